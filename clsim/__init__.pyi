from clsim import score as score
from clsim import torch as torch
from clsim.errors import ClsimError, ClsimWarning, DeviceError, InputError
from clsim.exchange import array_signals, write_acoular, write_flac, write_mat, write_mcap
from clsim.impulse_responses import ImpulseResponses, impulse_responses
from clsim.opencl.device import list_devices
from clsim.paths.find_paths import find_paths
from clsim.paths.ground_truth import BodyTruth, EchoTruth, ScattererTruth, body_truth, direct_path, scatterer_truth
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import PathTable
from clsim.recording import Recording, decode_binaural
from clsim.render.baseband import Baseband
from clsim.render.interpolator import Bandlimited, Lagrange, TruncatedLagrange
from clsim.render.options import RenderOptions
from clsim.render.plan import Plan
from clsim.render.planning import plan_render
from clsim.render.render import Rendering, render, render_chunks, render_tracks
from clsim.room_measures import LateralMeasures, RoomMeasures, lateral_measures, room_measures, speech_transmission
from clsim.scene.air import Air
from clsim.scene.body import Body
from clsim.scene.captured import captured_person
from clsim.scene.directivity.head_related import HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import (
    Ambisonic,
    AxialDirectivity,
    AxisymmetricDirectivity,
    Directivity,
    FirstOrder,
    Omni,
    Piston,
)
from clsim.scene.directivity.spherical_table import SphericalDirectivity
from clsim.scene.ends import Receiver, Source
from clsim.scene.fluctuation import Fluctuation, TargetFluctuation
from clsim.scene.material.material import Material
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.people import hand, walking_person
from clsim.scene.receiver_array import grid_positions, positions_from_file, receiver_array
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.scene.transducer import Electronics, Transducer
from clsim.scene_file import load_scene
from clsim.sensitivity.sensitivities import Sensitivities, gradient, sensitivities
from clsim.study.batch import RenderedScene, render_batch
from clsim.study.run import run_study
from clsim.study.shards import read_shards
from clsim.tracks.tracks import Tracks, track
from clsim.version import __version__ as __version__
from clsim.workflow.load_recording import load_recording, open_store

__all__ = [
    "Air",
    "Ambisonic",
    "AxialDirectivity",
    "AxisymmetricDirectivity",
    "Bandlimited",
    "Baseband",
    "Body",
    "BodyTruth",
    "ClsimError",
    "ClsimWarning",
    "DeviceError",
    "Directivity",
    "EchoTruth",
    "Electronics",
    "FirstOrder",
    "Fluctuation",
    "HeadRelated",
    "ImpulseResponses",
    "InputError",
    "Lagrange",
    "LateralMeasures",
    "Material",
    "MeshRoom",
    "Omni",
    "PathSet",
    "PathTable",
    "Piston",
    "Plan",
    "Receiver",
    "Recording",
    "RenderOptions",
    "RenderedScene",
    "Rendering",
    "RoomMeasures",
    "Scatterer",
    "ScattererTruth",
    "Scene",
    "Sensitivities",
    "Shoebox",
    "Signal",
    "Source",
    "SphericalDirectivity",
    "SphericalHead",
    "TargetFluctuation",
    "Tracks",
    "Trajectory",
    "Transducer",
    "TruncatedLagrange",
    "array_signals",
    "body_truth",
    "captured_person",
    "decode_binaural",
    "direct_path",
    "find_paths",
    "gradient",
    "grid_positions",
    "hand",
    "impulse_responses",
    "lateral_measures",
    "list_devices",
    "load_recording",
    "load_scene",
    "open_store",
    "plan_render",
    "positions_from_file",
    "read_shards",
    "receiver_array",
    "render",
    "render_batch",
    "render_chunks",
    "render_tracks",
    "room_measures",
    "run_study",
    "scatterer_truth",
    "sensitivities",
    "speech_transmission",
    "track",
    "walking_person",
    "write_acoular",
    "write_flac",
    "write_mat",
    "write_mcap",
]
