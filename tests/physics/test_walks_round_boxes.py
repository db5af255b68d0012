"""Drawn walks round a crate: every path over edges is finite and bounded wherever it is evaluated."""

import numpy as np
import pytest
from edge_fields import field
from exhaustive import few
from made_meshes import box, joined, screen

import clsim
from clsim.paths.response import SceneResponse

FREQUENCIES = np.array([1e3, 40e3])
TIMES = np.linspace(-0.1, 1.1, 61)
LOUDEST = 18.0  # over a path without edges: four terms at each of two edges, of which one may be continued
ROOM = np.array([6.0, 5.0, 3.0])


def scene_round(
    low: np.ndarray, size: np.ndarray, source: np.ndarray, first: np.ndarray, last: np.ndarray, duration: float = 1.0
) -> clsim.Scene:
    """Walk, of one second where not told, in a room with a crate."""
    vertices, triangles = box(size)
    room = clsim.MeshRoom(*joined(box(ROOM), (vertices + low, triangles[:, ::-1])), clsim.Material.from_reflection(0.9))
    beacon = clsim.Source("s", clsim.Signal.tone(40e3, 0.5, 192e3), clsim.Trajectory.fixed(source))
    walker = clsim.Receiver("r", clsim.Trajectory.line(first, last, duration))
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
    paths, count = clsim.find_paths(scene, order, diffraction=2), 0
    at = SceneResponse(scene, 0, FREQUENCIES)
    for _, pair in paths.pairs():
        found, family = pair.arrivals(TIMES), pair.family
        response = pair.response(found, TIMES, at)
        assert np.isfinite(found.delay).all()
        assert np.isfinite(response).all(), type(family).__name__
        start, end = (x[pair.rows][:, None] for x in (family.start, family.end))
        active = (start <= TIMES) & (end > TIMES)
        assert np.all(np.abs(response[active]) <= LOUDEST / found.length[active][:, None])
        count += len(response)
    return count


@pytest.mark.parametrize(("place", "order"), few([((2.4, 1.5, 0.0), 1), ((2.6, 2.0, 0.0), 2)]))
def test_a_receiver_that_climbs_past_the_top_of_a_crate(place: tuple[float, float, float], order: int) -> None:
    ends = (np.array(end) for end in [(1.2, 2.1, 0.6), (4.2, 0.8, 0.9), (4.5, 3.6, 1.2)])
    assert check_walk(scene_round(np.array(place), np.array([0.7, 0.7, 1.0]), *ends), order) > 100


def test_a_walk_beside_a_crate_whose_edges_are_not_beyond_each_other() -> None:
    """Paths over two edges of which one is behind the other, rolled out: 2.5 m off, they took 3 million evaluations."""
    ends = (np.array(end) for end in [(4.95, 2.99, 2.3), (5.64, 1.51, 2.15), (5.27, 0.28, 0.99)])
    assert check_walk(scene_round(np.array([1.62, 1.79, 0.0]), np.array([1.14, 0.4, 1.58]), *ends, 4.1), 1) > 100


def test_drawn_walks() -> None:
    assert sum(check_walk(drawn(seed), 0) for seed in range(8)) > 80


@pytest.mark.exhaustive
@pytest.mark.long
@pytest.mark.parametrize(("order", "walks"), [(0, 400), (1, 80), (2, 20)])
def test_many_drawn_walks(order: int, walks: int) -> None:
    assert sum(check_walk(drawn(1000 * (order + 1) + seed), order) for seed in range(walks)) > 10 * walks


def level_at(places: list[tuple[float, float, float]], model: str, room: clsim.MeshRoom) -> np.ndarray:
    """Return the field of each receiver over that of free air, from a beacon at the first place."""
    beacon = clsim.Source("s", clsim.Signal.tone(40e3, 0.01, 192e3), clsim.Trajectory.fixed(places[0]))
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places[1:])]
    scene = clsim.Scene(room, clsim.Air(absorption=False), [beacon], ears)
    paths = clsim.find_paths(scene, 1, diffraction=1, diffraction_model=model)
    sums = [field(paths, np.array([0.5]), 40e3, receiver)[0] for receiver in range(len(ears))]
    return np.array(sums) * np.linalg.norm(np.subtract(places[1:], places[0]), axis=1)


@pytest.mark.parametrize("model", ["utd", "btm"])
def test_a_beacon_on_the_extension_of_an_edge(model: str) -> None:
    """A rigid screen does nothing to the sound of a source in its plane: the air moves along it already.

    Sound along the screen goes by one face alone: wrong by -33 dB at each of two edges and their image in the other
    face (docs/edges.md), together less than -22 dB.
    """
    room = clsim.MeshRoom(*screen((2.0, 2.0, 0.0), (2.0, 0.0, 0.0), 1.0), clsim.Material.from_reflection(1.0))
    line, beside = [(0.5, 2.0, 1.0), (5.5, 2.0, 1.0)], [(5.0, 3.0, 0.5), (3.0, 1.0, 0.3), (3.1, 2.4, 1.4)]
    for places in ([line[0], *beside], [line[1], *beside], [beside[0], *line]):
        wave = 2.0 * np.pi * 40e3 / clsim.Air(absorption=False).speed_of_sound
        free = np.exp(-1j * wave * np.linalg.norm(np.subtract(places[1:], places[0]), axis=1))
        assert np.max(np.abs(level_at(places, model, room) - free)) < 0.08
    assert np.isfinite(level_at(line, model, room)).all()


@pytest.mark.exhaustive
def test_ends_that_move_along_the_extension_of_an_edge(device: None) -> None:
    vertices, triangles = box((0.7, 0.7, 1.0))
    crate = vertices + np.array([2.0, 2.0, 0.5]), triangles[:, ::-1]
    room = clsim.MeshRoom(*joined(box(ROOM), crate), clsim.Material.from_reflection(0.9))
    signal = clsim.Signal.from_array(np.hanning(400) * np.sin(1.3 * np.arange(400)), 192e3)
    beacon = clsim.Source("s", signal, clsim.Trajectory.fixed((1.2, 2.0, 1.5)))
    climber = clsim.Receiver("r", clsim.Trajectory.line((2.7, 2.7, 1.9), (2.7, 2.7, 1.89), 0.02))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [beacon], [climber]), 0, diffraction=1)
    received = [np.asarray(clsim.render(paths, 192e3, engine=engine).samples) for engine in ("opencl", "reference")]
    assert np.max(np.abs(received[0] - received[1])) < 1e-4 * np.max(np.abs(received[1]))
