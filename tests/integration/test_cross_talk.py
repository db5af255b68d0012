"""A sonar's own sound, left out of what it hears or at a level of its own."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_sonar import RATE, SCENE, level_db, sonar, sonar_paths

import clsim
from clsim.paths.path_set import PathSet
from clsim.scene_file.scene import SceneFile, completed_scene


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> SceneFile:
    """Return the scene file, read."""
    return sonar(tmp_path_factory.mktemp("sonar"))


@pytest.fixture(scope="module")
def paths(file: SceneFile) -> PathSet:
    """Return its paths."""
    return sonar_paths(file)


def test_a_sonar_without_its_cross_talk(file: SceneFile, paths: PathSet) -> None:
    """Echoes alone, or with the room; nothing else changes."""
    echoes = clsim.find_paths(file.scene, 0, direct=False)
    assert echoes.order.tolist() == [1, 1, 1]
    assert [echoes.object_names[i] for i in echoes.objects[:, 0]] == ["hand", "ball", "bat"]
    wanted = clsim.render(
        PathSet(file.scene, clsim.find_paths(file.scene, 0).families[1:]), RATE, duration=0.06
    ).pressure
    np.testing.assert_array_equal(clsim.render(echoes, RATE, duration=0.06).pressure, wanted)
    assert np.any(wanted)
    both = clsim.find_paths(file.scene, 1, scattering_order=1, direct=False)
    assert len(both) == len(paths) - 1
    assert both.order.min() == 1
    bare = clsim.Scene(file.scene.room, clsim.Air(), file.scene.sources, file.scene.receivers)
    nothing = clsim.find_paths(bare, 0, direct=False)
    assert len(nothing) == 0
    assert not np.any(clsim.render(nothing, RATE, duration=0.01).pressure)
    with pytest.raises(clsim.InputError, match="direct: must be True, False or a level below 0 dB, but is 0"):
        clsim.find_paths(file.scene, 0, direct=0)


def wide_scene(scene: clsim.Scene, scatterers: Any = ()) -> clsim.Scene:
    """Return a scene with two ears more."""
    far = [clsim.Receiver(name, clsim.Trajectory.fixed((1.0, y, 1.2))) for name, y in (("left", 1.5), ("right", 2.5))]
    return clsim.Scene(scene.room, scene.air, scene.sources, [*scene.receivers, *far], scatterers=scatterers)


def test_cross_talk_by_pair(file: SceneFile, device: None) -> None:
    """A baffle's 20 dB for one ear, nothing for another; all else stays."""
    wide = wide_scene(file.scene)
    free = clsim.find_paths(wide, 1)
    wanted = {("sonar", "ear"): -20.0, ("sonar", "right"): False, ("sonar", "left"): True}
    found = clsim.find_paths(wide, 1, direct=wanted)
    assert len(found) == len(free) - 1
    assert found.digest() != clsim.find_paths(wide, 1, direct=wanted | {("sonar", "ear"): -20.5}).digest()
    parts = [
        clsim.PathSet(wide, (free.families[0].part(np.flatnonzero(rows)),))
        for rows in (free.order == 0, free.order > 0)
    ]
    for engine in ("opencl", "reference"):
        direct, echoes = (clsim.render(part, RATE, duration=0.04, engine=engine).pressure for part in parts)
        heard = clsim.render(found, RATE, duration=0.04, engine=engine).pressure
        levels = np.array([0.1, 1.0, 0.0])[:, None]
        assert level_db(heard - echoes - levels * direct, heard) < -110.0
    assert clsim.direct_path(found, [0.03]).line_of_sight[0, :, 0].tolist() == [True, True, False]


def test_the_truth_about_every_scatterer_as_seen_from_every_pair(file: SceneFile) -> None:
    seen = wide_scene(file.scene, file.scene.scatterers)
    truth = clsim.scatterer_truth(seen, [0.03])
    table, names = clsim.find_paths(seen, 0).table([0.03]), [s.name for s in seen.scatterers]
    for i in np.flatnonzero(table.order):
        here = names.index(table.name_objects(i)), 0, table.receiver[i], 0
        assert truth.delay[here] == pytest.approx(table.delay[i, 0], rel=1e-14)
        np.testing.assert_allclose(truth.bearing[here], table.arrival[i, 0], atol=1e-12)
    assert truth.delay.shape == (3, 1, 3, 1)


def test_cross_talk_in_files(tmp_path: Path) -> None:
    text = SCENE.replace("scattering_order = 1", 'direct = [{ source = "sonar", receiver = "ear", level_db = -20.0 }]')
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    read = clsim.load_scene(tmp_path / "scene.toml")
    assert read.paths["direct"] == {("sonar", "ear"): -20.0}
    (tmp_path / "again.toml").write_text(completed_scene(read, tmp_path), "utf-8")
    assert clsim.load_scene(tmp_path / "again.toml").paths == read.paths
    (tmp_path / "scene.toml").write_text(text.replace(", level_db = -20.0", ""), "utf-8")
    assert clsim.load_scene(tmp_path / "scene.toml").paths["direct"] == {("sonar", "ear"): False}


@pytest.mark.parametrize(
    ("direct", "message"),
    [
        ({("sonar", "nose"): False}, r"direct: must name a receiver of the scene \('ear'\), but names 'nose'"),
        ({("bat", "ear"): False}, r"direct: must name a source of the scene \('sonar'\), but names 'bat'"),
        ({"sonar": False}, "direct: must have pairs"), ({("sonar", "ear"): 3.0}, r"direct\[sonar, ear\]: must be True, False"),
        (np.inf, "direct: must be True, False"), (-np.inf, "direct: must be finite"),
    ],
)  # fmt: skip
def test_what_cannot_be_cross_talk(file: SceneFile, direct: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.find_paths(file.scene, 0, direct=direct)
