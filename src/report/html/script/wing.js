// 3D view of the wing: markers in flight and on ground, rotated by the pointer or the arrow keys.

// Delaunay triangulation of the markers seen from above (Bowyer and Watson, 1981).
const triangulate = (points) => {
  const far = 1e3 * (1 + Math.max(...points.flat().map(Math.abs)));
  const all = [...points, [-far, -far], [far, -far], [0, far]];
  const n = points.length;
  const within = ([a, b, c], p) => {
    const [ax, ay, bx, by, cx, cy] = [a, b, c].flatMap((k) => [all[k][0] - p[0], all[k][1] - p[1]]);
    const [aa, bb, cc] = [ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy];
    const inside = ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx);
    const turn = (all[b][0] - all[a][0]) * (all[c][1] - all[a][1]) - (all[b][1] - all[a][1]) * (all[c][0] - all[a][0]);
    return turn > 0 ? inside > 0 : inside < 0;
  };
  let mesh = [[n, n + 1, n + 2]];
  points.forEach((p, k) => {
    const hit = mesh.filter((t) => within(t, p));
    const edges = hit.flatMap(([a, b, c]) => [[a, b], [b, c], [c, a]]);
    const once = edges.filter(([a, b]) => !edges.some(([c, d]) => a === d && b === c));
    mesh = [...mesh.filter((t) => !hit.includes(t)), ...once.map(([a, b]) => [a, b, k])];
  });
  return mesh.filter((t) => t.every((k) => k < n));
};

class WingView {
  constructor(place) {
    this.turn = [-0.6, 0.45];
    this.times = 1;
    this.root = addElement(place, "div", { className: "chart wing" });
    const bar = addElement(this.root, "div", { className: "tools" });
    const label = addElement(bar, "label", {}, "Deflection scale ");
    this.select = addElement(label, "select", {});
    for (const times of [1, 2, 5, 10]) addElement(this.select, "option", { value: times }, times === 1 ? "true" : `${times} times`);
    this.select.onchange = () => { this.times = Number(this.select.value); this.draw(); };
    for (const [text, turn] of [["Front", [0, 0]], ["Above", [0, Math.PI / 2]], ["Side", [-Math.PI / 2, 0]], ["Oblique", [-0.6, 0.45]]]) {
      addButton(bar, text, `view: ${text.toLowerCase()}`, () => { this.turn = turn; this.draw(); });
    }
    addButton(bar, "SVG", "save the figure as SVG", () => saveFile(svgBlob(this.exportFigure()), "wing.svg"));
    addButton(bar, "PNG", "save the figure as PNG", () => savePng(this.exportFigure(), "wing.png"));
    this.svg = addSvgElement(this.root, "svg", { role: "img", tabindex: 0, "aria-label": "3D view of the wing; drag or use the arrow keys to rotate it" });
    this.caption = addElement(this.root, "p", { className: "caption" });
    this.addListeners();
  }

  setFrame(frame) {
    this.markers = frame.markers.filter((m) => m.ground !== null);
    this.mesh = this.markers.length > 2 ? triangulate(this.markers.map((m) => [m.ground[0], m.ground[2]])) : [];
    this.draw();
  }

