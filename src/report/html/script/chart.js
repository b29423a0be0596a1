// Chart of tracks: values on hover, zoom, tracks shown or hidden, export as SVG, PNG or CSV.
class Chart {
  constructor(place, data, before = null) {
    this.data = data;
    this.view = { x: null, y: null };
    this.off = new Set();
    this.root = addElement(place, "div", { className: "chart" });
    if (before !== null) before.before(this.root);
    this.addTools();
    this.svg = addSvgElement(this.root, "svg", { role: "img", tabindex: 0, "aria-label": `${data.name}; use the arrow keys to step through the points` });
    this.tip = addElement(this.root, "div", { className: "tip", hidden: true });
    this.tip.setAttribute("role", "status");
    this.addLegend();
    this.addListeners();
    this.draw();
  }

  addTools() {
    const bar = addElement(this.root, "div", { className: "tools" });
    addButton(bar, "+", "zoom in", () => this.zoomBy(0.5));
    addButton(bar, "−", "zoom out", () => this.zoomBy(2));
    addButton(bar, "All", "show the full range", () => this.resetZoom());
    addButton(bar, "SVG", "save the figure as SVG", () => saveFile(svgBlob(this.exportFigure()), `${this.data.name}.svg`));
    addButton(bar, "PNG", "save the figure as PNG", () => savePng(this.exportFigure(), `${this.data.name}.png`));
    addButton(bar, "CSV", "save the values as CSV", () => this.saveValues());
  }

  // Adds one switch per track; a double click shows one track alone.
  addLegend() {
    const tracks = this.data.tracks;
    if (tracks.length < 2) return;
    const list = addElement(this.root, "div", { className: tracks.length > 12 ? "legend long" : "legend" });
    if (tracks.length > 3) {
      addButton(list, "all", `show all ${tracks.length} tracks`, () => { this.off.clear(); this.draw(); });
      addButton(list, "none", "hide all tracks", () => { this.off = new Set(tracks.keys()); this.draw(); });
    }
    this.switches = tracks.map((track, k) => {
      const made = addElement(list, "button", { type: "button", title: "click: show or hide; double click: show this track alone" });
      addElement(made, "i", {}).style.cssText = `--light:${track.colour};--dark:${tintColour(track.colour, DARK.pale)}`;
      made.append(track.name);
      made.onclick = () => { if (!this.off.delete(k)) this.off.add(k); this.draw(); };
      made.ondblclick = () => { this.off = new Set(tracks.keys()); this.off.delete(k); this.draw(); };
      return made;
    });
  }

  visibleTracks() {
    return this.data.tracks.map((track, index) => ({ ...track, index })).filter((track) => !this.off.has(track.index));
  }

  // Ranges of the axes; unless selected, the y range fits the points in the x range.
  ranges() {
    const points = this.visibleTracks().flatMap((track) => track.points).filter((p) => isNumber(p[0]) && isNumber(p[1]));
    const span = (values, fallback) => {
      let [low, high] = [Infinity, -Infinity];
      for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
      if (low > high) return fallback;
      if (high - low > 1e-9 * (1 + Math.abs(high))) return [low, high];
      return [low - 0.5, high + 0.5];
    };
    const whole = span(points.map((p) => p[0]), [0, 1]);
    const margin = 0.015 * (whole[1] - whole[0]);
    const x = this.view.x ?? [whole[0] - margin, whole[1] + margin];
    const inside = points.filter((p) => p[0] >= x[0] && p[0] <= x[1]);
    const ends = inside.flatMap((p) => [p[1] - (p[2] ?? 0), p[1] + (p[2] ?? 0)]);
    const [low, high] = span(this.data.y.zero && !this.view.x ? [...ends, 0] : ends, [0, 1]);
    const room = 0.04 * (high - low);
    return { x, y: this.view.y ?? [low - room, high + room] };
  }

  draw() {
    const width = Math.max(300, this.root.clientWidth || 1040);
    const height = Math.round(Math.max(230, Math.min(this.data.height ?? 400, 0.75 * width)));
    this.paint(this.svg, width, height, currentTheme());
    this.switches?.forEach((made, k) => made.setAttribute("aria-pressed", String(!this.off.has(k))));
    this.hot = null;
    this.tip.hidden = true;
  }

