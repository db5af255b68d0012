"""Filters by Kaiser's window: those of SciPy, to the last bit."""

import numpy as np
import pytest

from clsim.numerics.resampling import band_pass, length_of, low_pass, low_pass_between, shape_of


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
