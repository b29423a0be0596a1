"use strict";
// Figures drawn by the program: a script changes their range and the points of their tracks. No network requests.
const addSvgElement = (parent, name, attributes, content) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (content !== undefined) element.textContent = content;
  parent.append(element);
  return element;
};

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
// Ends a line.
const BREAK = [null, null, null];
const isPoint = (p) => isNumber(p[0]) && isNumber(p[1]);

// Text of a number with two significant digits of its standard deviation, and the text of the latter.
const formatMeasured = (value, sigma, unit = "") => {
  if (!isNumber(value)) return ["–", ""];
  const known = isNumber(sigma) && sigma > 0;
  const decimals = known ? Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(sigma / 0.995)))) : 3;
  return [`${value.toFixed(decimals)} ${unit}`.trim(), known ? `± ${sigma.toFixed(decimals)} ${unit}`.trim() : ""];
};

// Text of a position on an axis, with as many digits as one of its steps: decimals, or a part of an ISO 8601 time.
const axisText = ({ zero, turned }, value, from, to) =>
  (to === null ? (turned ? -value : value).toFixed(from) : new Date(Math.round(3.6e6 * (value + zero))).toISOString().slice(from, to));

// Positions of the ticks of a range with their texts: multiples of the smallest step with at most `most` intervals.
const axisTicks = (axis, [low, high], most) => {
  const { steps, zero } = axis;
  const [step, from, to] = steps.find(([one]) => (high - low) / one <= most) ?? steps[steps.length - 1];
  const ticks = [];
  for (let k = Math.ceil((low + zero) / step - 1e-6); k * step <= high + zero + 1e-6 * step && ticks.length < 60; k++) {
    ticks.push([k * step - zero, axisText(axis, k * step - zero, from, to)]);
  }
  return ticks;
};

// Path data of points [x, y, sigma], as the program writes them; a point without numbers ends a line.
const pathData = (points, at = (x, y) => `${x},${y}`) => {
  const runs = [[]];
  for (const p of points) if (isPoint(p)) runs[runs.length - 1].push(p); else runs.push([]);
  const data = { curve: "", band: "", bar: "", dot: "", lone: "" };
  for (const run of runs.filter((one) => one.length > 0)) {
    const known = run.filter((p) => isNumber(p[2]));
    const sides = (k) => known.map(([x, y, s]) => at(x, y + k * s));
    const line = run.map(([x, y]) => at(x, y));
    data.curve += `M${line.join(" ")}h0`;
    if (known.length > 1) data.band += `M${[...sides(1), ...sides(-1).reverse()].join(" ")}Z`;
    data.bar += sides(-1).map((low, k) => `M${low} ${sides(1)[k]}`).join("");
    const dots = line.map((point) => `M${point}h0`).join("");
    data.dot += dots;
    // A single point makes no line.
    if (run.length === 1) data.lone += dots;
  }
  return data;
};

class Figure {
  constructor(svg) {
    this.svg = svg;
    this.area = svg.querySelector(".area");
    this.axes = [svg.dataset.x, svg.dataset.y].map((text) => JSON.parse(text));
    this.groups = [svg.children[0], svg.children[1]];
    this.marks = this.groups.map((group) => [...group.children]);
    const [x, y, width, height] = this.area.getAttribute("viewBox").split(" ").map(Number);
    this.view = [[x, x + width], [-y - height, -y]];
    this.whole = this.view;
    this.tracks = [...svg.querySelectorAll("[data-track]")].map((group) => ({
      group, name: group.dataset.name, points: JSON.parse(group.dataset.points), texts: JSON.parse(group.dataset.texts ?? "[]"),
    }));
  }

  setPoints(index, points, texts = []) {
    const track = Object.assign(this.tracks[index], { points, texts });
    const data = pathData(points);
    for (const path of track.group.children) path.setAttribute("d", data[path.classList[0]]);
  }

  // Shows the ranges [low, high] of both axes.
  setView(view) {
    this.view = view;
    const [[left, right], [bottom, top]] = view;
    this.area.setAttribute("viewBox", `${left} ${-top} ${right - left} ${top - bottom}`);
    // Points at the ends of the whole range are not cut.
    this.area.setAttribute("overflow", view[0] === this.whole[0] ? "visible" : "hidden");
    const { width, height } = this.svg.getBoundingClientRect();
    [width / 90, height / 45].forEach((most, k) => {
      if (view === this.whole) this.groups[k].replaceChildren(...this.marks[k]);
      else this.drawTicks(k, axisTicks(this.axes[k], view[k], Math.max(2, most)));
    });
  }

  drawTicks(k, ticks) {
    this.groups[k].replaceChildren();
    const [low, high] = this.view[k];
    for (const [value, text] of ticks) {
      const share = (value - low) / (high - low);
      const at = `${(100 * (k === 0 ? share : 1 - share)).toFixed(3)}%`;
      const [line, tick] = k === 0
        ? [{ x1: at, x2: at, y1: 0, y2: "100%" }, { x: at, y: "100%", dy: 16, "text-anchor": "middle" }]
        : [{ x1: 0, x2: "100%", y1: at, y2: at }, { x: 0, y: at, dx: -7, dy: 3.5, "text-anchor": "end" }];
      addSvgElement(this.groups[k], "line", { class: "grid", ...line });
      addSvgElement(this.groups[k], "text", { class: "tick", ...tick }, text);
    }
  }
}
