"""The page "Measured rooms": tables of what was measured and what clsim finds, and two pictures of each room."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.measured.rooms import Aim, MeasuredRoom, MeasuredState
from clsim.measured.simulated import Simulated, mean_difference, noticeable
from clsim.version import __version__

UNITS = {  # of pages: factor and unit
    "t30": (1.0, "s"), "t20": (1.0, "s"), "edt": (1.0, "s"), "d50": (100.0, "%"), "c80": (1.0, "dB"),
    "ts": (1000.0, "ms"), "g": (1.0, "dB"), "lf": (100.0, "%"), "lfc": (100.0, "%"), "iacc": (1.0, ""),
}  # fmt: skip
_NAMES = {"ts": "Ts"}
_WIDTH = 100  # of the page's lines


@dataclass(frozen=True, slots=True, eq=False)
class Validated:
    """A measured room and what clsim found for each of its states."""

    room: MeasuredRoom
    found: tuple[Simulated, ...]

    def states(self) -> Iterator[tuple[MeasuredState, Simulated]]:
        """Pair every state with what was found."""
        return zip(self.room.states, self.found, strict=True)


def provenance() -> str:
    """Version of clsim, and in a checkout the commit and its date."""
    root = Path(__file__).resolve().parents[2]

    def git(*words: str) -> str:
        try:
            done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError):
            return ""
        return done.stdout.strip()

    if not (root / "pyproject.toml").is_file():
        return f"clsim {__version__}"
    commit = git("log", "-1", "--format=commit %h of %cs", "--abbrev=10")
    changed = ", with changes" if git("status", "--porcelain", "--", "clsim", "kernels", "examples/measured") else ""
    return f"clsim {__version__}" + (f", {commit}{changed}" if commit else "")


def page_text(rooms: Sequence[Validated], seeds: Sequence[int]) -> str:
    """Text of the page in Markdown; pictures are beside it in ``pictures``."""
    head = Path(__file__).with_suffix(".md").read_text("utf-8")
    seeded = f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
    lines = [head, f"Written with {provenance()}; {seeded} of rays and noise.", ""]
    for one in rooms:
        lines += _room(one, len(seeds))
    return "\n".join(lines)


def picture_names(room: MeasuredRoom) -> list[str]:
    """Names of a room's pictures."""
    ranks = [f"{room.key}_ranks.png"] if any(state.participants for state in room.states) else []
    words = ["".join(letter if letter.isalnum() else "_" for letter in state.name) for state in room.states]
    return [f"{room.key}_{word}.png" for word in words] + ranks


def draw(one: Validated, folder: Path) -> None:
    """Draw parameters by band, a picture for each state, and mean differences among those of other programs."""
    room, panels = one.room, []
    for (state, found), name in zip(one.states(), picture_names(room), strict=False):
        parameters_picture(room, state, found, folder / name)
    for aim in room.aims:
        others = _others(aim, one)
        if others and aim.unit == "JND":
            title = f"{' and '.join(aim.states)}\n{', '.join(map(_word, aim.parameters))}\n{_range(aim)}"
            panels.append((title, _over_states(aim, one), np.array(others)))
    if panels:
        ranks_picture(panels, folder / picture_names(room)[-1], f"{room.name}: clsim among the participants")


def summary(one: Validated) -> list[str]:
    """Lines of the aims and what was reached, for the console."""
    lines = []
    for aim in one.room.aims:
        head = f"{one.room.name}, {' and '.join(aim.states)}: {_listed(aim)}"
        lines.append(f"{head}: {_value(aim, _over_states(aim, one))}, aim {_value(aim, aim.most)}")
    return lines


