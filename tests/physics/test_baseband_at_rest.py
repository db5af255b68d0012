"""Envelopes of pairs that never move: one complex impulse response each, against sums over the spectrum."""

from typing import Any

import frozen_sums
import numpy as np
import pytest
from made_responses import POROUS, ROUGH

import clsim
from clsim.render.planning import plan_render

pytestmark = pytest.mark.usefixtures("device")

RATE, CARRIER, BAND = 192e3, 40e3, (40e3, 4e3)
SIZE = (5.0, 4.0, 3.0)
A, B, FAR = (1.1, 1.3, 1.2), (3.7, 2.9, 2.2), (4.4, 0.7, 0.9)
AIR = clsim.Air()
CHIRP = clsim.Signal.chirp(39e3, 41e3, 0.1, RATE, window="hann")
TRAIN = clsim.Signal.pulses(clsim.Signal.chirp(39.5e3, 40.5e3, 0.008, RATE, window="hann"), 0.125, 3)
CLOCK = clsim.Electronics(clock_offset=1.7e-3)


def scene(signal: clsim.Signal = CHIRP, phased: bool = False, start: float = 0.0123456, **receiver) -> clsim.Scene:
    """Return a source and two receivers that rest, and one that walks."""
    walls = [clsim.Material.from_reflection(f) for f in (0.93, -0.8, 0.7, 0.9, 0.6, 0.8)]
    if phased:
        walls[2], walls[4] = POROUS, ROUGH
    ways = [clsim.Trajectory.fixed(B), clsim.Trajectory.fixed(FAR), clsim.Trajectory.line(FAR, B, 4.0)]
    ears = [clsim.Receiver(f"r{i}", way, **receiver) for i, way in enumerate(ways)]
    source = clsim.Source("s", signal, clsim.Trajectory.fixed(A), start=start)
    return clsim.Scene(clsim.Shoebox(SIZE, walls), AIR, [source], ears)


def envelope(sound: np.ndarray, every: int) -> np.ndarray:
    """Return the envelope of a sound that lies about the carrier: its spectrum above 0 Hz, moved down, cut."""
    spectrum = np.fft.fft(np.pad(sound, (0, len(sound))))
    f = np.fft.fftfreq(len(spectrum), 1.0 / RATE)
    kept = np.where(np.abs(f - CARRIER) < 0.5 * RATE / every, 2.0 * spectrum, 0.0)
    n = np.arange(len(sound))
    return (np.fft.ifft(kept)[: len(sound)] * np.exp(-2j * np.pi * (CARRIER / RATE) * n))[::every]


def test_equals_a_sum_over_the_spectrum(measured: Any) -> None:
    one, start, count = scene(), 0.0123456, 38400  # until the last path is over
    made = clsim.render(clsim.find_paths(one, 4), RATE, baseband=BAND, duration=count / RATE, chunk=1)
    assert "2 of 3 pairs never move: impulse responses, convolved" in made.notes
    factors = [lambda f, r=r: np.full(len(f), r) for r in (0.93, -0.8, 0.7, 0.9, 0.6, 0.8)]
    for got, place in zip(made.pressure, (B, FAR), strict=False):
        sound = frozen_sums.heard(
            CHIRP.read(0, CHIRP.count), RATE, start, count,
            lambda f, place=place: frozen_sums.response(f, SIZE, (A, place), 4, factors, AIR),
        )  # fmt: skip
        # The low-pass is flat within -100 dB and is passed twice; measured -98 dB.
        error = frozen_sums.error_db(got, envelope(sound, 32))
        measured("envelopes of pairs that never move", "the sound's own envelope", error, -94.0)


@pytest.mark.parametrize("phased", [False, True])
@pytest.mark.parametrize("responses", ["band", "centre"])
def test_same_as_path_by_path(phased: bool, responses: str) -> None:
    one = scene(phased=phased, electronics=CLOCK)
    paths = clsim.find_paths(one, 3)
    convolved, summed = (
        clsim.render(paths, RATE, baseband=BAND, duration=0.2, responses=responses, convolve_static=convolve).samples
        for convolve in (True, False)
    )
    assert np.array_equal(convolved[2], summed[2])
    for got, wanted in zip(convolved[:2], summed[:2], strict=True):
        assert np.linalg.norm(got - wanted) > 0.0
        assert frozen_sums.error_db(got, wanted) < -84.0


def test_silence_is_exact() -> None:
    one = scene(TRAIN, start=0.0)
    paths = clsim.find_paths(one, 1)
    made = clsim.render(paths, RATE, baseband=BAND, duration=0.35)
    latest = paths.table(np.zeros(1)).delay.max()
    quiet = (made.times % 0.125 > 0.008 + latest + 4e-3) & (made.times % 0.125 < 0.12)
    assert np.count_nonzero(quiet) > 100
    assert np.all(made.samples[:, quiet] == 0.0)
    assert np.abs(made.samples[:2]).max() > 0.1


def test_a_source_that_rests_needs_no_functions() -> None:
    one = scene()
    one = clsim.Scene(one.room, one.air, one.sources, one.receivers[:2])
    plan = plan_render(clsim.find_paths(one, 2), RATE, baseband=BAND, duration=0.1)
    assert len(plan.source_filters[0].basis) == 1
    assert not any(line.startswith("source 0") for line in plan.describe())
