"""An interactive 3D page that needs nothing but a browser."""

from __future__ import annotations

import html
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.output.atomic import atomic_path

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
    """A source or receiver: name, kind, positions (F, 3) at the frames and its whole way (M, 3), m."""

    name: str
    kind: str
    positions: Floats
    trail: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ViewedPaths:
    """The paths of a frame: corners (order + 2, 3) of each, m, orders (P,) and labels."""

    corners: tuple[Floats, ...]
    order: NDArray[np.int32]
    labels: tuple[str, ...]


def write_page(
    path: str | os.PathLike[str],
    *,
    title: str,
    walls: Sequence[ViewedWall],
    ends: Sequence[ViewedEnd],
    times: Floats,
    frames: Sequence[ViewedPaths],
) -> None:
    """Write one HTML file that holds everything, the drawing library included.

    Parameters
    ----------
    path : path-like
        Of the page.
    title : str
        Above the picture.
    walls, ends : sequence
        The room; sources and receivers.
    times : ndarray (F,)
        Of the frames, increasing, s.
    frames : sequence of ViewedPaths
        One per time.

    Raises
    ------
    InputError
        If lengths differ or times do not increase.
    """
    if len(frames) != len(times) or any(len(end.positions) != len(times) for end in ends):
        raise InputError("frames", f"must be one per time, {len(times)}, for paths and positions alike")
    if np.any(np.diff(times) <= 0.0):
        raise InputError("times", "must increase")
    from plotly.offline import get_plotlyjs

    last = max((int(f.order.max(initial=0)) for f in frames), default=0)
    fixed = [*_wall_traces(walls), *_trail_traces(ends)]
    data = {
        "times": [float(f"{t:.9g}") for t in times],
        "fixed": fixed,
        "marks": _mark_trace(ends),
        "places": [[_rounded(end.positions[i]) for end in ends] for i in range(len(times))],
        "orders": [_order_trace(n) for n in range(last + 1)],
        "frames": [_frame(f, last) for f in frames],
    }
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    page = _PAGE.replace("{{title}}", html.escape(title)).replace("{{data}}", text)
    page = page.replace("{{plotly}}", get_plotlyjs())
    with atomic_path(path) as temporary:
        temporary.write_text(page, "utf-8")


def _rounded(values: Floats) -> list[Any]:
    """Return coordinates to a tenth of a millimetre."""
    rounded: list[Any] = np.round(np.asarray(values, dtype=np.float64), 4).tolist()
    return rounded


