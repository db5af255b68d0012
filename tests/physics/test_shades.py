"""Shadows of outlines in scenes: on the device, several in a row, on echoes, and as a person walks by.

Levels are relative to the free field, where the exact one is above -20 dB.
"""

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from exhaustive import exhaustive
from shadow_oracle import AIR, MIDDLE, SILENT, PointSources, ellipsoid, errors, heard, walk

import clsim
from clsim.paths.response import SceneResponse
from clsim.paths.search.shades import parts_of
from clsim.paths.vertices.shade import ShadeVertex
from clsim.scene.scene import hidden_by_several


def crossing(thing: str) -> clsim.PathSet:
    """Return the direct sound of a chirp, and a body with a shadow that turns as it crosses its path; or two of them."""
    times, angle = np.linspace(0.0, 0.1, 5), np.linspace(0.0, 0.4, 5)[:, None]
    turned = np.concatenate([np.sin(angle) * np.array([0.36, 0.48, 0.8]), np.cos(angle)], axis=1)
    way = clsim.Trajectory.waypoints(times, np.array([2.0, 1.6, 1.2]) + np.outer(times, [0.2, 5.0, 0.5]), turned)
    made = {
        "ellipsoid": lambda: clsim.Scatterer.ellipsoid("e", (0.1, 0.15, 0.12), way, shadow=True),
        "capsule": lambda: clsim.Scatterer.capsule("e", 0.05, 0.2, way, shadow=True),
        "sphere": lambda: clsim.Scatterer.sphere("e", 0.1, way, model="outline"),
    }
    bodies = [made[thing.removeprefix("pole and ")]()]
    if thing.startswith("pole and "):
        turn = np.array([0.0, 0.1, 0.0, 1.0]) / np.sqrt(1.01)
        pole = clsim.Trajectory.fixed((1.6, 1.72, 1.2), turn)
        bodies.insert(0, clsim.Scatterer.capsule("pole", 0.05, 0.4, pole, shadow=True))
    band = (30e3, 50e3) if len(bodies) == 1 else (39e3, 41e3)  # the reference takes minutes for two in the wide one
    chirp = clsim.Signal.pulses(clsim.Signal.chirp(*band, 4e-3, 192e3, window="tukey"), 0.01, 4)
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8)), clsim.Air(),
        [clsim.Source("s", chirp, clsim.Trajectory.fixed((1.0, 1.7, 1.2)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 1.8, 1.2)))], scatterers=bodies,
    )  # fmt: skip
    return clsim.find_paths(scene, 0)


@pytest.mark.parametrize(
    "thing",
    [
        "ellipsoid",
        *(pytest.param(x, marks=pytest.mark.exhaustive) for x in ("capsule", "sphere", "pole and ellipsoid")),
    ],
)
def test_shadows_on_the_device(thing: str, device: str, measured: Callable[..., float]) -> None:
    """A body that turns as it passes between: the device's sound is that of the float64 reference."""
    paths = crossing(thing)
    wanted = clsim.render(paths, 192e3, duration=0.04, engine="reference").samples
    still = clsim.render(clsim.find_paths(replace(paths.scene, scatterers=()), 0), 192e3, duration=0.04).samples
    finest_db = -75.0 if thing.startswith("pole and ") else -90.0  # two shades in a row need too many functions below
    claims = ((finest_db, f"shadow of a {thing} that passes, on the device"), (-60.0, "the same by default"))
    for asked_db, claim in claims:
        options = {} if asked_db == -60.0 else {"scattering_error_db": asked_db}
        made = clsim.render(paths, 192e3, duration=0.04, **options).samples
        error = 10.0 * np.log10(
            np.mean((made - wanted) ** 2) / np.mean(still**2)
        )  # as deep in a shadow little is heard
        measured(claim, "the float64 reference", error, asked_db, "dB")
    assert np.sqrt(np.mean(wanted**2)) < 0.9 * np.sqrt(np.mean(still**2))


