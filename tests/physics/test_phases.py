"""Walls and directivities with phases, angles and no symmetry, against sums over the spectrum and against mirrored geometry."""

from collections.abc import Callable

import numpy as np
import pytest
import spectral_sums
from exhaustive import few
from made_responses import POROUS, ROUGH, Lopsided, OffCentre, porous_factor, rough_factor
from scipy.special import j1

import clsim
from clsim.numerics.band_filters import band_filters
from clsim.render.planning import plan_render

RATE, C = 192e3, 343.0
AIR = clsim.Air(speed_of_sound=C, relative_humidity=0.4)
HARD = clsim.Material.from_reflection(0.9)


def chirp(low: float, high: float, duration: float = 0.02) -> clsim.Signal:
    return clsim.Signal.chirp(low, high, duration, RATE, window="hann")


def turning(start, velocity, spin) -> clsim.Trajectory:
    """Return a straight way of 0.3 s on which the transducer turns at `spin`, rad/s about an axis."""
    times = np.linspace(0.0, 0.3, 151)
    angle = np.linalg.norm(spin) * times
    axis = np.array(spin) / np.linalg.norm(spin)
    quaternions = np.concatenate([np.sin(angle / 2)[:, None] * axis, np.cos(angle / 2)[:, None]], axis=1)
    return clsim.Trajectory.waypoints(
        times, np.array(start) + times[:, None] * np.array(velocity), orientations=quaternions
    )


