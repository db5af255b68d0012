"""The path family of the example package of plugins: one straight edge, on the host, beside images on the device.

A plugin's file is all that a search, both engines, tables, pages, responses and resumed runs need.
"""

import ast
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import clsim_barn.ridge
import numpy as np
import pytest
from clsim_barn.ridge import GAIN
from scene_texts import along, receiver_at, scene_text, shoebox_of, source_at, tone_of
from scipy.optimize import minimize_scalar

import clsim
from clsim.paths import find_paths
from clsim.paths.chain import Chain
from clsim.paths.legs.legs import StaticLeg
from clsim.paths.path_set import PathSet
from clsim.plugins import _plugins

SEAMS = {"arrivals", "family", "options", "propagation", "response"}  # of clsim.paths
RATE = 192e3
CHUNK = 18432


def test_the_file_needs_nothing_but_seams() -> None:
    tree = ast.parse(Path(clsim_barn.ridge.__file__).read_text("utf-8"))
    found = {node.module for node in tree.body if isinstance(node, ast.ImportFrom) and node.module.startswith("clsim.")}
    assert found <= {"clsim.arrays", *(f"clsim.paths.{name}" for name in SEAMS)}


SCENE = scene_text(
    source_at("robot", tone_of(10e3, 0.5, fade=0.01), along((2.0, 2.5, 1.0), (3.0, 2.0, 1.2), 0.5)),
    receiver_at("wall", (6.0, 4.0, 1.5)),
    receiver_at("cart", along((6.0, 1.0, 1.0), (6.0, 2.5, 1.0), 0.5)),
    room=shoebox_of(8.0, 6.0, 3.0, reflection=0.8),
    air={"absorption": False},
    render={"duration": 0.45, "chunk": 18432},
)


def scene_of() -> clsim.Scene:
    signal_ = clsim.Signal.tone(10e3, 0.5, RATE, fade=0.01)
    source = clsim.Source("robot", signal_, clsim.Trajectory.line((2.0, 2.5, 1.0), (3.0, 2.0, 1.2), 0.5))
    receivers = [
        clsim.Receiver("wall", clsim.Trajectory.fixed((6.0, 4.0, 1.5))),
        clsim.Receiver("cart", clsim.Trajectory.line((6.0, 1.0, 1.0), (6.0, 2.5, 1.0), 0.5)),
    ]
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.8))
    return clsim.Scene(room, clsim.Air(absorption=False), [source], receivers)


