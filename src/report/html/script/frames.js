// Every frame to choose, the one to be looked at first before all: its picture, its curve, the wing in space, its markers.

// Pictures are zoomed by dragging a rectangle over them.
const zoomable = (svg) => {
  const whole = svg.getAttribute("viewBox");
  let from = null;
  let chosen = null;
  const place = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  const bounds = (to) => ({
    x: Math.min(from.x, to.x), y: Math.min(from.y, to.y), width: Math.abs(to.x - from.x), height: Math.abs(to.y - from.y),
  });
  svg.addEventListener("pointerdown", (event) => {
    from = place(event);
    svg.setPointerCapture(event.pointerId);
    chosen = svgNode(svg, "rect", { class: "chosen" });
  });
  svg.addEventListener("pointermove", (event) => {
    if (from === null) return;
    for (const [key, value] of Object.entries(bounds(place(event)))) chosen.setAttribute(key, value);
  });
  svg.addEventListener("pointerup", (event) => {
    if (from === null) return;
    const { x, y, width, height } = bounds(place(event));
    const [, , w, h] = whole.split(" ").map(Number);
    chosen.remove();
    from = null;
    // The picture keeps its shape.
    const side = Math.max(width, (height * w) / h);
    if (side > 0.01 * w) svg.setAttribute("viewBox", `${x} ${y} ${side} ${(side * h) / w}`);
  });
  svg.addEventListener("pointercancel", () => { from = null; chosen?.remove(); });
  svg.addEventListener("dblclick", () => svg.setAttribute("viewBox", whole));
  return () => svg.setAttribute("viewBox", whole);
};

const takeAway = (bar, svg, name) => {
  button(bar, "SVG", "take the figure away as SVG", () => save(svgBlob(standing(svg())), `${name()}.svg`));
  button(bar, "PNG", "take the figure away as PNG", () => savePng(standing(svg()), `${name()}.png`));
};

class Frames {
  constructor(place, data, curves) {
    this.data = data;
    this.curves = curves;
    this.root = place;
    this.chooser();
    this.said = node(place, "p", { className: "said" });
    this.said.setAttribute("role", "status");
    this.pictured();
    node(place, "h3", {}, "Its deflection");
    this.curve = node(place, "div", {});
    node(place, "h3", {}, "The wing in space");
    this.wing = new Wing(node(place, "div", {}));
    node(place, "h3", {}, "Its markers");
    this.table = node(place, "div", { className: "scroll" });
    this.show(0);
  }

  chooser() {
    const bar = node(this.root, "div", { className: "tools" });
    const label = node(bar, "label", {}, "Frame ");
    this.select = node(label, "select", {});
    const group = (title, all) => {
      if (all.length === 0) return;
      const list = node(this.select, "optgroup", { label: title });
      for (const k of all) {
        const frame = this.data.frames[k];
        node(list, "option", { value: k }, `${frame.series} ${frame.image}${frame.doubt ? `: ${frame.doubt}` : ""}`);
      }
    };
    const all = [...this.data.frames.keys()];
    const first = all.filter((k) => this.data.frames[k].doubt);
    group("To be looked at first", first.length > 0 ? first : all.slice(0, 1));
    const order = (k) => `${this.data.frames[k].series} ${this.data.frames[k].image}`;
    this.order = all.sort((a, b) => (order(a) < order(b) ? -1 : 1));
    for (const series of new Set(this.order.map((k) => this.data.frames[k].series))) {
      group(`Series ${series}`, this.order.filter((k) => this.data.frames[k].series === series));
    }
    this.select.onchange = () => this.show(Number(this.select.value));
    const step = (by) => {
      const at = this.order.indexOf(this.now);
      this.show(this.order[(at + by + this.order.length) % this.order.length]);
    };
    const steps = node(bar, "span", { className: "steps" });
    button(steps, "‹", "the frame before", () => step(-1));
    button(steps, "›", "the next frame", () => step(1));
  }

  pictured() {
    this.pictures = new Map([...document.querySelectorAll("[data-frame]")].map((one) => [one.dataset.frame, one]));
    this.place = node(this.root, "div", { className: "chart" });
    const bar = node(this.place, "div", { className: "tools" });
    button(bar, "All", "the whole picture", () => this.whole?.());
    takeAway(bar, () => this.place.querySelector("svg"), () => `frame-${this.frame.series}-${this.frame.image}`);
    this.shownPicture = node(this.place, "div", { className: "shown" });
  }

  show(index) {
    this.now = index;
    const frame = this.data.frames[index];
    this.frame = frame;
    this.select.value = index;
    const test = frame.test ? `, global test ${frame.test}` : "";
    const factor = finite(frame.factor) ? `, variance factor ${frame.factor.toFixed(2)}` : "";
    this.said.textContent = frame.solved
      ? `Tip deflection ${measured(frame.deflection[0], frame.deflection[1], "m")} ${this.data.counted}${factor}${test}${frame.doubt && frame.test !== "rejected" ? `. To be looked at: ${frame.doubt}` : ""}.`
      : `No result: ${frame.why}`;
    this.said.className = frame.solved && frame.test !== "rejected" ? "said" : "said warning";
    this.picture(frame);
    this.drawCurve(frame);
    this.wing.set(frame);
    this.markers(frame);
  }

