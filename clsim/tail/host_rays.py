"""Rays of energy on the host: the definition of right, in the operations and the order of kernel `rays`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.tail.ray_room import (
    ANGLES,
    ESCAPE_SCALE,
    FAINT,
    FARTHEST,
    MOST_REFLECTIONS,
    SLOTS,
    Energies,
    Float32s,
    Layout,
    RayRoom,
    RayRun,
)

Ints = NDArray[Any]
Met = tuple[Float32s, Ints]

NOWHERE = np.float32(3.0e38)
FLOOR = 10.0**-6.5  # of the energy, below which nothing is heard
PI = np.float32(np.pi)
_ONE, _HALF, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(0.0)
_AT_ONCE = 2**15  # rays, for their memory


def dot(a: Float32s, b: Float32s) -> Float32s:
    """Return products (...) of vectors (..., 3), summed in the kernel's order."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def philox(counter: Ints, key: tuple[int, int]) -> Ints:
    """Return random words (n, 4) of counters (n, 4): Philox-4x32 with ten rounds, see `rays/philox.h`."""
    word, (first, second) = np.uint64(0xFFFFFFFF), key
    a, b, c, d = counter.astype(np.uint64).T
    for i in range(10):
        one, other = np.uint64(0xD2511F53) * a, np.uint64(0xCD9E8D57) * c
        keys = np.uint64((first + i * 0x9E3779B9) % 2**32), np.uint64((second + i * 0xBB67AE85) % 2**32)
        half = np.uint64(32)
        a, b, c, d = (other >> half) ^ b ^ keys[0], other & word, (one >> half) ^ d ^ keys[1], one & word
    return np.stack([a, b, c, d], axis=1).astype(np.uint32)


def uniform(words: Ints) -> Float32s:
    """Return numbers (n,) in [0, 1)."""
    return np.asarray((words >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24))


def on_circle(words: Ints) -> tuple[Float32s, Float32s]:
    """Return cosines and sines (n,) of even angles, by polynomials over a quadrant."""
    part = ((words & np.uint32(0x3FFFFFFF)) >> np.uint32(6)).astype(np.float32) * np.float32(2.0**-24) - _HALF
    x = part * np.float32(1.57079637)
    square = x * x
    f = np.float32
    sine = x * (_ONE + square * (f(-0.166666672) + square * (f(0.00833333377) + square * f(-0.000198412701))))
    cosine = _ONE + square * (
        f(-0.5) + square * (f(0.0416666679) + square * (f(-0.00138888892) + square * f(2.48015876e-05)))
    )
    quadrant = words >> np.uint32(30)
    return np.choose(quadrant, [cosine, -sine, -cosine, sine]), np.choose(quadrant, [sine, cosine, -sine, -cosine])


def unit(d: Float32s) -> Float32s:
    """Return directions (n, 3), one step of Newton's nearer to the length 1."""
    share = np.float32(1.5) - _HALF * dot(d, d)
    return np.asarray(d * share[:, None])


def next_wall(room: RayRoom, o: Float32s, d: Float32s, below: Float32s) -> Met:
    """Return distances (n,) of the next wall below some distances (n,), m, and its index, -1 for none."""
    return _next_plane(room, o, d, below) if room.convex else _next_triangle(room, o, d, below)


def _next_plane(room: RayRoom, o: Float32s, d: Float32s, below: Float32s) -> Met:
    far: Any = below.copy()
    wall: Any = np.full(len(o), -1)
    for w, plane in enumerate(room.plane):
        towards, height = dot(plane[:3], d), dot(plane[:3], o) - plane[3]
        with np.errstate(divide="ignore", invalid="ignore"):
            mine = np.maximum(height, _ZERO) / -towards
        nearer = (towards < 0.0) & (mine < far)
        far, wall = np.where(nearer, mine, far), np.where(nearer, w, wall)
    return far, wall


