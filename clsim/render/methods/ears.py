"""Receivers whose channels differ over frequency: the sound of each path at the centre, through responses that turn."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.numerics.blas import with_blas_threads
from clsim.paths.path_set import PathSet
from clsim.render.contributions import Stateless, digest_of
from clsim.render.ear_frames import EarFrames
from clsim.render.methods.per_sample import PathSum, path_pressures
from clsim.render.opencl.batches import Fades
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.options import RenderOptions
from clsim.render.plan import Allocation, PairPart, Plan, plan_of_part
from clsim.render.source_filters import Emission
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.tracks.tracks import SceneTracks, Tracks

_BYTES = 64 * 2**20  # of path signals on the device at a time


def can(tracks: Tracks, options: RenderOptions, pair: int) -> str | None:
    """Return the reason against rendering a pair by this method, by its index; None if there is none."""
    of_scene = tracks.of_scene
    if of_scene is None:
        return "tracks without a scene"
    directivity = of_scene.paths.scene.receivers[tracks.pairs[pair].receiver].directivity
    if not isinstance(directivity, ChannelDirectivity) or directivity.by_functions:
        return "its channels are alike over frequency"
    return "envelopes" if options.baseband is not None or options.responses == "centre" else None


def centre_tracks(tracks: SceneTracks, pairs: Sequence[int]) -> SceneTracks:
    """Return the tracks of pairs as an omnidirectional receiver at each receiver's centre has them."""
    scene = copy(tracks.paths.scene)
    receivers = [copy(receiver) for receiver in scene.receivers]
    for i in {tracks.pairs[pair].receiver for pair in pairs}:
        object.__setattr__(receivers[i], "directivity", Omni())
    object.__setattr__(scene, "receivers", tuple(receivers))
    families = {id(family): copy(family) for family in tracks.paths.families}
    for family in families.values():
        object.__setattr__(family, "scene", scene)
    once = {tracks.paths_of(pair): pair for pair in reversed(pairs)}  # both ears have the same paths
    kept = sorted(once.values())
    return replace(
        tracks,
        paths=PathSet(scene, tuple(families.values())),
        pairs=tuple(replace(tracks.pairs[i], channels=range(1)) for i in kept),
        pair_paths=tuple(
            replace(tracks.pair_paths[i], family=families[id(tracks.pair_paths[i].family)], channels=range(1))
            for i in kept
        ),
    )


def parts_of(
    emissions: Sequence[tuple[Signal, float]], tracks: Tracks, options: RenderOptions, samples: int,
    others: frozenset[int],
) -> tuple[PairPart, ...]:  # fmt: skip
    """Return pairs with receivers whose channels differ over frequency, with a plan."""
    pairs = [i for i in range(len(tracks.pairs)) if i not in others and can(tracks, options, i) is None]
    if not pairs or tracks.of_scene is None:
        return ()
    centres, until, made = centre_tracks(tracks.of_scene, pairs), samples / options.sampling_rate, []
    with with_blas_threads(1):
        for i, emitted in enumerate(emissions):
            silent = all(pair.source != i for pair in centres.pairs)
            emission = Emission.of(i, emitted, centres, options, until, centres, static=silent)
            made.append(emission.source_filters())
    plan = plan_of_part(options, centres, Allocation(), tuple(made), samples)
    return (PairPart(plan, frozenset(pairs)),)


@dataclass(frozen=True, slots=True, eq=False)
class Ears:
    """Contribution of receivers whose channels differ over frequency."""

    plan: Plan  # of the whole
    name: ClassVar[str] = "ears"

    @property
    def scene(self) -> Scene:
        """The scene."""
        assert self.plan.tracks.of_scene is not None, "ears are those of scenes"
        return self.plan.tracks.of_scene.paths.scene

    def describe(self) -> list[str]:
        lines = []
        for part in self.plan.allocation.ears:
            ears = f"{len({pair.receiver for pair in part.plan.tracks.pairs})} receivers with ears"
            lines.append(f"{part.plan.path_count} paths to {ears}: each is filtered on its own")
            lines += PathSum(part.plan).describe()
        return lines

    def digest(self) -> str:
        """Return a text that changes with any tap, and with the responses, of which some are looked at."""
        found, c = list[Any](), self.scene.air.speed_of_sound
        for part in self.plan.allocation.ears:
            found.append(PathSum(part.plan).digest())
            for receiver in sorted({pair.receiver for pair in part.plan.tracks.pairs}):
                ears = self.scene.receivers[receiver].directivity
                some = np.clip(np.geomspace(100.0, 0.4 * part.plan.sampling_rate, 8), *ears.band)
                found.append(ears.gain_towards(np.eye(3)[:, None], some, c))
        return digest_of(*found)

    def begin(self) -> _Adding:
        return _Adding(self)


