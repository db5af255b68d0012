"""Tracks computed on the device, in float64, from the images of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.geometry import rotate
from clsim.opencl.device import upload
from clsim.paths.arrivals import MACH_EXPONENT
from clsim.paths.motion_knots import KNOT_COLUMNS, knot_rate, motion_knots
from clsim.render.plan import SEGMENT, Plan, node_times
from clsim.scene.directivity import Directivity, Omni

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.opencl.device import Compiler
    from clsim.render.edges import Boundaries
    from clsim.render.slots import Slots
    from clsim.render.tracks import SceneTracks

_CELLS = 1024  # of a beam, over the cosine; its cubics are within 1e-9 for a piston of ka = 10
_AXIS = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class DeviceNodes:
    """Block polynomials of a run on the device, and what was found while they were made."""

    delay: Any
    cubics: Any
    error: Floats  # (segments,), relative to the strongest arrival of each receiver
    shortest: float  # s
    longest: float


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    """What one source and a batch of receivers need over a chunk, on the device."""

    source: int
    slots: Slots
    images: tuple[Any, ...]
    bounds: Boundaries
    knots: Any
    knot_count: int
    knot_first: float


class DeviceTracks:
    """Makes block polynomials with ``tracks.cl``."""

    def __init__(self, plan: Plan, tracks: SceneTracks, queue: Any, compiler: Compiler) -> None:
        self._plan, self._tracks, self._queue, self._compiler = plan, tracks, queue, compiler
        scene = tracks.scene
        self._knot_rates = []
        for source, emission in zip(scene.sources, plan.emissions, strict=True):
            # A position wrong by this much is wrong in phase by half the asked error at the band's end.
            error_db = getattr(plan.interpolator, "error_db", -90.0)
            tolerance = 10 ** ((error_db - 6.0) / 20) * scene.air.sound_speed / (2.0 * math.pi * emission.band)
            self._knot_rates.append(
                knot_rate(source, min(emission.signal.duration + source.start, plan.duration), tolerance)
            )
        frequencies = [emission.basis.nodes for emission in plan.emissions]
        c = scene.air.sound_speed
        self._source_beams = [
            self._upload(_beam_cells(s.directivity, f, c)) for s, f in zip(scene.sources, frequencies, strict=True)
        ]
        # One receiver beam per launch: receivers with different beams are told apart by a table each.
        self._receiver_tables = [[_beam_cells(r.directivity, f, c) for r in scene.receivers] for f in frequencies]
        self._projections = [self._upload(e.basis.projection.astype(np.float32)) for e in plan.emissions]
        self._nepers = [
            self._upload((scene.air.absorption(f) * math.log(10.0) / 20.0).astype(np.float32)) for f in frequencies
        ]

    def prepare(self, source: int, slots: Slots, bounds: Boundaries, start: int, length: int) -> _Chunk:
        """Upload images and motion for one source and a batch of receivers over a stretch of samples."""
        plan, scene = self._plan, self._tracks.scene
        matrix = np.empty((9, slots.count))
        offset = np.empty((3, slots.count))
        basis = plan.emissions[source].basis
        reflection = np.empty((len(basis.nodes), slots.count), dtype=np.float32)
        receiver_of = np.empty(slots.count, dtype=np.int32)
        for i, index in enumerate(slots.groups):
            here, paths = slots.of_group(i), self._tracks.path_groups[index]
            rows = slots.path[here]
            matrix[:, here] = paths.matrix[rows].reshape(-1, 9).T
            offset[:, here] = paths.offset[rows].T
            reflection[:, here] = np.where(slots.filling[here], 0.0, paths.part(rows).reflections(scene, basis.nodes).T)
            receiver_of[here] = i
        rate = plan.sampling_rate
        longest, shortest = slots.longest, min(0.0, slots.shortest)  # below 0 s by a receiver's own clock
        knots, first = motion_knots(
            scene.sources[source], start / rate - longest - 0.01 * abs(longest) - 0.05,
            (start + length) / rate - shortest + 0.05,
            self._knot_rates[source],
        )  # fmt: skip
        images = tuple(self._upload(a) for a in (matrix, offset, reflection, receiver_of))
        return _Chunk(source, slots, images, bounds, self._upload(knots), len(knots), first)

    def nodes(self, chunk: _Chunk, start: int, block: int, blocks: int) -> DeviceNodes:
        """Make the polynomials of `blocks` blocks from a sample on."""
        import pyopencl as cl

        plan, scene, slots = self._plan, self._tracks.scene, chunk.slots
        emission = plan.emissions[chunk.source]
        rate, c = plan.sampling_rate, scene.air.sound_speed
        walks = -(-blocks * block // SEGMENT)
        context, flags = self._queue.context, cl.mem_flags.READ_WRITE
        delay = cl.Buffer(context, flags, 4 * blocks * slots.count)
        cubics = cl.Buffer(context, flags, 16 * (1 + len(emission.basis)) * blocks * slots.count)
        found = np.empty((walks, slots.count, 4), dtype=np.float32)
        on_device = cl.Buffer(context, flags, found.nbytes)
        receivers = self._receivers_at(slots, node_times(start, block, blocks, rate))
        beams = [self._receiver_tables[chunk.source][r] for r in slots.receiver]
        kernel = self._compiler.kernel("tracks", self._constants(chunk.source, block))
        kernel(
            self._queue, (slots.count, walks), None, *chunk.images,
            *(self._upload(samples) for samples in chunk.bounds.samples_from(start)), self._upload(receivers),
            np.int32(blocks + 3), chunk.knots, np.int32(chunk.knot_count), np.float64(chunk.knot_first),
            np.float64(self._knot_rates[chunk.source]), np.float64(start / rate), np.float64(rate), np.float64(c),
            self._nepers[chunk.source], self._projections[chunk.source],
            np.float64(emission.start * rate - emission.bank.shift), np.float64(emission.start),
            np.float64(emission.start + emission.signal.duration), np.float32(2.0 * math.pi * emission.band),
            self._source_beams[chunk.source], self._upload(np.concatenate(beams)), np.int32(blocks), delay, cubics,
            on_device,
        )  # fmt: skip
        cl.enqueue_copy(self._queue, found, on_device)
        return DeviceNodes(
            delay,
            cubics,
            _relative_error(found, slots),
            float(found[..., 2].min()),
            float(found[..., 3].max()),
        )

    def _constants(self, source: int, block: int) -> dict[str, int]:
        scene, retarded = self._tracks.scene, self._tracks.motion == "retarded"
        return {
            "BLOCK": block,
            "WALK": SEGMENT // block,
            "FUNCTIONS": len(self._plan.emissions[source].basis),
            "NODES": len(self._plan.emissions[source].basis.nodes),
            "KNOT_COLUMNS": KNOT_COLUMNS,
            "CELLS": _CELLS,
            "RETARDED": int(retarded),
            "MACH_EXPONENT": MACH_EXPONENT[self._tracks.amplitude] if retarded else 0,
            "SOURCE_BEAM": int(not isinstance(scene.sources[source].directivity, Omni)),
            "RECEIVER_BEAM": int(any(not isinstance(r.directivity, Omni) for r in scene.receivers)),
        }

    def _receivers_at(self, slots: Slots, times: Floats) -> Floats:
        """Return position, velocity, axis and clock of the batch's receivers at the nodes, (receivers, nodes, 11)."""
        out = np.empty((len(slots.groups), len(times), 11))
        for i, r in enumerate(slots.receiver):
            receiver = self._tracks.scene.receivers[r]
            ahead = receiver.clock_ahead(times)
            out[i, :, :3] = receiver.trajectory.position(times + ahead)
            out[i, :, 3:6] = receiver.trajectory.velocity(times + ahead)
            out[i, :, 6:9] = rotate(receiver.orientation(times + ahead), _AXIS)
            out[i, :, 9], out[i, :, 10] = ahead, receiver.pace
        return out

    def _upload(self, array: NDArray[Any]) -> Any:
        return upload(self._queue.context, array)


