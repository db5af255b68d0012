"""Sampled channels: against the oracle, against their float64 twin, against the sum over paths, and where they are not used."""

import pickle
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from default_cases import Case, circles
from default_cases import measured as figures_of
from default_oracle import Circle, Line, Room
from exhaustive import few

import clsim
from clsim.opencl import launch
from clsim.opencl.launch import kernel_source
from clsim.render import channel_grid
from clsim.render.channel_grid import (
    NODES,
    OVERSAMPLING,
    TAPS,
    ChannelFilters,
    node_window,
    reference_channels,
    spread,
    window_at,
    window_table,
)
from clsim.render.methods.channel_split import Splitter
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.opencl import branch_signals, channel_engine, nodes
from clsim.render.opencl.channel_engine import ChannelEngine, TaperedEngine
from clsim.render.plan import Plan, node_times
from clsim.render.planning import on_device
from clsim.render.render import record
from clsim.render.source_filters import Emission

PROMISED_DB = -86.0
LEFT_DB = -83.0  # of what is summed beside them alone: tapers as lines over subblocks; measured -84.7
TWIN_DB = -105.0  # float32 and linear phases beside float64: measured -112 to -118
RATE = 16e3
CHANNELS: dict[str, Any] = {"channels": True, "narrowband": False}
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # signals that begin at once, tables that end
]


def case(name: str, band: tuple[float, float], rate: float, order: int, speed: float, length: float) -> Case:
    room, noise = (
        Room((6.0, 5.0, 3.0), 0.9, order, clsim.Air().speed_of_sound),
        clsim.Signal.noise(length, rate, 1, band),
    )
    ends = (
        (Circle((3.0, 2.5, 1.4), 1.0, 2.0 * np.pi / speed),),
        (Line((4.9, 0.8, 1.2)), Line((5.0, 1.0, 1.0), (-0.5, 0.4, 0.2))),
    )
    return Case(name, room, (noise,), *ends, rate, length, samples=1500, options=CHANNELS | {"duration": length})


CASES = [
    case("speech band, order 8", (100.0, 6500.0), RATE, 8, 1.0, 0.6),
    case("ultrasound, order 4", (20e3, 80e3), 192e3, 4, 1.0, 0.1),
    case("up to 20 kHz, fast", (500.0, 19.5e3), 48e3, 3, 5.0, 0.3),
    replace(circles()[1], name="a tone, order 10", options=CHANNELS | {"duration": 0.1}, samples=500),
]  # fmt: skip


@pytest.mark.parametrize("one", few((pytest.param(one, id=one.name) for one in CASES), kept=(0, 1)))
def test_the_promise_is_kept_against_the_oracle(one: Case, measured: Any) -> None:
    assert one.plan().allocation.channels
    found = figures_of(one).error_db
    measured("sampled channels", "the oracle", found, PROMISED_DB)


def scene(
    duration: float = 0.5, sources: int = 1, start: float = 0.0, air: clsim.Air | None = None, **receiver: Any
) -> clsim.Scene:
    """Return a room of walls and beams by frequency: sources on circles, one receiver moving and one at rest."""
    soft = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.2, 0.35, 0.5])
    room = clsim.Shoebox((6.0, 5.0, 3.0), {"default": clsim.Material.from_reflection(0.9), "z_min": soft})
    beam = clsim.FirstOrder(0.5)
    emitters = [
        clsim.Source(
            f"s{i}", clsim.Signal.noise(duration - 0.1, RATE, i, (200.0, 6e3)),
            clsim.Trajectory.circle((2.5, 2.5, 1.4), 0.8 + 0.3 * i, 6.0, duration), beam, aim=(1.0, 0.0, 0.3), start=start,
        )
        for i in range(sources)
    ]  # fmt: skip
    ears = [
        clsim.Receiver("moving", clsim.Trajectory.waypoints(
            np.linspace(0.0, duration, 4), [(4.0, 1.0 + 0.5 * k * duration, 2.0 - 0.03 * k * k) for k in range(4)]), **receiver),
        clsim.Receiver("at rest", clsim.Trajectory.fixed((4.5, 4.0, 2.5)), beam, aim=(-1.0, 0.0, 0.0)),
    ]  # fmt: skip
    return clsim.Scene(room, air or clsim.Air(), emitters, ears)


