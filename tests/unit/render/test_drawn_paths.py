"""Draws of paths by which functions of frequency are made: instants of a pair together are those one by one."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.numerics.band_filters import chebyshev_points
from clsim.paths.response import SceneResponse
from clsim.tracks import picked
from clsim.tracks.basis import Band
from clsim.tracks.tracks import SceneTracks, track


def tracks(speed: float, turning: bool = False, material: Any = None, head: bool = False) -> SceneTracks:
    """Return the tracks of a source that goes along x for a second, 3 m from a receiver."""
    walls = material or clsim.Material.from_reflection(0.9)
    tone = clsim.Signal.chirp(20e3, 40e3, 0.1, 192e3)
    way = clsim.Trajectory.line((2.0, 1.0, 1.2), (2.0 + speed, 1.0, 1.2), 1.0)
    beam = clsim.Piston(radius=0.01) if turning else clsim.Omni()
    source = clsim.Source("s", tone, way, directivity=beam, aim="forward" if turning else None)
    place = clsim.Trajectory.fixed((2.0, 4.0, 1.2))
    ear = clsim.Receiver.ambisonic("r", place, order=1) if head else clsim.Receiver("r", place)
    room = clsim.Shoebox((6.0, 5.0, 2.5), walls)
    return track(clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), 2))


@pytest.mark.parametrize(
    "made",
    [
        {"speed": 2.0},
        {"speed": 2.0, "turning": True},
        {"speed": 2.0, "material": clsim.Material.from_porous(20e3, 0.05)},
        {"speed": 2.0, "head": True},
    ],
    ids=["plain", "beam", "angular", "channels"],
)
def test_instants_together_are_those_one_by_one(made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    of_scene = tracks(**made)
    band = Band(20e3, 40e3, chebyshev_points(20e3, 40e3, 9), np.ones((1, 9)) / 9)
    draws = []
    for together in (True, False):
        monkeypatch.setattr("clsim.paths.chain.Chain.one_by_one", property(lambda self, here=together: here))
        (drawn,) = picked.picked_paths(of_scene, 0, 1.0, (400,), np.random.default_rng(1))
        draws.append((len(drawn), picked.Draw(of_scene, 0, 1.0, drawn).responses(band)))
    (few, stacked), (many, single) = draws
    assert few < many
    assert np.array_equal(stacked.first, single.first)
    scale = np.abs(single.responses).max()
    np.testing.assert_allclose(stacked.responses, single.responses, rtol=0.0, atol=1e-14 * scale)


def test_responses_are_those_of_the_paths_at_their_own_instants() -> None:
    of_scene = tracks(3.0)
    band = Band(20e3, 40e3, np.array([20e3, 30e3, 40e3]), np.ones((1, 3)) / 3)
    (drawn,) = picked.picked_paths(of_scene, 0, 1.0, (400,), np.random.default_rng(1))[0]
    made = picked.Draw(of_scene, 0, 1.0, (drawn,)).responses(band).responses / drawn.scale
    at = SceneResponse(of_scene.scene, 0, band.frequencies)
    for row in range(0, len(made), 7):
        alone, when = drawn.paths.part(np.array([row])), drawn.times[row]
        wanted = alone.response(alone.arrivals(when), when, at)[0, 0]
        np.testing.assert_allclose(made[row], wanted, rtol=1e-12)


def test_a_delay_is_taken_out_of_real_responses() -> None:
    """Where others are complex, all are turned."""
    of_scene = tracks(3.0)
    (drawn,) = picked.picked_paths(of_scene, 0, 1.0, (400,), np.random.default_rng(1))[0]
    draw, band = picked.Draw(of_scene, 0, 1.0, (drawn,)), Band(20e3, 40e3, np.array([20e3, 40e3]), np.ones((1, 2)) / 2)
    plain, turned = (draw.responses(dataclasses.replace(band, late=late)).responses for late in (0.0, 3e-5))
    assert not np.iscomplexobj(plain)
    np.testing.assert_allclose(turned, plain * np.exp(2j * np.pi * 3e-5 * band.frequencies), rtol=1e-12)


def test_ends_that_hardly_move_need_few_instants() -> None:
    """From a distance d less the way on: 12 instants for each such distance, 3 at least."""
    most = 24
    assert picked._instants(tracks(0.1), 0, 1.0, most) == 3
    assert picked._instants(tracks(1.0), 0, 1.0, most) == 7  # 12 x 1.02 / (3 - 1.02) = 6.2
    assert picked._instants(tracks(3.5), 0, 1.0, most) == most
    assert picked._instants(tracks(3.5), 0, 1.0, most, 8) == 8  # for narrow bands, but where ends are not alike
    assert picked._instants(tracks(3.5, turning=True), 0, 1.0, most, 8) == most
    assert picked._instants(tracks(0.1, turning=True), 0, 1.0, most) == most
    assert picked._instants(tracks(0.1, head=True), 0, 1.0, most) == most
    slow = tracks(0.1)
    heard = dataclasses.replace(slow.pairs[0], end=np.where(np.arange(len(slow.pairs[0])) == 1, 0.5, np.inf))
    assert picked._instants(dataclasses.replace(slow, pairs=(heard,)), 0, 1.0, most) == most


def test_loud_paths_are_drawn_surely_and_others_as_often_as_they_are_loud(rng: np.random.Generator) -> None:
    """What drawn paths stand for is all of the energy: shares of weights on levels of most different sizes."""
    level = rng.exponential(size=(300, 40)) ** 3
    level[:, 3], level[20:, 4] = 0.0, 0.0  # silence, and few paths
    chance = picked._chances(level, 50)
    np.testing.assert_allclose(np.delete(chance.sum(axis=0), [3, 4]), 50.0)
    assert not chance[:, 3].any()
    assert np.array_equal(chance[:, 4], level[:, 4] > 0.0)
    sure = chance >= 1.0
    assert all(
        level[sure[:, t], t].min() > level[~sure[:, t], t].max() for t in np.flatnonzero(sure[:, :3].any(axis=0))
    )
    energy = np.zeros(40)
    for rows, at, scale, first in picked._drawn(level, 50, rng, together=False):
        assert np.array_equal(first, np.searchsorted(at[:, 0], [*np.unique(at), at.max() + 1]))
        drawn = scale[:, 0] ** 2 * level[rows, at[:, 0]] ** 2  # of each, relative to all of the instant
        energy += np.bincount(at[:, 0], drawn, 40)
    assert energy[3] == 0.0
    np.testing.assert_allclose(energy[4], 1.0)
    np.testing.assert_allclose(np.delete(energy, 3), 1.0, atol=0.15)


def test_both_samples_have_instants_of_their_own_spread_over_the_run() -> None:
    of_scene = tracks(3.5)
    first, second = picked.picked_paths(of_scene, 0, 1.0, (400, 800), np.random.default_rng(1))
    times = [np.unique(np.concatenate([some.times[:, 0] for some in drawn])) for drawn in (first, second)]
    assert [len(t) for t in times] == [16, 16]
    assert len(np.intersect1d(*times)) == 2  # begin and end
    for t in times:
        assert np.all(np.abs(t - np.linspace(0.0, 1.0, 16)) <= 0.5 / 15 + 1e-12)
    rows = [sum(some.first[-1] for some in drawn) for drawn in (first, second)]
    assert 350 < rows[0] <= 420
    assert 350 < rows[1] <= 16 * len(of_scene.pairs[0])
