"""Walls and directivities as tables that a device looks up: cubics over an angle, B-splines over a sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import end_coefficients, transition
from clsim.paths.response import covered, directivity_gain
from clsim.scene.directivity.directivity import AxisymmetricDirectivity
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.scene.directivity.directivity import Directivity
    from clsim.scene.material.material import Material

CELLS = 1024  # of a table over an angle; its cubics are within 1e-9 for a piston of ka = 10
FACE_CELLS = 96  # of a table over a sphere along a face of the cube
SIDE = FACE_CELLS + 5  # its points: those of the cells and two beyond either edge
_MARGIN = 14  # points beyond an edge that the spline is made of, where 0.27 ** 12 of what is not known there is left
_MIDDLE_PHASE = 4.0  # rad, of the middle of the table of the transition function at the middle frequency
# Kinds of tables of directivities: none, by angle to an axis, by direction, and norms of spherical harmonics.
OMNI, AXIAL, SPHERICAL, HARMONIC = range(4)


def directivity_kind(directivities: Sequence[Directivity]) -> int:
    """Return the kind of table that represents all of some directivities."""
    if not all(isinstance(d, AxisymmetricDirectivity) for d in directivities):
        return SPHERICAL
    return OMNI if all(isinstance(d, Omni) for d in directivities) else AXIAL


def directivity_table(
    directivity: Directivity, kind: int, frequencies: Floats, speed_of_sound: float, parts: int
) -> NDArray[np.float32]:
    """Return the table of a directivity, flat; see ``response.h`` for its layout.

    Shapes: frequencies (M,) Hz.

    kind: `OMNI`, `AXIAL` or `SPHERICAL`; axial directivities have tables of either kind.
    """
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
    """Return the table of the transition function at waves in a metre (F,), flat, and its middle, m^(1/2).

    See ``transition_table.h``.
    """
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
