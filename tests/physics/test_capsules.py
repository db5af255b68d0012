"""Capsules: specular points against searches, fields against Kirchhoff's integral over the surface and exact series."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import h2vp, jvp

import clsim
from clsim.acoustics.capsule import capsule_aspects, capsule_field, capsule_specular_point
from clsim.acoustics.scattering import ellipsoid_specular_point, ellipsoid_strength
from clsim.paths.response import SceneResponse

C = 343.0
K = 2.0 * np.pi * 40e3 / C


def strengths(
    radius: float, length: float, source: np.ndarray, receiver: np.ndarray, wave: float = K, weight: float = 1.0
) -> np.ndarray:
    """Return the scattered field (n,) between ends (n, 3), m, relative to the phase of the shortest path."""
    ends = source.T, receiver.T
    glint = capsule_specular_point(radius, length, *ends, None, weight)
    for _ in range(3):
        glint = capsule_specular_point(radius, length, *ends, glint, weight)
    assert glint.change < 1e-6
    strength, aspects = capsule_aspects(radius, length, *ends, glint)
    return strength * capsule_field(np.array([wave]), aspects)[:, 0]


def ends_at(angle: np.ndarray, apart: float, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ends (n, 3) at angles (n,) from broadside, the receiver off the plane of the other and the axis."""
    source = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    other, aside = angle - apart, 0.5 * apart
    receiver = np.stack([np.cos(other) * np.cos(aside), np.cos(other) * np.sin(aside), np.sin(other)], axis=1)
    return distance * source, 1.3 * distance * receiver


def over_the_surface(radius: float, length: float, source: np.ndarray, receiver: np.ndarray, wave: float) -> complex:
    """Return Kirchhoff's integral over the whole surface, with the penumbra that bodies have, by the midpoint rule."""

    def part(places: np.ndarray, normals: np.ndarray, area: np.ndarray) -> complex:
        legs = [end - places for end in (source, receiver)]
        d = [np.linalg.norm(leg, axis=-1) for leg in legs]
        cosine = sum(0.5 * np.sum(leg * normals, axis=-1) / r for leg, r in zip(legs, d, strict=True))
        lit = np.where(cosine > 0.0, -cosine * np.expm1(-((np.maximum(cosine, 0.0) / 0.25) ** 3)), 0.0)
        return complex(
            np.sum(1j * wave / (2 * np.pi) * lit * np.exp(-1j * wave * (d[0] + d[1])) / (d[0] * d[1]) * area)
        )

    round_about = np.linspace(0.0, 2.0 * np.pi, 241)[:-1]
    count = int(1.3 * wave * length) + 20
    z = ((np.arange(count) + 0.5) / count - 0.5) * length
    normals = np.stack([np.cos(round_about), np.sin(round_about), 0.0 * round_about], axis=1)
    places = np.concatenate([radius * normals[None] + [[[0.0, 0.0, x]]] for x in z])
    step = 2.0 * np.pi / len(round_about)
    total = part(
        places, np.broadcast_to(normals, places.shape), np.full(places.shape[:2], radius * step * length / count)
    )
    some = max(60, int(4.0 * wave * radius))
    up = (np.arange(some) + 0.5) / some * np.pi / 2.0
    for side in (1.0, -1.0):
        n = np.stack(np.broadcast_arrays(
            np.cos(up)[:, None] * np.cos(round_about), np.cos(up)[:, None] * np.sin(round_about), side * np.sin(up)[:, None]
        ), axis=-1)  # fmt: skip
        area = radius**2 * np.cos(up)[:, None] * np.pi / 2.0 / some * step * np.ones(len(round_about))
        total += part(radius * n + [0.0, 0.0, 0.5 * side * length], n, area)
    return total


