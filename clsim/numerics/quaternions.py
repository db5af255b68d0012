"""Unit quaternions x y z w, right-handed; at identity an axis points along +x."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import Floats
from clsim.errors import InputError


def rotate(quaternion: ArrayLike, vectors: ArrayLike) -> Floats:
    """Turn vectors by unit quaternions; quaternion (..., 4); vectors (..., 3); result (... 3).

    ``v + 2 w (u × v) + 2 u × (u × v)`` for the quaternion ``(u, w)``: J. Diebel, "Representing Attitude", Stanford
    University, 2006, section 6.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    v = np.asarray(vectors, dtype=np.float64)
    u, w = q[..., :3], q[..., 3:]
    twice = 2.0 * cross_product(u, v)
    turned: Floats = v + w * twice + cross_product(u, twice)
    return turned


def inverse(quaternion: Floats) -> Floats:
    """Quaternions (..., 4) that turn back."""
    return np.asarray(quaternion * np.array([-1.0, -1.0, -1.0, 1.0]))


def cross_product(a: Floats, b: Floats) -> Floats:
    """Return the cross products of vectors (..., 3), as `numpy.cross` does in a third of its time.

    Shapes: a, b (..., 3); result (... 3).

    The definition, component by component: G. B. Arfken, H. J. Weber and F. E. Harris, "Mathematical Methods for
    Physicists", Academic Press, 2013, section 3.2.
    """
    out: Floats = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def quaternion_product(left: Floats, right: Floats) -> Floats:
    """Return the Hamilton product of quaternions x y z w: turning by `right` first, then by `left`."""
    a, b = left[..., :3], right[..., :3]
    w, v = left[..., 3:], right[..., 3:]
    vector = w * b + v * a + np.cross(a, b)
    return np.concatenate([vector, w * v - np.sum(a * b, axis=-1, keepdims=True)], axis=-1)


def quaternion_from_direction(direction: ArrayLike) -> Floats:
    """Return the rotation that turns +x into a direction and keeps +z as far up as it goes.

    Shapes: direction (..., 3); result (... 4).

    Our own derivation: a turn by the elevation e about -y, ``(0, -sin e/2, 0, cos e/2)``, then one by the azimuth a
    about z, ``(0, 0, sin a/2, cos a/2)``, multiplied out as the product of the second and the first: no roll. Straight
    up and down, where any azimuth would do, it is 0.
    """
    d = np.asarray(direction, dtype=np.float64)
    level = np.hypot(d[..., 0], d[..., 1])
    length = np.hypot(level, d[..., 2])
    if not np.all((length > 0.0) & np.isfinite(length)):
        raise InputError("direction", "must be finite and longer than 0")
    # Adding 0.0 turns -0.0 into 0.0, whose azimuth is 0 rather than pi.
    azimuth = 0.5 * np.arctan2(d[..., 1] + 0.0, d[..., 0] + 0.0)
    elevation = 0.5 * np.arctan2(d[..., 2], level)
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.stack([sa * se, -ca * se, sa * ce, ca * ce], axis=-1)


def normalised(quaternion: ArrayLike) -> Floats:
    """Return quaternions scaled to unit norm; quaternion (..., 4); result (... 4)."""
    q = np.asarray(quaternion, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all((norm > 0.0) & np.isfinite(norm)):
        raise InputError("quaternion", "must be finite and not 0, 0, 0, 0")
    unit: Floats = q / norm
    return unit


def same_hemisphere(quaternions: ArrayLike) -> Floats:
    """Return the same rotations with signs chosen so that neighbours lie close to each other; quaternions (n, 4).

    result: the first as given, each other one or its negative: no two neighbours have a negative dot product.
    """
    q = np.asarray(quaternions, dtype=np.float64)
    flips = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0.0, -1.0, 1.0)
    signs = np.concatenate([np.ones(min(1, len(q))), np.cumprod(flips)])
    signed: Floats = q * signs[:, None]
    return signed
