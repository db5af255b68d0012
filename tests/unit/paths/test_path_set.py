"""Sets of paths of a shoebox: gains, columns, corners and refusals."""

from dataclasses import replace

import numpy as np
import pytest

import clsim
from clsim.paths.response import SceneResponse

SIZE = np.array([8.0, 6.0, 3.0])


@pytest.fixture
def scene() -> clsim.Scene:
    room = clsim.Shoebox(
        SIZE, {"default": clsim.Material.from_reflection(0.8), "z_min": clsim.Material.from_reflection(-0.5)}
    )
    tone = clsim.Signal.tone(40e3, duration=0.5, sampling_rate=192e3)
    source = clsim.Source("s", tone, clsim.Trajectory.line((2, 3, 1), (4, 3, 1), duration=1.0))
    receivers = [
        clsim.Receiver("a", clsim.Trajectory.fixed((7, 3, 1))),
        clsim.Receiver("b", clsim.Trajectory.fixed((1, 1, 2))),
    ]
    return clsim.Scene(room, clsim.Air(speed_of_sound=340.0), [source], receivers)


def test_without_absorption_a_gain_is_spreading_and_walls_alone(scene: clsim.Scene) -> None:
    still = clsim.Source("s", scene.sources[0].signal, clsim.Trajectory.fixed((2, 3, 1)))
    bare = clsim.Scene(scene.room, clsim.Air(absorption=False), [still], scene.receivers)
    paths = clsim.find_paths(bare, 2)
    table = paths.table([0.0])
    factors = np.append(scene.room.reflections(40e3), 1.0)[table.walls].prod(axis=1)
    distance = bare.air.speed_of_sound * table.delay[:, 0]
    np.testing.assert_allclose(table.gain[:, 0], factors / distance, rtol=1e-12)
    frequencies = np.array([1e3, 40e3, 90e3])
    for rows, pair in paths.pairs():  # and at every frequency
        found = pair.arrivals(np.zeros(1))
        response = pair.response(found, np.zeros(1), SceneResponse(bare, 0, frequencies))[:, 0]
        np.testing.assert_allclose(response, (factors / distance)[rows, None] * np.ones(3), rtol=1e-12)


def test_order_out_of_range(scene: clsim.Scene) -> None:
    for order in (-1, 61, 1.5, True, "3"):
        with pytest.raises(clsim.InputError, match="max_order"):
            clsim.find_paths(scene, order)  # type: ignore[arg-type]
    with pytest.raises(clsim.InputError, match="path_limit"):
        clsim.find_paths(scene, 30, path_limit=1000)


def test_scene_refuses_leaving_the_room_and_coming_too_close() -> None:
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.8))
    tone = clsim.Signal.tone(40e3, duration=0.5, sampling_rate=192e3)
    fixed = clsim.Receiver("r", clsim.Trajectory.fixed((4, 3, 1)))

    def scene(trajectory: clsim.Trajectory) -> None:
        clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, trajectory)], [fixed])

    with pytest.raises(clsim.InputError, match=r"sources\[0\].trajectory.*inside the room.*at 0\.5"):
        scene(clsim.Trajectory.line((6, 3, 2), (10, 3, 2), duration=1.0))
    with pytest.raises(clsim.InputError, match=r"min_distance.*at 0\.5"):
        scene(clsim.Trajectory.line((3, 3, 1), (5, 3, 1), duration=1.0))
    with pytest.raises(clsim.InputError, match="speed of sound"):
        scene(clsim.Trajectory.line((1, 3, 2), (7, 3, 2), duration=0.51 / 30))
    with pytest.raises(clsim.InputError, match=r"sources\[0\].trajectory.*as long as the signal"):
        scene(clsim.Trajectory.line((1, 3, 2), (2, 3, 2), duration=0.25))


def test_columns_of_one_kind_are_no_copies(scene: clsim.Scene) -> None:
    paths = clsim.find_paths(scene, 2)
    (images,) = paths.families
    for name in ("source", "receiver", "order", "start", "end", "interactions", "objects", "walls"):
        assert getattr(paths, name) is getattr(images, name), name
        assert not getattr(paths, name).flags.writeable
    assert np.array_equal(images.interactions, np.where(images.walls >= 0, 0, -1))


def test_paths_of_another_scene_are_refused(scene: clsim.Scene) -> None:
    paths, other = clsim.find_paths(scene, 1), clsim.Scene(scene.room, scene.air, scene.sources, scene.receivers)
    with pytest.raises(clsim.InputError, match=r"families\[0\].*same scene"):
        clsim.PathSet(other, paths.families)
    with pytest.raises(clsim.InputError, match="families"):
        clsim.PathSet(scene, ())
    with pytest.raises(clsim.InputError, match=r"legs.*one row per path"):
        clsim.PathSet(scene, (replace(paths.families[0], legs=(paths.families[0].legs[0].part(slice(3)),)),))


def test_corners_of_paths_in_a_shoebox_are_in_it() -> None:
    """Walls at right angles are met in an order of their own, in which corners stand."""
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    ends = (clsim.Trajectory.fixed(place) for place in ((1.0, 1.0, 1.2), (3.3, 2.1, 0.7)))
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9)), clsim.Air(speed_of_sound=343.0),
        [clsim.Source("s", tone, next(ends))], [clsim.Receiver("r", next(ends))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 4)
    corners = paths.vertices(0.005)
    assert np.nanmin(corners) > -1e-12
    assert np.nanmax(corners - [4.0, 3.0, 2.5]) < 1e-12
    way = np.nansum(np.linalg.norm(np.diff(corners, axis=1), axis=2), axis=1)
    assert way == pytest.approx(343.0 * paths.table(np.zeros(1)).delay[:, 0], rel=1e-12)
