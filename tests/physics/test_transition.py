"""How paths begin and end in the sound."""

import numpy as np
import pytest
from exhaustive import exhaustive, few
from made_meshes import l_room

import clsim
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.planning import plan_render

RATE, TONE = 192e3, 40e3
SIGNAL = clsim.Signal.tone(TONE, 0.4, RATE, fade=0.002)
WALL = clsim.Material.from_reflection(0.9)


def gap(transition: float, first: float = 0.04, last: float = 0.06, step: float = 1e-3) -> clsim.Tracks:
    """Return one path of constant delay and gain that is not heard between two times."""
    times = np.arange(round(0.1 / step) + 1) * step
    delay = np.full((1, len(times)), 0.01)
    delay[0, (times > first + 1e-9) & (times < last - 1e-9)] = np.nan
    gain = np.where(np.isnan(delay), np.nan, 0.5)
    return clsim.Tracks.from_samples(times, delay, gain, transition=transition)


def raised_cosine(times: np.ndarray, at: float, length: float) -> np.ndarray:
    """Return a rise from 0 to 1 centred at a time, written down anew."""
    x = (times - (at - length / 2)) / length
    return np.where(x <= 0, 0.0, np.where(x >= 1, 1.0, np.sin(0.5 * np.pi * np.clip(x, 0, 1)) ** 2))


def rendered(tracks: clsim.Tracks, engine: str) -> np.ndarray:
    return clsim.render_tracks([SIGNAL], tracks, RATE, engine=engine, duration=0.1).pressure[0]


def test_gates_are_silent_from_sample_to_sample(engine: str) -> None:
    pressure = rendered(gap(0.0), engine)
    # Heard up to 40 ms and again from 60 ms on.
    assert not np.any(pressure[7680:11520])
    n = np.r_[3000:7680, 11520:19000]
    exact = 0.5 * np.sin(2 * np.pi * TONE * (n / RATE - 0.01))
    assert np.abs(pressure[n] - exact).max() < 1e-4


@pytest.mark.parametrize("length", [1e-3, 3.7e-3, 12e-3])
def test_raised_cosines_are_centred_on_the_boundary(length: float, engine: str) -> None:
    pressure = rendered(gap(length), engine)
    n = np.arange(3000, 19000)
    times = n / RATE
    weight = 1.0 - raised_cosine(times, 0.04, length) + raised_cosine(times, 0.06, length)
    exact = 0.5 * weight * np.sin(2 * np.pi * TONE * (times - 0.01))
    assert np.abs(pressure[n] - exact).max() < 1e-4


def test_a_path_that_is_heard_for_less_than_a_transition_fades_in_and_out(engine: str) -> None:
    times = np.arange(1001) / 10000.0
    delay = np.full((1, 1001), np.nan)
    delay[0, 500:504] = 0.01  # 0.3 ms
    tracks = clsim.Tracks.from_samples(times, delay, np.where(np.isnan(delay), np.nan, 0.5), transition=1e-3)
    pressure = rendered(tracks, engine)
    n = np.arange(19000)
    t = n / RATE
    weight = raised_cosine(t, 0.05, 1e-3) - raised_cosine(t, 0.0503, 1e-3)  # those that follow add up to one
    assert np.abs(pressure[n] - 0.5 * weight * np.sin(2 * np.pi * TONE * (t - 0.01))).max() < 1e-4
    assert np.abs(pressure).max() > 0.1


def splatter_db(transition: float, engine: str) -> float:
    """Return the level 5 kHz off the tone around one boundary, against the tone's own."""
    pressure = rendered(gap(transition), engine)[7680 - 1920 : 7680 + 1920].astype(float)
    spectrum = np.abs(np.fft.rfft(pressure * np.blackman(len(pressure))))
    frequencies = np.fft.rfftfreq(len(pressure), 1 / RATE)
    off = np.abs(np.abs(frequencies - TONE) - 5e3) < 300.0
    return float(20 * np.log10(spectrum[off].max() / spectrum.max()))


def test_a_transition_of_a_millisecond_does_not_splatter(engine: str) -> None:
    # The spectrum of a step is that of its slope over j 2 pi f, and the slope's is cos(pi f L) / (1 - (2 f L)²): at 4.7
    # to 5.3 kHz off and L = 1 ms at most -43 dB, less what the window smears.
    gate = splatter_db(0.0, engine)
    assert -55.0 < gate < -30.0
    assert splatter_db(1e-3, engine) < gate - 40.0


