"""Programs as PoCL builds them soonest: without the header of OpenCL C, and long kernels compiled once."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from clsim.opencl.kernels import PROGRAMS, declarations

if TYPE_CHECKING:
    from collections.abc import Collection

HEADER_READ = "-D_OPENCL_H_"  # by which the header of OpenCL C, 980 KiB of Clang's, knows that it was read

# Kernels whose work-items do so much that a call is nothing to them; small ones would no longer run side by side.
LONG_KERNELS = frozenset({"coarse_delays", "tracks", "pair_tracks", "intervals", "edge_intervals", "baseband"})
# The same where every work-item is a group of its own; those of a group wait for each other, which functions cannot.
LONG_ALONE = frozenset({"render"})
ALONE = "-DWORKERS=1"

_COMMENT = re.compile(r"//.*")
_PLACE = re.compile(r"\b(get_\w+)\((\d)\)")  # what tells a work-item which one it is


def as_built(program: str, text: str, options: Collection[str] = ()) -> str:
    """Return the text of a program for PoCL; numbers of lines stay those of its files.

    PoCL compiles all of a kernel three times, for three ways of launching it. A long kernel only calls its body: a
    function, compiled once, whose last arguments tell a work-item which one it is.
    """
    if program not in LONG_KERNELS and not (program in LONG_ALONE and ALONE in options):
        return f"{declarations()}\n{text}"
    before, head, kernel = re.split(rf"(__kernel .*\s*void {program}\()", text)
    signature, body = kernel.split("\n{", 1)
    parameters = _COMMENT.sub("", signature).rstrip().removesuffix(")")
    places = sorted(set(_PLACE.findall(body)))
    more = "".join(f", size_t {name}_{dimension}" for name, dimension in places)
    arguments = ", ".join([*PROGRAMS[program].arguments, *(f"{name}({dimension})" for name, dimension in places)])
    inner, lines = _PLACE.sub(r"\1_\2", body), "\n" * head.count("\n")
    return (
        f"{declarations()}\n{before}"
        f"static __attribute__((noinline)){lines} void {program}_body({parameters}{more})\n{{{inner}\n"
        f"{head}{parameters})\n{{\n    {program}_body({arguments});\n}}\n"
    )
