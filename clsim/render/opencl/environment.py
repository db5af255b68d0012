"""Tables of air, walls, directivities and receivers that a device looks up."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import end_coefficients, transition
from clsim.arrays import Complexes, Floats
from clsim.numerics.quaternions import rotate
from clsim.numerics.sphere import harmonic_norms
from clsim.paths.response import SceneResponse, Walls, covered, directivity_gain
from clsim.scene.directivity.directivity import AxisymmetricDirectivity, ChannelDirectivity, Directivity
from clsim.scene.directivity.patterns import NORMALIZATIONS, Ambisonic, Omni
from clsim.scene.ends import Receiver
from clsim.scene.material.material import Material
from clsim.scene.scene import Scene
from clsim.tracks.basis import Basis

CELLS = 1024  # of a table over an angle; its cubics are within 1e-9 for a piston of ka = 10
FACE_CELLS = 96  # of a table over a sphere along a face of the cube
SIDE = FACE_CELLS + 5  # its points: those of the cells and two beyond either edge
_MARGIN = 14  # points beyond an edge that the spline is made of, where 0.27 ** 12 of what is not known there is left
_MIDDLE_PHASE = 4.0  # rad, of the middle of the table of the transition function at the middle frequency
# Kinds of tables of directivities: none, by angle to an axis, by direction, and norms of spherical harmonics.
OMNI, AXIAL, SPHERICAL, HARMONIC = range(4)
# As programs take them.
TABLES = {"OMNI": OMNI, "AXIAL": AXIAL, "SPHERICAL": SPHERICAL, "HARMONIC": HARMONIC}
TABLES |= {"CELLS": CELLS, "SIDE": SIDE, "FACE_CELLS": FACE_CELLS}


def directivity_kind(directivities: Sequence[Directivity]) -> int:
    """Return the kind of table that represents all of some directivities."""
    if not all(isinstance(d, AxisymmetricDirectivity) for d in directivities):
        return SPHERICAL
    return OMNI if all(isinstance(d, Omni) for d in directivities) else AXIAL


def directivity_table(
    directivity: Directivity, kind: int, frequencies: Floats, speed_of_sound: float, parts: int
) -> NDArray[np.float32]:
    """Return the flat table (see ``response.h``) of a directivity of a kind at frequencies (M,), Hz."""
    if kind == OMNI:
        return np.zeros(0, dtype=np.float32)
    if kind == SPHERICAL:
        return _sphere(
            lambda towards: directivity_gain(directivity, towards, frequencies, speed_of_sound), len(frequencies), parts
        )
    assert isinstance(directivity, AxisymmetricDirectivity)
    frequencies = covered(frequencies, directivity)
    half = CELLS // 2  # two splines: the gain of a piston bends at 90 degrees
    cosine = np.linspace(-1.0, 1.0, CELLS + 1)
    ends = (slice(0, half + 1), slice(half, CELLS + 1))
    return np.concatenate(
        [
            cubics(cosine[piece], _shaped(directivity.gain(cosine[piece][:, None], frequencies, speed_of_sound),
                                           (half + 1, len(frequencies))), parts)
            for piece in ends
        ]
    )  # fmt: skip


def wall_table(material: Material, frequencies: Floats, speed_of_sound: float, parts: int) -> NDArray[np.float32]:
    """Return the table of a material over the root of the cosine of the angle of incidence, flat."""
    root = np.linspace(0.0, 1.0, CELLS + 1)
    cosine = np.maximum(root, 1e-6)[:, None] ** 2
    factor = material.reflection_at(covered(frequencies, material), cosine, speed_of_sound)
    return cubics(root, _shaped(factor, (CELLS + 1, len(frequencies))), parts)


def transition_table(waves: Floats, parts: int) -> tuple[NDArray[np.float32], float]:
    """Return the table of the transition function at waves in a metre (F,), flat, and its middle, m^(1/2)."""
    number = 2.0 * np.pi * waves
    middle = float(np.sqrt(_MIDDLE_PHASE / np.sqrt(number.min() * number.max())))
    place = np.linspace(0.0, 1.0, CELLS + 1)
    values = np.zeros((len(place), len(waves)), dtype=np.complex128)
    values[1:] = transition((middle * (1.0 / place[1:] - 1.0))[:, None] * np.sqrt(number))
    return cubics(place, values, parts), middle


def field_tables(waves: Floats, table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Waves in a metre at the frequencies of a basis, then tables of fields that use them, as kernels take both."""
    return np.concatenate([waves.astype(np.float32), table.ravel()])


