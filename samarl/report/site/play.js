// The playground: the page asks for one step after the other and draws between them (drawing.js).
"use strict";

const socket = new WebSocket(`ws://${location.host}/socket`);
const queue = []; // messages that wait for the answer to the one before
let waiting = false; // for an answer
let slow = 0; // timer of the message that it takes long
let view = null; // the last view of the server
let tool = "move";
let drag = null; // what the pointer does: {what, number, side, at, ...}
const keys = new Set(); // pressed, of up, down, left and right
const inputs = { scenario: "scenario", layout: "layout", robots: "robotCount", humans: "humans",
  view: "view", crowd: "crowd", reaction: "reaction", case: "case" };

// ---------------------------------------------------------------- messages

// Send a message, or replace one of the same kind that still waits.
function send(message) {
  const same = queue.findIndex(({ type, begins }) => type === message.type && !begins);
  if (same >= 0 && ["move", "walk", "drive"].includes(message.type) && !message.begins) queue[same] = message;
  else queue.push(message);
  sendNext();
}

function sendNext() {
  if (waiting || !queue.length || socket.readyState !== WebSocket.OPEN) return;
  waiting = true;
  slow = setTimeout(() => say("Working ... What is used for the first time is compiled, which takes up to a minute."), 2000);
  socket.send(JSON.stringify(queue.shift()));
}

socket.onopen = sendNext;
socket.onclose = () => { say("The server has stopped. Start samarl-play again and reload this page.", true); play(false); };
socket.onmessage = (event) => {
  const message = JSON.parse(event.data);
  waiting = false;
  clearTimeout(slow);
  if (!view || element("message").textContent.startsWith("Working")) say("");
  if (message.type === "view") show(message);
  if (message.type === "error") { stopAttack(); say(message.message, true); if (view) showChoices(); }
  if (message.type === "attack") showAttack(message);
  if (message.type === "saved") say(`Saved as ${message.path}. Play it: samarl-evaluate scenario.case_file=${message.path} agent=${view.sides[0].agent}`);
  sendNext();
};

function say(text, wrong = false) {
  element("message").textContent = text;
  element("message").classList.toggle("failure", wrong);
}

// ---------------------------------------------------------------- views

function show(message) {
  const isNew = !view || message.scene !== view.scene;
  const back = view && message.clock < view.clock;
  view = message;
  sides.forEach((side, i) => {
    const shown = message.sides[i];
    side.section.hidden = !shown;
    side.name.textContent = shown ? shown.label : "";
    side.episode = shown ? { ...decode(shown.episode), insight: shown.insight } : null;
  });
  state.shown = sides.map((side) => side.episode).filter(Boolean);
  state.steps = Math.max(...state.shown.map((episode) => episode.last));
  if (isNew || back || isStep) state.time = state.steps;
  isStep = false;
  state.bounds = isNew ? boundsOf(state.shown) : union(state.bounds, boundsOf(state.shown));
  element("stage").classList.toggle("alone", state.shown.length === 1);
  element("raysLabel").hidden = !state.shown.some((episode) => episode.lidar);
  element("time").max = Math.max(state.steps, 1);
  element("undo").disabled = !message.undo;
  element("note").textContent = message.sides.map((side) => side.note).filter(Boolean).join("; ");
  if (isOverAll() && state.time >= state.steps) play(false);
  showRobotButtons(state.shown[0].robots.length);
  showChoices();
  selectRobot(Math.min(state.robot, state.shown[0].robots.length - 1));
  document.body.dataset.ready = message.clock;
  if (playWhenShown) { playWhenShown = false; play(true); }
}

const isOverAll = () => view.sides.every((side) => side.over);

function union(a, b) {
  const low = [0, 1].map((axis) => Math.min(a.middle[axis] - a.half, b.middle[axis] - b.half));
  const high = [0, 1].map((axis) => Math.max(a.middle[axis] + a.half, b.middle[axis] + b.half));
  const half = Math.max(high[0] - low[0], high[1] - low[1]) / 2;
  return half > a.half + 1e-9 ? { middle: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2], half } : a;
}

function showChoices() {
  element("left").value = view.sides[0].agent;
  element("right").value = view.sides[1] ? view.sides[1].agent : "";
  for (const [field, id] of Object.entries(inputs)) {
    const input = element(id), value = String(view[field]);
    if (input.tagName === "SELECT" && ![...input.options].some((option) => option.value === value)) {
      input.add(new Option(field === "view" ? `${value}°` : value, value));
    }
    if (document.activeElement !== input || input.tagName === "SELECT") input.value = value;
  }
}

function choose(event) {
  const id = event.target.id, field = Object.keys(inputs).find((name) => inputs[name] === id);
  say("");
  if (!field) {
    send({ type: "choose", agents: [element("left").value, element("right").value].filter(Boolean) });
    return;
  }
  const value = event.target.value;
  const isNumber = ["robots", "humans", "view", "case"].includes(field);
  send({ type: "choose", [field]: isNumber ? Number(value) : value });
}

