"""From a scene file to its paths, the plan of rendering them and the recording: for commands and studies alike."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError, of_file, warn
from clsim.files.input_files import file_names
from clsim.output.raw_files import SampleFile
from clsim.output.stores import SoundStore, StoredSound, store_kinds
from clsim.paths.find_paths import find_paths
from clsim.paths.ground_truth import DirectPath, EchoTruth, body_truth, direct_path, scatterer_truth
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import PathTable
from clsim.render.options import RenderOptions
from clsim.render.plan import Plan, within_memory
from clsim.render.planning import plan_paths
from clsim.render.render import Rendering, render_chunks
from clsim.scene.scene import Scene
from clsim.scene_file.scene import SceneFile, completed_scene, referenced_files
from clsim.version import __version__
from clsim.workflow.console import Progress, no_progress
from clsim.workflow.result_folder import COMPLETED

LARGEST_TABLE = 2_000_000  # paths times instants
_OF_SCENE = {field.name for field in fields(Scene)}  # as the tables of a scene file are called


@dataclass(frozen=True, slots=True, eq=False)
class PlannedScene:
    """A scene file, its paths, and the plan of rendering them."""

    file: SceneFile  # what was read
    paths: PathSet  # all of its paths
    plan: Plan  # of rendering them as the file says

    def path_table(self, times: Floats, receiver: int | None = None) -> PathTable:
        """Return the table of all paths, or of those to one receiver, as they are rendered, by time of reception, s."""
        paths = self.paths if receiver is None else self.paths.at_receiver(receiver)
        return paths.table(times, self.plan.options.motion, self.plan.options.amplitude)

    def ground_truth(self, times: Floats) -> DirectPath:
        """Return the ground truth of the direct path, at times of reception, s."""
        return direct_path(self.paths, times, self.plan.options.motion)

    def echo_truths(self, times: Floats) -> tuple[EchoTruth, ...]:
        """Return the ground truth of scatterers and bodies, at times of reception, s."""
        scene, motion = self.paths.scene, self.plan.options.motion
        scattered = (scatterer_truth(scene, times, motion),) if scene.scatterers else ()
        return (*scattered, body_truth(scene, times, motion)) if scene.bodies else scattered

    def completed(self, folder: Path) -> str:
        """Return the text of the scene file with all defaults and choices, with file names relative to a folder."""
        return completed_scene(self.file, folder, duration=self.plan.duration, chunk=self.plan.chunk)

    def stored_sound(self, folder: Path) -> StoredSound:
        """Return the description of the sound for a store in a folder."""
        plan, receivers = self.plan, self.paths.scene.receivers
        positions = np.concatenate([receiver.trajectory.position(np.zeros(1)) for receiver in receivers])
        positions = np.repeat(positions, np.diff(plan.first_rows), axis=0)
        return StoredSound(
            plan.recorded, plan.units, positions, plan.sampling_rate, plan.samples, plan.chunk,
            self.completed(folder), __version__, plan.carrier,
        )  # fmt: skip


def plan_scene(file: SceneFile, progress: Progress = no_progress) -> PlannedScene:
    """Return the paths of a scene file and the plan of rendering them."""
    paths = find_scene_paths(file, progress)
    with _errors_within("render", file):
        options = RenderOptions(**file.render)
        what = "planning" if options.tail == "off" else "tracing rays"
        with progress(what, 1.0) as advance:
            return PlannedScene(file, paths, plan_paths(paths, options, shares(advance)))


def find_scene_paths(file: SceneFile, progress: Progress = no_progress) -> PathSet:
    """Return the paths of a scene file; parameters as in `plan_scene`."""
    try:
        with _errors_within("paths", file), progress("finding paths", 1.0) as advance:
            paths = find_paths(file.scene, **file.paths, progress=shares(advance))
    except MemoryError as error:
        raise InputError("paths.max_order", "must be smaller: there is not enough memory for so many paths") from error
    for i in np.setdiff1d(np.arange(len(file.scene.receivers)), paths.receiver):
        name = file.scene.receivers[i].name
        warn(f"receivers[{i}]: no path reaches {name!r}; its output is silent")
    return paths


@contextmanager
def _errors_within(table: str, file: SceneFile) -> Iterator[None]:
    """Name scene file and field in errors; fields that are not the scene's belong to `table`."""
    with of_file(file.name):
        try:
            yield
        except InputError as error:
            if re.split(r"[.[]", error.field)[0] in _OF_SCENE:
                raise
            raise error.within(table) from error


