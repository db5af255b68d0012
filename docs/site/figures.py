"""Figures that tests measured: a table of them, and its place in the page of validation.

`make measured` runs the tests that note figures, and this file with the folder of their notes.
"""

import hashlib
import json
import re
import sys
from collections import defaultdict
from pathlib import Path

BEGIN = re.compile(r"<!-- written by make measured: ([0-9a-f]*) -->\n")
END = "<!-- end of what make measured writes -->"
HEAD = ["| test | claim | oracle | allowed | measured |", "|---|---|---|---|---|"]

Figures = dict[tuple[str, str], str]  # a row of the table, by test and claim


def noted(folder: Path) -> Figures:
    """Rows of the figures that tests noted in a folder: the range of each claim over all cases of its test."""
    cases = defaultdict(list)
    for path in sorted(folder.glob("*.json")):
        row = json.loads(path.read_text("utf-8"))
        cases[_cell(row["test"]), _cell(row["claim"])].append(row)
    return {key: _row(key, rows) for key, rows in cases.items()}


def table(figures: Figures) -> list[str]:
    """Lines of a table of figures."""
    return [*HEAD, *(figures[key] for key in sorted(figures))]


def written(page: str) -> tuple[Figures, str, str]:
    """Rows of the table in a page, the digest that was written beside it, and the one that it has."""
    begin = BEGIN.search(page)
    assert begin is not None
    text = page[begin.end() : page.index(END)]
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    return {_key(row): row for row in rows}, begin[1], digest(text)


def digest(text: str) -> str:
    """Digest of a table's text, by which an edit by hand is found."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def update(page: str, figures: Figures, tests: Path) -> str:
    """Page with new rows in its table; of tests that did not run, the old ones stay while their files are there."""
    old = {key: row for key, row in written(page)[0].items() if (tests / key[0]).exists()}
    text = "\n".join(["", *table({**old, **figures}), "", ""])
    begin = BEGIN.search(page)
    assert begin is not None
    head = f"<!-- written by make measured: {digest(text)} -->\n"
    return page[: begin.start()] + head + text + page[page.index(END) :]


def _row(key: tuple[str, str], rows: list[dict[str, object]]) -> str:
    unit = str(rows[0]["unit"])
    allowed, found = (sorted({float(f"{row[name]:.3g}") for row in rows}) for name in ("allowed", "measured"))
    oracle = _cell(str(rows[0]["oracle"]))
    return f"| `{key[0]}` | {key[1]} | {oracle} | {_span(allowed, unit)} | {_span(found, unit)} |"


def _span(values: list[float], unit: str) -> str:
    ends = [f"{values[0]:.3g}"] + [f"{values[-1]:.3g}"] * (len(values) > 1)
    return f"{' to '.join(ends)} {unit}".strip()


def _cell(text: str) -> str:
    return re.sub(r"[|\n]", " ", text).strip()


def _key(row: str) -> tuple[str, str]:
    test, claim = row.split(" | ")[:2]
    return test.strip("|` "), claim.strip()


if __name__ == "__main__":
    docs = Path(__file__).parents[1]
    page = docs / "validation.md"
    page.write_text(update(page.read_text("utf-8"), noted(Path(sys.argv[1])), docs.parent / "tests"), "utf-8")