// ---------------------------------------------------------------- attacks

let attacking = false;

function showAttack({ tried, seconds, change, failure, over }) {
  const found = change === null ? "none makes the agent fail yet" : `a change of ${change.toFixed(2)} m makes it fail: ${failure}`;
  say(`Attack: ${tried} paths of people tried in ${seconds} s of computing; ${found}.`);
  if (attacking && !over) { send({ type: "attack" }); return; }
  stopAttack();
  if (change === null) return;
  send({ type: "attack", play: true });
  playWhenShown = true;
}

function stopAttack() {
  attacking = false;
  element("attack").textContent = "Attack";
}

function attack() {
  play(false);
  if (attacking) { attacking = false; return; } // the next answer ends it
  attacking = true;
  element("attack").textContent = "Stop and play";
  say("Attack: playing the scene, then searching for the smallest change of one person's path that makes the agent fail.");
  send({ type: "attack" });
}

let playWhenShown = false;

// ---------------------------------------------------------------- playing

let previous = 0; // time of the previous frame, ms

function tick(now) {
  if (!state.playing) return;
  const elapsed = Math.max(0, Math.min((now - previous) / 1000, 0.25));
  previous = now;
  const speed = Number(element("speed").value);
  state.time = Math.min(state.time + (elapsed * speed) / state.shown[0].step, state.steps);
  if (state.time > state.steps - Math.max(1, speed / 2)) stepIfIdle();
  if (isOverAll() && state.time >= state.steps) play(false);
  draw();
  document.body.dataset.frames = Number(document.body.dataset.frames || 0) + 1;
  requestAnimationFrame(tick);
}

function stepIfIdle() {
  if (isOverAll() || waiting || queue.length) return;
  if (drag?.what) send({ type: "move", what: drag.what, number: drag.number, position: drag.at, begins: false });
  send({ type: "step" });
}

function play(on) {
  if (on && isOverAll() && state.time >= state.steps) {
    playWhenShown = true;
    send({ type: "restart" });
    return;
  }
  state.playing = on && Boolean(view);
  element("play").textContent = state.playing ? "Pause" : "Play";
  if (state.playing) {
    previous = performance.now();
    requestAnimationFrame(tick);
  }
}

function step() {
  play(false);
  if (state.time < state.steps) { state.time = Math.floor(state.time) + 1; draw(); return; }
  send({ type: "step" });
  isStep = true;
}

let isStep = false; // the next view is shown to its end

// ---------------------------------------------------------------- the pointer

const TOUCH = 18; // pixels round an agent in which it is grabbed

// What lies under a point of a side: {what, number}, or null.
function grabbed(side, at) {
  const episode = side.episode, t = episode.last, reach = (TOUCH / side.canvas.clientWidth) * 2 * state.bounds.half;
  const shown = Math.min(state.time, t);
  const candidates = [
    ...episode.robots.map((path, number) => ({ what: "robot", number, gap: distance(between(path, shown), at) - episode.radius })),
    ...episode.humans.map((path, number) => ({ what: "person", number,
      gap: isPresent(episode, number, t) ? distance(between(path, shown), at) - episode.radii[number] : Infinity })),
    ...episode.goals.map((goal, number) => ({ what: "goal", number, gap: distance(goal, at) })),
  ];
  const nearest = candidates.reduce((a, b) => (b.gap < a.gap ? b : a));
  return nearest.gap < reach ? nearest : null;
}

function pointerDown(side, event) {
  if (!view || (event.pointerType === "mouse" && event.button !== 0)) return;
  const at = floorPoint(side.canvas, event);
  side.canvas.setPointerCapture(event.pointerId);
  event.preventDefault();
  if (tool === "wall") drag = { wall: at, at, side };
  else if (tool === "erase") send({ type: "erase", position: at });
  else if (tool === "person") {
    if (view.walker === null || event.shiftKey) send({ type: "add", position: at });
    else send({ type: "walk", position: at });
    drag = { walk: true, at, side };
  } else {
    const target = grabbed(side, at);
    if (target?.what === "robot") selectRobot(target.number);
    if (target) drag = { grabbed: target, from: at, at, side };
  }
  draw();
}

function pointerMove(side, event) {
  if (!drag) {
    if (tool === "person" && view?.walker !== null && event.pointerType === "mouse") {
      send({ type: "walk", position: floorPoint(side.canvas, event) });
    }
    if (tool === "move" && view) side.canvas.style.cursor = grabbed(side, floorPoint(side.canvas, event)) ? "grab" : "";
    return;
  }
  drag.at = floorPoint(side.canvas, event);
  if (drag.grabbed && !drag.what && distance(drag.from, drag.at) > 0.1) { // it is a drag, not a click
    Object.assign(drag, { what: drag.grabbed.what, number: drag.grabbed.number, begins: true });
  }
  if (drag.what) {
    send({ type: "move", what: drag.what, number: drag.number, position: drag.at, begins: Boolean(drag.begins) });
    drag.begins = false;
  }
  if (drag.walk) send({ type: "walk", position: drag.at });
  draw();
}

