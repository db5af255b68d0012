"""Time for which the state of a path by moving mirrors is certain.

Times are counted from that of reception and places are those of the air's frame, so that a room at rest stays where it
is. A path is a straight line from an image event to the reception, and leg k of it the line from the event S_k, the
emission mirrored k times, to R_k, the reception mirrored back; it meets mirror k at the share s_k. As reception goes
on, by one second, S_k and R_k move in space by a, m, and in time by b, m of sound's way, at most. A Lorentz reflection
with the Mach number M makes of these

    a' = (1 + M²) / (1 - M²) a + 2 M / (1 - M²) b + p,        b' = (1 + M²) / (1 - M²) b + 2 M / (1 - M²) a + q

of which p and q are what the mirror's own motion does to an image at a distance L from where it is met:

    p = 2 / (1 - M²) (V + L ((1 + M) w + m (1 + M) / (1 - M))),
    q = 2 / (1 - M²) (M V + L (M w + m (1 + M) / (1 - M)))

V is the mirror's speed, w its turn, and m how fast its Mach number may change where it is met: by the acceleration of
its points, by ``2 w V / c``, and by ``w u / c`` while the place moves on by u. That follows from the derivative of
``X - 2 G(X) N / (1 - M²)``, G the height over the mirror, by the mirror's normal (M, n): n and its change stand at
right angles. V, w and m are those of the surface's tangent, so that to first order where it touches does not matter.

A point of a line at a fixed share moves by no more than both its ends do in these shares. It meets a mirror, over
which heights along the line grow by H, at a share that moves by no more than its height does, h, over H, and there at a
place that moves by ``r + h D / H``, D being the line's length. H shrinks, too, as paths come to graze a mirror: bounds
are those of three quarters of it, and hold until it may be less. So each of what decides (which side, on the face or
beside it, in the way or not) is a distance and a speed at which it can shrink, and their ratio a time for which it
stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, Floats, by_value
from clsim.paths.legs.events import Events
from clsim.paths.legs.mirrors import ROOM, Mirrors, dot
from clsim.paths.propagation import UniformAir
from clsim.paths.visibility.rates import FAR, Pace, lasts, middle_of

PaceOf = Callable[[NDArray[np.int64], Floats], Pace]

EARLIER = 1.25  # of a delay, by which what a path meets within a stretch of time was met before it, and more
_MOST_DILATION = 2.0  # of a second of emission to one of reception that is taken first, and checked
_MOST_SLIDE = 0.5  # of the speed of sound, at which places on mirrors that turn move on, the same
_ROUNDS = 2  # in which bounds are made narrower
_MARGIN = 0.25  # of a path's length or rise, by which it may slide or shrink before bounds no longer hold
_LESS = 0.8  # of that margin: both length and share may change
_TURNS = 2  # of finding when sound is at the middle of a face, and when it was emitted
_BRIEF = 2e-2  # s; faces that turn past all their points within twice that are looked at at every sample then
_WIDEST, _CHORD = 0.5, 1.0353  # sine of an angle between two points of a face, and unit vectors' chord by it
_TAME = 1e-4  # m, by which events may lie off the line for the bounds to hold of where mirrors are met


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """The straight lines of n paths of N mirrors at one time of reception each."""

    share: Floats  # (n, N) at which mirrors are met, from 0 at the source to 1 at the receiver if they are met in order
    rise: Floats  # (n, N) how much the height over each mirror changes along the whole line, m
    length: Floats  # (n,) of the line, m
    # (n, N + 2, 3) in the room, m, and after the reception, s: emission, where mirrors are met, reception.
    place: Floats
    time: Floats  # (n, N + 2) likewise
    start: Floats  # (n, N, 3) what mirror k reflects, S_{k-1}, and where it is reflected to, R_k, in the room, m
    stop: Floats  # likewise
    tame: Bools  # (n, N) whether events lie where mirrors are taken from their motion
    now: Floats  # (n,) times of reception, s


def straightened(mirrors: Mirrors, walls: NDArray[Any], events: Events, now: Floats, medium: UniformAir) -> Line:
    """Return the lines of paths by mirrors (n, N), none of them -1, from their events at times (n,)."""
    count, order = walls.shape
    wind, c = np.array(medium.wind or (0.0, 0.0, 0.0)), medium.speed_of_sound
    planes = []
    for k in range(order):
        plane = mirrors.planes(walls[:, k], now[:, None], events.time[:, :, k + 1], events.place[:, :, k + 1])
        planes.append((plane.normal[:, 0], plane.offset[:, 0], plane.speed[:, 0] - plane.normal[:, 0] @ wind))
    start, stop = np.empty((2, count, order + 1, 4))
    start[:, 0, 0] = events.time[:, 0, 0]
    start[:, 0, 1:] = events.place[:, 0, 0] - events.time[:, 0, :1] * wind
    stop[:, order, 0], stop[:, order, 1:] = 0.0, events.place[:, 0, -1]
    for k in range(order):
        start[:, k + 1] = _mirrored(planes[k], start[:, k], c)
    for k in range(order, 0, -1):
        stop[:, k - 1] = _mirrored(planes[k - 1], stop[:, k], c)
    before = [_height(planes[k], start[:, k + 1]) for k in range(order)]
    behind = [_height(planes[k], stop[:, k + 1]) for k in range(order)]
    far, near = (np.stack(x, axis=1) if order else np.empty((count, 0)) for x in (before, behind))
    rise = near - far
    share = -far / np.where(rise == 0.0, 1e-300, rise)
    share = np.clip(share, -FAR, FAR)
    place, time = np.empty((count, order + 2, 3)), np.empty((count, order + 2))
    place[:, [0, -1]] = events.place[:, 0, [0, -1]]
    time[:, 0], time[:, -1] = start[:, 0, 0], 0.0
    met = start[:, 1:] + np.clip(share, -1e3, 1e3)[..., None] * (stop[:, 1:] - start[:, 1:])
    time[:, 1:-1] = met[..., 0]
    place[:, 1:-1] = met[..., 1:] + met[..., :1] * wind
    apart = np.linalg.norm(place[:, 1:-1] - events.place[:, 0, 1:-1], axis=2)
    front, back = (x[..., 1:] + x[..., :1] * wind for x in (start[:, :-1], stop[:, 1:]))
    length = np.linalg.norm((stop - start)[:, 0, 1:], axis=1)
    return Line(share, np.abs(rise), length, place, time, front, back, apart <= _TAME, now)


def _height(plane: tuple[Floats, Floats, Floats], event: Floats) -> Floats:
    normal, offset, speed = plane
    return np.asarray(dot(normal, event[:, 1:]) - speed * event[:, 0] - offset)


def _mirrored(plane: tuple[Floats, Floats, Floats], event: Floats, c: float) -> Floats:
    normal, _, speed = plane
    height = 2.0 * _height(plane, event) / (1.0 - (speed / c) ** 2)
    out = np.array(event)
    out[:, 1:] -= height[:, None] * normal
    out[:, 0] -= height * speed / c**2
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Upper bounds of the rates at which the criteria of n paths by N mirrors change, per time of reception."""

    dilation: Floats  # (n, N + 2) of times of events to those of reception
    place: Floats  # (n, N + 2) of emission, where mirrors are met, and reception in the room, m/s
    share: Floats  # (n, N) of the shares at which mirrors are met, 1/s
    start: Floats  # (n, N) of the heights over mirrors of what they reflect, and of where to, m/s
    stop: Floats  # likewise
    steady: Floats  # (n, N) for how long those of shares and of places on mirrors are bounds, s, as the rise shrinks
    holds: Floats  # (n,) for how long these are bounds, s; 0 where they are none

    def slides(self, body: NDArray[np.int64], pace: Pace, far: Floats) -> Floats:
        """Bound the speeds of places on mirrors of bodies (n, N), so far from their middles, in their axes, m/s."""
        rows = np.arange(len(body))[:, None]
        speed, turn = (x[rows, np.maximum(body, 0)] for x in (pace.speed, pace.turn))
        slide, late = self.place[:, 1:-1], self.dilation[:, 1:-1]
        away = far + pace.half[:, None] * (slide + late * speed)
        return np.asarray(np.where(body == ROOM, slide, slide + late * (speed + turn * away)))


