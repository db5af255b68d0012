"""Launches of kernels by the names of their arguments, and the memory that these take."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import ClsimError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from clsim.opencl.arguments import Argument

    WorkItems = tuple[tuple[int, ...], tuple[int, ...]]  # in all, and in a group

NUMBERS: dict[str, type[np.generic]] = {
    "int": np.int32, "uint": np.uint32, "long": np.int64, "ulong": np.uint64, "float": np.float32, "double": np.float64,
}  # fmt: skip


class Launch:
    """A kernel that is launched with arguments by name."""

    def __init__(self, name: str, kernel: Callable[..., Any], arguments: Mapping[str, Argument]) -> None:
        self._name, self._kernel = name, kernel
        structures = [a for a in arguments.values() if a.numbers]
        direct = {n: a for n, a in arguments.items() if not a.numbers}
        self._arguments = direct | {n: number for a in structures for n, number in a.numbers}
        self._ordered = itemgetter(*direct)
        self._structures = [
            (i, itemgetter(*(n for n, _ in a.numbers)), layout(a))
            for i, a in enumerate(arguments.values()) if a.numbers
        ]  # fmt: skip
        places = list(enumerate(direct.values()))
        self._numbers = [(i, NUMBERS[a.type]) for i, a in places if not a.shape]
        self._read = [(i, NUMBERS.get(a.type.rstrip("0123456789"))) for i, a in places if a.access == "in"]

    def __call__(self, queue: Any, items: WorkItems, /, **arguments: Any) -> Any:
        """Launch it; return the event.

        **arguments: buffers and numbers, those of structures too. An array for a buffer that is only read is uploaded;
            None is a buffer that is not used.
        """
        try:
            taken = list(self._ordered(arguments))
            values = [(i, np.array(tuple(of(arguments)), kind)) for i, of, kind in self._structures]
        except KeyError:
            raise self._refusal(arguments) from None
        if len(arguments) != len(self._arguments):
            raise self._refusal(arguments)
        for i, number in self._numbers:
            taken[i] = number(taken[i])
        if np.ndarray in map(type, taken):  # quicker than asking every argument
            for i, element in self._read:
                if isinstance(taken[i], np.ndarray):
                    taken[i] = upload(queue.context, _elements(taken[i], element))
        for i, value in values:
            taken.insert(i, value)
        return self._kernel(queue, *items, *taken)

    def _refusal(self, arguments: Mapping[str, Any]) -> ClsimError:
        missing, unknown = self._arguments.keys() - arguments, arguments.keys() - self._arguments
        told = [f"{what} {', '.join(sorted(n))}" for what, n in (("lacks", missing), ("has no", unknown)) if n]
        return ClsimError(f"launch of kernel {self._name}: it {' and '.join(told)}")


def _elements(array: NDArray[Any], element: type[np.generic] | None) -> NDArray[Any]:
    """Return an array in the type of a buffer's elements; structures are as they are."""
    return array if element is None else array.astype(element, casting="same_kind", copy=False)


def layout(structure: Argument) -> np.dtype[np.void]:
    """Type of a structure that kernels take by value, laid out as in C."""
    fields = [
        (n, NUMBERS[a.type], int(a.shape or 1)) if a.shape else (n, NUMBERS[a.type]) for n, a in structure.numbers
    ]
    return np.dtype(fields, align=True)


def upload(context: Any, array: NDArray[Any]) -> Any:
    """Return a buffer of a context with a copy of an array."""
    import pyopencl as cl

    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(array))


def work(count: int, *more: int, group: int = 32) -> WorkItems:
    """Return the size of a launch and of its work-groups: `group` items of the first dimension, rounded up to these.

    Left to itself a runtime may choose groups by the divisors of each size, and build the kernel anew for every one.
    """
    return (-(-count // group) * group, *more), (group, *(1 for _ in more))


class Scratch:
    """Buffers of a context that are used again, by name: fresh memory at every step of a run costs time."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._kept: dict[Any, Any] = {}

    def take(self, name: Any, size: int) -> Any:
        """Return the buffer of a name, of at least `size` bytes; its content may be lost."""
        import pyopencl as cl

        if name not in self._kept or self._kept[name].size < size:
            self._kept.pop(name, None)
            self._kept[name] = cl.Buffer(self._context, cl.mem_flags.READ_WRITE, size)
        return self._kept[name]
