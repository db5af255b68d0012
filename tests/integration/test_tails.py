"""Tails in runs: diffuse ones, and a toy of one's own; gone on with, in stores, in studies, by both engines."""

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from killing import Killer
from scene_texts import along, chirp_of, receiver_at, scene_text, source_at
from scipy.signal import lfilter

import clsim
from clsim.cli import main
from clsim.render import planning
from clsim.render.contributions import State, WithoutTables
from clsim.render.plan import SEGMENT, Plan
from clsim.render.render import Rendering
from clsim.workflow import checkpoint

RATE = 48e3
LEVEL = 0.01
TOY_TAIL_SCENE = scene_text(
    source_at("robot", chirp_of(3e3, 5e3, 1.5, 48e3, window="tukey"), along((1, 1, 1), (2, 1, 1), 2.0)),
    receiver_at("moving", along((3, 1, 2), (3, 2, 2), 2.0)),
    receiver_at("fixed", (3.0, 2.0, 2.0)),
    max_order=0,
    rate=48e3,
    render={
        "engine": "reference",
        "chunk": 18432,
        "responses": "centre",
        "interpolator": {"kind": "bandlimited", "error_db": -60.0},
    },
)


@dataclass(frozen=True)
class Tail:
    """What a source emits, through a decay of one time constant, alike at every receiver."""

    plan: Plan
    decay: float  # s
    fails_at: int | None = None  # sample
    name: str = "toy tail"

    def describe(self) -> list[str]:
        return [f"a toy tail of {self.decay:g} s"]

    def digest(self) -> str:
        return repr((self.decay, LEVEL))

    def begin(self) -> "Ringing":
        return Ringing(self)


class Ringing(WithoutTables):
    """A tail, and how it rings on."""

    def __init__(self, tail: Tail) -> None:
        self.tail, self.memory, self.warned = tail, np.zeros((len(tail.plan.source_filters), 1)), False

    def add(self, pressure: np.ndarray, start: int) -> None:
        if start == self.tail.fails_at:
            raise clsim.DeviceError("the toy fails")
        pole = np.exp(-1.0 / (self.tail.decay * self.tail.plan.sampling_rate))
        for i, filters in enumerate(self.tail.plan.source_filters):
            emitted = filters.signal.read(start, start + pressure.shape[1])
            rung, self.memory[i] = lfilter([LEVEL], [1.0, -pole], emitted, zi=self.memory[i])
            pressure += rung

    def until(self, last: int) -> None:
        pass

    def state(self) -> State:
        return {"memory": self.memory}

    def restore(self, state: State) -> None:
        self.memory = state["memory"].copy()

    def warn(self) -> None:
        self.warned = True


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Register the tail; the values may be changed."""
    values: dict[str, Any] = {"decay": 0.2}
    monkeypatch.setattr(planning, "BUILDERS", [*planning.BUILDERS, lambda plan: Tail(plan, **values)])
    return values


def find_paths() -> clsim.PathSet:
    chirp = clsim.Signal.chirp(3e3, 5e3, 1.5, RATE, window="tukey")
    source = clsim.Source("s", chirp, clsim.Trajectory.line((1, 1, 1), (2, 1, 1), 2.0))
    places = clsim.Trajectory.line((3, 1, 2), (3, 2, 2), 2.0), clsim.Trajectory.fixed((3, 2, 2))
    receivers = [clsim.Receiver(f"r{i}", place) for i, place in enumerate(places)]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 0)


def options(engine: str, chunk: int) -> dict[str, Any]:
    return {"engine": engine, "responses": "centre", "interpolator": clsim.Bandlimited(-60.0), "chunk": chunk}


@pytest.mark.parametrize("chunk", [10**6, SEGMENT])
def test_its_samples_are_added_exactly(engine: str, chunk: int, registered: dict[str, Any]) -> None:
    """In chunks as at once: what is added is the tail of the whole signal."""
    plan = clsim.plan_render(find_paths(), RATE, **options(engine, chunk))
    *others, tail = plan.contributions
    adding = [other.begin() for other in others]
    emitted = plan.source_filters[0].signal.read(0, plan.samples)
    rung = lfilter([LEVEL], [1.0, -np.exp(-1.0 / (0.2 * RATE))], emitted)
    wanted = np.zeros((2, plan.samples), plan.pressure_type)
    for start in range(0, plan.samples, plan.chunk):
        for other in adding:
            other.add(wanted[:, start : start + plan.chunk], start)
    alone = wanted.copy()
    wanted += rung
    rendering = Rendering(plan)
    pieces = [samples for _, samples in clsim.render_chunks(plan, rendering=rendering)]
    assert len(pieces) == -(-plan.samples // plan.chunk)
    np.testing.assert_array_equal(np.concatenate(pieces, axis=1), wanted.astype(np.float32))
    assert np.abs(wanted - alone).max() > 1e-3  # it is heard
    assert rendering._pressure._adding[-1].warned
    made = clsim.render(find_paths(), RATE, **options(engine, chunk))
    np.testing.assert_array_equal(made.samples, wanted.astype(np.float32))
    assert [line for line in made.notes if line in tail.describe()] == ["a toy tail of 0.2 s"]


def test_another_process_goes_on_with_its_state(registered: dict[str, Any]) -> None:
    plan = clsim.plan_render(find_paths(), RATE, **options("reference", SEGMENT))
    whole = [samples for _, samples in clsim.render_chunks(plan)]
    begun, gone_on = Rendering(plan), Rendering(plan)
    pieces = clsim.render_chunks(plan, rendering=begun)
    first = [next(pieces)[1] for _ in range(2)]
    gone_on.restore({name: value.copy() for name, value in begun.state().items()})
    later = [samples for _, samples in clsim.render_chunks(plan, first=2 * SEGMENT, rendering=gone_on)]
    for got, wanted in zip([*first, *later], whole, strict=True):
        np.testing.assert_array_equal(got, wanted)
    forgetful = next(clsim.render_chunks(plan, first=2 * SEGMENT))[1]
    assert not np.array_equal(forgetful, whole[2])


def run(folder: Path, out: str, *more: str) -> int:
    return main(["run", str(folder / "scene.toml"), "-o", str(folder / out), "--no-plots", "--table", "none", *more])


def test_runs_are_gone_on_with_and_another_tail_is_another_run(registered, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(checkpoint, "_PERIOD", -1.0)  # every chunk is noted
    (tmp_path / "scene.toml").write_text(TOY_TAIL_SCENE, "utf-8")
    assert run(tmp_path, "whole") == 0
    registered["fails_at"] = 2 * SEGMENT
    assert run(tmp_path, "out") == 2
    assert "the toy fails" in capsys.readouterr().err
    registered |= {"fails_at": None, "decay": 0.3}
    assert run(tmp_path, "out", "--resume") == 2
    told = capsys.readouterr().err
    assert "contributions.toy tail was '(0.2, 0.01)' and is '(0.3, 0.01)'" in told
    registered["decay"] = 0.2
    assert run(tmp_path, "out", "--resume") == 0
    for name in ("moving.wav", "fixed.wav"):
        got, wanted = (soundfile.read(tmp_path / folder / name, dtype="float32")[0] for folder in ("out", "whole"))
        np.testing.assert_array_equal(got, wanted)
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    assert "a toy tail of 0.2 s" in capsys.readouterr().out


SCENE = scene_text(
    source_at("moving", chirp_of(1e3, 3e3, 3.0, 16e3, window="tukey"), along((1, 1, 1), (2, 1, 1), 5.0)),
    source_at("still", chirp_of(3e3, 1e3, 3.0, 16e3, window="tukey"), (3.0, 1.0, 1.5)),
    receiver_at(
        "turning",
        {
            "kind": "waypoints", "times": (0, 5), "positions": [(2, 2, 1), (2.3, 1.7, 1.2)],
            "orientations": [(0, 0, 0, 1), (0, 0, 0.8, 0.6)], "smooth": False,
        },
        directivity={"kind": "first-order", "weight": 0.5},
    ),
    receiver_at("fixed", (3.0, 2.0, 2.0)),
    room={"kind": "shoebox", "size": (4.0, 3.0, 2.5), "walls": {"reflection": 0.6, "scattering": 0.3}},
    rate=16e3,
    render={"chunk": 18432, "tail": "auto", "tail_directions": 16, "tail_error_db": 3.0},
)  # fmt: skip


STUDY = """
format = 1
scene = "scene.toml"
metrics = "judge:level"
keep = ["recording", "metrics"]
[[vary]]
field = "render.tail_seed"
name = "seed"
values = [0, 1]
"""
JUDGE = """
import numpy as np


