"""Shadows of ellipsoids and capsules, against exact spheres and a solution of the boundary-value problem by point sources.

Levels are relative to the free field, where the exact one is above -20 dB.
"""

from collections.abc import Callable

import numpy as np
import pytest
from shadow_oracle import AIR, MIDDLE, SILENT, C, capsule, ellipsoid, errors, evenly, heard, sphere, walk

import clsim
from clsim.acoustics.fock import FIRST, LAST, fock_hard, lit_reflection
from clsim.acoustics.outline import CapsuleOutline, EllipsoidOutline, counts_of_points
from clsim.acoustics.silhouette import forward_share, outline_field
from clsim.numerics.band_filters import chebyshev_points


@pytest.mark.parametrize(
    ("radius", "frequency"),
    [(0.05, 40e3), (0.3, 40e3), *(pytest.param(*x, marks=pytest.mark.exhaustive) for x in ((0.1, 40e3), (0.05, 20e3)))],
)
def test_spheres_by_their_outline(radius: float, frequency: float, measured: Callable[..., float]) -> None:
    """From the middle of the shadow to twice the radius beside it, across the boundary in steps of 1/20 of it."""
    wave, source = 2.0 * np.pi * frequency / C, np.array([-1.5, 0.0, 0.0])
    ball = clsim.Scatterer.sphere("b", radius, clsim.Trajectory.fixed(MIDDLE), model="outline")
    found = []
    for distance in (0.5, 3.0):
        places = walk(distance, np.arange(0.0, 3.0 * radius * (1.0 + distance / 1.5), radius / 20.0))
        found.append(errors(heard([ball], wave, source, places), sphere(wave, radius, source, places)))
    found = np.concatenate(found)
    claim = f"sphere of {radius * 100:g} cm by its outline, {frequency / 1e3:g} kHz"
    measured(claim, "the exact series, dB rms", float(np.sqrt(np.mean(found**2))), 0.7)
    measured(f"{claim}, worst", "the exact series", float(np.abs(found).max()), 2.5)


def test_outlines_count_near_the_line_of_sight() -> None:
    """A ball that goes from it to six radii of the Fresnel zone: beyond two the mirror alone, as the exact series has it."""
    radius, wave, source = 0.1, 2.0 * np.pi * 40e3 / C, np.array([-3.0, 0.0, 0.0])
    ball = clsim.Scatterer.sphere("b", radius, clsim.Trajectory.fixed(MIDDLE), model="outline")
    zone = np.sqrt(2.0 * np.pi / wave * 1.5)
    places = walk(
        3.0, 2.0 * np.array([radius + n * zone for n in (0.5, 0.9, 1.3, 1.6, 1.9, 2.2, 3.0, 4.0, 5.0, 6.0, 0.2)])
    )
    ends = np.tile(source, (len(places), 1)), places
    share = forward_share(ball.shape.outline, wave, *ends)[:, 0]
    np.testing.assert_allclose(share[[0, 1, -1]], 1.0, atol=0.05)
    assert np.all(share[5:10] == 0.0)
    assert np.all((share[2:5] > 0.0) & (share[2:5] < 0.95))
    found = errors(heard([ball], wave, source, places), sphere(wave, radius, source, places))
    assert np.abs(found).max() < 0.4


def test_lines_of_sight_pass_ellipsoids_at_their_nearest_points() -> None:
    """Forty lines, and 80000 points of the surface of a forearm: coordinates that make it a sphere are wrong by 60 %."""
    rng, axes = np.random.default_rng(4), np.array([0.0385, 0.05, 0.175])
    source, middle = rng.normal(size=(40, 3)), 0.15 * rng.normal(size=(40, 3))
    along = middle - source
    around = np.linspace(0.0, 2.0 * np.pi, 400)[None]
    up = np.linspace(0.0, np.pi, 200)[:, None]
    surface = np.stack(np.broadcast_arrays(np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)), -1)
    away = surface.reshape(-1, 1, 3) * axes - source
    share = np.clip(np.sum(away * along, axis=2) / np.sum(along**2, axis=1), 0.0, 2.0)
    exact = np.linalg.norm(away - share[..., None] * along, axis=2).min(axis=0)
    found, place = EllipsoidOutline(axes).clearance(source, source + 2.0 * along)
    beside = exact > 0.02
    assert np.sum(beside) > 20
    np.testing.assert_allclose(found[beside], exact[beside], rtol=0.1)
    foot = np.linalg.norm(source + 2.0 * place[:, None] * along, axis=1)
    assert np.all(foot < axes.max() + exact + 1e-9)