def test_specular_points_are_those_of_the_shortest_way(rng: np.random.Generator) -> None:
    for _ in range(8):
        radius, length = rng.uniform(0.01, 0.1), rng.uniform(0.01, 0.6)
        ends = rng.normal(size=(2, 3))
        ends *= (rng.uniform(0.5 * length + radius + 0.05, 4.0, 2) / np.linalg.norm(ends, axis=1))[:, None]
        glint = capsule_specular_point(radius, length, *ends[:, :, None], None, 1.0)
        for _ in range(3):
            glint = capsule_specular_point(radius, length, *ends[:, :, None], glint, 1.0)

        def way(y: np.ndarray, radius: float = radius, length: float = length, ends: np.ndarray = ends) -> float:
            n = y[1:] / np.linalg.norm(y[1:])
            place = radius * n + np.array([0.0, 0.0, np.clip(y[0], -0.5 * length, 0.5 * length)])
            return float(sum(np.linalg.norm(place - end) for end in ends))

        starts = [np.concatenate([[z], v]) for z in (-0.4 * length, 0.4 * length) for v in (*ends, ends.sum(axis=0))]
        found = min(
            minimize(way, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13}).fun for start in starts
        )
        if glint.hidden[0]:
            assert found == pytest.approx(float(np.linalg.norm(ends[1] - ends[0])), abs=1e-4)
            continue
        place = glint.place[:, 0]
        assert sum(np.linalg.norm(place - end) for end in ends) <= found + 1e-10
        beyond = max(abs(place[2]) - 0.5 * length, 0.0)
        assert np.linalg.norm([*place[:2], beyond]) == pytest.approx(radius, rel=1e-12)


@pytest.mark.parametrize(
    ("radius", "length", "distance", "apart", "error"),
    [
        (0.04, 0.4, 1.5, 0.0, -37.0), (0.04, 0.4, 0.6, 0.6, -35.0), (0.02, 0.1, 0.5, 0.6, -27.0),
        (0.01, 0.1, 0.5, 0.0, -27.0),
    ],
)  # fmt: skip
def test_fields_are_those_of_the_integral_over_the_surface(radius, length, distance, apart, error) -> None:
    """From broadside, where a finite line shines 18 dB above its ends, to the tips; about ``1 / (k R)`` is left."""
    angle = np.radians(np.linspace(-90.0, 90.0, 13))
    source, receiver = ends_at(angle, apart, distance)
    exact = np.array([over_the_surface(radius, length, s, r, K) for s, r in zip(source, receiver, strict=True)])
    glint = capsule_specular_point(radius, length, source.T, receiver.T, None, 1.0)
    d = [np.linalg.norm(glint.place - end.T, axis=0) for end in (source, receiver)]
    got = strengths(radius, length, source, receiver) * np.exp(-1j * K * (d[0] + d[1])) / (d[0] * d[1])
    seen = ~glint.hidden
    assert np.abs(exact).max() > 2.0 * np.median(np.abs(exact))
    assert 20.0 * np.log10(np.linalg.norm((got - exact)[seen]) / np.linalg.norm(exact[seen])) < error


def test_nothing_jumps_where_side_and_ends_meet() -> None:
    """Along the whole turn half the step gives half the largest change, also towards both tips and in motion."""
    for apart, weight in ((0.0, 1.0), (0.7, 1.0), (0.7, 1.02)):
        changes = []
        for count in (8001, 16001):
            ends = ends_at(np.linspace(-1.6, 1.6, count), apart, 1.0)
            found = strengths(0.03, 0.3, *ends, weight=weight)
            changes.append(np.abs(np.diff(found)).max())
        assert changes[0] / changes[1] == pytest.approx(2.0, rel=0.05)
        assert changes[1] < 5e-3 * np.abs(found).max()


