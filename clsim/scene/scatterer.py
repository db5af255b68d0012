"""Things that scatter sound: points, spheres, ellipsoids and capsules that move through the room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics import outline, silhouette, sphere
from clsim.acoustics.capsule import ASPECTS, capsule_aspects, capsule_field, capsule_specular_point
from clsim.acoustics.scattering import SpecularPoint, ellipsoid_mirror, ellipsoid_specular_point, ellipsoid_strength
from clsim.arrays import FARTHEST, Complexes, Floats, as_choice, as_flag, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, check_kind, check_name
from clsim.scene.fluctuation import TargetFluctuation
from clsim.scene.motion.motion import Moved
from clsim.scene.motion.trajectory import Trajectory

MODELS = ("series", "geometrical", "outline")
_STRONGEST = 60.0  # dB re 1 m, a target strength that no thing in a room exceeds
_SMALLEST = 1e-6  # m; less scatters nothing that a receiver hears, and is lost in rounding
_LONGEST_ASPECT = 1e4  # of semi-axes: of thinner bodies the specular point is lost in rounding
_LARGEST_KA = 2000.0  # of a series


class Shape(Protocol):
    """Protocol of scatterer shapes: specular point, strength and field in the scatterer's frame."""

    @property
    def kind(self) -> str:
        """The word for it."""

    @property
    def semi_axes(self) -> Floats:
        """Half of its extent along its own axes (3,), m."""

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere about the centre, m."""

    @property
    def is_complex(self) -> bool:
        """Whether its field has a phase of its own."""

    @property
    def shadows(self) -> bool:
        """Whether the scattered field includes the shadow behind it."""

    @property
    def outlined(self) -> bool:
        """Whether that is the field about its outline."""

    @property
    def aspects(self) -> int:
        """Number of arguments of `field` per path."""

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint | None:
        """Return specular point for endpoints (3, n), see `ellipsoid_specular_point`; None for its centre."""

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        """Return scattering strength (n,) between endpoints (3, n), m, and arguments (n, aspects) of `field`."""

    def field(self, wave: Floats, centre: float, aspects: Floats, past: Complexes | float = 1.0) -> Complexes | None:
        """Return factor (..., F) of the strength at wave numbers (F,), 1/m, about a central one; None for 1."""

    def largest(self, wave: Floats, nearest: Floats) -> Floats:
        """Return bounds (n, F) of the scattered pressure times the path length at wave numbers (F,), 1/m.

        The distances of both ends from it have at least these harmonic means, over 2, (n,) m.
        """

    def holds(self, places: Floats, margin: float) -> NDArray[np.bool_]:
        """Return mask of positions (n, 3) inside it, or nearer to it than a margin, m."""


def _over(nearest: Floats, strength: Floats) -> Floats:
    """Return bounds (n, F) of strengths (F,) m over distances (n,) m."""
    return np.asarray(strength / nearest[:, None])


@dataclass(frozen=True, slots=True)
class PointShape:
    """A point of one strength, m, at all frequencies and in all directions."""

    strongest: float
    kind: ClassVar[str] = "point"
    radius: ClassVar[float] = 0.0
    is_complex: ClassVar[bool] = False
    shadows: ClassVar[bool] = False
    outlined: ClassVar[bool] = False
    aspects: ClassVar[int] = 1

    @property
    def semi_axes(self) -> Floats:
        return np.zeros(3)

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint | None:
        return None

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        one = np.ones(source.shape[1])
        return self.strongest * one, one[:, None]

    def field(self, wave: Floats, centre: float, aspects: Floats, past: Complexes | float = 1.0) -> Complexes | None:
        return None

    def largest(self, wave: Floats, nearest: Floats) -> Floats:
        return _over(nearest, np.full(len(wave), self.strongest))

    def holds(self, places: Floats, margin: float) -> NDArray[np.bool_]:
        return np.asarray(np.linalg.norm(places, axis=-1) < margin)


@dataclass(frozen=True, slots=True, eq=False)
class EllipsoidShape:
    """A rigid ellipsoid with semi-axes (3,) m: geometrical optics and, outlined, its shadow."""

    semi_axes: Floats
    outlined: bool = False
    kind: ClassVar[str] = "ellipsoid"

    @property
    def radius(self) -> float:
        return float(self.semi_axes.max())

    @property
    def is_complex(self) -> bool:
        return self.outlined

    @property
    def shadows(self) -> bool:
        return self.outlined

    @property
    def outline(self) -> outline.Outline:
        return outline.EllipsoidOutline(self.semi_axes)

    @property
    def aspects(self) -> int:
        return silhouette.ASPECTS if self.outlined else 1

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint:
        return ellipsoid_specular_point(self.semi_axes, source, receiver, near, weight)

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        found = specular or self.specular(source, receiver, None, 1.0)
        if self.outlined:
            mirrored = ellipsoid_mirror(self.semi_axes, source, receiver, found)
            return silhouette.silhouette_aspects((source, receiver), found, mirrored)
        return ellipsoid_strength(self.semi_axes, source, receiver, found), np.ones((source.shape[1], 1))

    def field(self, wave: Floats, centre: float, aspects: Floats, past: Complexes | float = 1.0) -> Complexes | None:
        """Return the reflection or, in the forward direction, the outline's field; None for geometrical optics."""
        if self.outlined:
            return silhouette.silhouette_field(self.outline, wave, centre, aspects, 1.0, past)
        return None

    def largest(self, wave: Floats, nearest: Floats) -> Floats:
        """Return the bounds (n, F) of half the largest mean radius of curvature, and of the outline."""
        bound = _over(nearest, np.full(len(wave), 0.5 * np.prod(self.semi_axes) / self.semi_axes.min() ** 2))
        return bound + silhouette.silhouette_bound(self.radius, wave, nearest) if self.outlined else bound

    def holds(self, places: Floats, margin: float) -> NDArray[np.bool_]:
        return np.asarray(np.linalg.norm(places / (self.semi_axes + margin), axis=-1) < 1.0)


