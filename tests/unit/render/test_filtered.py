"""Signals through filters: with pauses and without, wherever these lie."""

import numpy as np
import pytest

from clsim.render.source_filters import filtered


@pytest.mark.parametrize("half", [0, 1, 5, 16])
def test_what_no_sound_reaches_is_silent_and_the_rest_is_convolved(half: int, rng: np.random.Generator) -> None:
    """Pauses about as long as the filters, at the beginning, the end, and within."""
    filters, length = rng.standard_normal((2, 2 * half + 1)), 2 * half
    for begin in (0, 1, half, 97, 200 - length, 199):
        for pause in (0, 1, half, half + 1, length, length + 1, length + 2, length + 3, 3 * length + 9):
            samples = rng.standard_normal(200 + length) + 5.0
            samples[begin : begin + pause] = 0.0
            places, values = filtered(lambda a, b, s=samples: s[a + half : b + half], filters, 0, 200)
            wanted = np.stack([np.convolve(samples, taps, "valid") for taps in filters])
            got = np.zeros_like(wanted)
            got[:, places] = values
            np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-12)
            reached = np.convolve(samples != 0.0, np.ones(length + 1), "valid") > 0.5
            np.testing.assert_array_equal(places, np.flatnonzero(reached))
    assert not len(filtered(lambda a, b: np.zeros(b - a), filters, 0, 50)[0])
