"""Scenes at default settings that the oracle knows too: those that once went wrong, and drawn ones."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import default_oracle as oracle
import numpy as np
from default_oracle import Circle, Line, Room, Sway

import clsim
from clsim.render.planning import plan_render
from clsim.render.render import render_chunks

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.render.plan import Plan

C = clsim.Air().speed_of_sound


@dataclass(frozen=True)
class Case:
    """A scene in the oracle's words."""

    name: str
    room: Room
    signals: tuple[clsim.Signal, ...]
    sources: tuple[oracle.Curve, ...]
    receivers: tuple[oracle.Curve, ...]
    rate: float
    duration: float  # of trajectories, s
    starts: tuple[float, ...] = ()
    samples: int = 3000  # looked at, of each receiver
    options: dict[str, object] = field(default_factory=dict)  # of the call

    def scene(self) -> clsim.Scene:
        room = clsim.Shoebox(self.room.size, clsim.Material.from_reflection(self.room.reflection))
        air = clsim.Air(self.room.temperature, self.room.humidity, self.room.pressure, self.room.speed_of_sound)
        starts = self.starts or (0.0,) * len(self.signals)
        long = max(self.duration, *(a + s.duration for a, s in zip(starts, self.signals, strict=True)))
        sources = [
            clsim.Source(f"s{i}", signal, trajectory(curve, long), start=start)
            for i, (signal, curve, start) in enumerate(zip(self.signals, self.sources, starts, strict=True))
        ]
        ears = [clsim.Receiver(f"r{i}", trajectory(curve, self.duration)) for i, curve in enumerate(self.receivers)]
        return clsim.Scene(room, air, sources, ears)

    def plan(self) -> Plan:
        scene = self.scene()
        paths = clsim.find_paths(scene, max_order=self.room.order)
        return plan_render(paths, self.rate, **self.options)

    def truth(self, receiver: int, at: np.ndarray, limits: list[np.ndarray]) -> oracle.Truth:
        """Return the pressure at samples of a receiver, from the part of each source's signal below its limit."""
        starts = self.starts or (0.0,) * len(self.signals)
        emitted = []
        for signal, start, limit in zip(self.signals, starts, limits, strict=True):
            signal = signal.at_rate(self.rate)
            samples = signal.read(0, signal.count)
            emitted.append(oracle.Emitted(samples, self.rate, start, self.room, limit))
        ends = list(zip(emitted, self.sources, strict=True))
        return oracle.truth(ends, self.receivers[receiver], self.room, at / self.rate)


def trajectory(curve: oracle.Curve, end: float) -> clsim.Trajectory:
    """Return a curve as clsim knows it."""
    if isinstance(curve, Line) and not any(curve.speed):
        return clsim.Trajectory.fixed(curve.origin)
    if isinstance(curve, Line):
        return clsim.Trajectory.line(curve.origin, curve.position(np.array(end)), end)
    if isinstance(curve, Circle):
        return clsim.Trajectory.circle(curve.centre, curve.radius, curve.period, end)
    return clsim.Trajectory(curve, 0.0, end)


def pressures(plan: Plan) -> np.ndarray:
    """Return the samples of a plan (receivers, samples)."""
    return np.concatenate([piece for _, piece in render_chunks(plan)], axis=1)


@dataclass(frozen=True)
class Figures:
    """Errors in dB: over all, and in the worst 20 ms, whose middle is `worst_at`, s."""

    error_db: float
    local_db: float
    worst_at: float


def measured(case: Case, change: Callable[[np.ndarray], np.ndarray] = lambda pressure: pressure) -> Figures:
    """Render a case and compare it; the worst receiver counts."""
    plan = case.plan()
    made = change(pressures(plan))
    at = oracle.chosen(made.shape[1], case.samples)
    found = []
    for i, pressure in enumerate(made):
        exact = case.truth(i, at, band_limits(plan))
        assert np.count_nonzero(exact.level > 1e-2 * exact.level.max()) > 0.03 * len(at)  # something sounds
        middles, local = oracle.local_errors(pressure[at], exact, at / case.rate)
        worst = int(np.argmax(local))
        found.append(Figures(oracle.error_db(pressure[at], exact.pressure), float(local[worst]), float(middles[worst])))
    return max(found, key=lambda f: f.error_db)


