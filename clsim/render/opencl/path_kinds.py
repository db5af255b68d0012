"""Compile-time constants of programs for each kind of paths."""

from clsim.acoustics.capsule import FLATTEST, NEAR_JUNCTION
from clsim.acoustics.diffraction import ON_BOUNDARY, ON_LINE
from clsim.acoustics.edge_end import AT_CORNER, END_TERMS
from clsim.acoustics.scattering import FAR, FOUND, LONGEST_STEP, PENUMBRA
from clsim.acoustics.sphere import LEFT_OUT
from clsim.paths.diffraction.end_pieces import BOTH
from clsim.paths.moving.events import BEYOND_LEG
from clsim.paths.moving.face_cubics import FACE_COLUMNS
from clsim.paths.pose_cubics import POSE_COLUMNS
from clsim.paths.scattering.way import PATIENCE

END_CELLS = 128  # of the tables of ends of edges
POINT, ELLIPSOID, CAPSULE, SPHERE = range(4)  # shapes of scatterers that programs know: from CAPSULE on with phases
NO_WAY = -1e6  # s, a delay that tells that no way by a scatterer is found
_SETTLED = 1e-5  # rad of a specular point: after the step it is wrong by about its square, its strength too
KINDS = {
    "EDGES": 0, "SCATTERERS": 0,  # 1 in builds for this kind
    "BODIES": 0,  # most mirrors that move on a path, in builds for paths by bodies
    "MORE": 0,  # numbers that are predicted besides the delay and its rate
    "POINT": POINT, "CAPSULE": CAPSULE, "SPHERE": SPHERE,
    "LONGEST_STEP": LONGEST_STEP, "GLINT_FAR": FAR, "GLINT_FOUND": FOUND, "SETTLED": _SETTLED, "FLATTEST": FLATTEST,
    "NO_WAY": NO_WAY, "ON_LINE": ON_LINE, "PATIENCE": PATIENCE, "BEYOND_LEG": BEYOND_LEG,
    "POSE_COLUMNS": POSE_COLUMNS, "FACE_COLUMNS": FACE_COLUMNS,
}  # fmt: skip
OF_GAINS = {
    "ON_BOUNDARY": ON_BOUNDARY, "PENUMBRA": PENUMBRA, "NEAR_JUNCTION": NEAR_JUNCTION, "LEFT_OUT": LEFT_OUT,
    "END_CELLS": END_CELLS, "END_TERMS": END_TERMS, "BOTH": BOTH, "AT_CORNER": AT_CORNER,
}  # fmt: skip
