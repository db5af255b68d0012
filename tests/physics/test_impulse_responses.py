"""Impulse responses as sums of images."""

from dataclasses import replace

import frozen_sums
import numpy as np
import pytest
from made_responses import OffCentre

import clsim
from clsim.numerics.convolution import band_taper, ringing

RATE = 192e3
SIZE = (5.0, 4.0, 3.0)
A, B = (1.1, 1.3, 1.2), (3.7, 2.9, 2.2)
AIR = clsim.Air()
TONE = clsim.Signal.tone(40e3, 0.01, RATE)


def scene_of(source, receiver, walls=None, signal=TONE, **options) -> clsim.Scene:
    walls = clsim.Material.from_reflection(0.9) if walls is None else walls
    return clsim.Scene(
        clsim.Shoebox(SIZE, walls), AIR, [clsim.Source("s", signal, source, **options)],
        [clsim.Receiver("r", receiver)],
    )  # fmt: skip


def fixed(a=A, b=B, **options) -> clsim.Scene:
    return scene_of(clsim.Trajectory.fixed(a), clsim.Trajectory.fixed(b), **options)


def spectrum(found: clsim.ImpulseResponses, f: np.ndarray) -> np.ndarray:
    """Return the spectrum of the only pair's response at frequencies (F,)."""
    return np.array([np.sum(found.samples[0, 0] * np.exp(-2j * np.pi * x * found.times)) for x in f])


@pytest.mark.parametrize("edges", [(0.0, 0.45, 0.0, 0.05), (0.1, 0.2, 0.05, 0.05), (0.2, 0.25, 0.1, 0.25)])
def test_ringing_is_what_it_is_said_to_be(edges: tuple[float, float, float, float]) -> None:
    """An impulse between samples, cut where it is said to have rung out, keeps its spectrum."""
    size = 2**14
    f = np.arange(size // 2 + 1) / size
    weight = band_taper(f, *edges)
    low, high, below, above = edges
    assert np.all(weight[(f >= low) & (f <= high)] == 1.0)
    assert np.all(weight[(f >= high + above) | (f <= low - below if below else f < 0)] == 0.0)
    impulse = np.fft.irfft(weight * np.exp(-2j * np.pi * f * (size / 2 + 0.37)))
    away = np.abs(np.arange(size) - size / 2 - 0.37)
    reach = ringing(below, above)
    cut = np.where(away <= reach, impulse, 0.0)
    assert np.abs(np.fft.rfft(cut) - np.fft.rfft(impulse)).max() < 10 ** (-115 / 20)
    assert np.abs(impulse[away > reach * 5 / 7]).max() < 10 ** (-100 / 20) * np.abs(impulse).max()


@pytest.mark.parametrize("band", [None, (20e3, 60e3), (38e3, 42e3)])
def test_one_path_is_its_closed_form(band: tuple[float, float] | None) -> None:
    scene = fixed()
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, band=band, tail="off")
    distance = float(np.linalg.norm(np.subtract(A, B)))
    low, high = band or (200.0, 0.475 * RATE)
    f = np.linspace(low, high, 200)
    exact = 10 ** (-AIR.absorption_at(f) * (distance - 1) / 20) / distance
    exact = exact * np.exp(-2j * np.pi * f * distance / AIR.speed_of_sound)
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance


def test_one_path_in_air_that_disperses_has_its_wavenumber() -> None:
    """Over the whole band; the first metre is passed at the speed of the signal's centre."""
    air = clsim.Air(dispersion=True)
    found = clsim.impulse_responses(clsim.find_paths(replace(fixed(), air=air), 0), RATE, tail="off")
    distance = float(np.linalg.norm(np.subtract(A, B)))
    f = np.linspace(200.0, 0.475 * RATE, 200)
    k = air.wavenumber_at(f)
    exact = np.exp((k.imag - 1j * k.real) * (distance - 1) - 2j * np.pi * f / air.speed_at(40e3)) / distance
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance
    still = np.exp(k.imag * (distance - 1) - 2j * np.pi * f * distance / air.speed_of_sound) / distance
    assert np.abs(still - exact).max() > 10 ** (-10 / 20) / distance


