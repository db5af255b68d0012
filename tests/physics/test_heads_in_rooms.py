"""Heads: ears that turn, and heads in rooms with tails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few
from scipy.special import spherical_jn

import clsim
from clsim.numerics.quaternions import rotate
from clsim.numerics.sphere import fibonacci_sphere, real_harmonics, table_directions, table_values
from clsim.render.diffuse_tail import DiffuseTail

EARS_RATE, EARS_PLACE = 48e3, np.array([20.0, 20.0, 20.0])
HEAD = Path(__file__).parents[3] / "shared" / "data" / "hrtf" / "FHK_HRIR_L2354.sofa"


def turning_of_ears(rate):
    """A pose that turns about a slanted axis at a rate, rad/s."""
    times = np.linspace(0.0, 0.3, 301)
    axis = np.array([1.0, -0.5, 2.0]) / np.sqrt(5.25)
    poses = np.concatenate([axis * np.sin(0.5 * rate * times)[:, None], np.cos(0.5 * rate * times)[:, None]], axis=1)
    return clsim.Trajectory.waypoints(times, [tuple(EARS_PLACE)] * len(times), poses)


def by_samples(pressure, towards, head):
    """Return the sum over samples (n,) of a wave from directions (n, 3), each through the response of its instant."""
    size, count = 1024, len(pressure)
    frequencies = np.arange(size // 2 + 1) * (EARS_RATE / size)
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
    pose, way = turning_of_ears(4.0), clsim.Trajectory.line((22.0, 19.0, 20.5), (22.0, 21.0, 20.0), 0.3)
    sound = clsim.Signal.noise(0.025, EARS_RATE, 5, band=(300.0, 9e3), fade=0.01)
    receivers = [
        clsim.Receiver.binaural("head", pose, head),
        clsim.Receiver("omni", clsim.Trajectory.fixed(EARS_PLACE)),
    ]
    room = clsim.Shoebox(size=(40.0, 40.0, 40.0), walls=clsim.Material.from_reflection(0.5))
    air = clsim.Air(speed_of_sound=343.0, absorption=False)
    paths = clsim.find_paths(clsim.Scene(room, air, [clsim.Source("s", sound, way)], receivers), max_order=0)
    found = clsim.render(paths, EARS_RATE, duration=0.04).pressure.astype(float)
    times = np.arange(found.shape[1]) / EARS_RATE
    emitted = times.copy()
    for _ in range(20):
        away = way.position(emitted) - EARS_PLACE
        emitted = times - np.linalg.norm(away, axis=1) / 343.0
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    towards = np.stack([np.sum(rotate(pose.orientation(times), axis) * away, axis=1) for axis in np.eye(3)], axis=1)
    expected = by_samples(found[2], towards, head)
    assert np.abs(found[2]).max() > 0.01
    error = 20.0 * np.log10(np.linalg.norm(found[:2] - expected) / np.linalg.norm(expected))
    measured(f"ears that turn, {kind}", "the sum over samples", float(error), -86.0)


@pytest.mark.parametrize("what", ["a tone", "noise"])
def test_a_head_beside_an_omni_receives_what_it_does_alone(what):
    """A tone of 10 kHz for an omni is rendered as an envelope, wide noise is not: the head takes part in neither."""
    sound = (
        clsim.Signal.tone(10e3, 0.2, EARS_RATE, fade=0.02)
        if what == "a tone"
        else clsim.Signal.noise(0.2, EARS_RATE, 3, band=(300.0, 9e3), fade=0.02)
    )
    way = clsim.Trajectory.line((1.0, 1.0, 1.2), (1.3, 1.2, 1.2), 0.3)
    head = clsim.Receiver.binaural("head", clsim.Trajectory.fixed((3.0, 2.0, 1.5)))
    omni = clsim.Receiver("omni", clsim.Trajectory.fixed((2.5, 2.4, 1.4)))
    room = clsim.Shoebox(size=(4.0, 3.0, 2.5), walls=clsim.Material.from_reflection(0.7))
    both, alone, plain = (
        clsim.render(
            clsim.find_paths(clsim.Scene(room, clsim.Air(), [clsim.Source("s", sound, way)], receivers), 1), EARS_RATE,
            duration=0.2, narrowband=True,
        )
        for receivers in ([head, omni], [head], [omni])
    )  # fmt: skip
    for got, wanted in ((both.pressure[:2], alone.pressure), (both.pressure[2:], plain.pressure)):
        assert np.linalg.norm(wanted) > 0.0
        assert np.linalg.norm(got - wanted) < 10 ** (-86.0 / 20.0) * np.linalg.norm(wanted)


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


def cube(receivers, seconds=0.5, source=None, *, direct=False):
    """Paths of noise in a cube, in whose late tail energies by direction are nearly alike."""
    room = clsim.Shoebox(size=(5.0, 5.0, 5.0), walls=clsim.Material.from_reflection(0.9))
    sound = clsim.Signal.noise(seconds, 16e3, 3, band=(200.0, 5e3), fade=0.3 * seconds)
    source = clsim.Source("s", sound, source or clsim.Trajectory.fixed((1.5, 2.0, 3.1)))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), max_order=0, direct=direct)


def turning(rate, start=(2.9, 2.4, 2.2), end=None, seconds=2.2):
    """A pose that turns about the vertical at a rate, rad/s."""
    times = np.linspace(0.0, seconds, 40)
    angle, share = 0.5 * rate * times, times[:, None] / seconds
    places = np.array(start) + share * (np.array(start if end is None else end) - start)
    poses = np.stack([0.0 * angle, 0.0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    return clsim.Trajectory.waypoints(times, places, poses)


def test_the_tail_at_a_head_that_hardly_turns_is_that_at_rest(measured):
    """What moves is rendered by a few filters with weights by direction, what rests by gains at every frequency."""
    found = [
        clsim.render(cube([clsim.Receiver.binaural("head", pose)]), 16e3, duration=0.4, tail="auto").pressure
        for pose in (clsim.Trajectory.fixed((2.9, 2.4, 2.2)), turning(1e-5))
    ]
    error = 20.0 * np.log10(np.linalg.norm(found[1] - found[0]) / np.linalg.norm(found[0]))
    measured("tail at a head that turns", "the same head at rest", float(error), -28.0)


@pytest.mark.parametrize("tail", ["off", "auto"])
def test_chunks_change_no_bit_of_what_ears_hear(tail):
    head = clsim.Receiver.binaural("head", turning(2.0, end=(3.1, 2.4, 2.2)))
    fixed = clsim.Receiver.ambisonic("fixed", turning(0.0, end=(3.1, 2.4, 2.2)), fixed=True)  # without a warning
    paths = cube([head, fixed], direct=True)
    whole, cut = (clsim.render(paths, 16e3, duration=0.6, tail=tail, chunk=chunk).pressure for chunk in (10**6, 4608))
    np.testing.assert_array_equal(cut, whole)


def test_a_turn_acts_on_the_tail_as_on_its_waves():
    """After a turn by 90 degrees the tail is that of a head which faced there all the time, and not that of before."""
    poses = [turning(5.0 * np.pi, seconds=0.1), *(clsim.Trajectory.fixed((2.9, 2.4, 2.2), q) for q in QUARTERS)]
    facing, after, before = (
        clsim.render(cube([clsim.Receiver.binaural("head", pose)]), 16e3, duration=0.3, tail="auto").pressure
        for pose in (held(poses[0], 0.4), *poses[1:])
    )
    end = slice(2400, None)
    scale = np.linalg.norm(after[:, end])
    assert np.linalg.norm((facing - after)[:, end]) <= 10 ** (-28.0 / 20.0) * scale
    assert np.linalg.norm((facing - before)[:, end]) > 0.5 * scale


def test_pieces_of_the_tail_at_a_turning_head_are_those_of_the_whole():
    """Blocks lie on a fixed grid: pieces of any length, and of a run that is resumed, have the same bits."""
    head = clsim.Receiver.binaural("head", turning(2.0, end=(3.9, 3.1, 2.0)))
    plan = clsim.plan_render(cube([head], 0.2), 16e3, duration=0.9, tail="auto")
    whole = np.zeros((2, plan.samples), np.float32)
    DiffuseTail(plan).begin().add(whole, 0)
    assert np.abs(whole[:, 8000:]).max() > 0.0
    for first, size in ((0, 1000), (5003, 4700)):
        parts, tail = np.zeros_like(whole), DiffuseTail(plan).begin()
        for start in range(first, plan.samples, size):
            tail.add(parts[:, start : start + size], start)
        np.testing.assert_array_equal(parts[:, first:], whole[:, first:])


QUARTERS = ((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), (0.0, 0.0, 0.0, 1.0))


def held(pose, end):
    """A pose that rests where it ends, until a time, s."""
    times = np.append(np.linspace(0.0, pose.end, 40), [pose.end + 0.01, end])
    at = np.minimum(times, pose.end)
    return clsim.Trajectory.waypoints(times, pose.position(at), pose.orientation(at))


def diffuse_coherence(frequencies, head):
    """Coherence of a sphere's ears in a diffuse field, and relative powers there, by a mean over many directions."""
    gains = head.gain_towards(fibonacci_sphere(2000)[:, None], frequencies, 343.0)
    cross = np.mean(gains[..., 0] * np.conj(gains[..., 1]), axis=0)
    return cross.real, np.mean(np.abs(gains) ** 2, axis=(0, 2))


