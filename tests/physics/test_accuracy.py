"""Accuracy against exact solutions that share no code with the engines."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import oracle
import pytest
from exhaustive import few

import clsim
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.plan import SEGMENT, Plan
from clsim.render.planning import plan_render

SIZE = np.array([6.0, 5.0, 4.0])
REFLECTION = 0.9
AIR = clsim.Air()
COMPARED = 1000  # samples at which the exact solution is worked out: it is slow
WINDOW = 1500  # samples that the reference engine renders: it is slow


def scene_of(signal: clsim.Signal, source: clsim.Trajectory, receiver: clsim.Trajectory, **options) -> clsim.Scene:
    return clsim.Scene(
        clsim.Shoebox(SIZE, clsim.Material.from_reflection(REFLECTION)), AIR,
        [clsim.Source("s", signal, source, **options)], [clsim.Receiver("r", receiver)],
    )  # fmt: skip


def moving_scene(rng: np.random.Generator, signal: clsim.Signal, speed: float = 10.0):
    source = oracle.Wobble.random(rng, [2.0, 2.5, 2.0], speed)
    receiver = oracle.Wobble.random(rng, [4.2, 2.4, 2.1], speed)
    end = signal.duration + 0.1
    return scene_of(signal, source.trajectory(end), receiver.trajectory(end)), source, receiver


def rendered(plan: Plan, first: int) -> tuple[np.ndarray, int]:
    """Return the samples of a plan's engine and the first index: all of them, or a window of the slow engine."""
    if plan.options.engine == "reference":
        return ReferenceEngine(plan).render(first, min(first + WINDOW, plan.samples))[0], first
    return OpenclEngine(plan).render(0, plan.samples)[0], 0


def error_db(
    plan: Plan, emitted: Callable, source: object, receiver: object, order: int, made, start: int, rng
) -> float:
    """Return the error of samples from `start` on against the exact solution at some of them."""
    some = np.sort(rng.choice(len(made), min(COMPARED, len(made)), replace=False))
    scene = plan.tracks.scene
    wanted = oracle.received(
        emitted, source, receiver, SIZE, order, (start + some) / plan.sampling_rate, speed_of_sound=AIR.speed_of_sound,
        absorption=AIR.absorption_at(scene.sources[0].signal.centre_frequency), reflection=REFLECTION,
    )  # fmt: skip
    return oracle.error_db(made[some], wanted)


def tone_and_formula(frequency: float, rate: float, fade: float, duration: float):
    signal = clsim.Signal.tone(frequency, duration, rate, fade=fade)
    return signal, lambda t: np.where(t >= 0, np.sin(2 * np.pi * frequency * t) * oracle.rise(t, fade), 0.0)


# Delays and tracks are what is tested here, so everything is taken at one frequency (responses="centre").
# Of the -85 dB, -90 is the filter's bound; tracks stay within -96, and 63 paths in float32 within -110 (measured).
@pytest.mark.parametrize(("rate", "duration"), few([(192e3, 0.2), (48e3, 0.4), (500e3, 0.1)]))
@pytest.mark.parametrize("share", [0.1, 0.42, 0.8])
def test_tones(engine: str, rng, rate: float, duration: float, share: float, measured: Any) -> None:
    signal, formula = tone_and_formula(share * rate / 2, rate, 0.01, 2 * duration)
    scene, source, receiver = moving_scene(rng, signal)
    plan = plan_render(clsim.find_paths(scene, 3), rate, responses="centre", engine=engine, duration=duration)
    made = rendered(plan, int(0.7 * plan.samples))
    error = error_db(plan, formula, source, receiver, 3, *made, rng)
    oracle = "images mirrored point after point, emission times by iteration"
    measured("accuracy at one frequency: tones", oracle, error, -85.0)


@pytest.mark.parametrize(("rate", "duration"), few([(192e3, 0.2), (48e3, 0.4), (500e3, 0.1)]))
def test_chirps(engine: str, rng, rate: float, duration: float, measured: Any) -> None:
    low, high, fade, length = 0.1 * rate / 2, 0.8 * rate / 2, 0.1 * duration, duration
    signal = clsim.Signal.chirp(low, high, length, rate, window="tukey")

    def formula(t: np.ndarray) -> np.ndarray:
        phase = 2 * np.pi * t * (low + 0.5 * (high - low) * t / length)
        return np.sin(phase) * oracle.rise(t, fade) * oracle.rise(length - t, fade)

    scene, source, receiver = moving_scene(rng, signal)
    plan = plan_render(clsim.find_paths(scene, 3), rate, responses="centre", engine=engine, duration=duration)
    made = rendered(plan, int(0.9 * plan.samples))
    measured(
        "accuracy at one frequency: chirps", "the same", error_db(plan, formula, source, receiver, 3, *made, rng), -85.0
    )