def end_table(waves: Floats, parts: int, middle: float, cells: int) -> NDArray[np.float32]:
    """Make the table of the coefficients of `end_transition` at waves in a metre (F,), flat; see ``edge_end.h``."""
    place = np.linspace(0.0, 1.0, cells + 1)
    radius = (middle * (1.0 / place[1:] - 1.0))[:, None] * np.sqrt(2.0 * np.pi * waves)
    values = end_coefficients(radius).swapaxes(1, 2).reshape(cells, -1)
    return cubics(place, np.concatenate([np.zeros((1, values.shape[1])), values]), parts)


def _shaped(values: Floats | Complexes, shape: tuple[int, ...]) -> Any:
    return np.broadcast_to(values, shape)


def cubics(place: Floats, values: Floats | Complexes, parts: int) -> NDArray[np.float32]:
    """Return cubics between equidistant places (n + 1,), (n, 4, parts, M) flat, lowest power first."""
    from scipy.interpolate import CubicSpline

    coefficients = CubicSpline(place, _split(values, parts)).c[::-1]  # [power][cell][part][frequency]
    width = (place[1] - place[0]) ** np.arange(4)
    return np.ascontiguousarray(np.moveaxis(coefficients, 0, 1) * width[:, None, None], dtype=np.float32).ravel()


def _split(values: Floats | Complexes, parts: int) -> Floats:
    """Return real, and imaginary, parts (..., parts, M) of values (..., M)."""
    return np.stack([values.real, values.imag][:parts], axis=-2)


def _sphere(gain: Callable[[Floats], Floats | Complexes], count: int, parts: int) -> NDArray[np.float32]:
    """Return B-spline coefficients over the faces of a cube, (6, SIDE, SIDE, parts, M) flat.

    A face's own points go on beyond its edges, so that its spline knows no edge.
    """
    from scipy.ndimage import spline_filter

    place = np.arange(-_MARGIN, FACE_CELLS + _MARGIN + 1) * (2.0 / FACE_CELLS) - 1.0
    p, q = np.meshgrid(place, place, indexing="ij")
    kept = slice(_MARGIN - 2, _MARGIN - 2 + SIDE)
    table = np.empty((6, SIDE, SIDE, parts, count), dtype=np.float32)
    for face in range(6):
        axis = face // 2
        towards = np.empty((*p.shape, 3))
        towards[..., axis] = 1.0 - 2.0 * (face % 2)
        towards[..., (axis + 1) % 3], towards[..., (axis + 2) % 3] = p, q
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        values = _split(_shaped(gain(towards), (*p.shape, count)), parts)
        for part in range(parts):
            for m in range(count):
                table[face, :, :, part, m] = spline_filter(values[..., part, m], order=3)[kept, kept]
    return table.ravel()