@pytest.fixture(scope="module")
def registered(installed_plugins: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(installed_plugins)
        _plugins.cache_clear()
        yield
    _plugins.cache_clear()


@pytest.fixture(scope="module")
def paths(registered: None) -> PathSet:
    return clsim.find_paths(scene_of(), 1)


def test_columns_join_those_of_the_images(paths: PathSet) -> None:
    images, wedge = paths.families
    assert len(paths) == len(images) + len(wedge) == 14 + 2
    assert paths.interactions[-2:].tolist() == [[1], [1]]
    assert paths.walls[-2:].tolist() == [[-1], [-1]]
    assert paths.objects[-2:].tolist() == [[6], [6]]
    assert paths.object_names == (*paths.scene.room.faces.names, "ridge")
    mine = paths.at_receiver(1)
    assert (len(mine), mine.receiver.tolist()) == (8, [1] * 8)


def test_delays_are_those_of_the_shortest_way(paths: PathSet) -> None:
    """The way from where the sound was emitted to where it is received, by brute force; and its derivative."""
    wedge, times = paths.families[1], np.linspace(0.05, 0.45, 7)
    source, c = paths.scene.sources[0].trajectory, paths.scene.air.speed_of_sound
    for row, receiver in enumerate(paths.scene.receivers):
        found = wedge.arrivals(np.array([row]), times)
        for t, delay in zip(times, found.delay[0], strict=True):
            ends = source.position(t - delay), receiver.trajectory.position(t)
            way = minimize_scalar(
                lambda s, ends=ends: sum(np.linalg.norm(wedge.point + s * wedge.along - x) for x in ends),
                bracket=(-2.0, 2.0), options={"xtol": 1e-12},
            )  # fmt: skip
            assert delay == pytest.approx(way.fun / c, abs=1e-14)
        step = 1e-5
        before, after = (wedge.arrivals(np.array([row]), times + h).delay for h in (-step, step))
        np.testing.assert_allclose(found.delay_rate, (after - before) / (2.0 * step), atol=1e-9)


def test_tables_pictures_and_files_know_it(paths: PathSet, tmp_path: Path) -> None:
    from made_results import read_table

    from clsim.output.result_files import write_table
    from clsim.paths.path_table import view_scene, viewed

    table = paths.table(np.array([0.2, 0.3]))
    assert table.name_objects(15) == "ridge"
    np.testing.assert_allclose(table.gain[14:], GAIN / (343.0 * table.delay[14:]), rtol=0.02)
    np.testing.assert_allclose(table.doppler_shift, (table.doppler_factor - 1.0) * 10e3, rtol=1e-3)
    write_table(table, tmp_path / "paths.npz")
    again = read_table(tmp_path / "paths.npz")
    assert again.name_objects(15) == "ridge"
    np.testing.assert_array_equal(again.interactions, table.interactions)
    vertices = paths.vertices(0.2)
    on_edge = (vertices[14:, 1] - paths.families[1].point) @ paths.families[1].along
    np.testing.assert_allclose(
        vertices[14:, 1], paths.families[1].point + on_edge[:, None] * paths.families[1].along, atol=1e-12
    )
    frame = viewed(paths, duration=0.4, frames=2)["frames"][0]
    assert sum("ridge" in label for label in frame.labels) == 2
    view_scene(paths, tmp_path / "view.html", duration=0.4, frames=2)
    assert "ridge" in (tmp_path / "view.html").read_text("utf-8")


def error_db(got: np.ndarray, wanted: np.ndarray) -> float:
    return 20.0 * np.log10(max(np.linalg.norm(got - wanted), 1e-30) / np.linalg.norm(wanted))


def test_both_engines_render_it_by_itself(paths: PathSet, engine: str) -> None:
    """What is heard is gain times the tone at the time of emission."""
    alone = PathSet(paths.scene, paths.families[1:])
    heard = clsim.render(alone, RATE, engine=engine, duration=0.2).pressure
    n = np.arange(round(0.05 * RATE), round(0.19 * RATE), 97)
    for receiver in range(2):
        found = alone.families[0].arrivals(np.array([receiver]), n / RATE)
        gain = GAIN * (found.mach_factor / found.length)[0]
        wanted = gain * np.sin(2.0 * np.pi * 10e3 * found.emission_time[0])
        assert error_db(heard[receiver, n], wanted) < -80.0


def test_images_on_the_device_and_edges_on_the_host_add_up(paths: PathSet, device: None) -> None:
    from clsim.render.opencl.engine import OpenclEngine
    from clsim.render.opencl.host_nodes import HostNodeMaker
    from clsim.render.opencl.nodes import NodeMaker

    plan = clsim.plan_render(paths, RATE, duration=0.1)
    engine = OpenclEngine(plan)
    makers = {pair.family.identity: type(engine.maker(i)) for i, pair in enumerate(plan.tracks.pair_paths)}
    kinds = {name.rpartition(".")[2]: maker for name, maker in makers.items()}
    assert kinds["RidgePaths"] is HostNodeMaker
    assert kinds["SpecularPaths"] in (NodeMaker, HostNodeMaker)  # by whether the device has float64
    both = clsim.render(paths, RATE, duration=0.1).pressure
    parts = [clsim.render(PathSet(paths.scene, (f,)), RATE, duration=0.1).pressure for f in paths.families]
    assert error_db(parts[0] + parts[1], both) < -85.0
    assert error_db(parts[0], both) > -20.0
    exact = clsim.render(paths, RATE, duration=0.1, engine="reference").pressure
    assert error_db(both, exact) < -80.0


def test_pruning_and_responses_know_it(paths: PathSet) -> None:

    weak = PathSet(paths.scene, (paths.families[0], replace(paths.families[1], gain=1e-6)))
    plan = clsim.plan_render(weak, RATE, duration=0.1, prune_below_db=-60.0)
    assert sum(len(group) for group in plan.tracks.pairs) == len(paths.families[0])  # weak beside other kinds
    found = clsim.impulse_responses(paths, 96e3, at=0.1, tail="off")
    alone = [clsim.impulse_responses(PathSet(paths.scene, (f,)), 96e3, at=0.1, tail="off") for f in paths.families]
    got = found.samples[0, 1]
    total = np.zeros_like(got)
    for part in alone:
        first = found.lead - part.lead
        total[first : first + part.samples.shape[2]] += part.samples[0, 1]
    assert error_db(got, total) < -100.0


def test_any_change_of_any_column_changes_the_digest(paths: PathSet) -> None:
    for family in paths.families:
        known = family.digest()
        assert family.digest() == known
        legs = [(f"legs.{field.name}", field) for field in fields(StaticLeg)] if isinstance(family, Chain) else []
        for name, field in [*((field.name, field) for field in fields(family)), *legs]:
            of_leg = name.startswith("legs.")
            value = getattr(family.legs[0] if of_leg else family, field.name)
            if name in ("scene", "legs") or value is None:
                continue
            if isinstance(value, np.ndarray):
                changed = np.array(value)
                changed.flat[-1] = changed.flat[-1] - 1 if np.isfinite(changed.flat[-1]) else 7.0
            else:
                changed = value * 2
            if of_leg:
                other = replace(family, legs=(replace(family.legs[0], **{field.name: changed}),))
            else:
                other = replace(family, **{field.name: changed})
            assert other.digest() != known, name
            both = [other if f is family else f for f in paths.families]
            assert PathSet(paths.scene, tuple(both)).digest() != paths.digest()


RUN = """
import os, signal, sys
from clsim.cli import main
from clsim.workflow import checkpoint
from clsim.workflow.result_folder import Journal
checkpoint._PERIOD = 0.0
save, left = Journal.save, [3]
def killing(self, *arguments):
    save(self, *arguments)
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
Journal.save = killing
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.exhaustive
def test_a_killed_run_goes_on_with_it_and_not_without(
    tmp_path: Path, registered: None, installed_plugins: Path, device: None, capsys, monkeypatch
) -> None:
    from clsim.cli import main

    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")

    def command(out: str) -> list[str]:
        return ["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / out), "--no-plots", "--resume"]

    process = [sys.executable, "-c", RUN, *command("out")]
    path = os.pathsep.join([str(installed_plugins), *sys.path])
    killed = subprocess.run(process, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": path})
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    with monkeypatch.context() as patch:
        patch.setattr(find_paths, "PATH_FAMILIES", "clsim.nothing")
        assert main(command("out")) == 2
    assert "paths was" in capsys.readouterr().err  # of other paths
    assert main(command("whole")) == 0
    assert main(command("out")) == 0
    for name in ("wall.wav", "cart.wav"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
