"""Against Acoular: what microphones hear of a point source that moves in free field.

Acoular emits at 1 m what clsim does, solves for the time of emission as clsim does, and takes the nearest sample of
the signal at `up` times its sampling rate. Without `conv_amp` the gain is 1/r, clsim's "static"; with it
1 / (r (1 - M)^2), clsim's "convective". clsim's own "wave-equation", 1 / (r (1 - M)), is their geometric mean.
Before the first arrival Acoular reads the signal from its end on, so that the signals here end in silence.
"""

import importlib
import importlib.util
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clsim

SPEED = 343.0  # m/s
RATE = 48e3
DURATION = 0.25  # s
SOUNDING = 0.2  # s, of it
EARS = np.array([(10.0, 11.0, 10.0), (14.0, 9.0, 12.0), (3.0, 10.5, 9.0)])
RENDERING_DB = -86.0  # what rendering is said to be within
SWEEP = (1500.0, 4000.0)  # Hz


def motions() -> dict[str, clsim.Trajectory]:
    """Return a source that passes at 40 m/s, and one that circles five times a second, at 31 m/s."""
    return {
        "line": clsim.Trajectory.line((5.0, 10.0, 10.0), (15.0, 10.0, 10.0), DURATION),
        "circle": clsim.Trajectory.circle((10.0, 7.0, 10.0), radius=1.0, period=0.2, duration=DURATION),
    }


def acoular_module() -> Any:
    """Return Acoular, which warns on import that with OpenBLAS loaded it computes on one thread."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "We detected that Numpy is already loaded", UserWarning)
        return importlib.import_module("acoular")


@pytest.fixture(scope="session")
def theirs(once: Any) -> Callable[..., np.ndarray]:
    """Return a function from a motion to the signals of Acoular's microphones; compiling it takes seconds."""
    if importlib.util.find_spec("acoular") is None:
        pytest.skip("acoular is not installed")

    def found(motion: str, up: int, *, convective: bool) -> np.ndarray:
        name = f"Acoular, {motion}, {up}, {convective}"
        return np.asarray(
            once(name, lambda: their_sound(acoular_module(), scene_of(motions()[motion]), up, convective))
        )

    return found