def table_times(plan: Plan, rate: float, field: str) -> Floats:
    """Return the times of tables and ground truth, s: ``k / rate``, fewer where tables would grow too large."""
    if not 0.0 < rate <= plan.sampling_rate:
        raise InputError(field, f"must be above 0 and at most {plan.sampling_rate:g} Hz, but is {rate:g} Hz")
    count = int(plan.duration * rate) + 1
    most = max(2, LARGEST_TABLE // max(plan.path_count, 1))
    if count <= most:
        return np.arange(count) / rate
    warn(
        f"{field}: {plan.path_count} paths at {rate:g} Hz are too much for one table; "
        f"{most} instants are written, {most / plan.duration:.3g} a second"
    )
    return np.linspace(0.0, (count - 1) / rate, most)


def check_table_size(plan: Plan, field: str, rule: str) -> None:
    """Raise an InputError of a field if a plan has too many paths for a table; `rule` states the requirement."""
    most = LARGEST_TABLE // 2
    if plan.path_count > most:
        raise InputError(field, f"{rule} for more than {most} paths, but there are {plan.path_count}")


def input_files(scene: Path, file: SceneFile) -> list[Path]:
    """Return all files that a scene is read from: its own, and those that it names."""
    return [scene, *referenced_files(file)]


def shares(advance: Callable[[float], None]) -> Callable[[float], None]:
    """Convert a callback of increments into one of the total share done."""
    done = 0.0

    def report(share: float) -> None:
        """Advance the bar by the increment since the last call."""
        nonlocal done
        advance(share - done)
        done = share

    return report


GROUND_TRUTH = "ground_truth.npz"
MOST_DRAWN = 16  # receivers
PICTURES = ("paths", "spectrogram", "echogram")  # of each, the first only where paths come and go


@dataclass(frozen=True, slots=True)
class RunOutputs:
    """Files that a run may write into its folder."""

    receivers: list[str]  # names of the receivers, as files are called
    sounds: list[str]  # names of receivers and arrays, as files of sound are called
    sound: list[str]  # files or folders of the sound
    table: str  # the path table; empty if none is wanted
    drawn: list[str]  # receivers whose pictures are drawn, by their names

    @classmethod
    def of(cls, file: SceneFile, store: str, table: str, *, pictures: bool) -> RunOutputs:
        """Return the outputs of a scene file for a kind of store and of table ("none" for no table)."""
        names = file_names(tuple(receiver.name for receiver in file.scene.receivers))
        sounds = file_names(tuple(dict.fromkeys(row for end in file.scene.receivers for row, _ in end.rows)))
        file_of_table = "" if table == "none" else f"paths.{table}"
        sound, drawn = store_kinds()[store].names(sounds), names[:MOST_DRAWN] if pictures else []
        return cls(names, sounds, sound, file_of_table, drawn)

    def beside_sound(self, changing: bool = True) -> list[str]:
        """Return the files made after the sound, the completed scene last; `changing`: paths come and go."""
        tables = [self.table, GROUND_TRUTH] if self.table else [GROUND_TRUTH]
        kinds = PICTURES if changing else PICTURES[1:]
        return [*tables, *(picture(name, kind) for name in self.drawn for kind in kinds), COMPLETED]

    def all(self) -> list[str]:
        """Return all files that may be written."""
        return [*self.sound, *self.beside_sound()]


def picture(receiver: str, kind: str) -> str:
    """Return the name of a picture of a receiver."""
    return f"{receiver}_{kind}.png"


def render_into(
    sinks: Sequence[SampleFile | SoundStore], plan: Plan, rendering: Rendering, first: int = 0
) -> Iterator[int]:
    """Render a plan into sinks, in bounded memory; yield the number of samples written after each chunk."""
    with within_memory(plan.largest_field, "rendering", plan.memory_bytes), ExitStack() as stack:
        for sink in sinks:
            sink.open()
            stack.callback(sink.close)
        for start, samples in render_chunks(plan, first=first, rendering=rendering):
            for sink in sinks:
                sink.write(start, samples)
            yield start + samples.shape[1]
