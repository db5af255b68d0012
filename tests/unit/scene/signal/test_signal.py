"""Signals: random access, exactness after long times, and bad input."""

import tracemalloc
from collections.abc import Callable
from decimal import Decimal, localcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.signal import correlate, firwin
from scipy.signal.windows import hann, tukey

from clsim import ClsimWarning, InputError, Signal
from clsim.scene.signal.occupied_bandwidth import spectra
from clsim.scene.signal.waveforms import binary_sequence

RATE = 192e3
PULSE = Signal.chirp(39e3, 41e3, 1e-3, RATE, window="hann")
SIGNALS = {
    "tone": Signal.tone(40e3, 0.2, RATE, fade=0.01),
    "linear": Signal.chirp(20e3, 80e3, 0.2, RATE),
    "exponential": Signal.chirp(20e3, 80e3, 0.2, RATE, method="exponential", window="tukey"),
    "pulses": Signal.pulses(PULSE, 0.05, 4),
    "white": Signal.noise(0.2, RATE, seed=3),
    "band": Signal.noise(0.2, RATE, seed=3, band=(30e3, 50e3)),
    "faded": Signal.noise(0.2, RATE, seed=3, band=(30e3, 50e3), fade=0.03),
    "faded chirp": Signal.chirp(20e3, 80e3, 0.2, RATE, fade=0.03),
    "sequence": Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, bits=7),
    "array": Signal.from_array(np.arange(1.0, 9000.0), RATE, scale=0.1),
    "faster": Signal.from_array(np.arange(1.0, 9000.0), 44_100, scale=0.1).at_rate(RATE),
    "slower": Signal.from_array(np.arange(1.0, 9000.0), 250e3, scale=0.1).at_rate(RATE),
}


@pytest.mark.parametrize("signal", SIGNALS.values(), ids=SIGNALS)
def test_reads_the_same_however_it_is_cut(signal: Signal, rng: np.random.Generator) -> None:
    whole = signal.read(-100, signal.count + 100)
    assert not np.any(whole[:100])
    assert not np.any(whole[-100:])
    assert np.any(whole)
    for _ in range(20):
        start, stop = np.sort(rng.integers(-100, signal.count + 100, 2))
        np.testing.assert_array_equal(signal.read(start, stop), whole[start + 100 : stop + 100])


@pytest.mark.parametrize("n", [0, 4095, 1_000_000_007])
def test_tone_keeps_its_phase_after_hours(n: int) -> None:
    tone = Signal.tone(40_123.4, 6000.0, RATE, phase=0.3)
    cycles = float(n * Fraction(40_123.4) / 192_000 % 1)
    # A block of 4096 samples counts its own cycles: 4096 * 0.21 of them, each rounded to 2^-53, times 2 pi: 6e-13.
    assert tone.read(n, n + 1)[0] == pytest.approx(np.sin(2 * np.pi * cycles + 0.3), abs=1e-12)


def test_chirp_sweeps_as_stated() -> None:
    chirp = Signal.chirp(20e3, 80e3, 0.1, 1e6)
    phase = np.unwrap(
        np.angle(np.fft.ifft(np.where(np.fft.fftfreq(chirp.count) > 0, 2, 0) * np.fft.fft(chirp.read(0, chirp.count))))
    )
    frequency = np.diff(phase) * 1e6 / (2 * np.pi)
    at = np.arange(20_000, 80_000, 1000)
    np.testing.assert_allclose(frequency[at], 20e3 + 60e3 * (at + 0.5) / 1e5, rtol=2e-3)


@pytest.mark.parametrize("method", ["linear", "exponential"])
@pytest.mark.parametrize("n", [1, 57_000_000, 115_199_900])
def test_chirp_keeps_its_phase_after_minutes(method: str, n: int) -> None:
    chirp = Signal.chirp(20e3, 80e3, 600.0, RATE, method=method)
    with localcontext(prec=50):
        t = Decimal(n) / 192_000
        if method == "linear":
            cycles = t * (20_000 + Decimal(60_000) / 1200 * t)
        else:
            cycles = 20_000 * 600 / Decimal(4).ln() * (Decimal(4) ** (t / 600) - 1)
        expected = np.sin(2 * np.pi * float(cycles % 1))
    # Up to 3e7 cycles, a few roundings to 2^-53 of them each, times 2 pi.
    assert chirp.read(n, n + 1)[0] == pytest.approx(expected, abs=2 * np.pi * 8 * 3e7 * 2**-53)


