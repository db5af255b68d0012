"""Accuracy against exact solutions that share no code with the engines."""

import numpy as np
import oracle
import pytest

import clsim
from clsim.render.opencl import OpenclEngine
from clsim.render.plan import SEGMENT, plan_render
from clsim.render.reference import ReferenceEngine

SIZE = np.array([6.0, 5.0, 4.0])
REFLECTION = 0.9
AIR = clsim.Air()


def moving_scene(rng: np.random.Generator, signal: clsim.Signal, speed: float = 10.0, end: float = 2.0):
    source = oracle.Wobble.random(rng, [2.0, 2.5, 2.0], speed)
    receiver = oracle.Wobble.random(rng, [4.2, 2.4, 2.1], speed)
    scene = clsim.Scene(
        clsim.Shoebox(SIZE, clsim.Material.from_reflection(REFLECTION)),
        AIR,
        [clsim.Source("s", signal, source.trajectory(end))],
        [clsim.Receiver("r", receiver.trajectory(end))],
    )
    return scene, source, receiver


def sample(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return the samples at which the exact solution is worked out: it is slow."""
    return np.sort(rng.choice(count, 2500, replace=False))


def exact(emitted, scene, source, receiver, order, times):
    return oracle.received(
        emitted, source, receiver, SIZE, order, times, speed_of_sound=AIR.sound_speed,
        absorption=AIR.absorption(scene.sources[0].signal.centre_frequency), reflection=REFLECTION,
    )  # fmt: skip


def tone_and_formula(frequency: float, rate: float, fade: float, duration: float):
    signal = clsim.Signal.tone(frequency, duration, rate, fade=fade)
    return signal, lambda t: np.where(t >= 0, np.sin(2 * np.pi * frequency * t) * oracle.rise(t, fade), 0.0)


@pytest.mark.parametrize(("rate", "duration"), [(48e3, 0.4), (192e3, 0.2), (500e3, 0.1)])
@pytest.mark.parametrize("share", [0.1, 0.42, 0.8])
def test_tones(engine: str, rng, rate: float, duration: float, share: float) -> None:
    if engine == "reference":
        duration = 12_000 / rate
    frequency = share * rate / 2
    signal, formula = tone_and_formula(frequency, rate, 0.01, 2 * duration)
    scene, source, receiver = moving_scene(rng, signal)
    pressure = clsim.render(scene, clsim.find_paths(scene, 3), rate, engine=engine, duration=duration).pressure[0]
    some = sample(rng, len(pressure))
    wanted = exact(formula, scene, source, receiver, 3, some / rate)
    assert oracle.error_db(pressure[some], wanted) < -85.0


@pytest.mark.parametrize(("rate", "duration"), [(48e3, 0.4), (192e3, 0.2), (500e3, 0.1)])
def test_chirps(engine: str, rng, rate: float, duration: float) -> None:
    if engine == "reference":
        duration = 12_000 / rate
    low, high, length, fade = 0.1 * rate / 2, 0.8 * rate / 2, 2 * duration, 0.2 * duration
    signal = clsim.Signal.chirp(low, high, length, rate, window="tukey")

    def formula(t: np.ndarray) -> np.ndarray:
        phase = 2 * np.pi * t * (low + 0.5 * (high - low) * t / length)
        return np.where(t >= 0, np.sin(phase) * oracle.rise(t, fade), 0.0)

    scene, source, receiver = moving_scene(rng, signal)
    pressure = clsim.render(scene, clsim.find_paths(scene, 3), rate, engine=engine, duration=duration).pressure[0]
    some = sample(rng, len(pressure))
    wanted = exact(formula, scene, source, receiver, 3, some / rate)
    assert oracle.error_db(pressure[some], wanted) < -85.0


def test_ten_minutes_later(engine: str, rng) -> None:
    rate = 192e3
    signal, formula = tone_and_formula(0.8 * rate / 2, rate, 0.01, 601.0)
    scene, source, receiver = moving_scene(rng, signal, end=602.0)
    plan = plan_render(scene, clsim.find_paths(scene, 3), rate, engine=engine, duration=600.5)
    start = int(600.0 * rate) // SEGMENT * SEGMENT
    stop = start + (SEGMENT if engine == "opencl" else 4096)
    made = (OpenclEngine if engine == "opencl" else ReferenceEngine)(plan).render(start, stop)[0]
    some = sample(rng, stop - start)
    wanted = exact(formula, scene, source, receiver, 3, (start + some) / rate)
    assert oracle.error_db(made[some], wanted) < -85.0


def test_lagrange_reaches_its_own_error(engine: str, rng) -> None:
    rate, frequency = 192e3, 40e3
    signal, formula = tone_and_formula(frequency, rate, 0.01, 0.4)
    scene, source, receiver = moving_scene(rng, signal, speed=1.0)
    duration = 0.1 if engine == "opencl" else 0.08
    pressure = clsim.render(
        scene, clsim.find_paths(scene, 3), rate, engine=engine, duration=duration, interpolator=clsim.Lagrange(12)
    ).pressure[0]
    some = sample(rng, len(pressure))
    wanted = exact(formula, scene, source, receiver, 3, some / rate)
    # Error of the closed form at this frequency for delays spread evenly over a sample: solved as a linear system.
    fractions = np.linspace(-0.5, 0.5, 201)
    nodes = np.arange(13.0) - 6.0
    taps = np.linalg.solve(np.vander(nodes, increasing=True).T, np.vander(fractions, 13, increasing=True).T)
    w = 2 * np.pi * frequency / rate
    off = np.abs(np.exp(-1j * w * nodes) @ taps - np.exp(-1j * w * fractions))
    mean, worst = 20 * np.log10(np.sqrt(np.mean(off**2))), 20 * np.log10(off.max())
    assert worst == pytest.approx(-67.3, abs=0.1)
    # Every path has another fraction, but in 0.1 s each passes only a few samples: between the two, and 3 dB.
    assert mean - 3.0 < oracle.error_db(pressure[some], wanted) < worst + 1.0


def test_fly_by(engine: str) -> None:
    rate, frequency = 192e3, 40e3
    _, formula = tone_and_formula(frequency, rate, 0.01, 0.2)
    line = clsim.Trajectory.line((2, 2.5, 2), (4, 2.5, 2), 0.2)  # 10 m/s
    fixed = clsim.Trajectory.fixed((3.0, 2.6, 2.0))  # 0.1 m beside it
    scene = clsim.Scene(
        clsim.Shoebox(SIZE, clsim.Material.from_reflection(REFLECTION)), AIR,
        [clsim.Source("s", clsim.Signal.tone(frequency, 0.2, rate, fade=0.01), line)], [clsim.Receiver("r", fixed)],
    )  # fmt: skip
    pressure = clsim.render(scene, clsim.find_paths(scene, 1), rate, engine=engine, duration=0.18).pressure[0]
    wanted = exact(formula, scene, line, fixed, 1, np.arange(len(pressure)) / rate)
    assert oracle.error_db(pressure, wanted) < -80.0


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")  # a tone that begins sharply
def test_silent_before_the_first_arrival(engine: str) -> None:
    rate = 192e3
    signal = clsim.Signal.tone(40e3, 0.05, rate)
    scene = clsim.Scene(
        clsim.Shoebox(SIZE, clsim.Material.from_reflection(REFLECTION)), AIR,
        [clsim.Source("s", signal, clsim.Trajectory.fixed((1, 2, 2)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((5, 2, 2)))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 2)
    plan = plan_render(scene, paths, rate)
    pressure = clsim.render(scene, paths, rate, engine=engine).pressure[0]
    first = int(4.0 / AIR.sound_speed * rate) - plan.emissions[0].bank.reach
    assert not np.any(pressure[:first])
    assert np.any(pressure[first : first + 200])
