"""The search for paths over edges on the device against its NumPy twin, and with one thing wrong at a time."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from exhaustive import exhaustive, few
from made_meshes import joined, screen
from mutants import Mutants
from same_intervals import same

import clsim
from clsim.paths.propagation import UniformAir
from clsim.paths.search.edge_gaps import gap_candidates
from clsim.paths.search.edges import EdgeReach, edge_pairs, edges_and_ends
from clsim.paths.search.mesh import sides_of_air
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import EdgeCandidates
from clsim.paths.visibility.intervals import Intervals, VisibilityQuery, trajectory_tables

pytestmark = pytest.mark.usefixtures("device")
STEP = 1.0 / 12e3
ORDER = 1
GALES = {"into the fold": (9.0, -20.0, 1.0)}  # m/s


def folded() -> clsim.MeshRoom:
    """Return a sheet folded twice over a floor: what stands within it meets no wall on the way to a fold.

    Its first panel is so short that one gets round it at 80 degrees from its plane, as the fold sees it. A tile beside
    the first fold hides a part of it.
    """
    panels = [screen((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), 3.0), screen((0.0, -2.0, 0.0), (0.0, 2.0, 0.0), 3.0)]
    panels += [screen((0.0, -2.0, 0.0), (0.8, 0.0, 0.0), 3.0)]
    floor = np.array([[-6, -6, -1], [6, -6, -1], [0, 8, -1]], float), np.array([[0, 1, 2]])
    tile = np.array([[-0.01, 0.01, 1], [-0.3, 0.01, 1], [-0.01, 0.3, 1]], float), np.array([[0, 1, 2]])
    return clsim.MeshRoom(*joined(*panels, floor, tile), clsim.Material.from_reflection(0.9))


def boards() -> clsim.MeshRoom:
    """Return two boards on a floor, a tile half-way between their slanted edges, and a flap at the second one.

    Parts of the first edge are within the wedge of the flap's fold.
    """
    outlines = [
        [(-0.5, -2, 0), (-0.5, 0, 0), (-0.5, 0.3, 2), (-0.5, -2, 2)],
        [(0.6, -2, 0), (0.6, 0.2, 0), (0.7, -0.1, 2), (0.7, -2, 2)],
        [(0.1, 0.05, 0.9), (0.1, 0.3, 0.9), (0.1, 0.3, 1.1), (0.1, 0.05, 1.1)],
        [(0.0, 0.0, 0.05), (0.4, 0.0, 0.05), (0.4, 0.3, 0.05), (0.0, 0.3, 0.05)],
        [(0.6, 0.2, 0), (0.7, -0.1, 2), (0.5, -0.1, 2), (0.4, 0.2, 0)],
        [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)],
    ]
    parts = [(np.array(outline, float), np.array([[0, 1, 2], [0, 2, 3]])) for outline in outlines]
    return clsim.MeshRoom(*joined(*parts), clsim.Material.from_reflection(0.9))


def scenes() -> dict[str, tuple[clsim.Trajectory, list[clsim.Trajectory]]]:
    """Return ends that get into the fold, and such that places on edges slide far while ends hardly move."""
    fixed, ways = clsim.Trajectory.fixed, clsim.Trajectory.waypoints
    into = ways([0.0, 0.3, 0.5], [(0.17, 1.0, 1.2), (0.17, -0.8, 1.4), (1.5, -0.9, 1.5)], smooth=False)
    behind = fixed((-1.5, -1.1, 0.9))
    around = fixed((0.5, -2.5, 1.0))  # sees only the second fold of the paths over both
    # Beyond both ends of a fold, and centimetres off its line: the place on it slides by metres.
    near = ways(
        [0.0, 0.1, 0.2, 0.5],
        [(-0.3, 0.1, -0.5), (-0.004, 0.003, -0.5), (-0.4, 0.0, -0.4), (-0.6, -2.4, -0.4)],
        smooth=False,
    )
    low = fixed((-0.06, 0.05, 2.6))
    beside = ways([0.0, 0.2, 0.5], [(-1.2, -0.9, 0.3), (-0.9, -0.3, 1.5), (-0.52, -0.02, 0.6)], smooth=False)
    beyond = ways([0.0, 0.3, 0.5], [(1.2, -0.6, 1.6), (0.9, -0.2, 0.9), (1.5, 0.6, 0.2)], smooth=False)
    close = ways(
        [0.0, 0.2, 0.4, 0.5], [(0.7, 0.1, 1.9), (0.66, 0.02, 0.1), (0.9, -0.3, -0.4), (0.72, -0.1, 2.6)], smooth=False
    )
    return {
        "into the fold": (into, [behind, around]), "from the fold": (behind, [into]), "along a fold": (near, [low]),
        BOARDS: (beside, [beyond, close]),
    }  # fmt: skip


BOARDS = "between boards"
CASES = scenes()
FOLDS = [name for name in CASES if name != BOARDS]


@cache
def room_of(name: str) -> clsim.MeshRoom:
    return boards() if name == BOARDS else folded()


def query(name: str) -> VisibilityQuery:
    source, receivers = CASES[name]
    last = np.full(len(receivers), 0.5)
    ends = trajectory_tables(source, receivers)
    return VisibilityQuery(
        room_of(name).walls, ends, UniformAir(343.0, GALES.get(name)), np.zeros(len(last)), last, STEP
    )


def search(name: str, on_device: bool = False) -> EdgeSearch:
    asked = query(name)
    return EdgeSearch(asked, room_of(name).edges(), DeviceSearch(asked) if on_device else None, sides_of_air(asked))


def candidates(name: str) -> list[EdgeCandidates]:
    reach = EdgeReach(search(name), ORDER, 0.1)
    kinds = (gap_candidates,) if name == BOARDS else (edges_and_ends, edge_pairs, gap_candidates)
    return [c for kind in kinds for _, c in kind(reach)]


@pytest.fixture(scope="module")
def wanted(once) -> Callable[[str], list[tuple[EdgeCandidates, Intervals]]]:
    """Return a function to all paths that the NumPy twin finds in a scene."""
    return lambda name: once(f"edge search, {name}", lambda: found_on_host(name))


def found_on_host(name: str) -> list[tuple[EdgeCandidates, Intervals]]:
    finder = search(name)
    return [(c, finder.find(c)) for c in candidates(name)]


def agree(wanted: dict[str, list[tuple[EdgeCandidates, Intervals]]]) -> bool:
    for name, parts in wanted.items():
        finder = search(name, on_device=True)
        if not all(same(finder.find(c), twin, STEP) for c, twin in parts):
            return False
    return True


@pytest.mark.slow
@pytest.mark.parametrize("name", few(CASES, (1,)))
def test_both_find_the_same(name: str, wanted) -> None:
    parts = wanted(name)
    assert agree({name: parts})
    assert sum(len(found.path) for _, found in parts) > 10


# Not here, since these scenes do not see them: an end before the other edge (`fmin(heard.r, sent.r)`), which takes edges
# that are not parallel; and the place on the edge standing still for the legs (`moves[mine]` given to `path_status`), whose
# clearance is by the move of the place all the same.
FOLD_MUTANTS = {
    "the place on an edge does not slide": ("reach * (length + 2.0 * reach) / left", "0.0"),
    "no bound of the slide is none": ("/ left : s->far", "/ left : 0.0"),
    "as far in the air as off the edge": ("at.r * sin(beside)", "at.r"),
    "an arc for its sine": ("at.r * sin(beside)", "at.r * beside"),
    "in the air within the wedge": ("at.angle <= whole ? away : -away", "at.angle <= whole + 9.0 ? away : -away"),
    "the other end of an edge": ("times(places[mine], at_row", "times(s->end < 0 ? places[mine] : (1 - s->end) * s->edge[mine]->length, at_row"),
    "distances for one another": ("(a.z * b.r + b.z * a.r)", "(a.z * a.r + b.z * b.r)"),
    "not rolled out": ("across = a.r + b.r", "across = a.r - b.r"),
    "angles below the first face": ("angle < low ? angle + 2.0 * HALF_TURN : angle", "angle"),
    "the other face": ("face ? HALF_TURN * edge->n : 0.0", "face ? 0.0 : HALF_TURN * edge->n"),
    "not beyond the other edge": ("times(-at.r, inward(other, other_face))", "times(at.r, inward(other, other_face))"),
    "the far end of an edge": ("fmin(places[edge], s->edge[edge]->length - places[edge])", "places[edge]"),
    "the near end of an edge": ("fmin(places[edge], s->edge[edge]->length - places[edge])", "s->edge[edge]->length - places[edge]"),
    "wind from the other side": ("length * length) - along) * path", "length * length) + along) * path"),
    "wind of a half": ("along * along + path->room * length * length", "along * along + length * length"),
    "the first delay": ("fabs(later) <= CONTRACTED", "fabs(later) <= 1e9"),
    "emission at reception": ("s->source, time - at.delay, source_perturbation", "s->source, time, source_perturbation"),
    "the receiver stands still": ("within * speed_over(&s->receiver, time - within, time + within)", "0.0"),
    "the source stands still": ("late * speed_over(&s->source, emitted - late, emitted + late)", "0.0"),
    "margins of ends only": ("ratio(fabs(least), most)", "ratio(fabs(least), *reach)"),
    "valid outside": ("if (least < 0.0) return 0;", "if (least < -1e9) return 0;"),
    "the other side's end": ("mine ? at.received_at : at.emitted_at, apex", "mine ? at.emitted_at : at.received_at, apex"),
    "the first edge's place": ("times(places[mine], at_row", "times(places[0], at_row"),
    "the first edge": ("at_row(s->edge[mine]->start)", "at_row(s->edge[0]->start)"),
    "clearance of walls as of ends": ("ratio(apart, fmax(*reach, moves[mine]))", "ratio(apart, *reach)"),
    "clearance of walls alone": ("*clear = valid ? fmin(*clear, apart) : apart;", "*clear = apart;"),
    "no image": ("place = mirrored(s->walls.plane[walls[k]], place)", "place = sum(place, times(0.0, place))"),
}  # fmt: skip
# Of paths over two edges with air between. Not here: more alternate steps instead of Newton's, which find the same places.
GAP_MUTANTS = {
    "one step": ("k < STEPS && !nearer(d, a, b, &way)", "k < 1 && !nearer(d, a, b, &way)"),
    "found at once": ("return longest <= FOUND * scale", "return longest <= 1e9 * scale"),
    "by Newton from afar": ("longest <= NEWTON * scale", "longest <= 1e9 * scale"),
    "edges are parallel": ("mixed = -(d->cosine - one * other / apart)", "mixed = (d->cosine - one * other / apart)"),
    "opposite along": ("other = d->last + u * d->cosine - v", "other = d->last - u * d->cosine - v"),
    "on the line": ("fmax(square - along * along, ON_LINE * ON_LINE)", "fmax(square, ON_LINE * ON_LINE)"),
    "places stand still": ("SPARE * *reach * way.slides[edge]", "0.0 * *reach * way.slides[edge]"),
    "no second order": ("SPARE * *reach * way.slides[edge]", "0.2 * *reach * way.slides[edge]"),
    "the first order from afar": ("*reach < SMALL * least_leg", "*reach < 1e9 * least_leg"),
    "slides of one end": ("q * moves[0] + fabs(mixed) * moves[1]", "q * moves[0]"),
    "ends for one another": ("way->slides[1] = (p * moves[1] + fabs(mixed) * moves[0])", "way->slides[1] = (q * moves[0] + fabs(mixed) * moves[1])"),
    "within a wedge": ("fmin(ahead, back) > IN_AIR", "fmin(ahead, back) > -9.0"),
    "one edge in the air": ("fmin(ahead, back) > IN_AIR", "ahead > IN_AIR"),
    "no overlap": ("overlap[s->side - 2]", "overlap[3 - s->side]"),
    "both parts of one edge": ("apex[s->side - 2]", "apex[0]"),
    "no reflection between": ("image = mirrored(plane, image);", "image = sum(image, times(0.0, image));"),
    "the last edge as it is": ("cross_edges(s->edge[0], s->seen,", "cross_edges(s->edge[0], s->edge[1],"),
    "walls between hide nothing": ("return free && clear_way", "return free"),
    "valid off an edge": ("if (left < 0.0) return 0;", "if (left < -1e9) return 0;"),
    "margins of ends alone": ("ratio(fabs(left), fmax(*reach, most))", "ratio(fabs(left), *reach)"),
    "the far end of the first": ("fmin(way.places[edge], s->edge[edge]->length - way.places[edge])", "way.places[edge]"),
    "the other end's leg": ("s->side ? at.received_at : at.emitted_at, apex[s->side]", "s->side ? at.emitted_at : at.received_at, apex[s->side]"),
    "across the last leg": ("legs[2] * (legs[0] + legs[1]))", "legs[2] * (legs[1] - legs[0]))"),
}  # fmt: skip
MUTANTS = FOLD_MUTANTS | GAP_MUTANTS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "rooms"),
    [(["valid outside"], ["from the fold"]), exhaustive((FOLD_MUTANTS, FOLDS)), exhaustive((GAP_MUTANTS, [BOARDS]))],
    ids=["one", "all", "across air"],
)
def test_mutants_are_caught(names, rooms, wanted, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {room: wanted(room) for room in rooms}
    mutants = Mutants("edge_intervals", {name: MUTANTS[name] for name in names}, optimised=len(names) > 1)
    mutants.play(monkeypatch)
    assert agree(found), "none of them is chosen"
    assert mutants.unseen(lambda: agree(found)) == []