def _room(one: Validated, seeds: int) -> list[str]:
    """Section of a room."""
    room = one.room
    lines = [f"## {room.name}", "", fill(f"Source: {room.source}.", _WIDTH), "", *_aims(one, seeds)]
    lines += [*_items(room.notes), ""]
    for (state, found), name in zip(one.states(), picture_names(room), strict=False):
        lines += [f"### {room.name}, {state.name}", "", f"![Parameters by band, {state.name}](pictures/{name})", ""]
        lines += _table(room, state, found)
        notes = [" ".join(f"{part[0].upper()}{part[1:]}." for part in note.split("; ")) for note in found.notes]
        lines += ["Responses:", "", *_items(notes), ""] if notes else []
        missing = [_word(p) for p in state.mean if p not in found.values[0]]
        if missing:
            what = "was measured too, and is" if len(missing) == 1 else "were measured too, and are"
            lines += [f"{', '.join(missing)} {what} not compared: only means over all pairs are known.", ""]
    if len(picture_names(room)) > len(room.states):
        lines += [f"![Mean differences of all programs](pictures/{picture_names(room)[-1]})", ""]
    return lines


def _items(texts: Iterable[str]) -> list[str]:
    """List texts with bullets, in lines of the page's width."""
    return [fill(text, _WIDTH, initial_indent="- ", subsequent_indent="  ") for text in texts]


def _aims(one: Validated, seeds: int) -> list[str]:
    """Table of aims: what was reached, by seed, and where others are."""
    if not one.room.aims:
        return []
    lines = [
        "| aim | at most | clsim | single seeds | missed by | other programs: best, quartile, median |",
        "|---|---|---|---|---|---|",
    ]
    for aim in one.room.aims:
        reached = _over_states(aim, one)
        each = [_over_states(aim, one, seed) for seed in range(seeds)]
        others = _others(aim, one)
        theirs = ", ".join(_value(aim, x) for x in np.quantile(others, [0.0, 0.25, 0.5])) if len(others) else ""
        missed = _value(aim, reached - aim.most) if reached > aim.most else "–"
        lines.append(
            f"| {_listed(aim)}, {' and '.join(aim.states)} | {_value(aim, aim.most)} | {_value(aim, reached)} | "
            f"{', '.join(_value(aim, x) for x in each)} | {missed} | {theirs} |"
        )
    return [*lines, ""]


def _table(room: MeasuredRoom, state: MeasuredState, found: Simulated) -> list[str]:
    """Table of all parameters by band: measured, clsim, the mean difference, and that of the median participant."""
    has_others = bool(state.participants)
    eyring = "t20" in found.values[0]
    heads = ["", "Hz", "measured", "clsim", "clsim - measured", "mean JND"]
    heads += ["median participant - measured"] * has_others + ["Eyring"] * eyring
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name in found.values[0]:
        scale, unit = UNITS[name]
        wanted, got = state.mean[name], found.mean(name)
        apart = np.mean(np.abs(got - wanted) / noticeable(name, wanted), axis=1)
        theirs = [np.mean(v[name] - wanted, axis=1) for v in state.participants.values() if name in v]
        for b, frequency in enumerate(room.frequencies):
            difference = float(np.mean(got[b] - wanted[b]))
            cells = [(f"{_word(name)} ({unit})" if unit else _word(name)) if b == 0 else "", f"{frequency:.4g}"]
            cells += [f"{scale * x:.3g}" for x in (np.mean(wanted[b]), np.mean(got[b]))]
            cells += [f"{scale * difference:+.2g}", f"{apart[b]:.2f}"]
            if has_others:
                cells.append(f"{scale * float(np.median([x[b] for x in theirs])):+.2g}" if theirs else "")
            cells += [f"{found.eyring[b]:.3g}" if name in ("t20", "t30") else ""] * eyring
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


def _of(aim: Aim, room: MeasuredRoom, state: MeasuredState, values: dict[str, Floats]) -> float:
    """Value of an aim: the mean in JND, or the largest relative or absolute difference in a band."""
    bands = aim.bands(room)
    if aim.unit == "JND":
        return mean_difference(state, values, aim.parameters, bands)
    worst = []
    for name in aim.parameters:
        wanted = state.mean[name][bands].mean(axis=1)
        got = np.mean(values[name][bands], axis=1)
        worst.append(np.abs(100.0 * (got / wanted - 1.0) if aim.unit == "%" else got - wanted).max())
    return float(max(worst))


