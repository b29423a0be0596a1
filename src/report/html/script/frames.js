// Viewer of single frames: image, curve, 3D view of the wing, markers. It starts with the frame that ranks first.

// Lets you zoom a picture by dragging a rectangle over it. Returns a function that resets the zoom.
const makeZoomable = (svg) => {
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
    chosen = addSvgElement(svg, "rect", { class: "chosen" });
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
    // The aspect ratio is kept.
    const side = Math.max(width, (height * w) / h);
    if (side > 0.01 * w) svg.setAttribute("viewBox", `${x} ${y} ${side} ${(side * h) / w}`);
  });
  svg.addEventListener("pointercancel", () => { from = null; chosen?.remove(); });
  svg.addEventListener("dblclick", () => svg.setAttribute("viewBox", whole));
  return () => svg.setAttribute("viewBox", whole);
};

const addSaveButtons = (bar, svg, name) => {
  addButton(bar, "SVG", "save the figure as SVG", () => saveFile(svgBlob(standaloneSvg(svg())), `${name()}.svg`));
  addButton(bar, "PNG", "save the figure as PNG", () => savePng(standaloneSvg(svg()), `${name()}.png`));
};

class FrameViewer {
  constructor(place, data, curves) {
    this.data = data;
    this.curves = curves;
    this.root = place;
    this.addChooser();
    this.status = addElement(place, "p", { className: "said" });
    this.status.setAttribute("role", "status");
    this.addPictureArea();
    addElement(place, "h3", {}, "Deflection along the span");
    this.curve = addElement(place, "div", {});
    addElement(place, "h3", {}, "3D view of the wing");
    this.wing = new WingView(addElement(place, "div", {}));
    addElement(place, "h3", {}, "Markers");
    this.table = addElement(place, "div", { className: "scroll" });
    this.showFrame(0);
  }

  addChooser() {
    const bar = addElement(this.root, "div", { className: "tools" });
    const label = addElement(bar, "label", {}, "Frame ");
    this.select = addElement(label, "select", {});
    const group = (title, all) => {
      if (all.length === 0) return;
      const list = addElement(this.select, "optgroup", { label: title });
      for (const k of all) {
        const frame = this.data.frames[k];
        addElement(list, "option", { value: k }, `${frame.series} ${frame.image}${frame.doubt ? `: ${frame.doubt}` : ""}`);
      }
    };
    const all = [...this.data.frames.keys()];
    const first = all.filter((k) => this.data.frames[k].doubt);
    group("Check first", first.length > 0 ? first : all.slice(0, 1));
    const order = (k) => `${this.data.frames[k].series} ${this.data.frames[k].image}`;
    this.order = all.sort((a, b) => (order(a) < order(b) ? -1 : 1));
    for (const series of new Set(this.order.map((k) => this.data.frames[k].series))) {
      group(`Series ${series}`, this.order.filter((k) => this.data.frames[k].series === series));
    }
    this.select.onchange = () => this.showFrame(Number(this.select.value));
    const step = (by) => {
      const at = this.order.indexOf(this.index);
      this.showFrame(this.order[(at + by + this.order.length) % this.order.length]);
    };
    const steps = addElement(bar, "span", { className: "steps" });
    addButton(steps, "‹", "previous frame", () => step(-1));
    addButton(steps, "›", "next frame", () => step(1));
  }

  addPictureArea() {
    this.pictures = new Map([...document.querySelectorAll("[data-frame]")].map((one) => [one.dataset.frame, one]));
    this.pictureArea = addElement(this.root, "div", { className: "chart" });
    const bar = addElement(this.pictureArea, "div", { className: "tools" });
    addButton(bar, "All", "show the full image", () => this.resetZoom?.());
    addSaveButtons(bar, () => this.pictureArea.querySelector("svg"), () => `frame-${this.frame.series}-${this.frame.image}`);
    this.shownPicture = addElement(this.pictureArea, "div", { className: "shown" });
  }

  showFrame(index) {
    this.index = index;
    const frame = this.data.frames[index];
    this.frame = frame;
    this.select.value = index;
    const test = frame.test ? `, global test ${frame.test}` : "";
    const factor = isNumber(frame.factor) ? `, variance factor ${frame.factor.toFixed(2)}` : "";
    this.status.textContent = frame.solved
      ? `Tip deflection ${formatMeasured(frame.deflection[0], frame.deflection[1], "m")} ${this.data.counted}${factor}${test}${frame.doubt && frame.test !== "rejected" ? `. Check this frame: ${frame.doubt}` : ""}.`
      : `No result: ${frame.why}`;
    this.status.className = frame.solved && frame.test !== "rejected" ? "said" : "said warning";
    this.showPicture(frame);
    this.drawCurve(frame);
    this.wing.setFrame(frame);
    this.showMarkers(frame);
  }