@dataclass(frozen=True, slots=True)
class SphereShape:
    """A rigid sphere of a radius, m, by the series over its modes."""

    radius: float
    kind: ClassVar[str] = "sphere"
    is_complex: ClassVar[bool] = True
    shadows: ClassVar[bool] = True
    outlined: ClassVar[bool] = False
    aspects: ClassVar[int] = sphere.ASPECTS

    @property
    def semi_axes(self) -> Floats:
        return np.full(3, self.radius)

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint:
        return ellipsoid_specular_point(np.full(3, self.radius), source, receiver, near, weight)

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        return sphere.sphere_aspects(
            self.radius, source, receiver, specular or self.specular(source, receiver, None, 1.0)
        )

    def field(self, wave: Floats, centre: float, aspects: Floats, past: Complexes | float = 1.0) -> Complexes | None:
        self._check(wave)
        return sphere.sphere_field(self.radius * wave, aspects)

    def _check(self, wave: Floats) -> None:
        most = self.radius * float(wave.max())
        if most > _LARGEST_KA:
            problem = f"must be at most {_LARGEST_KA:g} / wave number for a series, but ka is {most:.6g} for "
            raise InputError("radius", f'{problem}{self.radius:g} m; say model="geometrical"')

    def largest(self, wave: Floats, nearest: Floats) -> Floats:
        self._check(wave)
        return sphere.sphere_bound(self.radius, wave, nearest)

    def holds(self, places: Floats, margin: float) -> NDArray[np.bool_]:
        return np.asarray(np.linalg.norm(places, axis=-1) < self.radius + margin)