def test_paths_that_follow_each_other_add_up_to_one(engine: str) -> None:
    times = np.linspace(0.0, 0.1, 101)
    delay = np.full((2, 101), 0.01)
    delay[0, 51:], delay[1, :50] = np.nan, np.nan  # one ends where the other begins
    tracks = clsim.Tracks.from_samples(times, delay, np.where(np.isnan(delay), np.nan, 0.5))
    pressure = rendered(tracks, engine)
    n = np.arange(3000, 19000)
    # The boundaries are the samples at 50 ms for both.
    assert np.abs(pressure[n] - 0.5 * np.sin(2 * np.pi * TONE * (n / RATE - 0.01))).max() < 1e-4


def walk(transition: float = 1e-3) -> tuple[clsim.Scene, clsim.PathSet]:
    """Return an L-shaped room, a receiver round the corner and a source that walks past it."""
    room = clsim.MeshRoom(*l_room(), WALL)
    line = clsim.Trajectory.line((2.0, 8.0, 1.4), (2.5, 1.0, 1.4), 0.4)  # 17 m/s
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((7.0, 3.0, 1.6)))]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", SIGNAL, line)], ears)
    return scene, clsim.find_paths(scene, 3)


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("transition", few([1e-3, 0.0]))
def test_engines_agree_while_paths_come_and_go(transition: float) -> None:
    _scene, paths = walk()
    ends = np.concatenate([paths.start, paths.end])
    assert np.sum(np.isfinite(ends)) > 30
    made = plan_render(paths, RATE, duration=0.4, transition=transition, responses="centre")
    first, last = (round(time * RATE) for time in (0.15, 0.25))  # of the slow engine
    assert np.sum((ends > 0.15) & (ends < 0.25)) > 5
    got = OpenclEngine(made).render(0, made.samples)[0, first:last]
    wanted = ReferenceEngine(made).render(first, last)[0]
    assert 20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted)) < -98.0


@pytest.mark.parametrize("engine", ["opencl", exhaustive("reference")], indirect=True)
def test_no_step_is_larger_than_the_transition_allows(engine: str) -> None:
    # With one path at a time: what the envelope of a path can do in a sample is the slope of its raised cosine, gain
    # times pi / 2 per transition, besides what its motion does.
    _scene, paths = walk()
    length = 1e-3
    signal = clsim.render(paths, RATE, duration=0.4, engine=engine, transition=length).pressure[0]
    from scipy.signal import hilbert

    envelope = hilbert(signal) * np.exp(-2j * np.pi * TONE * np.arange(len(signal)) / RATE)
    table = paths.table(np.linspace(0.05, 0.39, 341))
    gains = np.abs(np.nan_to_num(table.gain))
    turning = 2 * np.pi * TONE * np.abs(np.nan_to_num(table.doppler_factor, nan=1.0) - 1.0)
    bound = gains.sum(axis=0).max() * (0.5 * np.pi / length + turning.max()) / RATE
    inner = slice(round(0.05 * RATE), round(0.39 * RATE))
    assert np.abs(np.diff(envelope[inner])).max() < 1.1 * bound


def test_nothing_is_heard_without_a_path(engine: str) -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((7.5, 3.0, 1.6)))]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", SIGNAL, clsim.Trajectory.fixed((1.0, 8.5, 1.4)))], ears)
    paths = clsim.find_paths(scene, 0)
    assert len(paths) == 0
    assert paths.table([0.0, 0.1]).delay.shape == (0, 2)
    recording = clsim.render(paths, RATE, duration=0.1, engine=engine)
    assert recording.pressure.shape == (1, 19200)
    assert not np.any(recording.pressure)
    assert clsim.render(paths, RATE, engine=engine).pressure.shape == (1, round(0.4 * RATE))


@pytest.mark.parametrize("value", ["fade", "gate", -1e-3, 2.0, float("nan"), None, True])
def test_transitions_that_are_none_are_refused(value: object) -> None:
    with pytest.raises(clsim.InputError, match="transition: must be"):
        clsim.track(walk()[1] if value == "fade" else PATHS, transition=value)  # type: ignore[arg-type]


SHOEBOX = clsim.Scene(
    clsim.Shoebox((8, 6, 3), WALL), clsim.Air(), [clsim.Source("s", SIGNAL, clsim.Trajectory.fixed((2, 2, 1)))],
    [clsim.Receiver("r", clsim.Trajectory.fixed((7, 3, 1.6)))],
)  # fmt: skip
PATHS = clsim.find_paths(SHOEBOX, 0)
