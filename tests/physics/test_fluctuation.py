"""Noise of delays: its statistics, its derivatives, and that samples are the same however they are asked for."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from default_oracle import error_db
from oracle import as_the_paths_say

import clsim

RMS, TIME, LENGTH = 2e-6, 0.4, 0.3
NOISE = clsim.Fluctuation(RMS, TIME, LENGTH, seed=3)


def over_seeds(count: int, *points: tuple[float, float, float]) -> np.ndarray:
    """Return the noise of many seeds (count, points) at points of time, receiver's x and source's y."""
    t, x, y = np.array(points).T
    receiver, source = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    receiver[:, 0], source[:, 1] = x, y
    return np.array([replace(NOISE, seed=i).at(t, receiver, source)[0] for i in range(count)])


def test_it_is_gaussian_and_correlated_as_told() -> None:
    """Within four standard errors of 2000 seeds."""
    count, e = 2000, np.exp(-1.0)
    found = over_seeds(
        count, (0, 0, 0), (TIME, 0, 0), (0, LENGTH, 0), (0, 0, LENGTH), (0, 9.0 * LENGTH, 0), (0.1 * TIME, 0, 0)
    )
    assert found.std() == pytest.approx(RMS, rel=4.0 / np.sqrt(2.0 * count))
    correlation = np.corrcoef(found.T)[0]
    np.testing.assert_allclose(correlation[1:], [e, e, e, 0.0, np.exp(-0.01)], atol=4.0 / np.sqrt(count))
    kurtosis = np.mean(found[:, 0] ** 4) / np.mean(found[:, 0] ** 2) ** 2
    assert kurtosis == pytest.approx(3.0, abs=4.0 * np.sqrt(24.0 / count))
    assert np.abs(found).max() <= NOISE.most


def test_correlations_within_a_run_deviate_as_documented() -> None:
    """64 waves stand for all paths: ``1/sqrt(2K)`` however long the run; 60 pairs tell that within three deviations."""
    times, places = np.arange(0.0, 400.0 * TIME, 0.5 * TIME), np.random.default_rng(5).uniform(0.0, 30.0, (120, 3))
    still = np.zeros((len(times), 3))
    made = np.array([NOISE.at(times, still + place, still)[0] for place in places])
    pairs = [np.corrcoef(made[2 * i], made[2 * i + 1])[0, 1] for i in range(60)]
    expected = np.sqrt(1.0 / 128.0 + 1.25 / 400.0)
    assert np.sqrt(np.mean(np.square(pairs))) == pytest.approx(expected, rel=3.0 / np.sqrt(2.0 * 60))


def ends(moving: bool) -> tuple[list[clsim.Source], list[clsim.Receiver]]:
    tone = clsim.Signal.tone(40e3, 0.45, 192e3, fade=0.01)
    a, b = (2.0, 2.0, 1.5), (2.5, 2.2, 1.5)
    way = clsim.Trajectory.line(a, b, 0.5) if moving else clsim.Trajectory.fixed(a)
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed((6.0 + 0.03 * i, 3.0, 1.0))) for i in range(2)]
    return [clsim.Source("s", tone, way)], ears


def paths_of(moving: bool, noise: clsim.Fluctuation | None = NOISE, order: int = 1) -> clsim.PathSet:
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    air = clsim.Air(speed_of_sound=343.0, fluctuation=noise)
    return clsim.find_paths(clsim.Scene(room, air, *ends(moving)), order)


def test_delays_differ_by_it_and_rates_are_their_derivatives() -> None:
    step = 1e-5
    times = np.concatenate([0.2 + np.array([-step, 0.0, step]), np.linspace(0.0, 0.4, 201)])
    noisy, quiet = (paths_of(True, noise).table(times) for noise in (NOISE, None))
    added = noisy.delay - quiet.delay
    assert 0.2 * RMS < added.std() < 3.0 * RMS
    rate = (noisy.delay[:, 2] - noisy.delay[:, 0]) / (2.0 * step)
    np.testing.assert_allclose(1.0 - noisy.doppler_factor[:, 1], rate, atol=2e-10)
    assert np.abs(noisy.doppler_factor - quiet.doppler_factor).max() > 1e-7
    # Neighbouring receivers hear the same of it, other walls another one.
    per_receiver = added.reshape(2, -1, added.shape[1])
    assert np.corrcoef(per_receiver[0, 0], per_receiver[1, 0])[0, 1] > 0.9
    assert np.abs(per_receiver[0, 0] - per_receiver[1, 0]).max() < 0.5 * RMS < np.abs(added[0] - added[1]).max()


def test_bounds_hold() -> None:
    from clsim.tracks.tracks import track

    tracks = track(paths_of(True))
    low, high = tracks.delay_range(0, 0.1, 0.3)
    delay = tracks.paths.table(np.linspace(0.1, 0.3, 21)).delay[: len(low)]
    assert np.all((low[:, None] <= delay) & (delay <= high[:, None]))
    assert np.abs(np.diff(delay, axis=1)).max() / 0.01 <= tracks.max_rate(0)
    assert track(paths_of(False)).max_rate(0) > 0.0


@pytest.mark.parametrize("moving", [True, False])
def test_it_is_rendered_and_the_same_in_chunks(moving: bool, measured: Any) -> None:
    """Also of pairs that never move; chunks, and a start in the middle as when a run is resumed, change no bit."""
    paths = paths_of(moving)
    whole = clsim.render(paths, 192e3, duration=0.3).pressure
    n = np.arange(10_000, 57_000, 37)
    error = error_db(whole[0, n], as_the_paths_say(paths, n / 192e3))
    measured("noise of delays, rendered", "each path's delay and gain in float64", error, -85.0)
    assert error_db(whole[0, n], as_the_paths_say(paths_of(moving, None), n / 192e3)) > -20.0
    plan = clsim.plan_render(paths, 192e3, duration=0.3, chunk=18_432)
    later = [piece for _, piece in clsim.render_chunks(plan, first=18_432)]
    assert len(later) == 3
    np.testing.assert_array_equal(np.concatenate(later, axis=1), whole[:, 18_432:])


def test_words_of_scene_files_build_it() -> None:
    from clsim.scene_file.scene import SceneModel

    model = SceneModel.model_fields["air"].annotation.model_validate(
        {
            "temperature_celsius": [19.0, 23.0], "heights": [0.5, 2.5], "wind": [0.3, 0.0, 0.0],
            "fluctuation": {"rms": RMS, "correlation_time": TIME, "correlation_length": LENGTH, "seed": 3},
        }
    )  # fmt: skip
    air = model.build()
    assert air.fluctuation == NOISE
    assert (air.temperature_celsius, air.heights, air.wind) == ((19.0, 23.0), (0.5, 2.5), (0.3, 0.0, 0.0))
    lines = "\n".join(air.between(0.0, 3.0).describe())
    for words in ("18 °C", "24 °C, 50 % at 3 m", "wind of (0.3, 0, 0) m/s", "fluctuate by 2 µs", "legs are straight"):
        assert words in lines


@pytest.mark.parametrize(
    ("values", "field"),
    [((-1e-6, 1.0, 1.0), "rms"), ((1e-6, 0.0, 1.0), "correlation_time"), ((1e-6, 1.0, 0.0), "correlation_length")],
)
def test_what_is_out_of_bounds_is_refused_by_name(values: tuple[float, ...], field: str) -> None:
    with pytest.raises(clsim.InputError, match=f"^{field}: "):
        clsim.Fluctuation(*values)
