"""Packages that some tests need: looked for, but imported when a test asks for what is in them.

Every process of a run collects every file, and runs a share of the tests.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

import pytest


class Late:
    """What is in a package, which is imported with the first of it."""

    def __init__(self, package: str) -> None:
        self._package = package

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "pytestmark":  # collecting asks every object for such
            raise AttributeError(name)
        return getattr(importlib.import_module(self._package), name)


def installed(package: str, reason: str = "") -> Late:
    """Return a package; where it is not installed, the tests of the file that asks are a visible skip."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(reason or f"{package} is not installed", allow_module_level=True)
    return Late(package)