def frame_of(spin, times: np.ndarray) -> np.ndarray:
    """Return the matrices (T, 3, 3) whose columns are the axes of a transducer turning at `spin`: Rodrigues' formula."""
    axis = np.array(spin) / np.linalg.norm(spin)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = (np.linalg.norm(spin) * times)[:, None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


SPIN_S, SPIN_R = (1.0, -2.0, 0.5), (-0.7, 0.4, 1.8)


def scene(source_beam, receiver_beam, walls, signal) -> clsim.Scene:
    source = clsim.Source("s", signal, turning((4.0, 3.2, 1.4), (1.5, -1.0, 0.3), SPIN_S), source_beam)
    receiver = clsim.Receiver("r", turning((1.3, 1.1, 2.2), (-0.4, 0.8, -0.5), SPIN_R), receiver_beam)
    return clsim.Scene(clsim.Shoebox((8, 6, 3), walls), AIR, [source], [receiver])


WALLS = [HARD, POROUS, ROUGH, clsim.Material.from_reflection(-0.7), POROUS, ROUGH]
CASES = {
    "off centre": (OffCentre(2e-3), clsim.Omni(), [HARD] * 6),
    "lopsided source": (Lopsided(), clsim.Omni(), [HARD] * 6),
    "lopsided receiver": (clsim.FirstOrder(0.5), Lopsided(), [HARD] * 6),
    "walls by angle": (clsim.Omni(), clsim.Omni(), WALLS),
    "all of it": (Lopsided(), OffCentre(-1e-3), WALLS),
}


@pytest.mark.slow
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("case", few(CASES, kept=(4,)))
def test_every_frequency_of_every_path(case: str) -> None:
    source_beam, receiver_beam, walls = CASES[case]
    world = scene(source_beam, receiver_beam, walls, chirp(32e3, 48e3))
    paths = clsim.find_paths(world, 2)
    got = clsim.render(paths, RATE, duration=0.06).pressure[0].astype(float)
    times = np.arange(got.size) / RATE
    got, times = got[1500:9500:31], times[1500:9500:31]  # one of a few periods, at all their phases
    wanted = by_hand(world, paths, times)
    # Asked is -80 dB of the strongest arrival in each response.
    assert np.linalg.norm(got - wanted) < 10 ** (-75 / 20) * np.linalg.norm(wanted)


def by_hand(world: clsim.Scene, paths, times: np.ndarray) -> np.ndarray:
    """Return the sum over spectrum and paths: delays and directions from the path table, everything else from here."""
    table = paths.table(times)
    distance, late = table.delay * C, times - table.delay
    mach = np.sum(table.departure * np.array([1.5, -1.0, 0.3]), axis=-1) / C
    # The departure in the source's frame as it was at emission, the arrival in the receiver's.
    leaving = np.einsum("ptji,ptj->pti", frame_of(SPIN_S, late.ravel()).reshape(*late.shape, 3, 3), table.departure)
    coming = np.einsum("tji,ptj->pti", frame_of(SPIN_R, times), table.arrival)
    cosines, materials = np.abs(table.departure), world.room.faces.materials

    def response(f: float) -> np.ndarray:
        made = 10 ** (-AIR.absorption_at(f) * (distance - 1.0) / 20) / (distance * (1.0 - mach)) + 0j
        for beam, towards in ((world.sources[0].directivity, leaving), (world.receivers[0].directivity, coming)):
            made *= beam.gain_towards(towards, f, C)
        level = [m.reflection_at(f) if m not in (POROUS, ROUGH) else None for m in materials]
        for bounce in paths.walls.T:
            for p in np.flatnonzero(bounce >= 0):  # unfolded, a ray meets all walls across an axis at one angle
                wall, cosine = bounce[p], cosines[p, :, bounce[p] // 2]
                made[p] *= by_angle(materials[wall], f, cosine) if level[wall] is None else level[wall]
        return made

    return spectral_sums.heard(world.sources[0].signal, late, response)


def by_angle(material: clsim.Material, f: float, cosine: np.ndarray):
    """Return the factor of a wall that depends on the angle, by formula."""
    return porous_factor(f, cosine) if material is POROUS else rough_factor(f, cosine, C)


class _Seen(clsim.Directivity):
    """A beam seen in a mirror across x."""

    is_complex = True
    band = (0.0, float("inf"))

    def __init__(self, beam: Lopsided) -> None:
        self._beam = beam

    def gain_towards(self, direction, frequency, speed_of_sound):
        return self._beam.gain_towards(np.asarray(direction) * (-1.0, 1.0, 1.0), frequency, speed_of_sound)


def test_an_image_is_a_mirrored_source_in_the_open(engine: str) -> None:
    signal = chirp(35e3, 45e3, 0.01)
    wall = {"default": clsim.Material.from_reflection(0.0), "x_min": clsim.Material.named("rigid")}
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((2.4, 1.7, 1.1)), Lopsided())]
    here = clsim.Trajectory.line((1.0, 1.0, 2.0), (1.6, 2.0, 2.2), 0.2)
    mirrored = clsim.Trajectory.line((4.0, 1.0, 2.0), (3.4, 2.0, 2.2), 0.2)
    ahead = (1.0, 0.0, 0.0)
    source = clsim.Source("s", signal, here, Lopsided(), aim=ahead)
    inside = clsim.Scene(clsim.Shoebox((9, 4, 3), wall), AIR, [source], ears)
    made = clsim.render(clsim.find_paths(inside, 1), RATE, engine=engine, duration=0.05).pressure[0]
    # The same ears, 5 m on: the wall is at x = 5, and the image at 5 - x.
    on = [clsim.Receiver("r", clsim.Trajectory.fixed((7.4, 1.7, 1.1)), Lopsided())]
    moved = clsim.Trajectory.line((6.0, 1.0, 2.0), (6.6, 2.0, 2.2), 0.2)
    direct = clsim.Source("s", signal, moved, Lopsided(), aim=ahead)
    image = clsim.Source("i", signal, mirrored, _Seen(Lopsided()), aim=ahead)
    room = clsim.Shoebox((20, 4, 3), clsim.Material.from_reflection(0.0))
    both = clsim.Scene(room, AIR, [direct, image], on)
    wanted = clsim.render(clsim.find_paths(both, 0), RATE, engine=engine, duration=0.05).pressure[0]
    assert np.abs(wanted).max() > 0.0
    assert np.linalg.norm(made - wanted) < 10 ** (-85 / 20) * np.linalg.norm(wanted)


def test_one_frequency_for_all_keeps_the_phase(engine: str) -> None:
    tone = clsim.Signal.tone(40e3, 0.02, RATE, fade=0.005)
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 2, 1)), OffCentre(2e-3))]
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((5.0, 2, 1)))
    world = clsim.Scene(clsim.Shoebox((8, 6, 3), HARD), AIR, [source], ears)
    made = clsim.render(
        clsim.find_paths(world, 0), RATE, engine=engine, duration=0.04, responses="centre", convolve_static=False,
    ).pressure[0]  # fmt: skip
    gain = OffCentre(2e-3).gain(1.0, 40e3, C) * 10 ** (-AIR.absorption_at(40e3) * 2.0 / 20) / 3.0
    times = np.arange(3000, 4000) / RATE
    wanted = np.real(gain * np.exp(2j * np.pi * 40e3 * (times - 3.0 / C)) / 1j)
    quiet = np.abs(clsim.render(clsim.find_paths(world, 0), RATE, engine=engine, duration=0.04).pressure[0])
    assert np.abs(made[3000:4000] - wanted).max() < 1e-4 * np.abs(wanted).max()
    assert quiet.max() == pytest.approx(abs(gain), rel=1e-3)


