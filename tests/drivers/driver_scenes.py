"""Small scenes that run every kernel with every option."""

import dataclasses
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from made_rays import box, run_in, traced, with_a_sheet
from made_responses import POROUS, ROUGH, Lopsided, OffCentre

import clsim
from clsim.opencl import device as device_module
from clsim.paths.path_set import PathSet
from clsim.render.diffuse_tail import DeviceWaves
from clsim.render.methods.ear_channel import EarChannelEngine
from clsim.render.methods.ear_components import Heads as Components
from clsim.render.methods.ears import EarEngine
from clsim.render.opencl.channel_engine import ChannelEngine, TaperedEngine
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT
from clsim.render.plan import Plan
from clsim.render.planning import BUILDERS, plan_render
from clsim.render.tilt import Stretches
from clsim.sensitivity.adjoint import MomentEngine
from clsim.tail.device_rays import GROUP, DeviceRays
from clsim.tail.streams import NODE, Between, Motion
from clsim.tracks.splines import Pieces

RATE = 192e3
SAMPLES = 192
SCENES: dict[str, Callable[[str], Any]] = {}  # plans, and what has a method `heard`
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
REAL = [clsim.Material.from_reflection(f) for f in (0.9, -0.8, 0.7, 0.6, -0.5, 0.8)]
CURTAIN = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])
SWEEP = clsim.Signal.chirp(37e3, 43e3, 0.02, RATE, window="tukey")
# Paths of a batch, to which scenes are filled up: at least as many as workers share. `make drivers` has 64, as by default.
BATCHES = {"pulses.cpu": 64, "crowd.cpu": 64, "plain.gpu": 32, "pulses.gpu": 32}
# Terms of sixteen paths of an envelope lie side by side.
BATCHES |= {
    f"{name}.{layout}": 16
    for name in ("baseband", "baseband_bend", "baseband_pulses", "baseband_tilted")
    for layout in ("cpu", "gpu")
}
FEWEST = 64 if os.environ.get("CLSIM_ALL_DRIVERS") else 8
LAYOUTS = {"cpu": CPU_LAYOUT, "gpu": GPU_LAYOUT}
DISPERSING, WINDY = clsim.Air(dispersion=True), clsim.Air(wind=(9.0, -4.0, 1.0))
CLOCK = clsim.Electronics(clock_ppm=300.0, clock_offset=1e-5)


def scene(make: Callable[[str], Any]) -> Callable[[str], Any]:
    """Enter a function that returns the plan of a scene for a device, by its name."""
    SCENES[make.__name__] = make
    return make


def world(
    signal: clsim.Signal = SWEEP,
    walls: list | None = None,
    beams: tuple = (clsim.Omni(), clsim.Omni()),
    still: bool = False,
    air: clsim.Air | None = None,
) -> clsim.Scene:
    """Return a box in which all moves, 6 cm apart, and in which the signal has been on for a while."""
    way = LINE((0.05, 0.045, 0.05), (0.06, 0.04, 0.055), 0.04)
    ear = FIXED((0.10, 0.08, 0.06)) if still else LINE((0.10, 0.08, 0.06), (0.09, 0.085, 0.06), 0.04)
    return clsim.Scene(
        clsim.Shoebox((0.16, 0.13, 0.11), walls or REAL), air or clsim.Air(),
        [clsim.Source("s", signal, way, beams[0], aim=(1, 0.3, -0.2))],
        [clsim.Receiver("r", ear, beams[1], aim=(-0.8, 0.1, 0.4), electronics=None if still else CLOCK)],
    )  # fmt: skip


def plan(
    of: clsim.Scene | PathSet, device: str, order: int = 1, blocks: tuple[int, ...] = (96,), **options: Any
) -> Plan:
    """Return a plan, short and with short filters, in blocks of given lengths."""
    given = {"interpolator": clsim.Bandlimited(-45.0), "response_error_db": -45.0, "duration": SAMPLES / RATE}
    paths = clsim.find_paths(of, order) if isinstance(of, clsim.Scene) else of
    made = plan_render(paths, RATE, device=device, convolve_static=False, **given | options)
    return dataclasses.replace(made, blocks=blocks, builders=BUILDERS) if blocks else made


