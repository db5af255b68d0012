"""Advice in the words of scene files: what Python writes as arguments of calls stands there as keys and values."""

from __future__ import annotations

import re

from clsim.errors import InputError

_TUPLE = re.compile(r"\b(\w+)=\(([^()]*?),?\)")
_VALUE = re.compile(r"\b(\w+)=(?=[\"'\w\[-])")
_ALONE = re.compile(r"\b(\w+)=(?=$|[ ,;.)])")
_WORDS = {"True": "true", "False": "false"}


def as_toml(text: str) -> str:
    """Return a message with the arguments of its advice as a scene file has them.

    Examples
    --------
    >>> print(as_toml('bridge it by max_gap= or repair=("gaps",); or say outside="hold", True or False'))
    bridge it by max_gap = … or repair = ["gaps"]; or say outside = "hold", true or false
    """
    text = _TUPLE.sub(r"\1 = [\2]", text)
    text = _ALONE.sub(r"\1 = …", _VALUE.sub(r"\1 = ", text))
    return re.sub(r"\b(True|False)\b", lambda found: _WORDS[found[1]], text)


def of_file(error: InputError, name: str) -> InputError:
    """Return an error of what a file holds, with the file's name and in its words."""
    told = InputError(error.field, as_toml(error.problem))
    told.file = error.file or name
    return told
