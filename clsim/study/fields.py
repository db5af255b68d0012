"""Fields of a scene file by dotted path, such as ``sources[0].trajectory.start[2]``."""

from __future__ import annotations

import copy
import re
from typing import Any

from clsim.errors import InputError

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)|\[(\d+|\*)\]")


def parsed(path: str) -> list[str | int]:
    """Return the steps of a dotted path: keys, indices, and ``"*"`` for all of a list."""
    steps: list[str | int] = []
    at = 0
    while at < len(path):
        if at and path[at] == ".":
            at += 1
        elif at and path[at] != "[":
            break
        found = _STEP.match(path, at)
        if found is None:
            break
        key, index = found.groups()
        steps.append(key or (index if index == "*" else int(index)))
        at = found.end()
    if at < len(path) or not steps or not isinstance(steps[0], str):
        raise InputError("", f"must be a dotted path such as sources[0].trajectory.start, but is {path!r:.80}")
    return steps


def replaced(content: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return the content of a scene file with another value of a field; tables that are missing are made."""
    content = copy.deepcopy(content)
    _put(content, parsed(path), value, "")
    return content


def _put(at: Any, steps: list[str | int], value: Any, where: str) -> None:
    step, rest = steps[0], steps[1:]
    if isinstance(step, int) or step == "*":
        if not isinstance(at, list):
            raise InputError("", f"must be a field of the scene, but {where} is no list")
        if isinstance(step, int) and step >= len(at):
            raise InputError("", f"must be a field of the scene, but {where} has {len(at)} entries and none [{step}]")
        chosen = [step] if isinstance(step, int) else range(len(at))
        for i in chosen:
            if rest:
                _put(at[i], rest, value, f"{where}[{i}]")
            else:
                at[i] = copy.deepcopy(value)
        return
    if not isinstance(at, dict):
        raise InputError("", f"must be a field of the scene, but {where} is no table")
    where = f"{where}.{step}" if where else str(step)
    if not rest:
        at[step] = copy.deepcopy(value)
        return
    if step not in at and not isinstance(rest[0], str):
        raise InputError("", f"must be a field of the scene, but {where} is not given there")
    _put(at.setdefault(step, {}), rest, value, where)