def _wall_traces(walls: Sequence[ViewedWall]) -> list[dict[str, Any]]:
    """Return one surface per material, and all outlines."""
    traces = []
    for m, material in enumerate(dict.fromkeys(wall.material for wall in walls)):
        mine = [wall for wall in walls if wall.material == material]
        corners = np.concatenate([wall.triangles for wall in mine]).reshape(-1, 3)
        x, y, z = _rounded(corners.T)
        i = list(range(0, len(corners), 3))
        names = [wall.name for wall in mine for _ in range(3 * len(wall.triangles))]
        traces.append(
            {
                "type": "mesh3d",
                "x": x,
                "y": y,
                "z": z,
                "i": i,
                "j": [a + 1 for a in i],
                "k": [a + 2 for a in i],
                "color": _MATERIALS[m % len(_MATERIALS)],
                "opacity": 0.18,
                "flatshading": True,
                "name": material,
                "showlegend": True,
                "text": names,
                "hovertemplate": "%{text}<extra>" + html.escape(material) + "</extra>",
            }
        )
    lines = np.concatenate([wall.outline for wall in walls])
    lines = np.concatenate([lines, np.full((len(lines), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    traces.append(_lines(lines, color="#555555", width=1.5, name="edges"))
    return traces


def _lines(points: Floats, *, color: str, width: float, name: str) -> dict[str, Any]:
    """Return lines through points, interrupted at NaN."""
    columns = [[None if np.isnan(v) else v for v in column] for column in _rounded(points.T)]
    return {
        "type": "scatter3d", "mode": "lines", "x": columns[0], "y": columns[1], "z": columns[2], "name": name,
        "line": {"color": color, "width": width}, "hoverinfo": "skip", "showlegend": False,
    }  # fmt: skip


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
        "text": [end.name for end in ends], "textposition": "top center",
        "marker": {
            "size": 6, "color": [_SOURCE if s else _RECEIVER for s in sources],
            "symbol": ["circle" if s else "diamond" for s in sources],
        },
        "hovertemplate": "%{text}<br>%{x} %{y} %{z}<extra></extra>",
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
    """Return for each order the points of its paths in a row, the number of points and the label of each path."""
    orders = []
    for n in range(last + 1):
        rows = np.flatnonzero(paths.order == n)
        points = np.concatenate([paths.corners[p] for p in rows]) if len(rows) else np.empty((0, 3))
        orders.append({"xyz": [_rounded(c) for c in points.T], "labels": [paths.labels[p] for p in rows]})
    return orders


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{{title}}</title>
<style>
html, body { margin: 0; height: 100%; font: 15px system-ui, sans-serif; color: #222; }
body { display: flex; flex-direction: column; }
header { padding: 8px 14px; display: flex; gap: 14px; align-items: center; border-bottom: 1px solid #ddd; }
h1 { font-size: 17px; margin: 0; }
#time { flex: 1; min-width: 120px; }
#told { min-width: 16em; font-variant-numeric: tabular-nums; }
#scene { flex: 1; min-height: 0; }
button { font: inherit; padding: 2px 12px; }
</style></head><body>
<header><h1>{{title}}</h1><button id="play">play</button>
<input id="time" type="range" min="0" step="1" value="0" aria-label="time"><span id="told"></span></header>
<div id="scene"></div>
<script>{{plotly}}</script>
<script id="data" type="application/json">{{data}}</script>
<script>
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const scene = document.getElementById("scene"), slider = document.getElementById("time");
const play = document.getElementById("play"), told = document.getElementById("told");
const marks = data.fixed.length, firstOrder = marks + 1;
let shown = -1, timer = null;

function lines(order, part) {  // points of all paths of an order, a gap behind each
  const out = {x: [], y: [], z: [], text: []};
  let at = 0;
  for (const label of part.labels) {
    for (let i = 0; i < order + 2; i++, at++) {
      out.x.push(part.xyz[0][at]); out.y.push(part.xyz[1][at]); out.z.push(part.xyz[2][at]); out.text.push(label);
    }
    out.x.push(null); out.y.push(null); out.z.push(null); out.text.push("");
  }
  return out;
}

function show(index) {
  if (index === shown) return Promise.resolve();
  shown = index;
  const places = data.places[index], frame = data.frames[index].map((part, order) => lines(order, part));
  const update = {
    x: [places.map(p => p[0]), ...frame.map(l => l.x)], y: [places.map(p => p[1]), ...frame.map(l => l.y)],
    z: [places.map(p => p[2]), ...frame.map(l => l.z)], text: [data.marks.text, ...frame.map(l => l.text)],
  };
  const count = data.frames[index].reduce((sum, part) => sum + part.labels.length, 0);
  told.textContent = `t = ${data.times[index].toFixed(3)} s: ${count} path${count === 1 ? "" : "s"} heard`;
  slider.value = index;
  return Plotly.restyle(scene, update, update.x.map((_, i) => marks + i));
}

function state() {  // what is drawn now, read back from the drawing
  const drawn = scene.data, paths = drawn.slice(firstOrder);
  return {
    index: shown, text: told.textContent,
    paths: paths.map(t => t.x.filter(v => v === null).length), visible: drawn.map(t => t.visible !== "legendonly"),
    places: drawn[marks].x.map((x, i) => [x, drawn[marks].y[i], drawn[marks].z[i]]), names: drawn.map(t => t.name),
  };
}

slider.max = data.times.length - 1;
if (data.times.length === 1) { slider.hidden = play.hidden = true; }
slider.addEventListener("input", () => show(Number(slider.value)));
play.addEventListener("click", () => {
  if (timer) { clearInterval(timer); timer = null; play.textContent = "play"; return; }
  play.textContent = "pause";
  timer = setInterval(() => show((shown + 1) % data.times.length), 120);
});
const axis = title => ({title: {text: title}, showbackground: false, gridcolor: "#e5e5e5", zeroline: false});
const layout = {
  margin: {l: 0, r: 0, t: 0, b: 0}, uirevision: "kept", legend: {x: 0.01, y: 0.99, bgcolor: "rgba(255,255,255,0.8)"},
  scene: {
    aspectmode: "data", xaxis: axis("x (m)"), yaxis: axis("y (m)"), zaxis: axis("z (m)"),
    camera: {eye: {x: -1.2, y: -1.75, z: 1.3}},
  },
};
window.clsim = {
  times: data.times, show, state,
  ready: Plotly.newPlot(scene, [...data.fixed, data.marks, ...data.orders], layout, {displaylogo: false})
    .then(() => show(0)),
};
</script></body></html>
"""
