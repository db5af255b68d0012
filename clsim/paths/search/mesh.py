"""Paths in a room of any shape: candidates from a finder, intervals by certified subdivision of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_count, read_only
from clsim.errors import DeviceError, InputError, warn
from clsim.opencl.device import DeviceInfo, find_device
from clsim.paths.chain import Chain
from clsim.paths.family import NONE, SPECULAR, TRANSMISSION
from clsim.paths.legs.legs import image_columns
from clsim.paths.options import PathOptions
from clsim.paths.propagation import mean_medium_of
from clsim.paths.search.beam_tree import BeamTree, Candidates, FoundPaths, TooManyBeamsError
from clsim.paths.search.ray_shooting import THROUGH, ShotRays, divided, see_through
from clsim.paths.visibility import intervals
from clsim.paths.visibility.device import DeviceLookup, DeviceSearch
from clsim.paths.visibility.intervals import Search
from clsim.paths.visibility.occlusion import WallLookup
from clsim.scene.ends import Source, find_mount
from clsim.scene.motion.motion import Motion
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.walls import Walls
from clsim.scene.scene import Scene

Progress = Callable[[float], None]
LARGEST_MESH_ORDER = 20

BEAM_LIMIT = 5_000_000  # of one tree
_SMALLEST_CELL = 0.01  # of the room's size, below which halving a cell does not help a tree
# Where pairs of walls swap their order, one path ends as another with the same image begins: a gap of a sample between
# them would be heard at -102 dB.
_OF_A_SAMPLE = 1.0 / 16.0
_FEW_WALLS = 64  # are looked up by NumPy: quicker than building kernels for it
_BATCH = 16_384  # candidates searched at a time


@dataclass(frozen=True, slots=True, eq=False)
class MeshSearch:
    """How paths are looked for in a room of any shape; see `find_paths`."""

    max_order: int
    search: PathOptions

    def paths(self, scene: Scene, room: MeshRoom, source: Source, progress: Progress) -> FoundPaths:
        """Return every path from one source to all receivers."""
        query, longest = visibility_query(scene, room, source, self.max_order, self.search.resolution)
        if scene.panels:
            query = replace(query, walls=see_through(room.walls, scene.panels))
        ends, last = query.trajectory_tables, query.last
        device, air = float64_device(self.search.engine, self.search.device), sides_of_air(query)
        walls = query.walls
        of_device = None if len(walls) <= _FEW_WALLS else device
        lookup = WallLookup(walls) if of_device is None else DeviceLookup(walls, of_device)
        plant = partial(BeamTree, walls, limit=BEAM_LIMIT, sides=air, lookup=lookup)
        shoot = self._shoots(plant, room.walls.size, ends)
        if shoot and scene.panels:
            raise InputError("finder", 'must be "beam-tree" where walls let sound pass; or lower max_order')
        parts: list[FoundPaths] = []
        cells = [(0.0, float(last.max()))]
        while cells:
            begin, end = cells.pop()
            receivers = ends.receiver_spheres(begin, end)
            centre, radius = ends.sphere(0, begin - longest, end)
            if shoot:
                finder: BeamTree | ShotRays = ShotRays(room, source.trajectory, receivers, find_mount(room, source))
            else:
                finder = plant(centre, radius, receivers)
            part = partial(report, progress, begin / last.max(), end / last.max())
            try:
                here = query.during(begin, end)
                search = partial(intervals.find_intervals, here) if device is None else DeviceSearch(here, device).find
                parts.append(self._with_intervals(partial(here.found_in_air, air, search), finder, source.name, part))
                if isinstance(finder, ShotRays):
                    _report_missed(finder, parts[-1].walls, shoot)
            except TooManyBeamsError as error:
                if radius < _SMALLEST_CELL * room.walls.size:
                    raise InputError("max_order", str(error)) from error
                cells += [(0.5 * (begin + end), end), (begin, 0.5 * (begin + end))]
        found = FoundPaths.of_cells(parts, last)
        return divided(query, found, scene.panels) if scene.panels else found

    def _shoots(self, plant: Callable[..., BeamTree], size: float, ends: intervals.TrajectoryTables) -> str:
        """Return why rays are shot, because of a tree that would be far too large or as asked; else nothing."""
        if self.search.finder == "auto":
            centre, radius = ends.sphere(0)
            tree = plant(
                centre, min(radius, _SMALLEST_CELL * size), intervals.BoundingSpheres(np.empty((0, 3)), np.empty(0))
            )
            beams = tree.estimate(self.max_order)
            return "" if beams <= BEAM_LIMIT else f"a beam tree would need about {beams:.1g} beams, so rays are shot"
        return "" if self.search.finder == "beam-tree" else "rays are shot, as asked"

    def _with_intervals(self, search: Search, finder: BeamTree | ShotRays, name: str, progress: Progress) -> FoundPaths:
        """Return a finder's candidates with the intervals in which they are heard."""
        parts, count, done = [FoundPaths.none(self.max_order)], 0, 0
        for batch, waiting in _batches(finder.candidates(self.max_order)):
            sequence, receiver = batch.sequence[batch.row], batch.receiver
            found = search(sequence, receiver)
            walls = np.full((len(found.path), self.max_order), -1, dtype=np.int32)
            walls[:, : sequence.shape[1]] = sequence[found.path]
            order = np.full(len(found.path), sequence.shape[1])
            parts.append(FoundPaths(receiver[found.path], order, walls, found.begin, found.end))
            count += len(order)
            if count > (most := self.search.path_limit):
                bound = f"must give at most {most} paths (path_limit), but {self.max_order} gives more"
                raise InputError("max_order", f"{bound} from {name!r}, after {finder.share:.0%} of the search")
            done += len(receiver)
            progress(finder.share * done / (done + waiting))
        return FoundPaths.joined(parts)


