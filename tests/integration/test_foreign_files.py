"""Files of somebody else, and odd names: a result, or an error of one line; never a traceback."""

import base64
import json
import os
import random
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from exhaustive import few
from late import installed
from made_studies import ENVIRONMENT, SCENE

import clsim
from clsim.cli import main

POSITIONS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
CORNERS = struct.pack("<3Hxx", 0, 1, 2)


def gltf(nodes: list[dict], roots: list[int]) -> str:
    """Return a glTF file of one triangle, which nodes put into places."""
    data = base64.b64encode(POSITIONS + CORNERS).decode()
    return json.dumps(
        {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": roots}], "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
            ],
            "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
            "buffers": [{"byteLength": 44, "uri": f"data:application/octet-stream;base64,{data}"}],
        }
    )  # fmt: skip


CYCLES = {
    "of two": ([{"mesh": 0, "children": [1]}, {"mesh": 0, "children": [0]}], [0]),
    "below the root": ([{"children": [1]}, {"children": [2]}, {"mesh": 0, "children": [1]}], [0]),
    "of one": ([{"mesh": 0, "children": [0]}], [0]),
    "no cycle, but one of two parents, of which trimesh places one": (
        [{"children": [2]}, {"children": [2]}, {"mesh": 0}],
        [0, 1],
    ),
    "none, but 2^40 places": ([*({"children": [n + 1, n + 1]} for n in range(40)), {"mesh": 0}], [0]),
    "apart": ([{"mesh": 0}, {"children": [2]}, {"children": [1]}], [0]),
}


@pytest.mark.parametrize("which", CYCLES)
def test_a_cycle_of_nodes_is_refused(tmp_path: Path, which: str) -> None:
    (tmp_path / "room.gltf").write_text(gltf(*CYCLES[which]), "utf-8")
    with pytest.raises(clsim.InputError, match=r"room\.gltf: must hold nodes that form trees"):
        clsim.MeshRoom.from_file(tmp_path / "room.gltf", 1.0, "z", clsim.Material.from_reflection(0.9))


# Ten entities of ten entities each: 10^7 letters out of a kilobyte.
ENTITIES = "".join(f"<!ENTITY a{n} '{f'&a{n - 1};' * 10}'>" for n in range(1, 7))
BOMB = f"<!DOCTYPE m [<!ENTITY a0 'aaaaaaaaaa'>{ENTITIES}]><m><pos x='&a6;' y='0' z='0'/></m>"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32-le"])
def test_entities_are_refused_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    head = f'<?xml version="1.0" encoding="{encoding[:6].upper()}"?>' if encoding.startswith("utf-16") else ""
    (tmp_path / "array.xml").write_bytes((head + BOMB).encode(encoding))
    with pytest.raises(clsim.InputError, match=r"must be UTF-8|without declarations|cannot be read|holds none"):
        clsim.positions_from_file(tmp_path / "array.xml")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the results of a run in a Zarr store."""
    installed("zarr")
    installed("xarray")
    folder = tmp_path_factory.mktemp("finished")
    (folder / "scene.toml").write_text(SCENE.replace("[render]", '[render]\nengine = "reference"'), "utf-8")
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), "--store", "zarr", "--no-plots"]) == 0
    return folder / "out"


@pytest.mark.parametrize("number", few(range(80), kept=(0, 1, 2, 3)))
def test_a_damaged_chunk_is_one_line(finished: Path, tmp_path: Path, number: int, capsys) -> None:
    chance, out = random.Random(number), tmp_path / "out"
    shutil.copytree(finished, out)
    chunks = sorted(p for p in (out / "recording.zarr").rglob("*") if p.is_file() and p.name != "zarr.json")
    path = next(p for p in chunks if "sound" in p.parts) if number < 4 else chance.choice(chunks)
    data = bytearray(path.read_bytes())
    if number % 4 == 0:
        data = data[: chance.randrange(len(data))]
    elif number % 4 == 1:
        data = bytearray(chance.randbytes(len(data)))
    elif number % 4 == 2:
        for _ in range(5):
            data[chance.randrange(min(len(data), 32))] = chance.randrange(256)
    else:
        data = bytearray()
    path.write_bytes(data)
    try:
        clsim.load_recording(out)
    except clsim.InputError as error:
        assert str(error).startswith(("folder: must hold the sound", "folder: must be a store"))
    else:
        assert number >= 4, "the sound itself was damaged"
    assert main(["score", str(out)]) in (0, 1, 2)  # and raises nothing
    assert capsys.readouterr().err.count("\n") <= 1


NAMES = ["walk\udcff", "a\x1b[31mb", "two\nlines", "del\x7f"]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("name", few(NAMES, kept=(0,)))
def test_odd_names_work(tmp_path: Path, name: str, capfd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    line = [sys.executable, "-m", "clsim", "new", f"{name}.toml"]
    done = subprocess.run(line, capture_output=True, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == os.fsencode(f"{name}.toml\n")  # the name itself, for scripts
    scene = clsim.load_scene(f"{name}.toml")
    page = Path(f"{name}.html")
    line = [sys.executable, "-m", "clsim", "view", f"{name}.toml", "--frames", "2"]
    done = subprocess.run(line, capture_output=True, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (0, b"")
    assert scene.scene.sources
    text = page.read_text("utf-8")  # which is UTF-8, whatever the name
    assert "\x1b" not in text.partition("<script")[0]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_scene_file_cannot_name_what_is_no_utf8(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("walk\udcff.txt").write_text("".join(f"{t} {t} 1 1 0 0 0 1\n" for t in range(1, 7)), "utf-8")
    assert main(["new", "scene.toml", "--trajectory", "walk\udcff.txt"]) == 2
    assert capsys.readouterr().err == (
        "clsim: error: path: must be UTF-8, as scene files are, but is walk\\udcff.txt; rename it\n"
    )
    Path("walk\x7f.txt").write_text("".join(f"{t} {t} 1 1 0 0 0 1\n" for t in range(1, 7)), "utf-8")
    assert main(["new", "scene.toml", "--trajectory", "walk\x7f.txt"]) == 0


def test_messages_give_a_terminal_no_commands(tmp_path: Path, capsys) -> None:
    (tmp_path / "scene.toml").write_text(SCENE.replace("format = 1", 'format = 1\n"\\u001b[31mx" = 1'), "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 2
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "\\x1b[31mx" in err


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX limits the size of files")
def test_a_limit_of_files_is_named(tmp_path: Path, device: None) -> None:
    line = ["/bin/sh", "-c", 'ulimit -f 16; exec "$@"', "sh", sys.executable, "-m", "clsim", "devices"]
    done = subprocess.run(line, capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 2
    assert "no OpenCL device" not in done.stderr
    assert "ulimit -f" in done.stderr
    assert done.stderr.count("\n") == 1
