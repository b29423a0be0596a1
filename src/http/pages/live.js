"use strict";
// The wing as it is measured: results come as server-sent events, a picture of the frame is asked for once a second.
(() => {
  const SPAN_S = 180;
  const DRAW_MS = 200;
  const FRAME_MS = 1000;
  const SVG = "http://www.w3.org/2000/svg";
  const byId = (id) => document.getElementById(id);
  const text = (id, value) => { byId(id).textContent = value; };
  const history = [];
  const outlines = new Map();
  let newest = null;
  let changed = false;

  const number = (value, digits) =>
    typeof value === "number" && Number.isFinite(value) ? value.toFixed(digits) : null;
  const tile = (id, value, beside) => {
    text(id, value ?? "–");
    text(`${id}-beside`, beside ?? "");
  };
  const measured = (id, value, sigma, digits, unit) => {
    const [shown, spread] = [number(value, digits), number(sigma, digits)];
    tile(id, shown && `${shown} ${unit}`, shown && spread && `± ${spread} ${unit}`);
  };

  // 1, 2 or 5 times a power of ten, not below the raw step.
  const roundStep = (raw) => {
    const power = 10 ** Math.floor(Math.log10(raw));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
  };

  const element = (parent, name, attributes, content) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (content !== undefined) node.textContent = content;
    parent.append(node);
    return node;
  };

  // A range that does not jump with each gust: it grows at once, and shrinks where less than half of it is used.
  const ranges = new Map();
  const steady = (id, low, high) => {
    const [from, to] = ranges.get(id) ?? [low, high];
    const kept = high - low < 0.5 * (to - from) ? [low, high] : [Math.min(from, low), Math.max(to, high)];
    ranges.set(id, kept);
    return kept;
  };

  // Points: x, y, sigma or null; null itself breaks the line. Returns how many times the band is enlarged.
  const plot = (svg, points, { xRange, xLabel, yFrom0, xTick }) => {
    // In the page's own pixels: letters keep their size on a phone.
    const width = Math.max(240, svg.clientWidth);
    const height = Math.max(200, Math.min(320, 0.56 * width));
    const [left, right, top, bottom] = [46, 14, 10, 40];
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    const seen = points.filter((p) => p !== null);
    if (seen.length === 0) {
      element(svg, "text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, "No result yet");
      return 1;
    }
    // The band is inside, too.
    let low = Math.min(...seen.map((p) => p.y - (p.sigma ?? 0)));
    let high = Math.max(...seen.map((p) => p.y + (p.sigma ?? 0)));
    if (yFrom0) [low, high] = [Math.min(0, low), Math.max(0, high)];
    [low, high] = steady(svg.id, low, high);
    const step = roundStep(Math.max(high - low, 4 * Math.max(...seen.map((p) => p.sigma ?? 0)), 1e-3) / 4);
    [low, high] = [Math.floor(low / step) * step, Math.ceil(high / step) * step];
    if (high <= low) high = low + step;
    const x = (value) => left + ((value - xRange[0]) / (xRange[1] - xRange[0] || 1)) * (width - left - right);
    const y = (value) => top + ((high - value) / (high - low)) * (height - top - bottom);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let k = 0; k <= Math.round((high - low) / step); k++) {
      const value = low + k * step;
      element(svg, "line", { class: "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) });
      element(svg, "text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, value.toFixed(digits));
    }
    const ticks = 4;
    for (let k = 0; k <= ticks; k++) {
      const value = xRange[0] + (k / ticks) * (xRange[1] - xRange[0]);
      const anchor = k === 0 ? "start" : k === ticks ? "end" : "middle";
      element(svg, "text", { x: x(value), y: height - 22, "text-anchor": anchor }, xTick(value));
    }
    element(svg, "text", { x: (left + width - right) / 2, y: height - 5, "text-anchor": "middle" }, xLabel);
    const widest = Math.max(...seen.map((p) => p.sigma ?? 0));
    const enlarged = [50, 20, 10, 5, 2].find((factor) => widest * factor < 0.12 * (high - low)) ?? 1;
    for (const run of runs(points)) {
      const at = (p, side) => `${x(p.x).toFixed(1)},${y(p.y + side * enlarged * (p.sigma ?? 0)).toFixed(1)}`;
      const around = [...run.map((p) => at(p, 1)), ...[...run].reverse().map((p) => at(p, -1))];
      element(svg, "polygon", { class: "band", points: around.join(" ") });
      element(svg, "polyline", { class: "curve", points: run.map((p) => at(p, 0)).join(" ") });
    }
    return enlarged;
  };

  // The lift that the frame tells best, and against what it is counted.
  const LIFTS = {
    survey: ["lift_m", "sigma_lift_m", "against the survey"],
    ground: ["lift_ground_m", "sigma_lift_ground_m", "against the ground frame"],
    root: ["lift_root_m", "sigma_lift_root_m", "from the root's tangent"],
  };
  const shownLift = (tip) => {
    const [lift, sigma, words] = LIFTS[tip?.shown] ?? LIFTS.survey;
    return { lift: tip?.[lift], sigma: tip?.[sigma], words };
  };

  const runs = (points) => {
    const all = [[]];
    for (const point of points) {
      if (point === null) all.push([]);
      else all[all.length - 1].push(point);
    }
    return all.filter((run) => run.length > 0);
  };

  const band = (enlarged) => `Band: 1 sigma${enlarged > 1 ? `, enlarged ${enlarged} times` : ""}`;

  const overTime = (id, unit, of) => {
    const now = history.length > 0 ? history[history.length - 1].time : 0;
    const points = [];
    let last = null;
    for (const one of history) {
      const value = of(one);
      // Where results are missing for a second the line ends.
      if (last !== null && one.time - last > 1) points.push(null);
      if (typeof value.y === "number") {
        points.push({ x: one.time - now, ...value });
        last = one.time;
      }
    }
    const since = history.length > 0 ? now - history[0].time : 0;
    const range = [-Math.min(SPAN_S, 20 * Math.max(1, Math.ceil(since / 20))), 0];
    const enlarged = plot(byId(id), points, { xRange: range, xLabel: `${unit}, over seconds`, xTick: (v) => v.toFixed(0) });
    text(`${id}-caption`, `${band(enlarged)}.`);
  };

  const draw = () => {
    const result = newest;
    if (result === null) return;
    const solved = result.status === "ok";
    const pair = (result.torsion ?? [])[0] ?? {};
    const tip = shownLift(solved ? result.tip : null);
    measured("lift", tip.lift, tip.sigma, 3, "m");
    if (solved) text("lift-name", `Tip lift ${tip.words}`);
    measured("twist", solved ? pair.twist_deg : null, pair.sigma_twist_deg, 2, "°");
    const recent = history.filter((one) => one.came > performance.now() - 10000);
    const elapsed = recent.length > 1 ? (recent[recent.length - 1].came - recent[0].came) / 1000 : 0;
    tile("rate", elapsed > 0 ? `${((recent.length - 1) / elapsed).toFixed(1)} Hz` : null, "over ten seconds");
    const late = recent.map((one) => one.latency).sort((a, b) => a - b);
    const p95 = late[Math.max(0, Math.ceil(0.95 * late.length) - 1)];
    tile("latency", `${Math.round(result.latency_ms)} ms`, p95 && `95 %: ${Math.round(p95)} ms`);
    tile("skipped", String(result.skipped), `of ${result.number} frames`);
    tile("test", result.global_test, `variance ${number(result.variance_factor, 2) ?? "–"}`);
    const curve = (result.curve ?? []).map((p) => ({ x: p.span_m, y: p.lift_m, sigma: p.sigma_lift_m }));
    if (curve.length > 1) {
      const range = [curve[0].x, curve[curve.length - 1].x];
      const enlarged = plot(byId("curve"), curve, {
        xRange: range, xLabel: "Lift, m, over the span, m", yFrom0: true, xTick: (v) => v.toFixed(1),
      });
      const sigma = curve[curve.length - 1].sigma;
      const end = typeof sigma === "number" ? `; at its end ${(1000 * sigma).toFixed(1)} mm` : "";
      text("curve-caption", `Of the bending axis, against the survey. ${band(enlarged)}${end}.`);
    }
    // Where the frames' choice changes, only those of the newest one's are drawn: two lifts make no curve.
    const lifted = history.filter((one) => typeof one.lift === "number");
    const words = (lifted[lifted.length - 1] ?? tip).words;
    const alike = (one) => one.words === words;
    overTime("lifts", `m, ${words}`, (one) => (alike(one) ? { y: one.lift, sigma: one.liftSigma } : {}));
    overTime("twists", "degrees", (one) => ({ y: one.twist, sigma: one.twistSigma }));
    const when = result.exposure_time.replace("T", " ").slice(0, 21);
    const said = solved ? "" : `: ${result.reason ?? "no numbers"}`;
    state(`Frame ${result.number}, ${when} UTC, mounting ${result.mounting}${result.jolt ? ", jolted" : ""}${said}`, !solved);
  };

  const state = (words, warn) => {
    const node = byId("state");
    node.textContent = words;
    node.className = warn ? "warning" : "soft";
  };

  const take = (result) => {
    newest = result;
    changed = true;
    const solved = result.status === "ok";
    const pair = (solved && (result.torsion ?? [])[0]) || {};
    const tip = shownLift(solved ? result.tip : null);
    const time = Date.parse(result.exposure_time) / 1000;
    // A clock that was set begins a new history.
    if (history.length > 0 && time < history[history.length - 1].time) history.length = 0;
    history.push({
      time, came: performance.now(), latency: result.latency_ms,
      lift: tip.lift, liftSigma: tip.sigma, words: tip.words, twist: pair.twist_deg, twistSigma: pair.sigma_twist_deg,
    });
    while (history.length > 0 && time - history[0].time > SPAN_S) history.shift();
    outlines.set(result.number, result.outlines ?? []);
    while (outlines.size > 100) outlines.delete(outlines.keys().next().value);
  };

  const outline = (frame, [width, height]) => {
    const svg = byId("outlines");
    svg.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    svg.replaceChildren();
    const seen = outlines.get(frame) ?? [];
    for (const one of seen) {
      element(svg, "ellipse", {
        class: one.id === null ? "unnamed" : "named", cx: one.u_px, cy: one.v_px,
        rx: Math.max(one.semi_major_px, width / 250), ry: Math.max(one.semi_minor_px, width / 250),
        transform: `rotate(${one.angle_deg} ${one.u_px} ${one.v_px})`,
      });
    }
    const named = seen.filter((one) => one.id !== null).length;
    text("frame-caption", `Frame ${frame}: ${named} markers, ${seen.length - named} without a name.`);
  };

  let shown = null;
  const fetchFrame = async () => {
    if (newest === null || document.visibilityState !== "visible") return;
    const answer = await fetch("/live/frame.jpg");
    if (!answer.ok) return;
    const frame = Number(answer.headers.get("x-wingd-frame"));
    const size = (answer.headers.get("x-wingd-size") ?? "4x3").split("x").map(Number);
    const url = URL.createObjectURL(await answer.blob());
    const image = byId("frame");
    image.src = url;
    await image.decode();
    outline(frame, size);
    if (shown !== null) URL.revokeObjectURL(shown);
    shown = url;
  };

  const frames = async () => {
    try {
      await fetchFrame();
    } catch (error) {
      // The next second brings another.
    }
    setTimeout(frames, FRAME_MS);
  };

  const source = new EventSource("/live/events");
  source.addEventListener("message", (event) => take(JSON.parse(event.data)));
  source.addEventListener("down", (event) => state(`${JSON.parse(event.data).reason}.`, true));
  source.addEventListener("error", () => state("The page's server does not answer; it is called again.", true));
  setInterval(() => {
    if (changed && document.visibilityState === "visible") {
      changed = false;
      draw();
    }
  }, DRAW_MS);
  frames();
})();
