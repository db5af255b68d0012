"""Fields of what a scene file holds, by their paths: for tests that change each of them."""

from pathlib import Path

from clsim.errors import InputError
from clsim.scene_file.scene import build_scene


def leaves(value: object, path: tuple = ()) -> list[tuple]:
    """Return the path of every field in a value, tables and lists included."""
    out = [path] if path else []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return out + [leaf for key, inner in items for leaf in leaves(inner, (*path, key))]


def written(path: tuple) -> str:
    """Return a path as errors write it."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def refusal(content: dict, base: Path) -> str:
    """Return the message with which a scene is refused, or the outcome if it is not."""
    try:
        build_scene(content, base)
    except InputError as error:
        return str(error)
    except Exception as error:  # a warning, too
        return f"no InputError but {error!r}"
    return "not refused"
