"""Paths by scatterers and bodies: against the sound that was emitted last, the same room at rest, wind, and its sums."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.numerics.quaternions import rotate
from clsim.paths.chain import Chain
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.path_table import viewed
from clsim.paths.propagation import UniformAir
from clsim.paths.response import QUASI_STATIC, RETARDED, SceneResponse
from clsim.paths.vertices.scatterer_paths import find_scattered
from clsim.render.methods.static import pairs_at_rest

C, RATE = 343.0, 192e3
AIR = clsim.Air(speed_of_sound=C)
WOOD, HARD = clsim.Material.from_reflection(0.8), clsim.Material.from_porous(20e3, 0.05)
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
TONE = clsim.Signal.tone(40e3, 0.2, RATE)
ROOM = clsim.Shoebox((4.0, 3.0, 2.5), WOOD)
ENDS = (
    [clsim.Source("s", TONE, LINE((0.7, 1.2, 1.1), (0.9, 1.3, 1.0), 0.2))],
    [clsim.Receiver("r", LINE((0.6, 1.6, 1.3), (0.6, 1.4, 1.2), 0.2))],
)
PLATE = clsim.MeshRoom([(0, -1.0, -0.9), (0, 1.0, -0.9), (0, 1.0, 0.9), (0, -1.0, 0.9)], [(0, 1, 2), (0, 2, 3)], HARD)
SWING = clsim.Trajectory.swing((3.1, 1.6, 1.3), (0.2, 0.1, 1.0), [0.0, 0.1, 0.25], [0.0, 0.1, 0.2])


def things() -> list[clsim.Scatterer]:
    """Return a point, a sphere, an ellipsoid and a capsule that move, the last two turn as well."""
    t = np.linspace(-0.05, 0.25, 16)
    way, half = np.stack([2.0 + 0.9 * t, 1.0 + t, 1.2 + 0.1 * np.sin(9.0 * t)], axis=1), 0.75 * t
    turn = np.stack([0 * t, 0 * t, np.sin(half), np.cos(half)], axis=1)
    return [
        clsim.Scatterer.point("point", -10.0, LINE((2.0, 2.0, 1.0), (1.5, 2.0, 1.2), 0.2)),
        clsim.Scatterer.sphere("ball", 0.05, LINE((1.6, 0.6, 0.7), (1.9, 0.5, 0.7), 0.2)),
        clsim.Scatterer.ellipsoid("arm", (0.05, 0.1, 0.07), clsim.Trajectory.waypoints(t, way, turn), shadow=False),
        clsim.Scatterer.capsule(
            "leg", 0.05, 0.3, clsim.Trajectory.waypoints(t, way + np.array([0.0, 0.5, -0.4]), turn), shadow=False
        ),
    ]


def scene_of(plate: Any, room: Any = ROOM, scatterers: Any = None) -> clsim.Scene:
    """Return the things in a room with a plate on a trajectory, or with none."""
    bodies = [] if plate is None else [clsim.Body("plate", PLATE, plate)]
    return clsim.Scene(room, AIR, *ENDS, scatterers=scatterers or things(), bodies=bodies)


@pytest.fixture(scope="module")
def moving() -> clsim.PathSet:
    """Return paths in a room where all moves."""
    return clsim.find_paths(scene_of(SWING), 1, scattering_order=1)


def family_of(paths: clsim.PathSet) -> Chain:
    """Return the paths by a scatterer and a body."""
    found = paths.families[-1]
    assert found.kind == "moving scatterer"
    return found


def test_a_body_at_rest_is_a_wall() -> None:
    """All that is told of every path is as in the room with the plate as one of its walls."""
    turned = np.array([0.0, 0.0, np.sin(0.05), np.cos(0.05)])
    pose = FIXED((3.0, 1.5, 1.2), turned)
    placed = clsim.Body("plate", PLATE, pose).placed(PLATE.vertices, np.zeros(4))
    walled = clsim.MeshRoom.joined([ROOM, clsim.MeshRoom(placed, PLATE.triangles, HARD)])
    tables = [
        clsim.find_paths(scene, 1, scattering_order=1, engine="reference").table(np.array([0.06, 0.11, 0.16]))
        for scene in (scene_of(None, walled), scene_of(pose))
    ]

    def rows(table: clsim.PathTable) -> Any:
        p, t = np.nonzero(np.isfinite(table.delay))
        columns = [table.delay, table.doppler_factor, table.gain.real, table.gain.imag]
        columns += [x[..., i] for x in (table.departure, table.arrival) for i in range(3)]
        found = np.stack([x[p, t] for x in columns], axis=1)
        return found[np.argsort(found[:, 0])]

    one, other = map(rows, tables)
    assert one.shape == other.shape
    by_both = np.sum(np.any(tables[1].interactions == 2, axis=1) & np.any(tables[1].interactions == 3, axis=1))
    assert by_both > 20
    assert np.abs(one[:, 0] - other[:, 0]).max() < 1e-12
    # What else is told depends on the specular point, which is found to 1e-3 rad before its last step.
    assert np.abs(one - other).max() < 1e-8


def earliest(way: Callable[[Any], Any], start: Any) -> float:
    """Return the stationary value of ways (n,) by unknowns (n, m), by Newton's method with differences, m."""
    m, h, x = len(start), 1e-3, start
    steps = h * np.concatenate([np.zeros((1, m)), np.eye(m), -np.eye(m), *(np.eye(m) + row for row in np.eye(m))])
    for _ in range(8):
        f = way(x + steps)
        slope, both = (f[1 : m + 1] - f[m + 1 : 2 * m + 1]) / (2 * h), f[2 * m + 1 :].reshape(m, m)
        bend = (both - f[1 : m + 1] - f[1 : m + 1, None] + f[0]) / h**2
        x = x - np.linalg.solve(bend, slope)
    assert np.linalg.eigvalsh(bend).min() > 0.0
    return float(way(x[None])[0])


