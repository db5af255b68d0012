"""Tapers: against the integral of Kaiser's window, what is taken and left adds up to all of it, and nodes hold them."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import i0

from clsim.render.channel_grid import NODES, OVERSAMPLING, node_window
from clsim.tracks.splines import REACH, Pieces, audible, taper

TRANSITION, UNTIL = 1e-3, 2.0


def test_a_taper_is_the_integral_of_kaisers_window() -> None:
    whole, _ = quad(lambda x: i0(9.0 * np.sqrt(1.0 - x * x)), -1.0, 1.0)
    for place in (-0.9, -0.4, 0.0, 0.2, 0.7):
        part, _ = quad(lambda x: i0(9.0 * np.sqrt(1.0 - x * x)), -1.0, place)
        # The series ends early: its next term is (b^2 / 4)^11 / 11!^2 of the window's middle, 1e-4 of it.
        assert taper(np.array([place]))[0] == pytest.approx(part / whole, abs=2e-5)
    np.testing.assert_array_equal(taper(np.array([-2.0, -1.0, 1.0, 3.0])), [0.0, 0.0, 1.0, 1.0])


@pytest.mark.parametrize("transition", [0.0, TRANSITION])
def test_what_is_taken_and_what_is_left_is_all_of_it(transition: float, rng: np.random.Generator) -> None:
    count, length = 60, 0.1
    start, end = np.sort(rng.uniform(-0.5, UNTIL + 0.5, (2, count)), axis=0)
    start[:20], end[10:30] = -np.inf, np.inf
    cuts = np.sort(rng.uniform(0.0, UNTIL, (count, 2)), axis=1)
    apart = rng.random(count) < 0.2
    taken, left = Pieces.of(start, end, cuts, UNTIL).handed_over(apart, length, transition)
    times = np.arange(0.0, UNTIL, 1e-3 / 7)
    total = np.zeros((count, len(times)))
    np.add.at(total, taken.rows, taken.tapers.weights(times))
    sudden = audible(times, left.start, left.end, transition)
    sudden = np.where(left.tapers.weights(times) > 0.0, sudden, 0.0)
    np.add.at(total, left.rows, sudden * left.tapers.weights(times))
    assert 0 < len(taken) < len(left)
    assert not np.any(apart[taken.rows])
    # The weights of tapers end in a tip of 1e-6, half a transition before that of the engine does.
    np.testing.assert_allclose(total, audible(times, start, end, transition), atol=2e-5)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_nodes_hold_a_path_that_begins(share: float) -> None:
    """Its phase turns as fast as Doppler shifts let it, by some of the band that nodes hold; the taper has the rest."""
    spacing = 40
    band = 1.0 / (2.0 * OVERSAMPLING * spacing)  # cycles a sample
    shift, length = share * band, REACH / ((1.0 - share) * band)
    reach = int(0.5 * length / spacing) + 2 * NODES
    nodes = np.arange(-reach, reach + 1)

    def path(at: np.ndarray) -> np.ndarray:
        return taper(2.0 * at / length) * np.exp(2j * np.pi * shift * at)

    within = np.arange(-(reach - NODES) * spacing, (reach - NODES) * spacing)
    away = within[:, None] - nodes * spacing
    window = node_window(spacing)
    weights = np.where(
        np.abs(away) < NODES * spacing, window[np.clip(away + NODES * spacing - 1, 0, len(window) - 1)], 0.0
    )
    wrong_db = 20.0 * np.log10(np.abs(weights @ path(nodes * spacing) - path(within)).max())
    assert -110.0 < wrong_db < -84.0  # of the path, at its worst instant; measured -85.6 to -89.6
