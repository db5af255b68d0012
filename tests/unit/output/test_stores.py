"""A kind of store is a class and its name in the list."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from clsim_barn.columns import Columns

from clsim.cli import main
from clsim.output import stores

SCENE = """
format = 1
room = { kind = "shoebox", size = [4.0, 3.0, 2.5], walls = { reflection = 0.9 } }
[[sources]]
name = "s"
signal = { kind = "tone", frequency = 40e3, duration = 0.005, sampling_rate = 192e3, fade = 0.001 }
trajectory = { kind = "fixed", position = [1.0, 1.0, 1.0] }
[[receivers]]
name = "left"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[[receivers]]
name = "right"
trajectory = { kind = "fixed", position = [3.0, 2.0, 2.0] }
[paths]
max_order = 0
[render]
sampling_rate = 192e3
engine = "reference"
"""


class Named(Columns):
    """A store that refuses a name."""

    packages = ("numpy",)

    @staticmethod
    def problem_of(receiver: str) -> str:
        return "must not be called nobody" if receiver == "nobody" else ""


def test_a_store_is_a_class_and_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(SCENE, "utf-8")
    assert main(["run", str(scene), "-o", str(tmp_path / "wav"), "--no-plots"]) == 0
    assert main(["run", str(scene), "-o", str(tmp_path / "npy"), "--store", "columns"]) == 2
    assert '--store: must be one of "wav", "zarr", "hdf5", but is' in capsys.readouterr().err
    monkeypatch.setitem(stores.STORES, "columns", Named)
    assert main(["run", str(scene), "-o", str(tmp_path / "npy"), "--store", "columns", "--no-plots"]) == 0
    for row, name in zip(np.load(tmp_path / "npy" / "sound.npy").T, ("left", "right"), strict=True):
        np.testing.assert_array_equal(row, soundfile.read(tmp_path / "wav" / f"{name}.wav", dtype="float32")[0])
    scene.write_text(SCENE.replace("left", "nobody"), "utf-8")
    capsys.readouterr()
    assert main(["run", str(scene), "-o", str(tmp_path / "other"), "--store", "columns"]) == 2
    assert capsys.readouterr().err == "clsim: error: receivers[0]: must not be called nobody\n"


@pytest.mark.parametrize("kind", stores.STORES)
def test_stores_have_names_and_packages(kind: str) -> None:
    names = stores.STORES[kind].names(["a", "b"])
    assert len(names) == len(set(names)) > 0
    assert stores.STORES[kind].problem_of("a") == ""
