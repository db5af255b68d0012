"""Drawn studies as shards: the same bytes for any number of workers, killed and resumed; their sounds and labels."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from late import installed
from made_studies import ENVIRONMENT, index
from scene_texts import along, chirp_of, receiver_at, scene_text, source_at

import clsim
from clsim.cli import main
from clsim.opencl.device import list_devices
from clsim.study.shards import DamagedError, read_members, read_table, sound_of

parquet = installed("pyarrow.parquet")
installed("zarr")
installed("xarray")
soundfile = installed("soundfile")

SCENE = scene_text(
    source_at("talker", chirp_of(500.0, 5e3, 0.2, 16e3, window="hann"), along((1, 1, 1), (2, 1, 1), 1.0)),
    receiver_at("left", (3.0, 1.0, 1.5)),
    receiver_at("right", (3.0, 1.2, 1.5)),
    room={"kind": "shoebox", "size": (5.0, 4.0, 2.5), "walls": {"reverberation_time": 0.3}},
    max_order=2,
    rate=16e3,
    render={"duration": 0.25},
)
STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "direct", "reverberant", "noise", "ground_truth", "room_measures"]
draws = %d
seed = 7
table_rate = 20.0
noise = { snr_db = 20.0 }
shards = { members = 4, format = "%s" }
[[vary]]
field = "room.walls.reverberation_time"
name = "time"
random = { log_uniform = [0.2, 0.6] }
[[vary]]
field = "sources[0].trajectory.start"
name = "start"
random = { inside = 0.5 }
[[vary]]
field = "noise.snr_db"
name = "snr"
random = { uniform = [0.0, 30.0] }
"""


def write(folder: Path, draws: int = 10, form: str = "wav") -> list[str]:
    folder.mkdir(exist_ok=True)
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "study.toml").write_text(STUDY % (draws, form), "utf-8")
    return ["study", str(folder / "study.toml"), "-o", str(folder / "out")]


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "out" / "shards").iterdir()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not list_devices():
        pytest.skip("no OpenCL device on this machine")
    folder = tmp_path_factory.mktemp("shards") / "one"
    assert main([*write(folder), "--workers", "1"]) == 0
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    copied = shutil.copytree(finished, tmp_path / "copied")
    settings = copied / "out" / "study.json"  # which names its folders
    settings.write_text(settings.read_text("utf-8").replace(str(finished), str(copied)), "utf-8")
    return copied


