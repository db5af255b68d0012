"""Nodes of paths over one edge: the device's against those of the kind of paths itself, in float64 on the host."""

import warnings
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from made_responses import POROUS, OffCentre
from mutants import KeptEngines, Mutants

import clsim
from clsim.paths.fades import FadeColumns, Fades
from clsim.paths.path_set import PathSet
from clsim.render.opencl import path_columns
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT, Layout, OpenclEngine
from clsim.render.opencl.host_nodes import HostNodeMaker
from clsim.render.opencl.nodes import NodeMaker
from clsim.render.plan import Plan
from clsim.render.planning import plan_render

pytestmark = [pytest.mark.usefixtures("device"), pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")]
RATE = 192e3
SAMPLES = 9216
# Either takes gains from every fourth node where that is wrong by -100 dB of a path at most (`SMOOTH_SHARE`); paths add
# up as the root of the sum of squares.
TOLERANCE_DB = -100.0
CURTAIN = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])
SOFT = clsim.Material.from_reflection(-0.8)


@cache
def paths() -> PathSet:
    """Return paths round a screen over a porous floor, and round its ends, while both ends move fast; one edge is between two walls.

    The receiver passes boundaries of shadow and of reflection by the screen. All that begins or ends fades, by any share.
    """
    corners = [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0), (0, -1, 0.3), (0, 1, 0.3), (0, 1, 1.2), (0, -1, 1.2)]
    corners += [(0.4, 1.3, 0.3), (0.4, 1.3, 1.2)]
    triangles = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7), (5, 8, 9), (5, 9, 6)]
    room = clsim.MeshRoom(corners, triangles, [POROUS, POROUS, CURTAIN, CURTAIN, SOFT, SOFT])
    sweep = clsim.Signal.chirp(34e3, 46e3, 0.06, RATE, window="tukey")
    way = clsim.Trajectory.line((-1.0, 0.5, 0.9), (-0.8, 0.9, 1.1), 0.1)
    ears = [clsim.Trajectory.line((0.8, -0.2, 1.3), (0.8, 0.2, 1.6), 0.1), clsim.Trajectory.fixed((-0.4, 1.5, 0.8))]
    scene = clsim.Scene(
        room, clsim.Air(), [clsim.Source("s", sweep, way, OffCentre(2e-3), aim=(1.0, -0.2, 0.1))],
        [clsim.Receiver(f"r{i}", ear, clsim.FirstOrder(0.4), aim=(-1.0, 0.1, 0.3),
                        electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=2e-3))
         for i, ear in enumerate(ears)],
    )  # fmt: skip
    found: Any = clsim.find_paths(scene, 1, diffraction=1).families[1]
    random, bounds = np.random.default_rng(5), np.stack([found.start, found.end], axis=1)
    share = np.exp(1j * random.uniform(-0.7, 0.7, bounds.shape)) * random.uniform(0.0, 1.0, bounds.shape)
    span = np.clip(0.5 * np.diff(bounds), 1e-3, random.uniform(1e-3, 0.02, bounds.shape))
    known, rows = np.nan_to_num(bounds, posinf=0.0, neginf=0.0), np.arange(len(found))
    sent = random.uniform(0.0, 1.0, bounds.shape)
    moment = known - sent * np.stack([found.delays(rows, times) for times in known.T], axis=1)
    made = FadeColumns(np.where(np.isfinite(bounds), share, 0.0), span, moment, sent, 0.0 * sent)
    fades = Fades(SimpleNamespace(made=[made]), 0, rows)
    return PathSet(scene, (replace(found, fades=fades),))


@cache
def plan() -> Plan:
    return plan_render(paths(), RATE, duration=SAMPLES / RATE, convolve_static=False)


@cache
def by_host() -> np.ndarray:
    with pytest.MonkeyPatch.context() as patched:
        patched.delitem(path_columns.COLUMNS, "edges")
        engine = OpenclEngine(plan())
        assert isinstance(engine.maker(0), HostNodeMaker)
        return engine.render(0, SAMPLES)


ENGINES = KeptEngines()