def sweep(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a sweep that swells and fades at times (...), s, and its slope, 1/s."""
    low, high = SWEEP
    phase = 2.0 * np.pi * (low * times + 0.5 * (high - low) / SOUNDING * times**2)
    turning = 2.0 * np.pi * (low + (high - low) / SOUNDING * times)
    swell = np.sin(np.pi * times / SOUNDING) ** 2
    swelling = np.pi / SOUNDING * np.sin(2.0 * np.pi * times / SOUNDING)
    on = (times >= 0.0) & (times <= SOUNDING)
    slope = swelling * np.cos(phase) - swell * turning * np.sin(phase)
    return np.where(on, swell * np.cos(phase), 0.0), np.where(on, slope, 0.0)


def scene_of(motion: clsim.Trajectory) -> clsim.Scene:
    emitted = sweep(np.arange(round(DURATION * RATE)) / RATE)[0]
    return clsim.Scene(
        clsim.Shoebox((20.0, 20.0, 20.0), clsim.Material.from_reflection(0.5)),
        clsim.Air(speed_of_sound=SPEED, absorption=False),
        [clsim.Source("s", clsim.Signal.from_array(emitted, RATE), motion)],
        [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(ear)) for i, ear in enumerate(EARS)],
    )


def their_sound(acoular: Any, scene: clsim.Scene, up: int, convective: bool) -> np.ndarray:
    """Return the signals of Acoular's microphones (receivers, samples)."""
    motion, emitted = scene.sources[0].trajectory, sweep(np.arange(round(DURATION * RATE)) / RATE)[0]
    # A cubic spline through points 1 ms apart is off by (1 ms)^4 / 384 times the fourth derivative, 3e-9 m on the circle.
    told = np.linspace(0.0, DURATION, 251)
    points = {float(t): tuple(map(float, place)) for t, place in zip(told, motion.position(told), strict=True)}
    samples = acoular.TimeSamples(data=emitted[:, None], sample_freq=RATE)
    source = acoular.MovingPointSource(
        signal=acoular.GenericSignalGenerator(source=samples), mics=acoular.MicGeom(pos_total=EARS.T),
        env=acoular.Environment(c=SPEED), trajectory=acoular.Trajectory(points=points), up=up, conv_amp=convective,
    )  # fmt: skip
    return np.concatenate([np.array(block) for block in source.result(1024)]).T


def check(paths: clsim.PathSet, mine: np.ndarray, theirs: np.ndarray, amplitude: str, up: int) -> None:
    """Compare sound (receivers, samples), given how finely Acoular took the signal.

    The nearest of samples a time T apart is off by up to T/2, evenly spread: T / sqrt(12) in root mean square, by which
    the slope of the signal, at the time of emission and with the path's gain, is multiplied. The square of what is
    evenly spread has a relative variance of 0.8, and so the sum of ``slope² off²`` one of
    ``0.8 sum(slope^4) / sum(slope²)²``; five deviations of it are allowed to either side.
    """
    times = np.arange(mine.shape[1]) / RATE
    table = paths.table(times, amplitude=amplitude)
    slope = table.gain * sweep(times - table.delay)[1]
    jitter = rms(slope) / (RATE * up * np.sqrt(12.0))
    spread = 5.0 * np.sqrt(0.8 * np.sum(slope**4, axis=1)) / np.sum(slope**2, axis=1)
    own = 10.0 ** (RENDERING_DB / 20.0) * rms(mine)
    off = rms(mine - theirs)
    assert mine.shape == theirs.shape
    np.testing.assert_array_less(off, np.sqrt(jitter**2 * (1.0 + spread) + own**2))
    np.testing.assert_array_less(np.sqrt(np.maximum(jitter**2 * (1.0 - spread) - own**2, 0.0)), off)


def rms(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["line", "circle"])
def test_a_moving_source_as_it_comes(theirs, engine: str, motion: str) -> None:
    """clsim's own amplitude is the geometric mean of Acoular's two, whose samples are taken at the same times."""
    scene, up = scene_of(motions()[motion]), 512
    paths = clsim.find_paths(scene, max_order=0)
    mine = clsim.render(paths, RATE, duration=DURATION, engine=engine).pressure.astype(float)
    static, convective = (theirs(motion, up, convective=c) for c in (False, True))
    check(paths, mine, np.sign(static) * np.sqrt(static * convective), "wave-equation", up)


@pytest.mark.parametrize("motion", ["line", "circle"])
def test_amplitudes_of_a_moving_source(theirs, motion: str) -> None:
    """Each of the two that Acoular knows."""
    scene, up = scene_of(motions()[motion]), 512
    paths = clsim.find_paths(scene, max_order=0)
    for amplitude, convective in (("static", False), ("convective", True)):
        found = clsim.render(paths, RATE, duration=DURATION, engine="reference", amplitude=amplitude)
        sound = theirs(motion, up, convective=convective)
        check(paths, found.pressure.astype(float), sound, amplitude, up)


def test_finer_samples_come_nearer(theirs) -> None:
    """What is left between the two is Acoular's choice of samples, and falls with it from -43 to -67 dB."""
    scene = scene_of(motions()["line"])
    paths = clsim.find_paths(scene, max_order=0)
    found = clsim.render(paths, RATE, duration=DURATION, engine="reference", amplitude="static")
    for up in (16, 64, 256):
        check(paths, found.pressure.astype(float), theirs("line", up, convective=False), "static", up)


def array_recording() -> clsim.Recording:
    """A talker's band of noise at an array of 16 microphones, two of their radii of 0.1 and 0.2 m."""
    angle = 2.0 * np.pi * np.arange(16) / 16.0
    ring = np.where(np.arange(16) % 2 == 0, 0.2, 0.11)
    places = np.stack([ring * np.cos(angle), ring * np.sin(angle), 0.0 * angle], axis=1)
    array = clsim.receiver_array("array", places, clsim.Trajectory.fixed((10.0, 10.0, 10.0)))
    noise = clsim.Signal.noise(0.4, RATE, 3, band=(3000.0, 6000.0), fade=0.02)
    source = clsim.Source("s", noise, clsim.Trajectory.fixed((10.12, 9.92, 10.6)))
    room = clsim.Shoebox((20.0, 20.0, 20.0), clsim.Material.from_reflection(0.5))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=SPEED), [source], array)
    return clsim.render(clsim.find_paths(scene, max_order=0), RATE, duration=0.4)


