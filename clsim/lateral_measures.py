"""Lateral energy and interaural correlation of impulse responses, by frequency band."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsim.acoustics.decay import interaural_correlation, lateral_fractions
from clsim.arrays import Floats, read_only, short_repr
from clsim.errors import InputError
from clsim.impulse_responses import ImpulseResponses
from clsim.room_measures import BANDS, band_centres, cut_to_band
from clsim.scene.directivity.head_related import EARS

_EARLY = 0.08  # s


@dataclass(frozen=True, slots=True, eq=False)
class LateralMeasures:
    """How much sound arrives from the side.

    Attributes
    ----------
    frequencies : ndarray (bands,)
        Centres of the bands, Hz.
    lf, lfc : ndarray (sources, bands)
        Early lateral energy fractions; NaN without microphones.
    iacc, iacc_early : ndarray (sources, bands)
        Interaural cross-correlation coefficients of all sound, and of the first 80 ms, 0 to 1; NaN without ears.
    source_names : tuple of str
        Along the first axis.
    """

    frequencies: Floats
    lf: Floats
    lfc: Floats
    iacc: Floats
    iacc_early: Floats
    source_names: tuple[str, ...]

    __repr__ = short_repr


def lateral_measures(
    responses: ImpulseResponses,
    microphones: tuple[str, str] | str | None = None,
    ears: tuple[str, str] | str | None = None,
    bands: str = "octave",
) -> LateralMeasures:
    """Compute lateral energy fractions of two microphones at a place, and the correlation of two ears.

    Parameters
    ----------
    responses : ImpulseResponses
        From `impulse_responses`.
    microphones : (str, str) or str, optional
        Names of an omnidirectional receiver and of a figure of eight, ``FirstOrder(0.0)``, whose null points at the
        source; or of an ambisonic receiver that faces the source: its channels ACN0 and ACN1 are both.
    ears : (str, str) or str, optional
        Names of the receivers of the left and the right ear, or of a head with two channels.
    bands : {"octave", "third-octave"}
        Into which responses are cut.

    Returns
    -------
    LateralMeasures
        By source and band.

    Raises
    ------
    InputError
        If the responses are none, a receiver is not known, or no such band lies within that of the responses.

    Notes
    -----
    ISO 3382-1:2009, annexes A and B. Sound begins with the earliest path to either receiver of a pair.
    """
    if not isinstance(responses, ImpulseResponses):
        raise InputError("responses", f"must be ImpulseResponses, but are {responses!r:.80}")
    centres = band_centres(responses.band, bands)
    share, rate = 2.0 ** (0.5 / BANDS[bands]), responses.sampling_rate
    found = {
        name: np.full((len(responses.source_names), len(centres)), math.nan)
        for name in ("lf", "lfc", "iacc", "iacc_early")
    }
    for field, pair in (("microphones", microphones), ("ears", ears)):
        if pair is None:
            continue
        rows = _rows(field, pair, responses.receiver_names)
        first = np.nanmin(
            np.append(responses.first_arrivals[:, rows], np.full((len(found["lf"]), 1), np.inf), axis=1), axis=1
        )
        for s in np.flatnonzero(np.isfinite(first)).tolist():
            begin = responses.lead + math.floor(first[s] * rate)
            for b, centre in enumerate(centres.tolist()):
                one, other = (cut_to_band(responses.samples[s, r], rate, centre, share) for r in rows)
                if field == "microphones":
                    found["lf"][s, b], found["lfc"][s, b] = lateral_fractions(one, other, rate, begin)
                else:
                    early = begin + round(_EARLY * rate)
                    found["iacc"][s, b] = interaural_correlation(one, other, rate)
                    found["iacc_early"][s, b] = interaural_correlation(one[:early], other[:early], rate)
    values = {name: read_only(one) for name, one in found.items()}
    return LateralMeasures(read_only(centres), **values, source_names=responses.source_names)


def _rows(field: str, pair: Any, names: tuple[str, ...]) -> list[int]:
    """Find two rows by their names, or the two of a receiver of several channels."""
    if isinstance(pair, str):
        pair = tuple(f"{pair} {channel}" for channel in (EARS if field == "ears" else ("ACN0", "ACN1")))
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(field, f"must be the names of two receivers, but is {pair!r:.80}")
    for i, name in enumerate(pair):
        if name not in names:
            raise InputError(f"{field}[{i}]", f"must be a receiver's name, one of {', '.join(names)}, but is {name!r}")
    return [names.index(name) for name in pair]
