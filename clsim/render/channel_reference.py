"""Sampled channels in NumPy, float64: the definition of right for the engine that scatters on a device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.render.channel_frames import ChannelFilters, ChannelFrames
from clsim.render.channel_grid import spread

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.render.plan import ChannelPart


def reference_channels(part: ChannelPart, start: int, stop: int) -> Floats:
    """Return the pressure (rows, stop - start) of the pairs of a part, Pa, with delays and gains at every node."""
    plan, rate = part.plan, part.plan.sampling_rate
    filters = plan.source_filters[part.source]
    channel, pressure = ChannelFilters.of(filters), np.zeros((plan.row_count, stop - start))
    ranges = [plan.tracks.delay_range(pair, start / rate - 1.0, stop / rate + 1.0) for pair in part.pairs]
    low, high = min(float(low.min()) for low, _ in ranges), max(float(high.max()) for _, high in ranges)
    frames = ChannelFrames(channel, channel.grid(low, high, part.spacing), pressure, start)
    nodes = frames.sounding(frames.nodes)
    for pair in part.pairs if nodes else ():
        delay, _, gain = plan.tracks.evaluate(pair, np.array(nodes) * (part.spacing / rate), filters.basis)
        places = frames.grid.places((delay + filters.start) * rate)
        for i, node in enumerate(nodes):
            grid = spread(places[:, i], gain[0, :, :, i], frames.grid.points)[None, None]
            frames.add(node, np.array([plan.rows_of_pair(pair).start]), frames.heard([node], grid)[0])
    return pressure