def _next_triangle(room: RayRoom, o: Float32s, d: Float32s, below: Float32s) -> Met:
    slope = _ONE / np.where(d == 0.0, np.float32(1e-18), d)
    node, place = np.nonzero(room.children < 0)
    boxes = room.boxes[node, :, place]  # (L, 6) of the leaves
    near, last = np.full((len(o), len(boxes)), -np.inf, np.float32), np.full((len(o), len(boxes)), np.inf, np.float32)
    for axis in range(3):
        start, slant = o[:, axis, None], slope[:, axis, None]
        low, high = ((boxes[:, 2 * axis + i] - start) * slant for i in range(2))
        ahead = slant >= 0.0
        near = np.maximum(near, np.where(ahead, low, high))
        last = np.minimum(last, np.where(ahead, high, low))
    ray, leaf = np.nonzero((near <= last) & (last >= 0.0) & (near <= below[:, None]))
    near = np.maximum(near[ray, leaf], _ZERO)
    leaves: Any = ~room.children[node, place][leaf]
    found = _in_leaves(room, leaves, o[ray], d[ray], near)
    far = below.copy()
    wall: Any = np.full(len(o), -1)
    lowest: Any = np.full(len(o), -1)
    row, column = np.nonzero(found < NOWHERE)
    held, number, of = found[row, column], 8 * leaves[row] + column, ray[row]
    order = np.lexsort((number, held, of))
    of, first = np.unique(of[order], return_index=True)
    best = order[first]
    met = held[best] < below[of]
    far[of[met]], lowest[of[met]] = held[best][met], number[best][met]
    wall[of[met]] = room.wall_of.reshape(-1)[lowest[of[met]]]
    return far, wall


def _in_leaves(room: RayRoom, leaf: Ints, o: Float32s, d: Float32s, near: Float32s) -> Float32s:
    """Return distances (n, 8) at which rays meet the triangles of leaves, one leaf for each ray."""
    at = np.moveaxis(room.leaves[leaf], 1, 0)  # (13, n, 8)
    start, heading = o.T[:, :, None], d.T[:, :, None]
    a, b, c = (at[3 * i : 3 * i + 3] - start for i in range(3))
    one, two, three = (_passes(heading, *edge) for edge in ((a, b), (b, c), (c, a)))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        height = at[12] - (at[9] * start[0] + at[10] * start[1] + at[11] * start[2])
        far = height / (at[9] * heading[0] + at[10] * heading[1] + at[11] * heading[2])
    left, right = (one >= 0.0) & (two >= 0.0) & (three >= 0.0), (one <= 0.0) & (two <= 0.0) & (three <= 0.0)
    met = (left | right) & (far > 0.0)
    return np.where(met, np.maximum(far, near[:, None]), NOWHERE)


def _passes(d: Float32s, a: Float32s, b: Float32s) -> Float32s:
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return np.asarray(d[0] * x + d[1] * y + d[2] * z)


class HostRays:
    """Traces rays in NumPy."""

    def trace(self, run: RayRun, layout: Layout, energies: Energies) -> None:
        """Trace a run's rays and add up their energies."""
        for group in range(len(run.until)):
            for first in range(0, len(run.directions), _AT_ONCE):
                rays = np.arange(first, min(first + _AT_ONCE, len(run.directions)))
                _Traced(run, layout, energies, group, rays).trace()