def test_broadside_is_the_exact_series_of_a_cylinder() -> None:
    """Far off a long one: ``L / pi |sum e_m (-1)^m J_m'(k R) / H_m'(k R)|`` of a rigid cylinder, within 1 %."""
    radius, length, m = 0.04, 4.0, np.arange(60)
    far = np.array([[1e5, 0.0, 0.0]])
    series = np.sum(np.where(m > 0, 2.0, 1.0) * (-1.0) ** m * jvp(m, K * radius) / h2vp(m, K * radius))
    assert abs(strengths(radius, length, far, far)[0]) == pytest.approx(length / np.pi * abs(series), rel=0.01)


def test_limits_are_geometrical_optics() -> None:
    """Near a long one those of a cylinder; where there is next to no side those of a sphere."""
    near = np.array([[0.54, 0.0, 0.0]])
    cylinder = 0.5 * 0.5 / np.sqrt(1.0 + 0.5 / 0.04)  # 1 / sqrt(h1 h2), h1 = 2 / d, h2 = 2 / d + 2 / R
    # What is missing beyond the ends of 5 m: some 0.04 of it, in quadrature or not.
    assert abs(strengths(0.04, 40.0, near, near)[0]) == pytest.approx(cylinder, rel=1e-3)
    ends = ends_at(np.linspace(-1.5, 1.5, 31), 0.5, 1.0)
    glint = ellipsoid_specular_point(np.full(3, 0.04), *(end.T for end in ends))
    sphere = ellipsoid_strength(np.full(3, 0.04), *(end.T for end in ends), glint)
    np.testing.assert_allclose(strengths(0.04, 1e-7, *ends), sphere, rtol=1e-3)


def test_bounds_and_what_is_inside(rng: np.random.Generator) -> None:
    shape = clsim.Scatterer.capsule("c", 0.03, 0.2, clsim.Trajectory.fixed((0.0, 0.0, 0.0)), shadow=False).shape
    ends = rng.normal(size=(2, 4000, 3))
    ends[:, :500, 2] = ends[:1, :500, 2] * 1e-3  # near broadside
    ends /= np.linalg.norm(ends, axis=2)[..., None] / rng.uniform(0.3, 50.0, (2, 4000, 1))
    for wave in (200.0, K):
        found = np.abs(strengths(0.03, 0.2, *ends, wave))
        assert 0.3 < found.max() / shape.largest(np.array([wave]), np.ones(1))[0, 0] <= 1.0
    inside = shape.holds(np.array([[0.0, 0.0, 0.129], [0.0, 0.02, 0.125], [0.029, 0.0, 0.1], [0.0, 0.0, 0.14]]), 0.0)
    assert inside.tolist() == [True, False, True, False]
    assert shape.holds(np.array([[0.0, 0.0, 0.14]]), 0.02).all()


def test_a_capsule_that_moves_and_turns_is_heard_as_its_law(engine: str, measured: Callable[..., float]) -> None:
    """A tone off one that turns through broadside: the table's gains and delays, sample by sample."""
    rate, t = 192e3, np.linspace(-0.05, 0.15, 9)
    turns = np.stack([0.0 * t, np.sin(3.0 * t + 0.2), 0.0 * t, np.cos(3.0 * t + 0.2)], axis=1)
    way = clsim.Trajectory.waypoints(t, np.stack([2.2 - 0.8 * t, 1.0 + 0.2 * t, 1.0 + 0.0 * t], axis=1), turns)
    tone = clsim.Signal.tone(40e3, 0.1, rate, fade=0.02)
    ends = (
        [clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 2.0)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.2, 2.0)))],
    )
    room = clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.0))
    air = clsim.Air(speed_of_sound=C, absorption=False)
    paths = clsim.find_paths(
        clsim.Scene(room, air, *ends, scatterers=[clsim.Scatterer.capsule("leg", 0.04, 0.3, way)]), 0, direct=False
    )
    samples = np.arange(round(0.04 * rate), round(0.07 * rate), 7)
    table = paths.table(samples / rate)
    exact = np.real(table.gain[0] * np.exp(2j * np.pi * 40e3 * (samples / rate - table.delay[0] - 0.25 / 40e3)))
    assert np.ptp(np.abs(table.gain[0])) > 0.2 * np.abs(table.gain[0]).max()
    for asked_db, claim in ((-90.0, "a capsule that moves and turns"), (-60.0, "the same by default")):
        options = {} if asked_db == -60.0 else {"scattering_error_db": asked_db}
        heard = clsim.render(paths, rate, duration=0.08, engine=engine, **options).pressure[0, samples]
        error = float(20.0 * np.log10(np.linalg.norm(heard - exact) / np.linalg.norm(exact)))
        measured(claim, "gains and delays of its law", error, min(asked_db + 5.0, -60.0))


