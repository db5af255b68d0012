"""Shadows of several bodies in one line of sight: what one lets pass of the sound is what the next one shades."""

from __future__ import annotations

import math

import numpy as np

from clsim.acoustics.outline import Outline, counts_of_points, faded
from clsim.acoustics.silhouette import WITHIN, outline_field
from clsim.arrays import Complexes, Floats

LOUDEST_SHADE = 2.5  # behind a sphere on the axis 2.4 times the free field is heard


def shade(outline: Outline, wave: Floats, source: Floats, receiver: Floats) -> Complexes:
    """Pressure (n, F) behind a body over that without it, near its shadow; 1 elsewhere.

    Shapes: wave (F,) 1/m; source, receiver (n, 3) m, in the body's frame.

    Of bodies in a row the product of all shades is taken for what is left of the direct sound. That is right where all
    but one are far off the line of sight; else what the first diffracts is taken for a wave from the source itself. Our
    own derivation: screens in a row, of which each meets what the last one lets pass.
    """
    sight = receiver - source
    length = np.maximum(np.linalg.norm(sight, axis=1), 1e-30)
    before = -np.sum(source * sight, axis=1) / length
    nearer = np.minimum(before, length - before)
    between = faded(nearer / outline.largest, (1.0, 0.0))
    found = np.ones((len(source), len(wave)), dtype=np.complex128)
    rows = np.flatnonzero(between > 0.0)
    zone = np.sqrt(2.0 * math.pi * (before * (length - before) / length)[rows, None] / wave)
    weight = between[rows, None] * faded(
        outline.clearance(source[rows], receiver[rows])[:, None] / zone, (WITHIN, 2.0 * WITHIN)
    )
    some = np.flatnonzero(weight.any(axis=1))
    if not len(some):
        return found
    rows, weight = rows[some], weight[some]
    counts = counts_of_points(outline, float(wave.max(initial=0.0)), source[rows], receiver[rows])
    for count in np.unique(counts).tolist():
        alike = np.flatnonzero(counts == count)
        here = rows[alike]
        found[here] += weight[alike] * outline_field(outline, wave, source[here], receiver[here], count)[0]
    return found
