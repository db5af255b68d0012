"""An interpolator of another kind: this file is all that both engines need."""

from dataclasses import dataclass

import numpy as np
import pytest

import clsim
from clsim.render.interpolator import SMALL_SUBBLOCK, Bank, Interpolator


@dataclass(frozen=True, slots=True)
class Linear(Interpolator):
    """Two taps, between which the delay lies."""

    def _bank(self, edge: float, max_rate: float, importance: tuple[float, ...]) -> Bank:
        mu_max = 0.52 + 0.5 * (SMALL_SUBBLOCK - 1) * max_rate
        return Bank(np.array([[0.5, 0.5], [-1.0, 1.0]]), 0, 0.5, edge, mu_max, SMALL_SUBBLOCK, -60.0)

    def _taps(self, bank: Bank, mu: np.ndarray) -> np.ndarray:
        return np.stack([0.5 - mu, 0.5 + mu], axis=1)


@pytest.mark.usefixtures("device")
def test_both_engines_render_with_it() -> None:
    rate, c = 48e3, 343.0
    tone = clsim.Signal.tone(200.0, 0.05, rate, fade=5e-3)
    line = clsim.Trajectory.line((1, 1, 1), (1.2, 1, 1), 0.1)
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((3, 1, 1)))
    room = clsim.Shoebox((5, 4, 3), clsim.Material.from_reflection(0.9))
    air = clsim.Air(speed_of_sound=c, absorption=False)
    paths = clsim.find_paths(clsim.Scene(room, air, [clsim.Source("s", tone, line)], [receiver]), 0)
    options = {"interpolator": Linear(), "responses": "centre", "duration": 0.06}
    fast, exact = (clsim.render(paths, rate, engine=e, **options).pressure[0] for e in ("opencl", "reference"))
    assert np.linalg.norm(fast - exact) < 1e-4 * np.linalg.norm(exact)
    usual = clsim.render(paths, rate, engine="reference", duration=0.06, responses="centre").pressure[0]
    assert 0.0 < np.linalg.norm(exact - usual) < 2e-3 * np.linalg.norm(usual)