@pytest.mark.parametrize("gap", [1.5, exhaustive(2.5)])
def test_shades_in_a_row_multiply(gap: float, measured: Callable[..., float]) -> None:
    """Two ellipsoids in a row, k a of 6, against point sources inside both at once; and in either order in the scene.

    Sums of both shadows are 4 dB off in the mean here, and 7 dB at worst.
    """
    ka, source, across = 6.0, np.array([-6.0, 0.0, 0.0]), np.arange(0.0, 3.6, 0.2)
    axes = np.array([0.6, 1.0, 0.7]), np.array([0.7, 0.8, 1.1])
    at = np.array([-0.5 * gap, 0.1, 0.0]), np.array([0.5 * gap, -0.15, 0.1])
    alone = [ellipsoid(size, ka, 450) for size in axes]
    exact = PointSources(
        np.concatenate([one.places + place for one, place in zip(alone, at, strict=True)]),
        np.concatenate([one.normals for one in alone]),
        np.concatenate([one.inside + place for one, place in zip(alone, at, strict=True)]), ka,
    )  # fmt: skip
    bodies = [
        clsim.Scatterer.ellipsoid(name, size, clsim.Trajectory.fixed(MIDDLE + place), shadow=True)
        for name, size, place in zip("ab", axes, at, strict=True)
    ]
    places = walk(0.5 * gap + 2.5, across)
    one, other = (heard(things, ka, source, places) for things in (bodies, bodies[::-1]))
    assert np.abs(one - other).max() < 0.06  # but for the fading of what is far off the line of sight
    twice = heard(bodies, ka, source, places, scatterers_in_row=2)
    assert np.abs(np.abs(twice) - np.abs(one)).max() < 0.3  # echoes from one to the other, and no shade twice
    errors_db = errors(one, exact.levels(source, places))
    rms = float(np.sqrt(np.mean(errors_db**2)))
    measured("shadow of two ellipsoids in a row, k a = 6", "point sources inside both, dB rms", rms, 2.5)
    assert np.abs(errors_db).max() < 5.0


def test_shadows_in_a_row_are_told() -> None:
    """A sphere by its series and an ellipsoid: their shadows add up, and a warning names both; not for outlines."""
    tone = clsim.Signal.tone(40e3, 0.02, 192e3)
    places = [MIDDLE + np.array(place) for place in ((-1.2, 0.0, 0.0), (1.2, 0.02, 0.01))]
    ends = (
        [clsim.Source("s", tone, clsim.Trajectory.fixed(places[0]))],
        [clsim.Receiver("r", clsim.Trajectory.fixed(places[1]))],
    )
    arm = clsim.Trajectory.line(MIDDLE + np.array([0.3, 0.6, 0.0]), MIDDLE + np.array([0.3, 0.1, 0.0]), 0.05)
    chest = clsim.Trajectory.fixed(MIDDLE + np.array([-0.3, 0.03, 0.02]))
    aside = clsim.Trajectory.fixed(MIDDLE + np.array([0.3, 0.6, 0.0]))
    for way, model, told in ((arm, "outline", False), (aside, "series", False), (arm, "series", True)):
        bodies = [
            clsim.Scatterer.sphere("chest", 0.2, chest, model=model),
            clsim.Scatterer.ellipsoid("arm", (0.1, 0.4, 0.35), way, shadow=True),
        ]
        scene = clsim.Scene(clsim.Shoebox((60.0, 60.0, 60.0), SILENT), AIR, *ends, scatterers=bodies)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            clsim.find_paths(scene, 0, scattering_order=0)
        several = [str(w.message) for w in found if "shadows add up" in str(w.message)]
        assert len(several) == told
    moved = hidden_by_several(scene.sources, scene.receivers, scene.scatterers)
    assert moved is not None
    named, time = re.fullmatch(
        r"('chest' and 'arm') stand in the line of sight from 's' to 'r' at (.*) s", moved
    ).groups()
    assert named
    # At 10 m/s the rim, 0.4 m before the centre, is on the line of sight after 0.6 - 0.4 - 0.013 m; 0.07 ms are a look.
    assert float(time) == pytest.approx(0.0187, abs=2e-3)


