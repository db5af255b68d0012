"""Errors of default renderings against a float64 oracle: ``python benchmarks/default_accuracy.py [part of a name]``.

Writes default_accuracy.md where all scenes were measured.
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "physics"))


def main() -> None:
    """Measure the scenes of tests/physics/test_default_accuracy.py at their full length."""
    from default_cases import listed, measured

    part, lines = sys.argv[1] if len(sys.argv) > 1 else "", []
    for case in listed():
        if part not in case.name:
            continue
        begin = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = measured(case)
        lines.append(f"| {case.name} | {found.error_db:.1f} | {found.local_db:.1f} | {found.worst_at:.2f} s |")
        print(lines[-1], f"{time.process_time() - begin:.1f} s", flush=True)
    if not part:
        head = ["| scene | error, dB | worst 20 ms, dB | at |", "|---|---|---|---|"]
        (Path(__file__).parent / "default_accuracy.md").write_text("\n".join([*head, *lines]) + "\n", "utf-8")


if __name__ == "__main__":
    main()
