"""Changes that must change nothing: turned and moved scenes, other axes, chunks, company; both engines."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import oracle
import pytest
from exhaustive import exhaustive
from proven import proven
from scipy.spatial.transform import Rotation

import clsim
from clsim.numerics.quaternions import quaternion_from_direction
from clsim.paths.legs.legs import StaticLeg
from clsim.paths.path_set import PathSet
from clsim.scene.signal.waveforms import Tone

RATE = 192e3
AIR = clsim.Air(speed_of_sound=343.0)
SIZE = np.array([6.0, 5.0, 4.0])
FACTORS = np.array([0.9, -0.8, 0.7, 0.6, -0.5, 0.8])
TONE = clsim.Signal.tone(40e3, 0.1, RATE, fade=0.004)
DURATION = 0.06
BEAMS = {"source": clsim.Piston(0.004), "receiver": clsim.FirstOrder(0.4)}
AIMS = {"source": np.array([1.0, 0.3, -0.2]), "receiver": np.array([-0.8, 0.1, 0.4])}
# Places of float32 and float64 steps differ, nothing else: float32's rounding over a sum of 25 paths.
SAME_DB = -115.0


def room(size: np.ndarray, factors: np.ndarray) -> clsim.Shoebox:
    return clsim.Shoebox(size, [clsim.Material.from_reflection(f) for f in factors])


def difference_db(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted) + 1e-15))


@dataclass(frozen=True)
class Moved:
    """A curve, turned and moved."""

    curve: oracle.Wobble
    turn: np.ndarray
    shift: np.ndarray

    def position(self, time: np.ndarray) -> np.ndarray:
        return self.curve.position(time) @ self.turn.T + self.shift

    def velocity(self, time: np.ndarray) -> np.ndarray:
        return self.curve.velocity(time) @ self.turn.T

    def speed_over(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        return self.curve.speed_over(begin, end)


@dataclass(frozen=True)
class World:
    """A scene with two moving ends and beams, which can be turned and moved as a whole."""

    source: oracle.Wobble
    receiver: oracle.Wobble

    @classmethod
    def random(cls, rng: np.random.Generator) -> "World":
        return cls(oracle.Wobble.random(rng, [2.0, 2.5, 2.0], 6.0), oracle.Wobble.random(rng, [4.2, 2.4, 2.1], 6.0))

    def scene(self, box: clsim.Shoebox, turn: np.ndarray | None = None, shift: object = (0.0, 0.0, 0.0)) -> clsim.Scene:
        turn = np.eye(3) if turn is None else turn
        paths = [
            clsim.Trajectory(Moved(curve, turn, np.array(shift)), 0.0, 0.2) for curve in (self.source, self.receiver)
        ]
        return clsim.Scene(
            box, AIR,
            [clsim.Source("s", TONE, paths[0], BEAMS["source"], aim=turn @ AIMS["source"])],
            [clsim.Receiver("r", paths[1], BEAMS["receiver"], aim=turn @ AIMS["receiver"])],
        )  # fmt: skip


def heard(scene: clsim.Scene, engine: str, paths: PathSet | None = None) -> np.ndarray:
    # The reference engine is slow: what has come in by 40 ms.
    duration = DURATION if engine == "opencl" else 0.04
    paths = clsim.find_paths(scene, 2) if paths is None else paths
    made = clsim.render(paths, RATE, engine=engine, duration=duration, convolve_static=False)
    return checked(made, [0])[0]


def checked(recording: clsim.Recording, receivers: list[int]) -> np.ndarray:
    """Return the recording (receivers, samples), after a check of some tones against the paths."""
    pressure = recording.pressure.astype(float)
    some = np.linspace(0.2, 0.99, 300) * pressure.shape[1]
    for receiver in receivers:
        wanted = oracle.as_the_paths_say(recording.paths, np.floor(some) / RATE, receiver)
        assert np.abs(wanted).max() > 0.01, "something sounds"
        assert (
            oracle.error_db(pressure[receiver, some.astype(int)], wanted) < -50.0
        )  # how exactly is in test_accuracy.py
    return pressure


@proven
def test_turning_and_moving_everything(engine: str, rng) -> None:
    """No shoebox can be turned; its images can: A' = R A R^T and b' = R b + s - A' s."""
    world = World.random(rng)
    plain = world.scene(room(SIZE, FACTORS))
    paths = clsim.find_paths(plain, 2)
    turn, shift = Rotation.random(random_state=7).as_matrix(), np.array([12.0, 11.0, 13.0])
    moved = world.scene(room(np.full(3, 25.0), FACTORS), turn, shift)
    images = paths.families[0]
    matrix = turn @ images.legs[0].matrix @ turn.T
    offset = images.legs[0].offset @ turn.T + shift - matrix @ shift
    turned = PathSet(moved, (replace(images, scene=moved, legs=(StaticLeg(matrix, offset),)),))
    assert np.abs(matrix - np.swapaxes(matrix, 1, 2)).max() < 1e-12  # products of mirrors along three axes
    assert difference_db(heard(moved, engine, turned), heard(plain, engine, paths)) < SAME_DB


