"""The scenes of `frozen.py`, which starts this file: writes the arrays of each into FOLDER/NAME.npz.

Usage: frozen_scenes.py CHECKOUT FOLDER [NAME...]; PYTHONPATH must begin with the checkout.
"""

import json
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import either
import frozen_pairings  # noqa: F401 - its scenes enter themselves
import numpy as np
import tomli_w
from frozen_files import L_PLAN, PILLAR, Arrays, clock_scene, command, results, written_scene
from frozen_parts import (
    BOX,
    RATE,
    SCENES,
    WALL,
    Fixed,
    Line,
    chirp,
    columns,
    ears,
    heard,
    one,
    prefixed,
    ring,
    scene,
    tone,
)

import clsim


@scene
def shoebox_by_frequency() -> Arrays:
    """Order 3, walls by frequency, pistons, everything moves."""
    curtain = clsim.Material.from_table([20e3, 30e3, 45e3, 60e3], [0.8, 0.5, 0.35, 0.3])
    carpet = clsim.Material.from_absorption([10e3, 40e3, 80e3], [0.2, 0.5, 0.8])
    room = clsim.Shoebox((5.0, 4.0, 3.0), {"default": WALL, "x_min": curtain, "z_min": carpet})
    beam = clsim.Piston(0.0047)
    receivers = ears(directivity=beam, aim=(0.3, 0.4, -0.5))
    return heard(one(room, chirp(0.1), ring(0.1), receivers, directivity=beam, aim=(1.0, 0.2, 0.1)), 3)


@scene
def many_paths() -> Arrays:
    """Order 8, 833 paths to each receiver, short."""
    return heard(one(BOX, tone(0.03), ring(0.03), ears()), 8, duration=0.06)


@scene
def mesh() -> Arrays:
    """Paths that begin and end behind a pillar and round the corner of an L, two receivers."""
    materials = {"default": WALL, "floor": clsim.Material.from_reflection(0.5)}
    room = clsim.MeshRoom.from_plan(L_PLAN, 3.0, materials, [PILLAR])
    walk = Line((0.7, 5.0, 1.4), (3.3, 2.7, 1.5), 0.5)
    receivers = [clsim.Receiver("a", Fixed((7.2, 1.2, 2.0))), clsim.Receiver("b", Line((1, 1, 1), (3, 1, 1), 1.0))]
    moving = one(room, tone(0.5), walk, receivers)
    paths = clsim.find_paths(moving, 2)
    assert np.isfinite(paths.end).any()
    assert (paths.start > 0.0).any()
    by_host = columns(clsim.find_paths(moving, 1, engine="reference"), 0.5)
    gated = either.render(clsim.find_paths(moving, 1), RATE, transition="gate", duration=0.1)
    return heard(moving, 2) | prefixed(reference=by_host) | {"gate.samples": gated.samples}


@scene
def walls_by_angle() -> Arrays:
    """Complex walls that depend on angle, in a box and on an open screen within it."""
    panel = clsim.Material.from_impedance([20e3, 40e3, 60e3], [3.0 - 1.0j, 2.0 - 0.4j, 1.5 + 0.3j])
    stone, wool = clsim.Material.from_solid(2300.0, 3500.0), clsim.Material.from_porous(50e3, 0.02)
    phase = clsim.Material.from_reflection(0.7 * np.exp(0.5j))
    walls = [panel, stone, wool, WALL, stone, phase]
    box = clsim.Shoebox((5.0, 4.0, 3.0), walls)
    corners = [(3.0, 1.0, 0.5), (3.0, 2.5, 0.5), (3.1, 2.5, 2.0), (3.1, 1.0, 2.0)]
    screen = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], panel)
    joined = clsim.MeshRoom.joined([box, screen])
    return prefixed(
        box=heard(one(box, chirp(0.03, 38e3, 42e3), ring(0.03), ears()), 2),
        screen=heard(one(joined, tone(0.03), ring(0.03), ears()), 1),
    )


@scene
def baseband() -> Arrays:
    """Complex envelopes of ends that move, walls by frequency; and at rest."""
    room = clsim.Shoebox((5.0, 4.0, 3.0), {"default": WALL, "y_max": clsim.Material.from_porous(50e3, 0.02)})
    narrow = chirp(0.1, 39e3, 41e3)
    still = one(BOX, narrow, Fixed((2.0, 2.1, 1.2)), ears()[:1])
    return prefixed(
        moving=heard(one(room, narrow, ring(0.1), ears()), 2, baseband=(40e3, 5e3)),
        still=heard(still, 3, baseband=(40e3, 4e3)),
    )


