"""A run that can be killed at any moment and resumed, in this process or in pieces on workers."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

from clsim.errors import ClsimError, InputError, warn
from clsim.files.atomic import remove_leftovers, sha256_of
from clsim.output.stores import SoundStore
from clsim.render.contributions import State
from clsim.render.plan import Plan, within_memory
from clsim.render.planning import on_device
from clsim.render.render import PressureSum, ReceiverChain, Rendering
from clsim.scene_file.scene import referenced_files
from clsim.workflow.console import progress
from clsim.workflow.pieces import Handed, Piece, PlanFile, check_worker, device_of, do_piece, idle, versions
from clsim.workflow.pipeline import PlannedScene, render_into
from clsim.workflow.processes import Call, Dispatch, Tasks, local_devices
from clsim.workflow.result_folder import ResultFolder
from clsim.workflow.workers import Workers

_PERIOD = 1.0  # s between checkpoints, at least: the loss of a killed run beside its current chunk
_PIECE_WORK = 2e9  # path-samples of a piece, about: seconds, so that handing it out costs nothing
_PIECES = 64  # into which a run is cut at least along time, as far as it has chunks
_BLOCKS = 2  # of receivers for each worker
_UNKNOWN = 16  # workers that a scheduler is taken to have


def render_sound(
    results: ResultFolder, plan: Plan, store: SoundStore, identity: dict[str, Any], workers: Workers | None = None
) -> list[Path]:
    """Render into a store, from the beginning or from the checkpoint; return the paths moved to their place."""
    names = [path.name for path in store.paths]
    if all(map(results.is_whole, names)):
        return []
    begun: tuple[int, State] = 0, {}
    if results.journal.exists():
        begun = results.journal.load()[1:]
        lost = [path for path in store.paths if not (path.exists() or results.is_whole(path.name))]
        if lost:
            raise InputError("--resume", f"must find {lost[0]}, which is missing (--force begins anew)")
        store.recover()
    else:
        store.create()
    if begun[0] < plan.samples:
        notes = _Notes(results, identity, plan.samples, begun[0])
        with progress("rendering", plan.path_count * plan.samples) as bar:

            def advance(samples: float) -> None:
                """Move the bar on by samples of all paths."""
                bar(plan.path_count * samples)

            advance(begun[0])
            if workers is None:
                _render(plan, store, begun, notes, advance)
            else:
                render_on_workers(workers, results.work, plan, store, begun, notes, advance)
    return results.take(names)


class _Notes:
    """Checkpoints of a run, at a limited rate."""

    def __init__(self, results: ResultFolder, identity: dict[str, Any], samples: int, done: int) -> None:
        self._results, self._identity, self._samples = results, identity, samples
        self._done, self._noted = done, -math.inf

    def due(self, done: int) -> bool:
        """Return True if a checkpoint at so many samples is due."""
        finished = done == self._samples
        return done > self._done and (finished or time.monotonic() - self._noted > _PERIOD)

    def __call__(self, done: int, state: State) -> None:
        """Write a checkpoint of samples and state to the disk, if one is due."""
        if self.due(done):
            self._results.journal.save(self._identity, done, state)
            self._done, self._noted = done, time.monotonic()


def _render(
    plan: Plan, store: SoundStore, begun: tuple[int, State], notes: _Notes, advance: Callable[[float], None]
) -> None:
    """Render in this process."""
    rendering = Rendering(plan)
    if begun[0]:
        rendering.restore(begun[1])
    before = begun[0]
    for done in render_into([store], plan, rendering, before):
        if notes.due(done):
            store.to_disk()
            notes(done, rendering.state())
        advance(done - before)
        before = done


def run_identity(planned: PlannedScene) -> dict[str, Any]:
    """Return all that the samples of a scene file depend on, in texts and numbers."""
    file, paths, plan = planned.file, planned.paths, planned.plan
    content = file.model.model_dump(mode="json", exclude_none=True, warnings=False)
    content["render"] |= {
        "engine": plan.options.engine, "duration": plan.duration, "samples": plan.samples, "chunk": plan.chunk,
    }  # fmt: skip
    content["render"].pop("device", None)
    return {
        "scene": content,
        "contents": {os.path.relpath(path, file.base): sha256_of(path) for path in referenced_files(file)},
        "device": device_of(plan),
        "versions": versions(),
        "paths": paths.digest(),
        "contributions": {contribution.name: contribution.digest() for contribution in plan.contributions},
    }


def render_on_workers(
    workers: Workers, folder: Path, plan: Plan, store: SoundStore, begun: tuple[int, State],
    note: Callable[[int, State], None], advance: Callable[[float], None],
) -> None:  # fmt: skip
    """Render a plan into a store by workers, from where it was; `note` gets each state without a gap on the disk."""
    here = workers.count()
    handed = Handed.of(plan, store, _BLOCKS * (here or _UNKNOWN))
    with within_memory(plan.largest_field, f"rendering by {here} processes", here * plan.memory_bytes):
        remove_leftovers(folder)
    pieces = Pieces(handed, PlanFile.write(folder, handed), *begun)
    dispatch, shown = Dispatch(pieces.todo()), set[str]()
    devices: list[str] = []
    if workers.scheduler is None and plan.options.engine == "opencl" and plan.options.device is None:
        kind = device_of(plan)  # that of the workers' devices
        devices = [device for device in local_devices() if device_of(on_device(plan, device)) == kind]
    try:
        with closing(workers.at_most(pieces.count).rows(dispatch, pieces, devices)) as rows:
            for number, row in rows:
                if row["status"] == "failed":
                    piece = pieces.piece(number)
                    raise ClsimError(f"samples {piece.first} to {piece.last} were not rendered: {row['error']}")
                for text in row["warnings"]:
                    without_numbers = re.sub(r"[\d.]+", "", text)
                    if without_numbers not in shown:  # those that differ in numbers alone appear once
                        shown.add(without_numbers)
                        warn(text)
                for ready in pieces.settle(number, row["state"]):
                    dispatch.add(ready)
                advance(pieces.rendered(number))
                note(*pieces.whole())
    finally:
        pieces.file.remove()
    receivers = ReceiverChain(plan)
    receivers.restore(pieces.whole()[1])
    receivers.warn()


class Pieces(Tasks):
    """All pieces of a run, which of them can be done, and what is whole."""

    # Pieces are numbered stretch by stretch: pressure first, then each block of receivers in which something rings on.
    # Behind all of these stands what several stretches are made of alike. A chain is a block's pieces, or those of
    # pressure where a contribution remembers something.
    kind = "piece"
    loads = ("zarr", "scipy.fft", "pyopencl.invoker", "clsim.scene.scene")

    def __init__(self, handed: Handed, file: PlanFile, done: int, state: State) -> None:
        plan = handed.plan
        self.file, self._plan, self._later = file, plan, handed.later()
        chunks = -(-(plan.samples - done) // plan.chunk)
        piece_work = round(_PIECE_WORK / (max(plan.path_count, 1) * plan.chunk))
        step = plan.chunk * max(1, min(piece_work, chunks // _PIECES))
        self._edges = [*range(done, plan.samples, step), plan.samples]
        self._rendered: set[int] = set()  # stretches whose pressure is there
        self._next = [0] * (1 + len(self._later))  # stretch before which all are there, of pressure and each block
        self._states: list[dict[int, State]] = [{0: state} for _ in self._next]
        pressure = PressureSum(plan)
        self._is_chain = bool(pressure.state())
        self._parts = [set(pressure.shared(*stretch)) for stretch in pairwise(self._edges)]  # that are still wanted
        self._users: dict[str, list[int]] = {}  # stretches, by what they are made of
        for stretch, names in enumerate(self._parts):
            for name in sorted(names):
                self._users.setdefault(name, []).append(stretch)
        self._shared = list(self._users)

    @property
    def count(self) -> int:
        """Number of pieces."""
        return self._behind + len(self._shared)

    @property
    def _behind(self) -> int:
        """Number of the first piece that is shared."""
        return (len(self._edges) - 1) * len(self._next)

    def todo(self) -> list[int]:
        """Return the pieces that can be done at once."""
        stretches = filter(self._can_be_summed, range(len(self._parts)))
        return [*(len(self._next) * stretch for stretch in stretches), *range(self._behind, self.count)]

    def _can_be_summed(self, stretch: int) -> bool:
        """Return True if all inputs of a block's pressure exist."""
        return not self._parts[stretch] and (not self._is_chain or stretch == self._next[0])

    def piece(self, number: int) -> Piece:
        """Return a piece."""
        if number >= self._behind:
            name = self._shared[number - self._behind]
            users = self._users[name]
            return Piece(self._edges[users[0]], self._edges[users[-1] + 1], None, name)
        stretch, chain = divmod(number, len(self._next))
        first, last = self._edges[stretch : stretch + 2]
        return Piece(first, last, self._later[chain - 1] if chain else None)

    def rendered(self, number: int) -> int:
        """Return the number of pressure samples that a piece adds."""
        piece = self.piece(number)
        return piece.last - piece.first if piece.receivers is None and piece.shared is None else 0

    def check(self) -> Call:
        """Return a call of `check_worker`."""
        return check_worker, (self.file, device_of(self._plan), versions())

    def call(self, number: int) -> Call:
        """Return a call of `do_piece` with the state before the piece."""
        if number >= self._behind:
            return do_piece, (self.file, self.piece(number), {})
        stretch, chain = divmod(number, len(self._next))
        state = self._states[chain][stretch] if chain or self._is_chain else {}
        mine = [f"receivers.{i}." for i in self._later[chain - 1]] if chain else ["contribution"]
        return do_piece, (
            self.file, self.piece(number), {n: v for n, v in state.items() if n.startswith(tuple(mine))},
        )  # fmt: skip

    def over(self) -> Call:
        """Stop workers from writing; return a call that waits until they have stopped."""
        self.file.remove()
        return idle, ()

    def settle(self, number: int, state: State) -> list[int]:
        """Mark a piece as done; return the pieces that became possible, the most urgent last."""
        if number >= self._behind:
            return self._found(self._shared[number - self._behind])
        stretch, chain = divmod(number, len(self._next))
        ready = []
        if chain == 0:
            self._rendered.add(stretch)
            for name, users in self._users.items():  # what stretches that are all there have shared
                if stretch in users and self._rendered.issuperset(users):
                    self.file.shared(name).unlink(missing_ok=True)
            while self._next[0] in self._rendered:
                self._next[0] += 1
            ready = [number + k for k in range(1, len(self._next)) if self._next[k] == stretch]
        else:
            piece = self.piece(number)
            assert piece.receivers is not None
            for start in range(piece.first, piece.last, self._plan.chunk):
                self.file.between(start, piece.receivers).unlink(missing_ok=True)
            self._next[chain] += 1
        following = number + len(self._next)
        self._states[chain][stretch + 1] = state
        if stretch + 2 < len(self._edges) and (
            (self._is_chain and self._can_be_summed(stretch + 1)) if chain == 0 else stretch + 1 in self._rendered
        ):
            ready.append(following)
        return ready

    def _found(self, name: str) -> list[int]:
        """Mark a shared part as made; return the pieces that waited for it alone."""
        for stretch in self._users[name]:
            self._parts[stretch].discard(name)
        ready = filter(self._can_be_summed, self._users[name])
        return [len(self._next) * stretch for stretch in ready][::-1]

    def whole(self) -> tuple[int, State]:
        """Return the number of samples without a gap, and the state after them."""
        stretch = min(self._next)
        state: State = {}
        for states in self._states:
            for old in [at for at in states if at < stretch]:
                del states[old]
            state |= states.get(stretch, {})
        return self._edges[stretch], state