@proven
def test_images_that_turn(engine: str, rng) -> None:
    """Rooms without right angles have images that turn: the inverse of their matrix is not the matrix itself."""
    world = World.random(rng)
    plain = world.scene(room(np.full(3, 30.0), FACTORS), shift=(5.0, 5.0, 5.0))
    turn = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()
    # Source and image change places: emitted at R^T (x - s), imaged back to x.
    shift = np.array([14.0, 13.0, 15.0])
    here = clsim.find_paths(plain, 0)
    inner = clsim.Trajectory(Moved(world.source, turn.T, turn.T @ (np.full(3, 5.0) - shift) + 15.0), 0.0, 0.2)
    source = clsim.Source("s", TONE, inner, BEAMS["source"], aim=turn.T @ AIMS["source"])
    scene = clsim.Scene(plain.room, AIR, [source], plain.receivers)
    offset = shift - turn @ np.full(3, 15.0)
    images = replace(here.families[0], scene=scene, legs=(StaticLeg(turn[None], offset[None]),))
    paths = PathSet(scene, (images,))
    assert difference_db(heard(scene, engine, paths), heard(plain, engine, here)) < SAME_DB


@pytest.mark.parametrize("engine", ["opencl", exhaustive("reference")], indirect=True)
@pytest.mark.parametrize(
    ("axes", "mirrored"),
    [((1, 2, 0), (False, False, False)), ((0, 2, 1), (True, False, True))],
    ids=["cyclic", "mirror"],
)
@proven
def test_other_axes(engine: str, rng, axes: tuple[int, ...], mirrored: tuple[bool, ...]) -> None:
    """Exchange axes and look into a mirror, with six different walls."""
    world = World.random(rng)
    signs, picked = np.where(mirrored, -1.0, 1.0), list(axes)
    turn = signs[:, None] * np.eye(3)[picked]
    size = SIZE[picked]
    factors = np.array([FACTORS[2 * a : 2 * a + 2][:: -1 if m else 1] for a, m in zip(axes, mirrored, strict=True)])
    other = world.scene(room(size, factors.ravel()), turn, np.where(mirrored, size, 0.0))
    assert difference_db(heard(other, engine), heard(world.scene(room(SIZE, FACTORS)), engine)) < SAME_DB


@proven
def test_reciprocity_with_beams(engine: str) -> None:
    ends = [np.array([2.0, 3.1, 1.2]), np.array([4.7, 1.5, 2.4])]
    beams, aims = list(BEAMS.values()), list(AIMS.values())

    def render(s: int, r: int) -> np.ndarray:
        source = clsim.Source("s", TONE, clsim.Trajectory.fixed(ends[s]), beams[s], aim=aims[s])
        receiver = clsim.Receiver("r", clsim.Trajectory.fixed(ends[r]), beams[r], aim=aims[r])
        return heard(clsim.Scene(room(SIZE, FACTORS), AIR, [source], [receiver]), engine)

    assert difference_db(render(0, 1), render(1, 0)) < SAME_DB


