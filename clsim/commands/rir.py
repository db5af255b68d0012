"""`clsim rir`: impulse responses of a scene file at one instant."""

from __future__ import annotations

import argparse

from clsim.commands.arguments import add_output, add_scene, as_whole
from clsim.errors import InputError
from clsim.files.atomic import NewFile
from clsim.impulse_responses import TAILS, as_response_band, impulse_responses
from clsim.output.result_files import response_names, write_response_sounds, write_responses
from clsim.scene_file import load_scene
from clsim.tail.design import SCATTERINGS
from clsim.workflow.console import progress
from clsim.workflow.pipeline import find_scene_paths, input_files, shares

_FIELDS = {"band[0]": "--band", "band[1]": "--band", "path": "--output", "tail_seed": "--tail-seed"}
_FIELDS |= {name: f"--{name}" for name in ("at", "band", "tail")}
# Of what is meant as a file, where WAV files need a folder.
_ENDINGS_OF_FILES = ("npz", "sofa", "wav", "mat", "h5", "hdf5", "csv", "txt", "flac", "json", "parquet")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    text = "a folder for a WAV file per source and receiver, or a .npz or .sofa file"
    add_output(parser, text, required=True, metavar="PATH")
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    parser.add_argument(
        "--format", choices=("wav", "npz", "sofa"), help="default: by the ending of the output, else wav"
    )
    parser.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"),
        help="band of exact responses, Hz (default: 0 to 0.95 of half the sampling rate)",
    )  # fmt: skip
    parser.add_argument(
        "--lead", choices=("cut", "keep"), default="cut",
        help="ringing before time 0: cut, so that sample 0 is time 0 (default), or kept",
    )  # fmt: skip
    parser.add_argument(
        "--tail", choices=TAILS, default="auto",
        help="energy beyond the images as a diffuse tail: auto (default), in closed rooms and below 40 kHz, or off",
    )  # fmt: skip
    parser.add_argument(
        "--tail-scattering", choices=SCATTERINGS, default=SCATTERINGS[0],
        help="size (default): walls of the tail also scatter by their limited size; material: by their materials alone",
    )  # fmt: skip
    parser.add_argument(
        "--tail-seed", type=as_whole, default=0, metavar="N", help="of the tail's rays and noise (default: 0)"
    )


def execute(options: argparse.Namespace) -> int:
    """Write impulse responses to files; return the exit status."""
    kind = _kind(options)
    file = load_scene(options.scene)
    rate = file.render["sampling_rate"]
    read = input_files(options.scene, file)
    sounds = response_names([s.name for s in file.scene.sources], [r.name for r in file.scene.receivers])
    files = [options.output / name for name in sounds] if kind == "wav" else [options.output]
    targets = [NewFile(path, read, options.force, new_folder=kind == "wav") for path in files]
    try:
        as_response_band(rate, options.band)  # before paths are searched for
        paths = find_scene_paths(file, progress)
        with progress("impulse responses", 1.0) as advance:
            found = impulse_responses(
                paths, rate, options.at, options.band, lead=options.lead, tail=options.tail,
                tail_seed=options.tail_seed, tail_scattering=options.tail_scattering, progress=shares(advance),
            )  # fmt: skip
        made = [target.ready() for target in targets]
        if kind == "wav":
            write_response_sounds(found, options.output)
        else:
            write_responses(found, options.output)
    except InputError as error:
        raise InputError(_FIELDS.get(error.field, error.field), error.problem) from error
    for path in made:
        print(path)
    count = found.samples.shape[2]
    print(f"{count} samples at {rate:g} Hz, exact from {found.band[0]:g} to {found.band[1]:g} Hz")
    for line in found.describe():
        print(line)
    return 0


def _kind(options: argparse.Namespace) -> str:
    """Return the format: as given, by the output's ending, or WAV files in a folder."""
    ending = options.output.suffix.removeprefix(".")
    kind: str = options.format or (ending if ending in ("npz", "sofa") else "wav")
    if kind != "wav" and ending != kind:
        raise InputError("--output", f"must end in .{kind}, but is {options.output}")
    if kind == "wav" and (ending.lower() in _ENDINGS_OF_FILES or options.output.is_file()):
        raise InputError("--output", f"must be a folder for WAV files, but is {options.output}")
    return kind
