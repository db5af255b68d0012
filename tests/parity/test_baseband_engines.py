"""The OpenCL engine for complex envelopes against the reference engine, and kernels with one thing wrong."""

import dataclasses
import sys

import numpy as np
import pytest
from mutants import Mutants

import clsim
from clsim.opencl import device as device_module
from clsim.opencl import launch as compiler_module
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl import engine as opencl_module
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import GPU_LAYOUT
from clsim.render.plan import Plan
from clsim.render.planning import plan_render

pytestmark = pytest.mark.usefixtures("device")
RATE, BAND = 192e3, (40e3, 4.8e3)
SAMPLES = 1800  # of the envelope, at 6 kHz
# Phases in float32 and block polynomials within -96 dB of the strongest path: measured -108 dB and better.
TOLERANCE_DB = -100.0


def pulses() -> clsim.Signal:
    return clsim.Signal.pulses(clsim.Signal.chirp(39.8e3, 40.2e3, 0.012, RATE, window="hann"), 0.06, 5)


def plan(order: int = 2, signal: clsim.Signal | None = None, **options) -> Plan:
    """Return the plan of a scene in which all moves, walls depend on frequency and a clock is fast."""

    def trajectory(centre: np.ndarray, phase: float) -> clsim.Trajectory:
        def place(t: np.ndarray) -> np.ndarray:
            return centre + 0.3 * np.sin(2 * np.pi * np.array([2.0, 1.7, 1.3]) * t[:, None] + phase)

        return clsim.Trajectory.sampled(place, 0.5, 500.0)

    walls = [clsim.Material.from_reflection(f) for f in (0.9, -0.8, 0.7, 0.6, -0.5, 0.8)]
    walls[0] = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])
    signal = signal or clsim.Signal.chirp(39.3e3, 40.7e3, 0.3, RATE, window="tukey")
    scene = clsim.Scene(
        clsim.Shoebox((6, 5, 4), walls), clsim.Air(),
        [clsim.Source("s", signal, trajectory(np.array([2.0, 2.5, 2.0]), 0.3), clsim.Piston(0.004), aim=(1, 0.3, -0.2), start=1.234e-3)],
        [clsim.Receiver("r", trajectory(np.array([4.2, 2.4, 2.1]), 1.9), clsim.FirstOrder(0.4), aim=(-0.8, 0.1, 0.4), electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=2e-3))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, order)
    if options.pop("partly", False):
        k = np.arange(len(paths))
        start, end = np.where(k % 3 == 1, 0.04 + 7.3e-3 * k, -np.inf), np.where(k % 3 == 2, 0.06 + 8.7e-3 * k, np.inf)
        images = dataclasses.replace(paths.families[0], start=start, end=end)
        paths = dataclasses.replace(paths, families=(images,))
    return plan_render(
        paths, RATE, **{"duration": SAMPLES / 6e3, "response_error_db": -110.0, "baseband": BAND} | options
    )


def apart_db(got: np.ndarray, wanted: np.ndarray) -> float:
    if not np.all(np.isfinite(got)):
        return np.inf
    return float(20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted) + 1e-15))


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan()


@pytest.fixture(scope="module")
def wanted(made: Plan, once) -> np.ndarray:
    return np.asarray(once("baseband engines", lambda: ReferenceEngine(made).render(0, made.samples)))


def test_engines_agree(made: Plan, wanted: np.ndarray) -> None:
    assert len(made.source_filters[0].basis) > 1
    assert apart_db(BasebandEngine(made).render(0, made.samples), wanted) < TOLERANCE_DB


def test_a_beacon_is_held_as_asked_without_a_warning() -> None:
    tone = clsim.Signal.tone(40e3, 0.3, RATE, fade=0.1)
    beacon = plan(1, tone, response_error_db=-80.0)
    got = clsim.render(beacon.tracks.paths, RATE, baseband=BAND, duration=SAMPLES / 6e3)
    assert apart_db(got.samples, ReferenceEngine(beacon).render(0, SAMPLES)) < -80.0