def shaded(order: int, ends: list[np.ndarray], places: list[np.ndarray], size: float, reflecting: bool) -> complex:
    """Return the factor by shadows of the loudest path of an order between two ends in a cube about 0, past ellipsoids."""
    middle = np.full(3, 0.5 * size)
    wall = clsim.Material.from_reflection(1.0) if reflecting else SILENT
    bodies = [
        clsim.Scatterer.ellipsoid(str(i), (0.1, 0.05, 0.2), clsim.Trajectory.fixed(middle + at), shadow=True)
        for i, at in enumerate(places)
    ]
    source, receiver = (clsim.Trajectory.fixed(middle + place) for place in ends)
    scene = clsim.Scene(
        clsim.Shoebox((size,) * 3, wall), AIR, [clsim.Source("s", clsim.Signal.tone(40e3, 0.02, 192e3), source)],
        [clsim.Receiver("r", receiver)], scatterers=bodies,
    )  # fmt: skip
    found = clsim.find_paths(scene, order, scattering_order=order).table(np.array([0.06]))
    of_order = found.order == order
    plain = np.flatnonzero(of_order & (found.interactions <= 0).all(axis=1))
    factors = {}
    for row in np.flatnonzero(of_order & (found.interactions == 5).any(axis=1)):
        walls = [x for x in found.objects[row].tolist() if x >= 0]
        alike = [p for p in plain if [x for x in found.objects[p].tolist() if x >= 0] == walls]
        assert len(alike) == 1
        factors[tuple(walls)] = complex(found.gain[row, 0] / found.gain[alike[0], 0])
    return max(factors.values(), key=abs)


@pytest.mark.parametrize(
    "walls",
    [
        [(0, 1)], [(0, 1), (1, 1)], [(1, 1), (0, 1)], [(0, 1), (0, -1)], [(0, 1), (1, 1), (2, -1)],
        [(1, -1), (0, 1), (1, 1)],
    ],
)  # fmt: skip
def test_shadows_on_echoes_are_those_on_images(walls: list[tuple[int, int]]) -> None:
    """A body beside each leg: the factor of the echo is that of the image's sound past images of all bodies.

    Walls of a cube of 4 m are met in the order that is given, by their axes and sides.
    """
    random, half = np.random.default_rng(len(walls)), 2.0
    for _ in range(4000):  # ends between which the line through the images meets the walls in this order
        source, image = random.uniform(-1.6, 1.6, (2, 3))
        mirrors, met, at, seen = [], [], source.copy(), image.copy()
        for axis, side in reversed(walls):  # the receiver as the source sees it
            seen[axis] = 2.0 * side * half - seen[axis]
        for _ in walls:
            along = seen - at
            hits = [(half * np.sign(along[i]) - at[i]) / along[i] for i in range(3)]
            axis = int(np.argmin(hits))
            met.append((axis, int(np.sign(along[axis]))))
            at = at + hits[axis] * along
            seen[axis] = 2.0 * met[-1][1] * half - seen[axis]
            mirrors.append(at.copy())
        if met == walls and min(np.linalg.norm(np.diff([source, *mirrors, image], axis=0), axis=1)) > 0.8:
            break
    else:
        pytest.fail("no such path")
    corners = [source, *mirrors, image]
    bodies = []
    for begin, end in pairwise(corners):
        leg = (end - begin) / np.linalg.norm(end - begin)
        aside = np.cross(leg, [0.3, 0.5, 0.8])
        bodies.append(0.5 * (begin + end) + 0.09 * aside / np.linalg.norm(aside))
    echo = shaded(len(walls), [source, image], bodies, 2.0 * half, True)
    images = []
    for leg, body in product(range(len(bodies)), bodies):  # as the receiver sees it: by the walls behind the leg
        place = body.copy()
        for axis, side in walls[leg:]:
            place[axis] = 2.0 * side * half - place[axis]
        images.append(place)
    far = source.copy()
    for axis, side in walls:
        far[axis] = 2.0 * side * half - far[axis]
    direct = shaded(0, [far, image], images, 60.0, False)
    assert abs(direct) > 0.1
    assert echo == pytest.approx(direct, rel=1e-6)


