"""What is silent is left out without a change of a single bit."""

from dataclasses import replace

import numpy as np
import pytest
from exhaustive import few
from made_meshes import pillar_room
from mutants import Mutants

import clsim
from clsim.render.opencl import branch_signals as branches_module
from clsim.render.opencl.batches import CELL, Activity, find_activity
from clsim.render.opencl.engine import GPU_LAYOUT, OpenclEngine
from clsim.render.plan import SEGMENT, Plan
from clsim.render.planning import BUILDERS, plan_render

pytestmark = pytest.mark.usefixtures("device")
RATE = 192e3
WALL = clsim.Material.from_reflection(0.9)


def pulses(period: float, count: int, duration: float = 1e-3) -> clsim.Signal:
    return clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, duration, RATE, window="hann"), period, count)


def around(centre, radius: float, turns: float, duration: float = 0.6) -> clsim.Trajectory:
    return clsim.Trajectory.circle(centre, radius, 2 * np.pi * turns, duration)


def box_plan(signal: clsim.Signal, order: int = 4, **options) -> Plan:
    walls = {"default": WALL, "x_min": clsim.Material.from_absorption([20e3, 40e3, 60e3], [0.1, 0.6, 0.2])}
    ears = [
        clsim.Receiver("near", around((4.5, 2.5, 1.5), 0.5, 1.3)),
        clsim.Receiver(
            "late", clsim.Trajectory.fixed((1.0, 1.0, 2.0)), electronics=clsim.Electronics(clock_offset=0.02)
        ),
    ]
    source = clsim.Source("s", signal, around((2.0, 2.0, 1.2), 0.8, 1.7), start=0.0123)
    scene = clsim.Scene(clsim.Shoebox((6, 5, 3), walls), clsim.Air(), [source], ears)
    return plan_render(clsim.find_paths(scene, order), RATE, duration=0.5, **options)


def pillar_plan() -> Plan:
    source = clsim.Source("s", pulses(0.05, 10), around((3.0, 2.0, 1.2), 1.5, 2.0))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((6.2, 4.4, 1.4)))]
    scene = clsim.Scene(clsim.MeshRoom(*pillar_room(), WALL), clsim.Air(), [source], ears)
    return plan_render(clsim.find_paths(scene, 2), RATE, duration=0.5)


def near_plan() -> Plan:
    """Return the plan of a source that pulses while it passes a receiver at 12 mm and 20 m/s, all in fine blocks."""
    line = clsim.Trajectory.line((1.0, 2.5, 2.0), (5.0, 2.5, 2.0), 0.2)
    source = clsim.Source("s", pulses(0.033, 6, 5e-3), line)
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((3.02, 2.512, 2.0)))]  # when the fourth pulse is in its middle
    scene = clsim.Scene(clsim.Shoebox((6, 5, 4), WALL), clsim.Air(), [source], ears)
    return replace(plan_render(clsim.find_paths(scene, 2), RATE, duration=0.2), blocks=(24,), builders=BUILDERS)


PLANS = {
    "a pulse every 0.1 s": lambda: box_plan(pulses(0.1, 5)),
    "one pulse": lambda: box_plan(pulses(1.0, 1)),
    "as at the centre": lambda: box_plan(pulses(0.1, 5), responses="centre"),
    "short groups": lambda: box_plan(pulses(0.1, 5), order=1, interpolator=clsim.Lagrange(7), responses="centre"),
    "paths that come and go": pillar_plan,
    "near and fast": near_plan,
}


def rendered(plan: Plan, skips_silence: bool, **options) -> np.ndarray:
    engine = OpenclEngine(plan, **options)
    engine.skips_silence = skips_silence
    return engine.render(0, plan.samples)


