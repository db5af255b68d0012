"""Fades of paths over edges that nothing takes over from: jumps of the sum, the gain itself, and what is rendered."""

import pickle
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from edge_fields import field, terms
from test_edge_ends import AIR, HARD, around_events, decibels, in_the_open

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE = 192e3, 40e3
SIGNAL = clsim.Signal.tone(TONE, 0.01, RATE)
# Size of a thing, m, a source, and the ends of a walk of a second: the loudest jumps of 24 drawn walks.
WALKS = {
    "box": ((0.5, 0.4, 0.6), (0.5075, 0.0153, -0.5144), (-0.4633, 0.4729, 0.9582), (0.5687, 0.2869, 1.2047)),
    "table": ((0.9, 0.6, 0.04), (0.8447, -0.0214, 0.3301), (-0.2304, 1.2929, -0.1122), (0.8321, -0.5907, -0.7528)),
}


@cache
def walk(name: str, frequency: float = TONE, part: tuple[float, float] = (0.0, 1.0), **options: Any) -> PathSet:
    """Find the paths of a part of a walk, s."""
    size, source, *ends = WALKS[name]
    first, last = (np.array(end) for end in ends)
    begin, end = (first + share * (last - first) for share in part)
    way = clsim.Trajectory.line(begin, end, part[1] - part[0])
    signal = clsim.Signal.tone(frequency, 0.2, RATE, fade=0.01)
    emitting, receiver = clsim.Source("s", signal, clsim.Trajectory.fixed(source)), clsim.Receiver("r", way)
    scene = clsim.Scene(in_the_open(size), AIR, [emitting], [receiver])
    return clsim.find_paths(scene, 0, **{"diffraction": 2, **options})


def as_walker_sees(name: str) -> PathSet:
    """Find the paths of a walk where thing and source move instead."""
    size, source, *ends = WALKS[name]
    first, last = (np.array(end) for end in ends)
    shell, middle = clsim.Shoebox((20, 20, 20), clsim.Material.from_reflection(0.0)).as_mesh(), 0.5 * np.array(size)
    room = clsim.MeshRoom(shell.vertices - 10.0, shell.triangles, shell.faces.materials[0])
    moved, away = (clsim.Trajectory.line(x, x + first - last, 1.0) for x in (np.array(source), middle))
    ends_of = (
        [clsim.Source("s", clsim.Signal.tone(TONE, 0.1, RATE), moved)],
        [clsim.Receiver("r", clsim.Trajectory.fixed(first))],
    )
    body = clsim.Body.box("thing", size, HARD, away)
    return clsim.find_paths(clsim.Scene(room, AIR, *ends_of, bodies=[body]), 0, diffraction=2)


def loudest_jump(paths: PathSet, frequency: float = TONE, apart: float = 2e-6) -> float:
    """Return the largest jump where paths begin and end, dB re the strongest path there; see `jumps`."""
    times = (around_events(paths, apart).reshape(-1, 2)[:, [0, 0, 1, 1]] + 2e-7 * np.array([-1, 0, 0, 1])).ravel()
    one = terms(paths, times, frequency)
    sums = one.sum(axis=0).reshape(-1, 4)
    jump = sums[:, 2] - sums[:, 1] - 0.5 * (sums[:, 1] - sums[:, 0] + sums[:, 3] - sums[:, 2])
    return decibels(jump / np.abs(one).max(axis=0).reshape(-1, 4).max(axis=1))


@pytest.mark.parametrize("frequency", [40e3, 2e3])
@pytest.mark.parametrize("name", WALKS)
def test_the_sum_does_not_jump(name: str, frequency: float, measured: Callable[..., float]) -> None:
    """Where an end passes the plane of a face, and a third edge comes into the way of two."""
    assert loudest_jump(walk(name, frequency, edge_fades=False), frequency) > -18.0
    error = loudest_jump(walk(name, frequency), frequency)
    assert measured("walks past a table and a box, fades", "no jump", error, -60.0) < -60.0


def test_the_sum_does_not_jump_over_one_edge_or_three(measured: Callable[..., float]) -> None:
    error = max(loudest_jump(walk("box", diffraction=edges)) for edges in (1, 3))
    assert measured("a walk past a box, one edge and three, fades", "no jump", error, -60.0) < -60.0


@pytest.mark.parametrize("name", WALKS)
def test_the_sum_does_not_jump_while_things_move(name: str, measured: Callable[..., float]) -> None:
    """Events of one instant are some microseconds apart at bodies: between them paths turn, so each is taken alone."""
    error = loudest_jump(as_walker_sees(name), apart=3e-7)
    assert measured("a moving thing, fades", "no jump", error, -65.0) < -65.0


@pytest.mark.parametrize("edges", [1, 2])
def test_a_body_at_rest_fades_as_the_same_in_the_room(edges: int, measured: Callable[..., float]) -> None:
    """In the middle of fades, past a box; the source is exactly in the plane of a face or not."""
    size, beside, first, last = WALKS["box"]
    shell, middle = clsim.Shoebox((20, 20, 20), clsim.Material.from_reflection(0.0)).as_mesh(), 0.5 * np.array(size)
    room = clsim.MeshRoom(shell.vertices - 10.0, shell.triangles, shell.faces.materials[0])
    box = [clsim.Body.box("thing", size, HARD, clsim.Trajectory.fixed(middle))]
    errors = []
    for source in (beside, (0.9, 0.2, 0.6)):
        ends = (
            [clsim.Source("s", SIGNAL, clsim.Trajectory.fixed(source))],
            [clsim.Receiver("r", clsim.Trajectory.line(first, last, 1.0))],
        )
        one, other = (
            clsim.find_paths(clsim.Scene(about, AIR, *ends, bodies=things), 0, diffraction=edges)
            for about, things in ((in_the_open(size), []), (room, box))
        )
        times = middles_of_fades(one)
        sums = terms(one, times, TONE)
        errors.append(decibels((sums.sum(axis=0) - field(other, times, TONE)) / np.abs(sums).max(axis=0)))
    assert measured("fades of a body at rest", "the room", max(errors), -80.0) < -80.0