@pytest.mark.parametrize("thin", [0.01, 0.003, 0.0003])
def test_thin_discs_edge_on_leave_the_free_field(thin: float) -> None:
    """A disc of 60 cm, as rigid as it is, has nothing to reflect or to shade there; Fock's term alone adds 2 to 14 dB."""
    for frequency in (20.0, 100.0, 2e3, 20e3, 80e3):
        wave, outline = np.array([2.0 * np.pi * frequency / C]), EllipsoidOutline(np.array([0.3, 0.3, thin]))
        level = 1.0 + outline_field(outline, wave, np.array([[-1.2, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]), 512)[0]
        assert abs(20.0 * np.log10(np.abs(level[0, 0]))) < 0.7


@pytest.mark.parametrize(("ka", "error_db"), [(0.02, 0.05), (0.2, 0.3), (2.0, 0.35)])
def test_low_frequencies_pass_small_spheres(ka: float, error_db: float) -> None:
    source, places = np.array([-1.2, 0.0, 0.0]), walk(1.0, np.arange(0.0, 0.5, 0.1))
    outline, wave = EllipsoidOutline(np.full(3, 0.1)), ka / 0.1
    found = 1.0 + outline_field(outline, np.array([wave]), np.tile(source, (5, 1)), places, 64)[0][:, 0]
    assert np.abs(20.0 * np.log10(np.abs(found / sphere(wave, 0.1, source, places)))).max() < error_db


@pytest.mark.parametrize(
    ("body", "ka"),
    [
        ("ellipsoid", 4.0),
        *(pytest.param(b, k, marks=pytest.mark.exhaustive) for b, k in (("capsule", 4.0), ("ellipsoid", 8.0))),
    ],
)
def test_bodies_against_point_sources(body: str, ka: float, measured: Callable[..., float]) -> None:
    fixed = clsim.Trajectory.fixed(MIDDLE)
    if body == "ellipsoid":
        axes = np.array([1.0, 0.6, 0.4])
        thing, exact = (
            clsim.Scatterer.ellipsoid("e", axes, fixed, shadow=True),
            ellipsoid(axes, ka, 900 if ka > 4.0 else 450),
        )
    else:
        thing, exact = clsim.Scatterer.capsule("c", 0.5, 1.0, fixed, shadow=True), capsule(0.5, 0.5, ka, 900)
    found = []
    for direction in evenly(5):
        across = np.cross(direction, [0.3, 0.2, 0.9])
        across /= np.linalg.norm(across)
        off = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.7, 2.2, 3.0])
        places = np.concatenate([-d * direction + off[:, None] * across for d in (1.6, 3.0, 8.0)])
        source = 5.0 * direction
        found.append(errors(heard([thing], ka, source, places), exact.levels(source, places)))
    found = np.concatenate(found)
    claim = f"shadow of a {body}, k a = {ka:g}"
    measured(claim, "point sources inside it, dB rms", float(np.sqrt(np.mean(found**2))), 1.0)
    measured(f"{claim}, worst", "point sources inside it", float(np.abs(found).max()), 3.0)


