"""`clsim devices` and `warm-up`: whether a device computes as it should, and kernels built before they are needed."""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from clsim.commands.arguments import add_render_option
from clsim.errors import DeviceError
from clsim.opencl.device import DeviceInfo, find_device, list_devices, no_device
from clsim.paths.find_paths import find_paths
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.opencl.nodes import Nodes
from clsim.render.plan import Plan
from clsim.render.planning import plan_render
from clsim.render.render import render
from clsim.scene.air import Air
from clsim.scene.directivity.patterns import FirstOrder, Piston
from clsim.scene.ends import Receiver, Source
from clsim.scene.material.material import Material
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.protocol import Room
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.version import __version__
from clsim.workflow.console import built_programs, progress

RATE = 192e3
PROMISED_DB = -85.0  # relative to the received signal, at default settings
_DURATION = 0.03  # s, of the scenes that are compared
_ORDER, _LONG = 8, 1.0  # of the one whose rates are measured, and s
_SIZE = np.array([6.0, 5.0, 3.0])


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """Result of a device's test."""

    info: DeviceInfo  # the device
    apart_db: dict[str, float]  # difference from the reference engine by scene, dB relative to the received signal
    render_rate: float  # path-samples a second, of the sum over paths and of the tracks by themselves
    tracks_rate: float  # likewise
    first_seconds: float  # that the first call took, building kernels included

    @property
    def passed(self) -> bool:
        """Test if every scene is within the promised error at default settings."""
        return max(self.apart_db.values()) < PROMISED_DB

    def line(self) -> str:
        """Return the report in one line."""
        info = self.info
        worst = max(self.apart_db, key=self.apart_db.__getitem__)
        parts = [
            f"clsim {__version__}", info.name, f"{info.kind}, {info.platform}", info.version, f"driver {info.driver}",
            f"{info.compute_units} units at {info.clock_hz / 1e6:.0f} MHz", f"{info.memory_bytes / 2**30:.1f} GiB",
            f"groups of {info.largest_group}", "float64" if info.fp64 else "no float64",
            f"{'passed' if self.passed else 'FAILED'}: {self.apart_db[worst]:.0f} dB ({worst})",
            f"render {self.render_rate:.2g}/s, tracks {self.tracks_rate:.2g}/s",
            f"first call {self.first_seconds:.1f} s", f"{platform.system()} {platform.machine()}",
        ]  # fmt: skip
        return " | ".join(parts)


def put_to_test(wanted: str | None = None, notify: Callable[[str], None] = lambda text: None) -> DeviceReport:
    """Test a device."""
    info, _ = find_device(wanted)
    apart, begun, first = {}, time.perf_counter(), 0.0
    for name, plan in _plans(info.id).items():
        engine = OpenclEngine(plan) if plan.baseband is None else BasebandEngine(plan)
        got = engine.render(0, plan.samples)
        first = first or time.perf_counter() - begun
        wanted_sound = ReferenceEngine(plan).render(0, plan.samples)
        apart[name] = float("inf")
        if np.all(np.isfinite(got)) and np.any(wanted_sound):
            error = np.linalg.norm(got - wanted_sound) / np.linalg.norm(wanted_sound)
            apart[name] = float(20.0 * np.log10(error + 1e-15))
        notify(f"{name}: {apart[name]:.0f} dB from the reference engine")
    return DeviceReport(info, apart, *_rates(info.id), first)


class _TimedEngine(OpenclEngine):
    """Engine that measures the time spent on making nodes, s."""

    seconds = 0.0

    def maker(self, pair: int) -> Any:
        """Return the node maker of a pair, timed."""
        found, queue = super().maker(pair), self._queue

        def nodes(*arguments: Any) -> Nodes:
            queue.finish()
            begun = time.perf_counter()
            made: Nodes = found.nodes(*arguments)
            self.seconds += time.perf_counter() - begun
            return made

        return SimpleNamespace(prepare=found.prepare, nodes=nodes)


def _rates(device: str) -> tuple[float, float]:
    """Return path-samples a second of the render stage and of the tracks, kernels being built."""
    walk = Trajectory.circle((3.0, 2.5, 1.5), 1.0, 1.047, _LONG)
    source = Source("s", Signal.tone(40e3, _LONG, RATE, fade=0.01), walk)
    scene = Scene(
        Shoebox(_SIZE, Material.from_reflection(0.9)),
        Air(),
        [source],
        [Receiver("r", Trajectory.fixed((1.0, 1.0, 2.0)))],
    )
    plan = plan_render(find_paths(scene, _ORDER), RATE, device=device, duration=_LONG, responses="centre")
    OpenclEngine(plan).render(0, plan.samples)
    engine = _TimedEngine(plan)
    begun = time.perf_counter()
    engine.render(0, plan.samples)
    spent = time.perf_counter() - begun
    work = plan.path_count * plan.samples
    return work / (spent - engine.seconds), work / engine.seconds


