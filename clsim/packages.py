"""Packages that only some uses need: how one that is missing is told."""

from __future__ import annotations

from importlib.util import find_spec

from clsim.errors import InputError


def check_packages(field: str, what: str, extra: str, *packages: str) -> None:
    """Raise an InputError if a package that a feature needs is not installed.

    Examples
    --------
    >>> check_packages("path", "a table", "tables", "pandas_of_nobody")
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: path: a table needs pandas_of_nobody: pip install 'clsim[tables]'
    """
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise InputError(field, f"{what} needs {' and '.join(missing)}: pip install 'clsim[{extra}]'")


def check_pictures(field: str) -> None:
    """Raise an InputError for `field` if the plotting packages are not installed."""
    check_packages(field, "a picture", "pictures", "matplotlib")
