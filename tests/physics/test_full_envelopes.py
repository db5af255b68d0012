"""Envelopes whose rate their band almost fills, and delay filters that err more where a signal has little."""

import numpy as np
import pytest

import clsim
from clsim.render.plan import Plan
from clsim.scene.signal.occupied_bandwidth import CELLS, ShortTimeSpectra

RATE, TIME = 192e3, 4.0


def found(signal: clsim.Signal, order: int) -> clsim.PathSet:
    """Return the paths of a source at 6 m/s in a box."""
    way = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 1.0, TIME)
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))]
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, way)], ears), order)


def rate_of(plan: Plan) -> float:
    (part,) = plan.allocation.narrow
    return part.plan.sampling_rate


@pytest.mark.filterwarnings("ignore:signals.0.:clsim.ClsimWarning")
@pytest.mark.parametrize(
    "signal",
    [
        clsim.Signal.chirp(30e3, 50e3, TIME, RATE, window="tukey"),
        clsim.Signal.noise(TIME, RATE, 1, (20e3, 45e3)),
    ],
    ids=["chirp of 20 kHz", "noise of 25 kHz"],
)
def test_many_paths_take_lower_rates(signal: clsim.Signal, measured) -> None:
    """Against the sum of the sound itself at -110 dB: within the -86 dB of default settings."""
    options = {"sampling_rate": RATE, "duration": 0.2}
    few, many = (found(signal, order) for order in (1, 7))
    plan = clsim.plan_render(many, narrowband=True, **options)
    assert rate_of(plan) < rate_of(clsim.plan_render(few, narrowband=True, **options))
    (part,) = plan.allocation.narrow
    assert part.plan.baseband is not None
    assert part.plan.baseband.bandwidth > 0.8 * rate_of(plan)
    fine = {"interpolator": clsim.Bandlimited(-110.0), "response_error_db": -110.0, "channels": False}
    wanted = clsim.render(many, narrowband=False, **fine, **options).pressure[0].astype(float)
    got = clsim.render(many, narrowband=True, **options).pressure[0].astype(float)
    wrong = 20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
    measured("envelopes whose rate their band almost fills", "sound itself at -110 dB", wrong, -86.0)


@pytest.mark.parametrize("high", [40.0, 400.0, 4e3])
def test_a_bin_stands_for_all_frequencies_nearest_to_it(high: float) -> None:
    frequencies = 25.0 * np.arange(4001)
    sound = ShortTimeSpectra(frequencies, np.ones((1, 4001)) / 4001, np.ones(1))
    weight = sound.importance(high, np.ones(1), 40_010.0)
    assert weight.shape == (CELLS,)
    assert weight.min() > 0.0
