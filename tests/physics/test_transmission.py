"""Sound straight through thin panels: against the mass law, images of a divided box, and an opaque screen's field.

The oracles share no code with clsim: the mass law is written again, images are mirrored coordinates of a box.
"""

import itertools
import math

import numpy as np
import pytest
from edge_fields import field

import clsim
from clsim.paths.path_set import PathSet

RATE, TONE, C = 192e3, 40e3, 343.0
AIR = clsim.Air(absorption=False, speed_of_sound=C)
RIGID = clsim.Material.from_reflection(1.0)
FIXED = clsim.Trajectory.fixed
SOURCE, RECEIVER = np.array([0.1, -1.0, 0.2]), np.array([0.9, 1.2, -0.4])


def sheet(material: clsim.Material, y: float = 0.0, x: tuple[float, float] = (-3.0, 3.0)) -> clsim.MeshRoom:
    corners = [(x[0], y, -3), (x[0], y, 3), (x[1], y, 3), (x[1], y, -3)]
    return clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], material)


def limp(mass: float) -> clsim.Material:
    return RIGID.transmitting(surface_mass=mass)


def law(mass: float, cosine: float) -> complex:
    """Transmission factor of a limp panel at the tone's frequency, in air of 1.204 kg/m³."""
    return 1.0 / (1.0 + 1j * 2.0 * math.pi * TONE * mass * cosine / (2.0 * 1.204 * C))


def found(room: clsim.MeshRoom, ends: tuple, order: int = 0, **options: object) -> PathSet:
    tone = clsim.Signal.tone(TONE, 0.04, RATE, fade=0.001)
    scene = clsim.Scene(room, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])])
    return clsim.find_paths(scene, order, **options)


def decibels(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-300))


@pytest.mark.parametrize("masses", [(2.0,), (2.0, 0.5)])
def test_sheets_between_both_ends_are_the_mass_law(masses: tuple[float, ...], engine, measured) -> None:
    """At oblique incidence: paths by the law within rounding, what is rendered within -80 dB of the closed form."""
    room = clsim.MeshRoom.joined([sheet(limp(m), 0.4 * i) for i, m in enumerate(masses)])
    paths = found(room, (FIXED(SOURCE), FIXED(RECEIVER)), engine=engine)
    apart = float(np.linalg.norm(RECEIVER - SOURCE))
    cosine = float(RECEIVER[1] - SOURCE[1]) / apart
    wanted = math.prod((law(m, cosine) for m in masses), start=1.0 + 0j) / apart
    assert paths.interactions.tolist() == [[4] * len(masses)]
    assert paths.order.tolist() == [len(masses)]
    gain = paths.table(np.zeros(1)).gain[0, 0]
    assert decibels(abs(gain - wanted) / abs(wanted)) < -200.0
    places = paths.vertices(0.0)[0]
    assert np.abs(places[1:-1, 1] - 0.4 * np.arange(len(masses))).max() < 1e-12
    heard = clsim.render(paths, RATE, duration=0.04, engine=engine).pressure[0]
    times = np.arange(2000, 6000) / RATE - apart / C
    exact = np.imag(wanted * np.exp(2j * np.pi * TONE * times))
    error = float(decibels(np.abs(heard[2000:6000] - exact).max() / abs(wanted)))
    measured("through sheets by the mass law, rendered", "closed form", error, -80.0)


def test_a_table_of_losses_is_its_level() -> None:
    curtain = clsim.Material.from_reflection(0.3).transmitting(frequencies=[1e3, 100e3], losses_db=[12.0, 12.0])
    paths = found(sheet(curtain), (FIXED(SOURCE), FIXED(RECEIVER)))
    gain = paths.table(np.zeros(1)).gain[0, 0]
    assert abs(gain) * np.linalg.norm(RECEIVER - SOURCE) == pytest.approx(10 ** (-12 / 20), rel=1e-12)


def test_both_ways_are_one() -> None:
    """Between two sheets sound goes to and fro; either way every path is the same within -200 dB, as is their sum."""
    room = clsim.MeshRoom.joined([sheet(limp(0.05)), sheet(limp(0.02), 0.5)])
    gains = []
    for ends in ((FIXED(SOURCE), FIXED(RECEIVER)), (FIXED(RECEIVER), FIXED(SOURCE))):
        table = found(room, ends, 4).table(np.zeros(1))
        assert table.order.tolist() == [2, 4, 6]
        gains.append(table.gain[:, 0] * np.exp(-2j * np.pi * TONE * table.delay[:, 0]))
    assert decibels(np.abs(gains[0] - gains[1]).max() / np.abs(gains[0]).max()) < -200.0


