"""Models of a scene file's tables, made from the constructors that they call, and what is wrong with such a file."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, Tag, create_model

from clsim.errors import InputError, inside, meant, not_one_of

if TYPE_CHECKING:
    from pydantic import ValidationError

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Numbers = list[float]
Hold = Literal["hold"] | None
PATHS = ("path", "phases_path")  # keys that name files
# Types of keys by the annotations of constructors' parameters; keys of other types are given theirs.
_TYPES: dict[str, Any] = {
    "float": float, "int": int, "bool": bool, "str": str, "float | None": float | None, "int | None": int | None,
    "str | None": str | None, "bool | float": bool | float, "str | PathLike[str]": str, "ArrayLike": Vector,
    "ArrayLike | None": Vector | None, "tuple[float, float] | None": Pair | None,
}  # fmt: skip
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


class Model(BaseModel):
    """Base of all tables."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    def arguments(self) -> dict[str, Any]:
        """Return the fields as arguments of the constructor: all but the kind."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}


class Table(Model):
    """Base of tables that describe a value, which a constructor makes of what their keys hold."""

    constructor: ClassVar[Callable[..., Any]]
    readers: ClassVar[dict[str, Callable[[Any], Any]]] = {}  # of keys that a file writes in another form

    def build(self, base: Path = Path()) -> Any:
        """Make the value, with files relative to `base`."""
        return self.constructor(**self.parts(base))

    def parts(self, base: Path) -> dict[str, Any]:
        """Return the arguments of the constructor, with what tables describe in their place."""
        found = {}
        for name, value in self.arguments().items():
            if name in self.readers:
                with inside(name):
                    found[name] = self.readers[name](value)
            else:
                found[name] = built(name, value, base)
        return found


def built(field: str, value: Any, base: Path) -> Any:
    """Return the argument that a key's value stands for: tables as what they describe, files with their folder."""
    with inside(field):
        if isinstance(value, Table):
            return value.build(base)
        if isinstance(value, dict):
            return {name: built(name, inner, base) for name, inner in value.items()}
    return base / value if field in PATHS and value is not None else value


def table(
    kind: str, make: Callable[..., Any], *, name: str = "", base: type[Table] = Table, without: str = "", **types: Any
) -> type[Table]:
    """Return the model of a table whose keys are the parameters of a constructor."""
    # kind: word by which the table is chosen; none where empty. name: of the model, when not that of the kind. without:
    # parameters that files do not give, between blanks. types: of keys whose annotation says too little, alone or with
    # their default.
    keys: dict[str, Any] = {"kind": (Literal[kind], ...)} if kind else {}
    for parameter in inspect.signature(make).parameters.values():
        if parameter.name not in without.split() and parameter.name not in base.model_fields:
            default = ... if parameter.default is parameter.empty else parameter.default
            kept = getattr(parameter.annotation, "__forward_arg__", parameter.annotation)  # as a text
            given = types.get(parameter.name) or _TYPES[kept]
            whole = (given, list(default) if isinstance(default, tuple) else default)
            keys[parameter.name] = given if isinstance(given, tuple) else whole
    called = name or "_" + "".join(word.title() for word in kind.split("-"))
    model = create_model(called, __base__=base, __module__=str(make.__module__), **keys)
    model.constructor = staticmethod(make)
    return model


def one_of(*tables: type[Table]) -> Any:
    """Return the type of a key that holds one of some tables, told apart by their kinds."""
    return Annotated[Union[tables], Field(discriminator="kind")]  # noqa: UP007


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
        words = re.findall("'([^']*)'", context["expected"])
        problem = f"must be {' or '.join(words)}, but is {in_file(given)}"
        return InputError(field, not_one_of(given, words) if isinstance(given, str) else problem)
    rule = _RULES.get(kind, "must be of another kind").format_map(context)
    return InputError(field, rule if ", but" in rule else f"{rule}, but is {in_file(given)}")


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
