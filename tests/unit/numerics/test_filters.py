"""Filters and convolutions against SciPy's, envelopes made sound, and the threads that compute them."""

import sys
from fractions import Fraction
from types import ModuleType

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from clsim.numerics.blas import blas_threads, with_blas_threads
from clsim.numerics.convolution import Upsampler, band_pass, convolved, length_of, low_pass, low_pass_between, shape_of


@pytest.mark.parametrize(
    ("count", "length"), [(1, 1), (50, 1), (40, 40), (60, 31), (9000, 31), (18432, 1501), (40001, 64)]
)
@pytest.mark.parametrize("kinds", ["ff", "fc", "cf"])
def test_it_is_scipys(rng, count: int, length: int, kinds: str) -> None:
    signal = pytest.importorskip("scipy.signal")
    sound, filters = rng.standard_normal(count), rng.standard_normal((3, length))
    sound = sound * 1j if kinds[0] == "c" else sound
    filters = filters + 1j if kinds[1] == "c" else filters
    made = convolved(sound, filters)
    assert made.shape == (3, count + length - 1)
    assert np.array_equal(made, signal.oaconvolve(sound[None], filters, axes=1))
    # Rounding in blocks of up to 2**15: some 1e-15 of the sum of all taps.
    expected = np.convolve(sound[:500], filters[1])[: min(count, 500)]
    assert np.allclose(made[1, : len(expected)], expected, rtol=0.0, atol=1e-13 * length)


RATE = 192e3


def sound_of(made: Upsampler, envelope: np.ndarray, first: int) -> np.ndarray:
    """Return the sound of one envelope from its sample `first` on."""
    sound = np.zeros((1, (len(envelope) - 2 * made.reach + 1) * made.every), dtype=np.float32)
    made.add(envelope[None], first, sound, 0)
    return sound[0]


@pytest.mark.parametrize(("carrier", "every", "half"), [(40e3, 40, 1.9e3), (25_003.7, 24, 3.2e3), (8e3, 9, 7e3)])
def test_tones_come_out_at_the_carriers_side(carrier: float, every: int, half: float, measured) -> None:
    """Within -110 dB anywhere in the band; a sign of the phase or a sample's shift is wrong by 0 dB."""
    made = Upsampler.about(carrier, RATE, every, half)
    first = 123_456_789  # late, for the carrier's phase
    at = np.arange(first + 1 - made.reach, first + 300 + made.reach)
    for away in (-half, -0.3 * half, 0.0, half):
        phase = 2.0 * np.pi * (away * every / RATE * (at - first) + 0.3)
        got = sound_of(made, np.exp(1j * phase), first)
        n = np.arange(300 * every)
        turned = float(Fraction(carrier) * every * first / Fraction(RATE) % 1)
        wanted = np.cos(2.0 * np.pi * (turned + (carrier + away) / RATE * n + 0.3))
        found = 20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
        measured("sound of envelopes", "closed form", found, -110.0)


def test_silence_stays_exact(rng: np.random.Generator) -> None:
    made = Upsampler.about(40e3, RATE, 40, 1.9e3)
    envelope = np.zeros(2000, dtype=np.complex64)
    envelope[1000:1010] = rng.normal(size=10) + 1j * rng.normal(size=10)
    got = sound_of(made, envelope, 0)
    sounding = np.flatnonzero(got) // 40 + made.reach - 1  # by samples of the envelope
    assert 1000 - made.reach <= sounding.min() < 1000
    assert 1009 < sounding.max() <= 1010 + made.reach


def test_pieces_are_parts_of_the_whole(rng: np.random.Generator) -> None:
    made = Upsampler.about(40e3, RATE, 40, 1.9e3)
    envelope = rng.normal(size=1500) + 1j * rng.normal(size=1500)
    whole = sound_of(made, envelope, 70)
    part = sound_of(made, envelope[300 : 700 + 2 * made.reach], 370)
    np.testing.assert_allclose(part, whole[300 * 40 :][: len(part)], atol=1e-5)


def told() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_threads_are_bounded_within_only() -> None:
    """The number of threads that threadpoolctl reports for NumPy's and SciPy's libraries now, not at the first look."""
    np.linalg.svd(np.eye(3))
    __import__("scipy.linalg")
    if max(told(), default=1) == 0:
        pytest.skip("no library of linear algebra is known")
    with threadpool_limits(2, "blas"):
        assert blas_threads() == max(told())
        before = told()
        with with_blas_threads(1):
            assert set(told()) == {1}
            assert blas_threads() == 1
        assert told() == before


def test_libraries_are_looked_for_again_when_modules_were_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    from clsim.numerics import blas as module

    first = module._libraries(len(sys.modules))
    assert module._libraries(len(sys.modules)) is first
    monkeypatch.setitem(sys.modules, "another", ModuleType("another"))
    assert module._libraries(len(sys.modules)) is not first


@pytest.mark.parametrize("ripple_db", [25.0, 49.0, 51.0, 115.0])
def test_lengths_and_shapes_are_scipys(ripple_db: float) -> None:
    signal = pytest.importorskip("scipy.signal")
    for width in (0.004, 0.07, 0.31):
        assert (length_of(width, ripple_db), shape_of(ripple_db)) == signal.kaiserord(ripple_db, width)


def test_filters_are_scipys(rng) -> None:
    signal = pytest.importorskip("scipy.signal")
    for cutoff, length, ripple_db in zip(
        rng.uniform(0.02, 0.98, 30), range(9, 900, 30), rng.uniform(25, 140, 30), strict=True
    ):
        window = ("kaiser", shape_of(ripple_db))
        assert np.array_equal(low_pass(cutoff, length, ripple_db), signal.firwin(length, cutoff, window=window))
        band = [0.5 * cutoff, cutoff]
        expected = signal.firwin(length, band, window=("kaiser", 8.0), pass_zero=False)
        assert np.array_equal(band_pass(*band, length, 8.0), expected)


def test_what_is_stopped_is_below_the_ripple() -> None:
    """And what is passed within it: 100 dB and 1e-5; a cut-off at the wrong end is wrong by 6 dB."""
    taps = low_pass_between(20e3, 26e3, 192e3, 100.0)
    assert len(taps) % 2 == 1
    gain = np.abs(np.fft.rfft(taps, 2**16))
    frequencies = np.fft.rfftfreq(2**16, 1 / 192e3)
    assert np.abs(gain[frequencies <= 20e3] - 1.0).max() < 1.3e-5
    assert gain[frequencies >= 26e3].max() < 1.3e-5
