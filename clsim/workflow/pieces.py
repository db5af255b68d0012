"""Pieces of a run, as a worker does them: pressure for a stretch of time, or what some receivers make of it.

All workers have one plan, from one file: nothing is planned twice, and nothing can be planned otherwise. Pressure is
cut along time, at chunks: it does not depend on what was before. What several stretches of time are made of alike, such
as a chunk of envelopes, is a piece of its own: it waits in a file until all of them are there. What rings on in
receivers' ends depends on what was before, so for each block of receivers there is a chain of pieces, each of which is
handed what the one before remembered; pressure waits for it in files. Pressure is not cut along receivers: the lengths
of blocks are chosen for a batch of receivers at once, so another batch would change it.
"""

from __future__ import annotations

import asyncio
import hashlib
import pickle
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from clsim.errors import ClsimError, ClsimWarning, DeviceError, in_one_line
from clsim.files.atomic import atomic_path, safe_path, temporary_path
from clsim.numerics.blas import blas_threads, with_blas_threads
from clsim.opencl.device import find_device
from clsim.output.stores import SoundStore
from clsim.render.contributions import State
from clsim.render.plan import Plan, within_memory
from clsim.render.planning import on_device
from clsim.render.render import PressureSum, ReceiverChain, receivers_with_ends
from clsim.version import __version__
from clsim.workflow.processes import Row

_busy = threading.Lock()  # a process does one piece at a time: engines are not shared


@cache
def versions() -> dict[str, str]:
    """Return the versions of packages that samples depend on."""
    return {"clsim": __version__, "numpy": np.__version__, "scipy": version("scipy")}


def device_of(plan: Plan) -> str:
    """Return the kind of device on which a plan is rendered here, with its driver."""
    if plan.options.engine != "opencl":
        return "none"
    info, _ = find_device(plan.options.device)
    return f"{info.name} ({info.platform}, {info.version})"


@dataclass(frozen=True, slots=True)
class Piece:
    """Some chunks of a run."""

    first: int  # samples, the last one not among them
    last: int  # likewise
    receivers: range | None = None  # rows whose ends are to take the pressure; None for the pressure itself
    shared: str | None = None  # name of what they and others are made of alike, the only thing to make then


@dataclass(frozen=True, slots=True, eq=False)
class Handed:
    """Data of a run that all workers share."""

    plan: Plan  # what is rendered
    store: SoundStore  # into which; created
    blocks: tuple[range, ...]  # rows whose samples are written together, of whole receivers
    blas_threads: int  # of the linear algebra, where the run is begun: on others it may round otherwise

    @classmethod
    def of(cls, plan: Plan, store: SoundStore, blocks: int) -> Handed:
        """Return the shared data, with receivers in so many blocks."""
        edges = np.linspace(0, plan.receiver_count, min(blocks, plan.receiver_count) + 1).astype(int).tolist()
        rows = plan.first_rows[edges].tolist()
        return cls(plan, store, tuple(map(range, rows[:-1], rows[1:])), blas_threads())

    def later(self) -> list[range]:
        """Return the blocks with receivers that carry state, whose pieces form a chain."""
        rows = [int(self.plan.first_rows[i]) for i in receivers_with_ends(self.plan)]
        return [block for block in self.blocks if any(row in block for row in rows)]


@dataclass(frozen=True, slots=True)
class PlanFile:
    """File from which workers read a run; intermediate results of workers stand beside it."""

    path: str  # the same on all machines
    digest: str  # SHA-256 of what it holds

    @classmethod
    def write(cls, folder: Path, handed: Handed) -> PlanFile:
        """Write the shared data into a folder of unfinished results."""
        content, path = pickle.dumps(handed, pickle.HIGHEST_PROTOCOL), temporary_path(folder.absolute() / "run.plan")
        with safe_path(path) as temporary:
            temporary.write_bytes(content)
        return cls(str(path), hashlib.sha256(content).hexdigest())

    def load(self) -> Handed:
        """Return the shared data."""
        content = Path(self.path).read_bytes()
        if hashlib.sha256(content).hexdigest() != self.digest:
            raise ClsimError(f"{self.path} must hold the plan of this run, but holds another one")
        handed: Handed = pickle.loads(content)
        return handed

    def between(self, start: int, block: range) -> Path:
        """Return the file of a block's pressure for the chunk from `start` on, until its receivers take it."""
        path = Path(self.path)
        return path.with_name(f"{path.stem}.{start}-{block.start}.npy")

    def shared(self, name: str) -> Path:
        """Return the file of an intermediate result that several pieces use, by its name."""
        path = Path(self.path)
        return path.with_name(f"{path.stem}.shared-{name}.npy")

    def remove(self) -> None:
        """Delete it and all that stands beside it; a worker that is still at this run writes nothing any more."""
        path = Path(self.path)
        path.unlink(missing_ok=True)
        for left in path.parent.glob(f"{path.stem}.*"):
            left.unlink(missing_ok=True)


