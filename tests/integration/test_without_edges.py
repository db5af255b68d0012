"""Reports where reflections alone are wrong: edges near Fresnel zones, and paths that begin and end at edges."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main

SCENE = scene_text(
    source_at("beacon", tone_of(40e3, 0.02, fade=0.005), (0.4, 1.3, 1.5)),
    receiver_at("robot", along((-1.9, 0.3, 1.2), (1.7, -0.8, 1.4), 2.0)),
    room={
        "kind": "plan",
        "outline": [(3, 0), (1.5, 2.6), (-1.5, 2.6), (-3, 0), (-1.5, -2.6), (1.5, -2.6)],
        "height": 3.0,
        "materials": {"default": {"reflection": 0.9}},
    },
    max_order=2,
    paths={"diffraction": 0},
    render={"duration": 0.03},
)


HERE, THERE = np.array([4.0, 5.0, 2.0]), np.array([6.0, 5.0, 2.0])
WAVE = 2.0 * np.pi * 40e3 / 343.0


def plate(side: float, beside: float, tilt: float) -> clsim.Scene:
    """Return a square plate 2 m above the middle of a source and a receiver, moved along x and turned about y."""
    hard = clsim.Material.from_reflection(1.0)
    half, turn = 0.5 * side, np.radians(0.5 * tilt)
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    pose = clsim.Trajectory.fixed((5.0 + beside, 5.0, 4.0), (0.0, np.sin(turn), 0.0, np.cos(turn)))
    body = clsim.Body("plate", clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], hard), pose)
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    room = clsim.Shoebox((10.0, 10.0, 8.0), clsim.Material.from_reflection(1e-6))
    return clsim.Scene(
        room, clsim.Air(absorption=False, speed_of_sound=343.0),
        [clsim.Source("s", tone, clsim.Trajectory.fixed(HERE))], [clsim.Receiver("r", clsim.Trajectory.fixed(THERE))],
        bodies=[body],
    )  # fmt: skip


def missing_db(side: float, beside: float, tilt: float) -> float:
    """Level re the direct sound of what geometry leaves out: Kirchhoff's integral over the plate less the mirror path."""
    count = int(side / 1.6e-3)  # a fifth of a wavelength apart
    u = (np.arange(count) + 0.5) / count * side - 0.5 * side
    along, normal = (np.array(x) for x in _axes(np.radians(tilt)))
    middle = np.array([5.0 + beside, 5.0, 4.0])
    points = middle + u[:, None, None] * along + u[None, :, None] * np.array([0.0, 1.0, 0.0])
    first, second = points - HERE, points - THERE
    d, e = np.linalg.norm(first, axis=-1), np.linalg.norm(second, axis=-1)
    cosines = 0.5 * np.abs(first @ normal / d + second @ normal / e)
    field = 1j * WAVE / (2.0 * np.pi) * np.sum(cosines * np.exp(-1j * WAVE * (d + e)) / (d * e)) * (side / count) ** 2
    image = HERE - 2.0 * ((HERE - middle) @ normal) * normal
    share = ((middle - image) @ normal) / ((THERE - image) @ normal)
    hit = image + share * (THERE - image) - middle
    if max(abs(hit @ along), abs(hit[1])) < 0.5 * side:
        far = float(np.linalg.norm(THERE - image))
        field -= np.exp(-1j * WAVE * far) / far
    return float(20.0 * np.log10(abs(field) * 2.0))