@pytest.mark.parametrize("motion", few(["walks and turns", "turns", "source moves"]))
def test_ears_hear_the_tail_as_coherent_as_a_diffuse_field(motion):
    """Their correlation in bands against theory for a rigid sphere."""
    pose = turning(2.0, end=(3.4, 2.9, 2.0) if motion == "walks and turns" else None)
    way = None if motion != "source moves" else clsim.Trajectory.line((1.5, 2.0, 3.1), (2.0, 2.4, 3.0), 2.2)
    paths = cube([clsim.Receiver.binaural("head", pose)], 0.02, way)
    heard = [clsim.render(paths, 16e3, duration=0.5, tail="auto", tail_seed=seed).pressure for seed in range(6)]
    spectra = np.fft.rfft(np.stack(heard, axis=1)[..., 1280:].astype(float))  # first reflections are not diffuse
    frequencies = np.fft.rfftfreq(6720, 1.0 / 16e3)
    for low, high in ((250.0, 450.0), (450.0, 900.0), (900.0, 1800.0), (1800.0, 3600.0)):
        left, right = spectra[..., (frequencies >= low) & (frequencies < high)]
        correlation = np.sum(left * np.conj(right)).real / np.linalg.norm(left) / np.linalg.norm(right)
        cross, power = diffuse_coherence(np.linspace(low, high, 40), clsim.SphericalHead())
        # What decays by 60 dB in 0.77 s lasts as long as 0.11 s at an even level: 0.11 * 200 * 6 independent values in
        # the lowest band, of which each correlation is off by 1 / sqrt(132) at most. Three of that, and 0.05 for 64
        # directions whose energies differ by up to 1 dB.
        assert abs(correlation - cross.sum() / power.sum()) <= 0.05 + 3.0 / np.sqrt(0.11 * (high - low) * 6.0)