def test_nothing_jumps_where_a_shadow_begins() -> None:
    """A hand's width passes the line of sight: half the step gives half the largest change, of everything together."""
    wave, source = 2.0 * np.pi * 40e3 / C, np.array([-1.5, 0.0, 0.0])
    turned = clsim.Trajectory.fixed(MIDDLE, np.array([0.1, 0.3, -0.2, np.sqrt(0.86)]))
    things = (
        clsim.Scatterer.ellipsoid("e", (0.03, 0.06, 0.1), turned, shadow=True), clsim.Scatterer.capsule("c", 0.03, 0.2, turned, shadow=True),
    )  # fmt: skip
    for thing in things:
        changes = []
        for count in (101, 201):
            places = walk(0.5, np.linspace(0.02, 0.14, count))
            changes.append(np.abs(np.diff(heard([thing], wave, source, places))).max())
        assert changes[0] / changes[1] == pytest.approx(2.0, rel=0.01)


def test_nothing_jumps_where_the_side_of_a_capsule_ends() -> None:
    """A hand's breadth of places 2 mm apart has a specular point on the side and on a cap: halved steps halve changes."""
    turned = np.array([-0.64508132, 0.08272527, -0.57582496, 0.49543137])
    way = clsim.Trajectory.fixed(MIDDLE, turned / np.linalg.norm(turned))
    wave, source = 2.0 * np.pi * 40e3 / C, np.array([-0.841536, 0.012391, -0.249286])
    stick = clsim.Scatterer.capsule("c", 0.018803, 0.350009, way, shadow=True)
    changes = []
    for count in (101, 201):
        places = np.array([0.658464, -0.057609, -0.319286]) + np.outer(np.linspace(-0.03, 0.03, count), [0.0, 0.6, 0.8])
        changes.append(np.abs(np.diff(heard([stick], wave, source, places))).max())
    assert changes[0] / changes[1] == pytest.approx(2.0, rel=0.1)


def test_capsules_seen_along_their_axis(device: str) -> None:
    """The field is that of nearly the axis, and the device's that of the reference."""
    for radius, length in ((0.05, 0.4), (0.02, 0.1)):
        stick = clsim.Scatterer.capsule("c", radius, length, clsim.Trajectory.fixed(MIDDLE), shadow=True)
        places = np.array([[0.0, 0.0, 1.0], [1e-6, 0.0, 1.0], [0.0, -1e-6, 1.0]])
        found = heard([stick], 2.0 * np.pi * 40e3 / C, np.array([0.0, 0.0, -1.2]), places)
        assert np.abs(found - found[0]).max() < 1e-5
    tone = clsim.Signal.tone(40e3, 0.02, 192e3, fade=5e-3)
    ends = [clsim.Trajectory.fixed(MIDDLE + np.array([0.0, 0.0, z])) for z in (-1.2, 1.0)]
    scene = clsim.Scene(
        clsim.Shoebox(2.0 * MIDDLE, SILENT), AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], scatterers=[stick],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0)
    got, wanted = (clsim.render(paths, 192e3, engine=engine).samples for engine in ("opencl", "reference"))
    assert 20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted)) < -60.0


@pytest.mark.parametrize(("radius", "length"), [(0.05, 0.4), (0.02, 0.1)])
def test_nothing_jumps_where_lines_of_sight_turn_through_an_axis(radius: float, length: float) -> None:
    """Within the capsule and beside it: halved steps halve changes. It was -7 to -50 dB whatever the step."""
    outline, wave = CapsuleOutline(radius, 0.5 * length), np.array([2.0 * np.pi * 40e3 / C])
    for off in (0.005, 0.02, 0.06):
        changes = []
        for count in (1001, 2001):
            angle = np.linspace(-0.12, 0.12, count)
            along = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
            ends = [distance * along + [0.0, off, 0.0] for distance in (-1.2, 1.0)]
            changes.append(np.abs(np.diff(outline_field(outline, wave, *ends, 256)[0][:, 0])).max())
        assert changes[0] / changes[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    ("band", "error"),
    [((39e3, 41e3), 5e-5), ((30e3, 50e3), 1e-4), ((20e3, 80e3), 1e-3)],  # 2e-5 by the table of Fock's function alone
)
def test_bands_are_frequencies_one_by_one(band: tuple[float, float], error: float) -> None:
    """Fields over a band are carried from few wave numbers: they are those of each frequency alone."""
    random = np.random.default_rng(5)
    ends = [random.uniform(-1.0, 1.0, (20, 3)) + np.array([x, 0.0, 0.0]) for x in (-1.5, 1.5)]
    wave = chebyshev_points(*band, 387) * (2.0 * np.pi / C)
    for outline in (EllipsoidOutline(np.array([0.1, 0.3, 0.2])), CapsuleOutline(0.1, 0.4)):
        together = outline_field(outline, wave, *ends, 128)[0][:, ::43]
        alone = np.concatenate([outline_field(outline, wave[[i]], *ends, 128)[0] for i in range(0, 387, 43)], axis=1)
        assert np.abs(together - alone).max() < error
        assert np.abs(alone).max() > 0.3