@pytest.mark.parametrize(
    ("band", "duration"), [((20e3, 60e3), 0.2), pytest.param((30e3, 50e3), 0.35, marks=pytest.mark.exhaustive)]
)
def test_a_source_that_passes_a_capsule_is_heard_as_its_law(band, duration, device, measured) -> None:
    """Many tones at once: each with the law's response at its own frequency, and no warning.

    Lobe after lobe passes the receiver: a few instants of the run do not tell of them.
    """
    rate, rng = 192e3, np.random.default_rng(5)
    tones, phases = np.linspace(*band, 48) + rng.uniform(-100.0, 100.0, 48), rng.uniform(0.0, 2.0 * np.pi, 48)
    t = np.arange(round(duration * rate)) / rate
    fade = np.clip(np.minimum(t, t[::-1]) / 0.02, 0.0, 1.0)
    samples = (
        1e-2 * np.sin(0.5 * np.pi * fade) ** 2 * np.cos(2.0 * np.pi * tones[:, None] * t + phases[:, None]).sum(axis=0)
    )
    turn = np.array([0.3, 0.1, 0.2, 0.9]) / np.sqrt(0.95)
    scene = clsim.Scene(
        clsim.Shoebox((8.0, 6.0, 4.0), clsim.Material.from_reflection(0.0)),
        clsim.Air(speed_of_sound=C, absorption=False),
        [clsim.Source("s", clsim.Signal.from_array(samples, rate),
                      clsim.Trajectory.line((2.0, 2.0, 2.0), (2.0 + 0.8 * duration, 2.0 + 4.0 * duration, 2.0), duration))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((5.5, 1.5, 2.2)))],
        scatterers=[clsim.Scatterer.capsule("c", 0.03, 0.3, clsim.Trajectory.fixed((3.5, 3.0, 2.0), turn))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0, direct=False)
    heard_at = np.arange(round(0.05 * rate), round((duration - 0.03) * rate), 61)
    times = heard_at / rate
    found = paths.families[-1].arrivals(slice(None), times)
    response = paths.families[-1].response(slice(None), found, times, SceneResponse(scene, 0, tones))[0]
    exact = 1e-2 * np.sum(
        (response * np.exp(1j * (2.0 * np.pi * np.outer(times - found.delay[0], tones) + phases))).real, axis=1
    )
    for options, allowed_db, by in (({"scattering_error_db": -90.0}, -85.0, "-90 dB"), ({}, -60.0, "default")):
        with warnings.catch_warnings():
            warnings.simplefilter("error", clsim.ClsimWarning)
            heard = clsim.render(paths, rate, duration=duration, **options).pressure[0, heard_at]
        parts = [np.array_split(x, 8) for x in (heard - exact, exact)]
        error_db = max(20.0 * np.log10(np.linalg.norm(w) / np.linalg.norm(x)) for w, x in zip(*parts, strict=True))
        claim = f"a capsule passed by a source, {band[0] / 1e3:g} to {band[1] / 1e3:g} kHz, {by}"
        measured(claim, "the law at each frequency, summed", error_db, allowed_db)