function pointerUp() {
  if (drag?.wall && distance(drag.wall, drag.at) > 0) send({ type: "wall", start: drag.wall, end: drag.at });
  drag = null;
  draw();
}

// What is being dragged or drawn is shown at once, before the server answers.
function drawDrag() {
  if (!drag || !state.bounds) return;
  const { canvas } = drag.side, { middle, half } = state.bounds;
  const scale = canvas.clientWidth / (2 * half), pen = canvas.getContext("2d");
  const place = ([x, y]) => [(x - middle[0] + half) * scale, (half - y + middle[1]) * scale];
  pen.strokeStyle = colours.ink;
  pen.beginPath();
  if (drag.wall) { pen.lineWidth = 3; pen.moveTo(...place(drag.wall)); pen.lineTo(...place(drag.at)); }
  if (drag.what) { pen.lineWidth = 2; pen.arc(...place(drag.at), 0.36 * scale, 0, 2 * Math.PI); }
  pen.stroke();
}

element("setup").open = innerWidth > 640; // on a phone the floor comes first
state.afterDraw = drawDrag;
sides.forEach((side) => {
  side.canvas.addEventListener("pointerdown", (event) => pointerDown(side, event));
  side.canvas.addEventListener("pointermove", (event) => pointerMove(side, event));
  for (const kind of ["pointerup", "pointercancel"]) side.canvas.addEventListener(kind, pointerUp);
});

// ---------------------------------------------------------------- tools and keys

const DRIVING = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right",
  w: "up", s: "down", a: "left", d: "right" };

function useTool(name) {
  if (tool === "drive" && name !== "drive") send({ type: "drive", robot: null });
  tool = name;
  document.querySelectorAll("[data-tool]").forEach((button) =>
    button.setAttribute("aria-pressed", String(button.dataset.tool === name)));
  element("pad").hidden = name !== "drive";
  say(document.querySelector(`[data-tool=${name}]`).title);
  if (name === "drive") sendKeys();
}

const sendKeys = () => send({ type: "drive", robot: state.robot, keys: [...keys] });

function press(key, on) {
  if (on === keys.has(key)) return;
  if (on) keys.add(key); else keys.delete(key);
  sendKeys();
}

function keyDown(event) {
  if (["SELECT", "INPUT"].includes(event.target.tagName) && event.target.type !== "range") return;
  if ((event.ctrlKey || event.metaKey) && event.key === "z") { event.preventDefault(); send({ type: "undo" }); return; }
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (tool === "drive" && DRIVING[event.key]) { event.preventDefault(); press(DRIVING[event.key], true); return; }
  const onButton = event.target.tagName === "BUTTON" || event.target.tagName === "SUMMARY";
  if (event.key === " " && !onButton) play(!state.playing);
  else if (event.key === "ArrowRight") step();
  else if (/^\d$/.test(event.key)) selectRobot(Number(event.key));
  else return;
  event.preventDefault();
}

document.addEventListener("keydown", keyDown);
document.addEventListener("keyup", (event) => { if (DRIVING[event.key]) press(DRIVING[event.key], false); });
document.addEventListener("robotselected", () => { if (tool === "drive" && view.driven !== null && view.driven !== state.robot) sendKeys(); });
document.querySelectorAll("[data-tool]").forEach((button) => { button.onclick = () => useTool(button.dataset.tool); });
document.querySelectorAll("[data-key]").forEach((button) => {
  button.onpointerdown = (event) => { event.preventDefault(); press(button.dataset.key, true); };
  button.onpointerup = button.onpointercancel = button.onpointerleave = () => press(button.dataset.key, false);
});
element("play").onclick = () => play(!state.playing);
element("forward").onclick = step;
element("restart").onclick = () => { say(""); send({ type: "restart" }); };
element("next").onclick = () => { say(""); send({ type: "choose", case: view.case + 1 }); };
element("attack").onclick = attack;
element("undo").onclick = () => { say(""); send({ type: "undo" }); };
element("strip").onclick = (event) => { play(false); state.time = Math.round((event.offsetX / event.target.clientWidth) * state.steps); draw(); };
element("time").oninput = (event) => { play(false); state.time = Number(event.target.value); draw(); };
element("rays").onchange = draw;
element("choice").onsubmit = (event) => event.preventDefault();
element("choice").onchange = choose;
element("keep").onsubmit = (event) => { event.preventDefault(); send({ type: "save", name: element("name").value }); };
