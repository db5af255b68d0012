"""The paper's Doppler experiment with the theory drawn over it.

A 40 kHz source goes round a circle once a second before a fixed receiver. Each path's frequency is the ground truth
that clsim gives beside the sound. With the paper's quasi-static motion all lines cross at 0, 0.5, 1, 1.5 and 2 s; with
exact (retarded) motion each line is late by its own delay, 6 to 33 ms here.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim
from clsim.pictures.plots import spectrogram_picture


def main() -> None:
    """Render the scene file beside this script and draw its spectrogram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    file = clsim.load_scene(Path(__file__).with_name("circle.toml"))
    paths = clsim.find_paths(file.scene, **file.paths)
    recording = clsim.render(paths, **file.render)
    recording.save(folder / "paper_circle.wav")
    times = np.linspace(0.0, 2.0, 401)
    table = paths.table(times, motion=file.render["motion"])
    heard = [p for p in range(len(paths)) if table.gain[p, 0] != 0.0]
    names = [table.name_objects(p) for p in heard]
    overlay = [(times, 40e3 * table.doppler_factor[p], name) for p, name in zip(heard, names, strict=True)]
    spectrogram_picture(
        recording.pressure[0], recording.sampling_rate, folder / "paper_circle.png",
        title="40 kHz source on a circle, 1 turn/s: theory dashed, crossings at 0, 0.5, 1, 1.5, 2 s",
        band=(39.4e3, 40.6e3), overlay=overlay,
    )  # fmt: skip
    crossing = np.ptp(40e3 * table.doppler_factor[heard][:, ::100], axis=0)
    print(f"spread of the lines at 0, 0.5, 1, 1.5, 2 s: {np.round(crossing, 1)} Hz")
    print(folder / "paper_circle.png")


if __name__ == "__main__":
    main()
