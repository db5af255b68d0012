"""Binary sequences and their waveforms."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import Floats, as_count, read_only
from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

SEQUENCES = ("mls", "gold")

# Feedback taps of preferred pairs of maximum-length sequences (R. Gold, IEEE Trans. Inf. Theory 13, 1967), as in
# scipy.signal.max_len_seq: the exponents between 0 and the register's length of each polynomial.
_PREFERRED: dict[int, tuple[tuple[int, ...], tuple[int, ...]]] = {
    5: ((2,), (2, 3, 4)),
    6: ((1,), (1, 2, 5)),
    7: ((3,), (1, 2, 3)),
    9: ((4,), (3, 4, 6)),
    10: ((3,), (2, 3, 8)),
    11: ((2,), (2, 5, 8)),
}
_MOST_SAMPLES = 2**26  # of a sequence, which is kept
_BLOCK = 2**16  # samples made at a time
_HALF_CHIPS = 16  # chips on either side over which a chip's pulse is kept


def binary_sequence(kind: str, bits: int, code: int) -> NDArray[np.float64]:
    """Return one period of a sequence as +1 and -1, ``2**bits - 1`` chips.

    code: for "gold" 0 and 1 are the two maximum-length sequences, k + 2 their product with the second one rotated by k.
    For "mls" the number of chips by which it is rotated.
    """
    from scipy.signal import max_len_seq

    bits = as_count("bits", bits, at_least=2, at_most=16)
    length = 2**bits - 1
    if kind == "mls":
        code = as_count("code", code, at_least=0, at_most=length - 1)
        return np.asarray(np.roll(1.0 - 2.0 * max_len_seq(bits)[0], code))
    if bits not in _PREFERRED:
        raise InputError(
            "bits",
            f"must be one of {', '.join(map(str, _PREFERRED))} for Gold sequences, but is {bits}",
        )
    code = as_count("code", code, at_least=0, at_most=length + 1)
    first, second = (1.0 - 2.0 * max_len_seq(bits, taps=np.array(taps))[0] for taps in _PREFERRED[bits])
    if code < 2:
        return np.asarray((first, second)[code])
    return np.asarray(first * np.roll(second, code - 2))


def shaped_count(chips: int, chip_rate: float, sampling_rate: float) -> int:
    """Return the number of samples of a sequence on a carrier."""
    return math.ceil((chips - 1 + 2 * _HALF_CHIPS) * sampling_rate / chip_rate) + 1


def most_repeats(chips: int, chip_rate: float, sampling_rate: float) -> int:
    """Return number of periods of a sequence that can be kept, at least 1."""
    if shaped_count(chips, chip_rate, sampling_rate) > _MOST_SAMPLES:
        raise InputError(
            "chip_rate",
            f"must be high enough for a period of {chips} chips to take at most {_MOST_SAMPLES} samples, "
            f"but is {chip_rate:g} Hz",
        )
    return max(1, int((_MOST_SAMPLES * chip_rate / sampling_rate - 2 * _HALF_CHIPS) / chips))


@lru_cache(maxsize=4)
def shaped_sequence(
    kind: str,
    bits: int,
    code: int,
    repeats: int,
    chip_rate: float,
    carrier: float,
    rolloff: float,
    sampling_rate: float,
) -> Floats:
    """Return a sequence on a carrier, (n,), its chips shaped by a raised cosine.

    The first chip is centred 16 chips after the beginning, so that its pulse, of level 1, begins from nothing.

    References
    ----------
    J. G. Proakis, Digital Communications, 4th ed., eq. 9.2-27.
    """
    chips = np.tile(binary_sequence(kind, bits, code), repeats)
    out = np.empty(shaped_count(len(chips), chip_rate, sampling_rate))
    for first in range(0, len(out), _BLOCK):
        n = np.arange(first, min(first + _BLOCK, len(out)))
        place = n * (chip_rate / sampling_rate) - _HALF_CHIPS  # in chips
        base = np.zeros(len(n))
        nearest = np.floor(place).astype(np.int64)
        for offset in range(-_HALF_CHIPS, _HALF_CHIPS + 1):
            k = nearest + offset
            inside = (k >= 0) & (k < len(chips))
            base[inside] += chips[k[inside]] * _pulse(place[inside] - k[inside], rolloff)
        out[n] = base * np.cos(2.0 * math.pi * np.mod(n * (carrier / sampling_rate), 1.0))
    return read_only(out)


def _pulse(x: Floats, rolloff: float) -> Floats:
    """Return the raised-cosine pulse, tapered to nothing at its ends; `x` in chips."""
    singular = np.abs(np.abs(2.0 * rolloff * x) - 1.0) < 1e-6
    safe = np.where(singular, 0.0, x)
    shape = np.sinc(safe) * np.cos(math.pi * rolloff * safe) / (1.0 - (2.0 * rolloff * safe) ** 2)
    limit = math.pi / 4.0 * math.sin(math.pi / (2.0 * rolloff)) / (math.pi / (2.0 * rolloff))
    taper = np.cos(0.5 * math.pi * np.clip(x / (_HALF_CHIPS + 1), -1.0, 1.0)) ** 2
    return np.asarray(np.where(singular, limit, shape) * taper)
