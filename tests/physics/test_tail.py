"""The diffuse tail: energies against image sources and Eyring, and the statistics of what is heard of them."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import firwin
from scipy.signal.windows import tukey

import clsim
from clsim.acoustics.room_acoustics import eyring_time, reverberation_time
from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.family import SPECULAR
from clsim.render import diffuse_tail
from clsim.render.contributions import Contribution
from clsim.render.diffuse_tail import DiffuseTail
from clsim.render.methods import static
from clsim.render.plan import SEGMENT, Plan
from clsim.render.planning import PER_SAMPLE
from clsim.render.render import Rendering
from clsim.tail.design import DEPARTURES, SourceTail, TailEnergy, TailOptions, find_tail
from clsim.tail.noise import combined, plane_waves
from clsim.tail.streams import NODE, HostWaves, Motion
from clsim.tail.zones import Zones, at_middles, band_centres, band_shares, with_middles, zone_radius

SIZE, PLACE, HEARD = np.array([8.0, 6.0, 3.0]), np.array([2.0, 1.5, 1.2]), np.array([5.0, 4.0, 1.8])
RATE, C = 24e3, 343.0


def scene(
    wall: clsim.Material,
    source: clsim.Trajectory | None = None,
    receivers: tuple[clsim.Trajectory, ...] = (),
    signal: clsim.Signal | None = None,
    *,
    size: Any = SIZE,
    mesh: bool = False,
) -> clsim.Scene:
    room: Any = clsim.Shoebox(size, wall)
    signal = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=RATE) if signal is None else signal
    sound = clsim.Source("s", signal, source or clsim.Trajectory.fixed(PLACE))
    places = receivers or (clsim.Trajectory.fixed(HEARD),)
    ends = [clsim.Receiver(f"r{i}", place) for i, place in enumerate(places)]
    air = clsim.Air(speed_of_sound=C)
    return clsim.Scene(room.as_mesh() if mesh else room, air, [sound], ends)


def tail_of(of: clsim.Scene, max_order: int, band: tuple[float, float] = (500.0, 4000.0), **more: Any) -> SourceTail:
    zones = tuple(Zones.frozen(ends, of.room, 0.0, beams=i == 0) for i, ends in enumerate((of.sources, of.receivers)))
    return find_tail(of, 0, band, zones, TailOptions(max_order, **more))


def image_energy(of: clsim.Scene, factor: float, radius: float, max_order: int, air: float) -> np.ndarray:
    """The energy of images of each order, in the mean over the part of a sphere that is in the room."""
    points = HEARD + radius * fibonacci_sphere(500) * np.cbrt((np.arange(500) * 0.7548776662) % 1.0)[:, None]
    points = points[np.all((points > 0.0) & (points < SIZE), axis=1)]
    n = np.arange(-max_order, max_order + 1)
    cell = np.stack(np.meshgrid(n, n, n, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.abs(cell).sum(axis=1)
    image = cell * SIZE + np.where(cell % 2 == 0, PLACE, SIZE - PLACE)
    far = np.linalg.norm(image[:, None] - points, axis=2)
    each = factor**order * np.mean(np.exp(-air * (far - 1.0)) / far**2, axis=1)
    return np.bincount(order, each)[: max_order + 1]


@pytest.mark.parametrize(("scattering", "mesh"), few([(0.0, False), (0.3, False), (0.3, True)], (0, 2)))
def test_rays_hold_the_energy_of_images(scattering: float, mesh: bool, measured: Callable[..., float]) -> None:
    """Up to an order rays count what images do; what is left of mirrored rays goes on as a geometric series.

    Energies are absolute: of 1 Pa at 1 m. The standard error of 60 000 rays is some 0.03 dB here.
    """
    of = scene(clsim.Material.from_reflection(0.9, scattering=scattering), mesh=mesh)
    tail = tail_of(of, 6, (1000.0, 1000.0), error_db=0.05)
    (pair,) = tail.pairs.values()
    air = float(of.air.absorption_at(tail.centres)[0]) * math.log(10.0) / 10.0
    by_order = image_energy(of, 0.81 * (1.0 - scattering), zone_radius(of.room), 12, air)
    off_db = abs(10.0 * math.log10(pair.images.sum() / by_order[:7].sum()))
    measured("energy of the tail's rays", "images, in the mean over a sphere", off_db, 0.15)
    if scattering == 0.0:
        beyond = by_order[7:].sum() / (1.0 - (by_order[12] / by_order[7]) ** (6 / 5))
        assert 10.0 * math.log10(pair.energy.sum() / beyond) == pytest.approx(0.0, abs=0.2)


def test_energy_does_not_depend_on_the_order_at_which_images_end() -> None:
    """Joined without a step: images and tail of order 1 and 6 add up to the same in every window of 20 ms and band."""
    of = scene(clsim.Material.from_absorption([250.0, 4000.0], [0.1, 0.3], scattering=0.2))
    sums = []
    for order in (1, 6):
        (pair,) = tail_of(of, order, (1000.0, 2000.0), error_db=0.3).pairs.values()
        both = pair.images[:200].copy()
        both[: len(pair.energy)] += pair.energy[:200].sum(axis=1)
        sums.append(both.reshape(10, 20, -1).sum(axis=1))
    np.testing.assert_allclose(10.0 * np.log10(sums[0] / sums[1]), 0.0, atol=0.5)


def decay_time(energy: np.ndarray, step: float) -> float:
    left = np.cumsum(energy[::-1])[::-1]
    return reverberation_time(10.0 * np.log10(left / left[0] + 1e-30), 1.0 / step, -5.0, -35.0)


def test_reverberation_is_eyrings_in_a_diffuse_room() -> None:
    of = scene(clsim.Material.from_reflection(math.sqrt(0.9), scattering=1.0), size=(7.0, 6.0, 5.0))
    tail = tail_of(of, 0, (1000.0, 8000.0), error_db=0.5)
    (pair,) = tail.pairs.values()
    air = of.air.absorption_at(tail.centres) * math.log(10.0) / 10.0
    volume, surface = of.room.volume, of.room.surface_area
    expected = eyring_time(volume, surface, np.full(len(air), 0.1 * surface), air, C)
    total = pair.energy.sum(axis=1)
    total[: len(pair.images)] += pair.images[: len(total)]
    found = [decay_time(total[:, b], tail.time_step) for b in range(len(air))]
    np.testing.assert_allclose(found, expected, rtol=0.05)
    responses = clsim.impulse_responses(clsim.find_paths(of, 2), RATE, band=(500.0, 11e3), lead="keep", tail="auto")
    measured = clsim.room_measures(responses)
    np.testing.assert_allclose(measured.t30[0, 0], measured.eyring, rtol=0.08)


def isotropic(seconds: float, level: float = 1.0, zones: Zones | None = None) -> SourceTail:
    """A tail alike from all sides that does not decay, of 0.25 in all, of one band."""
    here = Zones(4.0, HEARD[None] / 4.0, beams=False, turns=np.array([[0.0, 0.0, 0.0, 1.0]]))
    energy = np.full((round(seconds * 1e3), 64, 1), 0.25e-3 / 64 / seconds * level, np.float32)
    pair = TailEnergy(energy[:100], energy[100:], np.full(DEPARTURES, 1.0 / DEPARTURES), np.ones((len(energy), 1)))
    return SourceTail(
        np.array([1000.0]), 1e-3, zones or here, here, {(0, 0): pair}, fibonacci_sphere(64), fibonacci_sphere(DEPARTURES), 1, 0.0, 0
    )  # fmt: skip


def test_made_responses_decay_as_the_rays_energies() -> None:
    """What is still to come, by short-time spectra at the middle of each band, within 0.5 dB down to -35 dB.

    Four seeds, 64 directions and 6 frequencies: a standard error is 0.2 dB, and one seed alone has 0.4 dB.
    """
    of = scene(clsim.Material.from_absorption([250.0, 4000.0], [0.1, 0.4], scattering=0.5))
    tail = tail_of(of, 2, (500.0, 4000.0), error_db=0.25)
    pair = tail.pairs[0, 0]
    taps = np.concatenate([plane_waves(replace(tail, seed=i), (0, 0), 0, RATE, moves=False).taps for i in range(4)])
    window, hop, step = np.hanning(2048), 512, round(tail.time_step * RATE)
    frames = sliding_window_view(taps, 2048, axis=1)[:, ::hop]
    power = np.mean(np.abs(np.fft.rfft(frames * window)) ** 2, axis=0)
    f = np.fft.rfftfreq(2048, 1.0 / RATE)
    assert pair.energy.shape[2] == len(tail.centres) == 10
    for b, centre in enumerate(tail.centres):
        near = np.abs(np.log2(np.maximum(f, 1.0) / centre)) < 0.1
        variance = np.repeat(pair.energy[:, :, b].mean(axis=1) / step, step)
        wanted = sliding_window_view(variance[: taps.shape[1]], 2048)[::hop] @ window**2
        left, asked = (np.cumsum(x[::-1])[::-1] for x in (power[:, near].mean(axis=1), wanted))
        loud = asked > asked[0] * 10.0**-3.5
        assert np.count_nonzero(loud) > 7
        np.testing.assert_allclose(10.0 * np.log10(left[loud] / asked[loud]), 0.0, atol=0.5)


def test_microphones_are_as_coherent_as_in_a_diffuse_field() -> None:
    """``sin(kr)/(kr)``: within 0.1 up to kr = 11 with 64 directions; the estimate's own error is 0.03."""
    tail, far = isotropic(2.0), 0.2
    waves = plane_waves(tail, (0, 0), 0, RATE, moves=False)
    places = far * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)[:1]])
    taps = combined(waves, -places @ tail.arrivals.T / C, np.ones((5, 64, 1)), tail.centres, RATE).taps
    spectrum, f = np.fft.rfft(taps), np.fft.rfftfreq(taps.shape[1], 1.0 / RATE)
    kr = 2.0 * math.pi * f * far / C
    cells = np.minimum((kr / 0.5).astype(int), 22)
    energy = sum(np.bincount(cells, np.abs(spectrum[i]) ** 2) for i in range(1, 5)) / 4.0
    first = np.bincount(cells, np.abs(spectrum[0]) ** 2)
    cross = np.mean([np.bincount(cells, (spectrum[0] * spectrum[i].conj()).real) for i in range(1, 5)], axis=0)
    coherence = (cross / np.sqrt(first * energy))[:22]
    np.testing.assert_allclose(coherence, np.sinc(0.5 * (np.arange(22) + 0.5) / math.pi), atol=0.1)


