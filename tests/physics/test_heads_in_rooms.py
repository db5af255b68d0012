"""Ears and components in diffuse fields and through headphones, against theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import spherical_jn

import clsim
from clsim.numerics.sphere import fibonacci_sphere

RATE = 48e3
PLACE = (20.0, 20.0, 20.0)


def test_components_of_a_diffuse_tail_are_uncorrelated():
    """In N3D the covariance of a diffuse field is a multiple of the identity; a static receiver in a cube's tail."""
    room = clsim.Shoebox(size=(5.0, 5.0, 5.0), walls=clsim.Material.from_reflection(0.9))
    sound = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=16e3, fade=0.02)
    microphone = clsim.Receiver.ambisonic("hoa", clsim.Trajectory.fixed((2.9, 2.4, 2.2)), 1, "N3D")
    source = clsim.Source("s", sound, clsim.Trajectory.fixed((1.5, 2.0, 3.1)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [microphone]), max_order=1)
    found = clsim.impulse_responses(paths, 16e3, band=(500.0, 6e3), tail="auto", lead="keep")
    assert found.receiver_names == tuple(f"hoa ACN{i}" for i in range(4))
    late = found.samples[0][:, 1600:]
    covariance = late @ late.T / np.mean(np.sum(late**2, axis=1))
    # Some 2 * 5500 Hz * 0.1 s independent samples in the loud part: a few percent, and 64 directions with their energies.
    assert np.abs(covariance - np.eye(4)).max() < 0.25
    assert np.abs(np.diag(covariance) - 1.0).max() < 0.25


def test_the_sphere_s_ears_are_coherent_in_a_diffuse_field_as_computed_by_modes():
    """The coherence of two places on a rigid sphere: the mean over all directions against the sum over modes."""
    head = clsim.SphericalHead(ear_azimuth=90.0)
    frequencies = np.array([200.0, 500.0, 1000.0, 2000.0])
    gains = head.gain_towards(fibonacci_sphere(4000)[:, None], frequencies, 343.0)
    cross = np.mean(gains[..., 0] * np.conj(gains[..., 1]), axis=0)
    power = np.sqrt(np.prod(np.mean(np.abs(gains) ** 2, axis=0), axis=1))
    ka = 2.0 * np.pi * frequencies * head.radius / 343.0
    from scipy.special import spherical_yn

    n = np.arange(40)[:, None]
    slope = spherical_jn(n, ka, derivative=True) - 1j * spherical_yn(n, ka, derivative=True)
    modes = (2 * n + 1) / np.abs(slope) ** 2
    expected = np.sum(modes * (-1.0) ** n, axis=0) / np.sum(modes, axis=0)  # ears opposite each other
    np.testing.assert_allclose((cross / power).real, expected, atol=2e-3)
    assert np.abs((cross / power).imag).max() < 2e-3


def test_a_decoded_recording_is_what_ears_hear():
    """Below the frequency that order 7 holds, a decoded wave is the head's own to -80 dB; order 1 is not."""
    room = clsim.Shoebox(size=(40.0, 40.0, 40.0), walls=clsim.Material.from_reflection(0.5))
    sound = clsim.Signal.noise(0.2, RATE, 1, band=(200.0, 1.2e3), fade=0.02)
    receivers = [
        clsim.Receiver.ambisonic("seven", clsim.Trajectory.fixed(PLACE), order=7),
        clsim.Receiver.ambisonic("one", clsim.Trajectory.fixed(PLACE), order=1),
        clsim.Receiver.binaural("head", clsim.Trajectory.fixed(PLACE)),
    ]
    source = clsim.Source("s", sound, clsim.Trajectory.fixed((25.0, 23.0, 21.0)))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0), [source], receivers)
    found = clsim.render(clsim.find_paths(scene, max_order=0), RATE, duration=0.25)
    ears = found.samples[found.rows_of("head")]

    def error(name):
        decoded = clsim.decode_binaural(found, receiver=name)
        assert [channel for _, channel in decoded.channels] == ["left", "right"]
        return np.linalg.norm(decoded.pressure - ears) / np.linalg.norm(ears)

    assert error("seven") <= 10 ** (-80.0 / 20.0)
    assert error("one") > 0.1
    with pytest.raises(clsim.InputError, match="ambisonic"):
        clsim.decode_binaural(found, receiver="head")


def test_lateral_measures_take_heads_and_components():
    room = clsim.Shoebox(size=(6.0, 5.0, 3.0), walls=clsim.Material.from_reflection(0.8))
    sound = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=16e3, fade=0.02)
    facing = clsim.Trajectory.fixed((4.5, 2.1, 1.4), (0.0, 0.0, 1.0, 0.0))  # looks along -x, at the source
    receivers = [
        clsim.Receiver.binaural("head", facing),
        clsim.Receiver.ambisonic("hoa", facing, 1),
        clsim.Receiver("omni", clsim.Trajectory.fixed((4.5, 2.1, 1.4))),
        clsim.Receiver("eight", clsim.Trajectory.fixed((4.5, 2.1, 1.4)), clsim.FirstOrder(0.0), aim=(0.0, 1.0, 0.0)),
    ]
    source = clsim.Source("s", sound, clsim.Trajectory.fixed((1.5, 3.0, 1.7)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), max_order=4)
    responses = clsim.impulse_responses(paths, 16e3, band=(200.0, 6e3), tail="off", lead="keep")
    made = clsim.lateral_measures(responses, "hoa", "head")
    apart = clsim.lateral_measures(responses, ("omni", "eight"), ("head left", "head right"))
    np.testing.assert_allclose(made.lf, apart.lf, rtol=1e-6)
    np.testing.assert_array_equal(made.iacc, apart.iacc)
    assert np.all((made.iacc > 0.0) & (made.iacc <= 1.0))
