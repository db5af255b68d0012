"""Exact fields about rigid bodies over the free field: spheres by their series, others by point sources inside them.

And those of clsim at the same places.
"""

import numpy as np
from scipy.special import eval_legendre, spherical_jn, spherical_yn

import clsim
from clsim.paths.response import SceneResponse

C = 343.0
SILENT = clsim.Material.from_reflection(0.0)
AIR = clsim.Air(speed_of_sound=C, absorption=False)
MIDDLE = np.full(3, 30.0)


def sphere(wave: float, radius: float, source: np.ndarray, receivers: np.ndarray) -> np.ndarray:
    """Return the pressure (n,) about a rigid sphere at the origin over the free field, by its series."""
    away = np.linalg.norm(receivers - source, axis=1)
    n = np.arange(int(wave * radius + 12.0 * (wave * radius) ** (1 / 3) + 30))

    def hankel(x: float, derivative: bool = False) -> np.ndarray:
        return spherical_jn(n, x, derivative) - 1j * spherical_yn(n, x, derivative)

    found = np.empty(len(receivers), dtype=complex)
    far = float(np.linalg.norm(source))
    for i, receiver in enumerate(receivers):
        there = float(np.linalg.norm(receiver))
        with np.errstate(all="ignore"):
            modes = (
                (2 * n + 1) * spherical_jn(n, wave * radius, True) / hankel(wave * radius, True) * hankel(wave * far)
            )
            modes = modes * hankel(wave * there) * eval_legendre(n, source @ receiver / (far * there))
        found[i] = 1.0 + 1j * wave * modes[np.isfinite(modes)].sum() * away[i] * np.exp(1j * wave * away[i])
    return found


def evenly(count: int) -> np.ndarray:
    """Return directions (n, 3) evenly spread over the sphere."""
    i = np.arange(count) + 0.5
    up, about = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    return np.stack([np.cos(about) * np.sin(up), np.sin(about) * np.sin(up), np.cos(up)], axis=1)


class PointSources:
    """Rigid bodies by point sources inside that cancel the normal velocity on the surface, by least squares."""

    def __init__(self, places: np.ndarray, normals: np.ndarray, inside: np.ndarray, wave: float) -> None:
        self.places, self.normals, self.inside, self.wave = places, normals, inside, wave
        self.matrix = np.stack([self.slope(source) for source in inside], axis=1)

    def slope(self, source: np.ndarray) -> np.ndarray:
        """Return the normal derivatives (n,) of a source's pressure on the surface."""
        away = self.places - source
        r = np.linalg.norm(away, axis=1)
        return np.exp(-1j * self.wave * r) / r * (-1j * self.wave - 1 / r) / r * np.sum(away * self.normals, axis=1)

    def levels(self, source: np.ndarray, receivers: np.ndarray) -> np.ndarray:
        """Return the pressure (n,) over the free field."""
        wanted = -self.slope(source)
        strengths = np.linalg.lstsq(self.matrix, wanted, rcond=1e-12)[0]
        assert np.linalg.norm(self.matrix @ strengths - wanted) < 0.02 * np.linalg.norm(wanted)
        r = np.linalg.norm(receivers[:, None] - self.inside, axis=2)
        away = np.linalg.norm(receivers - source, axis=1)
        return 1.0 + (np.exp(-1j * self.wave * r) / r) @ strengths * away * np.exp(1j * self.wave * away)


def ellipsoid(axes: np.ndarray, wave: float, count: int) -> PointSources:
    """Return an ellipsoid by point sources on a surface inside."""
    out, within = evenly(2 * count), evenly(count)
    normals, inwards = out / axes, within / axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    depth = min(0.6 * axes.min() ** 2 / axes.max(), 0.25 * axes.min())
    return PointSources(out * axes, normals, within * axes - depth * inwards, wave)


def capsule(radius: float, half: float, wave: float, count: int) -> PointSources:
    """Return a capsule by point sources on one of half its radius."""

    def surface(count: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
        on_side = int(count * half / (half + radius))
        ends, i = evenly(count - on_side), np.arange(on_side) + 0.5
        about = np.pi * (1.0 + 5.0**0.5) * i
        side = np.stack([np.cos(about), np.sin(about), 0.0 * i], axis=1)
        axis = np.concatenate([np.where(ends[:, 2] >= 0.0, half, -half), (2.0 * i / max(on_side, 1) - 1.0) * half])
        normals = np.concatenate([ends, side])
        return radius * normals + axis[:, None] * [0.0, 0.0, 1.0], normals

    return PointSources(*surface(2 * count, radius), surface(count, 0.5 * radius)[0], wave)


def heard(
    shapes: list[clsim.Scatterer], wave: float, source: np.ndarray, receivers: np.ndarray, **search: int
) -> np.ndarray:
    """Return direct sound and scatterers (n,) at receivers (n, 3), over the free field."""
    frequency = wave * C / (2.0 * np.pi)
    signal = clsim.Signal.tone(frequency, 0.01, 8.0 * frequency)
    scene = clsim.Scene(
        clsim.Shoebox(2.0 * MIDDLE, SILENT), AIR, [clsim.Source("s", signal, clsim.Trajectory.fixed(MIDDLE + source))],
        [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(MIDDLE + at)) for i, at in enumerate(receivers)], scatterers=shapes,
    )  # fmt: skip
    total = np.zeros(len(receivers), dtype=complex)
    at = SceneResponse(scene, 0, np.array([frequency]))
    for family in clsim.find_paths(scene, 0, **search).families:
        for pair in family.pairs():
            found = pair.arrivals(np.zeros(1))
            turn = np.exp(-2j * np.pi * frequency * found.delay[:, 0])
            total[pair.receiver] += np.sum(pair.response(found, np.zeros(1), at)[:, 0, 0] * turn)
    away = np.linalg.norm(receivers - source, axis=1)
    return total * away * np.exp(1j * wave * away)


def errors(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return errors of levels, dB, where the exact one is above -20 dB."""
    assert np.sum(np.abs(exact) > 0.1) > 10
    return 20.0 * np.log10(np.abs(got / exact))[np.abs(exact) > 0.1]


def walk(distance: float, across: np.ndarray) -> np.ndarray:
    """Return places (n, 3) behind the origin as seen from -x, off the axis by distances (n,)."""
    return np.stack([np.full(len(across), distance), 0.8 * across, 0.6 * across], axis=1)