@pytest.mark.parametrize(("window", "expected"), [("hann", hann(1921)), ("tukey", tukey(1921, 0.2))])
def test_windows_of_a_chirp(window: str, expected: np.ndarray) -> None:
    plain, shaped = (Signal.chirp(20e3, 80e3, 0.01, RATE, window=w).read(0, 1920) for w in ("none", window))
    np.testing.assert_allclose(shaped, plain * expected[:-1], rtol=0, atol=1e-14)


def test_train_is_its_pulse_in_every_period() -> None:
    train = Signal.pulses(PULSE, 0.002, 50)
    expected = np.tile(np.pad(PULSE.read(0, 192), (0, 192)), 50)[:-192]
    assert train.count == len(expected)
    np.testing.assert_array_equal(train.read(0, train.count), expected)


@pytest.mark.parametrize(
    "signal",
    [
        Signal.tone(40e3, 600.0, RATE, fade=1.0), Signal.chirp(20e3, 80e3, 600.0, RATE, window="hann"),
        Signal.pulses(PULSE, 0.1, 6000), Signal.noise(600.0, RATE, seed=1, band=(30e3, 50e3)),
    ],
    ids=["tone", "chirp", "pulses", "noise"],
)  # fmt: skip
def test_ten_minutes_are_never_held_whole(signal: Signal) -> None:
    tracemalloc.start()
    signal.read(50_000_000, 50_065_536)
    signal.energy_spectrum()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A block is 0.5 MB and some copies of it; the whole would be 920 MB. scipy's modules may be loaded here first.
    assert peak < 50e6


def test_noise_has_its_level_band_and_seed() -> None:
    noise = Signal.noise(1.0, RATE, seed=1, band=(30e3, 50e3), rms=2.0)
    samples = noise.read(0, noise.count)
    # 192 000 samples of which a fifth are independent: the deviation of the rms is 0.4 %; five of them.
    assert np.sqrt(np.mean(samples**2)) == pytest.approx(2.0, rel=0.02)
    frequencies, energy = noise.energy_spectrum()
    outside = energy[(frequencies < 28e3) | (frequencies > 52e3)].sum() / energy.sum()
    # Beginning and end are cut sharply: each spreads 1 / (4 pi^2 * 2 kHz * 1 s) of the energy beyond 2 kHz, twice.
    assert outside < 2 * 2 / (4 * np.pi**2 * 2e3)
    assert not np.array_equal(samples, Signal.noise(1.0, RATE, seed=2, band=(30e3, 50e3), rms=2.0).read(0, noise.count))


def test_band_noise_is_its_filter_applied_to_white_noise() -> None:
    low, high = 30e3, 50e3
    white, band = (Signal.noise(0.1, RATE, seed=5, band=b) for b in (None, (low, high)))
    taps = firwin(769, [low, high], window=("kaiser", 12.3), pass_zero=False, fs=RATE)
    expected = np.convolve(white.read(0, white.count), taps / np.linalg.norm(taps), mode="valid")
    # Two ways of summing 769 products of order one in float64.
    np.testing.assert_allclose(band.read(384, band.count - 384), expected, rtol=0, atol=1e-13)


def test_band_noise_is_120_db_down_beside_its_band() -> None:
    """Half a hundredth of the sampling rate beside the band; the window leaks -150 dB there."""
    samples = Signal.noise(0.5, RATE, seed=3, band=(30e3, 50e3)).read(0, 96_000)
    energy = np.abs(np.fft.rfft(samples * np.kaiser(len(samples), 20.0))) ** 2
    frequencies = np.fft.rfftfreq(len(samples), 1 / RATE)
    beside = (frequencies < 29e3) | (frequencies > 51e3)
    assert energy[beside].max() < 10 ** (-118 / 10) * energy[~beside].max()


def test_white_noise_is_white_and_gaussian() -> None:
    samples = Signal.noise(1.0, RATE, seed=7).read(0, 192_000)
    deviation = 1 / np.sqrt(192_000)
    auto = np.fft.irfft(np.abs(np.fft.rfft(samples)) ** 2)[1:96_000] / 192_000
    assert abs(samples.mean()) < 5 * deviation
    assert np.abs(auto).max() < 6.5 * deviation  # the largest of 96 000: 4.4 expected, 6.5 by a chance of 1e-5
    assert np.mean(samples**4) == pytest.approx(3.0, abs=5 * np.sqrt(96) * deviation)


def test_spectrum_of_a_long_train_holds_its_energy() -> None:
    train = Signal.pulses(PULSE, 0.1, 6000)
    _, energy = train.energy_spectrum()
    # Hann windows at half overlap: squares sum to 3/4; half of the spectrum is negative frequencies.
    expected = 0.5 * 0.75 * 6000 * np.sum(PULSE.read(0, PULSE.count) ** 2)
    # 200 of the segments, of which 0.43 meet a pulse: a deviation of 10 %.
    assert energy.sum() == pytest.approx(expected, rel=0.3)


