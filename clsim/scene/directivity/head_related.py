"""Directivities of two ears: head-related responses from SOFA files, and a rigid sphere."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.sphere import sphere_surface_field
from clsim.arrays import Complexes, Floats, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, settle
from clsim.numerics.blas import with_blas_threads
from clsim.numerics.convolution import advanced, arrival_times
from clsim.numerics.sphere import RadialOnSphere, fibonacci_sphere, largest_hole, merged, real_harmonics
from clsim.scene.directivity.directivity import ChannelDirectivity, check_coverage, unit_directions
from clsim.scene.directivity.text_files import HEAD_CONVENTIONS, opened_sofa, read_responses, read_sofa

EARS = ("left", "right")
_LARGEST_HOLE = 60.0  # degrees, radius of the largest cap without a direction
_MOST = 4000  # directions, whose equations take 0.2 GB and some seconds
_KEPT = 1e-7  # of the largest component of all responses, below which one is left out
_LONGEST = 2**14  # samples of a response
_SLOWEST = 200.0  # m/s, below which no sound in air is
_DEGREE = 5  # of the polynomial of lateness
_IN_GAPS = 700  # directions evenly over the sphere, of which those in gaps are taken
_GAP, _LEAST_GAP = 2.5, 0.2  # times the median distance of neighbours, and rad, beyond which there is a gap
_COARSE, _STIFF = 4, 1e-3  # order of the harmonics that fill gaps, and their stiffness
_NEAR = 0.1  # least cosine between a direction and an ear's axis at which its time of arrival is taken as it is


class _Ears(ChannelDirectivity):
    """Base class of directivities of two ears."""

    __slots__ = ()
    is_complex: ClassVar[bool] = True

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, ``"left"`` and ``"right"``."""
        return EARS


