"""A kind of paths that is told in one file: one straight edge, on the host, beside the images of a room on the device.

The law is a toy (delays by the shortest way over the edge, spreading times a constant); what is tested is that such a
file and its registration are all that a search, both engines, tables, pages, responses and resumed runs need.
"""

import ast
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import clsim
from clsim.arrays import Floats
from clsim.paths.arrivals import Arrivals
from clsim.paths.family import DIFFRACTION, PathFamily, Rows
from clsim.paths.find_paths import FAMILY_FINDERS, registered_family
from clsim.paths.path_set import PathSet
from clsim.paths.propagation import arrivals_by, straight
from clsim.paths.response import SceneResponse
from clsim.paths.search import PathSearch

SEAMS = {"arrivals", "family", "find_paths", "path_set", "propagation", "response", "search"}  # of clsim.paths
GAIN = 0.3
RATE = 192e3
CHUNK = 18432


# --- the kind of paths, and how it is found ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class WedgePaths(PathFamily):
    """Paths over one straight edge through a point (3,), along a unit vector (3,)."""

    point: Floats
    along: Floats
    gain: float

    object_names: ClassVar[tuple[str, ...]] = ("ridge",)

    def apex(self, source: Floats, receiver: Floats) -> Floats:
        """Return where the shortest ways between places (..., 3) meet the edge."""
        (z_s, r_s), (z_r, r_r) = (self._cylindrical(x) for x in (source, receiver))
        return self.point + ((z_s * r_r + z_r * r_s) / (r_s + r_r))[..., None] * self.along

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        source, receiver = (end.trajectory for end in self.ends(rows))
        times = np.asarray(times, dtype=np.float64)
        count = len(self.source[rows])
        return arrivals_by(
            lambda heard_at: WaysOver(self, count, heard_at),
            self.medium(0),
            (source, receiver),
            times,
            motion,
            amplitude,
        )

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Any:
        response = self.gain * at.air(found) * (found.mach_factor / found.length)[..., None]
        at.apply_directivities(response, self.ends(rows), found, times)
        return response

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        source, receiver = (end.trajectory for end in self.ends(rows))
        found = self.arrivals(rows, np.array([time]), motion)
        emitted_at = source.position(found.emission_time[:, 0])
        heard_at = np.broadcast_to(receiver.position(np.array([time])), emitted_at.shape)
        return np.stack([emitted_at, self.apex(emitted_at, heard_at), heard_at], axis=1)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        apex = self.apex(source, receiver)
        return straight(source, apex)[0] + straight(apex, receiver)[0]

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        return np.full((len(self.source[rows]), len(at.frequencies)), self.gain)

    def _cylindrical(self, place: Floats) -> tuple[Floats, Floats]:
        z = (place - self.point) @ self.along
        return z, np.linalg.norm(place - self.point - z[..., None] * self.along, axis=-1)


@dataclass(frozen=True, slots=True)
class WaysOver:
    """Ways over the edge to a receiver at places (T, 3), the same for all paths."""

    paths: WedgePaths
    count: int
    heard_at: Floats

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        heard_at = np.broadcast_to(self.heard_at, (self.count, *self.heard_at.shape))[p, t]
        start = np.broadcast_to(start, heard_at.shape)
        apex = self.paths.apex(start, heard_at)
        (first, direction), (second, _) = straight(start, apex), straight(apex, heard_at)
        return first + second, direction

    def arrive(self, start: Floats) -> Floats:
        heard_at = np.broadcast_to(self.heard_at, start.shape)
        return straight(self.paths.apex(start, heard_at), heard_at)[1]

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        raise NotImplementedError  # the air is the same everywhere

    def seen(self) -> Floats:
        raise NotImplementedError  # and still


def find_wedge(scene: clsim.Scene, search: PathSearch) -> WedgePaths:
    """Return one path over the edge for every source and receiver."""
    source, receiver = np.divmod(np.arange(len(scene.sources) * len(scene.receivers)), len(scene.receivers))
    count = len(source)
    return WedgePaths(
        scene=scene,
        source=source.astype(np.int32),
        receiver=receiver.astype(np.int32),
        order=np.ones(count, dtype=np.int32),
        start=np.full(count, -np.inf),
        end=np.full(count, np.inf),
        interactions=np.full((count, 1), DIFFRACTION, dtype=np.int8),
        objects=np.zeros((count, 1), dtype=np.int8),
        point=np.array([4.0, 3.0, 2.0]),
        along=np.array([0.6, 0.8, 0.0]),
        gain=GAIN,
    )


# --- what it needs ----------------------------------------------------------------------------------------------------


def test_the_file_needs_nothing_but_seams() -> None:
    tree = ast.parse(Path(__file__).read_text("utf-8"))
    found = {node.module for node in tree.body if isinstance(node, ast.ImportFrom) and node.module.startswith("clsim.")}
    assert found <= {"clsim.arrays", *(f"clsim.paths.{name}" for name in SEAMS)}


