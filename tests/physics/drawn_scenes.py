"""Scenes drawn from a seed: 16 to 192 kHz, all kinds of walls, orders 0 to 4, 0 to 20 m/s, as plain numbers."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import drawn_oracle as oracle
import numpy as np
from default_cases import band_limits, pressures, trajectory
from default_oracle import Curve, Line, Room, Sway, chosen
from drawn_oracle import Absorption, Beam, Echo, End, Factor, Impedance, Sound, Wall

import clsim
from clsim.errors import ClsimWarning
from clsim.render.planning import plan_render

RATES = (16e3, 24e3, 32e3, 44.1e3, 48e3, 96e3, 192e3)
KINDS = ("factors", "absorption", "impedance", "echo", "mixed")
SAMPLES = 120  # compared, of each receiver
OCTAVES = (125.0, 250.0, 500.0, 1e3, 2e3, 4e3)
REMOVED = re.compile(r"(-\d+) dB of its energy lies above")
FIGURE = re.compile(r"(?:approximated to|by up to|are wrong by) (-\d+(?:\.\d+)?) dB")


@dataclass(frozen=True)
class Drawn:
    """A scene in plain numbers."""

    name: str
    room: Room
    walls: tuple[Wall, ...]
    rate: float
    signals: tuple[np.ndarray, ...]
    given: tuple[clsim.Signal, ...]  # the same, as a user gives them
    starts: tuple[float, ...]
    sources: tuple[End, ...]
    receivers: tuple[End, ...]
    duration: float
    margin: float

    def scene(self) -> clsim.Scene:
        names = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
        room = clsim.Shoebox(self.room.size, {n: material(w) for n, w in zip(names, self.walls, strict=True)})
        air = clsim.Air(self.room.temperature, self.room.humidity, self.room.pressure, self.room.speed_of_sound)
        long = max(self.duration, *(s + len(x) / self.rate for s, x in zip(self.starts, self.signals, strict=True)))
        sources = [
            clsim.Source(f"s{i}", signal, trajectory(end.curve, long), beam(end.beam), aim=end.beam.axis, start=start)
            for i, (signal, end, start) in enumerate(zip(self.given, self.sources, self.starts, strict=True))
        ]
        receivers = [
            clsim.Receiver(f"r{i}", trajectory(end.curve, self.duration), beam(end.beam), aim=end.beam.axis)
            for i, end in enumerate(self.receivers)
        ]
        return clsim.Scene(room, air, sources, receivers)


def material(wall: Wall) -> clsim.Material:
    """A wall as clsim knows it."""
    if isinstance(wall, Factor):
        return clsim.Material.from_reflection(wall.value)
    if isinstance(wall, Absorption):
        return clsim.Material.from_absorption(wall.frequencies, wall.coefficients)
    if isinstance(wall, Impedance):
        return clsim.Material.from_impedance(wall.frequencies, wall.impedances, outside="hold")
    return clsim.Material.from_impulse_response(wall.samples, wall.rate, wall.reference)


def beam(given: Beam) -> clsim.Directivity:
    """A beam as clsim knows it."""
    if given.weight is not None:
        return clsim.FirstOrder(given.weight)
    return clsim.Omni() if given.radius is None else clsim.Piston(given.radius)


@dataclass(frozen=True)
class Outcome:
    """Error of a rendering, dB, and what its warnings state."""

    error_db: float
    local_db: float  # in the worst 40 ms
    stated_db: float  # largest error that a warning states, -inf without one
    removed_db: float  # share of the signal's energy above the band
    stated_removed_db: float  # the same as a warning states it, -inf without one
    warnings: tuple[str, ...]

    def allowed_db(self, promised_db: float) -> float:
        """The largest error that is allowed."""
        return max(promised_db, self.stated_db + 3.0)


def outcome(drawn: Drawn) -> Outcome:
    """Render a scene at default settings and compare every receiver; the worst counts."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClsimWarning)
        plan = plan_render(clsim.find_paths(drawn.scene(), max_order=drawn.room.order), drawn.rate)
        made = pressures(plan)
    told = tuple(str(w.message) for w in caught if issubclass(w.category, ClsimWarning))
    at = chosen(made.shape[1], SAMPLES)
    sounds = [
        (Sound(x, drawn.rate, start, drawn.margin, limit), source)
        for x, start, limit, source in zip(drawn.signals, drawn.starts, band_limits(plan), drawn.sources, strict=True)
    ]
    errors = []
    for pressure, receiver in zip(made, drawn.receivers, strict=True):
        exact = oracle.received(sounds, receiver, drawn.room, drawn.walls, at / drawn.rate)
        assert np.count_nonzero(exact.level > 1e-2 * exact.level.max()) > 0.03 * len(at), "hardly anything sounds"
        errors.append(oracle.errors_db(pressure[at], exact, at / drawn.rate))
    stated = max((float(m[1]) for m in map(FIGURE.search, told) if m), default=-np.inf)
    removed = max((float(m[1]) for m in map(REMOVED.search, told) if m), default=-np.inf)
    return Outcome(
        *(float(e) for e in np.max(errors, axis=0)), stated, max(s.removed_db() for s, _ in sounds), removed, told
    )


