"""Materials in scene files: every constructor, every error by its field, paths, the schema."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile
import tomli_w

import clsim
from clsim.cli import main
from clsim.scene_file import load_scene
from clsim.scene_file.scene import build_scene, completed_scene, scene_schema

COMPLEX = {"frequencies": [30e3, 50e3], "factors": [[0.5, 0.1], 0.4]}
IMPEDANCE = {"frequencies": [30e3, 50e3], "impedances": [[3.0, -1.0], 2.0]}
WAYS = {
    "reflection": 0.9,
    "named": "carpet",
    "absorption": {"frequencies": [1e3, 50e3], "coefficients": [0.1, 0.2]},
    "table": COMPLEX,
    "impedance": IMPEDANCE,
    "impulse_response": {"samples": [0.5, 0.1], "sampling_rate": 192e3, "reference": 0.5, "band": [1e3, 90e3]},
    "wav": {"path": "wall.wav", "channel": 0, "scale": 0.5},
    "solid": {"density": 2300.0, "sound_speed": 3500.0},
    "porous": {"flow_resistivity": 50e3, "thickness": 0.02},
}


def scene(walls: dict) -> dict:
    """Return a scene in a box with these walls."""
    return {
        "format": 1,
        "room": {"kind": "shoebox", "size": [4.0, 3.0, 2.5], "walls": walls},
        "sources": [
            {
                "name": "s",
                "signal": {"kind": "tone", "frequency": 40e3, "duration": 0.1, "sampling_rate": 192e3},
                "trajectory": {"kind": "fixed", "position": [1.0, 2.0, 1.0]},
            }
        ],
        "receivers": [{"name": "r", "trajectory": {"kind": "fixed", "position": [3.0, 2.5, 1.0]}}],
        "paths": {"max_order": 1},
        "render": {"sampling_rate": 192e3},
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    soundfile.write(tmp_path / "wall.wav", [0.5, 0.25], 192000, subtype="FLOAT")
    return tmp_path


def material(walls: dict, folder: Path) -> clsim.Material:
    return build_scene(scene(walls), folder).scene.room.faces.materials[0]


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")
@pytest.mark.parametrize("way", WAYS)
def test_every_constructor_has_its_table(way, folder):
    said = {
        "reflection": lambda: clsim.Material.from_reflection(0.9),
        "named": lambda: clsim.Material.named("carpet"),
        "absorption": lambda: clsim.Material.from_absorption([1e3, 50e3], [0.1, 0.2]),
        "table": lambda: clsim.Material.from_table([30e3, 50e3], [0.5 + 0.1j, 0.4]),
        "impedance": lambda: clsim.Material.from_impedance([30e3, 50e3], [3 - 1j, 2]),
        "impulse_response": lambda: clsim.Material.from_impulse_response([0.5, 0.1], 192e3, 0.5, (1e3, 90e3)),
        "wav": lambda: clsim.Material.from_impulse_response([0.25, 0.125], 192e3),
        "solid": lambda: clsim.Material.from_solid(2300.0, 3500.0),
        "porous": lambda: clsim.Material.from_porous(50e3, 0.02),
    }[way]()
    read = material({way: WAYS[way]}, folder)
    f, cosine = np.array([35e3, 40e3]), np.array([[1.0], [0.3]])
    np.testing.assert_array_equal(read.reflection_at(f, cosine), said.reflection_at(f, cosine))
    rough = material({way: WAYS[way], "roughness": 2e-4}, folder)
    np.testing.assert_array_equal(rough.reflection_at(f, cosine), said.rough(2e-4).reflection_at(f, cosine))
    told = {"frequencies": [30e3, 50e3], "values": [0.2, 0.4]}
    np.testing.assert_allclose(
        material({way: WAYS[way], "scattering": told}, folder).scattered_share(f),
        clsim.Material.from_reflection(1.0, scattering=([30e3, 50e3], [0.2, 0.4])).scattered_share(f), rtol=1e-12,
    )  # fmt: skip


def test_a_complex_number_is_a_pair(folder):
    assert material({"reflection": [0.5, -0.2]}, folder).reflection_at(40e3) == 0.5 - 0.2j
    assert not material({"reflection": [0.5, 0.0]}, folder).is_complex


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ({}, r"room\.walls: must have one of reflection, named, .*, reverberation_time, but has none of them"),
        ({"roughness": 1e-4}, r"room\.walls: must have one of .* but has none"),
        ({"reflection": 0.9, "named": "carpet"}, r"room\.walls: must have one of .* but has reflection and named"),
        ({"reflection": 1.2}, r"room\.walls\.reflection: must be from -1 to 1, but is 1.2"),
        ({"reflection": [0.9, 0.9]}, r"room\.walls\.reflection: must have a magnitude of at most 1, but is 0.9\+0.9j"),
        ({"reflection": [0.9]}, r"room\.walls\.reflection: must be a number or \[real, imaginary\], but is \[0.9\]"),
        ({"reflection": "0.9"}, r"room\.walls\.reflection: must be a number"),
        ({"reflection": 0.9, "roughness": 0.2}, r"room\.walls\.roughness: must be at most 0.1 m, but is 0.2 m"),
        ({"reflection": 0.9, "roughness": -1.0}, r"room\.walls\.roughness: must be at least 0 m"),
        ({"reflection": 0.9, "transmission": {}}, r"room\.walls\.transmission: must have surface_mass, or"),
        ({"reflection": 0.9, "transmission": {"surface_mass": 0.0}}, r"transmission\.surface_mass: must be at least"),
        ({"reflection": 0.9, "scattering": 2.0}, r"room\.walls\.scattering: must be at most 1, but is 2"),
        ({"named": "plywod"}, r'room\.walls\.named: must be one of 31 names, .*; did you mean "plywood"'),
        ({"default": {"named": "wood"}}, r'room\.walls\.default\.named: must be one of 31 names'),
        ({"absorption": {"frequencies": [1e3], "coefficients": [1.2]}}, r"room\.walls\.absorption\.coefficients\[0\]: must be from 0 to 1"),
        ({"absorption": {"frequencies": [1e3]}}, r"room\.walls\.absorption\.coefficients: must be given, but is missing"),
        ({"table": COMPLEX | {"frequencies": [50e3, 30e3]}}, r"room\.walls\.table\.frequencies: must increase strictly"),
        ({"table": COMPLEX | {"factors": [0.5]}}, r"room\.walls\.table\.factors: must have the shape 2, but has 1"),
        ({"table": COMPLEX | {"factors": [0.5, [0.9, 0.9]]}}, r"room\.walls\.table\.factors\[1\]: must have a magnitude"),
        ({"table": COMPLEX | {"factors": [0.5, [0.9]]}}, r"room\.walls\.table\.factors\[1\]: must be a number or \[real, imaginary\], but is \[0.9\]"),
        ({"table": COMPLEX | {"factors": []}}, r"room\.walls\.table\.factors: must have the shape 2, but has 0"),
        ({"table": COMPLEX | {"outside": "zero"}}, r'room\.walls\.table\.outside: must be one of "hold"'),
        ({"impedance": IMPEDANCE | {"impedances": [1.0, -1.0]}}, r"room\.walls\.impedance\.impedances\[1\]: must have a real part"),
        ({"impulse_response": {"samples": [], "sampling_rate": 1e5}}, r"room\.walls\.impulse_response\.samples: must not be empty"),
        ({"impulse_response": {"samples": [1.2], "sampling_rate": 1e5}}, r"room\.walls\.impulse_response\.samples: must send back no more"),
        ({"impulse_response": {"samples": [0.2], "sampling_rate": 1e5, "band": [1.0]}}, r"room\.walls\.impulse_response\.band: must have the shape 2, but has 1"),
        ({"wav": {"path": "none.wav"}}, r"room\.walls\.wav\.path: must be a sound file, but there is no file .*none.wav"),
        ({"wav": {"path": "wall.wav", "channel": 1}}, r"room\.walls\.wav\.channel: must be below 1"),
        ({"wav": {"path": "wall.wav", "chanel": 1}}, r"room\.walls\.wav\.chanel: is no known key"),
        ({"solid": {"density": 0.0, "sound_speed": 1e3}}, r"room\.walls\.solid\.density: must be above 0"),
        ({"porous": {"flow_resistivity": 50e3, "thickness": -1.0}}, r"room\.walls\.porous\.thickness: must be above 0 m"),
        ({"porous": 5}, r"room\.walls\.porous: "),
        ({"x_min": {"porous": {"thickness": 1.0}}, "default": {"reflection": 0.5}}, r"room\.walls\.x_min\.porous\.flow_resistivity: must be given"),
        ({"felt": {"reflection": 0.5}}, r"room\.walls\.felt: is no known key"),
    ],
)  # fmt: skip
def test_errors_name_field_rule_and_value(walls, message, folder):
    with pytest.raises(clsim.InputError, match=message):
        build_scene(scene(walls), folder)


def test_a_copy_of_the_scene_elsewhere_finds_the_sound_file(folder):
    walls = {"default": {"wav": {"path": "wall.wav"}}, "x_min": {"reflection": [0.0, 0.5]}}
    file = build_scene(scene(walls), folder)
    (folder / "out").mkdir()
    copy = folder / "out" / "scene.completed.toml"
    copy.write_text(completed_scene(file, folder / "out"), "utf-8")
    assert 'path = "../wall.wav"' in copy.read_text("utf-8")
    again = load_scene(copy).scene.room.faces.materials
    for read, first in zip(again, file.scene.room.faces.materials, strict=True):
        assert read.reflection_at(40e3) == first.reflection_at(40e3)


@pytest.mark.parametrize("group", ["table", "solid", "wav", "roughness", "path", "wood"])
def test_groups_of_a_mesh_may_be_called_like_a_constructor(group, tmp_path):
    (tmp_path / "floor.obj").write_text(f"v 0 0 0\nv 8 0 0\nv 8 6 0\nv 0 6 0\nusemtl {group}\nf 1 2 3 4\n")
    content = scene({})
    content["room"] = {"kind": "mesh", "path": "floor.obj", "materials": {group: {"reflection": 0.5}}}
    file = build_scene(content, tmp_path)
    assert file.scene.room.reflections(40e3).tolist() == [0.5]
    assert f"[room.materials.{group}]" in completed_scene(file, tmp_path / "out")
    content["room"]["materials"] = {"solid": WAYS["solid"] | {"boundary_layer": False}}
    assert build_scene(content, tmp_path).scene.room.reflections(40e3) == pytest.approx(0.9999, abs=1e-5)


def test_the_schema_knows_every_way():
    properties = scene_schema()["$defs"]["MaterialModel"]["properties"]
    assert set(properties) == {*WAYS, "reverberation_time", "roughness", "scattering", "transmission"}


def test_all_ways_pass_through_the_checks_of_a_scene_without_warnings(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for way, told in WAYS.items():
            material({way: told}, folder)


@pytest.mark.parametrize("command", ["check", "paths", "run"])
def test_a_material_beyond_its_table_is_told_once(command, folder, capsys, device):
    content = scene({"default": {"named": "carpet"}, "x_min": {"named": "brick"}, "x_max": {"reflection": 0.5}})
    file = folder / "scene.toml"
    file.write_text(tomli_w.dumps(content), "utf-8")
    more = ["-o", str(folder / "out"), "--no-plots"] if command == "run" else []
    assert main([command, str(file), *more]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "the material" in line]
    assert len(told) == 2
    for line, name in zip(sorted(told), ("brick", "carpet"), strict=True):
        assert line.startswith(f"clsim: warning: the material '{name}' covers 125 to 4000 Hz; outside, the")
        assert f"'estimated-{name}', an estimate" in line


def test_a_table_that_does_not_reach_is_an_error_in_a_line(folder, capsys, device):
    file = folder / "scene.toml"
    file.write_text(tomli_w.dumps(scene({"table": {"frequencies": [1e3, 2e3], "factors": [0.5, 0.5]}})), "utf-8")
    assert main(["check", str(file)]) == 2
    printed = capsys.readouterr()
    assert printed.err.endswith(
        ": room: frequency must be from 1000 to 2000 Hz, which the material (table of factors) covers, "
        "but is 45093.8 Hz; extend it by name (outside = …) or give more of it\n"
    )
