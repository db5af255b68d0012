import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clsim.errors import InputError
from clsim.numerics.quaternions import normalised, quaternion_from_direction, rotate, same_hemisphere

ROUNDING = 1e-14  # some tens of float64 roundings on values of order 1


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)


def test_rotate_is_scipys_rotation(rng):
    quaternions = normalised(rng.standard_normal((50, 4)))
    vectors = rng.standard_normal((50, 3))
    np.testing.assert_allclose(
        rotate(quaternions, vectors), Rotation.from_quat(quaternions).apply(vectors), atol=10 * ROUNDING
    )


def test_rotate_broadcasts_and_keeps_length(rng):
    quaternions = normalised(rng.standard_normal((5, 1, 4)))
    vectors = rng.standard_normal((7, 3))
    turned = rotate(quaternions, vectors)
    assert turned.shape == (5, 7, 3)
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=-1), np.broadcast_to(np.linalg.norm(vectors, axis=-1), (5, 7)), rtol=ROUNDING
    )
    np.testing.assert_allclose(rotate(-quaternions, vectors), turned, atol=ROUNDING)


def test_identity_turns_nothing(rng):
    vectors = rng.standard_normal((4, 3))
    np.testing.assert_array_equal(rotate([0.0, 0.0, 0.0, 1.0], vectors), vectors)


def test_direction_is_met_without_roll(rng):
    directions = rng.standard_normal((50, 3)) * 10.0 ** rng.uniform(-3, 3, (50, 1))
    quaternions = quaternion_from_direction(directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(rotate(quaternions, [1.0, 0.0, 0.0]), unit, atol=ROUNDING)
    np.testing.assert_allclose(rotate(quaternions, [0.0, 1.0, 0.0])[:, 2], 0.0, atol=ROUNDING)  # level: no roll
    assert np.all(rotate(quaternions, [0.0, 0.0, 1.0])[:, 2] > 0.0)  # up stays up


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (-1, 0, 0), (-1, -0.0, 0), (-0.0, -0.0, -1), (1, 0, 0)])
def test_axes_are_met(direction):
    turned = rotate(quaternion_from_direction(direction), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, direction, atol=ROUNDING)


def test_straight_up_has_the_azimuth_zero():
    for sign in (0.0, -0.0):
        left = rotate(quaternion_from_direction((sign, sign, 1.0)), [0.0, 1.0, 0.0])
        np.testing.assert_allclose(left, [0.0, 1.0, 0.0], atol=ROUNDING)


@pytest.mark.parametrize("direction", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 0)])
def test_no_direction_is_refused(direction):
    with pytest.raises(InputError) as error:
        quaternion_from_direction(direction)
    assert error.value.field == "direction"


def test_normalised(rng):
    quaternions = rng.standard_normal((6, 4))
    unit = normalised(quaternions)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(unit * np.linalg.norm(quaternions, axis=1)[:, None], quaternions, rtol=ROUNDING)
    for bad in ([0, 0, 0, 0], [np.nan, 0, 0, 1]):
        with pytest.raises(InputError):
            normalised(bad)


def test_signs_follow_the_neighbour(rng):
    angle = np.linspace(0.0, 6.0 * np.pi, 200)  # three whole turns: the quaternion itself turns one and a half
    smooth = np.stack([np.zeros_like(angle), np.zeros_like(angle), np.sin(angle / 2), np.cos(angle / 2)], axis=1)
    flipped = smooth * rng.choice([-1.0, 1.0], 200)[:, None]
    flipped[0] = smooth[0]
    np.testing.assert_array_equal(same_hemisphere(flipped), smooth)
    assert not np.array_equal(flipped, smooth)


def test_signs_of_few():
    assert same_hemisphere(np.empty((0, 4))).shape == (0, 4)
    np.testing.assert_array_equal(same_hemisphere([[0, 0, 0, -1.0]]), [[0, 0, 0, -1.0]])
