"""Paths over an edge and by a scatterer, in either order: against products of what each does alone, which is proven."""

import dataclasses
import math

import numpy as np
import pytest
from edge_fields import field, jumps, terms

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE, C = 192e3, 40e3, 343.0
AIR = clsim.Air(absorption=False, speed_of_sound=C)
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
SCREEN = clsim.MeshRoom(
    [(0, 0, -3), (0, 0, 3), (-6, 0, 3), (-6, 0, -3)], [(0, 1, 2), (0, 2, 3)], clsim.Material.from_reflection(0.9)
)


def found(
    room: object,
    ends: tuple,
    things: tuple | list = (),
    order: int = 0,
    length: float = 0.06,
    **options: object,
) -> PathSet:
    tone = clsim.Signal.tone(TONE, length, RATE, fade=0.001)
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], scatterers=things
    )
    options = {"diffraction": 1, "edge_scattering": bool(things), "scattering_order": order} | options
    return clsim.find_paths(scene, order, **options)


def mixed(paths: PathSet, kind: str = "") -> PathSet:
    """Return the paths by an edge and a scatterer alone, of one order of both if it is named."""
    kinds = [kind] if kind else ["static edge scatterer", "static scatterer edge", "static edge scatterer edge"]
    return PathSet(paths.scene, tuple(f for f in paths.families if getattr(f, "kind", "") in kinds))


def shifted(ends: tuple) -> tuple:
    """Return ends at rest 15 m from the walls of an empty room."""
    return tuple(FIXED(np.array(end.position(0.0)) + 15.0) for end in ends)


def shifted_thing(thing: clsim.Scatterer) -> clsim.Scatterer:
    """Return a scatterer on `OUT` there."""
    places = [np.array(OUT.position(t)) + 15.0 for t in (0.0, 0.4)]
    return dataclasses.replace(thing, trajectory=LINE(*places, 0.4))


def decibels(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-300))


FLOOR_OF = clsim.Material.from_porous(20e3, 0.05, outside="extend")
SOME_KINDS = ["static scatterer", "static edge scatterer", "static scatterer edge", "static edge scatterer edge"]
SOURCE, POINT, RECEIVER = (-1.0, -1.2, 0.1), (-0.7, 1.5, 0.3), (-0.2, 2.6, -0.4)


@pytest.mark.parametrize("edge_first", [True, False])
def test_a_point_is_a_receiver_and_then_a_source(edge_first: bool) -> None:
    """At rest: the field over the edges to the point, by the free field of a point from there, to -180 dB."""
    ends = (SOURCE, RECEIVER) if edge_first else (RECEIVER, SOURCE)
    point = clsim.Scatterer.point("p", 0.0, FIXED(POINT))
    paths = mixed(found(SCREEN, (FIXED(ends[0]), FIXED(ends[1])), [point]))
    kind = "static edge scatterer" if edge_first else "static scatterer edge"
    got = field(mixed(paths, kind), np.zeros(1), TONE)[0]
    over = found(SCREEN, (FIXED(SOURCE), FIXED(POINT)))
    apart = math.dist(POINT, RECEIVER)
    wanted = field(over, np.zeros(1), TONE)[0] * np.exp(-2j * np.pi * TONE * apart / C) / apart
    assert len(paths) > 0
    assert decibels(abs(got - wanted) / abs(wanted)) < -180.0
    named = [paths.object_names[i] for i in paths.objects[0] if i >= 0]
    assert ("edge" in named[0], named[-1] == "p") == (True, True) if edge_first else named[0] == "p"


def test_both_ways_are_one() -> None:
    """A sphere of 5 cm behind a screen on a floor: the sums of all paths over edges and by it agree to -100 dB."""
    floor = clsim.MeshRoom([(-9, -9, -1), (9, -9, -1), (0, 18, -1)], [(0, 1, 2)], clsim.Material.from_reflection(0.7))
    screen = clsim.MeshRoom(
        [(0, 0, -0.9), (0, 0, 2), (-6, 0, 2), (-6, 0, -0.9)],
        [(0, 1, 2), (0, 2, 3)],
        clsim.Material.from_reflection(0.9),
    )
    room, ball = clsim.MeshRoom.joined([screen, floor]), [clsim.Scatterer.sphere("b", 0.05, FIXED(POINT))]
    ends = FIXED(SOURCE), FIXED(RECEIVER)
    each = [mixed(found(room, way, ball, 1)) for way in (ends, ends[::-1])]
    sums = [field(paths, np.zeros(1), TONE)[0] for paths in each]
    assert len(each[0]) == len(each[1]) > 8
    assert np.any(each[0].interactions == 0)
    assert decibels(abs(sums[0] - sums[1]) / abs(sums[0])) < -100.0


