"""The sum over paths, each with its delay and gain at every output sample, by either engine: the method for all."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import methodcaller
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.render.contributions import Stateless, digest_of
from clsim.render.interpolator import Bandlimited
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.options import RenderOptions
from clsim.render.plan import BLOCKS, Allocation, Plan
from clsim.render.source_filters import SourceFilters
from clsim.tracks.splines import audible
from clsim.tracks.tracks import Tracks


@dataclass(frozen=True, slots=True, eq=False)
class PathSum:
    """The sum over paths."""

    plan: Plan  # what the engine carries out
    name: str = "path sum"

    def describe(self) -> list[str]:
        lines = []
        for i, filters in enumerate(self.plan.source_filters):
            if not self.plan.is_claimed(i):
                here = f"source {i}" if self.name == "path sum" else f"source {i}, {self.name}"
                lines += [f"{here}: {filters.describe_filters()}", f"{here}: {filters.describe()}"]
                lines.append(
                    f"{here}: total error at most {self.promised_db(i):.0f} dB of the level received within 40 ms"
                )
        return lines

    def promised_db(self, source: int) -> float:
        """Return the bound of a source's error re the level over 40 ms, dB: independent errors add up squared."""
        filters = self.plan.source_filters[source]
        parts_db = [filters.bank.error_db, filters.basis.error_db, self.plan.motion_error_db]
        return 10.0 * math.log10(sum(10.0 ** (part / 10.0) for part in parts_db))

    def digest(self) -> str:
        """Return a text that changes with the filters: linear algebra on other threads may round them otherwise."""
        about = repr((sorted(self.plan.allocation.claimed), self.plan.segment, self.plan.blocks))
        return digest_of(about, *(filters.digest() for filters in self.plan.source_filters))

    def begin(self) -> _Sum:
        return _Sum(self.plan)


ECHOES = "scattered"  # name of the group of paths by scatterers by approximate formulae
PER_SAMPLE = methodcaller("where_left", PathSum)  # builds it of a plan


class Group(NamedTuple):
    """Pairs with filters of their own: name of their part, options, indices and lengths of blocks."""

    name: str
    options: RenderOptions
    pairs: frozenset[int]
    blocks: tuple[int, ...]


def scattered_groups(tracks: Tracks, convolved: Allocation, options: RenderOptions) -> list[Group]:
    """Return pairs by scatterers whose fields vary over frequency: approximations, with shadows, and exact ones."""
    usable = options.engine == "opencl" and options.baseband is None and isinstance(options.interpolator, Bandlimited)
    if tracks.of_scene is None or not usable:
        return []
    vertices = [getattr(pair.family, "vertex", None) for pair in tracks.of_scene.pair_paths]
    varied = {i for i, v in enumerate(vertices) if getattr(v, "varies", False)} - convolved.claimed
    exact, allowed_db = replace(options, channels=False), options.scattering_error_db
    within = exact
    if allowed_db is not None:
        within = replace(exact, interpolator=Bandlimited(allowed_db), response_error_db=allowed_db)
    approximate = frozenset(i for i in varied if getattr(vertices[i], "approximate", False))
    groups = Group(ECHOES, within, approximate, BLOCKS), Group("series", exact, frozenset(varied - approximate), BLOCKS)
    return [group for group in groups if group.pairs]


@dataclass(eq=False)
class _Sum(Stateless):
    """Adds the sum over paths; the engine starts with the first piece."""

    plan: Plan
    engine: OpenclEngine | ReferenceEngine | None = None
    last: int | None = None  # sample from which on the engine prepares nothing; None: prepares all

    def until(self, last: int) -> None:
        self.last = last

    def add(self, pressure: NDArray[Any], start: int) -> None:
        if self.engine is None:
            on_device = OpenclEngine if self.plan.baseband is None else BasebandEngine
            self.engine = (ReferenceEngine if self.plan.options.engine == "reference" else on_device)(self.plan)
        self.engine.until(self.plan.samples if self.last is None else self.last)
        self.engine.add(pressure, start)

    def warn(self) -> None:
        if self.engine is not None:
            self.engine.warn()


