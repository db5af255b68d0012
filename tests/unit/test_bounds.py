"""Values beyond all use are refused by name; values that are merely large or small are not."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile

import clsim
from clsim import Air, Electronics, InputError, Material, MeshRoom, Receiver, Scene, Shoebox, Signal, Source, Trajectory
from clsim.arrays import as_count, as_floats, as_number
from clsim.scene.directivity.patterns import Piston
from clsim.scene.transducer import Transducer
from clsim.study.file import load_study

WALL = Material.from_reflection(0.5)
TONE = Signal.tone(40e3, 0.01, 192e3, fade=0.004)
HERE = Trajectory.fixed((1.0, 1.0, 1.0))
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]


def scene(source: Source, receiver: Receiver, **more: float) -> Scene:
    return Scene(Shoebox((4.0, 3.0, 2.0), WALL), Air(), [source], [receiver], **more)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Signal.tone(40e3, 0.01, 192e3, amplitude=1e300), r"^amplitude: must be at most 1e\+12 Pa, but is 1e\+300 Pa"),
        (lambda: Signal.tone(40e3, 0.01, 192e3, phase=1e300), "^phase: must be at most"),
        (lambda: Signal.tone(1e-300, 0.01, 192e3), "^frequency: must be at least 0.001 Hz"),
        (lambda: Signal.chirp(1e3, 2e3, 0.01, 192e3, amplitude=-1e300), "^amplitude: must be at least"),
        (lambda: Signal.noise(0.01, 192e3, 1, rms=1e300), "^rms: must be at most"),
        (lambda: Signal.from_array([0.0, -1e300], 192e3), r"^samples\[1\]: must be within 1e\+12 Pa, but is -1e\+300 Pa"),
        (lambda: Signal.pulses(TONE, 1e308, 2), r"^period: must be at most 1e\+07 s"),
        (lambda: Signal.pulses(TONE, 1.0, 2**63 - 1), "^count: must be from 1 to 10000000, but is 9223372036854775807"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=192e3, repeats=2**63 - 1), "^repeats: must be from 1 to 27"),
        (lambda: Signal.sequence(carrier=40e3, chip_rate=1e-3, sampling_rate=192e3), "^chip_rate: must be high enough for a period"),
        (lambda: Air(speed_of_sound=0.343), "^speed_of_sound: must be at least 100 m/s, but is 0.343 m/s"),
        (lambda: Air(speed_of_sound=34300.0), "^speed_of_sound: must be at most 2000 m/s"),
        (lambda: Air(speed_of_sound=3e8), "^speed_of_sound: must be at most 2000 m/s"),
        (lambda: Shoebox((1e200, 3.0, 2.0), WALL), r"^size\[0\]: must be at most 100000 m, but is 1e\+200 m"),
        (lambda: Shoebox((4.0, 3.0, 1e-300), WALL), r"^size\[2\]: must be at least 0.0001 m"),
        (lambda: MeshRoom.from_plan(SQUARE, 1e300, WALL), "^height: must be at most 100000 m"),
        (lambda: MeshRoom.from_plan([(0, 0), (1e300, 0), (1, 1)], 2.0, WALL), r"^outline\[1\]\[0\]: must be within 1e\+08 m"),
        (lambda: MeshRoom([(0, 0, 0), (1e300, 0, 0), (0, 1, 0)], [(0, 1, 2)], WALL), r"^vertices\[1\]\[0\]: must be within"),
        (lambda: Trajectory.circle((1, 1, 1), 1.0, 1e308, 1.0), "^period: must be at most"),
        (lambda: Trajectory.circle((1, 1, 1), 1.0, 1.0, 1.0, axis=(1e300, 0, 0)), r"^axis\[0\]: must be within 1e\+100"),
        (lambda: Trajectory.circle((1, 1, 1), 1.0, 1.0, 1.0, axis=(5e-324, 0, 0)), "^axis: must be a direction"),
        (lambda: Trajectory.fixed((1, 1, 1), (1e300, 0, 0, 0)), r"^orientation\[0\]: must be within 1e\+100"),
        (lambda: Trajectory.fixed((1, 1, 1), (0, 90, 0, 0)), "^orientation: must be a unit quaternion x y z w, but its norm is 90"),
        (lambda: Receiver("r", HERE, aim=(0.0, 1e300, 0.0)), r"^aim\[1\]: must be within"),
        (lambda: Receiver("r", HERE, aim=(0.0, 0.0, 0.0)), "^aim: must be a direction, but is 0, 0, 0"),
        (lambda: scene(Source("s", TONE, HERE), Receiver("r", Trajectory.fixed((2, 2, 1))), min_distance=1e-300), "^min_distance: must be at least 1e-06 m"),
        (lambda: Piston(1e300), "^radius: must be at most 1 m"),
        (lambda: Piston(4.7), "^radius: must be at most 1 m, but is 4.7 m; .*: 4.7 mm are 0.0047 m"),
        (lambda: Transducer.resonance(40e3, 2e3, 1e300), "^sensitivity: must be at most"),
        (lambda: Transducer.from_table([1e3, 2e3], [1.0, 1e300]), r"^values\[1\]: must be within"),
        (lambda: Transducer.from_impulse_response([1e-300], 192e3), "^samples: must not all be 0"),
        (lambda: Electronics(adc_bits=8, adc_full_scale=1e-300), "^adc_full_scale: must be at least"),
        (lambda: Electronics(low_cut=1e-300), "^low_cut: must be at least 0.001 Hz"),
        (lambda: Material.from_solid(1e300, 1e300), "^density: must be at most"),
        (lambda: clsim.grid_positions((-1e308, 1e308, 3), 1.0, 1.0), r"^x\[0\]: must be at least -1e\+08 m"),
        (lambda: as_number("n", 10**400), "^n: must be finite, but is inf"),
        (lambda: as_count("n", 10**5000, at_most=1), "^n: must be from 0 to 1, but is too long to be shown"),
        (lambda: as_floats("n", [10**400], (1,)), "^n: must be numbers"),
    ],
)  # fmt: skip
def test_what_is_beyond_all_use_is_refused_by_name(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Signal.tone(0.01, 100.0, 1e3, amplitude=-2e3),
        lambda: Signal.tone(5e6, 1e-5, 20e6, amplitude=20e-6),
        lambda: Signal.from_array([8_388_607, -8_388_608], 96e3, scale=2.0**-23),
        lambda: Signal.pulses(TONE, 0.1, 864_000),
        lambda: Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=192e3, repeats=2000),
        lambda: Air(speed_of_sound=135.0),
        lambda: Air(speed_of_sound=1540.0),
        lambda: Shoebox((0.005, 0.01, 0.002), WALL),
        lambda: Shoebox((20e3, 500.0, 100.0), WALL),
        lambda: MeshRoom([(5e5, 5e6, 0), (5e5 + 1, 5e6, 0), (5e5, 5e6 + 1, 0)], [(0, 1, 2)], WALL),
        lambda: Receiver("r", HERE, aim=(1e-9, 0.0, 0.0)),
        lambda: Transducer.resonance(40e3, 2e3, 1e-6),
        lambda: Piston(1e-4),
    ],
)
def test_what_somebody_may_want_is_not_refused(make) -> None:
    make()


def test_a_tone_may_have_the_shortest_fade() -> None:
    faded = Signal.tone(40e3, 0.001, 192e3, fade=5e-324).read(0, 192)
    np.testing.assert_allclose(faded, Signal.tone(40e3, 0.001, 192e3).read(0, 192), atol=1e-12)


def test_a_sequence_in_pieces_is_the_sequence() -> None:
    from clsim.scene.signal.waveforms import Sequence, shaped_count, shaped_sequence

    whole = shaped_sequence(Sequence("mls", 10, 0, 5, 8e3, 40e3, 0.5, 1.0), 192e3)
    assert len(whole) == shaped_count(5 * 1023, 8e3, 192e3) > 2**16
    one = shaped_sequence(Sequence("mls", 10, 0, 1, 8e3, 40e3, 0.5, 1.0), 192e3)
    # A period is 24 552 samples, 5115 cycles of the carrier; away from the ends all periods are the same.
    inside = slice(1000, 20_000)
    for period in range(5):
        np.testing.assert_allclose(whole[24_552 * period :][inside], one[inside], atol=1e-9)


def test_wav_files_have_bounds_of_scale_and_samples(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    soundfile.write(path, np.array([0.5, -0.5], np.float32), 48_000, subtype="FLOAT")
    for make in (Signal.from_wav, Transducer.from_wav, Material.from_wav):
        with pytest.raises(InputError, match=r"^scale: must be at most 1e\+12, but is 1e\+300"):
            make(path, scale=1e300)
    soundfile.write(path, np.array([0.5, 1e30], np.float32), 48_000, subtype="FLOAT")
    with pytest.raises(InputError, match=r"^path: must hold finite samples, but \[1\] of .* is 1e\+30"):
        Signal.from_wav(path)


@pytest.mark.filterwarnings("ignore:amplitude. gives samples:clsim.ClsimWarning")
@pytest.mark.parametrize("engine", ["reference", "opencl"])
def test_what_float32_does_not_hold_is_refused_when_it_arises(engine: str, request) -> None:
    if engine == "opencl":
        request.getfixturevalue("device")
    loud = Signal.tone(40e3, 0.002, 192e3, amplitude=1e12, fade=0.001)
    deaf = Transducer.from_impulse_response([1e12], 192e3)
    made = scene(
        Source("s", loud, HERE, transducer=deaf),
        Receiver("r", Trajectory.fixed((2.0, 2.0, 1.0)), transducer=deaf, electronics=Electronics(gain_db=200.0)),
    )
    paths = clsim.find_paths(made, 0)
    with pytest.raises(
        InputError, match=r"^receivers: must receive what float32 holds, but of 'r' sample \d+ is -?(inf|nan)"
    ):
        clsim.render(paths, 192e3, engine=engine, responses="centre", duration=0.01)


def test_paths_that_walls_of_reflection_0_silence_are_left_out() -> None:
    room = Shoebox((4.0, 3.0, 2.0), Material.from_reflection(0.0))
    made = Scene(room, Air(), [Source("s", TONE, HERE)], [Receiver("r", Trajectory.fixed((2.0, 2.0, 1.0)))])
    plan = clsim.plan_render(clsim.find_paths(made, 1), 192e3, prune_below_db=-60.0, engine="reference")
    assert plan.path_count == 1
    assert plan.left_out.endswith(
        "6 paths that stay below -60 dB of the strongest are left out; all of them together are silent"
    )


def test_a_time_beyond_all_decimals_is_told(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("1e999999999,0,0,0,1,0,0,0\n" * 4)
    with pytest.raises(InputError, match=r"^path: poses\.csv, line 1: t must be a finite number, but is '1e999999999'"):
        Trajectory.from_file(path, "euroc")


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        (
            "random = { uniform = [0, 1" + "0" * 400 + "] }",
            r"^vary\[0\].random.uniform\[1\]: must be a number of 64 bits",
        ),
        ("random = { uniform = [-1.7e308, 1.7e308] }", r"^vary\[0\].random.uniform: must be within 1e\+300"),
        ("random = { normal = [[0, 0], [[1], [1]]] }", None),
        ("random = { normal = [1, -0.0] }", None),
        ("range = { start = -1.7e308, stop = 1.7e308, count = 2 }", r"^vary\[0\].range: must be of finite width"),
    ],
)
def test_draws_that_no_generator_makes_are_told(vary: str, message: str | None, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("format = 1\nmin_distance = 0.01\n")
    draws = "draws = 3\n" if "random" in vary else ""
    (tmp_path / "study.toml").write_text(
        f'format = 1\nscene = "scene.toml"\n{draws}[[vary]]\nfield = "min_distance"\n{vary}\n'
    )
    if message is None:
        assert len(load_study(tmp_path / "study.toml").members) == 3
        return
    with pytest.raises(InputError, match=message):
        load_study(tmp_path / "study.toml")


def test_an_empty_key_is_told(tmp_path: Path) -> None:
    from clsim.scene_file import load_scene

    (tmp_path / "scene.toml").write_text('"" = 1\n')
    with pytest.raises(InputError, match=r'scene.toml: "": is no known key'):
        load_scene(tmp_path / "scene.toml")


def test_bounds_leave_products_finite() -> None:
    from clsim.arrays import FARTHEST, LOUDEST

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert math.isfinite(LOUDEST**3 * FARTHEST**4)
