"""`clsim compare` and `validate`: measured impulse responses and rooms against what clsim finds for them."""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from clsim.acoustics.room_acoustics import before_noise, decay_curve, is_clipped
from clsim.arrays import Floats, as_index
from clsim.commands.arguments import add_output, as_path, as_whole
from clsim.errors import InputError, check_pictures, not_one_of, warn
from clsim.files.atomic import NewFile, atomic_path
from clsim.files.sound import read_sound_file
from clsim.impulse_responses import ImpulseResponses, impulse_responses
from clsim.measured.page import Validated, comparison_picture, draw, page_text, picture_names, summary
from clsim.measured.rooms import BUILT_IN, NAME, MeasuredRoom, bras_room, measured_room
from clsim.measured.simulated import Aligned, Reflection, align, checked, noticeable, reflections, simulate
from clsim.room_measures import BANDS, RoomMeasures, band_centres, cut_to_band, room_measures
from clsim.scene_file import load_scene
from clsim.workflow.console import progress
from clsim.workflow.pipeline import find_scene_paths, input_files, shares

_PARAMETERS = {"edt": (1.0, "s"), "t20": (1.0, "s"), "t30": (1.0, "s"), "c50": (1.0, "dB"), "c80": (1.0, "dB"),
               "d50": (100.0, "%"), "ts": (1e3, "ms")}  # fmt: skip
_LOWEST = 88.0  # Hz, from which on responses are compared
_HIGHEST = 11.4e3  # Hz, up to which, or to 0.45 of the sampling rate
_LISTED = 12  # reflections that are printed
_DRAWN = 8  # decay curves
_EARLY = 0.08  # s after the first arrival
_SMOOTH = 0.25e-3  # s, over which early levels are averaged


def compare_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("measured", type=Path, help="sound file of a measured impulse response")
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument(
        "--channel", type=as_whole, default=0, metavar="N", help="channel of the sound file (default: 0)"
    )
    parser.add_argument("--source", metavar="NAME", help="source of the scene (default: the first)")
    parser.add_argument("--receiver", metavar="NAME", help="receiver of the scene (default: the first)")
    parser.add_argument("--bands", choices=tuple(BANDS), default="octave", help="default: octave")
    parser.add_argument("--seed", type=as_whole, default=0, metavar="N", help="seed of the tail (default: 0)")
    add_output(parser, "the picture; a table of reflections is beside it, as CSV", "comparison.png")


def compare(options: argparse.Namespace) -> int:
    """Align both responses, print parameters and reflections, and draw them; return the exit status."""
    if options.output.suffix.lower() != ".png":
        raise InputError("--output", f"must end in .png, but is {options.output}")
    if options.channel < 0 or options.seed < 0:
        raise InputError("--channel" if options.channel < 0 else "--seed", "must be at least 0, but is less")
    check_pictures("--output")
    samples, rate = _read(options.measured, options.channel)
    file = load_scene(options.scene)
    sources, receivers = file.scene.sources, file.scene.receivers
    s = as_index("--source", 0 if options.source is None else options.source, [one.name for one in sources])
    r = as_index("--receiver", 0 if options.receiver is None else options.receiver, [one.name for one in receivers])
    file = replace(file, scene=replace(file.scene, sources=[sources[s]], receivers=[receivers[r]]))
    read = [options.measured, *input_files(options.scene, file)]
    targets = [NewFile(path, read, options.force) for path in (options.output, options.output.with_suffix(".csv"))]
    paths = find_scene_paths(file, progress)
    band = _LOWEST, min(_HIGHEST, 0.45 * rate)
    with progress("impulse response", 1.0) as advance:
        images = impulse_responses(paths, rate, band=band, lead="keep", tail="off")
        simulated = impulse_responses(
            paths, rate, band=band, lead="keep", tail="auto", tail_seed=options.seed, progress=shares(advance)
        )  # fmt: skip
    aligned = align(samples, simulated, images)
    print(*_given(aligned, simulated), sep="\n")
    theirs, ours = (room_measures(one, options.bands) for one in (aligned.responses, simulated))
    print(*_parameters(theirs, ours), sep="\n")
    until = float(simulated.first_arrivals[0, 0]) + _EARLY
    found = reflections(paths.table(np.zeros(1), "quasi-static"), simulated, aligned.responses, until)
    print(f"{'ms':>8} {'order':>5} {'measured':>9} {'simulated':>9}  dB re the first arrival, by")
    for one in found[:_LISTED]:
        levels = f"{one.measured_db:>9.1f} {one.simulated_db:>9.1f}"
        print(f"{1e3 * one.delay:>8.3f} {one.order:>5} {levels}  {one.objects}")
    if len(found) > _LISTED:
        print(f"and {len(found) - _LISTED} more up to {1e3 * _EARLY:.0f} ms after the first")
    _draw(aligned, simulated, found, options, targets[0].ready())
    _write(found, targets[1].ready())
    print(*(target.path for target in targets), sep="\n")
    return 0


