"""Packages that only some uses need: each that is missing is answered by the line that installs it."""

import sys
from pathlib import Path

import pytest
from made_studies import STUDY

import clsim
from clsim.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a scene and a study of it."""
    folder = tmp_path_factory.mktemp("packages")
    assert main(["new", str(folder / "scene.toml")]) == 0
    (folder / "study.toml").write_text(STUDY % ([0], [1.0]), "utf-8")
    return folder


@pytest.mark.parametrize(
    ("package", "extra", "arguments"),
    [
        ("pyarrow", "parquet", ["run", "scene.toml", "-o", "out", "--table", "parquet"]),
        ("zarr", "store", ["run", "scene.toml", "-o", "out", "--store", "zarr"]),
        ("h5netcdf", "store", ["run", "scene.toml", "-o", "out", "--store", "hdf5"]),
        ("distributed", "study", ["run", "scene.toml", "-o", "out", "--store", "zarr", "--scheduler", "tls://a:1"]),
        ("dask", "study", ["study", "study.toml", "-o", "out", "--scheduler", "tls://a:1"]),
        ("zarr", "study", ["study", "study.toml", "-o", "out"]),
        ("matplotlib", "pictures", ["run", "scene.toml", "-o", "out"]),
        ("matplotlib", "pictures", ["plot", "air", "-o", "out.png"]),
        ("matplotlib", "pictures", ["materials", "-o", "out.png"]),
        ("sofar", "sofa", ["rir", "scene.toml", "-o", "out.sofa"]),
    ],
)
def test_commands_say_what_installs_it(folder, package, extra, arguments, monkeypatch, capsys) -> None:
    """One line, exit status 2, and nothing is written."""
    monkeypatch.chdir(folder)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert package in told
    assert told.endswith(f": pip install 'clsim[{extra}]'\n")
    assert sorted(path.name for path in folder.iterdir()) == ["scene.toml", "study.toml"]


def test_stores_say_what_opens_them(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(clsim.InputError, match=r"needs .*xarray: pip install 'clsim\[store\]'$"):
        clsim.open_store(folder)


def test_shooting_says_what_traces_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9)).as_mesh()
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    ends = (
        [clsim.Source("s", tone, clsim.Trajectory.fixed((1, 1, 1)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((3, 2, 1)))],
    )
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(clsim.InputError, match=r"needs embreex: pip install 'clsim\[shooting\]'$"):
        clsim.find_paths(clsim.Scene(room, clsim.Air(), *ends), 1, finder="shooting")
