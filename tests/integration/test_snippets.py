"""Every snippet of README and of docs runs as it stands, page by page, in a process of its own."""

from pathlib import Path

import pytest
from exhaustive import few
from snippets import PAGES, ROOT, problem_of, run_page, snippets


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("page", few([page for page in PAGES if snippets(page)]), ids=lambda page: page.name)
def test_the_snippets_of_a_page_run(page: Path, tmp_path: Path) -> None:
    assert problem_of(run_page, page, tmp_path) == ""


def test_the_landing_page_gets_from_files_to_sound_truth_and_plot_in_15_lines() -> None:
    ((kind, text),) = snippets(ROOT / "docs" / "index.md")
    assert kind == "python"
    assert len([line for line in text.splitlines() if line]) <= 15
    for call in ("MeshRoom.from_file", "Trajectory.from_file", ".save(", "direct_path(", ".savefig("):
        assert call in text