def _plans(device: str) -> dict[str, Plan]:
    """Return the compared plans, by subject."""
    tone = Signal.tone(40e3, _DURATION, RATE, fade=0.005)
    sweep = Signal.chirp(36e3, 44e3, _DURATION, RATE, window="tukey")
    pulses = Signal.pulses(Signal.chirp(38e3, 42e3, 1e-3, RATE, window="hann"), 0.012, 2)
    narrow = Signal.chirp(39.5e3, 40.5e3, _DURATION, RATE, window="tukey")
    curtain = Material.from_absorption([20e3, 40e3, 60e3], [0.1, 0.4, 0.5])
    box = Shoebox(_SIZE, [curtain, *map(Material.from_reflection, (-0.8, 0.7, 0.6, -0.5, 0.8))])
    hard = Shoebox(_SIZE, Material.from_impedance([20e3, 40e3, 60e3], [3.0 - 1.0j, 2.0 - 0.4j, 1.5 + 0.3j]))
    corners = np.array([(2.5, 1.5, 0.0), (2.5, 2.275, 0.0), (2.5, 2.275, 3.0), (2.5, 1.5, 3.0)])
    screen = MeshRoom(corners, np.array([(0, 1, 2), (0, 2, 3)]), Material.from_reflection(0.9))
    beams = (Piston(0.004), FirstOrder(0.4))
    return {
        "functions of frequency": _plan(device, box, sweep, beams),
        "walls by angle": _plan(device, hard, tone, beams),
        "pulses": _plan(device, box, pulses),
        "paths that come and go": _plan(device, screen, tone),
        "envelopes": _plan(device, box, narrow, baseband=(40e3, 4e3)),
    }


def _plan(device: str, room: Shoebox | MeshRoom, signal: Signal, beams: tuple[Any, ...] = (), **options: Any) -> Plan:
    walk = Trajectory.line((2.0, 2.0, 1.0), (2.0, 2.3, 1.1), 0.1)
    ear = Trajectory.line((3.0, 2.5, 1.2), (2.9, 2.6, 1.2), 0.1)
    directed: list[dict[str, Any]] = [
        {"directivity": beam, "aim": aim} for beam, aim in zip(beams, [(1.0, 0.3, 0.0), (-1.0, 0.0, 0.2)], strict=False)
    ]
    source, receiver = directed or ({}, {})
    scene = Scene(room, Air(), [Source("s", signal, walk, **source)], [Receiver("r", ear, **receiver)])
    return plan_render(find_paths(scene, 1), RATE, device=device, duration=_DURATION, **options)


def devices_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--test", nargs="?", const="", metavar="DEVICE",
        help="compare a device, by id or part of its name, with the reference engine, and measure its rates; the "
        "best one when none is named",
    )  # fmt: skip


def devices(options: argparse.Namespace) -> int:
    """List the devices, or test one; return the exit status, 1 if a test fails."""
    if options.test is not None:
        report = put_to_test(options.test or None, lambda text: print(text, flush=True))
        print(report.line())
        if not report.passed:
            print(f"the device is not within {PROMISED_DB:g} dB: please report the line above")
        return 0 if report.passed else 1
    found = list_devices()
    if not found:
        raise DeviceError(no_device())
    for info in found:
        tracks = "float64" if info.fp64 else "no float64: pairs of floats take its place"
        print(
            f"{info.id}  {info.name}  ({info.kind}, {info.platform}, {info.compute_units} units, "
            f"{info.memory_bytes / 2**30:.1f} GiB, {tracks})"
        )
    return 0


_EACH = 0.05  # s of each scene: long enough for all kernels, which do not know how long a run is


def warm_up_arguments(parser: argparse.ArgumentParser) -> None:
    add_render_option(parser, "device", 'an OpenCL device, such as "0:0" or part of its name (default: the best)')


def warm_up(options: argparse.Namespace) -> int:
    """Render small scenes of common kinds and forget them; return the exit status."""
    device, _ = find_device(options.device)
    begun = time.monotonic()
    wall = Material.from_reflection(0.9)
    box = Shoebox(size=np.array([8.0, 9.0, 3.0]), walls=wall)
    corner = MeshRoom.from_plan([(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)], 3.0, wall)
    chirp = Signal.chirp(30e3, 50e3, 0.002, RATE, window="tukey")
    scenes: list[tuple[Room, Signal]] = [
        (box, Signal.tone(40e3, _EACH, RATE, fade=0.01)),  # on and on
        (box, Signal.tone(40e3, 5.0 * _EACH, RATE)),  # abrupt ends: several functions of frequency
        (box, Signal.pulses(chirp, 0.5 * _EACH, 2)),  # with pauses
        (corner, Signal.chirp(30e3, 50e3, _EACH, RATE, window="tukey")),  # paths that begin and end
    ]
    with progress("building kernels (once)", len(scenes)) as advance, built_programs() as built:
        for room, signal in scenes:
            _warm(signal, room, device.id)
            advance(1.0)
    spent = time.monotonic() - begun
    print(f"{built.count} programs are ready on {device.name}, in {spent:.1f} s")
    return 0


def _warm(signal: Signal, room: Room, device: str) -> None:
    """Render a source that passes the corner at 6 m/s, for receivers at rest and in motion."""
    walk = Trajectory.line((3.6, 4.55, 1.5), (3.6, 4.55 - 6.0 * signal.duration, 1.5), signal.duration)
    source = Source("source", signal, walk)
    at_rest = Receiver("at rest", Trajectory.fixed((7.0, 1.0, 2.0)))
    moving = Receiver("moving", Trajectory.line((1.0, 7.0, 1.0), (1.1, 7.1, 1.0), signal.duration))
    for receivers in ([at_rest], [at_rest, moving]):
        scene = Scene(room, Air(), [source], receivers)
        render(find_paths(scene, 1, device=device), RATE, device=device)
