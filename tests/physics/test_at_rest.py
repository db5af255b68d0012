"""Pairs that never move: against sums over the spectrum, and against rendering path by path."""

from dataclasses import replace
from typing import Any

import frozen_sums
import numpy as np
import pytest
from exhaustive import exhaustive
from made_responses import Lopsided, OffCentre

import clsim
from clsim.render.planning import plan_render

pytestmark = pytest.mark.usefixtures("device")

RATE = 192e3
SIZE = (5.0, 4.0, 3.0)
A, B, FAR = (1.1, 1.3, 1.2), (3.7, 2.9, 2.2), (4.4, 0.7, 0.9)
AIR = clsim.Air()
CHIRP = clsim.Signal.chirp(25e3, 55e3, 0.03, RATE, window="hann")
ECHO = 0.21e-3  # s, by which a wall sends back a part later
HARD = clsim.Material.from_reflection(0.93)


def echoing(f: np.ndarray) -> np.ndarray:
    return 0.7 + 0.2 * np.exp(-2j * np.pi * f * ECHO)


def echoing_wall() -> clsim.Material:
    rate = 4 / ECHO * 10
    samples = np.zeros(41)
    samples[0], samples[40] = 0.7, 0.2
    return clsim.Material.from_impulse_response(samples, rate)


def scene_of(source, receivers, signal=CHIRP, walls=HARD, **options) -> clsim.Scene:
    start = options.pop("start", 0.0)
    return clsim.Scene(
        clsim.Shoebox(SIZE, walls), AIR, [clsim.Source("s", signal, source, start=start, **options)], receivers
    )


def at(place, **options) -> clsim.Receiver:
    return clsim.Receiver(f"at {place}", clsim.Trajectory.fixed(place), **options)


@pytest.mark.parametrize("complex_walls", [False, True])
def test_equals_a_sum_over_the_spectrum(complex_walls: bool, measured: Any) -> None:
    """Order 4, two receivers, a start between samples, chunks of one segment."""
    walls = {"default": HARD, "y_max": echoing_wall() if complex_walls else clsim.Material.from_reflection(-0.8)}
    start = 0.0123456
    scene = scene_of(clsim.Trajectory.fixed(A), [at(B), at(FAR)], walls=walls, start=start)
    paths = clsim.find_paths(scene, 4)
    made = clsim.render(paths, RATE, duration=0.2, chunk=1).pressure  # the last path is over at 0.13 s
    factors = [lambda f: np.full(len(f), 0.93)] * 6
    factors[3] = echoing if complex_walls else lambda f: np.full(len(f), -0.8)
    for pressure, place in zip(made, (B, FAR), strict=True):
        wanted = frozen_sums.heard(
            CHIRP.read(0, CHIRP.count), RATE, start, made.shape[1],
            lambda f, place=place: frozen_sums.response(f, SIZE, (A, place), 4, factors, AIR),
        )  # fmt: skip
        measured("pairs that never move", "sums in float64", frozen_sums.error_db(pressure, wanted), -115.0)


@pytest.mark.parametrize(
    "beams", [exhaustive(((clsim.Piston(0.0047), clsim.FirstOrder(0.5)),)), (OffCentre(2e-3), Lopsided())]
)
@pytest.mark.parametrize("responses", ["band", "centre"])
def test_equals_rendering_path_by_path(beams, responses) -> None:
    """Beams, real and complex; as exact as what is compared with: -90 dB over the band, or the delay filters'."""
    source = clsim.Trajectory.fixed(A)
    scene = scene_of(source, [at(B, directivity=beams[1], aim=(-1, 0.2, 0.1))], directivity=beams[0], aim=(1, 0.3, 0.2))
    paths = clsim.find_paths(scene, 3)
    options = {"duration": 0.06, "responses": responses, "interpolator": clsim.Bandlimited(-120.0)}
    convolved, by_path = (
        clsim.render(paths, RATE, convolve_static=choice, **options).pressure for choice in (True, False)
    )
    assert not np.array_equal(convolved, by_path)  # two ways indeed
    allowed = -88.0 if responses == "band" else -98.0 if beams[0].is_complex else -110.0
    assert frozen_sums.error_db(convolved, by_path) < allowed


def test_some_receivers_move_and_one_has_a_clock() -> None:
    """Only pairs at rest are convolved; each receiver hears what it hears alone."""
    line = clsim.Trajectory.line(B, FAR, 0.2)
    clock = clsim.Electronics(clock_offset=1.37e-3)
    receivers = [at(B), clsim.Receiver("mover", line), at(FAR, electronics=clock)]
    drifting = clsim.Receiver("drifting", clsim.Trajectory.fixed(B), electronics=clsim.Electronics(clock_ppm=30.0))
    scene = scene_of(clsim.Trajectory.fixed(A), [*receivers, drifting])
    paths = clsim.find_paths(scene, 2)
    options = {"duration": 0.1, "interpolator": clsim.Bandlimited(-110.0), "responses": "centre"}
    plan = plan_render(paths, RATE, **options)
    resting = {plan.tracks.pairs[i].receiver for i in plan.allocation.convolved}
    assert resting == {0, 2}
    made = clsim.render(paths, RATE, **options).pressure
    by_path = clsim.render(paths, RATE, convolve_static=False, **options).pressure
    np.testing.assert_array_equal(made[[1, 3]], by_path[[1, 3]])
    for r in (0, 2):
        assert frozen_sums.error_db(made[r], by_path[r]) < -105.0
    # An offset of 1.37 ms is one: without it the signal would lie elsewhere altogether.
    alone = scene_of(clsim.Trajectory.fixed(A), [at(FAR)])
    early = clsim.render(clsim.find_paths(alone, 2), RATE, **options).pressure[0]
    assert frozen_sums.error_db(made[2], early) > 0.0