@pytest.mark.parametrize("place", [(3.7, 2.9, 2.2), (3.7, 2.9, 2.2003), (3.7, 2.901, 2.2)])
def test_the_peak_lies_at_the_delay(place: tuple[float, float, float]) -> None:
    """Within 0.01 sample, by a parabola through the largest of 64 times as many samples."""
    scene = fixed(b=place)
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, tail="off")
    late = np.linalg.norm(np.subtract(A, place)) / AIR.speed_of_sound * RATE
    taps = found.samples[0, 0]
    even = len(taps) + len(taps) % 2
    fine = np.fft.irfft(np.fft.rfft(taps, even), 64 * even)
    k = int(fine.argmax())
    a, b, c = fine[k - 1 : k + 2]
    at = (k + 0.5 * (a - c) / (a - 2 * b + c)) / 64 - found.lead
    assert at == pytest.approx(late, abs=0.01)


def test_a_beam_with_a_phase_turns_all_frequencies() -> None:
    """A source that radiates from 2 mm ahead of where it is said to be is heard from there."""
    scene = fixed(directivity=OffCentre(2e-3), aim=np.subtract(B, A))
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, band=(20e3, 60e3), tail="off")
    f = np.linspace(20e3, 60e3, 100)
    distance = float(np.linalg.norm(np.subtract(A, B)))
    exact = 10 ** (-AIR.absorption_at(f) * (distance - 1) / 20) / distance
    exact = exact * np.exp(-2j * np.pi * f * (distance - 2e-3) / AIR.speed_of_sound)
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance


@pytest.mark.parametrize("order", [2, 5])
def test_a_room_is_the_sum_of_its_images(order: int, measured) -> None:
    factors = (0.9, -0.8, 0.7, 0.95, 0.5, 0.85)
    names = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
    walls = {name: clsim.Material.from_reflection(factor) for name, factor in zip(names, factors, strict=True)}
    scene = fixed(walls=walls)
    found = clsim.impulse_responses(clsim.find_paths(scene, order), RATE, tail="off")
    f = np.linspace(500.0, 0.475 * RATE, 400)
    exact = frozen_sums.response(
        f, SIZE, (A, B), order, [lambda f, x=x: np.full(len(f), x) for x in factors], AIR
    )  # fmt: skip
    error = np.abs(spectrum(found, f) - exact)
    found = 20 * np.log10(error.max() / np.abs(exact).max())
    measured("impulse responses of rooms", "sum over images", found, -110.0)


def test_a_moving_scene_is_frozen_and_convolved(engine: str) -> None:
    """The response at an instant is what is rendered where everything stands as it does then."""
    chirp = clsim.Signal.chirp(30e3, 50e3, 0.02, RATE, window="hann")
    moving = scene_of(
        clsim.Trajectory.line(A, (2.1, 1.3, 1.2), 1.0), clsim.Trajectory.line(B, (3.7, 1.9, 2.2), 1.0), signal=chirp
    )
    found = clsim.impulse_responses(clsim.find_paths(moving, 3), RATE, at=0.25, tail="off")
    frozen = fixed((1.35, 1.3, 1.2), (3.7, 2.65, 2.2), signal=chirp)
    made = clsim.render(clsim.find_paths(frozen, 3), RATE, engine=engine, duration=0.1).pressure[0]
    convolved = np.convolve(found.samples[0, 0], chirp.read(0, chirp.count))[found.lead :][: len(made)]
    made = made[: len(convolved)].astype(float)
    # The reference engine holds responses within -100 dB of the strongest and delays within its filters' -98 dB.
    assert frozen_sums.error_db(made, convolved) < (-115.0 if engine == "opencl" else -90.0)


def test_sample_0_is_time_0() -> None:
    """What rings earlier at a close receiver is cut, and told; nothing else changes."""
    near = (1.1, 1.3, 1.21)
    paths = clsim.find_paths(fixed(b=near), 1)
    kept = clsim.impulse_responses(paths, RATE, lead="keep", tail="off")
    assert 200 < kept.lead < 2000
    assert kept.times[kept.lead] == 0.0
    f = np.linspace(1e3, 91e3, 200)
    exact = frozen_sums.response(f, SIZE, (A, near), 1, [lambda f: np.full(len(f), 0.9)] * 6, AIR)
    assert np.abs(spectrum(kept, f) - exact).max() < 10 ** (-110 / 20) * np.abs(exact).max()
    with pytest.warns(clsim.ClsimWarning, match=r"rings before time 0 is cut.*-\d+ dB.*lead=\"keep\" keeps it"):
        found = clsim.impulse_responses(paths, RATE, tail="off")
    assert found.lead == 0
    assert found.times[0] == 0.0
    np.testing.assert_array_equal(found.samples, kept.samples[:, :, kept.lead :])
    late = np.linalg.norm(np.subtract(A, near)) / AIR.speed_of_sound
    assert found.first_arrivals[0, 0] == pytest.approx(late, rel=1e-12)
    assert abs(int(found.samples[0, 0].argmax()) - late * RATE) <= 0.5
    early, whole = (np.sum(np.square(kept.samples[0, 0, :n])) for n in (kept.lead, None))
    assert found.cut_db[0, 0] == pytest.approx(10 * np.log10(early / whole), abs=1e-6)
    assert kept.cut_db[0, 0] == -np.inf
    assert f"at sample {late * RATE:.1f}" in found.describe()[0]


