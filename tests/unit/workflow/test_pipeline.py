"""From a scene file to a recording there is one way: a run and a study's member differ in nothing but where results go."""

import json
import pickle
import random
import tracemalloc
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from exhaustive import few
from late import installed
from test_tails import Tail

import clsim
from clsim.cli import main
from clsim.output.stores import STORES, SoundStore, StoredSound
from clsim.render import planning
from clsim.render.plan import Plan
from clsim.render.render import Rendering
from clsim.study.file import load_study
from clsim.study.member import run_member, study_to_settings
from clsim.workflow.checkpoint import Pieces, run_identity
from clsim.workflow.pieces import Handed, PlanFile, check_worker, device_of, do_piece, versions
from clsim.workflow.pipeline import plan_scene

installed("zarr")
installed("xarray")
pytestmark = pytest.mark.filterwarnings("ignore:.* were clipped:clsim.ClsimWarning")

RATE = 48e3
CHUNK = 18_432


def made_plan(engine: str, seconds: float = 1.5) -> Plan:
    """Return a plan of four chunks if left so long, with receivers whose ends ring on and others between."""
    chirp = clsim.Signal.chirp(3e3, 5e3, seconds - 0.2, RATE, window="tukey")
    source = clsim.Source("s", chirp, clsim.Trajectory.line((1, 1, 1), (2, 1, 1), seconds + 0.5))
    ends = [
        None,
        clsim.Electronics(low_cut=2e3, high_cut=8e3, order=3, self_noise_db=20.0, seed=2, adc_bits=12, adc_full_scale=0.5),
        None,
        None,
        clsim.Electronics(low_cut=1e3, clock_ppm=30.0),
    ]  # fmt: skip
    receivers = [
        clsim.Receiver(f"r{i}", clsim.Trajectory.fixed((3.0, 0.5 + 0.4 * i, 2.0)), electronics=end)
        for i, end in enumerate(ends)
    ]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 0)
    return clsim.plan_render(
        paths, RATE, engine=engine, chunk=CHUNK, responses="centre", interpolator=clsim.Bandlimited(-60.0)
    )


@cache
def rendered(engine: str) -> tuple[Plan, np.ndarray, Rendering]:
    """Return the plan, what one process makes of it, (5, n), and the rendering that is done with."""
    plan = made_plan(engine)
    rendering = Rendering(plan)
    return plan, np.concatenate([samples for _, samples in rendering.pieces()], axis=1), rendering


def store_in(folder: Path, plan: Plan) -> SoundStore:
    names = plan.tracks.receiver_names
    positions = np.zeros((len(names), 3))
    about = StoredSound(plan.channels, plan.units, positions, RATE, plan.samples, plan.chunk, "", clsim.__version__)
    store = STORES["zarr"](folder, about, names)
    store.create()
    return store


def samples_in(folder: Path) -> np.ndarray:
    import zarr

    return np.nan_to_num(
        zarr.open_group(folder / "recording.zarr", mode="r")["sound"][...]
    )  # also where it is not whole


def done_in_pieces(
    plan: Plan, folder: Path, chance: random.Random, begun: tuple[int, Any] = (0, {}), stop: int | None = None
) -> list[tuple[int, Any]]:
    """Do pieces at random, some of them twice; return what was whole behind each, until `stop` samples are."""
    handed = Handed.of(plan, store_in(folder, plan), 3)
    pieces = Pieces(handed, PlanFile.write(folder, handed), *begun)
    ready, whole = pieces.todo(), []
    while ready:
        number = ready.pop(chance.randrange(len(ready)))
        function, arguments = pieces.call(number)
        assert function is do_piece
        for _ in range(chance.randint(1, 2)):  # a worker that was taken for dead does it, too
            row = do_piece(*pickle.loads(pickle.dumps(arguments)), None)
        ready += pieces.settle(number, row["state"])
        whole.append(pieces.whole())
        if stop is not None and whole[-1][0] >= stop:
            break
    pieces.file.remove()
    assert not list(folder.glob(".*")), "nothing is left beside the store"
    return whole