class _Traced:
    """Rays of one group of bands under way."""

    def __init__(self, run: RayRun, layout: Layout, energies: Energies, group: int, rays: Ints) -> None:
        self._run, self._to, self._energies, self._group, self._ray = run, layout, energies, group, rays
        self._bands = slice(int(run.first_band[group]), int(run.first_band[group + 1]))
        self._o = np.tile(run.origin, (len(rays), 1))
        self._d = run.directions[rays].copy()
        self._energy = run.emitted[rays, self._bands].copy()
        self._loudest = self._energy.max(axis=1)
        self._floor = self._loudest * np.float32(FLOOR)
        self._travelled = np.zeros(len(rays), np.float32)
        self._scattered, self._fresh = np.zeros((2, len(rays)), np.bool_)
        self._last = np.full(len(rays), -1)
        self._face = np.zeros((len(rays), 3), np.float32)
        self._far, self._wall = self._next(self._o, self._d)

    def trace(self) -> None:
        """Follow them to their ends."""
        for order in range(MOST_REFLECTIONS):
            self._keep((self._loudest > self._floor) & (self._travelled < self._run.until[self._group]))
            if not len(self._ray):
                return
            for zone in range(len(self._to.zones)):
                self._cross(zone, order)
            self._escape(self._wall < 0)
            self._keep(self._wall >= 0)
            self._reflect(order)

    def _next(self, o: Float32s, d: Float32s) -> Met:
        return next_wall(self._run.room, o, d, np.full(len(o), NOWHERE))

    def _keep(self, kept: Ints) -> None:
        if not kept.all():
            for name in (
                "_ray", "_o", "_d", "_energy", "_loudest", "_floor", "_travelled", "_scattered", "_fresh",
                "_last", "_face", "_far", "_wall",
            ):  # fmt: skip
                setattr(self, name, getattr(self, name)[kept])

    def _cross(self, zone: int, order: int) -> None:
        """Add what rays carry through a sphere on their next way."""
        to, radius = self._to.zones[zone, :3] - self._o, np.float32(self._to.radius)
        middle = dot(to, self._d)
        off = to - middle[:, None] * self._d
        inside = radius * radius - dot(off, off)
        rained = self._fresh & self._is_rained_on(np.sqrt(dot(to, to)), dot(to, self._face))
        rows = np.flatnonzero((inside > 0.0) & ~rained)
        half, middle = np.sqrt(inside[rows]), middle[rows]
        heading = np.minimum(middle + half, self._far[rows]) - np.maximum(middle - half, _ZERO)
        weight = heading * (self._to.zones[zone, 3] * np.float32(self._to.scale))
        of_images = ~self._scattered[rows] & (order <= self._run.max_order)
        length, direction = self._travelled[rows] + middle, self._d[rows]
        for mask, images in ((of_images, True), (~of_images, False)):
            self._record(zone, rows[mask], direction[mask], length[mask], weight[mask], images=images)

    def _is_rained_on(self, far: Float32s, height: Float32s) -> Ints:
        radius = np.float32(self._to.radius)
        return np.asarray((far > radius) & (height >= radius) & (self._travelled + far < np.float32(self._to.rain)))

    def _escape(self, gone: Ints) -> None:
        rows, walls = np.flatnonzero(gone), len(self._run.room.plane)
        cell = np.where(self._last[rows] < 0, walls, self._last[rows])
        whole = (self._energy[rows] * np.float32(ESCAPE_SCALE)).astype(np.uint64)
        np.add.at(self._energies.escaped[:, self._bands], cell, whole)
        places = np.concatenate([self._o[rows], self._d[rows]], axis=1)
        self._energies.places = np.concatenate([self._energies.places, places])

    def _reflect(self, order: int) -> None:
        run = self._run
        wall = run.room.plane[self._wall]
        normal, towards = wall[:, :3], dot(self._d, wall[:, :3])
        cosine: Any = np.abs(towards)
        side: Any = np.where(towards > 0.0, -_ONE, _ONE).astype(np.float32)
        cell = np.minimum((np.float32(ANGLES) * np.sqrt(cosine)).astype(np.int64), ANGLES - 1)
        angle = run.kind[self._wall].astype(np.int64) * ANGLES + cell
        left = self._energy * run.returned.reshape(-1, run.returned.shape[2])[angle, self._bands]
        self._energy, self._loudest = np.where(left > FAINT, left, _ZERO), left.max(axis=1)
        self._travelled = self._travelled + self._far
        self._o = self._o + self._far[:, None] * self._d
        height = dot(normal, self._o) - wall[:, 3]
        self._o = self._o + (np.float32(run.room.off) * side - height)[:, None] * normal
        self._face, self._last = side[:, None] * normal, self._wall
        onward = unit(self._d - (np.float32(2.0) * towards)[:, None] * normal)
        share = run.scattered.reshape(-1, run.scattered.shape[2])[angle, self._group]
        sized = self._scattered | (order >= run.max_order)
        if run.sized:
            following, next_one = self._next(self._o, onward)
            by_size = self._share_by_size(cosine, following)
            share = np.where(sized, _ONE - (_ONE - by_size) * (_ONE - share), share)
        for zone in range(len(self._to.zones)):
            self._rain(zone, share)
        drawn = self._drawn(order)
        self._fresh = uniform(drawn[:, 0]) < share
        self._scattered = self._scattered | self._fresh
        self._d = np.where(self._fresh[:, None], self._lambert(side, drawn), onward)
        self._far, self._wall = self._next(self._o, self._d)
        if run.sized:
            self._far = np.where(self._fresh, self._far, following)
            self._wall = np.where(self._fresh, self._wall, next_one)

    def _drawn(self, order: int) -> Ints:
        counter = np.zeros((len(self._ray), 4), np.uint64)
        counter[:, 0], counter[:, 1:] = self._run.first_ray + self._ray, (order, self._group, self._run.stream)
        return philox(counter, self._run.key)

    def _lambert(self, side: Any, drawn: Ints) -> Any:
        room = self._run.room
        square = uniform(drawn[:, 1]) + np.float32(2.0**-25)
        cosine, sine = np.sqrt(square), np.sqrt(_ONE - square)
        turn, other = on_circle(drawn[:, 2])
        parts = (side * cosine, sine * turn, sine * other)
        x, y, z = (
            part[:, None] * axis[self._last, :3]
            for part, axis in zip(parts, (room.plane, room.along, room.across), strict=True)
        )
        return unit(x + y + z)

    def _share_by_size(self, cosine: Float32s, after: Float32s) -> Float32s:
        room, before = self._run.room, self._far
        one, other = room.along[self._wall], room.across[self._wall]
        a, b = dot(one[:, :3], self._d), dot(other[:, :3], self._d)
        wide = a * a >= b * b
        width, length = np.where(wide, one[:, 3], other[:, 3]), np.where(wide, other[:, 3], one[:, 3])
        far = np.minimum(after, FARTHEST)
        near = self._run.wavelength[self._group] * (before * far / (before + far))
        seen = width * cosine
        with np.errstate(divide="ignore", invalid="ignore"):
            by_width, by_length = np.minimum(seen * seen / near, _ONE), np.minimum(length * length / near, _ONE)
        return np.asarray(_ONE - by_width * by_length)

    def _rain(self, zone: int, share: Float32s) -> None:
        """Add what is scattered to a zone directly."""
        to = self._to.zones[zone, :3] - self._o
        square, above = dot(to, to), dot(to, self._face)
        far = np.sqrt(square)
        met = (share > 0.0) & (self._travelled < np.float32(self._to.rain)) & self._is_rained_on(far, above)
        rows = np.flatnonzero(met)
        there: Any = to[rows] / far[rows, None]
        if not self._run.room.convex and len(rows):
            rows_hidden = next_wall(self._run.room, self._o[rows], there, far[rows])[1] >= 0
            rows, there = rows[~rows_hidden], there[~rows_hidden]
        square, above, far = square[rows], above[rows], far[rows]
        weight = share[rows] * above / (PI * square * far) * np.float32(self._to.scale)
        self._record(zone, rows, there, self._travelled[rows] + far, weight, images=False)

    def _record(
        self, zone: int, rows: Ints, direction: Float32s, length: Float32s, weight: Float32s, *, images: bool
    ) -> None:
        """Add passages of rays through a zone after ways (n,), m; weights (n,) are what energies are multiplied by."""
        good = (length >= 0.0) & (weight > 0.0)
        rows, direction, length, weight = rows[good], direction[good], length[good], weight[good]
        to, e = self._to, self._energies
        bin_ = (length * np.float32(1.0 / to.per_bin)).astype(np.int64)
        window = (length * np.float32(1.0 / to.per_window)).astype(np.int64)
        energy = self._energy[rows] * weight[:, None]
        whole = energy.astype(np.uint64)
        in_bins, bands = bin_ < to.bins, self._bands
        if images:
            np.add.at(e.images[zone, :, bands], bin_[in_bins], whole[in_bins])
            return
        slot = self._ray[rows] % SLOTS
        within = window < to.windows
        np.add.at(e.windows[:, zone, :, bands], (slot[within], window[within]), whole[within])
        arrival = np.argmax(np.stack([-dot(direction, m[:3]) for m in to.arrivals], axis=1), axis=1)
        early, late = in_bins & (bin_ < to.early), in_bins & (bin_ >= to.early)
        np.add.at(e.early[zone, :, :, bands], (bin_[early], arrival[early]), whole[early])
        row = e.late[int(to.late_row[zone]), :, :, bands]
        np.add.at(row, (bin_[late] - to.early, arrival[late]), whole[late])
        total = np.zeros(len(rows), np.float32)
        for b in range(energy.shape[1]):  # in the kernel's order
            total = total + energy[:, b]
        departure = self._run.departure[self._ray[rows]]
        np.add.at(e.departures[zone], departure[in_bins], total[in_bins].astype(np.uint64))