def test_a_box_divided_by_a_panel_has_the_images_of_the_box() -> None:
    """Up to two reflections by outer walls: each image of the box once, times the law at each crossing of the panel.

    Reflections by the panel are left out of both: they are those of a mirror, as everywhere.
    """
    size, at = np.array([4.0, 3.0, 2.5]), 1.7
    wall = clsim.Material.from_reflection(0.8)
    box = clsim.MeshRoom.joined(
        [clsim.Shoebox(tuple(size), wall), clsim.MeshRoom(
            [(at, 0, 0), (at, 3.0, 0), (at, 3.0, 2.5), (at, 0, 2.5)], [(0, 1, 2), (0, 2, 3)], limp(0.02))]
    )  # fmt: skip
    source, receiver = np.array([0.7, 1.1, 0.9]), np.array([3.1, 2.2, 1.6])
    paths = found(box, (FIXED(source), FIXED(receiver)), 2)
    table, panel = paths.table(np.zeros(1)), len(box.faces.names) - 1
    by_walls = ~np.any((table.interactions == 0) & (table.objects == panel), axis=1)
    got = table.gain[by_walls, 0] * np.exp(-2j * np.pi * TONE * table.delay[by_walls, 0])
    wanted = []
    for cells in itertools.product(range(-2, 3), repeat=3):
        if sum(map(abs, cells)) > 2:
            continue
        image = np.array([n * s + (x if n % 2 == 0 else s - x) for n, s, x in zip(cells, size, source, strict=True)])
        way = receiver - image
        length, low, high = float(np.linalg.norm(way)), *sorted((image[0], receiver[0]))
        mirrored = [n * size[0] + (at if n % 2 == 0 else size[0] - at) for n in range(-3, 4)]
        crossings = sum(low < plane < high for plane in mirrored)
        factor = 0.8 ** sum(map(abs, cells)) * law(0.02, abs(way[0]) / length) ** crossings
        wanted.append(factor / length * np.exp(-2j * np.pi * TONE * length / C))
    assert len(got) == len(wanted) == 25
    apart = np.abs(np.sort_complex(got) - np.sort_complex(np.array(wanted))).max()
    assert decibels(apart / np.abs(wanted).max()) < -180.0


@pytest.mark.parametrize("finder", ["reference", "opencl"])
def test_a_source_that_passes_the_border_is_heard_through_the_panel_until_then(finder: str) -> None:
    """The path is divided when the sound passes the edge at x = 0, within the resolution; gains are as at rest."""
    way = clsim.Trajectory.line((-0.6, -1.0, 0.0), (0.6, -1.0, 0.0), 0.04)  # 30 m/s
    paths = found(sheet(limp(0.02), x=(-3.0, 0.0)), (way, FIXED((0.2, 1.0, 0.0))), engine=finder)
    assert paths.order.tolist() == [0, 1]
    # The line to the receiver passes the edge when the source is at x = -0.2.
    emitted = 0.04 * (0.6 - 0.2) / 1.2
    cut = emitted + math.hypot(0.4, 2.0) / C
    assert paths.end[1] == paths.start[0] == pytest.approx(cut, abs=1.0 / 16.0 / RATE)
    around = cut + np.array([-1e-4, 1e-4])
    gains = paths.table(around).gain
    assert np.isnan(gains[0, 0])
    assert np.isnan(gains[1, 1])
    cosine = 2.0 / math.hypot(0.4, 2.0)
    assert gains[1, 0] / gains[0, 1] == pytest.approx(law(0.02, cosine), rel=3e-3)  # 3 mm from the border


def test_an_edge_of_a_panel_adds_what_an_opaque_one_lacks() -> None:
    """Where the share T passes at all angles and 1 - T comes back, fields are T of the free one and 1 - T of a screen.

    On both sides of the border, at it, and on the source's side; the screen is rigid, its field that of the uniform
    theory.
    """
    share = 0.25
    loss = -20.0 * math.log10(share)
    panel = clsim.Material.from_reflection(1.0 - share).transmitting(frequencies=[1e3, 100e3], losses_db=[loss, loss])
    source = FIXED((-0.5, -1.0, 0.1))
    for place in ((0.7, 1.3, 0.0), (-0.9, 1.3, 0.2), (0.4999, 1.0, 0.1), (0.5001, 1.0, 0.1), (-1.2, -0.8, 0.0)):
        ends = source, FIXED(place)
        sums = [
            field(found(sheet(m, x=(-3.0, 0.0)), ends, 1, diffraction=1), np.zeros(1), TONE)[0] for m in (panel, RIGID)
        ]
        apart = math.dist(place, (-0.5, -1.0, 0.1))
        free = np.exp(-2j * np.pi * TONE * apart / C) / apart
        assert decibels(abs(sums[0] - share * free - (1.0 - share) * sums[1]) / abs(free)) < -150.0


def test_reflected_absorbed_and_transmitted_energy_are_one() -> None:
    f, cosine = np.geomspace(20.0, 100e3, 50)[:, None], np.linspace(0.05, 1.0, 20)
    for absorbed in (0.0, 0.36):
        panel = clsim.Material.from_reflection(math.sqrt(1.0 - absorbed)).transmitting(surface_mass=3.0)
        passed = np.abs(panel.passing.reflection_at(f, cosine)) ** 2
        total = panel.energy_at(f, cosine) + passed + absorbed * (1.0 - passed)
        assert np.abs(total - 1.0).max() < 1e-12
    with pytest.raises(clsim.InputError, match=r"transmission: must leave .* at 4000 Hz is 1\.06"):
        clsim.Material.from_reflection(0.9).transmitting(frequencies=[1e3, 4e3], losses_db=[20.0, 6.0])


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, "transmission: must have surface_mass, or frequencies and losses_db"),
        ({"surface_mass": 1.0, "frequencies": [1e3], "losses_db": [3.0]}, "transmission: must have surface_mass, or"),
        ({"surface_mass": 0.0}, "surface_mass: must be at least 0.001 kg/m²"),
        ({"frequencies": [1e3], "losses_db": [-1.0]}, r"losses_db\[0\]: must be from 0 to 300 dB, but is -1 dB"),
    ],
)
def test_bad_panels_are_refused(given: dict, problem: str) -> None:
    with pytest.raises(clsim.InputError, match=problem):
        RIGID.transmitting(**given)