def partly(of: clsim.Scene, until: float) -> PathSet:
    """Return the paths of a scene, every other one of which begins or ends on the way."""
    paths = clsim.find_paths(of, 1)
    k = np.arange(len(paths))
    start, end = np.where(k % 3 == 1, 0.4 * until, -np.inf), np.where(k % 3 == 2, 0.6 * until, np.inf)
    return dataclasses.replace(paths, families=(dataclasses.replace(paths.families[0], start=start, end=end),))


@scene
def plain(device: str) -> Plan:
    """One function, no directivity, receivers at rest."""
    return plan(world(still=True), device, responses="centre")


@scene
def functions(device: str) -> Plan:
    """Walls and directivities by frequency, real, and images where they are at reception."""
    beams = (clsim.Piston(0.004), clsim.FirstOrder(0.4))
    return plan(world(walls=[CURTAIN, *REAL[1:]], beams=beams), device, motion="quasi-static")


@scene
def harmonics(device: str) -> Plan:
    """Four ambisonic components of a receiver that turns, for several functions of frequency."""
    beams = (clsim.Piston(0.004), clsim.Ambisonic(1))
    return plan(world(walls=[CURTAIN, *REAL[1:]], beams=beams), device)


@scene
def components(device: str) -> Plan:
    """Four ambisonic components of one function of frequency: gains that do not fill their vector."""
    return plan(world(beams=(clsim.Omni(), clsim.Ambisonic(1))), device, responses="centre")


@scene
def phased(device: str) -> Plan:
    """Walls that depend on the angle, with phases, and so does a directivity, in air that disperses."""
    beams = (OffCentre(2e-3), clsim.FirstOrder(0.4))
    return plan(world(walls=[POROUS, ROUGH, *REAL[2:]], beams=beams, air=DISPERSING), device)


@scene
def fine(device: str) -> Plan:
    """Short blocks, and paths that come and go at once."""
    return plan(partly(world(), 0.001), device, blocks=(24,), transition=0.0)


@scene
def doubled(device: str) -> Plan:
    """A band up to half the sampling rate, by branch signals of twice the rate; with paths that come and go."""
    high = clsim.Signal.chirp(88e3, 92e3, 0.02, RATE, window="tukey")
    return plan(partly(world(high, still=True), 0.001), device, responses="centre")


