"""The built-in materials: all load, all say where they are from, tables say what was published."""

import json
import re
import warnings

import numpy as np
import pytest
from scenes import DATA

from clsim.cli import main
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import LIBRARY, MATERIAL_NAMES, Material

TABLES = [name for name, entry in LIBRARY.items() if entry.constructor == "absorption"]
ESTIMATES = [name for name in LIBRARY if name.startswith("estimated-")]
TABLE = DATA / "materials" / "pyroomacoustics_materials.json"
OCTAVES = np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3])


@pytest.mark.parametrize("name", MATERIAL_NAMES)
def test_every_material_says_what_it_is_and_how_sure(name):
    entry = LIBRARY[name]
    assert (entry.name, Material.named(name).name) == (name, name)
    assert len(entry.source) > 5
    assert entry.what
    assert entry.uncertainty == "exact" or re.match(
        r"0\.\d+ of the absorption|(an upper bound: )?0\.\d", entry.uncertainty
    )
    assert entry.estimated == name.startswith("estimated-")


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_met_at_their_own_frequencies_and_held_above_by_name(name):
    material, entry = Material.named(name), LIBRARY[name]
    coefficients = np.array(entry.arguments["coefficients"])
    assert np.all((coefficients >= 0.0) & (coefficients <= 1.0))
    np.testing.assert_allclose(material.reflection_at(OCTAVES), np.sqrt(1.0 - coefficients), rtol=1e-13)
    assert material.band == (125.0, 4000.0)
    with pytest.warns(
        ClsimWarning, match=f"'{name}' covers 125 to 4000 Hz; outside, .* nearest end .*ultrasound"
    ) as told:
        assert material.reflection_at(40e3) == pytest.approx(np.sqrt(1.0 - coefficients[-1]), rel=1e-14)
    instead = re.search(r"there is '([^']*)', an estimate", str(told[0].message))
    assert instead is None or instead[1] in ESTIMATES
    assert (material.is_complex, material.depends_on_angle) == (False, False)


def test_published_values_are_kept():
    assert Material.named("rigid").reflection_at(40e3) == 1.0
    assert Material.named("pressure-release").reflection_at(40e3) == -1.0
    for name, at, alpha in (
        ("concrete", 500.0, 0.015), ("brick", 4000.0, 0.07), ("plaster", 125.0, 0.013), ("glass", 125.0, 0.18),
        ("linoleum", 250.0, 0.03), ("carpet", 1000.0, 0.37),
    ):  # fmt: skip
        assert Material.named(name).reflection_at(at) == pytest.approx(np.sqrt(1 - alpha), rel=1e-14)


@pytest.mark.parametrize("name", ESTIMATES)
def test_estimates_hold_at_ultrasound_without_a_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        factor = np.abs(Material.named(name).reflection_at([[20e3], [40e3], [80e3]], [1.0, 0.5, 0.1]))
    assert np.all(factor <= 1.0)
    assert np.all(factor > 1e-3)


def test_estimated_ranges_are_what_the_assumed_properties_make():
    """The range of a factor at 40 kHz, from the range of roughness that stands beside it."""
    checked = 0
    for name in ESTIMATES:
        told = re.match(
            r"([\d.]+) to ([\d.]+) at 40 kHz, for a roughness of ([\d.]+) to ([\d.]+) mm", LIBRARY[name].uncertainty
        )
        if told is None:
            continue
        low, high, rough, smooth = map(float, told.groups())
        solid = Material.from_solid(**LIBRARY[name].arguments)
        assert smooth < 1e3 * LIBRARY[name].roughness < rough
        # Told with two digits, rounded down above: nobody is told more than there is.
        assert abs(solid.rough(1e-3 * rough).reflection_at(40e3)) == pytest.approx(low, abs=0.006)
        assert abs(solid.rough(1e-3 * smooth).reflection_at(40e3)) == pytest.approx(high, abs=0.0100)
        checked += 1
    assert checked == 4


@pytest.mark.parametrize(
    ("name", "resistivities", "thicknesses"),
    [("estimated-carpet", (20e3, 200e3), (0.005, 0.010)), ("estimated-mineral-wool", (10e3, 200e3), (0.04, 0.04))],
)
def test_porous_ranges_are_what_the_assumed_properties_make(name, resistivities, thicknesses):
    low, high = map(float, re.match(r"([\d.]+) to ([\d.]+) at 40 kHz", LIBRARY[name].uncertainty).groups())
    factors = [
        abs(Material.from_porous(s, d, "extend").reflection_at(40e3))
        for s in np.geomspace(*resistivities, 15)
        for d in np.linspace(*thicknesses, 25)
    ]
    assert min(factors) == pytest.approx(low, abs=0.01)
    assert max(factors) == pytest.approx(high, abs=0.02)


def test_unknown_names_are_refused_with_a_list():
    for name in ("wood", "", None, ["carpet"]):
        with pytest.raises(InputError, match=r"31 names, but is .wood.; did you mean|carpet") as error:
            Material.named(name)
        assert error.value.field == "name"


def test_the_command_lists_them(capsys):
    assert main(["materials"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for name, entry in LIBRARY.items():
        assert re.search(rf"^{name} +(all|125 to 4000) ", printed.out, re.MULTILINE), name
        assert f"  {name}: {entry.uncertainty}" in printed.out
        assert entry.source in printed.out
    assert main(["materials", "carpet", "rigid", "carpet", "--frequency", "1000"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["carpet", "rigid"]
    assert "2.01 dB " in lines[1], "-10 log10(1 - 0.37)"
    assert "held" not in lines[1]


def test_the_command_draws_them(tmp_path, capsys):
    picture = tmp_path / "walls.png"
    assert main(["materials", "rigid", "carpet", "estimated-carpet", "-o", str(picture)]) == 0
    assert capsys.readouterr().out.strip() == str(picture)
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert main(["materials", "-o", str(picture), "--force"]) == 0, "all of them"
    assert [p.name for p in tmp_path.iterdir()] == ["walls.png"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["wool"], "NAME: must be a built-in material (`clsim materials` lists them), but is 'wool'"),
        (["carpet", "--frequency", "0"], "--frequency: must be finite and above 0 Hz, but is 0 Hz"),
        (["carpet", "--frequency", "nan"], "--frequency: must be finite"),
        (["carpet", "-o", "/nowhere/walls.png"], "but /nowhere does not"),
    ],
)
def test_the_command_tells_errors_in_a_line(arguments, message, capsys):
    assert main(["materials", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert message in printed.err


@pytest.mark.skipif(not TABLE.exists(), reason=f"no real data: {TABLE} is missing")
def test_ninety_published_entries_of_somebody_else_are_materials():
    content = json.loads(TABLE.read_text("utf-8"))
    entries = [entry for group in content["absorption"].values() for entry in group.values()]
    assert len(entries) == 90
    for entry in entries:
        alpha = np.array(entry["coeffs"])
        f = np.array(entry.get("center_freqs", content["center_freqs"]))[: len(alpha)]
        material = Material.from_absorption(f, alpha, entry["description"])
        np.testing.assert_allclose(material.reflection_at(f) ** 2, 1.0 - alpha, atol=1e-14)
        between = material.reflection_at(np.geomspace(f[0], f[-1], 300)) ** 2
        assert between.min() >= (1.0 - alpha).min() - 1e-12
        assert between.max() <= (1.0 - alpha).max() + 1e-12
