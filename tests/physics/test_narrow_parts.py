"""Narrow parts and rests: against the oracle, against the plain way, and where neither may be heard."""

import math
import pickle
from dataclasses import replace
from typing import Any

import default_oracle as oracle
import numpy as np
import pytest
from default_cases import Case, abrupt_tones, circles
from default_cases import measured as figures_of
from exhaustive import few
from mutants import Mutants
from test_double_edges import prism

import clsim
from clsim.render import envelope, tilt
from clsim.render.envelope import NarrowFilters, RestFilters
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.batches import GPU_LAYOUT
from clsim.render.plan import NarrowPart, Plan
from clsim.render.planning import on_device
from clsim.render.render import record

RATE = 192e3
PROMISED_DB = -85.0
NARROW: dict[str, Any] = {"narrowband": True}
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # signals that begin at once
]


def moving(signal: clsim.Signal, name: str, order: int) -> Case:
    """Return a scene whose ends sway at up to 10 m/s each."""
    case = abrupt_tones()[3]
    return replace(case, name=name, signals=(signal,), rate=RATE, room=replace(case.room, order=order))


CASES = [
    moving(clsim.Signal.tone(40e3, 0.08, RATE), "abrupt tone, order 3", 3),
    moving(clsim.Signal.chirp(39e3, 41e3, 0.08, RATE), "abrupt chirp, order 3", 3),
    moving(clsim.Signal.tone(40e3, 0.08, RATE, fade=0.01), "faded tone, order 10", 10),
    replace(circles()[1], name="circle, order 10"),
    moving(clsim.Signal.noise(0.08, RATE, 1, (20e3, 45e3)), "noise of 20 to 45 kHz, order 3", 3),
    replace(
        circles()[1], name="noise of 30 to 50 kHz on a circle, order 5", room=replace(circles()[1].room, order=5),
        signals=(clsim.Signal.noise(0.3, RATE, 1, (30e3, 50e3)),),
    ),
    moving(clsim.Signal.chirp(30e3, 70e3, 0.08, RATE, window="tukey"), "chirp of 30 to 70 kHz, order 3", 3),
]  # fmt: skip


@pytest.mark.parametrize("case", few((pytest.param(case, id=case.name) for case in CASES), kept=(0, 3, 4, 5)))
def test_the_sum_is_what_the_oracle_hears(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tilt, "_LEAST_WORK", 0.0)  # tilts in short scenes, too
    case = replace(case, options=NARROW | {"duration": min(case.duration, 0.1)}, samples=500)
    assert case.plan().allocation.narrow
    assert figures_of(case).error_db <= PROMISED_DB


