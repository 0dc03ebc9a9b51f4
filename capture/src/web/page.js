"use strict";
// The live page. Frames and state as capture/src/live/hub.rs and capture/src/web.rs say them.

const SECONDS = 10;          // of the strips
const BINS = 2048;           // of 10 ms: more than the strips show
const AXES = ["x", "y", "z"];
const $ = (id) => document.getElementById(id);

// ---- what came ----------------------------------------------------------------------------------------------------

const bins = { time: new Float64Array(BINS), value: new Float32Array(BINS * 12), next: 0, count: 0 };
let latest = null;           // the latest strip, decoded
let state = null;            // the latest state
let heard = 0;               // when something last came, ms of performance.now()
let changed = true;
const trail = [];            // where the tool was, m
// For tests and the curious.
const stats = (window.ftStats = { frames: 0, lost: 0, drawn: 0, fps: 0, connections: 0 });

function takeStrip(buffer) {
  const view = new DataView(buffer);
  const float = (at) => view.getFloat32(at, true);
  const floats = (at, count) => Array.from({ length: count }, (_, index) => float(at + 4 * index));
  const number = view.getUint32(0, true);
  const count = view.getUint32(4, true);
  const time = view.getFloat64(8, true);
  if (latest && number > latest.number + 1) stats.lost += number - latest.number - 1;
  if (latest && time < latest.time - 1) bins.count = 0;     // another source: its time begins anew
  latest = { number, time, width: float(16), force: floats(20, 3), torque: floats(32, 3), tcp: floats(44, 7), sensor: floats(72, 7) };
  for (let index = 0; index < count; index++) {
    const at = 100 + 52 * index;
    bins.time[bins.next] = time + float(at);
    for (let part = 0; part < 12; part++) bins.value[bins.next * 12 + part] = float(at + 4 + 4 * part);
    bins.next = (bins.next + 1) % BINS;
    bins.count = Math.min(bins.count + 1, BINS);
  }
  const last = trail[trail.length - 1];
  if (!Number.isNaN(latest.tcp[0]) && (!last || distance(last, latest.tcp) > 0.004)) {
    trail.push(latest.tcp.slice(0, 3));
    if (trail.length > 400) trail.shift();
  }
  stats.frames += 1;
  changed = true;
}

const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

// ---- the connection -----------------------------------------------------------------------------------------------

let socket = null;
let wait = 500;

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const opened = new WebSocket(`${scheme}//${location.host}/live`);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.onopen = () => { wait = 500; heard = performance.now(); stats.connections += 1; latest = null; };
  opened.onmessage = (event) => {
    heard = performance.now();
    if (typeof event.data === "string") { state = JSON.parse(event.data); showState(); } else takeStrip(event.data);
  };
  opened.onclose = () => {
    if (socket !== opened) return;
    socket = null;
    showLink();
    setTimeout(connect, wait);
    wait = Math.min(wait * 2, 5000);
  };
}

// A connection that is silent is dead, whatever the system thinks of it (a phone that slept).
setInterval(() => {
  if (socket && socket.readyState === WebSocket.OPEN && performance.now() - heard > 3000) {
    const dead = socket;
    socket = null;
    dead.close();
    connect();
  }
  showLink();
}, 500);

// ---- commands -----------------------------------------------------------------------------------------------------

function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    localStorage.setItem("ft-token", given);
    history.replaceState(null, "", location.pathname);
  }
  return localStorage.getItem("ft-token");
}

let token = takeToken();

async function ask(name, argument = "") {
  say(`${name} ...`);
  try {
    const response = await fetch(`command/${name}`, { method: "POST", body: argument, headers: { Authorization: `Bearer ${token}` } });
    const said = await response.json();
    if (response.status === 401) { token = null; localStorage.removeItem("ft-token"); showButtons(); }
    say(said.ok ? done(name, said) : said.error, !said.ok);
  } catch (error) {
    say(`${name}: no answer (${error.message})`, true);
  }
}

function done(name, said) {
  if (name === "start") return `recording ${said.file}`;
  if (name === "stop") return said.ends_session ? "ending" : `finished ${said.file}, ${size(said.bytes)}`;
  return `marked ${said.mark}`;
}

function say(text, bad = false) {
  $("answer").textContent = text;
  $("answer").className = bad ? "bad" : "";
}

