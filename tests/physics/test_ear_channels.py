"""Sampled channels of ears: against the sum over paths in float64, where motion jumps, in pieces, and where they pay."""

import pickle
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.opencl import launch
from clsim.opencl.launch import kernel_source
from clsim.render.methods import ear_channel, ears
from clsim.render.methods.ear_components import ear_components
from clsim.render.methods.ear_responses import ear_responses
from clsim.render.plan import Allocation, Plan
from clsim.render.planning import on_device
from clsim.render.render import record
from clsim.tracks.onward import OnwardTurning, turn_jumps

PROMISED_DB = -86.0
RATE = 16e3
BAND = (200.0, 6e3)
CHANNELS: dict[str, Any] = {"channels": True, "narrowband": False}
CLOCK = clsim.Electronics(clock_ppm=300.0, clock_offset=1e-3, high_cut=5e3, gain_db=20.0)
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # signals that begin at once
]


def turning(times: Any, angles: Any, places: Any = ((4.5, 2.8, 1.2), (4.6, 2.7, 1.2))) -> clsim.Trajectory:
    """Return a motion from one place to another that turns about the vertical through angles, rad."""
    half, ends = 0.5 * np.asarray(angles), np.asarray(places)
    share = np.asarray(times)[:, None] / times[-1]
    quaternions = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)
    return clsim.Trajectory.waypoints(times, ends[0] + share * (ends[1] - ends[0]), orientations=quaternions)


def room_of(
    duration: float, head: clsim.Trajectory, order: int = 2, sources: int = 1, **receiver: Any
) -> clsim.PathSet:
    """Return paths from sources on circles to a spherical head and a microphone, among walls by frequency."""
    soft = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.2, 0.35, 0.5])
    room = clsim.Shoebox((6.0, 5.0, 3.0), {"default": clsim.Material.from_reflection(0.9), "z_min": soft})
    emitters = [
        clsim.Source(
            f"s{i}", clsim.Signal.noise(duration - 0.1, RATE, i, BAND),
            clsim.Trajectory.circle((2.5, 2.5, 1.4), 0.8 + 0.3 * i, 6.0, duration), clsim.FirstOrder(0.5),
            aim=(1.0, 0.0, 0.3),
        )
        for i in range(sources)
    ]  # fmt: skip
    ends = [
        clsim.Receiver("head", head, clsim.SphericalHead(), **receiver),
        clsim.Receiver("microphone", clsim.Trajectory.fixed((4.5, 4.0, 2.5))),
    ]
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), emitters, ends), order)


def walk(duration: float = 0.5, *, smooth: bool = True, **receiver: Any) -> clsim.PathSet:
    """Return the paths of a walk round the corner of an L-shaped room to a head that moves."""
    soft = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.2, 0.35, 0.5])
    room = clsim.MeshRoom.from_plan([(0, 0), (6, 0), (6, 2.6), (2.8, 2.6), (2.8, 5), (0, 5)], 3.0, soft)
    places = [(1.5, 0.9, 1.4), (2.4, 1.0, 1.5), (3.0, 1.4, 1.4), (3.9, 1.2, 1.3)]
    way = clsim.Trajectory.waypoints(np.linspace(0.0, 1.2, 4), places, smooth=smooth)
    walker = clsim.Source("s", clsim.Signal.noise(duration - 0.1, RATE, 0, BAND), way)
    motion = clsim.Trajectory.line((1.2, 4.4, 1.2), (1.9, 3.4, 1.0), 1.3)
    head = clsim.Receiver("head", motion, clsim.SphericalHead(), aim=(1.0, -1.0, 0.0), **receiver)
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [walker], [head]), 2)


def planned(paths: clsim.PathSet, duration: float = 0.3, **options: Any) -> Plan:
    return clsim.plan_render(paths, RATE, **CHANNELS | {"duration": duration} | options)


def sound(plan: Plan) -> np.ndarray:
    return record(plan).samples.astype(np.float64)


def inside(plan: Plan) -> Allocation:
    """Return the allocation among the pairs with ears."""
    return plan.allocation.ears[0].plan.allocation


def apart_db(one: np.ndarray, other: np.ndarray) -> float:
    return float(20.0 * np.log10(max(np.linalg.norm(one - other) / np.linalg.norm(other), 1e-15)))


STEADY = turning((0.0, 0.8), (0.3, 1.9))


@pytest.mark.parametrize(
    ("paths", "options", "parts"),
    [
        pytest.param(lambda: room_of(0.3, STEADY, 1, sources=2), {}, (2, 0), id="a head that turns, two sources"),
        pytest.param(
            lambda: room_of(0.3, turning((0.0, 0.15, 0.8), (0.0, 0.4, -0.4)), 1), {}, (1, 1), id="it turns back"
        ),
        pytest.param(lambda: walk(0.3, electronics=CLOCK), {"transition": 0.0}, (1, 1), id="paths begin, a clock"),
        pytest.param(lambda: walk(0.45, smooth=False), {"duration": 0.45}, (1, 1), id="a velocity jumps"),
    ],
)
def test_it_is_what_the_reference_engine_gives(
    paths: Any, options: dict[str, Any], parts: tuple[int, int], measured: Any
) -> None:
    found = paths()
    plan = planned(found, **options)
    assert (len(inside(plan).channels), len(inside(plan).beside)) == parts
    assert any("impulse responses of" in line for line in plan.describe())
    right = planned(found, **options | {"engine": "reference", "channels": None})
    error = apart_db(sound(plan), sound(right))
    measured("sampled channels", "ears", error, PROMISED_DB)


