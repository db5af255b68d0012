"""Functions of a value and its options, each of which is a keyword that is listed once."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar

from clsim.errors import InputError

O = TypeVar("O")  # noqa: E741 - options
P = ParamSpec("P")
T = TypeVar("T")
V = TypeVar("V")
T_co = TypeVar("T_co", covariant=True)
V_contra = TypeVar("V_contra", contravariant=True)


class OfOptions(Protocol[V_contra, P, T_co]):
    """A function of a value and options, each of which is a keyword."""

    def __call__(self, value: V_contra, /, *args: P.args, **kwargs: P.kwargs) -> T_co:
        """Call the function with each option as a keyword."""


def keywords_of(make: Callable[P, O], kind: type[V]) -> Callable[[Callable[[V, O], T]], OfOptions[V, P, T]]:
    """Return a decorator for functions of a value of some kind and of options, which makes each option a keyword."""
    # Signature and docstring list them all, so that editors and ``help`` know them.

    def decorated(function: Callable[[V, O], T]) -> OfOptions[V, P, T]:
        """Return a function of a value and options as one of the value and keywords."""
        own, options = inspect.signature(function), inspect.signature(make)
        name = next(iter(own.parameters))
        signature = own.replace(parameters=[own.parameters[name], *options.parameters.values()])

        def call(*args: Any, **kwargs: Any) -> T:
            """Check the value and the names of keywords, and call with the options that they make."""
            value = args[0] if args else kwargs.get(name)
            if (args or name in kwargs) and not isinstance(value, kind):
                raise InputError(name, f"must be a {kind.__name__}, but is {value!r:.80}")
            try:
                given = signature.bind(*args, **kwargs).arguments
            except TypeError as error:  # in the words of the function that was called
                raise TypeError(f"{function.__name__}() {error}") from None
            made: Any = make
            return function(given.pop(name), made(**given))

        functools.update_wrapper(call, function)
        vars(call)["__signature__"] = signature
        call.__doc__ = with_options_listed(function.__doc__, make)
        return call

    return decorated


def with_options_listed(docstring: str | None, options: Any) -> str:
    """Return a docstring in which the line of the options, and what is indented below, is what their own one says."""
    listed = inspect.cleandoc(options.__doc__ or "").partition("----------\n")[2]
    own = re.split(r"\n\n\w+\n-+\n", listed)[0]  # up to the next section
    before, _, after = inspect.cleandoc(docstring or "").partition(f"options : {options.__name__}\n")
    rest = after.partition("\n\n")
    return before + own + rest[1] + rest[2] if after else before