@pytest.mark.filterwarnings("ignore:.*delay filters are wrong")
@pytest.mark.parametrize(
    ("name", "layout"), [(name, None) for name in PLANS] + few([(name, GPU_LAYOUT) for name in PLANS], kept=(2,))
)
def test_not_a_bit_changes(name: str, layout, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = PLANS[name]()
    looked: list[bool] = []
    monkeypatch.setattr(
        branches_module, "find_activity", lambda *a: looked.append(find_activity(*a).is_cheaper) or find_activity(*a)
    )
    with_silence = rendered(plan, False, layout=layout)
    assert np.abs(with_silence).max() > 0.0
    np.testing.assert_array_equal(rendered(plan, True, layout=layout), with_silence)
    assert looked
    assert all(looked)


def in_chunks(plan: Plan, skips_silence: bool) -> np.ndarray:
    engine, step = OpenclEngine(plan), 2 * SEGMENT
    engine.skips_silence = skips_silence
    return np.concatenate([engine.render(a, min(a + step, plan.samples)) for a in range(0, plan.samples, step)], axis=1)


def test_memory_that_is_used_again_is_silent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two periods are 260 samples less than a chunk: what sounded in the last one lies right behind what sounds in this.
    plan = box_plan(pulses((2 * SEGMENT - 260) / 2 / RATE, 5), order=2)
    wanted = in_chunks(plan, False)
    np.testing.assert_allclose(wanted, rendered(plan, False), atol=1e-6 * np.abs(wanted).max())
    np.testing.assert_array_equal(in_chunks(plan, True), wanted)
    monkeypatch.setattr(Activity, "__or__", lambda now, before: now)  # what sounded before is left there
    assert not np.array_equal(in_chunks(plan, True), wanted)


@pytest.mark.parametrize("responses", ["band", "centre"])
def test_functions_of_frequency_are_applied_where_it_sounds(responses) -> None:
    filters = box_plan(pulses(0.1, 5), response_error_db=-80.0, responses=responses).source_filters[0]
    first, last = -300, int(0.35 * RATE)
    half = filters.filter_half
    read = filters.signal.read(first - half, last + half)
    wanted = np.stack([np.convolve(read, f, mode="valid") for f in filters.filters])
    found = filters.streams(first, last)
    np.testing.assert_allclose(found, wanted, atol=1e-13 * np.abs(wanted).max())
    reached = np.convolve(read != 0.0, np.ones(2 * half + 1), mode="valid") > 0.5
    assert 0.003 < np.mean(reached) < 0.05
    assert not found[:, ~reached].any()
    places, values = filters.active(first, last)
    np.testing.assert_array_equal(places, np.flatnonzero(reached))
    np.testing.assert_array_equal(found[:, places], values)


def test_dense_signals_are_not_looked_through() -> None:
    assert not find_activity(np.arange(5000), 4979, 10, 11).is_cheaper


def test_cells_are_those_that_filters_hear(rng: np.random.Generator) -> None:
    before, after, length = 7, 13, 2000
    stream = np.where(rng.random(length + before + after) < 0.004, 1.0, 0.0)
    found = find_activity(np.flatnonzero(stream), length, before, after)
    heard = [np.any(stream[j : j + before + after + 1]) for j in range(length)]
    cells = -(-length // CELL)
    first = np.pad(heard, (0, cells * CELL - length)).reshape(cells, CELL).any(axis=1)
    for c in range(cells):
        later, earlier = np.flatnonzero(first[c:]), np.flatnonzero(first[: c + 1])
        assert found.following[c] <= (c + later[0] if len(later) else cells)  # none that sounds is passed over
        assert found.preceding[c] >= (earlier[-1] if len(earlier) else -1)
    assert 0.3 < np.mean(found.following == np.arange(cells)) / np.mean(first) < 1.2


MUTANTS = {
    "bounds too narrow": ("tracks", "cell_at(s, start - longest)] <=", "cell_at(s, start - longest + 200.0)] <="),
    "first group too late": ("tracks", "* CELL - start + shortest;\n    const real end", "* CELL - start + longest + 40.0;\n    const real end"),
    "next block too late": ("tracks", "* CELL - start + shortest;\n    return", "* CELL - start + longest + 800.0;\n    return"),
    "last group too early": ("tracks", "+ 1) * CELL - start + longest", "+ 1) * CELL - start + shortest - 40.0"),
    "cells before the origin": ("tracks", "s->origin + (real)block * s->block_samples;\n    return", "(real)block * s->block_samples;\n    return"),
    "last node forgotten": ("tracks", "solved = block + 3;", "solved = block + 4;"),
    "first group left out": ("render", "+ MASK_FIRST(mask), end", "+ MASK_FIRST(mask) + 1, end"),
    "last group left out": ("render", "g < until; g += WORKERS", "g < until - 1; g += WORKERS"),
    "path left out": ("render", "if (!mask) continue;", "if (!mask || slot % 64 == 7) continue;"),
    "last path left out": ("render", "i < count[g - first_subblock]; i++", "i < count[g - first_subblock] - 1; i++"),
    "curve of another term": ("render", "CUBIC_CURVE(c[2], c[3], t)", "CUBIC_CURVE(c[2], c[2], t)"),
    "slope of another term": ("render", "CUBIC_SLOPE(c[1], c[2], c[3], t)", "CUBIC_SLOPE(c[1], c[2], c[2], t)"),
    "gains of other functions": ("render", "i * functions + first + first_beside)", "i * functions + first + first_beside + 1)"),
    "gain's slope of another term": ("render", "CUBIC_SLOPE(g[1], g[2], g[3], t)", "CUBIC_SLOPE(g[1], g[2], g[2], t)"),
    "another function's sum": ("render", "*at + sum[k][j]", "*at + sum[k / 2][j]"),
}  # fmt: skip


@pytest.mark.parametrize("program", sorted({program for program, _, _ in MUTANTS.values()}))
def test_mutants_are_caught(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plans = [box_plan(pulses(0.1, 5), order=2)]
    if program == "tracks":  # gains there change slowly; near by and fast they are those of every node
        plans.append(near_plan())
    wanted = [rendered(plan, False) for plan in plans]  # by the kernels as they are
    mutants = Mutants(program, {name: (old, new) for name, (of, old, new) in MUTANTS.items() if of == program})
    mutants.play(monkeypatch)

    def unseen() -> bool:
        return all(np.array_equal(rendered(p, True), w) for p, w in zip(plans, wanted, strict=True))

    assert unseen(), "none of them is chosen"
    assert [name for name in mutants if unseen()] == []