def _relative_error(found: NDArray[np.float32], slots: Slots) -> Floats:
    """Return the largest error of each segment, relative to the strongest arrival of the same receiver."""
    first = slots.first_slot[:-1]
    error = np.sqrt(np.maximum.reduceat(found[:, :, 0], first, axis=1))
    strongest = np.maximum.reduceat(found[:, :, 1], first, axis=1)
    return np.asarray((error / np.maximum(strongest, 1e-30)).max(axis=1), dtype=np.float64)


def _beam_cells(directivity: Directivity, frequencies: Floats, speed_of_sound: float) -> NDArray[np.float32]:
    """Return a beam as cubics on equal cells of the cosine, lowest power first, (cells, frequencies, 4)."""
    from scipy.interpolate import CubicSpline

    cosine = np.linspace(-1.0, 1.0, _CELLS + 1)
    half = _CELLS // 2  # two splines: the gain of a piston bends at 90°
    parts = []
    for piece in (slice(0, half + 1), slice(half, _CELLS + 1)):
        gain = np.broadcast_to(
            directivity.gain(cosine[piece][:, None], frequencies, speed_of_sound), (half + 1, len(frequencies))
        )
        width = (2.0 / _CELLS) ** np.arange(4)
        parts.append(np.moveaxis(CubicSpline(cosine[piece], gain).c[::-1], 0, -1) * width)
    return np.ascontiguousarray(np.concatenate(parts), dtype=np.float32)
