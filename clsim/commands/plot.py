"""`clsim plot` and `materials`: pictures of directivities and air, and the built-in materials, listed or drawn."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from clsim.arrays import Floats, as_number
from clsim.commands.arguments import add_output
from clsim.errors import InputError, check_pictures, inside, meant, not_one_of, with_field
from clsim.files.atomic import NewFile
from clsim.output.plots import DirectivityDiagram, air_picture, directivity_picture, reflection_loss, reflection_losses
from clsim.scene.air import Air
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.ends import Source
from clsim.scene.material.material import LIBRARY, MATERIAL_NAMES, Material
from clsim.scene.scene import Scene
from clsim.scene_file import load_scene

_MOST_CURVES = 5
_USUAL = (20e3, 40e3, 60e3)  # Hz, of a directivity that is known everywhere


def plot_arguments(parser: argparse.ArgumentParser) -> None:
    pictures = parser.add_subparsers(required=True, metavar="PICTURE")
    directivity = pictures.add_parser(
        "directivity", help="of a scene's sources and receivers, of a transducer or of a table"
    )
    directivity.add_argument("scene", type=Path, nargs="?", help="scene file (TOML)")
    directivity.add_argument("--end", metavar="NAME", help="only this source or receiver")
    directivity.add_argument("--name", help="a named directivity instead of a scene, for example T4010A1")
    directivity.add_argument(
        "--table", type=Path, metavar="FILE", help="a table instead of a scene (.csv, .npz, .mat, .sofa)"
    )
    directivity.add_argument("--rear", choices=("hold", "mirror", "zero"), help="beyond the last angle of --table")
    directivity.add_argument("--scale", choices=("db", "linear"), help="what real values of --table are")
    directivity.add_argument(
        "--hold", action="store_true", help="at other frequencies than the table's, as at the nearest"
    )
    directivity.add_argument("--frequencies", type=float, nargs="+", metavar="HZ", help="a curve for each")
    air = pictures.add_parser("air", help="absorption and speed of sound in air by frequency, absorption by humidity")
    air.add_argument("--temperature", type=float, default=20.0, metavar="CELSIUS", help="default: 20")
    air.add_argument("--pressure", type=float, default=101_325.0, metavar="PA", help="default: 101325")
    air.add_argument(
        "--humidity", type=float, nargs="+", default=[0.1, 0.3, 0.5, 0.7, 0.9], metavar="H", help="relative, 0 to 1"
    )
    for picture in (directivity, air):
        add_output(picture, "", f"{picture.prog.split()[-1]}.png")


def plot(options: argparse.Namespace) -> int:
    """Draw the picture; return the exit status."""
    if options.output.suffix.lower() != ".png":
        raise InputError("--output", f"must end in .png, but is {options.output}")
    check_pictures("--output")
    if hasattr(options, "humidity"):
        try:
            airs = [Air(options.temperature, humidity, options.pressure) for humidity in options.humidity]
        except InputError as error:
            named = {"temperature_celsius": "temperature", "relative_humidity": "humidity"}
            raise InputError(f"--{named.get(error.field, error.field)}", error.problem) from error
        air_picture(airs, NewFile(options.output, [], options.force).ready())
    else:
        diagrams, read = _diagrams(options)
        directivity_picture(diagrams, NewFile(options.output, read, options.force).ready())
    print(options.output)
    return 0


def _diagrams(options: argparse.Namespace) -> tuple[list[DirectivityDiagram], list[Path]]:
    """Return the diagrams to draw, and the files that they were read from."""
    wanted = None
    if options.frequencies is not None:
        checked = [as_number("--frequencies", f, above=0.0, at_most=50e6, unit="Hz") for f in options.frequencies]
        wanted = np.array(checked)
    given = [name for name in ("scene", "name", "table") if getattr(options, name) is not None]
    if len(given) != 1:
        raise InputError(
            "plot directivity", f"must be given one of SCENE, --name and --table, but is given {len(given)}"
        )
    if options.end is not None and options.scene is None:
        raise InputError("--end", f"must come with a scene file, but is {options.end!r:.80}")
    if options.scene is not None:
        from clsim.workflow.pipeline import input_files  # late, as all that `clsim materials` does without

        file = load_scene(options.scene)
        return _scene_diagrams(file.scene, options.end, wanted), input_files(options.scene, file)
    directivity = _read_directivity(options)
    frequencies = _usual_frequencies(directivity) if wanted is None else wanted
    title = options.name if options.name is not None else options.table.stem
    diagram = _checked_diagram(
        DirectivityDiagram(title, directivity, frequencies, Air().speed_of_sound), "--frequencies"
    )
    return [diagram], [] if options.table is None else [options.table]


def _read_directivity(options: argparse.Namespace) -> Directivity:
    """Return the directivity of a name or of a table's file."""
    if options.name is not None:
        with with_field("--name"):
            return Directivity.named(options.name, outside="hold" if options.hold else None)
    from clsim.scene_file.ends import DirectivityTableModel, SofaModel

    path, outside = str(options.table), "hold" if options.hold else None
    with inside("--table"):
        if options.table.suffix == ".sofa":
            found: Directivity = SofaModel.model_validate({"kind": "sofa", "path": path, "outside": outside}).build()
            return found
        content = {"kind": "table", "path": path, "rear": options.rear, "scale": options.scale, "outside": outside}
        return DirectivityTableModel.model_validate(content).build()


