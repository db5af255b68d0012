"""Motion: Doppler shifts, conventions of amplitude, and times of emission."""

import numpy as np
import oracle
import pytest
from proven import proven
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import clsim

C, WIND = 340.0, np.array([3.0, -2.0, 0.5])
START, SPEED = np.array([2.0, 3.0, 1.0]), np.array([4.0, 1.0, 0.2])  # m and m/s, of the source
RECEIVERS = {"a": ((9.0, 1.0, 2.0), (-1.0, 1.5, 0.0)), "b": ((30.0, 8.0, 3.0), (0.0, 0.0, 0.0))}
EMITTED = np.array([0.0, 0.4, 1.1])
SECONDS = 2.0
ROUNDING = 1e-12  # s: of positions of tens of metres, some ulps of 4e-15 m over c, and of times about 1 s


def paths_between(sources: list[clsim.Source], receivers: list[clsim.Receiver], **air: object) -> clsim.PathSet:
    room = clsim.Shoebox((40.0, 20.0, 5.0), clsim.Material.from_reflection(0.5))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=C, **air), sources, receivers), 0)


def source(trajectory: clsim.Trajectory) -> clsim.Source:
    return clsim.Source("s", clsim.Signal.tone(40e3, 0.01, 192e3), trajectory)


@pytest.fixture(scope="module")
def paths() -> clsim.PathSet:
    walk = clsim.Trajectory.line(START, START + SECONDS * SPEED, SECONDS)
    turn = Rotation.from_euler("zyx", [[40.0, 20.0, -10.0], [100.0, -30.0, 5.0]], degrees=True)
    (place, speed), (fixed, _) = RECEIVERS.values()
    ends = [place, np.add(place, SECONDS * np.array(speed))]
    carried = clsim.Trajectory.waypoints([0.0, SECONDS], ends, turn.as_quat())
    ears = [
        clsim.Receiver("a", carried),
        clsim.Receiver("b", clsim.Trajectory.fixed(fixed), clsim.FirstOrder(0.5), aim=(-1.0, 0.0, 0.0)),
    ]
    return paths_between([source(walk)], ears, wind=tuple(WIND))


