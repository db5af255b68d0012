"""The sum over paths, each with its delay and gain at every output sample, by either engine: the method for all."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clsim.render.contributions import Stateless
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.reference import ReferenceEngine

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.render.plan import Plan


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
            if not self.plan.is_claimed(i):
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