@dataclass(frozen=True, slots=True, eq=False)
class HeadRelated(_Ears):
    """Head-related impulse responses of two ears, interpolated over the sphere with their times of arrival apart.

    Parameters
    ----------
    directions : array_like (n, 3)
        From where the sound comes, in the head's frame (front +x, left +y, up +z), of any length. No cap without one
        may be wider than 60° from its centre.
    responses : array_like (n, 2, samples)
        Responses of the left and the right ear, relative to the pressure at the head's centre without the head.
    sampling_rate : float
        Hz.
    outside : {None, "hold"}
        Rule for frequencies above half the sampling rate: refused (None), or the gain there.
    name : str
        Name in messages.

    Notes
    -----
    A response's time of arrival is where it is most like its minimum-phase version (J. Nam, J. S. Abel and J. O. Smith,
    AES Convention 125, 2008, paper 7612). A sphere is fitted to the times of each ear on its own side; behind the head
    they jump. Responses are advanced by the sphere's times, as for phase-corrected spherical harmonics (Z. Ben-Hur et
    al., IEEE/ACM Trans. Audio Speech Lang. Process. 27 (12), 2019). Fifth powers of distances and quadratic functions
    interpolate them over the sphere, through the values at given directions. Gaps wider than 2.5 times the distance of
    neighbours are filled by harmonics of order 4 first. Over frequency, a response is its Fourier sum.
    """

    directions: Floats
    responses: Floats
    sampling_rate: float
    _: KW_ONLY
    outside: str | None = None
    name: str = ""
    beside: Floats = field(init=False, repr=False)  # (k, 3) directions in gaps, by which these are filled
    parts: tuple[Floats, Floats] = field(init=False, repr=False)  # (n + k, R) weights, (R, 2, N) components
    times: Floats = field(init=False, repr=False)  # (2, 2) of each ear: lateness at the middle, and of a radius, s

    __repr__ = short_repr

    def __post_init__(self) -> None:
        rate = as_number("sampling_rate", self.sampling_rate, at_least=1000.0, at_most=10e6, unit="Hz")
        directions = unit_directions(self.directions)
        responses = as_floats("responses", self.responses, (len(directions), 2, None))
        count = responses.shape[2]
        if count > _LONGEST:
            raise InputError("responses", f"must be at most {_LONGEST} samples long, but are {count}")
        directions, flat = merged(directions, responses.reshape(len(directions), -1))
        responses = flat.reshape(len(directions), 2, count)
        for i in np.flatnonzero(np.any(np.all(responses == 0.0, axis=2), axis=1))[:1]:
            raise InputError(f"responses[{i}]", "must not be silent at an ear")
        hole = largest_hole(directions)
        if hole > _LARGEST_HOLE:
            raise InputError("directions", f"must leave no gap wider than {_LARGEST_HOLE:g}°, but leave {hole:.0f}°")
        if len(directions) > _MOST:
            raise InputError("directions", f"must be at most {_MOST}, but are {len(directions)}")
        times = _fitted_times(directions, arrival_times(responses) / rate)
        aligned = advanced(responses, rate * _late(times, directions)).reshape(len(directions), -1)
        beside = _gaps(directions)
        with with_blas_threads(1):  # as many in each process, for the same bits
            weights, components = _components(np.concatenate([aligned, _coarse(directions, aligned, beside)]))
        kept = {"directions": directions, "responses": responses, "beside": beside, "times": times}
        settle(self, sampling_rate=rate, **{name: read_only(array) for name, array in kept.items()})
        settle(self, parts=(read_only(weights), read_only(components.reshape(len(components), 2, -1))))

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the responses cover."""
        return 0.0, math.inf if self.outside == "hold" else 0.5 * self.sampling_rate

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of each ear; see `Directivity.gain_towards`."""
        f = np.asarray(frequency, dtype=np.float64)
        check_coverage(f, self.band)
        unique, column = np.unique(np.minimum(f, 0.5 * self.sampling_rate), return_inverse=True)
        towards = np.asarray(direction, dtype=np.float64).reshape(-1, 3)
        late = self.lateness(towards, speed_of_sound)
        gain = np.tensordot(_weights(self)(towards), _spectra(self, unique.tobytes()), 1)
        gain *= np.exp(-2j * np.pi * late[:, :, None] * unique)
        row = np.arange(len(gain)).reshape(np.shape(direction)[:-1])
        return np.moveaxis(gain, 1, 2)[row, column.reshape(f.shape)]

    @property
    def reach(self) -> float:
        """Bound of the magnitude of `lateness`, s."""
        return float(np.abs(self.times).sum(axis=1).max() * 0.5 * math.pi)

    def lateness(self, direction: Floats, speed_of_sound: float) -> Floats:
        """Return the times of arrival at each ear; see `ChannelDirectivity.lateness`."""
        return _late(self.times, np.asarray(direction, dtype=np.float64))

    def aligned(self, direction: Floats, frequencies: Floats, speed_of_sound: float, channels: range) -> NDArray[Any]:
        """Return the gains of some ears without the phase of their lateness; see `ChannelDirectivity.aligned`."""
        check_coverage(frequencies, self.band)
        spectra = _spectra(self, np.minimum(frequencies, 0.5 * self.sampling_rate).tobytes())
        weights = _weights(self)(np.asarray(direction, dtype=np.float64).reshape(-1, 3))
        shape = (*np.shape(direction)[:-1], len(frequencies))
        # A product of real matrices: weights have no imaginary part.
        parts = [np.ascontiguousarray(spectra[:, ear]).view(np.float64) for ear in channels]
        return np.stack([(weights @ part).view(np.complex128).reshape(shape) for part in parts])

    @classmethod
    def from_sofa(cls, path: str | PathLike[str], **options: Any) -> HeadRelated:
        """Return the responses of a SOFA file (AES69), through the package ``netCDF4`` (``pip install 'clsim[sofa]'``).

        Parameters
        ----------
        path : path-like
            With the ending ``.sofa``, of the convention SimpleFreeFieldHRIR, FreeFieldHRIR or FreeFieldHRTF.
        **options : Any
            `outside` and `name` of the constructor.
        """
        try:
            return cls(*read_sofa(opened_sofa(Path(path)), HEAD_CONVENTIONS, read_responses), **options)
        except InputError as error:
            raise InputError("path", f"{error.problem} ({error.field}): {path}") from error


