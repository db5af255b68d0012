"""A talker who walks through a hall: images of order 3, and what they leave as a diffuse tail.

Writes what a still ear hears (WAV, without and with the tail) and a picture of both, with the reverberation time of the
hall's impulse response beside Eyring's.
"""

import argparse
from pathlib import Path

import numpy as np
import soundfile
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import lfilter

import clsim

RATE, SIZE = 24e3, (15.0, 10.0, 5.0)
EAR = (11.0, 6.0, 1.6)
OCTAVES = [125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3]


def main() -> None:
    """Render the walk without and with the tail, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--seconds", type=float, default=5.0)
    arguments = parser.parse_args()
    folder, seconds = arguments.output, arguments.seconds
    folder.mkdir(parents=True, exist_ok=True)
    # Bands that scatter alike share rays.
    plaster = clsim.Material.from_absorption(OCTAVES, [0.18, 0.18, 0.2, 0.22, 0.24, 0.26, 0.28], scattering=0.2)
    walk = clsim.Trajectory.line((3.0, 3.0, 1.6), (3.0 + 1.2 * (seconds + 1.0), 4.5, 1.6), seconds + 1.0)
    talker = clsim.Source("talker", clsim.Signal.from_array(babble(seconds), RATE), walk)
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed(EAR))
    scene = clsim.Scene(clsim.Shoebox(SIZE, plaster), clsim.Air(), [talker], [ear])
    paths = clsim.find_paths(scene, max_order=3)
    heard = {tail: clsim.render(paths, RATE, tail=tail, tail_error_db=1.0) for tail in ("off", "auto")}
    loudest = max(float(np.abs(recording.samples).max()) for recording in heard.values())
    for tail, recording in heard.items():
        path = folder / f"walking_talker_{tail}.wav"
        soundfile.write(path, 0.9 * recording.samples[0] / loudest, int(RATE), subtype="PCM_16")
        print(path)
    response = clsim.impulse_responses(paths, RATE, band=(90.0, 11e3), lead="keep", tail="auto")
    draw(heard, response, folder / "walking_talker.png")
    print(*(note for note in heard["auto"].notes if "tail" in note), folder / "walking_talker.png", sep="\n")


def babble(seconds: float) -> np.ndarray:
    """Return four syllables a second: pulses of a voice through three resonances, with pauses between words."""
    rng, count = np.random.default_rng(4), round(seconds * RATE)
    t = np.arange(count) / RATE
    pitch = 120.0 + 15.0 * np.sin(2.0 * np.pi * 0.7 * t)
    phase = np.cumsum(pitch) / RATE
    pulses = np.concatenate([[0.0], np.diff(np.floor(phase))]) + 0.01 * rng.standard_normal(count)
    out = np.zeros(count)
    for i in range(int(4 * seconds)):
        part = slice(round(i * RATE / 4), round((i + 0.85) * RATE / 4))
        voice = pulses[part]
        for formant, width in zip(
            rng.uniform([300.0, 900.0, 2400.0], [800.0, 2200.0, 3200.0]), (80.0, 110.0, 160.0), strict=True
        ):
            pole = np.exp(-np.pi * width / RATE + 2j * np.pi * formant / RATE)
            voice = lfilter([1.0 - abs(pole)], [1.0, -2.0 * pole.real, abs(pole) ** 2], voice)
        out[part] = voice * np.hanning(len(voice)) ** 0.5 * (rng.random() > 0.2)
    return np.asarray(0.05 * out / np.sqrt(np.mean(out**2)))


def draw(heard: dict[str, clsim.Recording], response: clsim.ImpulseResponses, path: Path) -> None:
    """Draw spectrograms of what is heard, and the decay of the impulse response."""
    figure = Figure(figsize=(15.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    for axis, (tail, recording) in zip(axes[:2], heard.items(), strict=True):
        samples = recording.samples[0]
        level = 10.0 * np.log10(np.mean(heard["auto"].samples[0] ** 2) / RATE)
        axis.specgram(samples, NFFT=512, noverlap=384, Fs=RATE, vmin=level - 50.0, vmax=level + 15.0)
        axis.set(title=f'tail="{tail}"', xlabel="time (s)", ylabel="frequency (Hz)", ylim=(0.0, 6000.0))
        axis.set(xlim=(0.0, heard["auto"].samples.shape[1] / RATE), facecolor="#440154")  # silence
    measures = clsim.room_measures(response)
    axes[2].semilogx(measures.frequencies, measures.t30[0, 0], "o-", label="T30 of images and tail")
    axes[2].semilogx(measures.frequencies, measures.eyring, "--", label="Eyring with air")
    axes[2].set_xticks(measures.frequencies, [f"{f:g}" for f in measures.frequencies])
    axes[2].minorticks_off()
    axes[2].set(xlabel="octave (Hz)", ylabel="s", title="reverberation", ylim=(0.0, None))
    axes[2].legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
