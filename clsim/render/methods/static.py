"""Pairs of source and receiver at rest: one impulse response each, convolved with the emitted signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.numerics.convolution import convolved
from clsim.paths.channel import ImpulseResponse, ResponseBand, frozen_responses
from clsim.render.contributions import Stateless, digest_of
from clsim.render.interpolator import Bandlimited
from clsim.render.options import RenderOptions
from clsim.render.plan import Plan
from clsim.render.source_filters import SourceFilters
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver, Source
from clsim.scene.signal.occupied_bandwidth import shares
from clsim.tracks.tracks import Tracks

_WIDEST = 0.95  # of Nyquist
_SHARE = 1e-12  # of a signal's energy that may lie beyond the band to either side
_LOWEST = 0.02  # of the sampling rate, below which a band goes on down to 0 Hz: an edge there would ring for long
_LOWEST_COMPLEX = 1e-3  # the same for complex responses, which may bend at 0 Hz


def pairs_at_rest(tracks: Tracks, options: RenderOptions) -> frozenset[int]:
    """Return the indices of the pairs that `can` be convolved, which this method claims."""
    return frozenset(i for i in range(len(tracks.pairs)) if can(tracks, options, i) is None)


def can(tracks: Tracks, options: RenderOptions, pair: int) -> str | None:
    """Return the reason against convolving a pair, by its index; None if there is none."""
    of_scene = tracks.of_scene
    if of_scene is None:
        return "tracks without a scene"
    if not options.convolve_static or options.engine != "opencl" or not isinstance(options.interpolator, Bandlimited):
        return "every path is rendered by the requested delay filter"
    scene, member = of_scene.paths.scene, tracks.pairs[pair]
    source, receiver = scene.sources[member.source], scene.receivers[member.receiver]
    if not (_is_static(source) and _is_static(receiver)) or of_scene.pair_paths[pair].family.moves:
        return "it moves or turns"
    if receiver.clock_rate != 1.0:
        return "its clock drifts"
    return None if member.always_audible else "paths begin or end"


def _is_static(end: Source | Receiver) -> bool:
    return end.trajectory.is_static and (isinstance(end.directivity, Omni) or not end.trajectory.turns)


@dataclass(frozen=True, slots=True, eq=False)
class StaticConvolution:
    """Emitted signals, convolved with the impulse responses of static pairs."""

    plan: Plan  # of the whole
    name: ClassVar[str] = "static pairs"

    @property
    def pairs(self) -> tuple[int, ...]:
        """Indices of the pairs among the tracks' pairs."""
        return tuple(sorted(self.plan.allocation.convolved))

    @property
    def at_centre(self) -> bool:
        """Whether air, walls and directivities are those at the centre frequency of the source's signal."""
        return self.plan.options.responses == "centre"

    def describe(self) -> list[str]:
        return [f"{len(self.pairs)} of {len(self.plan.tracks.pairs)} pairs never move: impulse responses, convolved"]

    def digest(self) -> str:
        filters = (filters.digest() for filters in self.plan.source_filters)
        return digest_of(repr((self.pairs, self.at_centre)), *filters)

    def begin(self) -> _Convolution:
        return _Convolution(self)

    def responses(self, source: int) -> list[tuple[int, ImpulseResponse]]:
        """Return rows of the pressure and impulse responses of a source."""
        filters, tracks = self.plan.source_filters[source], self.plan.tracks.of_scene
        assert tracks is not None, "only pairs of scenes are claimed"
        centre = filters.signal.centre_frequency if self.at_centre else None
        rate = filters.signal.sampling_rate
        band, found = _band(filters, complex_responses=tracks.paths.is_complex), []
        for i in self.pairs:
            pair = tracks.pair_paths[i]
            if pair.source == source:
                clock_error = float(tracks.scene.receivers[pair.receiver].clock_error(np.zeros(1))[0])
                later = filters.start - clock_error
                row = self.plan.rows_of_pair(i).start
                for channel, made in enumerate(frozen_responses(pair, 0.0, rate, band, later=later, centre=centre)):
                    found.append((row + channel, filters.acting(made)))
        return found


class _Convolution(Stateless):
    """Adds a convolution; the responses are made when the first piece asks for them."""

    def __init__(self, what: StaticConvolution) -> None:
        self._what = what
        self._responses: dict[int, list[tuple[int, ImpulseResponse]]] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        all_filters = self._what.plan.source_filters
        if not self._responses:
            self._responses = {source: self._what.responses(source) for source in range(len(all_filters))}
        stop = start + pressure.shape[1]
        for source, responses in self._responses.items():
            if not responses:
                continue
            last = max(response.last for _, response in responses)
            first = min(response.first for _, response in responses)
            emitted = all_filters[source].emitted(start - last, stop - first)
            if not np.any(emitted):
                continue
            for row, response in responses:
                pressure[row] += _convolved(emitted[last - response.last :], response, stop - start)


def _band(filters: SourceFilters, *, complex_responses: bool) -> ResponseBand:
    """Return the band of a signal, with the widest possible edges, so that arrivals are short."""
    rate = filters.signal.sampling_rate
    low, high = np.clip(shares(filters.signal.energy_spectrum(), _SHARE), *filters.held)
    high = min(max(high, 0.025 * rate), max(0.5 * _WIDEST * rate, filters.band))
    low, above = min(low, high), 0.5 * rate - high
    least = (_LOWEST_COMPLEX if complex_responses else _LOWEST) * rate
    return ResponseBand(low, high, low if low >= least else 0.0, above)


def _convolved(emitted: NDArray[Any], response: ImpulseResponse, count: int) -> NDArray[Any]:
    """Return samples (count,) of a response to what was emitted from as many samples before as it is long."""
    taps = response.taps
    sent = emitted[: count + len(taps) - 1]
    out, active = np.zeros(count, dtype=sent.dtype), np.flatnonzero(sent)
    if not len(active):
        return out
    begin, end = int(active[0]), int(active[-1]) + 1
    short, long = sorted((sent[begin:end], taps), key=len)
    whole = convolved(long, short)
    first, last = max(begin - len(taps) + 1, 0), min(end, count)
    out[first:last] = whole[first + len(taps) - 1 - begin : last + len(taps) - 1 - begin]
    # Where nothing sounds there is silence, without the rounding of the transforms.
    active_before = np.concatenate([[0], np.cumsum(sent != 0.0)])
    out[active_before[len(taps) :] == active_before[:count]] = 0.0
    return out