def band_limits(plan: Plan) -> list[np.ndarray]:
    """Return the taps of the filters that what each source emits passes."""
    return [e.band_limit for e in plan.source_filters]


def listed() -> list[Case]:
    """Return the scenes that went wrong."""
    return [
        *circles(), *abrupt_tones(), *pairs_at_rest(), *phones(), *wide_bands(), *near_and_far(), *near_and_fast(),
        *fast_ends(),
    ]  # fmt: skip


def circles() -> list[Case]:
    room = Room((8.0, 6.0, 3.0), 0.9, 10, C)
    tone = clsim.Signal.tone(40e3, duration=0.3, sampling_rate=192e3)
    ends = (Circle((4, 3, 1.5), 1.0, 1.0),), (Line((1.0, 1.0, 2.9)),)
    case = Case("circle, order 10", room, (tone,), *ends, 192e3, 0.3)
    return [replace(case, name="circle, order 3", room=replace(room, order=3)), case]


def abrupt_tones() -> list[Case]:
    made = []
    for f, rate, speed in [(76e3, 192e3, 6), (76e3, 192e3, 10), (40e3, 192e3, 8), (25e3, 192e3, 10), (19e3, 48e3, 7),
                           (8e3, 48e3, 10), (190e3, 500e3, 10)]:  # fmt: skip
        room, length = Room((6.0, 5.0, 4.0), 0.9, 3, C), 0.08
        source = Sway((2.0, 2.5, 2.0), (0.4, 0.3, 0.2), tuple(speed / np.array([0.6, 0.5, 0.4])), (0.1, 1.0, 2.0))
        receiver = Sway((4.2, 2.4, 2.1), (0.3, 0.4, 0.2), tuple(speed / np.array([0.5, 0.7, 0.4])), (1.1, 0.0, 3.0))
        tone = clsim.Signal.tone(f, length, rate)
        made.append(Case(f"abrupt {f / 1e3:g} kHz at {rate / 1e3:g} kHz, {speed} m/s", room, (tone,), (source,),
                         (receiver,), rate, length + 0.0113))  # fmt: skip
    return made


def pairs_at_rest() -> list[Case]:
    tone = clsim.Signal.tone(40e3, 0.05, 192e3)
    case = Case("at rest, abrupt, convolved", Room((6.0, 5.0, 4.0), 0.9, 3, C), (tone,), (Line((2.0, 2.5, 2.0)),),
                (Line((4.2, 2.4, 2.1)),), 192e3, 0.08)  # fmt: skip
    sweep = clsim.Signal.chirp(20e3, 76e3, 0.05, 192e3, window="tukey")
    cases = [case, replace(case, name="at rest, sweep, convolved", signals=(sweep,))]
    apart = [
        replace(c, name=c.name.replace("convolved", "path by path"), options={"convolve_static": False}) for c in cases
    ]
    return [*cases, *apart]


def wide_bands(duration: float = 0.5) -> list[Case]:
    room, rate = Room((8.0, 6.0, 3.0), 0.9, 10, C), 192e3
    ends = (Circle((4, 3, 1.5), 1.0, 1.0),), (Line((1.0, 1.0, 2.9)),)
    signals = {
        "sweep 20 to 80 kHz": clsim.Signal.chirp(20e3, 80e3, duration, rate, window="tukey"),
        "abrupt sweep 20 to 80 kHz": clsim.Signal.chirp(20e3, 80e3, duration, rate),
        "noise 30 to 50 kHz": clsim.Signal.noise(duration, rate, 1, (30e3, 50e3)),
    }
    length = {"duration": duration}
    return [
        Case(f"{name}, order 10", room, (s,), *ends, rate, duration, samples=min(3000, round(duration * 1e4)),
             options=length) for name, s in signals.items()
    ]  # fmt: skip