@dataclass(frozen=True, slots=True)
class SphericalHead(_Ears):
    """Two ears on a rigid sphere: sources are far away.

    Parameters
    ----------
    radius : float
        m, at most 1.
    ear_azimuth : float
        Angle of the left ear from the front, degrees; the right one is opposite.

    Notes
    -----
    R. O. Duda and W. L. Martens, "Range dependence of the response of a spherical head model", J. Acoust. Soc. Am. 104
    (5), 3048-3058, 1998: 8.75 cm, and ears 100° from the front.

    Examples
    --------
    >>> gain = SphericalHead().gain_towards(np.array([0.0, 1.0, 0.0]), 8e3, 343.0)
    >>> (20 * np.log10(np.abs(gain))).round(1).tolist()
    [5.9, -15.7]
    """

    band: ClassVar[tuple[float, float]] = (0.0, math.inf)
    radius: float = 0.0875
    ear_azimuth: float = 100.0

    def __post_init__(self) -> None:
        settle(self, radius=as_number("radius", self.radius, at_least=1e-4, at_most=1.0, unit="m"))
        settle(self, ear_azimuth=as_number("ear_azimuth", self.ear_azimuth, at_least=0.0, at_most=180.0))

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of each ear; see `Directivity.gain_towards`."""
        f = np.asarray(frequency, dtype=np.float64)
        unique, column = np.unique(f, return_inverse=True)
        row = np.arange(np.asarray(direction)[..., 0].size).reshape(np.shape(direction)[:-1])
        cosine = self._cosines(direction).reshape(-1, 2)
        ka = 2.0 * np.pi * unique * self.radius / speed_of_sound
        gain = np.stack([sphere_surface_field(ka, of_ear) for of_ear in cosine.T], axis=-1)
        return gain[row, column.reshape(f.shape)]

    @property
    def reach(self) -> float:
        """Bound of the magnitude of `lateness`, s: half of the way round, in slow air."""
        return 0.5 * math.pi * self.radius / _SLOWEST

    def lateness(self, direction: Floats, speed_of_sound: float) -> Floats:
        """Return approximate arrival times (..., 2) at both ears, s (Woodworth); see `ChannelDirectivity.lateness`."""
        late = np.polynomial.polynomial.polyval(self._cosines(direction), _WOODWORTH)
        return np.asarray(self.radius / speed_of_sound * late)

    def aligned(self, direction: Floats, frequencies: Floats, speed_of_sound: float, channels: range) -> NDArray[Any]:
        """Return the gains of some ears without the phase of their lateness; see `ChannelDirectivity.aligned`."""
        terms = _aligned_terms(self.radius, np.asarray(frequencies).tobytes(), speed_of_sound)
        cosine = np.moveaxis(self._cosines(direction), -1, 0)[channels.start : channels.stop]
        powers = np.polynomial.chebyshev.chebvander(cosine, len(terms) - 1)
        return np.asarray(powers @ terms.view(np.float64)).view(np.complex128)

    def _cosines(self, direction: Floats) -> Floats:
        """Return the cosines (..., 2) of the angles between directions (..., 3) and both ears."""
        angle = math.radians(self.ear_azimuth)
        ears = np.array([[math.cos(angle), side * math.sin(angle), 0.0] for side in (1.0, -1.0)])
        return np.asarray(np.clip(np.asarray(direction) @ ears.T, -1.0, 1.0))


@lru_cache(maxsize=32)
def _aligned_terms(radius: float, frequencies: bytes, speed_of_sound: float) -> Complexes:
    """Chebyshev coefficients (N, F) over the cosine of incidence of a sphere's gains, their lateness taken out."""
    f = np.frombuffer(frequencies)
    ka = 2.0 * np.pi * f * radius / speed_of_sound
    # The field and the phase of the lateness turn by up to 2.6 ka over the cosine.
    count = 64 + 4 * math.ceil(float(ka.max()))
    cosine = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    late = radius / speed_of_sound * np.polynomial.polynomial.polyval(cosine, _WOODWORTH)
    values = sphere_surface_field(ka, cosine) * np.exp(2j * np.pi * late[:, None] * f)
    terms: Any = scipy.fft.dct(values, type=2, axis=0) / count
    terms[0] *= 0.5
    loud = np.abs(terms).max(axis=1)
    return np.ascontiguousarray(terms[: int(np.flatnonzero(loud > _KEPT * loud.max())[-1]) + 1])


