"""A process of its own that reads variables of a MATLAB file from its input and writes them as a .npz file."""

from __future__ import annotations

import io
import sys
from typing import Any

VERSION_73 = 3  # exit status for a file that SciPy does not read
_ADDRESSES = 2**31  # bytes, the process and its libraries included
_SECONDS = 60  # of computing


def main(largest: int, names: list[str]) -> int:
    """Read and write; return the exit status. Variables that are not asked for are only named."""
    import numpy as np
    from scipy.io import loadmat, whosmat

    _limit()
    file: Any = io.BytesIO(sys.stdin.buffer.read())
    try:
        there = whosmat(file)
        asked = [name for name, _, _ in there if name in names]
        if sum(16 * float(np.prod(shape, dtype=float)) for name, shape, _ in there if name in asked) > largest:
            raise ValueError(f"it holds more than {largest} bytes")
        variables = loadmat(file, variable_names=asked)
        arrays = {f"value{i}": np.asarray(variables[name]) for i, name in enumerate(asked)}
    except NotImplementedError:
        return VERSION_73
    except Exception as error:  # whatever a parser meets in a broken file
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    for name, array in zip(asked, arrays.values(), strict=True):
        if array.dtype.kind not in "biufcU":
            print(f"{name} holds no numbers", file=sys.stderr)
            return 1
    told: dict[str, Any] = {
        "names": np.array([name for name, _, _ in there], dtype=str),
        "asked": np.array(asked, dtype=str),
    }
    np.savez(sys.stdout.buffer, **(told | arrays))
    return 0


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
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