@dataclass(frozen=True, slots=True, eq=False)
class _Mirrored:
    """Motions of the mirrors of n paths, (n, N) each, at most: see the file's beginning."""

    speed: Floats
    turn: Floats
    gain: Floats
    jolt: Floats
    mach: Floats
    away: Floats
    start: Floats
    stop: Floats
    spare: Floats


def drift(mirrors: Mirrors, walls: NDArray[Any], line: Line, pace: Pace, medium: UniformAir, there: Bools) -> Drift:
    """Bound the rates of lines of paths; those `there` (n,) meet all faces: their mirrors are as fast as bodies."""
    c = medium.speed_of_sound
    wind = float(np.linalg.norm(medium.wind or (0.0, 0.0, 0.0)))
    moves = _motions(mirrors, walls, line, pace, there, c, wind)
    turns = (moves.turn > 0.0) | (moves.gain > 0.0) | (moves.jolt > 0.0)
    crude = np.full((len(walls), walls.shape[1] + 2), _MOST_DILATION), np.full(walls.shape, _MOST_SLIDE * c)
    first = _drift(moves, line, pace, crude, c, wind)
    resting = ~turns & (moves.speed == 0.0)
    even = (first.dilation <= crude[0]) | np.pad(resting, ((0, 0), (1, 1)))
    ok = np.all(even, axis=1) & np.all((first.place[:, 1:-1] <= crude[1]) | (moves.turn == 0.0), axis=1)
    ok &= np.all(line.tame | (moves.turn == 0.0), axis=1) | ~there
    found = first
    for _ in range(_ROUNDS):
        known = np.minimum(found.dilation, crude[0]), np.minimum(found.place[:, 1:-1], crude[1])
        found = _drift(moves, line, pace, known, c, wind)
    stretch = c * (found.dilation[:, 0] - 1.0) / np.maximum(line.length, 1e-9)
    quickest = np.maximum(found.start / moves.start, found.stop / moves.stop)
    slides = np.where(line.tame, found.share + stretch[:, None], quickest)
    slides = np.maximum(slides, _MARGIN * (found.place[:, 1:-1] + _MOST_DILATION * moves.speed) / moves.spare)
    slides = np.where(turns, slides, 0.0).max(axis=1, initial=0.0)
    holds = np.where(ok, lasts(np.full(len(walls), _LESS * _MARGIN), slides), 0.0)
    wider = np.where(turns, 1.0, 1.0 / (1.0 - _MARGIN))  # what turns slides farther before heights shrink as much
    steady = np.where(turns, FAR, lasts(_MARGIN * line.rise, found.start + found.stop))
    found.place[:, 1:-1] = np.minimum(found.place[:, 1:-1] * wider, FAR)
    found.dilation[:, 1:-1] = 1.0 + (found.dilation[:, 1:-1] - 1.0) * wider
    return replace(found, share=np.minimum(found.share * wider, FAR), steady=steady, holds=holds)