def noisy(order: int = 5, *, partly: bool = False, tilted: bool = True, **options: Any) -> NarrowPart:
    """Return the narrow part of noise of 30 to 50 kHz, with the air's tilt as an imaginary delay or without."""
    case = next(case for case in CASES if "30 to 50 kHz" in case.name)
    paths = clsim.find_paths(case.scene(), order)
    if partly:
        k = np.arange(len(paths))
        start, end = np.where(k % 3 == 1, 0.04 + 5e-4 * k, -np.inf), np.where(k % 3 == 2, 0.06 + 4e-4 * k, np.inf)
        paths = replace(paths, families=(replace(paths.families[0], start=start, end=end),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tilt, "_LEAST_WORK", 0.0)
        if not tilted:
            patch.setattr(envelope, "stretches_of", lambda *_: None)
        plan = clsim.plan_render(paths, RATE, duration=0.15, **NARROW | options)
    part = plan.allocation.narrow[0]
    filters = part.plan.source_filters[0]
    assert isinstance(filters, NarrowFilters)
    assert (filters.stretches.count > 1) == tilted
    return part


def envelopes(part: NarrowPart) -> np.ndarray:
    """Return the envelopes (receivers, n) of a narrow part."""
    return BasebandEngine(part.plan).render(0, part.plan.samples)


@pytest.mark.parametrize("partly", [False, True])
def test_tilts_of_the_air_take_half_the_functions_and_change_nothing(partly: bool) -> None:
    one, other = noisy(partly=partly, transition=5e-3), noisy(partly=partly, transition=5e-3, tilted=False)
    functions = [len(part.plan.source_filters[0].basis) for part in (one, other)]
    assert functions == [2, 4]
    wanted = envelopes(other)
    assert apart_db(envelopes(one), wanted) < -95.0
    assert apart_db(BasebandEngine(one.plan, GPU_LAYOUT).render(0, one.plan.samples), wanted) < -95.0


MUTANTS = {
    "imaginary delay's sign": ("u - was * im", "u + was * im"),
    "its product": ("*a = *b * im + s", "*a = s"),
    "square of the delay": ("mu_squared = mu * mu - nu * nu", "mu_squared = mu * mu"),
    "its imaginary part": ("2.0f * mu * nu", "mu * nu"),
    "rest of the delay": ("mu * tilt_per_sample + paths->nu[p]", "paths->nu[p]"),
    "middle of a stretch": ("((float)stretch + 0.5f) * length", "(float)stretch * length"),
    "stretch of a delay": ("(int)(beyond * per_length)", "(int)(beyond * length)"),
    "signals of a stretch": ("&from_middle) * rows", "&from_middle) * 0"),
    "even and odd branches": ("if (COUNT(0) - q & 1) multiply", "if (!(COUNT(0) - q & 1)) multiply"),
}


def test_mutants_of_tilts_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    part = noisy()
    engine, wanted = BasebandEngine(part.plan), envelopes(part)
    mutants = Mutants("baseband", MUTANTS)
    mutants.play(monkeypatch)
    found = {name: apart_db(engine.render(0, part.plan.samples), wanted) for name in mutants}
    assert apart_db(engine.render(0, part.plan.samples), wanted) < -120.0, "none of them is chosen any more"
    assert {name: db for name, db in found.items() if not db > -90.0} == {}


def scene(*signals: clsim.Signal, duration: float = 0.25, start: float = 0.0, **receiver: Any) -> clsim.Scene:
    """Return a room with walls and beams by frequency: sources on circles, a moving receiver and one at rest."""
    walls = clsim.Material.from_reflection(0.9)
    soft = clsim.Material.from_absorption([20e3, 40e3, 60e3, 80e3], [0.1, 0.2, 0.35, 0.5])
    room = clsim.Shoebox((6.0, 5.0, 3.0), {"default": walls, "z_min": soft})
    beam = clsim.Piston(0.004)
    sources = [
        clsim.Source(
            f"s{i}", signal, clsim.Trajectory.circle((2.5, 2.5, 1.4), 0.8 + 0.3 * (i % 2), 1.0, duration), beam,
            aim=(1.0, 0.0, 0.3), start=start + 0.01 * i,
        )
        for i, signal in enumerate(signals)
    ]  # fmt: skip
    ways = clsim.Trajectory.line((4.0, 1.0, 2.0), (4.0, 1.0 + min(5.0 * duration, 2.0), 2.0), duration), (4.5, 4.0, 2.5)
    ears = [
        clsim.Receiver("moving", ways[0], **receiver),
        clsim.Receiver("at rest", clsim.Trajectory.fixed(ways[1]), beam, aim=(-1.0, 0.0, 0.0)),
    ]
    return clsim.Scene(room, clsim.Air(), sources, ears)


def planned(one: clsim.Scene, order: int = 2, **options: Any) -> Plan:
    return clsim.plan_render(clsim.find_paths(one, order), RATE, **NARROW | options)


def sound(plan: Plan) -> np.ndarray:
    return record(plan).samples.astype(np.float64)


def apart_db(one: np.ndarray, other: np.ndarray) -> float:
    return float(20.0 * np.log10(max(np.linalg.norm(one - other) / np.linalg.norm(other), 1e-15)))


# Onset, an even stretch, end: so short that kernels of the rest, and of the plain way, are those for signals that pause.
TONE = clsim.Signal.tone(40e3, 0.04, RATE)
BEACONS = clsim.Signal.from_array(
    sum(
        clsim.Signal.tone(f, 0.04, RATE, fade=fade).read(0, 7680)
        for f, fade in ((20e3, 0.0), (40e3, 0.01), (60e3, 0.0))
    ),
    RATE,
)
ELECTRONICS = clsim.Electronics(clock_ppm=40.0, clock_offset=1e-3, high_cut=70e3, gain_db=20.0)


@pytest.mark.parametrize(
    ("one", "options", "parts"),
    [
        pytest.param(scene(TONE), {}, [(0,)], id="walls and beams by frequency"),
        pytest.param(scene(clsim.Signal.tone(15e3, 0.1, 48e3)), {"responses": "centre", "motion": "quasi-static"},
                     [(0,)], id="responses at the centre, quasi-static, brought to the sampling rate",
                     marks=pytest.mark.exhaustive),
        pytest.param(scene(TONE, transducer=clsim.Transducer.named("MA40S4R"), electronics=ELECTRONICS), {}, [(0,)],
                     id="transducer, electronics, clock"),
        pytest.param(scene(TONE, clsim.Signal.chirp(20e3, 80e3, 0.04, RATE), TONE), {}, [(0, 2)],
                     id="two narrow sources and a wide one", marks=pytest.mark.exhaustive),
        pytest.param(scene(TONE, clsim.Signal.tone(25e3, 0.03, RATE)), {}, [(0,), (1,)], id="two carriers"),
        pytest.param(scene(BEACONS), {}, [(0,), (0,), (0,)], id="three carriers of one source"),
        pytest.param(scene(clsim.Signal.pulses(clsim.Signal.tone(40e3, 0.03, RATE), 0.07, 3)), {}, [(0,)],
                     id="bursts with pauses"),
    ],
)  # fmt: skip
def test_it_is_what_the_plain_way_gives(one, options, parts, measured) -> None:
    plan = planned(one, **options)
    assert [part.sources for part in plan.allocation.narrow] == parts
    found = apart_db(sound(plan), sound(planned(one, narrowband=False, **options)))
    measured("narrow parts", "the plain way", found, PROMISED_DB)


def test_pairs_at_rest_are_convolved_with_all_of_the_signal() -> None:
    walls, still = clsim.Material.from_reflection(0.8), clsim.Trajectory.fixed((1.0, 2.0, 1.0))
    ears = [
        clsim.Receiver("moving", clsim.Trajectory.line((4.0, 3.0, 1.0), (4.0, 2.0, 1.0), 0.2)),
        clsim.Receiver("at rest", clsim.Trajectory.fixed((4.0, 2.0, 2.0))),
    ]
    one = clsim.Scene(clsim.Shoebox((6.0, 5.0, 3.0), walls), clsim.Air(), [clsim.Source("s", TONE, still)], ears)
    plan = planned(one)
    assert plan.allocation.narrow
    assert len(plan.allocation.convolved) == 1
    got, whole = sound(plan), sound(planned(one, narrowband=False))
    assert all(apart_db(one, other) <= PROMISED_DB for one, other in zip(got, whole, strict=True))


def test_nothing_is_heard_before_an_arrival_less_the_stated_reach() -> None:
    start = 0.05
    walls, way = clsim.Material.from_reflection(0.8), clsim.Trajectory.line((1.0, 2.0, 1.0), (2.0, 2.0, 1.0), 0.2)
    far = clsim.Receiver("far", clsim.Trajectory.line((12.0, 2.0, 1.5), (12.0, 2.001, 1.5), 0.2))
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.1, RATE), way, start=start)
    plan = planned(clsim.Scene(clsim.Shoebox((13.0, 4.0, 3.0), walls), clsim.Air(), [source], [far]))
    got = sound(plan)[0]
    (part,), (rest,) = plan.allocation.narrow, plan.source_filters
    filters = part.plan.source_filters[0]
    assert isinstance(rest, RestFilters)
    assert isinstance(filters, NarrowFilters)
    reach = max(rest.half_length, (filters.half_length + part.upsampler.reach) * part.upsampler.every)
    told = [line for line in plan.describe() if "before an arrival" in line]
    assert any(f"{1e3 * reach / RATE:.3g} ms before an arrival" in line for line in told)
    c = clsim.Air().speed_of_sound
    arrival = (start + math.dist((1.0, 2.0, 1.0), (12.0, 2.0, 1.5)) / c) * RATE - 0.25 * RATE * start
    silent = max(math.floor(arrival) - reach, 0)
    assert silent > 2000
    assert not np.any(got[:silent])
    assert np.abs(got[: math.floor(arrival) - 200]).max() < 1e-4 * np.abs(got).max()  # the skirts take each other away