class _Adding(Stateless):
    """Adds what ears receive; the engine starts with the first piece."""

    def __init__(self, ears: Ears) -> None:
        self._ears = ears
        self.engines: list[EarEngine] = []

    def add(self, pressure: NDArray[Any], start: int) -> None:
        for i, part in enumerate(self._ears.plan.allocation.ears):
            plan = part.plan
            frames = EarFrames(plan, self._ears.scene, (self._ears.plan.first_rows, pressure), start)
            begin = max(start - frames.after, 0) // plan.segment * plan.segment
            # Whole segments but for the plan's last one, so that no bit depends on the chunks.
            end = -(-(start + pressure.shape[1] + frames.before) // plan.segment) * plan.segment
            end = min(end, plan.samples + frames.before)
            if plan.options.engine == "reference":
                _add_exactly(frames, begin, end)
                continue
            if len(self.engines) <= i:
                self.engines.append(EarEngine(plan))
            self.engines[i].filter(frames, begin, end)


def _add_exactly(frames: EarFrames, begin: int, end: int) -> None:
    """Add paths in float64."""
    plan = frames.plan
    for first in range(begin, end, plan.segment):
        last = min(first + plan.segment, end)
        for pair, member in enumerate(plan.tracks.pairs):
            signals = np.zeros((len(member), last - first))
            for row, received in path_pressures(plan, pair, first, last):
                signals[row] = received[0]
            frames.add(pair, np.arange(len(member)), signals, first)


class _EarRun(Run):
    """Renders the paths of a batch one by one."""

    _engine: EarEngine
    _apart, _divides = True, False

    def _fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths, each slot with a row of its own."""
        fades = self._batch.fades(start, block, blocks)
        if fades is None:
            return None
        first = np.arange(len(fades.slot) + 1, dtype=np.int32)
        return Fades(fades.slot, fades.block, fades.start, fades.end, first, fades.slot, fades.block)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        import pyopencl as cl

        engine, count, length = self._engine, self._batch.count, self._plan.segment
        step = length * max(_BYTES // (4 * count * length), 1)
        for at in range(segment * length, end, step):
            stop = min(at + step, end)
            self._origin, self._stride, size = at, stop - at, 4 * count * (stop - at)
            self._pressure = engine._scratch.take("apart", size)
            cl.enqueue_fill_buffer(engine._queue, self._pressure, np.zeros(1, np.float32), 0, size)
            later = (at - segment * length) // block
            super()._render(nodes, at // length, stop, block, first_block + later)
            shape = count, stop - at
            made: Any = cl.enqueue_map_buffer(
                engine._queue, self._pressure, cl.map_flags.READ, 0, shape, np.dtype("f4")
            )[0]
            for i, pair in enumerate(self._batch.pairs):
                here = np.arange(count)[self._batch.of_pair(i)]
                here = here[~self._batch.padding[here]]
                engine.frames.add(pair, self._batch.path[here], made[here], self._start + at)
            made.base.release(engine._queue)


class EarEngine(OpenclEngine):
    """Renders the sound of each path at receivers' centres, and has it filtered."""

    run = _EarRun
    frames: EarFrames

    def filter(self, frames: EarFrames, begin: int, end: int) -> None:
        """Add paths that arrive at centres from a sample to another to frames."""
        self.frames = frames
        self.add(np.zeros((self._plan.row_count, end - begin), np.float32), begin)
