"""`clsim materials`: the built-in materials, listed or drawn."""

from __future__ import annotations

import argparse

import numpy as np

from clsim.commands.arguments import add_output
from clsim.errors import InputError, check_pictures, meant
from clsim.files.atomic import NewFile
from clsim.output.plots import reflection_loss, reflection_losses
from clsim.scene.material.material import LIBRARY, MATERIAL_NAMES, Material


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "List the built-in materials, with sources and uncertainty, or draw what they send back."
    parser.add_argument("names", nargs="*", metavar="NAME", help="material (default: all)")
    add_output(parser, "draw them to this PNG instead")
    parser.add_argument(
        "--frequency", type=float, default=40e3, metavar="HZ", help="frequency of the angles shown (default: 40000)"
    )


def execute(options: argparse.Namespace) -> int:
    """List the materials that were named, or all, or draw them; return the exit status."""
    names = list(dict.fromkeys(options.names)) or list(MATERIAL_NAMES)
    for name in names:
        if name not in LIBRARY:
            problem = f"must be a built-in material (`clsim materials` lists them), but is {name!r:.80}"
            raise InputError("NAME", problem + meant(name, LIBRARY))
    if not (np.isfinite(options.frequency) and options.frequency > 0.0):
        raise InputError("--frequency", f"must be finite and above 0 Hz, but is {options.frequency:g} Hz")
    if options.output is not None:
        check_pictures("--output")
    materials = [Material.named(name) for name in names]
    if options.output is not None:
        target = NewFile(options.output, [], options.force)
        reflection_losses(materials, target.ready(), frequency=options.frequency)
        print(target.path)
        return 0
    print(f"{'name':<27} {'known (Hz)':<14} {f'loss at {options.frequency / 1e3:g} kHz':<17} what")
    for material in materials:
        low, high = material.band
        known = f"{low:g} to {high:g}" if np.isfinite(high) else "all"
        loss = float(reflection_loss(material, np.array([options.frequency]), np.ones(1))[0]) + 0.0
        held = "" if low <= options.frequency <= high else " held"
        print(f"{material.name:<27} {known:<14} {f'{loss:.2f} dB{held}':<17} {LIBRARY[material.name].what}")
    print("\nsources and uncertainty (tables: of the absorption; estimates: of the factor)")
    for source in dict.fromkeys(LIBRARY[name].source for name in names):
        print(f"{source}")
        for name in (n for n in names if LIBRARY[n].source == source):
            print(f"  {name}: {LIBRARY[name].uncertainty}")
    return 0
