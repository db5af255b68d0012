"""An interactive 3D page that needs nothing but a browser."""

from __future__ import annotations

import html
import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.files.atomic import atomic_path

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats

# Okabe and Ito's colours, then darker ones: told apart by colour-blind people too.
_MATERIALS = (
    "#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#999999", "#7f5fc7", "#44aa99",
    "#882255", "#6b4c1e",
)  # fmt: skip
_ORDERS = ("#c1272d", "#3b0f70", "#2c728e", "#21a685", "#8bc34a", "#c0b000", "#e69f00", "#999999")
_BODIES = ("#5d4037", "#7b1fa2", "#00695c", "#283593")
_EDGES = "#b8860b"
_SOURCE, _RECEIVER = "#c1272d", "#111111"


@dataclass(frozen=True, slots=True, eq=False)
class ViewedWall:
    """A wall: its name and material, triangles (T, 3, 3) and outline (E, 2, 3), m."""

    name: str
    material: str
    triangles: Floats
    outline: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ViewedEnd:
    """A source or receiver: name, kind, positions (F, 3) at the frames and its whole way (M, 3), m.

    A position that is not known is NaN: nothing is drawn there.
    """

    name: str
    kind: str
    positions: Floats
    trail: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ViewedBody:
    """A body: name, corners (V, 3) in its own coordinates, m, triangles (T, 3); origin (F, 3), m, and axes (F, 3, 3).

    Row i of the axes is where the body's own axis i points in a frame.
    """

    name: str
    vertices: Floats
    triangles: NDArray[np.int64]
    places: Floats
    axes: Floats

    def corners(self, frame: int) -> Floats:
        """Return where its corners (V, 3) are in a frame, m."""
        return np.asarray(self.places[frame] + self.vertices @ self.axes[frame])


@dataclass(frozen=True, slots=True, eq=False)
class ViewedPaths:
    """The paths of a frame: corners (order + 2, 3) of each, m, orders (P,) and labels."""

    corners: tuple[Floats, ...]
    order: NDArray[np.int32]
    labels: tuple[str, ...]


def write_page(path: str | os.PathLike[str], **what: Any) -> None:
    """Write one HTML file that holds everything, the drawing library included.

    Parameters
    ----------
    path : path-like
        Of the page.
    **what
        As in `page_text`.

    Raises
    ------
    InputError
        As `page_text` does.
    """
    text = page_text(**what)
    with atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")


def page_text(
    *,
    title: str,
    walls: Sequence[ViewedWall],
    ends: Sequence[ViewedEnd],
    times: Floats,
    frames: Sequence[ViewedPaths],
    notes: Sequence[str] = (),
    edges: Floats | None = None,
    bodies: Sequence[ViewedBody] = (),
) -> str:
    """Return the text of one HTML page that holds everything, the drawing library included.

    Parameters
    ----------
    title : str
        Above the picture.
    walls, ends : sequence
        The room; sources and receivers.
    times : ndarray (F,)
        Of the frames, increasing, s.
    frames : sequence of ViewedPaths
        One per time.
    notes : sequence of str
        Lines below the title.
    edges : ndarray (E, 2, 3), optional
        Ends of the edges at which sound is diffracted, m.
    bodies : sequence of ViewedBody
        What moves as a whole.

    Raises
    ------
    InputError
        If lengths differ, times do not increase or a path has another number of corners than its order asks for.
    """
    _check_times(times, ends, frames)
    for i, frame in enumerate(frames):
        _check_paths(f"frames[{i}]", frame)
    from plotly.offline import get_plotlyjs

    text = json.dumps(_document(walls, ends, times, frames, edges, bodies), separators=(",", ":"), allow_nan=False)
    parts = {
        "title": html.escape(title),
        "notes": "".join(f"<p>{html.escape(note)}</p>" for note in notes),
        "data": text.replace("<", "\\u003c"),
        "plotly": get_plotlyjs(),
    }
    # In one go: what is put in is not searched again, whatever the names in it are.
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], _PAGE)


def _check_times(times: Floats, ends: Sequence[ViewedEnd], frames: Sequence[ViewedPaths]) -> None:
    if len(times) == 0:
        raise InputError("times", "must not be empty")
    rule = f"must be one per time, {len(times)}, for paths and positions alike, but"
    if len(frames) != len(times):
        raise InputError("frames", f"{rule} there are {len(frames)}")
    for i, end in enumerate(ends):
        if end.positions.shape != (len(times), 3):
            shape = " x ".join(map(str, end.positions.shape))
            raise InputError("frames", f"{rule} ends[{i}].positions has the shape {shape}")
    for i, time in enumerate(times):
        if not np.isfinite(time):
            raise InputError(f"times[{i}]", f"must be finite, but is {time}")
        if i and time <= times[i - 1]:
            problem = f"must increase strictly, but [{i}] = {time:g} s follows [{i - 1}] = {times[i - 1]:g} s"
            raise InputError("times", problem)


