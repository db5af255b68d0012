"""When paths by bodies and behind them are there: certified subdivision against closed forms and every output sample."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from scipy.spatial.transform import Rotation

import clsim
from clsim.paths.find_paths import ROOM_FINDERS
from clsim.paths.legs.events import find_events
from clsim.paths.options import PathOptions
from clsim.paths.search.beam_tree import TooManyBeamsError
from clsim.paths.search.bodies import BodySearch
from clsim.paths.visibility import rates, subdivision
from clsim.paths.visibility.mirrors import PastBodies
from clsim.paths.visibility.obstacles import Legs, hidden_by

C, RATE = 343.0, 192e3
WOOD, SILENT = clsim.Material.from_reflection(0.9), clsim.Material.from_reflection(0.0)
FIXED, LINE, SWING = clsim.Trajectory.fixed, clsim.Trajectory.line, clsim.Trajectory.swing


def scene_of(bodies: Any, source: Any, receiver: Any, duration: float, room: Any = None) -> clsim.Scene:
    """Return a scene of one pair, in 343 m/s."""
    tone = clsim.Signal.tone(40e3, duration, RATE)
    room = room or clsim.Shoebox((6.0, 5.0, 3.0), WOOD)
    air = clsim.Air(speed_of_sound=C)
    return clsim.Scene(room, air, [clsim.Source("s", tone, source)], [clsim.Receiver("r", receiver)], bodies=bodies)


def test_a_pole_that_flies_through_the_line_of_sight_is_seen() -> None:
    """1 cm wide, at 20 m/s: 0.5 ms, of 60 that are looked at; sound needs 2 m on from there to the receiver."""
    pole = clsim.Body.box("pole", (0.0, 0.01, 0.8), WOOD, LINE((2.0, 1.4, 1.0), (2.0, 2.6, 1.0), 0.06))
    scene = scene_of([pole], FIXED((1.0, 2.0, 1.0)), FIXED((4.0, 2.0, 1.0)), 0.05)
    shares: list[float] = []
    found = clsim.find_paths(scene, 0, engine="reference", body_step=1.0, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert len(shares) > 4  # it is told while they are looked for, and not only behind each of three steps
    edges = (np.array([2.0, 2.0]) - 1.4 - np.array([0.005, -0.005])) / 20.0 + 2.0 / C
    assert (len(found), found.start[0], found.end[1]) == (2, -np.inf, np.inf)
    assert [found.end[0], found.start[1]] == pytest.approx(edges.tolist(), abs=1.0 / RATE)


def test_a_grazing_glint_of_a_box_at_rest_is_seen() -> None:
    """A receiver passes at 2 m/s, 37 ms at 6 to 8 degrees: as it comes near, hits slide ever faster. As in the room."""
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    turned = FIXED((2.5, 2.5, 1.5), (*(np.sin(0.2) * axis), np.cos(0.2)))
    box = clsim.Body.box("box", (0.3, 0.2, 0.4), WOOD, turned)
    ends = FIXED((1.2, 2.37, 1.43)), LINE((3.4, 1.6, 1.3), (3.3, 3.5, 1.75), 1.0)
    hall = clsim.Shoebox((6.0, 5.0, 3.0), WOOD)
    built_in = clsim.MeshRoom(box.placed(box.mesh.vertices, np.array(0.0)), box.mesh.triangles, WOOD)
    joined = clsim.MeshRoom.joined([hall, built_in])
    mine, room = (
        clsim.find_paths(scene_of(bodies, *ends, 0.99, of), 1, engine="reference").families
        for bodies, of in (([box], hall), ([], joined))
    )
    glint, first = mine[-1], len(hall.faces)
    wanted = np.flatnonzero(np.any(room[0].walls >= first, axis=1))
    assert len(glint) == len(wanted) == 1
    np.testing.assert_allclose(
        [glint.start[0], glint.end[0]], [room[0].start[wanted[0]], room[0].end[wanted[0]]], atol=1e-5
    )
    assert 0.03 < glint.end[0] - glint.start[0] < 0.04


def test_a_glint_of_a_facet_that_turns_is_seen() -> None:
    """A facet of 1.6 cm turns about its middle at 10 rad/s: both ends are near each other, so it must face them."""
    turn = SWING((3.0, 2.5, 1.5), (0, 0, 1), [-0.6, 0.0, 0.6], [0.0, 0.06, 0.12], origin=(0, 0, 0))
    facet = clsim.Body.box("facet", (0.0, 0.016, 0.016), WOOD, turn, centre=(3.0, 2.5, 1.5))
    scene = scene_of([facet], FIXED((1.0, 2.49, 1.5)), FIXED((1.0, 2.51, 1.5)), 0.11)
    found = clsim.find_paths(scene, 1, engine="reference", body_step=1.0)
    glint = found.families[-1]
    # At the angle a the image of y = -0.01 m is a distance of 2 (d cos a + y sin a) off along the normal, d = 2 m; the
    # hit is where the line meets the facet, at most 8 mm from its middle.
    a = np.linspace(-0.05, 0.05, 200_001)
    normal, middle = np.stack([np.cos(a), np.sin(a)], axis=1), np.array([3.0, 2.5])
    source, ear = np.array([1.0, 2.49]), np.array([1.0, 2.51])
    image = source - 2.0 * ((source - middle) @ normal.T)[:, None] * normal
    near, far = (ear - middle) @ normal.T[:, :], np.sum((image - middle) * normal, axis=1)
    hit = ear + (near / (near - far))[:, None] * (image - ear)
    seen = a[np.abs((hit - middle)[:, 1] * np.cos(a) - (hit - middle)[:, 0] * np.sin(a)) <= 0.008]
    assert len(glint) == 1
    length = glint.end[0] - glint.start[0]
    assert length < 1e-3
    assert length == pytest.approx((seen[-1] - seen[0]) / 10.0, rel=0.02)
    assert 0.5 * (glint.end[0] + glint.start[0]) == pytest.approx(0.06 + 2.0 / C, abs=2e-5)
    assert_every_sample(scene, 1, glint, (glint.start[0] - 1e-3, glint.end[0] + 1e-3), None)


GRAZED = {
    # A source beside a box that turns with it, 4 cm over the plane of a face: without mixed rounds 4.7 ms too long.
    "carried": (
        (0.70435904, 0.4947952, 0.39970796), (3.06392675, 2.64432096, 1.57687146),
        [[0.97443248, -0.22186736, -0.03544327], [0.22229685, 0.9291054, 0.2955457], [-0.03264141, -0.29586826, 0.95467089]],
        (-0.22616141, 0.88360637, 0.40998878), -3.64236976, (0.81610776, -0.37300306, 0.24433599),
        ((1.589298, 2.90687731, 1.6099098), (-0.12659011, 0.53589645, 0.15560114)), "b z_max", (0.0190476, 0.0554203),
    ),
    # A cube of 2 cm whose reflection passes by at 100 m/s: no bound held, and looks were 2 ms apart.
    "brief": (
        (0.02461908, 0.02355272, 0.01273244), (2.7621133, 2.56427351, 1.8868131), np.eye(3),
        (-0.36912239, 0.53060773, -0.763023), -5.7948649, (2.28603507, 4.00236978, 2.180923),
        ((3.3555309, 1.07453413, 1.33545771), (0.01791483, 0.0120306, 0.02916033)), "b z_min", (0.1330917, 0.1333178),
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:edges within or beside the Fresnel zones")
@pytest.mark.parametrize("name", list(GRAZED))
def test_reflections_by_turning_faces_are_those_of_fermats_principle(name: str) -> None:
    """Ends were found by other code: the place of the shortest way on the face, at every 0.5 us."""
    size, centre, posed, axis, rate, at, (first, speed), face, wanted = GRAZED[name]
    times = np.linspace(0.0, 0.3, 9)
    turned = Rotation.from_rotvec(rate * times[:, None] * np.array(axis)) * Rotation.from_matrix(posed)
    way = clsim.Trajectory.waypoints(times, np.tile(centre, (9, 1)), turned.as_quat())
    box = clsim.Body.box("b", size, WOOD, way)
    tone, mount = clsim.Signal.tone(40e3, 0.27, RATE), {"mounted_on": "b"} if name == "carried" else {}
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 3.0), WOOD), clsim.Air(speed_of_sound=C),
        [clsim.Source("s", tone, FIXED(at), **mount)],
        [clsim.Receiver("r", LINE(first, np.array(first) + 0.3 * np.array(speed), 0.3))], bodies=[box],
    )  # fmt: skip
    found = clsim.find_paths(scene, 1, engine="reference").families[-1]
    number = len(scene.room.faces) + box.faces.index(face)
    rows = np.flatnonzero(found.legs[0].surfaces[:, 0] == number)
    assert [(found.start[i], found.end[i]) for i in rows] == [pytest.approx(wanted, abs=2e-6)]


def test_even_motions_are_bounded_by_what_they_are() -> None:
    """Bounds hold and are near what they bound: a swing, and waypoints at which velocities jump."""
    swing = SWING((2, 2, 0), (0, 0, 1), [0.0, 0.5, 0.1, 0.9], [0.0, 0.3, 0.5, 1.0])
    kinked = clsim.Trajectory.waypoints(
        [0, 0.5, 1.0], [(1, 1, 1), (2, 1, 1), (2, 3, 1)], [[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0, 0, 0, 1]]
    )
    for motion in (swing, kinked):
        body = clsim.Body.box("b", (0.4, 0.3, 0.2), WOOD, motion)
        pace = rates.BodyRates.of([body], 0.05, 1.0).of_ends(FIXED((0, 0, 0)), [motion])
        begin = np.linspace(0.0, 0.9, 50)
        told = pace.over(np.zeros(50, dtype=int), begin, begin + 0.02, np.full(50, 0.02))
        times = begin[:, None] + np.linspace(0.0, 0.04, 401)
        corner = body.placed(body.mesh.vertices[0], times)
        speed = np.linalg.norm(motion.velocity(times), axis=2).max(axis=1)
        turn = np.linalg.norm(motion.angular_velocity(times), axis=2).max(axis=1)
        assert np.all(told.speed[:, 0] >= speed - 1e-9)
        assert np.all(told.turn[:, 0] >= turn - 1e-9)
        assert np.all(told.receiver >= speed - 1e-9)
        assert np.mean(told.turn[:, 0]) < 1.3 * np.mean(turn)
        velocity = np.gradient(corner, axis=1) / 1e-4
        change = np.linalg.norm(velocity[:, 1:-1] - velocity[:, 1:2], axis=2).max(axis=1)
        arm = float(np.linalg.norm(body.mesh.vertices[0]))
        most = 0.04 * (told.gain + told.lift * arm) + told.jolt + told.twist * arm
        assert np.all(most[:, 0] >= change - 1e-3)


def drawn(seed: int) -> clsim.Scene:
    """Return a room with a partition or none, two bodies that turn and slide, and ends that may move or be carried."""
    rng = np.random.default_rng(seed)
    room: Any = clsim.Shoebox((6.0, 5.0, 3.0), WOOD)
    if seed % 2:
        sheet = clsim.MeshRoom([(3, 3.2, 0), (3, 5, 0), (3, 5, 2.4), (3, 3.2, 2.4)], [(0, 1, 2), (0, 2, 3)], WOOD)
        room = clsim.MeshRoom.joined([room, sheet])
    angles = rng.uniform(-0.03, 0.03, 4)
    turn = SWING((2.2, 1.6, 0.3), (0.1, 0.2, 1), angles, [0.0, 0.06, 0.12, 0.2], origin=(0, 0, 0))
    board = clsim.Body.box("board", (0.05, 0.7, 1.2), WOOD, turn, centre=(2.2, 1.7, 1.4))
    start = np.array([3.9, 1.5, 1.2]) + rng.uniform(-0.3, 0.3, 3)
    stop = start + rng.uniform(-0.2, 0.2, 3)
    half = 0.5 * rng.uniform(0.0, 0.3)
    ways = [[0, 0, 0, 1], [0, 0, np.sin(half), np.cos(half)], [0, 0, np.sin(half / 2), np.cos(half / 2)]]
    cart = clsim.Trajectory.waypoints([0.0, 0.08, 0.2], [start, 0.5 * (start + stop), stop], ways)
    box = clsim.Body.box("cart", (0.3, 0.2, 0.25), WOOD, cart)
    ear = LINE(rng.uniform((4.8, 3.0, 0.5), (5.6, 4.5, 2.5)), rng.uniform((4.8, 3.0, 0.5), (5.6, 4.5, 2.5)), 0.2)
    tone = clsim.Signal.tone(40e3, 0.15, RATE)
    source = clsim.Source("s", tone, FIXED((0.4, 0.6, 1.3)))
    if seed % 3 == 2:
        source = clsim.Source("s", tone, FIXED((-0.25, 0.05, 0.0)), mounted_on="cart")
    return clsim.Scene(room, clsim.Air(speed_of_sound=C), [source], [clsim.Receiver("r", ear)], bodies=[board, box])


def searched(scene: clsim.Scene, order: int) -> BodySearch:
    """Return the default query of `find_paths`."""
    return BodySearch(scene, PathOptions(order, body_step=1.0, engine="reference"))


def assert_every_sample(
    scene: clsim.Scene, order: int, family: Any, span: tuple[float, float], sequences: Any, rate: float = RATE
) -> None:
    """Assert that paths by mirrors are as at every output sample of a time they are seen to be, but for a sample."""
    search = searched(scene, order)
    pair = search.pair(0, 0)
    times = np.arange(int(span[0] * rate) + 1, int(span[1] * rate)) / rate
    surfaces = np.unique(family.legs[0].surfaces, axis=0) if sequences is None else sequences
    for walls in surfaces:
        events = find_events(search.obstacles.mirrors, walls[None], pair.ends, pair.medium, times, rounds=5)
        there = search.obstacles.there(walls[None], events, times[None])[0]
        mine = np.flatnonzero(np.all(family.legs[0].surfaces == walls, axis=1))
        heard = np.zeros(len(times), dtype=bool)
        for row in mine:
            heard |= (times >= family.start[row]) & (times < family.end[row])
        assert_alike(there, heard, walls)


def assert_alike(there: Any, heard: Any, what: Any) -> None:
    """Assert that both differ in single samples at most, where one of them changes."""
    wrong = np.flatnonzero(there != heard)
    assert np.all(np.diff(wrong) > 1), f"{what}: {len(wrong)} samples in a row differ"
    changes = np.flatnonzero(np.diff(there.astype(int)))
    near = [np.abs(changes + 0.5 - w).min(initial=9.0) <= 1.0 for w in wrong]
    assert all(near), f"{what}: differs at {wrong}"


def every_sequence(search: BodySearch, order: int) -> Any:
    """Return all sequences of mirrors that hold a body, (n, order)."""
    owner, found = search.obstacles.mirrors.owner, []
    grown: list[tuple[int, ...]] = [()]
    for _ in range(order):
        grown = [(*s, w) for s in grown for w in range(len(owner)) if not s or s[-1] != w]
        found += [(*s, *[-1] * (order - len(s))) for s in grown if any(owner[w] >= 0 for w in s)]
    return np.array(found, dtype=np.int32)


@pytest.mark.filterwarnings("ignore:.*Fresnel zone")
@pytest.mark.parametrize("seed", few([2, 5, 9]))
def test_drawn_scenes_at_every_sample(seed: int) -> None:
    """All sequences of one mirror and those that were found, at each sample of 16 kHz: nothing that lasts is missed."""
    scene = drawn(seed)
    found = clsim.find_paths(scene, 2, engine="reference", body_step=1.0)
    search, family = searched(scene, 2), found.families[-1]
    single = every_sequence(search, 1)
    single = np.pad(single, ((0, 0), (0, 1)), constant_values=-1)
    known = np.unique(np.concatenate([single, family.legs[0].surfaces]), axis=0)
    assert_every_sample(scene, 2, family, (0.0, 0.15), known, RATE / 12)
    assert_certain(scene, family)
    walls = found.families[0]
    times = np.arange(0.0, 0.15, 12.0 / RATE)
    bare = ROOM_FINDERS[type(scene.room)](scene, scene.room, search.search)
    pair = search.pair(0, 0)
    past = PastBodies(bare, np.arange(len(bare)), search.obstacles, pair.rates, pair.medium)
    for row in range(len(bare)):
        place, when = past.polylines(np.array([row]), times[None])
        free = np.ones(len(times), dtype=bool)
        for leg in range(int(bare.order[row]) + 1):
            legs = Legs(place[0, :, leg], place[0, :, leg + 1], when[0, :, leg], when[0, :, leg + 1])
            for body in scene.bodies:
                free &= ~hidden_by(body, legs, np.full(len(times), -1), np.full(len(times), -1))[0]
        free &= (times >= bare.start[row]) & (times < bare.end[row])
        same = np.flatnonzero(np.all(walls.objects == bare.objects[row], axis=1))
        heard = np.zeros(len(times), dtype=bool)
        for i in same:
            heard |= (times >= walls.start[i]) & (times < walls.end[i])
        inside = (times >= bare.start[row]) & (times < bare.end[row])
        assert_alike(free[inside], heard[inside], bare.objects[row])


def assert_certain(scene: clsim.Scene, family: Any) -> None:
    """Assert that what looks near changes say is certain holds, and that some of it fails for 30 times as long."""
    search = searched(scene, 2)
    look = search.mirror_evaluation(0)(family.legs[0].surfaces, np.zeros(len(family), dtype=int))
    rng, changes = np.random.default_rng(0), np.stack([family.start, family.end], axis=1)
    row, side = np.nonzero(np.isfinite(changes))
    rows = np.repeat(row, 40)
    times = np.repeat(changes[row, side], 40) + rng.choice([-1, 1], len(rows)) * 10 ** rng.uniform(-5, -2, len(rows))
    there, sure, _ = look.evaluate(rows, times, np.full(len(rows), 0.01))
    for spare in (1.0, 30.0):
        within = np.minimum(spare * sure, 0.01)
        again = [look.status(rows, times + share * within) for share in (-0.999, -0.5, 0.5, 0.999)]
        wrong = np.any(np.array(again) != there, axis=0) & (sure > 0.0)
        assert np.any(wrong) == (spare > 1.0), f"{np.sum(wrong)} of {len(rows)} with {spare:g} times the bounds"


def test_paths_that_run_along_what_decides_are_not_looked_at_for_ever() -> None:
    """A path that is there now and then, and for a while on the verge: looks stay few, all that lasts is found."""
    count = 0

    def truth(times: Any) -> Any:
        return (times > 0.2) & (times < 0.3) | (times > 0.7)

    def look(rows: Any, times: Any, half: Any) -> Any:
        nonlocal count
        count += len(rows)
        apart = np.min(np.abs(times[:, None] - [0.2, 0.3, 0.7]), axis=1)
        sure = np.where((times > 0.8), 0.0, 0.7 * apart)
        return truth(times), sure, rates.taken_for(sure, np.full(len(times), 1.0))

    spans = np.zeros(1, dtype=np.int64), np.zeros(1), np.ones(1)
    path, begin, end = subdivision.certified(look, lambda rows, times: truth(times), spans, 1.0 / 16.0 / RATE)
    assert path.tolist() == [0, 0]
    assert np.concatenate([begin, end]) == pytest.approx([0.2, 0.7, 0.3, 1.0], abs=1.0 / 16.0 / RATE)
    assert count < 3000


def in_a_long_room(order: int) -> BodySearch:
    """The search in a room 40 km long, across which a body of a few decimetres swings for half a second."""
    turn = SWING((2.1, 0.4, 0.5), (0, 0, 1), [0.0, 0.2, 0.3], [0.0, 0.2, 0.5])
    board = clsim.Body.box("board", (0.3, 0.02, 0.4), WOOD, turn, centre=(0.15, 0, 0))
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.1, RATE), FIXED((1.0, 1.0, 1.0)))
    room, ear = clsim.Shoebox((4.0, 40e3, 2.0), WOOD), clsim.Receiver("r", FIXED((3.0, 1.0, 1.0)))
    return searched(clsim.Scene(room, clsim.Air(speed_of_sound=C), [source], [ear], bodies=[board]), order)


@pytest.mark.filterwarnings("ignore:room. .* is large")
def test_poses_are_not_nearer_than_a_millisecond() -> None:
    """Images by a body that swings go far in a large room: 80 000 poses in half a second were looked at, also for none."""
    assert len(in_a_long_room(0).cells(0.5, lambda span: span)) == 1
    spans = [span for span, _ in in_a_long_room(1).cells(0.5, lambda span: span)]
    assert 100 < len(spans) <= 510
    assert spans[0][0] == 0.0
    assert spans[-1][1] == 0.5
    assert all(one[1] == other[0] for one, other in pairwise(spans))


@pytest.mark.filterwarnings("ignore:room. .* is large")
def test_too_many_beams_are_refused_at_once() -> None:
    """Where beams about the shortest stretch of time are too many, halves of longer ones are not looked at."""
    asked = []

    def find(span: tuple[float, float]) -> None:
        asked.append(span)
        raise TooManyBeamsError("must give at most 5 beams")

    with pytest.raises(clsim.InputError, match=r"body_order: must give at most 5 beams"):
        in_a_long_room(0).cells(0.5, find)
    assert len(asked) == 2


@pytest.mark.filterwarnings("ignore:room. .* is large")
def test_stretches_with_too_many_beams_are_halved() -> None:
    def find(span: tuple[float, float]) -> None:
        if span[1] - span[0] > 0.1:
            raise TooManyBeamsError("must give at most 5 beams")

    spans = [span for span, _ in in_a_long_room(0).cells(0.5, find)]
    assert spans[0] == (0.0, 0.001)
    assert spans[-1][1] == 0.5
    assert all(one[1] == other[0] and one[1] - one[0] <= 0.1 for one, other in pairwise(spans))


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
@pytest.mark.parametrize(
    ("place", "swapped"), few([((1.2, 2.4, 1.43), False), ((1.3, 2.2, 1.7), True), ((2.65, 1.4, 1.43), False)], (1,))
)
def test_an_end_in_the_plane_of_a_face_has_the_paths_of_a_room(place: tuple[float, ...], swapped: bool) -> None:
    """At rest, and beside the face: paths along it came and went by rounding and tolerances, as loud as the sound."""
    hall, box = (
        clsim.Shoebox((8.0, 8.0, 6.0), SILENT),
        clsim.Body.box("box", (0.3, 0.2, 0.4), WOOD, FIXED((2.5, 2.5, 1.5))),
    )
    built_in = clsim.MeshRoom(box.placed(box.mesh.vertices, np.array(0.0)), box.mesh.triangles, WOOD)
    way = (
        LINE((3.4, 1.6, 1.3), (3.3, 3.5, 1.75), 1.0) if place[0] < 2.0 else LINE((1.5, 3.4, 1.25), (3.3, 3.5, 1.8), 1.0)
    )
    ends = (way, FIXED(place)) if swapped else (FIXED(place), way)
    times, pressures = np.linspace(0.03, 0.97, 101), []
    for bodies, room in (([box], hall), ([], clsim.MeshRoom.joined([hall, built_in]))):
        paths = clsim.find_paths(
            scene_of(bodies, *ends, 0.99, room), 0, diffraction=2, engine="reference", edge_fades=False
        )
        table = paths.table(times)
        waves = np.nan_to_num(table.gain * np.exp(-2j * np.pi * 40e3 * np.nan_to_num(table.delay)))
        pressures.append(waves.sum(axis=0))
    off = np.abs(pressures[0] - pressures[1]).max()
    assert off < 1e-3 * np.abs(pressures[1]).max()
