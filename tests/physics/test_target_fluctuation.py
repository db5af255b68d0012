"""Scatterers whose strength fluctuates: statistics of the noise, and what is heard of it against its law."""

import time
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.scene.fluctuation import TargetFluctuation

C, RATE = 340.0, 96e3


def test_power_is_as_swerling_has_it_and_correlation_as_told() -> None:
    """Over seeds: exponential powers without a steady share; the variance of the power is 1 - steady²."""
    times = np.array([0.0, 0.5, 1.0])
    for steady in (0.0, 0.71):
        found = np.array([TargetFluctuation(0.5, steady, seed).at(times) for seed in range(4000)])
        power = np.abs(found) ** 2
        assert power.mean() == pytest.approx(1.0, abs=0.03)
        assert power.var() == pytest.approx(1.0 - steady**2, abs=0.08)
        z = found - np.sqrt(steady)
        for i, wanted in ((1, np.exp(-1.0)), (2, np.exp(-4.0))):
            assert np.mean(z[:, i] * z[:, 0].conj()).real / (1.0 - steady) == pytest.approx(wanted, abs=0.04)
        if steady == 0.0:
            assert np.mean(power > 1.0) == pytest.approx(np.exp(-1.0), abs=0.03)
            assert power.max() < TargetFluctuation(0.5).most ** 2


def test_the_same_seed_is_the_same_noise_in_any_pieces() -> None:
    noise, times = TargetFluctuation(0.1, 0.3, 5), np.linspace(0.0, 3.0, 40_000)
    whole = noise.at(times)
    np.testing.assert_array_equal(np.concatenate([noise.at(part) for part in np.split(times, [1, 777, 30_001])]), whole)
    np.testing.assert_array_equal(TargetFluctuation(0.1, 0.3, 5).at(times[7:9]), whole[7:9])
    assert np.abs(TargetFluctuation(0.1, 0.3, 6).at(times) - whole).max() > 0.5


def test_what_is_heard_is_the_steady_echo_times_the_noise_at_the_time_of_scattering(engine, measured) -> None:
    """A tone off a point at rest, by no wall and by one before it: each with the noise when it was met; -85 dB."""
    noise = clsim.TargetFluctuation(correlation_time=0.02, steady=0.2, seed=1)
    at = [clsim.Trajectory.fixed(p) for p in ((1.0, 1.0, 1.0), (1.5, 1.0, 1.0), (3.0, 2.0, 1.5))]
    tone = clsim.Signal.tone(20e3, 0.12, RATE, fade=0.01)
    ends = [clsim.Source("s", tone, at[0])], [clsim.Receiver("r", at[1])]
    room = clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.8))
    point = clsim.Scatterer.point("p", 0.0, at[2], fluctuation=noise)
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=C, absorption=False), *ends, scatterers=[point])
    paths = clsim.find_paths(scene, 0, scattering_order=1, direct=False)
    assert not scene.scatterers[0].is_static
    times = np.arange(round(0.05 * RATE), round(0.075 * RATE)) / RATE
    first = paths.families[1].arrivals(slice(None), times)
    late = first.more["second_length"][:, :1] / C
    exact = np.zeros(len(times))
    for p in range(len(paths)):
        d = [float(first.length[p, 0] - first.more["second_length"][p, 0]), float(first.more["second_length"][p, 0])]
        walls = 0.8 ** (paths.order[p] - 1)
        phase = 2.0 * np.pi * 20e3 * (times - sum(d) / C)
        exact += walls / (d[0] * d[1]) * np.imag(noise.at(times - late[p]) * np.exp(1j * phase))
    heard = clsim.render(paths, RATE, duration=0.075, engine=engine).pressure[0, round(0.05 * RATE) :]
    error = float(20.0 * np.log10(np.linalg.norm(heard - exact) / np.linalg.norm(exact)))
    measured("scatterers that fluctuate", "law of the noise, path by path", error, -85.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"correlation_time": 0.0}, "correlation_time: must be at least 0.001 s, but is 0"),
        ({"correlation_time": 1.0, "steady": 1.5}, "steady: must be at most 1, but is 1.5"),
        ({"correlation_time": 1.0, "seed": 0.5}, "seed: must be a whole number"),
    ],
)
def test_what_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.TargetFluctuation(**given)
    with pytest.raises(clsim.InputError, match="fluctuation: must be a TargetFluctuation, but is 3"):
        clsim.Scatterer.point("p", 0.0, clsim.Trajectory.fixed((1.0, 1.0, 1.0)), fluctuation=3)


def test_motion_after_the_sound_takes_no_time() -> None:
    """A sphere that moves for six days beside 10 ms of sound; every instant of it would take over a minute."""
    tone = clsim.Signal.tone(40e3, 0.01, 192e3, fade=0.002)

    def found(seconds: float) -> tuple[clsim.PathSet, float]:
        way = clsim.Trajectory.circle((3.0, 2.0, 1.2), 0.5, 1.0, seconds)
        ball = clsim.Scatterer.sphere("ball", 0.1, way, fluctuation=clsim.TargetFluctuation(0.2, 0.5, 1))
        scene = clsim.Scene(
            clsim.Shoebox((6, 5, 3), clsim.Material.from_reflection(0.9)), clsim.Air(),
            [clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))],
            [clsim.Receiver("r", clsim.Trajectory.fixed((5.0, 4.0, 1.5)))], scatterers=[ball],
        )  # fmt: skip
        begun = time.process_time()
        return clsim.find_paths(scene, 1, scattering_order=1), time.process_time() - begun

    (short, _), (long, spent) = found(120.0), found(5e5)
    assert spent < 15.0
    np.testing.assert_allclose(long.families[1].vertex.nearest, short.families[1].vertex.nearest, rtol=1e-3)
