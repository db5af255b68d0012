"""Metrics and labels of members: names that are taken, numbers beyond 64 bits, other shapes, texts of digits."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from late import installed
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.study import run
from clsim.study.file import load_study
from clsim.study.member import run_member, study_to_settings
from clsim.study.shards import _write_table
from clsim.torch import _tensor

SCENE = scene_text(
    source_at("talker", tone_of(1e3, 0.01, 16e3, fade=0.002), (1, 1, 1)),
    receiver_at("ear", (3.0, 2.0, 1.5)),
    max_order=0,
    rate=16e3,
    render={"duration": 0.02, "engine": "reference"},
)
STUDY = """
format = 1
scene = "scene.toml"
metrics = "made:metrics"
%s
[[vary]]
field = "min_distance"
values = [0.01]
"""


@pytest.mark.parametrize("name", ["key", "files", "sha256", "warnings", "scene", "full_scale_direct"])
def test_metrics_of_shards_take_no_names_of_labels(tmp_path: Path, name: str) -> None:
    for package in ("xarray", "pyarrow"):
        installed(package)
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY % "shards = { members = 1 }", "utf-8")
    (tmp_path / "made.py").write_text(f"def metrics(*_):\n    return {{{name!r}: 1.0}}\n", "utf-8")
    (tmp_path / "study.json").write_text(json.dumps(study_to_settings(load_study(tmp_path / "study.toml"))), "utf-8")
    row = run_member(str(tmp_path), 0, None)
    assert row["error"] == f"metrics: must return names that are not taken yet, but returned {name!r}"


def test_numbers_beyond_64_bits_are_texts_in_tables(tmp_path: Path) -> None:
    parquet = installed("pyarrow.parquet")
    _write_table(tmp_path / "t.parquet", [{"member": 0, "big": 2**64 - 1}], b"")
    assert parquet.read_table(tmp_path / "t.parquet").to_pylist() == [{"member": 0, "big": str(2**64 - 1)}]


def test_metrics_of_other_shapes_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    xarray = installed("xarray")
    sizes = {f"m{k:06d}": n for k, n in enumerate((2, 2, 3, 1))}
    found = {name: {"m": xarray.DataArray(np.ones(n), dims="x")} for name, n in sizes.items()}
    monkeypatch.setattr(run, "metrics_of", lambda group: found[group.name])
    index = SimpleNamespace(rows={k: run.MemberRow(k, {}, "finished") for k in range(4)})
    with pytest.warns(clsim.ClsimWarning, match="summary: m is NaN for member 2 and others of another shape"):
        stacked = run._stacked(Path("out"), index)
    assert np.isfinite(stacked["m"][1]).all(axis=1).tolist() == [True, True, False, False]


def test_texts_of_digits_are_no_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(from_numpy=lambda array: array))
    for text in ("42", ["1", "2"], [], "nan"):
        made = _tensor(text)
        assert made == text if text else made.shape == (0,)
    assert _tensor([[1, None], [3.0, 4]]).tolist()[1] == [3.0, 4.0]
    assert np.isnan(_tensor(None))
    assert _tensor([True, False]).dtype == bool
    assert _tensor(7).dtype == np.float64
