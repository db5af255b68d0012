"""Rays of the diffuse tail: segments a second and core, and whole responses of the two measured rooms.

    python benchmarks/rays.py FOLDER        # which holds bras_cr2/ and ptb_studio/

Processor times, of a process with a warm kernel cache; the number of segments is that of the mean free path.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import measured_rooms
import numpy as np

import clsim
from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.design import TailOptions, find_tail
from clsim.tail.device_rays import ray_engine
from clsim.tail.ray_room import WallEnergies, ray_room
from clsim.tail.rays import Spheres, Tracer
from clsim.tail.zones import Zones, zone_radius


def segments_per_second(scene: clsim.Scene, zones: int) -> float:
    """Return segments a second of one core, of rays of 300 m."""
    room, centres = scene.room, np.array([1000.0])
    tracer = Tracer(ray_room(room), WallEnergies.of(scene, centres), ray_engine(), 343.0, 2, (0, 0))
    places = [receiver.trajectory.position(np.zeros(1))[0] for receiver in scene.receivers]
    middles = np.array([places[i % len(places)] for i in range(zones)])
    sphere = Spheres(middles, np.ones(zones), zone_radius(room), fibonacci_sphere(64), fibonacci_sphere(32))
    layout = tracer._layout(sphere, np.zeros(zones, np.int64), 1, 800, 50)
    origin = scene.sources[0].trajectory.position(np.zeros(1))[0]
    run = tracer._run(origin, lambda d: np.ones((len(d), 1)), sphere, 0, 512, np.array([300.0]), 0)
    for _ in range(2):
        energies = layout.empty()
        begun = time.process_time()
        tracer.engine.trace(run, layout, energies)
        spent = time.process_time() - begun
    return len(run.directions) * 300.0 / (4.0 * (room.volume or 1.0) / room.surface_area) / spent


def timed(what: str, made: Callable[[], object]) -> None:
    """Print wall and processor time of a second call."""
    made()
    wall, spent = time.perf_counter(), time.process_time()
    made()
    print(
        f"{what:45} {time.perf_counter() - wall:6.2f} s, {time.process_time() - spent:6.2f} s of processors", flush=True
    )


def main() -> None:
    """Print a line for each room."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    warnings.simplefilter("ignore", clsim.ClsimWarning)
    tone = clsim.Signal.tone(1e3, duration=0.5, sampling_rate=16e3)
    walk = clsim.Receiver("ear", clsim.Trajectory.line((4.0, 3.0, 1.6), (5.0, 3.0, 1.6), 1.0))
    box = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9, scattering=0.2))
    moving = clsim.Scene(box, clsim.Air(), [clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.6)))], [walk])
    zones = Zones.along(moving.sources, box, 1.0, beams=True), Zones.along(moving.receivers, box, 1.0, beams=False)
    timed(
        "tail of a moving microphone in a shoebox",
        lambda: find_tail(moving, 0, (500.0, 4000.0), zones, TailOptions(2)),
    )
    scenes = {
        "BRAS CR2": (measured_rooms.seminar_room(folder / "bras_cr2"), (88.0, 11e3)),
        "PTB, open": (measured_rooms.studio(folder / "ptb_studio", "open"), (88.0, 5.7e3)),
    }
    for name, (scene, band) in scenes.items():
        speeds = [segments_per_second(scene, count) / 1e6 for count in (1, len(scene.receivers))]
        print(f"{name}: {speeds[0]:.2f} million segments a second and core, {speeds[1]:.2f} with all zones", flush=True)
        paths = clsim.find_paths(scene, 2)
        timed(f"{name}: responses", lambda p=paths, b=band: clsim.impulse_responses(p, 48e3, band=b, tail="auto"))


if __name__ == "__main__":
    main()
