"""Paths that are too quiet to matter are left out, and what is lost is bounded."""

import re

import numpy as np
import pytest
from exhaustive import exhaustive

import clsim
from clsim.render.planning import plan_render
from clsim.tracks.pruning import _bounds
from clsim.tracks.tracks import track

RATE = 192e3


def scene(beam=None) -> clsim.Scene:
    chirp = clsim.Signal.chirp(35e3, 45e3, 0.1, RATE, window="tukey")
    way = clsim.Trajectory.circle((3.0, 2.5, 1.2), 1.5, 1.0, 0.6)
    source = clsim.Source("s", chirp, way, beam or clsim.Omni(), aim=(1.0, 0.2, 0.0))
    ears = [clsim.Receiver("r", clsim.Trajectory.line((5.0, 4.0, 2.0), (4.5, 4.0, 2.2), 0.6))]
    walls = {"default": clsim.Material.from_reflection(0.5), "x_min": clsim.Material.from_reflection(0.5).rough(0.3e-3)}
    return clsim.Scene(clsim.Shoebox((6, 5, 3), walls), clsim.Air(), [source], ears)


@pytest.mark.parametrize("beam", [clsim.Omni(), clsim.Piston(0.006), clsim.FirstOrder(0.3)])
def test_bounds_are_bounds(beam, rng: np.random.Generator) -> None:
    paths = clsim.find_paths(scene(beam), 4)
    bound, strongest = _bounds(track(paths), 0, (35e3, 45e3), 0.5)
    table = paths.table(rng.uniform(0.0, 0.5, 200))
    loudest = np.abs(table.gain).max(axis=1)
    assert np.all(loudest <= bound)
    assert strongest <= loudest.max() * (1 + 1e-3)
    assert strongest > 0.7 * loudest.max()
    assert np.median(bound / loudest) < 4.0 if isinstance(beam, clsim.Omni) else True


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["opencl", exhaustive("reference")], indirect=True)
def test_what_is_lost_is_less_than_said(engine: str) -> None:
    world = scene()
    paths = clsim.find_paths(world, 5)
    whole, part = (
        clsim.render(paths, RATE, engine=engine, duration=0.06, responses="centre", prune_below_db=level)
        for level in (None, -60.0)
    )
    said = next(note for note in part.notes if "left out" in note)
    count, bound = re.match(r"(\d+) paths that stay below -60 dB .* at most (-[\d.]+) dB", said).groups()
    assert 50 < int(count) < len(paths)
    assert whole.pressure.shape == part.pressure.shape
    lost = np.abs(whole.pressure - part.pressure).max()
    strongest = np.abs(paths.table(np.linspace(0.0, 0.06, 50)).gain).max()
    assert 0.0 < lost < strongest * 10 ** (float(bound) / 20)
    assert not any("left out" in note for note in whole.notes)


def test_paths_that_all_matter_stay() -> None:
    world = scene()
    paths = clsim.find_paths(world, 1)
    plan = plan_render(paths, RATE, duration=0.2, prune_below_db=-100.0)
    assert plan.path_count == len(paths)
    assert "no path stays below -100 dB" in plan.describe()


@pytest.mark.parametrize("level", [0.0, float("nan"), "quiet"])
def test_levels_that_are_none_are_refused(level) -> None:
    world = scene()
    with pytest.raises(clsim.InputError, match="prune_below_db: must be"):
        plan_render(clsim.find_paths(world, 1), RATE, duration=0.2, prune_below_db=level)


def test_what_air_has_swallowed_is_silence_and_no_failure() -> None:
    # 97 m at 500 kHz: some 4000 dB, and the square of such a gain is 0 in float64.
    way = clsim.Trajectory.line((98.0, 3.0, 1.0), (97.0, 3.0, 1.0), 1.0)
    source = clsim.Source("s", clsim.Signal.tone(500e3, 3e-4, 1.25e6, fade=1.5e-4), way)
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 3.0, 1.0)))
    room = clsim.Shoebox((100.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [receiver]), 0)
    plan = plan_render(paths, 1.25e6)
    assert 0.0 < paths.table([0.3]).gain[0, 0] < 1e-162
    assert not any("nan" in line for line in plan.describe())
