"""Complex beams over wide bands with motion, and as laboratories measure them: late, ringing, in fine rows."""

import numpy as np
import pytest

import clsim
from clsim.numerics.band_filters import BandFilters, band_filters
from clsim.tracks.basis_design import Held

C = 343.0
AIR = clsim.Air(speed_of_sound=C)
SIZE = (6.0, 5.0, 3.0)
VELOCITY = np.array([4.0, 1.0, 0.5])
OCTAVES = clsim.Material.from_absorption([125, 250, 500, 1e3, 2e3, 4e3, 8e3], [0.1, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
QUIET = ("ignore:signals.0.. -.. dB of its energy lies above", "ignore:the material")
HARD = clsim.Material.from_reflection(0.8)


def loudspeaker() -> clsim.AxialDirectivity:
    """Return the beam of two points, 8 cm apart, the rear one a low-pass: complex, and never quite real at low f."""
    degrees, f = np.arange(0.0, 181.0, 10.0), np.linspace(100.0, 7000.0, 60)
    turn = 2j * np.pi * f / C * np.cos(np.radians(degrees))[:, None]
    values = 0.8 * np.exp(0.03 * turn) + 0.3 * np.exp(-0.05 * turn) / (1 + 1j * f / 1500.0)
    return clsim.AxialDirectivity(degrees, f, values, outside="hold")


def beacon(late: float, ringing: float) -> clsim.AxialDirectivity:
    """Return a beam in rows 34 Hz apart that is heard late, and rings: 30 echoes that fall by 40 dB."""
    rng = np.random.default_rng(1)
    degrees, f = np.arange(0.0, 181.0, 5.0), np.arange(15e3, 60e3, 34.0)
    cosine = np.cos(np.radians(degrees))[:, None]
    values = 0.5 + 0.5 * cosine + 0j * f
    for after in rng.uniform(0.0, ringing, 30):
        size = 0.2 * 10 ** (-2 * after / ringing) * (0.5 + rng.uniform(-0.5, 0.5) * cosine)
        values += size * np.exp(-2j * np.pi * f * after)
    return clsim.AxialDirectivity(degrees, f, values * np.exp(-2j * np.pi * f * late), outside="hold")


def world(signal: clsim.Signal, beam, walls: clsim.Material) -> clsim.Scene:
    start = np.array([1.5, 2.0, 1.2])
    way = clsim.Trajectory.line(start, start + 0.2 * VELOCITY, 0.2)
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((3.6, 2.6, 1.5)))
    return clsim.Scene(clsim.Shoebox(SIZE, walls), AIR, [clsim.Source("s", signal, way, beam, aim=(1, 0, 0))], [ear])


def by_hand(scene: clsim.Scene, paths: clsim.PathSet, times: np.ndarray, rate: float, count: int) -> np.ndarray:
    """Return the sum over spectrum and paths; what comes after `count` samples goes round."""
    table, signal = paths.table(times), scene.sources[0].signal
    distance, late = table.delay * C, times - table.delay
    mach = table.departure @ VELOCITY / C
    spectrum, f = np.fft.rfft(signal.read(0, signal.count), count)[:-1], np.fft.rfftfreq(count, 1 / rate)[:-1]
    spectrum[0] *= 0.5
    f[0] = 1e-3  # air and walls need not know 0 Hz
    loud = np.abs(spectrum) > 1e-6 * np.abs(spectrum).max()
    spectrum, f, out = spectrum[loud], f[loud], np.zeros(len(times))
    for p, walls in enumerate(paths.walls):
        response = (
            10 ** (-AIR.absorption_at(f) * (distance[p, :, None] - 1.0) / 20) / (distance * (1 - mach))[p, :, None]
        )
        response = response * scene.sources[0].directivity.gain(table.departure[p, :, :1], f, C)
        for wall in walls[walls >= 0]:
            response *= scene.room.faces.materials[wall].reflection_at(f)
        out += 2.0 / count * np.real((np.exp(2j * np.pi * f * late[p, :, None]) * response) @ spectrum)
    return out


def error_db(got: np.ndarray, wanted: np.ndarray, rate: float, low: float, high: float) -> float:
    """Return the error from `low` to `high` Hz, relative to all that is wanted."""
    inside = np.fft.rfftfreq(len(got), 1 / rate)
    inside = (inside >= low) & (inside <= high)
    wrong, all_of_it = (np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2 for x in (got - wanted, wanted))
    return 10.0 * float(np.log10(wrong[inside].sum() / all_of_it.sum()))


def noise(rate: float = 16e3) -> clsim.Signal:
    return clsim.Signal.noise(0.04, rate, 3, (200.0, 6000.0))


@pytest.mark.usefixtures("device")
@pytest.mark.filterwarnings(*QUIET, "ignore:source 0. air, walls and directivities are approximated to -7.[.]. dB")
def test_abrupt_noise_from_a_complex_beam_is_rendered_as_asked() -> None:
    """Noise that is switched on sounds down to 0 Hz, where no filter has a phase."""
    rate = 16e3
    scene = world(noise(), loudspeaker(), OCTAVES)
    paths = clsim.find_paths(scene, 1)
    made = clsim.render(paths, rate, duration=0.06).pressure[0].astype(float)[48:448]
    wanted = by_hand(scene, paths, np.arange(48, 448) / rate, rate, 1024)
    assert np.abs(made).max() > 0.01
    assert error_db(made, wanted, rate, 0.0, 7000.0) < -76.0


@pytest.mark.filterwarnings(*QUIET)
def test_one_frequency_of_a_complex_beam_tells_what_it_cannot_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsim.numerics.band_filters.LONGEST", 513)
    scene = world(noise(), loudspeaker(), OCTAVES)
    with pytest.warns(
        clsim.ClsimWarning, match=r"source 0: .* approximated to -\d\d dB from .* phase at \d+ Hz, .*fade the"
    ):
        plan = clsim.plan_render(clsim.find_paths(scene, 0), 16e3, responses="centre")
    assert len(plan.source_filters[0].basis) == 2


@pytest.mark.usefixtures("device")
def test_a_beacon_measured_late_and_ringing() -> None:
    rate = 128e3  # the pulse is all within the band
    pulse = clsim.Signal.tone(40e3, 0.002, rate, fade=0.001)
    scene = world(pulse, beacon(late=8e-3, ringing=3e-3), HARD)
    paths = clsim.find_paths(scene, 0)
    made = clsim.render(paths, rate, duration=0.04).pressure[0].astype(float)
    heard = np.arange(1733, 3067)
    wanted = by_hand(scene, paths, heard / rate, rate, 4096)
    assert np.abs(made).max() == pytest.approx(np.abs(wanted).max(), rel=0.01)
    assert error_db(made[heard], wanted, rate, 0.0, 60e3) < -76.0


def test_filters_begin_late() -> None:
    """A delay is taps in front, and nothing else."""
    plain, late, early = (
        band_filters(np.ones((1, 1)), 1e3, 4e3, 16e3, np.ones(9), np.max, 1e-4, by) for by in (0, 5, -3)
    )
    assert plain.error_db == late.error_db <= -80.0
    middle = plain.taps.shape[1] // 2
    for filters, by in ((late, 5), (early, -3)):
        half = filters.taps.shape[1] // 2
        first = half - middle + by
        np.testing.assert_array_equal(filters.taps[0, first : first + 2 * middle + 1], plain.taps[0])
        assert np.count_nonzero(filters.taps) == np.count_nonzero(plain.taps)


def test_what_is_slight_near_0_hz_counts_by_its_energy() -> None:
    """A quarter of a turn from 4 Hz on, at -40 dB of the band's level up to 150 Hz."""
    nodes = np.cos(np.pi * (np.arange(129) + 0.5) / 129)
    f = 3002.0 + 2998.0 * nodes
    importance = np.where(f < 150.0, 0.01, 1.0)

    def energy(left: np.ndarray) -> float:
        return float(np.sqrt(np.mean((left * importance) ** 2)))

    found = band_filters(np.array([[0.2j]]), 4.0, 6000.0, 16e3, importance, energy, 1e-3)
    assert found.error_db <= -60.0
    half = found.taps.shape[1] // 2
    w = 2 * np.pi * f / 16e3
    left = np.abs(np.exp(-1j * np.outer(w, np.arange(-half, half + 1))) @ found.taps[0] - 0.2j) * importance
    assert left[f >= 150.0].max() < 10 ** (-50 / 20)
    assert left.max() > 10 ** (-60 / 20)
    assert energy(left / importance) < 10 ** (-60 / 20)


FILTERS = BandFilters(np.zeros((1, 3)), -60.0, 5e3)


@pytest.mark.parametrize(
    ("held", "filters", "cause"),
    [
        (Held(1, 100.0, 6e3, 16e3, 129, -55.0, 3, -90.0), FILTERS, r"129 frequencies do not resolve .* than 13.9 ms"),
        (Held(1, 100.0, 6e3, 16e3, 129, -90.0, 40, -55.0), FILTERS, "more than 40 functions of frequency"),
        (Held(1, 100.0, 6e3, 16e3), BandFilters(FILTERS.taps, -55.0, 5e3), r"4097 taps \(256 ms\) does .* 5000 Hz"),
        # About 0 Hz 4 dB are added: a part of a bin may have more energy than the bin's mean.
        (Held(1, 2.0, 6e3, 16e3), BandFilters(FILTERS.taps, -59.0, 3.0), "a phase at 3 Hz, .*; fade the signal"),
    ],
)
def test_shortfalls_are_told_with_their_cause(held: Held, filters: BandFilters, cause: str) -> None:
    with pytest.warns(clsim.ClsimWarning, match=rf"source 1: .* -55 dB from .*not the -80 dB .*{cause}.*_db=-55"):
        assert held.within(-80.0, filters) == -55.0
    assert held.within(-50.0, filters) <= -55.0


def test_what_is_next_to_nothing_like_it_is_refused() -> None:
    with pytest.raises(clsim.InputError, match=r"response_error_db: must be reached .* -80 dB is not.* -30 dB is the"):
        Held(0, 100.0, 6e3, 16e3, 129, -30.0).within(-80.0)