@scene
def pulses(device: str) -> Plan:
    """Silence between pulses, several functions, and paths that come and go."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, 0.2e-3, RATE, window="hann"), 0.75e-3, 2)
    return plan(partly(world(pulse, walls=[CURTAIN, *REAL[1:]]), 0.0012), device, duration=0.0015)


@scene
def mesh(device: str) -> Plan:
    """Paths searched for on the device, round a folded screen and over its edges, with transitions, in wind."""
    corners = [(0.08, 0.02, 0.0), (0.08, 0.0601, 0.0), (0.08, 0.0601, 0.1), (0.08, 0.02, 0.1)]
    corners += [(0.09, 0.02, 0.05), (0.09, 0.0601, 0.05)]
    screen = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (1, 5, 2)], REAL[0])
    way, ear = LINE((0.05, 0.05, 0.05), (0.05, 0.07, 0.05), 0.02), LINE((0.10, 0.08, 0.05), (0.10, 0.085, 0.05), 0.02)
    of = clsim.Scene(screen, WINDY, [clsim.Source("s", SWEEP, way)], [clsim.Receiver("r", ear)])
    return plan(clsim.find_paths(of, 1, diffraction=2, resolution=1e-3), device, responses="centre")


def over_edges() -> PathSet:
    """Find paths over edges, and over ends of them, in air that rests."""
    corners = [(0.08, 0.02, 0.0), (0.08, 0.06, 0.0), (0.08, 0.06, 0.1)]
    screen = clsim.MeshRoom(corners, [(0, 1, 2)], REAL[0])
    way, ear = LINE((0.05, 0.04, 0.05), (0.05, 0.08, 0.05), 0.04), LINE((0.10, 0.08, 0.05), (0.10, 0.09, 0.05), 0.04)
    of = clsim.Scene(screen, clsim.Air(), [clsim.Source("s", SWEEP, way)], [clsim.Receiver("r", ear)])
    return clsim.find_paths(of, 0, diffraction=1, resolution=1e-3)


@scene
def bend(device: str) -> Plan:
    """Nodes of paths over edges."""
    return plan(over_edges(), device, responses="centre")


@scene
def swinging(device: str) -> Plan:
    """Paths by a door that depends on the angle, and by a box, in wind: two mirrors that move on a path."""
    still = world(walls=[POROUS, *REAL[1:]], beams=(clsim.Piston(0.004), clsim.FirstOrder(0.4)), air=WINDY)
    hinge = clsim.Trajectory.swing((0.06, 0.10, 0.0), (0, 0, 1), [0.0, 0.002, 0.01], [0.0, 0.02, 0.04])
    door = clsim.Body.box("door", (0.08, 0.0, 0.1), POROUS, hinge, centre=(0.045, 0.0, 0.055))
    slide = clsim.Body.box("slide", (0.0, 0.08, 0.1), REAL[1], LINE((0.02, 0.05, 0.055), (0.021, 0.05, 0.055), 0.04))
    of = dataclasses.replace(still, bodies=(door, slide))
    found = clsim.find_paths(of, 2).families[-1]
    some = found.part(np.arange(0, len(found), 2))  # no more than are looked at side by side, the last by both
    return plan(PathSet(of, (some,)), device, duration=96 / RATE)


def among_things(device: str, family: int, step: int) -> Plan:
    """Return the plan of every so many paths of a family: images, paths by things, and shadows on images, in wind."""
    turned = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.1, 0.2, 0.97468]]
    way = clsim.Trajectory.waypoints([0.0, 0.04], [(0.08, 0.06, 0.05), (0.08, 0.061, 0.05)], turned)
    things = [
        clsim.Scatterer.ellipsoid("e", (0.004, 0.012, 0.008), way),
        clsim.Scatterer.capsule("c", 0.003, 0.012, LINE((0.05, 0.1, 0.03), (0.05, 0.1, 0.031), 0.04)),
        clsim.Scatterer.ellipsoid("f", (0.004, 0.006, 0.005), FIXED((0.07, 0.06, 0.06)), shadow=True),
        clsim.Scatterer.capsule("d", 0.003, 0.004, FIXED((0.07, 0.07, 0.06)), shadow=True),
        clsim.Scatterer.sphere("b", 0.005, FIXED((0.03, 0.1, 0.08))),
        clsim.Scatterer.point("p", -40.0, LINE((0.12, 0.03, 0.03), (0.12, 0.03, 0.031), 0.04)),
    ]
    of = dataclasses.replace(world(air=WINDY), scatterers=things)
    found = clsim.find_paths(of, 0, scattering_order=1).families[family]
    few = np.arange(0, len(found), step)
    paths = PathSet(of, (found.part(few),))
    made = plan(paths, device, responses="centre", duration=96 / RATE, scattering_error_db=None)
    (part,) = made.allocation.scattered  # all of them
    return dataclasses.replace(part.plan, blocks=(96,), builders=BUILDERS)


@scene
def sonar(device: str) -> Plan:
    """Paths by an ellipsoid that turns, by a capsule and a sphere, which have phases, and by a point, with walls."""
    return among_things(device, -2, 26)  # of each one with walls on both legs, and one with fewer


@scene
def shadows(device: str) -> Plan:
    """Shadows of an ellipsoid and a capsule on the direct sound."""
    return among_things(device, -1, 1)


@scene
def crowd(device: str) -> Plan:
    """More walls than are looked up by NumPy: a floor, and tiles over and under it."""
    corners, faces = [(-0.1, -0.1, 0.0), (0.3, -0.1, 0.0), (0.3, 0.3, 0.0), (-0.1, 0.3, 0.0)], [(0, 1, 2), (0, 2, 3)]
    for k in range(64):
        height = 0.1 + 1e-4 * k if k < 12 else -0.1 - 1e-4 * k  # most are hidden by the floor: simulating takes long
        x, y, z, first = 0.02 * (k % 12), 0.02 * (k // 12), height, len(corners)
        corners += [(x, y, z), (x + 0.01, y, z), (x, y + 0.01, z)]
        faces.append((first, first + 1, first + 2))
    way, ear = LINE((0.05, 0.04, 0.05), (0.05, 0.06, 0.05), 0.04), FIXED((0.10, 0.08, 0.06))
    room = clsim.MeshRoom(corners, faces, REAL[0])
    of = clsim.Scene(room, clsim.Air(), [clsim.Source("s", SWEEP, way)], [clsim.Receiver("r", ear)])
    return plan(of, device, 2, responses="centre")


def envelopes(device: str, of: clsim.Scene | PathSet, **options: Any) -> Plan:
    return plan(of, device, **{"blocks": (), "baseband": (40e3, 12e3)} | options)


@scene
def baseband(device: str) -> Plan:
    """Complex envelopes, in wind."""
    return envelopes(device, world(walls=[CURTAIN, *REAL[1:]], air=WINDY), blocks=(96,))


@scene
def baseband_bend(device: str) -> Plan:
    """Complex envelopes round edges, whose functions of frequency come in pairs."""
    return envelopes(device, over_edges(), blocks=(96,))


@scene
def baseband_pulses(device: str) -> Plan:
    """Complex envelopes with silence, and paths that come and go."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(39.5e3, 40.5e3, 2e-3, RATE, window="hann"), 15e-3, 2)
    return envelopes(device, partly(world(pulse), 0.03), duration=0.035)