def _motions(
    mirrors: Mirrors, walls: NDArray[Any], line: Line, pace: Pace, there: Bools, c: float, wind: float
) -> _Mirrored:
    """Motion of mirrors: on a body's faces as its points, else as far off as mirrors are continued."""
    owner = mirrors.owner[walls]
    moving, body = owner != ROOM, np.maximum(owner, 0)
    middles = [middle_of(b) for b in mirrors.bodies]
    limit, lever = (np.array([getattr(m, name) for m in middles])[body] for name in ("limit", "lever"))
    rows = np.arange(len(walls))[:, None]
    of_bodies = pace.speed, pace.turn, pace.gain, pace.lift, pace.jolt, pace.twist
    speed, turn, gain, lift, jolt, twist = (np.where(moving, x[rows, body], 0.0) for x in of_bodies)
    when = np.where(moving, line.time[:, 1:-1], 0.0)
    middle = np.zeros((*walls.shape, 3))
    for number, thing in enumerate(mirrors.bodies):
        p, k = np.nonzero(owner == number)
        middle[p, k] = thing.placed(middles[number].place, line.now[p] + when[p, k])
    off = np.linalg.norm(line.place[:, 1:-1] - middle, axis=2)
    spare = np.where(there[:, None] | ~line.tame, FAR, _MARGIN * off + lever)
    arm = np.where(there[:, None], lever, np.where(line.tame, off + spare, limit))
    far, near = ((1.0 + _MARGIN) * (np.linalg.norm(x - middle, axis=2) + limit) for x in (line.start, line.stop))
    shares = (np.abs(x) + _MARGIN for x in (line.share, 1.0 - line.share))
    shares = (np.where(there[:, None], np.minimum(x, 1.0), x) for x in shares)
    start, stop = (np.where(line.tame, x * line.length[:, None], y) for x, y in zip(shares, (far, near), strict=True))
    moved = speed + turn * arm
    away = np.where(line.tame, 0.0, off + limit)
    return _Mirrored(
        moved, turn, gain + lift * arm + 2.0 * turn * moved, jolt + twist * arm, (moved + wind) / c, away * turn, start,
        stop, spare,
    )  # fmt: skip


