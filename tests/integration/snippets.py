"""Runs the snippets of a page of the documentation, or a notebook, in a process of its own."""

import json
import multiprocessing
import os
import re
import shlex
import shutil
import tomllib
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim

ROOT = Path(clsim.__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# A comment, `<!-- not run: why -->`, stands before what needs files or machines that a test has not.
FENCE = re.compile(r"(?<!-->\n)^```(python|sh|toml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
# What most pages and notebooks load, all together some seconds.
LOADED = [
    "clsim.workflow.pipeline", "clsim.commands.scenes", "clsim.commands.run", "clsim.pictures.plots", "clsim.render.opencl.engine",
    "clsim.study.run", "clsim.score", "scipy.signal", "xarray", "zarr", "matplotlib.pyplot", "trimesh",
]  # fmt: skip
# What commands need that a test cannot give: a cluster, root's rights, another machine, the network.
ELSEWHERE = re.compile(
    r"^(make|pip|python -m (pip|pytest)|sudo|apt|dask|tail|ls|clinfo|export|git|cd)\b|--scheduler|docker|ssh"
)

ROOM = scene_text(
    source_at("talker", tone_of(1e3, 0.1, 16e3, fade=0.01), (1, 1, 1.2)),
    receiver_at("seat", (4.4, 3.3, 1.9)),
    room=shoebox_of(6.0, 4.5, 3.0, reflection=0.85),
    rate=16e3,
)


def snippets(page: Path) -> list[tuple[str, str]]:
    """Return kind and text of each of a page's snippets."""
    return FENCE.findall(page.read_text("utf-8"))


def small_scene(signal: clsim.Signal) -> clsim.Scene:
    """Return the ``scene`` of pages: a robot that walks and emits, four receivers."""
    walk = clsim.Trajectory.line((2.0, 2.0, 1.2), (2.4, 2.6, 1.2), 0.3)
    robot = clsim.Source("robot", signal, walk)
    places = {"ceiling": (1.0, 1.0, 2.4), "b": (5.0, 1.0, 2.3), "c": (5.0, 4.0, 2.4), "d": (1.0, 4.0, 2.2)}
    ears = [clsim.Receiver(name, clsim.Trajectory.fixed(place)) for name, place in places.items()]
    return clsim.Scene(clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8)), clsim.Air(), [robot], ears)


def prelude(text: str) -> dict[str, Any]:
    """Return the names that a page takes for granted, and write the files that it names."""
    tone = clsim.Signal.tone(40e3, 0.3, 192e3, fade=0.01)
    pulse = clsim.Signal.chirp(20e3, 45e3, 5e-3, 192e3, window="tukey")
    scene = small_scene(tone if "baseband=(" in text else clsim.Signal.pulses(pulse, 0.05, 4))
    paths = clsim.find_paths(scene, 1)
    recording = clsim.render(paths, 192e3) if "recording" in text else None
    t = np.linspace(0.0, 0.3, 31)
    for name, size in (("hall.obj", (2.0, 0.4, 1.5)), ("shelf.obj", (2.0, 0.4, 1.5)), ("room.obj", scene.room.size)):
        box = clsim.Shoebox(size, clsim.Material.from_reflection(0.8)).as_mesh()
        faces = [f"v {x} {y} {z}" for x, y, z in box.vertices] + [f"f {a} {b} {c}" for a, b, c in box.triangles + 1]
        Path(name).write_text("\n".join(faces), "utf-8")
    walk = scene.sources[0].trajectory.position(t)
    np.savetxt("walk.txt", np.column_stack([10.0 * t, *walk.T, np.tile((0, 0, 0, 1), (31, 1))]))  # 3 s
    shutil.copytree(ROOT / "examples", "examples")
    rows = "\n".join(f"{angle},0,-1" for angle in range(0, 190, 10))
    for name in ("beam.csv", "phase.csv"):
        Path(name).write_text(f"angle,20000,60000\n{rows}\n", "utf-8")
    if "beam.npz" in text:
        write_beams()
    if "clsim new scene.toml" not in text:
        shutil.copy("examples/circle.toml", "scene.toml")
    if "measured.wav" in text:
        write_measured()
    for folder, opened in (("out", 'load_recording("out/'), ("FOLDER", 'open_store("FOLDER')):
        if opened in text:
            run_commands(f"clsim run examples/circle.toml -o {folder} --no-plots --store zarr")
    return {
        "clsim": clsim, "np": np, "scene": scene, "paths": paths, "recording": recording, "trajectory": scene.sources[0].trajectory,
        "signal": tone, "voltage": tone, "times": t, "at": 0.1, "frequency": 40e3, "speed_of_sound": 343.0,
        "delays": np.full((1, 31), 0.01), "gains": np.ones((1, 31)), "direction": np.array([1.0, 0.0, 0.0]),
        "angles_degrees": np.linspace(0.0, 180.0, 19), "frequencies": np.array([20e3, 60e3]), "values": np.ones((19, 2)),
        "magnitudes_db": np.zeros((19, 2)), "phases_degrees": np.zeros((19, 2)),
        "anchors": np.array([(1, 1, 2.4), (5, 1, 2.3), (5, 4, 2.4), (1, 4, 2.2)], dtype=float),
        "x": np.linspace(1, 5, 5), "y": np.linspace(1, 4, 4),
    }  # fmt: skip


