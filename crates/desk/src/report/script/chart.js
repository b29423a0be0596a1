// Interactive figures: values on hover, zoom, tracks shown or hidden, export as SVG, PNG or CSV.
const addElement = (parent, name, properties, content) => {
  const made = Object.assign(document.createElement(name), properties);
  if (content !== undefined) made.textContent = content;
  parent.append(made);
  return made;
};

const addButton = (parent, text, title, action) => {
  const made = addElement(parent, "button", { type: "button", title, onclick: action }, text);
  made.setAttribute("aria-label", `${text}: ${title}`);
  return made;
};

const addTools = (before) => {
  const bar = Object.assign(document.createElement("div"), { className: "tools" });
  before.before(bar);
  return bar;
};

const saveFile = (parts, type, name) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(parts, { type }));
  link.download = name.replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^-+|-+$/g, "");
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
};

const COPIED = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap", "opacity", "font-size",
  "font-family", "font-weight", "text-anchor", "paint-order"];

// Copies a drawing with the styles of the page written into it, for use outside the page.
const copyDrawing = (svg) => {
  const copy = svg.cloneNode(true);
  const [from, to] = [svg, copy].map((root) => [root, ...root.querySelectorAll("*")]);
  from.forEach((original, k) => {
    const style = getComputedStyle(original);
    for (const name of COPIED) to[k].setAttribute(name, style.getPropertyValue(name));
  });
  copy.removeAttribute("style");
  return copy;
};

// Copies a drawing that is at least as wide as on paper.
const copyPicture = (svg) => {
  const copy = copyDrawing(svg);
  const [, , width, height] = svg.getAttribute("viewBox").split(/\s+/).map(Number);
  const scale = width > 2400 ? 1600 / width : 1;
  copy.setAttribute("width", width * scale);
  copy.setAttribute("height", height * scale);
  return copy;
};

const svgText = (svg) => {
  svg.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  return new XMLSerializer().serializeToString(svg);
};

// Saves twice the drawing's size, on white.
const savePng = async (svg, name) => {
  const image = new Image();
  image.src = URL.createObjectURL(new Blob([svgText(svg)], { type: "image/svg+xml" }));
  await image.decode();
  const [width, height] = ["width", "height"].map((key) => 2 * Number(svg.getAttribute(key)));
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d");
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, width, height);
  context.drawImage(image, 0, 0, width, height);
  URL.revokeObjectURL(image.src);
  canvas.toBlob((blob) => saveFile([blob], "image/png", name), "image/png");
};

const addSaveButtons = (bar, copy, name) => {
  addButton(bar, "SVG", "save the figure as SVG", () => saveFile([svgText(copy())], "image/svg+xml", `${name()}.svg`));
  addButton(bar, "PNG", "save the figure as PNG", () => savePng(copy(), `${name()}.png`));
};

