"""What air, walls and directivities make of every frequency along paths, in float64: the definition of right.

The OpenCL gains (``response.h``) are the small twin of this file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.errors import InputError
from clsim.numerics.quaternions import rotate
from clsim.paths.arrivals import Arrivals
from clsim.scene.air import Air, coefficients
from clsim.scene.directivity.directivity import ChannelDirectivity, Directivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver, Source
from clsim.scene.material.material import Material
from clsim.scene.scene import Scene

Walls = NDArray[np.signedinteger[Any]]


NEPERS = np.log(10.0) / 20.0  # in one dB
_GRAZING = 1e-9  # least cosine of an angle of incidence


class SceneResponse:
    """What air, walls and transducers of a scene do at some frequencies: what responses of all paths are made of.

    A response is received over emitted pressure by frequency, without the delay; a delay tau would be ``exp(-2j pi f
    tau)``.

    Shapes: frequencies (F,) Hz; left_out (F,) absorption of the air that is rendered otherwise, 1/m (see `Tilt`).

    Attributes
    ----------
    frequencies : ndarray (F,)
        The same.
    nepers : ndarray (F,)
        Absorption of the air, of the amplitude, 1/m; half way up where it depends on the height.
    least_nepers, most_nepers : ndarray (F,)
        Bounds of it over all heights, 1/m.
    angular : ndarray (walls + 1,) bool
        Walls whose factor depends on the angle of incidence; False at the end, for -1, which is no wall.
    dtype : numpy type
        Type of the factors of walls and transducers: float64, or complex128 where one of the scene is complex.
    disperses : bool
        Whether the air gives phases.
    surfaces : int
        Number of walls and faces, at which begin the numbers of those that let sound pass, see `Scene.materials`.
    panels : ndarray (surfaces,) bool
        Walls that let sound pass.
    """

    def __init__(self, scene: Scene, source: int, frequencies: Floats, left_out: Floats | float = 0.0) -> None:
        self._scene, self.frequencies, self.disperses = scene, frequencies, scene.air.dispersion
        self._centre, self._layers = scene.sources[source].emitted.centre_frequency, scene.air.layers
        materials = self._materials = scene.materials
        self.surfaces = len(materials) // (2 if scene.panels else 1)
        self.panels: NDArray[np.bool_] = np.isin(np.arange(self.surfaces), scene.panels)
        self.nepers: Floats = scene.air.absorption_at(frequencies) * NEPERS - left_out
        layers = [layer.absorption_at(frequencies) * NEPERS for layer in scene.air.layers]
        self.least_nepers, self.most_nepers = self.nepers, self.nepers
        if layers:
            self._by_height = coefficients(np.array(layers))
            self.least_nepers, self.most_nepers = 0.99 * np.min(layers, axis=0), 1.01 * np.max(layers, axis=0)
        self.angular: NDArray[np.bool_] = np.array([*(m.depends_on_angle for m in materials), False])
        self.dtype: Any = np.complex128 if is_complex(scene) else np.float64
        self._factors = np.ones((len(materials) + 1, len(frequencies)), dtype=self.dtype)
        known = {id(material): i for i, material in enumerate(dict.fromkeys(materials))}
        self._alike = np.array([*(known[id(m)] for m in materials), len(known)], dtype=np.int64)
        for material in dict.fromkeys(materials):
            if not material.depends_on_angle:
                rows = [m is material for m in (*materials, None)]
                at = covered(frequencies, material)
                self._factors[rows] = material.reflection_at(at, 1.0, scene.air.speed_of_sound)

    def air(self, found: Arrivals) -> Floats | Complexes:
        """Transmission of the air (P, T, F) relative to 1 m of it, with its dispersion if it has one."""
        beyond, ratio = (found.through - 1.0)[..., None], found.frequency_ratio[..., None]
        if not self.disperses:
            nepers = self.nepers if found.means is None else found.means @ self._by_height
            return np.asarray(np.exp(-beyond * nepers))
        met = 1.0 if np.all(ratio == 1.0) else ratio
        if found.means is None:
            lossy, lead = self.air_at(met)
            return np.asarray(np.exp(beyond * (1j * lead - lossy)))
        shares = found.means @ coefficients(np.eye(len(self._layers)))  # of each layer in the mean
        exponent: Any = 0.0
        for i, layer in enumerate(self._layers):
            lossy, lead = self._of_air(layer, met)
            exponent = exponent + shares[..., i, None] * (1j * lead - lossy)
        return np.asarray(np.exp(beyond * exponent))

    def air_at(self, frequency_ratio: Floats | float) -> tuple[Floats, Floats]:
        """Return absorption, 1/m, and lead before the delays' phase, rad/m, (..., F) at ratios of the frequencies."""
        return self._of_air(self._scene.air, frequency_ratio)

    def _of_air(self, air: Air, frequency_ratio: Floats | float) -> tuple[Floats, Floats]:
        f = self.frequencies * frequency_ratio
        k = air.wavenumber_at(f)
        return -k.imag, 2.0 * np.pi / air.speed_at(self._centre) * f - k.real

    def reflection(self, walls: Walls) -> Floats | Complexes:
        """Return the product of the factors (P, F) of walls (P, N), of those that are the same at every angle."""
        base, which = int(self._alike.max()) + 1, None
        if base ** walls.shape[1] < 2**62:  # sequences of the same materials, as numbers
            _, first, which = np.unique(
                self._alike[walls] @ base ** np.arange(walls.shape[1]), return_index=True, return_inverse=True
            )
            walls = walls[first]
        product: Floats | Complexes = np.ones((len(walls), len(self.frequencies)), dtype=self.dtype)
        for wall in walls.T:
            product *= self._factors[wall]
        return product if which is None else product[which]

    def largest_reflection(self, walls: Walls) -> Floats:
        """Return the product of the factors' magnitudes (P, F) of walls (P, N), 1 where they depend on the angle."""
        product, magnitudes = np.ones((len(walls), len(self.frequencies))), np.abs(self._factors)
        for wall in walls.T:
            product *= magnitudes[wall]
        return product

    def reflection_at(self, wall: int, cosine: Floats) -> Floats | Complexes:
        """Return the factor (..., F) of a wall at cosines (...) of the angle of incidence."""
        material = self._materials[wall]
        angle = np.maximum(cosine, _GRAZING)[..., None]
        return material.reflection_at(covered(self.frequencies, material), angle, self._scene.air.speed_of_sound)

    def angular_bounces(self, walls: Walls) -> list[tuple[int, Floats]]:
        """Return the bounces at which some path meets a wall whose factor depends on the angle, with normals (P, 3)."""
        met = self.angular[walls]
        if not met.any():
            return []
        through = walls >= self.surfaces
        own = np.where(through, walls - self.surfaces, walls)
        normals = np.concatenate([self._scene.room.faces.normals, np.zeros((1, 3))])[own]
        mirrors, unfolded = np.where(through[..., None], 0.0, normals), normals.copy()
        for bounce in range(walls.shape[1]):  # each is mirrored by the walls before it, the last of them first
            for before in range(bounce - 1, -1, -1):
                along = np.sum(unfolded[:, bounce] * mirrors[:, before], axis=1, keepdims=True)
                unfolded[:, bounce] -= 2.0 * along * mirrors[:, before]
        return [(bounce, unfolded[:, bounce]) for bounce in np.flatnonzero(met.any(axis=0)).tolist()]

    def apply_angular_walls(self, response: Floats | Complexes, walls: Walls, directions: Floats) -> None:
        """Multiply responses (P, T, F) by the factors of walls (P, N) that depend on the angle, in place."""
        for bounce, normals in self.angular_bounces(walls):
            met = walls[:, bounce]
            for wall in np.unique(met[self.angular[met]]):
                here = np.flatnonzero(met == wall)
                cosine = np.abs(np.einsum("pti,pi->pt", directions[here], normals[here]))
                response[here] *= self.reflection_at(wall, cosine)

    def apply_angles(self, response: Floats | Complexes, surfaces: Walls, cosine: Floats) -> None:
        """Multiply responses (P, T, F) by the factors of surfaces (P, N) that depend on the angle, in place."""
        for bounce, met in enumerate(surfaces.T):
            for wall in np.unique(met[self.angular[met]]).tolist():
                here = np.flatnonzero(met == wall)
                response[here] *= self.reflection_at(wall, cosine[here, :, bounce])

    def apply_directivities(
        self, response: Floats | Complexes, ends: tuple[Source, Receiver], found: Arrivals, times: Floats
    ) -> None:
        """Multiply responses (P, T, F) by the directivities of both ends, in place."""
        (source, receiver), frequencies, c = ends, self.frequencies, self._scene.air.speed_of_sound
        if not isinstance(source.directivity, Omni):
            towards = to_transducer_frame(source.orientation, found.emission_time, found.departure)
            response *= directivity_gain(source.directivity, towards, frequencies, c)
        if not isinstance(receiver.directivity, Omni | ChannelDirectivity):
            towards = to_transducer_frame(receiver.orientation, times, found.arrival)
            response *= directivity_gain(receiver.directivity, towards, frequencies, c)

    def of_channels(
        self, response: Floats | Complexes, receiver: Receiver, channels: range | None, found: Arrivals, times: Floats
    ) -> Floats | Complexes:
        """Multiply responses (P, T, F) by the gains of channels of a receiver, (C, P, T, F)."""
        directivity, c = receiver.directivity, self._scene.air.speed_of_sound
        if not isinstance(directivity, ChannelDirectivity):
            return response[None]
        towards = to_transducer_frame(receiver.orientation, times, found.arrival)
        if channels is None:
            gain = np.moveaxis(directivity_gain(directivity, towards, self.frequencies, c), -1, 0)
        else:
            gain = directivity.aligned(towards, covered(self.frequencies, directivity), c, channels)
        return np.asarray(gain * response, dtype=np.result_type(response, self.dtype))


