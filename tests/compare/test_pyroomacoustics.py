"""Against pyroomacoustics: the impulse response of a shoebox, and which images are seen in an L-shaped room.

Its conventions, as far as they matter here: sound pressure 1/d at d metres as in clsim; an arrival is a sinc between
samples, read from a table by linear interpolation, times a Hann window that stays on whole samples, and everything
comes half the filter's length later; images, gains and times are float32; the loss of a wall is 1 - factor squared.

Air is left out: pyroomacoustics takes absorption from a table by octaves, which is no ISO 9613-1 (0.5 to 0.9 of it
from 2 kHz on).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from late import installed
from scipy.spatial import cKDTree

import clsim

pra = installed("pyroomacoustics", "pyroomacoustics is not installed")

SPEED = 345.2  # m/s, not its default of 343
RATE = 16000
SIZE = (5.0, 4.0, 3.0)
SOURCE, RECEIVER = (1.1, 1.3, 1.2), (3.7, 2.9, 2.2)
FACTORS = {"west": 0.9, "east": 0.8, "south": 0.7, "north": 0.95, "floor": 0.5, "ceiling": 0.85}
WALLS = dict(zip(("x_min", "x_max", "y_min", "y_max", "z_min", "z_max"), FACTORS.values(), strict=True))
ORDER = 4
ROUNDED = 2.0**-24  # of a value, at most, by rounding to float32
BAND = (0.02, 0.35)  # of the sampling rate, well off both ends, where a filter of 81 taps falls

L_ROOM = ((0.0, 0.0), (8.0, 0.0), (8.0, 5.0), (4.0, 5.0), (4.0, 9.0), (0.0, 9.0))
HEIGHT = 3.0
FACTOR = 0.9
EARS, SEEDS = 5, 5


@dataclass(frozen=True)
class Filter:
    """What pyroomacoustics makes of an arrival."""

    taps: int
    steps: int  # of its table of the sinc, per sample

    def error(self, frequencies: np.ndarray) -> float:
        """Return the largest error of its response against a pure delay at frequencies in cycles per sample."""
        k = np.arange(self.taps) - self.taps // 2
        worst = 0.0
        for late in np.linspace(0.0, 1.0, 41):
            at = (k - late) * self.steps
            below = np.floor(at)
            low, high = np.sinc(below / self.steps), np.sinc((below + 1.0) / self.steps)
            taps = np.hanning(self.taps) * (low + (at - below) * (high - low))
            wrong = np.exp(-2j * np.pi * np.outer(frequencies, k)) @ taps - np.exp(-2j * np.pi * frequencies * late)
            worst = max(worst, float(np.abs(wrong).max()))
        return worst


AS_IT_COMES, FINE = Filter(81, 20), Filter(401, 1024)


@pytest.fixture
def constants() -> Iterator[Any]:
    """Its settings, which are those of the process, put back behind the test."""
    names = ("frac_delay_length", "sinc_lut_granularity", "rir_hpf_enable")
    before = {name: pra.constants.get(name) for name in names}
    pra.constants.set("rir_hpf_enable", False)  # a high-pass at 10 Hz, whose ringing is longer than the response
    yield pra.constants
    for name, value in before.items():
        pra.constants.set(name, value)


def scene_of(room: Any, source: Any, receivers: Any) -> clsim.Scene:
    return clsim.Scene(
        room, clsim.Air(speed_of_sound=SPEED, absorption=False),
        [clsim.Source("s", clsim.Signal.tone(1e3, 0.01, RATE), clsim.Trajectory.fixed(source))],
        [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(receivers)],
    )  # fmt: skip


def shoebox_paths() -> clsim.PathSet:
    room = clsim.Shoebox(SIZE, {name: clsim.Material.from_reflection(factor) for name, factor in WALLS.items()})
    return clsim.find_paths(scene_of(room, SOURCE, [RECEIVER]), ORDER)


def their_shoebox() -> Any:
    materials = {name: pra.Material(1.0 - factor**2) for name, factor in FACTORS.items()}
    room = pra.ShoeBox(SIZE, fs=RATE, max_order=ORDER, materials=materials, air_absorption=False)
    room.set_sound_speed(SPEED)
    room.add_source(SOURCE)
    room.add_microphone(RECEIVER)
    return room


def image_places(paths: clsim.PathSet, source: Any) -> np.ndarray:
    (images,) = paths.families
    assert images.is_specular
    return np.asarray(images.legs[0].matrix @ np.asarray(source) + images.legs[0].offset)


def rounding_of_images(order: int, farthest: float) -> float:
    """Return the largest rounding error of an image's position in float32, m.

    A reflection is ``x + 2 (n . (p - x)) n``: for each of three axes a difference, a product and a sum for the scalar
    product, and for the image a product and a sum, all of numbers below twice the farthest image's distance; the normal
    is float32 too. That is eight roundings a reflection, and each image inherits its parent's.
    """
    return order * 8 * 2.0 * farthest * ROUNDED


def rounding_of_gains(least: float) -> float:
    """Return the largest relative rounding error in float32 of a product of `ORDER` factors, the least of which is `least`.

    Loss and 1 less the loss, ``r²``, are rounded, which is off by up to two roundings of 1, and so r by ``1 / r²`` of
    them; the root, the power and the product are three more.
    """
    return ORDER * (1.0 / least**2 + 3.0) * ROUNDED


def test_images_of_a_shoebox_and_their_gains(measured) -> None:
    """Tolerances are those of float32, of places and of gains."""
    paths, room = shoebox_paths(), their_shoebox()
    room.image_source_model()
    theirs = room.sources[0]
    mine = image_places(paths, SOURCE)
    far, row = cKDTree(theirs.images.T.astype(float)).query(mine)
    assert theirs.images.shape[1] == len(paths) == len(set(row))
    allowed = rounding_of_images(1, float(np.abs(mine).max()))  # in closed form, not image by image
    measured("images of a shoebox", "pyroomacoustics, float32", 1e6 * far.max(), 1e6 * allowed, "µm")
    np.testing.assert_array_equal(theirs.orders[row], paths.order)
    table = paths.table(np.array([0.0]))
    distances = np.linalg.norm(mine - RECEIVER, axis=1)
    np.testing.assert_allclose(table.delay[:, 0], distances / SPEED, rtol=1e-14)
    gains = theirs.damping[0, row] / distances
    np.testing.assert_allclose(table.gain[:, 0], gains, rtol=rounding_of_gains(min(FACTORS.values())))


@pytest.mark.parametrize("taken", [AS_IT_COMES, FINE], ids=["as it comes", "fine"])
def test_impulse_response_of_a_shoebox(constants: Any, taken: Filter, measured) -> None:
    """Spectra over a band agree as far as its filter is no pure delay and its times are float32.

    Each path is wrong by up to its gain times (the filter's error + the phase of two roundings of its time, in
    samples). Errors of paths add in power, as the paths themselves do, which is asserted.
    """
    constants.set("frac_delay_length", taken.taps)
    constants.set("sinc_lut_granularity", taken.steps)
    paths, room = shoebox_paths(), their_shoebox()
    room.compute_rir()
    theirs = np.asarray(room.rir[0][0])
    mine = clsim.impulse_responses(paths, RATE, lead="keep", tail="off")

    size = 4096
    frequencies = np.fft.rfftfreq(size)
    band = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    early = taken.taps // 2  # what its filter comes later

    def spectrum(samples: np.ndarray, lead: int) -> np.ndarray:
        assert len(samples) <= size
        return (np.fft.rfft(samples, size) * np.exp(2j * np.pi * frequencies * lead))[band]

    wanted, found = spectrum(theirs, early), spectrum(mine.samples[0, 0], mine.lead)
    table = paths.table(np.array([0.0]))
    gains, samples = table.gain[:, 0], table.delay[:, 0] * RATE + early
    rounded = 2.0 * np.pi * BAND[1] * 2.0 * ROUNDED * samples
    allowed = np.linalg.norm(gains * (taken.error(frequencies[band][::16]) + rounded))
    assert rms(found) == pytest.approx(np.linalg.norm(gains), rel=0.1)
    found_db, allowed_db = (20 * np.log10(x / rms(wanted)) for x in (rms(found - wanted), allowed))
    measured(f"impulse response, filter of {taken.taps} taps", "pyroomacoustics", found_db, allowed_db)
    assert allowed <= {AS_IT_COMES: 4e-3, FINE: 2.5e-4}[taken] * rms(wanted)  # -48 and -72 dB


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def test_images_seen_in_an_l_shaped_room(engine: str) -> None:
    """Random ends see the same images, at places and with gains that agree within float32."""
    mine = clsim.MeshRoom.from_plan(L_ROOM, HEIGHT, clsim.Material.from_reflection(FACTOR))
    pairs = [compare_images(mine, np.random.default_rng(seed), engine) for seed in range(SEEDS)]
    assert 80 * EARS * SEEDS < sum(pairs) < 200 * EARS * SEEDS


def compare_images(mine: clsim.MeshRoom, drawn: np.random.Generator, engine: str) -> int:
    """Compare what a few receivers see of a source, drawn at random; return how many images that is."""
    source, *ears = points_inside(mine, drawn, 1 + EARS)
    paths = clsim.find_paths(scene_of(mine, source, ears), ORDER, engine=engine)
    room = their_l_room(source, ears)
    theirs = room.sources[0]
    places, gains = image_places(paths, source), paths.table(np.array([0.0])).gain[:, 0]
    near = rounding_of_images(ORDER, float(np.abs(places).max()))
    for receiver, ear in enumerate(ears):
        rows = np.flatnonzero(paths.receiver == receiver)
        columns = np.flatnonzero(room.visibility[0][receiver])
        far, of = cKDTree(theirs.images[:, columns].T.astype(float)).query(places[rows])
        assert len(rows) == len(columns) == len(set(of)), f"from {source} to {ear}"
        assert far.max() <= near
        assert cKDTree(places[rows]).query_pairs(10.0 * near) == set(), "places tell the images apart"
        np.testing.assert_array_equal(theirs.orders[columns][of], paths.order[rows])
        distances = np.linalg.norm(places[rows] - ear, axis=1)
        wanted = theirs.damping[0, columns][of] / distances
        np.testing.assert_allclose(gains[rows], wanted, rtol=rounding_of_gains(FACTOR))
    return len(paths)


def their_l_room(source: Any, ears: Any) -> Any:
    wall = pra.Material(1.0 - FACTOR**2)
    room = pra.Room.from_corners(np.transpose(L_ROOM), fs=RATE, max_order=ORDER, materials=wall, air_absorption=False)
    room.extrude(HEIGHT, materials=wall)
    room.set_sound_speed(SPEED)
    room.add_source(source)
    room.add_microphone_array(np.transpose(ears))
    room.image_source_model()
    return room


def points_inside(room: clsim.MeshRoom, drawn: np.random.Generator, count: int) -> np.ndarray:
    """Return points (count, 3), 5 cm from the box about the room or more."""
    low, high = room.extent
    found = drawn.uniform(low + 0.05, high - 0.05, (8 * count, 3))
    return np.asarray(found[room.contains(found)][:count])
