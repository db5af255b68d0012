"""Simulation of the sound that microphones receive in rooms while sources and receivers move.

The pipeline is four values and three arrows between them::

    Scene --find_paths--> PathSet --track--> Tracks --render--> Recording

`render` takes the last two arrows at once.

"""

import sys

from clsim import process

if process.is_command():  # here, because what follows takes long enough for somebody to press Ctrl-C
    process.end_on_interrupt()

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

from clsim.version import __version__ as __version__


def _homes() -> dict[str, str]:
    """Return the modules of the public names, as the stub imports them; packages are those of clsim itself."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names if alias.name[0] != "_"}


_HOMES = _homes()
_PACKAGES = [name for name, home in _HOMES.items() if home == "clsim"]
for _name in _PACKAGES:
    del _HOMES[_name]
__all__ = sorted(_HOMES)
# Names of earlier versions: the name that each has now, and since when.
_RENAMED = {
    "DirectivityTable": ("AxialDirectivity", "0.2"),
    "SphericalTable": ("SphericalDirectivity", "0.2"),
    "direct_truth": ("direct_path", "0.2"),
}


class _Package(ModuleType):
    """A package some of whose functions are called as its modules are: the name is the function's."""

    def __setattr__(self, name: str, value: object) -> None:
        if name not in _HOMES or not isinstance(value, ModuleType):  # Python sets modules when it imports them
            super().__setattr__(name, value)

    def __getattr__(self, name: str) -> object:
        if name in _PACKAGES:
            return import_module(f"clsim.{name}")
        if name in _RENAMED:
            new, since = _RENAMED[name]
            import_module("clsim.errors").renamed(name, new, since)
            return getattr(self, new)
        if name not in _HOMES:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value: object = getattr(import_module(_HOMES[name]), name)
        self.__dict__[name] = value
        return value

    def __reduce__(self) -> tuple[Callable[[str], ModuleType], tuple[str]]:
        return import_module, (self.__name__,)  # functions that name it are sent to workers with it

    def __dir__(self) -> list[str]:
        return sorted({"__doc__", "__name__", "__version__", *_HOMES, *_PACKAGES})  # not what the file imports


sys.modules[__name__].__class__ = _Package