def _read(path: Path, channel: int) -> tuple[Floats, float]:
    """Read the measured response and its sampling rate, Hz."""
    try:
        taps, rate = read_sound_file(path, channel)
    except InputError as error:
        raise InputError(
            {"path": "measured", "channel": "--channel"}.get(error.field, error.field), error.problem
        ) from error
    if rate < 1000.0:
        raise InputError("measured", f"must be sampled at 1 kHz at least, but is at {rate:g} Hz")
    if is_clipped(taps.astype(np.float64)):
        warn(f"{path} is clipped: several samples in a row are at full scale, and levels and early energies are wrong")
    return checked(taps.astype(np.float64), rate, path), rate


def _given(aligned: Aligned, simulated: ImpulseResponses) -> list[str]:
    """Describe delay and gain between both."""
    level = 20.0 * np.log10(abs(aligned.gain))
    turned = ", polarity reversed" if aligned.gain < 0.0 else ""
    how = "by their beginnings and energies" if aligned.by_onset else "by their correlation"
    lines = [
        f"{_pair(simulated)}: the measured response is {1e3 * aligned.delay:.3f} ms late and at {level:+.1f} dB"
        f"{turned} ({how}; correlation with the images {aligned.correlation:.2f})"
    ]
    if aligned.by_onset:
        lines.append("the responses are not alike: another pair, another room, or a loudspeaker that rings")
    return [*lines, *simulated.notes]


def _parameters(measured: RoomMeasures, simulated: RoomMeasures) -> list[str]:
    """Table of parameters by band: measured, simulated, and the difference in just noticeable ones."""
    lines = [f"{'':<9} {'Hz':>6} {'measured':>9} {'simulated':>9} {'JND':>6}"]
    for name, (scale, unit) in _PARAMETERS.items():
        for b, frequency in enumerate(measured.frequencies):
            wanted, got = (getattr(one, name)[0, 0, b] for one in (measured, simulated))
            step = noticeable("c80" if name == "c50" else name, np.array([wanted]))[0]
            head = f"{name} ({unit})" if b == 0 else ""
            apart = f"{(got - wanted) / step:+.1f}" if np.isfinite(got - wanted) else "-"
            lines.append(f"{head:<9} {frequency:>6.4g} {scale * wanted:>9.3g} {scale * got:>9.3g} {apart:>6}")
    return lines


