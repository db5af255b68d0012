"""Fades of paths over edges where the series of edges breaks off.

A path ends where another edge or face comes into the way. Where no path takes over, or not all of it, the sum of all
would jump. So the rest fades before an end, and after a beginning.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, Rows, read_only, unique_rows
from clsim.paths.chain import Chain
from clsim.paths.fades import FadeColumns, Fades
from clsim.paths.family import PathFamily
from clsim.paths.response import Arrivals, SceneResponse
from clsim.paths.search.same_events import SAME_DELAY, Events
from clsim.paths.vertices.edge import EdgeVertex

_LEAST = 2e-4  # jump of the pressure that is left, over that of the strongest path
_NEAR = 3e-5  # s between beginnings and ends of one event
_BESIDE, _BESIDE_BODIES = 1e-7, 5e-7  # s from these, where paths are evaluated: bodies' are up to 0.2 µs late
_SHORTEST, _LONGEST = 1e-3, 0.25  # s, of fades
_SLOWEST = 1e-9  # m/s, at which nothing moves
_FREQUENCIES = np.array([0.8, 1.0, 1.25])  # of the centre frequency
_INSTANTS = 33  # at which the strongest path without edges is looked for
_ONE_BY_ONE = 8  # paths that are evaluated together, each at a time of its own
_DAMPING = 1e-6  # of the squares of members


@dataclass(frozen=True, eq=False)
class Fading:
    """All paths of a scene, and which shares of those over edges fade where the sum of all would jump."""

    found: tuple[PathFamily, ...]
    direct: bool  # whether direct sound is among all

    @property
    def families(self) -> tuple[PathFamily, ...]:
        """All paths; those over edges fade."""
        return tuple(
            replace(family, fades=Fades(self, number, read_only(np.arange(len(family)))))
            if isinstance(family, Chain) and isinstance(family.vertex, EdgeVertex)
            else family
            for number, family in enumerate(self.found)
        )

    @cached_property
    def made(self) -> list[FadeColumns]:
        """Fades of the paths of each family."""
        known = [number for number, family in enumerate(self.found) if isinstance(family, Chain)]
        chains: Any = [self.found[number] for number in known]
        events = Events.of(chains, chains[0].scene)
        made = [FadeColumns.none(len(family)) for family in self.found]
        for pair in np.unique(events.pair).tolist():
            of_pair = _PairEvents.of(events, pair, self.direct)
            for group in of_pair.groups():
                for member, *given in zip(*of_pair.missing(group), strict=True):
                    place = events.row[member], events.side[member]
                    for field, value in zip(fields(FadeColumns), given, strict=True):
                        getattr(made[known[events.family[member]]], field.name)[place] = value
        return made

    def __getstate__(self) -> dict[str, Any]:
        """Keep shares alone in copies: worker processes need no other paths."""
        return {"made": self.made}


@dataclass(frozen=True, slots=True, eq=False)
class _PairEvents:
    """Beginnings and ends of paths between one source and one receiver."""

    events: Events
    which: Rows  # (n,) of all events
    instant: Rows  # (n,) number of the time that is taken for one
    time: Floats  # (n,) that time, s
    over_edges: NDArray[np.bool_]  # (n,)
    value: Complexes  # (n, F) pressure over that emitted, without the delay
    delay: Floats  # (n,) s
    onwards: Floats  # (n,) delay from what moves on the way, s
    other: Rows  # (n,) event at the other end of the same interval, -1 for none
    frequencies: Floats  # (F,) Hz
    loudest: Floats  # (n,) pressure of the strongest path without edges, or less

    @staticmethod
    def of(events: Events, pair: int, direct: bool) -> _PairEvents:
        which = np.flatnonzero(events.pair == pair)
        source = pair // len(events.scene.receivers)
        at = SceneResponse(events.scene, source, _FREQUENCIES * events.scene.sources[source].emitted.centre_frequency)
        exact = events.time[which]
        instant = np.cumsum(np.diff(exact, prepend=exact[0]) > _NEAR).astype(np.int64)
        time = (np.bincount(instant, weights=exact) / np.bincount(instant))[instant]
        value, times = np.empty((len(which), len(at.frequencies)), dtype=np.complex128), np.empty((2, len(which)))
        over_edges = np.zeros(len(which), dtype=bool)
        for number in np.unique(events.family[which]).tolist():
            mine, chain = events.family[which] == number, events.chains[number]
            over_edges[mine] = isinstance(chain.vertex, EdgeVertex)
            beside = _BESIDE_BODIES if events.scene.bodies else _BESIDE
            ahead = beside * (1.0 - 2.0 * events.side[which[mine]])  # there are no steps within the interval
            near, far = (_each(chain, events.row[which[mine]], time[mine] + x * ahead, at) for x in (1.0, 3.0))
            value[mine], times[:, mine] = (1.5 * one - 0.5 * other for one, other in zip(near, far, strict=True))
        loudest = _strongest(events, pair, np.linspace(exact[0], exact[-1], _INSTANTS), at, direct)(time)
        key = 2 * unique_rows(np.stack([events.family[which], events.row[which]], axis=1))[2] + events.side[which]
        place = np.full(2 * len(which), -1)
        place[key] = np.arange(len(which))
        other = place[key ^ 1]
        return _PairEvents(
            events, which, instant, time, over_edges, value, times[0], times[1], other, at.frequencies, loudest
        )

    def groups(self) -> Iterator[Rows]:
        """Yield the events (k,) at one instant of paths that are as long as each other."""
        order = np.lexsort((self.delay, self.instant))
        apart = (np.diff(self.instant[order]) > 0) | (np.diff(self.delay[order]) > SAME_DELAY)
        for group in np.split(order, np.flatnonzero(apart) + 1):
            if self.over_edges[group].any():
                yield group

    def missing(self, group: Rows) -> tuple[Any, ...]:
        """Find which of a group's events (k,) miss shares of their paths, and `FadeColumns` of these, (k,) each.

        The shares together are the jump, and have the least sum of squares.
        """
        turned = self.value[group] * np.exp(
            -2j * np.pi * self.frequencies * (self.delay[group] - self.delay[group[0]])[:, None]
        )
        signed = turned * (1.0 - 2.0 * self.events.side[self.which[group]])[:, None]
        jump, loudest = signed.sum(axis=0), max(np.abs(turned).max(), self.loudest[group[0]])
        span, *columns_of_time = self._spans(group)
        own = self.over_edges[group] & (span >= _SHORTEST)
        if np.abs(jump).max() <= _LEAST * loudest or not own.any():
            return (np.empty(0, dtype=np.int64),) * (1 + len(fields(FadeColumns)))
        columns = signed[own].T
        squares = columns @ columns.conj().T
        squares += _DAMPING * np.trace(squares).real * np.eye(len(squares))
        share = columns.conj().T @ np.linalg.solve(squares, jump)
        return self.which[group[own]], share, span[own], *(column[own] for column in columns_of_time)

    def _spans(self, group: Rows) -> tuple[Floats, ...]:
        """Compute times (k,) in which all moves by the Fresnel zone's width, at most half of an interval, s.

        With them come the moments, and the weights of the times of emission and of what moves, see `FadeColumns`.
        """
        which, now, events = self.which[group], self.time[group[0]], self.events
        scene, chains = events.scene, events.chains
        source, receiver = divmod(int(events.pair[which[0]]), len(scene.receivers))
        ends = (scene.sources[source], now - self.delay[group[0]]), (scene.receivers[receiver], now)
        moved = [float(np.linalg.norm(end.trajectory.velocity(np.array([t])))) for end, t in ends]
        rows = zip(events.family[which].tolist(), events.row[which].tolist(), strict=True)
        met = np.array([chains[family].speeds[row] for family, row in rows])
        speed = np.maximum(sum(moved) + met, _SLOWEST)
        sent, met = moved[0] / speed, met / speed
        other, sign = self.other[group], 1.0 - 2.0 * events.side[which]
        one, last = (events.time[self.which[x]] - sent * self.delay[x] - met * self.onwards[x] for x in (group, other))
        room = np.where(other < 0, np.inf, 0.5 * sign * (last - one))
        c, middle = scene.air.speed_of_sound, self.frequencies[len(self.frequencies) // 2]
        zone = c * np.sqrt(self.delay[group] / middle)
        return np.minimum(np.clip(zone / speed, _SHORTEST, _LONGEST), room), one, sent, met


def _each(chain: Chain, rows: Rows, times: Floats, at: SceneResponse) -> tuple[Complexes, Floats]:
    """Responses (n, F) of paths of a pair, each at a time of its own, s, and delays from source and edge (2, n), s.

    Frequencies are those that arrive at edges at rest, whoever else moves: so shares are the same both ways.
    """
    air = chain.scene.air
    if isinstance(chain.vertex, EdgeVertex) and not (chain.legs[0].moving or air.layers or air.fluctuation):
        found = chain.arrivals(rows, times[:, None])
        response: Any = chain.response(rows, _unshifted(chain, found), times[:, None], at)
        return response[:, 0], np.stack([found.delay[:, 0], np.zeros(len(rows))])
    value, delays = np.empty((len(rows), len(at.frequencies)), dtype=np.complex128), np.zeros((2, len(rows)))
    for first in range(0, len(rows), _ONE_BY_ONE):
        some = slice(first, first + _ONE_BY_ONE)
        here, now = rows[some], times[some]
        found = chain.arrivals(here, now)
        value[some] = np.einsum("iif->if", chain.response(here, _unshifted(chain, found), now, at))
        onwards = found.more.get("onwards", np.zeros_like(found.delay))
        delays[:, some] = np.diagonal(found.delay), np.diagonal(onwards)
    return value, delays


def _unshifted(chain: Chain, found: Arrivals) -> Arrivals:
    """Arrivals without Doppler shifts; as they are where bodies move."""
    if any(body.peak_speed > 0.0 for body in chain.scene.bodies):
        return found
    one = np.ones_like(found.delay)
    more = found.more | ({"doppler": one} if "doppler" in found.more else {})
    return replace(found, frequency_ratio=one, mach_factor=one, more=more)


def _strongest(events: Events, pair: int, times: Floats, at: SceneResponse, direct: bool) -> Any:
    """Make a function of times (n,), s: the pressure (n,) of the strongest path without edges about each, or less."""
    most = np.zeros(len(times))
    source, receiver = divmod(pair, len(events.scene.receivers))
    for chain in events.chains:
        if chain.vertex is None:
            mine = (chain.source == source) & (chain.receiver == receiver) & (direct | (chain.order > 0))
            rows = np.flatnonzero(mine)
            if len(rows):
                found = chain.arrivals(rows, times)
                active = (chain.start[rows, None] <= times) & (times < chain.end[rows, None])
                level = np.abs(chain.response(rows, found, times, at)).min(axis=2)
                most = np.maximum(most, np.max(level * active, axis=0))

    def at_times(now: Floats) -> Floats:
        after = np.clip(np.searchsorted(times, now), 1, len(times) - 1)
        return np.minimum(most[after - 1], most[after])

    return at_times
