"""Lagrange banks up to their largest order, against exact rational arithmetic."""

from fractions import Fraction
from math import prod

import numpy as np
import pytest

import clsim
from clsim.numerics.fractional_delay import bank_error, design_bandlimited, design_tilted, lagrange_bank

RATE = 192e3


@pytest.mark.parametrize("order", [12, 31, 32, 39, 40])
def test_lagrange_banks_are_exact(order: int) -> None:
    bank = lagrange_bank(order)
    for mu in (Fraction(0), Fraction(13, 100), Fraction(-1, 2), Fraction(52, 100), Fraction(-3, 2)):
        at = mu + Fraction(order, 2)
        nodes = range(order + 1)
        exact = [float(prod((at - j) / Fraction(k - j) for j in nodes if j != k)) for k in nodes]
        found = float(mu) ** np.arange(order + 1.0) @ bank
        # Rounding of some 40 products each of a few units: measured 1.0e-15, where the largest tap is 1.
        np.testing.assert_allclose(found, exact, rtol=0, atol=2e-15)


def test_order_40_is_the_largest() -> None:
    assert clsim.TruncatedLagrange(40, 33).length == 33
    for kind in (clsim.Lagrange, lambda order: clsim.TruncatedLagrange(order, 2 + order % 2)):
        with pytest.raises(clsim.InputError, match="from 1 to 40"):
            kind(41)


def test_float32_renders_order_40_as_well_as_float64(engine: str, measured) -> None:
    """60 kHz at 192 kHz and 20 m/s: -82.1 dB is the polynomial's own error, in both engines."""
    tone = clsim.Signal.tone(60e3, 0.04, RATE, fade=0.004)
    source = clsim.Source("s", tone, clsim.Trajectory.line((2, 3, 1), (3, 3, 1), 0.05))
    room = clsim.Shoebox((10, 8, 6), clsim.Material.from_reflection(0.9))
    scene = clsim.Scene(
        room, clsim.Air(speed_of_sound=343.0), [source], [clsim.Receiver("r", clsim.Trajectory.fixed((5, 5, 4)))]
    )
    paths = clsim.find_paths(scene, 0)
    made = clsim.render(
        paths, RATE, interpolator=clsim.Lagrange(40), responses="centre", engine=engine, duration=0.03
    ).pressure[0]
    some = np.arange(4000, 5700)
    table = paths.table(some / RATE)
    exact = table.gain[0] * np.sin(2 * np.pi * 60e3 * (some / RATE - table.delay[0]))
    error = np.linalg.norm(made[some] - exact) / np.linalg.norm(exact)
    found = measured("Lagrange filters of order 40, their own error", "closed form", 20 * np.log10(error), -81.6)
    assert found == pytest.approx(-82.1, abs=0.5)


@pytest.mark.parametrize(
    ("cutoff", "mu_max", "nu_max", "importance"),
    [(2.28, 0.69, 0.2, (1.0,)), (1.5, 0.6, 0.4, (0.01,)), (2.7, 0.65, 0.2, (1.0, 1.0, 1.0, 0.01))],
)
def test_banks_hold_complex_delays(cutoff: float, mu_max: float, nu_max: float, importance: tuple[float, ...]) -> None:
    taps, reached_db = design_tilted(-90.0, cutoff, mu_max, nu_max, importance)
    rng, half = np.random.default_rng(1), taps.shape[1] // 2
    delay = mu_max * rng.uniform(-1.0, 1.0, 400) - 1j * nu_max * rng.uniform(-1.0, 1.0, 400)
    w = cutoff * rng.uniform(-1.0, 1.0, 400)
    got = np.vander(delay, len(taps), increasing=True) @ taps
    wrong = np.abs(
        np.sum(got * np.exp(-1j * np.outer(w, np.arange(-half, half + 1))), axis=1) - np.exp(-1j * w * delay)
    )
    weighted = wrong * np.array(importance)[(np.abs(w) / cutoff * len(importance)).astype(int)]
    assert reached_db <= -90.0
    assert 20.0 * np.log10(weighted.max()) <= reached_db + 0.2  # between the frequencies of the design
    assert design_tilted(-90.0, cutoff, mu_max, 0.5 * nu_max, importance)[0].shape[0] <= len(taps)
    if len(importance) > 1:  # weak ends take shorter filters
        assert taps.shape[1] < design_tilted(-90.0, cutoff, mu_max, nu_max)[0].shape[1]


@pytest.mark.parametrize("cutoff", [0.3, 1.6, 2.2, 2.98])
@pytest.mark.parametrize("mu_max", [0.55, 1.5])
@pytest.mark.parametrize("error_db", [-60.0, -90.0, -105.0])
def test_banks_are_as_good_as_told_at_frequencies_between(cutoff: float, mu_max: float, error_db: float) -> None:
    """Errors at 4001 frequencies and 41 delays, which are not those of the design."""
    taps, told = design_bandlimited(error_db, cutoff, mu_max)
    w, mu = np.linspace(0.0, cutoff, 4001), np.linspace(-mu_max, mu_max, 41)
    responses = np.exp(-1j * np.outer(w, np.arange(taps.shape[1]) - taps.shape[1] // 2)) @ taps.T
    made = sum(np.outer(responses[:, q], mu**q) for q in range(len(taps)))
    reached = 20.0 * np.log10(np.abs(made - np.exp(-1j * np.outer(w, mu))).max())
    assert told <= error_db
    assert reached <= told + 0.5
    centre = taps.shape[1] // 2
    assert 20.0 * np.log10(bank_error(taps, centre, 0.0, cutoff, mu_max)) == pytest.approx(told, abs=1e-6)
