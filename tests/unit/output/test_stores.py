"""A kind of store is a class and its name in the list."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from clsim_barn.columns import Columns
from scene_texts import receiver_at, scene_text, source_at, tone_of

from clsim.cli import main
from clsim.output import stores

SCENE = scene_text(
    source_at("s", tone_of(40e3, 0.005, fade=0.001), (1.0, 1.0, 1.0)),
    receiver_at("left", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order=0,
    render={"engine": "reference"},
)


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
