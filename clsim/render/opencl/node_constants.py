"""Constants of the programs of nodes, and the structures of kernels/nodes/path.h."""

from __future__ import annotations

import math

import numpy as np

from clsim.acoustics import fock, silhouette
from clsim.acoustics.capsule import CAP_FADE, FLATTEST, NEAR_JUNCTION
from clsim.acoustics.diffraction import AT_CORNER, END_TERMS, ON_BOUNDARY, ON_LINE
from clsim.acoustics.outline import NEAR_AXIS, NEAR_ROUNDS, NEAREST_END
from clsim.acoustics.scattering import ELONGATED, FAR, FOUND, LONGEST_STEP, OUTWARD_STEPS, PENUMBRA
from clsim.acoustics.sphere import LEFT_OUT
from clsim.paths.cubics import FACE_COLUMNS, POSE_COLUMNS
from clsim.paths.legs.events import BEYOND_LEG
from clsim.paths.vertices.edge_field import BOTH
from clsim.paths.vertices.scatterer_paths import PATIENCE

STATIC, MOVING = range(2)  # legs
NONE, EDGE, SCATTERER, SHADE = range(4)  # vertices
POINT, ELLIPSOID, CAPSULE, SPHERE = range(4)  # shapes of scatterers; from CAPSULE on fields have phases
END_CELLS = 128  # of the tables of ends of edges
NO_PATH = -1e6  # s, delay that reports that no path by a scatterer is found
_CONVERGED = 1e-5  # rad of a specular point: after the step its error, and that of its strength, is about the square
# Constants of every program of nodes, whatever its leg and vertex.
OF_DELAYS = {
    "STATIC": STATIC, "MOVING": MOVING, "EDGE": EDGE, "SCATTERER": SCATTERER,
    "SHADE": SHADE, "POINT": POINT, "CAPSULE": CAPSULE,
    "ELONGATED": ELONGATED, "OUTWARD_STEPS": OUTWARD_STEPS,
    "LONGEST_STEP": LONGEST_STEP, "SPECULAR_FAR": FAR, "SPECULAR_FOUND": FOUND, "SETTLED": _CONVERGED,
    "FLATTEST": FLATTEST, "NO_PATH": NO_PATH, "ON_LINE": ON_LINE, "PATIENCE": PATIENCE, "BEYOND_LEG": BEYOND_LEG,
    "POSE_COLUMNS": POSE_COLUMNS, "FACE_COLUMNS": FACE_COLUMNS,
}  # fmt: skip
OF_GAINS = {
    "ON_BOUNDARY": ON_BOUNDARY, "PENUMBRA": PENUMBRA, "NEAR_JUNCTION": NEAR_JUNCTION, "LEFT_OUT": LEFT_OUT,
    "END_CELLS": END_CELLS, "END_TERMS": END_TERMS, "BOTH": BOTH, "AT_CORNER": AT_CORNER, "HALF_TURN": math.pi,
    "FOCK_FIRST": fock.FIRST, "FOCK_LAST": fock.LAST, "FOCK_COUNT": fock.COUNT,
    "COSINE_WHOLE": silhouette.FORWARD_COSINE[0], "COSINE_NONE": silhouette.FORWARD_COSINE[1],
    "NEAR_WHOLE": silhouette.NEAR_FOCK[0], "NEAR_NONE": silhouette.NEAR_FOCK[1],
    "GRAZING": silhouette.GRAZING[0], "GRAZED": silhouette.GRAZING[1], "SHORTEST": silhouette.SHORTEST,
    "NEAREST_END": NEAREST_END, "NEAR_AXIS": NEAR_AXIS, "NEAR_ROUNDS": NEAR_ROUNDS, "CAP_FADE": CAP_FADE,
    "WITHIN": silhouette.WITHIN, "SHARP": silhouette.SHARP, "ELLIPSOID": ELLIPSOID, "SPHERE": SPHERE,
}  # fmt: skip
SHAPES = {"point": POINT, "ellipsoid": ELLIPSOID, "capsule": CAPSULE, "sphere": SPHERE}
# Structures of kernels/nodes/path.h.
TWO_SIDES = [
    ("source_turn", "f8", 9),
    ("source_shift", "f8", 3),
    ("receiver_turn", "f8", 9),
    ("receiver_shift", "f8", 3),
]
EDGE_VIEW = np.dtype(
    [*TWO_SIDES, ("n", "f8"), ("low", "f8", 2), ("wide", "f8", 2), ("narrow", "f8", 2), ("even", "f8", 2),
     ("odd", "f8", 2), ("end", "f8"), ("moment", "f8", 2), ("span", "f8", 2), ("slip", "f8", 2), ("lit", "i4", 4),
     ("end_side", "i4"), ("face", "i4", 2), ("bounces", "i4", 2), ("corner", "f4"), ("share", "f4", (2, 2))]
)  # fmt: skip
SCATTERER_VIEW = np.dtype(
    [*TWO_SIDES, ("semi_axes", "f8", 3), ("strength", "f8"), ("thing", "i4"), ("turned", "i4"), ("shape", "i4"),
     ("first_mode", "i4"), ("modes", "i4"), ("least", "i4")]
)  # fmt: skip
SHADE_VIEW = np.dtype([("first", "i4"), ("count", "i4")])
MIRROR_VIEW = np.dtype([("turn", "f8", 9), ("shift", "f8", 3), ("most", "f8"), ("face", "i4"), ("unused", "i4")])
