"""Polygons from AC3D files, which programs of room acoustics exchange.

The format: "The AC3D file format", version 3.0, at the site of AC3D. Text, an object to a block, blocks in a tree.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_TEXT, read_file

_KIND = 0x0F  # bits of a surface's flags: 0 for a polygon, others are lines
_DEEPEST = 200


@dataclass(slots=True)
class _Lines:
    """The lines of a file, in order."""

    path: Path
    lines: list[str]
    at: int = 0

    def next(self) -> list[str]:
        """Return the words of the next line that has some; none at the end."""
        while self.at < len(self.lines):
            self.at += 1
            text = self.lines[self.at - 1].strip()
            if text:
                try:
                    return shlex.split(text)
                except ValueError:
                    return text.split()
        return []

    def numbers(self, words: list[str], count: int) -> list[float]:
        """Return so many numbers of a line, or refuse it."""
        try:
            found = [float(word) for word in words[:count]]
        except ValueError:
            found = []
        if len(found) < count:
            raise self.wrong(f"must have {count} numbers, but is {' '.join(words)!r:.60}")
        return found

    def count(self, words: list[str]) -> int:
        """Return the whole number of a line, at most one for each line that is left."""
        number = self.numbers(words, 1)[0]
        if not (number == int(number) and 0 <= number <= len(self.lines) - self.at):
            raise self.wrong(f"must have a count of what follows, but has {words[0]!r:.40}")
        return int(number)

    def wrong(self, problem: str) -> InputError:
        return InputError(str(self.path), f"line {self.at} {problem}")


def read_ac3d(path: Path) -> tuple[Floats, list[NDArray[np.int64]], list[int], list[str]]:
    """Read corners (n, 3), polygons of them, the material of each, and the materials' names."""
    try:
        data = read_file(path, LARGEST_TEXT)
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    if not data.startswith(b"AC3D") or b"\0" in data:
        raise InputError(str(path), "must be an AC3D file, which begins with AC3D, but is not")
    lines = _Lines(path, data.decode("utf-8", "replace").splitlines(), 1)
    materials: list[str] = []
    vertices: list[Floats] = []
    polygons: list[NDArray[np.int64]] = []
    of_polygon: list[int] = []
    while words := lines.next():
        if words[0] == "MATERIAL":
            materials.append(words[1] if len(words) > 1 else "")
        elif words[0] == "OBJECT":
            _read_object(lines, np.eye(3), np.zeros(3), vertices, polygons, of_polygon, 0)
        else:
            raise lines.wrong(f"must begin a material or an object, but is {' '.join(words)!r:.60}")
    for number in sorted(set(of_polygon)):
        if not 0 <= number < len(materials):
            raise InputError(str(path), f"must use materials from 0 to {len(materials) - 1}, but uses {number}")
    if not polygons:
        raise InputError(str(path), "must hold faces, but holds none")
    return np.concatenate(vertices), polygons, of_polygon, materials


def _read_object(
    lines: _Lines, turn: Floats, shift: Floats, vertices: list[Floats], polygons: list[NDArray[np.int64]],
    of_polygon: list[int], depth: int,
) -> None:  # fmt: skip
    """Read an object and its descendants; each is turned and moved within the one above."""
    if depth > _DEEPEST:
        raise lines.wrong(f"must have objects in each other {_DEEPEST} deep at most")
    first, count = sum(map(len, vertices)), 0
    while words := lines.next():
        if words[0] == "loc":
            shift = shift + turn @ np.array(lines.numbers(words[1:], 3))
        elif words[0] == "rot":
            turn = turn @ np.array(lines.numbers(words[1:], 9)).reshape(3, 3).T
        elif words[0] == "data":
            lines.at += 1  # a line of text
        elif words[0] == "numvert":
            count = lines.count(words[1:])
            own = np.array([lines.numbers(lines.next(), 3) for _ in range(count)]).reshape(-1, 3)
            vertices.append(own @ turn.T + shift)
        elif words[0] == "SURF":
            _read_surface(lines, words, first, count, polygons, of_polygon)
        elif words[0] == "kids":
            for _ in range(lines.count(words[1:])):
                if lines.next()[:1] != ["OBJECT"]:
                    raise lines.wrong("must begin an object that stands in another one")
                _read_object(lines, turn, shift, vertices, polygons, of_polygon, depth + 1)
            return


def _read_surface(
    lines: _Lines, words: list[str], first: int, count: int, polygons: list[NDArray[np.int64]], of_polygon: list[int]
) -> None:
    """Read a surface; lines are left out."""
    try:
        flags = int(words[1], 0)
    except (IndexError, ValueError):
        raise lines.wrong("must have the flags of a surface") from None
    material, corners = 0, []
    while words := lines.next():
        if words[0] == "mat":
            material = int(lines.numbers(words[1:], 1)[0])
        elif words[0] == "refs":
            for _ in range(lines.count(words[1:])):
                corner = lines.numbers(lines.next(), 1)[0]
                if not (corner == int(corner) and 0 <= corner < count):
                    raise lines.wrong(f"must name a corner from 0 to {count - 1}, but names {corner:g}")
                corners.append(first + int(corner))
            break
    if flags & _KIND == 0 and len(corners) >= 3:
        polygons.append(np.array(corners, dtype=np.int64))
        of_polygon.append(material)