@dataclass(frozen=True, slots=True)
class CapsuleShape:
    """A rigid cylinder about z with half spheres at its ends, of a radius and a length between their centres, m."""

    cylinder_radius: float
    length: float
    outlined: bool = False
    kind: ClassVar[str] = "capsule"
    is_complex: ClassVar[bool] = True

    @property
    def shadows(self) -> bool:
        return self.outlined

    @property
    def outline(self) -> outline.Outline:
        return outline.CapsuleOutline(self.cylinder_radius, 0.5 * self.length)

    @property
    def aspects(self) -> int:
        return ASPECTS + silhouette.ASPECTS if self.outlined else ASPECTS

    @property
    def semi_axes(self) -> Floats:
        return np.array([self.cylinder_radius, self.cylinder_radius, self.radius])

    @property
    def radius(self) -> float:
        return 0.5 * self.length + self.cylinder_radius

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint:
        return capsule_specular_point(self.cylinder_radius, self.length, source, receiver, near, weight)

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        found = specular or self.specular(source, receiver, None, 1.0)
        return capsule_aspects(self.cylinder_radius, self.length, source, receiver, found, self.outlined)

    def field(self, wave: Floats, centre: float, aspects: Floats, past: Complexes | float = 1.0) -> Complexes | None:
        """Return the Fresnel integrals along it or, in the forward direction, the field about its outline."""
        return capsule_field(wave, aspects, self.outline if self.outlined else None, past, centre)

    def largest(self, wave: Floats, nearest: Floats) -> Floats:
        """Return the bounds (n, F) of both ends and the whole of the side in phase."""
        side = self.length * np.sqrt(self.cylinder_radius * wave / (4.0 * np.pi))
        bound = _over(nearest, side + self.cylinder_radius)
        return bound + silhouette.silhouette_bound(self.radius, wave, nearest) if self.outlined else bound

    def holds(self, places: Floats, margin: float) -> NDArray[np.bool_]:
        beyond = np.maximum(np.abs(places[..., 2]) - 0.5 * self.length, 0.0)
        off = np.stack([places[..., 0], places[..., 1], beyond], axis=-1)
        return np.asarray(np.linalg.norm(off, axis=-1) < self.cylinder_radius + margin)