def _check_paths(field: str, paths: ViewedPaths) -> None:
    for name, count in (("order", len(paths.order)), ("labels", len(paths.labels))):
        if count != len(paths.corners):
            raise InputError(f"{field}.{name}", f"must be one per path, {len(paths.corners)}, but there are {count}")
    for p, (corners, order) in enumerate(zip(paths.corners, paths.order, strict=True)):
        if order < 0:
            raise InputError(f"{field}.order[{p}]", f"must be at least 0, but is {order}")
        if corners.shape != (order + 2, 3):
            shape = " x ".join(map(str, corners.shape))
            problem = f"must have the shape {order + 2} x 3 for a path of order {order}, but has {shape}"
            raise InputError(f"{field}.corners[{p}]", problem)
        if not np.isfinite(corners).all():
            raise InputError(f"{field}.corners[{p}]", "must be finite")


def _document(
    walls: Sequence[ViewedWall],
    ends: Sequence[ViewedEnd],
    times: Floats,
    frames: Sequence[ViewedPaths],
    edges: Floats | None,
    bodies: Sequence[ViewedBody],
) -> dict[str, Any]:
    """Return all that the page draws: traces that stay, those that change, and per frame what goes into them."""
    last = max(int(np.max(f.order, initial=0)) for f in frames)
    return {
        "times": [float(f"{t:.9g}") for t in times],
        "fixed": [*_wall_traces(walls), *_edge_traces(edges), *_trail_traces(ends)],
        "bodies": [_body(body, _BODIES[i % len(_BODIES)]) for i, body in enumerate(bodies)],
        "marks": _mark_trace(ends),
        "places": [[_rounded(end.positions[i]) for end in ends] for i in range(len(times))],
        "orders": [_order_trace(n) for n in range(last + 1)],
        "frames": [_frame(f, last) for f in frames],
    }


def _plain(text: str) -> str:
    """Return a text that plotly, which reads a little HTML, draws letter by letter."""
    return html.escape(text, quote=False)


def _rounded(values: Floats) -> list[Any]:
    """Return coordinates (n,) to a millimetre; what is not known is None."""
    rounded = np.round(np.asarray(values, dtype=np.float64), 3) + 0.0  # no minus zero
    return [v if np.isfinite(v) else None for v in rounded.tolist()]


def _wall_traces(walls: Sequence[ViewedWall]) -> list[dict[str, Any]]:
    """Return for each material its surface and the outlines of its walls, which one legend entry toggles."""
    traces = []
    for m, material in enumerate(dict.fromkeys(wall.material for wall in walls)):
        mine = [wall for wall in walls if wall.material == material]
        group = f"material {m}"
        traces.append(_surface(mine, _MATERIALS[m % len(_MATERIALS)]) | {"legendgroup": group})
        edges = np.concatenate([wall.outline for wall in mine])
        edges = np.concatenate([edges, np.full((len(edges), 1, 3), np.nan)], axis=1).reshape(-1, 3)
        traces.append(_lines(edges, color="#555555", width=1.5, name="edges") | {"legendgroup": group})
    return traces


