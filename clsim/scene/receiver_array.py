"""Many receivers at once: fixed microphones on a grid or at positions from a file, and arrays that move as one."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import FARTHEST, Floats, as_count, as_number
from clsim.errors import InputError, check_kind, check_name
from clsim.files.input_files import LARGEST_TEXT, read_file
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.ends import Element, Receiver
from clsim.scene.motion.trajectory import Trajectory, as_direction, as_places

_MOST = 100_000  # receivers of an array


def receiver_array(
    name: str, positions: ArrayLike, trajectory: Trajectory | None = None, *,
    directivities: Sequence[Directivity] | None = None, aims: ArrayLike | None = None, **arguments: Any,
) -> list[Receiver]:  # fmt: skip
    """Return receivers at positions: fixed in the room, or the elements of an array that moves and turns as one.

    Parameters
    ----------
    name : str
        Prefix of all names: ``name-0`` in the room, ``name 0`` in an array.
    positions : array_like (n, 3)
        m, in the room, or with `trajectory` in the array's own frame. Arrays of pyroomacoustics and Acoular are (3, n),
        the transpose: ``array.R.T``, ``mics.pos.T``.
    trajectory : Trajectory, optional
        Position and orientation of the array's frame. Elements are then the channels of one receiver in recordings:
        ``recording.rows_of(name)``.
    directivities : sequence of Directivity, optional
        One for each position; in place of `directivity`.
    aims : array_like (n, 3), optional
        Unit vectors or longer ones along the elements' axes, in the same frame; in place of `aim`.
    **arguments : Any
        Arguments of `Receiver`, the same for all: directivity, aim, transducer, electronics.

    Notes
    -----
    Each element has its own delays, directions and shadows: nothing is taken from the array's middle. `find_paths`
    searches for the paths of all of them at once.

    Examples
    --------
    >>> ceiling = receiver_array("ceiling", grid_positions((0.5, 7.5, 8), (0.5, 5.5, 6), 2.9))
    >>> len(ceiling), ceiling[-1].name
    (48, 'ceiling-47')
    >>> robot = Trajectory.line((1.0, 1.0, 0.5), (3.0, 1.0, 0.5), duration=2.0)
    >>> pair = receiver_array("pair", [[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], robot)
    >>> pair[0].trajectory.position(1.0).tolist(), pair[1].rows
    ([2.0, 1.1, 0.5], (('pair', '1'),))
    """
    check_name(name)
    places = as_places("positions", positions, (None, 3))
    if len(places) > _MOST:
        raise InputError("positions", f"must be at most {_MOST}, but are {len(places)}")
    own = _of_each(arguments, len(places), directivities, aims)
    if trajectory is None:
        return [
            Receiver(f"{name}-{i}", Trajectory.fixed(place), **more)
            for i, (place, more) in enumerate(zip(places, own, strict=True))
        ]
    check_kind("trajectory", trajectory, Trajectory, "a Trajectory")
    made = []
    for i, (place, more) in enumerate(zip(places, own, strict=True)):
        aim = more.pop("aim", None)
        towards = None if aim is None else as_direction("aim", aim)
        motion = Trajectory.carried(trajectory, Trajectory.fixed(place), towards)
        made.append(Receiver(f"{name} {i}", motion, element=Element(name, str(i), place), **more))
    return made


def _of_each(arguments: dict[str, Any], count: int, directivities: Any, aims: Any) -> list[dict[str, Any]]:
    """Return the arguments of each of several receivers."""
    each = [dict(arguments) for _ in range(count)]
    given: dict[str, Any] = {"directivity": directivities, "aim": aims}
    for (key, values), field in zip(given.items(), ("directivities", "aims"), strict=True):
        if values is None:
            continue
        if key in arguments:
            raise InputError(field, f"must be left out where {key} is given")
        if len(values) != count:
            raise InputError(field, f"must be one for each of {count} positions, but are {len(values)}")
        for one, value in zip(each, values, strict=True):
            one[key] = value
    return each


def row_receivers(receivers: Sequence[Receiver]) -> NDArray[np.int64]:
    """Return the index of the receiver of each row of recordings (rows,)."""
    return np.repeat(np.arange(len(receivers)), [len(receiver.rows) for receiver in receivers])


def array_elements(receivers: Sequence[Receiver], array: str | None) -> list[int]:
    """Return the indices of an array's elements among receivers; of the only array where none is named."""
    names = list(dict.fromkeys(r.element.array for r in receivers if r.element is not None))
    if not names or (array is None and len(names) > 1) or (array is not None and array not in names):
        raise InputError("array", f"must name an array of the scene, one of {names}, but is {array!r:.80}")
    return [i for i, r in enumerate(receivers) if r.element is not None and r.element.array == (array or names[0])]


def grid_positions(x: Any, y: Any, z: Any) -> Floats:
    """Return the positions (n, 3) of a grid, x fastest, m.

    Parameters
    ----------
    x, y, z : float or (first, last, count)
        One coordinate, m, or evenly spaced ones from the first to the last.

    Examples
    --------
    >>> grid_positions((1.0, 2.0, 2), 3.0, 2.5).tolist()
    [[1.0, 3.0, 2.5], [2.0, 3.0, 2.5]]
    """
    axes = [_axis(field, value) for field, value in (("x", x), ("y", y), ("z", z))]
    if np.prod([float(len(axis)) for axis in axes]) > _MOST:
        raise InputError("x", f"must make at most {_MOST} positions with y and z")
    up, across, along = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    return np.stack([along.ravel(), across.ravel(), up.ravel()], axis=1)


def positions_from_file(path: str | PathLike[str]) -> Floats:
    """Return positions (n, 3) from a file, m.

    Parameters
    ----------
    path : path-like
        Three numbers a line, parted by commas, semicolons or spaces; lines that begin with ``#`` and a first line of
        words are passed over. Or a microphone geometry of Acoular (XML): a ``<pos x="" y="" z=""/>`` for each.
    """
    try:
        content = read_file(path, LARGEST_TEXT)
        is_xml = content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<")
        found = _from_xml(path, content) if is_xml else _from_lines(path, content.decode("utf-8-sig").splitlines())
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError("path", f"{path}: cannot be read: {reason}") from error
    if not found:
        raise InputError("path", f"{path}: must hold positions, but holds none")
    return as_places("positions", found, (None, 3))


def _from_xml(path: str | PathLike[str], content: bytes) -> list[list[float]]:
    """Return positions from the elements ``pos`` of a file."""
    from xml.etree import ElementTree

    if b"\0" in content:  # UTF-16, in which what follows would find nothing
        raise InputError("path", f"{path}: must be UTF-8, but holds a zero byte")
    if b"<!" in content.replace(b"<!--", b""):  # entities could make a small file as large as memory
        raise InputError("path", f"{path}: must be XML without declarations such as <!DOCTYPE")
    try:
        elements = list(ElementTree.fromstring(content).iter("pos"))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError("path", f"{path}: must be XML, but {error}") from error
    found = []
    for number, element in enumerate(elements, 1):
        words = [element.get(axis, "") for axis in "xyz"]
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = [np.nan]
        if not np.all(np.isfinite(values)):
            problem = f"pos {number} must have x, y and z, finite numbers, but has {words!r:.80}"
            raise InputError("path", f"{path}: {problem}")
        found.append(values)
    return found


def _from_lines(path: str | PathLike[str], lines: list[str]) -> list[list[float]]:
    """Return positions from lines of three numbers."""
    found: list[list[float]] = []
    words_passed = False
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            if not found and not words_passed:
                words_passed = True  # names of columns
                continue
            raise InputError("path", f"{path}: line {number} must be three numbers, but is {line!r:.80}") from error
        if len(values) != 3 or not np.all(np.isfinite(values)):
            raise InputError("path", f"{path}: line {number} must be three finite numbers, but is {line!r:.80}")
        found.append(values)
    return found


def _axis(field: str, value: Any) -> Floats:
    if np.ndim(value) == 0:
        return np.array([as_number(field, value, at_least=-FARTHEST, at_most=FARTHEST, unit="m")])
    if len(value) != 3:
        raise InputError(field, f"must be a number or first, last and count, but is {value!r:.80}")
    first, last = (
        as_number(f"{field}[{i}]", value[i], at_least=-FARTHEST, at_most=FARTHEST, unit="m") for i in range(2)
    )
    count = value[2]
    if isinstance(count, float) and count.is_integer():
        count = int(count)
    count = as_count(f"{field}[2]", count, at_least=1, at_most=_MOST)
    if count == 1 and first != last:
        raise InputError(f"{field}[2]", f"must be at least 2 between {first:g} and {last:g} m, but is 1")
    return np.linspace(first, last, count)
