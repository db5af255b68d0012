"""Sampled channels of ears: paths are spread over components of responses, whose filters stand behind the windows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.blas import with_blas_threads
from clsim.opencl.launch import work
from clsim.paths.family import PairPaths
from clsim.paths.propagation import NEAREST
from clsim.render.methods.channel_split import MOST_JUMPS
from clsim.render.methods.ear_components import LANES, EarComponents, Heads, towards
from clsim.render.methods.ear_responses import BEFORE, LAGRANGE, lagrange_weights
from clsim.render.opencl.channel_engine import ChannelEngine, ChannelRun
from clsim.render.opencl.host_nodes import side_by_side, thread_count
from clsim.render.plan import Plan
from clsim.scene.ends import Receiver, Source
from clsim.scene.motion.curves import Onward
from clsim.tracks.onward import turn_jumps
from clsim.tracks.tracks import SceneTracks, clock_time

_LEAST = 1e-6  # rad/s, by which directions turn at least
_STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])  # nodes between directions that are looked at
_LONGEST = 0.25  # s between directions that are looked at, at most: motions go on for a second beyond their ends
_EVALUATED = 64  # paths of which directions are worked out at a time
_PIECE = 2**26  # bytes of the sound of all components that are held at a time


class _Weights:
    """Weights of components for the paths of a receiver, at nodes: looked at as often as directions turn."""

    def __init__(
        self, components: EarComponents, paths: PairPaths, tracks: SceneTracks, spacing: float,
        turns: Floats, kinks: Floats,
    ) -> None:  # fmt: skip
        self._components, self._paths, self._tracks, self._spacing = components, paths, tracks, spacing
        self._kinks = kinks / spacing
        steps = np.maximum(np.minimum(components.ears.turn / turns, _LONGEST) / spacing, 1.0)
        self._step = _STEPS[np.searchsorted(_STEPS, steps, side="right") - 1]
        self._known: dict[int, dict[int, NDArray[np.float32]]] = {}

    def at(self, nodes: list[int]) -> NDArray[np.float32]:
        """Return the weights (nodes, P, room)."""
        out = np.zeros((len(nodes), len(self._paths), self._components.room), np.float32)
        count = len(self._components.shares)
        for step in np.unique(self._step).tolist():
            rows = np.flatnonzero(self._step == step)
            first = np.array(nodes) // step - BEFORE
            over = (self._kinks[:, :1] < step * (first + LAGRANGE)) & (self._kinks[:, 1:] > step * first)
            direct = np.any(over, axis=0) | (step == 1)
            if direct.any():
                at = np.flatnonzero(direct)
                out[np.ix_(at, rows, np.arange(count))] = self._found(rows, [nodes[i] for i in at])
            between = np.flatnonzero(~direct)
            known = self._coarse(rows, step, {k + i for k in first[between].tolist() for i in range(LAGRANGE)})
            shares = lagrange_weights(BEFORE + np.array(nodes) % step / step)
            for i in between.tolist():
                each = (known[int(first[i]) + k] * np.float32(shares[k, i]) for k in range(LAGRANGE))
                out[i, rows, :count] = sum(each)
        return out

    def _coarse(self, rows: NDArray[np.int64], step: int, wanted: set[int]) -> dict[int, NDArray[np.float32]]:
        """Return the weights (rows, M) of paths at nodes a step apart, by their number."""
        known = {k: own for k, own in self._known.get(step, {}).items() if k in wanted}
        new = sorted(wanted - known.keys())
        if new:
            known |= dict(zip(new, self._found(rows, [step * k for k in new]), strict=True))
        self._known[step] = known
        return known

    def _found(self, rows: NDArray[np.int64], nodes: list[int]) -> NDArray[np.float32]:
        """Return the weights (nodes, rows, M) of some paths."""
        times = self._spacing * np.array(nodes, dtype=np.float64)

        def found(part: NDArray[np.int64]) -> NDArray[np.float32]:
            to = towards(self._paths.part(part), self._tracks, times)
            return np.asarray(self._components.weights(to.swapaxes(0, 1)), np.float32)

        parts = [rows[i : i + _EVALUATED] for i in range(0, len(rows), _EVALUATED)]
        with with_blas_threads(1):
            return np.concatenate(side_by_side(found, parts), axis=1)


def _kinks(end: Source | Receiver) -> Floats:
    """Return times (k,) at which the motion of an end of continued tracks is not smooth, s."""
    motion = end.trajectory
    ends = [motion.curve.first, motion.curve.last] if isinstance(motion.curve, Onward) else []
    return np.concatenate([motion.breaks, turn_jumps(motion), ends])


class _EarRun(ChannelRun):
    """Spreads paths over the components of one receiver after the other."""

    _engine: EarChannelEngine

    def __post_init__(self) -> None:
        super().__post_init__()
        rate, batch = self._plan.sampling_rate, self._batch
        times = self._start / rate, (self._start + self._length) / rate
        self._weights = [
            self._engine.weights_of(pair, batch.path[batch.of_pair(i)], times) for i, pair in enumerate(batch.pairs)
        ]

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin, grid, threads = segment * self._plan.segment, self._task.frames.grid, thread_count()
        first, last = self._start + begin, self._start + end
        wanted = self._task.frames.active_nodes(range(-(-first // grid.spacing), -(-last // grid.spacing)))
        for i, receiver in enumerate(self._batch.receiver.tolist()):
            vectors = self._engine.heads.of[receiver].vectors(self._plan.source_filters[self._source].basis.sizes)
            of_node = LANES * grid.points * int(vectors.sum())
            step = threads * max(1, self._engine.at_once // (4 * threads * of_node))
            for some in (wanted[k : k + step] for k in range(0, len(wanted), step)):
                where = self._where(np.array(some) * grid.spacing - first, first, block, first_block)
                self._receive(nodes, some, where, i, vectors)

    def _receive(self, nodes: Any, some: list[int], where: dict[str, Any], i: int, vectors: NDArray[np.int32]) -> None:
        """Add the sound of the components of receiver i of the batch at some nodes."""
        import pyopencl as cl

        engine, frames, receiver = self._engine, self._task.frames, int(self._batch.receiver[i])
        ends = np.cumsum(frames.grid.points * LANES * vectors).tolist()
        grids = engine._scratch.take("components", 4 * len(some) * ends[-1])
        constants = self._spread_constants(nodes, -(-self._functions // 8) * 8)
        engine._compiler.kernel("components", constants)(
            engine._queue, work(len(some), group=1), delay=nodes.delay, polynomials=nodes.polynomials,
            slots=self._batch.count, functions=self._functions, **where,
            first_slot=int(self._batch.first_slot[i]), last_slot=int(self._batch.first_slot[i + 1]),
            weights=self._weights[i].at(some), room=engine.heads.of[receiver].room, vectors=vectors,
            **self._spreading(), points=frames.grid.points, grids=grids,
        )  # fmt: skip
        shape = len(some), ends[-1]
        mapped: Any = cl.enqueue_map_buffer(engine._queue, grids, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        sound, start = engine.sounds[receiver]
        spectra = frames.spectra(some)

        def received(node: int) -> NDArray[Any]:
            each = np.split(mapped[node], ends[:-1])
            return frames.received_components(spectra[node], [g.reshape(frames.grid.points, -1) for g in each])

        for node, samples in zip(some, side_by_side(received, range(len(some))), strict=True):
            first, stop = frames.grid.received(node)
            low, high = max(first, start), min(stop, start + len(sound))
            sound[low - start : high - start, : samples.shape[1]] += samples[low - first : high - first]
        mapped.base.release(engine._queue)


class EarChannelEngine(ChannelEngine):
    """Renders receivers with ears of a plan by their impulse responses at nodes, component by component."""

    run = _EarRun
    at_once = 2**26  # bytes of grids

    def __init__(self, plan: Plan, spacing: int, heads: Heads) -> None:
        super().__init__(plan, spacing)
        self.heads = heads
        self.sounds: dict[int, tuple[NDArray[np.float32], int]] = {}  # of components by receiver, and first sample

    def add_ears(self, first_rows: NDArray[np.int32], pressure: NDArray[Any], start: int) -> None:
        """Add what ears receive to the pressure (rows, n) from a sample on."""
        heads, stop = self.heads.of, start + pressure.shape[1]
        before, after = (max(getattr(c.ears, name) for c in heads.values()) for name in ("before", "after"))
        segment = self._plan.segment
        step = max(_PIECE // (4 * segment * sum(c.room for c in heads.values())), 1) * segment
        for first in range(start, stop, step):
            last = min(first + step, stop)
            low, count = first - after, last - first + before + after
            self.sounds = {r: (np.zeros((count, c.room), np.float32), low) for r, c in heads.items()}
            self.add(np.empty((1, count), np.float32), low)
            for r, c in heads.items():
                self.sounds[r][0][: max(-low, 0)] = 0.0  # the sum over paths begins at the first sample, too
                found = c.filtered(self.sounds[r][0])[:, after + c.ears.before :][:, : last - first]
                pressure[first_rows[r] : first_rows[r] + len(found), first - start : last - start] += found

    def weights_of(self, pair: int, rows: NDArray[np.int64], between: tuple[float, float]) -> _Weights:
        """Return the weights of some paths of a pair between two times, s."""
        tracks, spacing = self._plan.tracks.of_scene, self._spacing / self._plan.sampling_rate
        assert tracks is not None, "ears are those of scenes"
        paths = tracks.pair_paths[pair].part(rows)
        source, receiver = tracks.scene.sources[paths.source], tracks.scene.receivers[paths.receiver]
        low, high = (x[rows] for x in tracks.delay_range(pair, *between))
        departs, arrives = _kinks(source), clock_time(receiver, _kinks(receiver))
        kinks = np.concatenate([
            np.stack([departs + low.min(), departs + high.max()], axis=1), np.stack([arrives, arrives], axis=1)
        ])  # fmt: skip
        speed = tracks.speeds.source[paths.source] / (1.0 - tracks.max_rate(paths.source))
        speed += tracks.speeds.receiver[paths.receiver]
        turns = speed / np.maximum(low * tracks.scene.air.slowest, NEAREST) + receiver.trajectory.peak_turn + _LEAST
        if len(arrives) > MOST_JUMPS:
            turns += np.inf
        return _Weights(self.heads.of[paths.receiver], paths, tracks, spacing, turns, kinks)
