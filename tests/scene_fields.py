"""Fields of what a scene file holds, by their paths: for tests that change each of them."""


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