def _drift(moves: _Mirrored, line: Line, pace: Pace, crude: tuple[Floats, Floats], c: float, wind: float) -> Drift:
    """Return bounds from cruder ones, of the dilation (n, N + 2) and of how fast places on mirrors move (n, N), m/s."""
    dilation, late, slide = crude[0][:, 0], crude[0][:, 1:-1], crude[1]
    mach, order = moves.mach, moves.mach.shape[1]
    doppler, over = (1.0 + mach) / (1.0 - mach), 1.0 / (1.0 - mach**2)
    jolts = moves.jolt / np.maximum(pace.half, 1e-12)[:, None]
    quickens = (moves.gain * late + jolts + moves.turn * slide) / c  # of Mach numbers, 1/s
    own, other, mixed = 2.0 * over, (1.0 + mach**2) * over, 2.0 * mach * over

    def pushed(apart: Floats, k: int) -> tuple[Floats, Floats]:
        turned, quick = moves.turn[:, k] * late[:, k], doppler[:, k] * quickens[:, k]
        space = own[:, k] * (moves.speed[:, k] + apart * ((1.0 + mach[:, k]) * turned + quick))
        return space, own[:, k] * (mach[:, k] * moves.speed[:, k] + apart * (mach[:, k] * turned + quick))

    def through(a: Floats, b: Floats, apart: Floats, k: int) -> tuple[Floats, Floats]:
        space, time = pushed(apart, k)
        return other[:, k] * a + mixed[:, k] * b + space, other[:, k] * b + mixed[:, k] * a + time

    a, b = pace.source, np.zeros(len(mach))
    for k in range(order):
        a, b = through(a, b, moves.start[:, k], k)
    least = np.maximum((1.0 - (pace.source + wind) / c) / np.prod(doppler, axis=1), 1e-3)
    slower = (pace.receiver + a + b) / (c * least)
    fronts = [(pace.source * dilation + wind * (dilation - 1.0), c * (dilation - 1.0))]
    backs = [(pace.receiver, np.zeros(len(mach)))]
    for k in range(order):
        fronts.append(through(*fronts[-1], moves.start[:, k], k))
        backs.insert(0, through(*backs[0], moves.stop[:, order - 1 - k], order - 1 - k))
    share, place, start, stop = (np.empty(mach.shape) for _ in range(4))
    for k in range(order):
        s, r = np.abs(line.share[:, k]), np.abs(1.0 - line.share[:, k])
        line_moves = np.minimum(s * backs[k][0] + r * fronts[k][0], s * backs[k + 1][0] + r * fronts[k + 1][0])
        tilts = moves.turn[:, k] * late[:, k] + quickens[:, k]
        own_moves = moves.speed[:, k] + moves.away[:, k] * late[:, k] + mach[:, k] * c * (dilation - 1.0)
        with np.errstate(divide="ignore", over="ignore"):
            share[:, k] = np.minimum((line_moves + own_moves) / np.maximum(line.rise[:, k], 1e-300), FAR)
        place[:, k] = line_moves + line.length * share[:, k] + wind * (dilation - 1.0)
        for out, (x, y), apart in ((start, fronts[k], moves.start[:, k]), (stop, backs[k + 1], moves.stop[:, k])):
            out[:, k] = x + mach[:, k] * y + moves.speed[:, k] + apart * tilts
    places = np.column_stack([pace.source * dilation, np.minimum(place, FAR), pace.receiver])
    dilation = 1.0 + (np.pad(line.length[:, None] / c * share, ((0, 0), (1, 1))) + slower[:, None])
    return Drift(dilation, places, share, start, stop, np.empty(0), np.empty(0))


