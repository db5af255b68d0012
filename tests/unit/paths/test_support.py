"""The support matrix against what paths, searches and methods do, and against the page that shows it."""

from functools import lru_cache
from itertools import product
from pathlib import Path

import pytest
from exhaustive import few

import clsim
from clsim.paths.chain import DEVICE, HOST, MEDIA, REFUSED, SUPPORT, media_of, program_of
from clsim.render.methods import sampled_channel, static
from clsim.render.opencl.path_columns import COLUMNS
from clsim.render.options import RenderOptions
from clsim.tracks.tracks import track

WALL = clsim.Material.from_reflection(0.8)
AIRS = {
    "still air": clsim.Air(),
    "wind": clsim.Air(wind=(3.0, 0.0, 0.0)),
    "air by height": clsim.Air((20.0, 24.0), heights=(0.0, 3.0)),
    "fluctuating air": clsim.Air(fluctuation=clsim.Fluctuation(2e-6, 0.2, 0.3, 3)),
}
# Methods of rendering, and the media in which they take pairs whose paths change with both ends alone.
METHODS = {
    "sum over paths": MEDIA,
    "narrow bands": MEDIA,
    "convolution (pairs at rest)": MEDIA[:3],
    "sampled channels": MEDIA[:3],
}
# Options of `find_paths`, and what is added to the scene, for kinds of chains.
FOUND = {
    "static": ({}, ""),
    "static edge": ({"diffraction": 1}, ""),
    "static exact edge": ({"diffraction": 1, "diffraction_model": "btm"}, ""),
    "static edge pair": ({"diffraction": 2}, ""),
    "static edge gap": ({"diffraction": 2}, ""),
    "static three edges": ({"diffraction": 3, "max_order": 0}, ""),
    "static scatterer": ({"scattering_order": 0}, "scatterers"),
    "static edge scatterer": ({"diffraction": 1, "edge_scattering": True}, "scatterers"),
    "static scatterer edge": ({"diffraction": 1, "edge_scattering": True}, "scatterers"),
    "static edge scatterer edge": ({"diffraction": 2, "edge_scattering": True}, "scatterers"),
    "static scatterer pair": ({"scatterers_in_row": 2}, "scatterers twice"),
    "moving": ({}, "bodies"),
    "moving edge": ({"diffraction": 1}, "bodies"),
    "moving edge pair": ({"diffraction": 2, "max_order": 0}, "bodies"),
    "moving edge gap": ({"diffraction": 2, "max_order": 0}, "bodies"),
    "moving edge and end": ({"diffraction": 2, "max_order": 0}, "bodies"),
    "moving scatterer": ({"scattering_order": 0}, "bodies scatterers"),
}


def scene(air: clsim.Air, more: str = "") -> clsim.Scene:
    """Make an L-shaped room with a pillar and both ends at rest in view of each other."""
    pillar = [(2.5, 2.5), (3.0, 2.5), (3.0, 3.0), (2.5, 3.0)]
    outline = [(0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (4.0, 3.0), (4.0, 6.0), (0.0, 6.0)]
    room = clsim.MeshRoom.from_plan(outline, 3.0, WALL, [pillar])
    tone = clsim.Signal.tone(20e3, 0.01, 96e3, fade=0.002)
    ends = (
        clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.2))),
        clsim.Receiver("r", clsim.Trajectory.fixed((5.0, 1.5, 1.6))),
    )
    line = clsim.Trajectory.line((2.0, 0.4, 1.0), (2.0, 0.45, 1.0), 0.1)
    things = {}
    if "bodies" in more:
        things["bodies"] = [clsim.Body.box("crate", (0.6, 0.1, 0.6), WALL, line)]
    if "scatterers" in more:
        things["scatterers"] = [clsim.Scatterer.sphere("ball", 0.05, clsim.Trajectory.fixed((3.0, 1.6, 1.4)))]
    if "twice" in more:
        things["scatterers"].append(clsim.Scatterer.sphere("one more", 0.05, clsim.Trajectory.fixed((3.5, 1.0, 1.4))))
    return clsim.Scene(room, air, [ends[0]], [ends[1]], **things)