def test_spectrum_of_a_short_pulse_holds_its_energy() -> None:
    _, energy = PULSE.energy_spectrum()
    expected = 0.5 * 0.75 * np.sum(PULSE.read(0, PULSE.count) ** 2)
    # cos^4 + sin^4 of a short pulse's place in the windows is 3/4 on average, at least 1/2 and at most 1.
    assert expected / 1.5 < energy.sum() < expected / 0.75 * 1.001


@pytest.mark.parametrize("rate", [RATE, 96e3], ids=["in windows as long", "in others"])
def test_both_spectra_of_a_signal_are_those_of_either(rate: float) -> None:
    # 12 s: segments are picked at 192 kHz; most windows are silent.
    train = Signal.pulses(Signal.chirp(20e3, 40e3, 0.005, rate), 0.2, 60)
    sound, spectrum = spectra(train)
    for got, expected in zip(spectrum(), train.energy_spectrum(), strict=True):
        np.testing.assert_array_equal(got, expected)
    assert (len(sound.frequencies) == len(spectrum()[0])) == (rate == RATE)


def test_a_band_from_next_to_0_hz_on_has_the_energy_at_0_hz() -> None:
    """The bin at 0 Hz stands for all frequencies up to half a bin: filters would be free there without it."""
    hum, _ = spectra(Signal.from_array(np.hanning(800), 16e3))
    points = np.linspace(0.02, 8e3, 2000)
    assert hum.energy[:, 0].max() > 0.1
    np.testing.assert_allclose(hum.near(points, 0.02, 8e3).sum(axis=1), hum.energy.sum(axis=1), rtol=1e-9)


def test_centre_frequency() -> None:
    assert SIGNALS["tone"].centre_frequency == 40e3
    assert SIGNALS["linear"].centre_frequency == 50e3
    assert SIGNALS["pulses"].centre_frequency == 40e3
    assert SIGNALS["band"].centre_frequency == 40e3
    assert SIGNALS["sequence"].centre_frequency == 40e3
    tone = Signal.tone(30e3, 0.2, RATE, fade=0.05)
    copied = Signal.from_array(tone.read(0, tone.count), RATE)
    assert copied.centre_frequency == pytest.approx(30e3, rel=1e-6)
    assert copied.at_rate(96e3).centre_frequency == copied.centre_frequency
    assert Signal.from_array(np.zeros(10), RATE).centre_frequency == 0.25 * RATE


@pytest.mark.parametrize("name", ["tone", "linear", "exponential", "pulses"])
def test_another_rate_evaluates_the_formula_anew(name: str) -> None:
    signal = SIGNALS[name]
    doubled = signal.at_rate(2 * RATE)
    assert doubled.sampling_rate == 2 * RATE
    # The phase at the same time, rounded: up to 0.2 s * 80 kHz cycles of 2^-53 each, a few times.
    np.testing.assert_allclose(doubled.read(0, doubled.count)[::2], signal.read(0, signal.count), rtol=0, atol=1e-10)


def test_sequence_at_another_rate_is_the_sequence_made_there() -> None:
    there = Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=500e3, bits=7)
    moved = SIGNALS["sequence"].at_rate(500e3)
    np.testing.assert_array_equal(moved.read(0, moved.count), there.read(0, there.count))


def test_rates_that_do_not_fit_are_refused() -> None:
    for name in ("tone", "linear", "pulses", "band", "sequence"):
        with pytest.raises(InputError, match=r"^sampling_rate: must be above \d+ Hz, twice the signal's"):
            SIGNALS[name].at_rate(48e3)
    for rate in (0.0, float("nan"), "fast"):
        with pytest.raises(InputError, match=r"^sampling_rate: must be"):
            SIGNALS["white"].at_rate(rate)
    with pytest.raises(InputError, match="simple multiple"):
        SIGNALS["array"].at_rate(192e3 * np.pi / 3)


