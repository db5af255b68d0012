"""Errors of default renderings against a float64 oracle: ``python benchmarks/default_accuracy.py [part of a name]``."""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "physics"))


def main() -> None:
    """Print the table."""
    from default_cases import listed, measured

    part = sys.argv[1] if len(sys.argv) > 1 else ""
    print(f"{'scene':44} {'error':>7} {'local':>7} {'at':>6} {'s':>6}")
    for case in listed():
        if part not in case.name:
            continue
        begin = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = measured(case)
            except Exception as error:
                print(f"{case.name:44} {type(error).__name__}: {error!s:.90}", flush=True)
                continue
        spent = time.perf_counter() - begin
        print(
            f"{case.name:44} {found.error_db:7.1f} {found.local_db:7.1f} {found.worst_at:6.2f} {spent:6.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
