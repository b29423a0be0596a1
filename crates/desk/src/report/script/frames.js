// Viewer of single frames: image, positions, curve, 3D view of the wing, markers. It starts with the frame that ranks first.

// 3D view of the wing, rotated by the pointer or buttons.
class WingView {
  constructor(figure) {
    this.figure = figure;
    this.turn = [-0.6, 0.45];
    this.times = 1;
    this.markers = [];
    const { svg, tools } = figure;
    const label = addElement(tools, "label", {}, "Deflection scale ");
    tools.prepend(label);
    const select = addElement(label, "select", {});
    for (const times of [1, 2, 5, 10]) addElement(select, "option", { value: times }, times === 1 ? "true" : `${times} times`);
    select.onchange = () => { this.times = Number(select.value); this.draw(); };
    for (const [text, turn] of [["Front", [0, 0]], ["Above", [0, Math.PI / 2]], ["Side", [-Math.PI / 2, 0]], ["Oblique", this.turn]]) {
      addButton(tools, text, `view: ${text.toLowerCase()}`, () => { this.turn = turn; this.draw(); });
    }
    let last = null;
    svg.addEventListener("pointerdown", (event) => { last = [event.clientX, event.clientY]; svg.setPointerCapture(event.pointerId); });
    svg.addEventListener("pointermove", (event) => {
      if (last === null) return;
      const [across, down] = [event.clientX - last[0], event.clientY - last[1]].map((px) => px / 150);
      this.turn = [this.turn[0] + across, Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.turn[1] + down))];
      this.draw();
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { last = null; });
    new ResizeObserver(() => this.draw()).observe(svg);
  }

  setFrame(frame) {
    this.markers = frame.markers.filter((m) => m.ground !== null);
    this.draw();
  }

  draw() {
    const [sa, ca, sb, cb] = [Math.sin(this.turn[0]), Math.cos(this.turn[0]), Math.sin(this.turn[1]), Math.cos(this.turn[1])];
    // X outboard, Y up, Z along the chord; viewed along the chord, then rotated about the vertical and tilted.
    const flat = ([x, y, z]) => [ca * x + sa * z, cb * y + sb * (sa * x - ca * z), null];
    const moved = ({ ground, flight }) => flat(flight.map((v, k) => ground[k] + this.times * (v - ground[k])));
    const flying = this.markers.filter((m) => m.flight !== null);
    const [ground, flight] = [this.markers.map((m) => flat(m.ground)), flying.map(moved)];
    const lines = flying.flatMap((m) => [flat(m.ground), moved(m), BREAK]);
    const texts = (markers) => markers.map((m) => `${m.name}, deflection ${formatMeasured(...m.deflection, "m").join(" ")}`);
    this.figure.setPoints(0, ground, texts(this.markers));
    this.figure.setPoints(1, flight, texts(flying));
    this.figure.setPoints(2, lines);
    this.setScale([...ground, ...flight]);
    const scale = this.times === 1 ? "true scale" : `deflection enlarged ${this.times} times`;
    this.figure.place.parentElement.querySelector(".caption").textContent =
      `Markers on ground (grey) and in flight (blue), ${scale}. Drag to rotate.`;
  }

  // Sets ranges with one scale for both axes.
  setScale(points) {
    const { width, height } = this.figure.svg.getBoundingClientRect();
    if (points.length === 0 || width === 0) return;
    const ranges = [0, 1].map((k) => [Math.min(...points.map((p) => p[k])), Math.max(...points.map((p) => p[k]))]);
    const metres = Math.max((ranges[0][1] - ranges[0][0]) / width, (ranges[1][1] - ranges[1][0]) / height, 1e-6) * 0.55;
    this.figure.setView(ranges.map(([low, high], k) => [-1, 1].map((side) => (low + high) / 2 + side * metres * [width, height][k])));
  }
}