@pytest.mark.parametrize("bits", [5, 6, 7, 9, 10, 11])
def test_gold_sequences_have_three_valued_correlations(bits: int) -> None:
    length = 2**bits - 1
    bound = 2 ** ((bits + 2) // 2) + 1
    for a, b in ((0, 1), (2, 7), (3, length + 1)):
        first, second = binary_sequence("gold", bits, a), binary_sequence("gold", bits, b)
        cross = np.rint(np.fft.ifft(np.fft.fft(first) * np.conj(np.fft.fft(second))).real)
        assert set(cross) <= {-1.0, -float(bound), float(bound - 2)}


def test_maximum_length_sequence_has_two_valued_autocorrelation() -> None:
    chips = binary_sequence("mls", 9, 5)
    auto = np.rint(np.fft.ifft(np.abs(np.fft.fft(chips)) ** 2).real)
    assert auto[0] == 511
    assert set(auto[1:]) == {-1.0}


def test_sequence_stays_in_its_band_and_correlates_sharply() -> None:
    signal = Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, bits=9, rolloff=0.5)
    frequencies, energy = signal.energy_spectrum()
    assert energy[np.abs(frequencies - 40e3) > 6.3e3].sum() / energy.sum() < 1e-5
    samples = signal.read(0, signal.count)
    auto = np.abs(correlate(samples, samples, method="fft"))
    peak = auto.argmax()
    far = np.r_[auto[: peak - 200], auto[peak + 200 :]]
    assert far.max() < 0.15 * auto[peak]  # aperiodic side lobes of 511 chips: below 3 / sqrt(511)


def test_chips_stand_at_their_centres() -> None:
    signal = Signal.sequence(kind="gold", code=9, bits=5, carrier=40e3, chip_rate=8e3, sampling_rate=RATE, amplitude=2)
    # 24 samples and 5 cycles a chip, the first one 16 chips after the beginning: the carrier is 1 there.
    np.testing.assert_allclose(
        signal.read(16 * 24, (16 + 31) * 24)[::24], 2 * binary_sequence("gold", 5, 9), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Signal.tone(96e3, 1.0, RATE), "frequency"),
        (lambda: Signal.tone(float("nan"), 1.0, RATE), "frequency"),
        (lambda: Signal.tone(40e3, 0.0, RATE), "duration"),
        (lambda: Signal.tone(40e3, 1.0, -1), "sampling_rate"),
        (lambda: Signal.tone(40e3, 1.0, RATE, fade=0.6), "fade"),
        (lambda: Signal.chirp(1e3, 2e3, 1.0, RATE, window="box"), "window"),
        (lambda: Signal.chirp(1e3, 2e3, 1.0, RATE, window="hann", fade=0.1), "fade: must be left out with a window"),
        (lambda: Signal.chirp(1e3, 2e3, 1.0, RATE, fade=0.51), "fade: must be at most 0.5 s"),
        (lambda: Signal.noise(1.0, RATE, seed=1, fade=-0.1), "fade: must be at least 0 s"),
        (
            lambda: Signal(np.zeros(9), RATE),
            r"waveform: .* is ndarray; samples are taken by Signal\.from_array\(samples",
        ),
        (lambda: Signal(Signal.tone(1e3, 0.1, RATE), RATE), "waveform: must be a waveform, but is Signal"),
        (lambda: Signal.from_array(np.zeros(9, dtype=np.int16), RATE), r"scale: must be given for integers \(int16\)"),
        (lambda: Signal.from_array([0, 1, 0], RATE), r"scale: must be given for integers \(int64\)"),
        (lambda: Signal.from_array([0.0, 1e12], RATE, scale=2.0), r"samples\[1\]: must be within 1e\+12 Pa"),
        (lambda: Signal.noise(1.0, RATE, seed=-1), "seed"),
        (lambda: Signal.noise(1.0, RATE, seed=2**64), "seed"),
        (lambda: Signal.noise(1.0, RATE, seed=1, band=(5e3, 4e3)), r"band\[1\]"),
        (lambda: Signal.sequence(carrier=1e3, chip_rate=8e3, sampling_rate=RATE), "carrier"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, kind="gold", bits=8), "bits"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, kind="gold", bits=[5]), "bits"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, bits=10**12), "bits"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=RATE, bits=5, code=31), "code"),
        (lambda: Signal.pulses(PULSE, 0.5e-3, 3), "period"),
        (lambda: Signal.pulses(PULSE, 0.1 - 2e-6, 3), r"period: must be a whole number of samples.*0\.09999"),
        (lambda: Signal.pulses(PULSE, 0.1, 0), "count"),
        (lambda: Signal.pulses(Signal.pulses(PULSE, 0.1, 2), 1.0, 2), "pulse"),
        (lambda: Signal.from_array([1.0, float("inf")], RATE), r"samples\[1\]"),
        (lambda: Signal.from_array([], RATE), "samples"),
        (lambda: Signal.from_array(np.array([True, False]), RATE), "samples: must be numbers, but are true and false"),
        (lambda: Signal.from_array(np.array([0.0, 1.0]), RATE, scale=0.0), "scale: must not be 0"),
        (lambda: Signal.from_array(np.exp(1j * np.arange(9.0)), 48e3), "samples: must be real, but is complex128$"),
    ],
)
def test_bad_input_names_the_field(make, field: str) -> None:
    with pytest.raises(InputError, match=f"^{field}"):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda fade: Signal.tone(40e3, 0.02, RATE, amplitude=3.0, phase=0.5 * np.pi, fade=fade),
        lambda fade: Signal.chirp(20e3, 80e3, 0.02, RATE, fade=fade),
        lambda fade: Signal.noise(0.02, RATE, seed=3, fade=fade),
        lambda fade: Signal.noise(0.02, RATE, seed=3, band=(30e3, 50e3), fade=fade),
    ],
)
def test_fades_are_raised_cosines_at_both_ends(make) -> None:
    whole, fade = make(0.0), 0.005
    t = np.arange(whole.count) / RATE
    rise = np.minimum(np.minimum(t, 0.02 - t) / fade, 1.0)
    wanted = whole.read(0, whole.count) * 0.5 * (1.0 - np.cos(np.pi * rise))
    np.testing.assert_allclose(make(fade).read(0, whole.count), wanted, rtol=0, atol=1e-13)


