"""Drawn walks round a crate: every path over edges is finite and bounded wherever it is evaluated."""

import numpy as np
import pytest
from made_meshes import box, joined

import clsim
from clsim.paths.response import SceneResponse

FREQUENCIES = np.array([1e3, 40e3])
TIMES = np.linspace(-0.1, 1.1, 61)
LOUDEST = 18.0  # over a path without edges: four terms at each of two edges, of which one may be continued
ROOM = np.array([6.0, 5.0, 3.0])


def scene_round(low: np.ndarray, size: np.ndarray, source: np.ndarray, first: np.ndarray, last: np.ndarray) -> clsim.Scene:
    """Return a walk of one second in a room with a crate."""
    vertices, triangles = box(size)
    room = clsim.MeshRoom(*joined(box(ROOM), (vertices + low, triangles[:, ::-1])), clsim.Material.from_reflection(0.9))
    beacon = clsim.Source("s", clsim.Signal.tone(40e3, 0.5, 192e3), clsim.Trajectory.fixed(source))
    walker = clsim.Receiver("r", clsim.Trajectory.line(first, last, 1.0))
    return clsim.Scene(room, clsim.Air(), [beacon], [walker])


def drawn(seed: int) -> clsim.Scene:
    """Return a drawn walk that keeps 5 cm from a drawn crate."""
    random = np.random.default_rng(seed)
    size, low = random.uniform([0.3, 0.3, 0.4], [1.2, 1.2, 1.5]), np.append(random.uniform([1.5, 1.2], [3.0, 2.5]), 0.0)
    share = np.linspace(0.0, 1.0, 200)[:, None]
    while True:
        first, last, source = random.uniform(0.2, ROOM - 0.2, (3, 3))
        places = np.concatenate([source[None], first + share * (last - first)])
        if np.all(np.any((places < low - 0.05) | (places > low + size + 0.05), axis=1)):
            return scene_round(low, size, source, first, last)


def check_walk(scene: clsim.Scene, order: int) -> int:
    """Check all paths of a walk at all times, in their intervals and beyond; return how many there are."""
    paths, count = clsim.find_paths(scene, order, diffraction=2, resolution=1e-4), 0
    at = SceneResponse(scene, 0, FREQUENCIES)
    for _, pair in paths.pairs():
        found, family = pair.arrivals(TIMES), pair.family
        response = pair.response(found, TIMES, at)
        assert np.isfinite(found.delay).all() and np.isfinite(response).all(), type(family).__name__
        active = (TIMES >= family.start[pair.rows][:, None]) & (TIMES < family.end[pair.rows][:, None])
        assert np.all(np.abs(response[active]) <= LOUDEST / found.length[active][:, None])
        count += len(response)
    return count


def test_a_receiver_that_climbs_past_the_top_of_a_crate() -> None:
    crate = np.array([2.4, 1.5, 0.0]), np.array([0.7, 0.7, 1.0])
    ends = (np.array(place) for place in [(1.2, 2.1, 0.6), (4.2, 0.8, 0.9), (4.5, 3.6, 1.2)])
    assert check_walk(scene_round(*crate, *ends), 1) > 100


def test_drawn_walks() -> None:
    assert sum(check_walk(drawn(seed), 0) for seed in range(12)) > 120


@pytest.mark.exhaustive
@pytest.mark.parametrize(("order", "walks"), [(0, 400), (1, 80), (2, 20)])
def test_many_drawn_walks(order: int, walks: int) -> None:
    assert sum(check_walk(drawn(1000 * (order + 1) + seed), order) for seed in range(walks)) > 10 * walks