def _edge_traces(edges: Floats | None) -> list[dict[str, Any]]:
    """Return the edges that diffract, which a legend entry toggles."""
    if edges is None or not len(edges):
        return []
    points = np.concatenate([edges, np.full((len(edges), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    return [_lines(points, color=_EDGES, width=5.0, name="edges that diffract") | {"showlegend": True}]


def _surface(walls: Sequence[ViewedWall], color: str) -> dict[str, Any]:
    """Return the surface of walls of one material."""
    corners = np.concatenate([wall.triangles for wall in walls]).reshape(-1, 3)
    x, y, z = (_rounded(column) for column in corners.T)
    first = range(0, len(corners), 3)
    material = _plain(walls[0].material)
    return {
        "type": "mesh3d", "x": x, "y": y, "z": z, "name": material, "showlegend": True, "color": color,
        "i": [*first], "j": [a + 1 for a in first], "k": [a + 2 for a in first], "opacity": 0.18, "flatshading": True,
        "text": [_plain(wall.name) for wall in walls for _ in range(3 * len(wall.triangles))],
        "hovertemplate": "%{text}: %{fullData.name}<extra></extra>",
    }  # fmt: skip


def _lines(points: Floats, *, color: str, width: float, name: str) -> dict[str, Any]:
    """Return lines through points, interrupted at NaN."""
    x, y, z = (_rounded(column) for column in points.T)
    return {
        "type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "name": _plain(name),
        "line": {"color": color, "width": width}, "hoverinfo": "skip", "showlegend": False,
    }  # fmt: skip


def _body(body: ViewedBody, color: str) -> dict[str, Any]:
    """Return the trace of a body without its places, its corners, and its poses: origin and axes in a row."""
    i, j, k = (column.tolist() for column in body.triangles.T)
    name = _plain(body.name)
    trace = {
        "type": "mesh3d", "x": [], "y": [], "z": [], "name": name, "showlegend": True, "color": color, "i": i, "j": j,
        "k": k, "opacity": 0.45, "flatshading": True, "hovertemplate": "%{fullData.name}<extra></extra>",
    }  # fmt: skip
    poses = np.concatenate([body.places, body.axes.reshape(-1, 9)], axis=1)
    corners = [_rounded(corner) for corner in body.vertices]
    return {"trace": trace, "corners": corners, "poses": [np.round(pose, 6).tolist() for pose in poses]}


def _trail_traces(ends: Sequence[ViewedEnd]) -> list[dict[str, Any]]:
    colors = {"source": _SOURCE}
    return [
        _lines(end.trail, color=colors.get(end.kind, _RECEIVER), width=2.0, name=f"way of {end.name}")
        for end in ends
        if len(end.trail) > 1
    ]


def _mark_trace(ends: Sequence[ViewedEnd]) -> dict[str, Any]:
    """Return the trace of sources and receivers, without their positions."""
    sources = [end.kind == "source" for end in ends]
    return {
        "type": "scatter3d", "mode": "markers+text", "x": [], "y": [], "z": [], "name": "sources and receivers",
        "text": [end.name for end in ends], "textposition": "top center", "textfont": {"size": 15},
        "hovertext": [_plain(end.name) for end in ends],
        "marker": {
            "size": 6, "color": [_SOURCE if s else _RECEIVER for s in sources],
            "symbol": ["circle" if s else "diamond" for s in sources],
        },
        "hovertemplate": "%{hovertext}<br>%{x} %{y} %{z} m<extra></extra>",
    }  # fmt: skip


def _order_trace(order: int) -> dict[str, Any]:
    """Return the trace of all paths of an order, without their points."""
    return {
        "type": "scatter3d", "mode": "lines", "x": [], "y": [], "z": [], "text": [],
        "name": "direct sound" if order == 0 else f"order {order}",
        "line": {"color": _ORDERS[min(order, len(_ORDERS) - 1)], "width": 6 if order == 0 else 3 if order == 1 else 2},
        "hovertemplate": "%{text}<extra></extra>",
    }  # fmt: skip


def _frame(paths: ViewedPaths, last: int) -> list[dict[str, Any]]:
    """Return for each order the labels of its paths and all their corners in a row: x, y, z, x, ..., whole mm."""
    order = np.asarray(paths.order)
    orders = []
    for n in range(last + 1):
        rows = np.flatnonzero(order == n)
        points = np.concatenate([paths.corners[p] for p in rows]) if len(rows) else np.empty((0, 3))
        millimetres = np.round(points * 1e3).astype(np.int64).ravel().tolist()
        orders.append({"mm": millimetres, "labels": [_plain(paths.labels[p]) for p in rows]})
    return orders


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{{title}}</title>
<style>
html, body { margin: 0; height: 100%; font: 15px system-ui, sans-serif; color: #222; }
body { display: flex; flex-direction: column; }
header {
  padding: 8px 14px; display: flex; flex-wrap: wrap; gap: 4px 14px; align-items: center; border-bottom: 1px solid #ddd;
}
h1 { font-size: 17px; margin: 0; }
#time { flex: 1; min-width: 120px; }
#caption { min-width: 16em; font-variant-numeric: tabular-nums; }
#drawing { flex: 1; min-height: 0; }
button { font: inherit; padding: 2px 0; width: 4.5em; }
#notes { flex-basis: 100%; color: #555; }
#notes:empty { display: none; }
#notes p { margin: 2px 0; }
</style></head><body>
<header><h1>{{title}}</h1><button id="play">play</button>
<input id="time" type="range" min="0" step="1" value="0" aria-label="time"><span id="caption"></span>
<div id="notes">{{notes}}</div></header>
<div id="drawing"></div>
<script>{{plotly}}</script>
<script id="data" type="application/json">{{data}}</script>
<script>
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const scene = document.getElementById("drawing"), slider = document.getElementById("time");
const play = document.getElementById("play"), caption = document.getElementById("caption");
const firstBody = data.fixed.length, marks = firstBody + data.bodies.length, firstOrder = marks + 1;
let shown = -1, wanted = -1, busy = null, playing = false, turn = 0;

function lines(order, part) {  // points of all paths of an order, a gap behind each
  const out = {x: [], y: [], z: [], text: []};
  let at = 0;
  for (const label of part.labels) {
    for (let i = 0; i < order + 2; i++, at += 3) {
      out.x.push(part.mm[at] / 1000); out.y.push(part.mm[at + 1] / 1000); out.z.push(part.mm[at + 2] / 1000);
      out.text.push(label);
    }
    out.x.push(null); out.y.push(null); out.z.push(null); out.text.push("");
  }
  return out;
}

function posed(body, index) {  // the corners of a body in a frame
  const at = body.poses[index], axis = i => body.corners.map(
    c => at[i] + c[0] * at[3 + i] + c[1] * at[6 + i] + c[2] * at[9 + i]);
  return {x: axis(0), y: axis(1), z: axis(2), text: ""};
}

function draw(index) {
  shown = index;
  const at = data.places[index], marked = {
    x: at.map(p => p[0]), y: at.map(p => p[1]), z: at.map(p => p[2]), text: data.marks.text,
  };
  const moved = [
    ...data.bodies.map(body => posed(body, index)), marked,
    ...data.frames[index].map((part, order) => lines(order, part)),
  ];
  const update = Object.fromEntries(["x", "y", "z", "text"].map(key => [key, moved.map(trace => trace[key])]));
  const count = data.frames[index].reduce((sum, part) => sum + part.labels.length, 0);
  caption.textContent = `t = ${data.times[index].toFixed(3)} s: ${count} path${count === 1 ? "" : "s"} heard`;
  slider.value = index;
  return Plotly.restyle(scene, update, update.x.map((_, i) => firstBody + i));
}

function show(index) {  // a slow machine skips frames rather than lag behind the slider
  wanted = index;
  busy ??= (async () => { while (shown !== wanted) await draw(wanted); })().finally(() => { busy = null; });
  return busy;
}

async function run(mine) {
  while (playing && mine === turn) {
    const started = performance.now();
    await show((shown + 1) % data.times.length);
    await new Promise(done => setTimeout(done, Math.max(20, 120 - (performance.now() - started))));
  }
}

function pathsFirst() {  // the mouse finds what lies behind a wall: when it picks, all else is nearer than any wall
  const sub = scene._fullLayout?.scene?._scene, gl = sub?.glplot?.gl;
  if (!gl) return;
  const walls = new Set(Object.values(sub.traces).map(trace => trace.mesh));
  for (const object of sub.glplot.objects) {
    if (!object.drawPick || Object.hasOwn(object, "drawPick")) continue;
    const drawPick = object.drawPick, [near, far] = walls.has(object) ? [0.5, 1] : [0, 0.5];
    object.drawPick = function (camera) { gl.depthRange(near, far); drawPick.call(this, camera); gl.depthRange(0, 1); };
  }
}

function plain(text) { return text.replace(/&lt;/g, "<").replace(/&gt;/g, ">").replace(/&amp;/g, "&"); }

function state() {  // what is drawn now, read back from the drawing
  const drawn = scene.data, paths = drawn.slice(firstOrder);
  return {
    index: shown, text: caption.textContent, names: drawn.map(t => plain(t.name)),
    paths: paths.map(t => t.x.filter(v => v === null).length), visible: drawn.map(t => t.visible !== "legendonly"),
    places: drawn[marks].x.map((x, i) => [x, drawn[marks].y[i], drawn[marks].z[i]]),
    bodies: drawn.slice(firstBody, marks).map(t => t.x.map((x, i) => [x, t.y[i], t.z[i]])),
  };
}

slider.max = data.times.length - 1;
if (data.times.length === 1) { slider.hidden = play.hidden = true; }
slider.addEventListener("input", () => show(Number(slider.value)));
play.addEventListener("click", () => {
  playing = !playing;
  play.textContent = playing ? "pause" : "play";
  if (playing) run(++turn);
});
const axis = title => ({title: {text: title}, showbackground: false, gridcolor: "#e5e5e5", zeroline: false});
const layout = {
  margin: {l: 0, r: 0, t: 0, b: 0}, uirevision: "kept",
  legend: {x: 0.01, y: 0.99, tracegroupgap: 0, bgcolor: "rgba(255,255,255,0.8)"},
  scene: {
    aspectmode: "data", xaxis: axis("x (m)"), yaxis: axis("y (m)"), zaxis: axis("z (m)"),
    camera: {eye: {x: -1.2, y: -1.75, z: 1.3}},
  },
};
const traces = [...data.fixed, ...data.bodies.map(body => body.trace), data.marks, ...data.orders];
window.clsim = {
  times: data.times, show, state,
  ready: Plotly.newPlot(scene, traces, layout, {displaylogo: false})
    .then(() => { pathsFirst(); scene.on("plotly_afterplot", pathsFirst); return show(0); }),
};
</script></body></html>
"""
