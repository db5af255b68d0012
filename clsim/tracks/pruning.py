"""Paths that are never loud enough to matter, and a bound on what is lost without them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from clsim.arrays import Floats
from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.response import SceneResponse, directivity_gain
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.signal.occupied_bandwidth import shares
from clsim.tracks.tracks import SceneTracks

_STEP = 0.25  # s, over which distances are bounded
_LEAST_MOVE = 0.05  # m, or for as long as motions take for it
_DIRECTIONS = 2000  # in which the largest gain of a directivity is looked for
_BETWEEN = 1.05  # by which it may be larger between them
_FREQUENCIES = 9
_SHARE = 1e-4  # of the signal's energy at either end, which is not looked at


def pruned(tracks: SceneTracks, below_db: float, until: float) -> tuple[SceneTracks, str]:
    """Return the tracks of paths whose bounds reach a level of the strongest arrival by `until`, s, and a note.

    The bound of a gain is the product of spreading and air over the shortest distance that peak speeds allow within
    each quarter of a second (or 5 cm of motion, where that takes longer and no path comes or goes), of the reflection
    factors (1 where they depend on the angle), and of the directivities' largest gains, at nine frequencies of the
    signal's band. What all paths that are left out add is at most the sum of their bounds.
    """
    sources = {pair.source for pair in tracks.pairs}
    bands = {i: shares(tracks.paths.scene.sources[i].emitted.energy_spectrum(), _SHARE) for i in sources}
    bounds = [_bounds(tracks, i, bands[pair.source], until) for i, pair in enumerate(tracks.pairs)]
    ends = [(pair.source, pair.receiver) for pair in tracks.pairs]
    strongest: dict[tuple[int, int], float] = {}  # of paths of all kinds
    for both, (_, loudest) in zip(ends, bounds, strict=True):
        strongest[both] = max(strongest.get(both, 0.0), loudest)
    pairs, pair_paths, lost, count = [], [], dict.fromkeys(ends, 0.0), 0
    for both, (bound, _), pair, paths in zip(ends, bounds, tracks.pairs, tracks.pair_paths, strict=True):
        quiet = bound < 10 ** (below_db / 20) * strongest[both]
        rows = np.flatnonzero(~quiet)
        if np.any(quiet):
            lost[both] += float(bound[quiet].sum()) / strongest[both]
            count += len(quiet) - len(rows)
        if len(rows):
            pairs.append(replace(pair, start=pair.start[rows], end=pair.end[rows]))
            pair_paths.append(paths.part(rows))
    if not count:
        return tracks, f"no path stays below {below_db:g} dB"
    reduced = replace(tracks, pairs=tuple(pairs), pair_paths=tuple(pair_paths))
    most = max(lost.values())
    together = f"reach at most {20.0 * math.log10(most):.1f} dB" if most > 0.0 else "are silent"
    return reduced, (
        f"{count} paths that stay below {below_db:g} dB of the strongest are left out; all of them together {together}"
    )


def _bounds(tracks: SceneTracks, pair: int, band: tuple[float, float], until: float) -> tuple[Floats, float]:
    """Return bounds (P,) of the gains of a pair's paths over a band, Hz, and the strongest gain that was met."""
    scene, paths = tracks.paths.scene, tracks.pair_paths[pair]
    source, receiver, c = scene.sources[paths.source], scene.receivers[paths.receiver], scene.air.speed_of_sound
    frequencies = np.linspace(*band, _FREQUENCIES)
    at = SceneResponse(scene, paths.source, frequencies)
    directivities = _peak(source.directivity, frequencies, c) * _peak(receiver.directivity, frequencies, c)
    reflected = paths.family.gain_bound(paths.rows, at) * directivities
    source_speed = float(tracks.speeds.source[paths.source])
    slowest = paths.family.medium(paths.source).slowest
    mach_factor = (1.0 - source_speed / slowest) ** -tracks.kinematics.exponent
    bound, strongest = np.zeros(len(reflected)), 0.0
    spread = 2.0 * source_speed / slowest if at.disperses else 0.0  # of the frequencies on the way
    least, most = at.least_nepers * (1.0 - spread), at.most_nepers * (1.0 + spread)
    speed = source_speed + float(tracks.speeds.receiver[paths.receiver])
    member, step = tracks.pairs[pair], _STEP
    if member.always_audible:
        step = max(_STEP, _LEAST_MOVE / speed) if speed > 0.0 else math.inf
    edges = np.linspace(0.0, until, max(1, math.ceil(until / step)) + 1)
    for begin, end in pairwise(edges):
        audible = (member.start < end) & (member.end > begin)
        nearest = np.maximum(tracks.delay_range(pair, begin, end)[0] * slowest, scene.min_distance)[:, None]
        nepers = np.where(nearest > 1.0, least, most)
        gain = reflected * np.exp(-nepers * np.maximum(nearest - 1.0, -1.0)) / nearest * mach_factor
        bound = np.maximum(bound, np.where(audible, gain.max(axis=1), 0.0))
        middle = np.array([0.5 * (begin + end)])
        now = np.abs(paths.gain(paths.arrivals(middle, tracks.kinematics), middle)[:, 0])
        strongest = max(strongest, float(np.where((member.start <= middle) & (member.end > middle), now, 0.0).max()))
    return bound, strongest


def _peak(directivity: Directivity, frequencies: Floats, speed_of_sound: float) -> Floats:
    """Return a bound of a directivity's gain in any direction, (F,)."""
    if isinstance(directivity, Omni):
        return np.ones(len(frequencies))
    towards = np.concatenate([np.eye(3)[:1], np.roll(fibonacci_sphere(_DIRECTIONS), 1, axis=1)])  # about the axis, +x
    gain = np.abs(directivity_gain(directivity, towards, frequencies, speed_of_sound))
    return np.asarray(_BETWEEN * np.broadcast_to(gain, (len(towards), len(frequencies))).max(axis=0))