def planned(one: clsim.Scene, order: int = 4, **options: Any) -> Plan:
    return clsim.plan_render(clsim.find_paths(one, order), RATE, **CHANNELS | options)


def apart_db(one: np.ndarray, other: np.ndarray) -> float:
    return float(20.0 * np.log10(max(np.linalg.norm(one - other) / np.linalg.norm(other), 1e-15)))


def sound(plan: Plan) -> np.ndarray:
    samples = record(plan).samples
    return samples.astype(np.result_type(samples, np.float64))


def sweeping(duration: float = 0.5, **more: Any) -> clsim.Scene:
    """Return the scene with a sweep that is all within 3 to 5 kHz."""
    one = scene(duration, **more)
    sweep = clsim.Signal.chirp(3.3e3, 4.7e3, duration=duration - 0.1, sampling_rate=RATE, window="hann")
    sources = [
        clsim.Source(s.name, sweep, s.trajectory, s.directivity, aim=(1.0, 0.0, 0.3), start=s.start)
        for s in one.sources
    ]
    return clsim.Scene(one.room, one.air, sources, one.receivers)


ENVELOPE: dict[str, Any] = {"baseband": (3.9e3, 3.2e3)}  # its carrier turns by 0.975 in a sample


@pytest.mark.parametrize("options", [{}, ENVELOPE], ids=["sound", "envelope"])
def test_the_device_gives_what_the_twin_in_float64_gives(options: dict[str, Any], measured: Any) -> None:
    plan = planned(sweeping(0.3) if options else scene(0.3), **options)
    (part,) = plan.allocation.channels
    exact = reference_channels(part, 0, plan.samples)
    found = apart_db(sound(plan), exact)
    measured("sampled channels", "the twin", found, TWIN_DB)


MUTANTS = {
    "delays of the block's beginning": ("LOAD(c + 3 * BESIDE), t);", "LOAD(c + 3 * BESIDE), -1.0f);"),
    "gains of the block's beginning": ("LOAD(g + 3 * power), t);", "LOAD(g + 3 * power), -1.0f);"),
    "a point beside three samples": ("4 * thirds + nearest", "3 * thirds + nearest"),
    "one sample for a point": ("+ rest) * 1.33333333f", "+ rest) * 1.0f"),
    "nothing between phases": ("* between;", "* 0.0f;"),
    "the next phase": ("nearest(left) + 1;", "nearest(left) + 2;"),
    "the next point": ("- (TAPS / 2 - 1)", "- (TAPS / 2)"),
    "the first path's gain for all": ("spread * gain[k][part][i]", "spread * gain[k][part][0]"),
    "one function for all": ("(DELAY_TERMS + first_gain + k) * BESIDE;", "DELAY_TERMS * BESIDE;"),
    "the last eight paths left out": ("i < here; i++", "i < here - BESIDE; i++"),
    "the wrong block": ("row = node_block[first_node + node];", "row = node_block[0];"),
    "the first node for all": ("GRID_OF(node, 0) + at[i]", "GRID_OF(0, 0) + at[i]"),
    "what was there before": ("i < UNITS * FUNCTIONS * 2 * groups * WIDE;", "i < UNITS * FUNCTIONS * groups * WIDE;"),
    "the first function left out": ("function == 0)", "function < 2)"),
    "one filter for all": ("function * (long)spectrum;", "0 * (long)spectrum;"),
    "both nodes at one time": ("first_sample + apart, length", "first_sample, length"),
    "a pass turned the other way": (
        "if (!inverse && k) TURN(a, b, from, turns[2 * k - 2], turns",
        "if (!inverse && k) TURN(a, b, from, turns[2 * k - 2], -turns",
    ),
    "lanes without their turns": ("TURN_LANES(a, b, of->lane_turns", "TURN_LANES(a, b, of->back_turns"),
    "the other half of a spectrum": ("j < KEPT / 2 ? j", "j < KEPT / 2 ? j + 1"),
}
OF_ENVELOPES = {
    "delays without their high powers": ("rest += t * t * t * t *", "rest += 0.0f *"),
    "a carrier that turns by whole samples": ("rest * half_turns_per_sample", "0.0f * half_turns_per_sample"),
    "a carrier that turns within a sample only": ("whole_turn(whole[j], turn_per_sample)", "0.0f"),
    "a carrier that turns the other way": ("-own * sine", "own * sine"),
    "imaginary parts left out": ("part <= ENVELOPE; part++", "part < 1; part++"),
    "emitted by the first node for all": ("(first_unit + u) * (long)inner_stride", "0 * (long)inner_stride"),
}


