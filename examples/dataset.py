"""What cross-fading of responses at rest costs: the error against exact motion, over the members of a drawn study.

Draws rooms, reverberation times and walks, and renders each walk exactly (`clsim study`, as shards). The usual stand-in
convolves with impulse responses at points of the walk and cross-fades. Plots SI-SDR, and the error of the direction of
arrival (GCC-PHAT of two microphones), by the distance between points.
"""

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import fftconvolve

import clsim

RATE, SECONDS, BASE = 16e3, 3.0, 0.15  # Hz, s, m between microphones
SPEED, ORDER = 343.2, 4  # m/s, of sound; reflections
SPACINGS = (0.05, 0.1, 0.2, 0.4, 0.8)  # m along the walk
FRAME, UP = 4096, 16  # samples of an estimate of the direction, and how much finer its lags are
SCENE = f"""
format = 1
[room]
kind = "shoebox"
size = [6.0, 5.0, 3.0]
walls = {{ reverberation_time = 0.3 }}
[[sources]]
name = "talker"
signal = {{ kind = "wav", path = "talker.wav" }}
trajectory = {{ kind = "line", start = [1, 1, 1.5], end = [2, 1, 1.5], duration = {SECONDS + 0.5} }}
[[receivers]]
name = "left"
trajectory = {{ kind = "fixed", position = [3.0, 2.0, 1.5] }}
[[receivers]]
name = "right"
trajectory = {{ kind = "fixed", position = [3.0, 2.15, 1.5] }}
[paths]
max_order = {ORDER}
[render]
sampling_rate = {RATE}
duration = {SECONDS}
"""
STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "ground_truth"]
draws = {members}
seed = 1
table_rate = 100.0
shards = {{ members = 50 }}
[[vary]]
field = "room.size"
random = {{ uniform = [[4.0, 4.0, 2.5], [8.0, 7.0, 3.5]] }}
[[vary]]
field = "room.walls.reverberation_time"
name = "reverberation_time"
random = {{ log_uniform = [0.2, 0.6] }}
[[vary]]
field = "sources[0].trajectory.start"
name = "start"
random = {{ inside = 0.5 }}
[[vary]]
field = "sources[0].trajectory.end"
name = "end"
random = {{ inside = 0.5 }}
[[vary]]
field = ["receivers[0].trajectory.position", "receivers[1].trajectory.position"]
name = ["left", "right"]
random = {{ inside = {{ margin = 0.5, offsets = [[0, 0, 0], [0, {base}, 0]] }} }}
"""


def main() -> None:
    """Render the study, compare each member with its stand-ins, and draw their errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--members", type=int, default=6)
    arguments = parser.parse_args()
    folder = arguments.output / "dataset"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    soundfile.write(folder / "talker.wav", talker(), int(RATE), subtype="FLOAT")
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "study.toml").write_text(STUDY.format(members=arguments.members, base=BASE), "utf-8")
    clsim.run_study(folder / "study.toml", folder / "study")
    members = clsim.read_shards(folder / "study")
    found = np.array([errors_of(labels, sounds["recording"], folder) for labels, sounds in members])
    draw(found, arguments.output / "dataset.png")
    for spacing, (ratio, angle) in zip(("exact", "quasi-static", *SPACINGS), np.median(found, axis=0), strict=True):
        print(f"{spacing}: SI-SDR {ratio:.1f} dB, direction {np.degrees(angle):.2f} degrees off in the median")
    print(arguments.output / "dataset.png")


def talker() -> np.ndarray:
    """Return noise with the spectrum and the syllables of speech, roughly."""
    rng, count = np.random.default_rng(2), int((SECONDS + 0.2) * RATE)
    frequencies = np.fft.rfftfreq(count, 1.0 / RATE)
    shape = np.exp(-0.5 * (np.log2(np.maximum(frequencies, 1.0) / 700.0) / 1.3) ** 2) * (frequencies < 7e3)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(count)) * shape, count)
    syllables = 0.15 + np.abs(np.sin(2.0 * np.pi * 1.9 * np.arange(count) / RATE))
    return np.asarray(0.1 * noise * syllables / np.abs(noise).max())


