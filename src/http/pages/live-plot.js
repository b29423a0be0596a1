"use strict";
// Plots curves with error bands into the page's SVG elements.
const plots = (() => {
  const SVG = "http://www.w3.org/2000/svg";

  const element = (parent, name, attributes, content) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (content !== undefined) node.textContent = content;
    parent.append(node);
    return node;
  };

  // Returns 1, 2 or 5 times a power of ten, not below the raw step.
  const roundStep = (raw) => {
    const power = 10 ** Math.floor(Math.log10(raw));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
  };

  // Range that does not jump with each gust: it grows at once, and shrinks only if less than half of it is used.
  const ranges = new Map();
  const steady = (id, low, high) => {
    const [from, to] = ranges.get(id) ?? [low, high];
    const kept = high - low < 0.5 * (to - from) ? [low, high] : [Math.min(from, low), Math.max(to, high)];
    ranges.set(id, kept);
    return kept;
  };

  // The band is magnified to at most this fraction of the height; the range leaves room for it.
  const MAX_BAND_FRACTION = 0.12;
  const enlargement = (widest, height) =>
    [50, 20, 10, 5, 2].find((factor) => widest * factor < MAX_BAND_FRACTION * height) ?? 1;

  const range = (id, seen, yFrom0) => {
    const sigma = (p) => p.sigma ?? 0;
    let low = Math.min(...seen.map((p) => p.y));
    let high = Math.max(...seen.map((p) => p.y));
    if (yFrom0) [low, high] = [Math.min(0, low), Math.max(0, high)];
    [low, high] = steady(id, low, high);
    const widest = Math.max(...seen.map(sigma));
    const least = Math.max(high - low, 4 * widest, 1e-3);
    const enlarged = enlargement(widest, least);
    // If the range begins at 0, the band may be cut there.
    if (!yFrom0 || low < 0) low = Math.min(low, ...seen.map((p) => p.y - enlarged * sigma(p)));
    high = Math.max(high, ...seen.map((p) => p.y + enlarged * sigma(p)));
    const step = roundStep(Math.max(high - low, least) / 4);
    [low, high] = [Math.floor(low / step + 1e-9) * step, Math.ceil(high / step - 1e-9) * step];
    return { low, high: high > low ? high : low + step, step, enlarged };
  };

  // Groups points into continuous lines; null and a change of `doubt` end a line.
  const runs = (points) => {
    const all = [];
    let last = null;
    for (const point of points) {
      const run = all[all.length - 1];
      if (point !== null && last !== null && point.doubt === last.doubt) run.push(point);
      else if (point !== null) all.push([point]);
      last = point;
    }
    return all;
  };

  const axes = (svg, { low, high, step }, { xRange, xLabel }, { x, y, box }) => {
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let k = 0; k <= Math.round((high - low) / step); k++) {
      const value = low + k * step;
      element(svg, "line", { class: "grid", x1: box.left, x2: box.right, y1: y(value), y2: y(value) });
      element(svg, "text", { x: box.left - 6, y: y(value) + 4, "text-anchor": "end" }, value.toFixed(digits));
    }
    const across = roundStep((xRange[1] - xRange[0] || 1) / 5);
    const places = Math.max(0, -Math.floor(Math.log10(across) + 1e-9));
    for (let k = Math.ceil(xRange[0] / across - 1e-9); k * across <= xRange[1] + 1e-9 * across; k++) {
      element(svg, "text", { x: x(k * across), y: box.bottom + 18, "text-anchor": "middle" }, (k * across || 0).toFixed(places));
    }
    element(svg, "text", { x: (box.left + box.right) / 2, y: box.bottom + 35, "text-anchor": "middle" }, xLabel);
  };

  // Plots points { x, y, sigma, doubt } or null. `note` is written across; `hole` [from, to] has no results. Returns the
  // magnification of the band.
  const plot = (svg, points, { xRange, xLabel, yFrom0, note, noteClass, hole }) => {
    // The view box is in the page's pixels, so that letters keep their size on a phone.
    const width = Math.max(240, svg.clientWidth);
    const height = Math.max(200, Math.min(320, 0.56 * width));
    const box = { left: 46, right: width - 14, top: 10, bottom: height - 40 };
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    const write = (words) => element(svg, "text",
      { class: `note ${noteClass ?? ""}`, x: (box.left + box.right) / 2, y: box.top + 18, "text-anchor": "middle" }, words);
    const seen = points.filter((p) => p !== null);
    if (seen.length === 0) {
      write(note ?? "No result yet");
      return 1;
    }
    const scale = range(svg.id, seen, yFrom0);
    const x = (value) => box.left + ((value - xRange[0]) / (xRange[1] - xRange[0] || 1)) * (box.right - box.left);
    const y = (value) => box.top + ((scale.high - value) / (scale.high - scale.low)) * (box.bottom - box.top);
    axes(svg, scale, { xRange, xLabel }, { x, y, box });
    const clip = element(svg, "clipPath", { id: `${svg.id}-box` });
    const area = { x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top };
    element(clip, "rect", area);
    const inside = element(svg, "g", { "clip-path": `url(#${svg.id}-box)` });
    if (hole) element(inside, "rect", { ...area, class: "hole", x: x(hole[0]), width: x(hole[1]) - x(hole[0]) });
    const at = (p, side) => `${x(p.x).toFixed(1)},${y(p.y + side * scale.enlarged * (p.sigma ?? 0)).toFixed(1)}`;
    for (const run of runs(points)) {
      const group = element(inside, "g", { class: run[0].doubt ? "doubt" : "" });
      const around = [...run.map((p) => at(p, 1)), ...[...run].reverse().map((p) => at(p, -1))];
      element(group, "polygon", { class: "band", points: around.join(" ") });
      element(group, "polyline", { class: "curve", points: run.map((p) => at(p, 0)).join(" ") });
      // A single point makes no line.
      if (run.length === 1) element(group, "circle", { class: "dot", cx: x(run[0].x), cy: y(run[0].y), r: 3 });
    }
    if (note) write(note);
    return scale.enlarged;
  };

  return { plot, element };
})();
