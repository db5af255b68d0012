"""What channels cost: ambisonic microphones and heads against one receiver, all in one process, in turn.

Timed are whole calls of `render` in processor time, after a first one that builds kernels; of several the least is taken.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import clsim
from clsim.scene.directivity.directivity import ChannelDirectivity

RATE = 48e3
PLACE = (5.0, 4.0, 1.3)


class OneEar(ChannelDirectivity):
    """The left ear of a rigid sphere alone."""

    is_complex, band, channels, reach = True, (0.0, np.inf), ("left",), clsim.SphericalHead().reach

    def __init__(self) -> None:
        self._both = clsim.SphericalHead()

    def gain_towards(self, direction: Any, frequency: Any, speed_of_sound: float) -> Any:
        """Return the gain (..., 1)."""
        return self._both.gain_towards(direction, frequency, speed_of_sound)[..., :1]

    def lateness(self, direction: Any, speed_of_sound: float) -> Any:
        """Return the time of arrival (..., 1), s."""
        return self._both.lateness(direction, speed_of_sound)[..., :1]

    def aligned(self, direction: Any, frequencies: Any, speed_of_sound: float, channels: range) -> Any:
        """Return the gain (1, ..., F) without the phase of the lateness."""
        return self._both.aligned(direction, frequencies, speed_of_sound, channels)


def case(receiver: clsim.Receiver, order: int, duration: float, absorption: bool) -> Callable[[], Any]:
    """Return a rendering of noise from a source at 1.4 m/s in a box."""
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    noise = clsim.Signal.noise(duration, RATE, 5, band=(100.0, 16e3), fade=0.02)
    way = clsim.Trajectory.circle((3.0, 2.5, 1.5), 1.4, 2.0 * np.pi, duration)
    air = clsim.Air(absorption=absorption)
    paths = clsim.find_paths(clsim.Scene(room, air, [clsim.Source("s", noise, way)], [receiver]), order)
    return lambda: clsim.render(paths, RATE, duration=duration)


def turning(duration: float) -> clsim.Trajectory:
    """Return a place at which a head turns by 1.5 rad/s."""
    times = np.linspace(0.0, duration + 0.2, 10 * round(duration) + 3)
    poses = np.stack([0.0 * times, 0.0 * times, np.sin(0.75 * times), np.cos(0.75 * times)], axis=1)
    return clsim.Trajectory.waypoints(times, [PLACE] * len(times), poses)


def cases(duration: float) -> dict[str, tuple[Callable[[], Any], Callable[[], Any] | None]]:
    """Return the timed functions by name, and their references."""
    still, turns = clsim.Trajectory.fixed(PLACE), turning(duration)
    omni = case(clsim.Receiver("r", still), 8, duration, absorption=False)
    found = {}
    for order in (1, 3):
        there = clsim.Receiver.ambisonic("r", still, order)
        found[f"{(order + 1) ** 2} channels, one function, 833 paths"] = (
            case(there, 8, duration, absorption=False),
            omni,
        )
    for name, pose in (("still", still), ("turning", turns)):
        one = case(clsim.Receiver("r", pose, OneEar()), 2, duration, absorption=True)
        head = case(clsim.Receiver.binaural("r", pose), 2, duration, absorption=True)
        found[f"two ears, {name}, 25 paths, against one"] = head, one
    return found


def measured_heads(files: list[str], duration: float) -> dict[str, tuple[Callable[[], Any], Callable[[], Any] | None]]:
    """Return heads of SOFA files, still and turning."""
    poses = {"still": clsim.Trajectory.fixed(PLACE), "turning": turning(duration)}
    return {
        f"{Path(file).stem}, {name}, 25 paths": (
            case(clsim.Receiver.binaural("r", pose, file), 2, duration, absorption=True),
            None,
        )
        for file in files
        for name, pose in poses.items()
    }


def seconds(call: Callable[[], Any], repeat: int) -> float:
    """Return the least processor time of a call, s."""
    spent = []
    for _ in range(repeat + 1):
        begun = time.process_time()
        call()
        spent.append(time.process_time() - begun)
    return min(spent[1:])


def main() -> None:
    """Time the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=1.0, help="s of sound (default: 1)")
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="counted calls of each (default: 3)")
    parser.add_argument("--hrtf", nargs="*", default=[], metavar="FILE", help="SOFA files of heads that are timed, too")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| receiver | processor time, s | one receiver, s | ratio |\n" + "|---" * 4 + "|")
    for name, (call, other) in (cases(options.duration) | measured_heads(options.hrtf, options.duration)).items():
        own = seconds(call, options.repeat)
        its = "|  |" if other is None else f"| {(one := seconds(other, options.repeat)):.2f} | {own / one:.2f} |"
        print(f"| {name} | {own:.2f} {its}", flush=True)


if __name__ == "__main__":
    main()