def test_files_of_an_array_are_as_acoular_reads_them(tmp_path) -> None:
    """Samples over channels with their rate, and places that `positions_from_file` reads as Acoular does."""
    h5py, recording = pytest.importorskip("h5py", reason="h5py is not installed"), array_recording()
    samples, geometry = clsim.write_acoular(recording, tmp_path / "array.h5")
    signals, places = clsim.array_signals(recording)
    with h5py.File(samples) as file:
        np.testing.assert_array_equal(file["time_data"], signals.T)
        assert file["time_data"].attrs["sample_freq"] == RATE
    np.testing.assert_array_equal(clsim.positions_from_file(geometry), places)


@pytest.mark.exhaustive
def test_acoular_finds_a_source_in_files_of_an_array(tmp_path) -> None:
    """Its conventional beamformer's map is loudest where the source is, within a step of its grid."""
    if importlib.util.find_spec("acoular") is None:
        pytest.skip("acoular is not installed")
    acoular = acoular_module()
    samples, geometry = clsim.write_acoular(array_recording(), tmp_path / "array.h5")
    acoular.config.global_caching = "none"
    grid = acoular.RectGrid(x_min=-0.3, x_max=0.3, y_min=-0.3, y_max=0.3, z=0.6, increment=0.02)
    steer = acoular.SteeringVector(
        grid=grid, mics=acoular.MicGeom(file=geometry), env=acoular.Environment(c=SPEED), steer_type="true level"
    )
    source = acoular.TimeSamples(file=samples)
    assert (source.num_channels, source.sample_freq) == (16, RATE)
    spectra = acoular.PowerSpectra(source=source, block_size=512, window="Hanning")
    loud = acoular.BeamformerBase(freq_data=spectra, steer=steer).synthetic(4500.0, 1)
    x, y = np.unravel_index(np.argmax(loud), loud.shape)
    np.testing.assert_allclose([-0.3 + 0.02 * x, -0.3 + 0.02 * y], [0.12, -0.08], atol=0.021)


def test_pyroomacoustics_finds_the_direction_of_a_source_from_an_array() -> None:
    """Its MUSIC, on the signals and positions as they are, within its grid of 2 degrees and the near field's 1."""
    others = pytest.importorskip("pyroomacoustics", reason="pyroomacoustics is not installed")
    angle = 2.0 * np.pi * np.arange(6) / 6.0
    places = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    pose = clsim.Trajectory.fixed((10.0, 10.0, 10.0), (0.0, 0.0, np.sin(0.25), np.cos(0.25)))  # turned by 0.5 rad
    noise = clsim.Signal.noise(0.4, RATE, 3, band=(500.0, 4000.0), fade=0.02)
    far = np.array([10.0, 10.0, 10.0]) + 5.0 * np.array([np.cos(1.3), np.sin(1.3), 0.0])
    scene = clsim.Scene(
        clsim.Shoebox((20.0, 20.0, 20.0), clsim.Material.from_reflection(0.5)), clsim.Air(speed_of_sound=SPEED),
        [clsim.Source("s", noise, clsim.Trajectory.fixed(far))], clsim.receiver_array("array", places, pose),
    )  # fmt: skip
    signals, positions = clsim.array_signals(clsim.render(clsim.find_paths(scene, max_order=0), RATE, duration=0.4))
    size = 512
    spectra = np.stack([others.transform.stft.analysis(one, size, size // 2).T for one in signals.astype(float)])
    music = others.doa.MUSIC(positions.T, RATE, size, c=SPEED, n_grid=180)
    music.locate_sources(spectra, freq_range=[800.0, 3000.0])
    off = (music.azimuth_recon[0] - (1.3 - 0.5) + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(np.degrees(off)) <= 3.0
