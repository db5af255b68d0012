"""Scores of ranges and positions against what theory says of pulses, noise and geometry, at default settings."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.score import echoes, gdop, gdop_map, position, range_doppler, ranging

pytestmark = pytest.mark.usefixtures("device")

RATE = 192e3
C = 343.0
AIR = clsim.Air(speed_of_sound=C)
SPEED = 0.5  # m/s, at which sources recede
BANDS = ((20e3, 45e3, 5e-3), (20e3, 45e3, 10e-3), (17e3, 23e3, 10e-3), (17e3, 23e3, 10e-3))  # from, to, within s
WINDOWS = ("tukey", "tukey", "tukey", "none")
REACH = 8.0  # m


def fixed(name: str, *place: float, **more: Any) -> clsim.Receiver:
    return clsim.Receiver(name, clsim.Trajectory.fixed(place), **more)


def paths_in(size: tuple[float, ...], sources: list[Any], receivers: list[Any], order: int = 0) -> clsim.PathSet:
    room = clsim.Shoebox(size, clsim.Material.from_reflection(0.8))
    return clsim.find_paths(clsim.Scene(room, AIR, sources, receivers), order)


def chirps() -> list[clsim.Signal]:
    return [clsim.Signal.chirp(*band, RATE, window=window) for band, window in zip(BANDS, WINDOWS, strict=True)]


@pytest.fixture(scope="module")
def receding() -> clsim.Recording:
    """Return sources that recede from a receiver at 1 m, one after the other, each with a chirp of its own."""
    sources = []
    for i, chirp in enumerate(chirps()):
        path = clsim.Trajectory.line((2, 2, 1 + 0.1 * i), (2.5, 2, 1 + 0.1 * i), 1.0)
        sources.append(clsim.Source(f"s{i}", clsim.Signal.pulses(chirp, 0.2, 2), path, start=0.05 * i))
    ears = [fixed(f"r{i}", 1, 2, 1 + 0.1 * i) for i in range(len(sources))]
    with pytest.warns(clsim.ClsimWarning, match="of its energy lies above"):  # the chirp that begins abruptly
        return clsim.render(paths_in((8, 4, 3), sources, ears), sampling_rate=RATE)


@pytest.mark.parametrize("i", [0, 1, 2, 3])
def test_a_receding_chirp_seems_further_by_its_doppler_shift(receding: clsim.Recording, i: int) -> None:
    low, high, length = BANDS[i]
    centre, band = 0.5 * (low + high), high - low
    want = SPEED * length * (centre / band + 0.5)
    if WINDOWS[i] == "none":
        # The overlap of an abrupt chirp with itself, 1 - |t| / T, has a kink at no shift, which draws the peak of
        # sin(pi B t) / (pi B t), whose logarithm falls by (pi B t)² / 6, towards it.
        want -= C * 3.0 / (math.pi**2 * band**2 * length)
    score = ranging(receding, chirps()[i], source=f"s{i}", max_range=REACH)
    assert score.error.shape == (4, 2)
    np.testing.assert_allclose(score.error[i], want, rtol=0, atol=1e-4)
    assert score.line_of_sight.all()
    assert (score.crlb == 0.0).all()


def test_noise_is_met_as_well_as_it_can_be() -> None:
    """The deviation of 200 ranges in Gaussian noise is within 15 % of the bound, three of its own deviations."""
    pulse = clsim.Signal.chirp(30e3, 50e3, 2e-3, RATE, window="hann")
    source = clsim.Source("s", clsim.Signal.pulses(pulse, 0.01, 200), clsim.Trajectory.fixed((1, 2, 1)))
    electronics = clsim.Electronics(ambient_noise_db=10.0, self_noise_db=8.0, gain_db=6.0, seed=3)
    recording = clsim.render(paths_in((8, 4, 3), [source], [fixed("r", 3, 2, 1, electronics=electronics)]), RATE)
    for method in ("matched-filter", "phase"):
        score = ranging(recording, pulse, method)
        assert score.detection_rate == 1.0
        bound = float(np.sqrt(np.mean(np.square(score.crlb))))
        assert 0.85 < score.deviation / bound < 1.15
        assert abs(score.bias) < 4.0 * bound / math.sqrt(200)
    assert bound < 5e-5  # which knows the carrier
    noisy = clsim.Electronics(ambient_noise_db=60.0, seed=3)
    deaf = clsim.render(paths_in((8, 4, 3), [source], [fixed("r", 3, 2, 1, electronics=noisy)]), RATE, duration=0.3)
    assert ranging(deaf, pulse).detection_rate < 0.05


@pytest.fixture(scope="module")
def located(once: Callable[[str, Callable[[], Any]], Any]) -> clsim.Recording:
    """Return a walk below four receivers, and beacons that chirp in turn for the same receivers."""
    pulse = clsim.Signal.chirp(30e3, 50e3, 2e-3, RATE, window="hann")
    walk = clsim.Trajectory.line((2, 2, 1), (2.2, 2.1, 1), 1.0)
    places = ((0.5, 0.5, 2.5), (3.5, 0.4, 2.7), (3.4, 3.5, 2.4), (0.4, 3.6, 2.8), (2, 1, 2.9))
    beacons = [clsim.Trajectory.fixed((*place[:2], place[2] - 2.2)) for place in places]
    sources = [
        clsim.Source(name, clsim.Signal.pulses(pulse, 0.2, 2), path, start=0.03 * i)
        for i, (name, path) in enumerate([("walker", walk), *((f"b{i}", path) for i, path in enumerate(beacons))])
    ]
    ears = [fixed(f"c{i}", *place) for i, place in enumerate(places)]
    return clsim.render(paths_in((4, 4, 3), sources, ears), sampling_rate=RATE)


def test_positions_by_times_of_arrival_and_their_differences(located: clsim.Recording) -> None:
    pulse = clsim.Signal.chirp(30e3, 50e3, 2e-3, RATE, window="hann")
    score = ranging(located, pulse, source="walker", max_range=6.0)
    for method in ("toa", "tdoa"):
        found = position(score, method)
        assert found.names == ("walker",)
        np.testing.assert_allclose(found.exact[0, 1], [2.04, 2.02, 1.0], atol=1e-12)
        # What ranges are wrong by: 0.22 m/s times T (f_c / B + 1 / 2) is 1.1 mm at most.
        assert (found.error <= 1.1e-3 * found.gdop).all()
        assert found.availability == 1.0
    beacons = [ranging(located, pulse, source=f"b{i}", max_range=6.0) for i in range(5)]
    ears = position(beacons)
    assert ears.names == tuple(f"c{i}" for i in range(5))
    assert ears.percentile(100) < 2e-5  # nothing moves
    assert position(beacons[:4], "toa").percentile(100) < 2e-5
    with pytest.raises(clsim.InputError, match="scores: must give 4 anchors at least for tdoa, but give 3"):
        position(beacons[:3], "tdoa")


def test_scores_are_tables_and_pictures(located: clsim.Recording) -> None:
    pytest.importorskip("pandas")
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    pulse = clsim.Signal.chirp(30e3, 50e3, 2e-3, RATE, window="hann")
    score = ranging(located, pulse, source="walker", max_range=6.0)
    frame = score.to_dataframe()
    np.testing.assert_array_equal(frame[frame.receiver == "c2"].error, score.error[2])
    found = position(score)
    rows = found.to_dataframe()
    np.testing.assert_array_equal(rows[["x", "y", "z"]], found.estimated[0])
    np.testing.assert_array_equal(rows.z_exact, [1.0, 1.0])
    for drawn in (score, found):
        assert len(drawn.plot().axes) == 2
        assert "within" in drawn._repr_html_()
    pyplot.close("all")


def test_dilution_of_precision() -> None:
    """Anchors along three axes dilute by the root of 3; differences of a regular tetrahedron by 3 / 2 of the same."""
    axes = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]])
    assert gdop(axes, [0, 0, 0]) == pytest.approx(math.sqrt(3.0))
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    assert gdop(corners, [0, 0, 0], "tdoa") == pytest.approx(1.5)  # H' H is 4 / 3 of the identity, and 4 for the clock
    assert gdop(axes, [0, 0, 0], "tdoa") == math.inf
    assert gdop(axes * [1, 1, 0], [0, 0, 0]) == math.inf  # none of them sees z
    plane = gdop_map(corners, [-0.5, 0.0, 0.5], [0.0], 0.0, "tdoa")
    assert plane.gdop.shape == (1, 3)
    assert plane.gdop[0, 1] == pytest.approx(1.5)
    assert plane.gdop[0, 0] > 1.5
    assert plane.to_dataframe()["gdop"].tolist() == plane.gdop[0].tolist()
    assert plane.plot().axes[0].get_xlabel() == "x (m)"


def test_what_is_hidden_and_what_is_louder_than_the_direct_sound() -> None:
    """A floor loud with a beam on it: the strongest arrival is late by 1.6 m, the first is right; a screen hides both."""
    pulse = clsim.Signal.chirp(30e3, 50e3, 2e-3, RATE, window="hann")
    walls = {"default": clsim.Material.from_reflection(0.0), "z_min": clsim.Material.from_reflection(0.9)}
    screen = clsim.MeshRoom([(4, 2.5, 0), (4, 4, 0), (4, 4, 3), (4, 2.5, 3)], [(0, 1, 2), (0, 2, 3)], walls["default"])
    room = clsim.MeshRoom.joined([clsim.Shoebox((8, 4, 3), walls), screen])
    source = clsim.Source(
        "s", clsim.Signal.pulses(pulse, 0.05, 2), clsim.Trajectory.fixed((2, 2, 1.5)),
        directivity=clsim.FirstOrder(0.3), aim=(0.0, 0.0, -1.0),
    )  # fmt: skip
    ears = [fixed("open", 4.5, 2, 1.5), fixed("hidden", 5, 3.9, 1.5)]
    paths = clsim.find_paths(clsim.Scene(room, AIR, [source], ears), 1)
    recording = clsim.render(paths, sampling_rate=RATE)
    loudest, first = (ranging(recording, pulse, m) for m in ("matched-filter", "first-peak"))
    np.testing.assert_array_equal(first.line_of_sight, [[True, True], [False, False]])
    assert np.isnan(first.delay[1]).all()
    assert first.detection_rate == 0.5
    way = math.hypot(2.5, 3.0) - 2.5
    np.testing.assert_allclose(loudest.error[0], way, atol=1e-4)
    np.testing.assert_allclose(first.error[0], 0.0, atol=1e-4)
    assert (loudest.outlier_rate, first.outlier_rate) == (1.0, 0.0)
    assert math.isnan(loudest.bias)
    assert loudest.percentile(75) == pytest.approx(way, abs=1e-4)


def test_a_sonar_sees_a_wall_come_nearer() -> None:
    pulse = clsim.Signal.chirp(35e3, 45e3, 1e-3, RATE, window="hann")
    walls = {"default": clsim.Material.from_reflection(0.0), "x_max": clsim.Material.from_reflection(0.8)}
    period, count, speed = 0.02, 32, 0.1
    train = clsim.Signal.pulses(pulse, period, count)
    source = clsim.Source("s", train, clsim.Trajectory.line((4, 2, 1), (4 + speed, 2, 1), 1.0))
    ear = clsim.Receiver("r", clsim.Trajectory.line((4, 2.1, 1), (4 + speed, 2.1, 1), 1.0))
    room = clsim.Shoebox((6, 4, 3), walls)
    air = clsim.Air(speed_of_sound=C, absorption=False)
    recording = clsim.render(clsim.find_paths(clsim.Scene(room, air, [source], [ear]), 1), sampling_rate=RATE)
    found = range_doppler(recording, pulse, max_range=3.0)
    level = np.abs(found.amplitude)
    level[:, found.ranges < 0.5] = 0.0  # from source to receiver
    row, column = np.unravel_index(level.argmax(), level.shape)
    middle = 2.0 - speed * 0.5 * period * count
    assert abs(found.speeds[row] + speed) <= 0.5 * np.diff(found.speeds).max()
    # Within half a turn of the run, a third of the chirp's resolution, and what Doppler makes of a chirp, 2 v T f_c / B.
    assert abs(found.ranges[column] - middle) < 5e-3
    # The peak between bins and ranges is at most 1.42 dB lower (Hann) than the path is loud.
    assert 0.8 < level.max() / (0.8 / (2.0 * middle)) < 1.02
    np.testing.assert_allclose(np.ptp(found.speeds), C / (2 * 40e3 * period) * (count - 1) / count, rtol=1e-3)
    np.testing.assert_allclose(found.unambiguous_speed, C / (4 * 40e3 * period), rtol=1e-3)
    pytest.importorskip("pandas")
    frame = found.to_dataframe()
    far = frame[frame["range"] >= 0.5]
    loudest = far.loc[far.amplitude.abs().idxmax()]
    assert (loudest["range"], loudest.speed) == (found.ranges[column], found.speeds[row])
    labelled = found.to_xarray()
    assert labelled.sel(speed=found.speeds[row], range=found.ranges[column]) == found.amplitude[row, column]
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    drawn = found.plot().axes[0].collections[0].get_array()
    assert drawn.shape[1] <= 1600  # columns of a picture: each is the largest of some ranges
    np.testing.assert_allclose(drawn.max(axis=1), 20.0 * np.log10(np.abs(found.amplitude).max(axis=1)), rtol=1e-12)
    pyplot.close("all")


def test_echoes_of_a_train_follow_a_wall() -> None:
    """A sonar drives towards a wall: in each row the loudest echo is at the wall's distance at the reflection."""
    pulse = clsim.Signal.chirp(35e3, 45e3, 1e-3, RATE, window="hann")
    walls = {"default": clsim.Material.from_reflection(0.0), "x_max": clsim.Material.from_reflection(0.8)}
    period, count, speed = 0.02, 20, 0.5
    trajectory = clsim.Trajectory.line((4, 2, 1), (4 + speed, 2, 1), 1.0)
    source = clsim.Source("s", clsim.Signal.pulses(pulse, period, count), trajectory)
    scene = clsim.Scene(
        clsim.Shoebox((6, 4, 3), walls), clsim.Air(speed_of_sound=C, absorption=False), [source],
        [clsim.Receiver("r", trajectory)],
    )  # fmt: skip
    recording = clsim.render(clsim.find_paths(scene, 1, direct=False), sampling_rate=RATE)
    found = echoes(recording, pulse, max_range=3.0)
    assert found.amplitude.shape == (count, len(found.ranges))
    np.testing.assert_array_equal(found.emission_times, period * np.arange(count))
    distance = 2.0 - speed * found.emission_times
    exact = distance * C / (C + speed)  # half of the time of flight times c: out to the wall, back to where it is then
    loudest = np.abs(found.amplitude).argmax(axis=1)
    # Half a sample, and what Doppler makes of a chirp: its peak is early by 2 v / c T f_c / B seconds.
    shift = C / 2 * 2 * speed / C * 1e-3 * 40e3 / 10e3
    np.testing.assert_allclose(found.ranges[loudest], exact - shift, atol=0.6 * C / 2 / RATE)
    assert np.abs(found.amplitude)[np.arange(count), loudest] == pytest.approx(0.8 / (2 * exact), rel=0.02)
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    drawn = found.plot().axes[0].collections[0].get_array()
    np.testing.assert_allclose(drawn.max(axis=1), 20.0 * np.log10(np.abs(found.amplitude).max(axis=1)), rtol=1e-12)
    pyplot.close("all")