// A recording is not ended by one touch.
let asked = 0;
function pressStop() {
  if (performance.now() - asked < 3000) { asked = 0; $("stop").classList.remove("asks"); ask("stop"); return; }
  asked = performance.now();
  $("stop").classList.add("asks");
  say(state?.status?.stop_ends_session ? "press again to finish the recording and end the program" : "press again to finish the recording");
  setTimeout(() => $("stop").classList.remove("asks"), 3000);
}

$("start").onclick = () => ask("start");
$("stop").onclick = pressStop;
$("tare").onclick = () => ask("tare");
$("marking").onsubmit = (event) => {
  event.preventDefault();
  const text = $("text").value.trim();
  if (text) { ask("mark", text); $("text").value = ""; } else say("write the mark's text first", true);
};
for (const button of document.querySelectorAll(".quick")) button.onclick = () => ask("mark", button.dataset.mark);

// ---- what changes slowly ------------------------------------------------------------------------------------------

const size = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);
const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

function showLink() {
  const open = socket && socket.readyState === WebSocket.OPEN;
  const stale = !state?.status || state.status_age_s > 3;
  $("link").textContent = !open ? "connection lost: trying again" : stale ? `no word from the capture (${state?.source ?? "?"})` : "live";
  $("link").className = open && !stale ? "pill good" : "pill bad";
}

function showButtons() {
  const may = Boolean(token);
  const recording = state?.status?.recording ?? null;
  const known = Boolean(state?.status);
  for (const button of document.querySelectorAll("#controls button")) button.disabled = !may || !known;
  $("start").disabled ||= recording !== null;
  $("stop").disabled ||= recording === null;
  $("text").disabled = !may;
  if (!may) say("view only: commands need the address with #token=... that the capture printed");
}

function showState() {
  const status = state.status;
  $("name").textContent = status?.id ?? "ForceTwin";
  document.title = `${status?.id ?? "ForceTwin"} live`;
  const pill = $("recording");
  if (status?.recording) {
    pill.textContent = `● ${status.recording}  ${size(status.bytes)}  ${clock(status.recording_s ?? 0)}`;
    pill.className = "pill on";
  } else {
    pill.textContent = status ? "not recording" : "-";
    pill.className = "pill";
  }
  showLink();
  showButtons();
  rows($("devices"), ["device", "state", "rate/Hz", "gaps", "drops", "refused", "spread/µs"], (status?.streams ?? []).map((stream) => [
    stream.name, { text: stream.state, class: stream.state === "streaming" ? "text" : "text bad" }, stream.rate_hz.toFixed(0),
    count(stream.gaps), count(stream.drops), count(stream.refused), stream.clock ? stream.clock.spread_us.toFixed(0) : "-",
  ]));
  rows($("topics"), ["topic", "rate/Hz", "received", "missed", "age/ms"], Object.entries(state.topics).map(([name, topic]) => [
    name, topic.rate_hz.toFixed(0), topic.received, count(topic.missed), ((state.now_s - topic.last_ns * 1e-9) * 1e3).toFixed(0),
  ]));
  $("viewers").textContent = `${state.viewers} viewer${state.viewers === 1 ? "" : "s"}, ${state.viewer_drops} frames dropped for slow ones, ${stats.lost} of them here`;
  $("marks").replaceChildren(...state.marks.slice().reverse().map((mark) => {
    const item = document.createElement("li");
    const time = document.createElement("time");
    time.textContent = new Date(mark.at_s * 1e3).toLocaleTimeString();
    item.append(time, mark.text);
    return item;
  }));
}

const count = (value) => (value > 0 ? { text: value, class: "warn" } : value);

function rows(table, heads, lines) {
  const cell = (kind, value) => {
    const made = document.createElement(kind);
    made.textContent = value?.text ?? value;
    made.className = value?.class ?? (value === "state" ? "text" : "");
    return made;
  };
  const row = (kind, values) => {
    const made = document.createElement("tr");
    made.append(...values.map((value) => cell(kind, value)));
    return made;
  };
  table.replaceChildren(row("th", heads), ...lines.map((line) => row("td", line)));
}

// ---- drawing ------------------------------------------------------------------------------------------------------

let colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  colours = Object.fromEntries(["x", "y", "z", "line", "soft", "ink", "arrow", "card"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  changed = true;
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);

function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
    canvas.width = Math.round(wide * ratio);
    canvas.height = Math.round(high * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, high);
  return [context, wide, high];
}

