"""Receivers of several channels: ambisonic components against SciPy's harmonics, turns against turned worlds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exhaustive import few
from scipy.special import sph_harm_y

import clsim
from clsim.numerics.sphere import real_harmonics
from clsim.scene.directivity.directivity import ChannelDirectivity

RATE = 48e3


def oracle(order, directions):
    """Real harmonics in N3D and ACN order out of SciPy's complex ones, which have Condon and Shortley's phase."""
    x, y, z = directions.T
    polar, azimuth = np.arccos(np.clip(z, -1.0, 1.0)), np.arctan2(y, x)
    columns = []
    for degree in range(order + 1):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), polar, azimuth) * (-1.0) ** m * np.sqrt(4.0 * np.pi)
            columns.append(value.real if m == 0 else np.sqrt(2.0) * (value.imag if m < 0 else value.real))
    return np.stack(columns, axis=-1)


@pytest.fixture
def directions():
    drawn = np.random.default_rng(3).standard_normal((500, 3))
    return np.concatenate([drawn / np.linalg.norm(drawn, axis=1)[:, None], np.eye(3), -np.eye(3)])


@pytest.mark.parametrize("order", range(8))
def test_harmonics_are_those_of_scipy(order, directions):
    scale = clsim.Ambisonic(order, "N3D").scale
    found = real_harmonics(order, directions) * scale
    assert np.abs(found - oracle(order, directions)).max() <= 1e-12 * scale.max()


def free_field(source, receivers, order=0, **options):
    room = clsim.Shoebox(size=(40.0, 40.0, 40.0), walls=clsim.Material.from_reflection(0.5))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], receivers)
    return clsim.render(clsim.find_paths(scene, max_order=order), RATE, duration=0.25, **options)


def sound(**more):
    return clsim.Signal.noise(0.2, RATE, 5, band=(300.0, 9e3), fade=0.02, **more)


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_a_wave_is_received_as_its_direction_says(engine):
    """At rest and in motion: each component is the pressure times the harmonic of where the sound comes from."""
    away = np.array([2.0, -5.0, 3.0])
    place = np.array([20.0, 20.0, 20.0])
    radial = away / np.linalg.norm(away)
    for motion in (
        clsim.Trajectory.fixed(place + away),
        clsim.Trajectory.line(place + away, place + away + 2.0 * radial, 1.0),  # its direction stays
    ):
        microphones = [
            clsim.Receiver.ambisonic("hoa", clsim.Trajectory.fixed(place), order=7, normalization="N3D"),
            clsim.Receiver("omni", clsim.Trajectory.fixed(place)),
        ]
        found = free_field(clsim.Source("s", sound(), motion), microphones, engine=engine).pressure.astype(float)
        expected = oracle(7, radial[None])[0][:, None] * found[-1]
        error = np.linalg.norm(found[:-1] - expected) / np.linalg.norm(expected)
        assert error <= 1e-5


@pytest.mark.parametrize("kind", ["components", "ears"])
@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_turning_the_receiver_is_turning_the_world_the_other_way(engine, kind, measured):
    """A source circles a receiver that turns: in the receiver's frame it circles by the difference of both rates.

    What is received was emitted earlier by the time over the circle's radius, by which the microphone has turned.
    """
    times = np.linspace(0.0, 0.4, 401)
    place, turn, around = np.array([20.0, 20.0, 20.0]), 3.0 * times, 2.0 * times

    def circle(angle):
        ring = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.ones_like(angle)], axis=1)
        return clsim.Trajectory.waypoints(times, place + 3.0 * ring)

    def facing(angle):
        poses = np.stack([0.0 * angle, 0.0 * angle, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
        return clsim.Trajectory.waypoints(times, np.repeat(place[None], len(times), axis=0), poses)

    def heard(source, pose):
        ambisonic = kind == "components"
        there = clsim.Receiver.ambisonic("hoa", pose, order=3) if ambisonic else clsim.Receiver.binaural("head", pose)
        return free_field(clsim.Source("s", sound(), source), [there], engine=engine).pressure.astype(float)

    late = 3.0 * np.sqrt(1.09) / 343.0
    one, other = heard(circle(around), facing(turn)), heard(circle(around - turn - 3.0 * late), facing(0.0 * turn))
    error = 20.0 * np.log10(np.linalg.norm(one - other) / np.linalg.norm(one))
    measured(f"{kind} that turn, {engine}", "the world turned the other way", float(error), -100.0)
    still = heard(circle(around), facing(0.0 * turn))
    assert np.linalg.norm(one - still) > 0.1 * np.linalg.norm(one)  # the turn matters


def test_fixed_components_keep_the_axes_of_the_room():
    times = np.linspace(0.0, 0.4, 5)
    poses = [(0.0, 0.0, np.sin(t), np.cos(t)) for t in times]
    pose = clsim.Trajectory.waypoints(times, [(5.0, 5.0, 5.0)] * 5, poses)
    microphones = [
        clsim.Receiver.ambisonic("fixed", pose, order=1, fixed=True),
        clsim.Receiver.ambisonic("still", clsim.Trajectory.fixed((5.0, 5.0, 5.0)), order=1),
    ]
    found = free_field(clsim.Source("s", sound(), clsim.Trajectory.fixed((8.0, 7.0, 5.5))), microphones)
    np.testing.assert_array_equal(found.pressure[:4], found.pressure[4:])


@pytest.mark.parametrize("kind", few(["moving", "still", "baseband", "fading"], (0, 2)))
def test_both_engines_receive_the_same_channels(kind, measured):
    motion = clsim.Trajectory.fixed((2.0, 2.0, 1.5))
    if kind != "still":
        motion = clsim.Trajectory.line((2.0, 2.0, 1.5), (3.0, 3.2, 1.6), 1.0)
    signal = clsim.Signal.tone(6e3, duration=0.2, sampling_rate=RATE, fade=0.02) if kind == "baseband" else sound()
    room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    microphones = [
        clsim.Receiver("omni", clsim.Trajectory.fixed((5.0, 4.0, 1.2))),
        clsim.Receiver.ambisonic("hoa", clsim.Trajectory.fixed((5.0, 4.0, 1.3), (0.0, 0.6, 0.0, 0.8)), order=4),
    ]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, motion)], microphones)
    paths = clsim.find_paths(scene, max_order=2)
    if kind == "fading":
        family = paths.families[0]
        begin = np.where(np.arange(len(family)) % 3 == 1, 0.101, family.start)
        paths = replace(paths, families=(replace(family, start=begin), *paths.families[1:]))
    options = {"baseband": (6e3, 2e3)} if kind == "baseband" else {}
    fast, exact = (
        clsim.render(paths, RATE, engine=e, duration=0.25, **options).samples for e in ("opencl", "reference")
    )
    assert fast.shape[0] == 26
    error = np.linalg.norm(fast - exact, axis=1) / np.linalg.norm(exact, axis=1).max()
    measured("channels of receivers, opencl engine", "reference engine", float(20.0 * np.log10(error.max())), -86.0)


@pytest.mark.parametrize("air", ["plain", "dispersive"])
@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_the_first_component_beside_a_moving_ball_is_what_an_omni_there_hears(engine, air, measured):
    """Phases of the ball and of the air stay in components that have none of their own, whoever else listens."""
    way = clsim.Trajectory.line((2.6, 1.6, 1.2), (2.7, 1.8, 1.3), 0.4)
    place = clsim.Trajectory.fixed((5.2, 4.0, 1.5))
    microphones = [
        clsim.Receiver.ambisonic("hoa", place, order=7, normalization="N3D"),  # gains of so many are made on the host
        clsim.Receiver("omni", place),
        clsim.Receiver("elsewhere", clsim.Trajectory.fixed((4.5, 3.2, 1.1))),
    ]
    signal = clsim.Signal.noise(0.04, RATE, 1, band=(200.0, 2e3), fade=0.01)
    scene = clsim.Scene(
        clsim.Shoebox(size=(6.0, 5.0, 2.8), walls=clsim.Material.from_reflection(0.6)),
        clsim.Air(dispersion=air == "dispersive"),
        [clsim.Source("s", signal, clsim.Trajectory.fixed((1.0, 1.0, 1.6)))],
        microphones,
        scatterers=[clsim.Scatterer.sphere("ball", 0.15, way)] if air == "plain" else [],
    )
    paths = clsim.find_paths(scene, max_order=0, scattering_order=0)
    found = clsim.render(paths, RATE, duration=0.06, engine=engine).pressure.astype(float)
    error = 20.0 * np.log10(max(np.linalg.norm(found[0] - found[64]) / np.linalg.norm(found[64]), 1e-12))
    what = "ball that moves" if air == "plain" else "air with dispersion"
    measured(f"first component, {what}, {engine}", "an omni there", float(error), -80.0)


class TwoPlaces(ChannelDirectivity):
    """Two places on the x axis, d before and behind the centre, for sound from far away."""

    is_complex, band, channels, d = True, (0.0, np.inf), ("front", "back"), 0.1
    reach = 1.1 * d / 343.0

    def gain_towards(self, direction, frequency, speed_of_sound):
        late = self.lateness(direction, speed_of_sound)
        return np.exp(-2j * np.pi * np.asarray(frequency)[..., None] * late)

    def lateness(self, direction, speed_of_sound):
        return np.stack([-direction[..., 0], direction[..., 0]], axis=-1) * (self.d / speed_of_sound)


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_late_channels_of_a_moving_source_are_as_late_as_their_places(engine):
    """A source comes at 20 m/s: a channel d away from the centre receives what a receiver there does, to -55 dB.

    Its lateness is by the receiver's clock, and delays are by the source's: 6 % of 0.3 ms would be -5 dB here. Levels at
    both places differ by 0.1 m of the distance, which changes from 18 to 13 m.
    """
    place = np.array([20.0, 20.0, 20.0])
    way = clsim.Trajectory.line((38.0, 20.0, 20.0), (30.0, 20.0, 20.0), 0.4)
    there = [
        clsim.Receiver(f"{i}", clsim.Trajectory.fixed(place + sign * TwoPlaces.d * np.eye(3)[0]))
        for i, sign in enumerate((1.0, -1.0))
    ]
    receivers = [clsim.Receiver("two", clsim.Trajectory.fixed(place), TwoPlaces()), *there]
    found = free_field(clsim.Source("s", sound(), way), receivers, engine=engine).pressure.astype(float)
    scaled = found / np.linalg.norm(found, axis=1)[:, None]  # levels differ by 0.1 m of 15
    error = np.linalg.norm(scaled[:2] - scaled[2:], axis=1)
    assert error.max() <= 10 ** (-55.0 / 20.0)
