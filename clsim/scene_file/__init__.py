"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clsim.errors import InputError

if TYPE_CHECKING:
    from clsim.scene_file.scene import SceneFile


# Advice names arguments of calls, as Python writes them; in a scene file they are keys and values.
_TUPLE = re.compile(r"\b(\w+)=\(([^()]*?),?\)")
_VALUE = re.compile(r"\b(\w+)=(?=[\"'\w\[-])")
_ALONE = re.compile(r"\b(\w+)=(?=$|[ ,;.)])")
_WORDS = {"True": "true", "False": "false"}


def load_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Read a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file; `clsim schema` prints its fields. The files that it names are relative to it.

    Returns
    -------
    SceneFile
        ``scene``; ``paths``, the keyword arguments of `find_paths`; and ``render``, those of `render`, in SI units.

    Raises
    ------
    InputError
        If the file is missing or no TOML, or a field breaks a rule; the message names file or field, rule and value.

    Warns
    -----
    ClsimWarning
        If a value is probably a mistake.

    Examples
    --------
    >>> import tempfile
    >>> import clsim
    >>> text = '''
    ... format = 1
    ... room = { kind = "shoebox", size = [8.0, 6.0, 3.0], walls = { reflection = 0.9 } }
    ... [[sources]]
    ... name = "robot"
    ... signal = { kind = "tone", frequency = 40e3, duration = 0.01, sampling_rate = 192e3, fade = 0.002 }
    ... trajectory = { kind = "fixed", position = [4.0, 3.0, 1.5] }
    ... [[receivers]]
    ... name = "ceiling"
    ... trajectory = { kind = "fixed", position = [1.0, 1.0, 2.9] }
    ... [paths]
    ... max_order = 1
    ... [render]
    ... sampling_rate = 192e3
    ... engine = "reference"
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "scene.toml").write_text(text)
    ...     file = clsim.load_scene(Path(folder, "scene.toml"))
    >>> paths = clsim.find_paths(file.scene, **file.paths)
    >>> len(paths), file.render["sampling_rate"]
    (7, 192000.0)
    """
    from clsim.files.input_files import read_toml
    from clsim.scene_file.scene import build_scene  # late: pydantic takes longer to import than all else

    path = Path(path)
    content = read_toml(path)
    try:
        return replace(build_scene(content, path.parent), name=str(path))
    except InputError as error:
        given = InputError(error.field, as_toml(error.problem))
        given.file = error.file or str(path)
        raise given from error


def as_toml(text: str) -> str:
    """Return a message with the arguments of its advice as a scene file has them.

    >>> print(as_toml('bridge it by max_gap= or repair=("gaps",); or say outside="hold", True or False'))
    bridge it by max_gap = … or repair = ["gaps"]; or say outside = "hold", true or false
    """
    text = _TUPLE.sub(r"\1 = [\2]", text)
    text = _ALONE.sub(r"\1 = …", _VALUE.sub(r"\1 = ", text))
    return re.sub(r"\b(True|False)\b", lambda found: _WORDS[found[1]], text)
