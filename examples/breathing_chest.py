"""A chest that breathes before a 40 kHz transducer: 5 mm at 0.3 Hz, as the phase of the complex envelope.

Writes breathing_chest.png. The chest is a plate that moves, in a room whose walls answer, too; what is drawn is the
phase of what comes back of the plate alone, and 2 k A sin(2 pi f t) over it, at the time when sound meets the plate.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim
from clsim.paths.path_set import PathSet

RATE, CARRIER, DURATION, AMPLITUDE, BREATHS = 192e3, 40e3, 8.0, 5e-3, 0.3
DISTANCE, SPEED_OF_SOUND = 0.8, 343.0


def breath(t: np.ndarray) -> np.ndarray:
    """Return positions of the chest at times, m."""
    away = DISTANCE + AMPLITUDE * np.sin(2.0 * np.pi * BREATHS * t)
    return np.stack([1.0 + away, 0.0 * t + 1.5, 0.0 * t + 1.2], axis=1)


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=DURATION)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    skin = clsim.Material.from_reflection(0.95)
    motion = clsim.Trajectory.sampled(breath, options.duration + 0.1, 50.0)
    chest = clsim.Body.box("chest", (0.0, 0.3, 0.4), skin, motion)
    tone = clsim.Signal.tone(CARRIER, options.duration, RATE, fade=0.1)
    phone = clsim.Source("phone", tone, clsim.Trajectory.fixed((1.0, 1.5, 1.2)))
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((1.0, 1.52, 1.2)))
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.5))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=SPEED_OF_SOUND), [phone], [ear], bodies=[chest])
    paths = clsim.find_paths(scene, max_order=1, direct=False)
    alone = PathSet(scene, paths.families[-1:])
    whole, of_chest = (
        clsim.render(some, RATE, baseband=(CARRIER, 500.0), duration=options.duration) for some in (paths, alone)
    )
    draw(whole, of_chest, options.output / "breathing_chest.png")


def draw(whole: clsim.Recording, of_chest: clsim.Recording, path: Path) -> None:
    """Draw the envelope in its plane, the phase of what the chest sends back, and what it differs from theory by."""
    from matplotlib.figure import Figure

    rate = of_chest.sampling_rate
    some = slice(int(0.3 * rate), -int(0.3 * rate))
    times = (np.arange(len(of_chest.pressure[0])) / rate)[some]
    met = times - DISTANCE / SPEED_OF_SOUND  # when sound meets the chest
    phase = -np.unwrap(np.angle(of_chest.pressure[0][some]))
    theory = 2.0 * (2.0 * np.pi * CARRIER / SPEED_OF_SOUND) * AMPLITUDE * np.sin(2.0 * np.pi * BREATHS * met)
    off = phase - phase.mean() - (theory - theory.mean())
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    plane, over, error = figure.subplot_mosaic(
        [["plane", "phase"], ["plane", "error"]], width_ratios=(1, 2), height_ratios=(3, 1)
    ).values()
    for envelope, name in ((whole, "with the room"), (of_chest, "of the chest")):
        heard = envelope.pressure[0][some]
        plane.plot(heard.real, heard.imag, linewidth=1.0, label=name)
    plane.set(xlabel="in phase (Pa)", ylabel="in quadrature (Pa)", title="Complex envelope at 40 kHz")
    plane.set_aspect("equal", adjustable="datalim")
    plane.legend(loc="upper right")
    over.plot(times, phase - phase.mean(), linewidth=3.0, color="0.7", label="rendered")
    over.plot(times, theory - theory.mean(), "--", color="black", linewidth=1.0, label="2 k A sin(2 π f t)")
    over.set(ylabel="phase (rad)", title="5 mm at 0.3 Hz, 0.8 m away", ylim=(-10.0, 10.0))
    over.legend(loc="upper right", ncols=2)
    error.plot(times, 1e3 * off, color="#c1272d", linewidth=1.0)
    error.set(xlabel="time (s)", ylabel="difference\n(mrad)")
    figure.savefig(path, dpi=110)
    print(f"largest difference from theory: {1e3 * np.abs(off).max():.2f} mrad")


if __name__ == "__main__":
    main()
