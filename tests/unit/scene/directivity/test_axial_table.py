"""Tables by angle and frequency, against closed forms."""

import numpy as np
import pytest
from scipy.special import j1

import clsim
from clsim import AxialDirectivity
from clsim.acoustics.directivity import fit_delay

SPEED = 343.0
FINE = np.linspace(0.0, np.pi, 1025)


def piston_ahead(angle, frequency, radius=0.0047, ahead=0.01, delay=0.0):
    """Return the far field of a piston whose centre is `ahead` of the origin, with phases that turn quickly."""
    k = 2 * np.pi * frequency / SPEED
    x = np.maximum(np.abs(k * radius * np.sin(angle)), 1e-9)
    return 2 * j1(x) / x * np.exp(1j * k * ahead * np.cos(angle) - 2j * np.pi * frequency * delay)


def table_of(step, frequencies, last=180.0, options=None, **pattern):
    angles = np.arange(0.0, last + 1e-9, step)
    values = piston_ahead(np.radians(angles)[:, None], np.asarray(frequencies), **pattern)
    return AxialDirectivity(angles, frequencies, values, **(options or {}))


def level(gain):
    return 20 * np.log10(np.maximum(np.abs(gain), 1e-15))


def test_the_table_s_own_points_come_back():
    frequencies = np.linspace(20e3, 80e3, 25)
    table = table_of(5.0, frequencies, radius=0.01, ahead=0.03)
    gain = table.gain(np.cos(np.radians(table.angles_degrees))[:, None], frequencies, SPEED)
    np.testing.assert_allclose(gain, table.values, atol=1e-12)
    db = AxialDirectivity.from_db([0, 10, 45, 180], [1e3, 2e3], [[0, 0], [-1, -3], [-3, -20], [-40, -60]])
    gain = db.gain(np.cos(np.radians(db.angles_degrees))[:, None], db.frequencies, SPEED)
    np.testing.assert_allclose(level(gain), db.values, atol=1e-9)


@pytest.mark.parametrize(
    ("step", "radius", "ahead", "allowed"),
    [(10.0, 0.0047, 0.0, -80), (10.0, 0.0047, 0.03, -70), (5.0, 0.01, 0.03, -70), (2.5, 0.01, 0.03, -95)],
)
def test_between_angles_it_is_the_piston_whose_phase_turns(step, radius, ahead, allowed, measured):
    # Cubic splines: 24 dB per halved step. Measured: -82, -74, -83 and -107 dB. Straight lines between real and
    # imaginary parts are at -18 dB in the worst of these cases, dB and unwrapped phases at -20 dB.
    table = table_of(step, [40e3], radius=radius, ahead=ahead)
    error = table.gain(np.cos(FINE), 40e3, SPEED) - piston_ahead(FINE, 40e3, radius, ahead)
    found = level(error).max()
    measured(f"tables of directivities every {step:g}°", "piston", found, allowed)


def test_level_and_phase_between_angles_and_frequencies():
    frequencies = np.arange(20e3, 60.1e3, 2e3)
    table = table_of(5.0, frequencies, radius=0.008, ahead=0.02, delay=50e-6)
    between = np.arange(21e3, 60e3, 2e3)
    gain = table.gain(np.cos(FINE)[:, None], between, SPEED)
    expected = piston_ahead(FINE[:, None], between, 0.008, 0.02, 50e-6)
    loud = np.abs(expected) > 0.1  # of the axis
    assert np.abs(level(gain)[loud] - level(expected)[loud]).max() < 0.1
    assert np.degrees(np.abs(np.angle(gain[loud] / expected[loud]))).max() < 1.0
    assert level(gain - expected).max() < -55.0  # -61.5 measured


