"""Parts of edges that may see each other: no open way is left out, and hidden ones are."""

import numpy as np
import pytest
from test_edge_search import BOARDS, room_of, search

from clsim.paths.search.edge_gaps import PARTS, Fans, cotangents, fans_of_ends, in_air, open_gaps, segment_off, unhidden
from clsim.paths.visibility.clearance import mirrored
from clsim.paths.visibility.occlusion import WallLookup

EDGES, WALLS = room_of(BOARDS).edges(), room_of(BOARDS).walls
COUNT = len(EDGES)
DIRECT = np.empty((1, 0), dtype=np.int32)
FLOOR = np.array([[int(np.argmin(np.abs(WALLS.offset) + 1.0 - np.abs(WALLS.normal[:, 2])))]], dtype=np.int32)


def blocked(start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Mask of lines (n, 3) to (n, 3) that a wall crosses off their ends."""
    shift = 1e-4 * (stop - start)
    hidden = np.zeros(len(start), dtype=bool)
    hidden[WallLookup(WALLS).crossings(start + shift, stop - shift)[0]] = True
    return hidden


def on(edge: np.ndarray, place: np.ndarray) -> np.ndarray:
    return np.asarray(EDGES.start[edge] + (place * EDGES.length[edge])[:, None] * EDGES.along[edge])


def open_lines(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Draw edges and places (n, 2) on two of them that see each other, from the air of both, as angles say."""
    rng = np.random.default_rng(seed)
    edge, place = rng.integers(COUNT, size=(20_000, 2)), rng.uniform(size=(20_000, 2))
    ends = [on(edge[:, i], place[:, i]) for i in (0, 1)]
    angles = [EDGES.cylindrical(edge[:, i], ends[1 - i])[1] for i in (0, 1)]
    middle = 0.5 * (EDGES.start + EDGES.stop)[edge]
    clear = ~blocked(*ends) & (np.linalg.norm(middle[:, 0] - middle[:, 1], axis=1) > 1e-6)  # not both sides of a fold
    for i, angle in enumerate(angles):
        clear &= (angle > 1e-3) & (angle < np.pi * EDGES.n[edge[:, i]] - 1e-3)
    return edge[clear], place[clear], ends[0][clear], ends[1][clear]


def test_heights_over_distances() -> None:
    """Against all of a box of heights and distances, which have their extremes at its corners."""
    rng = np.random.default_rng(1)
    (low, high), (least, most) = (
        np.sort(rng.standard_normal((2, 50)), axis=0),
        np.sort(rng.uniform(0.1, 3.0, (2, 50)), axis=0),
    )
    every = np.array([z / r for z in (low, high) for r in (least, most)])
    assert np.array_equal(cotangents(low, high, least, most), (every.min(axis=0), every.max(axis=0)))


def test_distances_of_segments() -> None:
    ends = np.array([[(-1, 2), (1, 2)], [(3, 4), (6, 8)], [(3, 4), (3, 4)]], dtype=float)
    assert segment_off(ends).tolist() == [2.0, 5.0, 5.0]


@pytest.mark.parametrize("n", [0.7, 1.0, 1.5, 2.0])
def test_air_of_wedges(n: float) -> None:
    """It is told by the angle, at a place off all faces."""
    angle = np.linspace(0.0, 2.0 * np.pi, 41)[:-1] + 0.01
    assert in_air(n, np.cos(angle), np.sin(angle), 0.0).tolist() == (angle < np.pi * n).tolist()
    assert not in_air(n, np.cos(angle), np.sin(angle), 1.1).any()


def test_no_open_line_between_edges_is_left_out() -> None:
    """Drawn places that see each other are on parts that may, at cotangents within those of the fans."""
    edge, place, start, stop = open_lines(2)
    pairs = np.argwhere(~np.eye(COUNT, dtype=bool))
    gaps = open_gaps(WALLS, EDGES, pairs, np.empty((len(pairs), 0), dtype=np.int32))
    row = np.full((COUNT, COUNT), -1)
    row[tuple(gaps.pair.T)] = np.arange(len(gaps.pair))
    met, part = row[tuple(edge.T)], tuple(np.minimum(place * PARTS, PARTS - 1).astype(int).T)
    assert len(met) > 2000
    assert np.all(met >= 0)
    for i, (fan, sign) in enumerate(zip(gaps.fans, (1.0, -1.0), strict=True)):
        along = EDGES.along[edge[:, i]]
        away = sign * ((stop, start)[i] - (start, stop)[i])
        height = np.sum(away * along, axis=1)
        cotangent = height / np.linalg.norm(np.cross(away, along), axis=1)
        assert np.all(fan.free[met, *part])
        assert np.all((cotangent >= fan.low[met, *part] - 1e-9) & (cotangent <= fan.high[met, *part] + 1e-9))
    assert sum(fan.free.sum() for fan in gaps.fans[:1]) < 0.8 * len(pairs) * PARTS**2  # others are


def test_no_open_line_from_a_ball_is_left_out() -> None:
    """Drawn places in balls, direct and by the floor; and hidden parts are told."""
    finder, rng = search(BOARDS), np.random.default_rng(3)
    centre, radius = np.array([(-1.1, -0.7, 0.5), (1.0, 0.1, 1.2)]), np.array([0.2, 0.1])
    for sequence in (DIRECT, FLOOR):
        seen, every = 0, 0
        for edge in range(COUNT):
            fans = fans_of_ends(finder, edge, sequence, centre, radius)
            free = unhidden(finder, edge, sequence, centre, radius, fans)
            assert np.all(fans.free | ~free.free)
            for ball in (0, 1):
                turn = rng.standard_normal((300, 3))
                end = centre[ball] + radius[ball] * turn / np.linalg.norm(turn, axis=1)[:, None]
                place = rng.uniform(size=300)
                apex, image, hidden = on(np.full(300, edge), place), end, np.zeros(300, dtype=bool)
                if len(sequence[0]):
                    wall = np.full(300, sequence[0, 0])
                    image = mirrored(WALLS, wall, end)
                    share = end[:, 2] / (end[:, 2] + apex[:, 2])
                    bounce = end + share[:, None] * (np.array([1, 1, -1]) * apex - end)
                    hidden = (apex[:, 2] < 1e-3) | blocked(end, bounce) | (np.abs(bounce[:, :2]).max(axis=1) > 2.99)
                else:
                    bounce = end
                _, angle, z = EDGES.cylindrical(np.full(300, edge), image)
                r = np.linalg.norm(np.cross(image - EDGES.start[edge], EDGES.along[edge]), axis=1)
                hidden |= blocked(bounce, apex) | (angle < 1e-3) | (angle > np.pi * EDGES.n[edge] - 1e-3)
                part, kept = np.minimum(place * PARTS, PARTS - 1).astype(int), ~hidden
                cotangent = (place * EDGES.length[edge] - z) / r
                within = (cotangent >= fans.low[ball, 0, part] - 1e-6) & (cotangent <= fans.high[ball, 0, part] + 1e-6)
                assert np.all(within[kept])
                assert np.all(free.free[ball, 0, part[kept]])
                seen, every = seen + kept.sum(), every + free.free[ball].sum()
        assert seen > 1000
        assert every < 0.9 * 2 * COUNT * PARTS


def test_fans_meet_where_angles_agree() -> None:
    """On the first edge the same part, on the last one as well, and never at angles that differ."""
    fan = [
        Fans(np.ones((1, PARTS), dtype=bool), np.full((1, PARTS), low), np.full((1, PARTS), low + 0.1))
        for low in (0.0, 0.5)
    ]
    gap = Fans(np.ones((PARTS, PARTS), dtype=bool), np.full((PARTS, PARTS), 0.05), np.full((PARTS, PARTS), 0.2))
    assert gap.meet(fan[0], 0).sum() == PARTS**2
    assert gap.meet(fan[1], 0).sum() == 0
    gap.free[3, 5] = False
    assert gap.meet(fan[0], 0)[0].sum() == PARTS**2 - 1
    fan[0].free[0, 3] = False
    assert gap.meet(fan[0], 0)[0, 3].sum() == 0
    assert gap.meet(fan[0], 1)[0, :, 3].sum() == 0
    turned = gap.turned()
    assert (turned.low[0, 0], turned.high[0, 0]) == (-0.2, -0.05)
    hull = Fans.hull([*fan])
    assert hull.free.all()
    assert np.all(hull.high == 0.6)
    assert hull.low.tolist() == [0.0, 0.0, 0.0, 0.5, *[0.0] * 4]
    assert Fans.stacked(fan).free.shape == (2, 1, PARTS)