def test_pieces_go_on_bit_for_bit_and_chunks_hardly_matter() -> None:
    one = scene(TONE, clsim.Signal.chirp(20e3, 80e3, 0.04, RATE, window="tukey"), start=0.07)  # to beyond a chunk's end
    plan = planned(one, chunk=18432)
    whole = sound(plan).astype(np.float32)
    later = [piece for _, piece in clsim.render_chunks(plan, first=18432)]
    np.testing.assert_array_equal(np.concatenate(later, axis=1), whole[:, 18432:])
    assert apart_db(sound(planned(one)), whole) < -125.0


def test_some_windows_do_not_tell_of_a_sweep() -> None:
    signals = clsim.Signal.chirp(39.8e3, 40.2e3, 0.25, RATE), clsim.Signal.noise(0.25, RATE, 1, (39e3, 41e3))
    splits = [planned(scene(signal), order=0).source_filters[0].split for signal in signals]
    assert [split.quiet for split in splits] == [False, True]


def test_rest_and_narrow_part_add_up_to_the_signal() -> None:
    plan = planned(scene(clsim.Signal.tone(40e3, 1.0, RATE), duration=1.0))
    (rest,), filters = plan.source_filters, plan.allocation.narrow[0].plan.source_filters[0]
    assert isinstance(rest, RestFilters)
    assert isinstance(filters, NarrowFilters)
    left, upsampler = rest.emitted_samples(-4000, 196_000), plan.allocation.narrow[0].upsampler
    assert np.mean(left != 0.0) < 0.03  # but for onset and end there is silence
    assert rest.is_silent(40_000, 150_000)
    assert not np.any(left[44_000:154_000])
    assert [rest.is_silent(*ends) for ends in ((-4000, 40_000), (150_000, 196_000))] == [False, False]
    whole = rest.signal.read(-4000, 196_000)
    narrow = np.zeros(200_000)
    every, reach = upsampler.every, upsampler.reach
    first, last = -(4000 // every), 196_000 // every
    made = np.zeros((last - first) * every)
    upsampler.add(filters.emitted(first + 1 - reach, last + reach)[None], first, made[None], 0)
    begin = 4000 + first * every
    narrow[begin : begin + len(made)] = made
    inside = slice(begin, begin + len(made))
    assert apart_db((narrow + left)[inside], whole[inside]) < -95.0
    pieces = np.concatenate([rest.emitted_samples(a, a + 10_000) for a in range(-4000, 196_000, 10_000)])
    np.testing.assert_allclose(pieces, left, atol=2e-5)  # cells at the verge of silence may differ


def shaken(frequency: float, amplitude: float) -> clsim.Trajectory:
    def position(t: np.ndarray) -> np.ndarray:
        return np.array([2.0, 2.0, 1.0]) + amplitude * np.sin(2 * np.pi * frequency * t)[:, None] * np.ones(3)

    return clsim.Trajectory.sampled(position, 0.2, 50 * frequency)


BOX = clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.8))
LEGS = clsim.Trajectory.waypoints([0.0, 0.1, 0.2], [(1, 1, 1), (1.2, 1, 1), (1.2, 1.3, 1)], smooth=False)
NEAR = clsim.Trajectory.line((3.0, 2.0, 1.0), (5.0, 2.0, 1.0), 0.2)
SLOW = clsim.Trajectory.line((3.0, 2.0, 1.0), (3.4, 2.0, 1.0), 0.2)