def test_the_shared_delay_is_found():
    table = table_of(5.0, np.arange(30e3, 50e3, 1e3), ahead=0.02, delay=30e-6)
    assert table.delay[0] == pytest.approx(30e-6, abs=0.2e-6)
    assert table.delay[1] == pytest.approx(-0.02 / SPEED, rel=0.01)
    alone = table_of(5.0, [40e3], ahead=0.02)  # one frequency: from neighbours in angle
    assert alone.delay[1] == pytest.approx(-0.02 / SPEED, rel=0.01)


@pytest.mark.parametrize(
    ("step", "frequencies", "ahead", "delay"),
    [
        (10.0, np.arange(70e3, 80e3, 200.0), 0.06, 0.0),  # neighbours in angle are turns apart
        (2.0, np.array([20e3, 40e3, 60e3]), 0.03, 0.0),  # neighbours in frequency are
        (10.0, np.arange(30e3, 50e3, 200.0), 0.03, 2.5e-3),  # half a turn from one frequency to the next
        (10.0, np.arange(30e3, 50e3, 50.0), 0.01, 2.9e-3),  # 1 m of air
    ],
)
def test_the_shared_delay_is_found_where_phases_turn_far(step, frequencies, ahead, delay):
    table = table_of(step, frequencies, ahead=ahead, delay=delay)
    assert table.delay[1] == pytest.approx(-ahead / SPEED, rel=0.02)
    turns = (table.delay[0] - delay) * (frequencies[1] - frequencies[0])
    assert turns == pytest.approx(round(turns), abs=0.01)
    middle = frequencies[len(frequencies) // 2]
    error = table.gain(np.cos(FINE), middle, SPEED) - piston_ahead(FINE, middle, ahead=ahead, delay=delay)
    assert level(error).max() < -60.0


def test_fit_delay_in_three_dimensions(rng):
    points = rng.normal(size=(60, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    wanted = np.array([20e-6, -3e-6, 5e-6, 4e-6])
    f = np.array([30e3, 32e3, 35e3])
    values = np.exp(-2j * np.pi * f * (wanted[0] + points @ wanted[1:])[:, None])
    pairs = np.column_stack([np.arange(59), np.arange(1, 60)])
    np.testing.assert_allclose(fit_delay(points, f, values, pairs), wanted, atol=1e-12)
    many = np.linspace(30e3, 35e3, 20_000)  # so many that not all points are looked at
    values = np.exp(-2j * np.pi * many * (wanted[0] + points @ wanted[1:])[:, None])
    np.testing.assert_allclose(fit_delay(points, many, values, pairs), wanted, atol=1e-11)


def test_levels_in_db_do_not_overshoot():
    angles = np.array([0.0, 5, 10, 60, 65, 90, 120, 180])
    rows = np.array([0.0, 0, -20, -20, -3, -30, -30, -31])
    table = AxialDirectivity.from_db(angles, [40e3, 41e3, 60e3], rows[:, None] + [0.0, -1.0, -40.0])
    assert not table.is_complex
    got = level(table.gain(np.cos(FINE), 40e3, SPEED))
    cell = np.clip(np.searchsorted(np.radians(angles), FINE, side="right") - 1, 0, len(angles) - 2)
    assert np.all(got <= np.maximum(rows[cell], rows[cell + 1]) + 1e-9)
    assert np.all(got >= np.minimum(rows[cell], rows[cell + 1]) - 1e-9)
    over = level(table.gain(np.ones(200), np.linspace(40e3, 60e3, 200), SPEED))
    assert np.all(np.diff(over) <= 1e-12)


@pytest.mark.parametrize("options", [{}, {"scale": "db"}], ids=["complex", "db"])
@pytest.mark.parametrize("rear", [None, "hold", "mirror", "zero"])
def test_it_is_smooth_over_the_axis_and_where_the_rear_begins(rear, options):
    angles = np.arange(0.0, (180.0 if rear is None else 90.0) + 1, 15.0)
    values = piston_ahead(np.radians(angles)[:, None], np.array([40e3]), 0.003, 0.002)
    values = level(values) if options else values
    table = AxialDirectivity(angles, [40e3], values, rear=rear, **options)

    def slope(at, step):
        a, b = (table.gain(np.cos(at + s), 40e3, SPEED) for s in (0.0, step))
        return (b - a) / step

    h = 1e-6
    assert abs(slope(1e-7, h)) < 1e-4
    for joint in [np.pi / 2] if rear else [np.pi / 2, np.pi]:
        inside, beyond = slope(joint, -h), slope(joint, h if joint < np.pi else -h)
        assert abs(beyond - inside) < 1e-4, joint
    gain = table.gain(np.cos(FINE), 40e3, SPEED)
    assert np.abs(np.diff(gain)).max() < 5.0 * np.pi / 1024  # no jumps


def test_the_rear_is_what_was_asked_for():
    at_90 = table_of(5.0, [40e3], last=90.0, options={"rear": "hold"}).gain(np.cos(FINE), 40e3, SPEED)
    behind = np.pi / 2 + 1e-9 < FINE
    np.testing.assert_allclose(at_90[behind], piston_ahead(np.pi / 2, 40e3), atol=1e-12)
    mirrored = table_of(5.0, [40e3], last=90.0, options={"rear": "mirror"}).gain(np.cos(FINE), 40e3, SPEED)
    np.testing.assert_allclose(mirrored, mirrored[::-1], atol=1e-12)
    nothing = table_of(5.0, [40e3], last=90.0, options={"rear": "zero"})
    assert np.abs(nothing.gain(np.cos(np.radians([100.0, 130.0, 180.0])), 40e3, SPEED)).max() < 1e-12
    half = nothing.gain(np.cos(np.radians(95.0)), 40e3, SPEED)
    assert half == pytest.approx(0.5 * piston_ahead(np.pi / 2, 40e3), rel=1e-9)
    narrow = AxialDirectivity([0, 60], [40e3], [[1.0], [0.5]], rear="hold")
    assert narrow.gain(np.array([0.0, -1.0]), 40e3, SPEED).tolist() == pytest.approx([0.5, 0.5])


def test_two_sides():
    angles = np.arange(-90.0, 91.0, 30.0)
    same = np.cos(np.radians(angles))[:, None] + 0.1
    assert len(AxialDirectivity(angles, [1e3], same, rear="hold").angles_degrees) == 4
    other = same.copy()
    other[:3] *= 0.5
    with pytest.raises(clsim.InputError, match="side="):
        AxialDirectivity(angles, [1e3], other, rear="hold")
    for side, factor in (("positive", 1.0), ("negative", 0.5), ("mean", 0.75)):
        table = AxialDirectivity(angles, [1e3], other, rear="hold", side=side)
        assert table.gain(0.5, 1e3, SPEED) == pytest.approx(0.6 * factor)
    whole = np.arange(-180.0, 181.0, 45.0)
    assert AxialDirectivity(whole, [1e3], np.ones((9, 1))).gain(-1.0, 1e3, SPEED) == 1.0
    levels = np.zeros((9, 1))
    levels[0] = -0.5
    with pytest.raises(clsim.InputError, match=r"±180° by up to 0.5 dB"):
        AxialDirectivity(whole, [1e3], levels, scale="db")


def test_frequencies_outside_are_refused_or_held():
    refused = table_of(10.0, [30e3, 40e3, 50e3])
    assert refused.band == (30e3, 50e3)
    for f in (29e3, 50.1e3):
        with pytest.raises(clsim.InputError, match=f"must cover {f:g} Hz, but covers 30000 to 50000 Hz") as error:
            refused.gain(np.ones(3), f, SPEED)
        assert error.value.field == "directivity"
    held = table_of(10.0, [30e3, 40e3, 50e3], options={"outside": "hold"})
    assert held.band == (0.0, np.inf)
    np.testing.assert_allclose(
        np.abs(held.gain(np.cos(FINE), 60e3, SPEED)), np.abs(held.gain(np.cos(FINE), 50e3, SPEED))
    )
    # The centre stays where it is, so that the phase goes on.
    turned = np.angle(held.gain(1.0, 51e3, SPEED) / held.gain(1.0, 50e3, SPEED))
    assert turned == pytest.approx(-2 * np.pi * 1e3 * (held.delay[0] + held.delay[1]), rel=1e-9)
    edge = table_of(10.0, [30e3, 40e3, 50e3]).gain(np.ones(1), 50e3 * (1 + 1e-12), SPEED)
    assert np.isfinite(edge).all()


def test_relative_to_the_axis():
    f = np.linspace(30e3, 50e3, 21)
    response = (1.0 + 0.3 * np.sin(f / 1e3)) * np.exp(-2j * np.pi * f * 3e-3)  # 1 m of air among it
    angles = np.arange(0.0, 181.0, 5.0)
    beam = piston_ahead(np.radians(angles)[:, None], f)
    table = AxialDirectivity(angles, f, beam * response, relative_to_axis=True)
    np.testing.assert_allclose(table.gain(1.0, f, SPEED), 1.0, atol=1e-12)
    np.testing.assert_allclose(table.values, beam / beam[0], atol=1e-9)
    db = AxialDirectivity([0, 180], [1e3], [[-20.0], [-30.0]], scale="db", relative_to_axis=True)
    assert db.gain(-1.0, 1e3, SPEED) == pytest.approx(10**-0.5)
    with pytest.raises(clsim.InputError) as error:
        AxialDirectivity([0, 180], [1e3], [[0.0], [1.0]], relative_to_axis=True)
    assert error.value.field == "relative_to_axis"


def test_signed_real_values_stay_real_and_go_through_zero():
    angles = np.arange(0.0, 181.0, 10.0)
    table = AxialDirectivity(angles, [1e3], np.cos(np.radians(angles))[:, None])
    assert not table.is_complex
    gain = table.gain(np.cos(FINE), 1e3, SPEED)
    assert gain.dtype == np.float64
    np.testing.assert_allclose(gain, np.cos(FINE), atol=1e-5)  # (10 degrees)^4 / 384 = 2.4e-6, twice that at the ends


def test_shapes_broadcast():
    table = table_of(10.0, [30e3, 40e3])
    assert table.gain(1.0, 35e3, SPEED).shape == ()
    assert table.gain(np.ones((3, 4)), 35e3, SPEED).shape == (3, 4)
    assert table.gain(np.ones((3, 4, 1)), np.array([31e3, 35e3]), SPEED).shape == (3, 4, 2)
    both = table.gain(np.cos(FINE), np.linspace(30e3, 40e3, 1025), SPEED)
    assert both.shape == (1025,)
    assert both[512] == pytest.approx(table.gain(np.cos(FINE[512]), 35e3, SPEED), rel=1e-12)
    assert np.isnan(table.gain(np.nan, 35e3, SPEED))
    assert isinstance(table, clsim.AxisymmetricDirectivity)


GOOD = {"angles_degrees": [0, 90, 180], "frequencies": [1e3, 2e3], "values": np.ones((3, 2))}


@pytest.mark.parametrize(
    ("change", "field", "message"),
    [
        ({"frequencies": [2e3, 1e3]}, "frequencies", "increase strictly"),
        ({"frequencies": [1e3, 1e3]}, "frequencies", "increase strictly"),
        ({"frequencies": [-1.0, 1e3]}, "frequencies[0]", "at least 0 Hz, but is -1 Hz"),
        ({"frequencies": []}, "frequencies", "empty"),
        ({"frequencies": [1e3, np.nan]}, "frequencies[1]", "finite"),
        ({"frequencies": "all"}, "frequencies", "numbers"),
        ({"angles_degrees": [0, 90, 90]}, "angles_degrees", "[2] = 90° follows [1] = 90°"),
        ({"angles_degrees": [180, 90, 0]}, "angles_degrees", "increase strictly"),
        ({"angles_degrees": [10, 90, 180]}, "angles_degrees", "begin on the axis"),
        ({"angles_degrees": [0, 30, 90]}, "angles_degrees", "must reach 180°, but end at 90°"),
        ({"angles_degrees": [0, 180, 360]}, "angles_degrees", "from -180° to 180°"),
        ({"angles_degrees": [-90, 0, 30]}, "angles_degrees", "same on both sides"),
        ({"angles_degrees": [-90, -60, -30]}, "angles_degrees", "same on both sides"),
        ({"angles_degrees": [0, 30, 60], "rear": "mirror"}, "rear", "ends at 60°"),
        ({"angles_degrees": [0], "values": [[1, 1]], "rear": "hold"}, "angles_degrees", "go on"),
        ({"values": np.ones((2, 3))}, "values", "3 x 2, but are 2 x 3; transpose"),
        ({"values": np.ones((4, 2))}, "values", "3 x 2, but are 4 x 2"),
        ({"values": np.ones(3)}, "values", "shape"),
        ({"values": [[1, np.nan], [1, 1], [1, 1]]}, "values[0][1]", "finite"),
        ({"values": [[1, 1j * np.inf], [1, 1], [1, 1]]}, "values[0][1]", "finite"),
        ({"values": [[-np.inf, 0], [0, 0], [0, 0]], "scale": "db"}, "values[0][0]", "finite"),
        ({"values": [[500.0, 0], [0, 0], [0, 0]], "scale": "db"}, "values[0][0]", "from -300 to 300 dB, but is 500 dB"),
        ({"values": 1e20 * np.ones((3, 2))}, "values[0][0]", "at most 1e+15"),
        ({"values": np.zeros((3, 2))}, "values", "not all be 0"),
        ({"values": 1j * np.ones((3, 2)), "scale": "db"}, "values", "must be real"),
        ({"values": [["a", "b"]] * 3}, "values", "numbers"),
        ({"scale": "dB"}, "scale", '"linear", "db"'),
        ({"rear": "fold"}, "rear", '"hold", "mirror", "zero"'),
        ({"side": "left"}, "side", '"positive"'),
        ({"outside": "zero"}, "outside", '"hold"'),
        ({"relative_to_axis": "no"}, "relative_to_axis", "true or false"),
        ({"name": 3}, "name", "a text"),
    ],
)
def test_bad_values_are_refused_by_name(change, field, message):
    with pytest.raises(clsim.InputError) as error:
        AxialDirectivity(**(GOOD | change))
    assert error.value.field == field
    assert message in error.value.problem


def test_phases_must_have_the_shape_of_levels():
    with pytest.raises(clsim.InputError) as error:
        AxialDirectivity.from_db([0, 180], [1e3], [[0.0], [-3.0]], [[0.0]])
    assert error.value.field == "phases_degrees"


def test_no_phase_at_0_hz() -> None:
    """Held below its lowest frequency, a table becomes real towards 0 Hz; above half of it nothing changes."""
    table = AxialDirectivity([0.0, 180.0], [1e3, 2e3], [[1j, 1j], [0.5j + 0.5, 0.5j + 0.5]], outside="hold")
    gain = table.gain(1.0, np.array([1e3, 600.0, 500.0]), 343.0)
    turn = np.exp(-2j * np.pi * np.array([1e3, 600.0, 500.0]) * table.delay.sum())
    np.testing.assert_allclose(gain / turn, gain[0] / turn[0], atol=1e-12)
    assert abs(table.gain(1.0, 1e-3, 343.0).imag) < 1e-5
    halfway = table.gain(1.0, 250.0, 343.0) * np.exp(2j * np.pi * 250.0 * table.delay.sum())
    assert halfway.imag == pytest.approx(0.5 * (gain[0] / turn[0]).imag)