def still(**changes) -> clsim.Scene:
    waypoints = clsim.Trajectory.waypoints([0, 0.5, 1], [B, B, B])
    parts = {"receiver": waypoints, "source": clsim.Trajectory.fixed(A)} | changes
    ears = [clsim.Receiver("r", parts["receiver"], parts.get("beam", clsim.Omni()))]
    return scene_of(parts["source"], ears)


@pytest.mark.filterwarnings("ignore:signals.0.. the delay filters")
def test_what_is_at_rest() -> None:
    a, b = np.array(A), np.array(B)
    quarter = [(0, 0, 0, 1), (0, 0, 2**-0.5, 2**-0.5)]
    turning = clsim.Trajectory.waypoints([0, 1], [B, B], orientations=quarter)
    cases = {
        "waypoints": (still(), True),
        "legs": (still(receiver=clsim.Trajectory.waypoints([0, 1], [B, B], smooth=False)), True),
        "line": (still(source=clsim.Trajectory.line(A, A, 1.0)), True),
        "moves late": (still(receiver=clsim.Trajectory.waypoints([0, 0.5, 1], [B, B, b + 1e-9], smooth=False)), False),
        "source moves": (still(source=clsim.Trajectory.line(A, a + 1e-9, 1.0)), False),
        "circle": (still(source=clsim.Trajectory.circle(A, 1e-6, 1.0, 1.0)), False),
        "turning, omni": (still(receiver=turning), True),
        "turning, cardioid": (still(receiver=turning, beam=clsim.FirstOrder(0.5)), False),
    }
    for name, (scene, resting) in cases.items():
        paths = clsim.find_paths(scene, 1)
        assert bool(plan_render(paths, RATE).allocation.convolved) == resting, name
    scene = still()
    paths = clsim.find_paths(scene, 1)
    images = replace(paths.families[0], end=np.where(np.arange(len(paths)) == 3, 0.02, np.inf))  # one path ends
    half = replace(paths, families=(images,))
    assert not plan_render(half, RATE).allocation.convolved
    for options in (
        {"convolve_static": False}, {"engine": "reference"}, {"interpolator": clsim.Lagrange(12)},
    ):  # fmt: skip
        assert not plan_render(paths, RATE, **options).allocation.convolved
    with pytest.raises(clsim.InputError, match=r"^convolve_static: must be True or False, but is 'no'"):
        plan_render(paths, RATE, convolve_static="no")


def test_chunks_change_nothing_and_silence_is_silent() -> None:
    """Pulses far apart: between what is heard of them there is nothing at all."""
    pulse = clsim.Signal.tone(40e3, 0.002, RATE, fade=0.001)
    scene = scene_of(clsim.Trajectory.fixed(A), [at(B)], signal=clsim.Signal.pulses(pulse, 0.4, 2), start=0.1)
    paths = clsim.find_paths(scene, 2)
    whole = clsim.render(paths, RATE, chunk=10**6).pressure[0]
    pieces = clsim.render(paths, RATE, chunk=1).pressure[0]
    assert len(whole) > 4 * 18432
    assert frozen_sums.error_db(pieces, whole.astype(float)) < -130.0
    nearest = np.linalg.norm(np.subtract(A, B)) / AIR.speed_of_sound
    for begun in (0.1, 0.5):
        ringing = round(4e-3 * RATE)  # the relaxation of nitrogen, without delay, dies away within this
        arrival = round((begun + nearest) * RATE)
        assert not np.any(whole[arrival - round(0.3 * RATE) if begun > 0.1 else 0 : arrival - ringing])
        assert np.any(whole[arrival : arrival + 100])


def test_electronics_come_after() -> None:
    """Noise, cuts and converter see the same pressure, so a converter of 12 bits gives nearly the same codes."""
    end = clsim.Electronics(self_noise_db=30, seed=1, low_cut=1e3, gain_db=20.0, adc_bits=12, adc_full_scale=1.0)
    scene = scene_of(clsim.Trajectory.fixed(A), [at(B, electronics=end, transducer=clsim.Transducer.named("MA40S4R"))])
    paths = clsim.find_paths(scene, 1)
    options = {"duration": 0.06, "response_error_db": -100.0, "interpolator": clsim.Bandlimited(-110.0)}
    convolved, by_path = (
        clsim.render(paths, RATE, convolve_static=choice, **options).samples[0] for choice in (True, False)
    )
    step = 2.0 / 2**12
    assert np.count_nonzero(convolved) > 1000
    assert np.abs(convolved - by_path).max() <= 1.001 * step
    assert np.mean(convolved != by_path) < 0.01


def test_no_reflection_at_all_and_silence() -> None:
    dead = clsim.Material.from_reflection(0.0)
    silent = clsim.Signal.from_array(np.zeros(1000), RATE)
    for signal, heard in ((CHIRP, True), (silent, False)):
        scene = scene_of(clsim.Trajectory.fixed(A), [at(B)], signal=signal, walls=dead)
        made = clsim.render(clsim.find_paths(scene, 2), RATE, duration=0.05).pressure
        assert bool(np.any(made)) == heard
        assert np.isfinite(made).all()