def heard_alone(of: clsim.Scene, tail: SourceTail, duration: float, rate: float = RATE, **options: Any) -> Plan:
    """The plan of hearing nothing but a tail."""
    plan = clsim.plan_render(clsim.find_paths(of, 0), rate, duration=duration, engine="reference", **options)
    return replace(plan, allocation=replace(plan.allocation, tails=(tail,)), builders=[DiffuseTail])


def rendered(plan: Plan) -> np.ndarray:
    return np.concatenate([samples for _, samples in clsim.render_chunks(plan)], axis=1)


def comb(duration: float) -> tuple[clsim.Signal, np.ndarray]:
    """Tones 125 Hz apart."""
    tones = np.arange(3000.0, 6001.0, 125.0)
    t, rng = np.arange(round(duration * RATE)) / RATE, np.random.default_rng(5)
    samples = np.sum(np.cos(2.0 * np.pi * (tones[:, None] * t + rng.random((len(tones), 1)))), axis=0)
    return clsim.Signal.from_array(0.1 * samples * tukey(len(samples), 0.1), RATE), tones


@pytest.mark.parametrize("moving", ["receiver", "source"])
def test_doppler_spectrum_is_flat(moving: str) -> None:
    """Sound from all sides, or sent to all sides: within ±f v/c each frequency is as likely, and there is nothing else.

    25 tones of 64 directions in 4 cells: the estimate's error is some 0.3 dB, of 16 departures 0.2 dB more.
    """
    speed, duration = 2.0, 2.9
    signal, tones = comb(duration)
    way = clsim.Trajectory.line(HEARD - np.array([3.0, 0.0, 0.0]), HEARD + np.array([2.99, 0.0, 0.0]), 5.99 / speed)
    late = clsim.Trajectory.line(PLACE, PLACE + np.array([5.99, 0.0, 0.0]), 5.99 / speed)
    middle = Zones(
        4.0, (PLACE + np.array([3.0, 0.0, 0.0]))[None] / 4.0, beams=False, turns=np.array([[0.0, 0.0, 0.0, 1.0]])
    )
    if moving == "receiver":
        of = scene(clsim.Material.from_reflection(0.9), receivers=(way,), signal=signal)
        tail = isotropic(0.2)
    else:
        of = scene(clsim.Material.from_reflection(0.9), late, signal=signal)
        tail = isotropic(0.2, zones=middle)
    heard = rendered(heard_alone(of, tail, duration))[0][round(0.4 * RATE) :]
    spectrum = np.abs(np.fft.rfft(heard * np.hanning(len(heard)))) ** 2
    f = np.fft.rfftfreq(len(heard), 1.0 / RATE)
    shift = (f - tones[:, None]) / (tones[:, None] * speed / C)
    cells = [np.sum(np.where((shift >= a) & (shift < a + 0.5), spectrum, 0.0)) for a in np.arange(-1.0, 1.0, 0.5)]
    np.testing.assert_allclose(10.0 * np.log10(np.array(cells) / np.mean(cells)), 0.0, atol=1.5)
    near = np.abs(f - tones[:, None]) < 62.5
    beyond = np.sum(np.where(near & (np.abs(shift) > 1.1), spectrum, 0.0))
    assert beyond < 0.01 * np.sum(cells)