def is_complex(scene: Scene) -> bool:
    """Test if any wall or directivity of a scene has a phase."""
    directivities = [
        *(source.directivity for source in scene.sources),
        *(receiver.directivity for receiver in scene.receivers),
    ]
    return any(m.is_complex for m in scene.materials) or any(d.is_complex for d in directivities)


def to_transducer_frame(orientation: Callable[[Floats], Floats], times: Floats, directions: Floats) -> Floats:
    """Return directions (P, T, 3) in the frame of a transducer, turned as it is at times (T,) or (P, T)."""
    quaternions = orientation(times.ravel()).reshape(*times.shape, 4)
    return np.stack([np.sum(rotate(quaternions, axis) * directions, axis=-1) for axis in np.eye(3)], axis=-1)


def directivity_gain(
    directivity: Directivity, towards: Floats, frequencies: Floats, speed_of_sound: float
) -> Floats | Complexes:
    """Return the gain (..., F), of channels (..., F, C), of a directivity in directions (..., 3) of its own frame."""
    return directivity.gain_towards(towards[..., None, :], covered(frequencies, directivity), speed_of_sound)


def covered(frequencies: Floats, thing: Material | Directivity) -> Floats:
    """Return the frequencies nearest to given ones that a material or a directivity covers.

    Where a signal is more than next to nothing they are the same: plans see to that.
    """
    return np.asarray(np.clip(frequencies, *thing.band))


def check_band_coverage(scene: Scene, sources: Iterable[int], low: float, high: float, what: str) -> None:
    """Check that materials and the directivities of receivers and some sources cover a band."""
    directivities = [(f"sources[{i}]", scene.sources[i].directivity) for i in sources]
    directivities += [(f"receivers[{i}]", receiver.directivity) for i, receiver in enumerate(scene.receivers)]
    for field, directivity in directivities:
        if not (directivity.band[0] <= low and high <= directivity.band[1]):
            raise InputError(
                f"{field}.directivity",
                f"must cover {what}, {low:.0f} to {high:.0f} Hz, but covers "
                f'{directivity.band[0]:.6g} to {directivity.band[1]:.6g} Hz; give more of it, or say outside="hold"',
            )
    for material in dict.fromkeys(scene.materials):
        try:
            material.check_coverage([low, high])
        except InputError as error:
            raise InputError("room", f"{error.field} {error.problem}") from error