def test_components_that_turn_in_a_tail_stay_uncorrelated():
    """Covariance in N3D of what turns and moves, and of a figure of eight beside an omnidirectional receiver."""
    pose = turning(2.0, end=(3.4, 2.9, 2.0))
    receivers = [clsim.Receiver.ambisonic("hoa", pose, 2, "N3D"), clsim.Receiver("eight", pose, clsim.FirstOrder(0.0))]
    paths = cube(receivers, 0.02)
    heard = [clsim.render(paths, 16e3, duration=0.5, tail="auto", tail_seed=seed).pressure for seed in range(4)]
    found = np.concatenate([one[:, 1280:] for one in heard], axis=1).astype(float)
    covariance = found @ found.T / np.sum(found[0] ** 2)
    # Bounds are those of the sums of 9 products over 64 directions whose energies differ by up to 1 dB.
    assert np.abs(covariance[:9, :9] - np.eye(9)).max() <= 0.2
    np.testing.assert_allclose(found[9], found[3] / np.sqrt(3.0), rtol=1e-5, atol=1e-6 * np.abs(found[9]).max())


def late_only(responses, seconds=0.1):
    """Responses from a time on, which then is that of the first arrival."""
    samples = responses.samples.copy()
    samples[..., : responses.lead + round(seconds * responses.sampling_rate)] = 0.0
    return replace(responses, samples=samples, first_arrivals=np.full_like(responses.first_arrivals, seconds))


