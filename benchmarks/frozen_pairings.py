"""Scenes of `frozen.py` for every kind of leg and vertex, and for every rendering method and medium.

Each takes a second or so, since the gate compares all of them.
"""

from typing import Any

import numpy as np
from frozen_files import L_PLAN, PILLAR, Arrays
from frozen_parts import BOX, RATE, Circle, Fixed, Line, chirp, ears, heard, one, prefixed, ring, scene, tone

import clsim

PLASTER = clsim.Material.from_reflection(0.8)
ROUGH = clsim.Material.from_absorption([125, 500, 2e3, 4e3], [0.1, 0.2, 0.3, 0.4], scattering=0.3)


def rendered(of: clsim.Scene, order: int, options: dict[str, Any] | None = None, **search: Any) -> Arrays:
    """Return the arrays of a rendering whose paths are found with more than an order."""
    return heard(of, order, search=search, **(options or {}))


def around_the_corner(duration: float, signal: clsim.Signal, **more: Any) -> clsim.Scene:
    """Return an L-shaped room with a pillar whose receiver comes out from behind the inner corner."""
    room = clsim.MeshRoom.from_plan(L_PLAN, 3.0, PLASTER, [PILLAR])
    place = Line((7.0, 1.0, 1.5), (5.2, 2.4, 1.6), duration)
    return clsim.Scene(
        room, clsim.Air(), [clsim.Source("s", signal, Fixed((1.2, 7.1, 1.4)))], [clsim.Receiver("r", place)], **more
    )


def door(duration: float, turn: float = 0.4) -> clsim.Body:
    """Return a sheet that turns about an upright axis in the middle of the box."""
    swing = clsim.Trajectory.swing((2.6, 1.2, 0.0), (0, 0, 1), [0.0, turn], [0.0, duration])
    return clsim.Body.box("door", (0.0, 0.9, 2.0), PLASTER, swing, (0.0, 0.5, 1.1))


def crate(duration: float) -> clsim.Body:
    """Return a box that drives by."""
    drive = Line((2.9, 2.9, 0.6), (3.2, 2.6, 0.6), duration)
    return clsim.Body.box("crate", (0.6, 0.5, 0.8), PLASTER, drive)


def ball(duration: float, model: str = "series") -> clsim.Scatterer:
    """Return a sphere of 3 cm that flies by."""
    return clsim.Scatterer.sphere("ball", 0.03, Line((3.3, 1.6, 1.1), (3.6, 1.9, 1.2), duration), model)


def in_the_box(duration: float, signal: clsim.Signal, **more: Any) -> clsim.Scene:
    """Return the box with a source and a receiver at rest and one that moves."""
    return clsim.Scene(BOX, clsim.Air(), [clsim.Source("s", signal, Fixed((1.1, 0.9, 1.2)))], ears(), **more)


@scene
def edges() -> Arrays:
    """Render one edge by both theories, and two edges of one face."""
    moving = around_the_corner(0.2, chirp(0.02))
    return prefixed(
        utd=rendered(moving, 1, diffraction=1),
        btm=rendered(moving, 1, diffraction=1, diffraction_model="btm"),
        two=rendered(moving, 1, diffraction=2),
    )


@scene
def bodies() -> Arrays:
    """Render a sheet that turns and a box that drives: mirrors, shadows, edges of bodies, and two edges of the box."""
    moving = in_the_box(0.1, chirp(0.02), bodies=[door(0.2), crate(0.2)])
    driving = in_the_box(0.1, chirp(0.02), bodies=[crate(0.2)])
    return prefixed(
        mirrors=rendered(moving, 1), edges=rendered(moving, 1, diffraction=1), two=rendered(driving, 0, diffraction=2)
    )


@scene
def edges_behind_bodies() -> Arrays:
    """Render an edge of the room together with a body's face on one path."""
    turning = clsim.Trajectory.swing((5.2, 5.0, 0.0), (0, 0, 1), [0.0, 0.3], [0.0, 0.2])
    panel = clsim.Body.box("panel", (0.0, 0.9, 2.0), PLASTER, turning, (0.0, 0.5, 1.1))
    room = clsim.MeshRoom.from_plan([(0, 0), (8, 0), (8, 6), (4, 6), (4, 4), (0, 4)], 3.0, PLASTER)
    source = clsim.Source("s", chirp(0.02), Fixed((1.2, 2.1, 1.4)))
    receiver = clsim.Receiver("r", Line((6.0, 4.6, 1.5), (6.2, 5.0, 1.6), 0.2))
    return rendered(clsim.Scene(room, clsim.Air(), [source], [receiver], bodies=[panel]), 2, diffraction=1)