@proven
def test_aim_is_an_orientation(engine: str) -> None:
    """A fixed aim and the same orientation in the trajectory are one."""
    place, aim = (2.0, 3.0, 1.0), (0.5, -0.4, 0.2)
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((4, 2, 2)), BEAMS["receiver"], aim=(-1, 0, 0))
    by_aim = clsim.Source("s", TONE, clsim.Trajectory.fixed(place), BEAMS["source"], aim=aim)
    turned = clsim.Trajectory.fixed(place, orientation=quaternion_from_direction(aim))
    by_orientation = clsim.Source("s", TONE, turned, BEAMS["source"])
    first, second = (
        heard(clsim.Scene(room(SIZE, FACTORS), AIR, [s], [receiver]), engine) for s in (by_aim, by_orientation)
    )
    assert difference_db(first, second) < SAME_DB


@proven
def test_company_changes_nothing(engine: str, rng) -> None:
    """Two sources and three receivers hear the sum of each pair alone."""
    box = room(SIZE, FACTORS)
    places = [[2.0, 1.5, 2.0], [2.2, 3.6, 1.8], [4.2, 1.4, 2.1], [4.4, 3.6, 2.2]]
    moving = [oracle.Wobble.random(rng, x, 3.0).trajectory(0.2) for x in places]
    sources = [
        clsim.Source("a", TONE, moving[0], BEAMS["source"], aim=(1, 0, 0)),
        clsim.Source(
            "b", clsim.Signal.chirp(20e3, 60e3, 0.05, RATE, window="hann"), moving[1], BEAMS["source"], aim=(0, -1, 0),
            start=0.0071,
        ),
    ]  # fmt: skip
    receivers = [
        clsim.Receiver("p", moving[2]), clsim.Receiver("q", moving[3], BEAMS["receiver"], aim=(-1, 0, 0)),
        clsim.Receiver("r", clsim.Trajectory.fixed((3.2, 2.5, 2.0))),
    ]  # fmt: skip

    def render(some: list[clsim.Source], listening: list[clsim.Receiver]) -> np.ndarray:
        scene = clsim.Scene(box, AIR, some, listening)
        duration = 0.05 if engine == "opencl" else 0.025
        paths = clsim.find_paths(scene, 1)
        made = clsim.render(paths, RATE, engine=engine, duration=duration, responses="centre", convolve_static=False)
        tones_alone = all(isinstance(source.signal.waveform, Tone) for source in some)
        return checked(made, list(range(len(listening))) if tones_alone else [])

    together = render(sources, receivers)
    assert together.shape[0] == 3
    for row, receiver in zip(together, receivers, strict=True):
        alone = sum(render([source], [receiver])[0] for source in sources)
        # Filters are designed for the fastest receiver of the scene: within twice their -90 dB.
        assert difference_db(row, alone) < -84.0


@proven
def test_a_late_start_is_a_shift(engine: str) -> None:
    """A fixed scene whose source begins later by a whole number of samples sounds the same, later."""

    def render(start: float) -> np.ndarray:
        source = clsim.Source(
            "s", TONE, clsim.Trajectory.fixed((2, 3, 1)), BEAMS["source"], aim=AIMS["source"], start=start
        )
        receiver = clsim.Receiver("r", clsim.Trajectory.fixed((4, 2, 2)), BEAMS["receiver"], aim=(-1, 0, 0))
        return heard(clsim.Scene(room(SIZE, FACTORS), AIR, [source], [receiver]), engine)

    now, later = render(0.0), render(1000 / RATE)
    assert not np.any(later[:1000])
    assert difference_db(later[1000:], now[:-1000]) < SAME_DB


