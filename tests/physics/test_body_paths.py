"""Which paths are there while bodies move: against the finder of rooms at rest, and at the steps of what is rendered."""

from typing import Any

import numpy as np
import pytest

import clsim

C = 343.0
TONE = clsim.Signal.tone(40e3, duration=4.0, sampling_rate=96e3)
WOOD = clsim.Material.from_reflection(0.8)
SCREEN = clsim.MeshRoom(
    [(1.2, 1.9, 0.2), (2.0, 2.3, 0.2), (2.0, 2.3, 1.6), (1.2, 1.9, 1.6)], [(0, 1, 2), (0, 2, 3)], WOOD
)


def moving_scene(room: Any) -> clsim.Scene:
    """Return a room in which a door swings slowly and a box slides, by the end some 14 degrees and 0.2 m."""
    angles, times = [0.0, 0.1, 0.25], [0.0, 2.0, 4.0]
    hinge = clsim.Trajectory.swing((2.0, 1.4, 0.0), (0, 0, 1), angles, times)
    door = clsim.Body.box("door", (0.9, 0.0, 1.9), WOOD, hinge, centre=(0.5, 0.0, 1.1))
    slide = clsim.Trajectory.line((2.4, 0.5, 0.9), (2.6, 0.55, 0.9), 4.0)
    crate = clsim.Body.box("crate", (0.3, 0.4, 0.5), WOOD, slide)
    ends = (
        [clsim.Source("s", TONE, clsim.Trajectory.line((0.7, 0.8, 1.2), (0.8, 0.85, 1.25), 4.0))],
        [clsim.Receiver("far", clsim.Trajectory.fixed((3.4, 2.3, 1.1))),
         clsim.Receiver("near", clsim.Trajectory.fixed((1.4, 0.5, 1.0)))],
    )  # fmt: skip
    return clsim.Scene(room, clsim.Air(speed_of_sound=C), *ends, bodies=[door, crate])


def as_it_is(scene: clsim.Scene, time: float) -> clsim.Scene:
    """Return the same scene as it is at a time, with bodies for walls."""
    placed = [
        clsim.MeshRoom(body.placed(body.mesh.vertices, np.array(time)), body.mesh.triangles, WOOD)
        for body in scene.bodies
    ]
    fixed = [clsim.Trajectory.fixed(end.trajectory.position(time)) for _, end in scene.named_ends()]
    ends = (
        [clsim.Source("s", TONE, fixed[0])],
        [clsim.Receiver(r.name, at) for r, at in zip(scene.receivers, fixed[1:], strict=True)],
    )
    return clsim.Scene(clsim.MeshRoom.joined([scene.room.as_mesh(), *placed]), scene.air, *ends)


@pytest.mark.parametrize("kind", ["shoebox", "mesh"])
def test_paths_are_those_of_the_room_as_it_is(kind: str) -> None:
    """At 5 cm/s everything is where it is seen to 1 mm: the same ways are heard as in the room at rest.

    Ways over the same walls are known by their length, which 3 mirrors of a way of 10 m change by 6 mm at the most.
    """
    room: Any = clsim.Shoebox((4.0, 3.0, 2.5), WOOD)
    scene = moving_scene(room if kind == "shoebox" else clsim.MeshRoom.joined([room, SCREEN]))
    times = np.array([0.37, 2.13, 3.72] if kind == "mesh" else [2.91])
    table = clsim.find_paths(scene, 2).table(times)
    bodies, met = 0, 0
    for i, time in enumerate(times):
        still = clsim.find_paths(as_it_is(scene, float(time)), 2).table([0.5])
        for receiver in range(2):
            here = np.flatnonzero(np.isfinite(table.delay[:, i]) & (table.receiver == receiver))
            there = np.flatnonzero(np.isfinite(still.delay[:, 0]) & (still.receiver == receiver))
            assert len(here) == len(there), (time, receiver)
            ways = np.sort(C * table.delay[here, i]) - np.sort(C * still.delay[there, 0])
            assert np.abs(ways).max() < 6e-3
            bodies += np.sum(table.interactions[here] == 3)
            met += len(here)
    assert bodies >= 2 * len(times)
    assert met > 25 * len(times)


def test_a_door_that_sweeps_makes_no_step() -> None:
    """What is behind a door comes and goes within the transition: no sample of the envelope differs by more."""
    tone = clsim.Signal.tone(40e3, duration=1.0, sampling_rate=96e3, fade=0.01)
    hinge = clsim.Trajectory.swing((1.0, 0.9, 0.0), (0, 0, 1), [-0.6, 0.9], [0.0, 1.0])
    door = clsim.Body.box("door", (0.9, 0.0, 1.6), WOOD, hinge, centre=(0.5, 0.0, 1.2))
    ends = clsim.Trajectory.fixed((1.6, 1.7, 1.2)), clsim.Trajectory.fixed((2.1, 0.35, 1.1))
    scene = clsim.Scene(
        clsim.Shoebox((3.0, 2.5, 2.4), WOOD), clsim.Air(speed_of_sound=C), [clsim.Source("s", tone, ends[0])],
        [clsim.Receiver("r", ends[1])], bodies=[door],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 1)
    finite = np.isfinite(paths.start) | np.isfinite(paths.end)
    assert finite.sum() >= 4
    made = clsim.render(paths, 96e3, baseband=clsim.Baseband(40e3, 8e3, 16e3), duration=1.0)
    envelope = made.samples[0][330:-330]
    gains = np.abs(np.nan_to_num(paths.table(np.linspace(0.1, 0.9, 33)).gain))
    # A raised cosine over the transition of 1 ms of all that begins or ends, and Doppler shifts of 1 m/s.
    step = np.pi / 2.0 / (1e-3 * 16e3) * gains[finite].max(axis=1).sum() + 0.05 * gains.max(axis=1).sum()
    assert np.abs(np.diff(envelope)).max() < step
    assert np.ptp(np.abs(envelope)) > 0.5 * gains[0].max()
