"""Impulse responses of a scene at an instant, and of its tail."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_choice, as_count, as_floats, as_number, read_only, row_name, short_repr
from clsim.errors import InputError, warn
from clsim.numerics.convolution import band_taper
from clsim.paths.channel import ImpulseResponse, ResponseBand, frozen_responses, summed
from clsim.paths.family import PairPaths
from clsim.paths.path_set import PathSet
from clsim.paths.response import QUASI_STATIC, check_band_coverage
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.scene import Scene
from clsim.tail.design import SCATTERINGS, ULTRASOUND, NoTailError, SourceTail, TailOptions, find_tail, searched_order
from clsim.tail.noise import Responses, at_one_place, combined, gains_of, plane_waves, static_gains
from clsim.tail.zones import DiffuseField, Zones

LEADS = ("cut", "keep")
TAILS = ("off", "auto")
_WIDEST = 0.95  # of half the sampling rate
_NARROWEST = 1e-3  # of the sampling rate
_LOWEST = 2e-4  # of the sampling rate, other than 0
_MOST_BYTES = 2**33
_LOUD_LEAD_DB = -60.0  # of a response's energy before time 0, from which on its cutting is a warning


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseResponses:
    """Impulse responses of every source and receiver at an instant, with all motion frozen.

    Attributes
    ----------
    samples : ndarray (sources, receivers, n)
        Taps, a row for each channel of receivers: what is received, Pa, is their convolution with what is emitted, Pa
        at 1 m on the axis.
    sampling_rate : float
        Hz.
    lead : int
        Samples before that of time 0, which is that of the emission: 0 unless ``lead="keep"`` was asked for.
    at : float
        Time of reception at which everything was frozen, s.
    band : (low, high)
        Band in which the responses are exact, Hz.
    scene : Scene
        The scene.
    first_arrivals : ndarray (sources, receivers)
        Delay of the earliest path, s, as in the path table; nan where none is heard.
    cut_db : ndarray (sources, receivers)
        Share of each response's energy that lay before time 0 and was cut, dB; -inf for none.
    notes : tuple of str
        The tails that were added, or the reason for none.
    """

    samples: Floats
    sampling_rate: float
    lead: int
    at: float
    band: tuple[float, float]
    scene: Scene
    first_arrivals: Floats
    cut_db: Floats
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def times(self) -> Floats:
        """Delays of the taps (n,), s."""
        return (np.arange(self.samples.shape[2], dtype=np.float64) - self.lead) / self.sampling_rate

    @property
    def source_names(self) -> tuple[str, ...]:
        """Names along the first axis."""
        return tuple(source.name for source in self.scene.sources)

    @property
    def receiver_names(self) -> tuple[str, ...]:
        """Names along the second axis, of channels with the channel's name behind the receiver's."""
        return tuple(
            row_name((receiver.name, channel))
            for receiver in self.scene.receivers
            for channel in receiver.directivity.channels
        )

    def describe(self) -> list[str]:
        """Return lines that describe the time axis."""
        rows = self.source_names, self.receiver_names
        time_0 = f"sample {self.lead} is time 0, that of the emission"
        s, r = np.unravel_index(np.nanargmin(self.first_arrivals), self.first_arrivals.shape)
        first = self.lead + self.first_arrivals[s, r] * self.sampling_rate
        lines = [f"{time_0}; the first arrival, {rows[0][s]} at {rows[1][r]}, is at sample {first:.1f}"]
        s, r = np.unravel_index(np.argmax(self.cut_db), self.cut_db.shape)
        if self.cut_db[s, r] > -math.inf:
            lines.append(
                f"what rings before time 0 is cut: at most {self.cut_db[s, r]:.0f} dB of a response's energy, that of "
                f"{rows[0][s]} at {rows[1][r]}"
            )
        return [*lines, *self.notes]


def impulse_responses(
    paths: PathSet,
    sampling_rate: float,
    at: float = 0.0,
    band: tuple[float, float] | None = None,
    *,
    lead: str = "cut",
    tail: str = "auto",
    tail_seed: int = 0,
    tail_scattering: str = SCATTERINGS[0],
    progress: Callable[[float], None] | None = None,
) -> ImpulseResponses:
    """Return the impulse response of every source and receiver at an instant.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`; signals, transducers and electronics are left out.
    sampling_rate : float
        Hz.
    at : float
        Time of reception at which everything is frozen, s; delays are those of quasi-static motion.
    band : (low, high), optional
        Band in which the responses are exact, Hz; 0 to 0.95 of half the sampling rate when left out. Beyond either end
        they fall to nothing within half the band's width, or the room that there is; a band from 0 Hz has no lower end.
    lead : {"cut", "keep"}
        What becomes of what rings before time 0, where a receiver is so close that an arrival does: it is cut, so that
        sample 0 is time 0, or kept, and sample `ImpulseResponses.lead` is time 0.
    tail : {"auto", "off"}
        Whether what images leave is added as a diffuse tail by rays, as long as it is heard: with "auto" in closed
        rooms, for bands that begin below 40 kHz. `notes` says what was added, or why not.
    tail_seed : int
        Seed of the rays and of the tails' noise.
    tail_scattering : {"size", "material"}
        Whether walls scatter by their limited size as well, beyond images, or by their materials alone.
    progress : callable, optional
        Called now and then with the share of the work that is done, 0 to 1.

    Returns
    -------
    ImpulseResponses
        Float64, all of one length.

    Warns
    -----
    ClsimWarning
        If more than -60 dB of a response's energy is cut.

    Raises
    ------
    InputError
        If the instant lies outside a trajectory, no path is active then, the band does not fit the sampling rate, or
        walls or directivities are not known over it.

    Notes
    -----
    Each path is an impulse at its own delay, between samples, cut to the band, with the phases and magnitudes of air,
    walls and directivities at every frequency: its largest value lies at the delay. An arrival rings to either side
    for 7 over the width in which the band falls, 1.5 ms at 192 kHz by default, within 5/7 of that below -100 dB.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=48e3)
    >>> robot = clsim.Source("robot", tone, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0), [robot], [ceiling])
    >>> found = clsim.impulse_responses(clsim.find_paths(scene, max_order=0), 48e3)
    >>> int(found.samples[0, 0].argmax()), round(14.96 ** 0.5 / 343.0 * 48e3, 1)
    (541, 541.3)
    """
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    scene = paths.scene
    rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
    time = _as_instant(scene, at)
    kept = as_response_band(rate, band)
    check_band_coverage(
        scene, range(len(scene.sources)), max(kept.low, kept.high * 1e-3), kept.high, "the band of the responses"
    )
    as_choice("lead", lead, LEADS)
    with_tail = as_choice("tail", tail, TAILS) == "auto" and kept.low < ULTRASOUND
    scattering = as_choice("tail_scattering", tail_scattering, SCATTERINGS)
    options = TailOptions(searched_order(paths), seed=as_count("tail_seed", tail_seed), scattering=scattering)
    audible = _active_pairs(paths, time)
    if not audible:
        raise InputError("paths", f"must hold paths that are active at {time:g} s, but hold none")
    first_row = np.cumsum([0, *(len(receiver.directivity.channels) for receiver in scene.receivers)])
    found, shape = {}, (len(scene.sources), int(first_row[-1]))
    first_arrivals, cut_db = np.full(shape, math.nan), np.full(shape, -math.inf)
    for done, ((source, receiver), kinds) in enumerate(audible.items(), start=1):
        arrived = [(kind, kind.arrivals(np.array([time]), QUASI_STATIC)) for kind in kinds]
        earliest = min(float((one.delay + kind.group_delay_offset(one)).min()) for kind, one in arrived)
        by_kind = [frozen_responses(kind, time, rate, kept) for kind in kinds]
        for row, parts in enumerate(zip(*by_kind, strict=True), first_row[receiver]):
            pair = source, int(row)
            found[pair] = summed(list(parts))
            first_arrivals[pair] = earliest
            if lead == "cut":
                found[pair], cut_db[pair] = found[pair].causal()
        if progress is not None:
            progress(done / len(audible))
    notes = _add_tails(paths, time, rate, kept, options, found) if with_tail else _left(paths, kept)
    samples, before = _on_one_axis(shape, found)
    made = ImpulseResponses(
        read_only(samples), rate, before, time, (kept.low, kept.high), scene, read_only(first_arrivals),
        read_only(cut_db), notes,
    )  # fmt: skip
    if cut_db.max() > _LOUD_LEAD_DB:
        warn(f'lead="cut": {made.describe()[1]}; lead="keep" keeps it')
    return made


def _add_tails(
    paths: PathSet, time: float, rate: float, band: ResponseBand, options: TailOptions,
    found: dict[tuple[int, int], ImpulseResponse],
) -> tuple[str, ...]:  # fmt: skip
    """Add every source's tail to the pairs' responses at a time, s; return a line of description each."""
    notes = []
    for source in sorted({source for source, _ in found}):
        try:
            tails, what = frozen_tails(paths, source, time, rate, band, options)
        except NoTailError as refused:
            return (f"no {refused}",)
        for receiver, one in enumerate(tails):
            before = [found[source, receiver]] if (source, receiver) in found else []
            found[source, receiver] = summed([*before, one])
        left = f"without it {what.left_db:.1f} dB of the energy is missing"
        notes.append(f"source {source}: diffuse tail of {what.describe()}; {left}")
    return tuple(notes)


def _left(paths: PathSet, band: ResponseBand) -> tuple[str, ...]:
    """Note on what images leave of the reverberation in a band, if that is more than -20 dB."""
    middle = np.sqrt(max(band.low, 20.0) * band.high)
    field = DiffuseField.of(paths.scene, np.array([middle])) if middle < ULTRASOUND else None
    left = -math.inf if field is None else float(field.left_db(searched_order(paths))[0])
    return (f'images leave some {left:.0f} dB of the reverberation (tail="auto" adds it)',) if left > -20.0 else ()


def _on_one_axis(pairs: tuple[int, int], found: dict[tuple[int, int], ImpulseResponse]) -> tuple[Floats, int]:
    """Return the taps of pairs (sources, receivers, n), and the number of taps before time 0."""
    lead = max(0, -min(response.first for response in found.values()))
    shape = (*pairs, lead + max(response.last for response in found.values()) + 1)
    if 8 * math.prod(shape) > _MOST_BYTES:
        raise InputError(
            "scene", f"must have responses of at most {_MOST_BYTES >> 30} GiB, but {shape[0]} x {shape[1]} pairs "
            f"of {shape[2]} samples are more; take fewer sources or receivers at a time"
        )  # fmt: skip
    samples = np.zeros(shape)
    for pair, response in found.items():
        first = lead + response.first
        samples[(*pair, slice(first, first + len(response.taps)))] = response.taps
    return samples, lead


def as_response_band(sampling_rate: float, band: Any) -> ResponseBand:
    """Return a band with its edges."""
    most = 0.5 * _WIDEST * sampling_rate
    low, high = (0.0, most) if band is None else map(float, as_floats("band", band, (2,)))
    least = _LOWEST * sampling_rate
    as_number("band[0]", low, at_least=0.0, unit="Hz")
    if 0.0 < low < least:
        raise InputError("band[0]", f"must be 0 or at least {least:g} Hz at this sampling rate, but is {low:g} Hz")
    as_number("band[1]", high, at_least=low + _NARROWEST * sampling_rate, at_most=most, unit="Hz")
    above = min(0.5 * sampling_rate - high, 0.5 * (high - low))
    return ResponseBand(low, high, min(low, above), above)


def _as_instant(scene: Scene, at: Any) -> float:
    """Return a time at which all trajectories are known."""
    time = as_number("at", at, at_least=0.0, unit="s")
    for field, end in [*scene.named_ends(), *scene.named_scatterers(), *scene.named_bodies()]:
        if time > end.trajectory.end:
            raise InputError(
                "at", f"must lie within {field}.trajectory, up to {end.trajectory.end:g} s, but is {time:g} s"
            )
    return time


def _active_pairs(paths: PathSet, time: float) -> dict[tuple[int, int], list[PairPaths]]:
    """Return the active paths of every kind at a time, by source and receiver."""
    audible: NDArray[np.bool_] = (paths.start <= time) & (time < paths.end)
    found: dict[tuple[int, int], list[PairPaths]] = {}
    for rows, pair in paths.pairs():
        if audible[rows].any():
            found.setdefault((pair.source, pair.receiver), []).append(pair.part(np.flatnonzero(audible[rows])))
    return found


def frozen_tails(
    paths: PathSet, source: int, at: float, sampling_rate: float, band: ResponseBand, options: TailOptions
) -> tuple[list[ImpulseResponse], SourceTail]:
    """Return the tail of a source at every row of the receivers at a time, s, within a band, and what it is made of."""
    scene = paths.scene
    receivers = Zones.frozen(scene.receivers, scene.room, at, beams=False)
    zones = Zones.frozen([scene.sources[source]], scene.room, at, beams=True), receivers
    tail = find_tail(scene, source, (band.low, band.high), zones, options)
    several = [isinstance(r.directivity, ChannelDirectivity) for r in scene.receivers]
    counts = [len(r.directivity.channels) for r in scene.receivers]
    first_row = np.cumsum([0, *counts])
    places = np.concatenate([r.trajectory.position(np.array([at])) for r in scene.receivers])
    nearest = np.linalg.norm(places[:, None] - receivers.centres, axis=2).argmin(axis=1)
    found: dict[int, ImpulseResponse] = {}
    for zone in np.unique(nearest):
        here = np.flatnonzero(nearest == zone)
        key = 0, int(zone)
        rows = [int(first_row[r]) + channel for r in here.tolist() for channel in range(counts[r])]
        if len(here) == 1 and not several[int(here[0])]:
            weights = np.square(gains_of(scene, here.tolist(), tail, at)[0])
            made = at_one_place(tail, key, source, sampling_rate, weights, moves=False)
        else:
            late = -(places[here] - receivers.centres[zone]) @ tail.arrivals.T / scene.air.speed_of_sound
            late = np.repeat(late, [counts[r] for r in here.tolist()], axis=0)
            gains = static_gains(scene, here.tolist(), tail, at, sampling_rate)
            waves = plane_waves(tail, key, source, sampling_rate, moves=False)
            made = combined(waves, late, gains, tail.centres, sampling_rate)
        found |= dict(zip(rows, _cut(made, sampling_rate, band), strict=True))
    return [found[row] for row in range(int(first_row[-1]))], tail


def _cut(made: Responses, rate: float, band: ResponseBand) -> list[ImpulseResponse]:
    """Return responses cut to a band; what rings before time 0 is not kept."""
    from scipy.fft import irfft, next_fast_len, rfft

    ringing = int(band.ringing * rate)
    count = made.taps.shape[1] + ringing
    size = next_fast_len(count + ringing, real=True)
    frequencies = np.arange(size // 2 + 1, dtype=np.float64) * (rate / size)
    taper = band_taper(frequencies, band.low, band.high, band.below, band.above)
    taps = irfft(rfft(made.taps.astype(np.float64), size) * taper, size)
    return [ImpulseResponse(0, row[made.lead : count]) for row in np.asarray(taps)]