@pytest.mark.parametrize("seed", few([0, 1]))
def test_any_order_gives_the_same_samples(engine: str, seed: int, tmp_path: Path) -> None:
    plan, wanted, rendering = rendered(engine)
    assert -(-plan.samples // plan.chunk) == 4
    assert 0 < rendering.clipped[1] < plan.samples / 2
    whole = done_in_pieces(plan, tmp_path, random.Random(seed))
    np.testing.assert_array_equal(samples_in(tmp_path), wanted)
    assert whole[-1][0] == plan.samples
    assert [done for done, _ in whole] == sorted(done for done, _ in whole)
    for name, value in rendering.state().items():
        np.testing.assert_array_equal(whole[-1][1][name], value)


def test_what_is_whole_is_enough_for_one_process_and_for_others(tmp_path: Path) -> None:
    plan, wanted, _ = rendered("reference")
    done, state = done_in_pieces(plan, tmp_path, random.Random(5), stop=2 * CHUNK)[-1]
    assert 2 * CHUNK <= done < plan.samples
    np.testing.assert_array_equal(samples_in(tmp_path)[:, :done], wanted[:, :done])
    alone = Rendering(plan)
    alone.restore(state)
    np.testing.assert_array_equal(np.concatenate([s for _, s in alone.pieces(done)], axis=1), wanted[:, done:])
    (tmp_path / "again").mkdir()
    done_in_pieces(plan, tmp_path / "again", random.Random(6), (done, state))
    np.testing.assert_array_equal(samples_in(tmp_path / "again")[:, done:], wanted[:, done:])


def test_a_contribution_that_remembers_is_done_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "BUILDERS", [*planning.BUILDERS, lambda plan: Tail(plan, 0.2)])
    plan = made_plan("reference", 1.2)
    wanted = np.concatenate([samples for _, samples in Rendering(plan).pieces()], axis=1)
    done_in_pieces(plan, tmp_path, random.Random(1))
    np.testing.assert_array_equal(samples_in(tmp_path), wanted)


def test_chunks_of_envelopes_are_made_once_whichever_pieces_they_are_for(tmp_path: Path, device: str) -> None:
    seconds = 25.0  # longer than a chunk of the envelopes
    source = clsim.Source("s", clsim.Signal.tone(1e4, seconds, RATE), clsim.Trajectory.line((1, 1, 1), (2, 1, 1), 26.0))
    end = clsim.Electronics(low_cut=2e3, self_noise_db=20.0)
    receivers = [
        clsim.Receiver(f"r{i}", clsim.Trajectory.fixed((3.0, 0.5 + 0.4 * i, 2.0)), electronics=e)
        for i, e in enumerate([end, None])
    ]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 0)
    plan = clsim.plan_render(paths, RATE, chunk=8 * CHUNK, duration=seconds, responses="centre", narrowband=True)
    handed = Handed.of(plan, store_in(tmp_path, plan), 2)
    pieces = Pieces(handed, PlanFile.write(tmp_path, handed), 0, {})
    shared = [n for n in range(pieces.count) if pieces.piece(n).shared is not None]
    assert len(shared) == 2
    assert pieces.todo() == shared, "pressure waits for envelopes"
    wanted = np.concatenate([samples for _, samples in Rendering(plan).pieces()], axis=1)
    (tmp_path / "random").mkdir()
    done_in_pieces(plan, tmp_path / "random", random.Random(3))
    np.testing.assert_array_equal(samples_in(tmp_path / "random"), wanted)