  // Shows the embedded image, or the markers alone if the image is not embedded.
  showPicture(frame) {
    const embedded = this.pictures.get(`${frame.series}/${frame.image}`);
    this.shownPicture.replaceChildren();
    if (embedded) {
      const copy = embedded.cloneNode(true);
      copy.removeAttribute("data-frame");
      this.shownPicture.append(...copy.childNodes);
    } else {
      this.drawMarkersOnly(frame);
    }
    const svg = this.shownPicture.querySelector("svg");
    if (svg) this.resetZoom = makeZoomable(svg);
  }

  drawMarkersOnly(frame) {
    const seen = frame.markers.filter((m) => m.at !== null);
    if (seen.length === 0) { addElement(this.shownPicture, "p", {}, "The image is not embedded, and the frame has no marker positions."); return; }
    const [us, vs] = [0, 1].map((k) => seen.map((m) => m.at[k]));
    const size = Math.max(Math.max(...us) - Math.min(...us), Math.max(...vs) - Math.min(...vs), 10);
    const room = 0.08 * size;
    const [x, y] = [Math.min(...us) - room, Math.min(...vs) - room];
    const [w, h] = [Math.max(...us) - x + 2 * room, Math.max(...vs) - y + room];
    const svg = addSvgElement(this.shownPicture, "svg", { viewBox: [x, y, w, h].map(roundToTenth).join(" "), class: "photo", role: "img", "aria-label": "Markers of the frame" });
    const longest = Math.max(...seen.map((m) => Math.hypot(m.at[2] ?? 0, m.at[3] ?? 0)));
    const times = longest > 0 ? roundStep((0.03 * w) / longest) : 1;
    const line = w / 700;
    for (const m of seen) {
      const colour = m.used ? "#3dea6d" : "#ffd23d";
      const [u, v, ru, rv] = m.at;
      const mark = addSvgElement(svg, "circle", { cx: u, cy: v, r: w / 160, fill: "none", stroke: colour, "stroke-width": line });
      addSvgElement(mark, "title", {}, `${m.id}${m.why ? `: ${m.why}` : ""}`);
      if (isNumber(ru) && isNumber(rv)) {
        addSvgElement(svg, "line", { x1: u, y1: v, x2: u + times * ru, y2: v + times * rv, stroke: "#ff58c8", "stroke-width": line });
      }
      addSvgElement(svg, "text", { x: u + w / 110, y: v - w / 110, fill: colour, "font-size": w / 65 }, m.id);
    }
    const caption = longest > 0 ? ` Pink: residuals, enlarged ${Number(times.toPrecision(2))} times.` : "";
    addElement(this.shownPicture, "p", { className: "caption" }, `Image positions of the markers. The image itself is not embedded (option --pictures of wingd report).${caption}`);
  }

  drawCurve(frame) {
    this.curve.replaceChildren();
    const mean = this.curves?.tracks.find((track) => track.series === frame.series);
    // Without an installation the markers' spans have a guessed origin.
    const deflections = frame.markers.filter((m) => this.data.surveyed && m.ground !== null && isNumber(m.deflection[0]));
    const tracks = [
      { name: "this frame", colour: "#17456f", joined: true, dashed: false, points: frame.curve, texts: [] },
      { name: "mean of its series", colour: "#8a4b00", joined: true, dashed: true, points: mean?.points ?? [], texts: [] },
      { name: "markers", colour: "#1d6b4f", joined: false, dashed: false, points: deflections.map((m) => [m.ground[0], m.deflection[0], m.deflection[1]]), texts: deflections.map((m) => m.id) },
    ].filter((track) => track.points.length > 0);
    if (tracks.length === 0) { addElement(this.curve, "p", {}, "This frame has no curve."); return; }
    const name = `Deflection of ${frame.series} ${frame.image}`;
    new Chart(this.curve, { name, height: 320, x: { label: "span, outboard from the camera / m" }, y: { label: "deflection against the survey / m", zero: true }, tracks });
  }

  showMarkers(frame) {
    this.table.replaceChildren();
    if (frame.markers.length === 0) { addElement(this.table, "p", {}, "No markers."); return; }
    const table = addElement(this.table, "table", {});
    const row = (place, cells, kind) => {
      const made = addElement(place, "tr", {});
      cells.forEach((cell, k) => addElement(made, kind, { className: k === 0 ? "s" : k < 7 ? "n" : "l" }, cell));
    };
    row(addElement(table, "thead", {}), ["marker", "u / px", "v / px", "residual u / px", "residual v / px", "deflection against the survey / m", "σ / m", "remark"], "th");
    const body = addElement(table, "tbody", {});
    const fixed = (value, digits) => (isNumber(value) ? value.toFixed(digits) : "–");
    for (const m of frame.markers) {
      const [u, v, ru, rv] = m.at ?? [];
      const digits = decimalsFor(m.deflection[1]);
      const remark = m.used ? "" : m.why || "not used";
      row(body, [m.id, fixed(u, 2), fixed(v, 2), fixed(ru, 3), fixed(rv, 3), fixed(m.deflection[0], digits), fixed(m.deflection[1], digits), remark], "td");
    }
    addCsvButton(table, () => `markers-${frame.series}-${frame.image}`);
  }
}
