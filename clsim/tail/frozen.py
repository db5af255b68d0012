"""Tails of a scene that is frozen at an instant, as impulse responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.nufft import band_taper
from clsim.paths.impulse_response import ImpulseResponse
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.tail.design import find_tail
from clsim.tail.noise import at_one_place, combined, gains_of, plane_waves, static_gains
from clsim.tail.zones import Zones

if TYPE_CHECKING:
    from clsim.paths.impulse_response import ResponseBand
    from clsim.paths.path_set import PathSet
    from clsim.tail.design import SourceTail, TailOptions
    from clsim.tail.noise import Responses


def frozen_tails(
    paths: PathSet, source: int, at: float, sampling_rate: float, band: ResponseBand, options: TailOptions
) -> tuple[list[ImpulseResponse], SourceTail]:
    """Return the tail of a source at every row of the receivers at a time, s, within a band, and what it is made of."""
    scene = paths.scene
    receivers = Zones.frozen(scene.receivers, scene.room, at, beams=False)
    zones = Zones.frozen([scene.sources[source]], scene.room, at, beams=True), receivers
    tail = find_tail(scene, source, (band.low, band.high), zones, options)
    several = [isinstance(r.directivity, ChannelDirectivity) for r in scene.receivers]
    counts = [len(r.directivity.channels) for r in scene.receivers]
    first_row = np.cumsum([0, *counts])
    places = np.concatenate([r.trajectory.position(np.array([at])) for r in scene.receivers])
    nearest = np.linalg.norm(places[:, None] - receivers.centres, axis=2).argmin(axis=1)
    found: dict[int, ImpulseResponse] = {}
    for zone in np.unique(nearest):
        here = np.flatnonzero(nearest == zone)
        key = 0, int(zone)
        rows = [int(first_row[r]) + channel for r in here.tolist() for channel in range(counts[r])]
        if len(here) == 1 and not several[int(here[0])]:
            weights = np.square(gains_of(scene, here.tolist(), tail, at)[0])
            made = at_one_place(tail, key, source, sampling_rate, weights, moves=False)
        else:
            late = -(places[here] - receivers.centres[zone]) @ tail.arrivals.T / scene.air.speed_of_sound
            late = np.repeat(late, [counts[r] for r in here.tolist()], axis=0)
            gains = static_gains(scene, here.tolist(), tail, at, sampling_rate)
            waves = plane_waves(tail, key, source, sampling_rate, moves=False)
            made = combined(waves, late, gains, tail.centres, sampling_rate)
        found |= dict(zip(rows, _cut(made, sampling_rate, band), strict=True))
    return [found[row] for row in range(int(first_row[-1]))], tail


def _cut(made: Responses, rate: float, band: ResponseBand) -> list[ImpulseResponse]:
    """Return responses cut to a band; what rings before time 0 is not kept."""
    from scipy.fft import irfft, next_fast_len, rfft

    ringing = int(band.ringing * rate)
    count = made.taps.shape[1] + ringing
    size = next_fast_len(count + ringing, real=True)
    frequencies = np.arange(size // 2 + 1, dtype=np.float64) * (rate / size)
    taper = band_taper(frequencies, band.low, band.high, band.below, band.above)
    taps = irfft(rfft(made.taps.astype(np.float64), size) * taper, size)
    return [ImpulseResponse(0, row[made.lead : count]) for row in np.asarray(taps)]