def back(place: Callable[[Any], Any], heard: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return when sound was at a thing, and where, that is at places later."""
    flight = np.zeros(len(heard[0]))
    for _ in range(12):
        where = place(heard[0] - flight)
        flight = np.linalg.norm(where - heard[1], axis=1) / C
    return heard[0] - flight, where


def on_mirror(scene: clsim.Scene, wall: int, uv: Any, near: Any, when: float) -> Callable[[Any], Any]:
    """Return positions at times of the point of a mirror with the coordinates (n, 2)."""
    if wall >= len(scene.room.faces):
        plate = scene.bodies[0]
        own = plate.seen(near, np.array(when)) * [0, 1, 1] + np.pad(uv, ((0, 0), (1, 0)))
        return lambda t: plate.placed(own, t)
    places = near + uv @ np.linalg.svd(scene.room.faces.normals[wall][None])[2][1:]
    return lambda t: places


def on_body(body: clsim.Scatterer, uv: Any, near: Any, when: float) -> Callable[[Any], Any]:
    """Return positions at times of the point of a scatterer's surface with the coordinates (n, 2)."""
    motion, shape = body.trajectory, body.shape
    towards = rotate(motion.orientation(when) * [-1, -1, -1, 1], near - motion.position(when))
    axes = np.maximum(getattr(shape, "semi_axes", np.full(3, shape.radius)), 1e-12)
    towards = (towards + 1e-14) / axes / np.linalg.norm((towards + 1e-14) / axes)
    v = towards + 10.0 * uv @ np.linalg.svd(towards[None])[2][1:]
    own = axes * v / np.linalg.norm(v, axis=1)[:, None]
    return lambda t: motion.position(t) + rotate(motion.orientation(t), own)


def emitted_last(scene: clsim.Scene, body: clsim.Scatterer, walls: tuple[Any, Any], time: float, events: Any) -> Any:
    """Return the delays (n,) at a reception time by points of all surfaces with the coordinates (n, m).

    Two say where each mirror is met, from where the events say, and two by which point of the scatterer it goes.
    """
    before, after = walls
    count = 2 * len(before)

    def by_mirrors(leg: Any, mirrors: Any, uv: Any, heard: tuple[Any, Any], last: float) -> tuple[Any, Any]:
        for k in range(len(mirrors) - 1, -1, -1):
            near, when = leg.place[0, 0, k + 1], last + leg.time[0, 0, k + 1]
            heard = back(on_mirror(scene, mirrors[k], uv[:, 2 * k : 2 * k + 2], near, when), heard)
        return heard

    def way(unknown: Any) -> Any:
        place = np.tile(scene.receivers[0].trajectory.position(time), (len(unknown), 1))
        heard = by_mirrors(events.last, after, unknown[:, count:], (np.full(len(unknown), time), place), time)
        when = float(events.time[0, 0])
        own = unknown[:, -2:] if body.shape.radius else np.zeros((len(unknown), 2))
        heard = back(on_body(body, own, events.last.place[0, 0, 0], when), heard)
        heard = by_mirrors(events.first, before, unknown, heard, when)
        return C * (time - back(scene.sources[0].trajectory.position, heard)[0])

    return way


PLATE_FACE = 6
WAYS = [
    ("point", [PLATE_FACE], []), ("arm", [], [PLATE_FACE]), ("ball", [3, PLATE_FACE], [PLATE_FACE, 5]),
    ("arm", [PLATE_FACE, 3, 0], [PLATE_FACE]), ("arm", [PLATE_FACE], [PLATE_FACE, 0, PLATE_FACE]),
]  # fmt: skip


def test_what_is_heard_was_emitted_last() -> None:
    """Up to three mirrors on a leg, a plate that swings among them: 1e-7 m."""
    scene, time, random = scene_of(SWING), 0.13, np.random.default_rng(7)
    flat = Mirrors.of(scene.room, scene.bodies)
    ends = scene.sources[0].trajectory, scene.receivers[0].trajectory
    for name, before, after in WAYS:
        body = next(s for s in scene.scatterers if s.name == name)
        legs = np.array([before], dtype=int).reshape(1, -1), np.array([after], dtype=int).reshape(1, -1)
        found = find_scattered(flat, legs, body, ends, UniformAir(C), np.array([time]))
        start = random.uniform(-0.02, 0.02, 2 * (len(before) + len(after) + (name != "point")))
        exact = earliest(emitted_last(scene, body, (before, after), time, found), start)
        shares = np.concatenate([leg.share.ravel() for leg in (found.first, found.last)])
        assert np.all((shares > 0.0) & (shares < 1.0))
        assert C * (found.first.delay + found.last.delay)[0, 0] == pytest.approx(exact, abs=1e-7), name


@pytest.mark.exhaustive
def test_doppler_factors_are_derivatives_and_bounds_hold(moving: clsim.PathSet) -> None:
    """Both kinds of motion, and the bounds that rendering relies on: of delays, of their rates, of gains."""
    family, times, h = family_of(moving), np.array([0.05, 0.09, 0.15]), 1e-4
    for kinematics in (RETARDED, QUASI_STATIC):
        fine = [family.arrivals(slice(None), times + k * h, kinematics).delay for k in (-2, -1, 1, 2)]
        slope = (fine[0] - fine[3] + 8.0 * (fine[2] - fine[1])) / (12.0 * h)
        found = family.arrivals(slice(None), times, kinematics)
        some = np.isfinite(moving.table(times).delay[-len(family) :])
        # A mirror that turns is taken where the round before left it: that is 1 um, 4e-9 of a rate at 1.5 rad/s.
        np.testing.assert_allclose(found.delay_rate[some], slope[some], rtol=0.0, atol=4e-9)
    found = family.arrivals(slice(None), times)
    speeds = clsim.track(moving).speeds
    low, high = family.delay_bounds(slice(None), times[0], times[-1], speeds)
    assert np.all((found.delay >= low[:, None]) & (found.delay <= high[:, None]))
    assert np.all(high - low < 0.05)
    most = family.max_rate(float(speeds.source.max()), float(speeds.receiver.max()))
    assert 0.1 * most < np.abs(found.delay_rate).max() < most
    at = SceneResponse(moving.scene, 0, np.array([20e3, 40e3]))
    gain = np.abs(family.response(slice(None), found, times, at)).max(axis=1) * found.length.min(axis=1)[:, None]
    bound = family.gain_bound(slice(None), at)
    assert np.all(gain <= bound / (1.0 - float(speeds.source[0]) / C))
    points = family.vertex.scatterer == 0
    assert np.median(bound[points] / gain[points]) < 100.0


@pytest.mark.exhaustive
def test_tables_vertices_and_pages_know_them(moving: clsim.PathSet) -> None:
    """A way is as long as its corners are apart, each where it was; the page names what it meets in order."""
    family, time = family_of(moving), 0.1
    table = moving.table(np.array([time]))
    first = len(moving) - len(family)
    ways = [table.name_objects(first + i) for i in range(len(family))]
    row = ways.index("plate, ball, y_min")
    assert family.interactions[row].tolist() == [3, 2, 0]
    corners = moving.vertices(time)[first + row]
    way = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert way.sum() == pytest.approx(C * table.delay[first + row, 0], rel=1e-12)
    scattered = time - way[2:].sum() / C
    ball = moving.scene.scatterers[1]
    assert np.linalg.norm(corners[2] - ball.trajectory.position(scattered)) == pytest.approx(0.05, rel=1e-9)
    plate = moving.scene.bodies[0]
    assert abs(plate.seen(corners[1], np.array(scattered - way[1] / C))[0]) < 1e-9
    assert abs(corners[3, 1]) < 1e-12
    labels = viewed(moving, duration=0.1, frames=2)["frames"][0].labels
    assert any("plate, ball, y_min" in label for label in labels)
    for motion in ("retarded", "quasi-static"):  # the same to the first order of Mach numbers
        other = moving.table(np.array([time]), motion).delay[first + row, 0]
        assert other == pytest.approx(table.delay[first + row, 0], rel=0.03)


@pytest.mark.exhaustive
def test_all_that_moves_is_wind() -> None:
    """Ends, mirrors and scatterers that all move with u in still air hear what rests in wind of -u."""
    u, middle = np.array([6.0, -3.0, 1.0]), np.array([50.0, 50.0, 50.0])
    far = clsim.Shoebox((100.0, 100.0, 100.0), clsim.Material.from_reflection(0.0))
    turned = np.array([0.1, 0.3, 0.2, np.sqrt(1.0 - 0.14)])

    def scene(moves: bool) -> clsim.Scene:
        def at(*place: float, turn: Any = None) -> Any:
            start, t = middle + np.array(place), np.linspace(0.0, 0.1, 3)
            if not moves:
                return FIXED(start, turn)
            if turn is None:
                return LINE(start, start + 0.1 * u, 0.1)
            return clsim.Trajectory.waypoints(t, start + t[:, None] * u, np.tile(turn, (3, 1)))

        bodies = [clsim.Body("plate", PLATE, at(2.0, 0.2, 0.1, turn=[0.0, 0.1, 0.05, np.sqrt(1.0 - 0.0125)]))]
        scatterers = [
            clsim.Scatterer.point("point", 0.0, at(0.3, 0.7, -0.2)), clsim.Scatterer.sphere("ball", 0.05, at(-0.5, 0.3, 0.4)),
            clsim.Scatterer.ellipsoid("arm", (0.1, 0.2, 0.15), at(0.2, -0.5, 0.3, turn=turned)),
            clsim.Scatterer.capsule("leg", 0.1, 0.3, at(0.1, 0.1, -0.7, turn=turned)),
        ]  # fmt: skip
        air = clsim.Air(speed_of_sound=C, absorption=False, wind=None if moves else tuple(-u))
        source = clsim.Source("s", clsim.Signal.tone(40e3, 0.05, RATE), at(0.3, 0.2, 0.5))
        receiver = clsim.Receiver("r", at(-0.4, -0.3, 0.1))
        return clsim.Scene(far, air, [source], [receiver], scatterers=scatterers, bodies=bodies)

    one, other = (clsim.find_paths(scene(moves), 1, scattering_order=1, body_step=0.2) for moves in (True, False))
    times = np.array([0.05])
    unshaded = ([family for family in paths.families if not family.adds] for paths in (one, other))
    for mine, theirs in zip(*unshaded, strict=True):  # shadows are on echoes of walls that reflect nothing
        some = [family.part(np.flatnonzero((family.start < 0.05) & (family.end > 0.05))) for family in (mine, theirs)]
        some = [family.part(np.flatnonzero(~np.any(family.interactions == 0, axis=1))) for family in some]
        found = [family.arrivals(slice(None), times) for family in some]
        kind = mine.kind
        assert len(some[0]) == len(some[1]) >= (kind == "moving scatterer") * 10 + 1, kind
        at = [SceneResponse(paths.scene, 0, np.array([40e3])) for paths in (one, other)]
        gains = [family.response(slice(None), x, times, a) for family, x, a in zip(some, found, at, strict=True)]
        exact = kind != "static scatterer"  # of these the specular point is found to some 1e-9
        for name, allowed in (("delay", 1e-12), ("delay_rate", 1e-13), ("departure", 1e-8), ("arrival", 1e-8)):
            worst = np.abs(getattr(found[0], name) - getattr(found[1], name)).max()
            assert worst < (1e-13 if exact else allowed), (kind, name)
        assert np.abs(gains[0] / gains[1] - 1.0).max() < (1e-12 if exact else 2e-7), kind  # of the ball's phases


def test_ways_come_when_sound_meets_the_edge_and_engines_agree(device: None) -> None:
    """A sheet slides in along itself: echoes by it begin when sound is at its edge, both legs in turn, to a sample."""
    tone = clsim.Signal.tone(18e3, 0.2, 96e3, fade=0.005)
    places = {"s": np.array([1.0, 2.2, 1.2]), "p": np.array([1.5, 1.8, 1.2]), "r": np.array([1.0, 2.6, 1.2])}
    edge, speed, far = 2.9, 5.0, 3.0  # m at 0 s, m/s towards lower y, x of the sheet
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 3.0), WOOD), AIR, [clsim.Source("s", tone, FIXED(places["s"]))],
        [clsim.Receiver("r", FIXED(places["r"]))], scatterers=[clsim.Scatterer.point("p", -6.0, FIXED(places["p"]))],
        bodies=[clsim.Body("plate", PLATE, LINE((far, edge + 1.0, 1.2), (far, edge + 1.0 - 0.2 * speed, 1.2), 0.2))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0, scattering_order=1)
    family = family_of(paths)
    some = np.flatnonzero(~np.any(family.interactions == 0, axis=1))
    starts = {tuple(family.interactions[i, : family.order[i]].tolist()): family.start[i] for i in some}

    def by_sheet(one: str, other: str) -> tuple[float, float]:
        """Return when the edge is where sound is reflected, and how long the way to there and on is, s."""
        apart = [far - places[name][0] for name in (one, other)]
        met = (places[one][1] * apart[1] + places[other][1] * apart[0]) / sum(apart)
        hit = np.array([far, met, 1.2])
        return (edge - met) / speed, float(np.linalg.norm(places[other] - hit)) / C

    direct = float(np.linalg.norm(places["r"] - places["p"])) / C
    to, back = by_sheet("s", "p"), by_sheet("p", "r")
    assert starts[3, 2] == pytest.approx(sum(to) + direct, abs=1 / 96e3)
    assert starts[2, 3] == pytest.approx(sum(back), abs=1 / 96e3)
    whole = float(np.hypot(2.0 * far - 2.5, 0.8)) / C
    assert starts[3, 2, 3] == pytest.approx(max(sum(to) + whole, sum(back)), abs=1 / 96e3)
    alone = clsim.PathSet(scene, paths.families[-1:])
    exact, heard = (clsim.render(alone, 96e3, duration=0.2, engine=e).pressure for e in ("reference", "opencl"))
    assert np.linalg.norm(exact) > 0.0
    assert np.linalg.norm(heard - exact) < 10 ** (-85 / 20) * np.linalg.norm(exact)
    assert not pairs_at_rest(clsim.track(alone), clsim.RenderOptions(96e3))
