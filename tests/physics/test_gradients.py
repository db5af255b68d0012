"""Derivatives of losses against the Jacobian, of which they are the transpose; channels and envelopes."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exhaustive import exhaustive, few
from moved_scenes import (
    CASES,
    EXACT,
    EYE,
    FIXED,
    HARD,
    KNOTS,
    LINE,
    LOW,
    PULSE,
    RATE,
    RECEIVER,
    SOURCE,
    C,
    shoebox,
    turning,
    vector,
    walk,
)
from scenes import DATA

import clsim
from clsim.paths.path_set import PathSet
from clsim.render.options import RenderOptions
from clsim.sensitivity.linear_map import plan_of, received

ALL = [
    "sources[0].position", "sources[0].trajectory", "receivers[1].position", "receivers[0].electronics.clock_ppm",
    "air.temperature_celsius", "room.walls.z_min.reflection", "sources[0].gain_db",
]  # fmt: skip


@pytest.mark.parametrize("points", [4, 11])
def test_the_transpose(points: int, engine: str, rng: np.random.Generator) -> None:
    """``<J d, w> = <d, J' w>`` within 1e-6 of the lengths, for weights near ``J d``: nothing cancels.

    Of the device 5e-6: within subblocks a render leaves out powers of gains that the transpose does not. Eleven points
    are 10 ms apart: with moments over 3072 samples they were once wrong by several percent.
    """
    paths, options = walk(points=points), {"engine": engine, "duration": 0.024}
    jacobian = clsim.sensitivities(paths, ALL, RATE, **options).jacobian
    scale = rng.standard_normal(len(jacobian)) / np.linalg.norm(jacobian, axis=(1, 2))
    ahead = np.tensordot(scale, jacobian, 1)
    weights = ahead + rng.standard_normal(ahead.shape) * np.std(ahead)
    found = clsim.gradient(paths, weights, ALL, RATE, engine=engine)
    back = scale @ np.concatenate([np.ravel(found[name]) for name in ALL])
    lengths = np.linalg.norm(ahead) * np.linalg.norm(weights)
    assert abs(back - np.sum(ahead * weights)) <= (1e-6 if engine == "reference" else 5e-6) * lengths
    assert found["sources[0].trajectory"].shape == (points, 3)


@pytest.mark.parametrize("dispersion", [exhaustive(False), True])
def test_the_transpose_of_each_kind(dispersion: bool, rng: np.random.Generator) -> None:
    """Parameters of every kind, in a scene whose responses depend on directions and on time."""
    names = [
        "sources[0].trajectory", "sources[0].orientation", "sources[0].start", "receivers[0].position",
        "receivers[0].trajectory", "receivers[0].orientation", "receivers[0].electronics.clock_ppm",
        "receivers[0].electronics.clock_offset", "receivers[0].electronics.gain_db", "air.temperature_celsius",
        "air.relative_humidity", "room.walls.x_max.reflection", "room.walls.x_min.reflection",
        "room.walls.x_max.displacement", "room.walls.z_min.displacement",
    ]  # fmt: skip
    paths = turning(clsim.Air(dispersion=dispersion))
    jacobian = clsim.sensitivities(paths, names, RATE, engine="reference", duration=0.024).jacobian
    weights = jacobian / np.linalg.norm(jacobian, axis=(1, 2), keepdims=True)
    weights = np.tensordot(rng.standard_normal(len(jacobian)), weights, 1)
    found = clsim.gradient(paths, weights, names, RATE, engine="reference")
    back = np.concatenate([np.ravel(found[name]) for name in names])
    lengths = np.linalg.norm(jacobian, axis=(1, 2)) * np.linalg.norm(weights)
    np.testing.assert_allclose(back / lengths, np.tensordot(jacobian, weights, 2) / lengths, rtol=0, atol=1e-6)


def test_paths_that_begin_and_end(engine: str, rng: np.random.Generator) -> None:
    """Transitions weigh arrivals as they do in a render."""
    paths = walk()
    family = paths.families[0]
    start, end = np.array(family.start), np.array(family.end)
    start[::3], end[1::3] = 0.0121, 0.0133
    cut = PathSet(paths.scene, (replace(family, start=start, end=end),))
    jacobian = clsim.sensitivities(cut, ALL, RATE, engine=engine, duration=0.024).jacobian
    weights = jacobian[0] + rng.standard_normal(jacobian.shape[1:]) * np.std(jacobian[0])
    found = clsim.gradient(cut, weights, ["sources[0].position"], RATE, engine=engine)["sources[0].position"]
    np.testing.assert_allclose(found[0], np.sum(jacobian[0] * weights), rtol=2e-6)


def test_both_engines_agree() -> None:
    """The device's derivative is within -80 dB of the reference's: both hold their filters within -86 dB."""
    fast, exact = (
        clsim.sensitivities(walk(), ALL[:2], RATE, engine=e, duration=0.024).jacobian for e in ("opencl", "reference")
    )
    wrong, length = (np.linalg.norm(x, axis=(1, 2)) for x in (fast - exact, exact))
    np.testing.assert_array_less(wrong, 1e-4 * length)


def test_by_the_emitted_signal(rng: np.random.Generator) -> None:
    """The render is linear in what is emitted: its derivative times the signal is the weighted recording."""
    paths = walk()
    y = received(plan_of(paths, RenderOptions(RATE, **EXACT)))
    weights = y + rng.standard_normal(y.shape) * np.std(y)
    exact = {name: value for name, value in EXACT.items() if name != "duration"}
    found = clsim.gradient(paths, weights, ["sources[0].signal"], RATE, **exact)["sources[0].signal"]
    assert found.shape == (PULSE.count,)
    assert found @ PULSE.read(0, PULSE.count) == pytest.approx(np.sum(weights * y), rel=1e-5)


HEARD = "receivers[0]"


def several(kind: str, h: float = 0.0, what: str = "") -> PathSet:
    """Return paths to a receiver of several channels that moves, of which one thing is displaced by h."""
    half = 0.5 * np.radians(30.0 + h * (what == "orientation.z"))
    turning = FIXED((0, 0, 0), (0.0, 0.0, np.sin(half), np.cos(half))).turning
    places = np.array([[3.1, 2.3, 1.4], [3.0, 2.2, 1.5]]) + h * (what == "position.x") * EYE[0]
    way = replace(LINE(*places, 0.1), turning=turning)
    knots = KNOTS + h * (what == "trajectory.positions[1].y") * np.outer(np.arange(4) == 1, EYE[1])
    ends = {
        "ambisonic": lambda: [clsim.Receiver.ambisonic("r", way)],
        "head": lambda: [clsim.Receiver("r", way, directivity=clsim.SphericalHead(0.0875))],
        "array": lambda: clsim.receiver_array("r", [[0.0, 0.03, 0.0], [h * (what == "element"), -0.03, 0.0]], way),
    }[kind]()
    source = clsim.Source("s", LOW, clsim.Trajectory.waypoints(np.linspace(0.0, 0.1, 4), knots))
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.7))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=C, absorption=False), [source], ends), 1)


@pytest.mark.parametrize(
    ("what", "h", "kind"),
    few(
        [
            (*each, kind)
            for each in [("position.x", 5e-5), ("orientation.z", 0.02), ("trajectory.positions[1].y", 5e-5)]
            for kind in ["ambisonic", "head"]
        ],
        (2, 4),
    ),
)
def test_receivers_of_several_channels(what: str, h: float, kind: str) -> None:
    """Channels change with the direction of arrival, ears with the time of arrival as well.

    Those of ears, which renders filter, are right to the first order in the rates of change: 1.3e-3 at 8 m/s, where 4.3e-3 was wrong by emitted frequencies.
    """
    name, options = f"{'sources[0]' if 'traj' in what else HEARD}.{what}", EXACT | {"response_error_db": -110.0}
    found = clsim.sensitivities(several(kind), [vector(name)], 24e3, **options)
    derivative = found.jacobian[found.parameters.index(name)]
    ahead, behind = (received(plan_of(several(kind, x, what), RenderOptions(24e3, **options), False)) for x in (h, -h))
    assert len(derivative) == len(found.receivers) == (4 if kind == "ambisonic" else 2)
    allowed = 2e-3 if kind == "head" else 5e-5
    assert np.linalg.norm((ahead - behind) / (2.0 * h) - derivative) <= allowed * np.linalg.norm(derivative)
    weights = derivative + np.std(derivative)
    back = clsim.gradient(
        several(kind), weights, [vector(name)], 24e3, **{k: v for k, v in options.items() if k != "duration"}
    )
    lengths = np.linalg.norm(weights) * np.linalg.norm(derivative)
    there = np.ravel(back[vector(name)])[found.parameters.index(name)]
    assert abs(there - np.sum(weights * derivative)) <= 1e-6 * lengths


def test_measured_heads() -> None:
    """A head that turns, at the default errors: differences hold 3e-5, the transpose 1e-6."""
    file = DATA / "hrtf" / "MIT_KEMAR_normal_pinna.sofa"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    pytest.importorskip("sofar")
    whole, name, options = clsim.HeadRelated.from_sofa(file), "receivers[0].orientation", {"engine": "reference"}
    head = clsim.HeadRelated(whole.directions[::4], whole.responses[::4], whole.sampling_rate)

    def turned(h: float) -> PathSet:
        half = 0.5 * np.radians(30.0 + h)
        way = FIXED((3.1, 2.3, 1.4), (0.0, 0.0, np.sin(half), np.cos(half)))
        ends = [clsim.Source("s", LOW, SOURCE)], [clsim.Receiver("r", way, directivity=head)]
        return clsim.find_paths(clsim.Scene(clsim.Shoebox((4.0, 3.0, 2.5), HARD), clsim.Air(), *ends), 0)

    derivative = clsim.sensitivities(turned(0.0), [name], 24e3, duration=0.016, **options).jacobian[2]
    sounds = (received(plan_of(turned(h), RenderOptions(24e3, duration=0.016, **options))) for h in (0.01, -0.01))
    ahead, behind = sounds
    assert np.linalg.norm((ahead - behind) / 0.02 - derivative) <= 3e-5 * np.linalg.norm(derivative)
    back = clsim.gradient(turned(0.0), derivative, [name], 24e3, **options)[name][2]
    assert back == pytest.approx(np.sum(derivative**2), rel=1e-6)


def test_elements_of_arrays() -> None:
    """Each is a receiver: its place in the array's frame, which is turned by 30 degrees, is one in the room."""
    found = clsim.sensitivities(several("array"), ["receivers[1].position"], 24e3, **EXACT).jacobian
    derivative = np.tensordot([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0], found, 1)
    ahead, behind = (
        received(plan_of(several("array", x, "element"), RenderOptions(24e3, **EXACT))) for x in (5e-5, -5e-5)
    )
    assert np.linalg.norm((ahead - behind) / 1e-4 - derivative) <= 5e-5 * np.linalg.norm(derivative)


