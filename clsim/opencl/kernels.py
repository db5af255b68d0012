"""Kernel text: files joined in order, so that a build error names the file and its true line."""

from __future__ import annotations

from pathlib import Path

from clsim.errors import ClsimError

PROGRAMS = {
    "emit": ("emit.cl",),
    "branches": ("vector.h", "branches.cl"),
    "tracks": (
        "motion.h", "delay.h", "gain.h", "together.h", "nodes.h", "septic.h", "block.h", "silence.h", "tracks.cl",
    ),
    "anchors": ("motion.h", "delay.h", "anchors.cl"),
    "intervals": ("motion.h", "delay.h", "walls.h", "validity.h", "intervals.cl"),
    "edges": ("nodes.h", "weight.h", "edges.cl"),
    "mute": ("nodes.h", "mute.cl"),
    "render": ("vector.h", "nodes.h", "group.h", "farrow.h", "render.cl"),
    "baseband": ("vector.h", "nodes.h", "carrier.h", "baseband.cl"),
    "baseband_edges": ("vector.h", "nodes.h", "carrier.h", "weight.h", "baseband_edges.cl"),
}  # fmt: skip


def kernel_folder() -> Path:
    """Return the folder of the kernels: in the installed package, or beside it in a checkout.

    Raises
    ------
    ClsimError
        If there is none; the installation is broken.
    """
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent
    for folder, exists in (
        (package / "kernels", (package / "kernels").is_dir()),
        (checkout / "kernels", (checkout / "pyproject.toml").is_file()),
    ):
        if exists:
            return folder
    raise ClsimError(f"no kernels beside {package}: install clsim again")


def kernel_source(program: str) -> str:
    """Return the text of a program: its files in order, each behind a ``#line`` that names it."""
    folder = kernel_folder()
    parts = [f'#line 1 "{name}"\n{(folder / name).read_text("utf-8")}' for name in PROGRAMS[program]]
    return "\n".join(parts)
