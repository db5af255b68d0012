"""Paths over edges from the command line to the files: what every command makes of `[paths] diffraction = 1`."""

from pathlib import Path

import numpy as np
import pytest
from failing import stopped_and_resumed
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import viewed
from clsim.paths.response import SceneResponse

SCENE = scene_text(
    source_at("beacon", tone_of(40e3, 0.06, fade=0.005), (6.0, 2.0, 1.2)),
    receiver_at("robot", along((2.95, 6.9, 1.0), (3.1, 7.0, 1.0), 0.1)),
    receiver_at("shelf", (3.3, 7.5, 1.5)),
    room={
        "kind": "plan",
        "outline": [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)],
        "height": 3.0,
        "materials": {"default": {"reflection": 0.8}},
    },
    air={"absorption": False},
    paths={"diffraction": 1},
    render={"duration": 0.09},
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("edges") / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


@pytest.fixture(scope="module")
def paths(scene: Path) -> PathSet:
    file = clsim.load_scene(scene)
    assert file.paths["diffraction"] == 1
    return clsim.find_paths(file.scene, **file.paths)


def error_db(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted) + 1e-300))


def test_check_and_paths_name_edges(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(scene)]) == 0
    said = capsys.readouterr().out
    assert "edges: 1 that diffract, 3 m together" in said
    assert "270 degrees of air" in said
    assert main(["paths", str(scene), "--at", "0.05"]) == 0
    assert "edge wall" in capsys.readouterr().out


def test_check_names_thin_panels(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Walls of two faces, where paths go over one edge: no sound behind, unless they are sheets or paths go over two edges."""
    panel = """
[[room.obstacles]]
kind = "plan"
outline = [[2, 3], [3, 3], [3, 3.004], [2, 3.004]]
height = 1.0
materials = { default = { reflection = 0.8 } }
"""
    path, text = tmp_path / "scene.toml", scene.read_text("utf-8").replace("[air]", panel + "[air]")
    note = "of 4 mm: silent behind, as its edges are two (diffraction = 2), and thinner than two wavelengths, 17.2 mm"
    for edges, noted in ((1, True), (2, False)):
        path.write_text(text.replace("diffraction = 1", f"diffraction = {edges}"), "utf-8")
        assert main(["check", str(path)]) == 0
        assert (note in capsys.readouterr().out) == noted


def test_the_page_draws_edges(paths: PathSet) -> None:
    view = viewed(paths, duration=0.09, frames=2)
    assert view["edges"].shape == (1, 2, 3)
    assert any("edge wall" in label for label in view["frames"][0].labels)
    assert viewed(PathSet(paths.scene, paths.families[:1]), duration=0.09, frames=2)["edges"].shape == (0, 2, 3)


def test_the_truth_is_out_of_sight(paths: PathSet) -> None:
    """The direct sound is not heard behind the corner, and the first arrival is that over the edge."""
    from clsim.paths.ground_truth import direct_path

    truth, table = direct_path(paths, np.array([0.05])), paths.table(np.array([0.05]))
    assert not truth.line_of_sight.any()
    for receiver in (0, 1):
        heard = np.flatnonzero((table.receiver == receiver) & table.audible[:, 0])
        first = heard[np.argmin(table.delay[heard, 0])]
        assert table.name_objects(first).startswith("edge wall")
        assert table.delay[first, 0] > truth.delay[0, receiver, 0]


def test_engines_and_pairs_at_rest_agree(paths: PathSet, device: None) -> None:
    both = clsim.render(paths, 192e3, duration=0.08).pressure
    exact = clsim.render(paths, 192e3, duration=0.08, engine="reference").pressure
    assert error_db(both[0], exact[0]) < -80.0  # the robot: path by path
    assert error_db(both[1], exact[1]) < -80.0  # the shelf: one convolution
    alone = clsim.render(PathSet(paths.scene, paths.families[:1]), 192e3, duration=0.08).pressure
    assert error_db(alone, both) > -20.0


def test_bounds_of_gains_hold(paths: PathSet) -> None:
    times, frequencies = np.linspace(0.01, 0.09, 5), np.array([30e3, 40e3])
    at = SceneResponse(paths.scene, 0, frequencies)
    for pair in paths.families[1].pairs():
        found = pair.arrivals(times)
        level = np.abs(pair.response(found, times, at)) * found.length[..., None]
        assert np.all(level <= pair.family.gain_bound(pair.rows, at)[:, None])


def test_pruned_baseband_and_impulse_responses_know_them(paths: PathSet, device: None) -> None:
    """The shelf sees nothing of the beacon: each way of rendering hears it round the edge, and all agree."""
    wanted = clsim.render(paths, 192e3, duration=0.08).pressure[1].astype(np.float64)
    pruned = clsim.render(paths, 192e3, duration=0.08, prune_below_db=-60.0).pressure[1]
    assert error_db(pruned, wanted) < -50.0
    envelope = clsim.render(paths, 192e3, duration=0.08, baseband=(40e3, 4e3)).pressure[1]
    middle = slice(round(0.05 * 192e3), round(0.06 * 192e3))
    level = np.sqrt(2.0 * np.mean(wanted[middle] ** 2))
    held = np.abs(envelope[round(0.05 * len(envelope) / 0.08) : round(0.06 * len(envelope) / 0.08)])
    np.testing.assert_allclose(held, level, rtol=1e-3)
    table = paths.table(np.array([0.05]), motion="quasi-static")
    heard = np.flatnonzero((table.receiver == 1) & table.audible[:, 0])
    response = clsim.impulse_responses(paths, 192e3, at=0.05, band=(30e3, 50e3))
    first = table.delay[heard, 0].min()
    assert response.first_arrivals[0, 1] == pytest.approx(first, abs=1e-9)
    sound, sample = np.abs(response.samples[0, 1]), round(first * 192e3)
    assert sound[sample - 20 : sample + 20].max() > 10.0 * sound[: sample - 200].max()


def test_runs_that_were_stopped_go_on(scene: Path, tmp_path, monkeypatch, device) -> None:
    """Bit for bit, with the exact field at the edge; not with that of the theory, whose paths are others."""
    text, path = (
        scene.read_text("utf-8").replace("duration = 0.09", "duration = 0.12\nchunk = 18432"),
        tmp_path / "scene.toml",
    )
    text = text.replace("duration = 0.1 }", "duration = 0.2 }").replace("duration = 0.06,", "duration = 0.11,")
    path.write_text(text.replace("diffraction = 1", 'diffraction = 1\ndiffraction_model = "btm"'), "utf-8")
    other = tmp_path / "other.toml"
    other.write_text(text, "utf-8")
    out = stopped_and_resumed(monkeypatch, path, tmp_path, other=other)
    assert 'diffraction_model = "btm"' in (out / "scene.completed.toml").read_text("utf-8")
    with np.load(out / "ground_truth.npz") as found:
        assert not found["line_of_sight"].any()


def test_responses_are_written_by_the_command(scene: Path, tmp_path: Path) -> None:
    file = tmp_path / "responses.npz"
    assert main(["rir", str(scene), "-o", str(file), "--at", "0.05", "--band", "30000", "50000"]) == 0
    with np.load(file) as found:
        assert np.abs(found["samples"][0, 1]).max() > 1e-4, "all of it is from round the edge"
