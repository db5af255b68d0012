"""The tutorials as notebooks of the site, where it was built: their code is the tutorials', and runs cell by cell.

The build ran that code, and ends where a tutorial fails.
"""

import json
import re
from pathlib import Path

import pytest
from exhaustive import few
from snippets import ROOT, problem_of, run_notebook

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))


def notebook_of(tutorial: Path) -> Path:
    found = sorted((ROOT / "out" / "site").glob(f"_downloads/*/{tutorial.stem}.ipynb"))
    if not found:
        pytest.skip("the site is not built: make docs")
    return found[0]


def code_of(tutorial: Path) -> list[str]:
    """Return a tutorial's code between its texts, which are its docstring and comments that begin with a line `# %%`."""
    _, _, text = tutorial.read_text("utf-8").split('"""\n', 2)
    parts = re.split(r"^# %%\n(?:#.*\n)*", text, flags=re.MULTILINE)
    return [part.strip() for part in parts]


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_notebook_has_the_code_of_its_tutorial(tutorial: Path) -> None:
    cells = json.loads(notebook_of(tutorial).read_text("utf-8"))["cells"]
    assert [c["cell_type"] for c in cells] == ["markdown", "code"] * (len(cells) // 2)
    assert ["".join(c["source"]).strip() for c in cells[1::2]] == code_of(tutorial), "older than it: make docs"


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("tutorial", few(TUTORIALS), ids=lambda path: path.stem)
def test_a_tutorial_as_notebook_runs_top_to_bottom(tutorial: Path, tmp_path: Path) -> None:
    assert problem_of(run_notebook, notebook_of(tutorial), tmp_path) == ""