def test_workers_that_would_render_otherwise_are_refused(tmp_path: Path) -> None:
    plan = made_plan("reference", 0.5)
    file = PlanFile.write(tmp_path, Handed.of(plan, store_in(tmp_path, plan), 2))
    here = device_of(plan)
    assert check_worker(file, here, versions()) == ("", False)
    other = versions() | {"clsim": "0.0.9"}
    text = f"must have clsim 0.0.9, with which the run was begun, but has {clsim.__version__}"
    assert check_worker(file, here, other) == (text, False)
    text = f"must render on Some GPU, with which the run was begun, but has {here}"
    assert check_worker(file, "Some GPU", versions()) == (text, False)
    elsewhere = PlanFile(str(tmp_path / "elsewhere" / ".partial" / "run.plan"), file.digest)
    text = f"must see {tmp_path / 'elsewhere'} under the same path, but does not"
    assert check_worker(elsewhere, here, versions()) == (text, False)


def test_a_worker_takes_no_other_plan_and_writes_nothing_once_the_run_is_over(tmp_path: Path) -> None:
    plan = made_plan("reference", 0.5)
    handed = Handed.of(plan, store_in(tmp_path, plan), 5)  # the first receiver's samples need no others
    file = PlanFile.write(tmp_path, handed)
    with pytest.raises(clsim.ClsimError, match="must hold the plan of this run, but holds another one"):
        PlanFile(file.path, "0" * 64).load()
    function, arguments = Pieces(handed, file, 0, {}).call(0)
    function(*arguments, None)
    before = samples_in(tmp_path)
    assert np.any(before[0])
    file.remove()
    store_in(tmp_path, plan)  # another run begins where it was
    with pytest.raises(clsim.ClsimError, match="the run is over"):
        function(*arguments, None)
    assert not np.any(samples_in(tmp_path))


