// A chart of learning curves: task, quantity and runs are chosen by the reader.
"use strict";

const groups = JSON.parse(document.getElementById("curves").textContent);
const [task, quantity, boxes, chart, readout] = ["task", "quantity", "runs", "chart", "readout"].map((id) => document.getElementById(id));
let shown = null; // the lines of the chart, its scale and what moves with the cursor
const COLOURS = 7; // then the next dashes, as in the figures
const DASHES = ["", "7 4", "2 3", "7 3 2 3"];

function shape(name, attributes, text = "") { // of an SVG
  const drawn = document.createElementNS(chart.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) drawn.setAttribute(key, value);
  drawn.textContent = text;
  return drawn;
}

function fill(select, titles) {
  select.replaceChildren(...titles.map((title, i) => new Option(title, i)));
}

function chooseTask() {
  const group = groups[task.value], onlyAblations = !group.runs.some(({ main }) => main);
  fill(quantity, group.quantities.map(({ title }) => title));
  boxes.replaceChildren(...group.runs.map(({ name, seeds, main }, i) => {
    const label = document.createElement("label"), box = document.createElement("input");
    Object.assign(box, { type: "checkbox", value: i, checked: main || onlyAblations });
    label.append(box, sample(i), `${name} (${seeds} seed${seeds > 1 ? "s" : ""})`);
    return label;
  }));
  draw();
}

const stroke = (i) => `stroke: var(--series-${i % COLOURS}); stroke-dasharray: ${DASHES[Math.floor(i / COLOURS) % DASHES.length] || "none"}`;

function sample(i) {
  const drawn = shape("svg", { viewBox: "0 0 24 8", "aria-hidden": "true" });
  drawn.append(shape("path", { d: "M0 4H24", class: "curve", style: stroke(i) }));
  return drawn;
}

function ticks(low, high) { // at most six round numbers
  const raw = (high - low) / 5 || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, k) => (first + k) * step);
}

const short = (v) => (Math.abs(v) >= 1e6 ? `${+(v / 1e6).toPrecision(3)}M` : Math.abs(v) >= 1e3 ? `${+(v / 1e3).toPrecision(3)}k` : `${+v.toPrecision(3)}`);

function draw() {
  const group = groups[task.value], { key: column, unit } = group.quantities[quantity.value];
  const chosen = [...boxes.querySelectorAll("input")].filter((box) => box.checked).map((box) => Number(box.value));
  const lines = chosen.filter((i) => group.runs[i].lines[column]).map((i) => [i, group.runs[i].lines[column]]);
  const width = chart.clientWidth, height = Math.min(420, Math.max(260, width / 2));
  chart.setAttribute("viewBox", `0 0 ${width} ${height}`);
  chart.replaceChildren();
  const all = (k) => lines.flatMap(([, line]) => line[k]);
  const percent = /success|score/.test(column);
  const right = Math.max(1, ...all(0)), low = percent ? 0 : Math.min(0, ...all(2)), high = percent ? 100 : Math.max(...all(3), low + 1e-9);
  const x = (v) => 60 + (width - 75) * v / right, y = (v) => height - 42 - (height - 62) * (v - low) / (high - low);
  for (const v of ticks(low, high)) {
    chart.append(shape("line", { x1: 60, x2: width - 15, y1: y(v), y2: y(v), class: "rule" }));
    chart.append(shape("text", { x: 54, y: y(v) + 4, "text-anchor": "end" }, short(v)));
  }
  for (const v of ticks(0, right)) chart.append(shape("text", { x: x(v), y: height - 24, "text-anchor": "middle" }, short(v)));
  chart.append(shape("text", { x: width / 2, y: height - 6, "text-anchor": "middle" }, "world steps"));
  chart.append(shape("text", { x: 4, y: 12 }, unit));
  for (const [i, [steps, mean, lowest, highest]] of lines) {
    const path = (values) => values.map((v, k) => `${x(steps[k]).toFixed(1)} ${y(v).toFixed(1)}`);
    const band = [...path(lowest), ...path(highest).reverse()];
    if (group.runs[i].seeds > 1) chart.append(shape("path", { d: `M${band.join("L")}Z`, class: "band", style: `fill: var(--series-${i % COLOURS})` }));
    const line = steps.length > 1 ? shape("path", { d: `M${path(mean).join("L")}`, class: "curve", style: stroke(i) })
      : shape("circle", { cx: x(steps[0]), cy: y(mean[0]), r: 4, style: `fill: var(--series-${i % COLOURS})` });
    line.dataset.run = group.runs[i].name;
    line.append(shape("title", {}, group.runs[i].name));
    chart.append(line);
  }
  const cursor = shape("line", { y1: y(high), y2: y(low), class: "cursor", visibility: "hidden" });
  chart.append(cursor);
  shown = { group, lines, unit, cursor, x, right, stepsAt: (px) => (px - 60) * right / (width - 75) };
  hideValues();
}

// Write the value of every chosen run at its recorded step nearest to the pointer.
function showValues(event) {
  const { group, lines, unit, cursor, x, right, stepsAt } = shown;
  const steps = Math.min(right, Math.max(0, stepsAt(event.clientX - chart.getBoundingClientRect().left)));
  const values = lines.filter(([, line]) => steps <= line[0].at(-1)).map(([i, [grid, mean]]) => {
    const distances = grid.map((step) => Math.abs(step - steps));
    const entry = document.createElement("span");
    entry.append(sample(i), `${group.runs[i].name} ${short(mean[distances.indexOf(Math.min(...distances))])}`);
    return entry;
  });
  readout.replaceChildren(`${short(steps)} steps, ${unit}:`, ...values);
  for (const end of ["x1", "x2"]) cursor.setAttribute(end, x(steps));
  cursor.setAttribute("visibility", "visible");
}

function hideValues() {
  readout.textContent = "Point at the chart to read its values.";
  shown.cursor.setAttribute("visibility", "hidden");
}

fill(task, groups.map(({ title }) => title));
task.addEventListener("change", chooseTask);
quantity.addEventListener("change", draw);
boxes.addEventListener("change", draw);
for (const [id, checked] of [["all", true], ["none", false]]) {
  document.getElementById(id).addEventListener("click", () => {
    for (const box of boxes.querySelectorAll("input")) box.checked = checked;
    draw();
  });
}
chart.addEventListener("pointermove", showValues);
chart.addEventListener("pointerleave", hideValues);
window.addEventListener("resize", draw);
chooseTask();