@cache
def moving_plan() -> Plan:
    """Source and receivers that go through zones, and one that stands still."""
    rng, below = np.random.default_rng(3), firwin(63, 0.7)
    signal = clsim.Signal.from_array(0.1 * np.convolve(rng.standard_normal(round(1.4 * RATE)), below), RATE)
    walk = clsim.Trajectory.line(PLACE, PLACE + np.array([1.2, 0.5, 0.2]), 2.0)
    places = (
        clsim.Trajectory.line(HEARD, HEARD - np.array([1.2, 0.0, 0.0]), 2.0),
        clsim.Trajectory.fixed(HEARD + 0.1),
    )
    of = scene(clsim.Material.from_reflection(0.6, scattering=0.4), walk, places, signal)
    return clsim.plan_render(
        clsim.find_paths(of, 1), RATE, tail="auto", tail_directions=16, tail_error_db=3.0, responses="centre",
        duration=1.7,
    )  # fmt: skip


def tail_alone(plan: Plan) -> Contribution:
    (contribution,) = [c for c in plan.contributions if c.name == "diffuse tail"]
    return contribution


def of_contribution(plan: Plan, first: int = 0) -> np.ndarray:
    """What the tail adds from a sample on, in the plan's chunks."""
    adding, pieces = tail_alone(plan).begin(), []
    for start in range(first, plan.samples, plan.chunk):
        pieces.append(np.zeros((plan.receiver_count, min(plan.chunk, plan.samples - start)), np.float32))
        adding.add(pieces[-1], start)
    return np.concatenate(pieces, axis=1)


