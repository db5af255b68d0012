"""Responses that clsim finds for measured rooms, aligned and compared with what was measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.errors import InputError
from clsim.impulse_responses import ImpulseResponses, impulse_responses
from clsim.measured.rooms import MeasuredRoom, MeasuredState
from clsim.numerics.convolution import band_taper
from clsim.paths.path_table import PathTable
from clsim.room_measures import BANDS, lateral_measures, room_measures
from clsim.scene.ends import Receiver
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.scene import Scene
from clsim.workflow.console import Progress
from clsim.workflow.pipeline import find_scene_paths, shares

_ALIKE = 0.2  # correlation coefficient with the images, below which responses are aligned by their beginnings
_ONSET_DB = -20.0  # re the largest sample, at which a measured response begins (ISO 3382-1:2009, annex A.2.1)
_ABOUT = 0.25e-3  # s, on either side of a path's delay within which its sound is looked for
_BEFORE = 0.01  # s, of silence that is kept before the first arrival


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """A measured response on the time axis of a simulated one."""

    responses: ImpulseResponses  # (1, 1, n) the measured one, moved and scaled
    delay: float  # by which time 0 comes after the first sample of the measured one, s
    gain: float  # of the measured one over the simulated one; negative if its polarity is the other
    correlation: float  # coefficient of both over the images
    by_onset: bool  # whether the delay is that of the beginnings, as the responses are not alike


@dataclass(frozen=True, slots=True, eq=False)
class Reflection:
    """A path and the sound about its delay."""

    delay: float  # s
    order: int
    objects: str  # what it is reflected by
    simulated_db: float  # energy about its delay re that about the first path's
    measured_db: float


def align(measured: Floats, simulated: ImpulseResponses, images: ImpulseResponses) -> Aligned:
    """Move a measured response (n,) to the time axis of a simulated one (1, 1, m), and scale it."""
    # The delay is where the correlation with the images is largest in magnitude, between samples by a parabola; the
    # gain is by least squares there. Where the coefficient is below 0.2, both are by the beginnings and the energies.
    from scipy.fft import irfft, next_fast_len, rfft

    rate, known = simulated.sampling_rate, images.samples[0, 0]
    size = next_fast_len(len(measured) + len(known), real=True)
    frequencies = np.arange(size // 2 + 1, dtype=np.float64) * (rate / size)
    low, high = simulated.band
    taper = band_taper(frequencies, low, high, min(low, 0.5 * (high - low)), min(0.5 * rate - high, 0.5 * (high - low)))
    spectrum = rfft(measured, size) * taper
    found = irfft(spectrum * np.conj(rfft(known, size)), size)
    # Both have their own sample of time 0; all is moved to that of the simulated one.
    apart, energy = simulated.lead - images.lead, float(np.sum(np.square(known)))
    at = _peak(found)
    shift = at - apart
    kept = irfft(spectrum * np.exp(2j * np.pi * frequencies * shift / rate), size)
    alike = np.roll(kept, -apart)[: len(known)]
    correlation = float(found[round(at) % size]) / np.sqrt(energy * max(float(alike @ alike), 1e-300))
    gain = float(alike @ known) / energy
    by_onset = abs(correlation) < _ALIKE
    if by_onset:
        loud = np.abs(measured) >= np.abs(measured).max() * 10.0 ** (_ONSET_DB / 20.0)
        first = simulated.lead + float(simulated.first_arrivals[0, 0]) * rate
        shift = float(np.argmax(loud)) - first
        kept = irfft(spectrum * np.exp(2j * np.pi * frequencies * shift / rate), size)
        whole = float(np.sum(np.square(simulated.samples)))
        gain = float(np.sqrt(np.sum(np.square(kept)) / whole))
    count = max(1, min(size, len(measured) - int(np.floor(shift))))
    before = max(0, simulated.lead + int(float(simulated.first_arrivals[0, 0]) * rate) - int(_BEFORE * rate))
    kept[:before] = 0.0
    taps = read_only((kept[:count] / gain)[None, None])
    return Aligned(replace(simulated, samples=taps), (shift + simulated.lead) / rate, gain, correlation, by_onset)


def reflections(
    table: PathTable, simulated: ImpulseResponses, measured: ImpulseResponses, until: float
) -> list[Reflection]:
    """List paths up to a delay, s, by time, with the energies about their delays in both responses, dB re the first."""
    # Paths that arrive within 0.5 ms of each other share their sound.
    rows = [int(p) for p in np.argsort(table.delay[:, 0]) if table.audible[p, 0] and table.delay[p, 0] <= until]
    found: list[Reflection] = []
    first = np.ones(2)
    for row in rows:
        delay = float(table.delay[row, 0])
        energies = np.array([_about(response, delay) for response in (simulated, measured)])
        if not found:
            first = np.maximum(energies, 1e-300)
        levels = 10.0 * np.log10(np.maximum(energies / first, 1e-30))
        found.append(
            Reflection(delay, int(table.order[row]), table.name_objects(row), float(levels[0]), float(levels[1]))
        )
    return found


def _peak(found: Floats) -> float:
    """Place of the largest magnitude of a cyclic correlation (n,), between samples; negative in its second half."""
    size, at = len(found), int(np.abs(found).argmax())
    before, here, after = (abs(float(found[(at + i) % size])) for i in (-1, 0, 1))
    bent = before - 2.0 * here + after
    place = at + (0.5 * (before - after) / bent if bent < 0.0 else 0.0)
    return place if place < size / 2 else place - size


def _about(response: ImpulseResponses, delay: float) -> float:
    """Energy of a response about a delay, s."""
    middle = response.lead + delay * response.sampling_rate
    half = _ABOUT * response.sampling_rate
    first, last = max(0, round(middle - half)), round(middle + half) + 1
    return float(np.sum(np.square(response.samples[0, 0, first:last])))


def checked(samples: Floats, rate: float, path: object) -> Floats:
    """Check a measured response (n,): not silent, 50 ms at least."""
    if not np.any(samples):
        raise InputError(str(path), "must hold a response, but is silent")
    if len(samples) < 0.05 * rate:
        raise InputError(str(path), f"must hold 50 ms at least, but holds {1e3 * len(samples) / rate:.3g} ms")
    return np.asarray(samples, dtype=np.float64)


# Just noticeable differences, relative or absolute (ISO 3382-1:2009, table A.1; LFC, which it does not have, as LF).
_RELATIVE = {"t20": 0.05, "t30": 0.05, "edt": 0.05}
_ABSOLUTE = {"d50": 0.05, "lf": 0.05, "lfc": 0.05, "c80": 1.0, "g": 1.0, "ts": 0.01, "iacc": 0.075}
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