def _over_states(aim: Aim, one: Validated, seed: int | None = None) -> float:
    """Mean of what is reached over the aim's states, with parameters averaged over the seeds, or of one seed."""
    reached = []
    for state, found in one.states():
        if state.name in aim.states:
            mean = {name: found.mean(name) for name in found.values[0]}
            reached.append(_of(aim, one.room, state, mean if seed is None else found.values[seed]))
    return float(np.mean(reached))


def _others(aim: Aim, one: Validated) -> list[float]:
    """List values of an aim of other programs, in the mean over its states; those without a state are left out."""
    states = [state for state in one.room.states if state.name in aim.states]
    programs = [p for p in states[0].participants if all(p in state.participants for state in states)]
    return [float(np.mean([_of(aim, one.room, s, s.participants[p]) for s in states])) for p in programs]


def _listed(aim: Aim) -> str:
    """Parameters and frequencies of an aim, in words."""
    named = ", ".join(_word(p) for p in aim.parameters)
    return f"{named}, {_range(aim)}" + (f", {aim.remark}" if aim.remark else "")


def _range(aim: Aim) -> str:
    return f"{aim.low:g} to {aim.high:g} Hz" if aim.low < aim.high else f"{aim.high:g} Hz"


def _value(aim: Aim, value: float) -> str:
    return f"{value:.1f} %" if aim.unit == "%" else f"{value:.2f} {aim.unit}"


def _word(parameter: str) -> str:
    return _NAMES.get(parameter, parameter.upper())


_PANELS = 3
_CLSIM_COLOUR, _MEASURED_COLOUR, _OTHERS = "#c1272d", "#111111", "#9bb7cc"
_RANGE_DB = 60.0


