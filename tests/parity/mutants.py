"""Kernels with one thing wrong, all of a program in one text: building is what takes time, and this one is built once.

A mutant is a fragment of the text and what replaces it. What differs is found by tokens and widened to the expression
that holds it, and the expression becomes a choice between both, by a number that every launch gives as the global
offset of its third dimension; kernels that use this dimension get its index without the offset. The kernel alone asks for it, and hands it to every function:
runtimes inline what asks where a work-item is into each of their ways of launching. Mutants of preprocessor lines are
texts of their own.
"""

from __future__ import annotations

import re
from bisect import bisect
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import TYPE_CHECKING, Any

from clsim.errors import ClsimError
from clsim.opencl import launch as compiler_module

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import pytest

_TOKEN = re.compile(
    r"(?P<comment>//[^\n]*)|(?P<head>^[ \t]*#[ \t]*define[ \t]+\w+(\([^)]*\))?)|(?P<directive>^[ \t]*#[^\n]*)"
    r"|(?P<word>[A-Za-z_]\w*|\d[\w.]*)|(?P<operator>\+\+|--|&&|\|\||->|<<|>>|[-+*/%&|^<>=!]=|[^\s\\])|(?P<end>(?<!\\)\n)",
    re.MULTILINE,
)  # fmt: skip
# Of these a test runs so little that optimising takes longer.
_LONG = {"tracks", "pair_tracks", "intervals", "edge_intervals"}
_WITHOUT_OFFSET = "get_global_id(2)", "(get_global_id(2) - get_global_offset(2))"
_CHOICE = """size_t __attribute__((overloadable, const)) get_global_offset(uint);
#define MUTANT(number) (mutant == number)
"""
# Heads of functions; the macro behind one hands the number on at every call, and passes over a name in brackets.
_FUNCTION = re.compile(
    r"^(static (?:inline )?(?:__attribute__\(\(\w+\)\) )?[^(;={]*?)\b(\w+)(\([^;{}]*?)\)(\s*)\{", re.MULTILINE
)
_HANDED_ON = r"\1(\2)\3, const size_t mutant)\n#define \2(...) \2(__VA_ARGS__, mutant)\n\4{"
_KERNEL = re.compile(r"^__kernel [^{]*\{", re.MULTILINE)
_OPEN, _CLOSE = dict(zip("([{", ")]}", strict=True)), set(")]}")
_ASSIGN = {"=", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^="}
_HEADS = {"if", "for", "while"}


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    start: int
    end: int


class Mutants:
    """A program with all of its mutants, one of which is chosen at a time.

    Parameters
    ----------
    program : str
        Its name.
    mutants : mapping of str to (str, str)
        By name: what stands once in the text of the program, and what replaces it.
    optimised : bool
        Whether they run so much that optimising pays.

    Raises
    ------
    ValueError
        If a fragment does not stand there exactly once.
    """

    def __init__(self, program: str, mutants: Mapping[str, tuple[str, str]], *, optimised: bool = False) -> None:
        self.program, self._text = program, compiler_module.kernel_source(program).replace(*_WITHOUT_OFFSET)
        self._optimised = optimised
        lost = [name for name, (old, _) in mutants.items() if self._text.count(old) != 1]
        if lost:
            raise ValueError(f"program {program}: not exactly once in its text is what the mutants {lost} change")
        tokens = _tokens(self._text)
        self._alone, self._number, changes = {}, {}, []
        for number, (name, (old, new)) in enumerate(mutants.items(), start=2):  # 1 is none of them
            start = self._text.index(old)
            edits = list(_edits(self._text, start, start + len(old), new))
            regions, mutated = _regions(self._text, tokens, edits), self._text.replace(old, new)
            if regions and _same_words(_edited(self._text, 0, len(self._text), sorted(regions)), mutated):
                self._number[name] = number
                changes += [(*region, number) for region in regions]
            else:
                self._alone[name] = mutated
        functions = _FUNCTION.sub(_HANDED_ON, _joined(self._text, changes))
        self._together = _CHOICE + _KERNEL.sub(r"\g<0>\n    const size_t mutant = get_global_offset(2);", functions)
        self.chosen: str | None = None

    def __iter__(self) -> Iterator[str]:
        """Choose one after the other, each under its name."""
        for name in (*self._number, *self._alone):
            self.chosen = name
            yield name
        self.chosen = None

    def unseen(self, agree: Callable[[], bool]) -> list[str]:
        """Return those under which a search agrees all the same; it need not end under others."""
        found = []
        for name in self:
            try:
                if agree():
                    found.append(name)
            except ClsimError:  # the search did not end
                pass
        return found

    def play(self, patch: pytest.MonkeyPatch) -> None:
        """Let the program be built with its mutants from here on."""
        original, tried = compiler_module.kernel_source, compiler_module.TriedKernel
        build = compiler_module.Compiler._build

        def source(program: str) -> str:
            if program != self.program:
                return original(program)
            return self._alone.get(self.chosen or "", self._together)

        def launched(kernel: Any, trial: Any) -> Any:
            return tried(kernel if kernel.function_name != self.program else _Chosen(self, kernel), trial)

        def built(compiler: Any, program: str, text: str, options: list[str]) -> Any:
            hasty = program == self.program and program in _LONG and not self._optimised
            more = ["-cl-opt-disable"] if hasty else []
            return build(compiler, program, text, [*options, *more])

        patch.setattr(compiler_module, "kernel_source", source)
        patch.setattr(compiler_module.Compiler, "_build", built)
        patch.setattr(compiler_module, "TriedKernel", launched)

    def number(self) -> int:
        """Return the number of the chosen mutant; drivers may build launches without an offset apart, so never 0."""
        return self._number.get(self.chosen or "", 1)


class KeptEngines:
    """Engines by what is rendered, each kept while the text of its kernels stays: tables are made and uploaded once."""

    def __init__(self) -> None:
        self._kept: dict[Any, tuple[list[str], Any]] = {}

    def engine(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the engine of a key, made anew if kernels have another text than when it was made."""
        texts = [compiler_module.kernel_source(name) for name in ("branches", "tracks", "render")]
        if key not in self._kept or self._kept[key][0] != texts:
            self._kept[key] = texts, make()
        return self._kept[key][1]

    def forget(self, key: Any) -> None:
        """Keep the engine of a key no longer: one that gave up."""
        del self._kept[key]


class _Chosen:
    """A kernel that is launched with the number of a mutant."""

    def __init__(self, mutants: Mutants, kernel: Any) -> None:
        self._mutants, self._kernel = mutants, kernel

    def __call__(self, queue: Any, size: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        ones = (1,) * (3 - len(size))
        offset = (0, 0, self._mutants.number())
        return self._kernel(queue, size + ones, group + ones, *arguments, global_offset=offset)


def _tokens(text: str) -> list[_Token]:
    """Return the tokens of a program, no comments; ends of lines only behind macros."""
    found, in_macro = [], False
    for match in _TOKEN.finditer(text):
        if match.lastgroup == "comment" or (match.lastgroup == "end" and not in_macro):
            continue
        in_macro = match["head"] is not None or (in_macro and match["end"] is None)
        found.append(_Token(match[0], match.start(), match.end()))
    return found


def _same_words(text: str, other: str) -> bool:
    """Compare the tokens of two texts in all lines between the first and the last that differ."""
    a, b = text.splitlines(), other.splitlines()
    first = _common(a, b)
    while first > 0 and a[first - 1].endswith("\\"):  # all of a macro, in which ends of lines may be tokens
        first -= 1
    last = _common(a[first:][::-1], b[first:][::-1])
    one, two = (_tokens("\n".join([*lines[first : len(lines) - last], ""])) for lines in (a, b))
    return [t.text for t in one] == [t.text for t in two]


def _common(a: list[str], b: list[str]) -> int:
    """Return the number of equal lines at the beginning."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def _edits(text: str, start: int, end: int, new: str) -> Iterator[tuple[int, int, str]]:
    """Return the differences as (start, end, replacement) in the text; tokens are never split."""
    while start > 0 and _is_word(text[start - 1 : start + 1]):  # the fragment begins or ends within a word
        start, new = start - 1, text[start - 1] + new
    while _is_word(text[end - 1 : end + 1]):
        end, new = end + 1, new + text[end]
    before, after = [list(_TOKEN.finditer(t)) for t in (text[start:end], new)]
    same = SequenceMatcher(None, [m[0] for m in before], [m[0] for m in after], autojunk=False)
    for kind, a, b, c, d in same.get_opcodes():
        if kind != "equal":
            at = before[a].start() if a < len(before) else end - start
            yield (
                start + at,
                start + (before[b - 1].end() if b > a else at),
                new[after[c].start() : after[d - 1].end()] + " " if d > c else "",
            )


def _is_word(pair: str) -> bool:
    return len(pair) == 2 and all(c.isalnum() or c in "_." for c in pair)


def _regions(text: str, tokens: list[_Token], edits: list[tuple[int, int, str]]) -> list[tuple[int, int, str]]:
    """Return the expressions that hold the edits, as (start, end, what they become); none if there are no such."""
    found: dict[tuple[int, int], str] = {}
    for start, end, _ in edits:
        region = _expression(text, tokens, start, end, edits)
        if region is None:
            return []
        found[region] = _edited(text, *region, edits)
    return [(*r, new) for r, new in found.items() if not any(o != r and o[0] <= r[0] and r[1] <= o[1] for o in found)]


def _edited(text: str, start: int, end: int, edits: list[tuple[int, int, str]]) -> str:
    for first, last, new in reversed(edits):
        if start <= first and last <= end:
            text, end = text[:first] + new + text[last:], end + len(new) - (last - first)
    return text[start:end]


def _expression(
    text: str, tokens: list[_Token], start: int, end: int, edits: list[tuple[int, int, str]]
) -> tuple[int, int] | None:
    """Return the smallest expression, by its places in the text, that holds a part of it and is one when edited, too."""
    first = bisect(tokens, start, key=lambda t: t.end)  # tokens that the part touches: none for what is put between two
    last = bisect(tokens, end - 1, key=lambda t: t.start) if end > start else first
    while (
        first >= 0 and last <= len(tokens) and not {t.text.lstrip(" \t")[0] for t in tokens[first:last]} & set(";{}#")
    ):
        a, b = _left(tokens, first), _right(tokens, last)
        region = tokens[a].start, tokens[b - 1].end
        (opened, closed, parted), became = _balance(tokens[a:b]), _balance(_tokens(_edited(text, *region, edits)))
        if b > a and not (opened or closed or parted or any(became)):
            return region
        first, last = a - (closed > 0 or not opened), b + (opened > 0 or not closed)  # with the brackets that it lacks
    return None


def _balance(tokens: list[_Token]) -> tuple[int, int, bool]:
    """Return the numbers of unclosed and of unopened brackets in tokens, and a flag for a separator."""
    opened, closed, parted = 0, 0, False
    for token in tokens:
        if token.text in _CLOSE:
            opened, closed = max(opened - 1, 0), closed + (opened == 0)
        opened += token.text in _OPEN
        parted |= opened == 0 and token.text in {",", ";"}
    return opened, closed, parted


def _left(tokens: list[_Token], i: int) -> int:
    """Return the first token of what reaches up to token `i`: back to a bracket, a separator or an assignment."""
    while i > 0:
        text = tokens[i - 1].text
        if (
            text in _OPEN
            or text in _ASSIGN
            or text in {",", ";", "}", "return", "else", "\n"}
            or text.lstrip().startswith("#")
        ):
            break
        if text in _CLOSE:
            depth, j = 1, i - 1
            while depth:
                j -= 1
                depth += (tokens[j].text in _CLOSE) - (tokens[j].text in _OPEN)
            if tokens[j - 1].text in _HEADS:
                break
            i = j
        else:
            i -= 1
    return i


def _right(tokens: list[_Token], i: int) -> int:
    """Return the token behind what begins before token `i`: on to a bracket that closes, or a separator."""
    depth = 0
    while i < len(tokens):
        text = tokens[i].text
        if depth == 0 and (text in _CLOSE or text in {",", ";", "\n"} or text.lstrip().startswith("#")):
            break
        depth += (text in _OPEN) - (text in _CLOSE)
        i += 1
    return i


def _joined(text: str, changes: list[tuple[int, int, str, int]]) -> str:
    """Return the text in which every changed expression is a choice; one within another is chosen within it."""

    def part(start: int, end: int, within: list[tuple[int, int, str, int]]) -> str:
        out, at = [], start
        while within:
            first, last = within[0][0], max(w[1] for w in within if w[0] == within[0][0])
            here = [w for w in within if w[:2] == (first, last)]
            inner = part(first, last, [w for w in within if first <= w[0] < last and w not in here])
            void = any(not new.strip() for _, _, new, _ in here)
            choices = "".join(f"MUTANT({number}) ? {_grouped(new, void)} : " for _, _, new, number in here)
            out += [text[at:first], f"({choices}{_grouped(inner, void)})"]
            at, within = last, [w for w in within if w[0] >= last]
        return "".join((*out, text[at:end]))

    return part(0, len(text), sorted(changes))


def _grouped(expression: str, void: bool) -> str:
    return f"(void)({expression if expression.strip() else 0})" if void else f"({expression})"
