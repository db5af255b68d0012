"""Filters for responses over a band: their equations against dense ones, and what they reach."""

import math

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from clsim.numerics import band_filters as module
from clsim.numerics.band_filters import band_filters, chebyshev_points, magnitudes


@pytest.mark.parametrize("count", [9, 255, 257, 1201], ids=["short", "factored", "by recursion", "long"])
def test_toeplitz_equations_are_solved(count: int, rng: np.random.Generator) -> None:
    """Weights of 1 up to 0.7 of the frequencies, and 1e-8 beyond, as those of filters."""
    w = np.linspace(0.0, math.pi, 8 * count)
    column = np.cos(np.outer(np.arange(count), w)) @ np.where(w < 0.7 * math.pi, 1.0, 1e-8)
    matrix = column[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))]
    wanted = rng.standard_normal((3, count)) @ matrix
    found = module._of_toeplitz(column, wanted)
    assert np.abs(found @ matrix - wanted).max() < 1e-11 * np.abs(wanted).max()


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("edges", [(0.0, 2.9), (0.9, 1.3)], ids=["wide", "narrow"])
@pytest.mark.parametrize("half", [5, 40, 63])
def test_equations_of_all_lengths_are_least_squares(edges: tuple[float, float], half: int, turns: bool) -> None:
    """Taps against a dense solution at the frequencies of the sums."""
    band, at = np.array(edges), []

    def wanted_at(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = (w >= band[0]) & (w <= band[1])
        wanted = np.stack([np.cos(1.5 * w), 1.0 / (1.0 + w)]) * (np.exp(0.3j * w) if turns else 1.0)
        at.append((w, np.where(inside, 1.0, 1e-8), wanted))
        return at[-1][1], wanted

    even, odd = module._Fit.of(wanted_at, band, 63).solved(half)
    w, square, wanted = (np.concatenate(some, axis=-1) for some in zip(*at, strict=True))
    columns = [np.cos(np.outer(w, np.arange(half + 1)))]
    if turns:
        columns = [np.concatenate([columns[0], np.zeros((len(w), half))], axis=1)]
        columns.append(
            np.concatenate([np.zeros((len(w), half + 1)), np.sin(np.outer(w, np.arange(1, half + 1)))], axis=1)
        )
    parts = [wanted.real, wanted.imag][: len(columns)]
    system = np.concatenate(columns) * np.sqrt(np.tile(square, len(columns)))[:, None]
    solved = np.linalg.lstsq(system, (np.concatenate(parts, axis=1) * np.sqrt(np.tile(square, len(columns)))).T)[0].T
    weights = np.sqrt(square)
    for of_all, found in zip(solved, np.concatenate([even, odd], axis=1)[:, : solved.shape[1]], strict=True):
        left = (columns[0] @ of_all - columns[0] @ found) * weights
        assert np.abs(left).max() < 1e-5


def test_filters_have_the_response_that_is_wanted() -> None:
    """A kink asks for long filters: the error that is told is that of the taps, at frequencies of their own."""
    low, high, rate, count = 100.0, 7000.0, 16e3, 387
    points = chebyshev_points(low, high, count)

    def wanted(f: np.ndarray) -> np.ndarray:
        return 0.5 + np.minimum(np.abs(f - 900.0), 400.0) / 4e3

    coefficients = chebyshev.chebfit((2.0 * points - high - low) / (high - low), wanted(points), count - 1)[None]
    made = band_filters(coefficients, low, high, rate, np.ones(count), lambda left: float(left.max()), 1e-3)
    f = np.linspace(low, high, 5001)
    half = made.taps.shape[1] // 2
    response = np.cos(2.0 * math.pi / rate * np.outer(f, np.arange(-half, half + 1))) @ made.taps[0]
    given = chebyshev.chebval((2.0 * f - high - low) / (high - low), coefficients[0])
    assert 20.0 * math.log10(np.abs(response - given).max()) <= made.error_db + 0.5
    assert -75.0 < made.error_db <= -60.0
    np.testing.assert_allclose(made.taps, made.taps[:, ::-1], atol=1e-12)  # nothing is shifted


@pytest.mark.parametrize("length", [17, 513, 1301])
def test_magnitudes_are_those_of_transforms(length: int, rng: np.random.Generator) -> None:
    taps, w = rng.standard_normal((2, length)), np.linspace(0.01, 3.0, 40)
    exact = np.abs(taps @ np.exp(-1j * np.outer(np.arange(length), w)))
    np.testing.assert_allclose(magnitudes(taps, w), exact, rtol=1e-10, atol=1e-10)