def level(recording, paths, parameters):
    return {"rms": np.sqrt(np.mean(recording.samples**2, axis=1))}
"""
NAMES = ("turning.wav", "fixed.wav")


def command(scene: Path, out: Path, *more: str) -> list[str]:
    return ["run", str(scene), "-o", str(out), "--no-plots", "--table", "none", *more]


def sound(out: Path) -> np.ndarray:
    return np.stack([soundfile.read(out / name, dtype="float32")[0] for name in NAMES])


def error_db(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(10.0 * np.log10(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


def test_runs_are_gone_on_with_to_the_last_bit(killer: Killer, scene: Path, tmp_path: Path, device: None) -> None:
    """Two sources, one of which moves, a receiver that turns with its beam, and one that stands still."""
    pytest.importorskip("zarr")
    out = tmp_path / "out"
    assert main(command(scene, tmp_path / "whole")) == 0
    assert killer.run(command(scene, out, "--store", "zarr"), out, event=3, of="journal.npz") == -signal.SIGKILL
    assert killer.run(command(scene, out, "--store", "zarr", "--resume"), out) == 0, killer.log
    with clsim.open_store(out) as found:
        np.testing.assert_array_equal(found.sound.values, sound(tmp_path / "whole"))


@pytest.mark.exhaustive
def test_both_engines_and_studies_hear_the_same(scene: Path, tmp_path: Path, device: None) -> None:
    """The tails of both are the same within -60 dB (filters of -70 dB each); a seed's is the same everywhere."""
    zarr = pytest.importorskip("zarr")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    (tmp_path / "judge.py").write_text(JUDGE, "utf-8")
    assert main(command(scene, tmp_path / "opencl")) == 0
    assert main(command(scene, tmp_path / "reference", "--engine", "reference")) == 0
    heard = sound(tmp_path / "opencl")
    assert error_db(sound(tmp_path / "reference"), heard) < -60.0
    scene.write_text(SCENE.replace('tail = "auto"', 'tail = "off"'), "utf-8")
    assert main(command(scene, tmp_path / "off")) == 0
    images = sound(tmp_path / "off")
    images = np.pad(images, ((0, 0), (0, heard.shape[1] - images.shape[1])))
    assert -10.0 < error_db(images, heard) < -1.0  # it is heard
    scene.write_text(SCENE, "utf-8")
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "study")]) == 0
    members = [zarr.open(tmp_path / "study" / "study.zarr")[f"m00000{i}/sound"][:] for i in range(2)]
    np.testing.assert_array_equal(members[0], heard)
    assert error_db(members[1][:, :49_000], heard[:, :49_000]) > -20.0  # another seed, another tail
