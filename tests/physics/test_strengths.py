"""What scatterers send back, against published values and against minima found by other means."""

import numpy as np
import pytest
from exhaustive import few
from scipy.optimize import minimize

from clsim.acoustics.scattering import ellipsoid_specular_point, ellipsoid_strength
from clsim.acoustics.sphere import sphere_field

C = 343.0
RADII = (0.005, 0.01, 0.02, 0.05, 0.1)


def sent_back(ka: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the field of a sphere (n, F) far away, over its front's, at angles between the ends, rad."""
    aspects = np.stack([np.cos(angle), 0.0 * angle, 0.0 * angle, 2.0 * np.cos(0.5 * angle)], axis=1)
    return sphere_field(ka, aspects)


def test_a_sphere_in_water_has_its_published_strengths() -> None:
    """The benchmark of Jech et al. (J. Acoust. Soc. Am. 138, 2015), printed to 0.01 dB: right within 0.005 dB."""
    frequencies = np.array([12e3, 32e3, 112e3, 212e3, 312e3])
    form = sent_back(2.0 * np.pi * frequencies / 1477.3 * 0.01, np.zeros(1))
    np.testing.assert_allclose(
        20.0 * np.log10(0.005 * np.abs(form[0])), [-54.44, -46.74, -45.52, -46.74, -45.72], atol=0.0051
    )


@pytest.mark.parametrize(
    ("frequency", "wanted"),
    [(40e3, [-51.47, -45.56, -39.84, -32.07, -26.04]), (20e3, [-55.94, -45.45, -39.54, -31.96, -26.05])],
)
def test_spheres_in_air(frequency: float, wanted: list[float]) -> None:
    form = [sent_back(np.array([2.0 * np.pi * frequency / C * a]), np.zeros(1))[0, 0] * a for a in RADII]
    np.testing.assert_allclose(20.0 * np.log10(np.abs(form) / 2.0), wanted, atol=0.0051)


def test_far_spheres_are_mirrors_but_for_what_creeps_round() -> None:
    """Geometrical optics within the published table's levels, from 90 to 180 degrees, at 20 to 80 kHz."""
    every, angles = 2.0 * np.pi * np.linspace(20e3, 80e3, 25) / C, np.radians(np.linspace(0.0, 90.0, 91))
    for radius, level in ((0.01, -13.0), (0.02, -18.0), (0.05, -26.0), (0.1, -32.0)):
        lit = sent_back(radius * every, angles) - 1.0
        assert 20.0 * np.log10(np.sqrt(np.mean(np.abs(lit) ** 2))) == pytest.approx(level, abs=1.0), radius


def test_ellipsoids_reflect_where_the_way_is_shortest(rng: np.random.Generator) -> None:
    """Against a minimum over the surface by other means, and the strength against its second derivatives there."""
    for _ in range(12):
        axes = rng.uniform(0.05, 0.4, 3)
        ends = rng.normal(size=(2, 3))
        ends *= (rng.uniform(1.2, 8.0, 2) / np.linalg.norm(ends / axes, axis=1))[:, None]
        source, receiver = ends[:, :, None]
        glint = ellipsoid_specular_point(axes, source, receiver)
        for _ in range(3):
            glint = ellipsoid_specular_point(axes, source, receiver, glint)

        def way(v: np.ndarray, axes: np.ndarray = axes, ends: np.ndarray = ends) -> float:
            place = axes * v / np.linalg.norm(v)
            return float(sum(np.linalg.norm(place - end) for end in ends))

        found = min(minimize(way, start, tol=1e-13).fun for start in (ends[0], ends[1], ends.sum(axis=0)))
        apart = float(np.linalg.norm(ends[1] - ends[0]))
        if glint.hidden[0]:
            assert found == pytest.approx(apart, abs=1e-5)
            continue
        assert way(glint.normal[:, 0]) == pytest.approx(found, abs=1e-9)
        across = np.linalg.svd(glint.normal.T)[2][1:]
        h, second = 1e-4, np.empty((2, 2))
        for i in range(2):
            for j in range(2):
                second[i, j] = sum(
                    a * b * way(glint.normal[:, 0] + h * (a * across[i] + b * across[j])) for a in (1, -1) for b in (1, -1)
                ) / (4.0 * h * h)  # fmt: skip
        normal = glint.normal[:, 0] / axes
        leaving = ends[0] - glint.place[:, 0]
        cosine = normal @ leaving / np.linalg.norm(normal) / np.linalg.norm(leaving)
        area = np.prod(axes) * np.linalg.norm(normal)
        wanted = cosine * area / np.sqrt(np.linalg.det(second)) * -np.expm1(-((cosine / 0.25) ** 3))
        assert ellipsoid_strength(axes, source, receiver, glint)[0] == pytest.approx(wanted, rel=1e-4)


def nearest_on(axes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the points (n, 3) of an ellipsoid nearest to places (n, 3) outside: bisection of the secular equation."""
    low, high = np.zeros(len(places)), np.linalg.norm(axes * places, axis=1)
    for _ in range(64):
        m = 0.5 * (low + high)
        outside = np.linalg.norm(axes * places / (axes**2 + m[:, None]), axis=1) > 1.0
        low, high = np.where(outside, m, low), np.where(outside, high, m)
    return axes**2 * places / (axes**2 + high[:, None])


def shortest_ways(axes: np.ndarray, source: np.ndarray, receiver: np.ndarray) -> np.ndarray:
    """Return the lengths (n,) of the shortest ways by an ellipsoid: bisection over points between both ends (n, 3).

    The specular point x is nearest to the point between the ends that divides them as both distances from x are.
    """
    low, high = np.zeros(len(source)), np.ones(len(source))
    for _ in range(56):
        share = 0.5 * (low + high)
        place = nearest_on(axes, source + share[:, None] * (receiver - source))
        to, back = (np.linalg.norm(place - end, axis=1) for end in (source, receiver))
        short = share * back < (1.0 - share) * to
        low, high = np.where(short, share, low), np.where(short, high, share)
    return np.asarray(to + back)


@pytest.mark.parametrize("aspect", few([1.0, 3.9, 10.0, 80.0, 1e4], (1, 4)))
@pytest.mark.parametrize("plate", [False, True])
def test_long_ellipsoids_reflect_where_the_way_is_shortest(aspect: float, plate: bool, rng) -> None:
    """Ends near poles and plates, both seen from a place of the surface: to 1e-9 m, after two steps from nearby."""
    count = 0
    for _ in range(4):
        axes = 0.1 * rng.permutation([aspect, 0.7 * aspect if plate else 0.8, 0.7])
        u = rng.normal(size=(100, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        normal = u / axes / np.linalg.norm(u / axes, axis=1)[:, None]
        source, receiver = (
            axes * u + normal * rng.uniform(0.05, 3.0, (100, 1)) + rng.uniform(-2.0, 2.0, (100, 3)) for _ in range(2)
        )
        free = np.linalg.norm(np.stack([source, receiver]) / axes, axis=2).min(axis=0) > 1.02
        source, receiver = source[free], receiver[free]
        glint = ellipsoid_specular_point(axes, source.T, receiver.T)
        for _ in range(2):
            glint = ellipsoid_specular_point(axes, source.T, receiver.T, glint)
        assert glint.change < 1e-3
        lit = ~glint.hidden
        way = sum(np.linalg.norm(glint.place.T - end, axis=1)[lit] for end in (source, receiver))
        np.testing.assert_allclose(way, shortest_ways(axes, source[lit], receiver[lit]), rtol=0.0, atol=1e-9)
        count += lit.sum()
    assert count > 200


def test_far_ellipsoids_and_planes() -> None:
    axes, out = np.array([0.3, 0.2, 0.1]), np.array([0.6, 0.48, 0.64])
    far = 1e7 * out[:, None]
    wanted = np.prod(axes) / (2.0 * np.sum((axes * out) ** 2))  # abc / (2 h²)
    assert ellipsoid_strength(axes, far, far, ellipsoid_specular_point(axes, far, far))[0] == pytest.approx(
        wanted, rel=1e-6
    )
    huge, near = np.full(3, 1e5), np.array([[0.0], [0.0], [1e5 + 2.0]])
    glint = ellipsoid_specular_point(huge, near, near)
    assert ellipsoid_strength(huge, near, near, glint)[0] == pytest.approx(1.0, rel=1e-4)  # 1 / (1 / 2 m + 1 / 2 m)
