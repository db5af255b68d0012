"""Room measures of noisy decays and speech transmission against pyrato's, from the same responses."""

from typing import Any

import numpy as np
import pytest
import soundfile
from exhaustive import few

import clsim
from clsim.acoustics.room_acoustics import before_noise, centre_time, decay_curve, lateral_fractions, reverberation_time

RATE = 48e3


@pytest.fixture(scope="module")
def pyrato() -> Any:
    pytest.importorskip("pyfar", reason="pyfar is not installed")
    return pytest.importorskip("pyrato", reason="pyrato is not installed")


def decaying(seconds: float, noise_db: float, rng: np.random.Generator, length: float = 3.0) -> np.ndarray:
    """White noise that decays by 60 dB in a time, and steady noise."""
    times = np.arange(round(length * RATE)) / RATE
    first, second = rng.standard_normal((2, len(times)))
    return np.asarray(first * 10.0 ** (-3.0 * times / seconds) + 10.0 ** (noise_db / 20.0) * second)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("seconds", "noise_db"), few([(0.6, -50.0), (1.6, -60.0), (1.0, -48.0)], (0, 1)))
def test_times_of_noisy_decays(pyrato: Any, seconds: float, noise_db: float, rng: np.random.Generator) -> None:
    """Theirs by Lundeby's crossing and Chu's subtraction."""
    import pyfar

    made = decaying(seconds, noise_db, rng)
    theirs = pyrato.edc.energy_decay_curve_chu_lundeby(pyfar.Signal(made, RATE), plot=False)
    count, noise, beyond = before_noise(made, RATE)
    curve = decay_curve(made[:count], noise, beyond)
    for name, last_db in (("T20", -25.0), ("T30", -35.0)):
        wanted = float(np.ravel(pyrato.parameters.reverberation_time_linear_regression(theirs, T=name))[0])
        assert reverberation_time(curve, RATE, -5.0, last_db) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.filterwarnings("ignore")
def test_centre_time_and_lateral_fraction(pyrato: Any, rng: np.random.Generator) -> None:
    import pyfar

    made, eight = (decaying(0.8, -200.0, rng) for _ in range(2))
    curves = [pyrato.edc.energy_decay_curve_chu_lundeby, pyrato.edc.schroeder_integration]
    whole, lateral = (curves[1](pyfar.Signal(x, RATE)) for x in (made, 0.3 * eight))
    assert centre_time(made, RATE) == pytest.approx(float(np.ravel(pyrato.parameters.center_time(whole))[0]), rel=2e-3)
    wanted = float(np.ravel(pyrato.parameters.early_lateral_energy_fraction(whole, lateral))[0])
    assert lateral_fractions(made, 0.3 * eight, RATE)[0] == pytest.approx(wanted, rel=2e-2)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("seconds", "levels"),
    few([(0.3, None), (1.0, None), (3.0, None), (0.8, (60.0, 45.0)), (0.8, (30.0, 20.0))], (0, 4)),
)
def test_speech_transmission(pyrato: Any, seconds: float, levels: tuple[float, float] | None, tmp_path, rng) -> None:
    """Without levels, and with those of speech and noise, down to the threshold of hearing."""
    import pyfar

    made = decaying(seconds, -200.0, rng, max(2.0 * seconds, 1.7))
    soundfile.write(tmp_path / "hall.wav", 0.2 * made, round(RATE), subtype="FLOAT")
    speech = None if levels is None else np.linspace(levels[0], levels[0] - 20.0, 7)
    noise = None if levels is None else np.linspace(levels[1], levels[1] - 10.0, 7)
    more = {} if speech is None or noise is None else {"level": speech, "snr": speech - noise}
    theirs = pyrato.parameters.speech_transmission_index_indirect(pyfar.Signal(made, RATE), **more)
    found = clsim.speech_transmission(tmp_path / "hall.wav", speech, noise)[0, 0]
    assert found == pytest.approx(float(np.ravel(theirs)[0]), abs=0.01)