_NUMBERS = 2**22  # gains held at a time


class ReferenceEngine:
    """Carries out a plan slowly and exactly."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def warn(self) -> None:
        """Tell nothing: all is exact."""

    def until(self, last: int) -> None:
        """Prepare nothing anyway."""

    def render(self, start: int, stop: int) -> Floats | Complexes:
        """Return the pressure (rows, stop - start) in Pa; in baseband its complex envelope."""
        plan = self._plan
        pressure = np.zeros((plan.row_count, stop - start), dtype=float if plan.baseband is None else complex)
        for i, pair in enumerate(plan.tracks.pairs):
            if i in plan.allocation.claimed:
                continue
            functions, rows = len(plan.source_filters[pair.source].basis), plan.rows_of_pair(i)
            step = min(max(_NUMBERS // (len(pair) * functions * (rows.stop - rows.start)), 256), 4096)
            for first in range(start, stop, step):
                last = min(first + step, stop)
                found = (own for _, own in path_pressures(plan, i, first, last))
                pressure[rows, first - start : last - start] += sum(found, np.zeros((1, last - first)))
        return pressure

    def add(self, pressure: NDArray[Any], start: int) -> None:
        pressure += self.render(start, start + pressure.shape[1])


def path_pressures(plan: Plan, pair: int, first: int, last: int) -> Iterator[tuple[int, Floats | Complexes]]:
    """Yield paths of a pair, by their rows, and the pressure of each over samples `first` to `last`, (C, n)."""
    tracks, member = plan.tracks, plan.tracks.pairs[pair]
    filters = plan.source_filters[member.source]
    times = np.arange(first, last) / plan.sampling_rate
    ramp = 0.5 * tracks.transition
    rows = np.flatnonzero((member.start - ramp <= times[-1]) & (member.end + ramp >= times[0]))
    if not len(rows):
        return
    delay, _, gain = tracks.evaluate(pair, times, filters.basis, rows)
    weight = audible(times, member.start[rows], member.end[rows], tracks.transition)
    weight = weight if member.tapers is None else weight * member.tapers.part(rows).weights(times)
    gain = np.where(weight > 0.0, gain, 0.0) * weight
    delay_samples = delay * (filters.oversampling * plan.sampling_rate) + filters.delay_samples
    whole = np.rint(delay_samples)
    weighted: Any = gain * filters.carrier_phase(delay_samples)
    samples = filters.oversampling * np.arange(first, last)
    emitted, active = samples - whole.astype(np.int64), np.any(weighted, axis=(0, 1, 3))
    for p, delayed in delayed_streams(plan, filters, emitted, delay_samples - whole, active):
        yield int(rows[p]), np.einsum("fn,cfn->cn", delayed, weighted[:, :, p])


def delayed_streams(
    plan: Plan, filters: SourceFilters, emitted: NDArray[np.int64], mu: Floats, active: NDArray[np.bool_]
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield active paths and the streams (K, n) of functions on each, by `emitted` and `mu` (P, n), samples."""
    length, centre = filters.bank.taps.shape[1], filters.bank.centre
    first = int(emitted.min()) + centre - length + 1
    streams = filters.streams(first, int(emitted.max()) + centre + 1)
    if not np.any(streams):
        return
    # Tap k reads x[n - D - k + centre]: a window ends at n - D + centre and runs backwards.
    windows = sliding_window_view(streams, length, axis=1)
    for p in np.flatnonzero(active).tolist():
        seen = windows[:, emitted[p] + centre - length + 1 - first, ::-1]
        yield p, np.einsum("nk,fnk->fn", plan.options.interpolator.taps(filters.bank, mu[p]), seen)