C, SPOT = 343.0, clsim.Trajectory.fixed((1.5, 2.0, 2.0))
OPEN = clsim.Shoebox((8.0, 6.0, 4.0), clsim.Material.from_reflection(0.0))
STIRRED = clsim.Air(speed_of_sound=C, fluctuation=clsim.Fluctuation(2e-6, 0.2, 0.3, 3))
POINT = clsim.Scatterer.point("p", 0.0, clsim.Trajectory.line((2.5, 2.0, 2.0), (2.4, 2.0, 2.0), 0.1))
PILLAR = prism(0.2, 0.2)
PLATE = clsim.Body(
    "plate",
    clsim.MeshRoom([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], [(0, 1, 2), (0, 2, 3)], BOX.faces.materials[0]),
    clsim.Trajectory.line((2.0, 2.0, 2.0), (1.95, 2.0, 2.0), 0.1),
)


@pytest.mark.parametrize(
    ("room", "ear", "things", "search", "nodes"),
    [
        pytest.param(OPEN, SPOT, {"scatterers": [POINT]}, {}, {"images", "scatterers"}, id="scatterer"),
        pytest.param(OPEN, SPOT, {"air": STIRRED}, {}, {None}, id="air that fluctuates"),
        pytest.param(OPEN, SPOT, {"bodies": [PLATE]}, {"max_order": 1}, {"images", "bodies"}, id="body",
                     marks=pytest.mark.exhaustive),
        pytest.param(
            clsim.MeshRoom(PILLAR.vertices + np.array([1.3, 2.0, 2.0]), PILLAR.triangles, PILLAR.faces.materials[0]),
            clsim.Trajectory.fixed((1.7, 2.05, 2.0)), {}, {"diffraction": 2}, {None}, id="two edges",
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            OPEN, clsim.Trajectory.line((1.02, 2.0, 2.0), (1.12, 2.0, 2.0), 0.1), {}, {}, {"images"},
            id="a receiver 2 cm away",
        ),
    ],
)  # fmt: skip
def test_the_first_block_of_an_envelope_begins_before_anything_sounds(room, ear, things, search, nodes) -> None:
    """From the first sample on it is what the reference engine gives, wherever nodes are made."""
    things = {"air": clsim.Air(speed_of_sound=C)} | things
    source = clsim.Source(
        "s", clsim.Signal.tone(40e3, 0.06, RATE, fade=0.005), clsim.Trajectory.line((1, 2, 2), (1.1, 2, 2), 0.1)
    )
    one = clsim.Scene(room, things.pop("air"), [source], [clsim.Receiver("r", ear)], **things)
    paths = clsim.find_paths(one, **({"max_order": 0} | search))
    assert {family.device for family in paths.families if len(family)} == nodes
    plan = clsim.plan_render(paths, RATE, duration=0.05, **NARROW)
    assert plan.allocation.narrow
    whole = clsim.render(paths, RATE, duration=0.05, engine="reference").pressure.astype(np.float64)
    level = np.sqrt(np.mean(whole[:, : round(0.02 * RATE)] ** 2))
    parts = (sound(plan) - whole).reshape(-1, round(0.0025 * RATE))
    assert 20.0 * np.log10(np.sqrt(np.mean(parts**2, axis=1)).max() / level) <= PROMISED_DB