def _axes(angle: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return (np.cos(angle), 0.0, -np.sin(angle)), (np.sin(angle), 0.0, np.cos(angle))


@pytest.mark.parametrize(
    ("side", "beside", "tilt"),
    [(0.05, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0), (0.1, 0.0, 10.0), (0.2, 0.0, 5.0), (2.0, 0.95, 0.0), (2.0, 1.05, 0.0)],
)  # fmt: skip
def test_the_field_of_edges_is_warned_of_with_its_level(side: float, beside: float, tilt: float) -> None:
    """Small plates, tilted ones by which no path goes, and a mirror point 5 cm inside and outside of a large one.

    Kirchhoff's integral and edges differ by the edge's own share, some 1 dB here; the message has whole dB.
    """
    with pytest.warns(clsim.ClsimWarning, match=r"Fresnel zones.*diffraction=1") as caught:
        clsim.find_paths(plate(side, beside, tilt), 1)
    (text,) = (str(warning.message) for warning in caught)
    assert float(text.split(" dB")[0].split()[-1]) == pytest.approx(missing_db(side, beside, tilt), abs=2.0)


@pytest.mark.parametrize(("side", "beside", "diffraction"), [(0.1, 0.0, 1), (2.0, 0.0, 0), (2.0, 1.5, 0)])
def test_others_are_not(side: float, beside: float, diffraction: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clsim.find_paths(plate(side, beside, 0.0), 1, diffraction=diffraction)


def test_small_faces_that_images_make_whole_are_not() -> None:
    """A shaft 10 cm wide, as a mesh: its walls are narrower than Fresnel zones, and images are the whole field."""
    room = clsim.Shoebox((6.0, 0.1, 3.0), clsim.Material.from_reflection(0.9)).as_mesh()
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    near, far = (clsim.Trajectory.fixed((x, 0.05, 1.5)) for x in (4.0, 2.0))
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, near)], [clsim.Receiver("r", far)])
    assert len(clsim.find_paths(scene, 2)) > 5


def test_check_reports_jumps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A lossy double reflection of 0.9² that ends at an edge is as loud as the direct sound over its length, at most."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    assert main(["check", str(path)]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if "jumps" in line]
    assert len(said) == 1
    assert "diffraction = 1" in said[0]
    assert -20.0 < float(said[0].split(" dB")[0].split()[-1]) < -3.0
    path.write_text(SCENE.replace("diffraction = 0", "diffraction = 1"), "utf-8")
    assert main(["check", str(path)]) == 0
    assert "jumps" not in capsys.readouterr().out


NINE = """
format = 1
air = {{ absorption = false }}
[room]
kind = "shoebox"
size = [10, 10, 8]
walls = {{ default = {{ reflection = 0.001 }} }}
[[sources]]
name = "beacon"
signal = {{ kind = "tone", frequency = 40e3, duration = 0.02, sampling_rate = 192e3, fade = 0.005 }}
trajectory = {{ kind = "fixed", position = [4, 5, 2] }}
[[receivers]]
name = "robot"
trajectory = {{ kind = "fixed", position = [6, 5, 2] }}
[paths]
max_order = 1
[render]
sampling_rate = 192e3
duration = 0.03
{plates}
"""
PLATE = """
[[bodies]]
name = "plate {x}"
kind = "box"
size = [0.1, 0.1, 0.0]
material = {{ reflection = 1.0 }}
trajectory = {{ kind = "fixed", position = [{x}, {y}, 4], orientation = [0.0, {sine}, 0.0, {cosine}] }}
"""


@pytest.mark.parametrize("tilt", [0.0, 10.0])
def test_check_reports_one_of_many_small_plates(tilt: float, tmp_path, capsys) -> None:
    """Nine plates of 10 cm have too many edges to search all; one stands between the ends, the others 4 m aside.

    Tilted by 10 degrees none has a path, so that the field of edges is all that it sends.
    """
    sine, cosine = np.sin(np.radians(0.5 * tilt)), np.cos(np.radians(0.5 * tilt))
    plates = "".join(PLATE.format(x=x, y=5 if x == 5 else 9, sine=sine, cosine=cosine) for x in range(1, 10))
    path = tmp_path / "scene.toml"
    path.write_text(NINE.format(plates=plates), "utf-8")
    assert main(["check", str(path)]) == 0
    (line,) = (text for text in capsys.readouterr().err.splitlines() if "Fresnel zone" in text)
    assert "diffraction = 1" in line
    assert float(line.split(" dB")[0].split()[-1]) == pytest.approx(missing_db(0.1, 0.0, tilt), abs=2.0)
