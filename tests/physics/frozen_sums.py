"""What is heard in a shoebox where nothing moves, as a sum over its spectrum; shares no code with clsim's paths."""

from collections.abc import Callable, Sequence

import numpy as np

Factor = Callable[[np.ndarray], np.ndarray]


def images(size: Sequence[float], source: Sequence[float], order: int) -> list[tuple[np.ndarray, tuple[int, ...]]]:
    """Return places of all images up to an order, and how often each of the walls x_min, x_max, ... z_max is met."""
    found = []
    for n in np.ndindex(*[2 * order + 1] * 3):
        times = np.array(n) - order
        if np.abs(times).sum() > order:
            continue
        place = [
            k * length + x if k % 2 == 0 else (k + 1) * length - x
            for k, length, x in zip(times, size, source, strict=True)
        ]
        met: list[int] = []
        for k in times:
            more, less = (abs(k) + 1) // 2, abs(k) // 2
            met += [less, more] if k > 0 else [more, less]
        found.append((np.array(place), tuple(met)))
    return found


def response(
    f: np.ndarray, size: Sequence[float], ends: Sequence[Sequence[float]], order: int, walls: Sequence[Factor], air
) -> np.ndarray:
    """Return the spectrum of the impulse response at frequencies f (F,) in Hz."""
    total = np.zeros(len(f), dtype=complex)
    factors = [wall(f) for wall in walls]
    for place, met in images(size, ends[0], order):
        distance = np.linalg.norm(place - np.asarray(ends[1]))
        gain = 10 ** (-air.absorption_at(f) * (distance - 1.0) / 20) / distance
        for factor, times in zip(factors, met, strict=True):
            gain = gain * factor**times
        total += gain * np.exp(-2j * np.pi * f * distance / air.speed_of_sound)
    return total


def heard(signal: np.ndarray, rate: float, start: float, count: int, spectrum: Callable[[np.ndarray], np.ndarray]):
    """Return samples (count,) of a signal that begins at a time, after a response; what comes later wraps round."""
    size = 2 ** int(np.ceil(np.log2(len(signal) + count)))
    f = np.fft.rfftfreq(size, 1.0 / rate)
    late = np.exp(-2j * np.pi * f * start)
    answer = spectrum(np.maximum(f, 1e-3))  # formulae of the air divide by the frequency
    return np.fft.irfft(np.fft.rfft(signal, size) * late * answer, size)[:count]


def error_db(got: np.ndarray, wanted: np.ndarray) -> float:
    """Return the root mean square error relative to what is wanted, dB."""
    return 20.0 * float(np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted)))
