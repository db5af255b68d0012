"""The field at an edge against exact solutions of the wave equation, and what it must be by symmetry."""

from collections.abc import Callable

import numpy as np
import pytest
from edge_fields import mistaken
from scipy.special import fresnel, wofz
from wedge_oracle import C, Place, edge_field, half_plane, wedge_series

from clsim.acoustics.diffraction import (
    end_detour,
    end_transition,
    exact_wedge_terms,
    lit_angles,
    path_over_edge,
    transition,
    wedge_terms,
)

HALF_PLANE = 2.0 * np.pi


def place(r: float, degrees: float, z: float) -> Place:
    return r, float(np.radians(degrees)), z


def wave_number(frequency: float) -> float:
    return 2.0 * np.pi * frequency / C


def utd(source: Place, receiver: Place, wedge: float, k: float, lit=None) -> complex:
    n = wedge / np.pi
    way = path_over_edge(*(np.float64(x) for x in (source[0], source[2], receiver[0], receiver[2])))
    weight, root = wedge_terms(n, lit_angles(n, source[1], receiver[1]), lit)
    terms = 0.5 * weight * transition(root * np.sqrt(k * way.breadth))
    return complex(np.exp(-1j * k * way.length) / way.length * terms.sum())


def exact(source: Place, receiver: Place, wedge: float, k: float, lit=None) -> complex:
    n = wedge / np.pi
    way = path_over_edge(*(np.float64(x) for x in (source[0], source[2], receiver[0], receiver[2])))
    angles, r = lit_angles(n, source[1], receiver[1]), (np.float64(source[0]), np.float64(receiver[0]))
    seen = np.where(angles >= 0.0, 1.0, -1.0) if lit is None else lit
    terms = exact_wedge_terms(n, angles, seen, *r, way, np.array([k]))
    return complex(np.exp(-1j * k * way.length) / way.length * np.sum(terms))


def distance(source: Place, receiver: Place, angle: float) -> float:
    """Return the distance of places that are an angle apart."""
    (rs, _, zs), (rr, _, zr) = source, receiver
    return float(np.sqrt(rs**2 + rr**2 - 2.0 * rs * rr * np.cos(angle) + (zs - zr) ** 2))


def way_field(source: Place, receiver: Place, angle: float, k: float) -> complex:
    """Return the free field of a way: past the edge, or by a face."""
    apart = distance(source, receiver, angle)
    return complex(np.exp(-1j * k * apart) / apart)


def decibels(value: float | np.floating) -> float:
    return float(20.0 * np.log10(abs(value) + 1e-300))


@pytest.mark.parametrize(
    ("source", "receiver", "wedge", "frequency", "level", "phase"),
    [
        (place(2, 60, 0), place(1.5, 300, 0.4), 360, 40e3, -43.3495, 19.81),
        (place(2, 60, 0), place(1.5, 245, 0.4), 270, 40e3, -25.0485, 28.01),
        (place(1, 20, 0.3), place(0.5, 250, -0.2), 270, 25e3, -25.1998, -132.23),
    ],
)
def test_published_values(source, receiver, wedge, frequency, level, phase) -> None:
    """Values of the exact integral that were computed by another program; the theory's own error is 0.04 degrees."""
    k = wave_number(frequency)
    for found, db, degrees in (
        (edge_field(source, receiver, np.radians(wedge), k), 6e-5, 6e-3),
        (exact(source, receiver, np.radians(wedge), k), 6e-5, 6e-3),
        (utd(source, receiver, np.radians(wedge), k), 2e-3, 0.04),
    ):
        assert decibels(abs(found)) == pytest.approx(level, abs=db)
        assert np.degrees(np.angle(found)) == pytest.approx(phase, abs=degrees)


# Mistakes that programs have made: what is wrong, in which function, and how.
MUTANTS = {
    "turns of one boundary taken for another's": (
        wedge_terms, "turns = np.round(angles / (2.0 * n * np.pi))",
        "turns = np.round(np.where(np.arange(4) % 2, -(2.0 * np.pi - angles), angles) / (2.0 * n * np.pi))",
    ),
    "no square of the sine of the angle to the edge": (
        path_over_edge, "2.0 * source_r * receiver_r / length", "2.0 * source_r * receiver_r * length / across**2",
    ),
    "no half for angles at a wedge": (wedge_terms, "np.tan(0.5 * np.where", "np.tan(np.where"),
}  # fmt: skip


