"""Nodes of paths by scatterers: the device's against those of the kind of paths itself, in float64 on the host."""

from functools import cache

import numpy as np
import pytest
from exhaustive import few
from made_responses import POROUS, OffCentre
from mutants import KeptEngines, Mutants

import clsim
from clsim.paths.path_set import PathSet
from clsim.render.opencl import nodes, path_columns
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT, Layout, OpenclEngine, Run
from clsim.render.opencl.host_nodes import HostNodeMaker
from clsim.render.opencl.nodes import NodeMaker
from clsim.render.plan import Plan
from clsim.render.planning import plan_render

pytestmark = [pytest.mark.usefixtures("device"), pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")]
RATE = 192e3
SAMPLES = 9216
# Gains of the device are taken from every fourth node where that is wrong by -100 dB of a path at most (`SMOOTH_SHARE`);
# paths add up as the root of the sum of squares. The host's are those of every node.
TOLERANCE_DB = -100.0
# Looked at at every node, there is left what is float32: gains on the device, and the table of phases along capsules.
EVERY_NODE_DB = -120.0
CURTAIN = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])
WINDY = clsim.Air(wind=(4.0, -3.0, 1.0))


def things(phased: bool) -> list[clsim.Scatterer]:
    """Return an ellipsoid that tumbles, a sphere and a point; with phases of their own a capsule and a sphere by its series, too."""
    times, angle = np.linspace(-0.1, 0.3, 7), np.linspace(0.0, 0.9, 7)[:, None]
    turned = np.concatenate([np.sin(angle) * np.array([0.36, 0.48, 0.8]), np.cos(angle)], axis=1)
    along = np.array([2.0, 1.5, 1.2]) + np.outer(times, [1.0, 0.5, -0.2])
    tumbling = clsim.Trajectory.waypoints(times, along, turned)
    swinging = clsim.Trajectory.sampled(
        lambda t: np.stack([1.6 + 0.2 * np.sin(9.0 * t), 2.2 + 0.0 * t, 1.0 + 0.1 * np.cos(7.0 * t)], 1), 0.3, 200.0
    )
    found = [
        clsim.Scatterer.ellipsoid("tumbling", (0.09, 0.3, 0.15), tumbling, shadow=False),
        clsim.Scatterer.sphere("swinging", 0.05, swinging, model="geometrical"),
        clsim.Scatterer.point("point", -20.0, clsim.Trajectory.line((1.0, 2.0, 1.5), (1.4, 1.7, 1.2), 0.3)),
    ]
    if phased:
        found += [
            clsim.Scatterer.capsule("stick", 0.03, 0.25, tumbling, shadow=False),
            clsim.Scatterer.sphere("ball", 0.04, swinging),
        ]
    return found


@cache
def paths(air: clsim.Air | None = None, phased: bool = False) -> PathSet:
    """Return paths by scatterers among walls, from a fast source to fast receivers, one of which has a fast clock."""
    sweep = clsim.Signal.chirp(34e3, 46e3, 0.06, RATE, window="tukey")
    way = clsim.Trajectory.line((0.5, 0.6, 0.9), (0.7, 0.9, 1.1), 0.1)
    ears = [clsim.Trajectory.line((2.8, 0.6, 1.3), (2.6, 0.9, 1.6), 0.1), clsim.Trajectory.fixed((0.6, 2.5, 0.8))]
    clocks = [clsim.Electronics(clock_ppm=300.0, clock_offset=2e-3), None]
    scene = clsim.Scene(
        clsim.Shoebox((3.2, 3.0, 2.4), [POROUS, CURTAIN, clsim.Material.from_reflection(-0.8), POROUS, CURTAIN, CURTAIN]),
        air or clsim.Air(),
        [clsim.Source("s", sweep, way, OffCentre(2e-3), aim=(1.0, 0.5, 0.1))],
        [clsim.Receiver(f"r{i}", ear, clsim.FirstOrder(0.4), aim=(-1.0, 0.1, 0.3), electronics=clock)
         for i, (ear, clock) in enumerate(zip(ears, clocks, strict=True))],
        scatterers=things(phased),
    )  # fmt: skip
    found = clsim.find_paths(scene, 1, scattering_order=1).families[-1]
    some = np.flatnonzero(
        (found.vertex.scatterer < 3) | (found.order == 1)
    )  # of what takes long on the host, direct legs alone
    return PathSet(scene, (found.part(some),))


