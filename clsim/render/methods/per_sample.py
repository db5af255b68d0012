"""The sum over paths, each with its delay and gain at every output sample, by either engine: the method for all."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clsim.render.contributions import Stateless
from clsim.render.interpolator import Bandlimited
from clsim.render.methods.costs import measured_costs
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.reference import ReferenceEngine

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.render.plan import Plan
    from clsim.render.source_filters import Emission, SourceFilters

_OF_A_WINDOW = 0.5  # of a window of the short-time spectra in which the rest is loud


def cost_of_whole(emission: Emission) -> float:
    """Return the processor time of a path in a sample of all that is emitted, ns."""
    assert isinstance(emission.options.interpolator, Bandlimited)
    low, high = emission.sound.bounds(10 ** ((emission.options.interpolator.error_db - 6.0) / 10))
    known = measured_costs()
    return known.plain + known.wide * (high - low) / (0.5 * emission.signal.sampling_rate)


def cost_of_filters(filters: SourceFilters) -> float:
    """Return the same with filters that are designed."""
    known = measured_costs()
    return known.branch * float(filters.rows[-1]) + known.function * len(filters.basis)


def cost_of_rest(emission: Emission, loud: float) -> float:
    """Return the same of what narrow bands leave, by the share of time in which that is not silent.

    Functions of frequency are then for that time alone, and on average it lasts for half of a window of the spectra.
    """
    known = measured_costs()
    return (cost_of_whole(emission) - known.plain + _OF_A_WINDOW * known.rest) * loud


def build(plan: Plan) -> PathSum | None:
    """Return the sum over a plan's paths except those that other methods claim; None if there are no others."""
    return None if len(plan.allocation.claimed) == len(plan.tracks.pairs) else PathSum(plan)


@dataclass(frozen=True, slots=True, eq=False)
class PathSum:
    """The sum over paths."""

    plan: Plan  # what the engine carries out

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "path sum"

    def describe(self) -> list[str]:
        """Describe the filters of each source for delays and responses, and the bound of the error."""
        lines = []
        for i, filters in enumerate(self.plan.source_filters):
            if not self.plan.allocation.claims(self.plan.tracks, i):
                lines += [f"source {i}: {filters.describe_filters()}", f"source {i}: {filters.describe()}"]
                lines.append(
                    f"source {i}: all of it together within {self.promised_db(i):.0f} dB of what is heard in some 40 ms"
                )
        return lines

    def promised_db(self, source: int) -> float:
        """Return the bound on the error of paths rendered per sample, relative to the received level over 40 ms, dB.

        Errors of delay filters, of responses and of motion between nodes are independent: their squares add up.
        """
        filters = self.plan.source_filters[source]
        parts_db = [filters.bank.error_db, filters.basis.error_db, self.plan.motion_error_db]
        return 10.0 * math.log10(sum(10.0 ** (part / 10.0) for part in parts_db))

    def digest(self) -> str:
        """Return a text that changes with the filters: linear algebra on other threads may round them otherwise."""
        plan = self.plan
        found = hashlib.sha256(repr((sorted(plan.allocation.claimed), plan.segment, plan.blocks)).encode())
        for filters in plan.source_filters:
            found.update(filters.digest().encode())
        return found.hexdigest()

    def begin(self) -> _Sum:
        """Return an object that adds it."""
        return _Sum(self.plan)


class _Sum(Stateless):
    """Adds the sum over paths; the engine starts with the first piece."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._engine: OpenclEngine | ReferenceEngine | None = None
        self._last = plan.samples

    def until(self, last: int) -> None:
        """Have the engine prepare nothing from sample `last` on."""
        self._last = last

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add the sum of paths from sample `start` on to the pressure (receivers, n), Pa."""
        if self._engine is None:
            self._engine = _engine(self._plan)
        self._engine.until(self._last)
        self._engine.add(pressure, start)

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        if self._engine is not None:
            self._engine.warn()


def _engine(plan: Plan) -> OpenclEngine | ReferenceEngine:
    if plan.options.engine == "reference":
        return ReferenceEngine(plan)
    return OpenclEngine(plan) if plan.baseband is None else BasebandEngine(plan)
