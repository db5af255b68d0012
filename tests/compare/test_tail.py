"""Reverberation with a tail against pyroomacoustics' image sources and rays, in three rooms of its examples."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from scipy.signal import butter, sosfilt

import clsim

RATE = 8e3
# Of room_shoebox_3d_rt60.py, of the README's section on ray tracing, and of room_L_shape_3d_rt.py (extruded by 2 m).
SHOEBOXES = [((10.0, 7.5, 3.5), 0.26), ((9.0, 7.5, 3.5), 0.2)]
L_SHAPE = np.array([[0, 0], [0, 3], [5, 3], [5, 1], [3, 1], [3, 0]], dtype=float)


def theirs(room: Any, source: np.ndarray, ear: np.ndarray) -> float:
    from pyroomacoustics.experimental import measure_rt60

    room.set_ray_tracing(receiver_radius=0.5, n_rays=20_000, energy_thres=1e-6)
    room.add_source(source)
    room.add_microphone(ear)
    found = []
    for _ in range(4):  # its rays are drawn anew: a single time scatters by 2 %, seldom by 6 %
        room.compute_rir()
        found.append(measure_rt60(without_modes(room.rir[0][0]), fs=int(RATE), decay_db=30))
    return float(np.mean(found))


def without_modes(response: np.ndarray) -> np.ndarray:
    """What lies above 500 Hz: below, decays of boxes are those of their modes, which rays do not have."""
    return np.asarray(sosfilt(butter(8, 500.0, "highpass", fs=RATE, output="sos"), response))


def ours(room: Any, source: np.ndarray, ear: np.ndarray) -> float:
    tone = clsim.Signal.tone(1e3, 0.1, RATE)
    ends = clsim.Trajectory.fixed(source), clsim.Trajectory.fixed(ear)
    scene = clsim.Scene(
        room, clsim.Air(speed_of_sound=343.0, absorption=False), [clsim.Source("s", tone, ends[0])],
        [clsim.Receiver("r", ends[1])],
    )  # fmt: skip
    found = clsim.impulse_responses(clsim.find_paths(scene, 3), RATE, lead="keep", tail_scattering="material")
    above = replace(found, samples=without_modes(found.samples))
    return float(clsim.room_measures(above, None).t30[0, 0, 0])


@pytest.mark.parametrize("which", few(range(3), kept=(1,)))
def test_t30_is_pyroomacoustics(which: int, measured) -> None:
    pra = pytest.importorskip("pyroomacoustics", reason="pyroomacoustics is not installed")
    options = {"fs": int(RATE), "max_order": 3, "ray_tracing": True, "air_absorption": False}
    wall = clsim.Material.from_reflection(np.sqrt(1.0 - (absorption := [0.26, 0.2, 0.2][which])))
    np.random.seed(0)  # noqa: NPY002  theirs draws from it
    if which < 2:
        size = SHOEBOXES[which][0]
        source, ear = np.array([2.5, 3.73, 1.76]), np.array([6.3, 4.87, 1.2])
        their_room = pra.ShoeBox(size, materials=pra.Material(absorption), **options)
        our_room: Any = clsim.Shoebox(size, wall)
    else:
        pytest.importorskip("embreex", reason="embreex is not installed")
        source, ear = np.array([1.0, 1.0, 0.5]), np.array([3.5, 2.0, 0.5])
        their_room = pra.Room.from_corners(L_SHAPE.T, materials=pra.Material(absorption), **options)
        their_room.extrude(2.0, materials=pra.Material(absorption))
        our_room = clsim.MeshRoom.from_plan(L_SHAPE, 2.0, wall)
    wanted, found = theirs(their_room, source, ear), ours(our_room, source, ear)
    off = 100.0 * abs(found / wanted - 1.0)
    measured("T30 with a tail", "rays of pyroomacoustics", off, 5.0, "%")