def test_a_path_fades_within_its_time() -> None:
    """Half of the pressure is there in the middle, all beyond, in the table of paths as in responses."""
    (paths, plain), halfway = (walk("table", edge_fades=fades) for fades in (True, False)), 0
    for family, other in zip(paths.families, plain.families, strict=True):
        fades = getattr(family, "fades", None)
        alone = np.flatnonzero(np.abs(fades.share[:, 1] - 1.0) < 1e-5) if fades is not None else ()
        for row in alone:
            end, span = family.end[row], fades.columns.span[row, 1]
            one, whole = (
                PathSet(f.scene, (f.part(np.array([row])),)).table(end - span * np.array([1.2, 0.5, 1e-3])).gain[0]
                for f in (family, other)
            )
            np.testing.assert_allclose(one / whole, [1.0, 0.5, 0.0], atol=1e-5)
            halfway += 1
    assert halfway > 5


def sent_at(paths: PathSet, times: np.ndarray, frequency: float = TONE) -> tuple[np.ndarray, np.ndarray]:
    """Sums and largest of all paths that are sent at times (T,), as edges hear a frequency, whoever moves."""
    found = []
    for family in paths.families:
        for row in np.arange(len(family))[:, None]:
            received = times
            for _ in range(5):
                received = times + family.arrivals(row, received).delay[0]
            for k in np.flatnonzero((received >= family.start[row]) & (received < family.end[row])):
                now = received[[k]]
                arrived = family.arrivals(row, now)
                at = SceneResponse(paths.scene, 0, frequency / arrived.frequency_ratio[0])
                one = family.response(row, arrived, now, at)[0, 0, 0] / arrived.mach_factor[0, 0]
                turned = np.exp(-2j * np.pi * frequency * arrived.delay[0, 0])
                found.append(np.where(np.arange(len(times)) == k, one * turned, 0.0))
    return np.sum(found, axis=0), np.abs(found).max(axis=0)


@pytest.mark.parametrize("name", WALKS)
@pytest.mark.parametrize("edges", [1, 2])
def test_fades_are_the_same_both_ways(edges: int, name: str, measured: Callable[..., float]) -> None:
    """In the middle of fades, with the source on the walk and the receiver at rest."""
    size, source, *ends = WALKS[name]
    ways = clsim.Trajectory.fixed(source), clsim.Trajectory.line(*ends, 1.0)
    one, other = (
        clsim.find_paths(
            clsim.Scene(in_the_open(size), AIR, [clsim.Source("s", SIGNAL, way)], [clsim.Receiver("r", back)]),
            0, diffraction=edges,
        )
        for way, back in (ways, ways[::-1])
    )  # fmt: skip
    times = middles_of_fades(one)[::4]
    sums = terms(one, times, TONE)
    exchanged, _ = sent_at(other, times)
    error = decibels((sums.sum(axis=0) - exchanged) / np.abs(sums).max())
    assert measured("fades, both ways", "reciprocity", error, -80.0) < -80.0


def middles_of_fades(paths: PathSet) -> np.ndarray:
    """Times (n,) half-way through fades, s."""
    times = []
    for family in paths.families:
        if (fades := getattr(family, "fades", None)) is not None:
            shares, span = np.abs(fades.share), fades.columns.span
            times += list((family.start + 0.5 * span[:, 0])[shares[:, 0] > 0.01])
            times += list((family.end - 0.5 * span[:, 1])[shares[:, 1] > 0.01])
    return np.unique(times)


def test_fades_are_found_when_needed() -> None:
    """A copy, as worker processes get it, has the shares alone, and all have one digest."""
    paths = walk.__wrapped__("box", diffraction=1)
    found = paths.families[-1].fades.found
    assert "made" not in vars(found)
    copy = pickle.loads(pickle.dumps(paths))
    assert set(vars(copy.families[-1].fades.found)) == {"made"}
    assert copy.digest() == paths.digest() == walk("box", diffraction=1).digest()
    assert paths.digest() != walk("box", diffraction=1, edge_fades=False).digest()


def test_what_is_rendered_fades(engine: str, measured: Callable[..., float]) -> None:
    """A tone past the loudest event, but for the transitions of paths that begin and end."""
    paths = walk("box", part=(0.37, 0.49), diffraction=1)
    assert paths.families[-1].fades.share.any()
    heard = clsim.render(paths, RATE, duration=0.12, engine=engine).pressure[0]
    times = np.arange(round(0.02 * RATE), round(0.115 * RATE)) / RATE
    apart = np.abs(times[:, None] - around_events(paths)).min(axis=1)
    times = times[apart > 6e-4]
    wanted = np.imag(field(paths, times, TONE) * np.exp(2j * np.pi * TONE * times))
    error = decibels((heard[np.round(times * RATE).astype(int)] - wanted) / np.abs(wanted).max())
    assert measured("a tone past a box, fades", "gains and delays of each path", error, -85.0) < -85.0
