"""Paths over two edges: behind a pillar against the field of its outline, and where they take over from others."""

from functools import cache

import numpy as np
import pytest
from edge_fields import jumps
from pillar_bem import PILLAR, RECEIVERS, SIDE, SOURCE, C
from scipy.special import hankel2

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE = 192e3, 40e3
TALL = 30.0  # m, to the ends of the pillar


def pillar() -> clsim.MeshRoom:
    half = 0.5 * SIDE
    foot = [(-half, -half), (half, -half), (half, half), (-half, half)]
    corners = [(*place, z) for z in (-TALL, TALL) for place in foot]
    sides = [(i, (i + 1) % 4, j) for i in range(4) for j in (4 + (i + 1) % 4,)]
    sides += [(i, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    return clsim.MeshRoom(corners, sides, clsim.Material.from_reflection(1.0))


def paths_past(receivers: list[clsim.Trajectory], diffraction: int) -> PathSet:
    source = clsim.Source("s", clsim.Signal.tone(TONE, 0.01, RATE), clsim.Trajectory.fixed((*SOURCE, 0.0)))
    ears = [clsim.Receiver(f"r{i}", way) for i, way in enumerate(receivers)]
    scene = clsim.Scene(pillar(), clsim.Air(absorption=False, speed_of_sound=C), [source], ears)
    paths = clsim.find_paths(scene, 1, diffraction=diffraction)
    time = np.zeros(1)
    near = [
        np.concatenate([pair.index[pair.arrivals(time).length[:, 0] < 0.5 * TALL] for pair in family.pairs()])
        for family in paths.families
        if len(family)
    ]
    kept = [family for family in paths.families if len(family)]
    return PathSet(scene, tuple(family.part(rows) for family, rows in zip(kept, near, strict=True)))


@cache
def at_rest(diffraction: int) -> PathSet:
    return paths_past([clsim.Trajectory.fixed((*place, 0.0)) for place in RECEIVERS], diffraction)


def over_free_field(paths: PathSet) -> np.ndarray:
    """Return totals at the receivers in two dimensions: ways spread as a line's sound does."""
    k, at, time = 2.0 * np.pi * TONE / C, SceneResponse(paths.scene, 0, np.array([TONE])), np.zeros(1)
    total = np.zeros(len(RECEIVERS), dtype=complex)
    for family in paths.families:
        for pair in family.pairs():
            found = pair.arrivals(time)
            length, free = found.length[:, 0], np.linalg.norm(np.subtract(RECEIVERS[pair.receiver], SOURCE))
            made = pair.response(found, time, at)[:, 0, 0] * length
            total[pair.receiver] += np.sum(made * hankel2(0, k * length)) / hankel2(0, k * free)
    return total


@pytest.mark.parametrize(("diffraction", "bound"), [(1, -9.0), (2, -30.5)])
def test_behind_a_pillar(diffraction: int, bound: float) -> None:
    """Root mean square over places out of sight, relative to the free field; the values are within -45 dB."""
    wrong = np.abs(over_free_field(at_rest(diffraction)) - PILLAR)
    assert 10.0 * np.log10(np.mean(wrong**2)) < bound


def test_ways_over_two_edges() -> None:
    """Delays are those of the legs, both edges are told, and both ends are alike."""
    paths = at_rest(2)
    double, half = paths.families[-1], 0.5 * SIDE
    assert np.all(double.order == 2 + np.sum(double.interactions == 0, axis=1))
    for pair in double.pairs():
        found, (x, y) = pair.arrivals(np.zeros(1)), RECEIVERS[pair.receiver]
        corners = double.vertices(pair.rows, 0.0)[:, :4, :2]
        legs = np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1)
        np.testing.assert_allclose(found.length[:, 0], legs, rtol=1e-12)
        np.testing.assert_allclose(found.delay[:, 0] * C, legs, rtol=1e-12)
        np.testing.assert_allclose(np.abs(corners[:, 1:3]), half, atol=1e-12)
        np.testing.assert_allclose(corners[:, 3], np.tile((x, y), (len(legs), 1)), atol=1e-12)


def test_no_jump_where_the_second_edge_takes_over() -> None:
    """A walk out of the deep shadow: what one edge sends begins as two edges have half of it, and the sight comes."""
    way = clsim.Trajectory.line((1.5, 0.06, 0.02), (1.48, 0.19, 0.03), 0.1)
    paths = paths_past([way], 2)
    single = paths.families[-2]
    events = np.unique(np.concatenate([single.start, single.end, paths.families[0].start, paths.families[0].end]))
    events = events[np.isfinite(events)]
    assert len(events) >= 2
    assert 20.0 * np.log10(jumps(paths, events, TONE).max()) < -40.0
    without = PathSet(paths.scene, paths.families[:-1])
    assert 20.0 * np.log10(jumps(without, events, TONE).max()) > -10.0
