"""Rendered bits stay: scenes of every leg, vertex, medium and method against hashes of `benchmarks/frozen_hashes.json`.

A change that means to move bits writes the hashes anew (`python benchmarks/frozen.py . --freeze`) and says so in its
message; a change that does not is found here.
"""

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


def load_frozen() -> ModuleType:
    spec = importlib.util.spec_from_file_location("frozen", ROOT / "benchmarks" / "frozen.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


frozen = load_frozen()
REFERENCE = json.loads(frozen.FROZEN.read_text("utf-8"))
QUICK = [name for name, known in REFERENCE["scenes"].items() if known["seconds"] < 7.0]


@pytest.mark.exhaustive
@pytest.mark.skipif(
    frozen.machine() != REFERENCE["made_with"],
    reason=f"hashes are of another processor or other libraries: {REFERENCE['made_with']}",
)
@pytest.mark.parametrize("half", [0, 1])
def test_bits_are_as_they_were(half: int, tmp_path: Path, device: None) -> None:
    names = QUICK[half::2]
    found: dict[str, object] = {}
    for name, arrays, _ in frozen.computed(ROOT, tmp_path, names):
        found[name] = arrays if isinstance(arrays, str) else frozen.grouped(arrays)
    expected = {n: {k: v for k, v in REFERENCE["scenes"][n].items() if k != "seconds"} for n in names}
    assert found == expected
