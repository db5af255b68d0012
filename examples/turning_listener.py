"""A talker walks round a listener who turns the head: sound for headphones, and a page that shows both as it plays.

Writes turning_listener.wav (left and right ear), turning_listener.html, which holds the sound and a plan of the room,
and turning_listener.png, the plan and the delay between the ears. `--hrtf FILE.sofa` takes measured
head-related responses; without it the head is a rigid sphere.
"""

import argparse
import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from walking_talker import OCTAVES, RATE, babble

import clsim

SIZE, HEAD, RADIUS, LAP = (6.0, 5.0, 2.8), np.array([3.0, 2.4, 1.3]), 1.3, 8.0  # m and s
PAGE = """<!doctype html><meta charset="utf-8"><title>A talker walks round a listener</title>
<style>body{font:16px sans-serif;margin:2em;max-width:40em}canvas{border:1px solid #888;max-width:100%}</style>
<h1>A talker walks round a listener</h1>
<p>Put on headphones. The talker (red) walks round the head (blue), which turns as its nose shows.</p>
<audio id="sound" controls src="data:audio/wav;base64,SOUND"></audio><br>
<canvas id="plan" width="600" height="500"></canvas>
<script>
const m = MOTION, sound = document.getElementById("sound"), g = document.getElementById("plan").getContext("2d");
function dot(x, y, r, colour) { g.fillStyle = colour; g.beginPath(); g.arc(x, y, r, 0, 7); g.fill(); }
function draw() {
  const i = Math.min(m.talker.length - 1, Math.round(sound.currentTime * m.rate)), [x, y] = m.head, a = m.facing[i];
  g.clearRect(0, 0, 600, 500);
  dot(100 * x + 24 * Math.cos(a), 500 - 100 * y - 24 * Math.sin(a), 6, "#38c");
  dot(100 * x, 500 - 100 * y, 20, "#38c"); dot(100 * m.talker[i][0], 500 - 100 * m.talker[i][1], 12, "#c33");
  requestAnimationFrame(draw);
}
draw();
</script>
"""


def facing(times: np.ndarray) -> np.ndarray:
    """Return the directions in which the listener looks, rad from +x: left and right, and for a while at the talker."""
    return 1.2 * np.sin(2.0 * np.pi * times / 5.0) * np.clip(times - 2.0, 0.0, 1.0)


def talker_path(seconds: float) -> clsim.Trajectory:
    """Return the circle about the listener."""
    return clsim.Trajectory.circle((HEAD[0], HEAD[1], 1.6), RADIUS, LAP, seconds + 1.0)


def rendered(seconds: float, hrtf: Path | None = None) -> clsim.Recording:
    """Render both ears of a head that turns while the talker walks round it."""
    times = np.linspace(0.0, seconds + 1.0, 200)
    angle = facing(times)
    turns = np.stack([0.0 * angle, 0.0 * angle, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
    pose = clsim.Trajectory.waypoints(times, np.repeat(HEAD[None], len(times), axis=0), turns)
    head = clsim.Receiver.binaural("head", pose, hrtf)
    talker = clsim.Source("talker", clsim.Signal.from_array(babble(seconds), RATE), talker_path(seconds))
    plaster = clsim.Material.from_absorption(OCTAVES, [0.2, 0.25, 0.3, 0.3, 0.35, 0.4, 0.4], scattering=0.3)
    scene = clsim.Scene(clsim.Shoebox(SIZE, plaster), clsim.Air(), [talker], [head])
    return clsim.render(clsim.find_paths(scene, max_order=2), RATE, tail="auto", tail_error_db=1.0)


def scaled(recording: clsim.Recording) -> np.ndarray:
    """Return the samples (n, channels) for a player, at most 0.9."""
    return 0.9 * recording.samples.T / np.abs(recording.samples).max()


def main() -> None:
    """Render the walk, and write sound, page and picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--hrtf", type=Path, help="SOFA file of head-related responses (default: a rigid sphere)")
    parser.add_argument("--seconds", type=float, default=LAP)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    recording, around = rendered(options.seconds, options.hrtf), talker_path(options.seconds)
    print("\n".join(recording.notes))
    ears = scaled(recording)
    soundfile.write(options.output / "turning_listener.wav", ears, int(RATE), subtype="PCM_16")
    write_page(ears, around, options.output / "turning_listener.html")
    directivity = recording.paths.scene.receivers[0].directivity
    draw(recording, directivity, around, options.output / "turning_listener.png")
    print(*(options.output / f"turning_listener.{kind}" for kind in ("wav", "html", "png")), sep="\n")


def write_page(ears: np.ndarray, around: clsim.Trajectory, path: Path) -> None:
    """Write one file that holds the sound (n, 2), the motion, and what draws it."""
    sound, rate = io.BytesIO(), 25.0
    soundfile.write(sound, ears, int(RATE), subtype="PCM_16", format="WAV")
    times = np.arange(len(ears) / RATE * rate) / rate
    places = np.round(around.position(np.minimum(times, around.end))[:, :2], 3)
    motion = {"rate": rate, "head": HEAD[:2].tolist(), "talker": places.tolist(), "facing": facing(times).tolist()}
    page = PAGE.replace("MOTION", json.dumps(motion))
    path.write_text(page.replace("SOUND", base64.b64encode(sound.getvalue()).decode()), "utf-8")


def draw(recording: clsim.Recording, ears: Any, around: clsim.Trajectory, path: Path) -> None:
    """Draw the plan, and by how much sound is at the left ear before it is at the right one."""
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    plan, delay = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
    times = np.linspace(0.0, LAP, 81)
    ring = around.position(np.minimum(times, around.end))
    plan.plot(ring[:, 0], ring[:, 1], color="tab:red", label="talker")
    plan.plot(HEAD[0], HEAD[1], "o", color="tab:blue", markersize=16, label="listener")
    plan.set(xlim=(0.0, SIZE[0]), ylim=(0.0, SIZE[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    plan.legend()
    window, most = round(0.2 * RATE), round(1e-3 * RATE)
    count = recording.samples.shape[1] // window
    pieces = recording.samples[:, : count * window].astype(float).reshape(2, count, window)
    correlation = np.array([np.correlate(right, left, "full") for left, right in zip(*pieces, strict=True)])
    lags = np.argmax(correlation[:, window - 1 - most : window + most], axis=1) - most
    power = np.sum(pieces**2, axis=(0, 2))
    middle = (np.arange(count) + 0.5) * window / RATE
    loud = power > 0.03 * power.max()
    delay.plot(middle[loud], 1e6 * lags[loud] / RATE, ".", label="largest correlation in 0.2 s")
    away = around.position(np.minimum(middle, around.end)) - HEAD
    off = np.arctan2(away[:, 1], away[:, 0]) - facing(middle)
    late = ears.lateness(np.stack([np.cos(off), np.sin(off), 0.0 * off], axis=1), 343.0)
    delay.plot(middle, 1e6 * (late[:, 1] - late[:, 0]), label="direct sound, by the head's responses")
    delay.set(xlabel="time (s)", title="left ear before right ear (us)")
    delay.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
