"""A hand-held 40 kHz beacon that moves past four receivers on the ceiling.

The motion is a measured one: a file of your own in TUM format (t x y z qx qy qz qw), for example a sequence's ground
truth from the TUM RGB-D benchmark.
"""

import argparse
from pathlib import Path

import clsim
from clsim.pictures.plots import spectrogram_picture


def main() -> None:
    """Render the first seconds of the motion and draw what each receiver hears."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--trajectory", type=Path, help="TUM file")
    parser.add_argument("--duration", type=float, default=8.0, help="seconds (default: 8)")
    options = parser.parse_args()
    if options.trajectory is None:
        print("skipped: give a TUM file with --trajectory")
        return
    options.output.mkdir(parents=True, exist_ok=True)
    motion = clsim.Trajectory.from_file(options.trajectory, "tum", max_gap=0.2, translate=(2.0, 2.0, 0.0))
    for note in motion.notes:
        print(note)
    room = clsim.Shoebox(size=(6.0, 5.0, 3.0), walls=clsim.Material.from_reflection(0.85))
    tone = clsim.Signal.tone(40e3, duration=options.duration, sampling_rate=192e3, fade=0.01)
    beacon = clsim.Source("beacon", tone, motion)
    corners = [(1.0, 1.0), (5.0, 1.0), (1.0, 4.0), (5.0, 4.0)]
    ceiling = [clsim.Receiver(f"ceiling-{i}", clsim.Trajectory.fixed((x, y, 2.95))) for i, (x, y) in enumerate(corners)]
    scene = clsim.Scene(room, clsim.Air(), [beacon], ceiling)
    paths = clsim.find_paths(scene, max_order=2)
    recording = clsim.render(paths, 192e3, duration=options.duration)
    recording.save(options.output / "hand_held.wav")
    for name, pressure in zip(recording.receiver_names, recording.pressure, strict=True):
        picture = options.output / f"hand_held_{name}.png"
        spectrogram_picture(
            pressure,
            recording.sampling_rate,
            picture,
            title=f"hand-held 40 kHz beacon, {name}",
            band=(39.85e3, 40.15e3),
        )
        print(picture)


if __name__ == "__main__":
    main()
