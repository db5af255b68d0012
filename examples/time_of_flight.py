"""A study of the time of flight that a matched filter finds, over a ceiling of 100 receivers.

A robot on the floor chirps every 0.1 s. Each receiver takes the largest value of its matched filter's output for the
direct sound. The study file varies the number of reflections and the robot's speed; the ground truth is clsim's own.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import hilbert, oaconvolve

import clsim

PERIOD, LENGTH = 0.1, 5e-3  # s, of the chirps
CENTRE, SWEEP = 40e3, 10e3  # Hz
LATEST = 0.06  # s after a chirp began, in which its direct sound is looked for
PERCENTILES = (50, 75, 90, 95)


def errors(recording: clsim.Recording, paths: clsim.PathSet, parameters: dict[str, object]) -> dict[str, object]:
    """Return the errors of all times of flight (receivers, chirps) as lengths, m, and the radial speeds, m/s.

    clsim calls this in the process that rendered a member of the study; the sound is not kept.
    """
    robot, rate, c = paths.scene.sources[0], recording.sampling_rate, paths.scene.air.speed_of_sound
    count, length = round(robot.signal.duration / PERIOD), round(LENGTH * rate)
    emitted = PERIOD * np.arange(count) + 0.5 * LENGTH  # the middles of the chirps
    exact = clsim.direct_path(paths, emitted=emitted)
    found = np.empty((len(recording.samples), count))
    matched = np.conj(hilbert(robot.signal.read(0, length)))[::-1]  # of its output the magnitude is the envelope
    for r, samples in enumerate(recording.pressure):
        envelope = np.abs(oaconvolve(samples, matched)[length - 1 :])
        for k in range(count):
            first = round(PERIOD * k * rate)
            found[r, k] = (first + peak(envelope[first : first + round(LATEST * rate)])) / rate + 0.5 * LENGTH
    return {"miss": c * (found - exact.reception_time[0]), "radial": exact.radial_speed[0]}


def peak(values: np.ndarray) -> float:
    """Return the vertex of the parabola through the largest value and its neighbours, samples."""
    i = int(np.clip(np.argmax(values), 1, len(values) - 2))
    before, at, after = values[i - 1 : i + 2]
    return i + 0.5 * (before - after) / (before - 2.0 * at + after)


def main() -> None:
    """Run the study, and draw the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--full", action="store_true", help="700 members instead of 12")
    options = parser.parse_args()
    name = "time_of_flight_full" if options.full else "time_of_flight"
    store = options.output / name
    shutil.rmtree(store, ignore_errors=True)
    rows = clsim.run_study(Path(__file__).parent / f"{name}.toml", store)
    failed = [row for row in rows if row.status != "finished"]
    assert not failed, failed[0].error
    print(f"{len(rows)} members, {sum(row.seconds for row in rows):.0f} s of work")
    import xarray

    with xarray.open_zarr(store / "study.zarr" / "summary") as summary:
        found = summary.load()
    for row in table(found):
        print(row)
    if not options.full:
        draw_map(found, options.output / "time_of_flight_map.png")
        draw_curves(found, options.output / "time_of_flight_curves.png")
        print(options.output / "time_of_flight_map.png")
        print(options.output / "time_of_flight_curves.png")


def table(found: object) -> list[str]:
    """Return percentiles of the absolute error by number of reflections, a line each."""
    lines = ["order  " + "".join(f"{f'{p} %':>9}" for p in PERCENTILES) + "   of |error|, mm"]
    for order in np.unique(found.order):
        error = 1e3 * np.abs(found.miss.values[found.order == order])
        lines.append(f"{order:>5}  " + "".join(f"{np.percentile(error, p):>9.2f}" for p in PERCENTILES))
    return lines


def member(found: object, order: int, speed: float) -> int:
    """Return the number of the member of an order and a speed, m/s."""
    return int(np.flatnonzero((found.order == order) & np.isclose(found.end - 3.0, speed))[0])


def draw_map(found: object, file: Path) -> None:
    """Draw the median error of every receiver on the ceiling, for some members."""
    from matplotlib.colors import LogNorm

    figure = Figure(figsize=(11.0, 3.45), layout="constrained")
    FigureCanvasAgg(figure)
    shown = None
    for axes, (order, speed) in zip(figure.subplots(1, 3, sharey=True), ((1, 0.0), (3, 0.0), (3, 2.0)), strict=True):
        error = 1e3 * np.median(np.abs(found.miss.values[member(found, order, speed)]), axis=1).reshape(10, 10)
        shown = axes.imshow(
            error, origin="lower", extent=(0.0, 8.0, 0.0, 6.0), norm=LogNorm(0.1, 3000.0), cmap="cividis"
        )
        axes.plot([3.0, 3.0 + 0.48 * speed], [2.0, 2.0], "o-", color="white", markeredgecolor="black", markersize=6)
        axes.set(title=f"up to {order} reflection{'s' * (order > 1)}, {speed:g} m/s", xlabel="x (m)")
    figure.axes[0].set_ylabel("y (m)")
    figure.colorbar(shown, ax=figure.axes, label="median |error| (mm)", extend="both", pad=0.01)
    figure.suptitle("Distance by time of flight, 100 receivers on the ceiling; the robot's way is white")
    figure.savefig(file, dpi=100)


def draw_curves(found: object, file: Path) -> None:
    """Draw how errors are distributed by number of reflections, and how they follow the radial speed."""
    figure = Figure(figsize=(11.0, 4.3), layout="constrained")
    FigureCanvasAgg(figure)
    spread, moving = figure.subplots(1, 2)
    colours = ("#1f3b73", "#2a788e", "#35a36b", "#c1272d")
    for order, colour in enumerate(colours):
        error = np.sort(1e3 * np.abs(found.miss.values[member(found, order, 0.0)]).ravel())
        share = (np.arange(len(error)) + 1.0) / len(error)
        spread.semilogx(np.maximum(error, 1e-2), 100.0 * share, color=colour, label=f"{order}")
    spread.set(
        title="at rest: distribution by number of reflections", xlabel="|error| (mm)", ylabel="share of chirps (%)",
        xlim=(1e-2, 1e4), ylim=(0.0, 100.0),
    )  # fmt: skip
    spread.legend(title="up to", loc="lower right")
    chirp = 1e3 * CENTRE * LENGTH / SWEEP  # mm per m/s: a chirp in which a shift of frequency is a shift of time
    for speed, colour in zip((0.0, 1.0, 2.0), (colours[0], *colours[2:]), strict=True):
        at = member(found, 0, speed)
        moving.plot(
            found.radial.values[at].ravel(), 1e3 * found.miss.values[at].ravel(), ".", markersize=3.0, color=colour,
            label=f"{speed:g} m/s",
        )  # fmt: skip
    ends = np.array([-2.0, 2.0])
    moving.plot(ends, chirp * ends, "--", color="black", linewidth=1.0, label="theory")
    moving.set(
        title="direct sound only: a chirp mistakes Doppler for delay", xlabel="radial speed (m/s)", ylabel="error (mm)"
    )
    moving.legend(title="robot", loc="upper left")
    for axes in (spread, moving):
        axes.grid(alpha=0.25, linewidth=0.6)
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    main()
