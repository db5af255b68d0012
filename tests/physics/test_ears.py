"""Ears that move and turn against the sum over samples, each through the response of its own instant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.numerics.quaternions import rotate

RATE, PLACE = 48e3, np.array([20.0, 20.0, 20.0])
HEAD = Path(__file__).parents[3] / "shared" / "data" / "hrtf" / "FHK_HRIR_L2354.sofa"


def turning(rate):
    """A pose that turns about a slanted axis at a rate, rad/s."""
    times = np.linspace(0.0, 0.3, 301)
    axis = np.array([1.0, -0.5, 2.0]) / np.sqrt(5.25)
    poses = np.concatenate([axis * np.sin(0.5 * rate * times)[:, None], np.cos(0.5 * rate * times)[:, None]], axis=1)
    return clsim.Trajectory.waypoints(times, [tuple(PLACE)] * len(times), poses)


def by_samples(pressure, towards, head):
    """Return the sum over samples (n,) of a wave from directions (n, 3), each through the response of its instant."""
    size, count = 1024, len(pressure)
    frequencies = np.arange(size // 2 + 1) * (RATE / size)
    fade = np.clip((16e3 - frequencies) / 4e3, 0.0, 1.0)
    out = np.zeros((2, count + size))
    for first in range(0, count, 512):
        gain = head.gain_towards(towards[first : first + 512, None], frequencies, 343.0) * fade[:, None]
        taps = np.roll(np.fft.irfft(gain, axis=1), size // 2, axis=1)  # from half of the size before the instant on
        for i in range(len(taps)):
            out[:, first + i : first + i + size] += pressure[first + i] * taps[i].T
    return out[:, size // 2 : size // 2 + count]


@pytest.mark.parametrize("kind", ["sphere", "measured"])
def test_ears_that_turn_hear_each_sample_as_their_pose_says(kind, measured):
    """A head turns by 4 rad/s while a source passes: against a microphone at its centre and the sum over its samples."""
    head = clsim.SphericalHead()
    if kind == "measured":
        if not HEAD.exists():
            pytest.skip(f"{HEAD} is not there")
        pytest.importorskip("sofar")
        head = clsim.HeadRelated.from_sofa(HEAD)
    pose, way = turning(4.0), clsim.Trajectory.line((22.0, 19.0, 20.5), (22.0, 21.0, 20.0), 0.3)
    sound = clsim.Signal.noise(0.025, RATE, 5, band=(300.0, 9e3), fade=0.01)
    receivers = [clsim.Receiver.binaural("head", pose, head), clsim.Receiver("omni", clsim.Trajectory.fixed(PLACE))]
    room = clsim.Shoebox(size=(40.0, 40.0, 40.0), walls=clsim.Material.from_reflection(0.5))
    air = clsim.Air(speed_of_sound=343.0, absorption=False)
    paths = clsim.find_paths(clsim.Scene(room, air, [clsim.Source("s", sound, way)], receivers), max_order=0)
    found = clsim.render(paths, RATE, duration=0.04).pressure.astype(float)
    times = np.arange(found.shape[1]) / RATE
    emitted = times.copy()
    for _ in range(20):
        away = way.position(emitted) - PLACE
        emitted = times - np.linalg.norm(away, axis=1) / 343.0
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    towards = np.stack([np.sum(rotate(pose.orientation(times), axis) * away, axis=1) for axis in np.eye(3)], axis=1)
    expected = by_samples(found[2], towards, head)
    assert np.abs(found[2]).max() > 0.01
    error = 20.0 * np.log10(np.linalg.norm(found[:2] - expected) / np.linalg.norm(expected))
    assert measured(f"ears that turn, {kind}", "the sum over samples", float(error), -86.0) <= -86.0


@pytest.mark.parametrize("what", ["a tone", "noise"])
def test_a_head_beside_an_omni_receives_what_it_does_alone(what):
    """A tone of 10 kHz for an omni is rendered as an envelope, wide noise is not: the head takes part in neither."""
    sound = (
        clsim.Signal.tone(10e3, 0.2, RATE, fade=0.02)
        if what == "a tone"
        else clsim.Signal.noise(0.2, RATE, 3, band=(300.0, 9e3), fade=0.02)
    )
    way = clsim.Trajectory.line((1.0, 1.0, 1.2), (1.3, 1.2, 1.2), 0.3)
    head = clsim.Receiver.binaural("head", clsim.Trajectory.fixed((3.0, 2.0, 1.5)))
    omni = clsim.Receiver("omni", clsim.Trajectory.fixed((2.5, 2.4, 1.4)))
    room = clsim.Shoebox(size=(4.0, 3.0, 2.5), walls=clsim.Material.from_reflection(0.7))
    both, alone, plain = (
        clsim.render(
            clsim.find_paths(clsim.Scene(room, clsim.Air(), [clsim.Source("s", sound, way)], receivers), 1), RATE,
            duration=0.2, narrowband=True,
        )
        for receivers in ([head, omni], [head], [omni])
    )  # fmt: skip
    for got, wanted in ((both.pressure[:2], alone.pressure), (both.pressure[2:], plain.pressure)):
        assert np.linalg.norm(wanted) > 0.0
        assert np.linalg.norm(got - wanted) < 10 ** (-86.0 / 20.0) * np.linalg.norm(wanted)
