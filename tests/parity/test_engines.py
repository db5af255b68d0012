"""The OpenCL engine against the reference engine, feature by feature."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from made_responses import POROUS, ROUGH, Lopsided, OffCentre
from mutants import Mutants

import clsim
from clsim.opencl import device as device_module
from clsim.paths.chain import Chain
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl import engine as opencl_module
from clsim.render.opencl.block_polynomials import Residual
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT, OpenclEngine
from clsim.render.opencl.host_nodes import PairNodeMaker
from clsim.render.plan import SEGMENT, Plan
from clsim.render.planning import plan_render

pytestmark = pytest.mark.usefixtures("device")
RATE = 192e3
TONE = clsim.Signal.tone(40e3, 0.2, RATE, fade=0.005)
SPIN = np.array([[0.0, 0.0, np.sin(a / 2), np.cos(a / 2)] for a in np.linspace(0.0, 4.0, 9)])
TURNING = clsim.Trajectory.waypoints(
    np.linspace(0.0, 0.4, 9), np.linspace([2.0, 2.0, 1.0], [3.0, 2.5, 1.2], 9), orientations=SPIN
)
# float32 sums of 63 paths, and tracks within -96 dB of the strongest path: measured -112 dB.
TOLERANCE_DB = -100.0


def scene(source_beam=None, receiver_beam=None, signal: clsim.Signal = TONE, start: float = 0.0) -> clsim.Scene:
    omni = clsim.Omni()
    walls = {"default": clsim.Material.from_reflection(0.9), "x_min": clsim.Material.from_reflection(-0.6)}
    receiver = clsim.Trajectory.circle((4.5, 2.5, 1.5), 0.5, 0.5, 0.5)
    return clsim.Scene(
        clsim.Shoebox((6, 5, 3), walls), clsim.Air(),
        [clsim.Source("s", signal, TURNING, source_beam or omni, start=start)],
        [clsim.Receiver("r", receiver, receiver_beam or omni, aim=(-1, 0.2, 0))],
    )  # fmt: skip


def plan(world: clsim.Scene, order: int = 3, **options) -> Plan:
    return plan_render(
        clsim.find_paths(world, order), RATE, duration=options.pop("duration", 0.08), responses="centre", **options,
    )  # fmt: skip


def pressure(made: Plan, **options) -> np.ndarray:
    return OpenclEngine(made, **options).render(0, made.samples)


def difference_db(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted) + 1e-15))


def windows(pressure: Callable[[int, int], np.ndarray]) -> np.ndarray:
    """Return the windows that are compared, of the slow engine too: at the first arrivals, and once all paths are active."""
    return np.concatenate([pressure(first, last) for first, last in ((3600, 4800), (14_080, 15_360))], axis=1)


CASES = {
    "plain": (scene(), {}),
    "beams": (scene(clsim.Piston(0.006), clsim.FirstOrder(0.4)), {}),
    "quasi-static": (scene(clsim.Piston(0.006)), {"motion": "quasi-static"}),
    "static amplitude": (scene(), {"amplitude": "static"}),
    "convective amplitude": (scene(), {"amplitude": "convective"}),
    "lagrange": (scene(), {"interpolator": clsim.Lagrange(12)}),
    "odd lagrange": (scene(), {"interpolator": clsim.Lagrange(5)}),
    "truncated": (scene(), {"interpolator": clsim.TruncatedLagrange(20, 11)}),
    "late start": (scene(start=0.0123456), {}),
    "another rate": (scene(signal=clsim.Signal.tone(40e3, 0.2, 250e3, fade=0.005)), {}),
}


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")
@pytest.mark.parametrize("case", CASES)
def test_engines_agree(case: str, measured) -> None:
    world, options = CASES[case]
    # Groups hold on to a whole delay a little beyond mu = 1/2, where Lagrange errs more; by less than its own error.
    tolerance = -60.0 if "lagrange" in case or case == "truncated" else TOLERANCE_DB
    made = plan(world, **options)
    heard, wanted = pressure(made), windows(ReferenceEngine(made).render)
    assert np.abs(wanted[:, :1200]).max() > 0.1 * np.abs(wanted).max()
    found = difference_db(windows(lambda first, last: heard[:, first:last]), wanted)
    kind = "Lagrange filters" if tolerance > TOLERANCE_DB else "delay filters"
    measured(f"OpenCL engine, {kind}", "reference engine", found, tolerance)


@pytest.mark.slow
def test_layout_for_gpus_gives_the_same() -> None:
    made = plan(scene(), order=1, duration=0.02)
    assert difference_db(pressure(made, layout=GPU_LAYOUT), pressure(made)) < -120.0


@pytest.fixture
def without_float64(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return a function after which the device reports that it has no float64."""
    found = device_module.find_device

    def hidden(wanted):
        info, handle = found(wanted)
        return dataclasses.replace(info, fp64=False), handle

    return lambda: monkeypatch.setattr(opencl_module, "find_device", hidden)


