"""Decays in a box whose walls absorb alike, by images of all orders; shares no code with clsim."""

import numpy as np
from scipy.interpolate import PchipInterpolator

RATE = 8e3  # Hz, of coherent responses
SIZE, C, STEP = np.array((6.2, 4.7, 3.1)), 343.0, 1e-3
OCTAVES = np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3])
SMOOTH, ZIGZAG = (0.4, 0.3, 0.2, 0.12, 0.08, 0.05), (0.06, 0.2, 0.06, 0.2, 0.06, 0.2)


def returned(table: tuple[float, ...], f: np.ndarray) -> np.ndarray:
    """Return the share of energy that comes back, held beyond the ends of the table."""
    curve = PchipInterpolator(np.log(OCTAVES), table)
    return np.asarray(1.0 - curve(np.log(np.clip(f, OCTAVES[0], OCTAVES[-1]))))


def images(source: np.ndarray, ear: np.ndarray, longest: float) -> np.ndarray:
    """Return sums (T, N) of ``1 / d²`` of all images by bin of time and order, up to `longest` s."""
    axes = []
    for size, here, there in zip(SIZE, source, ear, strict=True):
        cell = np.arange(-int(longest * C / size) - 2, int(longest * C / size) + 3)
        axes.append((np.abs(cell), np.where(cell % 2 == 0, cell * size + here, (cell + 1) * size - here) - there))
    (first, far), (second, wide), (third, high) = axes
    across, orders = np.add.outer(wide**2, high**2).ravel(), np.add.outer(second, third).ravel()
    times, count = round(longest / STEP), int(first.max() + orders.max()) + 1
    found = np.zeros(times * count)
    for order, way in zip(first, far, strict=True):
        square = across + way**2
        at = (np.sqrt(square) / (C * STEP)).astype(np.int64)
        kept = at < times
        found += np.bincount(at[kept] * count + order + orders[kept], 1.0 / square[kept], len(found))
    return found.reshape(times, count)


def coherent(
    source: np.ndarray, ear: np.ndarray, longest: float, table: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the spectrum of the sum of images of order 1 on with their phases, its frequencies, and samples of it.

    Arrivals are shared between two samples: -70 dB at 125 Hz, -46 dB at 500 Hz.
    """
    axes = []
    for size, here, there in zip(SIZE, source, ear, strict=True):
        cell = np.arange(-int(longest * C / size) - 2, int(longest * C / size) + 3)
        axes.append((np.abs(cell), np.where(cell % 2 == 0, cell * size + here, (cell + 1) * size - here) - there))
    (first, far), (second, wide), (third, high) = axes
    across, orders = np.add.outer(wide**2, high**2).ravel(), np.add.outer(second, third).ravel()
    times, count = round(longest * RATE), int(first.max() + orders.max()) + 1
    found = np.zeros(times * count)
    for order, way in zip(first, far, strict=True):
        distance = np.sqrt(across + way**2)
        at = (distance / C * RATE).astype(np.int64)
        kept = at < times - 1
        share, place = (distance / C * RATE - at)[kept], at[kept] * count + order + orders[kept]
        found += np.bincount(place, (1.0 - share) / distance[kept], len(found))
        found += np.bincount(place + count, share / distance[kept], len(found))
    f = np.fft.rfftfreq(2 * times, 1.0 / RATE)
    factor = np.sqrt(returned(table, np.maximum(f, 1e-3)))
    spectrum, power = np.zeros(len(f), dtype=complex), np.ones(len(f))
    for arrivals in found.reshape(times, count).T[1:]:
        power = power * factor
        spectrum += np.fft.rfft(arrivals, 2 * times) * power
    return spectrum, f, times


def butterworth(f: np.ndarray, centre: float, parts: int = 1) -> np.ndarray:
    """Return the energy that a filter of order 3 at either edge passes, of an octave or one of its equal parts."""
    half = 2.0 ** (0.5 / parts)
    off = (f / centre - centre / f) / (half - 1.0 / half)
    return np.asarray(1.0 / (1.0 + off**6))


def energy(by_order: np.ndarray, table: tuple[float, ...], f: np.ndarray) -> np.ndarray:
    """Return the energy (T, F) of images of order 1 on, in air without loss."""
    return np.asarray(by_order[:, 1:] @ (returned(table, f) ** np.arange(1.0, by_order.shape[1])[:, None]))


def octave_decay(by_order: np.ndarray, table: tuple[float, ...], centre: float) -> np.ndarray:
    """Return the energy (T,) in an octave of images of order 1 on, of white noise in air without loss."""
    f = np.geomspace(centre / 4.0, centre * 4.0, 61)
    return np.asarray(energy(by_order, table, f) @ (butterworth(f, centre) * f))


def decay_times(energy: np.ndarray, step: float) -> tuple[float, float]:
    """Return T20 and T30 of energies (T,), s, by lines through the backward integral."""
    left = 10.0 * np.log10(np.cumsum(energy[::-1])[::-1] / energy.sum() + 1e-300)
    found = []
    for last in (-25.0, -35.0):
        part = np.flatnonzero((left <= -5.0) & (left >= last))
        found.append(-60.0 / float(np.polyfit(part * step, left[part], 1)[0]))
    return found[0], found[1]
