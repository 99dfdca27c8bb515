// Drawing of episodes, for the viewer of replays and for the playground: one or two methods on the
// same case, with a shared clock.
"use strict";

const element = (id) => document.getElementById(id);
// time in steps; shown: episodes; bounds: see `boundsOf`;
// afterDraw: function, or none
const state = { time: 0, playing: false, robot: 0, steps: 0, shown: [] };
const sides = [...document.querySelectorAll(".side")].map((section) => ({
  section,
  canvas: section.querySelector("canvas"),
  name: section.querySelector("h2"),
  outcome: section.querySelector(".outcome"),
  sight: section.querySelector(".sight"),
  episode: null,
}));

// ---------------------------------------------------------------- data

// Decode an episode of `samarl.report.replays.as_replay`.
function decode(data) {
  const sums = (differences) => { let sum = 0; return differences.map((d) => (sum += d)); };
  const points = (agents) => agents.map(([x, y]) => {
    const [xs, ys] = [sums(x), sums(y)];
    return xs.map((value, t) => [value / 100, ys[t] / 100]);
  });
  return {
    ...data,
    last: data.robots[0][0].length - 1,
    robots: points(data.robots),
    humans: points(data.humans),
    waypoints: data.waypoints && points(data.waypoints),
    headings: data.headings.map((h) => sums(h).map((degrees) => (degrees * Math.PI) / 180)),
  };
}

const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const isOn = (switches, t) => switches.filter((step) => step <= t).length % 2 === 1;

const isPresent = (episode, human, t) => isOn(episode.humansPresent[human], t);

function between(series, t) {
  const k = Math.min(Math.floor(t), series.length - 1);
  const next = series[Math.min(k + 1, series.length - 1)];
  const share = t - k;
  if (typeof next === "number") return series[k] + share * (next - series[k]);
  return series[k].map((value, axis) => value + share * (next[axis] - value));
}

// The others from the view of one robot at step k: {kind, number, visible, shared, percent of
// attention}. Those that are shared by team-mates are visible as well.
function othersOf(episode, robot, k) {
  const at = Math.min(k, episode.last - 1);
  const list = [];
  for (const [kind, visible, shared, attention] of [
    ["human", episode.humansVisible, episode.humansReported, episode.humanAttention],
    ["robot", episode.robotsVisible, episode.robotsReported, episode.robotAttention],
  ]) {
    visible[robot].forEach((switches, number) => {
      if (kind === "robot" && number === robot) return;
      const percent = attention ? attention[at][robot][number] : null;
      if (kind === "human" && !isPresent(episode, number, k)) return;
      list.push({
        kind, number, percent, visible: isOn(switches, k),
        shared: Boolean(shared) && isOn(shared[robot][number], k),
      });
    });
  }
  return list;
}

// ---------------------------------------------------------------- drawing

const style = () => getComputedStyle(document.documentElement);
const darkness = matchMedia("(prefers-color-scheme: dark)");
let colours = {};

function readColours() {
  const properties = style();
  colours = {};
  for (const name of ["ink", "muted", "grid", "contact", "passage", "attention", "page", "panel"]) {
    colours[name] = properties.getPropertyValue(`--${name}`).trim();
  }
  colours.robots = [0, 1, 2, 3, 4, 5, 6].map((i) => properties.getPropertyValue(`--series-${i}`).trim());
}

const colourOf = (robot) => colours.robots[robot % colours.robots.length];

// The square around everything in some episodes: its middle and half its side.
function boundsOf(episodes) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const episode of episodes) {
    const { robots, humans, goals } = episode;
    const present = humans.flatMap((path, j) => path.filter((_, t) => isPresent(episode, j, t)));
    const ends = episode.walls.flatMap(([x0, y0, x1, y1]) => [[x0, y0], [x1, y1]]);
    for (const point of [...robots.flat(), ...present, ...goals, ...ends]) {
      for (const axis of [0, 1]) {
        low[axis] = Math.min(low[axis], point[axis]);
        high[axis] = Math.max(high[axis], point[axis]);
      }
    }
  }
  const half = Math.max(high[0] - low[0], high[1] - low[1]) / 2 + 0.8;
  return { middle: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2], half };
}

