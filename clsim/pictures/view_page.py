"""An interactive 3D page that needs nothing but a browser, and what notebooks show: tables, pages, sound."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import check_packages

# Okabe and Ito's colours, then darker ones: told apart by colour-blind people too.
_MATERIALS = (
    "#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#999999", "#7f5fc7", "#44aa99",
    "#882255", "#6b4c1e",
)  # fmt: skip
_ORDERS = ("#c1272d", "#3b0f70", "#2c728e", "#21a685", "#8bc34a", "#c0b000", "#e69f00", "#999999")
_BODIES = ("#5d4037", "#7b1fa2", "#00695c", "#283593")
_HERE = Path(__file__).parent
_EDGES = "#b8860b"
_HEALED, _OPEN = "#7b1fa2", "#ff00aa"
_AIM = 0.06  # length of a drawn aim, of the room's
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
    """A source or receiver: name, kind, positions (F, 3) at the frames and its whole trajectory (M, 3), m."""

    # A position that is not known is NaN: nothing is drawn there. `aims` (F, 3) are unit vectors of what it is aimed
    # at.
    name: str
    kind: str
    positions: Floats
    trail: Floats
    aims: Floats | None = None


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
        """Return the corners (V, 3) in a frame, m."""
        return np.asarray(self.places[frame] + self.vertices @ self.axes[frame])


@dataclass(frozen=True, slots=True, eq=False)
class ViewedFlaws:
    """Flaws of a mesh: where it was healed (n, 3), and open edges (E, 2, 3), m."""

    healed_at: Floats
    open_edges: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ViewedPaths:
    """The paths of a frame: vertices (order + 2, 3), m, orders (P,), labels, between whom, and levels (P,), dB."""

    vertices: tuple[Floats, ...]
    order: NDArray[np.int32]
    labels: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    levels: Floats

    @classmethod
    def none(cls) -> ViewedPaths:
        """Return a frame without paths."""
        return cls((), np.zeros(0, dtype=np.int32), (), (), np.zeros(0))


def page_text(
    *, title: str, walls: Sequence[ViewedWall], ends: Sequence[ViewedEnd], times: Floats, frames: Sequence[ViewedPaths],
    notes: Sequence[str] = (), edges: Floats | None = None, bodies: Sequence[ViewedBody] = (),
    flaws: ViewedFlaws | None = None,
) -> str:  # fmt: skip
    """Return the text of one self-contained HTML page, the drawing library included."""
    # Shapes: times (F,) s; edges (E, 2, 3) m.
    content = _document(walls, ends, times, frames, edges, bodies, flaws)
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    parts = {
        "title": html.escape(title),
        "notes": "".join(f"<p>{html.escape(note)}</p>" for note in notes),
        "data": text.replace("<", "\\u003c"),
        "plotly": (_HERE / "plotly" / "plotly-gl3d.min.js").read_text("utf-8"),
    }
    # In one go: what is put in is not searched again, whatever the names in it are.
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], (_HERE / "view_page.html").read_text("utf-8"))


def _document(
    walls: Sequence[ViewedWall], ends: Sequence[ViewedEnd], times: Floats, frames: Sequence[ViewedPaths],
    edges: Floats | None, bodies: Sequence[ViewedBody], flaws: ViewedFlaws | None,
) -> dict[str, Any]:  # fmt: skip
    """Return the data of the page: fixed traces, changing traces, and their values per frame."""
    last = max(int(np.max(f.order, initial=0)) for f in frames)
    pairs = [pair for frame in frames for pair in frame.pairs]
    sources, receivers = (list(dict.fromkeys(names)) for names in zip(*pairs, strict=True)) if pairs else ([], [])
    reach = _AIM * max((float(np.max(np.ptp(wall.triangles, axis=(0, 1)))) for wall in walls), default=1.0)
    fixed = _wall_traces(walls)
    if edges is not None and len(edges):
        drawn = _lines(_apart(edges), color=_EDGES, width=5.0, name="edges that diffract")
        fixed.append(drawn | {"showlegend": True})
    fixed += _flaw_traces(flaws)
    for end in (end for end in ends if len(end.trail) > 1):
        colour = _SOURCE if end.kind == "source" else _RECEIVER
        fixed.append(_lines(end.trail, color=colour, width=2.0, name=f"way of {end.name}"))
    return {
        "times": [float(f"{t:.9g}") for t in times],
        "fixed": fixed,
        "bodies": [_body(body, _BODIES[i % len(_BODIES)]) for i, body in enumerate(bodies)],
        "marks": _mark_trace(ends),
        "places": [[_rounded(end.positions[i]) for end in ends] for i in range(len(times))],
        "aims": [
            [
                [_rounded(end.positions[i]), _rounded(end.positions[i] + reach * end.aims[i])]
                for end in ends
                if end.aims is not None
            ]
            for i in range(len(times))
        ],
        "orders": [_order_trace(n) for n in range(last + 1)],
        "sources": sources,
        "receivers": receivers,
        "frames": [_frame(f, last, sources, receivers) for f in frames],
    }


def _plain(text: str) -> str:
    """Return a text that plotly, which reads a little HTML, draws letter by letter."""
    return html.escape(text, quote=False)


def _rounded(values: Floats) -> list[Any]:
    """Return coordinates (n,) rounded to a millimetre; None where unknown."""
    rounded = np.round(np.asarray(values, dtype=np.float64), 3) + 0.0  # no minus zero
    return [v if np.isfinite(v) else None for v in rounded.tolist()]


def _wall_traces(walls: Sequence[ViewedWall]) -> list[dict[str, Any]]:
    """Return the surface and the wall outlines of each material, toggled by one legend entry."""
    traces = []
    for m, material in enumerate(dict.fromkeys(wall.material for wall in walls)):
        mine = [wall for wall in walls if wall.material == material]
        group = f"material {m}"
        traces.append(_surface(mine, _MATERIALS[m % len(_MATERIALS)]) | {"legendgroup": group})
        edges = _apart(np.concatenate([wall.outline for wall in mine]))
        traces.append(_lines(edges, color="#555555", width=1.5, name="edges") | {"legendgroup": group})
    return traces


def _flaw_traces(flaws: ViewedFlaws | None) -> list[dict[str, Any]]:
    """Return the places where a mesh was healed, and its open edges, each toggled by a legend entry."""
    traces: list[dict[str, Any]] = []
    if flaws is not None and len(flaws.healed_at):
        x, y, z = (_rounded(column) for column in flaws.healed_at.T)
        traces.append({
            "type": "scatter3d", "mode": "markers", "x": x, "y": y, "z": z, "name": "healed here", "showlegend": True,
            "marker": {"size": 4, "color": _HEALED, "symbol": "x"},
            "hovertemplate": "healed at %{x} %{y} %{z} m<extra></extra>",
        })  # fmt: skip
    if flaws is not None and len(flaws.open_edges):
        named = "open edges: energy escapes here"
        traces.append(_lines(_apart(flaws.open_edges), color=_OPEN, width=6.0, name=named) | {"showlegend": True})
    return traces


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


def _apart(segments: Floats) -> Floats:
    """Return the ends of segments (E, 2, 3) in a row (3 E, 3), with NaN behind each."""
    return np.concatenate([segments, np.full((len(segments), 1, 3), np.nan)], axis=1).reshape(-1, 3)


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


def _frame(paths: ViewedPaths, last: int, sources: list[str], receivers: list[str]) -> list[dict[str, Any]]:
    """Return for each order the paths' labels, and all their vertices in a row: x, y, z, x, ..., whole mm."""
    order = np.asarray(paths.order)
    orders = []
    for n in range(last + 1):
        rows = np.flatnonzero(order == n)
        points = np.concatenate([paths.vertices[p] for p in rows]) if len(rows) else np.empty((0, 3))
        millimetres = np.round(points * 1e3).astype(np.int64).ravel().tolist()
        part = {
            "mm": millimetres, "labels": [_plain(paths.labels[p]) for p in rows],
            "source": [sources.index(paths.pairs[p][0]) for p in rows],
            "receiver": [receivers.index(paths.pairs[p][1]) for p in rows],
            "level": np.round(paths.levels[rows], 1).tolist(),
        }  # fmt: skip
        orders.append(part)
    return orders


