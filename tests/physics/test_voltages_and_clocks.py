"""Drive voltage in, voltage out, and clocks, on both engines."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.render.plan import SEGMENT

RATE = 192e3
AIR = clsim.Air()
ROOM = clsim.Shoebox((6, 5, 4), clsim.Material.from_reflection(0.8))
SPEAKER, EAR = clsim.Transducer.named("MA40S4S"), clsim.Transducer.named("MA40S4R")


def rendered(source: clsim.Source, *receivers: clsim.Receiver, order: int = 0, rate: float = RATE, **options):
    scene = clsim.Scene(ROOM, AIR, [source], list(receivers))
    return clsim.render(clsim.find_paths(scene, order), rate, **options)


def error_db(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted) + 1e-15))


def test_ten_volts_give_the_catalogues_level_and_the_receivers_voltage(engine: str) -> None:
    drive = clsim.Signal.tone(40e3, 0.03, RATE, amplitude=10 * np.sqrt(2), fade=0.005)
    source = clsim.Source("s", drive, clsim.Trajectory.fixed((2, 2, 2)), transducer=SPEAKER)
    place = clsim.Trajectory.fixed((2.3, 2, 2))
    bare, ear = clsim.Receiver("bare", place), clsim.Receiver("ear", place, transducer=EAR)
    recording = rendered(source, bare, ear, engine=engine)
    middle = slice(round(0.012 * RATE), round(0.022 * RATE))  # 400 whole periods, long after the onset
    pressure, voltage = np.sqrt(np.mean(recording.samples[:, middle].astype(float) ** 2, axis=1))
    # The model is 0.0013 dB off at resonance for each transducer, at 4.8 samples a period.
    assert 20 * np.log10(pressure / 20e-6) == pytest.approx(120.0, abs=0.005)
    assert 20 * np.log10(voltage / 10) == pytest.approx(120.0 - 94 + 0.0206 - 63, abs=0.01)  # 1 Pa is 93.98 dB
    assert recording.units == ("Pa", "V")
    # The receiver rings on: its recording ends later than all sound.
    assert recording.samples.shape[1] >= 0.03 * RATE + len(EAR.impulse_response(RATE))
    for name in ("pressure", "voltage"):
        with pytest.raises(clsim.InputError, match=r"take recording\.samples"):
            getattr(recording, name)
    assert rendered(source, ear, engine=engine, duration=0.001).voltage.shape == (1, 192)


def test_source_and_receiver_filters_commute_with_the_path(engine: str) -> None:
    chirp = clsim.Signal.chirp(35e3, 45e3, 5e-3, RATE, window="tukey")
    path = clsim.Trajectory.fixed((2, 2, 2)), clsim.Trajectory.fixed((4, 3, 1.5))
    one = rendered(
        clsim.Source("s", chirp, path[0], transducer=SPEAKER), clsim.Receiver("r", path[1], transducer=EAR),
        order=2, engine=engine,
    )  # fmt: skip
    bare = rendered(
        clsim.Source("s", SPEAKER.drive(chirp), path[0]), clsim.Receiver("r", path[1]), order=2, engine=engine
    )
    wanted = np.convolve(bare.pressure[0], EAR.impulse_response(RATE))[: one.samples.shape[1]]
    assert error_db(one.voltage[0, : len(wanted)], wanted) < -120.0


def test_clock_of_50_ppm_turns_the_phase_of_a_tone(engine: str, measured) -> None:
    places = (2, 2, 2), (4, 3, 1.5)
    tone = clsim.Signal.tone(40e3, 0.6, RATE, fade=0.01)
    electronics = clsim.Electronics(clock_ppm=50.0, clock_offset=1e-3)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed(places[1]), electronics=electronics)
    recording = rendered(clsim.Source("s", tone, clsim.Trajectory.fixed(places[0])), ear, engine=engine, duration=0.55)
    distance = float(np.linalg.norm(np.subtract(*places)))
    gain = 10 ** (-float(AIR.absorption_at(40e3)) * (distance - 1) / 20) / distance
    part = slice(round(0.05 * RATE), None)

    def heard(ppm: float, offset: float) -> np.ndarray:
        n = np.arange(recording.samples.shape[1])
        return gain * np.sin(2 * np.pi * 40e3 * (n * (1 + 1e-6 * ppm) / RATE + offset - distance / AIR.speed_of_sound))

    found = error_db(recording.pressure[0, part], heard(50.0, 1e-3)[part])
    measured("tone by a clock of +50 ppm and 1 ms", "formula", found, -90.0)
    # It would see a clock wrong by 0.01 ppm (in phase by 1.4e-3 rad at the end) or 0.01 µs.
    assert error_db(recording.pressure[0, part], heard(50.01, 1e-3)[part]) > -70.0
    assert error_db(recording.pressure[0, part], heard(50.0, 1.00001e-3)[part]) > -60.0
    times = recording.reception_times(0)
    assert times[[0, 1000]] == pytest.approx([1e-3, 1e-3 + 1000 / RATE * 1.00005], abs=1e-15)


MOVING = clsim.Trajectory.circle((3, 2.5, 2), 0.5, 0.5, 1.0), clsim.Trajectory.line((1, 1, 1), (1.5, 1.2, 1.1), 1.0)


def test_a_late_clock_hears_the_same_later_and_a_slow_one_at_another_rate(engine: str) -> None:
    tone = clsim.Signal.tone(40e3, 0.4, RATE, fade=0.01)
    source = clsim.Source("s", tone, MOVING[0])

    def heard(rate: float = RATE, duration: float = 0.06, **clock) -> np.ndarray:
        ear = clsim.Receiver("r", MOVING[1], electronics=clsim.Electronics(**clock))
        return rendered(source, ear, order=1, rate=rate, engine=engine, duration=duration).pressure[0]

    late, plain = heard(clock_offset=960 / RATE), heard(duration=0.07)
    assert error_db(late, plain[960 : 960 + len(late)]) < -85.0
    early = heard(clock_offset=-960 / RATE)
    assert error_db(early[960:], plain[: len(early) - 960]) < -85.0
    slow, sampled = heard(clock_ppm=10_000.0), heard(RATE / 1.01, duration=0.0606)
    assert error_db(slow, sampled[: len(slow)]) < -85.0


def test_clocks_at_a_late_time_stay_exact(engine: str) -> None:
    tone = clsim.Signal.tone(40e3, 0.05, RATE, fade=0.01)
    source = clsim.Source("s", tone, clsim.Trajectory.circle((3, 2.5, 2), 0.5, 0.5, 40.0), start=10.0)
    chunks = {}
    for ppm in (0.0, 100.0):
        ear = clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 1)), electronics=clsim.Electronics(clock_ppm=ppm))
        scene = clsim.Scene(ROOM, AIR, [source], [ear])
        plan = clsim.plan_render(clsim.find_paths(scene, 0), RATE, engine=engine, duration=10.07, chunk=SEGMENT)
        late = int(9.9 * RATE) // SEGMENT * SEGMENT
        kept = [part for _, part in clsim.render_chunks(plan, first=late)]
        chunks[ppm] = np.concatenate(kept, axis=1)[0, -round(0.15 * RATE) :]
    onset = {
        ppm: int(np.flatnonzero(np.abs(samples) > 0.01 * np.abs(samples).max())[0]) for ppm, samples in chunks.items()
    }
    assert onset[0.0] - onset[100.0] == pytest.approx(10.0 * 1e-4 * RATE, abs=4)  # 1 ms early by its own clock


def test_output_does_not_depend_on_chunks(engine: str) -> None:
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.2, RATE, fade=0.01), MOVING[0], transducer=SPEAKER)
    electronics = clsim.Electronics(ambient_noise_db=20.0, self_noise_db=10.0, seed=4, low_cut=30e3, clock_ppm=20.0)
    ear = clsim.Receiver("r", MOVING[1], transducer=EAR, electronics=electronics)
    whole, parts = (rendered(source, ear, engine=engine, duration=0.3, chunk=chunk).voltage for chunk in (10**9, 1))
    assert error_db(parts, whole) < -120.0


def test_converter_counts_what_it_clips(engine: str) -> None:
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.02, RATE, fade=0.002), clsim.Trajectory.fixed((2, 2, 2)))
    place = clsim.Trajectory.fixed((3, 2, 2))
    adc = clsim.Electronics(adc_bits=8, adc_full_scale=0.5)
    with pytest.warns(
        clsim.ClsimWarning, match=r"receivers\[1\].electronics: \d+ of \d+ samples of 'adc' were clipped"
    ):
        recording = rendered(
            source, clsim.Receiver("bare", place), clsim.Receiver("adc", place, electronics=adc), engine=engine
        )
    bare, converted = recording.pressure.astype(float)
    codes = np.rint(bare * 256)
    assert recording.clipped == (0, int(np.count_nonzero((codes > 127) | (codes < -128))))
    np.testing.assert_array_equal(converted, np.clip(codes, -128, 127) / 256)
    assert any("samples clipped" in note for note in recording.notes)


SCENE = scene_text(
    source_at(
        "speaker", tone_of(40e3, 0.0004, amplitude=14.1), (1, 1, 1), transducer={"kind": "named", "name": "MA40S4S"}
    ),
    receiver_at(
        "ear",
        (3.0, 1.0, 1.5),
        transducer={"kind": "wav", "path": "response.wav", "scale": 0.01},
        electronics={
            "self_noise_db": 10.0, "seed": 1, "gain_db": 60.0, "adc_bits": 10, "adc_full_scale": 0.2, "clock_ppm": 30.0,
        },
    ),
    render={"duration": 0.02, "engine": "reference"},
)  # fmt: skip


def test_scene_files_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taps = EAR.impulse_response(RATE) / EAR.sensitivity
    soundfile.write(tmp_path / "response.wav", taps, int(RATE), subtype="FLOAT")
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    assert "receiver 0: recorded in V; transducer without a name; self-noise 10 dB" in capsys.readouterr().out
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "a")]) == 0
    assert "samples of 'ear' were clipped" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "a" / "scene.completed.toml"), "-o", str(tmp_path / "b"), "--no-plots"]) == 0
    one, two = (soundfile.read(tmp_path / folder / "ear.wav")[0] for folder in "ab")
    np.testing.assert_array_equal(one, two)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        drive = clsim.Signal.tone(40e3, 0.4e-3, RATE, amplitude=14.1)
        source = clsim.Source("speaker", drive, clsim.Trajectory.fixed((1, 1, 1)), transducer=SPEAKER)
        response = clsim.Transducer.from_wav(tmp_path / "response.wav", scale=0.01)
        electronics = clsim.Electronics(
            self_noise_db=10.0, seed=1, gain_db=60.0, adc_bits=10, adc_full_scale=0.2, clock_ppm=30.0
        )
        ear = clsim.Receiver("ear", clsim.Trajectory.fixed((3, 1, 1.5)), transducer=response, electronics=electronics)
        room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.9))
        scene = clsim.Scene(room, AIR, [source], [ear])
        recording = clsim.render(clsim.find_paths(scene, 1), RATE, duration=0.02, engine="reference")
    np.testing.assert_array_equal(recording.voltage[0], one)
