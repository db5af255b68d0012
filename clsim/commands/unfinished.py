"""A run that may be killed at any moment, and goes on from where it was."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import time
import tomllib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.commands.console import progress
from clsim.errors import InputError
from clsim.opencl.device import find_device
from clsim.output.atomic import locked, to_disk
from clsim.output.journal import Journal, first_difference
from clsim.render.receiving import Receiving
from clsim.render.render import render_chunks
from clsim.scene_file import referenced_files

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from clsim.output.stores import SoundStore
    from clsim.paths.path_set import PathSet
    from clsim.render.plan import Plan
    from clsim.scene_file import SceneFile

_PERIOD = 1.0  # s between notes in the journal, at least: what a killed run loses beside the chunk it was at


class Unfinished:
    """The results of a run until they are whole: a folder ``.partial`` within that of the results.

    Nothing leaves it before all sound is rendered; its journal says how much of the sound is on the disk.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._place = folder, folder / ".partial"
        self._journal = Journal(self._place)
        self._resume = False

    def check(self, options: argparse.Namespace) -> None:
        """Refuse a folder that holds results, unless the user says what becomes of them.

        Raises
        ------
        InputError
            If it does; the message names the options.
        """
        self._resume = options.resume
        if options.resume and options.force:
            raise InputError("--resume", "must be given without --force, which begins anew")
        if options.force or options.resume:
            return
        if self._journal.exists():
            raise InputError(
                "--output",
                f"must hold no unfinished run, but {self._place} is one (--resume goes on, --force begins anew)",
            )
        if (self._folder / "scene.toml").exists():
            raise InputError(
                "--output",
                f"must hold no results yet, but {self._folder / 'scene.toml'} exists (--force writes over)",
            )

    def already_whole(self, text: str) -> bool:
        """Return whether the folder holds the results of this very scene.

        Raises
        ------
        InputError
            If it holds those of another one.
        """
        finished = self._folder / "scene.toml"
        if self._journal.exists() or not finished.exists():
            return False
        try:
            old = tomllib.loads(finished.read_text("utf-8"))
        except ValueError as error:
            raise InputError("--resume", f"must find its own results, but {finished} is no scene file") from error
        difference = first_difference(old, tomllib.loads(text))
        if difference is not None:
            raise InputError("--resume", f"must find its own results, but in {finished} {difference}")
        return True

    @contextmanager
    def opened(self) -> Iterator[Path]:
        """Yield the folder of unfinished results, and delete it when the block ends well.

        Otherwise a note on the exception says what is kept of the sound; nothing is where there is none.
        """
        self._place.mkdir(parents=True, exist_ok=True)
        with locked(self._place / "lock", "--output"):
            try:
                yield self._place
            except BaseException as error:
                if not self._journal.exists():
                    shutil.rmtree(self._place, ignore_errors=True)
                elif not isinstance(error, InputError):  # which says itself what can be done
                    error.add_note(f"what was rendered is kept in {self._place}: --resume goes on with it")
                raise
            shutil.rmtree(self._place)

    def render(self, plan: Plan, store: SoundStore, identity: dict[str, Any]) -> None:
        """Render into a store, from the beginning or from where the journal says.

        Raises
        ------
        InputError
            If what is to be gone on with is another run; the message says in what it differs.
        """
        receiving, done = Receiving(plan), 0
        if self._resume and self._journal.exists():
            old, done, state = self._journal.load()
            difference = first_difference(old, json.loads(json.dumps(identity)))
            if difference is not None:
                raise InputError("--resume", f"must go on with the same run, but {difference} (--force begins anew)")
            receiving.restore(state)
        else:
            self._journal.discard()
            store.create()
        if done == plan.samples:
            return
        store.open()
        try:
            with progress("rendering", plan.path_count * plan.samples) as advance:
                advance(plan.path_count * done)
                noted = -math.inf
                for start, samples in render_chunks(plan, first=done, receiving=receiving):
                    store.write(start, samples)
                    done = start + samples.shape[1]
                    if done == plan.samples or time.monotonic() - noted > _PERIOD:
                        store.to_disk()
                        self._journal.save(identity, done, receiving.state())
                        noted = time.monotonic()
                    advance(plan.path_count * samples.shape[1])
        finally:
            store.close()

    def move(self, store: SoundStore) -> list[Path]:
        """Move whole sound to where it belongs; return its paths."""
        made = [self._folder / path.name for path in store.paths]
        for path, final in zip(store.paths, made, strict=True):
            if path.exists():  # else it was moved before the run was killed
                if final.is_dir():
                    shutil.rmtree(final)
                path.replace(final)
        to_disk(self._folder)
        return made


def run_identity(file: SceneFile, paths: PathSet, plan: Plan, options: dict[str, Any]) -> dict[str, Any]:
    """Return all that the samples of a run depend on, in texts and numbers.

    Parameters
    ----------
    file : SceneFile
        With the contents of the files that it names.
    paths : PathSet
        Their digest stands for the search.
    plan : Plan
        Says the device, and what was resolved.
    options : dict
        Of the command line.
    """
    import scipy

    import clsim

    device = "none"
    if plan.engine == "opencl":
        info, _ = find_device(plan.device)
        device = f"{info.name} ({info.platform}, {info.version})"
    content = file.model.model_dump(mode="json", exclude_none=True, warnings=False)
    content["render"] |= {
        "engine": plan.engine, "duration": plan.duration, "samples": plan.samples, "chunk": plan.chunk,
    }  # fmt: skip
    content["render"].pop("device", None)
    found = hashlib.sha256()
    for name in ("source", "receiver", "walls", "image_matrix", "image_offset", "start", "end"):
        found.update(np.ascontiguousarray(getattr(paths, name)).tobytes())
    filters = hashlib.sha256()  # linear algebra on another number of threads may round otherwise
    for emission in plan.emissions:
        for array in (emission.basis.projection, emission.filters, *(bank.taps for bank in emission.banks)):
            filters.update(np.ascontiguousarray(array).tobytes())
    return {
        "scene": content,
        "contents": {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in referenced_files(file)},
        "device": device,
        "options": options,
        "versions": {"clsim": clsim.__version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "paths": found.hexdigest(),
        "filters": filters.hexdigest(),
    }
