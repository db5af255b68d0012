"""The paper's second experiment: a chirp in a hard-walled room, through MA40S4S and MA40S4R transducers.

The drive goes from 39 to 41 kHz in 1.3 ms, at 10 V rms. The Hilbert envelope of what is received shows the direct sound
and the reflections; lines mark where the path table says that they begin. Transducers that are 2.4 kHz wide round the
envelope: the grey one is what transducers of the same sensitivity at all frequencies would give.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.signal import hilbert

import clsim
from clsim.pictures.plots import DIRECT, new_figure, save_figure

RATE = 192e3  # Hz
AMPLITUDE = 10.0 * 2**0.5  # V


def envelope(samples: np.ndarray) -> np.ndarray:
    """Return the Hilbert envelope."""
    return np.abs(hilbert(samples, 2 * len(samples))[: len(samples)])


def main() -> None:
    """Render the chirp and draw the envelope."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    sender, microphone = clsim.Transducer.named("MA40S4S"), clsim.Transducer.named("MA40S4R")
    recording, paths = received(AMPLITUDE, sender, microphone)
    recording.save(folder / "paper_chirp.wav")
    even, _ = received(AMPLITUDE * sender.sensitivity, None, None)
    table = paths.table([0.0])
    gain = np.abs(table.gain[:, 0])
    strong = np.flatnonzero((gain > 0.08 * gain.max()) & (table.delay[:, 0] < 0.019))
    figure, axes = new_figure(4.5)
    times = np.arange(recording.voltage.shape[1]) / RATE * 1e3
    grey = 1e3 * envelope(even.pressure[0] * microphone.sensitivity)
    axes.fill_between(times, grey, color="#c6c6c6", linewidth=0.0, label="transducers without resonance")
    axes.plot(times, 1e3 * envelope(recording.voltage[0]), color="black", linewidth=1.0)
    for kind, colour, line in ((True, DIRECT, "-"), (False, "#1f77b4", "--")):
        arriving = 1e3 * table.delay[strong[table.direct[strong] == kind], 0]
        axes.vlines(
            arriving,
            0.0,
            1.0,
            colour,
            line,
            label="direct" if kind else "reflected",
            transform=axes.get_xaxis_transform(),
        )
    axes.set(xlabel="time (ms)", ylabel="envelope (mV)", xlim=(times[0], times[-1]), ylim=(0.0, None))
    axes.set_title("39 to 41 kHz chirp of 1.3 ms in a hard room, MA40S4S to MA40S4R; lines: predicted arrivals")
    figure.legend(loc="outside lower center", ncols=4)
    save_figure(figure, folder / "paper_chirp.png")
    print(folder / "paper_chirp.png")


def received(
    amplitude: float, sender: clsim.Transducer | None, microphone: clsim.Transducer | None
) -> tuple[clsim.Recording, clsim.PathSet]:
    """Return the recording of a chirp and its paths: in V with transducers, in Pa at 1 m without."""
    chirp = clsim.Signal.chirp(39e3, 41e3, duration=1.3e-3, sampling_rate=RATE, window="tukey", amplitude=amplitude)
    source = clsim.Source(
        "MA40S4S", chirp, clsim.Trajectory.fixed((0.8, 1.0, 1.0)),
        directivity=clsim.Directivity.named("MA40S4S"), aim=(1.0, 0.9, 0.3), transducer=sender,
    )  # fmt: skip
    receiver = clsim.Receiver(
        "MA40S4R", clsim.Trajectory.fixed((2.6, 1.4, 1.2)),
        directivity=clsim.Directivity.named("MA40S4R"), aim=(-1.0, 0.9, 0.3), transducer=microphone,
    )  # fmt: skip
    room = clsim.Shoebox(size=(4.0, 3.0, 2.5), walls=clsim.Material.from_reflection(0.98))
    scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
    paths = clsim.find_paths(scene, max_order=3)
    return clsim.render(paths, RATE, duration=0.02), paths


if __name__ == "__main__":
    main()
