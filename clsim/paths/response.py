"""Arrivals of paths at any time, and what air, walls and directivities make of every frequency along them, in float64.

The OpenCL gains (``response.h``) are the small twin of this file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_choice
from clsim.errors import InputError
from clsim.numerics.quaternions import rotate
from clsim.scene.air import Air, coefficients
from clsim.scene.directivity.directivity import ChannelDirectivity, Directivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver, Source
from clsim.scene.material.material import Material
from clsim.scene.scene import Scene

Walls = NDArray[np.signedinteger[Any]]

NEPERS = np.log(10.0) / 20.0  # in one dB
_GRAZING = 1e-9  # least cosine of an angle of incidence
_MACH_EXPONENT = {"wave-equation": 1, "static": 0, "convective": 2}
_AT_A_TIME = 16384  # arrivals of paths at times that are computed at a time, where they are many


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Motion while sound is on its way, and how the source's motion changes the amplitude; as in `render`."""

    motion: str = "retarded"
    amplitude: str = "wave-equation"

    def __post_init__(self) -> None:
        as_choice("motion", self.motion, ("retarded", "quasi-static"))
        as_choice("amplitude", self.amplitude, tuple(_MACH_EXPONENT))

    @property
    def retarded(self) -> bool:
        """Whether everything is where it was when the sound passed, not where it is at reception."""
        return self.motion == "retarded"

    @property
    def exponent(self) -> int:
        """Exponent of the Doppler factor in the amplitude."""
        return _MACH_EXPONENT[self.amplitude]


RETARDED = Kinematics()
QUASI_STATIC = Kinematics("quasi-static")


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What P paths bring at T times, each array (P, T) or (P, T, 3)."""

    delay: Floats  # (P, T) from emission to reception, s
    delay_rate: Floats  # (P, T) its derivative by the time of reception; the Doppler factor is ``1 - delay_rate``
    # (P, T, 3) unit vectors: from the real source along the path, and from the receiver back along it; in wind
    # the normals of the wavefront.
    departure: Floats
    arrival: Floats  # likewise
    length: Floats  # (P, T) of the path, over which pressure falls, m
    through: Floats  # (P, T) of the air that it passes, m: the same where the air rests
    means: Floats | None  # (P, T, terms) means of polynomials of the height along it, where the air depends on that
    emission_time: Floats  # (P, T) when it was emitted, s
    mach_factor: Floats  # (P, T) factor of the amplitude by the source's motion
    frequency_ratio: Floats  # (P, T) frequency on the way over that emitted: ``1 / (1 - M)``
    # (P, T, ...) quantities that only responses of a kind of path need, by name.
    more: dict[str, Floats] = field(default_factory=dict)

    def part(self, rows: NDArray[np.int64], times: slice | NDArray[np.int64] = slice(None)) -> Self:
        """Arrivals of some of the paths at some of the times; of rows and times (n, 1) each path at its own."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "more"}
        some: dict[str, Any] = {name: None if x is None else x[rows, times] for name, x in columns.items()}
        return replace(self, **some, more={name: x[rows, times] for name, x in self.more.items()})


def slices_of(times: int, paths: int) -> list[slice]:
    """Return slices of so many times that the arrivals of so many paths take little memory."""
    step = max(1, _AT_A_TIME // max(paths, 1))
    return [slice(i, i + step) for i in range(0, times, step)]


class SceneResponse:
    """What air, walls and transducers of a scene do at frequencies (F,), Hz: received over emitted pressure.

    Responses leave out the delay, which would be ``exp(-2j pi f tau)``, and the absorption of the air that is rendered
    otherwise, `left_out` (F,), 1/m (see `Tilt`).
    """

    def __init__(self, scene: Scene, source: int, frequencies: Floats, left_out: Floats | float = 0.0) -> None:
        self._scene, self.frequencies, self.disperses = scene, frequencies, scene.air.dispersion
        self._centre, self._layers = scene.sources[source].emitted.centre_frequency, scene.air.layers
        materials = self._materials = scene.materials
        # Number of walls and faces, at which begin the numbers of those that let sound pass, see `Scene.materials`.
        self.surfaces = len(materials) // (2 if scene.panels else 1)
        self.panels: NDArray[np.bool_] = np.isin(np.arange(self.surfaces), scene.panels)  # walls that let sound pass
        # (F,) absorption of the air, 1/m; half way up where it depends on the height, with bounds over all heights.
        self.nepers: Floats = scene.air.absorption_at(frequencies) * NEPERS - left_out
        layers = [layer.absorption_at(frequencies) * NEPERS for layer in scene.air.layers]
        self.least_nepers, self.most_nepers = self.nepers, self.nepers
        if layers:
            self._by_height = coefficients(np.array(layers))
            self.least_nepers, self.most_nepers = 0.99 * np.min(layers, axis=0), 1.01 * np.max(layers, axis=0)
        # (walls + 1,) walls whose factor depends on the angle of incidence; False at the end, for -1, which is none.
        self.angular: NDArray[np.bool_] = np.array([*(m.depends_on_angle for m in materials), False])
        self.dtype: Any = np.complex128 if is_complex(scene) else np.float64  # of factors of walls and transducers
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
            lost = -beyond * nepers
            return np.asarray(np.exp(lost, out=lost))
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
    parts: tuple[Any, ...] = (*scene.sources, *scene.receivers)
    return any(m.is_complex for m in scene.materials) or any(end.directivity.is_complex for end in parts)


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
    """Return the nearest frequencies that a thing covers; plans see to it that the signal has no others."""
    return np.asarray(np.clip(frequencies, *thing.band))


def check_band_coverage(scene: Scene, sources: Iterable[int], low: float, high: float, what: str) -> None:
    """Check that materials and the directivities of receivers and some sources cover a band."""
    directivities = [(f"sources[{i}]", scene.sources[i].directivity) for i in sources]
    directivities += [(f"receivers[{i}]", receiver.directivity) for i, receiver in enumerate(scene.receivers)]
    for end, directivity in directivities:
        if not (directivity.band[0] <= low and high <= directivity.band[1]):
            raise InputError(
                f"{end}.directivity",
                f"must cover {what}, {low:.0f} to {high:.0f} Hz, but covers "
                f'{directivity.band[0]:.6g} to {directivity.band[1]:.6g} Hz; give more of it, or say outside="hold"',
            )
    for material in dict.fromkeys(scene.materials):
        try:
            material.check_coverage([low, high])
        except InputError as error:
            raise InputError("room", f"{error.field} {error.problem}") from error