# Round the corner of an L no path of order 0 leads; the converter clips, so that there is another warning.
SCENE = """
format = 1
[room]
kind = "plan"
outline = [[0, 0], [8, 0], [8, 2], [2, 2], [2, 6], [0, 6]]
height = 3.0
materials = { default = { reflection = 0.8 } }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.01, sampling_rate = 192e3, fade = 0.002, amplitude = 5.0 }
trajectory = { kind = "line", start = [1.0, 5.0, 1.4], end = [1.1, 4.6, 1.5], duration = 0.2 }
[[receivers]]
name = "near"
trajectory = { kind = "fixed", position = [1.5, 3.0, 1.0] }
transducer = { kind = "resonance", frequency = 40e3, width = 3e3, sensitivity = 0.01 }
electronics = { adc_bits = 12, adc_full_scale = 0.005 }
[[receivers]]
name = "far"
trajectory = { kind = "fixed", position = [7.0, 1.0, 1.0] }
[paths]
max_order = 0
[render]
sampling_rate = 192e3
engine = "%s"
"""
STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "ground_truth", "paths"]
[[vary]]
field = "sources[0].trajectory.end[0]"
name = "end"
values = [1.1]
"""


@pytest.fixture
def folder(tmp_path: Path, engine: str) -> Path:
    (tmp_path / "scene.toml").write_text(SCENE % engine, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    return tmp_path


def test_a_member_is_a_run(folder: Path, capsys) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), "--no-plots"]) == 0
    warned = [line.removeprefix("clsim: warning: ") for line in capsys.readouterr().err.splitlines()]
    assert any("no path reaches 'far'" in line for line in warned)
    assert any("clip" in line for line in warned)

    study = load_study(folder / "study.toml")
    (folder / "study.json").write_text(json.dumps(study_to_settings(study)), "utf-8")
    (folder / "study.zarr").mkdir()
    row = run_member(str(folder), 0, None)
    assert row["status"] == "finished", row["error"]
    told = [" ".join(text.split()).replace("diffraction=1", "diffraction = 1") for text in row["warnings"]]
    assert told == warned  # but for the words of scene files
    with xarray.open_zarr(folder / "study.zarr" / "m000000") as member:
        identity = json.loads(member.attrs["identity"])
        for name, sound in zip(member.receiver.values, member.sound.values, strict=True):
            np.testing.assert_array_equal(soundfile.read(folder / "out" / f"{name}.wav", dtype="float32")[0], sound)
        assert np.abs(member.sound.values[0]).max() > 0.0
        # The text of the scene is the same, too, but for where it stands.
        assert member.attrs["scene"] == (folder / "out" / "scene.completed.toml").read_text("utf-8")
    record = json.loads((folder / "out" / "clsim.json").read_text("utf-8"))["identity"]
    assert record.pop("options") == {"store": "wav", "table_rate": 100.0}
    assert record == identity


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_identity_changes_with_what_samples_depend_on(folder: Path) -> None:
    def identity(old: str = "", new: str = "") -> dict:
        text = (folder / "scene.toml").read_text("utf-8")
        assert old in text
        (folder / "other.toml").write_text(text.replace(old, new) if old else text, "utf-8")
        return json.loads(json.dumps(run_identity(plan_scene(clsim.load_scene(folder / "other.toml")))))

    same, again = identity(), identity()
    assert same == again
    for old, new in (("0.8", "0.7"), ("[1.1, 4.6", "[1.2, 4.6"), ("[render]", '[render]\namplitude = "static"')):
        assert identity(old, new) != same


def test_errors_of_members_name_the_field_of_the_scene_file(folder: Path) -> None:
    pytest.importorskip("xarray")
    (folder / "study.toml").write_text(
        STUDY.replace("sources[0].trajectory.end[0]", "paths.max_order").replace("1.1", "99")
    )
    study = load_study(folder / "study.toml")
    (folder / "study.json").write_text(json.dumps(study_to_settings(study)), "utf-8")
    row = run_member(str(folder), 0, None)
    assert row["status"] == "failed"
    assert row["error"].startswith("paths.max_order: must be from 0 to 20")


def test_a_device_of_this_machine_is_not_part_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE % "opencl", "utf-8")
    file = clsim.load_scene(tmp_path / "scene.toml")
    here = file.on_device("0:0")
    assert (here.render["device"], here.paths["device"], here.model.render.device) == ("0:0", "0:0", None)
    asked = file.with_render(device="some", duration=0.125)
    assert asked.on_device("0:0") is asked
    assert (asked.render["device"], asked.paths["device"], asked.model.render.device) == ("some", "some", "some")
    assert (asked.render["duration"], asked.model.render.duration) == (0.125, 0.125)
    assert (file.render["device"], file.model.render.device, file.render["duration"]) == (None, None, None)


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_members_are_rendered_in_bounded_memory(tmp_path: Path, device) -> None:
    """Sound goes chunk by chunk into the store, and into the file that metrics read."""
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    scene = (SCENE % "opencl").replace("[render]", "[render]\nchunk = 18432\nduration = 8.0")
    (tmp_path / "scene.toml").write_text(scene, "utf-8")
    (tmp_path / "judge.py").write_text(
        "def last(recording, paths, parameters):\n    return {'last': recording.samples[:, -1], 'peak': abs(recording.samples[0, :9999]).max()}\n",
        "utf-8",
    )
    study = STUDY.replace('"ground_truth", "paths"]', '"metrics"]\nmetrics = "judge:last"').replace("1.1]", "1.1, 1.2]")
    (tmp_path / "study.toml").write_text(study, "utf-8")
    (tmp_path / "study.json").write_text(json.dumps(study_to_settings(load_study(tmp_path / "study.toml"))), "utf-8")
    (tmp_path / "study.zarr").mkdir()
    assert run_member(str(tmp_path), 0, None)["status"] == "finished"  # which loads and builds what stays
    tracemalloc.start()
    row = run_member(str(tmp_path), 1, None)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert row["status"] == "finished", row["error"]
    with xarray.open_zarr(tmp_path / "study.zarr" / "m000001") as member:
        assert member.sound.shape == (2, 8 * 192_000)
        assert member["peak"] == np.abs(member.sound.values[0, :9999]).max() > 0.0
        np.testing.assert_array_equal(member["last"].values, member.sound.values[:, -1])
    assert peak < 0.5 * 4 * 2 * 8 * 192_000
    assert list((tmp_path / ".partial").iterdir()) == []