  paint(svg, width, height, theme) {
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const [left, right, top, bottom] = [58, 16, 10, 44];
    const { x, y } = this.ranges();
    const [w, h] = [width - left - right, height - top - bottom];
    this.box = { left, top, w, h, x, y };
    const font = { "font-family": '"Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans", sans-serif', "font-size": 12 };
    const px = (v) => left + ((v - x[0]) / (x[1] - x[0])) * w;
    const py = (v) => top + ((y[1] - v) / (y[1] - y[0])) * h;
    const maxTicks = Math.max(2, Math.min(8, w / 90));
    const { zero } = this.data.x;
    const ticks = isNumber(zero) ? timeTicks(x[0], x[1], zero, maxTicks) : linearTicks(x[0], x[1], maxTicks);
    const marks = addSvgElement(svg, "g", { ...font, fill: theme.soft, stroke: "none" });
    for (const [v, text] of ticks) {
      addSvgElement(marks, "line", { x1: roundToTenth(px(v)), x2: roundToTenth(px(v)), y1: top, y2: top + h, stroke: theme.grid });
      const half = 3.1 * text.length;
      const at = Math.max(half, Math.min(px(v), width - half));
      addSvgElement(marks, "text", { x: roundToTenth(at), y: top + h + 17, "text-anchor": "middle" }, text);
    }
    for (const [v, text] of linearTicks(y[0], y[1], Math.max(4, h / 45))) {
      addSvgElement(marks, "line", { x1: left, x2: left + w, y1: roundToTenth(py(v)), y2: roundToTenth(py(v)), stroke: theme.grid });
      addSvgElement(marks, "text", { x: left - 6, y: roundToTenth(py(v) + 4), "text-anchor": "end" }, text);
    }
    addSvgElement(marks, "text", { x: left + w / 2, y: height - 6, "text-anchor": "middle", fill: theme.ink }, this.data.x.label);
    const middle = `rotate(-90 13 ${top + h / 2})`;
    addSvgElement(marks, "text", { x: 13, y: top + h / 2, "text-anchor": "middle", fill: theme.ink, transform: middle }, this.data.y.label);
    // A nested drawing clips its content in every program that reads SVG.
    const inner = addSvgElement(svg, "svg", { x: left, y: top, width: w, height: h, viewBox: `${left} ${top} ${w} ${h}`, overflow: "hidden" });
    for (const track of this.visibleTracks()) this.drawTrack(inner, track, px, py, theme);
    addSvgElement(svg, "rect", { x: left, y: top, width: w, height: h, fill: "none", stroke: theme.frame });
    this.marker = addSvgElement(svg, "circle", { r: 6, fill: "none", stroke: theme.ink, "stroke-width": 2, visibility: "hidden" });
    this.chosen = addSvgElement(svg, "rect", { fill: theme.soft, "fill-opacity": 0.25, visibility: "hidden" });
  }

  drawTrack(inner, track, px, py, theme) {
    const colour = tintColour(track.colour, theme.pale);
    const group = addSvgElement(inner, "g", { "data-track": track.index });
    const at = (p, k) => `${roundToTenth(px(p[0]))},${roundToTenth(py(p[1] + k * (p[2] ?? 0)))}`;
    const points = track.points.filter((p) => isNumber(p[0]) && isNumber(p[1]));
    if (track.joined) {
      const known = points.filter((p) => isNumber(p[2]));
      const outline = [...known.map((p) => at(p, 1)), ...known.map((p) => at(p, -1)).reverse()];
      if (known.length > 1) addSvgElement(group, "polygon", { points: outline.join(" "), fill: colour, opacity: 0.2 });
      addSvgElement(group, "polyline", { points: points.map((p) => at(p, 0)).join(" "), fill: "none", stroke: colour,
        "stroke-width": 1.8, "stroke-dasharray": track.dashed ? "5 4" : null });
    }
    if (!track.joined || track.dots) {
      for (const p of points) {
        const cx = roundToTenth(px(p[0]));
        if (isNumber(p[2])) {
          addSvgElement(group, "line", { x1: cx, x2: cx, y1: roundToTenth(py(p[1] - p[2])), y2: roundToTenth(py(p[1] + p[2])), stroke: colour, "stroke-width": 1.3 });
        }
        addSvgElement(group, "circle", { cx, cy: roundToTenth(py(p[1])), r: track.small ? 2.2 : 3.4, fill: track.small ? theme.paper : colour, stroke: colour });
      }
    }
  }