def test_chunks_and_resuming_change_nothing_and_zones_little() -> None:
    """Begun anywhere, in pieces of any length, samples are the same to the last bit; from zone to zone nothing jumps."""
    plan = moving_plan()
    (tail,) = plan.allocation.tails
    assert tail is not None
    assert min(len(tail.zones), len(tail.receiver_zones)) > 1
    whole = of_contribution(plan)
    cut = replace(plan, chunk=SEGMENT, builders=[DiffuseTail])
    np.testing.assert_array_equal(of_contribution(cut), whole)
    np.testing.assert_array_equal(of_contribution(cut, 2 * SEGMENT), whole[:, 2 * SEGMENT :])
    heard = rendered(plan)
    by_path = rendered(replace(plan, builders=[PER_SAMPLE, static.StaticConvolution]))
    np.testing.assert_allclose(heard - by_path, whole, atol=1e-5 * np.abs(heard).max())
    level = [float(np.mean(part**2)) for part in np.array_split(whole[0][round(0.3 * RATE) : round(1.4 * RATE)], 6)]
    assert 10.0 * math.log10(max(level) / min(level)) < 2.5
    (line,) = tail_alone(plan).describe()
    assert line in plan.describe()
    assert re.match(r"source 0: diffuse tail of .* 16 directions, . x . zones; [0-9]+ rays", line)
    assert Rendering(plan).state() == {}