@pytest.mark.parametrize("name", [*MUTANTS, *OF_ENVELOPES])
def test_the_twin_sees_a_kernel_with_one_thing_wrong(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = (MUTANTS | OF_ENVELOPES)[name]
    monkeypatch.setattr(launch, "kernel_source", lambda program: mutated(program, old, new))
    monkeypatch.setattr(channel_engine, "_AT_ONCE", 1)  # few nodes at a time
    plan = planned(sweeping(0.3), order=2, **ENVELOPE) if name in OF_ENVELOPES else planned(scene(0.3), order=2)
    (part,) = plan.allocation.channels
    made = np.zeros((plan.row_count, plan.samples), np.complex64 if name in OF_ENVELOPES else np.float32)
    ChannelEngine(part.plan, part.spacing).add(made, 0)  # what is no number is no error here
    assert not apart_db(made, reference_channels(part, 0, plan.samples)) <= TWIN_DB


def mutated(program: str, old: str, new: str, wanted: str = "scatter") -> str:
    text = kernel_source(program)
    if program != wanted:
        return text
    assert text.count(old) == 1
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("one", "options"),
    [
        pytest.param(scene(), {}, id="walls and beams by frequency"),
        pytest.param(scene(start=0.03123), {"responses": "centre"}, id="begins later, responses at the centre"),
        pytest.param(scene(sources=2), {}, id="two sources"),
        pytest.param(scene(air=clsim.Air(wind=(3.0, -2.0, 0.5))), {}, id="wind"),
        pytest.param(scene(air=clsim.Air((20.0, 24.0), heights=(0.0, 3.0))), {}, id="air by height, nodes by the host",
                     marks=pytest.mark.exhaustive),
        pytest.param(
            scene(electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=1e-3, high_cut=5e3, gain_db=20.0)), {},
            id="electronics, clock",
        ),
        pytest.param(sweeping(sources=2, start=0.01), ENVELOPE, id="envelopes of two sources"),
        pytest.param(
            sweeping(air=clsim.Air(wind=(3.0, -2.0, 0.5)), directivity=clsim.Ambisonic(1), aim="forward",
                     electronics=clsim.Electronics(clock_ppm=300.0, clock_offset=1e-3)), ENVELOPE,
            id="envelopes, several channels, clock, wind",
        ),
    ],
)  # fmt: skip
def test_it_is_what_the_reference_engine_gives(one: clsim.Scene, options: dict[str, Any], measured: Any) -> None:
    plan = planned(one, order=2, **options)
    assert len(plan.allocation.channels) == len(one.sources)
    assert any("impulse responses of 2 pairs are sampled" in line for line in plan.describe())
    right = planned(one, order=2, **options | {"engine": "reference", "channels": None})
    found = apart_db(sound(plan), sound(right))
    measured("sampled channels", "the reference engine", found, PROMISED_DB)