  // Draws the figure for use in a document, on white, with a legend.
  exportFigure() {
    const svg = document.createElementNS(NAMESPACE, "svg");
    const [width, height] = [1040, Math.max(300, this.data.height ?? 400)];
    this.paint(svg, width, height, LIGHT);
    const named = this.visibleTracks().filter(() => this.data.tracks.length > 1);
    const across = 5;
    named.forEach((track, k) => {
      const [x, y] = [58 + (k % across) * 196, height + 14 + 17 * Math.floor(k / across)];
      addSvgElement(svg, "line", { x1: x, x2: x + 20, y1: y - 4, y2: y - 4, stroke: track.colour, "stroke-width": 2, "stroke-dasharray": track.dashed ? "5 4" : null });
      addSvgElement(svg, "text", { x: x + 26, y, "font-size": 12, "font-family": "Arial, sans-serif", fill: LIGHT.ink }, track.name.slice(0, 27));
    });
    const total = height + (named.length > 0 ? 10 + 17 * Math.ceil(named.length / across) : 0);
    svg.setAttribute("viewBox", `0 0 ${width} ${total}`);
    svg.setAttribute("width", width);
    svg.setAttribute("height", total);
    this.draw();
    return svg;
  }

  saveValues() {
    const clock = isNumber(this.data.x.zero);
    const time = (hour) => (clock && isNumber(hour) ? new Date(this.data.x.zero + 3.6e6 * hour).toISOString() : hour);
    const rows = this.visibleTracks().flatMap((track) =>
      track.points.map((p, k) => [track.name, time(p[0]), p[1], p[2], track.texts?.[k] ?? ""]));
    saveCsv([["track", clock ? "UTC" : this.data.x.label, this.data.y.label, "sigma", "what"], ...rows], this.data.name);
  }

  resetZoom() {
    this.view = { x: null, y: null };
    this.draw();
  }

  zoomBy(factor) {
    const { x, y } = this.ranges();
    const around = ([low, high]) => [(low + high) / 2 - ((high - low) / 2) * factor, (low + high) / 2 + ((high - low) / 2) * factor];
    this.view = { x: around(x), y: this.view.y ? around(y) : null };
    this.draw();
  }

  pointerPosition(event) {
    const area = this.svg.getBoundingClientRect();
    const [, , width, height] = this.svg.getAttribute("viewBox").split(" ").map(Number);
    return [((event.clientX - area.left) / area.width) * width, ((event.clientY - area.top) / area.height) * height];
  }

  addListeners() {
    let from = null;
    this.svg.addEventListener("pointerdown", (event) => {
      if (event.button === 0) { from = this.pointerPosition(event); this.svg.setPointerCapture(event.pointerId); }
    });
    this.svg.addEventListener("pointermove", (event) => {
      const to = this.pointerPosition(event);
      if (from !== null && Math.hypot(to[0] - from[0], to[1] - from[1]) > 6) this.drawSelection(from, to);
      else this.showNearest(to);
    });
    this.svg.addEventListener("pointerup", (event) => {
      const to = this.pointerPosition(event);
      if (from !== null && Math.abs(to[0] - from[0]) > 12) this.zoomTo(from, to);
      else this.showNearest(to);
      from = null;
    });
    this.svg.addEventListener("pointercancel", () => { from = null; this.chosen.setAttribute("visibility", "hidden"); });
    this.svg.addEventListener("pointerleave", () => { if (from === null) this.hidePoint(); });
    this.svg.addEventListener("dblclick", () => this.resetZoom());
    this.svg.addEventListener("keydown", (event) => this.handleKey(event));
    let width = 0;
    new ResizeObserver(() => {
      if (this.root.clientWidth !== width) { width = this.root.clientWidth; this.draw(); }
    }).observe(this.root);
    darkMode.addEventListener("change", () => this.draw());
  }

  // A horizontal drag selects a range of x alone, a rectangle a range of both axes.
  drawSelection(from, to) {
    const { left, top, w, h } = this.box;
    const flat = Math.abs(to[1] - from[1]) < 24;
    const inside = (v, low, size) => Math.max(low, Math.min(v, low + size));
    const [x1, x2] = [from[0], to[0]].map((v) => inside(v, left, w)).sort((a, b) => a - b);
    const [y1, y2] = (flat ? [top, top + h] : [from[1], to[1]]).map((v) => inside(v, top, h)).sort((a, b) => a - b);
    for (const [key, value] of Object.entries({ x: x1, y: y1, width: x2 - x1, height: y2 - y1, visibility: "visible" })) {
      this.chosen.setAttribute(key, value);
    }
    return { x1, x2, y1, y2, flat };
  }

