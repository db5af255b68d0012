"""Ground truth has the same names and values behind every door; silent paths are silent."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from made_results import read_table
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.output.columns import Columns
from clsim.output.result_files import write_ground_truth, write_table
from clsim.paths.path_table import viewed
from clsim.study.content import _add_ground_truth, _add_paths

TIMES = np.array([0.0, 0.04, 0.1])
OF_PATHS = ("source", "receiver", "order", "interactions", "objects", "direct")
OVER_TIME = ("delay", "doppler_factor", "doppler_shift", "gain", "departure", "arrival")
OF_DIRECT_PATH = (
    "delay", "doppler_factor", "line_of_sight", "radial_speed", "reception_time", "arrival", "local_arrival",
    "source_position", "receiver_position",
)  # fmt: skip


@pytest.fixture(scope="module")
def paths() -> clsim.PathSet:
    """Return a walk past a screen that hides the direct path for a while, and a floor that returns nothing."""
    floor = clsim.Material.from_reflection(0.0)
    room = clsim.Shoebox((8, 6, 3), {"default": clsim.Material.from_reflection(0.9), "z_min": floor})
    screen = clsim.MeshRoom([(4, 1, 0.5), (4, 2, 0.5), (4, 2, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], floor)
    source = clsim.Source(
        "s", clsim.Signal.tone(40e3, 0.1, 192e3), clsim.Trajectory.line((2, 1.5, 1), (2, 3.5, 1), 0.2)
    )
    receivers = [clsim.Receiver(n, clsim.Trajectory.fixed(p)) for n, p in (("a", (6, 1.5, 1.5)), ("b", (6, 4, 1)))]
    scene = clsim.Scene(clsim.MeshRoom.joined([room, screen]), clsim.Air(), [source], receivers)
    return clsim.find_paths(scene, 1, engine="reference", resolution=1e-4)


@pytest.fixture(scope="module")
def table(paths: clsim.PathSet):
    return paths.table(TIMES)


def test_every_door_has_the_table_under_its_own_names(paths: clsim.PathSet, table, tmp_path: Path) -> None:
    names = {"times", *OF_PATHS, *OVER_TIME}
    assert {f.name for f in fields(table)} == names | {"source_names", "receiver_names", "object_names"}
    assert np.isnan(table.delay).any()
    write_table(table, tmp_path / "paths.npz")
    with np.load(tmp_path / "paths.npz") as file:
        assert set(file) == {f.name for f in fields(table)}
        for name in names:
            np.testing.assert_array_equal(file[name], getattr(table, name))
    assert read_table(tmp_path / "paths.npz").doppler_factor.shape == table.delay.shape
    member = Columns()
    _add_paths(member, table)
    assert set(member.variables) == {"times", *(f"path_{name}" for name in OF_PATHS + OVER_TIME)}
    for name in OF_PATHS + OVER_TIME:
        np.testing.assert_array_equal(member.variables[f"path_{name}"].values, getattr(table, name))
    np.testing.assert_array_equal(member.variables["times"].values, table.times)


def test_parquet_has_the_names_of_the_table(table, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    write_table(table, tmp_path / "paths.parquet")
    rows = parquet.read_table(tmp_path / "paths.parquet")
    directions = {f"{name}_{axis}" for name in ("departure", "arrival") for axis in "xyz"}
    assert set(rows.column_names) == {
        "times",
        "path",
        *OF_PATHS,
        "delay",
        "doppler_factor",
        "doppler_shift",
        "gain",
        *directions,
    }
    path, time = np.nonzero(np.isfinite(table.delay))
    np.testing.assert_array_equal(rows["times"].to_numpy(), table.times[time])
    for name in ("delay", "doppler_factor", "gain"):
        np.testing.assert_array_equal(rows[name].to_numpy(), getattr(table, name)[path, time])
    np.testing.assert_array_equal(rows["departure_y"].to_numpy(), table.departure[path, time, 1])


def test_every_door_has_the_ground_truth_under_its_own_names(paths: clsim.PathSet, table, tmp_path: Path) -> None:
    exact = clsim.direct_path(paths, TIMES)
    assert {f.name for f in fields(exact)} == {"times", "emitted", *OF_DIRECT_PATH, "source_names", "receiver_names"}
    write_ground_truth(exact, tmp_path / "ground_truth.npz")
    member = Columns()
    _add_ground_truth(member, exact, paths.scene)
    assert set(member.variables) == {"times", "source", *OF_DIRECT_PATH}
    with np.load(tmp_path / "ground_truth.npz") as file:
        assert set(file) == {"times", "emitted", *OF_DIRECT_PATH, "source_names", "receiver_names"}
        assert not file["emitted"]
        for name in ("times", *OF_DIRECT_PATH):
            np.testing.assert_array_equal(file[name], getattr(exact, name))
            np.testing.assert_array_equal(member.variables[name].values, getattr(exact, name))
    # What is true of the direct path is that of the table, where it is heard.
    for row in np.flatnonzero(table.direct):
        heard, r = table.audible[row], table.receiver[row]
        assert exact.line_of_sight[0, r][heard].all()
        for name in ("delay", "doppler_factor", "arrival"):
            np.testing.assert_array_equal(getattr(exact, name)[0, r][heard], getattr(table, name)[row][heard])
    np.testing.assert_allclose(
        exact.radial_speed, paths.scene.air.speed_of_sound * (1.0 - exact.doppler_factor), rtol=0, atol=1e-12
    )
    assert not exact.line_of_sight.all()


def test_a_silent_path_is_not_counted_as_heard(paths: clsim.PathSet, table) -> None:
    there = np.isfinite(table.delay)
    silent = there & ~table.audible
    assert 0 < silent[:, 0].sum() < there[:, 0].sum()
    assert np.all(table.gain[silent] == 0.0)
    frame = viewed(paths, duration=0.1, frames=1)["frames"][0]
    assert len(frame.order) == table.audible[:, 0].sum()
    assert not any("z_min" in label for label in frame.labels)


SCENE = scene_text(
    source_at("s", tone_of(40e3, 0.01), (2.0, 2.0, 1.0)),
    receiver_at("r", (6.0, 3.0, 1.0)),
    room={
        "kind": "shoebox",
        "size": (8.0, 6.0, 3.0),
        "walls": {"default": {"reflection": 0.9}, "z_min": {"reflection": 0.0}},
    },
)


def test_paths_are_listed_as_silent(tmp_path: Path, capsys) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    assert main(["paths", str(tmp_path / "scene.toml")]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert "doppler factor" in head
    assert len(lines) == 7
    assert [line for line in lines if "silent" in line] == [line for line in lines if "z_min" in line] != []
    assert not any("-600" in line for line in lines)