@cache
def plan(of: PathSet, **options: str) -> Plan:
    """Return the plan, or that of all paths together, whose fields vary over frequency."""
    exact = {"convolve_static": False, "scattering_error_db": -90.0}
    made = plan_render(of, RATE, duration=SAMPLES / RATE, **exact, **options)
    return next((part.plan for part in made.allocation.scattered), made)


ENGINES = KeptEngines()


@pytest.fixture(autouse=True)
def _all_paths_in_equal_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take no few paths out of a batch: of nodes by the host none are."""
    monkeypatch.setattr(Run, "_divides", False)


def heard(of: PathSet, layout: Layout, maker: type, **options: str) -> np.ndarray:
    """Return the samples with nodes of a maker; not finite where the engine refuses the nodes."""
    key = of, layout, maker, nodes.SMOOTH_SHARE, *options.items()
    engine = ENGINES.engine(key, lambda: OpenclEngine(plan(of, **options), layout))
    assert type(engine.maker(0)) is maker
    try:
        with np.errstate(invalid="ignore"):  # of mutants
            return engine.render(0, SAMPLES)
    except clsim.ClsimError as error:
        assert "lie outside the bounds" in str(error) or "must be seen from both ends" in str(error)
        ENGINES.forget(key)
        return np.full((2, SAMPLES), np.inf)


@cache
def by_host(of: PathSet, **options: str) -> np.ndarray:
    with pytest.MonkeyPatch.context() as patched:
        patched.delitem(path_columns.COLUMNS, "scatterers")
        return heard(of, CPU_LAYOUT, HostNodeMaker, **options)


def difference_db(
    air: clsim.Air | None = None, phased: bool = False, layout: Layout = CPU_LAYOUT, **options: str
) -> float:
    """Return the error of the samples with nodes of the device, at the receiver where it is largest."""
    got, wanted = heard(paths(air, phased), layout, NodeMaker, **options), by_host(paths(air, phased), **options)
    if not np.all(np.isfinite(got)):
        return np.inf
    return float(20 * np.log10((np.linalg.norm(got - wanted, axis=1) / np.linalg.norm(wanted, axis=1)).max()))


CASES = {
    "still air": {},
    "phases": {"phased": True},
    "as on GPUs": {"layout": GPU_LAYOUT},
    "wind": {"air": WINDY, "phased": True, "amplitude": "convective"},
    "at reception": {"air": clsim.Air(dispersion=True), "motion": "quasi-static"},
}


@pytest.mark.parametrize("case", few(CASES))
def test_device_and_host_make_the_same(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert difference_db(**CASES[case]) < TOLERANCE_DB
    monkeypatch.setattr(nodes, "SMOOTH_SHARE", 0.0)
    assert difference_db(**CASES[case]) < EVERY_NODE_DB


def test_device_and_host_find_the_specular_points_of_poles() -> None:
    """160 times as long as thin: the place moves by metres where the unit vector u hardly turns."""
    pole = clsim.Scatterer.ellipsoid(
        "pole", (16.0, 0.2, 0.1), clsim.Trajectory.line((2.2, 2.2, 0.8), (2.3, 2.5, 0.8), 0.1), shadow=False
    )
    sweep = clsim.Signal.chirp(34e3, 46e3, 0.06, RATE, window="tukey")
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.0), clsim.Material.from_reflection(0.0)),
        clsim.Air(),
        [clsim.Source("s", sweep, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))],
        [clsim.Receiver(f"r{i}", clsim.Trajectory.line((3.0, 1.0 + i, 1.0), (3.0, 1.1, 1.0), 0.1)) for i in range(2)],
        scatterers=[pole],
    )
    found = PathSet(scene, clsim.find_paths(scene, 0, scattering_order=0).families[-1:])
    assert len(found) == 2
    got, wanted = heard(found, CPU_LAYOUT, NodeMaker), by_host(found)
    away = np.linalg.norm(got - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    assert 20.0 * np.log10(away.max()) < TOLERANCE_DB


def test_the_scene_has_all_that_such_paths_do() -> None:
    found = paths(phased=True).families[0]
    before, after = found.links(slice(None)).surfaces
    assert np.any(np.any(before >= 0, axis=1) & np.any(after >= 0, axis=1))
    assert set(np.unique(found.vertex.scatterer)) == {0, 1, 2, 3, 4}
    assert set(np.unique(found.receiver)) == {0, 1}


def test_what_is_between_the_ends_in_turns_has_a_way() -> None:
    """Near to a rim, ends as wind carries them to one place show another one, and from there the first."""
    found = paths(WINDY).families[0]
    rows = np.flatnonzero((found.vertex.scatterer == 0) & (found.receiver == 0))
    delay = found.arrivals(rows, np.array([0.0337, 0.03372, 0.03374])).delay
    assert np.abs(np.diff(delay, axis=1)).max() < 1e-6


MUTANTS = {
    "the later leg is as late as both": ("RETARDED ? time - b->onward : time", "RETARDED ? time - a->delay : time"),
    "the weight of the way to the receiver": ("(1.0 - coming) / (1.0 - leaving) * faster;", "(1.0 - coming) * (1.0 - leaving) * faster;"),
    "Mach number of the scatterer": ("later * (mach - coming)) / (1.0 - mach)", "later * (mach + coming)) / (1.0 + mach)"),
    "rate of the delay": ("coming - mach - leaving * (1.0 - mach)", "coming - mach - leaving * (1.0 + mach)"),
    "direction at the source": ("turned_back(seen->source_turn, 1, 0, leaving1)", "leaving1"),
    "direction at the receiver": ("turned_back(seen->receiver_turn, 1, 0, coming2)", "coming2"),
    "speed of what turns": ("scaled(o.z, p->turning[2])", "scaled(o.y, p->turning[2])"),
    "frame of what turns": ("b->receiver.y = DOT(r, p->axes[1])", "b->receiver.y = DOT(r, p->axes[2])"),
    "the third axis": ("across(out.axes[0], out.axes[1])", "across(out.axes[1], out.axes[0])"),
    "the specular point": ("(b.bend_both * b.slope_other - b.bend_other * b.slope_one)", "(b.bend_both * b.slope_one - b.bend_other * b.slope_one)"),
    "curvature": ("derivatives_at(g, u, (reals)1.0)", "derivatives_at(g, u, (reals)2.0)"),
    "along a capsule": ("clamped(at - (b.gz", "clamped(at + (b.gz"),
    "an end of a capsule": ("flatter + inward / OF_NODE(radius, lane)", "flatter + 2.0 * inward / OF_NODE(radius, lane)"),
    "phases along a capsule": ("t->waves[b] * (float)(-late)", "t->waves[b] * (float)(late)"),
    "angle at a sphere": ("s->cosine * legendre - n * last", "s->cosine * legendre - (n + 1) * last"),
    "distance from a sphere": ("step2 = s->receiver * step", "step2 = s->source * step"),
    "phase of a sphere": ("rint(late) - late", "late - rint(late)"),
    "strength of a sphere": ("return 0.5 * radius * OF_NODE(near1, lane)", "return 0.6 * radius * OF_NODE(near1, lane)"),
    "a sphere is a mirror": ("b->leaving = (leaving - coming) / (1.0 - coming)", "b->leaving = leaving"),
    "grazing incidence": ("OF_NODE(full, lane) * (1.0 - exp(-steep * steep * steep))", "OF_NODE(full, lane) * (1.0 - exp(-steep * steep))"),
    "strength of a point": ("double strength = seen->strength", "double strength = 2.0 * seen->strength"),
    "Doppler of the pressure": ("spread *= 1.0 - OF_NODE(b->leaving, lane)", "spread *= 1.0 + OF_NODE(b->leaving, lane)"),
    "lengths of both legs": ("squared1 * inverse1 * DOT(leaving1, direction1) * squared2", "squared1 * DOT(leaving1, direction1) * squared2"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.exhaustive
def test_mutants_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    mutants = Mutants("tracks", MUTANTS, optimised=True)
    mutants.play(monkeypatch)
    assert difference_db(phased=True) < TOLERANCE_DB, "none of them is chosen"
    assert mutants.unseen(lambda: difference_db(phased=True) < TOLERANCE_DB) == []
    assert difference_db(phased=True) < TOLERANCE_DB, "none of them is chosen any more"