def test_streams_that_are_not_kept_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zones beyond the memory that streams may take make them again for each chunk, to the last bit."""
    plan = replace(moving_plan(), chunk=SEGMENT, builders=[DiffuseTail])
    whole, adding = of_contribution(plan), tail_alone(plan).begin()
    adding.add(np.zeros((plan.receiver_count, SEGMENT), np.float32), 0)
    assert isinstance(adding, diffuse_tail._Tail)
    assert sum(s.held_bytes for zone in adding._received or [] for s in zone.streams.values()) > 0
    monkeypatch.setattr("clsim.tail.streams._MOST_HELD", 0)
    adding.add(np.zeros((plan.receiver_count, SEGMENT), np.float32), SEGMENT)
    assert sum(s.held_bytes for zone in adding._received or [] for s in zone.streams.values()) == 0
    np.testing.assert_array_equal(of_contribution(plan), whole)


def test_cost_of_many_moving_receivers_does_not_grow_with_zones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights are computed once per receiver for all zones, and a sum of streams holds up to 16 receivers of a zone."""
    starts = np.random.default_rng(0).uniform((0.5, 0.5, 0.5), (6.5, 5.5, 2.5), (20, 3))
    ways = tuple(clsim.Trajectory.line(place, place + np.array([1.0, 0.0, 0.0]), 1.0) for place in starts)
    of = scene(clsim.Material.from_reflection(0.6, scattering=0.4), receivers=ways)
    plan = clsim.plan_render(
        clsim.find_paths(of, 0), RATE, tail="auto", tail_directions=16, tail_error_db=3.0, duration=0.15,
        engine="reference",
    )  # fmt: skip
    (tail,) = plan.allocation.tails
    assert tail is not None
    times = np.arange(0, plan.samples + NODE, NODE) / RATE
    heard = np.array([tail.receiver_zones.weights(end, times).any(axis=1) for end in of.receivers]).sum(axis=0)
    assert len(heard) > 10
    asked: list[str] = []
    together: list[int] = []
    weigh, add_up = Zones.weights, HostWaves.received

    def weighed(zones: Zones, end: Any, times: np.ndarray) -> Any:
        asked.append(end.name)
        return weigh(zones, end, times)

    def added_up(waves: HostWaves, streams: Any, first: int, motion: Motion, start: int, stop: int) -> Any:
        together.append(len(motion.ahead))
        return add_up(waves, streams, first, motion, start, stop)

    monkeypatch.setattr(Zones, "weights", weighed)
    monkeypatch.setattr(HostWaves, "received", added_up)
    assert np.any(of_contribution(plan))
    assert [asked.count(end.name) for end in of.receivers] == [1] * 20
    assert sum(together) == heard.sum()
    assert len(together) == np.sum(-(-heard // 16))


def test_zones_are_crossed_at_constant_energy() -> None:
    plan = moving_plan()
    (tail,), of = plan.allocation.tails, plan.tracks.of_scene
    assert tail is not None
    assert of is not None
    for zones, ends in ((tail.zones, of.scene.sources), (tail.receiver_zones, of.scene.receivers)):
        weights = zones.weights(ends[0], np.linspace(0.0, 2.0, 50))
        np.testing.assert_allclose(np.sum(weights**2, axis=0), 1.0, rtol=1e-12)
        assert np.count_nonzero(weights.max(axis=1) > 0.5) > 1
        assert np.abs(np.diff(weights, axis=1)).max() < 0.1


def test_a_seed_says_all() -> None:
    one, again, other = (
        plane_waves(replace(isotropic(0.1), seed=seed), (0, 0), 0, RATE, moves=False).taps for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, again)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert isotropic(0.1).digest() != replace(isotropic(0.1), seed=1).digest()


def test_without_being_asked_there_is_none() -> None:
    paths = clsim.find_paths(scene(clsim.Material.from_reflection(0.9)), 1)
    assert [c.name for c in clsim.plan_render(paths, RATE).contributions] == ["static pairs"]
    ultrasound = clsim.Signal.chirp(42e3, 60e3, 0.01, 192e3, window="tukey")
    high = clsim.find_paths(scene(clsim.Material.from_reflection(0.9), signal=ultrasound), 1)
    plan = clsim.plan_render(high, 192e3, tail="auto")
    assert plan.allocation.tails == (None,)
    assert "source 0: no tail, for its band begins at 4" in "\n".join(plan.describe())
    soft = clsim.find_paths(scene(clsim.Material.from_reflection(0.01)), 2)
    (note,) = clsim.plan_render(soft, RATE, tail="auto", tail_error_db=3.0).allocation.notes
    assert "no tail, for images leave -" in note
    assert np.all(paths.interactions[paths.order > 0].max(axis=1) == SPECULAR)


def test_tracks_without_a_room_have_none() -> None:
    tracks = clsim.Tracks.from_samples([0.0, 1.0], [[0.01, 0.011]], [[0.3, 0.3]])
    tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=RATE)
    with pytest.raises(clsim.InputError, match=r"tail: must be 'off' for tracks without a room"):
        clsim.render_tracks([tone], tracks, RATE, tail="auto")
    paths = clsim.find_paths(scene(clsim.Material.from_reflection(0.9)), 1)
    with pytest.raises(clsim.InputError, match=r"tail: must be one of"):
        clsim.impulse_responses(paths, RATE, tail="both")


def test_an_open_mesh_is_refused() -> None:
    corners = [(0, 0, 0), (8, 0, 0), (8, 6, 0), (0, 6, 0)]
    floor = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], clsim.Material.from_reflection(0.9))
    of = scene(clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(floor, of.air, of.sources, of.receivers), 1)
    with pytest.raises(
        clsim.InputError,
        match=r"tail: must be 'off' in a room from which more than 50 % .* escapes, but .* not watertight",
    ):
        clsim.render(paths, RATE, tail="auto")


