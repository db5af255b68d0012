"""Another medium in one file: a uniform wind along a corridor, whose walls it does not meet.

Images by the walls along the wind stay what they are in still air; travel times and their derivatives are those of the
wind (exact: sound goes at c relative to air that moves at w). Checked against closed forms.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.arrays import Floats
from clsim.paths.find_paths import ROOM_FINDERS, registered_family
from clsim.paths.propagation import Leg, Medium
from clsim.paths.search import PathSearch
from clsim.paths.specular.family import SpecularPaths

C, WIND, RATE, TONE = 343.0, 8.0, 192e3, 10e3
WALLS_ACROSS = (0, 1)  # of the corridor, x_min and x_max: sound that they return goes against the wind on another law


# --- the medium, and the paths in it ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class UniformWind:
    """Air that moves at a velocity (3,), m/s."""

    speed_of_sound: float
    velocity: tuple[float, float, float]

    @property
    def slowest(self) -> float:
        return self.speed_of_sound - float(np.linalg.norm(self.velocity))

    @property
    def fastest(self) -> float:
        return self.speed_of_sound + float(np.linalg.norm(self.velocity))

    def travel_time(self, start: Floats, stop: Floats) -> Floats:
        """Return the positive root of ``|d - w t| = c t``."""
        apart, w = stop - start, np.array(self.velocity)
        along, room = apart @ w, self.speed_of_sound**2 - w @ w
        return (-along + np.sqrt(along**2 + room * np.sum(apart**2, axis=-1))) / room

    def leg(self, start: Floats, stop: Floats) -> Leg:
        time, w = self.travel_time(start, stop), np.array(self.velocity)
        normal = (stop - start) / (self.speed_of_sound * time[..., None]) - w / self.speed_of_sound
        speed = self.speed_of_sound + normal @ w
        return Leg(time, np.linalg.norm(stop - start, axis=-1), normal, normal, speed, speed)


@dataclass(frozen=True, slots=True, eq=False)
class WindyPaths(SpecularPaths):
    """Images by walls along the wind, which no device knows."""

    wind: float

    def medium(self, source: int) -> Medium:
        return UniformWind(self.scene.air.speed_of_sound, (self.wind, 0.0, 0.0))


def find_windy(scene: clsim.Scene, search: PathSearch) -> WindyPaths:
    """Return the paths of still air but for those by walls across the wind, in the wind."""
    still = ROOM_FINDERS[type(scene.room)](scene, scene.room, search)
    kept = still.part(np.flatnonzero(~np.isin(still.walls, WALLS_ACROSS).any(axis=1)))
    return WindyPaths(**{f.name: getattr(kept, f.name) for f in fields(kept) if f.init}, wind=WIND)


def test_the_file_needs_nothing_but_seams() -> None:
    tree = ast.parse(Path(__file__).read_text("utf-8"))
    found = {node.module for node in tree.body if isinstance(node, ast.ImportFrom) and node.module.startswith("clsim.")}
    seams = {"find_paths", "propagation", "search", "specular.family"}
    assert found <= {"clsim.arrays", *(f"clsim.paths.{name}" for name in seams)}


# --- what is heard ----------------------------------------------------------------------------------------------------


def corridor(source: clsim.Trajectory, *receivers: clsim.Trajectory) -> clsim.Scene:
    room = clsim.Shoebox((30.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    ears = [clsim.Receiver(f"r{i}", way) for i, way in enumerate(receivers)]
    tone = clsim.Signal.tone(TONE, 0.5, RATE, fade=0.01)
    return clsim.Scene(room, clsim.Air(speed_of_sound=C, absorption=False), [clsim.Source("s", tone, source)], ears)


UP, DOWN = (4.0, 1.5, 1.2), (24.0, 1.5, 1.2)
DRIVING = clsim.Trajectory.line((10.0, 1.5, 1.2), (13.0, 1.5, 1.2), 0.5)  # 6 m/s, with the wind
LEAVING = clsim.Trajectory.line((20.0, 1.5, 1.2), (22.0, 1.5, 1.2), 0.5)  # 4 m/s, with the wind


@pytest.fixture(autouse=True)
def windy() -> Iterator[None]:
    with registered_family("specular", find_windy):
        yield


def test_delays_at_rest_are_those_of_the_closed_form() -> None:
    """The direct path at once; images with the folded way's own components along and across."""
    scene = corridor(clsim.Trajectory.fixed((14.0, 1.5, 1.2)), *map(clsim.Trajectory.fixed, (UP, DOWN)))
    paths = clsim.find_paths(scene, 2)
    table = paths.table([0.0])
    direct = np.flatnonzero(paths.order == 0)
    np.testing.assert_allclose(table.delay[direct, 0], [10.0 / (C - WIND), 10.0 / (C + WIND)], rtol=1e-14)
    # Every way in air at rest that is found by shooting at where the air carries sound to: |d - w t| = c t.
    images = paths.families[0]
    ends = np.array([UP, DOWN])[paths.receiver]
    apart = ends - (images.image_matrix @ np.array([14.0, 1.5, 1.2]) + images.image_offset)
    carried = apart - table.delay * np.array([WIND, 0.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(carried, axis=1), C * table.delay[:, 0], rtol=1e-13)
    assert len(paths) > 2 * 9
    # To first order every path is late by the same -(x_r - x_s) w / c^2.
    late = table.delay[:, 0] - np.linalg.norm(apart, axis=1) / C
    first_order = -(ends - [14.0, 1.5, 1.2])[:, 0] * WIND / C**2
    np.testing.assert_allclose(late, first_order, atol=2.0 * (WIND / C) ** 2 * table.delay.max())


def test_doppler_is_that_of_the_closed_form() -> None:
    scene = corridor(DRIVING, clsim.Trajectory.fixed(UP), clsim.Trajectory.fixed(DOWN), LEAVING)
    paths = clsim.find_paths(scene, 0)
    got = paths.table([0.2]).doppler_factor[:, 0]
    with_it, against = C + WIND, C - WIND
    wanted = [against / (against + 6.0), with_it / (with_it - 6.0), (with_it - 4.0) / (with_it - 6.0)]
    np.testing.assert_allclose(got, wanted, rtol=1e-13)
    # The delay of the moving source: emitted at 10 + 6 (t - delay), heard at 24 after (24 - x) / (c + w).
    delay = paths.table([0.2]).delay[1, 0]
    assert delay == pytest.approx((24.0 - 10.0 - 6.0 * 0.2) / (with_it - 6.0), rel=1e-13)


def test_derivatives_are_those_of_the_delay(rng: np.random.Generator) -> None:
    paths = clsim.find_paths(corridor(DRIVING, LEAVING), 2)
    times, step = np.linspace(0.1, 0.4, 5), 1e-5
    before, now, after = (paths.table(times + h) for h in (-step, 0.0, step))
    np.testing.assert_allclose(1.0 - now.doppler_factor, (after.delay - before.delay) / (2.0 * step), atol=1e-9)


def test_bounds_hold() -> None:
    from clsim.tracks.tracks import track

    tracks = track(clsim.find_paths(corridor(DRIVING, LEAVING), 2))
    low, high = tracks.delay_range(0, 0.1, 0.3)
    delay = tracks.paths.table(np.linspace(0.1, 0.3, 21)).delay
    assert np.all(low[:, None] <= delay)
    assert np.all(delay <= high[:, None])
    assert np.abs(np.diff(delay, axis=1)).max() / 0.01 <= tracks.max_rate(0)


def test_engines_pages_and_identities_know_it(engine: str, tmp_path: Path) -> None:
    from clsim.output.view import view_scene

    scene = corridor(DRIVING, LEAVING)
    paths = clsim.find_paths(scene, 0)
    assert paths.families[0].device is None
    heard = clsim.render(paths, RATE, duration=0.3, engine=engine).pressure[0]
    n = np.arange(round(0.1 * RATE), round(0.29 * RATE), 97)
    found = paths.families[0].arrivals(slice(None), n / RATE)
    wanted = (found.mach_factor / found.length)[0] * np.sin(2.0 * np.pi * TONE * found.emission_time[0])
    assert np.linalg.norm(heard[n] - wanted) < 1e-4 * np.linalg.norm(wanted)
    # The phase turns at the frequency of the closed form: 10 kHz (c + w - 4) / (c + w - 6).
    phase = np.unwrap(
        np.angle(np.fft.ifft(np.where(np.arange(len(heard)) <= len(heard) // 2, 2, 0) * np.fft.fft(heard)))
    )
    slope = np.polyfit(n / RATE, phase[n], 1)[0] / (2.0 * np.pi)
    assert slope == pytest.approx(TONE * (C + WIND - 4.0) / (C + WIND - 6.0), abs=0.2)
    view_scene(paths, tmp_path / "view.html", duration=0.3, frames=3)
    other = replace(paths.families[0], wind=WIND + 1.0)
    assert other.digest() != paths.families[0].digest()
    assert paths.families[0].vertices(slice(None), 0.2).shape == (1, 2, 3)
