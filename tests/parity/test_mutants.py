"""Kernels with one thing wrong: the parity check at its own tolerance must see each of them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from exhaustive import few
from made_responses import POROUS, ROUGH, Lopsided, OffCentre
from mutants import KeptEngines, Mutants
from scipy.spatial.transform import Rotation, Slerp

import clsim
from clsim.paths.legs.legs import StaticLeg
from clsim.paths.path_set import PathSet
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl.engine import GPU_LAYOUT, Layout, OpenclEngine
from clsim.render.plan import Plan
from clsim.render.planning import plan_render

pytestmark = pytest.mark.usefixtures("device")
RATE = 192e3
FIRST, LAST = 6000, 9000  # samples that are compared: 25 paths are in
TOLERANCE_DB = -100.0  # as in test_engines.py
NEAR_DB = -96.0  # where ends are so near and fast that the shortest blocks just do


KINDS = ("real", "turned", "phased", "lopsided", "near", "doubled")


def _walls(phased: bool, plain: bool = False) -> list[clsim.Material]:
    """Return walls of signed factors, two of which depend on frequency; two on the angle too, one with a phase."""
    walls = [clsim.Material.from_reflection(f) for f in (0.9, -0.8, 0.7, 0.6, -0.5, 0.8)]
    if plain:
        return walls
    walls[0] = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])
    walls[3] = clsim.Material.from_absorption([20e3, 40e3, 60e3], [0.5, 0.3, 0.2])
    if phased:
        walls[2], walls[5] = POROUS, ROUGH
    return walls


def _paths(kind: str) -> PathSet:
    """Return a scene's paths: all ends moving, signed walls, beams.

    Kinds: turned, so that no matrix is diagonal; with phases and walls that depend on the angle; with beams without
    symmetry; so near that blocks are short; near half the sampling rate, so that branch signals have twice the rate; in
    wind, and air that disperses.
    """
    if kind == "near":
        return _near()
    turned = kind == "turned"
    beams = {"phased": (OffCentre(2e-3), clsim.FirstOrder(0.4)), "lopsided": (Lopsided(False), Lopsided(True))}
    source_beam, receiver_beam = beams.get(kind, (clsim.Piston(0.004), clsim.FirstOrder(0.4)))
    spin = Rotation.from_rotvec(np.linspace(0.0, 0.6, 9)[:, None] * [1.0, -2.0, 0.5]).as_quat()
    tone = clsim.Signal.chirp(34e3, 46e3, 0.03, RATE, window="tukey")
    if kind == "doubled":
        tone = clsim.Signal.chirp(88e3, 93e3, 0.03, RATE, window="tukey")
    air = clsim.Air(dispersion=True, wind=(12.0, -9.0, 5.0)) if kind == "airy" else clsim.Air()
    turn = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix() if turned else np.eye(3)
    shift = np.full(3, 10.0 if turned else 0.0)

    def trajectory(centre: np.ndarray, phase: float) -> clsim.Trajectory:
        def place(t: np.ndarray) -> np.ndarray:
            angle = 2 * np.pi * np.array([2.0, 1.7, 1.3]) * t[:, None] + phase
            return (centre + (0.02 if kind == "doubled" else 0.4) * np.sin(angle)) @ turn.T + shift

        if kind == "lopsided":
            times = np.linspace(0.0, 0.2, 101)
            turns = Slerp(np.linspace(0.0, 0.2, 9), Rotation.from_quat(spin))(times).as_quat()
            return clsim.Trajectory.waypoints(times, place(times), orientations=turns)
        return clsim.Trajectory.sampled(place, 0.2, 500.0)

    scene = clsim.Scene(
        clsim.Shoebox(np.full(3, 25.0) if turned else (6, 5, 4), _walls(kind == "phased", kind == "doubled")),
        air,
        [clsim.Source("s", tone, trajectory(np.array([2.0, 2.5, 2.0]), 0.3), source_beam, aim=None if kind == "lopsided" else turn @ (1, 0.3, -0.2))],
        [clsim.Receiver("r", trajectory(np.array([4.2, 2.4, 2.1]), 1.9), receiver_beam, aim=None if kind == "lopsided" else turn @ (-0.8, 0.1, 0.4), electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=2e-3))],
    )  # fmt: skip
    if not turned:
        return clsim.find_paths(scene, 1 if kind == "airy" else 2)
    # One image that turns: matrix and inverse differ.
    one = clsim.find_paths(scene, 0)
    matrix = Rotation.from_rotvec([0.2, 0.1, -0.3]).as_matrix()
    offset = (0.3, 0.2, -0.1) + (shift - matrix @ shift)
    turned = replace(one.families[0], legs=(StaticLeg(matrix[None], offset[None]),))
    return PathSet(scene, (turned,))


def _near() -> PathSet:
    """Return the paths of a source that passes a receiver at 12 mm and 25 m/s, 0.039 s after the beginning."""
    tone = clsim.Signal.chirp(50e3, 60e3, 0.06, RATE, window="tukey")
    line = clsim.Trajectory.line((2.025, 2.5, 2.0), (4.025, 2.5, 2.0), 0.08)
    scene = clsim.Scene(
        clsim.Shoebox((6, 5, 4), _walls(phased=False)), clsim.Air(), [clsim.Source("s", tone, line)],
        [clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 2.512, 2.0)))],
    )  # fmt: skip
    return clsim.find_paths(scene, 1)


@pytest.fixture(scope="module")
def difference_db(once) -> Callable[..., float]:
    """Return a function that renders a scene by the current kernels and compares it with the reference."""
    plans: dict[str, Plan] = {}
    wanted: dict[str, np.ndarray] = {}
    engines = KeptEngines()

    def compare(kind: str, layout: Layout | None = None) -> float:
        if kind not in plans:
            plan = plans[kind] = _plan(kind)
            wanted[kind] = once(f"mutants, {kind}", lambda: ReferenceEngine(plan).render(FIRST, LAST)[0])
        engine = engines.engine((kind, layout), lambda: OpenclEngine(plans[kind], layout))
        engine.skips_silence = False  # what it changes is in test_silence.py
        try:
            with np.errstate(invalid="ignore"):  # of gains without bounds
                got = engine.render(0, LAST)[0, FIRST:]
        except clsim.ClsimError as error:  # the engine itself found that delays are out of bounds
            assert "lie outside the bounds" in str(error)
            engines.forget((kind, layout))
            return np.inf
        if not np.all(np.isfinite(got)):
            return np.inf
        return float(20 * np.log10(np.linalg.norm(got - wanted[kind]) / np.linalg.norm(wanted[kind])))

    return compare


def _plan(kind: str) -> Plan:
    paths = _paths(kind)
    filters = clsim.Bandlimited(-100.0)  # blocks are 6 dB better
    return plan_render(
        paths, RATE, duration=LAST / RATE, response_error_db=-110.0, interpolator=filters,
        convolve_static=False,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("layout", few([None, GPU_LAYOUT]))
@pytest.mark.parametrize("kind", few(KINDS, kept=(0, 1, 4, 5)))
def test_kernels_as_they_are_pass(difference_db, kind: str, layout: Layout | None) -> None:
    assert difference_db(kind, layout) < (NEAR_DB if kind == "near" else TOLERANCE_DB)


MUTANTS = {
    "one tap further": ("branches", "tap[i] * x", "tap[((k + 1) % tap_count - k) * ROWS + i] * x"),
    "tap order": ("branches", "at++, tap += ROWS", "at++, tap = taps + (block * tap_count + tap_count - 1 - k) * ROWS"),
    "row of the bank": ("render", "branches + (rows - 1)", "branches + (rows - 2)"),
    "a sample late": ("render", "PLACE(-paths->whole[p], stride);", "PLACE(-1 - paths->whole[p], stride);"),
    "rate's sign": ("render", "sample[j] * paths->curve[p] + paths", "sample[j] * paths->curve[p] - paths"),
    "curve dropped": ("render", "sample[j] * paths->curve[p] + ", ""),
    "gain slope's sign": ("render", "(sample[j] * slope", "(-sample[j] * slope"),
    "fraction's sign": ("render", "out->fraction + p) = at - whole", "out->fraction + p) = whole - at"),
    "group's centre": ("render", "LANES) - 0.5f * (SUBBLOCK - 1)", "LANES) - 0.5f * SUBBLOCK"),
    "block's centre": ("render", "SUBBLOCK + SUBBLOCK - 1)", "SUBBLOCK + SUBBLOCK)"),
    "cubic term of the delay": ("render", "CUBIC(LOAD(c), c1, c2, c3, t)", "CUBIC(LOAD(c), c1, c2, c2, t)"),
    "gain in its block": ("render", "CUBIC(LOAD(g), g1,", "CUBIC(LOAD(g), -g1,"),
    "gain slope dropped": ("render", "sample[j] * slope + ", ""),
    "rate of the delay": ("render", "per_sample * CUBIC_SLOPE(c1, c2,", "per_sample * CUBIC_SLOPE(c1, -c2,"),
    "sign in Horner's scheme": ("render", "value[j] * mu[j] + LOAD", "-value[j] * mu[j] + LOAD"),
    "a branch skipped": ("render", "for (int q = 1; q < rows; q++) {\n        row", "for (int q = 2; q < rows; q++) {\n        row"),
    "another block's row": ("render", ", row = first_block + block", ", row = first_block"),
    "reflection's sign": ("tracks", "* BIN_VECTORS + b] * air;", "* BIN_VECTORS + b] * s->reflection[((long)slot * PARTS + part) * BIN_VECTORS + b] * air;"),
    "another path's walls": ("tracks", "s->reflection[((long)slot * PARTS", "s->reflection[((long)(slot ^ 1) * PARTS"),
    "half a Newton step": ("tracks", "(quasi_static - a->delay) * a->mach_factor", "0.5 * (quasi_static - a->delay)"),
    "Doppler's sign": ("tracks", "(receding - mach) * a->mach_factor;\n    const reals step = (quasi_static", "(receding + mach) * a->mach_factor;\n    const reals step = (quasi_static"),
    "curvature of the delay in a cell": ("tracks", "0.25 * (e0 + e1), 0.25 * (e1 - e0)", "0.25 * (e0 + e1), 0.2 * (e1 - e0)"),
    "absorption from 0 m": ("tracks", "(a->through - 1.0f);", "a->through;"),
    "clock's delay": ("tracks", "s->node[VECTOR(i)].delay - RECEIVER_AT(s, i).clock_error;", "s->node[VECTOR(i)].delay;"),
    "clock at reception": ("tracks", "s->block_time + receiver->clock_error,", "s->block_time,"),
    "clock's pace": ("tracks", ".rate * pace - (pace - 1.0)", ".rate - (pace - 1.0)"),
    "clock's own rate": ("tracks", ".rate * pace - (pace - 1.0)", ".rate * pace"),
    "receiver of another node": ("tracks", "s->rows + first)", "s->rows + first + 1)"),
    "delays in a cell": ("tracks", "d1 = FOUR_FROM(s->delay + at + 1)", "d1 = FOUR_FROM(s->delay + at)"),
    "a cell's next block": ("tracks", "write_terms(terms, 1, b->functions, BESIDE, c + i * next)", "write_terms(terms, 1, b->functions, BESIDE, c + (i ^ 1) * next)"),
    "node beside the one between cells": ("tracks", "gains_of_node(nodes, 1,", "gains_of_node(nodes, 3,"),
    "powers in a cell": ("tracks", "s->power[m][v] = p[m]", "s->power[m][v] = p[m > 1 ? m - 1 : m]"),
    "place in a cell": ("tracks", "((float)i + 0.5f)", "((float)i - 0.5f)"),
    "middle of a cell": ("tracks", "(float)(cell - from) + 0.5f", "(float)(cell - from)"),
    "Newton's scheme": ("tracks", "p[m] = here * p[m] + more * p[m - 1]", "p[m] = here * p[m] - more * p[m - 1]"),
    "emission at reception": ("tracks", "RETARDED ? time - a->delay : time, a);\n    const triples from = cubics(", "time, a);\n    const triples from = cubics("),
    "Mach exponent": ("tracks", "i < MACH_EXPONENT; i++) common", "i < MACH_EXPONENT / 2; i++) common"),
    "Mach exponent twice": ("tracks", "i < MACH_EXPONENT; i++) common", "i < 2 * MACH_EXPONENT; i++) common"),
    "rate without stretch": ("tracks", "(receding - mach) * a->mach_factor;\n    const reals step = (quasi_static", "(receding - mach);\n    const reals step = (quasi_static"),
    "source's speed": ("tracks", "COLUMN(3) + u * (2 * COLUMN(6)", "COLUMN(3) + u * (COLUMN(6)"),
    "receiver's speed dropped": ("tracks", "STATIC_RECEIVERS ? (reals)0.0 : path->slowness * DOT(direction, receiver->velocity)", "0.0"),
    "slope of the delay in a cell": ("tracks", "e1 = r2 * b->half_block", "e1 = r1 * b->half_block"),
    "absorption twice": ("tracks", "of_air(s->nepers, b, raised) * (a->through - 1.0f)", "of_air(s->nepers, b, raised) * (2.0f * a->through - 1.0f)"),
    "source beam's sign": ("tracks", "(1 + cosine)", "(1 - cosine)"),
    "receiver beam's sign": ("tracks", "(1 - inner(receiver_frame", "(1 + inner(receiver_frame"),
    "another function": ("render", "first_row + first_function, 1,", "first_row + (first_function > 0 ? first_function - 1 : 0), 1,"),
    "another frequency's air": ("tracks", "of_air(s->nepers, b,", "of_air(s->nepers, BIN_VECTORS - 1 - b,"),
    "another frequency's walls": ("tracks", "* BIN_VECTORS + b] * air;", "* BIN_VECTORS + BIN_VECTORS - 1 - b] * air;"),
    "another frequency's beam": ("tracks", "r->part[0][b] *= by->part[0][b]", "r->part[0][b] *= by->part[0][BIN_VECTORS - 1 - b]"),
    "projection shifted": ("tracks", "sum[m % 4] += projection[m * GAIN_VECTORS + k]", "sum[m % 4] += projection[(m ^ 1) * GAIN_VECTORS + k]"),
    "gain of the function before": ("tracks", "g[k * apart] = ((const float*)gain)[k]", "g[k * apart] = ((const float*)gain)[k > 1 ? k - 1 : k]"),
    "beam's place": ("tracks", "at - (float)cell, r);", "at - (float)cell + 0.5f, r);"),
}  # fmt: skip
# In other scenes than the first.
ELSEWHERE = {
    "transposed image": (
        "turned", "tracks", "m[0] * v.x + m[3 * slots] * v.y + m[6 * slots] * v.z", "m[0] * v.x + m[slots] * v.y + m[2 * slots] * v.z",
    ),
    "product's imaginary part": ("phased", "tracks", "real * by->part[1][b] + r->part[1][b]", "real * by->part[1][b] - r->part[1][b]"),
    "product's real part": ("phased", "tracks", "real * by->part[0][b] - r->part[1][b]", "real * by->part[0][b] + r->part[1][b]"),
    "real part, changed before it is used": ("phased", "tracks", "real * by->part[1][b] + r", "r->part[0][b] * by->part[1][b] + r"),
    "linear cosine": ("phased", "tracks", "sqrt(cosine < 0.0f ? -cosine : cosine)", "(cosine < 0.0f ? -cosine : cosine)"),
    "the same bounce again": ("phased", "tracks", "s->wall_of[i * (long)slots + slot]", "s->wall_of[slot]"),
    "another wall's table": ("phased", "tracks", "s->walls + (long)wall *", "s->walls + (long)(wall ^ 1) *"),
    "another path's normal": ("phased", "tracks", "s->normal + 3 * i * (long)slots + slot", "s->normal + 3 * i * (long)slots + (slot ^ 1)"),
    "axes of the normal": ("phased", "tracks", "n[slots] * (float)along.y", "n[2 * slots] * (float)along.y"),
    "imaginary part unprojected": ("phased", "tracks", "m < PARTS * FREQUENCIES; m++", "m < FREQUENCIES; m++"),
    "cube's second axis": ("lopsided", "tracks", "(axis == 0 ? y : axis == 1 ? z : x) * scale", "(axis == 0 ? y : axis == 1 ? x : z) * scale"),
    "cube's face": ("lopsided", "tracks", "(along < 0.0f)) * SIDE", "(along > 0.0f)) * SIDE"),
    "spline's weights": ("lopsided", "tracks", "t * t * (1.0f + s)", "t * t * (1.0f + t)"),
    "cell of the cube": ("lopsided", "tracks", "* SIDE + j + 1)", "* SIDE + j)"),
    "source's third axis": ("lopsided", "tracks", "z = cross_product(x, y)", "z = cross_product(y, x)"),
    "source's second axis": ("lopsided", "tracks", "y = cubic(a->knot + 2 * CUBIC_COLUMNS", "y = cubic(a->knot + CUBIC_COLUMNS"),
    "receiver's frame by its mirrored axes": (
        "lopsided", "tracks", "turned_back(image_matrix, slots, slot, z)", "turned_back(image_matrix, slots, slot, y)",
    ),
    "curvature of the delay": ("single", "tracks", "c[2 * apart] = (float)(0.25 * (e1", "c[2 * apart] = (float)(0.2 * (e1"),
    "slope of the delay": ("single", "tracks", "e1 = rates[2]", "e1 = rates[1]"),
    "delays of a cell's block": ("single", "tracks", "w->delay[i] = s->delay[of_stretch + i]", "w->delay[i] = s->delay[of_stretch + (i ^ 1)]"),
    "slope of the gain": ("near", "tracks", "s0 = 0.25f", "s0 = -0.25f"),
    "node beside the right one": ("near", "tracks", "at = (n - first) % GROUP", "at = (n - first) % GROUP / 2"),
    "twist dropped": ("near", "render", "sample[j] * paths->twist[p] + ", ""),
    "bend dropped": ("near", "render", "* sample[j] + slope) * sample[j] + gain", "* 0.0f + slope) * sample[j] + gain"),
    "flex dropped": ("near", "render", "(sample[j] * flex + bend)", "bend"),
    "the other phase": ("doubled", "render", "((ahead) & 1) * ((stride) / 2)", "(~(ahead) & 1) * ((stride) / 2)"),
    "one phase for both": ("doubled", "branches", "place % OVERSAMPLING * (stride", "0 * (stride"),
    "delays in the recording's samples": ("doubled", "tracks", "branch_rate = run.oversampling * run.sampling_rate", "branch_rate = run.sampling_rate"),
    "rates in the recording's samples": ("doubled", "tracks", "0.5 * run.oversampling * run.block_samples", "0.5 * run.block_samples"),
    "receiver's direction": ("lopsided", "tracks", "-(float)inner(receiver_frame[1], a->arrival), -(float)inner(receiver_frame[2], a->arrival), &r)", "(float)inner(receiver_frame[1], a->arrival), -(float)inner(receiver_frame[2], a->arrival), &r)"),
    "turned the other way": ("airy", "tracks", "turn(r, b, of_air(s->lead,", "turn(r, b, -of_air(s->lead,"),
    "another frequency's lead": ("airy", "tracks", "of_air(s->lead, b,", "of_air(s->lead, BIN_VECTORS - 1 - b,"),
    "lead of what is emitted": ("airy", "tracks", "of_air(s->lead, b, raised)", "of_air(s->lead, b, 0.0f)"),
    "loss of what is emitted": ("airy", "tracks", "of_air(s->nepers, b, raised)", "of_air(s->nepers, b, 0.0f)"),
    "lead from 0 m": ("airy", "tracks", "of_air(s->lead, b, raised) * (a->through - 1.0f)", "of_air(s->lead, b, raised) * a->through"),
    "wind's sign": ("airy", "tracks", "along = receiver->downwind - DOT(path->wind, from)", "along = DOT(path->wind, from) - receiver->downwind"),
    "wind in a half": ("airy", "tracks", "along * along + path->room * squared", "along * along + squared"),
    "wind not in the rate at the source": ("airy", "tracks", "DOT(leaving, velocity)", "path->slowness * DOT(direction, velocity)"),
    "wind not in the rate at the receiver": ("airy", "tracks", "DOT(coming, receiver->velocity)", "path->slowness * DOT(direction, receiver->velocity)"),
    "leaving as without wind": ("airy", "tracks", "unit(leaving)", "direction"),
    "coming as without wind": ("airy", "tracks", "unit(coming)", "direction"),
    "spread over the distance": ("airy", "tracks", "a->length = DOT(a->departure, apart);", "a->length = DOT(direction, apart);"),
    "wind of the room in an image": ("airy", "tracks", "turned_back(image_matrix, slots, slot, wind)", "wind"),
    "downwind of the room's origin": ("airy", "tracks", "DOT(at, wind)", "DOT(apart, wind)"),
}  # fmt: skip


def test_a_mutant_of_what_is_not_there_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"not exactly once in its text is what the mutants \['lost'\] change"):
        Mutants("render", {"kept": MUTANTS["a branch skipped"][1:], "lost": ("no such words", "")})


def _grouped() -> dict[tuple[str, str], dict[str, tuple[str, str]]]:
    """Return the mutants by scene and program."""
    grouped: dict[tuple[str, str], dict[str, tuple[str, str]]] = {}
    for name, (program, old, new) in MUTANTS.items():
        grouped.setdefault(("real", program), {})[name] = (old, new)
    for name, (kind, program, old, new) in ELSEWHERE.items():
        grouped.setdefault((kind, program), {})[name] = (old, new)
    return grouped


GROUPED = _grouped()
FEW = {("real", "branches"), ("turned", "tracks"), ("near", "render")}  # of each program, where least is built


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "program"), few(GROUPED, [i for i, group in enumerate(GROUPED) if group in FEW]))
def test_mutants_are_caught(kind: str, program: str, difference_db, monkeypatch: pytest.MonkeyPatch) -> None:
    mutants = Mutants(program, GROUPED[kind, program])
    mutants.play(monkeypatch)
    scene = ("real", GPU_LAYOUT) if kind == "single" else (kind, None)  # where blocks are written one at a time
    assert difference_db(*scene) < (NEAR_DB if kind == "near" else TOLERANCE_DB), "none of them is chosen"
    found = {name: difference_db(*scene) for name in mutants}
    assert difference_db(*scene) < (NEAR_DB if kind == "near" else TOLERANCE_DB), "none of them is chosen any more"
    # The smallest, the curve of a group of 32 samples, leaves -90 dB.
    assert {name: db for name, db in found.items() if not db > TOLERANCE_DB + 6.0} == {}
    assert found.keys() == GROUPED[kind, program].keys()
