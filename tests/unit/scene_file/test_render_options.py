"""The options of a rendering stand in one place: scene file, schema, study and command line follow."""

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import pytest
from pydantic import ValidationError

import clsim
from clsim.commands import arguments, run
from clsim.render.options import RenderOptions
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
    run.add_arguments(parser)
    given = parser.parse_args(["s.toml", "-o", "out", "--engine", "reference", "--duration", "0.5", "--device", "0:0"])
    assert (given.engine, given.duration, given.device) == ("reference", 0.5, "0:0")
    with pytest.raises(SystemExit):
        parser.parse_args(["s.toml", "-o", "out", "--engine", "other"])
    monkeypatch.setattr(arguments, "RenderOptions", MoreOptions)
    arguments.add_render_option(parser, "tail_db", "of the tail")
    assert parser.parse_args(["s.toml", "-o", "out", "--tail-db", "-30"]).tail_db == -30.0