def walking(sticks: list[clsim.Scatterer], duration: float) -> clsim.PathSet:
    """Return the paths of a 40 kHz tone from a source that moves, with capsules between walls."""
    tone = clsim.Signal.tone(40e3, duration, 192e3, fade=0.01)
    source = clsim.Source("s", tone, clsim.Trajectory.line((1.0, 1.3, 1.2), (1.2, 1.8, 1.3), duration))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 2.4, 1.1)))
    room = clsim.Shoebox((6.0, 4.0, 3.0), clsim.Material.from_reflection(0.8))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear], scatterers=sticks), 4)


@pytest.mark.filterwarnings("ignore:.*casts no shadow on them")
def test_echoes_leave_the_filters_of_reflections() -> None:
    """Reflections have the filters that they have in the room alone, and few functions hold echoes, and shadows."""
    way, bands = clsim.Trajectory.line((2.5, 1.0, 1.1), (2.5, 3.0, 1.1), 0.6), {}
    for name, shadow in (("none", None), ("echoes", False), ("shadows", True)):
        sticks = [] if shadow is None else [clsim.Scatterer.capsule("c", 0.05, 0.3, way, shadow=shadow)]
        bands[name] = clsim.plan_render(walking(sticks, 0.5), 192e3, duration=0.5)
    assert len({plan.source_filters[0].digest() for plan in bands.values()}) == 1
    functions = [
        len(bands[name].allocation.scattered[0].plan.source_filters[0].basis) for name in ("echoes", "shadows")
    ]
    assert functions[0] <= 3
    assert functions[1] <= 6


@pytest.mark.filterwarnings("ignore:.*casts no shadow on them")
@pytest.mark.parametrize("shadow", [False, True])
def test_capsules_are_solved_together_as_one_by_one(shadow: bool) -> None:
    """One that turns and one that does not, of other sizes: delays and responses at 40 kHz are those of each alone.

    Their shades multiply.
    """
    times = np.linspace(0.0, 0.4, 9)
    places = np.stack([2.5 + times, 2.0 + 0.0 * times, 1.0 + 0.1 * times], axis=1)
    turns = np.stack([np.sin(2.0 * times), 0.0 * times, 0.0 * times, np.cos(2.0 * times)], axis=1)
    sticks = [
        clsim.Scatterer.capsule("one", 0.04, 0.3, clsim.Trajectory.waypoints(times, places, turns), shadow=shadow),
        clsim.Scatterer.capsule("other", 0.06, 0.2, clsim.Trajectory.waypoints(times, places + 0.5 - 0.4 * shadow), shadow=shadow),
    ]  # fmt: skip
    together, *alone = (walking(some, 0.3).cir(times[1:7], carrier=40e3) for some in (sticks, *([s] for s in sticks)))
    for i, each in enumerate(alone):
        echo, own = len(together.delay) - 2 - shadow + i, len(each.delay) - 1 - shadow
        np.testing.assert_allclose(together.delay[echo], each.delay[own], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(together.gain[echo], each.gain[own], rtol=1e-8)
    if shadow:
        passed, *left = (1.0 + found.gain[-1] / found.gain[0] for found in (together, *alone))
        np.testing.assert_allclose(passed, left[0] * left[1], rtol=1e-8)
        assert min(np.abs(1.0 - one).max() for one in left) > 0.1


def test_echoes_are_envelopes_where_other_paths_are(device: str) -> None:
    """The split of the tone for paths by walls is taken for the echo, within what is promised of all."""
    stick = clsim.Scatterer.capsule(
        "c", 0.05, 0.3, clsim.Trajectory.line((2.5, 1.0, 1.1), (2.5, 3.0, 1.1), 4.1), shadow=False
    )
    paths = walking([stick], 4.0)
    told = clsim.plan_render(paths, 192e3, duration=4.0, narrowband=True).describe()
    assert sum("narrow part: rendered as complex envelope" in line for line in told) == 2
    got, wanted = (clsim.render(paths, 192e3, duration=4.0, narrowband=way).samples for way in (True, False))
    assert 20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted)) < -86.0
