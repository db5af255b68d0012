"""Scenes at default settings that the oracle knows too: those that once went wrong, and drawn ones."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import default_oracle as oracle
import numpy as np
from default_oracle import Circle, Line, Room, Sway

import clsim
from clsim.render.plan import Plan, plan_render
from clsim.render.render import render_chunks

if TYPE_CHECKING:
    from collections.abc import Callable

C = clsim.Air().sound_speed


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
        return plan_render(scene, paths, self.rate, **self.options)

    def truth(self, receiver: int, at: np.ndarray, limits: list[float | np.ndarray | None]) -> oracle.Truth:
        """Return what a receiver hears at samples of what each source emits below its limit."""
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
    """Return what a plan gives, (receivers, samples)."""
    return np.concatenate([piece for _, piece in render_chunks(plan)], axis=1)


@dataclass(frozen=True)
class Figures:
    """Errors in dB: over all, in the worst 20 ms, and of what lies below the band's end alone."""

    error_db: float
    local_db: float
    below_db: float
    worst_at: float  # s


def measured(case: Case, change: Callable[[np.ndarray], np.ndarray] = lambda pressure: pressure) -> Figures:
    """Render a case and compare it; the worst receiver counts."""
    plan = case.plan()
    made = change(pressures(plan))
    at = oracle.chosen(made.shape[1], case.rate, case.samples)
    below = min(e.band for e in plan.emissions) * (1.0 - plan.max_rate)
    found = []
    for i, pressure in enumerate(made):
        got, exact = pressure[at].astype(float), case.truth(i, at, band_limits(plan))
        middles, local = oracle.local_errors(got, exact, at / case.rate)
        worst = int(np.argmax(local))
        found.append(
            Figures(
                oracle.error_db(got, exact.pressure), float(local[worst]),
                oracle.error_below_db(got, exact.pressure, case.rate, below), float(middles[worst]),
            )
        )  # fmt: skip
    return max(found, key=lambda f: f.error_db)


def band_limits(plan: Plan) -> list[float | np.ndarray | None]:
    """Return the taps that what each source emits passes, None for none."""
    return [getattr(e, "band_limit", None) for e in plan.emissions]


def listed() -> list[Case]:
    """Return the scenes that went wrong."""
    return [*circles(), *abrupt_tones(), *pairs_at_rest(), *wide_bands(), *near_and_far(), *near_and_fast(), *fast_ends()]


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
        replace(c, name=c.name.replace("convolved", "path by path"), options={"convolve_at_rest": False}) for c in cases
    ]
    return [*cases, *apart]


def wide_bands() -> list[Case]:
    room, rate = Room((8.0, 6.0, 3.0), 0.9, 10, C), 192e3
    ends = (Circle((4, 3, 1.5), 1.0, 1.0),), (Line((1.0, 1.0, 2.9)),)
    signals = {
        "sweep 20 to 80 kHz": clsim.Signal.chirp(20e3, 80e3, 0.5, rate, window="tukey"),
        "abrupt sweep 20 to 80 kHz": clsim.Signal.chirp(20e3, 80e3, 0.5, rate),
        "noise 30 to 50 kHz": clsim.Signal.noise(0.5, rate, 1, (30e3, 50e3)),
    }
    return [Case(f"{name}, order 10", room, (s,), *ends, rate, 0.5) for name, s in signals.items()]


def near_and_far() -> list[Case]:
    sweep = clsim.Signal.chirp(21e3, 79e3, 1.0, 192e3, window="tukey")
    away = Line((0.5, 2.0, 2.0), (13.89, 0.0, 0.0))
    noise = clsim.Signal.noise(1.0, 192e3, 2, (21e3, 79e3))
    case = Case("0.11 to 14 m, sweep", Room((16.0, 4.0, 4.0), 0.9, 0, C), (sweep,), (away,), (Line((0.39, 2.0, 2.0)),),
                192e3, 1.0, samples=6000)  # fmt: skip
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
