"""The page that draws a scene: what stands in double braces is put in by `view_page`."""

PAGE = """<!DOCTYPE html>
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
