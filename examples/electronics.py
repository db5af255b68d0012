"""A voltage in, a voltage out: a 40 kHz burst through MA40S4S and MA40S4R, with noise, an amplifier and a converter.

Prints how much of the converter is used; draws the drive voltage, the sound pressure that
it makes at 1 m, and what the receiver records.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE = 192e3  # Hz
BURST = 0.4e-3  # s: 16 periods
WIDTH = 2.4e3  # Hz, between the -6 dB points of both transducers


def main() -> None:
    """Render the burst and draw the three signals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    speaker = clsim.Source(
        "speaker", clsim.Signal.tone(40e3, BURST, RATE, amplitude=10.0),
        clsim.Trajectory.fixed((0.5, 0.8, 1.2)), clsim.Directivity.named("MA40S4S"), aim=(1, 0, 0),
        transducer=clsim.Transducer.named("MA40S4S"),
    )  # fmt: skip
    ear = clsim.Receiver(
        "ear", clsim.Trajectory.fixed((3.3, 0.8, 1.2)), clsim.Directivity.named("MA40S4R"), aim=(-1, 0, 0),
        transducer=clsim.Transducer.named("MA40S4R"),
        electronics=clsim.Electronics(
            ambient_noise_db=0.0, self_noise_db=8.0, seed=1, low_cut=20e3, high_cut=80e3, gain_db=40.0,
            adc_bits=8, adc_full_scale=1.0, clock_ppm=20.0,
        ),
    )  # fmt: skip
    room = clsim.Shoebox(size=(4.0, 2.0, 2.5), walls=clsim.Material.from_reflection(0.95))
    scene = clsim.Scene(room, clsim.Air(), [speaker], [ear])
    paths = clsim.find_paths(scene, max_order=2)
    recording = clsim.render(paths, RATE, duration=0.018)
    recording.save(folder / "electronics.wav")
    used = np.abs(recording.voltage).max() / ear.electronics.adc_full_scale
    print(f"{100 * used:.0f} % of the converter's range; {recording.clipped[0]} samples clipped")
    draw(speaker, ear, recording, folder / "electronics.png")
    print(folder / "electronics.png")


def draw(speaker: clsim.Source, ear: clsim.Receiver, recording: clsim.Recording, path: Path) -> None:
    """Draw drive voltage, emitted pressure and recorded voltage."""
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    drive, emitted, heard, close = figure.subplots(4, 1)
    fine = 10 * RATE  # 4.8 samples in a period would draw beats that are not there
    count = round(2e-3 * fine)
    voltage, pressure = (signal.at_rate(fine).read(0, count) for signal in (speaker.signal, speaker.emitted))
    times = 1e3 * np.arange(len(voltage)) / fine
    drive.plot(times, voltage, color="black", linewidth=0.8)
    drive.set(title="drive voltage: 16 periods of 40 kHz", ylabel="V", xlim=(0, times[-1]))
    emitted.plot(times, pressure, color="#1f77b4", linewidth=0.8)
    decay = np.sqrt(3) / (np.pi * WIDTH)
    after = times >= 1e3 * BURST
    envelope = pressure[~after].max() * np.exp(-(times - 1e3 * BURST) / (1e3 * decay))
    label = f"decay with √3 / (π 2.4 kHz) = {1e3 * decay:.2f} ms"
    emitted.plot(times[after], envelope[after], "--", color="#c1272d", linewidth=1.2, label=label)
    emitted.legend(loc="upper right")
    emitted.set(title="emitted pressure at 1 m, with ring-down", ylabel="Pa", xlim=(0, times[-1]))
    times = 1e3 * recording.times
    heard.plot(times, recording.voltage[0], color="#2a7f3f", linewidth=0.6)
    heard.set(title="recorded voltage after 40 dB of gain: direct sound, then walls", ylabel="V", xlim=(0, times[-1]))
    step = ear.electronics.step
    shown = slice(round(7.0e-3 * RATE), round(8.5e-3 * RATE))
    close.step(times[shown], recording.voltage[0, shown] / step, where="mid", color="#2a7f3f", linewidth=0.9)
    close.set(
        title=f"the onset: noise in steps of {1e3 * step:.2g} mV (8 bits) before the direct sound",
        ylabel="steps", xlabel="time (ms)", xlim=(times[shown][0], times[shown][-1]), ylim=(-6.5, 6.5),
    )  # fmt: skip
    close.yaxis.set_major_locator(_whole_numbers())
    for axes in (drive, emitted, heard, close):
        axes.grid(alpha=0.25, linewidth=0.6)
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=130)


def _whole_numbers() -> object:
    """Return a locator of ticks at whole numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(integer=True)


if __name__ == "__main__":
    main()