@pytest.mark.parametrize(
    ("way", "why"),
    [
        pytest.param(LEGS, "the velocity of the source jumps", id="legs"),
        pytest.param(NEAR, "receiver 0 is passed so near, at up to 10.2 m/s", id="near"),
        pytest.param(shaken(800.0, 2e-4), "ends move so quickly", id="shaken"),
        pytest.param(SLOW, "scatterer 0 is passed so near", id="scatterer"),
    ],
)
def test_where_envelopes_would_not_do_the_plain_way_is_taken_and_told(way: clsim.Trajectory, why: str) -> None:
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 2.012, 1.0)))]
    things = [clsim.Scatterer.point("p", -40.0, clsim.Trajectory.fixed((3.2, 2.015, 1.0)))]
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.2, RATE), way)
    one = clsim.Scene(BOX, clsim.Air(), [source], ears, scatterers=things if "scatterer" in why else [])
    plan = planned(one, order=1)
    assert not plan.allocation.narrow
    (told,) = [line for line in plan.describe() if "without a narrow part" in line]
    assert why in told


def test_slow_shaking_is_narrow() -> None:
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 2.5, 1.0)))]
    one = clsim.Scene(BOX, clsim.Air(), [clsim.Source("s", TONE, shaken(25.0, 1e-3))], ears)
    assert planned(one, order=1).allocation.narrow