_MOST_TERMS = 16
_AIR_ERROR = 1e-6  # of polynomials of what air does, relative to its absorption
_MOST_GAINS = 256  # of a path's channels, up to which the device makes nodes
VECTOR = 8  # numbers of a vector of gains or of frequencies in kernels
_NOTHING = np.zeros(VECTOR, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Reception:
    """Directivities of receivers with equally many channels, as kernels take them."""

    channels: int
    kind: int  # of the tables
    projection: Any  # on the device, as in response.h
    tables: Any  # likewise
    table_of: NDArray[np.int32]  # (receivers of the scene,), bands from the first


class Environment:
    """Air, walls and directivities at the nodes of one source's basis, as the device takes them; see ``response.h``."""

    def __init__(
        self, scene: Scene, source: int, mach: float, basis: Basis, put: Callable[[NDArray[Any]], Any]
    ) -> None:
        c = scene.air.speed_of_sound
        self.count, self.parts = len(basis.nodes), basis.parts
        self._responses = SceneResponse(scene, source, basis.nodes, basis.tilt.at(basis.nodes))
        padding = -len(basis) % VECTOR if len(basis) > 1 else 0  # of gains, which stand side by side
        nepers, lead, self.air_terms = self._responses.nepers, np.zeros(1), 0
        if scene.air.dispersion:
            nepers, lead = air_polynomials(self._responses, mach)
            self.air_terms = len(nepers)
        air = [nepers, np.broadcast_to(lead / (2.0 * np.pi), nepers.shape)]
        self._scene, self._basis, self._put = scene, basis, put
        self.air = put(_flat([*air, basis.weight, basis.functions]))
        projection = [np.pad(p, ((0, 0), (0, padding))) for p in (basis.projection.T, basis.strengths[None])]
        directivities = [
            Omni() if isinstance(d, ChannelDirectivity) else d for d in (r.directivity for r in scene.receivers)
        ]
        receiver_kind = directivity_kind(directivities)
        self.source_kind = directivity_kind([scene.sources[source].directivity])
        source_beam = directivity_table(scene.sources[source].directivity, self.source_kind, basis.nodes, c, self.parts)
        kinds = list(dict.fromkeys(directivities))
        tables = [directivity_table(b, receiver_kind, basis.nodes, c, self.parts) for b in kinds]
        bands = len(tables[0]) // min(self.count, VECTOR)
        table_of = np.array([kinds.index(b) * bands for b in directivities], dtype=np.int32)
        beams = put(np.concatenate([*tables, _NOTHING]))
        self._receptions = {1: Reception(1, receiver_kind, put(_flat(projection)), beams, table_of)}
        materials, angular = scene.materials, self._responses.angular
        different = {id(m): m for m, turns in zip(materials, angular[:-1], strict=True) if turns}
        kind = {key: i for i, key in enumerate(different)}
        self._material_of = np.array([*(kind.get(id(m), -1) for m in materials), -1], dtype=np.int32)
        walls = [wall_table(m, basis.nodes, c, self.parts) for m in different.values()]
        flat = {"wall_tables": walls, "source_directivity": [source_beam]}
        self.tables = {name: put(np.concatenate([*parts, _NOTHING])) for name, parts in flat.items()}
        self.angular = 0

    def reception(self, channels: int) -> Reception:
        """Return the directivities of receivers with so many channels: plain ones, or ambisonic microphones."""
        if channels not in self._receptions:
            basis, order = self._basis, round(channels**0.5) - 1
            rows = basis.projection.astype(np.float32).ravel()
            sizes = np.repeat(basis.strengths, channels)
            projection = _flat([np.pad(part, (0, -part.size % VECTOR)) for part in (rows, sizes)])
            norms = [harmonic_norms(order) * Ambisonic(order, one).scale for one in NORMALIZATIONS]
            norms = [np.pad(norm, (0, -channels % VECTOR)) for norm in norms]
            bands = len(norms[0]) // min(self.count, VECTOR)
            table_of = [
                bands * NORMALIZATIONS.index(getattr(r.directivity, "normalization", NORMALIZATIONS[0]))
                for r in self._scene.receivers
            ]
            self._receptions[channels] = Reception(
                channels, HARMONIC, self._put(projection), self._put(_flat(norms)), np.array(table_of, dtype=np.int32)
            )
        return self._receptions[channels]

    def most_bounces(self, pairs: Iterable[Walls]) -> None:
        """Make room for the most walls that depend on the angle that any path of some pairs meets."""
        met = self._responses.angular
        self.angular = max((int(met[walls].sum(axis=1).max(initial=0)) for walls in pairs), default=0)

    def no_bounces(self, slots: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return empty columns: material (at least 1, slots) and normal (at least 1, 3, slots) of every bounce."""
        count = max(self.angular, 1)
        return np.full((count, slots), -1, dtype=np.int32), np.zeros((count, 3, slots), dtype=np.float32)

    def reflection(self, walls: Walls) -> Floats:
        """Return the product of reflection factors of walls without angle dependence, (P, parts, nodes)."""
        product = self._responses.reflection(walls)
        return np.stack([product.real, product.imag][: self.parts], axis=1)

    def tables_of(self, walls: Walls) -> NDArray[np.int32]:
        """Return the tables of walls (...) that depend on the angle, -1 for others."""
        return np.asarray(self._material_of[walls])

    def bounces(self, walls: Walls) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return material and normal of every bounce that depends on the angle, those of each path first."""
        wall_of, normal = self.no_bounces(len(walls))
        filled = np.zeros(len(walls), dtype=np.int64)
        for bounce, normals in self._responses.angular_bounces(walls):
            here = np.flatnonzero(self._responses.angular[walls[:, bounce]])
            wall_of[filled[here], here] = self._material_of[walls[here, bounce]]
            normal[filled[here], :, here] = normals[here]
            filled[here] += 1
        return wall_of, normal

    def bounces_of_sides(self, before: Walls, after: Walls) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return material and normal of every bounce on the source's side, and -2 less those of the receiver's."""
        (first, one), (last, other) = (self.bounces(walls) for walls in (before, after))
        walls, normals = np.concatenate([first, np.where(last < 0, -1, -2 - last)]), np.concatenate([one, other])
        most = np.argsort(walls == -1, axis=0, kind="stable")[: len(first)]
        return np.take_along_axis(walls, most, axis=0), np.take_along_axis(normals, most[:, None], axis=0)


def has_directivity(directivity: Directivity, gains: int) -> bool:
    """Test whether programs of nodes have the directivity of a receiver, with so many gains of a path."""
    return not isinstance(directivity, ChannelDirectivity) or (
        isinstance(directivity, Ambisonic) and gains <= _MOST_GAINS
    )


def _flat(parts: Iterable[Floats]) -> NDArray[np.float32]:
    """Return arrays one after the other."""
    return np.concatenate([part.astype(np.float32).ravel() for part in parts])


def air_polynomials(at: SceneResponse, mach: float) -> tuple[Floats, Floats]:
    """Return absorption, 1/m, and lead, rad/m, (terms, F) in powers of how much motion changes frequencies, a ratio."""
    low, high = -mach / (1.0 + mach), mach / (1.0 - mach)
    for terms in range(1, _MOST_TERMS + 1):
        places, between = (
            0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(n) + 0.5) / n)
            for n in (terms, 4 * terms)
        )
        powers = np.linalg.inv(np.vander(places, increasing=True))
        found, exact = ([powers @ x for x in at.air_at(1.0 + places[:, None])], at.air_at(1.0 + between[:, None]))
        made = [np.vander(between, terms, increasing=True) @ x for x in found]
        largest = np.abs(exact[0]).max()
        if max(np.abs(m - e).max() for m, e in zip(made, exact, strict=True)) <= _AIR_ERROR * largest:
            break
    return found[0], found[1]


# A receiver at a node, as in nodes/legs/static.h.
RECEIVER_NODE = np.dtype(
    [("position", "f8", 3), ("velocity", "f8", 3), ("axes", "f8", (2, 3)), ("clock_error", "f8"), ("clock_rate", "f8")]
)


def receiver_at(receiver: Receiver, times: Floats) -> NDArray[Any]:
    """Return position, velocity, axes and clock of a receiver, (times,)."""
    out = np.empty(len(times), dtype=RECEIVER_NODE)
    out["clock_error"] = receiver.clock_error(times)
    out["clock_rate"] = receiver.clock_rate
    true = times + out["clock_error"]
    out["position"], out["velocity"] = receiver.trajectory.position(true), receiver.trajectory.velocity(true)
    for i, axis in enumerate(np.eye(3)[:2]):
        out["axes"][:, i] = rotate(receiver.orientation(true), axis)
    return out