  // The embedded picture, or the markers alone where it is not embedded.
  picture(frame) {
    const embedded = this.pictures.get(`${frame.series}/${frame.image}`);
    this.shownPicture.replaceChildren();
    if (embedded) {
      const copy = embedded.cloneNode(true);
      copy.removeAttribute("data-frame");
      this.shownPicture.append(...copy.childNodes);
    } else {
      this.plain(frame);
    }
    const svg = this.shownPicture.querySelector("svg");
    if (svg) this.whole = zoomable(svg);
  }

  plain(frame) {
    const seen = frame.markers.filter((m) => m.at !== null);
    if (seen.length === 0) { node(this.shownPicture, "p", {}, "Its picture is not in this page, and no marker of it is known."); return; }
    const [us, vs] = [0, 1].map((k) => seen.map((m) => m.at[k]));
    const size = Math.max(Math.max(...us) - Math.min(...us), Math.max(...vs) - Math.min(...vs), 10);
    const room = 0.08 * size;
    const [x, y] = [Math.min(...us) - room, Math.min(...vs) - room];
    const [w, h] = [Math.max(...us) - x + 2 * room, Math.max(...vs) - y + room];
    const svg = svgNode(this.shownPicture, "svg", { viewBox: [x, y, w, h].map(tenth).join(" "), class: "photo", role: "img", "aria-label": "Markers of the frame" });
    const longest = Math.max(...seen.map((m) => Math.hypot(m.at[2] ?? 0, m.at[3] ?? 0)));
    const times = longest > 0 ? roundStep((0.03 * w) / longest) : 1;
    const line = w / 700;
    for (const m of seen) {
      const colour = m.used ? "#3dea6d" : "#ffd23d";
      const [u, v, ru, rv] = m.at;
      const mark = svgNode(svg, "circle", { cx: u, cy: v, r: w / 160, fill: "none", stroke: colour, "stroke-width": line });
      svgNode(mark, "title", {}, `${m.id}${m.why ? `: ${m.why}` : ""}`);
      if (finite(ru) && finite(rv)) {
        svgNode(svg, "line", { x1: u, y1: v, x2: u + times * ru, y2: v + times * rv, stroke: "#ff58c8", "stroke-width": line });
      }
      svgNode(svg, "text", { x: u + w / 110, y: v - w / 110, fill: colour, "font-size": w / 65 }, m.id);
    }
    const caption = longest > 0 ? ` Pink: residuals, enlarged ${Number(times.toPrecision(2))} times.` : "";
    node(this.shownPicture, "p", { className: "caption" }, `The markers' images in the frame, whose picture is not in this page (wingd report --pictures).${caption}`);
  }

  drawCurve(frame) {
    this.curve.replaceChildren();
    const mean = this.curves?.tracks.find((track) => track.series === frame.series);
    // Without an installation the markers' spans count from a guessed origin.
    const deflections = frame.markers.filter((m) => this.data.surveyed && m.ground !== null && finite(m.deflection[0]));
    const tracks = [
      { name: "this frame", colour: "#17456f", joined: true, dashed: false, points: frame.curve, texts: [] },
      { name: "mean of its series", colour: "#8a4b00", joined: true, dashed: true, points: mean?.points ?? [], texts: [] },
      { name: "markers", colour: "#1d6b4f", joined: false, dashed: false, points: deflections.map((m) => [m.ground[0], m.deflection[0], m.deflection[1]]), texts: deflections.map((m) => m.id) },
    ].filter((track) => track.points.length > 0);
    if (tracks.length === 0) { node(this.curve, "p", {}, "It has no curve."); return; }
    const name = `Deflection of ${frame.series} ${frame.image}`;
    new Chart(this.curve, { name, height: 320, x: { label: "span, outboard from the camera / m" }, y: { label: "deflection against the survey / m", zero: true }, tracks });
  }

  markers(frame) {
    this.table.replaceChildren();
    if (frame.markers.length === 0) { node(this.table, "p", {}, "None."); return; }
    const table = node(this.table, "table", {});
    const row = (place, cells, kind) => {
      const made = node(place, "tr", {});
      cells.forEach((cell, k) => node(made, kind, { className: k === 0 ? "s" : k < 7 ? "n" : "l" }, cell));
    };
    row(node(table, "thead", {}), ["marker", "u / px", "v / px", "residual u / px", "residual v / px", "deflection against the survey / m", "σ / m", "remark"], "th");
    const body = node(table, "tbody", {});
    const fixed = (value, digits) => (finite(value) ? value.toFixed(digits) : "–");
    for (const m of frame.markers) {
      const [u, v, ru, rv] = m.at ?? [];
      const digits = decimalsFor(m.deflection[1]);
      const said = m.used ? "" : m.why || "not used";
      row(body, [m.id, fixed(u, 2), fixed(v, 2), fixed(ru, 3), fixed(rv, 3), fixed(m.deflection[0], digits), fixed(m.deflection[1], digits), said], "td");
    }
    csvButton(table, () => `markers-${frame.series}-${frame.image}`);
  }
}
