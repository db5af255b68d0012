"""The contribution of narrow parts: complex envelopes at a low rate, made sound once for each receiver."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.render.blas_threads import with_blas_threads
from clsim.render.contributions import Stateless
from clsim.render.methods.per_sample import PathSum
from clsim.render.opencl.baseband_engine import BasebandEngine

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Complexes
    from clsim.render.plan import NarrowPart, Plan

_AHEAD = 64  # samples of the envelope before the first one of the sound: for upsampling, in whole subblocks


def build(plan: Plan) -> NarrowParts:
    """Make the contribution of a plan's narrow parts."""
    return NarrowParts(plan.allocation.narrow)


@dataclass(frozen=True, slots=True, eq=False)
class NarrowParts:
    """Contribution of the signals that are rendered as envelopes and upsampled."""

    parts: tuple[NarrowPart, ...]  # one for each carrier

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "narrow parts"

    def describe(self) -> list[str]:
        """Describe the rendering of each, some lines."""
        return [line for part in self.parts for line in _described(part)]

    def digest(self) -> str:
        """Return a text that changes with their options and with any tap."""
        found = hashlib.sha256()
        for part in self.parts:
            found.update(repr((part.plan.baseband, part.sources)).encode() + part.upsampler.taps.tobytes())
            found.update(PathSum(part.plan).digest().encode())
        return found.hexdigest()

    def begin(self) -> _Adding:
        """Return an object that adds them."""
        return _Adding(self.parts)


def _described(part: NarrowPart) -> list[str]:
    baseband, summed, lines = part.plan.baseband, PathSum(part.plan), []
    assert baseband is not None
    for i in part.sources:
        filters, here = part.plan.source_filters[i], f"source {i}, narrow part"
        reach = (filters.half_length + part.upsampler.reach) / part.plan.sampling_rate
        lines += [
            f"{here}: rendered as complex envelope of {baseband.bandwidth:.0f} Hz about {baseband.carrier:g} Hz at "
            f"{part.plan.sampling_rate:.6g} Hz; it sounds up to {1e3 * reach:.3g} ms before an arrival",
            f"{here}: {filters.describe_filters()}",
            f"{here}: {filters.describe()}",
            f"{here}: all of it together within {summed.promised_db(i):.0f} dB of what is heard in some 40 ms",
        ]
    return lines


class _Adding(Stateless):
    """Adds all narrow parts."""

    def __init__(self, parts: tuple[NarrowPart, ...]) -> None:
        self._parts = [_Upsampled(part) for part in parts]

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add the upsampled envelopes from sample `start` on to the pressure (receivers, n), Pa."""
        with with_blas_threads(1):
            for part in self._parts:
                part.add(pressure, start)

    def shared(self, first: int, last: int) -> list[str]:
        """Return names of the chunks of envelopes that samples `first` to `last` are made of: part and number."""
        return [f"{i}.{k}" for i, part in enumerate(self._parts) for k in part.chunks(first, last)]

    def made(self, name: str) -> NDArray[Any]:
        """Return a chunk of envelopes by its name, (receivers, n) complex."""
        part, chunk = map(int, name.split("."))
        with with_blas_threads(1):
            return self._parts[part].rendered(chunk, alone=True)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Have chunks of envelopes come from `find`, by their names."""

        def found(part: int, chunk: int) -> NDArray[Any]:
            return find(f"{part}.{chunk}")

        for i, part in enumerate(self._parts):
            part.found = partial(found, i)

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        for part in self._parts:
            part.warn()


class _Upsampled:
    """Envelopes of one narrow part, chunk by chunk of their own, and the sound that is made of them.

    Attributes
    ----------
    found : callable
        Returns a chunk of envelopes by its number.
    """

    def __init__(self, part: NarrowPart) -> None:
        self.found: Callable[[int], Complexes] = self.rendered
        self._plan, self._upsampler = part.plan, part.upsampler
        self._engine: BasebandEngine | None = None
        self._chunks: dict[int, Complexes] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add the sound from sample `start` on to the pressure (receivers, n), Pa."""
        every, stop = self._upsampler.every, start + pressure.shape[1]
        first = start // every
        envelopes = self._envelopes(*self._span(start, stop))
        for row, envelope in zip(pressure, envelopes, strict=True):
            if np.any(envelope):
                row += self._upsampler(envelope, first)[start - first * every : stop - first * every]

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        if self._engine is not None:
            self._engine.warn()

    def chunks(self, start: int, stop: int) -> range:
        """Return the chunks of envelopes that samples `start` to `stop` of the sound are made of."""
        return self._chunks_of(*self._span(start, stop))

    def _span(self, start: int, stop: int) -> tuple[int, int]:
        """Return the first and last samples of the envelopes that samples of the sound need."""
        every, reach = self._upsampler.every, self._upsampler.reach
        return start // every + 1 - reach, -(-stop // every) + reach

    def _chunks_of(self, first: int, last: int) -> range:
        size = self._plan.chunk
        return range((first + _AHEAD) // size, (last - 1 + _AHEAD) // size + 1)

    def _envelopes(self, first: int, last: int) -> Complexes:
        """Return samples `first` to `last` of the envelopes, (receivers, n)."""
        wanted = self._chunks_of(first, last)
        self._chunks = {k: self._chunks[k] if k in self._chunks else self.found(k) for k in wanted}
        begin = wanted[0] * self._plan.chunk - _AHEAD
        return np.concatenate([self._chunks[k] for k in wanted], axis=1)[:, first - begin : last - begin]

    def rendered(self, chunk: int, *, alone: bool = False) -> Complexes:
        """Return a chunk of envelopes; whichever asks for it, from whatever beginning, it is the same.

        Nothing is prepared for the next one if it is wanted alone.
        """
        if self._engine is None:
            self._engine = BasebandEngine(self._plan)
        start = chunk * self._plan.chunk - _AHEAD
        stop = min(start + self._plan.chunk, self._plan.samples)
        if alone:
            self._engine.until(stop)
        return self._engine.render(start, stop)