def test_what_cannot_be_scored_is_refused(receding: clsim.Recording) -> None:
    pulse = chirps()[0]
    bare = clsim.Recording(np.zeros((1, 4000), dtype=np.float32), RATE, ("a",), None, ())
    envelope = clsim.Recording(np.zeros((1, 4), dtype=np.complex64), 6e3, ("a",), None, (), carrier=40e3)
    for use, message in (
        (lambda: ranging(bare, pulse), r"recording: must have its paths for ranging, but has none"),
        (lambda: ranging(envelope, pulse), r"recording: must be sound for ranging, but is the envelope about 40000 Hz"),
        (lambda: ranging(receding, pulse, "nearest"), r"method: must be one of"),
        (lambda: ranging(receding, pulse, source="x"), r'source: must be one of "s0", "s1", "s2", "s3", but is .x.'),
        (lambda: ranging(receding, pulse, max_range=0.0), r"max_range: must be above 0"),
        (lambda: range_doppler(receding, pulse, 4), r"receiver: must be from 0 to 3, but is 4"),
        (lambda: range_doppler(receding, pulse, "nobody"), r"receiver: must be one of .*, but is 'nobody'"),
        (lambda: echoes(bare, pulse), r"recording: must have its paths for echoes, but has none"),
        (lambda: echoes(receding, pulse, max_range=-1.0), r"max_range: must be above 0"),
        (lambda: position([]), r"scores: must be one RangingScore at least"),
    ):
        with pytest.raises(clsim.InputError, match=message):
            use()