@dataclass(frozen=True, slots=True, eq=False)
class Scatterer(Moved):
    """An object that scatters sound, made by `point`, `sphere`, `ellipsoid` or `capsule`.

    It ends no path: behind what casts a shadow (by default all but points), the scattered wave cancels
    the direct one there. Paths by two scatterers are found with ``scatterers_in_row=2``.

    Parameters
    ----------
    name : str
        Unique among the scene's scatterers.
    shape : Shape
        Its shape, which decides what it scatters.
    trajectory : Trajectory
        Position of its centre, and its orientation.
    fluctuation : TargetFluctuation, optional
        Change of its strength with time.
    """

    name: str
    shape: Shape
    trajectory: Trajectory
    fluctuation: TargetFluctuation | None = None
    flush: ClassVar[bool] = False  # it sits in no wall

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_name(self.name)
        check_kind("trajectory", self.trajectory, Trajectory, "a Trajectory")
        self.trajectory.check_start()
        check_kind("fluctuation", self.fluctuation, TargetFluctuation | None, "a TargetFluctuation")

    @staticmethod
    def point(
        name: str, target_strength_db: float, trajectory: Trajectory, fluctuation: TargetFluctuation | None = None
    ) -> Scatterer:
        """Return a point that scatters alike in all directions and at all frequencies.

        Parameters
        ----------
        target_strength_db : float
            20 lg of the pressure at 1 m from it over that of the wave that meets it, dB; at most 60.
        trajectory : Trajectory
            Position over time.

        Examples
        --------
        >>> Scatterer.point("bat", -40.0, Trajectory.fixed((2.0, 1.0, 1.0))).shape.strongest
        0.01
        """
        level = as_number("target_strength_db", target_strength_db, at_most=_STRONGEST, unit="dB")
        return Scatterer(name, PointShape(10.0 ** (level / 20.0)), trajectory, fluctuation)

    @staticmethod
    def sphere(
        name: str, radius: float, trajectory: Trajectory, model: str = "series",
        fluctuation: TargetFluctuation | None = None,
    ) -> Scatterer:  # fmt: skip
        """Return a rigid sphere.

        Parameters
        ----------
        radius : float
            m, at least 1e-6.
        trajectory : Trajectory
            Position of its centre over time.
        model : {"series", "geometrical", "outline"}
            "series" sums its modes, exact at every frequency, distance and angle, shadow included. "geometrical" is
            geometrical optics, without a shadow. "outline" adds to this the shadow of its outline, as ellipsoids have.

        Examples
        --------
        >>> Scatterer.sphere("ball", 0.05, Trajectory.fixed((2.0, 1.0, 1.0))).shape
        SphereShape(radius=0.05)
        """
        size = as_number("radius", radius, above=0.0, at_least=_SMALLEST, at_most=FARTHEST, unit="m")
        as_choice("model", model, MODELS)
        alike = EllipsoidShape(read_only(np.full(3, size)), outlined=model == "outline")
        shape: Shape = SphereShape(size) if model == "series" else alike
        return Scatterer(name, shape, trajectory, fluctuation)

    @staticmethod
    def ellipsoid(
        name: str, semi_axes: ArrayLike, trajectory: Trajectory, fluctuation: TargetFluctuation | None = None,
        shadow: bool = True,
    ) -> Scatterer:  # fmt: skip
        """Return a rigid ellipsoid, by geometrical optics: the echo of its specular point.

        Parameters
        ----------
        semi_axes : array_like (3,)
            Along its own x, y and z, m, at least 1e-6; the longest at most 10 000 times the shortest.
        trajectory : Trajectory
            Position of its centre, and its orientation.
        shadow : bool
            Whether it casts a shadow: in the forward direction the field about its outline, which costs several times
            as much as its echo. It takes away the direct sound behind it.

        Examples
        --------
        >>> hand = Scatterer.ellipsoid("hand", (0.09, 0.05, 0.02), Trajectory.fixed((2.0, 1.0, 1.0)))
        >>> hand.shape.radius
        0.09
        """
        axes = as_floats("semi_axes", semi_axes, (3,), within=FARTHEST)
        for i, axis in enumerate(axes.tolist()):
            as_number(f"semi_axes[{i}]", axis, above=0.0, at_least=_SMALLEST, unit="m")
        if axes.max() > _LONGEST_ASPECT * axes.min():
            raise InputError(
                "semi_axes",
                f"must be at most {_LONGEST_ASPECT:g} times as long as the shortest of them, but are {axes.max():g} "
                f"and {axes.min():g} m; a long rod is a capsule",
            )
        return Scatterer(name, EllipsoidShape(read_only(axes), as_flag("shadow", shadow)), trajectory, fluctuation)

    @staticmethod
    def capsule(
        name: str, radius: float, length: float, trajectory: Trajectory, fluctuation: TargetFluctuation | None = None,
        shadow: bool = True,
    ) -> Scatterer:  # fmt: skip
        """Return a rigid capsule, a cylinder with round ends, by Fresnel integrals along it.

        Parameters
        ----------
        radius : float
            Radius of the cylinder and of both half spheres, m, at least 1e-6.
        length : float
            Length of the cylinder, between the centres of the half spheres, along its own z, m, at least 1e-6.
        trajectory : Trajectory
            Position of its middle, and its orientation.
        shadow : bool
            As of an `ellipsoid`.

        Examples
        --------
        >>> finger = Scatterer.capsule("finger", 0.009, 0.07, Trajectory.fixed((2.0, 1.0, 1.0)))
        >>> round(finger.shape.radius, 3)
        0.044
        """
        size = as_number("radius", radius, above=0.0, at_least=_SMALLEST, at_most=FARTHEST, unit="m")
        long = as_number("length", length, above=0.0, at_least=_SMALLEST, at_most=FARTHEST, unit="m")
        return Scatterer(name, CapsuleShape(size, long, as_flag("shadow", shadow)), trajectory, fluctuation)

    @property
    def is_static(self) -> bool:
        """Whether its echo does not change: it rests or turns symmetrically, and does not fluctuate."""
        if self.fluctuation is not None:
            return False
        alike = self.shape.radius == 0.0 or isinstance(self.shape, SphereShape)
        return self.trajectory.is_static and (alike or not self.trajectory.turns)

    def peak_speeds(self) -> tuple[float, float]:
        """Return bounds of the speeds of its centre and of its surface, m/s, which are sampled and 2 % larger."""
        speed = 1.02 * self.trajectory.peak_speed(*self._known)[0] if not self.trajectory.is_static else 0.0
        return speed, speed + 1.02 * self.trajectory.peak_turn * self.shape.radius

    @property
    def _known(self) -> tuple[float, float]:
        """Start and end of its trajectory, s."""
        from clsim.scene.motion.curves import CONTINUATION

        return self.trajectory.start - CONTINUATION, self.trajectory.end + CONTINUATION
