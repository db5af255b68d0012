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

    Parameters
    ----------
    planned : PlannedScene
        Whose paths are drawn.
    times : ndarray (T,)
        Those of the path table, s.
    store : SoundStore
        Of the sound, which is in its place.
    results : ResultFolder
        Where pictures are made.
    outputs : RunOutputs
        The receivers of which there are pictures.
    missing : list of str
        Names of results that are not there yet.
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
        spectrogram_picture(sound, rate, path, title=title, band=_shown_band(plan), unit=plan.units[r])
    else:
        envelope_spectrogram(sound[0 : plan.samples], rate, plan.carrier, path, title=title)


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