@scene
def scatterers() -> Arrays:
    """Render a scatterer of every shape, also by walls."""
    flight = Line((2.2, 1.6, 1.1), (2.6, 1.3, 1.2), 0.2)
    drift = Line((3.0, 2.0, 1.0), (3.1, 2.3, 1.3), 0.2)
    kinds = {
        "series": ball(0.2),
        "geometrical": ball(0.2, "geometrical"),
        "ellipsoid": clsim.Scatterer.ellipsoid("e", (0.05, 0.03, 0.08), drift),
        "capsule": clsim.Scatterer.capsule("c", 0.03, 0.2, drift),
        "point": clsim.Scatterer.point("p", -30.0, flight),
    }
    return prefixed(
        **{
            name: rendered(in_the_box(0.1, tone(0.02), scatterers=[x]), 1, scattering_order=1)
            for name, x in kinds.items()
        }
    )


@scene
def edges_and_scatterers() -> Arrays:
    """Render a sphere that the inner corner hides from the receiver, and then from neither end."""
    flight = clsim.Scatterer.sphere("ball", 0.03, Line((1.5, 3.0, 1.2), (3.5, 3.2, 1.2), 0.2))
    room, ends = clsim.MeshRoom.from_plan(L_PLAN, 3.0, PLASTER), (Fixed((1.2, 7.1, 1.4)), Fixed((6.0, 1.0, 1.5)))
    source, receiver = clsim.Source("s", tone(0.02), ends[0]), clsim.Receiver("r", ends[1])
    still = clsim.Scene(room, clsim.Air(), [source], [receiver], scatterers=[flight])
    return rendered(still, 0, diffraction=1, edge_scattering=True)


@scene
def scatterers_behind_bodies() -> Arrays:
    """Render a sphere seen by a body's face, one by a wall that a body hides."""
    moving = in_the_box(0.1, chirp(0.02), bodies=[door(0.2)], scatterers=[ball(0.2)])
    return rendered(moving, 1, scattering_order=1)


@scene
def tails() -> Arrays:
    """Render a diffuse tail of a receiver at rest and of one that moves."""
    room = clsim.Shoebox((5.0, 4.0, 3.0), ROUGH)
    sound = clsim.Signal.noise(0.1, 16e3, 1, (300, 4e3))
    options = {"tail": "auto", "tail_error_db": 3.0, "tail_directions": 16, "duration": 0.3}
    still = one(room, sound, Fixed((1.1, 0.9, 1.2)), ears()[:1])
    moving = one(room, sound, Fixed((1.1, 0.9, 1.2)), ears()[1:])
    found = {
        name: clsim.render(clsim.find_paths(s, 1), 16e3, **options)
        for name, s in (("still", still), ("moving", moving))
    }
    return {name: recording.samples for name, recording in found.items()}


@scene
def media() -> Arrays:
    """Render wind, air by height, dispersion, and fluctuation."""
    kinds = {
        "wind": clsim.Air(wind=(1.0, -2.0, 0.3)),
        "layered": clsim.Air(temperature_celsius=(18.0, 26.0), heights=(0.0, 3.0)),
        "dispersive": clsim.Air(dispersion=True),
        "fluctuating": clsim.Air(fluctuation=clsim.Fluctuation(1e-6, 0.05, 0.3, seed=2)),
    }
    source = [clsim.Source("s", chirp(0.02), ring(0.1))]
    return prefixed(**{name: heard(clsim.Scene(BOX, air, source, ears()), 1) for name, air in kinds.items()})


@scene
def narrow_bands() -> Arrays:
    """Render a tone, and two tones far apart, as complex envelopes and at the full rate."""
    t = np.arange(round(0.1 * RATE)) / RATE
    tones = np.sin(np.pi * t / 0.1) ** 2 * (np.sin(2e3 * np.pi * 40.0 * t) + np.sin(2e3 * np.pi * 25.0 * t))
    both = clsim.Signal.from_array(tones, RATE)
    moving = {"tone": one(BOX, tone(0.1), ring(0.1), ears()), "two": one(BOX, both, ring(0.1), ears()[:1])}
    made = {name: heard(of, 2, narrowband=True) for name, of in moving.items()}
    return prefixed(plain=heard(moving["tone"], 2, narrowband=False), **made)


@scene
def baseband_of_bodies() -> Arrays:
    """Render complex envelopes where a body and a sphere move."""
    moving = in_the_box(0.1, tone(0.05), bodies=[door(0.2)], scatterers=[ball(0.2)])
    return rendered(moving, 1, {"baseband": (40e3, 6e3)}, scattering_order=1, diffraction=1)


@scene
def blocks() -> Arrays:
    """Render slow motion, which has the longest blocks, and shaking, which has the shortest."""
    slow = one(BOX, tone(0.1), Line((2.0, 2.0, 1.2), (2.0, 2.01, 1.2), 0.1), ears()[:1])
    quick = one(BOX, tone(0.02), Circle((2.4, 2.1, 1.5), 0.01, 0.005, 0.02), ears()[:1])
    return prefixed(long=heard(slow, 1), short=heard(quick, 1))
