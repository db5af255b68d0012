"""Components of the responses of ears: functions of direction with a filter for each, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.blas import with_blas_threads
from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.family import PairPaths
from clsim.paths.response import to_transducer_frame
from clsim.render.channel_grid import COARSER, FINER, NODES, ChannelFilters
from clsim.render.methods.costs import measured_costs
from clsim.render.methods.ear_responses import EarResponses, ear_responses
from clsim.render.opencl.host_nodes import side_by_side
from clsim.render.source_filters import Emission, SourceFilters
from clsim.scene.scene import Scene
from clsim.tracks.tracks import SceneTracks

LANES = 8  # components side by side
_DIRECTIONS = 2500  # evenly over the sphere, whose responses tell the components
_LEFT_OUT_DB = -112.0  # of all responses, and of what functions of frequency make of them
_FREQUENCIES = 3.0  # times as many numbers as components, from which their weights follow
_BLOCK = 4  # times the length of responses that are filtered at a time


@dataclass(frozen=True, slots=True, eq=False)
class EarComponents:
    """Real functions of direction, and filters of each channel for them, whose products sum up to responses."""

    ears: EarResponses
    step: float  # Hz, between frequencies that tell the weights of components
    fade: Floats  # (F,) by which responses fade out there
    projection: NDArray[np.float32]  # (C F 2, M) of spectra as pairs of numbers
    shares: Floats  # (M,) of each component in all responses, root mean square
    taps: Floats  # (M, C, L) from `ears.before` samples before the centre's time on

    @property
    def room(self) -> int:
        """Components in whole vectors."""
        return -(-len(self.shares) // LANES) * LANES

    def weights(self, directions: Floats) -> Floats:
        """Return the weights (..., M) of components by direction (..., 3)."""
        found = np.ascontiguousarray(self.ears.at_multiples(directions, self.step, self.fade))
        return np.asarray(found.reshape(*found.shape[:-2], -1).view(np.float32) @ self.projection)

    def vectors(self, sizes: Floats) -> NDArray[np.int32]:
        """Return the vectors of components (K,) that functions of frequency need, by their sizes."""
        left = np.sqrt(np.cumsum(self.shares[::-1] ** 2)[::-1])
        level = 10 ** (_LEFT_OUT_DB / 20) / math.sqrt(len(sizes))
        counts = np.count_nonzero(np.outer(sizes, left) > level, axis=1)
        return np.asarray(np.maximum(-(-counts // LANES), 1), dtype=np.int32)

    def filtered(self, sound: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sound (C, n + L - 1) of channels from that of components (n, M)."""
        from scipy.fft import irfft, next_fast_len, rfft

        length = self.taps.shape[2]
        block = _BLOCK * length
        size = next_fast_len(block + length - 1, real=True)
        filters = rfft(self.taps.astype(np.float32), size).transpose(1, 2, 0)  # (C, F, M)
        out = np.zeros((len(filters), len(sound) + length - 1), np.float32)

        def made(first: int) -> NDArray[np.float32]:
            spectra = rfft(sound[first : first + block, : len(self.shares)], size, axis=0)
            return irfft(np.einsum("fm,cfm->cf", spectra, filters), size).astype(np.float32)

        firsts = range(0, len(sound), block)
        for first, received in zip(firsts, side_by_side(made, firsts), strict=True):
            own = out[:, first : first + size]
            own += received[:, : own.shape[1]]
        return out


