"""Walls that depend on frequency, at low sampling rates and down to 0 Hz, against sums over the spectrum."""

from collections.abc import Callable

import default_oracle
import frozen_sums
import numpy as np
import pytest
import spectral_sums
from exhaustive import few
from scipy.interpolate import PchipInterpolator

import clsim
from clsim.render.planning import plan_render
from clsim.render.render import record

PROMISED_DB = -86.0  # of the root of the sum of the squares of all paths, at defaults
QUIET = (
    "ignore:the material .absorption table. covers", "ignore:sources.0..signal. .* is low for paths",
    "ignore:signals.0.. .* of its energy lies above", "ignore:source 0. air, walls and directivities .* approximated to -8[6-9]",
    "ignore:source 0. air, walls and directivities .* approximated to -9",
)  # fmt: skip
pytestmark = [pytest.mark.filterwarnings(one) for one in QUIET]

SIZE, A, B, RATE = (6.2, 4.7, 3.1), (1.3, 1.1, 1.2), (4.4, 3.2, 1.7), 16e3
TABLE, ALPHA = np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3]), np.array([0.4, 0.3, 0.2, 0.12, 0.08, 0.05])
CURVE = PchipInterpolator(np.log(TABLE), ALPHA)  # as docs/materials.md says; held beyond the ends
AIR = clsim.Air()


def factor(f: np.ndarray) -> np.ndarray:
    return np.sqrt(1.0 - CURVE(np.log(np.clip(f, TABLE[0], TABLE[-1]))))


def tone(f: float) -> clsim.Signal:
    """One second in a Hann window."""
    return clsim.Signal.tone(f, 1.0, RATE, fade=0.5)


def red_noise(rate: float = RATE) -> clsim.Signal:
    noise = np.cumsum(np.random.default_rng(4).standard_normal(round(rate)))
    return clsim.Signal.from_array(1e-3 * (noise - noise.mean()), rate)


def scene_of(signal: clsim.Signal, source: clsim.Trajectory) -> clsim.Scene:
    room = clsim.Shoebox(SIZE, clsim.Material.from_absorption(TABLE, ALPHA))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed(B))]
    return clsim.Scene(room, AIR, [clsim.Source("s", signal, source)], ears)


SIGNALS: dict[str, Callable[[], clsim.Signal]] = {
    "25 Hz": lambda: tone(25.0),
    "500 Hz, abrupt": lambda: clsim.Signal.tone(500.0, 0.2, RATE),
    "12 Hz": lambda: tone(12.0),
    "50 Hz": lambda: tone(50.0),
    "100 Hz": lambda: tone(100.0),
    "20 to 400 Hz": lambda: clsim.Signal.chirp(20.0, 400.0, 0.5, RATE, window="hann"),
    "red noise": red_noise,
    "red noise at 24 kHz": lambda: red_noise(24e3),
    "2 kHz, abrupt": lambda: clsim.Signal.tone(2e3, 0.2, RATE),
}


@pytest.mark.parametrize("name", few(SIGNALS, kept=(0, 1)))
def test_paths_at_rest_one_by_one(name: str, engine: str, measured: Callable[..., float]) -> None:
    """The path filters, not the convolution of pairs at rest; the band limit is part of the signal."""
    signal = SIGNALS[name]()
    rate, paths = signal.sampling_rate, clsim.find_paths(scene_of(signal, clsim.Trajectory.fixed(A)), 1)
    plan = plan_render(paths, rate, engine=engine, convolve_static=False, duration=signal.duration + 0.1)
    made = record(plan).pressure[0]
    emitted = np.convolve(signal.read(0, signal.count), plan.source_filters[0].band_limit)
    lead = len(plan.source_filters[0].band_limit) // 2
    each = []
    for place, met in frozen_sums.images(SIZE, A, 1):
        far = float(np.linalg.norm(place - np.asarray(B)))

        def response(f: np.ndarray, far: float = far, order: int = sum(met)) -> np.ndarray:
            air = 10 ** (-AIR.absorption_at(f) * (far - 1.0) / 20) / far
            return air * factor(f) ** order * np.exp(-2j * np.pi * f * far / AIR.speed_of_sound)

        each.append(frozen_sums.heard(emitted, rate, 0.1 - lead / rate, len(made) + round(0.1 * rate), response))
    exact, early = np.array(each), round(0.1 * rate)
    error_db = 20.0 * np.log10(np.linalg.norm(made - exact.sum(axis=0)[early:]) / np.linalg.norm(exact))
    measured("walls by frequency at low sampling rates", "images by their spectra", error_db, PROMISED_DB)  # fmt: skip


@pytest.mark.parametrize("frequency", few((25.0, 12.0, 50.0, 100.0)))
def test_a_moving_source(frequency: float, engine: str) -> None:
    """A tone's spectrum line by line, each path's delay solved at every sample."""
    signal = tone(frequency)
    way = default_oracle.Line(A, (1.5, 0.8, 0.3))
    moving = clsim.Trajectory.line(way.origin, way.position(np.array(1.0)), 1.0)
    made = clsim.render(clsim.find_paths(scene_of(signal, moving), 1), RATE, engine=engine, duration=1.0).pressure[0]
    times = np.arange(0, len(made), 7) / RATE
    room = default_oracle.Room(SIZE, 1.0, 1, AIR.speed_of_sound)
    order, sign, offset = (np.array(one) for one in zip(*room.images(), strict=True))
    ear = default_oracle.Line(B)
    delay, mach = default_oracle.delays(way, ear, sign[:, None], offset[:, None], times, AIR.speed_of_sound)
    far = delay * AIR.speed_of_sound

    def response(f: float) -> np.ndarray:
        at = np.array([max(f, 1e-3)])
        air = 10 ** (-AIR.absorption_at(at) * (far - 1.0) / 20) / (far * (1.0 - mach))
        return np.asarray(air * factor(at) ** order[:, None])

    exact = np.array([
        spectral_sums.heard(signal, times[None] - delay[p : p + 1], lambda f, p=p: response(f)[p : p + 1], 0.3)
        for p in range(len(order))
    ])  # fmt: skip
    assert 20.0 * np.log10(np.linalg.norm(made[::7] - exact.sum(axis=0)) / np.linalg.norm(exact)) <= PROMISED_DB
