"""Plugins that are installed: each kind is found by its entry point, used, and refused by name where it is wrong."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, tone_of

from clsim.errors import InputError
from clsim.plugins import METHODS, PATH_FAMILIES, STORES, _plugins, with_plugins

SCENE = scene_text(
    source_at("s", tone_of(10e3, 0.02, 48e3, fade=0.001), (2.0, 2.0, 1.0)),
    receiver_at("quiet", (3.0, 1.0, 2.0)),
    receiver_at("mains 1", (3.0, 1.0, 2.0)),
    room=shoebox_of(8.0, 6.0, 3.0, reflection=0.8),
    max_order=0,
    rate=48e3,
    render={"engine": "reference"},
)
HALF_SPACE = """
import clsim
from clsim_barn.half_space import HalfSpace
tone = clsim.Signal.tone(40e3, 0.01, 192e3, fade=1e-3)
source = clsim.Source("s", tone, clsim.Trajectory.fixed((0.0, 0.0, 0.5)))
ear = clsim.Receiver("e", clsim.Trajectory.fixed((3.0, 0.0, 0.5)))
paths = clsim.find_paths(clsim.Scene(HalfSpace(), clsim.Air(), [source], [ear]), 2)
delays = paths.table([0.0]).delay[:, 0] * paths.scene.air.speed_of_sound
print(*delays)
"""


def test_family_store_and_method_take_part_in_a_run(tmp_path, installed_plugins: Path, monkeypatch, error_of) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(SCENE, "utf-8")
    command = [sys.executable, "-m", "clsim", "run", str(scene), "-o", str(tmp_path / "out"), "--no-plots", "--store"]
    path = os.pathsep.join([str(installed_plugins), *sys.path])
    subprocess.run([*command, "columns"], check=True, env=os.environ | {"PYTHONPATH": path}, capture_output=True)
    quiet, humming = np.load(tmp_path / "out" / "sound.npy").T
    times = np.arange(len(quiet)) / 48e3
    np.testing.assert_allclose(humming - quiet, 0.01 * np.sin(2.0 * np.pi * 50.0 * times), atol=1e-6)
    table = np.load(tmp_path / "out" / "paths.npz")
    assert "ridge" in str({name: table[name] for name in table.files})
    assert '--store: must be one of "wav", "zarr", "hdf5", but is' in error_of(
        "run", scene, "-o", tmp_path / "without", "--store", "columns"
    )


def test_paths_in_a_room_of_a_plugin_are_found(installed_plugins: Path) -> None:
    path = os.pathsep.join([str(installed_plugins), *sys.path])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", HALF_SPACE], check=True, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    direct, reflected, *ridge = map(float, done.stdout.split())
    assert (direct, reflected) == pytest.approx((3.0, np.sqrt(10.0)), rel=1e-12)
    assert len(ridge) == 1  # of the path family, whose edge is above the floor


def entry_points(folder: Path, name: str, text: str) -> None:
    info = folder / f"{name}-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n", "utf-8")
    (info / "entry_points.txt").write_text(text, "utf-8")


@pytest.mark.parametrize(
    ("group", "known", "lines", "message"),
    [
        (PATH_FAMILIES, {}, ["x = no_such_module:f"], r"plugin clsim.path_families:x: must be importable, but raises ModuleNot.*of first"),
        (METHODS, {}, ["x = math:pi"], r"clsim.methods:x: must be a class or a function, but is 3.14.*math:pi of first"),
        (STORES, {"wav": 1}, ["wav = math:sin"], "name of its own in clsim.stores, but 'wav' is part of clsim"),
        (STORES, {}, ["x = math:sin", "x = math:cos"], "but 'x' is math:cos and math:sin"),
    ],
)  # fmt: skip
def test_wrong_plugins_are_refused(tmp_path: Path, monkeypatch, group: str, known, lines, message: str) -> None:
    for name, line in zip(("first", "second"), lines, strict=False):
        entry_points(tmp_path, name, f"[{group}]\n{line}\n")
    monkeypatch.syspath_prepend(tmp_path)
    _plugins.cache_clear()
    with pytest.raises(InputError, match=message):
        with_plugins(known, group)
    _plugins.cache_clear()