  zoomTo(from, to) {
    const { x1, x2, y1, y2, flat } = this.drawSelection(from, to);
    const { left, top, w, h, x, y } = this.box;
    const across = (v) => x[0] + ((v - left) / w) * (x[1] - x[0]);
    const up = (v) => y[1] - ((v - top) / h) * (y[1] - y[0]);
    if (x2 - x1 < 4) return this.draw();
    this.view = { x: [across(x1), across(x2)], y: flat ? null : [up(y2), up(y1)] };
    return this.draw();
  }

  showNearest([x, y]) {
    const { left, top, w, h, x: xs, y: ys } = this.box;
    let best = null;
    for (const track of this.visibleTracks()) {
      track.points.forEach((p, k) => {
        if (!isNumber(p[0]) || !isNumber(p[1])) return;
        const cx = left + ((p[0] - xs[0]) / (xs[1] - xs[0])) * w;
        const cy = top + ((ys[1] - p[1]) / (ys[1] - ys[0])) * h;
        if (cx < left - 1 || cx > left + w + 1 || cy < top - 1 || cy > top + h + 1) return;
        const away = Math.hypot(cx - x, cy - y);
        if (best === null || away < best.away) best = { away, track, k, cx, cy };
      });
    }
    if (best === null || best.away > 60) return this.hidePoint();
    return this.showPoint(best);
  }

  showPoint({ track, k, cx, cy }) {
    this.hot = { track: track.index, k };
    const p = track.points[k];
    const clock = isNumber(this.data.x.zero);
    const where = clock ? `${new Date(this.data.x.zero + 3.6e6 * p[0]).toISOString().replace("T", " ").slice(0, 19)} UTC`
      : `${this.data.x.label.split(" / ")[0].split(",")[0]} ${Number(p[0].toPrecision(5))} ${this.data.x.label.split(" / ")[1] ?? ""}`;
    const unit = this.data.y.label.split(" / ")[1] ?? "";
    this.tip.replaceChildren();
    addElement(this.tip, "b", {}, track.name);
    addElement(this.tip, "span", {}, where);
    addElement(this.tip, "span", {}, formatMeasured(p[1], p[2], unit));
    if (track.texts?.[k]) addElement(this.tip, "span", {}, track.texts[k]);
    this.marker.setAttribute("cx", cx);
    this.marker.setAttribute("cy", cy);
    this.marker.setAttribute("visibility", "visible");
    this.svg.querySelectorAll("polyline").forEach((line) => {
      line.setAttribute("stroke-width", line.parentNode.dataset.track === String(track.index) ? 3 : 1.8);
    });
    this.tip.hidden = false;
    const ratio = this.svg.clientWidth / Number(this.svg.getAttribute("viewBox").split(" ")[2]);
    const [x, room] = [cx * ratio, this.root.clientWidth - this.tip.offsetWidth - 4];
    this.tip.style.left = `${Math.max(0, Math.min(x + 14, room))}px`;
    const above = this.svg.offsetTop + cy * ratio - this.tip.offsetHeight - 12;
    this.tip.style.top = `${above < this.svg.offsetTop ? this.svg.offsetTop + cy * ratio + 14 : above}px`;
  }

  hidePoint() {
    this.hot = null;
    this.tip.hidden = true;
    this.marker.setAttribute("visibility", "hidden");
  }

  handleKey(event) {
    const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    if (event.key === "Escape") { this.resetZoom(); return; }
    const tracks = this.visibleTracks();
    if (step === undefined || tracks.length === 0) return;
    event.preventDefault();
    const old = Math.max(0, tracks.findIndex((track) => track.index === this.hot?.track));
    const track = tracks[(old + step[0] + tracks.length) % tracks.length];
    const k = Math.max(0, Math.min(track.points.length - 1, (this.hot?.k ?? -1) + step[1]));
    const { left, top, w, h, x, y } = this.box;
    const p = track.points[k];
    if (p === undefined || !isNumber(p[1])) return;
    this.showPoint({ track, k, cx: left + ((p[0] - x[0]) / (x[1] - x[0])) * w, cy: top + ((y[1] - p[1]) / (y[1] - y[0])) * h });
  }
}