def difference_db(layout: Layout = CPU_LAYOUT) -> float:
    """Return the error of the samples with nodes of the device, at the receiver where it is largest."""
    engine = ENGINES.engine(layout, lambda: OpenclEngine(plan(), layout))
    assert isinstance(engine.maker(0), NodeMaker)
    try:
        got = engine.render(0, SAMPLES)
    except clsim.ClsimError as error:  # the engine itself found that delays are out of bounds
        assert "lie outside the bounds" in str(error)
        ENGINES.forget(layout)
        return np.inf
    wanted = by_host()
    if not np.all(np.isfinite(got)):
        return np.inf
    return float(20 * np.log10((np.linalg.norm(got - wanted, axis=1) / np.linalg.norm(wanted, axis=1)).max()))


def test_the_scene_has_all_that_such_paths_do() -> None:
    found = paths().families[0]
    assert set(np.unique(found.vertex.end_side)) == {-1, 0, 1}
    assert set(np.unique(found.vertex.lit)) == {-1, 0, 1}
    before, after = found.links(slice(None)).surfaces
    assert np.any(before >= 0)
    assert np.any(after >= 0)
    assert np.any(found.start > 0.0)  # pieces between boundaries
    within = np.abs(found.start - 0.5 * SAMPLES / RATE) < 0.4 * SAMPLES / RATE
    assert np.count_nonzero(found.fades.share[within, 0]) > 5


@pytest.mark.parametrize("layout", few([CPU_LAYOUT, GPU_LAYOUT]))
def test_device_and_host_make_the_same(layout: Layout) -> None:
    assert difference_db(layout) < TOLERANCE_DB


@pytest.mark.parametrize("degrees", few([70.0, 120.0]))
def test_inner_corners(degrees: float) -> None:
    """Partners of their terms meet both faces, up to three times: a porous one and a curtain."""
    found, samples = inner_corner(np.radians(degrees)), 3072
    made = plan_render(found, RATE, duration=samples / RATE, convolve_static=False)
    engine = OpenclEngine(made)
    assert isinstance(engine.maker(0), NodeMaker)
    received = engine.render(0, samples)[0]
    exact = clsim.render(found, RATE, duration=samples / RATE, engine="reference", convolve_static=False).pressure[0]
    error_db = 20.0 * np.log10(np.linalg.norm(received - exact) / np.linalg.norm(exact))
    assert error_db < -90.0  # to which both engines hold responses


def inner_corner(angle: float) -> PathSet:
    """Make the paths over the edge between two tall panels that meet at an angle."""
    x, y = 2.0 * np.cos(angle), 2.0 * np.sin(angle)
    corners = [(a, b, z) for a, b in ((2.0, 0.0), (0.0, 0.0), (x, y)) for z in (-4.0, 4.0)]
    room = clsim.MeshRoom(corners, [(0, 2, 3), (0, 3, 1), (2, 4, 5), (2, 5, 3)], [POROUS, POROUS, CURTAIN, CURTAIN])
    sweep = clsim.Signal.chirp(34e3, 46e3, 0.016, RATE, window="tukey")
    way = clsim.Trajectory.line((0.5, 0.1, 0.0), (0.6, 0.15, 0.05), 0.02)
    ear = clsim.Trajectory.line((0.5, 0.2, 0.3), (0.45, 0.3, 0.3), 0.02)
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", sweep, way)], [clsim.Receiver("r", ear)])
    paths = clsim.find_paths(scene, 3, diffraction=1)
    family = paths.families[1]
    return PathSet(scene, (family.part(np.flatnonzero(family.vertex.n < 1.0)),))


