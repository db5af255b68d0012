"""Transducers: closed forms, causality, random access, and bad input."""

from pathlib import Path

import numpy as np
import pytest
import soundfile

import clsim
from clsim import InputError, Signal, Transducer
from clsim.numerics.band_filters import minimum_phase, resonance_response

RATE = 192e3
BURST = Signal.tone(40e3, 0.4e-3, RATE)


def edges(frequency: float, width: float) -> tuple[float, float]:
    """Return the frequencies with the product frequency² and the difference width."""
    middle = np.hypot(frequency, width / 2)
    return middle - width / 2, middle + width / 2


def db(value: np.ndarray) -> np.ndarray:
    return 20 * np.log10(np.abs(value))


@pytest.mark.parametrize("rate", [96e3, 192e3, 500e3])
@pytest.mark.parametrize("width", [600.0, 2.4e3, 6e3])
def test_resonance_is_right_at_its_centre_and_6_db_points(rate: float, width: float, measured) -> None:
    low, high = edges(40e3, width)
    got = Transducer.resonance(40e3, width, 0.3).response([low, 40e3, high], rate)
    # A width wrong by 2 % moves the points by 0.13 dB.
    off = np.abs(db(got / 0.3) - [-20 * np.log10(2), 0.0, -20 * np.log10(2)]).max()
    measured("resonance: magnitude at its centre and half of it", "closed form", off, 0.05)


@pytest.mark.parametrize("rate", [150e3, 192e3, 500e3])
def test_resonance_has_its_own_phase(rate: float, measured) -> None:
    # A filter that is early or late by a tenth of a sample is wrong by 7.5 degrees at 192 kHz.
    frequencies = np.linspace(*edges(40e3, 2.4e3), 9)
    got = Transducer.resonance(40e3, 2.4e3, 1.0).response(frequencies, rate)
    off = np.abs(got - resonance_response(frequencies, 40e3, 2.4e3)).max()
    measured("resonance: response", "closed form", off, 0.01, "of the peak")
    assert np.degrees(np.angle(got[[0, -1]])) == pytest.approx([60.0, -60.0], abs=0.01)


@pytest.mark.parametrize("rate", [96e3, 192e3])
def test_resonance_rings_down_as_stated(rate: float) -> None:
    width = 2.4e3
    taps = Transducer.resonance(40e3, width, 1.0).impulse_response(rate)
    time = np.arange(len(taps)) / rate
    part = (time > 0.3e-3) & (time < 1.8e-3)
    # Energy behind each sample falls twice as fast as the envelope, without its oscillation but for some per cent.
    energy = np.log(np.cumsum(np.square(taps[::-1]))[::-1][part])
    constant = -2.0 / np.polyfit(time[part], energy, 1)[0]
    assert constant == pytest.approx(np.sqrt(3) / (np.pi * width), rel=0.01)


def test_minimum_phase_finds_the_filter_whose_zeros_are_inside() -> None:
    taps = np.array([1.0, -0.9, 0.5])  # zeros at 0.71
    found = minimum_phase(np.abs(np.fft.rfft(taps, 1024)))
    np.testing.assert_allclose(found[:3], taps, atol=1e-12)
    np.testing.assert_allclose(found[3:], 0.0, atol=1e-12)


def test_magnitude_table_becomes_minimum_phase() -> None:
    frequencies = np.linspace(0.0, RATE / 2, 4097)
    taps = np.array([0.4, -0.2, 0.1])
    values = np.abs(np.exp(-2j * np.pi * np.outer(frequencies / RATE, np.arange(3))) @ taps)
    found = Transducer.from_table(frequencies, values).impulse_response(RATE)
    np.testing.assert_allclose(found[:3], taps, atol=1e-6)  # straight lines between 4097 logarithms


def test_complex_table_gives_back_the_impulse_response(rng: np.random.Generator) -> None:
    frequencies = np.linspace(0.0, RATE / 2, 8193)
    taps = rng.normal(size=40) * np.exp(-np.arange(40) / 8)
    values = np.exp(-2j * np.pi * np.outer(frequencies / RATE, np.arange(40))) @ taps
    found = Transducer.from_table(frequencies, values).impulse_response(RATE)
    np.testing.assert_allclose(found[:40], taps, atol=1e-4)
    early = values * np.exp(2j * np.pi * frequencies * 20 / RATE)
    with pytest.raises(InputError, match=r"transducer\.values: must respond after 0 s"):
        Transducer.from_table(frequencies, early).impulse_response(RATE)


def test_outside_of_a_table_is_refused_or_extended_by_name() -> None:
    table = [36e3, 40e3, 44e3], [0.2, 0.6, 0.2]
    with pytest.raises(InputError, match="transducer: must cover the band of the signal"):
        Transducer.from_table(*table).drive(BURST)
    zero, hold = (Transducer.from_table(*table, outside=name) for name in ("zero", "hold"))
    np.testing.assert_allclose(np.abs(zero.response([36e3, 40e3, 44e3], RATE)), [0.2, 0.6, 0.2], rtol=0.01)
    assert np.all(db(zero.response([20e3, 60e3], RATE) / 0.6) < -75.0)
    np.testing.assert_allclose(np.abs(hold.response([20e3, 60e3], RATE)), 0.2, rtol=0.01)
    assert hold.drive(BURST).count > BURST.count
    long = Signal.tone(40e3, 0.1, RATE, fade=0.01)
    assert Transducer.from_table(*table).drive(long).centre_frequency == pytest.approx(40e3, abs=1.0)