def closed_form(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return delays (T,) of the emissions, s, and unit normals (T, 3) of the wavefront: ``|q + (v - w) t| = c t``."""
    place, speed = map(np.array, RECEIVERS[name])
    apart = place + EMITTED[:, None] * (speed - SPEED) - START
    along, drift = apart @ (speed - WIND), speed - WIND
    room = C**2 - drift @ drift
    delay = (along + np.sqrt(along**2 + room * np.sum(apart**2, axis=1))) / room
    return delay, (apart + delay[:, None] * drift) / (C * delay)[:, None]


@pytest.mark.parametrize("name", RECEIVERS)
def test_one_emission_at_moving_receivers_in_wind(paths: clsim.PathSet, name: str) -> None:
    truth, r = clsim.direct_path(paths, emitted=EMITTED), list(RECEIVERS).index(name)
    delay, normal = closed_form(name)
    place, speed = map(np.array, RECEIVERS[name])
    received = EMITTED + delay
    np.testing.assert_allclose(truth.reception_time[0, r], received, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(truth.delay[0, r], delay, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(truth.arrival[0, r], -normal, rtol=0, atol=1e-11)
    np.testing.assert_allclose(truth.source_position[0, r], START + EMITTED[:, None] * SPEED, rtol=0, atol=ROUNDING * C)
    np.testing.assert_allclose(
        truth.receiver_position[0, r], place + received[:, None] * speed, rtol=0, atol=ROUNDING * C
    )
    blown = C + normal @ WIND
    np.testing.assert_allclose(
        truth.doppler_factor[0, r], (blown - normal @ speed) / (blown - normal @ SPEED), rtol=1e-12
    )
    if name == "a":  # slerp between two orientations: a turn at constant rate
        turn = Rotation.from_euler("zyx", [[40.0, 20.0, -10.0], [100.0, -30.0, 5.0]], degrees=True)
        step = (turn[1] * turn[0].inv()).as_rotvec()
        turned = Rotation.from_rotvec(received[:, None] / SECONDS * step) * turn[0]
    else:
        turned = Rotation.from_euler("z", np.pi)
    np.testing.assert_allclose(truth.local_arrival[0, r], turned.inv().apply(-normal), rtol=0, atol=1e-11)
    assert truth.line_of_sight.all()


def test_time_differences_of_arrival(paths: clsim.PathSet) -> None:
    truth = clsim.direct_path(paths, emitted=EMITTED)
    exact = closed_form("b")[0] - closed_form("a")[0]
    np.testing.assert_allclose(truth.tdoa()[0], [0.0 * exact, exact], rtol=0, atol=2 * ROUNDING)
    np.testing.assert_allclose(truth.tdoa("b")[0], [-exact, 0.0 * exact], rtol=0, atol=2 * ROUNDING)
    # Differences of delays at one reception are no TDOA: they are off by centimetres.
    delays = clsim.direct_path(paths, EMITTED).delay[0]
    assert 0.05 < np.abs(C * (delays[1] - delays[0] - exact)).min() < 1.0
    with pytest.raises(clsim.InputError, match="emitted: must be given to direct_path for a TDOA"):
        clsim.direct_path(paths, EMITTED).tdoa()
    with pytest.raises(clsim.InputError, match='reference: must be one of "a", "b", but is'):
        truth.tdoa("c")


@pytest.mark.parametrize("motion", ["retarded", "quasi-static"])
def test_both_on_circles(motion: str) -> None:
    """The reception of an emission by a receiver that circles, by bisection of the equation itself."""
    rounds = [
        clsim.Trajectory.circle((8.0, 8.0, 1.0), 2.0, 1.0, SECONDS),
        clsim.Trajectory.circle((25.0, 9.0, 2.0), 1.5, 0.8, SECONDS, phase=1.0),
    ]
    paths = paths_between([source(rounds[0])], [clsim.Receiver("r", rounds[1])])

    def place(center: tuple[float, ...], radius: float, period: float, phase: float, t: float) -> np.ndarray:
        angle = 2.0 * np.pi * t / period + phase
        return np.array(center) + radius * np.array([np.cos(angle), np.sin(angle), 0.0])

    truth = clsim.direct_path(paths, motion=motion, emitted=EMITTED)
    for i, left in enumerate(EMITTED):

        def late(t: float, left: float = left) -> float:
            start = place((8.0, 8.0, 1.0), 2.0, 1.0, 0.0, left if motion == "retarded" else t)
            return t - left - np.linalg.norm(place((25.0, 9.0, 2.0), 1.5, 0.8, 1.0, t) - start) / C

        received = brentq(late, left, left + 0.2, xtol=1e-14, rtol=1e-15)
        assert abs(truth.reception_time[0, 0, i] - received) < ROUNDING


def test_tables_name_the_time_that_was_given(paths: clsim.PathSet) -> None:
    pytest.importorskip("xarray")
    truth = clsim.direct_path(paths, emitted=EMITTED)
    assert truth.to_xarray().times.attrs["long_name"] == "time of emission"
    rows = truth.to_dataframe()
    np.testing.assert_array_equal(rows.times[rows.receiver == "b"], EMITTED)
    np.testing.assert_array_equal(rows.local_arrival_y[rows.receiver == "b"], truth.local_arrival[0, 1, :, 1])


@pytest.mark.parametrize(("times", "emitted", "found"), [(None, None, "neither is"), ([0.0], [0.0], "both are")])
def test_one_of_both_times_is_given(paths: clsim.PathSet, times: object, emitted: object, found: str) -> None:
    with pytest.raises(clsim.InputError, match=f"times: must be given or else emitted, but {found}"):
        clsim.direct_path(paths, times, emitted=emitted)


RATE, TONE = 192e3, 40e3
AIR = clsim.Air(speed_of_sound=343.0)
ROOM = clsim.Shoebox((10, 8, 6), clsim.Material.from_reflection(0.9))


def heard(source: clsim.Trajectory, receiver: clsim.Trajectory, engine: str) -> np.ndarray:
    """Return the recording of a tone, after a check of some samples against the paths."""
    tone = clsim.Signal.tone(TONE, 0.1, RATE, fade=0.002)
    scene = clsim.Scene(ROOM, AIR, [clsim.Source("s", tone, source)], [clsim.Receiver("r", receiver)])
    made = clsim.render(clsim.find_paths(scene, 0), RATE, engine=engine, duration=0.1, convolve_static=False)
    pressure = made.pressure[0].astype(float)
    some = np.floor(np.linspace(0.1, 0.99, 300) * len(pressure))
    wanted = oracle.as_the_paths_say(made.paths, some / RATE)
    assert np.abs(wanted).max() > 0.01, "something sounds"
    assert oracle.error_db(pressure[some.astype(int)], wanted) < -50.0  # how exactly is in test_accuracy.py
    return pressure


def frequency_and_level(pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequency (Hz) and amplitude over time, from the analytic signal away from the ends."""
    spectrum = np.fft.fft(pressure)
    spectrum[len(spectrum) // 2 :] = 0.0
    analytic = 2 * np.fft.ifft(spectrum)[5000:-2000]
    phase = np.unwrap(np.angle(analytic))
    return (phase[200:] - phase[:-200]) * RATE / (2 * np.pi * 200), np.abs(analytic)


@pytest.mark.parametrize("speed", [3.0, 20.0])
@proven
def test_approaching_source_and_receiver(engine: str, speed: float) -> None:
    fixed = clsim.Trajectory.fixed((9, 4, 3))
    moving = clsim.Trajectory.line((1, 4, 3), (1 + speed * 0.1, 4, 3), 0.1)
    source_moves = np.median(frequency_and_level(heard(moving, fixed, engine))[0])
    receiver_moves = np.median(frequency_and_level(heard(fixed, moving, engine))[0])
    assert source_moves == pytest.approx(TONE / (1 - speed / 343.0), rel=2e-7)
    assert receiver_moves == pytest.approx(TONE * (1 + speed / 343.0), rel=2e-7)


@proven
def test_circle_about_the_receiver_changes_nothing(engine: str) -> None:
    circle = clsim.Trajectory.circle((5, 4, 3), 2.0, 1.0, 0.1)
    frequency, level = frequency_and_level(heard(circle, clsim.Trajectory.fixed((5, 4, 3)), engine))
    middle = slice(2000, -2000)
    # Phase noise of -80 dB at either end of 200 samples, most of it from the analytic signal's own ends.
    assert np.abs(frequency[middle] - TONE).max() < 2 * 1e-4 * RATE / (2 * np.pi * 200)
    expected = 10 ** (-AIR.absorption_at(TONE) / 20) / 2.0
    assert np.abs(level[middle] / expected - 1).max() < 1e-4


@pytest.mark.parametrize(("amplitude", "exponent"), [("static", 0), ("wave-equation", 1), ("convective", 2)])
def test_amplitude_conventions(amplitude: str, exponent: int) -> None:
    line = clsim.Trajectory.line((1, 4, 3), (3, 4, 3), 0.1)
    scene = clsim.Scene(
        ROOM, AIR, [clsim.Source("s", clsim.Signal.tone(TONE, 0.1, RATE), line)],
        [clsim.Receiver("r", clsim.Trajectory.fixed((9, 4, 3)))],
    )  # fmt: skip
    table = clsim.find_paths(scene, 0).table([0.05], amplitude=amplitude)
    distance = 343.0 * table.delay[0, 0]
    free = 10 ** (-AIR.absorption_at(TONE) * (distance - 1) / 20) / distance
    assert table.gain[0, 0] == pytest.approx(free * (1 - 20 / 343.0) ** -exponent, rel=1e-12)


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_a_receiver_that_meets_a_silent_source(engine: str) -> None:
    """It ends where a beacon stands that fell silent 14 ms before, 2 cm away: there is its sound, and then silence."""
    rate, tone = 16e3, clsim.Signal.tone(3e3, 0.37, 16e3, fade=0.01)
    beacon = clsim.Source("beacon", tone, clsim.Trajectory.fixed((3.5, 2.5, 1.5)))
    robot = clsim.Receiver("robot", clsim.Trajectory.line((3.5, 2.5, 0.924), (3.5, 2.5, 1.5), 0.384))
    room = clsim.Shoebox((7.0, 5.0, 3.0), clsim.Material.from_reflection(0.8))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [beacon], [robot]), 0)
    pressure = clsim.render(paths, rate, duration=0.384, engine=engine).pressure[0]
    assert np.abs(pressure[round(0.34 * rate) : round(0.36 * rate)]).max() > 10.0  # 4 to 7 cm away
    assert np.abs(pressure[round(0.377 * rate) :]).max() <= 1e-4 * np.abs(pressure).max()