def far_off() -> tuple[Plan, int]:
    """Return a plan of ends that move in a hall of 100 m, with clocks, and where in it something sounds: after 10 minutes."""
    sweep = clsim.Signal.chirp(70e3, 80e3, 0.5, RATE, window="tukey")
    way = clsim.Trajectory.circle((50.0, 40.0, 10.0), 20.0, 20.0, 700.0)
    clock = clsim.Electronics(clock_ppm=80.0, clock_offset=1e-4)
    ears = [
        clsim.Receiver("r", clsim.Trajectory.line((20, 20, 3), (90, 60, 20), 700.0)),
        clsim.Receiver("q", clsim.Trajectory.fixed((20, 20, 3)), electronics=clock),
    ]
    room = clsim.Shoebox((100, 80, 30), clsim.Material.from_reflection(0.9))
    world = clsim.Scene(room, clsim.Air(), [clsim.Source("s", sweep, way, start=600.0)], ears)
    return plan(world, order=2, duration=601.0), 6251 * SEGMENT


def beams() -> tuple[Plan, int]:
    """Return a plan of beams that turn, towards a receiver that moves."""
    return plan(scene(clsim.Piston(0.006), clsim.FirstOrder(0.4)), order=2), 0


def pulses() -> tuple[Plan, int]:
    """Return a plan with silence, receivers at rest, and paths that come and go."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, 1e-3, RATE, window="hann"), 0.04, 3)
    way = clsim.Trajectory.line((2.0, 2.0, 1.0), (2.4, 2.3, 1.1), 0.2)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    curtain = clsim.Material.from_absorption([20e3, 40e3, 60e3], [0.1, 0.4, 0.5])
    paths = clsim.find_paths(
        clsim.Scene(clsim.Shoebox((6, 5, 3), curtain), clsim.Air(), [clsim.Source("s", pulse, way)], [ear]), 3
    )
    k = np.arange(len(paths))
    start, end = np.where(k % 3 == 1, 0.05, -np.inf), np.where(k % 3 == 2, 0.07, np.inf)
    some = dataclasses.replace(paths.families[0], start=start, end=end)
    return plan_render(dataclasses.replace(paths, families=(some,)), RATE, duration=0.12), 0


# Delays of 0.5 s within 2^-45, gains and slopes in float32: measured -120 dB and better.
@pytest.mark.parametrize(("make", "layout"), [(far_off, CPU_LAYOUT), (beams, CPU_LAYOUT), (pulses, GPU_LAYOUT)])
def test_pairs_of_floats_do_for_float64(make: Callable, layout, without_float64: Callable) -> None:
    made, first = make()
    last = min(first + 2 * SEGMENT, made.samples)
    wanted = OpenclEngine(made, layout).render(first, last)
    without_float64()
    engine = OpenclEngine(made, layout)
    got = engine.render(first, last)
    assert [type(maker) for maker in engine._makers.values()] == [PairNodeMaker]
    assert difference_db(got, wanted) < -112.0


MUTANTS = {
    "products": ("fma(a.x, b.x, -whole) + ", ""),
    "sums": ("((a.x - (whole - other)) + (b.x - other)) + ", ""),
    "roots": ("rest / (near + near)", "0.0f"),
    "motion": ("rest[i]", "0.0f"),
}


def test_what_floats_leave_is_needed(without_float64, monkeypatch: pytest.MonkeyPatch) -> None:
    made, first = far_off()
    wanted = OpenclEngine(made).render(first, first + SEGMENT)
    without_float64()
    mutants = Mutants("pair_tracks", MUTANTS)
    mutants.play(monkeypatch)
    engine = OpenclEngine(made)

    def found_db() -> float:
        return difference_db(engine.render(first, first + SEGMENT), wanted)

    assert found_db() < -112.0, "none of them is chosen"
    found = {name: found_db() for name in mutants}
    assert {name: db for name, db in found.items() if not db > -112.0} == {}
    assert found.keys() == MUTANTS.keys()
    assert found_db() < -112.0, "none of them is chosen any more"


def test_host_tracks_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    made = plan(scene(clsim.Piston(0.006), clsim.FirstOrder(0.4)), order=1, duration=0.03)
    on_device = pressure(made)
    monkeypatch.setattr(Chain, "device", None)  # as for kinds that no device knows
    assert difference_db(pressure(made), on_device) < TOLERANCE_DB


@pytest.mark.slow
def test_host_tracks_carry_phases(monkeypatch: pytest.MonkeyPatch) -> None:
    chirp = clsim.Signal.chirp(36e3, 44e3, 0.03, RATE, window="hann")
    source = clsim.Source("s", chirp, TURNING, Lopsided())
    ears = [
        clsim.Receiver("r", clsim.Trajectory.circle((4.5, 2.5, 1.5), 0.5, 0.5, 0.5), OffCentre(2e-3), aim=(-1, 0.2, 0))
    ]
    world = clsim.Scene(clsim.Shoebox((6, 5, 3), [POROUS, ROUGH] * 3), clsim.Air(), [source], ears)
    made = plan_render(clsim.find_paths(world, 2), RATE, duration=0.06)
    on_device = pressure(made)
    monkeypatch.setattr(Chain, "device", None)  # as for kinds that no device knows
    assert difference_db(pressure(made), on_device) < TOLERANCE_DB


def test_responses_that_nothing_holds_are_told() -> None:
    chirp = clsim.Signal.chirp(36e3, 44e3, 0.03, RATE, window="hann")
    world = scene(clsim.Piston(0.006), signal=chirp)
    made = plan_render(clsim.find_paths(world, 1), RATE, duration=0.02)
    engine = OpenclEngine(made)
    engine.render(0, made.samples)
    engine.warn()  # says nothing: warnings are errors
    late = made.samples // made.segment + 5  # nothing else sounds about it
    engine.residuals[0].add(late, np.array([0]), np.array([1e-6, 1.0]).reshape(2, 1, 1))
    with pytest.warns(
        clsim.ClsimWarning, match=r"source 0: air, walls and directivities are approximated to -60.0 dB, not the -90 dB"
    ):
        engine.warn()


def test_what_nothing_holds_is_told_of_all_paths_beside_what_sounds_about_it() -> None:
    ears = np.array([2, 0])
    last_echoes = {7: [[1e-9, 0.0], [1e-3, 1.0]], 8: [[4e-9, 1e-9], [2e-3, 2.0]], 9: [[1e-9, 0.0], [1e-2, 1.0]]}
    at_once, by_and_by, alone = Residual(3), Residual(3), Residual(3)
    for segment, squares in last_echoes.items():
        for some in (at_once, by_and_by):
            some.add(segment, ears, np.array(squares)[:, None])
        at_once.add(segment, ears, np.array([[1e-9, 0.0], [1e-3, 0.0]])[:, None])  # other kinds of paths
        by_and_by.add(segment, ears, np.array([[1e-9, 0.0], [1e-3, 0.0]])[:, None])
        by_and_by.settle(segment)
    alone.add(8, ears, np.array(last_echoes[8])[:, None])
    # Of receiver 2, in segment 7 beside 8: 2e-9 of 3e-3; in 8 and 9 beside 9: 5e-9 of 1.1e-2 and less.
    assert at_once.level_db == pytest.approx(10.0 * np.log10(2e-9 / 3e-3))
    assert by_and_by.level_db == at_once.level_db
    assert alone.level_db == pytest.approx(10.0 * np.log10(4e-9 / 2e-3))


@pytest.mark.parametrize("chunk", [1, SEGMENT + 1, 50_001])
def test_chunks_change_nothing(chunk: int, measured) -> None:
    world = scene(clsim.Piston(0.006), clsim.FirstOrder(0.4))
    paths = clsim.find_paths(world, 3)
    whole = clsim.render(paths, RATE, duration=0.4, chunk=10**9).pressure
    parts = clsim.render(paths, RATE, duration=0.4, chunk=chunk).pressure
    measured("chunks change nothing", "one chunk", difference_db(parts, whole), -120.0)
