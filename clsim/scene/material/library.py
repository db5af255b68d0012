"""The built-in materials: what `material_library.toml` says of them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_CONSTRUCTORS = {"reflection": "factor", "absorption": "coefficients", "solid": None, "porous": None}


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """A built-in material."""

    name: str  # what it is called, and what it is
    what: str  # likewise
    source: str  # where it is from, and how sure
    uncertainty: str  # likewise
    constructor: str  # the constructor of `Material` that makes it, without ``from_``, and its arguments
    arguments: dict[str, Any]  # likewise
    roughness: float  # root mean square of its heights, m
    scattering: Any  # (frequencies, values) share of the energy sent back that leaves the mirror's direction
    beyond: str  # what happens outside its table

    @property
    def estimated(self) -> bool:
        """Whether it is calculated from assumed properties."""
        return self.name.startswith("estimated-")


def _read(path: Path) -> dict[str, LibraryEntry]:
    content = tomllib.loads(path.read_text("utf-8"))
    library = {}
    for name, row in content["materials"].items():
        constructor = next(key for key in _CONSTRUCTORS if key in row)
        argument = _CONSTRUCTORS[constructor]
        arguments = {argument: row[constructor]} if argument else row[constructor]
        if constructor == "absorption":
            arguments |= {"frequencies": content["octaves"]}
        instead = row.get("ultrasound")
        advice = f"for ultrasound there is {instead!r}, an estimate" if instead else "measure it for ultrasound"
        library[name] = LibraryEntry(
            name, row["what"], content["sources"][row["source"]], row["uncertainty"], constructor, arguments,
            row.get("roughness", 0.0), row.get("scattering", 0.0),
            f"outside, the absorption at the nearest end is taken; {advice}",
        )  # fmt: skip
    return library


LIBRARY = _read(Path(__file__).with_suffix(".toml"))
