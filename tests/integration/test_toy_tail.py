"""A contribution of another kind, an exponential tail: this file and one registration are all that it needs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
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
SCENE = scene_text(
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


def test_runs_are_gone_on_with_and_another_tail_is_another_run(
    registered: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(checkpoint, "_PERIOD", -1.0)  # every chunk is noted
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
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
