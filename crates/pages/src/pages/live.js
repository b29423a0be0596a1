"use strict";
// Live page: results and the recorder's state arrive as server-sent events, an image of the frame is requested once per second.
// Outdated values are marked by this browser's own clock, even if no event arrives.
(() => {
  const SPAN_S = 180;
  const TICK_MS = 100;
  const DRAW_MS = 200;
  const FRAME_MS = 1000;
  const RATE_S = 10;
  // Number of intervals after which a result is old, and after which it is lost, as in the recorder's health.
  const [OLD, LOST] = [3, 5];
  // The server sends an event at least every 4 s; after this silence the connection counts as lost.
  const SILENCE_MS = 6000;
  const RECONNECT_MS = 2000;
  const FULL_MS = 5000;
  const byId = (id) => document.getElementById(id);
  const text = (id, value) => { if (byId(id).textContent !== value) byId(id).textContent = value; };
  const mark = (node, name) => { if (node.getAttribute("class") !== name) node.setAttribute("class", name); };
  const history = [];
  const frames = new Map();
  let newest = null;
  let daemon = null;
  let link = { open: false, young: true, why: "waiting for the recorder" };
  let drawn = { at: 0, as: "" };

  const number = (value, digits) =>
    typeof value === "number" && Number.isFinite(value) ? value.toFixed(digits) : null;
  const seconds = (s) => (s < 10 ? `${s.toFixed(1)} s` : s < 120 ? `${Math.round(s)} s` : `${Math.round(s / 60)} min`);
  const since = (came) => (performance.now() - came) / 1000;

  const interval = () => {
    if (typeof daemon?.interval_s === "number") return daemon.interval_s;
    const last = history.slice(-11);
    return last.length > 1 ? (last[last.length - 1].came - last[0].came) / 1000 / (last.length - 1) : 1;
  };
  // Returns "" for a current result, "old" after 3 intervals or without a connection, "lost" after 5.
  const freshness = (came, every = interval()) => {
    const age = since(came);
    if (age > LOST * every) return "lost";
    return age > OLD * every || !link.open ? "old" : "";
  };

  const tile = (id, value, note, style) => {
    text(id, value ?? "–");
    text(`${id}-beside`, note ?? "");
    mark(byId(id).parentElement, style);
  };

  // The reported deflection, its standard deviation and its reference in words.
  const DEFLECTIONS = {
    survey: ["deflection_m", "sigma_deflection_m", "against the survey"],
    ground: ["deflection_ground_m", "sigma_deflection_ground_m", "against the ground frame"],
    root: ["deflection_root_m", "sigma_deflection_root_m", "from the root's tangent"],
  };
  const reportedDeflection = (tip) => {
    const [deflection, sigma, words] = DEFLECTIONS[tip?.reference] ?? DEFLECTIONS.survey;
    return { deflection: tip?.[deflection], sigma: tip?.[sigma], words, keys: [deflection, sigma] };
  };

  const solved = () => newest.result.status === "ok";
  const rejected = (result) => result.global_test === "rejected";

  const tiles = () => {
    if (newest === null) return tile("age", null, "none yet", link.open ? "" : "lost");
    const { result, came } = newest;
    const style = freshness(came);
    const age = `${seconds(since(came))} old`;
    const warned = style === "" && (!solved() || rejected(result)) ? "degraded" : style;
    const measured = (id, value, sigma, digits, unit) => {
      const [shown, spread] = [solved() ? number(value, digits) : null, number(sigma, digits)];
      const notes = [shown && spread && `± ${spread} ${unit}`, !solved() && "no numbers", rejected(result) && "test rejected", style && age];
      tile(id, shown && `${shown} ${unit}`, notes.filter(Boolean).join(", "), warned);
    };
    const pair = (result.torsion ?? [])[0] ?? {};
    tile("age", `${seconds(since(came))} ago`, `expected every ${number(interval(), 2)} s`, style);
    const tip = reportedDeflection(result.tip);
    measured("deflection", tip.deflection, tip.sigma, 3, "m");
    if (solved()) text("deflection-name", `Deflection of ${result.tip?.marker ?? "the tip"} ${tip.words}`);
    measured("twist", pair.twist_deg, pair.sigma_twist_deg, 2, "°");
    measured("streamwise", pair.streamwise_twist_deg, pair.sigma_streamwise_twist_deg, 2, "°");
    const recent = history.filter((one) => since(one.came) < RATE_S);
    const over = Math.min(RATE_S, since(history[0].came));
    tile("rate", `${(recent.length / Math.max(over, 1)).toFixed(1)} Hz`, "over 10 s", style);
    const late = recent.map((one) => one.latency).sort((a, b) => a - b);
    const p95 = late[Math.max(0, Math.ceil(0.95 * late.length) - 1)];
    tile("latency", `${Math.round(result.latency_ms)} ms`, style || p95 === undefined ? age : `95 %: ${Math.round(p95)} ms`, style);
    tile("skipped", String(result.skipped), style ? age : `of ${result.number} frames`, style);
    const variance = `variance ${number(result.variance_factor, 2) ?? "–"}`;
    tile("test", solved() ? result.global_test : null, [solved() ? variance : "no numbers", style && age].filter(Boolean).join(", "), warned);
  };

  // Shows one health word: the worse of the recorder's health and this page's own findings.
  const health = () => {
    let [word, reasons] = ["ok", []];
    const worse = (other, why) => {
      if (other === "failed" || word === "ok") word = other;
      reasons.push(why);
    };
    if (!link.open) worse(link.young ? "degraded" : "failed", link.why);
    if (daemon !== null && link.open) {
      if (daemon.health !== "ok") word = daemon.health;
      reasons.push(...daemon.reasons);
    }
    if (newest !== null) {
      const style = freshness(newest.came);
      const gone = `no result for ${seconds(since(newest.came))}`;
      if (style === "lost") worse("failed", gone);
      else if (style === "old" && link.open) worse("degraded", gone);
      if (!solved()) worse("degraded", `no numbers: ${newest.result.reason ?? "the frame is not solved"}`);
      else if (rejected(newest.result)) worse("degraded", "the global test rejected the last result: its standard deviations are unreliable");
    } else if (link.open && reasons.length === 0) worse("degraded", "no result yet");
    // If the recorder itself reports missing results, its sentence is enough.
    if (reasons.some((why) => why.startsWith("the last live result"))) reasons = reasons.filter((why) => !why.startsWith("no result for"));
    text("word", word);
    text("reasons", reasons.join("\n"));
    mark(byId("health"), word);
  };

  const style = (id, name) => mark(byId(id), name);
  const figures = new Map(["curve", "deflections", "twists"].map((id) => [id, new Figure(byId(id).querySelector("svg"))]));
  const ranges = new Map();

  // Range that does not jump with each gust: a new one if a value leaves it, or less than half of it is used.
  const steady = (id, low, high) => {
    const [from, to] = ranges.get(id) ?? [0, 0];
    if (low < from || high > to || high - low < 0.5 * (to - from)) {
      const room = Math.max(0.1 * (high - low), 5e-4);
      ranges.set(id, [low - room, high + room]);
    }
    return ranges.get(id);
  };

  // Draws points [x, y, sigma, doubt]; BREAK ends a line, as does a change of `doubt`. `lost` is the time from which results are
  // missing. Returns a sentence about the band.
  const plot = (id, points, xRange, { note = "", noteStyle = "", lost = null, low = Infinity }) => {
    const seen = points.filter(isPoint);
    const values = [...seen.flatMap((p) => [p[1] - (p[2] ?? 0), p[1] + (p[2] ?? 0)]), low].filter(isNumber);
    const words = byId(id).querySelector(".note");
    words.textContent = seen.length > 0 ? note : note || "No result yet";
    mark(words, `note ${noteStyle}`);
    const [bottom, top] = seen.length > 0 ? steady(id, Math.min(...values), Math.max(...values)) : [0, 1];
    byId(id).classList.toggle("empty", seen.length === 0);
    const ofKind = (doubt) => points.map((p) => (isPoint(p) && p[3] === doubt ? p : BREAK));
    const figure = figures.get(id);
    figure.setPoints(0, ofKind(false));
    figure.setPoints(1, ofKind(true));
    figure.setPoints(2, lost === null ? [] : [lost, xRange[1]].map((x) => [x, (bottom + top) / 2, top - bottom]));
    figure.setView([xRange, [bottom, top]]);
    return seen.length === 0 ? "" : "Band: 1 sigma.";
  };

  const curve = () => {
    const { result, came } = newest;
    const fresh = freshness(came);
    style("curve", `graph ${fresh}`);
    const { keys: [value, sigma], words } = reportedDeflection(result.tip);
    const points = solved() ? (result.curve ?? []).map((p) => [p.span_m, p[value], p[sigma], rejected(result)]) : [];
    const note = !solved() ? `No numbers in frame ${result.number}` : fresh ? `${seconds(since(came))} old`
      : rejected(result) ? "Test rejected" : "";
    const range = points.length > 0 ? [points[0][0], points[points.length - 1][0]] : [0, 1];
    const band = plot("curve", points, range, { note, noteStyle: fresh ? "" : "degraded", low: 0 });
    text("curve-caption", band && `Deflection of the bending axis, ${words}. ${band}`);
  };

  const overTime = (id, words, valueOf) => {
    const now = newest.time + since(newest.came);
    const apart = Math.max(1, OLD * interval());
    const points = [];
    let last = null;
    for (const one of history) {
      const [value, sigma] = valueOf(one);
      // The line ends if results are missing or have no numbers.
      if (last !== null && one.time - last > apart) points.push(BREAK);
      points.push(isNumber(value) ? [one.time - now, value, sigma, one.rejected] : BREAK);
      last = one.time;
    }
    const fresh = freshness(newest.came);
    style(id, `graph ${fresh}`);
    const range = [-Math.min(SPAN_S, 20 * Math.max(1, Math.ceil((now - history[0].time) / 20))), 0];
    const note = fresh ? `No result for ${seconds(since(newest.came))}` : solved() ? "" : "No numbers";
    const band = plot(id, points, range, { note, noteStyle: fresh ? "" : "degraded", lost: fresh ? newest.time - now : null });
    text(`${id}-caption`, `${words} ${band}`);
  };

  const draw = () => {
    curve();
    // If the reference changes, only deflections with the newest reference are drawn in the curve.
    const deflected = history.filter((one) => typeof one.deflection === "number");
    const { words } = deflected[deflected.length - 1] ?? reportedDeflection(null);
    overTime("deflections", `Deflection ${words}.`, (one) => (one.words === words ? [one.deflection, one.deflectionSigma] : []));
    overTime("twists", "", (one) => [one.twist, one.twistSigma]);
    const { result } = newest;
    const when = result.exposure_time.replace("T", " ").slice(0, 21);
    text("state", `Frame ${result.number}, ${when} UTC, mounting ${result.mounting}${result.mount_disturbed ? ", disturbed" : ""}`);
    style("state", `soft ${freshness(newest.came)}`);
  };

  // The image arrives once per second and is as old as its frame.
  let picture = null;
  const caption = () => {
    if (picture === null) return;
    const fresh = freshness(picture.came, Math.max(interval(), FRAME_MS / 1000));
    mark(byId("frame").parentElement, `seen ${fresh}`);
    mark(byId("frame-caption"), `caption ${fresh}`);
    text("frame-caption", `Frame ${picture.frame}, ${seconds(since(picture.came))} old: ${picture.words}.`);
  };

  const tick = () => {
    if (performance.now() - lastEvent > SILENCE_MS) lose("Connection lost: the page's server sends nothing; reconnecting");
    if (document.visibilityState !== "visible") return;
    tiles();
    health();
    caption();
    if (newest === null) return;
    const as = `${newest.result.number} ${freshness(newest.came)}`;
    const pause = freshness(newest.came) ? FRAME_MS : as === drawn.as ? Infinity : DRAW_MS;
    const changed = as.split(" ")[1] !== drawn.as.split(" ")[1];
    if (changed || performance.now() - drawn.at > pause) {
      drawn = { at: performance.now(), as };
      draw();
    }
  };

  // Adds a result of this age to the history.
  const remember = (result, age) => {
    const pair = (result.status === "ok" && (result.torsion ?? [])[0]) || {};
    const tip = reportedDeflection(result.status === "ok" ? result.tip : null);
    const [time, came] = [Date.parse(result.exposure_time) / 1000, performance.now() - age];
    // If the clock was set back or the recorder restarted, a new history begins.
    const last = history[history.length - 1];
    if (last && (time < last.time || result.number <= last.number)) history.length = 0;
    history.push({
      number: result.number,
      time, came, latency: result.latency_ms, rejected: rejected(result),
      deflection: tip.deflection, deflectionSigma: tip.sigma, words: tip.words, twist: pair.twist_deg, twistSigma: pair.sigma_twist_deg,
    });
    while (history.length > 0 && time - history[0].time > SPAN_S) history.shift();
    return { result, came, time };
  };

  const take = (result) => {
    // The age of a result counts from its exposure: arrival by this browser's clock minus the latency.
    newest = remember(result, result.latency_ms);
    const { came } = newest;
    frames.set(result.number, { came, outlines: result.outlines ?? [] });
    while (frames.size > 100) frames.delete(frames.keys().next().value);
  };

  const show = (frame, [width, height]) => {
    const svg = byId("outlines");
    svg.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    svg.replaceChildren();
    const known = frames.get(frame);
    const seen = known?.outlines ?? [];
    for (const one of seen) {
      addSvgElement(svg, "ellipse", {
        class: one.id === null ? "unnamed" : "named", cx: one.u_px, cy: one.v_px,
        rx: Math.max(one.semi_major_px, width / 250), ry: Math.max(one.semi_minor_px, width / 250),
        transform: `rotate(${one.angle_deg} ${one.u_px} ${one.v_px})`,
      });
    }
    const named = seen.filter((one) => one.id !== null).length;
    const words = known ? `${named} markers, ${seen.length - named} unidentified` : "no outlines received";
    // If it is the same frame as before, its age continues.
    const came = known?.came ?? (picture?.frame === frame ? picture.came : performance.now());
    picture = { frame, came, words };
  };

  let shown = null;
  const fetchFrame = async () => {
    if (newest === null || !link.open || document.visibilityState !== "visible") return;
    const answer = await fetch("/live/frame.jpg");
    if (!answer.ok) return;
    const frame = Number(answer.headers.get("x-wingd-frame"));
    const size = (answer.headers.get("x-wingd-size") ?? "4x3").split("x").map(Number);
    const url = URL.createObjectURL(await answer.blob());
    const image = byId("frame");
    image.src = url;
    await image.decode();
    show(frame, size);
    if (shown !== null) URL.revokeObjectURL(shown);
    shown = url;
  };

  const pictures = async () => {
    try {
      await fetchFrame();
    } catch (error) {
      // The next request follows after FRAME_MS.
    }
    setTimeout(pictures, FRAME_MS);
  };

  let source = null;
  let lastEvent = performance.now();
  let calling = null;
  const lose = (why, pause = RECONNECT_MS) => {
    source?.close();
    link = { open: false, why };
    lastEvent = performance.now();
    calling ??= setTimeout(() => { calling = null; listen(); }, pause);
    tick();
  };
  const listen = () => {
    source = new EventSource("/live/events");
    const on = (name, then) => source.addEventListener(name, (event) => {
      lastEvent = performance.now();
      then(event.data && JSON.parse(event.data));
    });
    on("message", (result) => { link = { open: true }; take(result); });
    // What came before this page was opened.
    on("past", (results) => { for (const one of results) remember(one, one.age_ms); });
    on("state", (state) => { link = { open: true }; daemon = state; });
    on("down", ({ reason }) => { link = { open: false, why: reason }; tick(); });
    on("full", ({ reason }) => lose(`${reason}; retrying every ${FULL_MS / 1000} s`, FULL_MS));
    source.addEventListener("error", () => lose("Connection lost: the page's server does not respond; reconnecting"));
  };
  document.addEventListener("visibilitychange", tick);
  listen();
  setInterval(tick, TICK_MS);
  pictures();
})();