def test_several_pairs_share_one_axis_of_time() -> None:
    still = clsim.Trajectory.fixed
    sources = [clsim.Source("a", TONE, still(A)), clsim.Source("b", TONE, still((2.0, 2.0, 2.0)))]
    receivers = [clsim.Receiver(name, still(place)) for name, place in (("c", B), ("d", (4.4, 0.7, 0.9)))]
    scene = clsim.Scene(clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9)), AIR, sources, receivers)
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, tail="off")
    assert found.samples.shape[:2] == (2, 2)
    assert (found.source_names, found.receiver_names) == (("a", "b"), ("c", "d"))
    for s, source in enumerate(sources):
        for r, receiver in enumerate(receivers):
            distance = np.linalg.norm(source.trajectory.position(0.0) - receiver.trajectory.position(0.0))
            peak = int(np.abs(found.samples[s, r]).argmax())
            assert found.times[peak] * AIR.speed_of_sound == pytest.approx(distance, abs=0.51 / RATE * 344)
    shares = []
    clsim.impulse_responses(clsim.find_paths(scene, 1), RATE, progress=shares.append, tail="off")
    assert shares == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": 1.5}, r"^at: must lie within sources\[0\]\.trajectory, up to 1 s, but is 1\.5 s"),
        ({"at": -0.1}, r"^at: must be at least 0 s, but is -0\.1 s"),
        ({"at": float("nan")}, r"^at: must be finite"),
        ({"at": "now"}, r"^at: must be a number, but is 'now'"),
        ({"band": (0.0, 96e3)}, r"^band\[1\]: must be at most 91200 Hz, but is 96000 Hz"),
        ({"band": (50e3, 40e3)}, r"^band\[1\]: must be at least 50192 Hz, but is 40000 Hz"),
        ({"band": (-1.0, 40e3)}, r"^band\[0\]: must be at least 0 Hz"),
        ({"band": (1.0, 40e3)}, r"^band\[0\]: must be 0 or at least 38\.4 Hz"),
        ({"band": (1e3,)}, r"^band: must have the shape 2"),
        ({"band": (0.0, float("inf"))}, r"^band\[1\]: must be finite"),
        ({"sampling_rate": 10.0}, r"^sampling_rate: must be at least 1000 Hz"),
        ({"paths": None}, r"^paths: must be a PathSet, but is None"),
    ],
)
def test_bad_input(options: dict, message: str) -> None:
    scene = scene_of(clsim.Trajectory.line(A, (2.1, 1.3, 1.2), 1.0), clsim.Trajectory.fixed(B))
    arguments = {"paths": clsim.find_paths(scene, 1), "sampling_rate": RATE} | options
    with pytest.raises(clsim.InputError, match=message):
        clsim.impulse_responses(**arguments)


def test_what_is_not_known_and_not_heard_is_refused() -> None:
    table = clsim.AxialDirectivity([0, 90, 180], [40e3], [[1.0], [0.5], [0.1]])
    scene = fixed(directivity=table, aim=(1, 0, 0))
    with pytest.raises(clsim.InputError, match=r"^sources\[0\]\.directivity: must cover the band of the responses"):
        clsim.impulse_responses(clsim.find_paths(scene, 1), RATE, tail="off")
    scene = fixed()
    paths = clsim.find_paths(scene, 1)
    images = replace(paths.families[0], start=np.full(len(paths), 0.5), end=np.full(len(paths), np.inf))
    later = replace(paths, families=(images,))
    with pytest.raises(clsim.InputError, match=r"^paths: must hold paths that are active at 0\.2 s, but hold none"):
        clsim.impulse_responses(later, RATE, at=0.2, tail="off")
    assert np.any(clsim.impulse_responses(later, RATE, at=0.5, tail="off").samples)
