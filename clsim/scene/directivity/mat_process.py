"""A process of its own that reads variables of a MATLAB file from its input and writes them as a .npz file."""

from __future__ import annotations

import io
import sys
from typing import Any

VERSION_73 = 3  # exit status for a file that SciPy does not read
_ADDRESSES = 2**31  # bytes, the process and its libraries included
_SECONDS = 60  # of computing


def main(largest: int, variable: str, names: list[str]) -> int:
    """Read and write; return the exit status. Other than the requested variables or fields are only listed by name."""
    import numpy as np

    _limit()
    try:
        content = _read(io.BytesIO(sys.stdin.buffer.read()), largest, variable, names)
    except NotImplementedError:
        return VERSION_73
    except Exception as error:  # whatever a parser meets in a broken file
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    np.savez(sys.stdout.buffer, **content)
    return 0


def _read(file: Any, largest: int, variable: str, names: list[str]) -> dict[str, Any]:
    """Return names of variables, structs and fields of one struct, and the requested arrays."""
    import numpy as np
    from scipy.io import loadmat, whosmat

    there = whosmat(file)
    structs = [name for name, _, kind in there if kind == "struct"]
    wanted = [name for name, _, _ in there if name in ([variable] if variable else names) and name not in structs]
    wanted += [variable] * (variable in structs)
    if sum(16 * float(np.prod(shape, dtype=float)) for name, shape, _ in there if name in wanted) > largest:
        raise ValueError(f"it holds more than {largest} bytes")
    found = {} if not wanted else loadmat(file, variable_names=wanted)
    content = {"names": np.array([name for name, _, _ in there], dtype=str), "structs": np.array(structs, dtype=str)}
    if variable in structs:
        struct = np.asarray(found[variable])
        content |= {"count": np.array(struct.size), "fields": np.array(struct.dtype.names or (), dtype=str)}
        found = {name: struct.ravel()[0][name] for name in struct.dtype.names or () if struct.size == 1}
    arrays = {name: np.asarray(found[name]) for name in names if name in found}
    for name, array in arrays.items():
        if array.dtype.kind not in "biufcU":
            raise ValueError(f"{name} holds no numbers")
    if sum(array.nbytes for array in arrays.values()) > largest:
        raise ValueError(f"it holds more than {largest} bytes")
    return content | {f"array {name}": array for name, array in arrays.items()}


def _limit() -> None:
    """Bound memory and time, and leave no core file, where the system can."""
    try:
        import resource
    except ImportError:
        return
    for which, bound in (("AS", _ADDRESSES), ("CPU", _SECONDS), ("CORE", 0)):
        limit = getattr(resource, f"RLIMIT_{which}")
        hard = resource.getrlimit(limit)[1]
        resource.setrlimit(limit, (bound if hard < 0 else min(bound, hard), hard))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2], sys.argv[3:]))
