"""Running a study on processes of this machine or on a Dask scheduler's workers, and the table of its members."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import texts
from clsim.errors import InputError, counted, in_one_line, of_file, warn
from clsim.files.atomic import locked, naming_full, remove_leftovers, safe_path, sha256_of
from clsim.output.columns import Columns, write_group, write_root
from clsim.output.raw_files import is_sealed, seal
from clsim.study import OF_WORKERS
from clsim.study.content import metrics_function
from clsim.study.file import DEFAULT_LIMIT, Member, Study, checked, load_study
from clsim.study.member import (
    INDEX,
    PARTIAL,
    ROOT_ATTRIBUTES,
    SETTINGS,
    STORE,
    Groups,
    MemberTasks,
    as_row,
    results_of,
    study_to_settings,
)  # fmt: skip
from clsim.study.shards import FOLDER as SHARDS
from clsim.study.shards import WAITING, Shards
from clsim.workflow.console import Progress, no_progress
from clsim.workflow.pieces import versions
from clsim.workflow.processes import Dispatch, local_devices, start_server
from clsim.workflow.result_folder import first_difference
from clsim.workflow.workers import Workers


@dataclass(frozen=True, slots=True)
class MemberRow:
    """Result of a member."""

    member: int  # from 0
    parameters: dict[str, Any]  # values of the varied fields, by name
    status: str = "waiting"  # result of the member
    seconds: float = 0.0  # that it took; 0 while it waits
    error: str = ""  # why it failed
    warnings: tuple[str, ...] = field(default=())  # texts of its warnings
    device: str = ""  # openCL device that rendered it, by id and name


class Index:
    """Rows of all members, in a file that is appended to; finished are those whose results can be read."""

    def __init__(self, folder: Path, members: tuple[Member, ...], results: Groups | Shards | None = None) -> None:
        self._folder, self._path = folder, folder / INDEX
        self.results = Groups(folder) if results is None else results
        self.rows = {m.number: MemberRow(m.number, m.parameters) for m in members}
        lines = self._path.read_bytes().splitlines() if self._path.exists() else []
        given = [row for line in lines if (row := as_row(line)) and row["member"] in self.rows]
        for row in given:
            if row["status"] == "failed":
                self._take(row)
        known = {row["member"]: row for row in given if row["status"] == "finished"}
        for member in members:
            if self.results.holds(member.number):
                self._take_results(member, known.get(member.number, {}))

    def _take_results(self, member: Member, known: dict[str, Any]) -> None:
        """Take a member as finished, or as waiting if its results are broken; after a failure metrics are read, too."""
        row, failed = self.results.row_of(member.number), self.rows[member.number].status == "failed"
        group = self._folder / STORE / member.name
        if row is None or (failed and isinstance(self.results, Groups) and isinstance(metrics_of(group), str)):
            where = f"what {group} holds" if isinstance(self.results, Groups) else "its archive"
            warn(f"member {member.number} is run again: {where} is broken")
            self.results.discard(member.number)
            self.rows[member.number] = MemberRow(member.number, member.parameters)
        else:
            self._take(known | row)

    @property
    def untouched(self) -> bool:
        """Test if no member has a result."""
        return all(row.status == "waiting" for row in self.rows.values())

    def _take(self, row: dict[str, Any]) -> MemberRow:
        number = int(row["member"])
        known = {name: row[name] for name in ("status", "seconds", "error", "device") if name in row}
        warned = tuple(row.get("warnings", ()))
        self.rows[number] = MemberRow(number, self.rows[number].parameters, **known, warnings=warned)
        return self.rows[number]

    def todo(self, retry: bool) -> list[int]:
        """Return the members to be run: those that wait, and those that failed if they are to be retried."""
        wanted = ("waiting", "failed") if retry else ("waiting",)
        return [row.member for row in self.rows.values() if row.status in wanted]

    def add(self, row: dict[str, Any]) -> MemberRow:
        """Append a member's result to the file, flushed to the disk."""
        taken = self._take(row)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(_line(taken))
            file.flush()
            os.fsync(file.fileno())
        self.results.decided(taken.member, self.rows)
        return taken

    def rewrite(self) -> None:
        """Write one line per member that is done with."""
        with safe_path(self._path) as temporary:
            lines = [_line(row) for row in self.rows.values() if row.status != "waiting"]
            temporary.write_text("".join(lines), "utf-8")


def _line(row: MemberRow) -> str:
    return json.dumps(asdict(row)) + "\n"


def create_store(folder: Path) -> None:
    """Create the store of a study without members, or repair its root."""
    store = folder / STORE
    if not is_sealed(store):
        write_root(store, ROOT_ATTRIBUTES)
        seal(store)


