"""Published studies done again: the figures of the examples against those of the papers."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile
from scipy.optimize import least_squares

import clsim

pytestmark = pytest.mark.usefixtures("device")


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(clsim.__file__).parents[1] / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_speeds_at_which_codes_are_lost(measured) -> None:
    """Paredes et al. 2011: nulls at 2.72, 0.67 and 0.17 m/s within 3 %; and no null elsewhere."""
    codes = example("moving_codes")
    for bits, published in zip(codes.BITS, codes.PUBLISHED, strict=True):
        off = 100.0 * abs(codes.null(bits) / published - 1.0)
        measured("speeds at which Kasami codes are lost", "Paredes et al. 2011", off, 3.0, "%")
    at_rest, half, gone = codes.peaks(6, np.array([0.0, 0.5, 1.0]) * codes.PUBLISHED[0])
    assert half / at_rest == pytest.approx(2.0 / np.pi, rel=0.03)  # sin(x) / x of half a turn
    assert gone / at_rest < 0.05
    # Matched to whole chips, the stretched code's ends count less, and cannot cancel the middle yet.
    assert codes.peaks(8, np.array([codes.PUBLISHED[1]]), 1.0)[0] > 0.05


def test_pistons_whose_nulls_split_a_chirp(measured) -> None:
    """Carotenuto et al. 2020: the peak is off the true time for the four largest pistons of six, and there alone.

    Nulls are where ka sin(angle) = 3.832: at 50 kHz from a diameter of 8.4 mm on. That of 8.5 mm has its at 80 degrees
    and 50 kHz, the chirp's faded end.
    """
    pistons = example("piston_pulses")
    for diameter in pistons.DIAMETERS:
        error = np.abs(pistons.errors(diameter))
        assert error[0] < 1e-5
        assert (error.max() > 5e-3) == (diameter > 10.0)
        if diameter < 10.0:
            worst = 1e3 * error.max()
            measured("ranges off the axis of small pistons", "true ranges", worst, 0.1, "mm")


def test_anchors_that_take_turns(measured) -> None:
    """Lopes et al. 2012: places at rest deviate by less than 2.3 cm, with a place every 350 ms.

    One that moves is off as the anchors' geometry makes it: anchor k is heard k turns later, when it has moved on, and a chirp over B about
    f_c within T adds f_c v T / B + v T / 2; both along its line of sight.
    """
    study = example("chirp_anchors")
    assert pytest.approx(0.35) == study.TURN * len(study.ANCHORS)
    resting = study.located(study.recorded(study.RESTING))
    assert resting.availability == 1.0
    assert np.linalg.norm(resting.deviation) < study.PUBLISHED
    found = 1e3 * resting.percentile(95)
    measured(
        "places at rest by anchors that take turns", "true places", found, 1.0, "mm"
    )  # of what is in the scene; the paper's figure has more
    carried = study.located(study.recorded(study.CARRIED))
    c = clsim.Air(22.0, 0.5).speed_of_sound
    velocity = np.array([study.SPEED, 0.0, 0.0])
    for found, true in zip(carried.estimated[0], carried.exact[0], strict=True):
        flight = np.linalg.norm(true - study.ANCHORS, axis=1) / c
        turns = study.TURN * np.arange(len(study.ANCHORS)) + flight - flight[0]
        away = true + velocity * turns[:, None] - study.ANCHORS
        distance = np.linalg.norm(away, axis=1)
        late = distance + away / distance[:, None] @ velocity * (32.5e3 * 5e-3 / 25e3 + 2.5e-3)
        expected = least_squares(lambda x, r=late: np.linalg.norm(x - study.ANCHORS, axis=1) - r, true).x
        assert np.linalg.norm(found - true) > study.PUBLISHED
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=5e-4)


def test_a_ceiling_of_receivers(measured) -> None:
    """Active Bat (Harter et al. 2002): 95 % within 9 cm, by differences, for the transducers' delay is 10 cm."""
    study = example("ceiling_grid")
    recording = study.recorded()
    differences, times = (study.located(recording, method) for method in ("tdoa", "toa"))
    assert differences.availability == times.availability == 1.0
    assert differences.percentile(95) < study.PUBLISHED
    found = 1e3 * differences.percentile(95)
    measured("places under a ceiling of receivers, by differences", "true places", found, 20.0, "mm")
    assert times.percentile(50) > study.PUBLISHED
    assert times.bias[2] < -study.PUBLISHED  # every range too long: too far below the ceiling


@pytest.mark.exhaustive
def test_a_long_run_that_was_killed_finds_its_ranges(tmp_path, measured) -> None:
    """The sound is that of a run in one go; ranges are exact to half a sample, 11 mm, and what Doppler adds to chirps.

    A shift of frequency is taken for one of time: 3.4 kHz x 50 ms / 5.2 kHz = 33 mm at 1 m/s.
    """
    hall = example("long_hall")
    hall.rendered(tmp_path, 16.0, order=0)
    scene = clsim.load_scene(tmp_path / "scene.toml").scene
    whole = clsim.render(clsim.find_paths(scene, 0), hall.RATE, duration=16.0, chunk=hall.CHUNK).samples
    for name, samples in zip(("east", "west"), whole, strict=True):
        np.testing.assert_array_equal(soundfile.read(tmp_path / "run" / f"{name}.wav", dtype="float32")[0], samples)
    found, true = hall.ranges(tmp_path)
    worst = 1e3 * np.abs(found - true).max()
    assert found.shape == (2, 16)
    measured("ranges of a long run", "true ranges", worst, 44.0, "mm")