def ringing(length: float) -> clsim.Material:
    """Return a wall whose impulse response rings for a while: 12 echoes within `length` s, falling by 12 dB."""
    rng = np.random.default_rng(3)
    late = np.sort(rng.uniform(0.0, length, 12))
    size = 0.125 * 10 ** (-12 / 20 * late / length) * rng.choice([-1, 1], 12)
    f = np.linspace(15e3, 85e3, 7001)
    factor = 0.5 + np.sum(size * np.exp(-2j * np.pi * f[:, None] * late), axis=1)
    return clsim.Material.from_table(f, factor / max(1.0, np.abs(factor).max()))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(("length", "most"), [(0.05e-3, 12), (0.2e-3, 24)])
def test_walls_that_ring_take_more_functions(length: float, most: int) -> None:
    walls = [ringing(length), *[HARD] * 5]
    world = scene(clsim.Omni(), clsim.Omni(), walls, chirp(30e3, 50e3))
    plan = plan_render(clsim.find_paths(world, 3), RATE, duration=0.05)
    assert 3 < len(plan.source_filters[0].basis) <= most
    assert plan.source_filters[0].basis.error_db < -80.0


def test_walls_that_ring_too_long_are_refused() -> None:
    world = scene(clsim.Omni(), clsim.Omni(), [ringing(20e-3)] * 6, chirp(20e3, 80e3))
    why = r"must be reached from .* do not resolve .* longer than 1\d(?:\.\d)? ms.* dB is the best; .* or ask for less"
    with pytest.raises(clsim.InputError, match=f"response_error_db: {why}"):
        plan_render(clsim.find_paths(world, 3), RATE, duration=0.05, response_error_db=-80.0)


@pytest.mark.parametrize("late", [0.0, 0.3, -2.7])
def test_filters_have_complex_responses(late: float) -> None:
    w = 2 * np.pi * np.linspace(30e3, 50e3, 200) / RATE
    nodes = np.cos(np.pi * (np.arange(40) + 0.5) / 40)
    wanted = np.exp(-1j * late * (0.5 * (w[0] + w[-1]) + 0.5 * (w[-1] - w[0]) * nodes))
    angles = np.outer(np.arange(40), np.arccos(nodes))
    coefficients = (np.cos(angles) @ wanted) / 20
    coefficients[0] *= 0.5
    taps = band_filters(coefficients[None], 30e3, 50e3, RATE, np.ones(40), np.max, 10 ** (-90 / 20)).taps[0]
    half = len(taps) // 2
    response = np.exp(-1j * np.outer(w, np.arange(-half, half + 1))) @ taps
    assert np.abs(response - np.exp(-1j * late * w)).max() < 10 ** (-90 / 20)


def test_filters_that_would_be_endless_are_the_best_and_tell_their_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsim.numerics.band_filters.LONGEST", 257)
    coefficients = np.zeros((1, 2000))
    coefficients[0, -1] = 1.0
    best = band_filters(coefficients, 40e3, 40.1e3, RATE, np.ones(40), np.max, 10 ** (-90 / 20))
    assert best.taps.shape[1] <= 257
    assert -1.0 < best.error_db < 1.0


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_measured_table_in_a_room(tmp_path) -> None:
    from scipy.io import savemat

    degrees, f = np.linspace(0.0, 180.0, 39), np.linspace(10e3, 90e3, 2600)
    measured = OffCentre(4e-3).gain(np.cos(np.radians(degrees))[:, None], f, C)
    savemat(tmp_path / "beam.mat", {"angles": degrees, "frequencies": f, "values": measured})
    table = clsim.AxialDirectivity.from_mat(tmp_path / "beam.mat")
    on_grid = table.gain(np.cos(np.radians(degrees))[:, None], f[::100], C)
    assert np.abs(20 * np.log10(np.abs(on_grid) / np.abs(measured[:, ::100]))).max() < 0.1
    assert np.abs(np.angle(on_grid / measured[:, ::100], deg=True)).max() < 1.0
    signal = chirp(25e3, 65e3)
    got, wanted = (
        clsim.render(clsim.find_paths(world, 2), RATE, duration=0.06).pressure[0]
        for world in (scene(beam, clsim.Omni(), [HARD] * 6, signal) for beam in (table, OffCentre(4e-3)))
    )
    assert np.linalg.norm(got - wanted) < 10 ** (-75 / 20) * np.linalg.norm(wanted)