@lru_cache
def searched(medium: str, more: str, *options: tuple[str, object]) -> clsim.PathSet:
    """Return the paths in a medium, once for all kinds that one search finds."""
    return clsim.find_paths(scene(AIRS[medium], more), engine="reference", **{"max_order": 1} | dict(options))


# Wind is a column of legs, not of vertices: at every change it is searched in with a few of them.
CASES = list(product(MEDIA, FOUND))
AT_EVERY_CHANGE = [
    i for i, (medium, kind) in enumerate(CASES) if medium != "wind" or kind in ("static edge", "moving edge")
]


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
@pytest.mark.parametrize(("medium", "kind"), few(CASES, AT_EVERY_CHANGE))
def test_paths_are_found_where_the_matrix_says(kind: str, medium: str) -> None:
    options, more = FOUND[kind]
    assert media_of(scene(AIRS[medium]).air) == (medium,)
    where = dict(zip(MEDIA, SUPPORT[kind].where, strict=True))[medium]
    if where == REFUSED:
        with pytest.raises(clsim.InputError, match="depends on the height or fluctuates"):
            searched(medium, more, *options.items())
        return
    found = [f for f in searched(medium, more, *options.items()).families if f.kind == kind]
    assert len(found) == 1
    assert found[0].device == (SUPPORT[kind].program if where == DEVICE else None)


def test_programs_are_those_of_columns() -> None:
    assert {row.program for row in SUPPORT.values()} - {None} == set(COLUMNS)
    assert all((row.program is None) == (DEVICE not in row.where) for row in SUPPORT.values())
    assert all((row.refusal is None) == (REFUSED not in row.where) for row in SUPPORT.values())
    both = clsim.Air(wind=(3.0, 0.0, 0.0), fluctuation=clsim.Fluctuation(2e-6, 0.2, 0.3, 3))
    assert media_of(both) == ("wind", "fluctuating air")
    assert program_of("static", both) is None


def test_scatterers_that_fluctuate_are_for_the_host() -> None:
    still = clsim.Trajectory.fixed((3.0, 1.6, 1.4))
    for fluctuation, program in ((None, "scatterers"), (clsim.TargetFluctuation(0.5), None)):
        plain = scene(clsim.Air())
        ball = clsim.Scatterer.ellipsoid("ball", (0.05, 0.05, 0.05), still, fluctuation, shadow=False)
        made = clsim.Scene(plain.room, plain.air, plain.sources, plain.receivers, scatterers=[ball])
        found = clsim.find_paths(made, 0, engine="reference", scattering_order=0).families[-1]
        assert found.device == program


@pytest.mark.parametrize("medium", MEDIA)
def test_methods_take_pairs_where_the_matrix_says(medium: str) -> None:
    options = RenderOptions(96e3)
    tracks = track(clsim.find_paths(scene(AIRS[medium]), 0, engine="reference"))
    for name, can in (("convolution (pairs at rest)", static.can), ("sampled channels", sampled_channel.can)):
        assert (can(tracks, options, 0) is None) == (medium in METHODS[name]), name


def support_tables() -> str:
    """Write the matrix as tables of a page: paths by media, and methods by media."""
    head = f"{' | '.join(MEDIA)} |\n|{'---|' * (len(MEDIA) + 1)}"
    rows = [f"| {row.paths} | {' | '.join(row.where)} |" for row in SUPPORT.values()]
    methods = [
        f"| {name} | {' | '.join('yes' if medium in media else 'no' for medium in MEDIA)} |"
        for name, media in METHODS.items()
    ]
    return "\n".join([f"| nodes of paths by | {head}", *rows, "", f"| method | {head}", *methods])


def test_page_of_limitations_shows_the_matrix() -> None:
    page = Path(__file__).parents[3] / "docs" / "limitations.md"
    if not page.exists():
        pytest.skip("installed without its pages")
    assert support_tables() in page.read_text("utf-8")
    assert HOST in support_tables()
