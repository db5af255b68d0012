"""Few paths of a batch that need shorter blocks than others: they take them alone, and nothing is lost or heard twice."""

from typing import Any

import numpy as np
import pytest

import clsim
from clsim.paths.path_set import PathSet
from clsim.render.opencl.baseband_engine import _BasebandRun
from clsim.render.opencl.batches import BATCH
from clsim.render.opencl.block_polynomials import few_paths, promising
from clsim.render.opencl.engine import Run

RATE = 192e3


@pytest.fixture(scope="module")
def edges() -> PathSet:
    """Return paths over the edges of three pillars, from a source that moves to four receivers."""
    wall = clsim.Material.from_reflection(0.8)
    corners = [(2.0, 2.5), (3.5, 1.5), (4.2, 3.4)]
    pillars = [[(x, y), (x + 0.3, y), (x + 0.3, y + 0.3), (x, y + 0.3)] for x, y in corners]
    room = clsim.MeshRoom.from_plan([(0, 0), (6, 0), (6, 5), (0, 5)], 3.0, wall, pillars=pillars)
    sound = clsim.Signal.chirp(30e3, 50e3, 0.8, RATE, window="tukey")
    source = clsim.Source("s", sound, clsim.Trajectory.line((2.5, 1.0, 1.2), (3.3, 1.8, 1.4), 1.0))
    places = [(5.3, 4.2, 1.6), (1.0, 4.0, 1.1), (5.0, 0.7, 2.0), (0.6, 0.7, 1.7)]
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places)]
    found = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], ears), 1, diffraction=1)
    return PathSet(found.scene, (found.families[1],))


def test_a_few_paths_take_shorter_blocks_alone(edges: PathSet, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[tuple[bool, int, int]] = []
    render = _BasebandRun._render

    def noted(self: Any, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        rendered.append((self._batch.few, block, self._batch.count))
        render(self, nodes, segment, end, block, first_block)

    monkeypatch.setattr(_BasebandRun, "_render", noted)
    divided = clsim.render(edges, RATE, duration=0.8, narrowband=True).samples
    few, others = ([row for row in rendered if row[0] == kind] for kind in (True, False))
    assert few, "nothing was divided"
    assert min(count for _, _, count in others) >= 4 * BATCH > max(count for _, _, count in few) / 4
    assert max(block for _, block, _ in few) < max(block for _, block, _ in others)
    monkeypatch.setattr(Run, "_divides", False)
    together = clsim.render(edges, RATE, duration=0.8, narrowband=True).samples
    # Either is within -86 dB, of what a receiver hears within 40 ms.
    window = round(0.04 * RATE)
    parts = (x[:, : x.shape[1] // window * window].reshape(len(x), -1, window) for x in (divided - together, together))
    wrong, level = (np.sqrt(np.mean(part.astype(np.float64) ** 2, axis=2)) for part in parts)
    assert np.all(wrong <= 10 ** (-86 / 20) * level.max(axis=1, keepdims=True))


def test_the_fewest_paths_are_those_that_are_worst() -> None:
    squares = np.array([1.0, 5.0, 2.0, 0.0, 7.0, 1.0], dtype=np.float32)
    mask = few_paths(squares, np.array([0, 4, 6], dtype=np.int32), np.array([3.0, 0.5]))
    np.testing.assert_array_equal(mask, [False, True, False, False, True, True])


def test_promising_blocks_are_shorter() -> None:
    blocks = np.array([512, 384, 256, 192, 128, 96])
    np.testing.assert_array_equal(promising(blocks, 1, np.array([1.0, 10.0, 1e9])), [2, 3, 5])