def test_channels_on_a_device() -> None:
    """The device's derivative and its transpose, of channels, too."""
    names = ["receivers[0].position", "sources[0].gain_db"]
    fast, exact = (
        clsim.sensitivities(several("ambisonic"), names, 24e3, engine=e, duration=0.024).jacobian
        for e in ("opencl", "reference")
    )
    wrong, length = (np.linalg.norm(x, axis=(1, 2)) for x in (fast - exact, exact))
    np.testing.assert_array_less(wrong, 3e-4 * length)  # -80 dB, and 10 dB that tangents are given
    found = clsim.gradient(several("ambisonic"), fast[0], names, 24e3)
    back = np.concatenate([np.ravel(found[name]) for name in names])
    np.testing.assert_allclose(back / length, np.tensordot(fast, fast[0], 2) / length, atol=5e-6 * length[0])


SLOW = KNOTS[0] + 0.1 * (KNOTS - KNOTS[0])
BAND: dict[str, Any] = {
    "baseband": (20e3, 8e3, 12e3), "duration": 0.024, "response_error_db": -100.0,
    "interpolator": clsim.Bandlimited(error_db=-100.0),
}  # fmt: skip
BEACONS: dict[str, tuple[Callable[[float], PathSet], str, float]] = {
    name: CASES[name] for name in ("static receiver", "clock rate", "temperature", "wind", "wall")
} | {
    "trajectory": (
        lambda h: shoebox(source=clsim.Trajectory.waypoints(
            np.linspace(0.0, 0.1, 4), SLOW + h * np.outer(np.arange(4) == 1, EYE[1]))),
        "sources[0].trajectory.positions[1].y", 8e-5,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", few(BEACONS, (1, 3, 5)))
def test_complex_envelopes(case: str) -> None:
    """Derivatives of baseband against differences, and their transpose by real and imaginary parts."""
    made, name, step = BEACONS[case]
    options = BAND | {"engine": "reference"}
    found = clsim.sensitivities(made(0.0), [vector(name)], RATE, **options)
    derivative, wrong = found.jacobian[found.parameters.index(name)], []
    for h in (0.5 * step, 0.25 * step):
        ahead, behind = (received(plan_of(made(x), RenderOptions(RATE, **options))) for x in (h, -h))
        wrong.append(np.linalg.norm((ahead - behind) / (2.0 * h) - derivative) / np.linalg.norm(derivative))
    assert np.iscomplexobj(derivative)
    assert wrong[1] <= 0.3 * wrong[0] + 1e-5, wrong
    assert wrong[1] <= 3e-5, wrong
    weights = derivative * np.exp(0.3j) + 0.1 * np.std(derivative)
    back = clsim.gradient(
        made(0.0), weights, [vector(name)], RATE, **{k: v for k, v in options.items() if k != "duration"}
    )
    there = np.ravel(back[vector(name)])[found.parameters.index(name)]
    assert there == pytest.approx(np.sum(np.conj(weights) * derivative).real, rel=1e-6)


def test_information_of_envelopes() -> None:
    """Noise is that of the real and of the imaginary part: a gain's bound is that over the length of its derivative."""
    paths, name = BEACONS["static receiver"][0](0.0), ["sources[0].gain_db"]
    found = clsim.sensitivities(paths, name, RATE, **BAND | {"engine": "reference"})
    assert found.bounds(0.1)[0] == pytest.approx(0.1 / np.linalg.norm(found.jacobian))
    fast = clsim.sensitivities(paths, name, RATE, **BAND).jacobian
    assert np.linalg.norm(fast - found.jacobian) <= 1e-4 * np.linalg.norm(fast)
    with pytest.raises(clsim.InputError, match=r"must not have 'sources\[0\]\.signal' in baseband"):
        clsim.gradient(paths, found.jacobian[0], ["sources[0].signal"], RATE, baseband=BAND["baseband"])


def test_tails_are_left_out_with_a_note() -> None:
    """With a tail the derivative is that of the paths, over the recording with its tail."""
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    ends = [clsim.Source("s", LOW, SOURCE)], [clsim.Receiver("r", RECEIVER)]
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), *ends), 1)
    options: dict[str, Any] = {"engine": "reference", "duration": 0.05}
    without, beside = (
        clsim.sensitivities(paths, ["receivers[0].position"], 24e3, tail=tail, **options) for tail in ("off", "auto")
    )
    assert (without.notes, len(beside.notes)) == ((), 1)
    assert "tail is left out" in beside.notes[0]
    np.testing.assert_array_equal(without.jacobian, beside.jacobian)
    by = (clsim.gradient(paths, beside.jacobian[0], ["receivers[0].position"], 24e3, tail=t) for t in ("off", "auto"))
    np.testing.assert_array_equal(*(found["receivers[0].position"] for found in by))
