"""What functions of frequency hold worse than was asked: told with its cause, or refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clsim.errors import InputError, warn
from clsim.numerics.band_filters import LONGEST

if TYPE_CHECKING:
    from clsim.numerics.band_filters import BandFilters

WORST_DB = -40.0  # error up to which a shortfall is a warning; beyond it must be asked for
_NEAR_ZERO = 8.0  # in sampling rates over taps: up to there it is 0 Hz that asks for long filters
# Added to errors about 0 Hz: they fill a part of one bin of the short-time spectra, in which a signal may have several
# times the energy of the bin's mean.
_UNSURE_DB = 4.0


@dataclass(frozen=True, slots=True)
class Held:
    """How well the steps from responses to filters hold them over a source's band, dB."""

    source: int  # index
    low: float  # the band, Hz
    high: float  # likewise
    sampling_rate: float  # hz
    looked_at: int = 0  # frequencies of the band at which responses were looked at
    resolved_db: float = -math.inf  # error between these frequencies
    functions: int = 0  # functions of frequency
    functions_db: float = -math.inf  # error of responses as sums of them
    at_centre: bool = False  # responses are those at one frequency: no error was asked for, so that none is refused

    def within(self, asked_db: float, filters: BandFilters | None = None) -> float:
        """Return the error that is reached, dB, with filters if they are there already."""
        reached = max(self.resolved_db, self.functions_db, -math.inf if filters is None else filters.error_db)
        if reached <= asked_db:
            return reached
        cause, remedy = self._cause(reached, filters)
        if filters is not None and reached == filters.error_db and self._near_zero(filters):
            reached += _UNSURE_DB
        where = f"from {self.low:.0f} to {self.high:.0f} Hz"
        if reached > WORST_DB and not self.at_centre:
            raise InputError(
                "response_error_db",
                f"must be reached {where}, but for source {self.source} {asked_db:g} dB is not: {cause}; "
                f"{reached:.0f} dB is the best; {remedy}, or ask for less",
            )
        asked = f", not the {asked_db:g} dB asked for" if not self.at_centre else ""
        less = f", or ask for response_error_db={math.ceil(reached)}" if not self.at_centre else ""
        warn(
            f"source {self.source}: air, walls and directivities are held within {reached:.0f} dB {where}{asked}: "
            f"{cause}; {remedy}{less}"
        )
        return reached

    def _cause(self, reached: float, filters: BandFilters | None) -> tuple[str, str]:
        """Return what keeps the error from being smaller, and what to do about it."""
        smooth = (
            "smooth what walls and directivities do over frequency (thin the rows of a table, shorten impulse "
            "responses), or narrow the signal's band (fade it)"
        )
        if reached == self.resolved_db:
            longest = 1e3 * 2.0 * self.looked_at / (math.pi * (self.high - self.low))
            return (
                f"{self.looked_at} frequencies do not resolve what walls and directivities do (impulse "
                f"responses longer than {longest:.3g} ms)"
            ), smooth
        if filters is None or reached == self.functions_db:
            return f"walls and directivities ask for more than {self.functions} functions of frequency", smooth
        if self._near_zero(filters):
            return (
                f"walls or directivities have a phase at {filters.worst:.0f} Hz, so near to 0 Hz that no filter of up "
                f"to {LONGEST} taps has it, and the signal sounds there, as one does that begins or ends abruptly"
            ), "fade the signal or narrow its band"
        longest = 1e3 * LONGEST / self.sampling_rate
        return (
            f"no filter of up to {LONGEST} taps ({longest:.0f} ms) does what walls and directivities do at "
            f"{filters.worst:.0f} Hz"
        ), smooth

    def _near_zero(self, filters: BandFilters) -> bool:
        """Whether filters are worst so near to 0 Hz that only longer ones would do."""
        return filters.worst <= _NEAR_ZERO * self.sampling_rate / LONGEST
