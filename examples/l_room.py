"""A source that walks round the corner of an L-shaped room, past a receiver in the other arm.

Every path is heard exactly while its walls and the corner allow it: lines begin and end in the picture of delays, and
the spectrogram shows each of them with its own Doppler shift.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim
from clsim.pictures.plots import spectrogram_picture
from clsim.workflow.pictures import history_picture

RATE = 192e3
DURATION = 6.0


def main() -> None:
    """Render the walk; draw delays over time and the spectrogram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    corners = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]
    room = clsim.MeshRoom.from_plan(corners, 3.0, clsim.Material.from_reflection(0.8))
    walk = clsim.Trajectory.waypoints(
        [0.0, 2.0, 3.0, 4.0, DURATION], [(2, 8, 1.4), (2, 4, 1.4), (2.4, 2.6, 1.4), (3.8, 2.0, 1.4), (6.5, 2.0, 1.4)]
    )
    source = clsim.Source("robot", clsim.Signal.tone(40e3, DURATION, RATE, fade=0.02), walk)
    receiver = clsim.Receiver("receiver", clsim.Trajectory.fixed((7.2, 1.2, 2.0)))
    scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
    paths = clsim.find_paths(scene, max_order=3)
    recording = clsim.render(paths, RATE, duration=DURATION)
    recording.save(folder / "l_room.wav")
    heard = [int(np.sum((paths.start <= t) & (t < paths.end))) for t in range(int(DURATION))]
    print(f"{len(paths)} intervals; paths heard at 0, 1, 2 ... s: {heard}")
    history_picture(paths.table(np.linspace(0.0, DURATION, 1201)), 0, folder / "l_room_paths.png")
    spectrogram_picture(
        recording.pressure[0], RATE, folder / "l_room.png", title="a 40 kHz source round a corner",
        band=(39.5e3, 40.5e3),
    )  # fmt: skip
    for name in ("l_room_paths.png", "l_room.png"):
        print(folder / name)


if __name__ == "__main__":
    main()