def test_gains_that_change_fast_give_the_same(made: Plan, wanted: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Functions of frequency of such paths are not joined; here no path's are."""
    original, joined = compiler_module.kernel_source, "here * here > JOINED_ABOVE"

    def source(program: str) -> str:
        text = original(program)
        assert program != "baseband" or joined in text
        return text.replace(joined, "here * here > 1e38f")

    monkeypatch.setattr(sys.modules[Plan.__module__], "SLOW_CHANGE", 1.0)  # few terms, however quick the motion
    together = BasebandEngine(made).render(0, made.samples)
    monkeypatch.setattr(compiler_module, "kernel_source", source)
    apart = BasebandEngine(made).render(0, made.samples)
    assert apart_db(apart, wanted) < TOLERANCE_DB
    assert not np.array_equal(apart, together)


def test_layout_for_gpus_gives_the_same(made: Plan, wanted: np.ndarray) -> None:
    assert apart_db(BasebandEngine(made, GPU_LAYOUT).render(0, made.samples), wanted) < TOLERANCE_DB


def test_host_tracks_give_the_same(made: Plan, wanted: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    found = device_module.find_device

    def without_float64(wanted_device):
        info, handle = found(wanted_device)
        return dataclasses.replace(info, fp64=False), handle

    monkeypatch.setattr(opencl_module, "find_device", without_float64)
    assert apart_db(BasebandEngine(made).render(0, made.samples), wanted) < TOLERANCE_DB


@pytest.mark.parametrize("chunk", [1, 3000])
def test_chunks_change_nothing(engine: str, chunk: int) -> None:
    whole, parts = (
        clsim.render(p.tracks.paths, RATE, baseband=BAND, engine=engine, duration=0.49, chunk=c).samples
        for p, c in [(plan(1), n) for n in (10**9, chunk)]
    )
    assert apart_db(parts, whole) < -120.0


def test_silence_changes_nothing() -> None:
    train = plan(signal=pulses())
    engine = BasebandEngine(train)
    sparse = engine.render(0, train.samples)
    engine.skips_silence = False
    assert np.array_equal(sparse, engine.render(0, train.samples))
    assert apart_db(sparse, ReferenceEngine(train).render(0, train.samples)) < TOLERANCE_DB


@pytest.mark.parametrize("transition", [5e-3, 0.0])
@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.filterwarnings("ignore:transition")
def test_paths_that_begin_and_end(transition: float, sparse: bool) -> None:
    edges = plan(partly=True, transition=transition, signal=pulses() if sparse else None)
    got, exact = (e(edges).render(0, edges.samples) for e in (BasebandEngine, ReferenceEngine))
    assert apart_db(got, exact) < TOLERANCE_DB + 3.0  # fewer paths at a time, errors relative to the strongest


MUTANTS = {
    "carrier's sign": ("baseband", "b * cosine - a * sine", "b * cosine + a * sine"),
    "real part's sign": ("baseband", "a * cosine + b * sine", "a * cosine - b * sine"),
    "whole turns": ("baseband", "(float)(int)((ulong)(long)whole * turn_per_sample >> 32) * 4.65661287e-10f", "0.0f"),
    "samples from the block's middle": ("baseband", "(delay + p) + nearest(moved)", "(delay + p)"),
    "rest of the delay": ("baseband", "d[0] -= rounded(moved)", "d[0] -= 0.0f"),
    "gain's even part": ("tracks", "0.125f * (s3 - s1)", "0.125f * (s1 - s3)"),
    "gain's odd part": ("tracks", "d3 * (1.0f / 24.0f) - 0.125f * d1", "d3 * (1.0f / 24.0f) - 0.225f * d1"),
    "turn of a delay off by one": ("baseband", "(ulong)(long)whole *", "(ulong)(long)(whole + 1) *"),
    "imaginary rows": ("baseband", "x + ((q) + COUNT(0)) * (long)stride", "x + (q) * (long)stride"),
    "rows of other functions": ("baseband", "(2 * ROWS_BEFORE(k) + (q))", "(2 * ROWS_BEFORE(k) + (q) / 2)"),
    "imaginary rows of other functions": ("baseband", "COUNT(k) + (q)", "(q)"),
    "gain of other functions": ("baseband", "r0 = here * inverse", "r0 = here"),
    "parity of half turns": ("baseband", "(nearest(x) & 1) << 31", "(nearest(x) & 2) << 30"),
    "last term of the cosine": ("baseband", "(-1.331880173f + s * 0.2196968188f)", "(-1.331880173f)"),
    "last term of the sine": ("baseband", "(-0.5980451734f + s * 0.07722012749f)", "(-0.5980451734f)"),
    "a sample late": ("baseband", "branches + lead + at", "branches + lead + at - 1"),
    "a branch skipped": ("baseband", "q = COUNT(0) - 2; q >= 0", "q = COUNT(0) - 2; q >= 1"),
    "gain's slope": ("baseband", "gain = paths->gain[0][1][p] * t", "gain = -paths->gain[0][1][p] * t"),
    "place in the block": ("baseband", "((float)inside + 0.5f", "((float)at + 0.5f"),
    "another block's row": ("baseband", "row = first_block + block;", "row = first_block;"),
    "first path's rest for all": ("baseband", "mu = mu * t + paths->delay[i][p];\n#pragma unroll", "mu = mu * t + paths->delay[i][0];\n#pragma unroll"),
    "first group's sum alone": ("baseband", "real_sum[g - first] += real", "real_sum[0] += real"),
    "parts of a stream": ("branches", "part * stream", "(1 - part) * stream"),
    "rows of a part": ("branches", "part * count", "(1 - part) * count"),
    "septic's centre": ("tracks", "13.0 * s3 - 162.0 * t1", "13.0 * s3 + 162.0 * t1"),
    "septic's slope": ("tracks", "5.0 * d3 - 162.0 * u1", "5.0 * d3 + 162.0 * u1"),
    "septic's cubic term": ("tracks", "19.0 / 1152.0 * u3", "19.0 / 1052.0 * u3"),
    "septic's fourth term": ("tracks", "11.0 / 384.0 * t3", "11.0 / 284.0 * t3"),
    "whole samples from the start": ("tracks", "return (int)(whole + more)", "return (int)whole"),
}  # fmt: skip


@pytest.mark.parametrize("program", sorted({program for program, _, _ in MUTANTS.values()}))
def test_mutants_are_caught(program: str, made: Plan, wanted: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        sys.modules[Plan.__module__], "SLOW_CHANGE", 1.0
    )  # few terms in long blocks, however quick the motion
    mutants = Mutants(program, {name: (old, new) for name, (of, old, new) in MUTANTS.items() if of == program})
    mutants.play(monkeypatch)
    engine = BasebandEngine(made)

    def found_db() -> float:
        return apart_db(engine.render(0, made.samples), wanted)

    assert found_db() < TOLERANCE_DB, "none of them is chosen"
    found = {name: found_db() for name in mutants}
    assert found_db() < TOLERANCE_DB, "none of them is chosen any more"
    assert {name: db for name, db in found.items() if not db > TOLERANCE_DB + 6.0} == {}
