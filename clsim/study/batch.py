"""Rendering many scenes one after another, in this process or on several, in their order."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from clsim.arrays import as_count, as_number
from clsim.errors import ClsimError, ClsimWarning, InputError, check_kind, in_one_line, warn
from clsim.paths.find_paths import find_paths
from clsim.paths.ground_truth import DirectPath, direct_path
from clsim.paths.options import PathOptions
from clsim.recording import Recording
from clsim.render.options import RenderOptions
from clsim.render.planning import plan_paths
from clsim.render.render import record
from clsim.scene.scene import Scene
from clsim.workflow.processes import Call, Dispatch, Row, Tasks, local_devices
from clsim.workflow.workers import Workers

_AHEAD = 2  # scenes that are taken for each worker: one that it renders, and the next


@dataclass(frozen=True, slots=True, eq=False)
class RenderedScene:
    """One scene of a batch.

    Attributes
    ----------
    index : int
        Place of the scene in the batch, from 0.
    recording : Recording
        Its sound, with the paths and the scene.
    truth : DirectPath
        Ground truth of the direct sound, by time of reception.
    """

    index: int
    recording: Recording
    truth: DirectPath


def render_batch(
    scenes: Iterable[Scene],
    sampling_rate: float,
    max_order: int,
    *,
    workers: int = 1,
    truth_rate: float = 100.0,
    paths: Mapping[str, Any] | None = None,
    **options: Any,
) -> Iterator[RenderedScene]:
    """Render many scenes, one after another or on several processes, in the order in which they are given.

    Parameters
    ----------
    scenes : iterable of Scene
        The scenes. A generator is asked for a scene when one is to be rendered: with processes for two of each
        process in advance.
    sampling_rate : float
        Sampling rate of the recordings, Hz.
    max_order : int
        Largest number of reflections.
    workers : int
        Processes of this machine; with 1 all is rendered in this process.
    truth_rate : float
        Instants of the ground truth per second, Hz.
    paths : mapping, optional
        Other options of `find_paths`, by name.
    **options
        As of `render`.

    Yields
    ------
    RenderedScene
        Index, recording and ground truth of each scene, with the same bits for any number of workers.

    Raises
    ------
    InputError
        If an argument breaks a rule, or a scene does: the field then begins with ``scenes[i]``. Scenes behind it are
        not rendered.
    DeviceError
        If there is no OpenCL device, or it fails.
    ClsimError
        If the process that renders a scene goes on dying.

    Warns
    -----
    ClsimWarning
        As `render`, with the scene's index.

    Notes
    -----
    Every process opens its device once and keeps built kernels and designed filters. Other processes are started anew:
    scripts then call this behind ``if __name__ == "__main__":``. They end with the iterator: when it is exhausted,
    closed, deleted or left by an error.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8))
    >>> tone = clsim.Signal.tone(1e3, 0.01, 16e3, fade=0.002)
    >>> ear = clsim.Receiver("ear", clsim.Trajectory.fixed((3.0, 2.0, 1.5)))
    >>> places = [(1.0, 1.0, 1.0), (1.0, 4.0, 1.0)]
    >>> talkers = [clsim.Source("talker", tone, clsim.Trajectory.fixed(place)) for place in places]
    >>> scenes = [clsim.Scene(room, clsim.Air(), [talker], [ear]) for talker in talkers]
    >>> for one in clsim.render_batch(scenes, 16e3, max_order=1, duration=0.03):
    ...     one.index, one.recording.samples.shape, (1e3 * one.truth.delay[0, 0, 0]).round(2)
    (0, (1, 480), np.float64(6.66))
    (1, (1, 480), np.float64(8.35))
    """
    workers = as_count("workers", workers, at_least=1)
    rate = as_number("truth_rate", truth_rate, above=0.0, at_most=1e6, unit="Hz")
    try:
        of_render = RenderOptions(sampling_rate, **options)
    except TypeError as error:  # in the words of the function that was called
        raise TypeError(str(error).replace("RenderOptions.__init__", "render_batch")) from None
    same = {"engine": of_render.engine, "device": of_render.device}
    how = _How(PathOptions(max_order, **same | dict(paths or {})), of_render, rate)
    check_kind("scenes", scenes, Iterable, "an iterable of Scene")
    numbered = enumerate(scenes)
    return _here(numbered, how) if workers == 1 else _by_processes(numbered, how, workers)


@dataclass(frozen=True, slots=True)
class _How:
    """Options that all scenes of a batch share."""

    search: PathOptions
    options: RenderOptions
    truth_rate: float


def _here(scenes: Iterator[tuple[int, Scene]], how: _How) -> Iterator[RenderedScene]:
    for index, scene in scenes:
        check_kind(f"scenes[{index}]", scene, Scene, "a Scene")
        yield _result(index, _row(how, index, scene))


def _by_processes(scenes: Iterator[tuple[int, Scene]], how: _How, workers: int) -> Iterator[RenderedScene]:
    tasks, dispatch, done, wanted = _BatchTasks(how), Dispatch([]), dict[int, Any](), 0

    def take() -> None:
        """Take scenes for all workers; those that come first are done first."""
        new = []
        while len(tasks.scenes) < _AHEAD * workers and (found := next(scenes, None)) is not None:
            tasks.scenes[found[0]] = _packed(*found)
            new.append(found[0])
        for index in reversed(new):
            dispatch.add(index)

    take()
    if not dispatch.left:
        return
    devices = local_devices() if how.options.engine == "opencl" and how.options.device is None else []
    with closing(Workers(workers).rows(dispatch, tasks, devices)) as rows:
        for index, row in rows:
            done[index] = row
            while wanted in done:
                found = _result(wanted, done.pop(wanted))
                del tasks.scenes[wanted]
                wanted += 1
                take()
                yield found


def _packed(index: int, scene: Scene) -> bytes:
    """Return a scene as it is sent to a process."""
    check_kind(f"scenes[{index}]", scene, Scene, "a Scene")
    try:
        return pickle.dumps(scene, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        problem = f"must be made of values that can be sent to processes, but {in_one_line(error)}; use workers=1"
        raise InputError(f"scenes[{index}]", problem) from error


def _row(how: _How, index: int, scene: Scene | bytes, device: str | None = None) -> Row:
    """Render a scene; return its result or its error, and the texts of its warnings. Workers call it, too."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClsimWarning)
        try:
            there: Scene = pickle.loads(scene) if isinstance(scene, bytes) else scene
            row: Row = {"found": _rendered(how, index, there, device)}
        except Exception as error:
            row = {"error": error}
    return row | {"warnings": [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]}