def visibility_query(
    scene: Scene, room: MeshRoom, source: Source, legs: int, resolution: float | None
) -> tuple[intervals.VisibilityQuery, float]:
    """Request for a search from one source, and the longest travel time of its paths, s."""
    medium = mean_medium_of(scene.air, source.emitted.centre_frequency)
    trajectories = [r.trajectory for r in scene.receivers]
    mounts = [find_mount(room, source), *(find_mount(room, end) for end in scene.receivers)]
    ends = intervals.trajectory_tables(source.trajectory, trajectories, mounts)
    spheres = [ends.sphere(row) for row in range(len(ends.places))]
    low = np.minimum(room.extent[0], np.min([c - r for c, r in spheres], axis=0))
    high = np.maximum(room.extent[1], np.max([c + r for c, r in spheres], axis=0))
    longest = (legs + 1) * float(np.linalg.norm(high - low)) / scene.air.slowest  # no leg is longer than that
    last = np.array([_last(source.trajectory, longest, t) for t in trajectories])
    fastest = float(ends.scales[0, 2])
    if fastest >= medium.slowest:  # a bound: at a sharp corner up to twice the speed
        raise InputError(
            "sources.trajectory",
            f"must surely stay below the speed of sound, {medium.slowest:.6g} m/s, for paths in a mesh, but "
            f"{source.name!r} is only known to stay below {fastest:.6g} m/s; smooth its corners or move it more slowly",
        )
    query = intervals.VisibilityQuery(
        room.walls, ends, medium, np.zeros(len(last)), last, resolution_of(scene, resolution)
    )
    return query, longest


def resolution_of(scene: Scene, resolution: float | None) -> float:
    """Time to which beginnings and ends of paths are found, s; a part of a sample if none is given."""
    return resolution or _OF_A_SAMPLE / max(s.signal.sampling_rate for s in scene.sources)


def mesh_paths(scene: Scene, room: MeshRoom, search: PathOptions) -> Chain:
    """Return every path of a mesh up to an order, a row for every interval in which it is heard."""
    order = as_count("max_order", search.max_order, at_most=LARGEST_MESH_ORDER)
    count = len(scene.sources)
    found = [
        MeshSearch(order, search).paths(scene, room, source, partial(report, search.notify, i / count, (i + 1) / count))
        for i, source in enumerate(scene.sources)
    ]
    every = FoundPaths.joined(found)
    if (whole := len(every.walls)) > search.path_limit:
        raise InputError("path_limit", f"must hold all paths, but is {search.path_limit} and they are {whole}")
    source = np.repeat(np.arange(count, dtype=np.int32), [len(f.order) for f in found])
    ends = source, every.receiver.astype(np.int32), every.order.astype(np.int32), every.begin, every.end
    images_of = every.walls, *image_isometries(room.walls, every.walls)
    columns: Any = [read_only(column) for column in (*ends, *images_of)]
    images = image_columns(*columns[5:])
    if scene.panels:
        images |= _met(found)
    return Chain(scene, *columns[:5], **images)