class FrameViewer {
  constructor(root, data, figures) {
    Object.assign(this, { root, data });
    for (const frame of data.frames) {
      frame.markers = frame.markers.map(([used, seen, ground, flight, deflection], k) =>
        ({ name: frame.rows[k][0], used, seen, ground, flight, deflection: deflection ?? [null, null] }));
    }
    [this.positions, this.curve, this.wing] = ["figure.positions", "figure.curve", "figure.wing"].map((name) => figures.get(root.querySelector(name)));
    this.wing = new WingView(this.wing);
    this.table = root.querySelector("table");
    this.classes = [...this.table.tHead.rows[0].cells].map((cell) => cell.className);
    this.addChooser();
    this.showFrame(0);
  }

  addChooser() {
    const { frames } = this.data;
    const bar = addTools(this.root.firstElementChild);
    this.select = addElement(addElement(bar, "label", {}, "Frame "), "select", {});
    const name = ({ series, image }) => `${series} ${image}`;
    const group = (label, all) => {
      if (all.length === 0) return;
      const list = addElement(this.select, "optgroup", { label });
      for (const k of all) addElement(list, "option", { value: k }, `${name(frames[k])}${frames[k].doubt ? `: ${frames[k].doubt}` : ""}`);
    };
    const all = [...frames.keys()];
    const first = all.filter((k) => frames[k].doubt);
    group("Check first", first.length > 0 ? first : [0]);
    const order = all.sort((a, b) => (name(frames[a]) < name(frames[b]) ? -1 : 1));
    for (const series of new Set(order.map((k) => frames[k].series))) group(`Series ${series}`, order.filter((k) => frames[k].series === series));
    this.select.onchange = () => this.showFrame(Number(this.select.value));
    const step = (by) => this.showFrame(order[(order.indexOf(this.index) + by + order.length) % order.length]);
    const steps = addElement(bar, "span", { className: "steps" });
    addButton(steps, "‹", "previous frame", () => step(-1));
    addButton(steps, "›", "next frame", () => step(1));
  }

  showFrame(index) {
    this.index = index;
    this.select.value = index;
    const frame = this.data.frames[index];
    const name = `${frame.series} ${frame.image}`;
    const [heading, status, title] = this.root.querySelectorAll(":scope > h3, :scope > p[role=status], :scope > details span");
    heading.textContent = name;
    title.textContent = name;
    status.textContent = frame.said;
    status.classList.toggle("warning", frame.warned);
    for (const one of this.root.querySelectorAll("[data-frame]")) one.hidden = one.dataset.frame !== `${frame.series}/${frame.image}`;
    const names = (markers) => markers.map((m) => m.name);
    const seen = (used) => frame.markers.filter((m) => m.seen !== null && m.used === used);
    const deflected = frame.markers.filter((m) => this.data.surveyed && m.ground !== null && isNumber(m.deflection[0]));
    [true, false].forEach((used, k) => {
      this.positions.setPoints(k, seen(used).map((m) => [m.seen[0], m.seen[1], null]), names(seen(used)));
      const shown = deflected.filter((m) => m.used === used);
      this.curve.setPoints(1 + k, shown.map((m) => [m.ground[0], ...m.deflection]), names(shown));
    });
    this.positions.setPoints(2, seen(true).flatMap(({ seen: [u, v, du, dv] }) => [[u, v, null], [u + du, v + dv, null], BREAK]));
    this.curve.setPoints(0, frame.curve);
    if (this.curve.tracks.length > 3) this.curve.setPoints(3, this.data.means[frame.series] ?? []);
    this.positions.name = `Image positions ${name}`;
    this.curve.name = `Deflection of ${name}`;
    for (const figure of [this.positions, this.curve]) figure.resetZoom();
    this.wing.setFrame(frame);
    this.table.tBodies[0].replaceChildren();
    this.table.querySelector("[aria-sort]")?.removeAttribute("aria-sort");
    for (const cells of frame.rows) {
      const row = addElement(this.table.tBodies[0], "tr", {});
      cells.forEach((cell, k) => addElement(row, "td", { className: this.classes[k] }, cell));
    }
  }
}