def write_summary(folder: Path, index: Index) -> None:
    """Write parameters, status, seconds and metrics, of the shapes of the first member, of all into one group."""
    stacked = _stacked(folder, index)
    rows = [index.rows[n] for n in sorted(index.rows)]
    summary = Columns(dict(ROOT_ATTRIBUTES))
    summary.add("member", "member", [row.member for row in rows])
    summary.add("status", "member", texts(row.status for row in rows))
    summary.add("seconds", "member", [row.seconds for row in rows])
    summary.add("error", "member", texts(row.error for row in rows))
    for name in rows[0].parameters:
        column = _column([row.parameters[name] for row in rows])
        summary.add(name, ("member", *(f"{name}_{i}" for i in range(column.ndim - 1))), column, coord=True)
    for name, (over, array, coords) in stacked.items():
        summary.add(name, ("member", *over), array)
        for key in coords.keys() & set(over):
            summary.add(key, coords[key].dims, coords[key].values, coords[key].attrs, coord=True)
    partial, final = folder / PARTIAL / "summary", folder / STORE / "summary"
    shutil.rmtree(partial, ignore_errors=True)
    write_group(summary, partial)
    seal(partial)
    shutil.rmtree(final, ignore_errors=True)
    partial.replace(final)


def _column(values: list[Any]) -> Any:
    """Return numbers, or equally long lists of them, as they are, and all else as texts."""
    try:
        column = np.array(values)
    except ValueError:  # lists of several lengths
        column = np.array([], dtype=object)
    if column.dtype.kind in "iuf":
        return column
    return texts(v if isinstance(v, str) else json.dumps(v) for v in values)


def metrics_of(group: Path) -> dict[str, Any] | str:
    """Return the metrics of a member, arrays of xarray by name, or why they cannot be read."""
    try:
        metadata = json.loads((group / "zarr.json").read_bytes())
        arrays, names = metadata["consolidated_metadata"]["metadata"], metadata["attributes"].get("metrics", ())
        if not names:
            return {}
        import xarray

        wanted = {*names, *(over for name in names for over in arrays[name].get("dimension_names", ()))}
        others = [name for name in arrays if name not in wanted]  # which are many, and take longer to open than these
        with xarray.open_zarr(group, chunks=None, drop_variables=others) as content:
            return {str(name): content[name].load() for name in names}
    except MemoryError:
        raise
    except Exception as error:  # of any kind: the packages below do not say which they raise for files that are broken
        return f"{group} cannot be read: {in_one_line(error)}"


def _stacked(folder: Path, index: Index) -> dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]:
    """Return dimensions, values (NaN where a member has none) and coordinates of every metric."""
    stacked: dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]] = {}
    others: dict[str, int] = {}
    for i, number in enumerate(sorted(index.rows)):
        if index.rows[number].status != "finished":
            continue
        metrics = metrics_of(folder / STORE / f"m{number:06d}")
        if isinstance(metrics, str):
            index.add({"member": number, "status": "failed", "error": metrics})
            continue
        for name, values in metrics.items():
            over = tuple(str(d) for d in values.dims)
            if name not in stacked:
                kind = np.complex128 if values.dtype.kind == "c" else np.float64
                empty = np.full((len(index.rows), *values.shape), np.nan, dtype=kind)
                stacked[name] = over, empty, {k: values.coords[k].variable for k in values.indexes}
            if stacked[name][0] == over and stacked[name][1].shape[1:] == values.shape:
                stacked[name][1][i] = values.values
            else:
                others.setdefault(name, number)
    for name, number in others.items():
        warn(f"summary: {name} is NaN for member {number} and others of another shape than the first one's")
    return stacked


