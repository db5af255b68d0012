"""Bodies together with scatterers, edges, tails, baseband, studies and resumed runs; and what is refused of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_texts import chirp_of, receiver_at, scene_text, source_at

import clsim
from clsim.cli import main
from clsim.paths.path_set import PathSet

RATE = 96e3
HEAD = scene_text(
    source_at("sonar", chirp_of(6e3, 9e3, 0.2, 96e3, window="hann"), (1.0, 1.0, 1.2)),
    receiver_at("ear", (3.5, 2.6, 1.2)),
    room={
        "kind": "plan",
        "outline": [(0, 0), (4, 0), (4, 3), (2, 3), (2, 1.9), (0, 1.9)],
        "height": 2.5,
        "materials": {"reflection": 0.8},
    },
    air={"absorption": False},
    paths={"diffraction": 1, "scattering_order": 1, "edge_scattering": True},
    rate=96e3,
    render={"duration": 0.22, "chunk": 18432},
)
THINGS = """
[[bodies]]
kind = "box"
name = "crate"
size = [0.8, 0.0, 0.9]
material = { reflection = 0.9 }
trajectory = { kind = "swing", axis_point = [1.3, 0.4, 1.1], axis = [0, 0, 1], angles = [0, 0.03, 0.06], times = [0, 0.15, 0.3] }
centre = [0.42, 0.0, 0.0]
[[scatterers]]
kind = "sphere"
name = "ball"
radius = 0.05
model = "geometrical"
trajectory = { kind = "line", start = [2.7, 1.2, 1.0], end = [2.9, 1.4, 1.2], duration = 0.3 }
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the scene file, read."""
    path = tmp_path_factory.mktemp("both") / "scene.toml"
    path.write_text(HEAD + THINGS, "utf-8")
    return clsim.load_scene(path)


@pytest.fixture(scope="module")
def paths(file: Any) -> PathSet:
    """Return its paths."""
    return clsim.find_paths(file.scene, **file.paths)


def level_db(part: Any, whole: Any) -> float:
    """Return the level of a signal relative to another, dB."""
    return float(20.0 * np.log10(np.linalg.norm(part) / np.linalg.norm(whole)))


def test_all_kinds_are_heard_together(paths: PathSet, device: None) -> None:
    """Over the edge, by the body, by the ball and by both: the sum of each alone, at default settings and in baseband."""
    assert all(len(family) for family in paths.families[1:])
    heard = clsim.render(paths, RATE, duration=0.08).pressure[0]
    parts = [
        clsim.render(PathSet(paths.scene, (family,)), RATE, duration=0.08).pressure[0] for family in paths.families
    ]
    assert level_db(np.sum(parts, axis=0) - heard, heard) < -85.0
    assert min(level_db(part, heard) for part in parts[1:]) > -60.0
    envelope = clsim.render(paths, RATE, duration=0.08, baseband=clsim.Baseband(7.5e3, 4e3, 8e3)).pressure[0]
    middle, step = slice(len(envelope) // 4, 3 * len(envelope) // 4), round(RATE / 8e3)
    carrier = np.exp(2j * np.pi * 7.5e3 * np.arange(len(envelope)) / 8e3)[middle]
    wanted = heard[::step][: len(envelope)][middle]
    assert level_db(np.real(envelope[middle] * carrier) - wanted, wanted) < -60.0


@pytest.mark.exhaustive
def test_a_tail_is_that_of_the_room_without_bodies(file: Any) -> None:
    """The tail is the same as without them, and what they hide of paths is hidden; the plan says so."""
    scene = file.scene
    bare = clsim.Scene(scene.room, scene.air, scene.sources, scene.receivers)
    options = {"duration": 0.22, "tail": "auto", "tail_error_db": 3.0, "engine": "reference", "responses": "centre"}
    tails = []
    for each in (scene, bare):
        found = clsim.find_paths(each, 0)
        only = PathSet(each, found.families[:1])
        with_tail, without = (clsim.render(only, RATE, **options | {"tail": tail}).pressure for tail in ("auto", "off"))
        tails.append(with_tail - without)
    assert np.linalg.norm(tails[0]) > 0.0
    np.testing.assert_allclose(tails[0], tails[1], atol=1e-6 * np.abs(tails[0]).max())
    plan = clsim.plan_render(clsim.find_paths(scene, 0), RATE, **options)
    assert any("tails are those of the room without its bodies ('crate')" in line for line in plan.describe())


def thing(kind: str, name: str, way: str, more: str = "") -> str:
    """Return a table of a body or a scatterer."""
    shape = {
        "bodies": 'kind = "box"\nsize = [0.3, 0.3, 0.3]\nmaterial = { reflection = 0.9 }',
        "scatterers": 'kind = "point"\ntarget_strength_db = -20.0',
    }[kind]
    return f'[[{kind}]]\nname = "{name}"\n{more or shape}\ntrajectory = {{ {way} }}\n'


def line(start: str, end: str, duration: float = 0.3) -> str:
    """Return a way."""
    return f'kind = "line", start = [{start}], end = [{end}], duration = {duration}'


FIXED = 'kind = "fixed", position = [3.0, 1.0, 1.2]'
PERSON = 'kind = "person"\nheight = 1.7'
CARRIED = '[[receivers]]\nname = "own"\nmounted_on = "cart"\ntrajectory = { kind = "fixed", position = [0.4, 0, 0] }\n'
REFUSED = {
    "bodies[0].trajectory: must keep it out of walls and other bodies, by 0.001 m or less, but 'b' goes through the wall":
        thing("bodies", "b", line("3, 1, 1.2", "4.5, 1, 1.2")),
    "'sonar' is in 'ball' or nearer to it at (1, 1, 1.2) m at 0 s":
        thing("scatterers", "ball", 'kind = "fixed", position = [1.1, 1, 1.2]', 'kind = "sphere"\nradius = 0.3'),
    "scatterers[0].trajectory: must walk at 0.0901 to 2.7 m/s, but is at 667 m/s at 0 s":
        thing("scatterers", "Ada", line("1, 1.5, 0", "3, 1.5, 0", 0.003), PERSON),
    "bodies[0].trajectory.axis: must be a direction, but is 0, 0, 0":
        thing("bodies", "b", 'kind = "swing", axis_point = [3, 1, 1], axis = [0, 0, 0], angles = [0, 1], times = [0, 1]'),
    "bodies[0].size[0]: must be finite, but is nan":
        thing("bodies", "b", FIXED, 'kind = "box"\nsize = [nan, 1, 1]\nmaterial = { reflection = 0.9 }'),
    "bodies[0].trajectory.start[1]: must be finite, but is nan": thing("bodies", "b", line("3, nan, 1", "3, 1, 1")),
    "bodies[0].triangles: must hold at least one, but is empty":
        thing("bodies", "b", FIXED, 'kind = "faces"\nvertices = []\ntriangles = []\nmaterial = { reflection = 0.9 }'),
    "bodies[0].trajectory: must keep off sources, receivers and scatterers, but 'p' is in 'b' or meets a face of it at 0 s":
        thing("bodies", "b", FIXED) + thing("scatterers", "p", FIXED),
    "but 'p' is in 'b' or meets a face of it at 0.104 s": thing("bodies", "b", FIXED)
        + thing("scatterers", "p", line("2.5, 1, 1.2", "3.5, 1, 1.2")),
    "'c' goes through 'b' at 0.10": thing("bodies", "b", line("3, 0.5, 1.2", "3, 1.5, 1.2"))
        + thing("bodies", "c", line("3, 1.5, 1.2", "3, 0.5, 1.2")),
    "'own' is in 'b' or meets a face of it at 0.28": CARRIED + thing("bodies", "cart", line("2, 1, 1.2", "2.48, 1, 1.2"))
        + thing("bodies", "b", FIXED),
    "must last as long as all signals, which end at 0.2 s, but ends at 0.1 s":
        thing("bodies", "b", line("3, 1, 1", "3, 1.1, 1", 0.1)),
    "render.duration: must end while all that moves is known, 0.21 s (the trajectory of 'b'), but is 0.22 s":
        thing("bodies", "b", line("3, 1, 1", "3, 1.1, 1", 0.21)),
    "bodies[1].name: must be unique, but [0] is 'b' too": thing("bodies", "b", FIXED) + thing("bodies", "b", FIXED),
    "bodies[0].name: must be a text that is not empty": thing("bodies", "", FIXED),
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_is_refused_in_a_line(message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the field, the name and the time; status 2. What `find_paths` warns of may stand before it."""
    head = HEAD.replace("diffraction = 1", "diffraction = 0")
    (tmp_path / "scene.toml").write_text(head + REFUSED[message], "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("clsim: warning: edges")]
    assert len(said) == 1
    assert message in said[0]
