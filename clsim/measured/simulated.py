"""Room parameters that clsim finds for a measured room, and their differences in just noticeable differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError
from clsim.impulse_responses import impulse_responses
from clsim.room_measures import BANDS, room_measures
from clsim.workflow.pipeline import find_scene_paths, shares

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.impulse_responses import ImpulseResponses
    from clsim.measured.rooms import MeasuredRoom, MeasuredState
    from clsim.workflow.console import Progress

# Just noticeable differences, relative or absolute (ISO 3382-1:2009, table A.1; LFC, which it does not have, as LF).
_RELATIVE = {"t20": 0.05, "t30": 0.05, "edt": 0.05}
_ABSOLUTE = {"d50": 0.05, "lf": 0.05, "lfc": 0.05, "c80": 1.0, "g": 1.0, "ts": 0.01, "iacc": 0.075}
NOTICEABLE = (*_RELATIVE, *_ABSOLUTE)
# What is taken from responses of omnidirectional receivers. LF, LFC and IACC need receivers of several channels: their
# values are to be added in `_parameters`.
COMPARED = ("t30", "t20", "edt", "d50", "c80", "ts", "g")


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Values that clsim found for a state of a measured room."""

    values: tuple[dict[str, Floats], ...]  # (bands, pairs) by parameter, for each seed
    eyring: Floats  # (bands,) Eyring's reverberation times, s
    notes: tuple[str, ...]  # what the responses are made of

    def mean(self, parameter: str) -> Floats:
        """Mean over the seeds (bands, pairs)."""
        return np.asarray(np.mean([values[parameter] for values in self.values], axis=0))


def simulate(room: MeasuredRoom, state: MeasuredState, seeds: Iterable[int], progress: Progress) -> Simulated:
    """Search for paths, make responses with a tail for each seed, and compute the room's parameters."""
    rate = state.scene.render["sampling_rate"]
    edge = 2.0 ** (0.5 / BANDS[room.bands])
    band = 0.5 * room.frequencies[0] / edge, min(1.02 * room.frequencies[-1] * edge, 0.475 * rate)
    paths = find_scene_paths(state.scene, progress)
    found, eyring = [], np.empty(0)
    notes: tuple[str, ...] = ()
    for seed in seeds:
        with progress(f"{room.name}, {state.name}, seed {seed}", 1.0) as advance:
            responses = impulse_responses(
                paths, rate, band=band, lead="keep", tail="auto", tail_seed=seed, progress=shares(advance)
            )  # fmt: skip
        values, eyring = _parameters(room, state, responses)
        found.append(values)
        notes = notes or responses.notes
    return Simulated(tuple(found), eyring, notes)


def _parameters(
    room: MeasuredRoom, state: MeasuredState, responses: ImpulseResponses
) -> tuple[dict[str, Floats], Floats]:
    """Parameters (bands, pairs) of responses, and Eyring's times (bands,), s."""
    measures = room_measures(responses, room.bands)
    rows = [int(np.abs(np.log(measures.frequencies / f)).argmin()) for f in room.frequencies]
    if np.any(np.abs(measures.frequencies[rows] / room.frequencies - 1.0) > 0.03):
        raise InputError("frequencies", f"must be centres of bands of the {room.bands} within those of the responses")
    found = {}
    for name in COMPARED:
        if name not in state.mean:
            continue
        values = getattr(measures, name)[:, :, rows]
        if room.pairs:
            s, r = (
                [names.index(pair[i]) for pair in room.pairs]
                for i, names in enumerate((measures.source_names, measures.receiver_names))
            )
            found[name] = np.asarray(values[s, r].T)
        else:
            found[name] = values.mean(axis=(0, 1))[:, None]
    return found, measures.eyring[rows]


def noticeable(parameter: str, measured: Floats) -> Floats:
    """Just noticeable difference about measured values, in their unit."""
    if parameter in _RELATIVE:
        return np.asarray(_RELATIVE[parameter] * measured)
    return np.full_like(measured, _ABSOLUTE[parameter])


def mean_difference(
    state: MeasuredState, values: dict[str, Floats], parameters: Iterable[str], bands: NDArray[np.bool_]
) -> float:
    """Mean of the magnitudes of differences from measured values, in just noticeable ones, over bands and pairs."""
    parts = [
        (np.abs(values[name] - state.mean[name]) / noticeable(name, state.mean[name]))[bands]
        for name in parameters
        if name in values and name in state.mean
    ]
    return float(np.mean(parts)) if parts else float("nan")