def write_beams() -> None:
    """Write tables of directivities of all kinds."""
    from scipy.io import savemat

    angles, frequencies, values = np.arange(0.0, 190.0, 10.0), np.array([20e3, 60e3]), np.ones((19, 2), dtype=complex)
    np.savez("beam.npz", angles=angles, frequencies=frequencies, values=values)
    struct = {"a": np.radians(angles), "f": frequencies, "X": values}
    savemat("beam.mat", {"theta": angles, "f": frequencies, "H": values, "L10R": struct})


def write_measured() -> None:
    """Write the scene of a talker and a seat, and a response of 0.4 s that somebody may have measured there."""
    import soundfile

    Path("scene.toml").write_text(ROOM, "utf-8")
    decay = np.random.default_rng(0).standard_normal(6400) * np.exp(-np.arange(6400) / 1000.0)
    soundfile.write("measured.wav", np.append(np.zeros(200), 0.1 * decay), 16000)


def run_page(page: str, folder: str, told: Any) -> None:
    """Run a page's snippets one after the other; tell what went wrong, nothing if nothing did."""
    os.chdir(folder)
    os.environ["MPLBACKEND"] = "agg"
    try:
        names = prelude(Path(page).read_text("utf-8"))
        for kind, text in snippets(Path(page)):
            if kind == "python":
                exec(compile(text, page, "exec"), names)
            elif kind == "sh":
                run_commands(text)
            else:
                check_tables(text)
        told.send("")
    except BaseException:
        told.send(traceback.format_exc()[-1500:])


def run_commands(text: str) -> None:
    """Run each `clsim …` line of a snippet."""
    from clsim.cli import main

    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if not words or ELSEWHERE.search(line):
            continue
        assert words[0] == "clsim", f"a command of another program: {line}"
        if words[1] == "run":
            words += ["--no-plots"] if "out/long" in words else ["--duration", "0.05"]  # the score needs a whole pulse
            words += [] if "--resume" in words else ["--force"]
        if words[1] == "study":
            words = ["clsim", "check", "examples/time_of_flight_scene.toml"]  # itself a test: the whole takes a minute
        try:
            status = main(words[1:])
        except SystemExit as leaving:
            status = int(leaving.code or 0)
        assert status == 0, line


def check_tables(text: str) -> None:
    """Read a part of a scene file, or of a study file, in the place of the same part of an example."""
    from clsim.measured.rooms import _File
    from clsim.scene_file.rooms import PolygonsFile
    from clsim.scene_file.scene import SceneModel
    from clsim.study.file import _StudyModel

    try:
        parts = [tomllib.loads(text)]
    except tomllib.TOMLDecodeError:  # a line for each of several ways to write a thing
        parts = [tomllib.loads(line) for line in text.splitlines()]
    for part in parts:
        if "vary" in part:
            _StudyModel.model_validate(part)
            continue
        if "polygons" in part:
            PolygonsFile.model_validate(part)
            continue
        if "states" in part:
            _File.model_validate(part)
            continue
        scene = tomllib.loads(Path("examples/circle.toml").read_text("utf-8"))
        ear = scene["receivers"][0] | {
            name: part.pop(name) for name in list(part) if name not in SceneModel.model_fields
        }
        array = {name: value for name, value in ear.items() if name != "trajectory"}
        part["sources"] = [scene["sources"][0] | row for row in part.get("sources", [{}])]
        part["receivers"] = [(array if "positions" in row else ear) | row for row in part.get("receivers", [{}])]
        SceneModel.model_validate(scene | part)


def run_notebook(notebook: str, folder: str, told: Any) -> None:
    """Run a notebook's cells from top to bottom; tell what went wrong, nothing if nothing did."""
    os.chdir(folder)
    os.environ["MPLBACKEND"] = "agg"
    warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")
    try:
        names: dict[str, Any] = {"__name__": "__main__"}
        cells = json.loads(Path(notebook).read_text("utf-8"))["cells"]
        for cell in (cell for cell in cells if cell["cell_type"] == "code"):
            exec(compile("".join(cell["source"]), notebook, "exec"), names)
        told.send("")
    except BaseException:
        told.send(traceback.format_exc()[-1500:])


def problem_of(run: Callable[[str, str, Any], None], file: Path, folder: Path) -> str:
    """Return the problem of running a file in a folder, by a process forked from one that has loaded everything."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        pytest.skip("this system does not fork")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["snippets", *LOADED])
    ours, theirs = context.Pipe()
    process = context.Process(target=run, args=(str(file), str(folder), theirs))
    process.start()
    theirs.close()  # so that a process that dies is seen at once
    problem = str(ours.recv())
    process.join()
    return problem
