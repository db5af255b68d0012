"""The search for paths over edges on the device against its NumPy twin, and with one thing wrong at a time."""

from collections.abc import Callable

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
from clsim.paths.trajectory_tables import trajectory_tables
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import EdgeCandidates
from clsim.paths.visibility.intervals import Intervals, VisibilityQuery

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
    return {
        "into the fold": (into, [behind, around]),
        "from the fold": (behind, [into]),
        "along a fold": (near, [low]),
    }


CASES, ROOM = scenes(), folded()
EDGES = ROOM.edges()


def query(name: str) -> VisibilityQuery:
    source, receivers = CASES[name]
    last = np.full(len(receivers), 0.5)
    ends = trajectory_tables(source, receivers)
    return VisibilityQuery(ROOM.walls, ends, UniformAir(343.0, GALES.get(name)), np.zeros(len(last)), last, STEP)


def search(name: str, on_device: bool = False) -> EdgeSearch:
    asked = query(name)
    return EdgeSearch(asked, EDGES, DeviceSearch(asked) if on_device else None, sides_of_air(asked))


def candidates(name: str) -> list[EdgeCandidates]:
    finder, ends = search(name), trajectory_tables(*CASES[name])
    reached = EdgeReach(finder, ORDER)
    sent, heard = reached(ends.sphere(0, -0.1)), [reached(ends.sphere(1 + r)) for r in range(len(CASES[name][1]))]
    kinds = edges_and_ends, edge_pairs, gap_candidates
    return [c for kind in kinds for _, c in kind(finder, (sent, heard), reached, ORDER, 0.1)]


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
@pytest.mark.parametrize("name", few(CASES))
def test_both_find_the_same(name: str, wanted) -> None:
    parts = wanted(name)
    assert agree({name: parts})
    assert sum(len(found.path) for _, found in parts) > 10


# Not here, since these scenes do not see them: an end before the other edge (`fmin(heard.r, sent.r)`), which takes edges
# that are not parallel; and the place on the edge standing still for the legs (`moves[mine]` given to `path_status`), whose
# clearance is by the move of the place all the same.
MUTANTS = {
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "rooms"), [(["valid outside"], ["into the fold"]), exhaustive((MUTANTS, CASES))], ids=["one", "all"]
)
def test_mutants_are_caught(names, rooms, wanted, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {room: wanted(room) for room in rooms}
    mutants = Mutants("edge_intervals", {name: MUTANTS[name] for name in names}, optimised=len(names) > 1)
    mutants.play(monkeypatch)
    assert agree(found), "none of them is chosen"
    assert mutants.unseen(lambda: agree(found)) == []