def _draw(
    aligned: Aligned, simulated: ImpulseResponses, found: list[Reflection], options: argparse.Namespace, path: Path
) -> None:
    """Draw decay curves by octave, and early reflections."""
    rate, both = simulated.sampling_rate, (aligned.responses, simulated)
    first = simulated.lead + int(float(simulated.first_arrivals[0, 0]) * rate)
    decays = []
    for centre in band_centres(simulated.band, "octave")[:_DRAWN]:
        curves = []
        for one in both:
            taps = cut_to_band(one.samples[0, 0], rate, centre, 2.0**0.5)[first:]
            count, noise, beyond = before_noise(taps, rate)
            curves.append(decay_curve(taps[:count], noise, beyond))
        decays.append((f"{centre:.4g} Hz", curves[0], curves[1]))
    last = first + int(_EARLY * rate)
    span = slice(max(0, first - int(0.005 * rate)), last)
    early = [_level(one.samples[0, 0], rate)[span] for one in both]
    count = min(map(len, early))
    axis = (np.arange(count) + span.start - simulated.lead) / rate
    times = [np.arange(one.samples.shape[2]) / rate for one in both]
    comparison_picture(
        decays, [*times, axis], [level[:count] for level in early], np.array([one.delay for one in found]), path,
        f"{options.measured.name} and {options.scene.name}, {_pair(simulated)}",
    )  # fmt: skip


def _pair(responses: ImpulseResponses) -> str:
    return f"{responses.source_names[0]} to {responses.receiver_names[0]}"


def _level(taps: Floats, rate: float) -> Floats:
    """Level of taps (n,) averaged over 0.25 ms, dB re the largest."""
    width = max(1, round(_SMOOTH * rate))
    power = np.convolve(np.square(taps), np.full(width, 1.0 / width), "same")
    return np.asarray(10.0 * np.log10(np.maximum(power / max(float(power.max()), 1e-300), 1e-12)))


def _write(found: list[Reflection], path: Path) -> None:
    """Write the table of reflections."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("delay", "order", "measured_db", "simulated_db", "way"))
        writer.writerows((one.delay, one.order, one.measured_db, one.simulated_db, one.objects) for one in found)


_PAGE = "measured_rooms.md"
_MOST_SEEDS = 100


def validate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "rooms", nargs="+", metavar="ROOM", help=f"{', '.join(BUILT_IN)}, {NAME}, or a TOML file of a measured room"
    )
    parser.add_argument("--bras", type=as_path, metavar="DIR", help=f"folder with the files of the BRAS, for {NAME}")
    parser.add_argument(
        "--seeds", type=as_whole, nargs="+", default=[0], metavar="N", help="seeds of rays and noise (default: 0)"
    )
    add_output(parser, f"for {_PAGE} and its pictures", "measured_rooms", metavar="FOLDER")


def validate(options: argparse.Namespace) -> int:
    """Simulate the rooms, print how far they are from what was measured, and write the page; return the exit status."""
    if len(options.seeds) > _MOST_SEEDS or min(options.seeds) < 0 or len(set(options.seeds)) < len(options.seeds):
        raise InputError("--seeds", f"must be 1 to {_MOST_SEEDS} different numbers from 0 on, but are {options.seeds}")
    check_pictures("--output")
    rooms = [_measured_room(name, options.bras) for name in options.rooms]
    targets = [NewFile(options.output / _PAGE, [], options.force, new_folder=True)] + [
        NewFile(options.output / "pictures" / name, [], options.force, new_folder=True)
        for room in rooms
        for name in picture_names(room)
    ]
    found = []
    for room in rooms:
        one = Validated(room, tuple(simulate(room, state, options.seeds, progress) for state in room.states))
        print(*summary(one), sep="\n", flush=True)
        found.append(one)
    (options.output / "pictures").mkdir(parents=True, exist_ok=True)
    text = page_text(found, options.seeds)
    for target in targets:
        target.ready()
    for one in found:
        draw(one, options.output / "pictures")
    with atomic_path(options.output / _PAGE) as temporary:
        temporary.write_text(text, "utf-8")
    for target in targets:
        print(target.path)
    return 0


def _measured_room(name: str, bras: Path | None) -> MeasuredRoom:
    """Read a room by its name, or from its file."""
    if name == NAME:
        if bras is None:
            raise InputError("--bras", f"must name the folder of the BRAS for {NAME}, but is missing")
        return bras_room(bras)
    if name not in BUILT_IN and not name.endswith(".toml"):
        raise InputError("ROOM", not_one_of(name, [*BUILT_IN, NAME]) + " (or a .toml file)")
    return measured_room(name)