def errors_of(labels: dict[str, Any], exact: np.ndarray, folder: Path) -> list[tuple[float, float]]:
    """Return SI-SDR (dB) and error of the direction (rad): of exact motion, of quasi-static motion, and by spacing."""
    drawn = json.loads(labels["parameters"])
    truth = np.array(labels["arrival"])[0].mean(axis=0) @ (0.0, 1.0, 0.0), np.array(labels["times"])
    errors = [(np.inf, direction_error(exact, *truth))]
    (folder / "member.toml").write_text(labels["scene"], "utf-8")
    scene = clsim.load_scene(folder / "member.toml").scene
    still = clsim.render(clsim.find_paths(scene, ORDER), RATE, duration=SECONDS, motion="quasi-static").samples
    errors.append((scale_free_ratio(exact, still), direction_error(still, *truth)))
    length = float(np.linalg.norm(np.subtract(drawn["end"], drawn["start"]))) * SECONDS / (SECONDS + 0.5)
    for spacing in SPACINGS:
        faded = cross_faded(scene, max(2, round(length / spacing) + 1))
        errors.append((scale_free_ratio(exact, faded), direction_error(faded, *truth)))
    return errors


def cross_faded(scene: clsim.Scene, points: int) -> np.ndarray:
    """Return the stand-in: the signal through the responses of points of the walk, cross-faded in between."""
    count = int(SECONDS * RATE)
    dry, place = talker(), np.arange(count) / count * (points - 1)
    heard = np.zeros((len(scene.receivers), count))
    paths = clsim.find_paths(scene, ORDER)
    for k in range(points):
        weight = np.maximum(0.0, 1.0 - np.abs(place - k))
        at = k * SECONDS / (points - 1)
        response = clsim.impulse_responses(paths, RATE, at, (0.0, 7.4e3), lead="keep", tail="off")
        for row, taps in enumerate(response.samples[0]):
            wet = fftconvolve(dry, taps)[response.lead :][:count]
            heard[row, : len(wet)] += weight[: len(wet)] * wet
    return heard


def scale_free_ratio(exact: np.ndarray, other: np.ndarray) -> float:
    """Return SI-SDR of a stand-in, dB (Le Roux et al., "SDR - half-baked or well done?", 2019)."""
    wanted = exact * (np.vdot(exact, other) / np.vdot(exact, exact))
    return float(10.0 * np.log10(np.vdot(wanted, wanted) / np.square(other - wanted).sum()))


def direction_error(samples: np.ndarray, sine: np.ndarray, times: np.ndarray) -> float:
    """Return the median error of the angle off broadside by GCC-PHAT, rad."""
    size, most = 2 * FRAME, int(np.ceil(BASE / SPEED * RATE * UP))
    frequencies, off = np.fft.rfftfreq(size, 1.0 / RATE), []
    for first in range(0, samples.shape[1] - FRAME, FRAME // 2):
        left, right = np.fft.rfft(samples[:, first : first + FRAME] * np.hanning(FRAME), size)
        cross = right * left.conj() * ((frequencies > 200.0) & (frequencies < 6e3))
        lags = np.fft.irfft(cross / np.maximum(np.abs(cross), 1e-9 * np.abs(cross).max()), UP * size)
        delay = (np.argmax(np.roll(lags, most)[: 2 * most + 1]) - most) / (RATE * UP)
        found, wanted = -delay * SPEED / BASE, np.interp((first + FRAME / 2) / RATE, times, sine)
        off.append(abs(np.arcsin(np.clip(found, -1.0, 1.0)) - np.arcsin(wanted)))
    return float(np.median(off))


def draw(found: np.ndarray, path: Path) -> None:
    """Draw both errors by the spacing of points, each member a thin line."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    ratio, angle = figure.subplots(1, 2)
    centimetres, degrees = 100.0 * np.array(SPACINGS), np.degrees(found[..., 1])
    for axes, values in ((ratio, found[:, 2:, 0]), (angle, degrees[:, 2:])):
        axes.semilogx(centimetres, values.T, color="0.8")
        axes.semilogx(centimetres, np.median(values, axis=0), "o-", label="cross-fading, median")
        axes.set(xlabel="between responses (cm)", xticks=centimetres, xticklabels=[f"{x:g}" for x in centimetres])
        axes.minorticks_off()
    ratio.axhline(np.median(found[:, 1, 0]), color="C2", linestyle=":", label="quasi-static motion, median")
    ratio.legend()
    ratio.set(ylabel="SI-SDR re exact motion (dB)", title="sound")
    angle.axhline(np.median(degrees[:, 0]), color="C1", linestyle="--", label="exact motion, median")
    angle.set(ylabel="error (degrees)", title="direction of arrival by GCC-PHAT", ylim=(0.0, None))
    angle.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