def test_outlines_have_enough_points() -> None:
    """A head that passes up to 0.8 m beside the line of sight: as by 4096 points, so that no number of them shows."""
    wave, head = (
        np.array([2.0 * np.pi * 40e3 / C]),
        clsim.Scatterer.capsule("h", 0.09, 0.05, clsim.Trajectory.fixed(MIDDLE), shadow=True),
    )
    ends = [np.stack([np.full(161, x), np.linspace(0.0, 0.8, 161), np.full(161, 0.1)], axis=1) for x in (-2.0, 2.0)]
    outline = head.shape.outline
    share = forward_share(outline, float(wave[0]), *ends)
    for i, count in enumerate(counts_of_points(outline, float(wave[0]), *ends)):
        few, many = (outline_field(outline, wave, *(end[[i]] for end in ends), n)[0] for n in (int(count), 4096))
        assert abs(share[i, 0] * (few - many)) < 1e-3


@pytest.mark.parametrize(("function", "at"), [(fock_hard, LAST), (lit_reflection, FIRST)])
def test_series_go_on_where_tables_end(function: Callable[..., np.ndarray], at: float) -> None:
    """Values and slopes of a table and of the series beyond its end meet."""
    step = np.array([0.02, 0.01])
    before, after = (function(at + sign * step) for sign in (-1.0, 1.0))
    ends = [2.0 * x[1] - x[0] for x in (before, after)]  # as lines, whose bends are less than what is allowed
    assert abs(ends[1] - ends[0]) < 2e-5


@pytest.mark.parametrize("thing", ["ellipsoid", "capsule"])
def test_sound_that_comes_back_along_the_normal_has_no_plane_of_incidence(thing: str) -> None:
    """A source and a receiver that turn about a body's axis, and one that crosses it: the echo does not jump."""
    make = {
        "ellipsoid": lambda: clsim.Scatterer.ellipsoid(
            "b", (0.02, 0.05, 0.09), clsim.Trajectory.fixed((0.0, 0.0, 0.0))
        ),
        "capsule": lambda: clsim.Scatterer.capsule("b", 0.02, 0.1, clsim.Trajectory.fixed((0.0, 0.0, 0.0))),
    }[thing]
    shape, wave = make().shape, np.array([2.0 * np.pi * 40e3 / C])
    turn, lean = np.linspace(0.0, 2.0 * np.pi, 25), np.array([0.0, 1e-9, 1e-7, 1e-5])
    ends = np.stack([1.0 + 0.0 * np.outer(lean, turn), np.outer(lean, np.cos(turn)), np.outer(lean, np.sin(turn))])
    source = ends.reshape(3, -1)
    receiver = source * np.array([[1.0], [-1.0], [-1.0]])
    strength, aspects = shape.strength(source, receiver, None)
    echo = strength * shape.field(wave, float(wave[0]), aspects)[:, 0]
    assert np.abs(echo - echo[0]).max() < 1e-6 * abs(echo[0])