const saveCsv = (rows, name) => {
  const cell = (value) => (/[",\n\r]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  const text = rows.map((row) => row.map((value) => cell(String(value ?? ""))).join(",")).join("\r\n");
  saveFile(["\ufeff", text, "\r\n"], "text/csv", `${name}.csv`);
};

const clamp = (value) => Math.max(0, Math.min(value, 1));
const pointerShare = (svg, event) => {
  const box = svg.getBoundingClientRect();
  return [clamp((event.clientX - box.left) / box.width), clamp((event.clientY - box.top) / box.height)];
};

// Lets the user drag a rectangle across a drawing. Calls `done` with its edges [left, right, top, bottom] as fractions of the
// drawing; a rectangle lower than `flat` px has the full height.
const addSelection = (svg, flat, done) => {
  const mark = addElement(svg.parentElement, "div", { className: "chosen", hidden: true });
  let from = null;
  const edges = (event) => {
    const to = pointerShare(svg, event);
    const { width, height } = svg.getBoundingClientRect();
    const [[left, right], ends] = [0, 1].map((k) => [from[k], to[k]].sort((a, b) => a - b));
    const [top, bottom] = (ends[1] - ends[0]) * height < flat ? [0, 1] : ends;
    return { all: [left, right, top, bottom], wide: (right - left) * width > 12, width, height };
  };
  svg.addEventListener("pointerdown", (event) => {
    if (event.button === 0) { from = pointerShare(svg, event); svg.setPointerCapture(event.pointerId); }
  });
  svg.addEventListener("pointermove", (event) => {
    if (from === null) return;
    const { all: [left, right, top, bottom], wide, width, height } = edges(event);
    mark.hidden = !wide;
    const [x, y] = [svg.getBoundingClientRect(), mark.parentElement.getBoundingClientRect()].reduce((a, b) => [a.left - b.left, a.top - b.top]);
    mark.style.cssText = `left:${x + left * width}px;width:${(right - left) * width}px;top:${y + top * height}px;height:${(bottom - top) * height}px`;
  });
  const end = (event) => {
    mark.hidden = true;
    const { all, wide } = from === null ? {} : edges(event);
    from = null;
    if (wide && event.type === "pointerup") done(all);
  };
  svg.addEventListener("pointerup", end);
  svg.addEventListener("pointercancel", end);
};

// Lets the user zoom a picture; the aspect ratio is kept. Returns a function that shows all of it.
const makeZoomable = (svg) => {
  const whole = svg.getAttribute("viewBox");
  const reset = () => svg.setAttribute("viewBox", whole);
  addSelection(svg, 0, ([left, right, top, bottom]) => {
    const [x, y, width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
    const side = Math.max(right - left, bottom - top);
    svg.setAttribute("viewBox", `${x + left * width} ${y + top * height} ${side * width} ${side * height}`);
  });
  svg.addEventListener("dblclick", reset);
  return reset;
};

class InteractiveFigure extends Figure {
  // A figure that is not zoomable shows the range that its owner sets.
  constructor(svg, zoomable = true) {
    super(svg);
    this.name = svg.getAttribute("aria-label");
    this.selected = null;
    svg.setAttribute("tabindex", 0);
    svg.setAttribute("aria-label", `${this.name}; use the arrow keys to step through the points`);
    this.place = svg.parentElement;
    this.tools = addTools(this.place);
    if (zoomable) this.addZoom();
    addSaveButtons(this.tools, () => this.exportFigure(), () => this.name);
    addButton(this.tools, "CSV", "save the values as CSV", () => this.saveValues());
    this.spot = addElement(this.place, "div", { className: "spot", hidden: true });
    this.tip = addElement(this.place, "div", { className: "tip", hidden: true });
    this.tip.setAttribute("role", "status");
    this.addLegend();
    svg.addEventListener("pointermove", (event) => this.showNearest(event));
    svg.addEventListener("pointerleave", () => this.hidePoint());
    svg.addEventListener("keydown", (event) => this.handleKey(event));
  }

  addZoom() {
    addButton(this.tools, "All", "show the full range", () => this.resetZoom());
    this.svg.addEventListener("dblclick", () => this.resetZoom());
    addSelection(this.svg, 24, ([left, right, top, bottom]) => {
      const [x, y] = this.view.map(([low, high]) => (share) => low + share * (high - low));
      this.selected = [x(left), x(right)];
      if (top === 0 && bottom === 1) this.fitView();
      else this.setView([this.selected, [y(1 - bottom), y(1 - top)]]);
    });
  }

  // Turns the names of the tracks into switches; a double click shows one track alone.
  addLegend() {
    const list = this.place.parentElement.querySelector(".legend");
    this.switches = [...(list?.querySelectorAll("button") ?? [])];
    const showOnly = (kept) => { this.tracks.forEach(({ group }, k) => group.toggleAttribute("hidden", !kept(k))); this.fitView(); };
    const isShown = (k) => !this.tracks[k].group.hasAttribute("hidden");
    this.switches.forEach((one, k) => {
      Object.assign(one, { disabled: false, title: "click: show or hide; double click: show this track alone" });
      one.onclick = () => showOnly((other) => isShown(other) !== (other === k));
      one.ondblclick = () => showOnly((other) => other === k);
    });
    if (this.switches.length > 3) {
      const item = document.createElement("li");
      list.prepend(item);
      addButton(item, "all", `show all ${this.switches.length} tracks`, () => showOnly(() => true));
      addButton(item, "none", "hide all tracks", () => showOnly(() => false));
    }
    this.fitView();
  }

  visibleTracks() {
    return this.tracks.filter(({ group }) => !group.hasAttribute("hidden"));
  }

  // Shows the selected range, or all. With a selection or a hidden track the vertical range fits the points shown.
  fitView() {
    this.switches.forEach((one, k) => one.setAttribute("aria-pressed", String(!this.tracks[k].group.hasAttribute("hidden"))));
    this.hidePoint();
    const shown = this.visibleTracks();
    const x = this.selected ?? this.whole[0];
    const inside = shown.flatMap((track) => track.points).filter((p) => isPoint(p) && p[0] >= x[0] && p[0] <= x[1]);
    const whole = this.selected === null && shown.length === this.tracks.length;
    if (whole || inside.length === 0) { this.setView(whole ? this.whole : [x, this.whole[1]]); return; }
    const ends = inside.flatMap((p) => [p[1] - (p[2] ?? 0), p[1] + (p[2] ?? 0)]);
    const [low, high] = [ends.reduce((a, b) => Math.min(a, b)), ends.reduce((a, b) => Math.max(a, b))];
    const room = 0.04 * (high - low) || 0.5;
    this.setView([x, [low - room, high + room]]);
  }

  resetZoom() {
    this.selected = null;
    this.fitView();
  }

  // Returns a position as fractions of the figure, from the top left.
  share([x, y]) {
    const [[left, right], [bottom, top]] = this.view;
    return [(x - left) / (right - left), (top - y) / (top - bottom)];
  }

  showNearest(event) {
    const { left, top, width, height } = this.svg.getBoundingClientRect();
    let best = { away: 60 };
    for (const track of this.visibleTracks()) {
      track.points.forEach((p, k) => {
        const [x, y] = this.share(p);
        if (!isPoint(p) || clamp(x) !== x || clamp(y) !== y) return;
        const away = Math.hypot(left + x * width - event.clientX, top + y * height - event.clientY);
        if (away < best.away) best = { away, track, k };
      });
    }
    if (best.track) this.showPoint(best.track, best.k);
    else this.hidePoint();
  }

  showPoint(track, k) {
    this.hidePoint();
    this.hot = { track, k };
    const p = track.points[k];
    const [x, y] = this.axes;
    const [[across, acrossUnit], [, unit]] = [x, y].map(({ label }) => label.split(" / "));
    const where = x.zero === 0 ? `${across.split(",")[0]} ${Number(p[0].toPrecision(5))} ${acrossUnit ?? ""}`
      : `${axisText(x, p[0], 0, 19).replace("T", " ")} UTC`;
    for (const [name, text] of [["b", track.name], ["span", where], ["span", formatMeasured(y.turned ? -p[1] : p[1], p[2], unit).join(" ")],
      ["span", track.texts[k] ?? ""]]) addElement(this.tip, name, {}, text);
    track.group.classList.add("hot");
    this.tip.hidden = false;
    this.spot.hidden = false;
    const { width, height } = this.svg.getBoundingClientRect();
    const at = this.share(p);
    const [left, top] = [at[0] * width, at[1] * height];
    this.spot.style.cssText = `left:${left}px;top:${top}px`;
    const above = top - this.tip.offsetHeight - 12;
    this.tip.style.cssText = `left:${Math.max(0, Math.min(left + 14, width - this.tip.offsetWidth))}px;top:${above < 0 ? top + 14 : above}px`;
  }

  hidePoint() {
    this.hot?.track.group.classList.remove("hot");
    this.hot = null;
    this.tip.hidden = true;
    this.spot.hidden = true;
    this.tip.replaceChildren();
  }

  handleKey(event) {
    const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    if (event.key === "Escape") this.resetZoom();
    const tracks = this.visibleTracks().filter((track) => track.points.some(isPoint));
    if (step === undefined || tracks.length === 0) return;
    event.preventDefault();
    const old = Math.max(0, tracks.indexOf(this.hot?.track));
    const track = tracks[(old + step[0] + tracks.length) % tracks.length];
    const known = [...track.points.keys()].filter((k) => isPoint(track.points[k]));
    const at = known.indexOf(this.hot?.k ?? -1) + step[1];
    this.showPoint(track, known[Math.max(0, Math.min(known.length - 1, at))]);
  }

  // Draws the figure for use in a document, on white, in px, with a legend.
  exportFigure() {
    const [width, height] = [960, parseInt(this.svg.style.getPropertyValue("--height"), 10)];
    const copy = copyDrawing(this.svg);
    for (const hidden of copy.querySelectorAll("[hidden]")) hidden.remove();
    for (const element of copy.querySelectorAll("*")) {
      for (const { name, value } of [...element.attributes]) {
        const size = /x|width/.test(name) ? width : height;
        if (value.endsWith("%")) element.setAttribute(name, (parseFloat(value) * size) / 100);
      }
    }
    const place = (x, y) => this.share([x, y]).map((share, k) => (share * [width, height][k]).toFixed(2)).join(",");
    for (const group of copy.querySelectorAll("[data-track]")) {
      const data = pathData(this.tracks[group.dataset.track].points, place);
      for (const path of group.children) path.setAttribute("d", data[path.classList[0]]);
    }
    copy.querySelector(".area").setAttribute("viewBox", `0 0 ${width} ${height}`);
    copy.querySelector(".area > g").removeAttribute("transform");
    const named = this.tracks.length > 1 ? this.visibleTracks() : [];
    const across = 3;
    const total = height + 80 + 17 * Math.ceil(named.length / across);
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    for (const [key, value] of Object.entries({ width: 1040, height: total, viewBox: `0 0 1040 ${total}` })) svg.setAttribute(key, value);
    for (const [key, value] of Object.entries({ x: 60, y: 30, width, height, overflow: "visible" })) copy.setAttribute(key, value);
    svg.append(copy);
    named.forEach((track, k) => {
      const [x, y] = [60 + (k % across) * (width / across), height + 86 + 17 * Math.floor(k / across)];
      const dot = track.group.querySelector(".dot");
      const size = dot === null ? [20, 3] : dot.matches(".small") ? [4, 4] : [8, 8];
      addSvgElement(svg, "rect", { x, y: y - 6, width: size[0], height: size[1], fill: track.group.getAttribute("stroke") });
      addSvgElement(svg, "text", { x: x + 26, y, "font-size": 12, "font-family": "Arial, sans-serif", fill: "#333b46" }, track.name.slice(0, 48));
    });
    return svg;
  }

  saveValues() {
    const [x, y] = this.axes;
    const time = x.zero !== 0;
    const row = (track) => (p, k) => [track.name, time ? `${axisText(x, p[0], 0, 23)}Z` : p[0], y.turned ? -p[1] : p[1], p[2], track.texts[k]];
    const rows = this.visibleTracks().flatMap((track) => track.points.map((p, k) => isPoint(p) && row(track)(p, k)).filter(Boolean));
    saveCsv([["track", time ? "UTC" : x.label, y.label, "sigma", "what"], ...rows], this.name);
  }
}