# --- what it then has -------------------------------------------------------------------------------------------------

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = { reflection = 0.8 }
[air]
absorption = false
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 10e3, duration = 0.5, sampling_rate = 192e3, fade = 0.01 }
trajectory = { kind = "line", start = [2.0, 2.5, 1.0], end = [3.0, 2.0, 1.2], duration = 0.5 }
[[receivers]]
name = "wall"
trajectory = { kind = "fixed", position = [6.0, 4.0, 1.5] }
[[receivers]]
name = "cart"
trajectory = { kind = "line", start = [6.0, 1.0, 1.0], end = [6.0, 2.5, 1.0], duration = 0.5 }
[paths]
max_order = 1
[render]
sampling_rate = 192e3
duration = 0.45
chunk = 18432
"""


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
def registered() -> Iterator[None]:
    with registered_family("wedge", find_wedge):
        yield


@pytest.fixture(scope="module")
def paths(registered: None) -> PathSet:
    return clsim.find_paths(scene_of(), 1)


def test_nothing_stays_registered() -> None:
    with registered_family("another wedge", find_wedge):
        assert len(clsim.find_paths(scene_of(), 0).families) >= 2
    with registered_family("specular", find_wedge):
        assert isinstance(clsim.find_paths(scene_of(), 0).families[0], WedgePaths)
    assert "another wedge" not in str([type(f) for f in clsim.find_paths(scene_of(), 0).families])
    assert not isinstance(clsim.find_paths(scene_of(), 0).families[0], WedgePaths)


def test_columns_join_those_of_the_images(paths: PathSet) -> None:
    images, wedge = paths.families
    assert len(paths) == len(images) + len(wedge) == 14 + 2
    assert paths.interactions[-2:].tolist() == [[1], [1]]
    assert paths.walls[-2:].tolist() == [[-1], [-1]]
    assert paths.objects[-2:].tolist() == [[6], [6]]
    assert paths.object_names == (*paths.scene.room.faces.names, "ridge")
    mine = paths.heard_by(1)
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
    from clsim.output.table import read_table, write_table
    from clsim.paths.view import view_scene, viewed

    table = paths.table(np.array([0.2, 0.3]))
    assert table.name_way(15) == "ridge"
    np.testing.assert_allclose(table.gain[14:], GAIN / (343.0 * table.delay[14:]), rtol=0.02)
    np.testing.assert_allclose(table.doppler_shift, (table.doppler_factor - 1.0) * 10e3, rtol=1e-3)
    write_table(table, tmp_path / "paths.npz")
    again = read_table(tmp_path / "paths.npz")
    assert again.name_way(15) == "ridge"
    np.testing.assert_array_equal(again.interactions, table.interactions)
    vertices = paths.vertices(0.2)
    on_edge = (vertices[14:, 1] - paths.families[1].point) @ paths.families[1].along
    np.testing.assert_allclose(
        vertices[14:, 1], paths.families[1].point + on_edge[:, None] * paths.families[1].along, atol=1e-12
    )
    frame = viewed(paths, duration=0.4, frames=2).frames[0]
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
    from clsim.render.opencl.device_nodes import DeviceTracks
    from clsim.render.opencl.engine import OpenclEngine
    from clsim.render.opencl.host_nodes import HostTracks

    plan = clsim.plan_render(paths, RATE, duration=0.1)
    engine = OpenclEngine(plan)
    kinds = {type(pair.family).__name__: type(engine.maker(i)) for i, pair in enumerate(plan.tracks.pair_paths)}
    assert kinds["WedgePaths"] is HostTracks
    assert kinds["SpecularPaths"] in (DeviceTracks, HostTracks)  # by whether the device has float64
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
    found = clsim.impulse_responses(paths, 96e3, at=0.1)
    alone = [clsim.impulse_responses(PathSet(paths.scene, (f,)), 96e3, at=0.1) for f in paths.families]
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
        for field in fields(family):
            if field.name == "scene" or not field.init:
                continue
            value = getattr(family, field.name)
            if isinstance(value, np.ndarray):
                changed = np.array(value)
                changed.flat[-1] = changed.flat[-1] - 1 if np.isfinite(changed.flat[-1]) else 7.0
            else:
                changed = value * 2
            other = replace(family, **{field.name: changed})
            assert other.digest() != known, field.name
            both = [other if f is family else f for f in paths.families]
            assert PathSet(paths.scene, tuple(both)).digest() != paths.digest()


RUN = """
import importlib.util, os, signal, sys
name, path, *arguments = sys.argv[1:]  # classes of paths are known by their modules' names
spec = importlib.util.spec_from_file_location(name, path)
wedge = importlib.util.module_from_spec(spec)
sys.modules[name] = wedge
spec.loader.exec_module(wedge)
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
with wedge.registered_family("wedge", wedge.find_wedge):
    sys.exit(main(arguments))
"""


@pytest.mark.exhaustive
def test_a_killed_run_goes_on_with_it_and_not_without(tmp_path: Path, device: None, capsys, monkeypatch) -> None:
    from clsim.cli import main

    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")

    def command(out: str) -> list[str]:
        return ["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / out), "--no-plots", "--resume"]

    process = [sys.executable, "-c", RUN, __name__, __file__, *command("out")]
    killed = subprocess.run(process, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    monkeypatch.delitem(FAMILY_FINDERS, "wedge", raising=False)  # other tests of this file have it registered
    assert main(command("out")) == 2
    assert "paths was" in capsys.readouterr().err  # of other paths
    with registered_family("wedge", find_wedge):
        assert main(command("whole")) == 0
        assert main(command("out")) == 0
    for name in ("wall.wav", "cart.wav"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
