"""Where envelopes go: stores, runs that are gone on with, studies, and quiet paths left out."""

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from exhaustive import few
from killing import Killer
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.workflow.result_folder import Journal

pytestmark = pytest.mark.usefixtures("device")

SCENE = scene_text(
    source_at("robot", tone_of(40e3, "%s", fade=0.05), along((1, 1, 1), (2, 1, 1), 1e3)),
    receiver_at("left", (3.0, 1.0, 2.0), electronics={"clock_ppm": 50.0}),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order="%d",
    render={"baseband": {"carrier": 40e3, "bandwidth": 1e3}, "chunk": 1},
)
SHORT, LONG = SCENE % (0.3, 1), SCENE % (4.0, 2)
KINDS = ("wav", "zarr", "hdf5")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.toml").write_text(SHORT, "utf-8")
    return tmp_path / "scene.toml"


def command(scene: Path, out: Path, kind: str, *more: str) -> list[str]:
    return ["run", str(scene), "-o", str(out), "--store", kind, "--table", "none", *more]


def envelopes(out: Path) -> np.ndarray:
    """Return the envelopes of WAV files with I and Q."""
    found = [soundfile.read(out / f"{name}.wav", dtype="float32") for name in ("left", "right")]
    assert {rate for _, rate in found} == {2560}
    return np.stack([frames[:, 0] + 1j * frames[:, 1] for frames, _ in found])


@pytest.mark.slow
def test_stores_hold_the_same_envelopes(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    pytest.importorskip("h5netcdf")
    drawn: list[np.ndarray] = []  # what pictures are drawn of
    monkeypatch.setattr(
        "clsim.workflow.pictures.spectrogram_picture", lambda sound, *_, **__: drawn.append(sound[0 : len(sound)])
    )
    monkeypatch.setattr("clsim.workflow.pictures.echogram_picture", lambda *_: None)
    for kind in KINDS:
        assert main(command(scene, tmp_path / kind, kind, "--duration", "0.25")) == 0
    wanted = envelopes(tmp_path / "wav")
    np.testing.assert_array_equal(drawn, [*wanted] * len(KINDS))
    assert wanted.shape == (2, 640)
    assert np.abs(wanted.imag).max() > 0.1
    for kind in KINDS[1:]:
        with clsim.open_store(tmp_path / kind) as found:
            assert found.sound.dtype == np.complex64
            np.testing.assert_array_equal(found.sound.values, wanted)
            np.testing.assert_allclose(found.time.values, np.arange(640) / 2560.0, rtol=1e-15)
            assert (found.attrs["carrier"], found.attrs["sampling_rate"]) == (40e3, 2560.0)
            assert found.sound.attrs["units"] == "Pa"
    with xarray.open_dataset(tmp_path / "hdf5" / "recording.h5", engine="h5netcdf") as plain:
        np.testing.assert_array_equal(plain.sound.values, wanted)
    truth = np.load(tmp_path / "wav" / "ground_truth.npz")
    assert truth["delay"].shape[:2] == (1, 2)


@pytest.mark.parametrize("kind", few(["wav", "zarr"]))
def test_a_killed_run_is_gone_on_with(kind: str, tmp_path: Path, killer: Killer) -> None:
    if kind != "wav":
        pytest.importorskip("zarr")
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(LONG, "utf-8")
    arguments = command(scene, out, kind, "--no-plots")
    assert killer.run(arguments, out, event=7, of="journal.npz") == -9  # when some chunks had been noted
    assert 0 < Journal(out / ".partial").load()[1] < 4 * 2560
    scene.write_text(LONG.replace("bandwidth = 1e3", "bandwidth = 1100.0"), "utf-8")
    assert killer.run([*arguments, "--resume"], out) == 2
    assert "scene.render.baseband.bandwidth was 1000.0 and is 1100.0" in killer.log
    scene.write_text(LONG, "utf-8")
    for more in ([*arguments, "--resume"], command(scene, tmp_path / "whole", "wav", "--no-plots")):
        assert killer.run(more, out) == 0, killer.log
    wanted = envelopes(tmp_path / "whole")
    if kind == "wav":
        np.testing.assert_array_equal(envelopes(out), wanted)
    else:
        with clsim.open_store(out) as found:
            np.testing.assert_array_equal(found.sound.values, wanted)


METRICS = """
import numpy as np


def doppler(recording, paths, parameters):
    assert recording.samples.dtype == np.complex64
    phase = np.unwrap(np.angle(recording.pressure[:, 256:512].astype(complex)))
    return {"shift": np.polyfit(recording.times[256:512], phase.T, 1)[0] / (2 * np.pi), "first": recording.samples[:, 300]}
"""
STUDY = """
format = 1
scene = "scene.toml"
metrics = "judge:doppler"
keep = ["recording", "ground_truth", "metrics"]
[[vary]]
field = "render.baseband.bandwidth"
name = "width"
values = [1e3, 2e3, 1.0]
"""


@pytest.mark.slow
@pytest.mark.exhaustive
def test_a_study_judges_envelopes(scene: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    xarray = pytest.importorskip("xarray")
    scene.write_text(
        SHORT.replace("max_order = 1", "max_order = 0").replace("duration = 1e3", "duration = 1.0"), "utf-8"
    )
    (tmp_path / "judge.py").write_text(METRICS, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--workers", "1"]) == 1
    rows = [json.loads(line) for line in (tmp_path / "out" / "index.jsonl").read_text("utf-8").splitlines()]
    assert [row["status"] for row in rows] == ["finished", "finished", "failed"]
    assert "baseband.bandwidth: must be above" in rows[2]["error"]
    groups = sorted((tmp_path / "out" / "study.zarr").glob("*0*"))
    for group in groups[:2]:
        with xarray.open_zarr(group) as found:
            assert found.sound.dtype == np.complex64
            np.testing.assert_array_equal(found.first.values, found.sound.values[:, 300])
            # 1 m/s along x towards both, at 0.15 s from (1.15, 1, 1); the left one's clock is slow by 50 ppm.
            along = np.array([1.85 / np.hypot(1.85, 1.0), 1.85 / np.sqrt(1.85**2 + 2.0)])
            wanted = 40e3 * (along / 343.2 + np.array([50e-6, 0.0]))
            np.testing.assert_allclose(found["shift"].values, wanted, rtol=0.004)


def test_quiet_paths_are_left_out_of_envelopes(engine: str) -> None:
    chirp = clsim.Signal.chirp(39.5e3, 40.5e3, 0.1, 192e3, window="hann")
    way = clsim.Trajectory.circle((3.0, 2.5, 1.2), 1.5, 2.0, 0.6)
    one = clsim.Scene(
        clsim.Shoebox((6, 5, 3), clsim.Material.from_reflection(0.5)),
        clsim.Air(),
        [clsim.Source("s", chirp, way)],
        [clsim.Receiver("r", clsim.Trajectory.fixed((5.0, 4.0, 2.0)))],
    )
    paths = clsim.find_paths(one, 3)
    whole, part = (
        clsim.render(paths, 192e3, engine=engine, duration=0.15, baseband=(40e3, 4e3), prune_below_db=level)
        for level in (None, -40.0)
    )
    said = next(note for note in part.notes if "paths that stay below -40 dB" in note)
    strongest = np.abs(paths.table(np.linspace(0.0, 0.2, 50)).gain).max()
    lost = np.abs(whole.pressure - part.pressure).max()
    assert 0.0 < lost < strongest * 10 ** (float(said.split("at most ")[1].split(" dB")[0]) / 20)