@scene
def baseband_tilted(device: str) -> Plan:
    """Complex envelopes with imaginary delays, about the middles of two stretches."""
    made = envelopes(device, world(still=True), blocks=(96,))
    filters = made.source_filters[0]
    taps, gains = (np.concatenate([x, x]) for x in (filters.mixer.taps, filters.mixer.gains))
    filters = dataclasses.replace(
        filters, banks=2 * filters.banks, mixer=dataclasses.replace(filters.mixer, taps=taps, gains=gains),
        stretches=Stretches(per_sample=0.01, length=6.0, count=2),
    )  # fmt: skip
    return dataclasses.replace(made, source_filters=(filters,), builders=BUILDERS)


@scene
def pairs_pulses(device: str) -> Plan:
    """Without float64: silence between pulses."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, 0.2e-3, RATE, window="hann"), 1.5e-3, 2)
    return plan(world(pulse, still=True), device, 0, responses="centre", duration=0.003)


@dataclasses.dataclass(frozen=True)
class Heads:
    """Each path on its own at the centre of a head."""

    device: str

    def heard(self, lanes: int) -> np.ndarray:
        heads = plan(world(beams=(clsim.Omni(), clsim.SphericalHead())), self.device, blocks=())
        centres = heads.allocation.ears[0].plan
        centres = dataclasses.replace(centres, blocks=(96,), builders=[])
        signals: list[np.ndarray] = []

        class Frames:
            """Takes the sound of paths."""

            def add(self, pair: int, rows: np.ndarray, found: np.ndarray, first: int) -> None:
                signals.append(np.array(found[: len(rows)]))

        layout = next(layout for layout in LAYOUTS.values() if layout.lanes == lanes)
        EarEngine(centres, layout).filter(Frames(), 0, centres.samples)
        return np.concatenate(signals)


@dataclasses.dataclass(frozen=True)
class Streams:
    """Streams of a diffuse tail, one of which two listeners that move do not hear."""

    device: str

    def heard(self, lanes: int) -> np.ndarray:
        drawn = np.random.default_rng(5)
        streams = drawn.standard_normal((3, 180)).astype(np.float32)  # from sample -40 on
        gains = np.stack([drawn.uniform(0.5, 1.0, (2, 4)), np.zeros((2, 4)), drawn.uniform(-1.0, 1.0, (2, 4))], -1)
        motion = Motion(drawn.uniform(-3.0, 3.0, (2, 1, 3)) + 0.3 * np.arange(4)[:, None], gains)
        waves = DeviceWaves(Between.up_to(40e3, RATE, 0.3 / NODE), self.device, lanes)
        return waves.received(streams, -40, motion, 5, 95)


@scene
def waves(device: str) -> Streams:
    """A diffuse tail's plane waves."""
    return Streams(device)


@dataclasses.dataclass(frozen=True)
class Rays:
    """Energies of rays in a convex room, and in one with a corner and a sheet where walls scatter by their size."""

    device: str

    def heard(self, lanes: int) -> np.ndarray:
        engine, tables = DeviceRays(device_module.find_device(self.device), min(lanes, GROUP)), []
        for make, sized in ((box, False), (with_a_sheet, True)):
            found = traced(engine, *run_in(make(), sized=sized, each=1))
            tables += [getattr(found, name).ravel() for name in found.TABLES]
        return np.concatenate(tables).astype(float)