// The step of a scale: 1, 2 or 5 times a power of ten.
function step(span) {
  const power = 10 ** (Math.floor(Math.log10(span)) - 1);
  return [1, 2, 5, 10, 20, 50].map((factor) => factor * power).find((candidate) => span / candidate <= 5);
}

const scales = {};
function drawStrip(name, offset, least) {
  const [context, wide, high] = prepare($(name));
  const end = latest ? latest.time : 0;
  const shown = [];
  let low = -least, top = least;
  for (let age = 1; age <= bins.count; age++) {
    const index = (bins.next - age + BINS) % BINS;
    if (end - bins.time[index] > SECONDS) break;
    shown.push(index);
    for (let axis = 0; axis < 3; axis++) {
      low = Math.min(low, bins.value[index * 12 + offset + axis]);
      top = Math.max(top, bins.value[index * 12 + 6 + offset + axis]);
    }
  }
  // The scale grows at once and shrinks slowly, so that it does not dance.
  const scale = (scales[name] ??= { low, top });
  scale.low = low < scale.low ? low : scale.low + 0.02 * (low - scale.low);
  scale.top = top > scale.top ? top : scale.top + 0.02 * (top - scale.top);
  const span = (scale.top - scale.low) * 1.1;
  const left = 38;
  const y = (value) => high / 2 - ((value - (scale.top + scale.low) / 2) / span) * (high - 8);
  const x = (time) => left + (1 + (time - end) / SECONDS) * (wide - left);
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "right";
  context.textBaseline = "middle";
  const grid = step(span);
  for (let tick = Math.ceil(scale.low / grid); tick * grid <= scale.top; tick++) {
    const at = y(tick * grid);
    context.strokeStyle = colours.line;
    context.lineWidth = tick === 0 ? 2 : 1;
    context.beginPath(); context.moveTo(left, at); context.lineTo(wide, at); context.stroke();
    context.fillStyle = colours.soft;
    context.fillText(String(Number((tick * grid).toPrecision(3))), left - 5, at);
  }
  for (let axis = 0; axis < 3; axis++) {
    context.strokeStyle = colours[AXES[axis]];
    context.lineWidth = 1.4;
    context.beginPath();
    let before = null;
    for (const index of shown) {
      const at = x(bins.time[index]);
      const low = y(bins.value[index * 12 + offset + axis]);
      const top = y(bins.value[index * 12 + 6 + offset + axis]);
      // A hole in the data is a hole in the line.
      if (before === null || bins.time[before] - bins.time[index] > 0.15) context.moveTo(at, top); else context.lineTo(at, top);
      if (low - top > 0.5) context.lineTo(at, low);
      before = index;
    }
    context.stroke();
  }
}

function legend(id, values, digits) {
  const spans = AXES.map((axis, index) => {
    const made = document.createElement("span");
    const name = document.createElement("b");
    name.textContent = `${axis} `;
    name.style.color = colours[axis];
    made.append(name, Number.isNaN(values[index]) ? "-" : values[index].toFixed(digits));
    return made;
  });
  $(id).replaceChildren(...spans);
}

// Turned by the hand: around the vertical, then up.
const eye = { around: -0.9, up: 0.45, scale: 1 };
{
  let from = null;
  $("tool").addEventListener("pointerdown", (event) => { from = event; $("tool").setPointerCapture(event.pointerId); });
  $("tool").addEventListener("pointerup", () => { from = null; });
  $("tool").addEventListener("pointermove", (event) => {
    if (!from) return;
    eye.around -= (event.clientX - from.clientX) * 0.01;
    eye.up = Math.max(-1.5, Math.min(1.5, eye.up + (event.clientY - from.clientY) * 0.01));
    from = event;
    changed = true;
  });
  $("tool").addEventListener("wheel", (event) => {
    event.preventDefault();
    eye.scale = Math.max(0.2, Math.min(5, eye.scale * Math.exp(-event.deltaY * 0.001)));
    changed = true;
  }, { passive: false });
}

function turn([x, y, z, w], [a, b, c]) {
  const [p, q, r] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p];
}
const add = (a, b) => a.map((value, index) => value + b[index]);