def test_paths_that_begin_and_end_at_once_are_rendered_plainly() -> None:
    paths = clsim.find_paths(scene(TONE), 1)
    family = paths.families[0]
    heard = replace(family, start=np.where(np.arange(len(family.start)) == 3, 0.1, family.start))
    plan = clsim.plan_render(replace(paths, families=(heard,)), RATE, transition=0.0, **NARROW)
    assert not plan.allocation.narrow
    assert any(line.endswith("paths begin and end at once") for line in plan.describe())


@pytest.mark.parametrize(
    "options",
    [{"interpolator": clsim.Lagrange(12)}, {"engine": "reference"}, {"narrowband": None}, {"narrowband": False}],
)
def test_other_engines_filters_and_few_paths_take_the_plain_way(options: dict[str, Any]) -> None:
    plan = planned(scene(clsim.Signal.tone(40e3, 0.02, RATE), duration=0.03), order=0, **options)
    assert not plan.allocation.narrow
    assert not plan.allocation.notes


def test_tracks_from_elsewhere_take_the_plain_way() -> None:
    tracks = clsim.Tracks.from_samples([0.0, 0.1], [[0.010, 0.011]], [[0.3, 0.3]])
    tone = clsim.Signal.tone(40e3, 0.05, RATE)
    made, plain = (clsim.render_tracks([tone], tracks, RATE, narrowband=choice).samples for choice in (True, False))
    np.testing.assert_array_equal(made, plain)


def test_the_oracle_sees_a_wrong_carrier(monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes out a tenth of a turn late is far from what is right: the bounds above can fail."""
    case = replace(CASES[0], options=NARROW | {"duration": 0.08}, samples=400)
    late = figures_of(case, lambda pressure: np.roll(pressure, 1, axis=1))
    assert late.error_db > -20.0
    assert oracle.QUIET_DB < 0.0


def test_a_plan_for_another_device_takes_its_narrow_parts_along() -> None:
    plan = planned(scene(TONE))
    there = on_device(plan, "0:0")
    assert [part.plan.options.device for part in there.allocation.narrow] == ["0:0"]
    np.testing.assert_array_equal(sound(pickle.loads(pickle.dumps(there))), sound(plan))


def test_envelopes_round_edges_have_one_complex_gain_for_two_functions() -> None:
    """Fields of edges turn phases: of two functions the second is the first one times j, and its filter is not used."""
    room = clsim.MeshRoom(PILLAR.vertices + np.array([1.3, 2.0, 2.0]), PILLAR.triangles, PILLAR.faces.materials[0])
    ear = clsim.Trajectory.line((1.7, 2.1, 2.0), (1.7, 2.12, 2.0), 0.1)
    sweep = clsim.Signal.chirp(35e3, 45e3, 0.1, RATE, window="tukey")
    sources = [clsim.Source("s", sweep, clsim.Trajectory.fixed((1.0, 1.95, 2.0)))]
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), sources, [clsim.Receiver("r", ear)]), 0, diffraction=1)
    plan = clsim.plan_render(paths, RATE, duration=0.05, **NARROW)
    functions = plan.allocation.narrow[0].plan.source_filters[0].basis
    assert functions.paired
    assert len(functions) % 2 == 0
    exact = clsim.render(paths, RATE, duration=0.05, engine="reference").pressure
    assert apart_db(sound(plan), exact) < PROMISED_DB
