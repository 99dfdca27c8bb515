// Viewer of replays, which drawing.js draws.
"use strict";

const entries = Object.entries(replays.entries).map(([key, entry]) => ({ key, ...entry })); // from replays/index.js
const loaded = new Map(); // episodes by key

// Called by the scripts in replays/.
function replay(key, data) {
  loaded.set(key, decode(data));
}

function load(key) {
  if (loaded.has(key)) return Promise.resolve(loaded.get(key));
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = `replays/${key}.js`;
    script.onload = () => resolve(loaded.get(key));
    script.onerror = () => reject(new Error(`replays/${key}.js could not be loaded`));
    document.head.append(script);
  });
}

// ---------------------------------------------------------------- playing

let previous = 0; // time of the previous frame, ms

function tick(now) {
  if (!state.playing) return;
  // A frame may have started before the key was pressed; a hidden page has no frames at all.
  const elapsed = Math.max(0, Math.min((now - previous) / 1000, 0.25));
  previous = now;
  const time = state.time + (elapsed * Number(element("speed").value)) / state.shown[0].step;
  state.time = Math.min(time, state.steps);
  if (state.time === state.steps) play(false);
  draw();
  requestAnimationFrame(tick);
}

function play(on) {
  if (on && state.time >= state.steps) state.time = 0;
  state.playing = on;
  element("play").textContent = on ? "Pause" : "Play";
  if (on) {
    previous = performance.now();
    requestAnimationFrame(tick);
  } else {
    updateAddress();
  }
}

function seek(time) {
  play(false);
  state.time = Math.max(0, Math.min(time, state.steps));
  draw();
  updateAddress();
}

const step = (by) => seek(by < 0 ? Math.ceil(state.time) + by : Math.floor(state.time) + by);

// ---------------------------------------------------------------- selection

const selection = () => ({
  column: element("column").value, case: element("case").value,
  left: element("left").value, right: element("right").value,
});

function fill(id, values, preferred, label = (value) => value) {
  const select = element(id), current = preferred ?? select.value;
  select.replaceChildren(...values.map((value) => new Option(label(value), value)));
  select.value = values.includes(current) ? current : values[0];
}

const distinct = (list, key) => [...new Set(list.map((entry) => entry[key]))];

// Update the options; keep the selection where it still exists.
function updateOptions(preferred = {}) {
  fill("column", distinct(entries, "column"), preferred.column);
  const inColumn = entries.filter((entry) => entry.column === selection().column);
  fill("case", distinct(inColumn, "case"), preferred.case);
  const inCase = inColumn.filter((entry) => entry.case === selection().case);
  const label = (method) => {
    const entry = inCase.find((one) => one.method === method);
    return entry ? `${entry.success ? "✓" : "✗"} ${method}` : "nothing";
  };
  fill("left", distinct(inCase, "method"), preferred.left, label);
  fill("right", ["", ...distinct(inCase, "method")], preferred.right, label);
}

let loading = 0;

async function show() {
  const choice = selection(), ticket = ++loading;
  const keys = [choice.left, choice.right].map((method) => entries.find((entry) =>
    entry.column === choice.column && entry.case === choice.case && entry.method === method)?.key);
  let episodes;
  try {
    episodes = await Promise.all(keys.map((key) => key && load(key)));
  } catch (error) {
    element("failure").textContent = error.message;
    element("failure").hidden = false;
    return;
  }
  if (ticket !== loading) return; // the selection has changed meanwhile
  sides.forEach((side, i) => {
    side.episode = episodes[i] || null;
    side.section.hidden = !side.episode;
    side.name.textContent = [choice.left, choice.right][i];
  });
  state.shown = episodes.filter(Boolean);
  state.steps = Math.max(...state.shown.map((episode) => episode.last));
  state.time = Math.min(state.time, state.steps);
  state.bounds = boundsOf(state.shown);
  element("stage").classList.toggle("alone", state.shown.length === 1);
  element("raysLabel").hidden = !state.shown.some((episode) => episode.lidar);
  element("time").max = state.steps;
  const count = state.shown[0].robots.length;
  showRobotButtons(count);
  selectRobot(Math.min(state.robot, count - 1));
}

// Keep the selection in the address, so that it can be shared.
function updateAddress() {
  const address = new URLSearchParams({
    ...selection(), robot: state.robot, step: Math.floor(state.time),
  });
  history.replaceState(null, "", `#${address}`);
}

// ---------------------------------------------------------------- the page

function key(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
  const second = state.shown.length ? Math.round(1 / state.shown[0].step) : 1;
  const speed = element("speed");
  const faster = (by) => {
    speed.selectedIndex = Math.max(0, Math.min(speed.selectedIndex + by, speed.length - 1));
  };
  const actions = {
    " ": () => play(!state.playing),
    ArrowLeft: () => step(event.shiftKey ? -second : -1),
    ArrowRight: () => step(event.shiftKey ? second : 1),
    Home: () => seek(0),
    End: () => seek(state.steps),
    "+": () => faster(1),
    "=": () => faster(1),
    "-": () => faster(-1),
  };
  const onButton = event.target.tagName === "BUTTON" || event.target.tagName === "SUMMARY";
  if (event.key === " " && onButton) return; // it presses the button
  const action = actions[event.key] || (/^\d$/.test(event.key) && (() => selectRobot(Number(event.key))));
  if (!action || !state.shown.length) return;
  event.preventDefault();
  action();
}

element("play").onclick = () => play(!state.playing);
element("back").onclick = () => step(-1);
element("forward").onclick = () => step(1);
element("strip").onclick = (event) =>
  seek(Math.round((event.offsetX / event.target.clientWidth) * state.steps));
element("time").oninput = (event) => seek(Number(event.target.value));
element("rays").onchange = draw;
element("choice").onsubmit = (event) => event.preventDefault();
element("choice").onchange = () => { updateOptions(); show(); };
document.addEventListener("keydown", key);
sides.forEach((side) => {
  side.canvas.onclick = (event) => {
    const at = floorPoint(side.canvas, event);
    const distances = side.episode.robots.map((path) =>
      distance(at, between(path, Math.min(state.time, side.episode.last))));
    selectRobot(distances.indexOf(Math.min(...distances)));
  };
});
document.addEventListener("robotselected", updateAddress);

if (entries.length < replays.total) {
  element("progress").textContent = `${entries.length} of ${replays.total} replays are recorded so far. Reload this page to see more.`;
}
const initial = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
state.time = Math.max(0, Math.trunc(initial.step)) || 0;
state.robot = Math.max(0, Math.trunc(initial.robot)) || 0;
// By default SAMARL and ORCA with a view of 360°, or the two methods that succeed most often.
const successes = (method) => entries.filter((e) => e.method === method && e.success).length;
const ranking = distinct(entries, "method").sort((a, b) => successes(b) - successes(a));
const [best, second = ""] = [...["SAMARL", "ORCA"].filter((m) => ranking.includes(m)),
  ...ranking.filter((m) => !["SAMARL", "ORCA"].includes(m))];
const column = distinct(entries, "column").find((name) => name.startsWith("360°"));
if (entries.length) {
  updateOptions({ column, left: best, right: second, ...initial });
  show();
}