@pytest.mark.slow
def test_a_killed_study_goes_on_to_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    """Two workers write what one does, killed with the study once a shard is joined and a member waits, or soon behind that."""
    arguments = [*write(tmp_path / "killed"), "--workers", "2"]
    out = tmp_path / "killed" / "out"
    study = subprocess.Popen(
        [sys.executable, "-m", "clsim", *arguments], env=ENVIRONMENT, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    while study.poll() is None and not (
        list((out / "shards").glob("*.parquet")) and list((out / "members").glob("m*.tar"))
    ):
        time.sleep(0.002)
    os.killpg(study.pid, signal.SIGKILL)
    study.wait()
    waiting = {path.name: path.stat().st_mtime_ns for path in (out / "members").glob("m*.tar")}
    assert main([*arguments, "--resume"]) == 0
    assert waiting, "the study was killed before its end"
    assert content(tmp_path / "killed") == content(finished)
    assert sorted(content(finished)) == [f"shard-00000{k}.{kind}" for k in range(3) for kind in ("parquet", "tar")]
    assert not any((finished / "out" / "members").iterdir())
    assert {row["status"] for row in index(tmp_path / "killed").values()} == {"finished"}


def members(folder: Path) -> list[tuple[dict[str, Any], dict[str, bytes]]]:
    return [one for path in sorted((folder / "out" / "shards").glob("*.tar")) for one in read_members(path)]


def test_the_parts_of_a_sound_add_up_at_the_ratio_that_was_drawn(finished: Path) -> None:
    for labels, files in members(finished):
        sound, direct, rest, noise = (sound_of(labels, files, part) for part in ("", "direct", "reverberant", "noise"))
        assert sound.shape == (2, 4000)
        assert np.abs(sound - (direct + rest + noise)).max() <= 1e-6 * np.abs(sound).max()
        energies = [np.square(x, dtype=np.float64).sum() for x in (direct + rest, noise)]
        wanted = json.loads(labels["parameters"])["snr"]
        assert 10.0 * np.log10(energies[0] / energies[1]) == pytest.approx(wanted, abs=1e-4)


def test_a_member_is_what_its_scene_gives(finished: Path) -> None:
    labels, files = members(finished)[5]
    (finished / "again.toml").write_text(labels["scene"], "utf-8")
    file = clsim.load_scene(finished / "again.toml")
    paths = clsim.find_paths(file.scene, max_order=2)
    clean = sound_of(labels, files, "direct") + sound_of(labels, files, "reverberant")
    wanted = clsim.render(paths, 16e3, duration=0.25).pressure
    assert np.abs(clean - wanted).max() <= 1e-6 * np.abs(wanted).max()
    direct = clsim.render(clsim.find_paths(file.scene, max_order=0), 16e3, duration=0.25).pressure
    assert np.abs(sound_of(labels, files, "direct") - direct).max() <= 3e-5 * np.abs(direct).max()  # -90 dB
    truth = clsim.direct_path(paths, labels["times"])
    assert np.array_equal(labels["delay"], truth.delay)
    towards = truth.source_position - truth.receiver_position
    assert np.allclose(labels["distance"], np.linalg.norm(towards, axis=-1), rtol=1e-12)
    assert np.allclose(labels["azimuth"], np.arctan2(towards[..., 1], towards[..., 0]), atol=2e-2)  # by v / c
    flat = np.hypot(towards[..., 0], towards[..., 1])
    assert np.allclose(labels["elevation"], np.arctan2(towards[..., 2], flat), atol=2e-2)
    table = paths.table(labels["times"])
    assert np.array_equal(np.array(labels["direct_gain"])[0], np.abs(table.gain[table.direct]))
    start, end = np.array(json.loads(labels["parameters"])["start"]), np.array([2.0, 1.0, 1.0])
    assert np.allclose(labels["source_speed"], np.linalg.norm(end - start), rtol=1e-9)
    assert np.all(np.array(labels["receiver_speed"]) == 0.0)
    eyring = np.array(labels["room_eyring"])[np.array(labels["frequency"]) == 500.0]
    assert eyring == pytest.approx(json.loads(labels["parameters"])["time"], rel=0.02)  # air of 20 °C takes its part


def test_tables_hold_what_archives_hold(finished: Path) -> None:
    found = {row["key"]: row for path in (finished / "out" / "shards").glob("*.parquet") for row in read_table(path)}
    assert sorted(found) == [f"m{k:06d}" for k in range(10)]
    for labels, _ in members(finished):
        assert found[labels["key"]] == labels


@pytest.mark.slow
def test_flac_is_within_its_24_bits(finished: Path, tmp_path: Path) -> None:
    assert main([*write(tmp_path / "flac", 2, "flac"), "--workers", "1"]) == 0
    for (labels, files), (exact, wav) in zip(members(tmp_path / "flac"), members(finished), strict=False):
        for part in ("", "noise"):
            scale = labels["full_scale" + (f"_{part}" if part else "")]
            off = np.abs(sound_of(labels, files, part) - sound_of(exact, wav, part)).max()
            assert off <= scale * 2.0**-24 * 1.01
        assert labels["key"] == exact["key"]
    with tarfile.open(tmp_path / "flac" / "out" / "shards" / "shard-000000.tar") as archive:
        data = archive.extractfile("m000001.flac")
        assert data is not None
        assert soundfile.info(io.BytesIO(data.read())).subtype == "PCM_24"


@pytest.mark.slow
def test_a_store_has_the_same_sounds(finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "store"
    arguments = write(folder, 2)
    text = (folder / "study.toml").read_text("utf-8")
    (folder / "study.toml").write_text(text.replace('shards = { members = 4, format = "wav" }', ""), "utf-8")
    assert main([*arguments, "--workers", "1"]) == 0
    for k, (labels, files) in enumerate(members(finished)[:2]):
        with clsim.open_store(folder / "out" / "study.zarr" / f"m{k:06d}") as member:
            for name in ("sound", "direct", "reverberant", "noise"):
                part = "" if name == "sound" else name
                assert np.array_equal(member[name].values, sound_of(labels, files, part))
            assert member.sound.attrs["units"] == "Pa"
            assert np.array_equal(member.room_eyring.values, labels["room_eyring"])
            assert np.array_equal(member.delay.values, labels["delay"])


def damaged(path: Path, at: float) -> None:
    data = bytearray(path.read_bytes())
    data[int(at * len(data))] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("at", [0.02, 0.3, 0.6])
def test_damaged_shards_are_refused_and_run_again(folder: Path, at: float, capsys: pytest.CaptureFixture[str]) -> None:
    before, out = content(folder), folder / "out"
    damaged(out / "shards" / "shard-000001.tar", at)
    with pytest.raises(DamagedError, match=r"shard-000001\.tar"):
        list(read_members(out / "shards" / "shard-000001.tar"))
    assert main(["verify", str(out)]) == 1
    assert "shards/shard-000001: has changed" in capsys.readouterr().out
    assert main(["study", str(folder / "study.toml"), "-o", str(out), "--resume", "--workers", "1"]) == 0
    assert "the members of shard-000001 are run again" in capsys.readouterr().err
    assert content(folder) == before


def test_damaged_tables_and_short_archives_are_refused(folder: Path) -> None:
    shards = folder / "out" / "shards"
    damaged(shards / "shard-000000.parquet", 0.5)
    with pytest.raises(DamagedError, match=r"shard-000000\.parquet cannot be read"):
        read_table(shards / "shard-000000.parquet")
    tar = shards / "shard-000001.tar"
    os.truncate(tar, tar.stat().st_size // 2)
    with pytest.raises(DamagedError, match=r"shard-000001\.tar"):
        list(read_members(tar))
    tar.unlink()
    with pytest.raises(DamagedError, match=r"shard-000001\.tar is not what was written"):
        read_table(shards / "shard-000001.parquet")


@pytest.mark.slow
def test_members_that_failed_join_their_shard_later(tmp_path: Path, device: None) -> None:
    folder = tmp_path / "failing"
    write(folder, 6)
    text = (folder / "study.toml").read_text("utf-8").replace('"room_measures"]', '"room_measures", "metrics"]')
    (folder / "study.toml").write_text(text.replace("draws", 'metrics = "judge:level"\ndraws'), "utf-8")
    judge = "import pathlib\ndef level(recording, paths, parameters):\n"
    judge += "    assert parameters['snr'] < 15.0 or pathlib.Path(__file__).with_name('now').exists()\n"
    (folder / "judge.py").write_text(judge + "    return {'level': float(recording.samples.std())}\n", "utf-8")
    arguments = ["study", str(folder / "study.toml"), "-o", str(folder / "out"), "--workers", "1"]
    assert main(arguments) == 1
    failed = {n for n, row in index(folder).items() if row["status"] == "failed"}
    assert 0 < len(failed) < 6
    assert {labels["member"] for labels, _ in members(folder)} == set(range(6)) - failed
    (folder / "now").touch()
    assert main([*arguments, "--retry"]) == 0
    assert [labels["member"] for labels, _ in members(folder)] == list(range(6))
    assert not any((folder / "out" / "members").iterdir())
    for labels, files in members(folder):
        assert labels["level"] == pytest.approx(float(sound_of(labels, files).std()), rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "left"', 'name = "left"\nelectronics = { self_noise_db = 10.0 }', "keep: must leave out direct"),
        ('name = "left"', 'name = "left"\ndirectivity = { kind = "ambisonic", order = 1 }', "noise: must come with"),
    ],
)
def test_what_parts_cannot_be_made_of_is_told(tmp_path, old: str, new: str, message: str, error_of) -> None:
    arguments = write(tmp_path / "bad")
    (tmp_path / "bad" / "scene.toml").write_text(SCENE.replace(old, new), "utf-8")
    assert message in error_of(*arguments)