def _met(found: list[FoundPaths]) -> dict[str, Any]:
    """Columns of what paths of each source meet, with the panels that they pass through."""
    rows: list[Any] = [each.met for each in found]
    width = max(row.shape[1] for row in rows)
    met = np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1])), constant_values=-1) for row in rows])
    kinds = np.select([met <= THROUGH, met >= 0], [TRANSMISSION, SPECULAR], NONE).astype(np.int8)
    return {"interactions": read_only(kinds), "objects": read_only(np.where(met <= THROUGH, THROUGH - met, met))}


def image_isometries(walls: Walls, sequence: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return matrices A (n, 3, 3) and offsets b (n, 3) of images ``A x + b`` by walls (n, N), -1 behind the last."""
    matrix, offset = np.tile(np.eye(3), (len(sequence), 1, 1)), np.zeros((len(sequence), 3))
    for wall in sequence.T:
        rows = np.flatnonzero(wall >= 0)
        normal, away = walls.normal[wall[rows]], walls.offset[wall[rows]]
        mirror = np.eye(3) - 2.0 * normal[:, :, None] * normal[:, None, :]
        matrix[rows] = mirror @ matrix[rows]
        offset[rows] = np.einsum("nij,nj->ni", mirror, offset[rows]) + 2.0 * away[:, None] * normal
    return matrix, offset


def report(progress: Progress, first: float, last: float, share: float) -> None:
    """Report the share of a part of the work."""
    progress(first + share * (last - first))


def float64_device(engine: str, name: str | None) -> tuple[DeviceInfo, Any] | None:
    """Return the device that validates paths, None for NumPy: asked for, or where no device has float64."""
    if engine == "opencl":
        try:
            info, chosen = find_device(name)
            if info.fp64:
                return info, chosen
            reason = f"{info.name} has no float64"
        except DeviceError as error:
            if name is not None:
                raise
            reason = str(error)
        warn(f"{reason}: paths are validated by NumPy, which is slow")
    return None


def _report_missed(rays: ShotRays, walls: NDArray[np.int32], reason: str) -> None:
    """Warn that rays have been shot, and of how many paths they are likely to have missed besides those by `walls`."""
    met = np.unique(walls, axis=0)
    warn(
        f"{reason}: paths by small walls can be missed. Two halves of the rays, compared, give {rays.missed(met):.2g} "
        f"missed sequences of walls at least, besides {len(met)} found; a lower max_order misses none"
    )


def sides_of_air(query: intervals.VisibilityQuery) -> NDArray[np.int64]:
    """Sides (W,) of walls on which paths from a query's source can be; see `WallLookup.air_sides`."""
    ends, source = query.trajectory_tables, np.zeros(1, dtype=np.int64)
    start = ends.lifted(source, ends.position(source, np.zeros(1)) + intervals.PERTURBATIONS[0])[0]
    return WallLookup(query.walls).air_sides(start)


def _batches(candidates: Iterator[Candidates]) -> Iterator[tuple[Candidates, int]]:
    """Join candidates of the same order until they are worth a launch; yield also how many others wait."""
    waiting: dict[int, list[Candidates]] = {}
    for found in candidates:
        order = found.sequence.shape[1]
        if len(found.row):
            waiting.setdefault(order, []).append(found)
        if sum(len(c.row) for c in waiting.get(order, ())) >= _BATCH:
            batch = Candidates.joined(waiting.pop(order))
            yield batch, sum(len(c.row) for some in waiting.values() for c in some)
    while waiting:
        some = waiting.pop(min(waiting))
        yield Candidates.joined(some), sum(len(c.row) for others in waiting.values() for c in others)


def _last(source: Motion, longest: float, receiver: Motion) -> float:
    """Return the time from which on nothing changes, or at which the recording ends at the latest, s."""
    last = min(source.end + longest, receiver.end)
    if math.isinf(source.end) and math.isinf(receiver.end):
        return 1.0  # nothing ever changes
    return max(last, 1e-3)
