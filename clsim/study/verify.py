"""Whether the arrays of a study can still be read: each chunk has a checksum."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.packages import check_packages
from clsim.study.member import STORE as STORE

if TYPE_CHECKING:
    from pathlib import Path


def changed_arrays(store: Path) -> tuple[list[str], int]:
    """List arrays of a store, or the store, whose chunks cannot be read or have other checksums; count all of them."""
    check_packages("folder", "zarr", "store", "zarr")
    import zarr

    paths = sorted(path.parent for path in store.rglob("zarr.json") if path.parent != store)
    changed, count = [], 0
    for path in paths:
        try:
            found = zarr.open(path, mode="r")
            if isinstance(found, zarr.Array):
                count += 1
                for part in range(found.nchunks):
                    found.get_block_selection(_block(found.cdata_shape, part))
        except (OSError, ValueError, RuntimeError, KeyError, TypeError):
            changed.append(f"{store.name}/{path.relative_to(store).as_posix()}")
    return changed, max(count, len(changed))


def _block(shape: tuple[int, ...], number: int) -> tuple[int, ...]:
    """Return the place of a chunk by its number."""
    place = []
    for size in reversed(shape):
        number, at = divmod(number, size)
        place.append(at)
    return tuple(reversed(place))
