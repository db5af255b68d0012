"""The table of a study's members: what became of each, a line of JSON as soon as it is known."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import texts
from clsim.errors import in_one_line, warn
from clsim.files.atomic import safe_path
from clsim.output.stores import consolidate, write_zarr
from clsim.study.member import PARTIAL, STORE, as_row, discard, root_attributes, row_of_group

if TYPE_CHECKING:
    from pathlib import Path

    from clsim.study.file import Member

INDEX = "index.jsonl"


@dataclass(frozen=True, slots=True)
class MemberRow:
    """What became of a member."""

    member: int  # from 0
    parameters: dict[str, Any]  # values of what is varied, by its name
    status: str = "waiting"  # what became of it
    seconds: float = 0.0  # that it took; 0 while it waits
    error: str = ""  # why it failed
    warnings: tuple[str, ...] = field(default=())  # what it warned of
    device: str = ""  # openCL device that rendered it, by id and name


class Index:
    """Rows of all members, kept in a file that survives everything: it is appended to, and read leniently.

    A member counts as finished if its group is in the store and can be read, whatever the file says.
    """

    def __init__(self, folder: Path, members: tuple[Member, ...]) -> None:
        self._folder, self._path = folder, folder / INDEX
        self.rows = {m.number: MemberRow(m.number, m.parameters) for m in members}
        lines = self._path.read_bytes().splitlines() if self._path.exists() else []
        failed = [row for line in lines if (row := as_row(line)) and row["status"] == "failed"]
        for row in failed:
            if row["member"] in self.rows:
                self._take(row)
        for member in members:
            if (folder / STORE / member.name).exists():
                self._take_group(member)

    def _take_group(self, member: Member) -> None:
        """Take a member as finished, or as waiting if its group is broken; after a failure metrics are read, too."""
        group = self._folder / STORE / member.name
        row = row_of_group(group)
        if row is None or (self.rows[member.number].status == "failed" and isinstance(metrics_of(group), str)):
            message = f"member {member.number} is run again: what {group} holds is broken"
            warn(message)
            discard(group)
            self.rows[member.number] = MemberRow(member.number, member.parameters)
        else:
            self._take(row)

    @property
    def untouched(self) -> bool:
        """Whether nothing is known of any member."""
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
        """Note what became of a member, on the disk itself."""
        taken = self._take(row)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(_line(taken))
            file.flush()
            os.fsync(file.fileno())
        return taken

    def rewrite(self) -> None:
        """Write one line per member that is done with."""
        with safe_path(self._path) as temporary:
            lines = [_line(row) for row in self.rows.values() if row.status != "waiting"]
            temporary.write_text("".join(lines), "utf-8")


def _line(row: MemberRow) -> str:
    return json.dumps(asdict(row)) + "\n"


def create_store(folder: Path) -> None:
    """Make the store of a study, still without members, or what is broken of it."""
    import zarr

    root = folder / STORE / "zarr.json"
    try:
        good = isinstance(json.loads(root.read_bytes()), dict)
    except (FileNotFoundError, ValueError, RecursionError):
        good = False
    if not good:
        root.unlink(missing_ok=True)
        zarr.open_group(folder / STORE, mode="a", zarr_format=3, attributes=root_attributes())


def write_summary(folder: Path, index: Index) -> None:
    """Write what is known of all members into one group, stacked: parameters, status, seconds, metrics.

    Metrics of another shape than in the first finished member are left out; they stay in the members' groups. A member
    whose metrics cannot be read has failed.
    """
    import xarray

    stacked = _stacked(folder, index)
    rows = [index.rows[n] for n in sorted(index.rows)]
    summary = xarray.Dataset(
        {
            "status": ("member", texts(row.status for row in rows)),
            "seconds": ("member", np.array([row.seconds for row in rows])),
            "error": ("member", texts(row.error for row in rows)),
        },
        coords={"member": [row.member for row in rows]},
        attrs=root_attributes(),
    )
    for name in rows[0].parameters:
        column = _column([row.parameters[name] for row in rows])
        over = ("member", *(f"{name}_{i}" for i in range(column.ndim - 1)))
        summary.coords[name] = (over, column)
    for name, (over, array, coords) in stacked.items():
        summary[name] = (("member", *over), array)
        summary = summary.assign_coords({k: v for k, v in coords.items() if k in over})
    partial, final = folder / PARTIAL / "summary", folder / STORE / "summary"
    shutil.rmtree(partial, ignore_errors=True)
    write_zarr(summary, partial, "w-")
    consolidate(partial)
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
    import xarray

    try:
        metadata = json.loads((group / "zarr.json").read_bytes())
        arrays, names = metadata["consolidated_metadata"]["metadata"], metadata["attributes"].get("metrics", ())
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
    return stacked