@lru_cache(maxsize=32)
def ear_components(ears: EarResponses) -> EarComponents:
    """Return the components of responses, in falling order, by the singular vectors of those all around."""
    from scipy.fft import irfft, next_fast_len
    from scipy.linalg import eigh

    length = ears.before + ears.after + 1
    size = next_fast_len(length, real=True)
    step, fade = ears.fade(size)
    found = ears.at_multiples(fibonacci_sphere(_DIRECTIONS), step, fade)
    channels = found.shape[1]
    flat = np.ascontiguousarray(found).reshape(len(found), -1).view(np.float64)
    squares, level = flat.T @ flat, 10 ** (_LEFT_OUT_DB / 10)
    whole = float(np.trace(squares))
    # All of those below this bound are left out: together they add less than the level.
    powers, axes = eigh(squares, subset_by_value=(level * whole / len(squares), np.inf), overwrite_a=True)
    powers, axes = powers[::-1], axes[:, ::-1]
    left = whole - np.cumsum(powers) + powers  # of each and all behind it
    count = int(np.count_nonzero(left > level * whole))
    spectra = np.ascontiguousarray(axes[:, :count].T).view(np.complex128).reshape(count, channels, -1)
    taps = np.roll(irfft(spectra, size), ears.before, axis=-1)[..., :length]
    every = max(int(2 * channels * len(fade) / (_FREQUENCIES * count)), 1)  # fewer frequencies tell the weights
    values = np.ascontiguousarray(spectra[..., ::every]).reshape(count, -1).view(np.float64)
    projection = np.linalg.pinv(values).astype(np.float32)
    shares = np.sqrt(powers[:count] / whole)
    return EarComponents(ears, every * step, fade[::every].astype(np.float32), projection, shares, taps)


@dataclass(frozen=True, slots=True, eq=False)
class Heads:
    """Components of receivers, by their index, for a band; what they cost."""

    of: Mapping[int, EarComponents]

    @classmethod
    def among(cls, scene: Scene, tracks: SceneTracks, filters: Sequence[SourceFilters], rate: float) -> Heads:
        """Return those of the receivers of tracks, by their responses in a scene, for the bands of filters."""
        band = max(f.band for f in filters) * (1.0 + max(tracks.max_rate(i) for i in range(tracks.source_count)))
        c, receivers = scene.air.speed_of_sound, sorted({pair.receiver for pair in tracks.pairs})
        with with_blas_threads(1):
            made = (ear_responses(scene.receivers[r].directivity, c, rate, band) for r in receivers)
            return cls(dict(zip(receivers, map(ear_components, made), strict=True)))

    def responses(self, paths: PairPaths, tracks: SceneTracks, times: Floats, frequency: float) -> Complexes:
        """Return responses (C, P, T) of a receiver's channels at a frequency, Hz."""
        ears, at = self.of[paths.receiver].ears, np.clip(frequency, *self.of[paths.receiver].ears.directivity.band)
        return np.moveaxis(ears.directivity.gain_towards(towards(paths, tracks, times), at, ears.speed_of_sound), -1, 0)

    def cost_of_path(self, filters: SourceFilters) -> float:
        """Processor time of a path in a sample that is filtered by itself, ns."""
        return filters.cost() + measured_costs().ear

    def cost_at_nodes(
        self, filters: SourceFilters, counts: tuple[float, float, int], spacing: int, longest: float, until: float
    ) -> float:
        """Return the processor time of sampled channels, ns; see `work_at_nodes`.

        Directions take as long otherwise. The components are there: `may_be_cheaper` weighs the time to find them.
        """
        known, (paths, _, _), samples = measured_costs(), counts, until * filters.rate
        nodes = samples / spacing + 2 * NODES
        points = ChannelFilters.of(filters).grid(0.0, longest, spacing).size
        spread = [LANES * int(c.vectors(filters.basis.sizes).sum()) for c in self.of.values()]
        room = sum(c.room for c in self.of.values())
        each = known.channel_path + known.ear_component * max(spread)
        transforms = points * (FINER / COARSER * sum(spread) + room) * known.ear_point
        return nodes * (paths * each + transforms) + samples * room * known.ear_filter


def may_be_cheaper(emission: Emission, filters: SourceFilters, pairs: list[int]) -> bool:
    """Test whether the sum over paths takes longer than to find components."""
    known, ends, until = measured_costs(), (emission.tracks.pairs[i] for i in pairs), emission.until
    seconds = sum(float(np.sum(np.clip(m.end, 0.0, until) - np.clip(m.start, 0.0, until))) for m in ends)
    return (filters.cost() + known.ear) * filters.rate * seconds > known.ear_planned


def towards(paths: PairPaths, tracks: SceneTracks, times: Floats) -> Floats:
    """Return directions (P, n, 3) of arrival in the receiver's frame, at times by its clock, s."""
    receiver = tracks.scene.receivers[paths.receiver]
    now = times + receiver.clock_error(times)
    return to_transducer_frame(receiver.orientation, now, paths.arrivals(now, tracks.kinematics).arrival)