def absent(line: Line, change: Drift, holds: Bools, beside: Floats) -> Floats:
    """Return for how long it is certain that paths do not meet all their mirrors in order, (n,) s."""
    far, near = np.abs(line.share) * line.rise, np.abs(1.0 - line.share) * line.rise
    one_side = (line.share <= 0.0) | (line.share >= 1.0)
    sure = np.where(one_side, np.minimum(lasts(far, change.start), lasts(near, change.stop)), 0.0)
    off = line.tame & ~holds & ~one_side
    sure = np.maximum(sure, np.where(off, np.minimum(beside, change.steady), 0.0)).max(axis=1, initial=0.0)
    late = line.share[:, :-1] - line.share[:, 1:]
    wrong = np.where(late > 0.0, lasts(np.maximum(late, 0.0), change.share[:, :-1] + change.share[:, 1:]), 0.0)
    wrong = np.minimum(wrong, np.minimum(change.steady[:, :-1], change.steady[:, 1:]))
    return np.asarray(np.maximum(sure, wrong.max(axis=1, initial=0.0)))


def behind(mirrors: Mirrors, walls: NDArray[Any], line: Line, pace: Pace, medium: UniformAir, delay: Floats) -> Floats:
    """Return for how long a face that moves surely has source and receiver on both its sides, (n,) s.

    That is asked of paths that one moving face alone reflects: all images by walls rest as the ends do, and
    whenever sound may meet the face, it is in a pose that differs from one of these by no more than it moves.
    """
    sure = np.zeros(len(walls))
    moving = np.append([not body.is_static for body in mirrors.bodies], False)[mirrors.owner[walls]]
    if medium.wind is not None:
        return sure
    rows = np.flatnonzero(np.sum(moving, axis=1) == 1)
    k = np.argmax(moving[rows], axis=1)
    surface = walls[rows, k]
    for face, p in by_value(surface):
        n, body = rows[p], int(mirrors.owner[face])
        when = line.now[n] - 0.5 * delay[n]
        own = [mirrors.bodies[body].seen(x[n, k[p]], when) for x in (line.start, line.stop)]
        heights = [x @ mirrors.normal[face] - mirrors.offset[face] for x in own]
        found = np.full(len(n), FAR)
        for height, place, end in zip(heights, own, (pace.source[n], pace.receiver[n]), strict=True):
            away = np.linalg.norm(place - middle_of(mirrors.bodies[body]).place, axis=1) + pace.half[n] * end
            faced = pace.speed[n, body] + pace.turn[n, body] * away
            off = np.abs(height) - EARLIER * delay[n] * (faced + end)
            found = np.minimum(found, lasts(np.maximum(off, 0.0), EARLIER * (faced + end)))
        sure[n] = np.where(heights[0] * heights[1] < 0.0, found, 0.0)
    return sure


