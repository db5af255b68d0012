"""What programs are told of the kinds of paths: constants that say which kind a build is for, and what these need."""

from clsim.acoustics.capsule import NEAR_JUNCTION
from clsim.acoustics.diffraction import ON_BOUNDARY
from clsim.acoustics.scattering import FAR, FOUND, LONGEST_STEP, PENUMBRA

POINT, ELLIPSOID, CAPSULE, SPHERE = range(4)  # shapes of scatterers that programs know
_SETTLED = 1e-5  # rad of a specular point: after the step it is wrong by about its square, its strength too
KINDS = {
    "EDGES": 0, "SCATTERERS": 0,  # 1 in builds for this kind
    "BODIES": 0,  # most mirrors that move on a path, in builds for paths by bodies
    "MORE": 0,  # numbers that are predicted besides the delay and its rate
    "POINT": POINT, "CAPSULE": CAPSULE,
    "LONGEST_STEP": LONGEST_STEP, "GLINT_FAR": FAR, "GLINT_FOUND": FOUND, "SETTLED": _SETTLED,
}  # fmt: skip
OF_GAINS = {"SPHERE": SPHERE, "ON_BOUNDARY": ON_BOUNDARY, "PENUMBRA": PENUMBRA, "NEAR_JUNCTION": NEAR_JUNCTION}
