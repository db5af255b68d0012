"""Nodes of paths by bodies: the device's against those of the kind of paths itself, in float64 on the host."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from made_responses import POROUS, OffCentre
from mutants import KeptEngines, Mutants
from scipy.spatial.transform import Rotation

import clsim
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
AIRS = {"rests": clsim.Air(dispersion=True), "wind": clsim.Air(wind=(6.0, -4.0, 1.0))}
WAYS: list[tuple[str, dict[str, Any]]] = [
    ("rests", {}), ("rests", {"motion": "quasi-static"}), ("wind", {"motion": "quasi-static"}),
    ("wind", {"amplitude": "convective"}),
]  # fmt: skip


@cache
def paths(air: str) -> PathSet:
    """Return paths by a swinging door, a breathing chest and a static table, mixed with walls, while both ends move."""
    hinge = clsim.Trajectory.swing((1.0, 2.0, 0.0), (0, 0, 1), [0.0, 0.02, 0.1], [0.0, 0.06, 0.12])
    door = clsim.Body.box("door", (1.6, 0.0, 2.0), POROUS, hinge, centre=(0.85, 0.0, 1.1))
    breath = clsim.Trajectory.line((0.3, 1.0, 1.2), (0.33, 1.0, 1.2), 0.12)
    chest = clsim.Body.box("chest", (0.0, 1.4, 1.8), CURTAIN, breath)
    table = clsim.Body.box("table", (1.5, 1.1, 0.0), SOFT, clsim.Trajectory.fixed((2.0, 0.7, 0.4)))
    sweep = clsim.Signal.chirp(34e3, 46e3, 0.06, RATE, window="tukey")
    way = clsim.Trajectory.line((1.0, 0.7, 1.2), (1.3, 0.8, 1.1), 0.12)
    ear = clsim.Trajectory.line((3.0, 0.6, 1.3), (2.8, 0.7, 1.4), 0.12)
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), {"default": CURTAIN, "y_min": POROUS}), AIRS[air],
        [clsim.Source("s", sweep, way, OffCentre(2e-3), aim=(1.0, 0.6, 0.1))],
        [clsim.Receiver("r", ear, clsim.FirstOrder(0.4), aim=(-1.0, 0.5, 0.3),
                        electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=2e-3))],
        bodies=[door, chest, table],
    )  # fmt: skip
    return PathSet(scene, (clsim.find_paths(scene, 2).families[-1],))


@cache
def plan(way: int) -> Plan:
    air, options = WAYS[way]
    return plan_render(paths(air), RATE, duration=SAMPLES / RATE, convolve_static=False, **options)


@cache
def by_host(way: int) -> np.ndarray:
    with pytest.MonkeyPatch.context() as patched:
        patched.delitem(path_columns.COLUMNS, "bodies")
        engine = OpenclEngine(plan(way))
        assert isinstance(engine.maker(0), HostNodeMaker)
        return engine.render(0, SAMPLES)


ENGINES = KeptEngines()


def difference_db(way: int = 0, layout: Layout = CPU_LAYOUT) -> float:
    """Return the error of the samples with nodes of the device."""
    engine = ENGINES.engine((way, layout), lambda: OpenclEngine(plan(way), layout))
    assert isinstance(engine.maker(0), NodeMaker)
    try:
        got = engine.render(0, SAMPLES)
    except clsim.ClsimError as error:  # the engine itself found that delays are out of bounds
        assert "lie outside the bounds" in str(error)
        ENGINES.forget((way, layout))
        return np.inf
    wanted = by_host(way)
    return (
        float(20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted)))
        if np.all(np.isfinite(got))
        else np.inf
    )


def test_the_scene_has_all_that_such_paths_do() -> None:
    found = paths("rests").families[0]
    body = found.legs[0].surfaces - len(found.scene.room.faces)  # 0 and 1 move
    moving = (body == 0) | (body == 1)
    assert {0, 1, 2} <= set(body[body >= 0].tolist())
    assert np.any(moving.all(axis=1))
    assert not np.all(moving.any(axis=1))  # by the table and walls
    for first in (0, 1):  # walls at rest before and after what moves
        assert np.any(moving[:, first] & (found.legs[0].surfaces[:, 1 - first] >= 0) & ~moving[:, 1 - first])


@pytest.mark.parametrize(
    ("way", "layout"), few([*((way, CPU_LAYOUT) for way in (0, 2, 3)), (0, GPU_LAYOUT), (1, GPU_LAYOUT)])
)
def test_device_and_host_make_the_same(way: int, layout: Layout) -> None:
    assert difference_db(way, layout) < TOLERANCE_DB


def test_grazing_reflections_by_faces_that_turn_are_found() -> None:
    """Twenty plain rounds do not find them: the device took delays of 0 s, and refused to render."""
    times = np.linspace(0.0, 0.3, 9)
    turned = Rotation.from_rotvec(-3.64 * times[:, None] * np.array([-0.226, 0.884, 0.41]))
    pose = turned * Rotation.from_matrix([[0.974, -0.222, -0.035], [0.222, 0.929, 0.296], [-0.033, -0.296, 0.955]])
    way = clsim.Trajectory.waypoints(times, np.tile((3.064, 2.644, 1.577), (9, 1)), pose.as_quat())
    box = clsim.Body.box("b", (0.704, 0.495, 0.4), SOFT, way)
    tone = clsim.Signal.tone(40e3, 0.06, RATE)
    beside = clsim.Trajectory.fixed((0.816, -0.373, 0.244))  # turns with the box, 4 cm over the plane of its face
    ear = clsim.Trajectory.fixed((1.586, 2.917, 1.613))
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 3.0), SOFT), clsim.Air(), [clsim.Source("s", tone, beside, mounted_on="b")],
        [clsim.Receiver("r", ear)], bodies=[box],
    )  # fmt: skip
    found = clsim.find_paths(scene, 1).families[-1]
    row = np.flatnonzero(found.start > 0.0)
    assert len(row) == 1
    grazing = PathSet(scene, (found.part(row),))
    ways = {engine: clsim.render(grazing, RATE, duration=0.06, engine=engine) for engine in ("opencl", "reference")}
    got, wanted = ways["opencl"].samples, ways["reference"].samples
    assert np.linalg.norm(got - wanted) < 1e-5 * np.linalg.norm(wanted)


MUTANTS = {
    "mirrors at rest": ("const reals mach = m->speed * slowness, twice", "const reals mach = 0.0, twice"),
    "the speed's share of a height": ("- m->speed * time - m->offset", "- m->offset"),
    "what turns": ("(rise - DOT(turns, place))", "rise"),
    "where walls before are": ("- (normal.x * shift[0] + normal.y", "+ (normal.x * shift[0] + normal.y"),
    "pose at reception": ("(RETARDED ? now + event : now) - poses->first", "now - poses->first"),
    "the next mirror's place": ("mirror_at(path, poses, seen->mirror + k,", "mirror_at(path, poses, seen->mirror,"),
    "times of later images": ("late -= rise * mach * slowness", "late += rise * mach * slowness"),
    "rate without stretch": ("(beyond + receding - drift) * pace", "(beyond + receding - drift)"),
    "the receiver's speed": ("slowness * DOT(onwards, heading)", "-slowness * DOT(onwards, heading)"),
    "pressure without the mirrors' stretch": ("i < MACH_EXPONENT; i++) length /=", "i < MACH_EXPONENT - 1; i++) length /="),
    "the mirrors' share of directions": ("before = plus_scaled(leaving, -rise, m->normal)", "before = plus_scaled(leaving, rise, m->normal)"),
    "arrival for departure": ("triple_of(met->direction, lane), triple_of(met->direction + MIRRORS", "triple_of(met->direction + MIRRORS, lane), triple_of(met->direction + MIRRORS"),
    "angle at a mirror that moves": ("bounce & 1 ? triple_of(met->normal + before, lane) : of_wall", "of_wall"),
    "angle behind it": ("met->direction + before, lane);\n        __global", "met->direction, lane);\n        __global"),
    "angles left out": ("*fielded = by_mirrors(env, met, lane, s->slots, s->slot, field)", "*fielded = 0"),
    "one round": ("(changed >= EVENT_ERROR) | (changed != changed)", "changed != changed"),
}  # fmt: skip


@pytest.mark.exhaustive
def test_mutants_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    mutants = Mutants("tracks", MUTANTS)
    mutants.play(monkeypatch)
    assert difference_db() < TOLERANCE_DB, "none of them is chosen"
    assert mutants.unseen(lambda: difference_db() < TOLERANCE_DB) == []
    assert difference_db() < TOLERANCE_DB, "none of them is chosen any more"
