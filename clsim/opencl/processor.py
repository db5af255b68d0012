"""The processor that PoCL compiles for, told to it where it does not know the one it runs on.

PoCL asks LLVM for the processor's name. The LLVM 14 in PoCL 3.0 knows none of AMD's since Zen 5, and says ``generic``,
a name that its compiler refuses: nothing could be built. PoCL 3.1 takes the processor for which its library of
functions was compiled, and so does `name_processor` for 3.0.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection
    from io import RawIOBase

UNKNOWN = "generic"
# Processors as PoCL's library of functions is compiled for them, the most able first, and what they must have, as Linux
# calls it. With another name its functions would not be inlined.
_ABLE = (
    ("skylake-avx512", {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "bmi2", "fma"}),
    ("haswell", {"abm", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}),
    ("x86-64", set[str]()),
)
_TRIPLE = b"x86_64-unknown-linux-gnu"  # what stands before the name in PoCL's description of a device
_DESCRIPTION = range(8, 2048, 8)  # bytes: places at which it can stand
_WORD = 8  # bytes of a pointer

_names: dict[str, Any] = {}  # texts that devices point to, for as long as there are devices


@cache
def name_processor(device: Any) -> None:
    """Have PoCL compile for what this processor can do, where it does not know which it is; once in a process.

    device: of PoCL. Nothing is done where its processor has a name, on other systems than Linux with x86-64, and where
    a process may not read its own memory.
    """
    with suppress(OSError):
        if processor(device) == UNKNOWN:
            flags = next(
                line for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines() if line.startswith("flags")
            )
            set_processor(device, able_processor(flags.split()))


def able_processor(flags: Collection[str]) -> str:
    """Return the ablest processor that PoCL's library is compiled for and that needs nothing but `flags`."""
    return next(name for name, needed in _ABLE if needed <= set(flags))


def processor(device: Any) -> str | None:
    """Return the name of the processor that PoCL compiles for; None where PoCL's description does not tell it."""
    return _named(device)[1]


def set_processor(device: Any, name: str) -> None:
    """Have PoCL compile for the processor of this name."""
    import ctypes

    place, was = _named(device)
    if was is not None:
        text = _names.setdefault(name, ctypes.create_string_buffer(name.encode()))
        with _memory() as memory:
            memory.seek(place)
            memory.write(ctypes.addressof(text).to_bytes(_WORD, sys.byteorder))


def _named(device: Any) -> tuple[int, str | None]:
    """Return where PoCL's description of a device points to the name of its processor, and that name."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return 0, None
    with _memory() as memory:
        for offset in _DESCRIPTION:
            place = device.int_ptr + offset
            if _text(memory, place) == _TRIPLE:
                name = _text(memory, place + _WORD)
                return place + _WORD, None if name is None else name.decode()
    return 0, None


def _memory() -> RawIOBase:
    """Open this process's memory: to read where nothing is, is an error there and no crash."""
    return Path("/proc/self/mem").open("r+b", buffering=0)


def _text(memory: RawIOBase, place: int) -> bytes | None:
    """Return the text that the pointer at a place in memory points to; None if it points to none."""
    try:
        memory.seek(place)
        memory.seek(int.from_bytes(memory.read(_WORD) or b"", sys.byteorder))
        text = memory.read(64) or b""
    except (OSError, OverflowError):  # no pointer
        return None
    return text.split(b"\0")[0] if text.split(b"\0")[0].isascii() else None
