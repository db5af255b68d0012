"""The pictures of a run."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import warn
from clsim.output.path_plots import echogram_picture, history_picture
from clsim.pictures.envelope_plot import envelope_spectrogram
from clsim.pictures.plots import spectrogram_picture
from clsim.workflow.console import progress
from clsim.workflow.outputs import MOST_DRAWN, PICTURES, picture

if TYPE_CHECKING:
    from pathlib import Path

    from clsim.arrays import Floats
    from clsim.output.stores import SoundStore
    from clsim.pictures.spectrogram import Readable
    from clsim.render.plan import Plan
    from clsim.workflow.outputs import RunOutputs
    from clsim.workflow.pipeline import PlannedScene
    from clsim.workflow.result_folder import ResultFolder

_SHORT, _SWEEPS = 0.05, 8.0  # s, and band times duration, of pulses that are short sweeps
_LEAST_WINDOW = 32  # samples
_PURE, _MOST_CURVES = 0.02, 6  # band of a tone as a share of its frequency; lines of theory that are still told apart
_MOST_INSTANTS = 3000  # of lines in a picture, more than it has columns


def draw_pictures(
    planned: PlannedScene,
    times: Floats,
    store: SoundStore,
    results: ResultFolder,
    outputs: RunOutputs,
    missing: list[str],
) -> None:
    """Draw the missing pictures; one that fails is a warning, and the others are drawn.

    Shapes: times (T,) s.
    """
    left_out = len(outputs.receivers) - len(outputs.drawn)
    if left_out:
        print(f"pictures are of the first {MOST_DRAWN} receivers of {len(outputs.receivers)}", file=sys.stderr)
    with progress("drawing", len(outputs.drawn)) as advance:
        for r, name in enumerate(outputs.drawn):
            for kind in PICTURES:
                wanted = picture(name, kind)
                if wanted not in missing:
                    continue
                try:
                    _draw(kind, planned, times, store.row(results.folder, r), r, results.work / wanted)
                except Exception as error:  # of whatever draws: the sound is there
                    problem = " ".join(str(error).split())[:300] or type(error).__name__
                    warn(f"{wanted} could not be drawn: {problem}")
            advance(1)


def _draw(kind: str, planned: PlannedScene, times: Floats, sound: Readable, r: int, path: Path) -> None:
    plan = planned.plan
    title, rate = plan.tracks.receiver_names[r], plan.sampling_rate
    if kind == "paths":
        drawn = times[np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)]
        history_picture(planned.path_table(drawn, r), r, path)
    elif kind == "echogram":
        echogram_picture(planned.path_table(times[:1], r), r, 0, path)
    elif plan.carrier is None:
        spectrogram_picture(
            sound, rate, path, title=title, band=_shown_band(plan), unit=plan.units[r], segment=_sweep_window(plan),
            overlay=_theory(planned, times, r),
        )  # fmt: skip
    else:
        envelope_spectrogram(sound[0 : plan.samples], rate, plan.carrier, path, title=title)


def _sweep_window(plan: Plan) -> int | None:
    """Return the window in which a short sweep goes as far as the window resolves; None for other signals."""
    windows = []
    for filters in plan.source_filters:
        pulse = filters.signal.pulse
        low, high = pulse.band()
        if pulse.duration > _SHORT or (high - low) * pulse.duration < _SWEEPS:
            return None
        windows.append(2.0 * np.sqrt(pulse.duration / (high - low)) * plan.sampling_rate)
    return max(_LEAST_WINDOW, 2 ** round(np.log2(max(windows)))) if windows else None


def _theory(planned: PlannedScene, times: Floats, r: int) -> list[tuple[Floats, Floats, str]]:
    """Return frequencies over time of direct sound and first reflections, of a single tone heard by few paths."""
    sources = planned.plan.source_filters
    if len(sources) != 1:
        return []
    low, high = sources[0].signal.band()
    centre = sources[0].signal.centre_frequency
    if high - low > _PURE * centre:
        return []
    drawn = np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)
    table = planned.path_table(times[drawn])
    sounds = np.nan_to_num(np.abs(table.gain)).max(axis=1) > 0.0
    mine = np.flatnonzero((table.receiver == r) & (table.order <= 1) & sounds)
    if len(mine) > _MOST_CURVES:
        return []
    shifted = centre * np.where(table.heard, table.doppler_factor, np.nan)
    return [(table.times, shifted[p], table.name_way(p)) for p in mine]


def _shown_band(plan: Plan) -> tuple[float, float]:
    """Return the frequencies worth showing: those that hold nearly all energy, with a margin for Doppler."""
    low: float = np.inf
    high: float = 0.0
    for filters in plan.source_filters:
        frequencies, energy = filters.signal.energy_spectrum()
        share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
        low = min(low, float(frequencies[np.searchsorted(share, 1e-3)]))
        high = max(high, float(frequencies[np.minimum(np.searchsorted(share, 1.0 - 1e-3), len(frequencies) - 1)]))
    margin = max(0.15 * (high - low), 3.0 * plan.max_rate * high, 200.0)
    return max(0.0, float(low) - margin), min(0.5 * plan.sampling_rate, float(high) + margin)
