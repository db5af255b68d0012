"""Shadows of several bodies in one line of sight: what one lets pass of the sound is what the next one shades."""

from __future__ import annotations

import numpy as np

from clsim.acoustics.outline import Outline
from clsim.acoustics.silhouette import forward_share, outline_fields
from clsim.arrays import Complexes, Floats

LOUDEST_SHADE = 2.5  # behind a sphere on the axis 2.4 times the free field arrives


def shade(outline: Outline, wave: Floats, centre: float, source: Floats, receiver: Floats) -> Complexes:
    """Pressure (n, F) behind a body over that without it, near its shadow; 1 elsewhere.

    centre: wave number in the middle of the signal's band, 1/m.

    Shapes: wave (F,) 1/m; source, receiver (n, 3) m, in the body's frame.

    Of bodies in a row the product of all shades is taken for what is left of the direct sound. That is right where all
    but one are far off the line of sight; else what the first diffracts is taken for a wave from the source itself. Our
    own derivation: screens in a row, of which each meets what the last one lets pass.
    """
    found = np.ones((len(source), len(wave)), dtype=np.complex128)
    share = forward_share(outline, centre, source, receiver)
    for rows, about, _ in outline_fields(outline, wave, (source, receiver), np.flatnonzero(share)):
        found[rows] += share[rows] * about
    return found