def parameters_picture(room: MeasuredRoom, state: MeasuredState, found: Simulated, path: Path) -> None:
    """Draw means over pairs by band: measured parameters, clsim's, and those of other programs behind them."""
    from clsim.pictures import plots

    names, frequencies = list(found.values[0]), room.frequencies
    rows = -(-len(names) // _PANELS)
    figure = plots.empty_figure(10.0, 0.6 + 2.5 * rows)
    figure.suptitle(f"{room.name}, {state.name}: means over pairs", fontsize=13)
    every: Any = figure.subplots(rows, _PANELS, squeeze=False).ravel()
    for axes, name in zip(every, names, strict=False):
        scale, unit = UNITS[name]
        others = [scale * values[name].mean(axis=1) for values in state.participants.values() if name in values]
        for i, other in enumerate(others):
            label = None if i else f"{len(others)} other programs"
            axes.semilogx(frequencies, other, color=_OTHERS, lw=0.8, label=label)
        spread = scale * state.deviation[name].mean(axis=1) if name in state.deviation else None
        axes.errorbar(
            frequencies, scale * state.mean[name].mean(axis=1), spread, color=_MEASURED_COLOUR, marker="o", ms=4,
            lw=1.2, capsize=3, label="measured" if spread is None else "measured, with standard deviation",
        )  # fmt: skip
        own = scale * np.mean(found.mean(name), axis=1)
        axes.semilogx(frequencies, own, color=_CLSIM_COLOUR, marker="s", ms=4, lw=1.8, label="clsim")
        axes.set_title(_word(name), fontsize=11)
        axes.set_ylabel(unit)
        ticks = frequencies[:: max(1, len(frequencies) // 6)]
        axes.set_xticks(ticks, [f"{f:g}" if f < 1000 else f"{f / 1000:.3g}k" for f in ticks.round()])
        axes.minorticks_off()
        axes.grid(alpha=0.25, linewidth=0.6)
    for axes in every[len(names) :]:
        axes.axis("off")
    for axes in every[max(0, len(names) - _PANELS) : len(names)]:
        axes.set_xlabel("Hz")
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=10)
    plots.save_figure(figure, path)


def ranks_picture(panels: Sequence[tuple[str, float, Floats]], path: Path, title: str) -> None:
    """Draw clsim's mean difference among those of other programs, a panel each: title, clsim's, others' (n,)."""
    from clsim.pictures import plots

    figure = plots.empty_figure(10.0, 4.2)
    figure.suptitle(title, fontsize=13)
    every: Any = figure.subplots(1, len(panels), squeeze=False).ravel()
    for axes, (name, own, others) in zip(every, panels, strict=True):
        heights = np.append(others, own)
        order = np.argsort(heights, kind="stable")
        colours = [_CLSIM_COLOUR if i == len(others) else _OTHERS for i in order]
        axes.bar(np.arange(len(order)) + 1, heights[order], color=colours)
        place = int(np.flatnonzero(order == len(others))[0])
        axes.annotate("clsim", (place + 1, own), ha="center", va="bottom", color=_CLSIM_COLOUR, fontsize=11)
        for share, word in ((0.25, "quartile of the others"), (0.5, "their median")):
            level = float(np.quantile(others, share))
            axes.axhline(level, color="#555555", lw=0.8, ls="--" if share == 0.5 else ":", label=f"{word}, {level:.2f}")
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("rank")
        axes.set_ylim(0.0, 1.25 * heights.max())
        axes.legend(loc="upper left", fontsize=8)
    every[0].set_ylabel("mean difference (JND)")
    plots.save_figure(figure, path)


def comparison_picture(
    decays: Sequence[tuple[str, Floats, Floats]], times: Sequence[Floats], early: Sequence[Floats], paths: Floats,
    path: Path, title: str,
) -> None:  # fmt: skip
    """Draw decay curves by band and early levels over time."""
    # Shapes: decays (title, measured (n,) dB, simulated (m,) dB) at times (n,), (m,) s of measured and simulated;
    # early: measured (k,), simulated (k,) dB at times (k,) s, the last of them; paths (p,) s.
    from clsim.pictures import plots

    columns = 4
    rows = -(-len(decays) // columns)
    figure = plots.empty_figure(11.0, 3.2 + 2.4 * rows)
    figure.suptitle(title, fontsize=13, parse_math=False)
    grid = figure.add_gridspec(rows + 1, columns)
    for i, (name, *levels) in enumerate(decays):
        axes: Any = figure.add_subplot(grid[i // columns, i % columns])
        for level, time, colour, word in zip(
            levels, times, (_MEASURED_COLOUR, _CLSIM_COLOUR), ("measured", "simulated"), strict=False
        ):  # fmt: skip
            axes.plot(time[: len(level)], level, color=colour, lw=1.4, label=word)
        axes.set(title=name, ylim=(-_RANGE_DB, 2.0), xlabel="s", ylabel="dB" if i % columns == 0 else "")
        axes.grid(alpha=0.25, linewidth=0.6)
        if i == 0:
            axes.legend(fontsize=9)
    axes = figure.add_subplot(grid[rows, :])
    for level, colour, word in zip(early, (_MEASURED_COLOUR, _CLSIM_COLOUR), ("measured", "simulated"), strict=True):
        axes.plot(1e3 * times[-1], level, color=colour, lw=1.0, label=word, alpha=0.85)
    for delay in paths:
        axes.axvline(1e3 * delay, color="#1f77b4", lw=0.6, alpha=0.6, zorder=0)
    axes.plot([], [], color="#1f77b4", lw=0.8, label="delays of paths")
    axes.set(title="Early reflections", ylim=(-45.0, 3.0), xlabel="ms", ylabel="dB re largest")
    axes.set_xlim(float(1e3 * times[-1][0]), float(1e3 * times[-1][-1]))
    axes.legend(fontsize=9, ncols=3, loc="upper right")
    axes.grid(alpha=0.25, linewidth=0.6)
    plots.save_figure(figure, path)
