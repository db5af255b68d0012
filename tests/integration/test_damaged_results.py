"""Results that were damaged, and files of others where results go: one line, nothing wrong is taken for right, nothing is lost.

A few at every change; `make attacks` does 1448 damaged files and 132 of others.
"""

import os
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from late import installed
from made_studies import METRICS, STUDY
from test_kills import RECEIVER, SCENE

import clsim
from clsim.cli import main

DAMAGED = int(os.environ.get("CLSIM_DAMAGED", "200"))
FOREIGN = int(os.environ.get("CLSIM_FOREIGN", "132"))
PARTS = 10
KINDS = ("wav", "zarr", "hdf5", "study")
SHORT = SCENE.replace("0.2,", "0.02,").replace("duration = 0.2 }", "duration = 0.02 }")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make results of each kind, in a folder of its own."""
    for package in ("zarr", "xarray", "h5netcdf"):
        installed(package)
    folder = tmp_path_factory.mktemp("finished")
    (folder / "scene.toml").write_text(SHORT % (0.9, "".join(RECEIVER % n for n in ("left", "right"))), "utf-8")
    (folder / "judge.py").write_text(METRICS.replace("time.sleep", "abs"), "utf-8")
    (folder / "study.toml").write_text(STUDY % ([0, 1], [0.5]), "utf-8")
    for kind in KINDS:
        assert main(command(folder, kind, folder / kind)) == 0
    return folder


def command(folder: Path, kind: str, out: Path, *more: str) -> list[str]:
    if kind == "study":
        return ["study", str(folder / "study.toml"), "-o", str(out), "--workers", "1", *more]
    return ["run", str(folder / "scene.toml"), "-o", str(out), "--store", kind, "--no-plots", *more]


def damage(random: np.random.Generator, data: bytes) -> bytes:
    """Cut bytes, flip a bit, or put noise, zeros, or nothing in their place."""
    changed, kind = bytearray(data), int(random.integers(6))
    at = int(random.integers(max(1, len(data))))
    if kind == 0:
        changed = changed[:at]
    elif kind == 1 and data:
        changed[at] ^= 1 << int(random.integers(8))
    elif kind == 2:
        changed[at : at + 64] = random.bytes(len(changed[at : at + 64]))
    elif kind == 3:
        changed[at : at + 512] = bytes(len(changed[at : at + 512]))
    elif kind == 4:
        changed = bytearray(random.bytes(len(data)))
    else:
        changed = changed[:at] + random.bytes(7) + changed[at:]
    return bytes(changed)


def told(arguments: list[str], capsys: Any) -> int:
    """Run a command; return its status. What it finds wrong is told in lines of clsim."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        status = main(arguments)
    err = capsys.readouterr().err
    assert status in (0, 1, 2), err
    assert all(line.startswith(("clsim: ", "changed", "  ")) for line in err.splitlines()), err
    assert err.count("clsim: error: ") == (status == 2), err
    return status


def samples(out: Path, **options: Any) -> Any:
    """Return the sound of a folder, None where it is refused."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return clsim.load_recording(out, **options).samples.tobytes()
    except clsim.ClsimError:
        return None


@pytest.mark.parametrize("part", few(range(PARTS), many=True))
def test_damaged_results_are_refused_or_right(part: int, finished: Path, tmp_path: Path, capsys: Any) -> None:
    out, found = tmp_path / "out", []
    whole = {kind: samples(finished / kind) for kind in KINDS[:3]}
    for number in range(part, DAMAGED, PARTS):
        random, kind = np.random.default_rng([33, number]), KINDS[number % 4 if number % 40 < 36 else number % 3]
        shutil.copytree(finished / kind, out)
        files = sorted(path for path in out.rglob("*") if path.is_file())
        path = files[int(random.integers(len(files)))]
        old = path.read_bytes()
        path.write_bytes(damage(random, old))
        try:
            changed = path.read_bytes() != old
            if kind != "study":
                assert samples(out, verify=True) in (None, whole[kind]), "other sound is taken for right"
                samples(out)
                assert told(["verify", str(out)], capsys) or not changed or path.name == "clsim.json", "nothing is seen"
                told(["score", str(out)], capsys)
                status = told(command(finished, kind, out, "--resume"), capsys)
            else:
                assert told(["verify", str(out)], capsys) or not changed or "study.zarr" not in str(path)
                status = 0
            assert status or kind == "study" or samples(out, verify=True) == whole[kind], "not made again"
        except Exception as error:
            found.append(f"{number}: {kind} {path.relative_to(out)}: {error!r:.600}")
            capsys.readouterr()
        shutil.rmtree(out)
    assert not found, "\n".join(found)


NAMES = {
    "wav": ["left.wav", "right.wav", "paths.npz", "ground_truth.npz", "scene.completed.toml", "clsim.json", ".partial", ".partial/lock", ".partial/journal.npz"],
    "zarr": ["recording.zarr", "recording.zarr/zarr.json", "clsim.json", ".partial/recording.zarr/mine", ".partial/contents.json"],
    "hdf5": ["recording.h5", ".partial/recording.h5"],
    "study": ["study.zarr", "study.zarr/zarr.json", "index.jsonl", "settings.json", ".partial/mine", ".lock"],
}  # fmt: skip
PLACES = [(kind, name) for kind, names in NAMES.items() for name in names]


@pytest.fixture
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.usefixtures("_quiet")
@pytest.mark.parametrize("part", few(range(PARTS), many=True))
def test_files_of_others_stay(part: int, finished: Path, tmp_path: Path, capsys: Any) -> None:
    """Whatever is in the way, or beside it, under names that clsim uses: its bytes are there afterwards."""
    found = []
    for number in range(part, FOREIGN, PARTS):
        random, (kind, name) = np.random.default_rng([34, number]), PLACES[number % len(PLACES)]
        out = tmp_path / str(number)
        path, content = out / name, [b"", random.bytes(50), b"{}", b"[1, 2]", b"mine"][number // len(PLACES) % 5]
        path.parent.mkdir(parents=True)
        other = out / "notes.txt"
        other.write_bytes(content)
        if number % 7 == 3:  # a link to something elsewhere
            (tmp_path / "elsewhere").write_bytes(content)
            path.symlink_to(tmp_path / "elsewhere")
        else:
            path.write_bytes(content)
        try:
            for more in ((), ("--resume",), *((("--force",),) if kind != "study" else ())):
                told(command(finished, kind, out, *more), capsys)
                now = {p.read_bytes() for p in out.rglob("*") if p.is_file() and p != other}
                assert content in now or content == b"", f"lost by {more}"
                assert other.read_bytes() == content
        except Exception as error:
            found.append(f"{number}: {kind} {name}: {error!r:.400}")
            capsys.readouterr()
    assert not found, "\n".join(found)
