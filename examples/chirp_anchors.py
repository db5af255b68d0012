"""Positions by anchors that take turns with broadband chirps: how they scatter, against a published system.

In the manner of S. I. Lopes, J. M. N. Vieira, D. Albuquerque, "High accuracy 3D indoor positioning using broadband
ultrasonic signals", IEEE TrustCom, 2008-2014, 2012: anchors under the ceiling emit chirps from 20 to 45 kHz one after
another (TDMA), and a receiver finds its place by their times of flight. Published are a standard deviation below 2.3 cm
and a place every 350 ms.

Places of receivers at rest scatter by a tenth of a millimetre in noise and echoes of second order; what the published
figure has beyond that (transducers, clocks, the survey of the anchors) is not in here. A receiver that is carried at
0.5 m/s is found 7.5 cm off, every time: it moves on by 13 cm from the first anchor's turn to the last one's, and the
Doppler shift of a chirp looks like delay.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE = 192e3
SIZE = (5.0, 4.0, 2.8)
ANCHORS = np.array([(0.4, 0.4, 2.6), (4.6, 0.5, 2.4), (4.5, 3.6, 2.6), (0.5, 3.5, 2.3)])
CHIRP = clsim.Signal.chirp(20e3, 45e3, 5e-3, RATE, window="tukey")
TURN = 0.0875  # s, of one anchor; a round of four takes 350 ms, as published
ROUNDS = 3
PUBLISHED = 0.023  # m, standard deviation
SPEED = 0.5  # m/s
DURATION = TURN * len(ANCHORS) * ROUNDS
TABLE = clsim.grid_positions((1.0, 4.0, 2), (1.0, 3.0, 2), 1.0)
RESTING = [clsim.Trajectory.fixed(place) for place in TABLE]
CARRIED = [clsim.Trajectory.line((1.5, 2.0, 1.2), (1.5 + SPEED * DURATION, 2.0, 1.2), DURATION)]
NOISE_DB = 10.0  # dB re 20 µPa/√Hz, of the air


def recorded(places: list[clsim.Trajectory]) -> clsim.Recording:
    """Return the recordings of receivers at places."""
    period = TURN * len(ANCHORS)
    train = clsim.Signal.pulses(CHIRP, period, ROUNDS)
    anchors = [
        clsim.Source(f"anchor-{i}", train, clsim.Trajectory.fixed(place), start=TURN * i)
        for i, place in enumerate(ANCHORS)
    ]
    noisy = clsim.Electronics(ambient_noise_db=NOISE_DB, seed=1)
    ears = [clsim.Receiver(f"tag-{i}", place, electronics=noisy) for i, place in enumerate(places)]
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.8))
    scene = clsim.Scene(room, clsim.Air(22.0, 0.5), anchors, ears)
    return clsim.render(clsim.find_paths(scene, max_order=2), sampling_rate=RATE, duration=DURATION)


def located(recording: clsim.Recording) -> clsim.score.PositionScore:
    """Return the receivers' estimates of their positions, round by round."""
    reach = 343.0 * (TURN - CHIRP.duration)
    ranges = [
        clsim.score.ranging(recording, CHIRP, "first-peak", source=f"anchor-{i}", max_range=reach)
        for i in range(len(ANCHORS))
    ]
    return clsim.score.position(ranges)


def main() -> None:
    """Draw the places, and print how they scatter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    resting, carried = (located(recorded(places)) for places in (RESTING, CARRIED))
    print(
        f"at rest: deviation {1e3 * np.linalg.norm(resting.deviation):.3f} mm, published: below {1e3 * PUBLISHED:g} mm"
    )
    print(f"at {SPEED:g} m/s: off by {1e3 * carried.percentile(50):.1f} mm")
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    figure, axes = pyplot.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    plan, spread = axes
    plan.plot(*ANCHORS[:, :2].T, "k^", label="anchors")
    for score, colour, label in ((resting, "#1f77b4", "at rest"), (carried, "#d62728", f"carried at {SPEED:g} m/s")):
        plan.plot(*score.exact[..., :2].reshape(-1, 2).T, "o", color=colour, markerfacecolor="none", label=label)
        plan.plot(*score.estimated[..., :2].reshape(-1, 2).T, ".", color=colour)
        error = 1e3 * np.sort(score.error.ravel())
        spread.step(error, 100.0 * np.arange(1, len(error) + 1) / len(error), color=colour, label=label)
    plan.set(xlim=(0.0, SIZE[0]), ylim=(0.0, SIZE[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    plan.set_title("circles: true places; dots: found")
    spread.axvline(1e3 * PUBLISHED, color="0.4", linestyle=":", label="published: deviation below")
    spread.set(xlabel="error of the place (mm)", ylabel="share of the places (%)", xscale="log")
    for one in axes:
        one.grid(alpha=0.25, linewidth=0.6)
        one.legend(fontsize=8, loc=(0.31, 0.45) if one is spread else "best")
    file = options.output / "chirp_anchors.png"
    figure.savefig(file, dpi=80)
    print(file)


if __name__ == "__main__":
    main()
