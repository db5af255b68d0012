"""Chance in a study: random values of fields, places inside each member's own room, and diffuse noise."""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from clsim.arrays import Floats, as_number
from clsim.errors import InputError, inside
from clsim.scene_file.model import Model, Vector
from clsim.scene_file.rooms import RoomModel

_MOST_DRAWN = 10**7  # numbers
_LARGEST = 1e300  # of them: sums and products stay finite
_BATCH, _TRIES = 256, 200  # places drawn at a time, and how often: 51 200 in all


class _Inside(Model):
    margin: float = 0.0
    offsets: Annotated[list[Vector], Field(min_length=1)] = Field(default=[[0.0, 0.0, 0.0]])


class RandomModel(Model):
    """A distribution: one key."""

    uniform: list[Any] | None = None
    log_uniform: list[Any] | None = None
    normal: list[Any] | None = None
    choice: list[Any] | None = None
    file: str | None = None
    inside: float | _Inside | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """A place inside a room, which is known once the member's room is."""

    seed: tuple[int, ...]  # of its own: any number of tries leaves the others as they are
    margin: float  # from walls, m
    offsets: tuple[tuple[float, ...], ...]  # of all places that are drawn as one, m
    which: int = 0  # row of `offsets`

    def within(self, room: dict[str, Any], base: Path) -> list[float]:
        """Return the position (3,), m, in the room that a table of a scene file describes."""
        return _placed(json.dumps(room, sort_keys=True), str(base), replace(self, which=0))[self.which]


def draws(random: RandomModel, fields: list[str], seed: int, count: int, folder: Path, base: Path) -> list[list[Any]]:
    """Return the draws of fields, each as one value per field.

    They depend on seed and field only, so another field changes none of them, and more draws begin with the same.

    folder, base: those of the study file and of the scene file.
    """
    given = {name: value for name, value in random.arguments().items() if value is not None}
    if len(given) != 1:
        raise InputError("random", f"must have one distribution, but has {' and '.join(given) or 'none'}")
    (name, value), field = next(iter(given.items())), f"random.{next(iter(given))}"
    if len(fields) > 1 and name != "inside":
        raise InputError("field", f"must be a single one for random, but are {len(fields)}")
    seeds = seed, zlib.crc32(fields[0].encode())
    generator = np.random.default_rng(seeds)
    if name == "inside":
        with inside(field):
            return _places(value, len(fields), seeds, count)
    if name == "file":
        value = _files(value, field, folder, base)
    if name in ("choice", "file"):
        if not value:
            raise InputError(field, "must hold at least one, but is empty")
        return [[value[i]] for i in generator.integers(len(value), size=count)]
    return [[drawn] for drawn in _numbers(name, value, field, generator, count)]


def _places(value: float | _Inside, fields: int, seeds: tuple[int, int], count: int) -> list[list[Any]]:
    table = value if isinstance(value, _Inside) else _Inside(margin=value)
    margin = as_number("margin", table.margin, at_least=0.0, unit="m")
    if len(table.offsets) != fields:
        problem = f"must be one per field, {fields}, but are {len(table.offsets)}"
        raise InputError("offsets" if isinstance(value, _Inside) else "", problem)
    offsets = tuple(map(tuple, table.offsets))
    return [[Place((*seeds, k), margin, offsets, row) for row in range(fields)] for k in range(count)]


@lru_cache(maxsize=64)
def _placed(room: str, base: str, place: Place) -> list[list[float]]:
    """Draw a place and all that stand about it, uniformly over the places at which all of them fit."""
    there, offsets = _room(room, base), np.array(place.offsets)
    low, high = there.extent
    lowest, highest = low + place.margin - offsets.min(axis=0), high - place.margin - offsets.max(axis=0)
    if (lowest > highest).any():
        raise InputError("inside", f"must leave a place in each room, but {place.margin:g} m off the walls is none")
    generator = np.random.default_rng(place.seed)
    for _ in range(_TRIES):
        found = generator.uniform(lowest, highest, (_BATCH, 3))[:, None] + offsets
        flat = found.reshape(-1, 3)
        good = there.contains(flat) & (there.clearance(flat) >= place.margin * (1.0 - 1e-9))
        rows = np.flatnonzero(good.reshape(_BATCH, -1).all(axis=1))
        if len(rows):
            positions: list[list[float]] = found[rows[0]].tolist()
            return positions
    tried = f"{_TRIES * _BATCH} of them are nearer than {place.margin:g} m to a wall, or outside"
    raise InputError("inside", f"must leave a place in each room, but {tried}")


@lru_cache(maxsize=4)
def _room(text: str, base: str) -> Any:
    model: TypeAdapter[Any] = TypeAdapter(RoomModel)
    try:
        return model.validate_python(json.loads(text)).build(Path(base))
    except (ValidationError, InputError) as error:  # the member's check says the same in full
        raise InputError("inside", "must be drawn in a room, but the member's is none") from error


def _files(pattern: str, field: str, folder: Path, base: Path) -> list[str]:
    """Return the files of a pattern, relative to the scene file's folder."""
    whole = folder / pattern
    try:
        found = sorted(path for path in Path(whole.anchor).glob(str(whole.relative_to(whole.anchor))) if path.is_file())
    except ValueError as error:
        raise InputError(field, f"must be a pattern such as speech/*.wav, but is {pattern!r:.80}") from error
    if not found:
        raise InputError(field, f"must match files beside the study file, but {pattern!r:.80} matches none")
    return [Path(os.path.relpath(path, base)).as_posix() for path in found]