def test_pieces_go_on_bit_for_bit_and_chunks_hardly_matter() -> None:
    one = scene(2.6)
    plan = planned(one, order=2, chunk=18432)
    whole = sound(plan).astype(np.float32)
    later = [piece for _, piece in clsim.render_chunks(plan, first=18432)]
    np.testing.assert_array_equal(np.concatenate(later, axis=1), whole[:, 18432:])
    assert apart_db(sound(planned(one, order=2)), whole) < -105.0  # another grid: images of the spread, and rounding
    envelopes = planned(sweeping(2.6), order=2, chunk=1, **ENVELOPE)
    pieces = [piece for _, piece in clsim.render_chunks(envelopes, first=envelopes.chunk)]
    assert len(pieces) > 1
    np.testing.assert_array_equal(np.concatenate(pieces, axis=1), record(envelopes).samples[:, envelopes.chunk :])


def test_receivers_are_known_at_all_instants_that_kernels_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains are told from the nodes of whole stretches of blocks, also behind the last block of a slow run."""
    known: list[int] = []
    read: list[int] = []
    make = nodes.NodeMaker.nodes

    def kept(start: int, block: int, count: int, rate: float) -> Any:
        known.append(count)
        return node_times(start, block, count, rate)

    def made(self: Any, chunk: Any, start: int, block: int, blocks: int, *more: Any) -> Any:
        each, segments = plan.segment // block, -(-blocks * block // plan.segment)
        read.append((segments - 1) * each + -(-each // 24) * 24 + 4)  # a stretch has 24 blocks, see smooth.h
        return make(self, chunk, start, block, blocks, *more)

    monkeypatch.setattr(nodes, "node_times", kept)
    monkeypatch.setattr(nodes.NodeMaker, "nodes", made)
    source = clsim.Source("s", clsim.Signal.noise(4.0, RATE, 1), clsim.Trajectory.fixed((4.0, 3.0, 1.0)))
    ear = clsim.Receiver("r", clsim.Trajectory.line((3.0, 2.4, 1.2), (3.01, 2.41, 1.2), 4.0))
    slow = clsim.Scene(
        clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.8)), clsim.Air(), [source], [ear]
    )
    plan = planned(slow)
    sound(plan)
    assert read
    assert [a <= b for a, b in zip(read, known, strict=True)] == [True] * len(read)


def test_what_is_handed_over_goes_on_bit_for_bit_and_goes_with_its_plan() -> None:
    """From any piece on, as resumed runs and workers render it."""
    plan = of_walk(walk(1.25, 2), chunk=18432, duration=1.25)
    assert plan.allocation.beside
    whole = sound(plan).astype(np.float32)
    there = pickle.loads(pickle.dumps(on_device(plan, "0:0")))
    assert [part.plan.options.device for part in there.allocation.beside] == ["0:0"]
    later = [piece for _, piece in clsim.render_chunks(there, first=18432)]
    np.testing.assert_array_equal(np.concatenate(later, axis=1), whole[:, 18432:])


def test_pairs_at_rest_are_convolved_beside_channels() -> None:
    one = scene()
    still = [
        clsim.Source("still", clsim.Signal.noise(0.3, RATE, 7, (200.0, 6e3)), clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    ]
    both = clsim.Scene(one.room, one.air, [*one.sources, *still], one.receivers)
    plan = planned(both, order=2)
    assert len(plan.allocation.convolved) == 1
    assert [len(part.pairs) for part in plan.allocation.channels] == [2, 1]
    assert apart_db(sound(plan), sound(planned(both, order=2, channels=False))) <= PROMISED_DB


def test_nothing_sounds_before_an_arrival() -> None:
    """Whole windows of nodes are transformed, so that there is rounding within one, and nothing at all before."""
    one, start = scene(1.2), 0.8
    late = replace(one.sources[0], signal=clsim.Signal.noise(0.2, RATE, 3, (200.0, 6e3)), start=start)
    plan = planned(clsim.Scene(one.room, one.air, [late], one.receivers), order=2)
    (part,) = plan.allocation.channels
    channel, made = ChannelFilters.of(plan.source_filters[0]), sound(plan)
    grid = channel.grid(0.0, plan.tracks.longest_delay(0.0, 1.2), part.spacing)
    onset = int(start * RATE)
    assert onset > grid.size + 1000
    assert not np.any(made[:, : onset - grid.size])
    assert np.abs(made[:, : onset - channel.ringing]).max() < 1e-6 * np.abs(made).max()


def walk(
    duration: float = 0.5,
    order: int = 2,
    *,
    air: clsim.Air | None = None,
    smooth: bool = True,
    sources: int = 1,
    **receiver: Any,
) -> clsim.PathSet:
    """Return the paths of a walk round the corner of an L-shaped room, past a receiver in the other arm that moves."""
    soft = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.2, 0.35, 0.5])
    room = clsim.MeshRoom.from_plan([(0, 0), (6, 0), (6, 2.6), (2.8, 2.6), (2.8, 5), (0, 5)], 3.0, soft)
    places = np.array([(1.5, 0.9, 1.4), (2.4, 1.0, 1.5), (3.0, 1.4, 1.4), (3.9, 1.2, 1.3)])
    walkers = [
        clsim.Source(
            f"s{i}", clsim.Signal.noise(duration - 0.1, RATE, i, (200.0, 6e3)),
            clsim.Trajectory.waypoints(np.linspace(0.0, 1.2, 4), places - (0.0, 0.3 * i, 0.0), smooth=smooth),
        )
        for i in range(sources)
    ]  # fmt: skip
    ear = clsim.Receiver("r", clsim.Trajectory.line((1.2, 4.4, 1.2), (1.9, 3.4, 1.0), 1.3), **receiver)
    return clsim.find_paths(clsim.Scene(room, air or clsim.Air(), walkers, [ear]), order)


def of_walk(paths: clsim.PathSet, **options: Any) -> Plan:
    return clsim.plan_render(paths, RATE, **CHANNELS | {"duration": 0.5} | options)


CLOCK = clsim.Electronics(clock_ppm=300.0, clock_offset=1e-3, high_cut=5e3, gain_db=20.0)


@pytest.mark.parametrize(
    ("given", "options"),
    [
        pytest.param({"sources": 2, "directivity": clsim.FirstOrder(0.5), "aim": (1.0, -1.0, 0.0)}, {}, id="a beam, two sources"),
        pytest.param({"directivity": clsim.Ambisonic(1)}, {}, id="four channels"),
        pytest.param({"electronics": CLOCK}, {"transition": 0.0}, id="a clock, begins at once"),
        pytest.param({"air": clsim.Air((20.0, 24.0), heights=(0.0, 3.0)), "order": 1}, {}, id="air by height, nodes by the host"),
    ],
)  # fmt: skip
def test_paths_that_begin_and_end_are_handed_over(
    given: dict[str, Any], options: dict[str, Any], measured: Any
) -> None:
    paths = walk(**given)
    plan = of_walk(paths, **options)
    assert len(plan.allocation.channels) == len(plan.tracks.scene.sources)
    assert any("beginnings, ends and" in line for line in plan.describe())
    right = of_walk(paths, **options | {"engine": "reference", "channels": None})
    found = apart_db(sound(plan), sound(right))
    measured("sampled channels", "paths that begin and end", found, PROMISED_DB)


def beside_twins(plan: Plan) -> tuple[float, float]:
    """Return the errors of sampled channels and of the sum beside them, relative to their twins in float64, dB."""
    (part,), (beside,) = plan.allocation.channels, plan.allocation.beside
    made = np.zeros((plan.row_count, plan.samples), np.float32)
    ChannelEngine(part.plan, part.spacing).add(made, 0)
    left = TaperedEngine(beside.plan).render(0, plan.samples)
    return (
        apart_db(made, reference_channels(part, 0, plan.samples)),
        apart_db(left, ReferenceEngine(beside.plan).render(0, plan.samples)),
    )


TAPER_MUTANTS = {
    "no taper of responses": ("scatter", "own *= share;", ""),
    "rises only": ("scatter", "taken(sample - LOAD(rise + from + i), sample - LOAD(fall + from + i)", "taken(sample - LOAD(rise + from + i), -FAR"),
    "a taper too long": ("taper_gains", "since_fall * per_half", "since_fall * 0.99f * per_half"),
    "no taper of what is left": ("taper_gains", "block < last", "block < first"),
    "the taper itself": ("taper_gains", "1.0f - taken", "taken"),
    "a cubic without its curve": ("taper_gains", "c[0] = inner - INNER * INNER * c[2 * power]", "c[0] = inner"),
    "fades twice": ("fades", "if (is_steady(n / subblock, subblock, start[fade], end[fade], per_ramp)) continue;", ""),
    "fades never": ("trim_activity", "first < last ? MASK(first, last) : 0", "0"),
}  # fmt: skip


@pytest.mark.parametrize("name", [None, *TAPER_MUTANTS])
def test_the_twins_see_tapers_with_one_thing_wrong(name: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = of_walk(walk(0.4, 2), duration=0.4)
    if name is not None:
        wanted, old, new = TAPER_MUTANTS[name]
        monkeypatch.setattr(launch, "kernel_source", lambda program: mutated(program, old, new, wanted))
    channels_db, left_db = beside_twins(plan)
    assert (channels_db <= TWIN_DB and left_db <= LEFT_DB) == (name is None)


NEAR = clsim.Trajectory.line((3.0, 2.0, 1.0), (5.0, 2.0, 1.0), 0.5)
LEGS = clsim.Trajectory.waypoints([0.0, 0.2, 0.5], [(1, 1, 1), (1.2, 1, 1), (1.2, 1.3, 1)], smooth=False)


@pytest.mark.parametrize("way", [pytest.param(NEAR, id="near"), pytest.param(LEGS, id="legs")])
def test_only_what_changes_fast_is_summed(way: clsim.Trajectory, measured: Any) -> None:
    """The direct path that is passed, all of the time, and all paths about the corner of a way."""
    source = clsim.Source("s", clsim.Signal.noise(0.4, RATE, 1, (200.0, 6e3)), way)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 2.012, 1.0)))
    room = clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.9))
    one = clsim.Scene(room, clsim.Air(), [source], [ear])
    plan = planned(one, order=1)
    (beside,) = plan.allocation.beside
    assert len(beside.plan.tracks.pairs[0]) == (1 if way is NEAR else 14)
    found = apart_db(sound(plan), sound(planned(one, order=1, channels=False)))
    measured("sampled channels", "the sum over paths", found, PROMISED_DB)


def boxed(way: clsim.Trajectory, places: list[tuple[float, float, float]], order: int, rate: float) -> clsim.PathSet:
    """Paths of a source in a shoebox to some places."""
    source = clsim.Source("s", clsim.Signal.noise(way.end, rate, 1, (200.0, 0.375 * rate)), way)
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places)]
    room = clsim.Shoebox((6.0, 6.0, 2.7), clsim.Material.from_reflection(0.9))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(absorption=False), [source], ears), order)


EAR = (4.9, 1.1, 1.6)
SLOW = clsim.Trajectory.line((1.0, 2.0, 1.2), (1.245, 2.245, 1.2), 3.5)
PAST = clsim.Trajectory.line((1.7, 1.12, 1.2), (2.3, 1.12, 1.2), 1.0)
TURN = clsim.Trajectory.waypoints([0.0, 0.3, 1.0], [(1, 5, 1.2), (1.3, 4.6, 1.3), (1.4, 4.4, 1.2)], smooth=False)


@pytest.mark.parametrize(
    ("paths", "options"),
    [
        pytest.param(lambda: boxed(SLOW, [EAR], 0, 48e3), {}, id="pieces whose longest delays differ"),
        pytest.param(lambda: boxed(PAST, [(2.0, 1.1, 1.2), EAR], 1, RATE), {}, id="one of two receivers is passed"),
        pytest.param(lambda: boxed(TURN, [EAR], 1, 48e3), {}, id="transitions over several short blocks"),
        pytest.param(lambda: boxed(TURN, [EAR], 1, 48e3), {"transition": 0.05}, id="a long transition"),
    ],
)
def test_every_receiver_gets_the_sum_over_paths_all_of_the_time(paths: Any, options: dict[str, Any]) -> None:
    """In windows of 30 ms; in each of these cases something else than the paths was once added for a while."""
    found = paths()
    rate, duration = found.scene.sources[0].emitted.sampling_rate, found.scene.sources[0].emitted.duration
    given = {"duration": duration, "narrowband": False} | options
    taken, summed = (clsim.render(found, rate, channels=channels, **given).samples for channels in (True, False))
    assert any("are sampled" in line for line in clsim.plan_render(found, rate, channels=True, **given).describe())
    window = round(0.03 * rate)
    for one, other in zip(taken.astype(np.float64), summed.astype(np.float64), strict=True):
        count = len(other) // window * window
        wrong, level = (np.sqrt(np.mean(x[:count].reshape(-1, window) ** 2, axis=1)) for x in (one - other, other))
        assert wrong.max() <= 10 ** (PROMISED_DB / 20) * level.max()


@pytest.mark.parametrize(
    "options",
    [{"interpolator": clsim.Lagrange(12)}, {"engine": "reference"}, {"channels": None}, {"channels": False}],
)
def test_other_engines_filters_and_few_paths_take_the_sum(options: dict[str, Any]) -> None:
    plan = planned(scene(0.3), order=1, **options)
    assert not plan.allocation.channels
    assert not any("sampled channels" in line for line in plan.describe())


def test_thousands_of_paths_are_sampled_by_themselves() -> None:
    assert planned(scene(1.0), order=14, channels=None, narrowband=None).allocation.channels


def test_paths_that_have_not_arrived_cost_the_sum_nothing() -> None:
    """In 100 ms the sum over thousands of paths works on the few that have arrived by then."""
    assert not planned(scene(0.3), order=15, channels=None, narrowband=None, duration=0.1).allocation.channels


def test_the_sum_takes_the_seconds_in_which_paths_sound() -> None:
    found = clsim.find_paths(scene(0.5, start=0.1), 3)
    plan = clsim.plan_render(found, RATE, **CHANNELS)
    tracks = plan.tracks.of_scene
    assert tracks is not None
    emission = Emission.of(0, (found.scene.sources[0].emitted, 0.1), tracks, plan.options, 0.45, tracks, static=False)
    splitter, pairs = Splitter.of(emission, tracks, [0, 1]), (0, 1)
    times, sounding = np.linspace(0.0, 0.45, 901), 0.0
    for pair in pairs:
        emitted = times - tracks.evaluate(pair, times, plan.source_filters[0].basis)[0]
        sounding += float(np.sum((emitted >= 0.1) & (emitted <= 0.5))) * 0.45 / 901
    # Delays are bounded by what they can be at the speeds of both ends, a few milliseconds to either side.
    assert sounding <= splitter.summed(pairs) <= 1.06 * sounding


def test_functions_of_frequency_are_drawn_from_the_loudest_of_many_paths() -> None:
    """Any 4096 of the 11 521 paths leave a residual of -80 dB, where -90 dB is requested."""
    noise = clsim.Signal.noise(0.5, 192e3, 1, (1e3, 82e3))
    source = clsim.Source("s", noise, clsim.Trajectory.line((1.0, 2.0, 1.4), (1.45, 2.2175, 1.4), 0.5))
    room = clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.9))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((4.9, 0.8, 1.2)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), 20)
    plan = clsim.plan_render(paths, 192e3, duration=0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # engines warn of residuals above the requested error
        record(plan)


def test_the_spread_of_a_path_is_a_delay() -> None:
    """Over its band the grid's spectrum, over that of the window, is the phase of the delay: images are 101 dB below."""
    points, place = 1000, 500.3712
    grid = spread(np.array([place]), np.ones((1, 1)), points)[0]
    f = np.arange(points // 2 + 1) / points
    found = np.fft.rfft(grid) / channel_grid.window_spectrum(f)
    inside = f < 0.5 * channel_grid.WIDEST * 3 / 4
    wrong = np.abs(found - np.exp(-2j * np.pi * f * place))[inside]
    assert 20.0 * np.log10(wrong.max()) < channel_grid.SPREAD_ERROR_DB + 1.0
    assert 20.0 * np.log10(wrong.max()) > -110.0  # a wider window would be a waste


def test_the_table_is_the_window() -> None:
    table = window_table()
    phase = 0.123456789
    row, rest = divmod(phase * channel_grid.PHASES, 1.0)
    found = table[int(row) + 1, 0] + rest * table[int(row) + 1, 1]
    # Linear between phases: an eighth of the second difference, which is at most 8 / TAPS^2 of the shape.
    np.testing.assert_allclose(found, window_at(np.arange(1 - TAPS // 2, TAPS // 2 + 1) - phase), atol=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_nodes_hold_what_changes_as_fast_as_they_are_made_for(share: float) -> None:
    spacing = 40
    change = share / (2.0 * OVERSAMPLING)  # cycles from node to node
    window, within = node_window(spacing), np.arange(spacing)
    found = np.zeros(spacing, dtype=complex)
    for n in range(1 - NODES, NODES + 1):
        inside = np.abs(within - n * spacing) < NODES * spacing
        found[inside] += np.exp(2j * np.pi * change * n) * window[within[inside] - n * spacing + NODES * spacing - 1]
    wrong = np.abs(found - np.exp(2j * np.pi * change * within / spacing))
    # What is passed and the nearest image are each within the window's error; at the end of the band both add up
    # (6 dB), and Kaiser's formula is right within 1 dB.
    assert 20.0 * np.log10(wrong.max()) < channel_grid.NODE_ERROR_DB + 7.0
    assert share == 0.0 or 20.0 * np.log10(wrong.max()) > -130.0


def test_a_plan_for_another_device_takes_its_channels_along() -> None:
    plan = planned(scene(0.3), order=2)
    there = on_device(plan, "0:0")
    assert [part.plan.options.device for part in there.allocation.channels] == ["0:0"]
    np.testing.assert_array_equal(sound(pickle.loads(pickle.dumps(there))), sound(plan))


def test_many_paths_take_several_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Receivers apart, and a receiver's paths in parts, whose responses are added up as sound; blocks are chosen for each."""
    plan = planned(scene(0.3), order=4)
    whole = sound(plan)
    monkeypatch.setattr(branch_signals, "NODE_BUDGET", 2**17)
    assert apart_db(sound(planned(scene(0.3), order=4)), whole) < -105.0
    monkeypatch.setattr(branch_signals.Limits, "paths_in_launch", 64)
    assert apart_db(sound(planned(scene(0.3), order=4)), whole) < -105.0


@pytest.mark.parametrize("kinds", ["steady", "kinks"])
def test_all_channels_of_a_receiver_that_turns_are_looked_at(kinds: str, measured: Any) -> None:
    """The first component does not turn; too many kinks of turning to be cut out are looked at, too."""
    duration = 2.6
    times = np.linspace(0.0, duration, 68)
    angles = 30.0 * times if kinds == "steady" else 0.3 * (-1.0) ** np.arange(len(times))
    half = 0.5 * angles
    turns = np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)
    pose = clsim.Trajectory.waypoints(times, np.tile((4.5, 2.8, 1.2), (len(times), 1)), orientations=turns)
    made = scene(duration)
    turning = replace(made, receivers=(clsim.Receiver("hoa", pose, clsim.Ambisonic(3)),))
    plan = clsim.plan_render(clsim.find_paths(turning, 0), RATE, duration=duration, **CHANNELS)
    assert bool(plan.allocation.channels) == (kinds == "steady")
    if kinds == "kinks":
        assert any("responses change faster" in note for note in plan.allocation.notes)
        return
    plain = clsim.plan_render(plan.tracks.of_scene.paths, RATE, duration=duration, **CHANNELS | {"channels": False})
    got, wanted = (record(each).samples.astype(np.float64) for each in (plan, plain))
    off = np.linalg.norm(got - wanted, axis=1).max() / np.linalg.norm(wanted, axis=1).max()
    measured(
        "sampled channels", "sum over paths, components of a receiver that turns", 20.0 * np.log10(off), PROMISED_DB
    )