def earliest(source: np.ndarray, place: np.ndarray) -> float:
    """Length of the shortest path over the edge along z through the origin, from rolled-out distances."""
    r, s = (math.hypot(*x[:2]) for x in (source, place))
    return math.hypot(r + s, source[2] - place[2])


@pytest.mark.parametrize("edge_first", [True, False])
def test_all_that_moves_is_heard_as_two_delays_in_a_row(edge_first: bool, engine, measured) -> None:
    """Delays by bisection, Doppler factors as their derivatives, and what is rendered within -75 dB of the table."""
    ways = [
        LINE(SOURCE, (-1.4, -1.0, 0.3), 0.06),
        LINE(POINT, (-0.3, 1.4, 0.1), 0.06),
        LINE(RECEIVER, (-0.5, 2.4, 0.0), 0.06),
    ]
    ways = ways if edge_first else ways[::-1]
    kind = "static edge scatterer" if edge_first else "static scatterer edge"
    paths = mixed(found(SCREEN, (ways[0], ways[2]), [clsim.Scatterer.point("p", 0.0, ways[1])]), kind)
    row = int(
        np.argmax(paths.families[0].vertex.edges[0 if edge_first else 1].edge.frame[:, 0, 0] > -1e-9)
    )  # over the edge along z

    def emitted(time: float) -> float:
        place = ways[2].position(time)
        for n in (1, 0):
            low, high, over = time - 1.0, time, (n == 0) == edge_first
            for _ in range(200):
                middle = 0.5 * (low + high)
                at = ways[n].position(middle)
                length = earliest(at, place) if over else float(np.linalg.norm(at - place))
                low, high = (middle, high) if middle + length / C < time else (low, middle)
            time = 0.5 * (low + high)
            place = ways[n].position(time)
        return time

    at = np.array([0.04, 0.05])
    family = paths.families[0]
    got = family.arrivals(np.array([row]), at)
    for i, time in enumerate(at.tolist()):
        assert abs(got.delay[0, i] - (time - emitted(time))) < 1e-12
        rate = 1.0 - (emitted(time + 1e-5) - emitted(time - 1e-5)) / 2e-5
        assert abs(got.delay_rate[0, i] - rate) < 1e-7
    assert np.abs(got.delay_rate).max() <= family.max_rate(8.0, 8.0)
    heard = clsim.render(paths, RATE, duration=0.06, engine=engine).pressure[0]
    samples = np.arange(8000, 11000)
    fine = np.imag(field(paths, samples / RATE, TONE) * np.exp(2j * np.pi * TONE * samples / RATE))
    error = float(decibels(np.abs(heard[samples] - fine).max() / np.abs(fine).max()))
    measured("an edge and a scatterer in a row, all moving", "bisection of both delays", error, -75.0)


@pytest.mark.parametrize("edge_first", [True, False])
@pytest.mark.parametrize(
    "thing",
    [
        clsim.Scatterer.point("p", 0.0, OUT := LINE((0.6, 1.0, 0.0), (1.4, 1.0, 0.0), 0.4)),
        clsim.Scatterer.sphere("p", 0.05, OUT),
        clsim.Scatterer.ellipsoid("p", (0.05, 0.08, 0.1), OUT),
        clsim.Scatterer.capsule("p", 0.15, 0.5, OUT),
    ],
    ids=["point", "sphere", "ellipsoid", "capsule"],
)
def test_what_comes_out_of_a_shadow_makes_no_step(thing: clsim.Scatterer, edge_first: bool) -> None:
    """At 2 m/s: where the path by it alone begins, the one over the edge changes over, and nothing jumps above -74 dB.

    That grows with the speed. Shortly before, the pressure is half of what it is without the screen, but for what the other edges add.
    """
    ends = FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))
    ends = ends if edge_first else ends[::-1]
    paths = found(SCREEN, ends, [thing])
    kinds = ["static scatterer", "static edge scatterer" if edge_first else "static scatterer edge"]
    some = PathSet(paths.scene, tuple(f for f in paths.families if getattr(f, "kind", "") in kinds))
    events = np.unique(np.concatenate([f.start[np.isfinite(f.start)] for f in some.families]))
    began = some.families[0].start[np.isfinite(some.families[0].start)]
    assert len(began) == 1
    assert began[0] in events
    assert max(map(decibels, jumps(some, events, TONE))) < -74.0
    free = found(
        clsim.Shoebox((30, 30, 30), clsim.Material.from_reflection(0.0)), shifted(ends), [shifted_thing(thing)]
    )
    free = PathSet(free.scene, tuple(f for f in free.families if f.kind == "static scatterer"))
    row = np.flatnonzero(some.families[1].end == began[0])
    assert len(row) == 1
    before = np.abs(terms(some, began - 1e-6, TONE)[len(some.families[0]) + row[0], 0])
    assert before / np.abs(field(free, began - 1e-6, TONE)[0]) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("turned", [False, True])