def test_nothing_jumps_as_a_person_walks_through_a_line_of_sight() -> None:
    """Twelve limbs in 2000 steps of 0.2 mm, at default settings: no step is far above its neighbours."""
    way = clsim.Trajectory.line((2.0, 1.2, 0.0), (2.0, 1.6, 0.0), 0.4)
    room = clsim.Shoebox((4.0, 3.0, 2.5), SILENT)
    ends = [clsim.Trajectory.fixed((x, 1.5, 1.1)) for x in (0.5, 3.5)]
    tone = clsim.Signal.tone(40e3, 0.35, 192e3)
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])],
        scatterers=clsim.walking_person("p", 1.75, way, shadow=True),
    )  # fmt: skip
    times, total = np.linspace(0.02, 0.34, 2001), 0.0
    at, paths = SceneResponse(scene, 0, np.array([40e3])), clsim.find_paths(scene, 0)
    for family in paths.families:
        for pair in family.pairs():
            found = pair.arrivals(times)
            turn = np.exp(-2j * np.pi * 40e3 * found.delay)
            total = total + np.sum(pair.response(found, times, at)[..., 0] * turn, axis=0)
    steps = np.abs(np.diff(total)) * 3.0  # over the direct sound
    around = np.maximum(steps[:-2], steps[2:])
    assert np.ptp(np.abs(total)) * 3.0 > 0.5
    assert (steps[1:-1] - around).max() < 1e-3


def test_shadows_begin_and_end_where_nothing_is_near() -> None:
    """A person walks to and fro between moving ends: rows of times and parts give what all parts give all the time."""

    def place(t: np.ndarray) -> np.ndarray:
        return np.stack([2.0 + 0.3 * np.sin(0.7 * t), 1.5 + 0.9 * np.sin(1.1 * t), 0.0 * t], axis=1)

    duration, room = 6.0, clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    way = clsim.Trajectory.line((0.5, 1.2, 1.1), (0.6, 1.8, 1.2), duration)
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", clsim.Signal.tone(40e3, 5.9, 192e3), way)],
        [clsim.Receiver("r", clsim.Trajectory.fixed((3.5, 1.6, 1.3)))],
        scatterers=clsim.walking_person("p", 1.75, clsim.Trajectory.sampled(place, duration, 100.0)),
    )  # fmt: skip
    paths = clsim.find_paths(scene, 2, scattering_order=2)
    shades: Any = next(family for family in paths.families if family.adds)
    walls: Any = next(family for family in paths.families if family.is_specular)
    assert len(shades) > len(np.unique(shades.walls, axis=0))  # several rows of one path
    assert shades.silent_ends
    at, times = SceneResponse(scene, 0, np.array([40e3])), np.linspace(0.05, duration - 0.01, 801)
    heard = 0
    for path in np.flatnonzero(walls.order <= 2)[::3].tolist():
        before, matrix, offset = parts_of(tuple(x for x in walls.walls[path].tolist() if x >= 0), scene)
        every = ShadeVertex(
            np.arange(1), np.array([0, len(before)]), matrix, offset, np.zeros((len(before), 2), dtype=int),
            scene.scatterers, True,
        )  # fmt: skip
        alone: Any = replace(walls.part(np.array([path])), vertex=every)
        found = alone.arrivals(np.arange(1), times)
        wanted = alone.response(np.arange(1), found, times, at)[0, :, 0]
        made = np.zeros_like(wanted)
        for row in np.flatnonzero(np.all(shades.walls[:, :2] == walls.walls[path, :2], axis=1)):
            now = np.flatnonzero((times >= shades.start[row]) & (times < shades.end[row]))
            one = np.array([row])
            made[now] += shades.response(one, shades.arrivals(one, times[now]), times[now], at)[0, :, 0]
        np.testing.assert_allclose(made, wanted, atol=1e-12)
        heard += int(np.any(wanted != 0.0))
    assert heard > 3


