"""Images of a shoebox against mirroring point after point, and the path table that is made from them."""

from collections.abc import Callable

import numpy as np
import oracle
import pytest

import clsim
from clsim.paths.find_paths import shoebox_image_count, shoebox_images

SIZE = np.array([5.0, 4.0, 3.0])
WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
FACTORS = np.array([0.9, -0.8, 0.7, 0.6, -0.5, 0.4])
AIR = clsim.Air(speed_of_sound=343.0)


@pytest.mark.parametrize("order", range(31))
def test_image_count(order: int) -> None:
    # Whole-numbered points with |i| + |j| + |k| <= N, counted by layers of k; each layer is a square on its corner.
    counted = sum(1 + 2 * m * (m + 1) for m in (order - abs(k) for k in range(-order, order + 1)))
    assert shoebox_image_count(order) == counted
    if order % 5 == 0:
        found = shoebox_images(SIZE, order)
        assert len(found.order) == counted
        point = found.matrix @ np.array([1.1, 2.3, 0.7]) + found.offset
        assert len(np.unique(point.round(6), axis=0)) == counted  # each at a place of its own


def test_images_are_where_mirroring_puts_them() -> None:
    order, point = 5, np.array([1.1, 2.3, 0.7])
    found = shoebox_images(SIZE, order)
    made = {tuple(p.round(9)): n for p, n in zip(found.matrix @ point + found.offset, found.order, strict=True)}
    wanted = {}
    for walls in oracle.mirror_sequences(order):
        image = point
        for wall in walls:
            image = oracle.mirror(image, wall, SIZE)
        wanted[tuple(image.round(9))] = len(walls)
    assert made == wanted


def test_listed_walls_make_the_image() -> None:
    found, point = shoebox_images(SIZE, 6), np.array([1.1, 2.3, 0.7])
    for walls, matrix, offset, order in zip(found.walls, found.matrix, found.offset, found.order, strict=True):
        listed = walls[walls >= 0]
        assert len(listed) == order
        assert np.all(walls[order:] == -1)
        image = point
        for wall in listed:
            image = oracle.mirror(image, int(wall), SIZE)
        np.testing.assert_allclose(matrix @ point + offset, image, atol=1e-12)


def mirrored(way: oracle.Wobble, walls: tuple[int, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a way mirrored at one wall after the other."""

    def image(t: np.ndarray) -> np.ndarray:
        x = way.position(t)
        for wall in walls:
            x = oracle.mirror(x, wall, SIZE)
        return x

    return image


def arriving(image: Callable[[np.ndarray], np.ndarray], receiver: oracle.Wobble) -> Callable[[np.ndarray], np.ndarray]:
    """Return the delay by time of reception, s, by fixed-point iteration."""

    def delay(t: np.ndarray) -> np.ndarray:
        out = np.zeros(len(t))
        for _ in range(20):
            out = np.linalg.norm(receiver.position(t) - image(t - out), axis=1) / AIR.speed_of_sound
        return out

    return delay


def test_path_table_of_a_moving_scene(rng) -> None:
    order, c = 3, AIR.speed_of_sound
    source, receiver = (oracle.Wobble.random(rng, x, 8.0) for x in ([1.6, 2.0, 1.5], [3.6, 2.0, 1.5]))
    room = clsim.Shoebox(SIZE, {w: clsim.Material.from_reflection(f) for w, f in zip(WALLS, FACTORS, strict=True)})
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", clsim.Signal.tone(40e3, 0.3, 192e3), source.trajectory(0.4))],
        [clsim.Receiver("r", receiver.trajectory(0.4))],
    )  # fmt: skip
    times = np.array([0.1, 0.2, 0.3])
    table = clsim.find_paths(scene, order).table(times)
    by_place = {tuple(d.round(9)): i for i, d in enumerate(table.delay)}
    decibel = AIR.absorption_at(40e3)
    h = 1e-5
    for walls in oracle.mirror_sequences(order):
        image = mirrored(source, walls)
        delay = arriving(image, receiver)
        exact = delay(times)
        i = by_place[tuple(exact.round(9))]
        assert table.order[i] == len(walls)
        np.testing.assert_allclose(table.delay[i], exact, rtol=1e-13)
        # Central differences: h^2 delay''' / 6 is below 1e-9, rounding 1e-17 / h = 1e-12.
        rate = (delay(times + h) - delay(times - h)) / (2 * h)
        np.testing.assert_allclose(table.doppler_factor[i], 1 - rate, rtol=1e-8)
        towards = image(times - exact) - receiver.position(times)
        np.testing.assert_allclose(table.arrival[i], towards / (c * exact)[:, None], atol=1e-12)
        approach = np.sum((image(times - exact + h) - image(times - exact - h)) / (2 * h) * -towards, axis=1)
        mach = approach / (c * exact * c)
        gain = np.prod(FACTORS[list(walls)]) * 10 ** (-decibel * (c * exact - 1) / 20) / (c * exact * (1 - mach))
        np.testing.assert_allclose(table.gain[i], gain, rtol=1e-8)
        # The way back to the source: mirrored once per wall.
        back = table.arrival[i].copy()
        for wall in walls:
            back[:, wall // 2] *= -1.0
        np.testing.assert_allclose(table.departure[i], -back, atol=1e-12)
