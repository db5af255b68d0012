"""A sonar's source and receiver at one place, and both of them in a face of the robot that carries them."""

import numpy as np
import pytest
from exhaustive import exhaustive

import clsim
from clsim.tracks.basis import flat_basis

C = 343.0
AIR = clsim.Air(speed_of_sound=C, absorption=False)
HARD = clsim.Material.from_reflection(1.0)
PULSE = clsim.Signal.chirp(39e3, 41e3, duration=2e-3, sampling_rate=192e3, window="hann")
SIZE = (4.0, 3.0, 2.5)


def transducer(motion: clsim.Trajectory, **options: object) -> tuple[clsim.Source, clsim.Receiver]:
    """A source and a receiver with one motion."""
    return clsim.Source("mouth", PULSE, motion, **options), clsim.Receiver("ear", motion, **options)


def heard(paths: clsim.PathSet, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Delays, s, and gains of all paths that are heard at a time."""
    tracks = clsim.track(paths)
    delays, gains = [], []
    for i, pair in enumerate(tracks.pairs):
        delay, _, gain = tracks.evaluate(i, np.array([time]), flat_basis(40e3))
        there = (pair.start <= time) & (time < pair.end)
        delays.append(delay[there, 0])
        gains.append(gain[0, 0, there, 0])
    return np.concatenate(delays), np.concatenate(gains)


def test_echoes_of_one_place_are_those_of_all_images_but_the_direct_sound() -> None:
    place = np.array([1.1, 1.3, 0.9])
    source, receiver = transducer(clsim.Trajectory.fixed(place))
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.8))
    paths = clsim.find_paths(clsim.Scene(room, AIR, [source], [receiver]), max_order=2, direct=False)
    wanted = []
    for n in np.ndindex(5, 5, 5):
        steps = np.array(n) - 2
        if 0 < np.abs(steps).sum() <= 2:
            image = steps * SIZE + np.where(steps % 2, np.array(SIZE) - place, place)
            far = np.linalg.norm(image - place)
            wanted.append((far / C, 0.8 ** np.abs(steps).sum() / far))
    delay, gain = heard(paths, 0.01)
    assert len(wanted) == 24
    assert np.allclose(np.sort(delay), np.sort([w[0] for w in wanted]), rtol=1e-12)
    assert np.allclose(np.sort(gain), np.sort([w[1] for w in wanted]), rtol=1e-12)


def test_a_transducer_that_drives_at_a_wall_hears_it_as_doppler_has_it() -> None:
    speed, ahead = 3.0, 2.0
    source, receiver = transducer(clsim.Trajectory.line((SIZE[0] - ahead, 1.0, 1.0), (SIZE[0] - 0.5, 1.0, 1.0), 0.5))
    paths = clsim.find_paths(clsim.Scene(clsim.Shoebox(SIZE, HARD), AIR, [source], [receiver]), 1, direct=False)
    for time in (0.05, 0.3):
        delay = heard(paths, time)[0]
        expected = 2.0 * (ahead - speed * time) / (C - speed)
        assert np.abs(delay - expected).min() < 1e-12
    both = [clsim.render(paths, 192e3, duration=0.02, engine=engine).pressure for engine in ("opencl", "reference")]
    assert np.abs(both[1]).max() > 0.1
    assert np.linalg.norm(both[0] - both[1]) < 3e-5 * np.linalg.norm(both[1])


def test_direct_sound_to_the_same_place_is_refused() -> None:
    source, receiver = transducer(clsim.Trajectory.line((1, 1, 1), (2, 1, 1), 0.5))
    elsewhere = clsim.Receiver("other", clsim.Trajectory.fixed((3, 2, 1)))
    scene = clsim.Scene(clsim.Shoebox(SIZE, HARD), AIR, [source], [elsewhere, receiver])
    for direct in (True, -40.0, {("mouth", "other"): False}):
        with pytest.raises(
            clsim.InputError, match="direct: must be False for 'mouth' and 'ear', which are at the same"
        ):
            clsim.find_paths(scene, 0, direct=direct)
    paths = clsim.find_paths(scene, 0, direct={("mouth", "ear"): False})
    assert paths.families[0].receiver.tolist() == [0]


def test_near_places_are_still_refused() -> None:
    source, _ = transducer(clsim.Trajectory.line((1, 1, 1), (2, 1, 1), 0.5))
    _, crossing = transducer(clsim.Trajectory.line((1, 1, 1), (1, 2, 1), 0.5))
    with pytest.raises(clsim.InputError, match="min_distance"):
        clsim.Scene(clsim.Shoebox(SIZE, HARD), AIR, [source], [crossing])


def robot(apart: float, motion: clsim.Trajectory, direct: bool | float, order: int) -> clsim.PathSet:
    """Paths of a sonar in the front of a hard box, with its ends some way apart."""
    body = clsim.Body.box("robot", (0.4, 0.3, 0.2), HARD, motion)
    front = {"mounted_on": "robot", "flush": True}
    source = clsim.Source("mouth", PULSE, clsim.Trajectory.fixed((0.2, 0.02, 0.0)), **front)
    receiver = clsim.Receiver("ear", clsim.Trajectory.fixed((0.2, 0.02 - apart, 0.0)), **front)
    return clsim.find_paths(
        clsim.Scene(clsim.Shoebox(SIZE, HARD), AIR, [source], [receiver], bodies=[body]), order, direct=direct
    )


def near(paths: clsim.PathSet, length: float, time: float) -> float:
    """Sum of the gains of all paths of about a length, m."""
    delay, gain = heard(paths, time)
    return float(gain[np.abs(delay * C - length) < 1e-3].sum())


@pytest.mark.parametrize(
    ("direct", "level", "moves"),
    [
        (True, 1.0, False), (-40.0, 0.01, False), (False, 0.0, False), exhaustive((-40.0, 0.01, True)),
        exhaustive((True, 1.0, True)), exhaustive((False, 0.0, True)),
    ],
)  # fmt: skip
def test_a_baffle_doubles_each_end(direct: bool | float, level: float, moves: bool) -> None:
    """The direct sound is heard twice; an echo of the wall ahead, 1.8 m away, four times."""
    motion = (
        clsim.Trajectory.line((2, 1.5, 1.2), (2.004, 1.5, 1.2), 0.02)
        if moves
        else clsim.Trajectory.fixed((2, 1.5, 1.2))
    )
    apart, time = 0.04, 0.015
    paths = robot(apart, motion, direct, 3)
    assert near(paths, apart, time) == pytest.approx(2.0 * level / apart, rel=2e-3)
    speed = 0.2 if moves else 0.0
    ahead = SIZE[0] - 2.2 - speed * time
    echo = np.hypot(2.0 * ahead + speed * 2.0 * ahead / C, apart)  # it was emitted farther away
    assert near(paths, echo, time) == pytest.approx(4.0 / echo, rel=2e-3)


def test_one_place_in_a_face_hears_echoes_alone() -> None:
    paths = robot(0.0, clsim.Trajectory.fixed((2, 1.5, 1.2)), False, 3)
    delay, _ = heard(paths, 0.01)
    assert delay.min() > 2.0 / C
    assert near(paths, 3.6, 0.01) == pytest.approx(4.0 / 3.6, rel=1e-3)
    assert np.abs(clsim.render(paths, 192e3, duration=0.02).pressure).max() > 1.0


def test_sheets_need_a_side_and_what_moves_on_its_body_is_refused() -> None:
    sheet = clsim.Body.box("sheet", (0.0, 0.3, 0.2), HARD, clsim.Trajectory.fixed((2, 1.5, 1.2)))
    room = clsim.Shoebox(SIZE, HARD)
    other = clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 1)))

    def scene(flush: object, own: clsim.Trajectory) -> clsim.Scene:
        return clsim.Scene(
            room, AIR, [clsim.Source("s", PULSE, own, mounted_on="sheet", flush=flush)], [other], bodies=[sheet]
        )

    centre = clsim.Trajectory.fixed((0, 0, 0))
    for side in (1.0, -1.0):
        assert scene((side, 0, 0), centre).sources[0].trajectory.position(0.0)[0] == pytest.approx(
            2.0 + side * 2e-6, abs=1e-9
        )
    with pytest.raises(clsim.InputError, match=r"sources\[0\]\.flush: must be a direction off the face for 's' at"):
        scene(True, centre)
    with pytest.raises(clsim.InputError, match=r"flush: must be left out, because .* is on no wall"):
        scene((1, 0, 0), clsim.Trajectory.fixed((0.1, 0, 0)))
    with pytest.raises(clsim.InputError, match="flush: must be left out where 's' moves"):
        scene((1, 0, 0), clsim.Trajectory.line((0, 0, 0), (0, 0.1, 0), 1.0))