def _numbers(name: str, value: list[Any], field: str, generator: np.random.Generator, count: int) -> list[Any]:
    """Return draws of a number, or of a list of them."""
    low, high = _bounds(value, field)
    if count * low.size > _MOST_DRAWN:
        raise InputError(field, f"must draw at most {_MOST_DRAWN} numbers, but draws {count * low.size}")
    shape = (count, *low.shape)
    if name == "normal":
        if (high < 0.0).any():
            raise InputError(field, f"must be mean and standard deviation, but the latter is {value[1]!r:.60}")
        drawn = generator.normal(low, high + 0.0, shape)  # NumPy refuses -0
    else:
        if (low > high).any():
            raise InputError(field, f"must be low and high, but is {value!r:.80}")
        if name == "log_uniform" and (low <= 0.0).any():
            raise InputError(field, f"must be above 0, but is {value!r:.80}")
        log = name == "log_uniform"
        drawn = generator.uniform(np.log(low) if log else low, np.log(high) if log else high, shape)
        drawn = np.clip(np.exp(drawn), low, high) if log else drawn
    result: list[Any] = drawn.tolist()
    return result


def _bounds(value: list[Any], field: str) -> Any:
    """Return both parameters of a distribution as arrays of one shape."""
    if len(value) != 2:
        raise InputError(field, f"must be two numbers, or two lists of them, but are {len(value)}")
    try:
        low, high = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in value))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(field, f"must be two numbers, or two lists of them, but is {value!r:.80}") from error
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise InputError(field, f"must be finite, but is {value!r:.80}")
    if max(np.abs(low).max(initial=0.0), np.abs(high).max(initial=0.0)) > _LARGEST:
        raise InputError(field, f"must be within {_LARGEST:g}, but is {value!r:.80}")
    return low, high


_BAND = 2048  # frequencies mixed at a time
_LOADING = 1e-6  # of the coherence matrix, which is singular at 0 Hz
_LEAST_HZ = 20.0  # below which a sloped spectrum is flat


class NoiseModel(Model):
    """The table ``[noise]`` of a study."""

    snr_db: float
    slope_db: float = 0.0  # of the power spectral density, per octave: 0 white, -3 pink
    field: Literal["spherical", "cylindrical"] = "spherical"

    def checked(self) -> NoiseModel:
        """Return the table, if its numbers are within bounds."""
        as_number("snr_db", self.snr_db, at_least=-200.0, at_most=200.0, unit="dB")
        as_number("slope_db", self.slope_db, at_least=-24.0, at_most=24.0, unit="dB")
        return self

    def samples(
        self, clean: NDArray[np.floating], rate: float, positions: Floats, speed_of_sound: float, seed: Sequence[int]
    ) -> NDArray[np.float32]:
        """Return noise (rows, n) whose energy is that of `clean` (rows, n), less the ratio.

        positions: (rows, 3) of the receivers, m.
        """
        power = float(np.square(clean, dtype=np.float64).sum())
        if power == 0.0:
            raise InputError("snr_db", "must come with sound, but the recording is silent")
        made = self._mixed(clean.shape, rate, positions, speed_of_sound, np.random.default_rng(seed))
        made *= math.sqrt(power / float(np.square(made).sum())) * 10.0 ** (-self.snr_db / 20.0)
        return made.astype(np.float32)

    def _mixed(
        self, shape: tuple[int, ...], rate: float, positions: Floats, c: float, chance: np.random.Generator
    ) -> Floats:
        """Mix independent noises by a square root of the coherence matrix at each frequency (Habets et al. 2008)."""
        from scipy.fft import irfft, next_fast_len

        rows, count = shape
        size = next_fast_len(count, real=True)
        frequencies = np.arange(size // 2 + 1) * (rate / size)
        spectrum = chance.standard_normal((len(frequencies), rows)) + 1j * chance.standard_normal(
            (len(frequencies), rows)
        )
        apart = np.linalg.norm(positions[:, None] - positions, axis=2)
        for first in range(0, len(frequencies), _BAND):
            some = slice(first, first + _BAND)
            alike: Floats = self.coherence(frequencies[some, None, None], apart, c) + _LOADING * np.eye(rows)
            root = np.asarray(np.linalg.cholesky(alike / (1.0 + _LOADING)), dtype=np.float64)
            spectrum[some] = (root @ spectrum[some, :, None])[..., 0]
        level = np.maximum(frequencies, _LEAST_HZ) ** (self.slope_db / (20.0 * math.log10(2.0)))
        level[0] = 0.0
        return np.asarray(irfft(spectrum.T * level, size, axis=1)[:, :count])

    def coherence(
        self, frequency: NDArray[np.floating], distance: NDArray[np.floating], speed_of_sound: float
    ) -> Floats:
        """Return the coherence of pressure at two places of a diffuse field."""
        # ``sin(kd) / (kd)`` where sound comes from all directions, ``J0(kd)`` from all horizontal ones (R. K. Cook et
        # al., "Measurement of correlation coefficients in reverberant sound fields", JASA 27, 1955).
        from scipy.special import j0

        phase = 2.0 * math.pi * frequency * distance / speed_of_sound
        return np.asarray(np.sinc(phase / math.pi) if self.field == "spherical" else j0(phase))
