"""Classes that compute the nodes of each kind of paths on a device, by `PathFamily.device`."""

from clsim.render.opencl.body_nodes import BodyTracks
from clsim.render.opencl.device_nodes import DeviceTracks
from clsim.render.opencl.edge_nodes import EdgeTracks
from clsim.render.opencl.pair_nodes import PairTracks
from clsim.render.opencl.scatterer_nodes import ScattererTracks

NODE_PROGRAMS = {"images": DeviceTracks, "edges": EdgeTracks, "bodies": BodyTracks, "scatterers": ScattererTracks}
PAIR_PROGRAMS = {"images": PairTracks}  # those without float64
