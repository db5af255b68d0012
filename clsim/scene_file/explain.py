"""What is wrong with a file of tables, in our words and those of the file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, Tag

from clsim.errors import InputError, meant, not_one_of

if TYPE_CHECKING:
    from pydantic import ValidationError

UNKNOWN = "is no known key"
# Rules by pydantic's names of them, with what it tells of each.
_RULES = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be a text",
    "list_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "finite_number": "must be finite",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than_equal": "must be at most {le:g}",
    "greater_than": "must be above {gt:g}",
    "less_than": "must be below {lt:g}",
    "too_short": "must hold at least {min_length} values, but holds {actual_length}",
    "too_long": "must hold at most {max_length} values",
}


def explain(error: ValidationError, content: Any, model: type[BaseModel]) -> InputError:
    """Return InputError for one of pydantic's errors, with the field's path."""
    # A misspelt key comes before what is then missing; of a number or a list of numbers, what is wrong within the list;
    # of a text where a word or something else may stand, the word.
    complaints: list[Any] = error.errors(include_url=False)
    first = min(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    field = _field_of(first, content)
    for complaint in complaints:
        inner = _field_of(complaint, content)
        word = complaint["type"] == "literal_error" and isinstance(complaint["input"], str) and inner == field
        if word or inner.startswith(f"{field}["):
            first, field = complaint, inner
    kind, context, given = first["type"], first.get("ctx", {}), first["input"]
    if kind == "missing":
        return InputError(field, "must be given, but is missing")
    if kind == "extra_forbidden":
        steps = first["loc"]
        known = [name for table in tables_at(model, steps[:-1]) for name in table.model_fields]
        return InputError(field, UNKNOWN + meant(steps[-1], known))
    if kind == "union_tag_not_found":
        listed = ", ".join(f'"{name}"' for table in tables_at(model, first["loc"]) for name in kinds(table))
        return InputError(f"{field}.kind", f"must be one of {listed}, but is missing")
    if kind == "union_tag_invalid":
        names = re.findall("'([^']*)'", context["expected_tags"])
        return InputError(f"{field}.kind", not_one_of(context["tag"], names))
    if kind == "literal_error":
        return InputError(field, _not_a_word(given, context["expected"]))
    rule = _RULES.get(kind, "must be of another kind").format_map(context)
    return InputError(field, rule if ", but" in rule else f"{rule}, but is {in_file(given)}")


def _not_a_word(given: Any, expected: str) -> str:
    """Return problem text for a value that is none of the words that pydantic lists."""
    words = re.findall("'([^']*)'", expected)
    return (
        not_one_of(given, words) if isinstance(given, str) else f"must be {' or '.join(words)}, but is {in_file(given)}"
    )


def in_file(value: Any) -> str:
    """Return the beginning of a value as TOML writes it, but for texts, which stand as Python writes them."""
    return str(value).lower() if isinstance(value, bool) else "a table" if isinstance(value, dict) else f"{value!r:.80}"


def kinds(table: type[BaseModel]) -> list[str]:
    """Return the kinds of a table: one word, or none."""
    field = table.model_fields.get("kind")
    return [] if field is None else list(get_args(field.annotation))


def tables_of(annotation: Any) -> list[tuple[str, type[BaseModel]]]:
    """Return the tables that a field may hold, however deep in lists and unions, each with its tag or an empty one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [("", annotation)]
    tag = next((part.tag for part in get_args(annotation)[1:] if isinstance(part, Tag)), "")
    parts = get_args(annotation)[:1] if get_origin(annotation) is Annotated else get_args(annotation)
    inner = [] if get_origin(annotation) is Literal else [found for part in parts for found in tables_of(part)]
    return [(own or tag, table) for own, table in inner]


def tables_at(model: type[BaseModel], steps: tuple[Any, ...]) -> list[type[BaseModel]]:
    """Return the tables that may stand where pydantic's steps lead: keys, indices, and the tags of unions' members."""
    found: list[tuple[str, type[BaseModel]]] = [("", model)]
    for step in steps:
        deeper = [table.model_fields[step] for _, table in found if step in table.model_fields]
        if deeper:
            found = [inner for field in deeper for inner in _held(field)]
        elif isinstance(step, str):
            called = [(tag, table) for tag, table in found if step in (tag, table.__name__, *kinds(table))]
            found = called or found
    return [table for _, table in found]


def _held(field: Any) -> list[tuple[str, type[BaseModel]]]:
    """Return the tables of a field, whose own tag pydantic keeps apart from its type."""
    tag = next((part.tag for part in field.metadata if isinstance(part, Tag)), "")
    return [(own or tag, table) for own, table in tables_of(field.annotation)]


def _field_of(complaint: Any, content: Any) -> str:
    """Return path of the field of a pydantic error."""
    field, at, steps = "", content, complaint["loc"]
    for i, step in enumerate(steps):
        known = isinstance(at, dict | list) and (step in at if isinstance(at, dict) else isinstance(step, int))
        if isinstance(step, str) and not known and i < len(steps) - 1:
            continue  # the name of a union's member, which no file holds
        if isinstance(step, str) and not known and complaint["type"] not in ("missing", "extra_forbidden"):
            continue
        word = step or '""'  # an empty key is one, too
        field += f"[{step}]" if isinstance(step, int) else f".{word}" if field else str(word)
        at = at[step] if known else None
    return field