@scene
def rays(device: str) -> Rays:
    """A diffuse tail's rays."""
    return Rays(device)


@dataclasses.dataclass(frozen=True)
class Channels:
    """Sound by the impulse responses of nodes, for several functions of frequency."""

    plan: Plan

    def heard(self, lanes: int) -> np.ndarray:
        pressure = np.zeros((1, self.plan.samples))
        ChannelEngine(self.plan, 64).add(pressure, 0)
        return pressure


@scene
def channels(device: str) -> Channels:
    """Impulse responses of a receiver at nodes."""
    return Channels(plan(world(walls=[CURTAIN, *REAL[1:]]), device))


@dataclasses.dataclass(frozen=True)
class EarChannels:
    """Sound by impulse responses of the components of a head at nodes."""

    scene: clsim.Scene
    plan: Plan

    def heard(self, lanes: int) -> np.ndarray:
        tracks = self.plan.tracks.of_scene
        heads = Components.among(self.scene, tracks, self.plan.source_filters, RATE)
        pressure = np.zeros((2, self.plan.samples), np.float32)
        EarChannelEngine(self.plan, 64, heads).add_ears(np.zeros(1, np.int32), pressure, 0)
        return pressure


@scene
def ear_channels(device: str) -> EarChannels:
    """A head of few components: at low frequencies."""
    low = clsim.Signal.chirp(1e3, 4e3, 0.02, RATE, window="tukey")
    one = world(low, beams=(clsim.Omni(), clsim.SphericalHead()))
    ears = plan(one, device, blocks=()).allocation.ears[0].plan
    return EarChannels(one, dataclasses.replace(ears, blocks=(96,), builders=[]))


@dataclasses.dataclass(frozen=True)
class Tapered:
    """What sampled channels take of paths that begin and end, and what the sum over paths keeps of them."""

    plan: Plan

    def heard(self, lanes: int) -> np.ndarray:
        pressure, tracks = np.zeros((1, self.plan.samples)), self.plan.tracks
        (pair,) = tracks.pairs
        found = Pieces.of(pair.start, pair.end, np.empty((len(pair), 0)), 1.0)
        none = np.zeros(len(pair), np.bool_)
        taken, left = (
            dataclasses.replace(self.plan, tracks=tracks.with_rows({0: rows}), builders=BUILDERS)
            for rows in found.handed_over(none, 0.6e-3, tracks.transition)
        )
        ChannelEngine(taken, 64).add(pressure, 0)
        return np.concatenate([pressure, TaperedEngine(left).render(0, left.samples)])


@scene
def tapered(device: str) -> Tapered:
    """Paths that begin and end between pulses."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, 0.2e-3, RATE, window="hann"), 0.75e-3, 2)
    return Tapered(plan(partly(world(pulse, walls=[CURTAIN, *REAL[1:]]), 0.0024), device, duration=0.0024))


@dataclasses.dataclass(frozen=True)
class Moments:
    """Moments of what arrives, times weights, for several functions of frequency."""

    plan: Plan

    def heard(self, lanes: int) -> np.ndarray:
        layout = next(layout for layout in LAYOUTS.values() if layout.lanes == lanes)
        weights, taken = np.random.default_rng(6).standard_normal((1, self.plan.samples)), []
        MomentEngine(self.plan, layout).taken(weights, lambda *given: taken.append(given[-1].ravel()))
        return np.concatenate(taken)


@scene
def heads(device: str) -> Heads:
    """The sound of each path on its own."""
    return Heads(device)


@scene
def moments(device: str) -> Moments:
    """The transpose of the sum over paths, some of which come and go."""
    return Moments(plan(partly(world(walls=[CURTAIN, *REAL[1:]]), 0.0005), device))


# The last ones, as their tables are large: after every launch Oclgrind clears notes of all memory that there is.
@scene
def lopsided(device: str) -> Plan:
    """Directivities without symmetry, and the Mach factor squared."""
    return plan(world(beams=(Lopsided(False), Lopsided(True))), device, 0, amplitude="convective")


@scene
def pairs(device: str) -> Plan:
    """Without float64: beams, and ends that move, with clocks, in air that disperses."""
    beams = (clsim.Piston(0.004), Lopsided(True))
    return plan(world(walls=[CURTAIN, *REAL[1:]], beams=beams, air=DISPERSING), device, 0)
