"""Streams heard on the move: both engines against tones whose values are known between samples."""

import numpy as np

from clsim.render.diffuse_tail import DeviceWaves
from clsim.tail.streams import NODE, Between, HostWaves, Motion

RATE, C, START, STOP = 48e3, 343.0, 1000, 5000


def error_db(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(10.0 * np.log10(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


def test_moving_listeners_hear_tones_where_they_are(device: None) -> None:
    """Up to 20 kHz at 48 kHz, whole delays that change every few samples too; filters promise -70 dB."""
    rng, first = np.random.default_rng(1), -500
    turn, phase = 2.0 * np.pi * rng.uniform(500.0, 20e3, 5) / RATE, rng.uniform(0.0, 6.0, 5)
    streams = np.cos(turn[:, None] * np.arange(first, 7000) + phase[:, None]).astype(np.float32)
    grid = np.arange(START // NODE, -(-STOP // NODE) + 1) * NODE
    speed, offset = np.array([[0.2], [30.0]])[:, None] * rng.uniform(-1.0, 1.0, 5) / C, rng.uniform(-300.0, 300.0, 5)
    motion = Motion(speed * grid[:, None] + offset, np.broadcast_to(1.0 - grid[:, None] / 1e4, (2, len(grid), 5)))
    samples = np.arange(START, STOP)
    ahead = speed * samples[:, None] + offset
    wanted = np.sum(np.cos(turn * (samples[:, None] + ahead) + phase), axis=2) * (1.0 - samples / 1e4)
    between = Between.up_to(20e3, RATE, 30.0 / C)
    host, there = HostWaves(between), DeviceWaves(between, None)
    heard = [waves.received(streams, first, motion, START, STOP) for waves in (host, there)]
    for found in heard:
        assert error_db(found, wanted) < -65.0
    assert error_db(*heard) < -65.0
    later = START // NODE + 7
    part = Motion(motion.ahead[:, 7:], motion.gains[:, 7:])
    for waves, found in zip((host, there), heard, strict=True):
        again = waves.received(streams[:, 300:], first + 300, part, later * NODE + 5, STOP)
        np.testing.assert_array_equal(again, found[:, later * NODE + 5 - START :])