@pytest.mark.parametrize("begin", [1.0, 600.0])
def test_ten_minutes_later(engine: str, rng, begin: float, measured: Any) -> None:
    rate = 192e3
    signal, formula = tone_and_formula(0.8 * rate / 2, rate, 0.01, begin + 1.0)
    scene, source, receiver = moving_scene(rng, signal)
    options = {"responses": "centre", "engine": engine, "duration": begin + 0.5, "narrowband": False}
    plan = plan_render(clsim.find_paths(scene, 3), rate, **options)
    start = int(begin * rate) // SEGMENT * SEGMENT
    kind, length = (OpenclEngine, SEGMENT) if engine == "opencl" else (ReferenceEngine, WINDOW)
    made = kind(plan).render(start, start + length)[0]
    error = error_db(plan, formula, source, receiver, 3, made, start, rng)
    measured("accuracy at one frequency, late in a run", "the same", error, -85.0)


def test_lagrange_reaches_its_own_error(engine: str, rng) -> None:
    rate, frequency, order = 192e3, 40e3, 12
    signal, formula = tone_and_formula(frequency, rate, 0.01, 0.4)
    scene, source, receiver = moving_scene(rng, signal)
    paths = clsim.find_paths(scene, 3)
    plan = plan_render(
        paths, rate, responses="centre", engine=engine, duration=0.15, interpolator=clsim.Lagrange(order)
    )
    made = rendered(plan, int(0.1 * rate))
    # The interpolating polynomial through 13 samples of exp(-j w t), solved for as a linear system.
    fractions, nodes, w = np.linspace(-0.5, 0.5, 201), np.arange(order + 1.0) - order / 2, 2 * np.pi * frequency / rate
    powers = np.vander(fractions, order + 1, increasing=True)
    taps = np.linalg.solve(np.vander(nodes, increasing=True).T, powers.T)
    off = np.abs(np.exp(-1j * w * nodes) @ taps - np.exp(-1j * w * fractions))
    # Its remainder is at most w^13 / 13! prod |t - t_k|.
    remainder = w ** (order + 1) / math.factorial(order + 1) * np.abs(np.prod(fractions[:, None] - nodes, axis=1))
    assert np.all(off <= remainder + 1e-12)
    # Fractions of 63 moving paths are spread evenly: the mean square over a sample, within 1 dB for their number.
    assert abs(error_db(plan, formula, source, receiver, 3, *made, rng) - 10 * np.log10(np.mean(off**2))) < 1.0


def test_fly_by(engine: str, rng, measured: Any) -> None:
    rate = 192e3
    signal, formula = tone_and_formula(40e3, rate, 0.01, 0.2)
    line = clsim.Trajectory.line((2, 2.5, 2), (4, 2.5, 2), 0.2)  # 10 m/s
    fixed = clsim.Trajectory.fixed((3.0, 2.6, 2.0))  # 0.1 m beside it, passed at 0.1 s
    scene = scene_of(signal, line, fixed)
    plan = plan_render(clsim.find_paths(scene, 1), rate, responses="centre", engine=engine, duration=0.12)
    whole, start = rendered(plan, int(0.1 * rate) - WINDOW // 2)
    close = slice(int(0.09 * rate) - start, int(0.11 * rate) - start) if engine == "opencl" else slice(None)
    error = error_db(plan, formula, line, fixed, 1, whole[close], start + (close.start or 0), rng)
    measured("fly-by at 0.1 m and 10 m/s", "the same", error, -80.0)


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")  # a tone that begins at once
@pytest.mark.parametrize("start", [0.0, 0.0123])
def test_silent_before_the_first_arrival(engine: str, start: float) -> None:
    rate = 192e3
    line = clsim.Trajectory.line((1, 2, 2), (1.5, 2, 2), 0.07)
    scene = scene_of(clsim.Signal.tone(40e3, 0.05, rate), line, clsim.Trajectory.fixed((5, 2, 2)), start=start)
    paths = clsim.find_paths(scene, 2)
    reach = plan_render(paths, rate, engine=engine).source_filters[0].half_length
    pressure = clsim.render(paths, rate, engine=engine, duration=0.03).pressure[0]
    arrival = int((start + (4.0 - start * 0.5 / 0.07) / AIR.speed_of_sound) * rate)
    assert reach < 200
    assert not np.any(pressure[: arrival - reach])
    assert np.abs(pressure[arrival + 1 : arrival + 6]).max() > 0.05  # 1 / 4 m less the air's 5 dB, within a period