def phones() -> list[Case]:
    """Return a signal of phones, up to 0.958 of half the sampling rate."""
    case = abrupt_tones()[4]
    sweep = clsim.Signal.chirp(17e3, 23e3, 0.08, case.rate, window="tukey")
    slow = Line((2.0, 2.5, 2.0), (1.0, 0.5, 0.0))
    return [replace(case, name="17 to 23 kHz at 48 kHz", signals=(sweep,), sources=(slow,))]


def near_and_far(duration: float = 1.0) -> list[Case]:
    """Return cases of a source that leaves a receiver, from 0.11 to 14 m."""
    sweep = clsim.Signal.chirp(21e3, 79e3, duration, 192e3, window="tukey")
    away = Line((0.5, 2.0, 2.0), (13.89 / duration, 0.0, 0.0))
    noise = clsim.Signal.noise(duration, 192e3, 2, (21e3, 79e3))
    case = Case("0.11 to 14 m, sweep", Room((16.0, 4.0, 4.0), 0.9, 0, C), (sweep,), (away,), (Line((0.39, 2.0, 2.0)),),
                192e3, duration, samples=round(6000 * duration))  # fmt: skip
    return [case, replace(case, name="0.11 to 14 m, noise", signals=(noise,))]


def near_and_fast() -> list[Case]:
    made = []
    for gap, speed in [(0.011, 10.0), (0.011, 20.0), (0.05, 20.0)]:
        tone = clsim.Signal.tone(40e3, 0.05, 192e3, fade=0.005)
        past = Line((3.0 - 0.025 * speed, 2.5, 2.0), (speed, 0.0, 0.0))
        made.append(Case(f"passing at {100 * gap:g} cm, {speed:g} m/s", Room((6.0, 5.0, 4.0), 0.9, 1, C), (tone,),
                         (past,), (Line((3.0, 2.5 + gap, 2.0)),), 192e3, 0.055))  # fmt: skip
    return made


def fast_ends() -> list[Case]:
    made = []
    for rate in (48e3, 192e3, 500e3):
        for speed, share in ((30.0, 0.2), (50.0, 0.2), (100.0, 0.2), (0.3 * C, 0.15), (0.5 * C, 0.1)):
            tone = clsim.Signal.tone(share * rate, 0.01, rate, fade=0.004)
            receiver = Line((11.0, 2.0, 1.2), (-speed, 0.0, 0.0))
            still = Line((3.0, 3.0, 1.5))
            source = still if speed == 30.0 else Line((2.0, 3.0, 1.5), (0.8 * speed, 0.1 * speed, 0.0))
            made.append(Case(f"fast: {speed:.4g} m/s at {rate / 1e3:g} kHz", Room((13.0, 6.0, 3.0), 0.9, 0, C), (tone,),
                             (source,), (receiver,), rate, 0.04))  # fmt: skip
    return made


ORDERS = [0] * 38 + [1] * 26 + [2] * 16 + [3] * 8 + [4] * 5 + [5, 6, 7, 8, 9, 10, 10]
RATES = (48e3, 64e3, 96e3, 192e3, 250e3, 384e3, 500e3)
SPEEDS = [0.0] * 8 + [1.0] * 17 + [10.0] * 30 + [30.0] * 20 + [60.0] * 10 + [100.0] * 15  # m/s at most
HIGHEST = 0.8  # of Nyquist, of what is heard


def drawn() -> list[Case]:
    """Return 100 scenes: speeds to 100 m/s, orders to 10, 48 to 500 kHz, tones and chirps, abrupt or faded."""
    rng = np.random.default_rng(10)
    orders, speeds = rng.permutation(ORDERS), rng.permutation(SPEEDS)
    return [drawn_case(i, int(o), float(v)) for i, (o, v) in enumerate(zip(orders, speeds, strict=True))]


