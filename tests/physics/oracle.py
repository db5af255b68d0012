"""What must be received, in float64 and by means that the engines do not use.

Images by mirroring point after point, emission times by fixed-point iteration, the emitted signal as a formula.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clsim.scene.motion.trajectory import Trajectory


@dataclass(frozen=True)
class Wobble:
    """Sums of sines about a centre: a smooth random motion with a stated peak speed."""

    centre: np.ndarray
    amplitude: np.ndarray  # (3 sines, 3)
    rate: np.ndarray  # (3 sines, 3) rad/s
    phase: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator, centre: object, speed: float) -> "Wobble":
        rate = 2 * np.pi * rng.uniform(1.0, 2.5, (3, 3))
        phase = rng.uniform(0, 2 * np.pi, (3, 3))
        trial = cls(np.array(centre, float), rng.uniform(0.5, 1.0, (3, 3)), rate, phase)
        peak = np.linalg.norm(trial.velocity(np.linspace(0, 10, 2001)), axis=1).max()
        return cls(trial.centre, trial.amplitude * speed / peak, rate, phase)

    def position(self, time: np.ndarray) -> np.ndarray:
        t, sines = np.asarray(time)[..., None], zip(self.amplitude, self.rate, self.phase, strict=True)
        return self.centre + sum(size * np.sin(rate * t + phase) for size, rate, phase in sines)

    def velocity(self, time: np.ndarray) -> np.ndarray:
        t, sines = np.asarray(time)[..., None], zip(self.amplitude, self.rate, self.phase, strict=True)
        return np.asarray(sum(size * rate * np.cos(rate * t + phase) for size, rate, phase in sines))

    def speed_over(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        most = np.linalg.norm(np.sum(self.amplitude * self.rate**2, axis=0))  # of the acceleration
        return np.linalg.norm(self.velocity(begin), axis=-1) + (end - begin) * most

    def trajectory(self, end: float = 2.0) -> Trajectory:
        return Trajectory(self, 0.0, end)


def mirror_sequences(order: int) -> list[tuple[int, ...]]:
    """Return one wall sequence for each image of a shoebox up to an order: those that mirror to new places."""
    found: dict[tuple[float, ...], tuple[int, ...]] = {}
    point, size = np.array([0.123, 0.234, 0.345]), np.array([1.0, 1.1, 1.2])
    front = [((), point)]
    found[tuple(point)] = ()
    for _ in range(order):
        nxt = []
        for walls, at in front:
            for wall in range(6):
                image = mirror(at, wall, size)
                key = tuple(np.round(image, 9))
                if key not in found:
                    found[key] = (*walls, wall)
                    nxt.append(((*walls, wall), image))
        front = nxt
    return list(found.values())


def mirror(point: np.ndarray, wall: int, size: np.ndarray) -> np.ndarray:
    axis, side = divmod(wall, 2)
    out = np.array(point)
    out[..., axis] = 2.0 * (size[axis] if side else 0.0) - out[..., axis]
    return out


def received(
    emitted: Callable[[np.ndarray], np.ndarray],
    source: object,
    receiver: object,
    size: np.ndarray,
    order: int,
    times: np.ndarray,
    *,
    speed_of_sound: float,
    absorption: float,
    reflection: float,
) -> np.ndarray:
    """Return the exact pressure at `times`."""
    c = speed_of_sound
    at = receiver.position(times)
    total = np.zeros(len(times))
    for walls in mirror_sequences(order):

        def image(t: np.ndarray, walls: tuple[int, ...] = walls) -> np.ndarray:
            x = source.position(t)
            for wall in walls:
                x = mirror(x, wall, size)
            return x

        delay = lengths(at - image(times)) / c
        for _ in range(7):  # contracts by the Mach number, at most 0.03: to 1e-13 s
            delay = lengths(at - image(times - delay)) / c
        distance = c * delay
        velocity = source.velocity(times - delay)
        for wall in walls:
            velocity[:, wall // 2] *= -1.0
        mach = np.sum((at - image(times - delay)) * velocity, axis=1) / (distance * c)
        gain = reflection ** len(walls) * 10 ** (-absorption * (distance - 1) / 20) / (distance * (1 - mach))
        total += gain * emitted(times - delay)
    return total


def lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("nk,nk->n", vectors, vectors))


def as_the_paths_say(paths: object, times: np.ndarray, receiver: int = 0) -> np.ndarray:
    """Return the pressure of tones at a receiver at `times`: each path's gain times the tone's formula at its delay."""
    table, total = paths.table(times), np.zeros(len(times))
    for p in np.flatnonzero(table.receiver == receiver):
        source = paths.scene.sources[table.source[p]]
        tone, t = source.signal.waveform, times - table.delay[p] - source.start
        level = tone.amplitude * np.where((t >= 0.0) & (t <= tone.duration), 1.0, 0.0)
        if tone.fade > 0.0:
            level *= rise(t, tone.fade) * rise(tone.duration - t, tone.fade)
        total += table.gain[p] * level * np.sin(2.0 * np.pi * tone.frequency * t + tone.phase)
    return total


def rise(t: np.ndarray, fade: float) -> np.ndarray:
    """Return the raised cosine with which signals begin."""
    return np.sin(0.5 * np.pi * np.clip(t / fade, 0.0, 1.0)) ** 2


def error_db(got: np.ndarray, exact: np.ndarray) -> float:
    """Return the error's RMS over the signal's, dB."""
    return float(20 * np.log10(np.linalg.norm(got - exact) / np.linalg.norm(exact)))