def html_table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]], notes: Sequence[str] = ()) -> str:
    """Return a table as HTML, with a title above it and lines below."""

    def row(cells: Sequence[object], kind: str) -> str:
        """Return a row of a table, of cells of a kind (``th`` or ``td``)."""
        return "<tr>" + "".join(f"<{kind}>{html.escape(str(cell))}</{kind}>" for cell in cells) + "</tr>"

    body = row(head, "th") + "".join(row(cells, "td") for cells in rows)
    below = "".join(f"<div>{html.escape(note)}</div>" for note in notes)
    return f"<div><b>{html.escape(title)}</b><table>{body}</table>{below}</div>"


def inline_page(page: str, height: int) -> Any:
    """Return an HTML page for display in a notebook, of a height in pixels."""
    check_packages("show", "a notebook", "notebook", "IPython")
    from IPython import display

    shown: Any = display.HTML  # its types are not told
    return shown(
        f'<div><iframe srcdoc="{html.escape(page)}" width="100%" height="{height}" style="border: 0"></iframe></div>'
    )


def inline_sound(samples: NDArray[Any], rate: int) -> Any:
    """Return a player of samples (n,) for a notebook at a rate, Hz."""
    check_packages("play", "a notebook", "notebook", "IPython")
    from IPython import display

    played: Any = display.Audio  # its types are not told
    return played(data=samples, rate=rate)