  addListeners() {
    let last = null;
    this.svg.addEventListener("pointerdown", (event) => { last = [event.clientX, event.clientY]; this.svg.setPointerCapture(event.pointerId); });
    this.svg.addEventListener("pointermove", (event) => {
      if (last === null) return;
      this.rotateBy((event.clientX - last[0]) / 150, (event.clientY - last[1]) / 150);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) this.svg.addEventListener(end, () => { last = null; });
    this.svg.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (turn !== undefined) { event.preventDefault(); this.rotateBy(...turn); }
    });
    new ResizeObserver(() => this.draw()).observe(this.root);
    darkMode.addEventListener("change", () => this.draw());
  }

  rotateBy(across, down) {
    this.turn = [this.turn[0] + across, Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.turn[1] + down))];
    this.draw();
  }

  draw() {
    if (this.markers === undefined) return;
    const width = Math.max(300, this.root.clientWidth || 1040);
    this.paint(this.svg, width, Math.round(Math.max(240, Math.min(420, 0.6 * width))), currentTheme());
    const enlarged = this.times === 1 ? "true scale" : `deflection enlarged ${this.times} times`;
    this.caption.textContent = `Markers on ground (hollow) and in flight (filled), ${enlarged}; the lines between markers only guide the eye. Drag to rotate.`;
  }

  exportFigure() {
    const svg = document.createElementNS(NAMESPACE, "svg");
    this.paint(svg, 1040, 520, LIGHT);
    const text = this.times === 1 ? "true scale" : `deflection enlarged ${this.times} times`;
    addSvgElement(svg, "text", { x: 20, y: 510, "font-size": 13, "font-family": "Arial, sans-serif", fill: LIGHT.ink }, `Ground: hollow, dashed. Flight: filled. ${text}.`);
    svg.setAttribute("width", 1040);
    svg.setAttribute("height", 520);
    return svg;
  }

  paint(svg, width, height, theme) {
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const [sa, ca, sb, cb] = [Math.sin(this.turn[0]), Math.cos(this.turn[0]), Math.sin(this.turn[1]), Math.cos(this.turn[1])];
    // X outboard, Y up, Z along the chord; viewed along the chord, then rotated about the vertical and tilted.
    const flat = ([x, y, z]) => {
      const [across, deep] = [ca * x + sa * z, -sa * x + ca * z];
      return [across, -(cb * y - sb * deep)];
    };
    const enlarged = (m) => (m.flight === null ? null : m.flight.map((v, k) => m.ground[k] + this.times * (v - m.ground[k])));
    const places = this.markers.map((m) => ({ m, ground: flat(m.ground), flight: enlarged(m) && flat(enlarged(m)) }));
    const all = places.flatMap((p) => (p.flight ? [p.ground, p.flight] : [p.ground]));
    if (all.length === 0) { addSvgElement(svg, "text", { x: 20, y: 30, fill: theme.soft }, "This frame has no positions."); return; }
    const [xs, ys] = [0, 1].map((k) => all.map((p) => p[k]));
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const scale = Math.min((width - 60) / Math.max(right - left, 1e-6), (height - 70) / Math.max(bottom - top, 1e-6));
    const at = ([x, y]) => [roundToTenth(width / 2 + scale * (x - (left + right) / 2)), roundToTenth((height - 20) / 2 + scale * (y - (top + bottom) / 2))];
    const [ground, flight] = [tintColour("#5b6573", theme.pale), tintColour("#17456f", theme.pale)];
    const edge = (p, q, attributes) => {
      const [[x1, y1], [x2, y2]] = [at(p), at(q)];
      addSvgElement(svg, "line", { x1, y1, x2, y2, ...attributes });
    };
    const pairs = new Set(this.mesh.flatMap(([a, b, c]) => [[a, b], [b, c], [c, a]].map((pair) => pair.sort((p, q) => p - q).join(" "))));
    for (const pair of pairs) {
      const [p, q] = pair.split(" ").map((k) => places[k]);
      edge(p.ground, q.ground, { stroke: ground, "stroke-width": 0.7, "stroke-dasharray": "3 3" });
      if (p.flight && q.flight) edge(p.flight, q.flight, { stroke: flight, "stroke-width": 1.1 });
    }
    for (const { m, ground: g, flight: f } of places) {
      if (f) edge(g, f, { stroke: flight, "stroke-width": 0.8, opacity: 0.6 });
      const deflection = formatMeasured(m.deflection[0], m.deflection[1], "m");
      const circle = (p, attributes) => {
        const made = addSvgElement(svg, "circle", { cx: at(p)[0], cy: at(p)[1], r: 3.4, ...attributes });
        addSvgElement(made, "title", {}, `${m.id}: deflection ${deflection}`);
      };
      circle(g, { fill: theme.paper, stroke: ground });
      if (f) circle(f, { fill: flight });
    }
    const step = roundStep((width / 6) / scale);
    const bar = { y1: height - 14, y2: height - 14 };
    addSvgElement(svg, "line", { x1: width - 20 - step * scale, x2: width - 20, ...bar, stroke: theme.ink, "stroke-width": 2 });
    addSvgElement(svg, "text", { x: width - 26 - step * scale, y: height - 10, "text-anchor": "end", "font-size": 12, "font-family": "Arial, sans-serif", fill: theme.ink }, `${Number(step.toPrecision(3))} m`);
  }
}