@pytest.mark.parametrize("seeds", few([8, 24]))
def test_measures_of_a_diffuse_field(seeds, measured):
    """LF, LFC and IACC of tails alone against theory: what figures of eight and a sphere's ears are in a diffuse field.

    A figure of eight takes a third of the energy, and both are independent: the mean magnitude of their product is
    2 / pi of the product of both levels. Of 75 of 80 ms the share of the energy is counted. Ears correlate as the
    spectrum of both says, at the best lag: tails of all seeds behind each other are one response, whose correlation is
    the mean of theirs.
    """
    place, rate = (2.9, 2.4, 2.2), 16e3
    receivers = [clsim.Receiver.ambisonic("hoa", clsim.Trajectory.fixed(place), 1)]
    receivers += [clsim.Receiver.binaural("head", clsim.Trajectory.fixed(place, (0.0, 0.0, 0.6, 0.8)))]
    paths = cube(receivers, direct=True)
    each = [
        late_only(clsim.impulse_responses(paths, rate, band=(300.0, 6e3), lead="keep", tail_seed=seed))
        for seed in range(seeds)
    ]
    found = [clsim.lateral_measures(one, "hoa") for one in each]
    long = replace(each[0], samples=np.concatenate([one.samples for one in each], axis=2))
    heard = np.array([np.square(one.samples[0, 0, one.lead + 1600 :][:1280]) for one in each])
    share, bands = heard[:, 80:].sum() / heard.sum(), found[0].frequencies
    # Energies of an octave in 75 ms are off by 1 / sqrt(time times bandwidth); what decays in 0.77 s is as 0.11 s.
    spread = 3.0 * np.sqrt(2.0 / (0.075 * seeds * bands / np.sqrt(2.0))) + 0.05
    for name, theory in (("lf", 1.0 / 3.0), ("lfc", 2.0 / np.pi / np.sqrt(3.0))):
        mean = np.mean([getattr(one, name)[0] for one in found], axis=0)
        for f, value, allowed in zip(bands.tolist(), mean / share / theory - 1.0, spread.tolist(), strict=True):
            measured(f"{name.upper()} of a tail, {f:.0f} Hz, relative", "theory", abs(value), allowed, "1")
    correlation = clsim.lateral_measures(long, ears="head").iacc[0]
    spread = 3.0 / np.sqrt(0.11 * seeds * bands / np.sqrt(2.0)) + 0.03
    for f, value, allowed in zip(bands.tolist(), correlation, spread.tolist(), strict=True):
        measured(f"IACC of a sphere in a tail, {f:.0f} Hz", "theory", abs(value - diffuse_iacc(f)), allowed, "1")


def diffuse_iacc(centre):
    """The largest correlation within 1 ms of ears in a diffuse field, white in an octave with the band filter's edges."""
    frequencies = np.linspace(0.25 * centre, 4.0 * centre, 1500)
    off = (frequencies / centre - centre / frequencies) * np.sqrt(2.0)
    cross, power = diffuse_coherence(frequencies, clsim.SphericalHead()) / (1.0 + off**6)
    lags = np.linspace(-1e-3, 1e-3, 401)
    return np.abs(np.cos(2.0 * np.pi * np.outer(lags, frequencies)) @ cross).max() / power.sum()


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


def test_values_are_table_values_between_directions():
    """Harmonics of order 8 all over the sphere and at its poles: cubics miss (n h)**4 3 / 128 at angles h apart."""
    towards = np.concatenate([fibonacci_sphere(3000), [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, -1e-17, 0.0)]])
    found = table_values(real_harmonics(8, table_directions(72)).astype(np.float32), towards)
    # Twice that: along both angles.
    assert np.abs(found - real_harmonics(8, towards)).max() <= 2.0 * 3.0 / 128.0 * (8.0 * np.pi / 72.0) ** 4