def run_study(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    resume: bool = False,
    retry: bool = False,
    limit: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> tuple[MemberRow, ...]:
    """Render a scene many times with other values of some of its fields.

    Parameters
    ----------
    path : path-like
        Path of the study file.
    output : path-like
        Folder for the store ``study.zarr``, with a group per member and a group ``summary``, and the index
        ``index.jsonl``.
    resume : bool
        Go on with the same study in this folder: members that are finished are not run again.
    retry : bool
        The same, and run members that failed again.
    limit : int, optional
        Largest number of members, 1000 when left out.
    workers : int, optional
        Processes on this machine: one per GPU, else one per two cores when left out.
    scheduler : str, optional
        Address of a running Dask scheduler, for example ``"tls://10.0.0.1:8786"``, instead; its workers must see the
        output folder under the same path.
    progress : callable, optional
        Called with a text and a total for each stage of the work; returns a context manager that yields a function
        to be called with every amount of work that is done.

    Raises
    ------
    InputError
        If the study file, or a member's scene, breaks a rule; nothing was run then.
    DeviceError
        If a worker has no OpenCL device.
    OSError
        If the disk is full; what is finished stays.
    ClsimError
        If the scheduler is lost, or workers do not come back; what is finished stays.

    Notes
    -----
    Processes are started anew, so scripts call this behind ``if __name__ == "__main__":``. A worker that dies is
    replaced, and what it was at is done by another; a member whose workers go on dying fails, and no other one with it.
    What the store holds counts: a member counts as finished when its group is there, and groups appear whole.
    """
    progress = progress or no_progress
    doing = Workers(workers, scheduler)
    doing.check("study", "a study")
    if scheduler is None:
        start_server(OF_WORKERS)
    with of_file(path):
        study = load_study(path, DEFAULT_LIMIT if limit is None else limit)
    folder = Path(output).absolute()
    new = not (resume or retry)
    if new:
        _refuse_begun(folder)
    with of_file(path), progress("checking scenes", len(study.members)) as advance:
        files = checked(study, advance)
    if study.metrics:
        metrics_function(study.metrics, study.folder)
    folder.mkdir(parents=True, exist_ok=True)
    with naming_full(folder), locked(folder / ".lock", "--output"):
        begun = _begin(study, files, folder, new, retry)
        results = results_of(study, folder)
        index = Index(folder, study.members, results)
        dispatch = Dispatch(index.todo(retry))
        try:
            index.rewrite()
            _run(MemberTasks(study, folder), dispatch, index, doing, progress)
        except BaseException as error:
            if any(results.holds(member.number) for member in study.members):
                error.add_note(f"what is finished is kept in {folder}: --resume goes on with it")
            elif begun and index.untouched and (scheduler is None or not dispatch.begun):
                _undo(folder)
            raise
        if study.shards is None:
            write_summary(folder, index)
        else:
            for number in range(0, len(study.members), study.shards.members):  # a process may have died before
                results.decided(number, index.rows)
        index.rewrite()
        shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    return tuple(index.rows[n] for n in sorted(index.rows))


def _refuse_begun(folder: Path) -> None:
    """Raise if a folder holds a study, or other files of a study's names."""
    if (folder / SETTINGS).exists():
        raise InputError(
            "--output", f"must hold no study yet, but {folder} does (--resume goes on, --retry also with what failed)"
        )
    for name in (STORE, SHARDS, WAITING, INDEX, PARTIAL):
        if os.path.lexists(folder / name):
            raise InputError("--output", f"must not hold {name} that is of no study, but {folder} does")


def _begin(study: Study, files: set[Path], folder: Path, new: bool, retry: bool) -> bool:
    """Create the folder of a study, or check that it holds this very one; return True if it was created.

    retry: the module of the metrics may have changed, of which members that are run from now on know.
    """
    if new or not (folder / SETTINGS).exists():
        _refuse_begun(folder)  # another process may have made it meanwhile
    module = study.folder / f"{study.metrics.partition(':')[0]}.py"
    named = sorted(files | ({module} if study.metrics and module.exists() else set()))
    made_by = {
        "versions": versions(),
        "contents": {str(path): sha256_of(path) for path in named},
    }
    settings = json.loads(json.dumps(study_to_settings(study) | {"made_by": made_by}))
    path = folder / SETTINGS
    begun, changed = not path.exists(), False
    if not begun:
        advice = "choose another folder"
        try:
            old = json.loads(path.read_bytes())
        except (ValueError, RecursionError) as error:
            raise InputError("--resume", f"must go on with a study, but {path} is broken; {advice}") from error
        changed = retry and _takes(old, settings, module)
        difference = first_difference(old, settings)
        if difference is not None:
            raise InputError("--resume", f"must go on with the same study, but {difference}; {advice}")
        kept = sum(results_of(study, folder).holds(member.number) for member in study.members) if changed else 0
        if kept:
            warn(f"metrics of {counted(kept, 'finished member')} stay those of {module.name} before it changed")
    if begun or changed:
        with safe_path(path) as temporary:
            temporary.write_text(json.dumps(settings, indent=1), "utf-8")
    if study.shards is None:
        create_store(folder)
    for name in () if study.shards is None else (SHARDS, WAITING):
        (folder / name).mkdir(exist_ok=True)
        remove_leftovers(folder / name)
    shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    (folder / PARTIAL).mkdir()
    return begun


def _takes(old: Any, settings: dict[str, Any], module: Path) -> bool:
    """Take the present module of the metrics into old settings; return True if it was another one."""
    try:
        before, now = (each["made_by"]["contents"] for each in (old, settings))
        changed = before[str(module)] != now[str(module)]
        before[str(module)] = now[str(module)]
    except (KeyError, TypeError, AttributeError):  # none, or no settings of a study: the comparison refuses them
        return False
    return bool(changed)


def _undo(folder: Path) -> None:
    """Delete the output of `_begin`, because nothing could be run: the same command works once the reason is gone."""
    shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    for name in (INDEX, f"{STORE}/zarr.json", SETTINGS, ".lock"):
        (folder / name).unlink(missing_ok=True)
    for empty in (folder / STORE, folder / SHARDS, folder / WAITING, folder):
        with suppress(OSError):  # it holds something else
            empty.rmdir()


def _run(tasks: MemberTasks, dispatch: Dispatch, index: Index, workers: Workers, progress: Progress) -> None:
    """Run members on workers, and record their results."""
    if not dispatch.left:
        return
    devices = local_devices() if tasks.needs_device and workers.scheduler is None else []
    with (
        progress("members", dispatch.left) as advance,
        closing(workers.at_most(dispatch.left).rows(dispatch, tasks, devices)) as rows,
    ):
        for number, row in rows:
            index.add({"member": number} | row)
            advance(1.0)