def test_bands_add_up_to_one() -> None:
    for band in ((100.0, 8000.0), (18e3, 22e3), (1000.0, 1000.0)):
        centres = band_centres(*band)
        shares = band_shares(np.geomspace(1.0, 1e5, 500), centres)
        np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)
        np.testing.assert_allclose(band_shares(centres, centres), np.eye(len(centres)), atol=1e-12)
    assert len(band_centres(18e3, 22e3)) <= 3
    thirds = band_centres(100.0, 8000.0)
    assert len(thirds) == 20
    np.testing.assert_allclose(thirds[1::3], [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0])


def test_middles_of_bands_go_on_smoothly() -> None:
    """Exponential decays whose rates are cubic over bands stay that; silent bands leave nothing beyond their neighbours."""
    bands, t = np.arange(9) / 2.0, np.linspace(0.0, 3.0, 7)[:, None]
    decays = np.exp(-t * (1.0 + 0.5 * bands + 0.05 * bands**2))
    np.testing.assert_allclose(at_middles(decays[:, ::2])[:, 2:-2], decays[:, 2:-2], rtol=1e-12)
    np.testing.assert_array_less(at_middles(np.array([1.0, 2.0, 0.0, 3.0])), 3.0 + 1e-9)
    assert at_middles(np.array([[2.0]])).tolist() == [[pytest.approx(2.0)]]
    assert with_middles(np.array([500.0, 2000.0])).tolist() == pytest.approx([500.0, 1000.0, 2000.0])


def test_a_hall_with_an_open_door_has_a_tail() -> None:
    """The door takes 2 % of the walls; it swallows what Eyring's room with such a window would, and is named."""
    mesh = clsim.Shoebox(SIZE, clsim.Material.from_reflection(math.sqrt(0.8), scattering=0.5)).as_mesh()
    holed = clsim.MeshRoom.from_plan(
        [(0, 0), (8, 0), (8, 6), (0, 6)], 3.0, clsim.Material.from_reflection(math.sqrt(0.8), scattering=0.5)
    )
    corners = [*holed.vertices, (8.0, 2.0, 0.0), (8.0, 3.0, 0.0), (8.0, 2.0, 2.0), (8.0, 3.0, 2.0)]
    kept = [t for t in holed.triangles.tolist() if not np.all(holed.vertices[t][:, 0] == 8.0)]
    n = len(holed.vertices)
    low = [
        int(np.flatnonzero(np.all(holed.vertices == p, axis=1))[0])
        for p in ((8, 0, 0), (8, 6, 0), (8, 0, 3), (8, 6, 3))
    ]
    a, b, c, d = low
    wall = [(a, n, n + 2), (a, n + 2, c), (c, n + 2, n + 3), (c, n + 3, d), (d, n + 3, n + 1), (d, n + 1, b)]
    room = clsim.MeshRoom(corners, [*kept, *wall], clsim.Material.from_reflection(math.sqrt(0.8), scattering=0.5))
    assert not room.is_closed
    assert mesh.is_closed
    of = scene(clsim.Material.from_reflection(0.9))
    open_hall = clsim.Scene(room, of.air, of.sources, of.receivers)
    tail = tail_of(open_hall, 2, (1000.0, 1000.0), error_db=0.5)
    share = float(re.match(r"([\d.]+) % of the energy escapes, near \(8.00, ", tail.escapes)[1]) / 100.0  # type: ignore[index]
    surface, door = mesh.surface_area, 2.0
    absorbed = 0.2 * (surface - door) + door
    assert share == pytest.approx(door / absorbed, rel=0.25)
