"""Rooms of scene files that are meshes, plans, or boxes with things in them; keys for options of rendering."""

import argparse
import copy
import importlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pydantic import ValidationError
from scene_fields import leaves, refusal, written

import clsim
from clsim.commands import arguments, run
from clsim.render.options import RenderOptions
from clsim.scene_file import load_scene
from clsim.scene_file.scene import RenderModel, SceneModel, build_scene, completed_scene, render_model, scene_schema
from clsim.study.file import replaced

SCENE = {
    "format": 1,
    "room": {"kind": "shoebox", "size": [4.0, 3.0, 2.5], "walls": {"reflection": 0.9}},
    "sources": [{
        "name": "s",
        "signal": {"kind": "tone", "frequency": 40e3, "duration": 0.01, "sampling_rate": 192e3, "fade": 0.002},
        "trajectory": {"kind": "fixed", "position": [1.0, 1.0, 1.0]},
    }],
    "receivers": [{"name": "r", "trajectory": {"kind": "fixed", "position": [3.0, 1.0, 1.0]}}],
    "paths": {"max_order": 1},
    "render": {"sampling_rate": 192e3, "engine": "reference"},
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class MoreOptions(RenderOptions):
    """The options with a toy among them."""

    tail_db: float = -60.0
    tail_kind: Literal["none", "exponential"] = "none"


def test_a_scene_file_has_a_key_for_each_option() -> None:
    names = {f.name for f in fields(RenderOptions)}
    assert set(RenderModel.model_fields) == names
    assert SceneModel.model_fields["render"].annotation is RenderModel
    assert set(scene_schema()["$defs"]["_Render"]["properties"]) == names
    file = build_scene(SCENE, Path())
    assert set(file.render) == names
    # The defaults are the same, too.
    assert RenderOptions(**file.render) == RenderOptions(192e3, engine="reference")


def test_a_new_option_is_a_key_without_more() -> None:
    model = render_model(MoreOptions)
    assert model.model_json_schema()["properties"]["tail_kind"]["enum"] == ["none", "exponential"]
    table = {"sampling_rate": 192e3, "tail_db": -40.0}
    assert model.model_validate(table).build()["tail_db"] == -40.0
    assert model.model_validate({"sampling_rate": 192e3}).build()["tail_kind"] == "none"
    assert MoreOptions(**model.model_validate(table).build()).tail_db == -40.0
    for wrong in ({"tail_db": "-40"}, {"tail_kind": "other"}, {"tail": 1.0}):
        with pytest.raises(ValidationError):
            model.model_validate(table | wrong)


def test_a_new_option_is_a_key_of_scenes_and_studies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(SceneModel.model_fields, "render", _field(render_model(MoreOptions)))
    monkeypatch.setattr("clsim.scene_file.scene.RenderOptions", MoreOptions)
    SceneModel.model_rebuild(force=True)
    try:
        file = build_scene(replaced(SCENE, "render.tail_db", -45.0), tmp_path)
        assert file.render["tail_db"] == -45.0
        assert "tail_db = -45.0" in completed_scene(file, tmp_path)
        assert "tail_db" in scene_schema()["$defs"]["_Render"]["properties"]
        with pytest.raises(
            clsim.InputError, match=r'render\.tail_kind: must be one of "none", "exponential", but is .x.'
        ):
            build_scene(replaced(SCENE, "render.tail_kind", "x"), tmp_path)
    finally:
        monkeypatch.undo()
        SceneModel.model_rebuild(force=True)
    with pytest.raises(clsim.InputError, match=r"render\.tail_db: is no known key"):
        build_scene(replaced(SCENE, "render.tail_db", -45.0), tmp_path)


def _field(model: type) -> object:
    from pydantic.fields import FieldInfo

    return FieldInfo.from_annotation(model)


def test_the_command_line_takes_types_from_the_options(monkeypatch: pytest.MonkeyPatch) -> None:
    parser = argparse.ArgumentParser()
    run.run_arguments(parser)
    given = parser.parse_args(["s.toml", "-o", "out", "--engine", "reference", "--duration", "0.5", "--device", "0:0"])
    assert (given.engine, given.duration, given.device) == ("reference", 0.5, "0:0")
    with pytest.raises(SystemExit):
        parser.parse_args(["s.toml", "-o", "out", "--engine", "other"])
    monkeypatch.setattr(importlib.import_module("clsim.render.options"), "RenderOptions", MoreOptions)
    arguments.add_render_option(parser, "tail_db", "of the tail")
    assert parser.parse_args(["s.toml", "-o", "out", "--tail-db", "-30"]).tail_db == -30.0


def mesh_scene(tmp_path: Path, room: dict, **paths) -> dict:
    """Return a scene in a room, with files of a floor and a screen beside it."""
    (tmp_path / "floor.obj").write_text("v 0 0 0\nv 8 0 0\nv 8 0 6\nv 0 0 6\nusemtl wood\nf 1 2 3 4\n")
    (tmp_path / "screen.obj").write_text("v 4 1 0\nv 4 3 0\nv 4 3 1.5\nv 4 1 1.5\nf 1 2 3 4\n")
    return {
        "format": 1,
        "room": room,
        "sources": [
            {
                "name": "s",
                "signal": {"kind": "tone", "frequency": 40e3, "duration": 0.1, "sampling_rate": 192e3},
                "trajectory": {"kind": "fixed", "position": [1.0, -2.0, 1.0]},
            }
        ],
        "receivers": [{"name": "r", "trajectory": {"kind": "fixed", "position": [7.0, -2.5, 1.0]}}],
        "paths": {"max_order": 1, **paths},
        "render": {"sampling_rate": 192e3, "transition": 0},
    }


def test_mesh_rooms_with_obstacles(tmp_path: Path) -> None:
    room = {
        "kind": "mesh", "path": "floor.obj", "up": "y", "materials": {"wood": {"reflection": 0.5}},
        "obstacles": [{"path": "screen.obj", "materials": {"reflection": 0.9}}],
    }  # fmt: skip
    file = build_scene(mesh_scene(tmp_path, room, finder="beam-tree", resolution=1e-5), tmp_path)
    assert file.scene.room.faces.names == ("floor wood", "screen")
    assert file.scene.room.reflections(40e3).tolist() == [0.5, 0.9]
    np.testing.assert_allclose(file.scene.room.extent, [[0, -6, 0], [8, 3, 1.5]], atol=1e-12)
    assert file.paths["finder"] == "beam-tree"
    assert file.paths["resolution"] == 1e-5
    assert file.render["transition"] == 0.0
    text = completed_scene(file, tmp_path / "out")
    assert 'path = "../floor.obj"' in text
    assert 'path = "../screen.obj"' in text
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "again.toml").write_text(text)
    assert load_scene(tmp_path / "out" / "again.toml").scene.room.faces.names == ("floor wood", "screen")