def drawn(seed: int) -> Drawn:
    """The scene of a seed."""
    rng = np.random.default_rng([32, seed])
    rate, order = float(rng.choice(RATES)), int(rng.choice(5, p=[0.15, 0.3, 0.25, 0.2, 0.1]))
    speed = float(rng.choice([0.0, rng.uniform(0.05, 2.0), rng.uniform(2.0, 20.0)], p=[0.2, 0.4, 0.4]))
    kind = str(rng.choice(KINDS, p=[0.15, 0.3, 0.2, 0.15, 0.2]))
    size = tuple(float(x) for x in rng.uniform([3.0, 3.0, 2.4], [9.0, 7.0, 4.0]))
    room = Room(
        size, 1.0, order, float(rng.uniform(332.0, 350.0)), float(rng.uniform(5, 30)), float(rng.uniform(0.2, 0.8))
    )
    walls = tuple(drawn_wall(rng, kind, rate) for _ in range(6))
    sources, receivers = (2, 2) if order < 3 and rng.random() < 0.2 else (1, 1)
    texts, signals, given = zip(
        *(drawn_signal(rng, rate, speed / room.speed_of_sound) for _ in range(sources)), strict=True
    )
    starts = tuple(float(rng.choice([0.0, rng.uniform(0.0, 0.02)])) for _ in range(sources))
    duration = max(s + len(x) / rate for s, x in zip(starts, signals, strict=True)) + float(rng.uniform(0.015, 0.05))
    while True:
        ends = [
            End(drawn_curve(rng, np.array(size), speed, duration), drawn_beam(rng, rate))
            for _ in range(sources + receivers)
        ]
        t = np.linspace(-0.03, duration, 400)
        apart = [
            np.linalg.norm(a.curve.position(t) - b.curve.position(t), axis=1)
            for a in ends[:sources]
            for b in ends[sources:]
        ]
        if np.min(apart) > 0.3 + 0.01 * speed:
            break
    beams = "+".join("piston" if e.beam.radius else "first" if e.beam.weight is not None else "omni" for e in ends)
    name = f"{seed}: {rate / 1e3:g} kHz, {kind}, order {order}, {speed:.2g} m/s, {beams}, {' and '.join(texts)}"
    return Drawn(
        name, room, walls, rate, signals, given, starts, tuple(ends[:sources]), tuple(ends[sources:]), duration,
        max(silence(walls, x, rate) for x in signals),
    )  # fmt: skip


def drawn_wall(rng: np.random.Generator, kind: str, rate: float) -> Wall:
    if kind == "mixed":
        kind = str(rng.choice(KINDS[:-1]))
    if kind == "factors":
        return Factor(float(rng.uniform(-0.95, 0.98) if rng.random() < 0.3 else rng.uniform(0.3, 0.98)))
    if kind == "echo":
        count = int(rng.integers(1, 9))
        taps = rng.normal(size=count) * np.exp(-np.arange(count) / 2.0)
        return Echo(
            tuple(taps / np.abs(taps).sum() * rng.uniform(0.5, 0.95)),
            rate,
            float(rng.choice([0.0, rng.uniform(0.0, 3.0)])),
        )
    if rate > 60e3 and rng.random() < 0.7:
        f = np.linspace(0.02, 0.5, int(rng.integers(4, 10))) * rate
    else:
        f = np.array(OCTAVES)
    if kind == "absorption":
        start = rng.uniform(0.02, 0.6)
        return Absorption(tuple(f), tuple(np.clip(start + np.cumsum(rng.normal(0.0, 0.12, len(f))), 0.01, 0.97)))
    resistance, mass = rng.uniform(0.5, 20.0), rng.uniform(-2.0, 2.0, len(f))
    return Impedance(
        tuple(f), tuple(complex(z) for z in resistance * (1.0 + 0.3 * rng.uniform(-1, 1, len(f)) + 1j * mass))
    )


def drawn_beam(rng: np.random.Generator, rate: float) -> Beam:
    axis = tuple(float(x) for x in rng.normal(size=3))
    match int(rng.integers(4)):
        case 0:
            return Beam(axis, radius=float(rng.uniform(0.2, 1.0) * 200.0 / rate))  # up to 5 mm at 40 kHz
        case 1:
            return Beam(axis, weight=float(rng.choice([0.25, 0.5, 0.75])))
    return Beam(axis)


