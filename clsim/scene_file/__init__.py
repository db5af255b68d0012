"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clsim.errors import InputError
from clsim.scene_file.words import of_file

if TYPE_CHECKING:
    import os

    from clsim.scene_file.scene import SceneFile


def load_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Read a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file; `clsim schema` tells its fields. The files that it names are relative to it.

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
        If something in the scene is hardly meant.

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
        return build_scene(content, path.parent)
    except InputError as error:
        raise of_file(error, str(path)) from error