def check_worker(plan: PlanFile, device: str, wanted: dict[str, str]) -> tuple[str, bool]:
    """Return the reason why a worker cannot render like the others, or "", and whether its device is the reason."""
    for name, mine in versions().items():
        if mine != wanted[name]:
            return f"must have {name} {wanted[name]}, with which the run was begun, but has {mine}", False
    if not Path(plan.path).exists():
        folder = Path(plan.path).parents[1]
        return f"must see {folder} under the same path, but does not", False
    try:
        here = device_of(_handed(plan).plan)
    except Exception as error:
        return in_one_line(error), isinstance(error, DeviceError)
    return ("" if here == device else f"must render on {device}, with which the run was begun, but has {here}"), False


def do_piece(plan: PlanFile, piece: Piece, state: State, device: str | None) -> Row:
    """Render a piece into the store, flushed to the disk; return its row with the state for the next piece."""
    begun = time.process_time()
    with _busy, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClsimWarning)
        site = _site(plan, device)
        rendered = site.handed.plan
        with (
            within_memory(rendered.largest_field, "rendering", rendered.memory_bytes),
            with_blas_threads(site.handed.blas_threads),
        ):
            remembered = site.do(piece, state)
    shown = [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]
    seconds = time.process_time() - begun
    return {"status": "finished", "state": remembered, "warnings": shown, "seconds": seconds}


async def idle() -> None:
    """Wait until this worker does no piece any more."""
    while _busy.locked():
        await asyncio.sleep(0.02)


@lru_cache(maxsize=1)
def _handed(plan: PlanFile) -> Handed:
    return plan.load()


@lru_cache(maxsize=1)
def _site(plan: PlanFile, device: str | None) -> _Site:
    return _Site(plan, device)


class _Site:
    """State that a worker keeps between pieces of a run."""

    def __init__(self, plan: PlanFile, device: str | None) -> None:
        self.handed, self._file = _handed(plan), plan
        self._plan = on_device(self.handed.plan, device)
        self._later = self.handed.later()
        self._pressure: PressureSum | None = None
        self._chains: dict[range, ReceiverChain] = {}

    def do(self, piece: Piece, state: State) -> State:
        """Do a piece; return the state for the next one."""
        if piece.shared is not None:  # an intermediate result that several pieces use
            made = self._whole().made(piece.shared)
            self._check_on()
            with atomic_path(self._file.shared(piece.shared)) as path:
                np.save(path, made)
            return {}
        store = self.handed.store
        store.open()
        try:
            remembered = self._sum(piece, state) if piece.receivers is None else self._taken(piece, state)
            store.to_disk()
        finally:
            store.close()
        return remembered

    def _sum(self, piece: Piece, state: State) -> State:
        """Render pressure; write the receivers whose samples it is, and leave the rest to the receivers' pieces."""
        whole = self._whole()
        if state:
            whole.restore(state)
        whole.until(piece.last)
        for start in self._chunks(piece):
            pressure = whole(start)
            for block in self.handed.blocks:
                here = pressure[block.start : block.stop]
                if block in self._later:
                    with atomic_path(self._file.between(start, block)) as path:
                        np.save(path, here)
                else:
                    self._write(start, ReceiverChain(self._plan, block)(start, here), block)
        whole.warn()
        return whole.state()

    def _whole(self) -> PressureSum:
        """Return the sum of all contributions, which read the intermediate results of others."""
        if self._pressure is None:
            self._pressure = PressureSum(self._plan)
            self._pressure.look_up(lambda name: np.load(self._file.shared(name), allow_pickle=False))
        return self._pressure

    def _taken(self, piece: Piece, state: State) -> State:
        """Apply the receivers' electronics to pressure that others rendered."""
        block = piece.receivers
        assert block is not None
        if block not in self._chains or not state:
            self._chains[block] = ReceiverChain(self._plan, block)
        chain = self._chains[block]
        if state:
            chain.restore(state)
        for start in self._chunks(piece):
            self._write(start, chain(start, np.load(self._file.between(start, block), allow_pickle=False)), block)
        return chain.state()

    def _chunks(self, piece: Piece) -> Iterator[int]:
        for start in range(piece.first, piece.last, self._plan.chunk):
            self._check_on()
            yield start

    def _write(self, start: int, samples: Any, block: range) -> None:
        self._check_on()
        self.handed.store.write(start, samples, block.start)

    def _check_on(self) -> None:
        """Raise if another run has begun in the same folder."""
        if not Path(self._file.path).exists():
            raise ClsimError("the run is over")
