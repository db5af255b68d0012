"""Images in uniform air at rest: changes of delay and response in closed form, and the transpose of these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.paths.family import PairPaths, PathFamily, Rows
from clsim.paths.response import Arrivals, Kinematics
from clsim.scene.directivity.patterns import Omni
from clsim.sensitivity.displaced import TangentResponse

_INSTANT = 1e-6  # s, half of that over which accelerations are taken
_STEP = 1e-5  # of directions, metres and Doppler factors, by which responses are differentiated


def in_closed_form(family: PathFamily) -> bool:
    """Test if paths are images in uniform air at rest."""
    air = family.scene.air
    return family.is_specular and air.wind is None and not air.layers and air.fluctuation is None


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Changes (P, T) of images, per unit of a parameter."""

    delay: Floats  # by the receiver's clock
    length: Floats
    mach: Floats  # of the source, along the path
    direction: Floats  # (P, T, 3) of departure
    emitted: Floats  # of the time of emission, s
    rate: Floats  # of the delay's rate, by what moves evenly


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Images between one source and one receiver at times (T,), with the motion of both."""

    # A source at x leaves for the mirrored receiver X along the unit vector u over the length L. For small changes S of
    # ``X - x``, where v is the source's velocity, ``M = u v / c`` and κ = 1 / (1 - M),
    # dτ = κ u S / c, W = S + v dτ, dL = u W, du = (W - u dL) / L, dM = (du v - a u dτ) / c.
    paths: PairPaths
    times: Floats
    found: Arrivals
    matrix: Floats  # (P, 3, 3) of the images
    velocity: Floats  # (P, T, 3) of the source at emission; 0 where the sound takes no time
    speed_of_sound: float
    exponent: float  # of κ in the amplitude
    acceleration: Floats  # (P, T) along the path over the speed of sound, 1/s
    heading: Floats  # (P, T, 3) velocity of the mirrored receiver less that of the source

    @property
    def family(self) -> PathFamily:
        """Kind of the paths."""
        return self.paths.family

    @property
    def rows(self) -> NDArray[np.int64]:
        """Which of these, (P,)."""
        return self.paths.index

    @classmethod
    def of(cls, paths: PairPaths, times: Floats, found: Arrivals, kinematics: Kinematics) -> Images:
        """Take the motion of both ends from their trajectories."""
        family: Any = paths.family
        links = family.links(paths.rows)
        (source, receiver), matrix, c = links.motions, links.legs[0].matrix, links.medium.speed_of_sound
        shape, own = (*found.delay.shape, 3), np.zeros((1, 1, 3))
        along = np.zeros(found.delay.shape)
        if not source.is_static:
            flat = found.emission_time.ravel()
            own = source.velocity(flat).reshape(shape)
            faster = source.velocity(flat + _INSTANT) - source.velocity(flat - _INSTANT)
            along = _dot(faster.reshape(shape), found.departure) / (2.0 * _INSTANT * c)
        mirrored = turned_back(matrix, receiver.velocity(times))
        retarded = kinematics.retarded
        return cls(
            paths, times, found, matrix, own if retarded else np.zeros((1, 1, 3)), c,
            float(kinematics.exponent) if retarded else 0.0, along, mirrored - own,
        )  # fmt: skip

    def change(
        self, apart: Floats | float = 0.0, velocity: Floats | float = 0.0, later: Floats | float = 0.0,
        speed: float = 0.0, swifter: Floats | float = 0.0,
    ) -> Change:  # fmt: skip
        """Return the changes by those of ``X - x`` and v, (P, T, 3), of times of reception and the speed of sound."""
        # `swifter` is the change (P, T, 3) of the mirrored receiver's velocity.
        u, v, length, c = self.found.departure, self.velocity, self.found.length, self.speed_of_sound
        moved = apart + np.asarray(later)[..., None] * self.heading
        delay = self.found.frequency_ratio * (_dot(u, moved) / c - length * speed / c**2)
        carried = moved + v * delay[..., None]
        longer, emitted = _dot(u, carried), later - delay
        turned = (carried - u * longer[..., None]) / length[..., None]
        mach = (_dot(turned, v) + _dot(u, np.asarray(velocity))) / c + self.acceleration * emitted
        mach = mach - _dot(u, v) * speed / c**2
        ratio = self.found.frequency_ratio
        nearer = _dot(turned, self.heading) + _dot(u, np.asarray(swifter) - velocity)
        rate = ratio * (nearer / c - self.acceleration * emitted) + self.found.delay_rate * (ratio * mach - speed / c)
        return Change(delay - later, longer, mach, turned, emitted, rate)

    def level(self, change: Change) -> Floats:
        """Relative change (P, T) of responses by spreading and the Doppler factor."""
        return np.asarray(self.exponent * self.found.frequency_ratio * change.mach - change.length / self.found.length)

    def moved(self, change: Change, step: float) -> Arrivals:
        """Arrivals after a step."""
        found, ratio = self.found, self.found.frequency_ratio
        departure = found.departure + step * change.direction
        return replace(
            found, departure=departure, arrival=self.arrival(departure), length=found.length + step * change.length,
            through=found.through + step * change.length, emission_time=found.emission_time + step * change.emitted,
            delay_rate=found.delay_rate + step * change.rate, frequency_ratio=ratio + step * ratio**2 * change.mach,
            mach_factor=found.mach_factor * (1.0 + step * self.exponent * ratio * change.mach),
        )  # fmt: skip

    def arrival(self, departure: Floats) -> Floats:
        """Directions of arrival (P, T, 3) of directions of departure."""
        return np.asarray(-np.einsum("pij,ptj->pti", self.matrix, departure))

    def forces(self, response: Floats | Complexes, weights: Complexes, at: TangentResponse) -> Forces:
        """Transpose of the changes of responses (C, P, T, F), weighted by weights (C, P, T, F)."""
        found = self.found
        product = np.asarray(np.conj(weights) * response, dtype=np.complex128)
        on_level = product.real.sum(axis=(0, 3))
        on_delay = product.imag.sum(axis=0) @ (2.0 * np.pi * at.turning)
        on_mach = self.exponent * found.frequency_ratio * on_level
        on_length = -on_level / found.length
        if at.disperses:
            on_length = on_length + self._response_by("through", weights, at)
            on_mach = on_mach + found.frequency_ratio**2 * self._response_by("frequency_ratio", weights, at)
        else:
            on_length = on_length - product.real.sum(axis=0) @ at.nepers
        turn = np.zeros((1, 1, 3)) if is_simple(self.family, self.rows, at) else self._by_direction(weights, at)
        return self._transposed(product, on_level, on_delay, on_length, on_mach, turn, weights, at)

    def _transposed(
        self, product: Complexes, on_level: Floats, on_delay: Floats, on_length: Floats, on_mach: Floats,
        turn: Floats, weights: Complexes, at: TangentResponse,
    ) -> Forces:  # fmt: skip
        """Transpose of `change`, backwards line by line."""
        u, v, c, found = self.found.departure, self.velocity, self.speed_of_sound, self.found
        source, receiver = self.family.ends(self.rows)
        turn = turn + on_mach[..., None] * v / c
        carried = u * on_length[..., None] + (turn - u * _dot(u, turn)[..., None]) / found.length[..., None]
        emitted = on_mach * self.acceleration
        if source.trajectory.turns and not isinstance(source.directivity, Omni):
            emitted = emitted + self._response_by("emission_time", weights, at)
        delay = on_delay - emitted + _dot(v, carried)
        apart = carried + u * (found.frequency_ratio * delay / c)[..., None]
        later = emitted + _dot(apart, self.heading) - on_delay
        if receiver.trajectory.turns and not isinstance(receiver.directivity, Omni):
            ahead, behind = (self._respond(found, at, self.times + sign * _STEP) for sign in (1.0, -1.0))
            later = later + _real_product(weights, ahead - behind) / (2.0 * _STEP)
        speed = -found.frequency_ratio * found.length / c**2 * delay - on_mach * _dot(u, v) / c**2
        return Forces(product, on_level, on_delay, apart, u * (on_mach / c)[..., None], later, speed)

    def _respond(self, found: Arrivals, at: TangentResponse, times: Floats | None = None) -> Any:
        return self.paths.responses(found, self.times if times is None else times, at)

    def _response_by(self, name: str, weights: Complexes, at: TangentResponse) -> Floats:
        """Product (P, T) of weights with the derivative of responses by a column of the arrivals."""
        value = getattr(self.found, name)
        ahead, behind = (replace(self.found, **{name: value + sign * _STEP}) for sign in (1.0, -1.0))
        return _real_product(weights, self._respond(ahead, at) - self._respond(behind, at)) / (2.0 * _STEP)

    def _by_direction(self, weights: Complexes, at: TangentResponse) -> Floats:
        """Product (P, T, 3) of weights with the gradient of responses by the direction of departure."""
        u, found = self.found.departure, np.zeros(self.found.departure.shape)
        least = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
        first = np.cross(u, least)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        for axis in (first, np.cross(u, first)):
            each = (u + sign * _STEP * axis for sign in (1.0, -1.0))
            ahead, behind = (replace(self.found, departure=to, arrival=self.arrival(to)) for to in each)
            slope = _real_product(weights, self._respond(ahead, at) - self._respond(behind, at)) / (2.0 * _STEP)
            found = found + slope[..., None] * axis
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """Derivatives of a loss by what images depend on, at nodes (P, T)."""

    product: Complexes  # (C, P, T, F) conjugate weights times responses
    level: Floats  # by the relative change of responses
    delay: Floats  # by a change of the delay alone, 1/s
    apart: Floats  # (P, T, 3) by changes of the mirrored receiver's place less the source's, 1/m
    velocity: Floats  # (P, T, 3) by changes of the source's velocity, s/m
    later: Floats  # by changes of the time of reception, 1/s
    speed: Floats  # by changes of the speed of sound, s/m


def has_beams(paths: PairPaths) -> bool:
    """Test if an end of the paths of a pair sounds or hears otherwise in some directions."""
    return not all(isinstance(end.directivity, Omni) for end in paths.family.ends(paths.rows))


def is_simple(family: Any, rows: Rows, at: TangentResponse) -> bool:
    """Test if responses change by spreading, air and the Doppler factor alone."""
    alike = all(isinstance(end.directivity, Omni) for end in family.ends(rows))
    return alike and not at.disperses and not bool(at.angular[family.links(rows).all_surfaces].any())


def turned_back(matrix: Floats, vectors: Floats) -> Floats:
    """Vectors (P, T, 3) before images mirror them, of vectors (T, 3) of all or (P, T, 3) of each."""
    each = np.broadcast_to(vectors, (len(matrix), *vectors.shape[-2:]))
    return np.asarray(np.einsum("pji,ptj->pti", matrix, each))


def _dot(a: Floats, b: Floats) -> Floats:
    each = a * b  # a sum along an axis of three takes much longer
    return np.asarray(each[..., 0] + each[..., 1] + each[..., 2])


def _real_product(weights: Complexes, values: Any) -> Floats:
    return np.asarray((np.conj(weights) * values).real.sum(axis=(0, -1)))