def test_impulse_response_is_what_was_given(tmp_path: Path, rng: np.random.Generator) -> None:
    taps = rng.normal(size=300).astype(np.float32)
    made = Transducer.from_impulse_response(taps, RATE)
    np.testing.assert_array_equal(made.impulse_response(RATE), taps.astype(np.float64))
    soundfile.write(tmp_path / "h.wav", 0.1 * taps / 5.0, int(RATE), subtype="FLOAT")
    np.testing.assert_allclose(
        Transducer.from_wav(tmp_path / "h.wav", scale=50.0).impulse_response(RATE), taps, rtol=1e-6
    )


@pytest.mark.parametrize("rate", [192e3, 384e3])
def test_impulse_response_at_another_rate_is_the_same_response(rate: float) -> None:
    taps = Transducer.resonance(40e3, 2.4e3, 1.0).impulse_response(250e3)
    made, frequencies = Transducer.from_impulse_response(taps, 250e3), np.linspace(35e3, 45e3, 11)
    np.testing.assert_allclose(made.response(frequencies, rate), made.response(frequencies, 250e3), atol=0.005)
    with pytest.raises(InputError, match=r"transducer\.samples: must respond after 0 s"):
        Transducer.from_impulse_response([1.0], 48e3).impulse_response(rate)


def test_driven_signal_is_a_convolution_however_it_is_cut(rng: np.random.Generator) -> None:
    made = Transducer.named("MA40S4S")
    voltage = Signal.noise(0.2, RATE, seed=2)
    emitted = made.drive(voltage)
    taps = made.impulse_response(RATE)
    whole = emitted.read(-10, emitted.count + 10)
    wanted = np.convolve(voltage.read(0, voltage.count), taps)
    assert emitted.count == len(wanted)
    np.testing.assert_allclose(whole[10:-10], wanted, atol=1e-13)
    for _ in range(20):
        start, stop = np.sort(rng.integers(-10, emitted.count + 10, 2))
        np.testing.assert_array_equal(emitted.read(start, stop), whole[start + 10 : stop + 10])


def test_emitted_signal_has_its_own_band_and_centre() -> None:
    noise = Signal.noise(0.1, RATE, seed=1)
    source = clsim.Source("s", noise, clsim.Trajectory.fixed((1, 1, 1)), transducer=Transducer.named("MA40S4S"))
    assert source.signal.centre_frequency == RATE / 4
    assert source.emitted.centre_frequency == pytest.approx(40e3, abs=1500)
    low, high = source.emitted.band()
    assert 20e3 < low < 39e3
    assert 41e3 < high < 75e3
    again = source.emitted.at_rate(500e3)
    assert again.duration == pytest.approx(source.emitted.duration, abs=1e-3)


def test_transducers_with_a_name_are_the_catalogues() -> None:
    # 120 dB re 20 µPa are 20 Pa rms at 0.3 m from 10 V rms; the air between 0.3 and 1 m takes 0.92 dB.
    loss = 10 ** (-0.7 * float(clsim.Air().absorption_at(40e3)) / 20)
    assert Transducer.named("MA40S4S").sensitivity == pytest.approx(2.0 * 0.3 * loss, rel=1e-12)
    assert Transducer.named("MA40S4R").sensitivity == pytest.approx(7.0795e-3, rel=1e-4)
    with pytest.raises(InputError, match="MA40S4S"):
        Transducer.named("MA40")


TABLE = Transducer.from_table
BAD = {
    "frequency": lambda: Transducer.resonance(0.0, 1.0, 1.0),
    "width": lambda: Transducer.resonance(40e3, 50e3, 1.0),
    "sensitivity": lambda: Transducer.resonance(40e3, 2e3, -1.0),
    "transducer.frequency": lambda: Transducer.resonance(40e3, 2e3, 1.0).impulse_response(80e3),
    "sampling_rate": lambda: Transducer.resonance(40e3, 2e3, 1.0).impulse_response(0.0),
    "frequencies": lambda: TABLE([2.0, 1.0], [1.0, 1.0]),
    "values": lambda: TABLE([1.0, 2.0], [1.0, 1.0, 1.0]),
    "values[1]": lambda: TABLE([1.0, 2.0], [1.0, 0.0]),
    "outside": lambda: TABLE([1.0, 2.0], [1.0, 1.0], "extend"),
    "samples": lambda: Transducer.from_impulse_response([0.0, 0.0], RATE),
    "samples[0]": lambda: Transducer.from_impulse_response([np.nan], RATE),
    "path": lambda: Transducer.from_wav("missing.wav"),
    "model": lambda: Transducer("MA40S4S"),  # type: ignore[arg-type]
    "signal": lambda: Transducer.named("MA40S4S").drive(np.ones(3)),  # type: ignore[arg-type]
    "transducer": lambda: clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 1)), transducer="MA40S4R"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("field", BAD)
def test_bad_input_names_the_field(field: str) -> None:
    with pytest.raises(InputError) as caught:
        BAD[field]()
    assert caught.value.field == field


def test_a_receivers_table_must_cover_what_is_emitted() -> None:
    source = clsim.Source("s", Signal.tone(40e3, 0.1, RATE, fade=0.01), clsim.Trajectory.fixed((1, 1, 1)))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((2, 1, 1)), transducer=TABLE([10e3, 30e3], [1.0, 1.0]))
    with pytest.raises(InputError, match=r"receivers\[0\]\.transducer: must cover the band of what 's' emits"):
        clsim.Scene(clsim.Shoebox((4, 3, 2), clsim.Material.from_reflection(0.5)), clsim.Air(), [source], [ear])