def test_faded_noise_stays_in_its_band() -> None:
    """Abrupt ends sound over all frequencies; a fade of 5 ms is 80 dB down 4 kHz off the band's filter."""
    outside = []
    for fade in (0.0, 5e-3):
        signal = Signal.noise(0.05, RATE, seed=1, band=(30e3, 50e3), fade=fade)
        energy = np.abs(np.fft.rfft(signal.read(-1000, signal.count + 1000))) ** 2
        frequencies = np.fft.rfftfreq(signal.count + 2000, 1.0 / RATE)
        outside.append(10.0 * np.log10(energy[frequencies < 25e3].sum() / energy.sum()))
    assert outside[1] < -75.0 < outside[0] + 30.0


def test_loud_samples_are_questioned(tmp_path: Path) -> None:
    loud = np.array([0.0, 3000.0, -3000.0])  # 160.5 dB SPL as a tone of that peak
    with pytest.warns(
        ClsimWarning,
        match=r"^samples: gives samples of up to 3000: without a transducer Pa, .* 161 dB SPL at 1 m, with one the volts",
    ):
        Signal.from_array(loud, RATE)
    Signal.from_array(0.9 * loud, RATE)  # 159.6 dB; warnings are errors
    steps = np.array([0, 16384, -32768], dtype=np.int16)
    np.testing.assert_array_equal(Signal.from_array(steps, RATE, scale=2.0**-15).read(0, 3), [0.0, 0.5, -1.0])
    with pytest.warns(ClsimWarning, match="^samples: gives samples of up to 32768: "):
        Signal.from_array(steps, RATE, scale=1.0)
    soundfile.write(tmp_path / "a.wav", np.array([0.0, 0.5]), 48000, subtype="FLOAT")
    with pytest.warns(ClsimWarning, match="^scale: gives samples of up to 16384: "):
        Signal.from_wav(tmp_path / "a.wav", scale=32768.0)


@pytest.mark.parametrize(
    ("field", "make"),
    [
        ("amplitude", lambda level: Signal.tone(1e3, 0.01, RATE, amplitude=-level)),
        ("amplitude", lambda level: Signal.chirp(1e3, 2e3, 0.01, RATE, amplitude=level)),
        (
            "amplitude",
            lambda level: Signal.sequence(carrier=4e3, chip_rate=1e3, sampling_rate=RATE, bits=5, amplitude=level),
        ),
        ("rms", lambda level: Signal.noise(0.01, RATE, seed=1, rms=level / np.sqrt(2.0))),
    ],
)
def test_loud_amplitudes_are_questioned(field: str, make: Callable[[float], Signal]) -> None:
    """160 dB SPL is a root mean square of 2000 Pa."""
    with pytest.warns(ClsimWarning, match=f"^{field}: .* 160 dB SPL at 1 m"):
        make(2829.0)
    make(2828.0)  # warnings are errors


def test_sound_whose_squares_are_zero_is_silence() -> None:
    """Energies of windows are relative to their level, which no number tells from 0 there."""
    faint, silent = (Signal.tone(16e3, 0.01, RATE, amplitude=a) for a in (1e-300, 0.0))
    for found, expected in zip(faint.short_time_spectra(), silent.short_time_spectra(), strict=True):
        np.testing.assert_array_equal(found, expected)
