"""Base class and helpers of the models of a scene file's tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from clsim.errors import InputError

T = TypeVar("T")
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class Model(BaseModel):
    """Base of all tables; `build` makes the value that a table describes, with paths relative to `base`."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    def arguments(self) -> dict[str, Any]:
        """Return the fields as arguments of the constructor: all but the kind."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}


def within(parent: str, build: Callable[[], T]) -> T:
    """Call `build`; the field of an InputError then begins with `parent`."""
    try:
        return build()
    except InputError as error:
        raise error.within(parent) from error