MUTANTS = {
    "one weight for all components": ("LOAD(own + m) * share", "LOAD(own) * share"),
    "the first path's weights": ("from - first_slot + i) * room", "from - first_slot) * room"),
    "the first point's share": ("spread[j] * gain", "spread[0] * gain"),
    "the first function's grid": ("grid += (long)points * beside;", ""),
    "another function's gain": ("gain[k][i]", "gain[0][i]"),
    "what was there before": ("i < (long)each * points; i++) made[i] = 0.0f", "i < 0; i++) made[i] = 0.0f"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_the_sum_sees_a_kernel_with_one_thing_wrong(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = MUTANTS[name]
    paths = room_of(0.3, STEADY, order=1)
    right = sound(planned(paths, 0.3, channels=False))
    assert apart_db(sound(planned(paths, 0.3)), right) < PROMISED_DB

    def mutated(program: str) -> str:
        text = kernel_source(program)
        assert program != "components" or text.count(old) == 1
        return text.replace(old, new) if program == "components" else text

    monkeypatch.setattr(launch, "kernel_source", mutated)
    assert not apart_db(sound(planned(paths, 0.3)), right) < PROMISED_DB


def test_pieces_go_on_bit_for_bit_and_chunks_hardly_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """From any piece on, as resumed runs and workers render it."""
    paths = walk(1.2)
    plan = planned(paths, 1.2, chunk=18432)
    assert inside(plan).beside
    whole = record(plan).samples
    there = pickle.loads(pickle.dumps(on_device(plan, "0:0")))
    assert [part.plan.options.device for part in (*inside(there).channels, *inside(there).beside)] == ["0:0"] * 2
    later = [piece for _, piece in clsim.render_chunks(there, first=18432)]
    np.testing.assert_array_equal(np.concatenate(later, axis=1), whole[:, 18432:])
    other = planned(paths, 1.2)
    assert apart_db(sound(other), whole) < -105.0  # another grid: images of the spread, and rounding
    monkeypatch.setattr(ear_channel, "_PIECE", 1)  # a segment at a time
    assert apart_db(sound(other), whole) < -105.0


def test_a_few_seconds_of_many_paths_are_sampled_by_themselves() -> None:
    few, many = (room_of(0.6, turning((0.0, 0.8), (0.3, 0.5)), order) for order in (2, 13))
    assert not inside(clsim.plan_render(few, RATE, duration=0.5)).channels
    assert inside(clsim.plan_render(many, RATE, duration=0.5)).channels
    assert not inside(clsim.plan_render(many, RATE, duration=0.5, channels=False)).channels


def test_components_are_the_responses() -> None:
    found = ear_responses(clsim.SphericalHead(), 343.0, RATE, 6.5e3)
    components = ear_components(found)
    drawn = np.random.default_rng(1).standard_normal((100, 3))
    directions = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    made = np.einsum("dm,mcl->dcl", components.weights(directions), components.taps)
    exact = np.roll(np.fft.irfft(found.spectra(directions, 1024, np.complex128), 1024), found.before, axis=-1)
    assert apart_db(made, exact[..., : made.shape[-1]]) < -88.0
    counts = components.vectors(np.array([1.0, 1e-3, 1e-9]))
    assert counts[0] * 8 >= len(components.shares) > counts[1] * 8 - 8 >= counts[2] - 1 == 0


def test_turning_goes_on_beyond_its_ends() -> None:
    motion = turning((0.0, 1.0, 2.0), (0.2, 0.8, 1.8))
    assert motion.turning is not None
    onward = OnwardTurning(motion.turning, 0.0, 2.0)
    times = np.array([-0.5, 0.5, 2.5])
    angles = np.array([-0.1, 0.5, 2.3])
    np.testing.assert_allclose(onward.orientation(times)[:, 2:], np.stack([np.sin(angles / 2), np.cos(angles / 2)], 1))
    np.testing.assert_allclose(onward.angular_velocity(times)[:, 2], [0.6, 0.6, 1.0])
    assert turn_jumps(motion).tolist() == [1.0]


@pytest.mark.parametrize("jumps", [False, True])
def test_the_sum_knows_directions_beside_ends_and_jumps(jumps: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpolation over fewer samples gives the same: few nodes are known in a short run, and none beyond a jump."""
    paths = walk(smooth=False) if jumps else room_of(0.5, clsim.Trajectory.fixed((4.5, 2.8, 1.2)), order=1)
    made = sound(planned(paths, channels=False))
    monkeypatch.setattr(ears, "_SPACINGS", (32,))
    assert apart_db(made, sound(planned(paths, channels=False))) < -100.0


def test_the_sum_follows_the_knots_of_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Directions that change little, but within milliseconds: a head on a small circle of few waypoints."""
    times = np.linspace(0.0, 0.4, 13)
    places = (4.5, 2.8, 1.2) + 0.07 * np.stack([np.cos(15.0 * times), np.sin(15.0 * times), 0.0 * times], axis=1)
    tone = clsim.Signal.tone(11.4e3, 0.3, 48e3, fade=0.01)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((3.5, 3.6, 1.9)))
    head = clsim.Receiver("head", clsim.Trajectory.waypoints(times, places), clsim.SphericalHead())
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.9)), clsim.Air(), [source], [head]
    )
    paths = clsim.find_paths(scene, 0)
    made = clsim.render(paths, 48e3, duration=0.3, channels=False).samples
    monkeypatch.setattr(ears, "_SPACINGS", (64,))
    assert apart_db(made, clsim.render(paths, 48e3, duration=0.3, channels=False).samples) < -90.0
