"""Pairs of source and receiver that never move: one impulse response each, convolved with the emitted signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.impulse_response import ImpulseResponse, ResponseBand, frozen_response
from clsim.render.interpolator import Bandlimited
from clsim.scene.directivity.patterns import Omni
from clsim.scene.signal.occupied_bandwidth import shares
from clsim.tracks.tracks import SceneTracks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.render.interpolator import Interpolator
    from clsim.render.plan import Plan
    from clsim.render.source_filters import SourceFilters
    from clsim.scene.scene import Receiver, Source
    from clsim.tracks.tracks import Tracks

_WIDEST = 0.95  # of Nyquist
_SHARE = 1e-12  # of a signal's energy that may lie beyond the band to either side
_LOWEST = 0.02  # of the sampling rate, below which a band goes on down to 0 Hz: an edge there would ring for long
_LOWEST_COMPLEX = 1e-3  # the same for complex responses, which may bend at 0 Hz


@dataclass(frozen=True, slots=True)
class StaticPairs:
    """Which groups of paths are convolved, by their indices.

    Attributes
    ----------
    groups : frozenset of int
        Indices among the tracks' groups.
    at_centre : bool
        Whether air, walls and beams are those at the centre frequency of the source's signal.
    """

    groups: frozenset[int] = frozenset()
    at_centre: bool = False

    def holds(self, tracks: Tracks, source: int) -> bool:
        """Return whether all paths of a source are convolved, and there are some."""
        mine = {i for i, group in enumerate(tracks.groups) if group.source == source}
        return bool(mine) and mine <= self.groups

    def describe(self, tracks: Tracks) -> list[str]:
        """Return what is convolved, a line or none."""
        if not self.groups:
            return []
        return [f"{len(self.groups)} of {len(tracks.groups)} pairs never move: impulse responses, convolved"]


NO_STATIC_PAIRS = StaticPairs()


def find_static_pairs(tracks: Tracks, interpolator: Interpolator, *, at_centre: bool) -> StaticPairs:
    """Return the groups of paths that never change.

    Neither end moves, no clock drifts, no path begins or ends, and no beam turns. A delay filter that is asked for by
    name (Lagrange) is used for all paths.
    """
    if not isinstance(tracks, SceneTracks) or not isinstance(interpolator, Bandlimited):
        return NO_STATIC_PAIRS
    scene, found = tracks.scene, []
    for i, group in enumerate(tracks.groups):
        source, receiver = scene.sources[group.source], scene.receivers[group.receiver]
        if tracks.pair_paths[i].family.moves:
            continue
        if _is_static(source) and _is_static(receiver) and receiver.clock_rate == 1.0 and group.always_heard:
            found.append(i)
    return StaticPairs(frozenset(found), at_centre)


def _is_static(end: Source | Receiver) -> bool:
    return end.trajectory.is_static and (isinstance(end.directivity, Omni) or not end.trajectory.turns)


class Convolution:
    """Renders the pairs of a plan that are at rest."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._responses: dict[int, list[tuple[int, ImpulseResponse]]] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add what is heard from sample `start` on to the pressure (receivers, n) in Pa."""
        if self._plan.static_pairs.groups and not self._responses:
            self._responses = {
                source: _responses(self._plan, source) for source in range(len(self._plan.source_filters))
            }
        stop = start + pressure.shape[1]
        for source, responses in self._responses.items():
            if not responses:
                continue
            last = max(response.last for _, response in responses)
            first = min(response.first for _, response in responses)
            emitted = self._plan.source_filters[source].emitted(start - last, stop - first)
            if not np.any(emitted):
                continue
            for receiver, response in responses:
                pressure[receiver] += _convolved(emitted[last - response.last :], response, stop - start)


def _responses(plan: Plan, source: int) -> list[tuple[int, ImpulseResponse]]:
    """Return receivers and impulse responses of a source."""
    tracks, filters = plan.tracks, plan.source_filters[source]
    assert isinstance(tracks, SceneTracks)
    centre = filters.signal.centre_frequency if plan.static_pairs.at_centre else None
    rate = filters.signal.sampling_rate
    band, found = _band(filters, complex_responses=tracks.paths.is_complex), []
    for i in sorted(plan.static_pairs.groups):
        pair = tracks.pair_paths[i]
        if pair.source == source:
            ahead = float(tracks.scene.receivers[pair.receiver].clock_error(np.zeros(1))[0])
            response = frozen_response(pair, 0.0, rate, band, later=filters.start - ahead, centre=centre)
            found.append((pair.receiver, filters.acting(response)))
    return found


def _band(filters: SourceFilters, *, complex_responses: bool) -> ResponseBand:
    """Return the band that holds a signal, with edges as wide as there is room, so that arrivals are short."""
    rate = filters.signal.sampling_rate
    low, high = np.clip(shares(filters.signal.energy_spectrum(), _SHARE), *filters.held)
    high = min(max(high, 0.025 * rate), max(0.5 * _WIDEST * rate, filters.band))
    low, above = min(low, high), 0.5 * rate - high
    least = (_LOWEST_COMPLEX if complex_responses else _LOWEST) * rate
    return ResponseBand(low, high, low if low >= least else 0.0, above)


def _convolved(emitted: NDArray[Any], response: ImpulseResponse, count: int) -> NDArray[Any]:
    """Return samples (count,) of a response to what was emitted from as many samples before as it is long."""
    from scipy.signal import oaconvolve

    taps = response.taps
    heard = emitted[: count + len(taps) - 1]
    out, sounding = np.zeros(count, dtype=heard.dtype), np.flatnonzero(heard)
    if not len(sounding):
        return out
    begin, end = int(sounding[0]), int(sounding[-1]) + 1
    whole = oaconvolve(heard[begin:end], taps)
    first, last = max(begin - len(taps) + 1, 0), min(end, count)
    out[first:last] = whole[first + len(taps) - 1 - begin : last + len(taps) - 1 - begin]
    # Where nothing sounds there is silence, without the rounding of the transforms.
    sounded = np.concatenate([[0], np.cumsum(heard != 0.0)])
    out[sounded[len(taps) :] == sounded[:count]] = 0.0
    return out