@scene
def static_pairs() -> Arrays:
    """Pairs at rest, convolved and path by path."""
    still = one(BOX, clsim.Signal.noise(0.1, RATE, 1, (35e3, 45e3)), Fixed((2.0, 2.1, 1.2)), ears()[:1])
    both = clsim.receiver_array("x", clsim.grid_positions((0.5, 4.5, 3), (0.4, 3.6, 2), 2.9))
    several = one(BOX, chirp(0.05), Fixed((2.0, 2.1, 1.2)), both)
    plain = heard(still, 4, convolve_at_rest=False)
    return prefixed(convolved=heard(still, 4), by_path=plain, several=heard(several, 2))


@scene
def static_and_moving() -> Arrays:
    """Two sources, of which one starts late, and two receivers; one of each moves."""
    sources = [
        clsim.Source("still", chirp(0.08), Fixed((2.0, 2.1, 1.2)), start=0.01),
        clsim.Source("moves", tone(0.08, 33e3), ring(0.1)),
    ]
    return heard(clsim.Scene(BOX, clsim.Air(25.0, 0.3), sources, ears()), 2)


@scene
def electronics() -> Arrays:
    """Transducers, noise, filters, converter, clocks; also a transducer of a table and one of samples."""
    end = clsim.Electronics(
        ambient_noise_db=0.0, self_noise_db=8.0, seed=1, low_cut=20e3, high_cut=80e3, gain_db=60.0,
        adc_bits=12, adc_full_scale=0.01, clock_ppm=200.0, clock_offset=1e-3,
    )  # fmt: skip
    table = clsim.Transducer.from_table([10e3, 40e3, 90e3], [0.5, 1.0, 0.3], outside="zero")
    taps = clsim.Transducer.from_impulse_response(np.exp(-np.arange(40.0) / 8.0), RATE)
    receivers = [
        clsim.Receiver("a", Fixed((0.9, 0.7, 2.6)), transducer=either.named_transducer("MA40S4R"), electronics=end),
        clsim.Receiver("b", ears()[1].trajectory, transducer=table, electronics=clsim.Electronics(clock_ppm=-5000.0)),
        clsim.Receiver("c", Fixed((4.1, 0.7, 1.6)), transducer=taps),
        clsim.Receiver(
            "d", Fixed((4.1, 2.7, 1.6)), electronics=clsim.Electronics(snr_db=20.0, reference_level_db=90.0)
        ),
    ]
    burst = clsim.Signal.tone(40e3, 2e-3, RATE, amplitude=10.0)
    speaker = {"directivity": either.named_directivity("MA40S4S"), "transducer": either.named_transducer("MA40S4S")}
    return prefixed(
        moving=heard(one(BOX, burst, ring(0.05), receivers, aim=(1, 0, 0), **speaker), 2, duration=0.045),
        still=heard(one(BOX, burst, Fixed((2.0, 2.1, 1.2)), receivers, aim=(1, 0, 0), **speaker), 2, duration=0.045),
    )


@scene
def pulses() -> Arrays:
    """Bursts with silence between them, in chunks, and from a later chunk on."""
    train = clsim.Signal.pulses(clsim.Signal.chirp(35e3, 45e3, 1e-3, RATE, window="hann"), 0.1, 5)
    moving = one(clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.4)), train, ring(0.5), ears())
    whole = heard(moving, 2)
    plan = either.plan_render(clsim.find_paths(moving, 2), RATE, chunk=18432)
    pieces = [samples for _, samples in clsim.render_chunks(plan)]
    later = [samples for _, samples in clsim.render_chunks(plan, first=2 * plan.chunk)]
    return whole | {"chunks": np.concatenate(pieces, axis=1), "later": np.concatenate(later, axis=1)}


@scene
def engines() -> Arrays:
    """Both engines and every interpolator on one short scene."""
    short = one(BOX, tone(0.008), ring(0.008), ears())
    kinds = {
        "opencl": {},
        "exact": {"engine": "reference"},
        "lagrange": {"interpolator": clsim.Lagrange(7), "response_error_db": "centre"},
        "truncated": {"interpolator": clsim.TruncatedLagrange(31, 12)},
        "coarse": {"interpolator": clsim.Bandlimited(-60.0)},
    }
    rendered = {n: heard(short, 1, duration=0.02, **more) for n, more in kinds.items()}
    envelope = heard(short, 1, duration=0.02, engine="reference", baseband=(40e3, 4e3))
    return prefixed(envelope=envelope, **rendered)