def drawn_curve(rng: np.random.Generator, size: np.ndarray, speed: float, duration: float) -> Curve:
    """A line or a sway, seldom a point at rest, at least 0.3 m from walls."""
    t = np.linspace(-0.03, duration, 200)
    still = speed == 0.0 or rng.random() < 0.15
    while True:
        centre, way = rng.uniform(0.3, size - 0.3), rng.normal(size=3)
        way /= np.linalg.norm(way)
        curve: Curve = Line(tuple(centre), (0.0, 0.0, 0.0) if still else tuple(speed * way))
        if not still and speed < 10.0 and rng.random() < 0.5:
            size_of = rng.uniform(0.1, 0.4, 3)
            curve = Sway(tuple(centre), tuple(size_of), tuple(speed * way / size_of), tuple(rng.uniform(0, 6, 3)))
        if np.all((curve.position(t) > 0.3) & (curve.position(t) < size - 0.3)):
            return curve


def silence(walls: tuple[Wall, ...], samples: np.ndarray, rate: float) -> float:
    """Seconds about a signal over which walls ring: long where tables bend, longest where the phase jumps at 0 Hz."""
    if any(isinstance(w, Impedance) for w in walls):  # a reactance that bends where the signal is rings, too
        return 0.75 if sounds_below(50.0, samples, rate) else 0.12
    bends = any(isinstance(w, Absorption | Impedance) and w.frequencies[0] < 1e3 for w in walls)
    return 0.25 if bends and sounds_below(500.0, samples, rate) else 0.03


def sounds_below(frequency: float, samples: np.ndarray, rate: float) -> bool:
    """Whether more than 1e-8 of the energy lies below a frequency, Hz."""
    energy = np.abs(np.fft.rfft(samples, 4 * len(samples))) ** 2
    return bool(energy[: round(frequency / rate * 4 * len(samples))].sum() > 1e-8 * energy.sum())


def faded(t: np.ndarray, duration: float, fade: float) -> np.ndarray:
    if fade == 0.0:
        return np.ones_like(t)
    return np.sin(0.5 * np.pi * np.clip(np.minimum(t, duration - t) / fade, 0.0, 1.0)) ** 2


def drawn_signal(rng: np.random.Generator, rate: float, mach: float) -> tuple[str, np.ndarray, clsim.Signal]:
    """A signal's name, its samples by formula, and what clsim makes of its parameters."""
    highest = 0.42 * rate * (1.0 - mach) / (1.0 + mach)
    lowest = 12.0 if rate < 60e3 else 1e3
    f, g = np.exp(rng.uniform(np.log(lowest), np.log(highest), 2))
    if rng.random() < 0.5:
        f, g = rng.uniform(0.15, 1.0, 2) * highest
    f, g = float(f), float(g)
    duration = float(max(rng.uniform(0.01, 0.06 if rate < 60e3 else 0.025), min(4.0 / f, 0.3)))
    t = np.arange(round(duration * rate)) / rate
    match int(rng.integers(4)):
        case 0:
            fade = float(rng.choice([0.0, 0.1, 0.5], p=[0.3, 0.2, 0.5])) * duration
            x = faded(t, duration, fade) * np.sin(2 * np.pi * f * t + 0.5)
            return f"tone {f:.0f} Hz, fade {fade:.3g} s", x, clsim.Signal.tone(f, duration, rate, phase=0.5, fade=fade)
        case 1:
            window = str(rng.choice(["none", "tukey", "hann"]))
            fade = {"none": 0.0, "tukey": 0.1, "hann": 0.5}[window] * duration
            x = faded(t, duration, fade) * np.sin(2 * np.pi * (f * t + (g - f) / (2 * duration) * t**2))
            return f"chirp {f:.0f} to {g:.0f} Hz, {window}", x, clsim.Signal.chirp(f, g, duration, rate, window=window)
        case 2:
            low, high = sorted((f, g))
            spectrum = np.fft.rfft(rng.normal(size=2 * len(t)))
            hz = np.fft.rfftfreq(2 * len(t), 1 / rate)
            spectrum *= np.exp(-(np.maximum(0.0, np.maximum(low - hz, hz - high) / (0.05 * high)) ** 2))
            fade = float(rng.choice([0.1, 0.3])) * duration
            x = np.fft.irfft(spectrum)[: len(t)] * faded(t, duration, fade)
            return f"noise {low:.0f} to {high:.0f} Hz, fade {fade:.3g} s", x, clsim.Signal.from_array(x, rate)
    chip, code = 0.1 * f, rng.choice([-1.0, 1.0], int(0.1 * f * duration) + 1)
    fade = float(rng.choice([0.0, 0.2])) * duration
    x = code[(chip * t).astype(int)] * np.cos(2 * np.pi * f * t) * faded(t, duration, fade)
    return f"code on {f:.0f} Hz, fade {fade:.3g} s", x, clsim.Signal.from_array(x, rate)
