"""Room parameters that clsim finds for a measured room, and their differences in just noticeable differences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.impulse_responses import ImpulseResponses, impulse_responses
from clsim.measured.rooms import MeasuredRoom, MeasuredState
from clsim.room_measures import BANDS, lateral_measures, room_measures
from clsim.scene.ends import Receiver
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.scene import Scene
from clsim.workflow.console import Progress
from clsim.workflow.pipeline import find_scene_paths, shares

# Just noticeable differences, relative or absolute (ISO 3382-1:2009, table A.1; LFC, which it does not have, as LF).
_RELATIVE = {"t20": 0.05, "t30": 0.05, "edt": 0.05}
_ABSOLUTE = {"d50": 0.05, "lf": 0.05, "lfc": 0.05, "c80": 1.0, "g": 1.0, "ts": 0.01, "iacc": 0.075}
NOTICEABLE = (*_RELATIVE, *_ABSOLUTE)
COMPARED = ("t30", "t20", "edt", "d50", "c80", "ts", "g")
LATERAL = ("lf", "lfc", "iacc")  # of ambisonic components, and of the ears of a rigid sphere, that face the source


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
    facing = _facing_receivers(room, state)
    scenes = [state.scene] + ([replace(state.scene, scene=facing)] if facing else [])
    paths = [find_scene_paths(file, progress) for file in scenes]
    found, eyring = [], np.empty(0)
    notes: tuple[str, ...] = ()
    for seed in seeds:
        made = []
        for part in paths:
            with progress(f"{room.name}, {state.name}, seed {seed}", 1.0) as advance:
                made.append(
                    impulse_responses(
                        part, rate, band=band, lead="keep", tail="auto", tail_seed=seed, progress=shares(advance)
                    )
                )
        values, eyring = _parameters(room, state, made[0])
        found.append(values | (_lateral_parameters(room, state, made[1]) if facing else {}))
        notes = notes or made[0].notes
    return Simulated(tuple(found), eyring, notes)


def _parameters(
    room: MeasuredRoom, state: MeasuredState, responses: ImpulseResponses
) -> tuple[dict[str, Floats], Floats]:
    """Parameters (bands, pairs) of responses, and Eyring's times (bands,), s."""
    measures = room_measures(responses, room.bands)
    rows = _rows(room, measures.frequencies)
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


def _rows(room: MeasuredRoom, frequencies: Floats) -> list[int]:
    """Places of the room's bands among centres of bands, Hz."""
    rows = [int(np.abs(np.log(frequencies / f)).argmin()) for f in room.frequencies]
    if np.any(np.abs(frequencies[rows] / room.frequencies - 1.0) > 0.03):
        raise InputError("frequencies", f"must be centres of bands of the {room.bands} within those of the responses")
    return rows


def _facing_receivers(room: MeasuredRoom, state: MeasuredState) -> Scene | None:
    """Scene with components and a head at each pair's receiver that face the source; None without lateral values."""
    if not room.pairs or not any(name in state.mean for name in LATERAL):
        return None
    scene = state.scene.scene
    places = {end.name: end.trajectory.position(np.zeros(1))[0] for _, end in scene.named_ends()}
    receivers = []
    for source, receiver in room.pairs:
        place, (components, head) = Trajectory.fixed(places[receiver]), _names(source, receiver)
        receivers.append(Receiver.ambisonic(components, place, 1, aim_at=places[source]))
        receivers.append(Receiver.binaural(head, place, aim_at=places[source]))
    return replace(scene, receivers=receivers)


def _names(source: str, receiver: str) -> tuple[str, str]:
    """Names of the ambisonic receiver and of the head of a pair."""
    return f"{source} {receiver} components", f"{source} {receiver} head"


def _lateral_parameters(room: MeasuredRoom, state: MeasuredState, responses: ImpulseResponses) -> dict[str, Floats]:
    """Lateral parameters (bands, pairs) of responses at components and heads that face the source."""
    measures = [lateral_measures(responses, *_names(*pair), room.bands) for pair in room.pairs]
    rows, own = _rows(room, measures[0].frequencies), [responses.source_names.index(s) for s, _ in room.pairs]
    return {
        name: np.stack([getattr(one, name)[s, rows] for one, s in zip(measures, own, strict=True)], axis=1)
        for name in LATERAL
        if name in state.mean
    }


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