@scene
def quasi_static() -> Arrays:
    """Images where they are when sound is received, and all laws of amplitude."""
    moving = one(BOX, tone(0.05), ring(0.05), ears())
    return prefixed(
        quasi=heard(moving, 2, motion="quasi-static", amplitude="static"),
        convective=heard(moving, 2, amplitude="convective"),
        centre=heard(moving, 2, response_error_db="centre", quietest_db=-30.0),
    )


@scene
def sampled_tracks() -> Arrays:
    """Tracks that anybody computed, of two sources and two receivers, with a gap."""
    times = np.linspace(0.0, 0.1, 101)
    delays = np.array([0.010 + 2e-4 * np.sin(60.0 * times), 0.012 + 0.01 * times, 0.008 - 0.005 * times])
    gains = np.array([0.3 + 0.1 * np.cos(40.0 * times), 0.2 + 0.0 * times, 0.1 + times])
    delays[1, 40:60] = gains[1, 40:60] = np.nan
    tracks = clsim.Tracks.from_samples(times, delays, gains, sources=[0, 0, 1], receivers=[0, 1, 1])
    signals = [tone(0.08), chirp(0.05)]
    recording = either.render_tracks(signals, tracks, RATE, starts=[0.0, 0.02])
    return {"samples": recording.samples}


@scene
def responses() -> Arrays:
    """Impulse responses of a box with moving ends and of a mesh."""
    box = clsim.find_paths(one(BOX, tone(0.1), ring(0.1), ears()), 4)
    plan = clsim.MeshRoom.from_plan(L_PLAN, 3.0, clsim.Material.from_porous(50e3, 0.02), [PILLAR])
    room = clsim.find_paths(one(plan, tone(0.1), Fixed((1.0, 5.0, 1.4)), [clsim.Receiver("r", Fixed((1, 1, 1)))]), 2)
    found = {
        "moving": either.impulse_responses(box, RATE, at=0.05, band=(20e3, 60e3)),
        "kept": either.impulse_responses(box, 48e3, at=0.0, lead="keep"),
        "mesh": either.impulse_responses(room, RATE, band=(25e3, 40e3)),
    }
    return {
        f"{n}.{a}": np.array(getattr(r, a)) for n, r in found.items() for a in ("samples", "lead", "first_arrivals")
    }


@scene
def oversampled() -> Arrays:
    """Bands that reach nearly to half the sampling rate."""
    top = clsim.Signal.noise(0.03, RATE, 3, (60e3, 92.5e3))
    slow = Line((2.0, 2.0, 1.2), (2.0, 2.02, 1.2), 0.03)
    moving = {"tone": one(BOX, tone(0.03, 92.5e3), slow, ears()[:1]), "noise": one(BOX, top, slow, ears()[:1])}
    return prefixed(**{name: heard(of, 1) for name, of in moving.items()})


@scene
def near_and_fast() -> Arrays:
    """Pass a receiver at 12 mm and 20 m/s: fine blocks."""
    line = Line((2.5, 2.5, 2.0), (3.5, 2.5, 2.0), 0.05)
    close = [clsim.Receiver("r", Fixed((3.02, 2.512, 2.0)))]
    room = clsim.Shoebox((6.0, 5.0, 4.0), WALL)
    train = clsim.Signal.pulses(clsim.Signal.tone(40e3, 4e-3, RATE, fade=1e-3), 8e-3, 5)
    return prefixed(
        tone=heard(one(room, tone(0.05), line, close), 0),
        pulses=heard(one(room, train, line, close), 1),
        envelope=heard(one(room, tone(0.05), line, close), 0, baseband=(40e3, 12e3)),
    )


