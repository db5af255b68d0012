"""`clsim warm-up`: kernels built before they are needed."""

from __future__ import annotations

import argparse
import time

import numpy as np

from clsim.commands.arguments import add_render_option
from clsim.opencl.device import find_device
from clsim.paths.find_paths import find_paths
from clsim.render.render import render
from clsim.scene.air import Air
from clsim.scene.ends import Receiver, Source
from clsim.scene.material.material import Material
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.protocol import Room
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.workflow.console import built_programs, progress

_RATE = 192e3
_DURATION = 0.05  # s of each scene: long enough for all kernels, which do not know how long a run is


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_render_option(parser, "device", 'an OpenCL device, such as "0:0" or part of its name (default: the best)')


def execute(options: argparse.Namespace) -> int:
    """Render small scenes of common kinds and forget them; return the exit status."""
    device, _ = find_device(options.device)
    begun = time.monotonic()
    wall = Material.from_reflection(0.9)
    box = Shoebox(size=np.array([8.0, 9.0, 3.0]), walls=wall)
    corner = MeshRoom.from_plan([(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)], 3.0, wall)
    chirp = Signal.chirp(30e3, 50e3, 0.002, _RATE, window="tukey")
    scenes: list[tuple[Room, Signal]] = [
        (box, Signal.tone(40e3, _DURATION, _RATE, fade=0.01)),  # on and on
        (box, Signal.tone(40e3, 5.0 * _DURATION, _RATE)),  # abrupt ends: several functions of frequency
        (box, Signal.pulses(chirp, 0.5 * _DURATION, 2)),  # with pauses
        (corner, Signal.chirp(30e3, 50e3, _DURATION, _RATE, window="tukey")),  # paths that begin and end
    ]
    with progress("building kernels (once)", len(scenes)) as advance, built_programs() as built:
        for room, signal in scenes:
            _render(signal, room, device.id)
            advance(1.0)
    spent = time.monotonic() - begun
    print(f"{built.count} programs are ready on {device.name}, in {spent:.1f} s")
    return 0


def _render(signal: Signal, room: Room, device: str) -> None:
    """Render a source that passes the corner at 6 m/s, for receivers at rest and in motion."""
    walk = Trajectory.line((3.6, 4.55, 1.5), (3.6, 4.55 - 6.0 * signal.duration, 1.5), signal.duration)
    source = Source("source", signal, walk)
    at_rest = Receiver("at rest", Trajectory.fixed((7.0, 1.0, 2.0)))
    moving = Receiver("moving", Trajectory.line((1.0, 7.0, 1.0), (1.1, 7.1, 1.0), signal.duration))
    for receivers in ([at_rest], [at_rest, moving]):
        scene = Scene(room, Air(), [source], receivers)
        render(find_paths(scene, 1, device=device), _RATE, device=device)