function drawSide({ canvas, episode }) {
  const size = canvas.clientWidth, ratio = devicePixelRatio || 1;
  const pixels = Math.round(size * ratio);
  if (canvas.width !== pixels) canvas.width = canvas.height = pixels;
  const { middle, half } = state.bounds;
  const scale = size / (2 * half);
  const place = ([x, y]) => [(x - middle[0] + half) * scale, (half - y + middle[1]) * scale];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, size, size);
  pen.lineJoin = "round";

  const line = (points, colour, width, dash = []) => {
    pen.beginPath();
    points.map(place).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.setLineDash(dash);
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.stroke();
    pen.setLineDash([]);
  };
  const disc = (centre, radius, { fill, stroke, width = 1.5, dash = [], alpha = 1 }) => {
    pen.beginPath();
    pen.arc(...place(centre), radius * scale, 0, 2 * Math.PI);
    pen.globalAlpha = alpha;
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    pen.globalAlpha = 1;
    if (stroke) {
      pen.setLineDash(dash);
      pen.strokeStyle = stroke;
      pen.lineWidth = width;
      pen.stroke();
      pen.setLineDash([]);
    }
  };
  const polygon = (centre, corners, radius, colour) => {
    const [x, y] = place(centre);
    pen.beginPath();
    corners.forEach(([turn, far]) => {
      const angle = turn * 2 * Math.PI - Math.PI / 2;
      pen.lineTo(x + far * radius * Math.cos(angle), y + far * radius * Math.sin(angle));
    });
    pen.closePath();
    pen.fillStyle = colour;
    pen.fill();
    pen.strokeStyle = colours.panel;
    pen.lineWidth = 1;
    pen.stroke();
  };
  const write = (text, [x, y], colour, size = 11, halo = null) => {
    pen.font = `600 ${size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    if (halo) {
      pen.strokeStyle = halo;
      pen.lineWidth = 3;
      pen.strokeText(text, x, y);
    }
    pen.fillStyle = colour;
    pen.fillText(text, x, y);
  };

  const t = Math.min(state.time, episode.last), k = Math.floor(t), me = state.robot;
  const robots = episode.robots.map((path) => between(path, t));
  const humans = episode.humans.map((path) => between(path, t));
  const others = othersOf(episode, me, k);
  const driving = (i) => t < episode.drivingSteps[i];

  for (let metre = Math.ceil((middle[0] - half) / 2) * 2; metre < middle[0] + half; metre += 2) {
    line([[metre, middle[1] - half], [metre, middle[1] + half]], colours.grid, 1);
  }
  for (let metre = Math.ceil((middle[1] - half) / 2) * 2; metre < middle[1] + half; metre += 2) {
    line([[middle[0] - half, metre], [middle[0] + half, metre]], colours.grid, 1);
  }

  if (episode.lidar && element("rays").checked) {
    const heading = between(episode.headings[me], t);
    pen.globalAlpha = 0.35;
    episode.lidar.ranges[me][k].forEach((range, ray) => {
      const angle = heading + episode.lidar.angles[ray];
      const [dx, dy] = [Math.cos(angle), Math.sin(angle)].map((part) => (part * range) / 100);
      line([robots[me], [robots[me][0] + dx, robots[me][1] + dy]], colourOf(me), 1);
    });
    pen.globalAlpha = 1;
  }
  episode.queuePlaces.forEach((place) =>
    disc(place, episode.radius, { stroke: colours.passage, width: 1, dash: [3, 3] }));
  episode.mouths.forEach(([x, y, outX, outY, width]) => {
    const half = [(-outY * width) / 2, (outX * width) / 2];
    line([[x - half[0], y - half[1]], [x + half[0], y + half[1]]], colours.passage, 1.5, [4, 3]);
    const at = (far, side) => [x + far * outX - side * outY, y + far * outY + side * outX];
    line([at(0.6, 0), at(0.12, 0)], colours.passage, 1.5);
    line([at(0.3, 0.13), at(0.12, 0), at(0.3, -0.13)], colours.passage, 1.5);
  });
  episode.walls.forEach(([x0, y0, x1, y1]) => line([[x0, y0], [x1, y1]], colours.ink, 3));

  robots.forEach((robot, i) => { // fields of view
    const view = (episode.fov * Math.PI) / 180, heading = between(episode.headings[i], t);
    const [x, y] = place(robot);
    if (episode.fov >= 360) {
      if (i === me) disc(robot, episode.range, { stroke: colourOf(i), width: 1, dash: [6, 4] });
      return;
    }
    const reach = i === me ? episode.range : 4 * episode.radius; // of the others only the direction
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, reach * scale, -heading - view / 2, -heading + view / 2);
    pen.closePath();
    pen.globalAlpha = i === me ? 0.13 : 0.2;
    pen.fillStyle = colourOf(i);
    pen.fill();
    pen.globalAlpha = i === me ? 0.5 : 0;
    pen.strokeStyle = colourOf(i);
    pen.lineWidth = 1;
    pen.stroke();
    pen.globalAlpha = 1;
  });

  humans.forEach((human, j) => {
    if (!isPresent(episode, j, k)) return;
    const reach = episode.radii[j] + episode.zone;
    const near = robots.some((robot, i) =>
      driving(i) && distance(robot, human) < reach + episode.radius);
    disc(human, reach, { fill: near ? colours.contact : colours.muted, alpha: near ? 0.25 : 0.14 });
  });
  others.filter((o) => o.percent >= 1).forEach(({ kind, number, percent }) => {
    const towards = kind === "human" ? humans[number] : robots[number];
    pen.globalAlpha = 0.55;
    line([robots[me], towards], colours.attention, 1 + percent / 8);
    pen.globalAlpha = 1;
  });
  const arrow = (path, colour) => { // position in one second at constant velocity
    const from = between(path, t), to = between(path, Math.min(t + 1, episode.last));
    const speed = [0, 1].map((axis) => (to[axis] - from[axis]) / (Math.min(t + 1, episode.last) - t || 1));
    const tip = [0, 1].map((axis) => from[axis] + speed[axis] / episode.step);
    if (distance(from, tip) < 0.1) return;
    const angle = Math.atan2(speed[1], speed[0]);
    line([from, tip], colour, 1.5);
    for (const side of [-2.6, 2.6]) {
      line([tip, [tip[0] + 0.16 * Math.cos(angle + side), tip[1] + 0.16 * Math.sin(angle + side)]], colour, 1.5);
    }
  };
  episode.humans.forEach((path, j) => { if (isPresent(episode, j, k)) arrow(path, colours.muted); });
  episode.robots.forEach((path, i) => { if (driving(i)) arrow(path, colourOf(i)); });

  others.filter((o) => o.kind === "human").forEach(({ number, visible, shared }) => {
    const direct = visible && !shared;
    disc(humans[number], episode.radii[number], direct
      ? { fill: colours.muted, stroke: colours.ink, width: 1 }
      : { fill: colours.panel, stroke: colours.muted, dash: shared ? [] : [3, 3], width: shared ? 2.5 : 1.5 });
    write(String(number), place(humans[number]), direct ? colours.page : colours.muted, 10);
  });

  const insight = isNow(episode, t) && episode.insight[me];
  if (insight) {
    line([robots[me], ...insight.route], colourOf(me), 1.5, [8, 5]);
    insight.tracks.filter(([, , , age]) => age > 0).forEach(([number, x, y, age]) => {
      disc([x, y], episode.radii[number], { stroke: colourOf(me), dash: [2, 3] });
      write(`${number}: ${age.toFixed(1)} s`, place([x, y]), colourOf(me), 10);
    });
  }

  const star = [...Array(10).keys()].map((i) => [i / 10, i % 2 ? 0.42 : 1]);
  const diamond = [[0, 1], [0.25, 1], [0.5, 1], [0.75, 1]];
  episode.goals.forEach((goal, i) => polygon(goal, star, 10, colourOf(i)));
  robots.forEach((robot, i) => {
    const colour = colourOf(i), path = episode.robots[i];
    pen.globalAlpha = 0.3;
    line(path, colour, 1);
    pen.globalAlpha = 1;
    line([...path.slice(0, k + 1), robot], colour, 2.2);
    const waypoint = episode.waypoints?.[i][Math.min(k, episode.last - 1)];
    if (waypoint && driving(i) && distance(waypoint, episode.goals[i]) > 0.02) {
      line([robot, waypoint], colour, 1.5, [2, 4]);
      polygon(waypoint, diamond, 6, colour);
    }
  });
  robots.forEach((robot, i) => {
    const visible = i === me || others.some((o) => o.kind === "robot" && o.number === i && o.visible);
    const heading = between(episode.headings[i], t), colour = colourOf(i);
    const tip = [0, 1].map((axis) =>
      robot[axis] + 1.9 * episode.radius * [Math.cos(heading), Math.sin(heading)][axis]);
    line([robot, tip], colour, 3);
    disc(robot, episode.radius, visible ? { fill: colour }
      : { fill: colours.panel, stroke: colour, dash: [3, 3] });
    if (i === me) disc(robot, episode.radius + 0.12, { stroke: colours.ink, width: 2 });
    if (isShielded(episode, i, k)) disc(robot, episode.radius + 0.25, { stroke: colours.contact, width: 3 });
    write(String(i), place(robot), visible ? colours.page : colour);
    const activity = activityOf(episode, i, t);
    if (activity) {
      const [x, y] = place(robot);
      write(activity, [x, y + episode.radius * scale + 8], colour, 11, colours.page);
    }
    if (isOver(episode, t) && episode.outcomes[i].startsWith("hit")) {
      const [x, y] = place(robot), arm = 11;
      for (const [width, ink] of [[6, colours.page], [3.5, colours.contact]]) {
        pen.beginPath();
        pen.moveTo(x - arm, y - arm);
        pen.lineTo(x + arm, y + arm);
        pen.moveTo(x + arm, y - arm);
        pen.lineTo(x - arm, y + arm);
        pen.lineWidth = width;
        pen.strokeStyle = ink;
        pen.stroke();
      }
    }
  });
  others.filter((o) => o.percent >= 10).forEach(({ kind, number, percent }) => {
    const [x, y] = place(kind === "human" ? humans[number] : robots[number]);
    write(`${percent} %`, [x, y - episode.radius * scale - 9], colours.attention);
  });
  const corner = [middle[0] - half + 0.3, middle[1] - half + 0.3];
  line([corner, [corner[0] + 2, corner[1]]], colours.ink, 2);
  const [labelX, labelY] = place([corner[0] + 1, corner[1]]);
  write("2 m", [labelX, labelY - 9], colours.ink);
  canvas.dataset.time = state.time.toFixed(3);
  canvas.dataset.step = k;
}

// What a robot with macro actions does at a passage; empty if it just drives.
const ACTIVITIES = ["", "waits", "goes", "holds off"];
const activityOf = (episode, robot, t) => (episode.activities && t < episode.drivingSteps[robot]
  ? ACTIVITIES[episode.activities[robot][Math.min(Math.floor(t), episode.last - 1)]] : "");

// Whether the reasons of the last decision (samarl.play.insight) apply to a time.
const isNow = (episode, t) => Boolean(episode.insight?.length) && t > episode.last - 1;
const isOver = (episode, t) => t >= episode.last && !episode.running;
const isShielded = (episode, robot, k) => Boolean(episode.shielded?.[robot].includes(k));

// Distance of a robot to the nearest person at each of its steps, between surfaces, m.
function nearestDistances(episode, robot) {
  episode.nearestDistances ??= [];  // cached, since every frame draws them
  return (episode.nearestDistances[robot] ??= computeDistances(episode, robot));
}

function computeDistances(episode, robot) {
  const steps = [...Array(Math.min(episode.drivingSteps[robot], episode.last) + 1).keys()];
  return steps.map((t) => Math.min(...episode.humans.map((path, j) => isPresent(episode, j, t)
    ? distance(path[t], episode.robots[robot][t]) - episode.radii[j] - episode.radius : Infinity)));
}

// The strip above the slider: these distances and the events of the selected robot.
const STRIP_METRES = 3;

function drawStrip() {
  const canvas = element("strip"), ratio = devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const x = (t) => (t / state.steps) * (width - 2) + 1;
  const y = (metres) => (height - 2) * (1 - Math.min(Math.max(metres, 0), STRIP_METRES) / STRIP_METRES) + 1;
  pen.fillStyle = colours.panel;
  pen.fillRect(0, 0, width, height);
  pen.globalAlpha = 0.18;
  pen.fillStyle = colours.contact;
  pen.fillRect(0, y(state.shown[0].zone), width, height);
  pen.globalAlpha = 1;
  state.shown.forEach((episode, side) => {
    const distances = nearestDistances(episode, state.robot);
    pen.beginPath();
    distances.forEach((metres, t) => (t ? pen.lineTo(x(t), y(metres)) : pen.moveTo(x(t), y(metres))));
    pen.strokeStyle = colourOf(state.robot);
    pen.lineWidth = 1.6;
    pen.setLineDash(side ? [4, 3] : []);
    pen.stroke();
    pen.setLineDash([]);
    drawValues(pen, episode, x, side ? [4, 3] : [], height);
    (episode.shielded?.[state.robot] || []).forEach((t) => {
      pen.fillStyle = colours.contact;
      pen.fillRect(x(t) - 1, side ? height - 5 : 0, 2, 5);
    });
    const end = distances.length - 1, mark = episode.outcomes[state.robot];
    pen.fillStyle = mark.startsWith("hit") ? colours.contact : colours.ink;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = end > 0.9 * state.steps ? "right" : "left";
    if (mark === "arrived" || mark.startsWith("hit")) {
      pen.fillText(mark === "arrived" ? "★" : "✕", x(end), side ? height - 8 : 14);
    }
  });
  pen.fillStyle = colours.ink;
  pen.fillRect(x(state.time) - 0.75, 0, 1.5, height);
}

// The value of the selected robot at each of its decisions, from its lowest to its highest.
function drawValues(pen, episode, x, dash, height) {
  const values = episode.values?.[state.robot].slice(0, episode.drivingSteps[state.robot]);
  if (!values?.length) return;
  const low = Math.min(...values), range = Math.max(...values) - low || 1;
  pen.beginPath();
  values.forEach((value, t) => pen.lineTo(x(t), (height - 4) * (1 - (value - low) / range) + 2));
  pen.strokeStyle = colours.attention;
  pen.lineWidth = 1.2;
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

// The value of the decision that leads to the next step; undefined without one.
const valueOf = (episode, robot, k) => (k < episode.drivingSteps[robot]
  ? episode.values?.[robot][Math.min(k, episode.last - 1)] : undefined);

const seconds = (episode, steps) => `${(steps * episode.step).toFixed(2)} s`;

function outcomeOf(episode, i, t) {
  const outcome = episode.outcomes[i].replace("_", " a ");
  if (isOver(episode, t) && outcome !== "arrived") {
    return { timeout: "out of time", interrupted: "still on its way" }[outcome] || outcome;
  }
  return t >= episode.drivingSteps[i] ? `arrived at ${seconds(episode, episode.drivingSteps[i])}`
    : activityOf(episode, i, t) || "driving";
}

function describe({ episode, outcome, sight, canvas, name }) {
  const t = Math.min(state.time, episode.last), k = Math.floor(t);
  const ended = isOver(episode, t) ? `Ended at ${seconds(episode, episode.last)}. ` : "";
  const robots = episode.outcomes.map((_, i) => `${i} ${outcomeOf(episode, i, t)}`);
  const others = othersOf(episode, state.robot, k);
  const count = (kind) => {
    const all = others.filter((o) => o.kind === kind);
    const shared = all.filter((o) => o.shared).length;
    return `${all.filter((o) => o.visible && !o.shared).length} of ${all.length} ${kind}s`
      + (shared ? ` (and ${shared} through team-mates)` : "");
  };
  const shield = isShielded(episode, state.robot, k) ? " The shield replaces its action." : "";
  const reasons = isNow(episode, t) ? ` ${episode.insight[state.robot].words}` : "";
  const attended = others.filter((o) => o.percent >= 1).sort((a, b) => b.percent - a.percent);
  const attention = episode.humanAttention
    ? ` Attends to ${attended.slice(0, 3).map((o) => `${o.kind} ${o.number} ${o.percent} %`).join(", ") || "nobody"}.`
    : "";
  const expected = valueOf(episode, state.robot, k);
  const value = expected === undefined ? "" : ` It expects a return of ${expected.toFixed(1)}.`;
  const texts = [
    [outcome, `${ended}Robots: ${robots.join(", ")}.`],
    [sight, `Robot ${state.robot} sees ${count("human")}, ${count("robot")}.${shield}${attention}${value}${reasons}`],
  ];
  for (const [where, text] of texts) if (where.textContent !== text) where.textContent = text;
  if (!state.playing) {
    canvas.setAttribute("aria-label",
      `${name.textContent} at ${seconds(episode, t)}: ${outcome.textContent} ${sight.textContent}`);
  }
}

function draw() {
  if (!state.shown.length) return;
  const shown = sides.filter((side) => side.episode);
  shown.forEach(drawSide);
  shown.forEach(describe);
  drawStrip();
  element("time").value = Math.floor(state.time);
  const text = seconds(state.shown[0], state.time);
  element("time").setAttribute("aria-valuetext", text);
  element("clock").textContent = text;
  state.afterDraw?.();
}

// The point of the floor under an event on a canvas, m.
function floorPoint(canvas, event) {
  const { middle, half } = state.bounds, box = canvas.getBoundingClientRect();
  return [middle[0] + ((event.clientX - box.left) / box.width) * 2 * half - half,
    middle[1] - ((event.clientY - box.top) / box.height) * 2 * half + half];
}

function showRobotButtons(count) {
  if (element("robots").children.length === count) return;
  element("robots").replaceChildren(...[...Array(count).keys()].map((i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = i;
    button.setAttribute("aria-label", `robot ${i}`);
    button.style.cssText = `--robot: var(--series-${i % 7}); border-color: var(--robot)`;
    button.onclick = () => selectRobot(i);
    return button;
  }));
}

function selectRobot(robot) {
  const buttons = [...element("robots").children];
  if (robot >= buttons.length) return;
  state.robot = robot;
  buttons.forEach((button, i) => button.setAttribute("aria-pressed", String(i === robot)));
  draw();
  document.dispatchEvent(new Event("robotselected"));
}

darkness.addEventListener("change", () => { readColours(); draw(); });
new ResizeObserver(draw).observe(element("stage"));
readColours();
