"""From the impulse responses of nodes to what is heard: transforms, filters, and the windows over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.kaiser import low_pass_between
from clsim.render.channel_grid import ChannelGrid, node_window, nodes_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.source_filters import SourceFilters

_STOPPED_DB = 100.0  # by which responses fall from the band's end to half the sampling rate: without it they ring long


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFilters:
    """Filters of a source's functions of frequency in a sampled channel."""

    filters: Floats  # (K, L), each through the low-pass beyond the band
    source: SourceFilters

    @classmethod
    def of(cls, source: SourceFilters) -> ChannelFilters:
        """Return the filters of a source."""
        rate = source.signal.sampling_rate
        taper = low_pass_between(source.band, 0.5 * rate, rate, _STOPPED_DB)
        return cls(np.stack([np.convolve(taps, taper) for taps in source.filters]), source)

    @property
    def ringing(self) -> int:
        """Samples by which a response rings to either side."""
        return int(self.filters.shape[1] // 2)

    def grid(self, shortest: float, longest: float, spacing: int) -> ChannelGrid:
        """Return the grid for delays between two bounds, s."""
        rate = self.source.signal.sampling_rate
        low, high = ((delay + self.source.start) * rate for delay in (shortest, longest))
        return ChannelGrid.between(low, high, self.ringing, spacing)


class ChannelFrames:
    """Adds what the responses of nodes make of one source's signal to a piece of the pressure."""

    def __init__(self, filters: ChannelFilters, grid: ChannelGrid, pressure: NDArray[Any], start: int) -> None:
        self.grid, self._pressure, self._start = grid, pressure, start
        self.nodes = nodes_of(start, start + pressure.shape[1], grid.spacing)
        real = pressure.dtype
        self._shaping = grid.shaping(filters.filters).astype(np.result_type(real, np.complex64))
        self._window = node_window(grid.spacing).astype(real)
        self._first = grid.needed(self.nodes[0])
        last = grid.needed(self.nodes[-1]) + grid.size
        self._emitted = filters.source.sounding(self._first, last).astype(real)

    def sounding(self, nodes: range) -> list[int]:
        """Return those of some nodes to whose windows something that sounds may contribute."""
        inside = range(max(nodes.start, self.nodes.start), min(nodes.stop, self.nodes.stop))
        return [node for node in inside if np.any(self._frame(node))]

    def _frame(self, node: int) -> NDArray[Any]:
        begin = self.grid.needed(node) - self._first
        return np.asarray(self._emitted[begin : begin + self.grid.size])

    def heard(self, nodes: Sequence[int], grids: NDArray[Any]) -> NDArray[Any]:
        """Return weighted samples (nodes, receivers, n) that responses (nodes, receivers, K, points) make."""
        from scipy.fft import irfft, rfft

        size, bins = self.grid.size, self.grid.size // 2 + 1
        spectra = rfft(grids)[..., :bins]
        response = spectra[:, :, 0] * self._shaping[0]
        for k in range(1, len(self._shaping)):
            response += spectra[:, :, k] * self._shaping[k]
        response *= rfft(np.stack([self._frame(node) for node in nodes]))[:, None]
        return np.asarray(irfft(response, size)[..., self.grid.span :][..., : len(self._window)] * self._window)

    def add(self, node: int, receivers: NDArray[np.integer[Any]], heard: NDArray[Any]) -> None:
        """Add a node's samples (receivers, n) to the pressure of receivers."""
        first, last = (at - self._start for at in self.grid.heard(node))
        begin, end = max(first, 0), min(last, self._pressure.shape[1])
        for row, samples in zip(receivers, heard, strict=True):
            self._pressure[row, begin:end] += samples[begin - first : end - first]