def _rendered(how: _How, index: int, scene: Scene, device: str | None) -> RenderedScene:
    options, search = how.options, how.search
    if device is not None:
        options, search = replace(options, device=device), replace(search, device=device)
    found = find_paths(scene, **{field.name: getattr(search, field.name) for field in fields(search)})
    plan = plan_paths(found, options)
    times = np.arange(int(plan.duration * how.truth_rate) + 1) / how.truth_rate
    return RenderedScene(index, record(plan), direct_path(found, times, options.motion))


def _result(index: int, row: Row) -> RenderedScene:
    """Return the result of a scene, with its warnings, or raise its error."""
    for text in row.get("warnings", ()):
        warn(f"scenes[{index}]: {text}")
    error = row.get("error")
    if error is None:
        found: RenderedScene = row["found"]
        found.recording.samples.flags.writeable = False
        return found
    if isinstance(error, InputError):
        raise error.within(f"scenes[{index}]") from error
    if isinstance(error, str | ClsimError):
        kind = ClsimError if isinstance(error, str) else type(error)
        raise kind(f"scenes[{index}]: {error}")
    error.add_note(f"while scenes[{index}] was rendered")
    raise error


class _BatchTasks(Tasks):
    """The scenes of a batch, as processes render them."""

    kind = "scene"
    loads = ("scipy.fft", "scipy.linalg", "pyopencl.invoker", __name__)

    def __init__(self, how: _How) -> None:
        self._how = how
        self.scenes: dict[int, bytes] = {}  # those that are taken and not handed on

    def call(self, number: int) -> Call:
        return _row, (self._how, number, self.scenes[number])

    def failed(self, number: int, error: BaseException) -> Row:
        """Return the row of a scene whose call raised an error."""
        return {"error": error}