MUTANTS = {
    "the other side of a boundary": ("side * rise * breadth", "-side * rise * breadth"),
    "phases of what is heard": ("2.0 * r_s * r_r / length * raised", "2.0 * r_s * r_r / length"),
    "continued as before the boundary": ("beyond.part[part][b] - r->part[part][b]", "r->part[part][b]"),
    "angle to the 0-face": ("HALF_TURN - together - odd,", "HALF_TURN + together - odd,"),
    "factor of the other face": ("(first + bounce) & 1", "(first + bounce + 1) & 1"),
    "the end's side": ("edge->end_side * (inside < 0.0 ? -root : root)", "edge->end_side * (inside > 0.0 ? -root : root)"),
    "the end without the edge": ("multiply(r, of_end);", ""),
    "polynomials of the angle": ("x * angle[m - 1] - angle[m - 2]", "x * angle[m - 1] + angle[m - 2]"),
    "the other side of a boundary, over an end": ("root < 0.0 ? -weight : weight", "weight"),
    "the end's detour": ("off * (off + 2.0 * along) / (near + far)", "off * (off - 2.0 * along) / (near + far)"),
    "Mach number at the source": ("rising * velocity.z - inward", "rising * velocity.z + inward"),
    "the receiver's speed": ("leaving * heading.z + outward", "leaving * heading.z - outward"),
    "direction at the receiver": ("times(-1.0, into_room(edge->receiver_turn", "times(1.0, into_room(edge->receiver_turn"),
    "direction at the source": ("into_room(edge->source_turn, towards_edge(from, place))", "towards_edge(from, place)"),
    "fades of the other time": ("gain[part] -= edge->share[part][side]", "gain[part] -= edge->share[part][1 - side]"),
    "fades without phases": ("factor.part[part][b] = gain[part]", "factor.part[part][b] = part ? 0.0f : gain[part]"),
    "fades by the receiver's clock": ("* s->block_time + late", "* s->block_time"),
    "the form of fades": ("x * (15.0f - 6.0f * x)", "x * (15.0f - 5.0f * x)"),
    "walls of the other side": ("wall < 0 ? a->arrival : a->departure", "a->departure"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.exhaustive
def test_mutants_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    mutants = Mutants("tracks", MUTANTS, optimised=True)
    mutants.play(monkeypatch)
    assert difference_db() < TOLERANCE_DB, "none of them is chosen"
    assert mutants.unseen(lambda: difference_db() < TOLERANCE_DB) == []
    assert difference_db() < TOLERANCE_DB, "none of them is chosen any more"


def test_the_last_echoes_of_a_pulse_are_held_as_well_as_the_pulse() -> None:
    """Paths over edges alone sound after a segment's end, softly: what is told of functions is told of all that sounds."""
    plaster = clsim.Material.from_reflection(0.6)
    walls = [
        clsim.MeshRoom([(4, a, 0), (4, b, 0), (4, b, 3), (4, a, 3)], [(0, 1, 2), (0, 2, 3)], plaster)
        for a, b in ((0.0, 4.0), (4.9, 6.0))
    ]
    room = clsim.MeshRoom.joined([clsim.Shoebox((8.0, 6.0, 3.0), plaster), *walls])
    pulse = clsim.Signal.chirp(20e3, 45e3, 5e-3, RATE, window="hann")
    beacon = clsim.Source("beacon", pulse, clsim.Trajectory.fixed((2.0, 4.9, 1.6)), start=0.06)
    tag = clsim.Receiver("tag", clsim.Trajectory.line((5.5, 3.0, 1.3), (5.5, 2.6, 1.3), 0.4))
    found = clsim.find_paths(clsim.Scene(room, clsim.Air(), [beacon], [tag]), 1, diffraction=1)
    made = plan_render(found, RATE, duration=0.15)
    engine = OpenclEngine(made)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        heard = engine.render(0, made.samples)[0]
        engine.warn()
    assert -140.0 < engine.residuals[0].level_db < made.source_filters[0].residual_db
    exact = clsim.render(found, RATE, duration=0.15, engine="reference").pressure[0].astype(np.float64)
    wrong, right = (np.sqrt(np.mean(x.reshape(-1, round(0.01 * RATE)) ** 2, axis=1)) for x in (heard - exact, exact))
    about = np.max([np.roll(right, shift) for shift in (-2, -1, 0, 1, 2)], axis=0)  # some 40 ms
    sounding = about > 1e-3 * right.max()
    assert 20.0 * np.log10((wrong[sounding] / about[sounding]).max()) < -85.0