def test_all_paths_together_make_no_step_with_edges_on_either_side(turned: bool, measured) -> None:
    """A sphere comes out of the shadow of either end: all paths stay within -60 dB of the strongest, -50 over one edge."""
    ends = FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))
    ball = clsim.Scatterer.sphere("b", 0.05, OUT)
    largest = []
    for diffraction in (1, 2):
        paths = found(SCREEN, ends[:: -1 if turned else 1], [ball], diffraction=diffraction)
        some = [family for family in paths.families if "scatterer" in family.kind]
        times = np.concatenate([[*family.start, *family.end] for family in some])
        events = np.unique(times[np.isfinite(times) & (times < 0.4)])
        largest.append(max(map(decibels, jumps(paths, events, TONE))))
    measured("a sphere that comes out of an edge's shadow", "no jump", largest[1], -60.0)
    assert largest[1] < largest[0]


def test_a_point_between_two_edges_is_a_receiver_and_a_source() -> None:
    """At rest: the product of both exact fields over edges, to -180 dB; places are those of both edges and the point."""
    spot, ends = (1.2, 0.8, 0.2), (FIXED((-1.0, -1.0, 0.1)), FIXED((-0.9, 1.0, -0.2)))
    paths = found(SCREEN, ends, [clsim.Scatterer.point("p", 0.0, FIXED(spot))], diffraction=2)
    got = field(mixed(paths, "static edge scatterer edge"), np.zeros(1), TONE)[0]
    parts = [found(SCREEN, way) for way in ((ends[0], FIXED(spot)), (FIXED(spot), ends[1]))]
    parts = [PathSet(p.scene, tuple(f for f in p.families if f.kind == "static edge")) for p in parts]
    wanted = np.prod([field(p, np.zeros(1), TONE)[0] for p in parts])
    assert decibels(abs(got - wanted) / abs(wanted)) < -180.0
    family = mixed(paths, "static edge scatterer edge").families[0]
    places = family.vertices(np.arange(1), 0.0)[0]
    assert np.allclose(places[2], spot, atol=1e-12)
    legs = np.linalg.norm(np.diff(places[:5], axis=0), axis=1)
    assert legs.sum() / C == pytest.approx(family.arrivals(np.arange(1), np.zeros(1)).delay[0, 0], rel=1e-12)


FLOOR = clsim.MeshRoom([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)], [(0, 1, 2), (0, 2, 3)], FLOOR_OF)
STANDING = clsim.MeshRoom(
    [(0, 0, -0.9), (0, 0, 2), (-6, 0, 2), (-6, 0, -0.9)], [(0, 1, 2), (0, 2, 3)], clsim.Material.from_reflection(0.9)
)


def test_a_floor_between_edge_and_point_is_a_mirror() -> None:
    """With a factor that depends on the angle: the field over the edge to the mirrored point, times the factor.

    The screen's upper parts send to the image alone what the floor reflects.
    """
    spot, ends = (0.3, 1.5, -0.6), (FIXED((-1.0, -1.2, 0.9)), FIXED((0.4, 2.6, 0.2)))
    paths = found(clsim.MeshRoom.joined([STANDING, FLOOR]), ends, [clsim.Scatterer.point("p", 0.0, FIXED(spot))], 1)
    mine = mixed(paths, "static edge scatterer")
    family = mine.families[0]
    wanted_kinds = [1, 0, 2] + [-1] * (family.interactions.shape[1] - 3)
    rows = np.flatnonzero(np.all(family.interactions == wanted_kinds, axis=1))
    upright = [r for r in rows if np.abs(family.vertex.edges[0].edge.frame[r, 0, :2]).max() < 1e-9]
    upright = np.array([r for r in upright if family.vertex.edges[0].edge.over_end[r] < 0])
    assert len(upright) == 1
    got = field(PathSet(mine.scene, (family.part(upright),)), np.zeros(1), TONE)[0]
    mirrored = (*spot[:2], -2.0 - spot[2])
    over = found(STANDING, (ends[0], FIXED(mirrored)))
    edge = next(f for f in over.families if f.kind == "static edge")
    row = np.flatnonzero((np.abs(edge.vertex.frame[:, 0, :2]).max(axis=1) < 1e-9) & (edge.vertex.over_end < 0))
    there = PathSet(over.scene, (edge.part(row),))
    places = family.vertices(upright, 0.0)[0]
    down = places[2] - places[1]
    factor = FLOOR_OF.reflection_at(TONE, abs(down[2]) / np.linalg.norm(down), C)
    apart = math.dist(spot, ends[1].position(0.0))
    wanted = field(there, np.zeros(1), TONE)[0] * factor * np.exp(-2j * np.pi * TONE * apart / C) / apart
    assert decibels(abs(got - wanted) / abs(wanted)) < -120.0
    assert places[2][2] == pytest.approx(-1.0, abs=1e-12)
    assert np.allclose(places[3], spot, atol=1e-12)