@scene
def directivities() -> Arrays:
    """Tables about an axis and over the sphere, first order, a library's beam; ends that turn."""
    angles = np.arange(0.0, 181.0, 15.0)
    falling = np.cos(np.radians(angles) / 2.0)[:, None] * np.exp(-1j * np.outer(angles, [0.5, 1.0, 1.5]) / 90.0)
    axial = either.found("DirectivityTable")(angles, [20e3, 40e3, 60e3], falling)
    spots = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
    unit = spots / np.linalg.norm(spots, axis=1, keepdims=True)
    pattern = (0.6 + 0.3 * unit[:, :1] + 0.1 * unit[:, 1:2]) * np.array([[1.0, 0.8 + 0.1j]])
    sphere = either.found("SphericalTable")(unit, [20e3, 60e3], pattern)
    half = np.sqrt(0.5)
    turning = clsim.Trajectory.waypoints(
        [0.0, 0.5, 1.0],
        [(1.5, 1.5, 1.5), (1.7, 1.6, 1.5), (1.8, 1.9, 1.4)],
        [(0, 0, 0, 1), (0, 0, half, half), (0, 0, 1, 0)],
    )
    receivers = [
        clsim.Receiver("first", Fixed((0.9, 0.7, 2.6)), either.found("Cardioid")(0.3), aim=(1, 1, -1)),
        clsim.Receiver("library", Fixed((4.0, 3.1, 0.9)), either.named_directivity("MA40S4R"), aim=(-1, -1, 0)),
        clsim.Receiver("sphere", ears()[1].trajectory, sphere, aim=(-1, 0, 0)),
    ]
    return prefixed(
        axial=heard(one(BOX, chirp(0.02, 38e3, 42e3), turning, receivers[:2], directivity=axial), 1),
        sphere=heard(one(BOX, tone(0.02), turning, receivers[2:], directivity=sphere), 1),
    )


@scene
def files(checkout: Path) -> Arrays:
    """Scene files through the command line: two examples, two written here; WAV, Zarr and HDF5."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mesh.toml").write_text(tomli_w.dumps(written_scene()), "utf-8")
        (folder / "clock.toml").write_text(tomli_w.dumps(clock_scene()), "utf-8")
        examples = checkout / "examples"
        runs = {
            "circle": (examples / "circle.toml", "--duration", 0.3, "--table-rate", 50),
            "array": (examples / "time_of_flight_scene.toml", "--duration", 0.03, "--store", "hdf5"),
            "mesh": (folder / "mesh.toml", "--store", "zarr"),
            "clock": (folder / "clock.toml",),
        }
        arrays = {}
        for run, arguments in runs.items():
            command("run", *arguments, "-o", folder / run, "--no-plots")
            arrays[run] = results(folder / run)
        command("rir", folder / "mesh.toml", "-o", folder / "rir.npz", "--band", 30e3, 50e3)
        with np.load(folder / "rir.npz") as content:
            arrays["rir"] = {n: content[n] for n in content.files if n != "scene"}
        return prefixed(**arrays)


STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "truth", "paths"]
[[vary]]
field = ["paths.max_order", "sources[0].trajectory.end[0]"]
name = ["order", "end"]
values = [[0, 2.1], [1, 2.4]]
"""


@scene
def study() -> Arrays:
    """Two members of a study."""
    import zarr

    arrays: Arrays = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.toml").write_text(tomli_w.dumps(clock_scene()), "utf-8")
        (folder / "study.toml").write_text(STUDY.replace("truth", either.GROUND_TRUTH), "utf-8")
        command("study", folder / "study.toml", "-o", folder / "out", "--workers", 1)
        rows = [json.loads(line) for line in (folder / "out" / "index.jsonl").read_text("utf-8").splitlines()]
        known = [{k: row[k] for k in ("member", "parameters", "status", "error")} for row in rows]
        arrays["index"] = np.array(json.dumps(sorted(known, key=lambda row: row["member"]), indent=1, sort_keys=True))
        root = zarr.open_group(folder / "out" / "study.zarr", mode="r")
        for group, content in sorted(root.groups()):
            for key, array in content.arrays():
                if key != "seconds":
                    arrays[f"{group}.{either.ARRAYS.get(key, key)}"] = np.asarray(array[...])
    return arrays


def saved(values: Any) -> np.ndarray:
    """Return an array that needs no pickle: texts of any kind have a length."""
    array = np.asarray(values)
    if array.dtype.kind not in "OT":
        return array
    return np.array([str(value) for value in array.ravel()], dtype=np.str_).reshape(array.shape)


def main() -> None:
    """Compute the scenes and write their arrays."""
    checkout, folder, names = Path(sys.argv[1]).resolve(), Path(sys.argv[2]), sys.argv[3:] or list(SCENES)
    assert Path(clsim.__file__).is_relative_to(checkout), f"{clsim.__file__} is not in {checkout}"
    warnings.simplefilter("ignore")
    for name in names:
        begun = time.perf_counter()
        try:
            arrays = SCENES[name](checkout)
            np.savez(folder / f"{name}.npz", **{n: saved(x) for n, x in arrays.items()})
        except Exception:
            (folder / f"{name}.txt").write_text(traceback.format_exc(), "utf-8")
        print(f"{name} {time.perf_counter() - begun:.1f}", flush=True)


if __name__ == "__main__":
    main()
