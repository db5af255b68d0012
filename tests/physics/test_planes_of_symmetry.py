"""Walks in a plane of symmetry, where paths over an edge run along their boundaries all the time."""

import numpy as np
import pytest
from edge_fields import terms

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.visibility import edge_intervals as pieces
from clsim.paths.visibility.edges import EdgeVisibility

PLAN = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 8), (0, 8)]
MOST = 40_000  # evaluations; 0.5 s at 1 ms are 1500 of each path on a boundary, at the resolution of 0.3 us 3 million


def on_the_diagonal(aside: float) -> PathSet:
    """Find the paths of a walk along the diagonal through the corner of an L, of which the source is so far aside, m."""
    room = clsim.MeshRoom.from_plan(PLAN, 3.0, clsim.Material.from_reflection(0.9))
    beacon = clsim.Source("s", clsim.Signal.tone(40e3, 1.0, 192e3), clsim.Trajectory.fixed((2.0 + aside, 2.0, 1.5)))
    walker = clsim.Receiver("r", clsim.Trajectory.line((1.0, 1.0, 1.2), (3.5, 3.5, 1.3), 0.5))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [beacon], [walker]), 3, diffraction=1)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where sides of paths are asked for too often."""
    asked, sides = [0], EdgeVisibility.sides

    def counting(self, query, which, time, half):
        asked[0] += len(which)
        assert asked[0] < MOST
        return sides(self, query, which, time, half)

    monkeypatch.setattr(EdgeVisibility, "sides", counting)


def test_a_walk_on_the_diagonal_of_an_l(counted: None) -> None:
    """A source 2 um aside, whose paths are on one side of each boundary, gives the same pressure."""
    times = np.linspace(0.01, 0.49, 49)
    one, other = (terms(on_the_diagonal(aside), times, 40e3) for aside in (0.0, 2e-6))
    apart = np.abs(one.sum(axis=0) - other.sum(axis=0)) / np.abs(other).max(axis=0)
    assert apart.max() < 0.02  # 2 um of 130 paths and more: 1.5e-3 rad each, added as their squares


def test_endless_searches_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "MOST_EVALUATIONS", 500)
    with pytest.raises(clsim.InputError, match=r"diffraction: must let .* 500 .*lower max_order, or give a larger res"):
        on_the_diagonal(0.0)