@pytest.mark.exhaustive
def test_shadows_that_begin_and_end_on_the_device(device: str, measured: Callable[..., float]) -> None:
    """A body crosses the line of sight twice within 0.6 s: the device's sound is that of the float64 reference."""

    def place(t: np.ndarray) -> np.ndarray:
        return np.stack([2.0 + 0.0 * t, 1.72 + 0.9 * np.cos(2.0 * np.pi * t / 0.6), 1.22 + 0.0 * t], axis=1)

    body = clsim.Scatterer.ellipsoid("e", (0.1, 0.05, 0.12), clsim.Trajectory.sampled(place, 0.6, 500.0))
    ends = [clsim.Trajectory.line((1.0, 1.7, 1.2), (1.1, 1.7, 1.2), 0.6), clsim.Trajectory.fixed((3.0, 1.8, 1.2))]
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.6, 2.5), SILENT), AIR,
        [clsim.Source("s", clsim.Signal.tone(40e3, 0.6, 192e3, fade=0.01), ends[0])],
        [clsim.Receiver("r", ends[1])], scatterers=[body],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0)
    rows = next(family for family in paths.families if family.adds)
    assert len(rows) == 2
    wanted = clsim.render(paths, 192e3, duration=0.6, engine="reference").samples
    still = clsim.render(clsim.find_paths(replace(scene, scatterers=()), 0), 192e3, duration=0.6).samples
    made = clsim.render(paths, 192e3, duration=0.6).samples
    error = 10.0 * np.log10(np.mean((made - wanted) ** 2) / np.mean(still**2))
    measured("shadow that passes twice, on the device", "the float64 reference", error, -60.0, "dB")


def test_shadows_ask_for_no_wider_bands() -> None:
    """A tone past a ball that comes by: envelopes are as narrow as without it, and nothing begins or ends at once."""
    way = clsim.Trajectory.line((2.0, 0.5, 1.2), (2.0, 3.5, 1.2), 3.0)
    ends = [clsim.Trajectory.line((1.0, 1.5, 1.2), (1.1, 1.6, 1.2), 3.0), clsim.Trajectory.fixed((3.0, 1.5, 1.2))]
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 4.0, 2.5), SILENT), AIR,
        [clsim.Source("s", clsim.Signal.tone(40e3, 2.9, 192e3, fade=0.01), ends[0])],
        [clsim.Receiver("r", ends[1])], scatterers=[clsim.Scatterer.ellipsoid("b", (0.05, 0.05, 0.05), way)],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0)
    shades = next(family for family in paths.families if family.adds)
    assert np.all(np.isfinite(shades.start) & np.isfinite(shades.end))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clsim.render(paths, 192e3, duration=0.2, baseband=(40e3, 1000.0), transition=0.0)
    assert not any(pair.fades for pair in clsim.plan_render(paths, 192e3, duration=2.9).tracks.pairs)


@pytest.mark.parametrize(("y", "shaded"), [(1.5, 1), (3.4, 0)])
def test_only_paths_that_something_comes_near_have_shadows(y: float, shaded: int) -> None:
    """A ball of 2 cm falls through the direct sound within 10 s, at up to 16 m/s: it is near that for some milliseconds."""

    def place(t: np.ndarray) -> np.ndarray:  # between two of the instants at which it is looked
        return np.stack([2.0 + 0.0 * t, y + 0.0 * t, 1.2 - 0.4 * np.tanh((t - 5.0195) / 0.025)], axis=1)

    scene = clsim.Scene(
        clsim.Shoebox((4.0, 4.0, 2.5), clsim.Material.from_reflection(0.0)), clsim.Air(),
        [clsim.Source("s", clsim.Signal.tone(40e3, 0.01, 192e3), clsim.Trajectory.fixed((1.0, 1.5, 1.2)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 1.5, 1.2)))],
        scatterers=[clsim.Scatterer.ellipsoid("b", (0.01, 0.01, 0.01), clsim.Trajectory.sampled(place, 10.0, 1e3))],
    )  # fmt: skip
    assert (clsim.find_paths(scene, 0).interactions == 5).any(axis=1).sum() == shaded