def averted(
    mirrors: Mirrors, walls: NDArray[Any], ends: tuple[Any, Any], now: Floats, pace_of: PaceOf, medium: UniformAir
) -> tuple[Floats, Bools]:
    """Return for how long the one moving face of paths surely is so turned that no point of it reflects, (n,) s.

    The mask (n,) is of faces for which this is known but for some milliseconds about a glint.
    A point of a face that moves at v sees both ends along the unit vectors a and b, with the parts a' and b' in its
    plane. Where it reflects, ``a' (c - b v) + b' (c + a v) = 0`` by Fermat's principle, so that ``|a' + b'| <= 2 v /
    c``. In the body's axes that sum is the one of the face's middle but for the angles under which the ends see the
    face and what moves, and for turns. No line is drawn on to a mirror: that holds however a path is slanted.
    """
    sure, far = np.zeros(len(walls)), np.zeros(len(walls), dtype=bool)
    moving = np.append([not body.is_static for body in mirrors.bodies], False)[mirrors.owner[walls]]
    if medium.wind is not None:
        return sure, far
    number = np.where(np.sum(moving, axis=1) == 1, np.argmax(moving, axis=1), -1)
    for k in np.unique(number[number >= 0]).tolist():
        for face in np.unique(walls[number == k, k]).tolist():
            p = np.flatnonzero((number == k) & (walls[:, k] == face))
            seen = _Middle.of(mirrors, walls[p], k, (ends[0], ends[1].part(p)), now[p], medium.speed_of_sound)
            pace = pace_of(p, 2.0 * (now[p] - seen.emitted))
            sure[p], far[p] = seen.averted(mirrors, int(mirrors.owner[face]), pace, medium)
    return sure, far


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """How the middle of a moving face sees both ends of n paths, or their images by walls at rest."""

    emitted: Floats  # (n,) when sound leaves the source that goes by the middle, s
    sums: Floats  # (n,) lengths of a' + b', see `averted`
    apart: tuple[Floats, Floats]  # (n,) distances from source and receiver, m
    size: float  # how far points of the face are from its middle, m
    unsure: float  # of those times, s

    @staticmethod
    def of(mirrors: Mirrors, walls: NDArray[Any], k: int, ends: tuple[Any, Any], now: Floats, c: float) -> _Middle:
        face, zeros = int(walls[0, k]), np.zeros((len(now), 1))
        number = int(mirrors.owner[face])
        body, local = mirrors.bodies[number], face - int(mirrors.first[number])
        middle = body.mesh.walls.centre[local]

        def image(place: Floats, met: NDArray[Any]) -> Floats:
            for each in met:
                plane = mirrors.planes(each, now[:, None], zeros, None)
                place = place - 2.0 * plane.height(zeros, place)[..., None] * plane.normal
            return place[:, 0]

        ear = image(ends[1].position(now[:, None]), walls[:, :k:-1].T)
        event = now
        for _ in range(_TURNS):
            before, event = event, now - np.linalg.norm(ear - body.placed(middle, event), axis=1) / c
        unsure, place, emission = np.abs(event - before), body.placed(middle, event), event
        for _ in range(_TURNS):
            source = image(ends[0].position(emission[:, None]), walls[:, :k].T)
            before, emission = emission, event - np.linalg.norm(source - place, axis=1) / c
        own = [body.seen(x, event) - middle for x in (source, ear)]
        apart = [np.linalg.norm(x, axis=1) for x in own]
        sums = sum(x / np.maximum(d, 1e-300)[:, None] for x, d in zip(own, apart, strict=True))
        sums = sums - (sums @ mirrors.normal[face])[:, None] * mirrors.normal[face]
        worst = float(np.max(unsure + np.abs(emission - before), initial=0.0))
        return _Middle(
            emission, np.linalg.norm(sums, axis=1), (apart[0], apart[1]), float(body.mesh.walls.radius[local]), worst
        )

    def averted(self, mirrors: Mirrors, body: int, pace: Pace, medium: UniformAir) -> tuple[Floats, Bools]:
        """Return for how long the sum surely differs from what it is where the face reflects, (n,) s; see `averted`."""
        c, source, ear = medium.speed_of_sound, pace.source, pace.receiver
        fast = pace.speed[:, body] + pace.turn[:, body] * middle_of(mirrors.bodies[body]).lever
        # By how much, s, an event at the face and the emission may differ from those of the middle, and go on.
        met = self.size / (c - fast) + self.unsure, (c + ear) / (c - fast)
        left = ((c + fast) * met[0] + self.size) / (c - source) + self.unsure, (c + fast) * met[1] / (c - source)
        moves = [self.size + source * left[0] + fast * met[0], source * left[1] + fast * met[1]]
        other = [self.size + fast * met[0], ear + fast * met[1]]
        first, then = 2.0 * fast / c + 2.0 * pace.turn[:, body] * met[0], 2.0 * pace.turn[:, body] * met[1]
        sure = np.full(len(fast), FAR)
        for (start, speed), apart in zip((moves, other), self.apart, strict=True):
            first, then = first + _CHORD * start / apart, then + _CHORD * speed / apart
            sure = np.minimum(sure, lasts(np.maximum(_WIDEST * apart - start, 0.0), speed))
        known = (sure > 0.0) & (left[1] <= EARLIER)  # within the times that the pace is of
        sure = np.where(known, np.minimum(sure, lasts(np.maximum(self.sums - first, 0.0), then)), 0.0)
        return sure, known & (first < _BRIEF * then)