def _components(aligned: Floats) -> tuple[Floats, Floats]:
    """Return weights (n, R) and components (R, m) whose products are rows (n, m), but for what is next to nothing."""
    tall = aligned.shape[0] > aligned.shape[1]
    powers, axes = np.linalg.eigh(aligned.T @ aligned if tall else aligned @ aligned.T)
    axes = axes[:, powers > _KEPT**2 * powers[-1]]
    first, second = (aligned @ axes, axes.T) if tall else (axes, axes.T @ aligned)
    return np.asarray(first), np.asarray(second)


# The polynomial of the cosine that is nearest to Woodworth's lateness, in radii over the speed of sound.
_COSINE = np.cos(np.linspace(0.0, math.pi, 181))
_WOODWORTH = np.asarray(
    np.polynomial.polynomial.polyfit(
        _COSINE, np.where(_COSINE > 0.0, -_COSINE, np.arcsin(-np.minimum(_COSINE, 0.0))), _DEGREE
    ),
    dtype=np.float64,
)


@lru_cache(maxsize=8)
def _weights(head: HeadRelated) -> Any:
    """Return the function of direction (m, 3) whose values are the weights of a head's components (m, R)."""
    with with_blas_threads(1):
        return RadialOnSphere.through(np.concatenate([head.directions, head.beside]), head.parts[0])


def _gaps(directions: Floats) -> Floats:
    """Return directions (k, 3) in gaps among others (n, 3), where these are farther than they are from each other."""
    tree, even = scipy.spatial.KDTree(directions), fibonacci_sphere(_IN_GAPS)
    apart = float(np.median(np.asarray(tree.query(directions, k=2)[0])[:, 1]))
    return even[tree.query(even)[0] > max(_GAP * apart, _LEAST_GAP)]


def _coarse(directions: Floats, values: Floats, at: Floats) -> Floats:
    """Return values (k, m) in gaps by regularised harmonics of a low order through values (n, m) of directions (n, 3).

    R. Duraiswami, D. N. Zotkin and N. A. Gumerov, "Interpolation and range extrapolation of HRTFs", ICASSP 2004:
    least squares with ``1 + l (l + 1)`` times the square of each coefficient of degree l.
    """
    if not len(at):
        return np.zeros((0, values.shape[1]))
    harmonics, degree = real_harmonics(_COARSE, directions), np.floor(np.sqrt(np.arange((_COARSE + 1) ** 2)))
    stiff = np.diag(_STIFF * len(directions) * (1.0 + degree * (degree + 1.0)))
    found = np.linalg.solve(harmonics.T @ harmonics + stiff, harmonics.T @ values)
    return np.asarray(real_harmonics(_COARSE, at) @ found)


def _fitted_times(directions: Floats, late: Floats) -> Floats:
    """Return lateness at the middle and of a radius (2, 2), s, of spheres that fit times (n, 2) at both ears, s."""
    found = np.empty((2, 2))
    for ear, cosine in enumerate((directions[:, 1], -directions[:, 1])):
        near = cosine > _NEAR
        columns = np.column_stack([np.ones(len(cosine)), np.polynomial.polynomial.polyval(cosine, _WOODWORTH)])
        found[ear] = np.linalg.lstsq(columns[near], late[near, ear], rcond=None)[0]
    return found


def _late(times: Floats, directions: Floats) -> Floats:
    """Return the lateness (..., 2), s, at the ears of fitted spheres for directions (..., 3)."""
    side = np.clip(directions[..., 1], -1.0, 1.0)
    both = np.stack([np.polynomial.polynomial.polyval(cosine, _WOODWORTH) for cosine in (side, -side)], axis=-1)
    return np.asarray(times[:, 0] + times[:, 1] * both)


@lru_cache(maxsize=32)
def _spectra(head: HeadRelated, frequencies: bytes) -> Complexes:
    """Return the spectra (R, 2, F) of a head's components at frequencies given as bytes."""
    components, f = head.parts[1], np.frombuffer(frequencies)
    count = components.shape[2]
    times = (np.arange(count) + count // 2) % count - count // 2  # the second half is before time 0
    turn = np.exp(-2j * np.pi / head.sampling_rate * np.outer(times, f))
    # One product of real matrices: of stacks of complex ones each has its own.
    with with_blas_threads(1):
        made = components.reshape(-1, count) @ np.ascontiguousarray(turn).view(np.float64)
    return np.asarray(made.view(np.complex128).reshape(*components.shape[:2], len(f)))
