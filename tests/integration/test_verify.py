"""Stored sound in which a bit has changed is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from exhaustive import few

import clsim
from clsim.cli import main

pytestmark = [pytest.mark.usefixtures("device")]
TONE = {"kind": "tone", "frequency": 16e3, "duration": 0.02, "sampling_rate": 48e3, "fade": 0.005}
SCENE: dict[str, Any] = {
    "format": 1, "room": {"kind": "shoebox", "size": [4.0, 3.0, 2.0], "walls": {"reflection": 0.8}},
    "sources": [{"name": "s", "signal": TONE, "trajectory": {"kind": "fixed", "position": [1.0, 1.0, 1.0]}}],
    "receivers": [{"name": n, "trajectory": {"kind": "fixed", "position": [3.0, y, 1.0]}} for n, y in (("a", 1.0), ("b", 2.0))],
    "paths": {"max_order": 1}, "render": {"sampling_rate": 48e3},
}  # fmt: skip
FLIPS = 10


def made(folder: Path, store: str) -> Path:
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE), "utf-8")
    out = folder / "out"
    assert (
        main(["run", str(folder / "scene.toml"), "-o", str(out), "--store", store, "--no-plots", "--table", "none"])
        == 0
    )
    return out


def sound_files(out: Path) -> list[Path]:
    chunks = [path for path in (out / "recording.zarr" / "sound" / "c").rglob("*") if path.is_file()]
    return chunks or [*out.glob("*.wav"), *out.glob("recording.h5")]


def refused(out: Path, **options: Any) -> bool:
    try:
        clsim.load_recording(out, **options)
    except clsim.InputError as error:
        assert error.field == "folder"
        return True
    return False


@pytest.mark.parametrize("store", few(["zarr", "wav", "hdf5"], kept=(0, 1)))
def test_a_flipped_bit(store: str, tmp_path: Path, rng: np.random.Generator, capsys: Any) -> None:
    out = made(tmp_path, store)
    assert not refused(out, verify=True)
    assert main(["verify", str(out)]) == 0
    silent = 0
    for k in range(FLIPS):
        path = sound_files(out)[k % len(sound_files(out))]
        whole = path.read_bytes()
        # HDF5's own parts have checksums; its library leaves an exception behind where they are wrong.
        first = len(whole) - 2 * 960 * 4 if store == "hdf5" else 0
        data, at = bytearray(whole), int(rng.integers(8 * first, 8 * len(whole)))
        data[at // 8] ^= 1 << at % 8
        path.write_bytes(data)
        silent += not refused(out)
        assert refused(out, verify=True)
        if k < 2:
            capsys.readouterr()
            assert main(["verify", str(out)]) == 1
            assert "has changed since" in capsys.readouterr().out
        path.write_bytes(whole)
    assert not refused(out, verify=True)
    if store == "zarr":  # whose chunks have checksums
        assert silent == 0


def test_a_store_without_checksums_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsim.output.stores._compressors", lambda: "auto")  # as they were written before
    assert not refused(made(tmp_path, "zarr"), verify=True)


@pytest.mark.exhaustive
def test_a_flipped_bit_in_a_study(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(SCENE), "utf-8")
    study = {
        "format": 1, "scene": "scene.toml", "keep": ["recording"],
        "vary": [{"field": "sources[0].signal.amplitude", "values": [1.0, 2.0]}],
    }  # fmt: skip
    (tmp_path / "study.toml").write_text(tomli_w.dumps(study), "utf-8")
    out = tmp_path / "out"
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(out), "--workers", "1"]) == 0
    assert main(["verify", str(out)]) == 0
    path = next(path for path in (out / "study.zarr" / "m000001" / "sound" / "c").rglob("*") if path.is_file())
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    capsys.readouterr()
    assert main(["verify", str(out)]) == 1
    assert "m000001/sound: has changed" in capsys.readouterr().out
    assert main(["verify", str(tmp_path)]) == 2