@pytest.mark.parametrize("what", [None, *MUTANTS])
def test_mistakes_are_seen(what: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    if what is not None:
        monkeypatch.setitem(globals(), MUTANTS[what][0].__name__, mistaken(*MUTANTS[what]))
    k, errors = wave_number(40e3), []
    for one, other, degrees in ((place(2, 60, 0), place(1.5, 245, 0.4), 270), (place(2, 10, 0), place(2, 80, 3), 200)):
        wedge = np.radians(degrees)
        errors.append(abs(utd(one, other, wedge, k) - edge_field(one, other, wedge, k)))
    assert (decibels(max(errors) * 3.5) < -75.0) == (what is None)


def test_oracles_agree() -> None:
    source, receiver, k = place(2, 60, 0), place(1.5, 300, 0.4), wave_number(40e3)
    assert abs(half_plane(source, receiver, k) - edge_field(source, receiver, HALF_PLANE, k)) < 1e-8 * 0.01
    exact, whole = edge_field(source, receiver, HALF_PLANE, k), half_plane(source, place(1.5, 200, 0.4), k)
    lit = edge_field(source, place(1.5, 200, 0.4), HALF_PLANE, k)
    direct = way_field(source, place(1.5, 200, 0.4), np.radians(140.0), k)
    assert abs(whole - direct - lit) < 1e-8 * abs(exact)


def test_walk_across_the_shadow_of_a_half_plane(measured: Callable[..., float]) -> None:
    """At 40 kHz, 2 m before and 1.5 m behind the edge: -94 dB of the free field at worst within 0.4 m."""
    k, source = wave_number(40e3), place(2.0, 90.0, 0.0)
    wrong = []
    for u in np.linspace(-0.4, 0.4, 41) + 1e-5:  # above 0 in the shadow
        receiver = (float(np.hypot(1.5, u)), float(np.radians(270.0) + np.arctan2(u, 1.5)), 0.2)
        found = utd(source, receiver, HALF_PLANE, k)
        apart = receiver[1] - source[1]
        if apart < np.pi:
            found += way_field(source, receiver, apart, k)
        wrong.append(abs(found - half_plane(source, receiver, k)) * distance(source, receiver, apart))
    measured("a walk across the shadow of a half-plane", "MacDonald", decibels(max(wrong)), -94.0)
    assert decibels(np.sqrt(np.mean(np.square(wrong)))) < -98.0


@pytest.mark.parametrize(("kr", "bound"), [(0.05, 0.0), (0.7, 0.0), (7.3, -45.0), (73.0, -66.0), (733.0, -89.0)])
def test_plane_waves_at_a_wedge(kr: float, bound: float) -> None:
    """Against the series of modes at 270 degrees: -48.5, -68.9 and -93.1 dB, plus 3 dB for the choice of angles.

    The exact field of a source that is 1e9 wavelengths away is within -120 dB at every distance: that is its contour.
    """
    n, came = 1.5, np.radians(65.0)
    for degrees in (20.0, 80.0, 150.0, 200.0, 235.0, 262.0):
        angle = np.radians(degrees)
        weight, root = wedge_terms(n, lit_angles(n, came, angle))
        found = np.exp(-1j * kr) * np.sum(0.5 * weight * transition(root * np.sqrt(2.0 * kr)))
        seen = lit_angles(n, came, angle) > 0.0
        beside = np.exp(1j * kr * np.cos(angle - came)) * (seen[0] & seen[1])
        beside += np.exp(1j * kr * np.cos(angle + came)) * seen[2]
        beside += np.exp(1j * kr * np.cos(2.0 * n * np.pi - angle - came)) * seen[3]
        wanted = wedge_series(n, angle, came, kr)
        assert decibels(abs(found + beside - wanted)) < bound
        r, far = np.float64(1.0), np.float64(1e9)
        terms = exact_wedge_terms(
            n, lit_angles(n, came, angle), np.where(seen, 1, -1), far, r, path_over_edge(far, 0.0 * r, r, 0.0 * r),
            np.array([kr]),
        )  # fmt: skip
        assert decibels(abs(np.exp(-1j * kr) * np.sum(terms) + beside - wanted)) < -120.0


@pytest.mark.parametrize(
    ("wedge", "frequency", "distance_m", "bound"),
    [(270, 1e3, 0.3, -42), (270, 20e3, 0.1, -63), (270, 40e3, 0.03, -58), (270, 40e3, 1.5, -88), (355, 40e3, 0.1, -75)],
)
def test_error_of_the_theory(wedge: float, frequency: float, distance_m: float, bound: float, measured) -> None:
    """Over angles, relative to the free field, 2 m from the source: the figures that are told to users, and 1 dB."""
    k, worst = wave_number(frequency), 0.0
    for came in (25.0, 60.0, 110.0):
        for went in (130.0, 170.0, 215.0, 0.98 * wedge):
            source, receiver = place(2.0, came, 0.0), place(distance_m, went, 0.1 * distance_m)
            wrong = utd(source, receiver, np.radians(wedge), k) - edge_field(source, receiver, np.radians(wedge), k)
            worst = max(worst, abs(wrong) * (2.0 + distance_m))
    error = decibels(worst)
    measured("uniform theory of edges, 1 to 40 kHz, 3 cm to 1.5 m", "exact integral along the edge", error, bound + 1.0)


def test_the_exact_field_against_the_integral(measured: Callable[..., float]) -> None:
    """Any wedge, 50 Hz to 80 kHz, ends from 1 cm of the edge on, within -120 dB of the free field over the edge.

    That is 20 dB above what the step of the contour leaves; what both were as one program has no part in it: the
    integral here has no pole taken out, so places near a boundary are for the next test.
    """
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(150):
        n = rng.uniform(1.02, 2.0)
        one, other = ((10 ** rng.uniform(-2.0, 0.5), rng.uniform(0.0, n * np.pi), rng.uniform(-1, 1)) for _ in range(2))
        if np.abs(lit_angles(n, one[1], other[1])).min() > 0.1:
            k = wave_number(10 ** rng.uniform(np.log10(50.0), np.log10(80e3)))
            wrong = exact(one, other, n * np.pi, k) - edge_field(one, other, n * np.pi, k)
            worst = max(worst, abs(wrong) * np.hypot(one[0] + other[0], one[2] - other[2]))
    measured("exact field of wedges, drawn", "exact integral along the edge", decibels(worst), -120.0)


@pytest.mark.parametrize("frequency", [100.0, 1e3, 40e3])
def test_the_exact_field_at_a_half_plane(frequency: float) -> None:
    """Against MacDonald across both boundaries, 3 cm and 1.5 m behind the edge, and on either as near as it gets."""
    k, source = wave_number(frequency), place(2.0, 60.0, 0.0)
    for r in (0.03, 1.5):
        for degrees in (5.0, 118.0, 120.0 - 1e-7, 120.0 + 1e-7, 125.0, 239.5, 240.0 - 1e-7, 240.0 + 1e-7, 241.0, 350.0):
            receiver = place(r, degrees, 0.01)
            found = exact(source, receiver, HALF_PLANE, k)
            if degrees < 240.0:
                found += way_field(source, receiver, receiver[1] - source[1], k)
            if degrees < 120.0:
                found += way_field(source, receiver, receiver[1] + source[1], k)
            assert decibels(abs(found - half_plane(source, receiver, k)) * (2.0 + r)) < -120.0, (r, degrees)


def test_inner_corners_and_even_walls_send_nothing() -> None:
    for n in (1.0, 1.0 / 2.0, 1.0 / 3.0):
        source, receiver = (2.0, 0.4 * n * np.pi, 0.1), (1.5, 0.77 * n * np.pi, 0.4)
        assert abs(utd(source, receiver, n * np.pi, 700.0)) < 1e-15
        assert abs(exact(source, receiver, n * np.pi, 700.0)) < 1e-12
    weight, root = wedge_terms(1.0, lit_angles(1.0, 0.5, 1.2))
    np.testing.assert_allclose(weight[2], -weight[3], rtol=1e-12)  # a change of material sends the difference
    np.testing.assert_allclose(root[2], root[3], rtol=1e-12)


def test_both_ends_are_alike() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        n = rng.uniform(1.0, 2.0)
        one, other = ((rng.uniform(0.1, 3.0), rng.uniform(0.0, n * np.pi), rng.uniform(-1.0, 1.0)) for _ in range(2))
        for law in (utd, exact):
            there, back = law(one, other, n * np.pi, 500.0), law(other, one, n * np.pi, 500.0)
            assert abs(there - back) < 1e-12 * abs(there) + 1e-15
        there = utd(one, other, n * np.pi, 500.0)
        turned = [(r, n * np.pi - angle, z) for r, angle, z in (one, other)]
        assert abs(utd(*turned, n * np.pi, 500.0) - there) < 1e-11 * abs(there) + 1e-14


@pytest.mark.parametrize("law", [utd, exact])
@pytest.mark.parametrize("boundary", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [1.2, 1.5, 2.0])
def test_partners_come_and_go_smoothly(n: float, boundary: int, law) -> None:
    """What a term loses across its boundary is its partner; and one continued from the lit side has lost it already.

    The theory takes 1 / L for 1 / R and has its κ there; of the exact field the partner is the pole, whatever the angle.
    """
    came = {0: n * np.pi - 0.3, 1: 0.3, 2: 0.7, 3: n * np.pi - 0.7}[boundary]
    at = {0: came - np.pi, 1: came + np.pi, 2: np.pi - came, 3: (2.0 * n - 1.0) * np.pi - came}[boundary]
    source, k = (2.0, came, 0.0), 700.0

    def fields(offset: float) -> tuple[complex, complex, complex]:
        receiver = (1.5, at + offset, 0.3)
        angles = lit_angles(n, came, receiver[1])
        partner = {0: at + offset - came, 1: at + offset - came, 2: came + at + offset,
                   3: 2.0 * n * np.pi - came - at - offset}[boundary]  # fmt: skip
        lit, dark = np.where(angles > 0.0, 1.0, -1.0), np.where(angles > 0.0, 1.0, -1.0)
        lit[boundary], dark[boundary] = 1.0, -1.0
        direct = way_field(source, receiver, partner, k)
        return law(source, receiver, n * np.pi, k, lit) + direct, law(source, receiver, n * np.pi, k, dark), direct

    for offset in (-1e-2, -1e-5, 1e-5, 1e-2):
        seen, unseen, direct = fields(offset)
        left = 0.3 * offset**2 + 1e-13 if law is utd else 1e-11
        assert abs(seen - unseen) < left * abs(direct), offset


@pytest.mark.parametrize("law", [utd, exact])
@pytest.mark.parametrize("n", [1.5, 2.0])
def test_on_a_boundary_all_is_the_mean_of_both_sides(n: float, law) -> None:
    """The value of upsvensson's EDverify at 100 Hz, source and receiver 1 m from the edge, to 1e-5."""
    came, k = np.radians(60.0), wave_number(100.0)

    def total(went: float) -> complex:
        source, receiver = (1.0, came, 0.0), (1.0, went, 0.0)
        seen = lit_angles(n, came, went) >= 0.0
        found = law(source, receiver, n * np.pi, k)
        if seen[0] and seen[1]:
            found += way_field(source, receiver, went - came, k)
        return found + seen[2] * way_field(source, receiver, went + came, k)

    for boundary in (np.pi + came, np.pi - came):
        before, on, behind = (total(boundary + step) for step in (-1e-4, 0.0, 1e-4))
        assert abs(on - 0.5 * (before + behind)) < 1e-5 * abs(on)


def test_the_transition_at_its_start_and_far_out() -> None:
    beside = np.array([8.0 - 1e-9, 8.0 + 1e-9])  # where a series takes over
    assert abs(np.diff(transition(beside))[0]) < 1e-10
    np.testing.assert_allclose(transition(beside), wofz(1j * np.exp(0.25j * np.pi) * beside), rtol=1e-10)
    root = np.array([1e-3, 0.5, 3.0, 40.0, 400.0])
    sine, cosine = fresnel(root * np.sqrt(2.0 / np.pi))
    wanted = np.exp(1j * root**2) * (1.0 - (1.0 + 1j) * (cosine - 1j * sine))
    np.testing.assert_allclose(transition(root)[:3], wanted[:3], rtol=1e-12)
    far = np.exp(-0.25j * np.pi) / (np.sqrt(np.pi) * root[3:])
    np.testing.assert_allclose(transition(root)[3:], far, rtol=1e-3)
    np.testing.assert_allclose(
        transition(-root[:3]), 2.0 * np.exp(1j * root[:3] ** 2) - transition(root[:3]), atol=1e-13
    )


def test_the_transition_of_an_end() -> None:
    """Against its integral, turned to where it falls; continued beyond either boundary it goes on smoothly."""
    x, w = np.polynomial.legendre.leggauss(400)
    turn, t = np.exp(-0.25j * np.pi), 3.5 * (x + 1.0)
    for a in (1e-3, 0.05, 0.4, 1.0, 2.5, 12.0):
        for b in (1e-2, 0.3, 0.9, 2.0, 9.0):
            along = a + turn * t**2 / 7.0
            values = np.exp(-1j * (along**2 - a**2)) / (along**2 + b**2) * turn * 2.0 * t / 7.0
            wanted = b / np.pi * np.sum(3.5 * w * values)
            assert abs(end_transition(np.array(a), np.array(b)) - wanted) < 1e-6, (a, b)
    for one, other in (((1e-8, 0.7), (-1e-8, 0.7)), ((0.7, 1e-8), (0.7, -1e-8)), ((-0.7, 1e-8), (-0.7, -1e-8))):
        assert abs(end_transition(*np.array(one)) - end_transition(*np.array(other))) < 5e-8


def test_an_end_of_an_edge() -> None:
    """The field of an edge with one end, against the exact integral along it, also where the edge is in transition.

    The product of both transition functions is wrong by as much as there is where the way passes near the corner.
    """
    k, wedge = wave_number(40e3), HALF_PLANE
    for degrees, offsets, within in (
        (262.0, (-0.3, -0.05, -0.01, 0.01, 0.05, 0.3), -85.0),
        (240.4, (-0.03, 0.01), -85.0),
    ):
        source, receiver = place(2.0, 60.0, 0.0), place(1.5, degrees, 0.4)
        r, z = (np.float64(source[0]), np.float64(receiver[0])), (np.float64(source[2]), np.float64(receiver[2]))
        way, angles = path_over_edge(r[0], z[0], r[1], z[1]), lit_angles(2.0, source[1], receiver[1])
        weight, root = wedge_terms(2.0, angles)
        free = 1.0 / distance(source, receiver, receiver[1] - source[1])
        whole, product, wrong = utd(source, receiver, wedge, k), 0.0, 0.0
        for end in way.apex + np.array(offsets):
            detour = float(end_detour(way, (r[0], z[0]), (r[1], z[1]), end))
            via = sum(np.hypot(one, end - at) for one, at in zip(r, z, strict=True))
            assert detour == pytest.approx(via - way.length, abs=1e-14)
            pieces = (way.apex - 16.0, end - 8.0), (end - 8.0, end - 0.5), (end - 0.5, end)
            exact = sum(edge_field(source, receiver, wedge, k, piece) for piece in pieces)
            inside = 1.0 if end > way.apex else -1.0
            turned = inside * np.exp(-1j * k * detour)
            both = end_transition(np.full(4, np.sqrt(k * detour)), root * np.sqrt(k * way.breadth))
            corner = np.sum(0.5 * weight * both) * np.exp(-1j * k * way.length) / way.length * turned
            alone = 0.5 * whole * transition(np.array([np.sqrt(k * detour)]))[0] * turned
            wrong = max(wrong, abs(whole * (inside > 0.0) - corner - exact))
            product = max(product, abs(whole * (inside > 0.0) - alone - exact))
        assert decibels(wrong / free) < within
        assert decibels(product / free) > (-70.0 if degrees == 262.0 else -25.0)  # what is gained by it