def gates(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, delays and gains of paths that begin and end at random samples, some for less than a block."""
    times = np.arange(0.0, 0.31, 0.0005)
    start = rng.uniform(0.005, 0.05, (12, 1))
    delays = start + 0.002 * np.sin(2 * np.pi * rng.uniform(1, 3, (12, 1)) * times)
    gains = rng.uniform(0.1, 1.0, (12, 1)) * np.cos(2 * np.pi * times + start)
    for row in range(2, 12):
        edges = np.sort(rng.choice(len(times) - 4, 6, replace=False))
        for a, b in edges.reshape(3, 2):
            delays[row, a + 2 : max(b, a + 3)] = np.nan
    heard_at = np.isfinite(delays)
    lonely = heard_at & ~np.roll(heard_at, 1, axis=1) & ~np.roll(heard_at, -1, axis=1)
    delays[lonely] = np.nan
    delays[2, 100:103] = start[2]  # 1 ms: 192 samples
    delays[2, [99, 103]] = np.nan
    gains[np.isnan(delays)] = np.nan
    gains[2, 100:103] = 0.7
    return times, delays, gains


@pytest.mark.parametrize("chunk", [1, 5000, 20_001])
@proven
def test_chunks(device: None, rng, chunk: int) -> None:
    """Paths that come and go, in chunks of odd length: the same but for float32's rounding."""
    times, delays, gains = gates(rng)
    tracks = clsim.Tracks.from_samples(times, delays, gains)
    tone = clsim.Signal.tone(40e3, 0.4, RATE, fade=0.004)
    whole = clsim.render_tracks([tone], tracks, RATE, duration=0.3, chunk=10**6).pressure
    parts = clsim.render_tracks([tone], tracks, RATE, duration=0.3, chunk=chunk).pressure
    assert difference_db(parts, whole) < -120.0
    # Away from gates, at the instants at which delays and gains are given, the sound is a sum of tones.
    heard_at = np.isfinite(delays)
    steady = np.all([np.all(heard_at == np.roll(heard_at, k, axis=1), axis=0) for k in range(-3, 4)], axis=0)
    some = np.flatnonzero(steady & (times > 0.06) & (times < 0.299))
    assert len(some) > 30
    exact = np.nansum(gains * np.sin(2 * np.pi * 40e3 * (times - delays)), axis=0)[some]
    assert oracle.error_db(parts[0, np.round(times[some] * RATE).astype(int)], exact) < -75.0


@proven
def test_gates_are_the_same_in_both_engines(device: None, rng, measured: Any) -> None:
    tracks = clsim.Tracks.from_samples(*gates(rng))
    tone = clsim.Signal.tone(40e3, 0.4, RATE, fade=0.004)
    fast, slow = (
        clsim.render_tracks([tone], tracks, RATE, duration=0.3, engine=e).pressure for e in ("opencl", "reference")
    )
    measured("motion in either frame", "the same scene", difference_db(fast, slow), -100.0)
    # Nowhere does a gate open or close a sample early or late: that would be an error of the path's own size.
    assert np.abs(fast - slow).max() < 1e-3 * np.abs(slow).max()


@proven
def test_sampled_tracks_are_their_formula(engine: str, measured: Any) -> None:
    """Delays and gains given as samples of known functions, against the tone at those delays."""
    times = np.linspace(0.0, 0.25, 251)
    rates = np.array([[3.0], [5.0], [2.0]])
    starts = np.array([[0.01], [0.02], [0.015]])

    def delay(t: np.ndarray) -> np.ndarray:
        return starts + 3e-4 * np.sin(2 * np.pi * rates * t)

    def gain(t: np.ndarray) -> np.ndarray:
        return 0.5 + 0.3 * np.cos(2 * np.pi * rates * t)

    tracks = clsim.Tracks.from_samples(times, delay(times), gain(times))
    tone = clsim.Signal.tone(40e3, 0.3, RATE, fade=0.004)
    pressure = clsim.render_tracks([tone], tracks, RATE, duration=0.2, engine=engine).pressure[0]
    some = np.arange(6000, 38_000, 7)
    late = some / RATE - delay(some / RATE)
    exact = np.sum(gain(some / RATE) * np.sin(2 * np.pi * 40e3 * late), axis=0)
    # Spline of step h: 5/384 h^4 f'''' = 4e-12 s, 1e-6 rad at 40 kHz; the gain's 4e-9. The filter's -90 dB remain.
    measured(
        "any delays, rendered", "each path's delay and gain in float64", oracle.error_db(pressure[some], exact), -85.0
    )
