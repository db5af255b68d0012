"""Convolution by blocks: that of SciPy, to the last bit, and by its definition."""

import numpy as np
import pytest

from clsim.numerics.convolution import convolved


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