def _scene_diagrams(scene: Scene, end: str | None, wanted: Floats | None) -> list[DirectivityDiagram]:
    """Return the diagrams of a scene's sources and receivers, or of one of them."""
    ends = [item for _, item in scene.named_ends()]
    chosen = [item for item in ends if end is None or item.name == end]
    if not chosen:
        raise InputError("--end", not_one_of(end, [item.name for item in ends]))
    audible = wanted
    if audible is None:  # the ends and centres of the emitted bands
        emitted = [source.emitted for source in scene.sources]
        found = {f for one in emitted for f in (*one.band(), one.centre_frequency) if f > 0.0}
        kept = np.array(sorted({float(f"{f:.3g}") for f in found}))
        audible = kept[np.linspace(0, len(kept) - 1, min(len(kept), _MOST_CURVES)).round().astype(int)]
    diagrams = []
    for item in chosen:
        frequencies = audible
        if wanted is None:  # those of the sources that the directivity is known at
            low, high = item.directivity.band
            frequencies = audible[(audible >= low) & (audible <= high)]
            if not len(frequencies):
                frequencies = _usual_frequencies(item.directivity)
        what = "source" if isinstance(item, Source) else "receiver"
        diagram = DirectivityDiagram(f"{what} {item.name}", item.directivity, frequencies, scene.air.speed_of_sound)
        diagrams.append(_checked_diagram(diagram, f"--frequencies (for {item.name})"))
    return diagrams


def _usual_frequencies(directivity: Directivity) -> Floats:
    """Return frequencies spread over a directivity's band, Hz."""
    low, high = directivity.band
    if math.isinf(high):
        table = getattr(directivity, "frequencies", None)
        if table is None:
            return np.array(_USUAL)
        low, high = float(table[0]), float(table[-1])
    return np.unique(np.linspace(low, high, _MOST_CURVES))


def _checked_diagram(diagram: DirectivityDiagram, field: str) -> DirectivityDiagram:
    low, high = diagram.directivity.band
    for f in diagram.frequencies[(diagram.frequencies < low) | (diagram.frequencies > high)][:1]:
        raise InputError(field, f"must lie within the table, {low:.6g} to {high:.6g} Hz, but has {f:.6g} Hz")
    return diagram


def materials_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "List the built-in materials, with sources and uncertainty, or draw what they send back."
    parser.add_argument("names", nargs="*", metavar="NAME", help="material (default: all)")
    add_output(parser, "draw them to this PNG instead")
    parser.add_argument(
        "--frequency", type=float, default=40e3, metavar="HZ", help="frequency of the angles shown (default: 40000)"
    )


def materials(options: argparse.Namespace) -> int:
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