@pytest.mark.exhaustive
@pytest.mark.parametrize("turned", [False, True])
def test_echoes_by_a_floor_make_no_step(turned: bool) -> None:
    """A sphere over a floor comes out of the shadow of a screen, each leg reflected or not: jumps below -60 dB."""
    ends = FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))
    ball = clsim.Scatterer.sphere("b", 0.03, LINE((0.6, 1.0, -0.2), (1.4, 1.0, -0.2), 0.4))
    room = clsim.MeshRoom.joined([SCREEN, FLOOR])
    paths = found(room, ends[:: -1 if turned else 1], [ball], 1, diffraction=2)
    some = [family for family in paths.families if family.kind in SOME_KINDS]
    times = np.concatenate([[*family.start, *family.end] for family in some])
    events = np.unique(times[np.isfinite(times) & (times < 0.4)])
    assert len(events) > 4
    assert max(map(decibels, jumps(paths, events, TONE))) < -60.0


def test_a_whole_period_later_all_is_the_same() -> None:
    """A sphere that swings behind the screen and out of it, 20 times a second: the sum of all paths, to -100 dB."""
    swing = clsim.Trajectory.sampled(
        lambda t: np.stack([1.0 + 0.1 * np.sin(40.0 * np.pi * t), 0 * t + 1.0, 0 * t], axis=-1), 0.2, 4e3
    )
    ball = clsim.Scatterer.sphere("b", 0.03, swing)
    paths = found(SCREEN, (FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))), [ball], length=0.2)
    times = 0.06 + 0.05 * np.linspace(0.0, 1.0, 200)
    one, other = (field(mixed(paths), t, TONE) for t in (times, times + 0.05))
    assert np.ptp(np.abs(one)) > 0.1 * np.abs(one).max()
    assert decibels(np.abs(one - other).max() / np.abs(one).max()) < -100.0


def test_both_engines_agree(device: None) -> None:
    """What is rendered of a sphere that comes out of a shadow: float32 nodes of the host against the definition."""
    ball = clsim.Scatterer.sphere("b", 0.05, LINE((0.98, 1.0, 0.0), (1.02, 1.0, 0.0), 0.03))
    paths = found(SCREEN, (FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))), [ball], length=0.03)
    both = [clsim.render(paths, RATE, duration=0.016, engine=name).pressure for name in ("opencl", "reference")]
    assert decibels(np.abs(both[0] - both[1]).max() / np.abs(both[1]).max()) < -86.0


def test_who_leaves_it_out_is_told() -> None:
    ends = FIXED((-1.0, -1.0, 0.1)), FIXED((0.3, 2.0, 0.0))
    with pytest.warns(clsim.ClsimWarning, match="scatterers go behind edges.*edge_scattering=True"):
        found(SCREEN, ends, [clsim.Scatterer.point("p", 0.0, OUT)], edge_scattering=False)


def test_bounds_hold_and_what_is_not_supported_is_refused() -> None:
    ends = FIXED(SOURCE), FIXED(RECEIVER)
    ball = clsim.Scatterer.sphere("b", 0.05, LINE(POINT, (-0.3, 1.4, 0.1), 0.06))
    for family in mixed(found(SCREEN, ends, [ball])).families[:1]:
        times, rows = np.linspace(0.01, 0.06, 30), np.arange(len(family))
        at = SceneResponse(family.scene, 0, np.array([TONE]))
        got = family.arrivals(rows, times)
        gain = np.abs(family.response(rows, got, times, at)[..., 0])
        assert np.all(gain * got.length <= family.gain_bound(rows, at))
        speeds = clsim.paths.family.PeakSpeeds(np.zeros(1), np.zeros(1))
        low, high = family.delay_bounds(rows, 0.01, 0.06, speeds)
        assert np.all((low[:, None] <= got.delay) & (got.delay <= high[:, None]))
    windy = clsim.Air(absorption=False, wind=(1.0, 0.0, 0.0))
    tone = clsim.Signal.tone(TONE, 0.06, RATE, fade=0.001)
    scene = clsim.Scene(
        SCREEN, windy, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], scatterers=[ball]
    )
    with pytest.raises(clsim.InputError, match="edge_scattering: must be false where the air moves"):
        clsim.find_paths(scene, 0, edge_scattering=True)