def test_one_turned_function_keeps_its_phase(engine: str) -> None:
    # All walls turn the phase by a quarter at every frequency; only reflections, at one angle, reach the receiver.
    tone = clsim.Signal.tone(40e3, 0.03, RATE, fade=0.01)
    turned = clsim.Material.from_reflection(0.9j)
    silent = clsim.Material.from_reflection(0.0)
    walls = {"default": silent, "z_min": turned}
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((3.0, 2.0, 1.0)))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((5.0, 2.0, 1.0)))]
    air = clsim.Air(speed_of_sound=C, relative_humidity=0.4)
    world = clsim.Scene(clsim.Shoebox((8, 4, 6), walls), air, [source], ears)
    paths = clsim.find_paths(world, 1)
    both = clsim.render(paths, RATE, engine=engine, duration=0.05, convolve_static=False).pressure[0]
    times = np.arange(3600, 4600) / RATE
    wanted = np.zeros(1000)
    for distance, factor in ((2.0, 1.0), (np.sqrt(8.0), 0.9j)):
        gain = factor * 10 ** (-air.absorption_at(40e3) * (distance - 1) / 20) / distance
        wanted += np.real(gain * np.exp(2j * np.pi * 40e3 * (times - distance / C)) / 1j)
    assert np.abs(both[3600:4600] - wanted).max() < 2e-4 * np.abs(wanted).max()


def test_beam_of_a_head_that_turns_ten_times_a_second(measured: Callable[..., float]) -> None:
    """Heard from its sides: what the axis is off there counts by how steep the beam is, and by how soft."""
    rate, f, c, radius, turn = 192e3, 40e3, 343.0, 0.06, 20.0 * np.pi
    room = clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.9))
    start, end = np.array([1.0, 1.2, 1.3]), np.array([1.05, 1.21, 1.31])
    times = np.linspace(0.0, 0.1, 4)
    head = clsim.Trajectory.carried(
        clsim.Trajectory.line(start, end, 0.1), clsim.Trajectory.swing((0, 0, 0), (0, 0, 1), turn * times, times)
    )
    tone = clsim.Signal.tone(f, 0.08, rate, fade=0.01)
    scene = clsim.Scene(
        room, clsim.Air(speed_of_sound=c, absorption=False),
        [clsim.Source("head", tone, head, clsim.Piston(radius))],
        [clsim.Receiver("ear", clsim.Trajectory.fixed((4.0, 3.0, 1.6)))],
    )  # fmt: skip
    pressure = clsim.render(clsim.find_paths(scene, 0), rate, duration=0.075).pressure[0]
    at = np.arange(round(0.025 * rate), round(0.072 * rate), 11)
    now = at / rate
    velocity, there = (end - start) / 0.1, np.array([4.0, 3.0, 1.6])
    delay = np.full(len(at), 0.01)
    for _ in range(20):
        delay = np.linalg.norm(there - start - (now - delay)[:, None] * velocity, axis=1) / c
    emitted = now - delay
    way = there - start - emitted[:, None] * velocity
    distance = np.linalg.norm(way, axis=1)
    ahead = way / distance[:, None]
    cosine = ahead[:, 0] * np.cos(turn * emitted) + ahead[:, 1] * np.sin(turn * emitted)
    z = 2.0 * np.pi * f / c * radius * np.where(cosine < 0.0, 1.0, np.sqrt(1.0 - cosine**2))
    exact = 2.0 * j1(z) / z / (distance * (1.0 - ahead @ velocity / c)) * np.sin(2.0 * np.pi * f * emitted)
    side = np.abs(cosine) < 0.8
    error_db = 10.0 * np.log10(np.sum((pressure[at] - exact)[side] ** 2) / np.sum(exact[side] ** 2))
    measured("beam of a head that turns at 10 Hz", "closed form", error_db, -85.0)
