"""The tutorials, as notebooks of the site where it was built, run from top to bottom, each in a process of its own."""

from pathlib import Path

import pytest
from snippets import ROOT, problem_of, run_notebook

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_as_notebook_runs_top_to_bottom(tutorial: Path, tmp_path: Path) -> None:
    found = sorted((ROOT / "out" / "site").glob(f"_downloads/*/{tutorial.stem}.ipynb"))
    if not found:
        pytest.skip("the site is not built: make docs")
    assert problem_of(run_notebook, found[0], tmp_path) == ""