function drawTool() {
  const [context, wide, high] = prepare($("tool"));
  const known = latest && !Number.isNaN(latest.tcp[0]);
  const at = known ? latest.tcp.slice(0, 3) : [0, 0, 0];
  const pose = known ? latest.tcp.slice(3) : [0, 0, 0, 1];
  const sensor = latest ? latest.sensor : [0, 0, -0.15, 0, 0, 0, 1];
  const metre = Math.min(wide, high) * 1.7 * eye.scale;     // pixels
  const [sa, ca, su, cu] = [Math.sin(eye.around), Math.cos(eye.around), Math.sin(eye.up), Math.cos(eye.up)];
  const project = (point) => {
    const [x, y, z] = [point[0] - at[0], point[1] - at[1], point[2] - at[2]];
    const [right, away] = [ca * x - sa * y, sa * x + ca * y];
    return [wide / 2 + metre * right, high / 2 - metre * (cu * z + su * away)];
  };
  const line = (points, colour, width) => {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = context.lineCap = "round";
    context.beginPath();
    points.map(project).forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
  };
  const world = (point) => add(at, turn(pose, point));
  // A floor of 10 cm squares under the tool, still in the world.
  const floor = at[2] - 0.22;
  const [east, north] = [Math.round(at[0] * 10) / 10, Math.round(at[1] * 10) / 10];
  for (let index = -3; index <= 3; index++) {
    line([[east + index / 10, north - 0.3, floor], [east + index / 10, north + 0.3, floor]], colours.line, 1);
    line([[east - 0.3, north + index / 10, floor], [east + 0.3, north + index / 10, floor]], colours.line, 1);
  }
  if (trail.length > 1) line(trail, colours.soft, 1);
  // From the sensor to the pads, the pads as far apart as the gripper is open.
  const wrist = sensor.slice(0, 3);
  const half = (Number.isNaN(latest?.width ?? NaN) ? 0.04 : latest.width) / 2;
  const palm = wrist.map((value) => value * 0.35);
  line([world(wrist), world(palm)], colours.ink, 7);
  for (const side of [-1, 1]) {
    const root = [palm[0] + side * half, palm[1], palm[2]];
    line([world(palm), world(root), world([side * half, 0, 0])], colours.ink, 4);
  }
  const origin = world(wrist);
  for (const [index, axis] of AXES.entries()) {
    const direction = [0, 0, 0];
    direction[index] = 0.06;
    line([origin, add(origin, turn(pose, turn(sensor.slice(3), direction)))], colours[axis], 2);
  }
  if (latest && !Number.isNaN(latest.force[0])) {
    // 4 mm for each newton, from the point between the pads; at most 40 cm.
    const force = turn(pose, turn(sensor.slice(3), latest.force));
    const norm = Math.hypot(...force);
    const tip = add(at, force.map((part) => part * 0.004 * Math.min(1, 100 / Math.max(norm, 1e-9))));
    line([at, tip], colours.arrow, 4);
    const [[x0, y0], [x1, y1]] = [project(at), project(tip)];
    const angle = Math.atan2(y1 - y0, x1 - x0);
    if (Math.hypot(x1 - x0, y1 - y0) > 6) {
      context.fillStyle = colours.arrow;
      context.beginPath();
      for (const [along, beside] of [[9, 0], [-4, 6], [-4, -6]]) {
        context.lineTo(x1 + along * Math.cos(angle) - beside * Math.sin(angle), y1 + along * Math.sin(angle) + beside * Math.cos(angle));
      }
      context.fill();
    }
    $("norm").textContent = `force on the tool ${norm.toFixed(1)} N`;
  }
  if (!known) {
    context.fillStyle = colours.soft;
    context.font = "12px system-ui, sans-serif";
    context.fillText("no pose: drawn upright", 8, high - 10);
  }
}

let second = performance.now(), inSecond = 0;
function draw(now) {
  requestAnimationFrame(draw);
  inSecond += 1;
  if (now - second >= 1000) {
    stats.fps = (inSecond * 1000) / (now - second);
    [second, inSecond] = [now, 0];
  }
  if (!changed) return;
  changed = false;
  stats.drawn += 1;
  drawStrip("force", 0, 1);
  drawStrip("torque", 3, 0.1);
  drawTool();
  if (latest) {
    legend("force-legend", latest.force, 2);
    legend("torque-legend", latest.torque, 3);
    const open = !Number.isNaN(latest.width);
    $("width").textContent = open ? `width ${(latest.width * 1e3).toFixed(1)} mm` : "width -";
    $("opening").style.width = open ? `${Math.min(100, latest.width * 1e3)}%` : "0";
  }
}

new ResizeObserver(() => { changed = true; }).observe(document.body);
readColours();
showButtons();
connect();
requestAnimationFrame(draw);