def test_a_decoded_recording_is_what_ears_hear():
    """Below the frequency that order 7 holds, a decoded wave is the head's own to -80 dB; order 1 is not."""
    room = clsim.Shoebox(size=(40.0, 40.0, 40.0), walls=clsim.Material.from_reflection(0.5))
    sound = clsim.Signal.noise(0.2, RATE, 1, band=(200.0, 1.2e3), fade=0.02)
    receivers = [
        clsim.Receiver.ambisonic("seven", clsim.Trajectory.fixed(PLACE), order=7),
        clsim.Receiver.ambisonic("N3D", clsim.Trajectory.fixed(PLACE), order=7, normalization="N3D"),
        clsim.Receiver.ambisonic("one", clsim.Trajectory.fixed(PLACE), order=1),
        clsim.Receiver.binaural("head", clsim.Trajectory.fixed(PLACE)),
    ]
    source = clsim.Source("s", sound, clsim.Trajectory.fixed((25.0, 23.0, 21.0)))
    scene = clsim.Scene(room, clsim.Air(), [source], receivers)
    found = clsim.render(clsim.find_paths(scene, max_order=0), RATE, duration=0.25)
    ears = found.samples[found.rows_of("head")]

    def error(name):
        decoded = clsim.decode_binaural(found, receiver=name)
        assert [channel for _, channel in decoded.channels] == ["left", "right"]
        return np.linalg.norm(decoded.pressure - ears) / np.linalg.norm(ears)

    assert error("seven") <= 10 ** (-80.0 / 20.0)
    assert error("N3D") <= 10 ** (-80.0 / 20.0)
    assert error("one") > 0.1
    with pytest.raises(clsim.InputError, match="ambisonic"):
        clsim.decode_binaural(found, receiver="head")
    with pytest.raises(clsim.InputError, match="normalization: must be SN3D of 'seven', but is 'N3D'"):
        clsim.decode_binaural(found, receiver="seven", normalization="N3D")
    with pytest.raises(clsim.InputError, match="hrtf: must be a SOFA file or a directivity of two ears"):
        clsim.decode_binaural(found, clsim.Omni())


def test_lateral_measures_take_heads_and_components():
    room = clsim.Shoebox(size=(6.0, 5.0, 3.0), walls=clsim.Material.from_reflection(0.8))
    sound = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=16e3, fade=0.02)
    facing = clsim.Trajectory.fixed((4.5, 2.1, 1.4), (0.0, 0.0, 1.0, 0.0))  # looks along -x, at the source
    receivers = [
        clsim.Receiver.binaural("head", facing),
        clsim.Receiver.ambisonic("hoa", facing, 1),
        clsim.Receiver.ambisonic("N3D", facing, 1, "N3D"),
        clsim.Receiver("omni", clsim.Trajectory.fixed((4.5, 2.1, 1.4))),
        clsim.Receiver("eight", clsim.Trajectory.fixed((4.5, 2.1, 1.4)), clsim.FirstOrder(0.0), aim=(0.0, 1.0, 0.0)),
    ]
    source = clsim.Source("s", sound, clsim.Trajectory.fixed((1.5, 3.0, 1.7)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), max_order=4)
    responses = clsim.impulse_responses(paths, 16e3, band=(200.0, 6e3), tail="off", lead="keep")
    made = clsim.lateral_measures(responses, "hoa", "head")
    apart = clsim.lateral_measures(responses, ("omni", "eight"), ("head left", "head right"))
    for one in (made, clsim.lateral_measures(responses, "N3D")):
        np.testing.assert_allclose(one.lf, apart.lf, rtol=1e-6)
        np.testing.assert_allclose(one.lfc, apart.lfc, rtol=1e-6)
    np.testing.assert_array_equal(made.iacc, apart.iacc)
    assert np.all((made.iacc > 0.0) & (made.iacc <= 1.0))