def drawn_case(seed: int, order: int, fastest: float) -> Case:
    rng = np.random.default_rng(seed)
    rate, speed = float(rng.choice(RATES)), fastest * float(rng.uniform(0.4, 1.0))
    length = float(rng.uniform(0.006, 0.025))  # s of sound
    duration = length + float(rng.uniform(0.01, 0.025))
    sources, ears = (1, 1) if rng.random() < 0.9 else (int(rng.integers(1, 3)), int(rng.integers(1, 3)))
    size = tuple(float(x) for x in rng.uniform([8.0, 5.0, 3.0], [14.0, 8.0, 4.0]))
    starts = tuple(float(rng.choice([0.0, rng.uniform(0.0, 0.002)])) for _ in range(sources))
    while True:
        ends = [drawn_curve(rng, np.array(size), speed, duration) for _ in range(sources + ears)]
        apart = distances(ends[:sources], ends[sources:], duration)
        if apart.min() > 0.3 + 0.005 * speed and apart.max() < 0.5 * C * duration:  # is heard for long enough
            break
    highest = HIGHEST * 0.5 * rate * (1.0 - speed / C) / (1.0 + speed / C)
    signals = tuple(drawn_signal(rng, highest, length, rate) for _ in range(sources))
    name = f"drawn {seed}: order {order}, {rate / 1e3:g} kHz, {speed:.3g} m/s, {sources} x {ears}"
    room = Room(size, float(rng.uniform(0.6, 0.97)), order, C, humidity=float(rng.uniform(0.3, 0.7)))
    return Case(name, room, signals, tuple(ends[:sources]), tuple(ends[sources:]), rate, duration, starts, samples=640)


def drawn_curve(rng: np.random.Generator, size: np.ndarray, speed: float, duration: float) -> oracle.Curve:
    """Return a line or a sway, seldom a point at rest, that stays 0.3 m away from walls."""
    times = np.linspace(0.0, duration, 100)
    still = speed == 0.0 or rng.random() < 0.15
    while True:
        centre, way = rng.uniform(0.3, size - 0.3), rng.normal(size=3)
        way /= np.linalg.norm(way)
        curve: oracle.Curve = Line(tuple(centre), (0.0, 0.0, 0.0) if still else tuple(speed * way))
        if not still and speed < 15.0 and rng.random() < 0.5:
            amplitude = rng.uniform(0.1, 0.4, 3)
            curve = Sway(tuple(centre), tuple(amplitude), tuple(speed * way / amplitude), tuple(rng.uniform(0, 6, 3)))
        places = curve.position(times)
        if np.all(places > 0.3) and np.all(places < size - 0.3):
            return curve


def distances(sources: list[oracle.Curve], ears: list[oracle.Curve], duration: float) -> np.ndarray:
    """Return distances of sources, now and a little earlier, from receivers, m."""
    times = np.linspace(0.0, duration, 200)
    apart = [s.position(times - 0.005 * k) - e.position(times) for s in sources for e in ears for k in range(4)]
    return np.asarray(np.linalg.norm(apart, axis=-1))


def drawn_signal(rng: np.random.Generator, highest: float, length: float, rate: float) -> clsim.Signal:
    f, g = rng.uniform(0.15, 1.0, 2) * highest
    match int(rng.integers(4)):
        case 0:
            return clsim.Signal.tone(float(f), length, rate, phase=float(rng.uniform(0, 6)))
        case 1:
            return clsim.Signal.tone(float(f), length, rate, fade=0.3 * length)
        case 2:
            return clsim.Signal.chirp(float(f), float(g), length, rate)
        case _:
            return clsim.Signal.chirp(float(f), float(g), length, rate, window="tukey")