def test_shoeboxes_and_plans_with_obstacles(tmp_path: Path) -> None:
    wall = {"reflection": 0.9}
    box = {"kind": "shoebox", "size": [9.0, 9.0, 3.0], "walls": wall}
    plan = {
        "kind": "plan",
        "outline": [[0.0, -6.0], [9.0, -6.0], [9.0, 4.0], [0.0, 4.0]],
        "height": 3.0,
        "materials": wall,
    }
    scene = mesh_scene(tmp_path, plan)
    assert len(build_scene(scene, tmp_path).scene.room.walls) == 6
    scene["room"]["pillars"] = [[[4.0, -5.0], [5.0, -5.0], [5.0, -4.0]]]
    scene["room"]["obstacles"] = [{"path": "screen.obj", "materials": {"default": wall}}]
    assert len(build_scene(scene, tmp_path).scene.room.walls) == 10
    scene["room"] = box | {"obstacles": [{"path": "screen.obj", "materials": wall}]}
    scene["sources"][0]["trajectory"]["position"] = [1.0, 2.0, 1.0]
    scene["receivers"][0]["trajectory"]["position"] = [7.0, 2.0, 1.0]
    assert build_scene(scene, tmp_path).scene.room.faces.names[-1] == "screen"


@pytest.mark.parametrize(
    ("room", "message"),
    [
        ({"kind": "mesh", "path": "none.obj", "materials": {"reflection": 0.9}}, "none.obj: "),
        ({"kind": "mesh", "path": "floor.obj"}, r"room\.materials: must be given, but is missing"),
        ({"kind": "mesh", "path": "floor.obj", "up": "w", "materials": {"reflection": 0.9}}, r'room\.up: must be one of "x", "y", "z"'),
        ({"kind": "mesh", "path": "floor.obj", "materials": {"reflection": 1.9}}, r"room\.materials\.reflection: must be from -1 to 1"),
        ({"kind": "mesh", "path": "floor.obj", "materials": {"glass": {"reflection": 0.9}}}, r"room\.materials\.glass: is no group of floor\.obj"),
        ({"kind": "mesh", "path": "floor.obj", "materials": {"wood": {"reflection": 1.9}}}, r"room\.materials\.wood\.reflection: must be from"),
        (
            {"kind": "mesh", "path": "floor.obj", "materials": {"reflection": 0.9}, "obstacles": [{"path": "screen.obj", "scale": 0.0, "materials": {"reflection": 0.9}}]},
            r"room\.obstacles\[0\]\.scale: must be at least 1e-09",
        ),
        ({"kind": "plan", "outline": [[0.0, 0.0], [1.0, 0.0]], "height": 3.0, "materials": {"reflection": 0.9}}, r"room\.outline: must be three"),
        ({"kind": "barn"}, r"room\.kind: must be one of"),
        ({"path": "floor.obj"}, r'room\.kind: must be one of "shoebox", "mesh", "plan", "polygons", but is missing'),
    ],
)  # fmt: skip
def test_rooms_that_are_none_are_refused(tmp_path: Path, room: dict, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        build_scene(mesh_scene(tmp_path, room), tmp_path)


MESH_ROOM = {
    "kind": "mesh", "path": "floor.obj", "scale": 1.0, "up": "y", "flatness": 1e-6,
    "materials": {"wood": {"named": "concrete"}, "default": {"reflection": 0.9}},
    "obstacles": [
        {"path": "screen.obj", "scale": 1.0, "up": "z", "flatness": 1e-5, "materials": {"reflection": 0.9}},
        {
            "kind": "plan", "outline": [[5.0, 3.0], [6.0, 3.0], [6.0, 4.0]], "height": 1.0,
            "materials": {"default": {"absorption": {"frequencies": [1e3, 50e3], "coefficients": [0.1, 0.2]}}},
        },
    ],
}  # fmt: skip
SEARCH = {"finder": "shooting", "resolution": 1e-5, "path_limit": 1000, "diffraction": 1, "diffraction_model": "btm"}
MESH_LEAVES = [("room", *leaf) for leaf in leaves(MESH_ROOM)] + [("paths", name) for name in SEARCH]


def spoiled(tmp_path: Path, path: tuple, value: object) -> dict:
    """Return the scene in the mesh room, with another value somewhere."""
    content = mesh_scene(tmp_path, copy.deepcopy(MESH_ROOM), **SEARCH)
    at = content
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = value
    return content


def test_what_a_mesh_room_and_its_search_are_told(tmp_path: Path) -> None:
    file = build_scene(spoiled(tmp_path, ("room", "up"), "y"), tmp_path)
    assert file.scene.room.flatness == 1e-5
    assert file.paths == {"max_order": 1, **SEARCH, "engine": "opencl", "device": None}
    assert file.scene.room.scale == 1.0
    several = spoiled(tmp_path, ("room", "obstacles", 0, "scale"), 0.5)
    assert build_scene(several, tmp_path).scene.room.scale is None
    content = spoiled(tmp_path, ("render",), {"sampling_rate": 192e3, "engine": "reference", "device": "0:0"})
    assert build_scene(content, tmp_path).paths["engine"] == "reference"
    assert build_scene(content, tmp_path).paths["device"] == "0:0"


@pytest.mark.parametrize("value", [float("nan"), "text", [], {"odd": 1}, True], ids=repr)
def test_nonsense_in_a_mesh_room_names_the_field(tmp_path: Path, value: object) -> None:
    wrong = []
    for path in MESH_LEAVES:
        if path[-1] == "obstacles" and value == []:
            continue  # there may be none
        match = written(path[: -1 if isinstance(path[-1], int) and value == [] else len(path)])
        told = refusal(spoiled(tmp_path, path, value), tmp_path)
        if not told.startswith(match.rpartition(".kind")[0] or match):
            wrong.append(f"{written(path)}: {told}")
    assert wrong == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("room", "scale"), 0.0),
        (("room", "flatness"), -1e-9),
        (("room", "obstacles", 1, "height"), -1.0),
        (("room", "obstacles", 0, "path"), "../nowhere/screen.obj"),
        (("room", "obstacles", 0, "obstacles"), []),
    ],
)
def test_values_out_of_range_in_a_mesh_room_name_the_field(tmp_path: Path, path: tuple, value: object) -> None:
    with pytest.raises(clsim.InputError) as caught:
        build_scene(spoiled(tmp_path, path, value), tmp_path)
    assert str(caught.value).startswith(f"{written(path)}: "), str(caught.value)
    if path[-1] == "path":
        assert str(tmp_path / str(value)) in str(caught.value)
