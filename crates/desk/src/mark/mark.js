// Marking page: an image with zoom and pan, its markers, and the requests that add manual marks.
// Pixel coordinates are those of results: (0, 0) is the centre of the first pixel.
"use strict";

const $ = (id) => document.getElementById(id);
const photo = $("photo");
const pen = photo.getContext("2d");
const lens = $("loupe").getContext("2d", { willReadFrequently: true });

const COLOURS = { detected: "#3dea6d", manual: "#57c8ff", lost: "#ffb000", rejected: "#ff5f6d" };
// Maximum distance of a click from a marker that it selects, screen px.
const MAX_CLICK_PX = 16;
// Maximum distance of a click from the outline of a lost marker that it marks, screen px.
const MAX_LOST_PX = 60;
// A press that moves less is a click, screen px.
const DRAG_PX = 4;
const FACTORS = [1, 10, 50, 200];
// Magnification of the loupe, screen px per image px.
const LOUPE_SCALE = 10;

// u, v: image position at the upper left corner; scale: screen px per image px.
const view = { u: -0.5, v: -0.5, scale: 1 };
let pictures = [];
let number = 0;
let state = null;
let image = null;
let chosen = null;
let factor = 2;
let question = null;
let press = null;
let pointer = null;
let busy = false;
const fingers = new Map();

const marker = (id) => state?.markers.find((m) => m.id === id);
const known = (m) => m.u_px !== null;
const place = (m) => (known(m) ? [m.u_px, m.v_px] : m.predicted ? [m.predicted.u_px, m.predicted.v_px] : null);
const toScreen = ([u, v]) => [(u - view.u) * view.scale, (v - view.v) * view.scale];
const toPicture = ([x, y]) => [view.u + x / view.scale, view.v + y / view.scale];
const at = (event) => {
  const box = photo.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
};
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

function say(text, bad = false) {
  $("said").textContent = text;
  $("said").classList.toggle("bad", bad);
}

// ---- drawing ----

function resize() {
  const ratio = window.devicePixelRatio || 1;
  photo.width = Math.round(photo.clientWidth * ratio);
  photo.height = Math.round(photo.clientHeight * ratio);
  draw();
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, photo.clientWidth, photo.clientHeight);
  Object.assign(photo.dataset, { u: view.u, v: view.v, scale: view.scale, chosen: chosen ?? "" });
  if (image) {
    pen.imageSmoothingEnabled = view.scale < 2;
    const [x, y] = toScreen([-0.5, -0.5]);
    pen.drawImage(image, x, y, image.width * view.scale, image.height * view.scale);
  }
  for (const m of state?.markers ?? []) drawMarker(m);
  drawLoupe();
}

function ellipse([x, y], major, minor, angle) {
  pen.beginPath();
  pen.ellipse(x, y, Math.max(major, 0.5), Math.max(minor, 0.5), angle, 0, 2 * Math.PI);
  pen.stroke();
}

function drawMarker(m) {
  const centre = place(m);
  if (!centre) return;
  const [x, y] = toScreen(centre);
  pen.strokeStyle = COLOURS[m.state];
  pen.fillStyle = COLOURS[m.state];
  pen.lineWidth = m.id === chosen ? 3 : 1.5;
  pen.setLineDash([]);
  if (known(m)) {
    cross(x, y, m.id === chosen ? 9 : 5);
    sigma(m, [x, y]);
    residual(m, [x, y]);
  } else if (m.predicted) {
    const o = m.predicted.outline;
    pen.setLineDash([5, 4]);
    ellipse(toScreen([o.u_px, o.v_px]), o.semi_major_px * view.scale + 4, o.semi_minor_px * view.scale + 4, o.angle_rad);
    pen.setLineDash([]);
  }
  if (m.state === "rejected") {
    pen.beginPath();
    pen.moveTo(x - 7, y - 7);
    pen.lineTo(x + 7, y + 7);
    pen.moveTo(x - 7, y + 7);
    pen.lineTo(x + 7, y - 7);
    pen.stroke();
  }
  pen.font = `${m.id === chosen ? "bold 15" : "13"}px system-ui, sans-serif`;
  pen.lineWidth = 3;
  pen.strokeStyle = "#11151a";
  pen.strokeText(m.id, x + 9, y - 9);
  pen.fillText(m.id, x + 9, y - 9);
}

function cross(x, y, size) {
  pen.beginPath();
  pen.moveTo(x - size, y);
  pen.lineTo(x + size, y);
  pen.moveTo(x, y - size);
  pen.lineTo(x, y + size);
  pen.stroke();
}

// Draws the ellipse of one standard deviation, magnified.
function sigma(m, centre) {
  const [[a, b], [, c]] = m.covariance_px2;
  const mean = (a + c) / 2;
  const off = Math.hypot((a - c) / 2, b);
  const enlarged = (variance) => Math.sqrt(Math.max(variance, 0)) * FACTORS[factor] * view.scale;
  ellipse(centre, enlarged(mean + off), enlarged(mean - off), Math.atan2(2 * b, a - c) / 2);
}

// Draws the residual from the observed to the adjusted position, magnified.
function residual(m, [x, y]) {
  if (m.residual_u_px === null) return;
  const long = FACTORS[factor] * view.scale;
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(x + m.residual_u_px * long, y + m.residual_v_px * long);
  pen.stroke();
}

// Draws the image around the pointer, its grey levels stretched from black to white.
function drawLoupe() {
  const canvas = $("loupe");
  canvas.hidden = !pointer || !image;
  if (canvas.hidden) return;
  canvas.classList.toggle("left", pointer[0] > photo.clientWidth / 2 && pointer[1] < 230);
  const side = canvas.width;
  const wide = side / LOUPE_SCALE;
  const [u, v] = toPicture(pointer);
  lens.imageSmoothingEnabled = false;
  lens.fillStyle = "#11151a";
  lens.fillRect(0, 0, side, side);
  lens.drawImage(image, u + 0.5 - wide / 2, v + 0.5 - wide / 2, wide, wide, 0, 0, side, side);
  const pixels = lens.getImageData(0, 0, side, side);
  let [low, high] = [255, 0];
  for (let i = 0; i < pixels.data.length; i += 4) {
    low = Math.min(low, pixels.data[i]);
    high = Math.max(high, pixels.data[i]);
  }
  const spread = 255 / Math.max(high - low, 1);
  for (let i = 0; i < pixels.data.length; i += 4) {
    const grey = (pixels.data[i] - low) * spread;
    pixels.data[i] = pixels.data[i + 1] = pixels.data[i + 2] = grey;
  }
  lens.putImageData(pixels, 0, 0);
  lens.strokeStyle = COLOURS.lost;
  lens.beginPath();
  lens.moveTo(side / 2, 0);
  lens.lineTo(side / 2, side);
  lens.moveTo(0, side / 2);
  lens.lineTo(side, side / 2);
  lens.stroke();
}

// ---- the view ----

function showAll() {
  if (!state) return;
  view.scale = Math.min(photo.clientWidth / state.width, photo.clientHeight / state.height);
  view.u = state.width / 2 - 0.5 - photo.clientWidth / view.scale / 2;
  view.v = state.height / 2 - 0.5 - photo.clientHeight / view.scale / 2;
  draw();
}

function zoom(ratio, about = [photo.clientWidth / 2, photo.clientHeight / 2]) {
  const [u, v] = toPicture(about);
  view.scale = Math.min(Math.max(view.scale * ratio, 0.02), 64);
  view.u = u - about[0] / view.scale;
  view.v = v - about[1] / view.scale;
  draw();
}

function centreOn(id) {
  const m = marker(id);
  const centre = m && place(m);
  if (!centre) return;
  const half = m.predicted?.outline.semi_major_px ?? 20;
  view.scale = Math.min(Math.max(70 / half, 0.5), 16);
  view.u = centre[0] - photo.clientWidth / view.scale / 2;
  view.v = centre[1] - photo.clientHeight / view.scale / 2;
}

function choose(id, centred = false) {
  chosen = id;
  if (id && centred) {
    centreOn(id);
    photo.scrollIntoView({ block: "nearest" });
  }
  const m = id && marker(id);
  if (m) say(words(m));
  table();
  draw();
}

function words(m) {
  const who = m.mark ? `, ${m.mark.who}${m.mark.why ? `: ${m.mark.why}` : ""}` : "";
  if (m.state === "lost") return `${m.id} is lost: ${m.reason ?? "not measured"}. Click its centre to mark it.`;
  if (m.state === "manual") return `${m.id} ${m.mark.source === "manual" ? "is marked manually" : "is marked manually and measured by the detector"}${who}`;
  if (m.state === "rejected") return `${m.id} is rejected${who}`;
  return `${m.id} is detected${m.used ? "" : `, not used: ${m.reason}`}. Drag it to mark it manually.`;
}

function nextLost(step) {
  const lost = state.markers.filter((m) => !known(m) && m.state !== "rejected" && place(m));
  if (lost.length === 0) return say("No marker expected in the image is lost.");
  const here = lost.findIndex((m) => m.id === chosen);
  const next = here < 0 ? (step > 0 ? 0 : lost.length - 1) : (here + step + lost.length) % lost.length;
  choose(lost[next].id, true);
}

// ---- tables ----

const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));

function showDeflection(result, value, note) {
  const there = result.deflection_m !== null && result.deflection_m !== undefined;
  $(value).textContent = there ? `${fixed(result.deflection_m, 4)} m` : result.status === "ok" ? "–" : "no result";
  const sigma = result.sigma_deflection_m;
  const change = value === "deflection" && state.change_m !== null ? ` (${signed(1e3 * state.change_m)} mm due to the marks)` : "";
  $(note).textContent = there ? `± ${fixed(1e3 * sigma, 1)} mm, ${result.used} markers${change}` : (result.reason ?? result.remarks[0] ?? "");
}

const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(1)}`;

function table() {
  showDeflection(state.now, "deflection", "deflection-beside");
  showDeflection(state.bare, "bare", "bare-beside");
  $("bare-name").textContent = state.bare.tip ? `Without marks, ${state.bare.tip}` : "Without marks";
  $("deflection-name").textContent = state.now.tip ? `Deflection of ${state.now.tip}, ${state.now.reference}` : "Result";
  const factor = state.now.variance_factor;
  $("test").textContent = factor === null ? "" : `variance factor ${fixed(factor, 2)}${state.now.global_test ? `, global test ${state.now.global_test}` : ""}`;
  const rows = state.markers.map((m) => {
    const row = document.createElement("tr");
    row.className = `${m.state}${m.id === chosen ? " chosen" : ""}`;
    const button = document.createElement("button");
    button.textContent = m.id;
    button.addEventListener("click", () => choose(m.id, true));
    const c = m.covariance_px2;
    const sigma = c ? Math.sqrt(Math.max(c[0][0], c[1][1])) : null;
    const residual = m.residual_u_px === null ? null : Math.hypot(m.residual_u_px, m.residual_v_px);
    const seen = m.state + (m.state === "lost" && !place(m) ? ", outside" : known(m) && !m.used ? ", not used" : "");
    const texts = [button, seen, fixed(sigma, 2), fixed(residual, 2)];
    texts.forEach((text, k) => {
      const cell = row.insertCell();
      cell.className = k > 1 ? "n" : "";
      cell.append(text);
    });
    row.title = m.reason ?? m.mark?.why ?? "";
    return row;
  });
  $("markers").tBodies[0].replaceChildren(...rows);
  const m = chosen && marker(chosen);
  $("reject").disabled = !m || m.state === "rejected";
  $("withdraw").disabled = !m?.mark;
  $("rename").disabled = !m || !known(m);
}

// ---- requests ----

// The page's address has the token, if the server made one.
const request = (path, options) => fetch(path + location.search, options);

async function fetchJson(path, options) {
  const answer = await request(path, options);
  if (answer.status === 401) throw new Error(await answer.text());
  const body = await answer.json();
  if (answer.status === 409) return { asks: body.reason };
  if (!answer.ok) throw new Error(body.reason ?? answer.statusText);
  return body;
}

async function post(request) {
  if (busy) return;
  busy = true;
  const who = $("who").value.trim();
  const before = state.now;
  try {
    const body = JSON.stringify({ who, why: $("why").value.trim(), ...request });
    const got = await fetchJson(`/picture/${number}`, { method: "POST", headers: { "content-type": "application/json" }, body });
    if (got.asks) {
      question = { ...request, over: true };
      $("question").textContent = got.asks;
      $("ask").hidden = false;
      $("yes").focus();
      return;
    }
    state = got;
    pictures[number].marks = state.marks;
    chosen = request.to ?? request.id;
    const m = marker(chosen);
    const same = before.tip && before.tip === state.now.tip && before.reference === state.now.reference;
    const change = same ? ` Deflection of ${before.tip} ${signed(1e3 * (state.now.deflection_m - before.deflection_m))} mm.` : "";
    // The reason belongs to one mark.
    $("why").value = "";
    say(`${words(m)}.${change}`.replace("..", "."));
    photo.dataset.marks = state.marks;
    list();
    table();
  } catch (error) {
    say(`Not stored: ${error.message}`, true);
    if (/^give a reason/.test(error.message)) $("why").focus();
    if (/^give your name/.test(error.message)) $("who").focus();
  } finally {
    busy = false;
    draw();
  }
}

function mark(id, [u, v], exact) {
  return post({ act: "place", id, u_px: u, v_px: v, exact });
}

function nudge(du, dv) {
  const m = chosen && marker(chosen);
  if (m?.state === "manual") mark(m.id, [m.u_px + du, m.v_px + dv], true);
  else say("Arrows move a manual mark: select one first.");
}

function rename() {
  const select = $("to");
  if (!chosen || !known(marker(chosen))) return;
  const empty = new Option("new id …", "");
  select.replaceChildren(empty, ...state.markers.filter((m) => m.id !== chosen).map((m) => new Option(m.id, m.id)));
  select.hidden = false;
  select.focus();
}

function answer(yes) {
  const meant = question;
  question = null;
  $("ask").hidden = true;
  photo.focus();
  if (yes && meant) post(meant);
  else draw();
}

// ---- pictures ----

function list() {
  const line = (p, k) => new Option(`${p.name}${p.marks ? ` (${p.marks})` : ""}`, k);
  $("picture").replaceChildren(...pictures.map(line));
  $("picture").value = number;
}

async function open(next) {
  if (next < 0 || next >= pictures.length) return;
  number = next;
  [state, image, chosen] = [null, null, null];
  list();
  say(`Reading ${pictures[number].name} …`);
  draw();
  try {
    const mine = number;
    const got = await fetchJson(`/picture/${mine}.json`);
    const png = await request(`/picture/${mine}.png`);
    const bitmap = await createImageBitmap(await png.blob());
    if (mine !== number) return;
    [state, image] = [got, bitmap];
    photo.dataset.marks = state.marks;
    table();
    showAll();
    const lost = state.markers.filter((m) => m.state === "lost" && place(m)).length;
    say(state.now.status === "ok" ? `${lost} markers expected in the image are lost.` : state.now.reason ?? "");
    photo.dataset.ready = mine;
  } catch (error) {
    say(error.message, true);
  }
}

// ---- mouse, touch and keyboard ----

function nearest(point, matches, limit) {
  const near = (state?.markers ?? []).filter((m) => place(m) && matches(m)).map((m) => [apart(toScreen(place(m)), point), m]);
  near.sort((a, b) => a[0] - b[0]);
  return near.length && near[0][0] <= limit ? near[0][1] : null;
}

function click(point, shift) {
  if (!state || question) return;
  const own = chosen && marker(chosen);
  if (own && !known(own)) return mark(chosen, toPicture(point), shift);
  const there = nearest(point, known, MAX_CLICK_PX);
  if (there) return choose(there.id);
  const half = (m) => (m.predicted?.outline.semi_major_px ?? 0) * view.scale;
  const lost = nearest(point, (m) => !known(m) && m.state === "lost" && apart(toScreen(place(m)), point) < MAX_LOST_PX + half(m), Infinity);
  if (lost) return mark(lost.id, toPicture(point), shift);
  choose(null);
}

photo.addEventListener("pointerdown", (event) => {
  photo.setPointerCapture(event.pointerId);
  const point = at(event);
  fingers.set(event.pointerId, point);
  const own = chosen && marker(chosen);
  const held = own && known(own) && apart(toScreen(place(own)), point) < MAX_CLICK_PX ? own.id : null;
  press = { from: point, last: point, held, moved: false, many: fingers.size > 1 };
});

photo.addEventListener("pointermove", (event) => {
  const point = at(event);
  pointer = event.pointerType === "touch" ? null : point;
  if (fingers.has(event.pointerId)) drag(event.pointerId, point);
  draw();
  if (press?.held && press.moved) {
    pen.strokeStyle = COLOURS.manual;
    pen.lineWidth = 2;
    cross(point[0], point[1], 12);
  }
});

function drag(id, point) {
  const others = [...fingers].filter(([other]) => other !== id);
  const before = fingers.get(id);
  fingers.set(id, point);
  if (others.length) {
    const other = others[0][1];
    zoom(apart(point, other) / Math.max(apart(before, other), 1), other);
    return;
  }
  if (!press) return;
  press.moved ||= apart(point, press.from) > DRAG_PX;
  if (press.moved && !press.held && !press.many) {
    view.u -= (point[0] - press.last[0]) / view.scale;
    view.v -= (point[1] - press.last[1]) / view.scale;
  }
  press.last = point;
}

photo.addEventListener("pointerup", (event) => {
  fingers.delete(event.pointerId);
  if (!press || fingers.size) return;
  const { held, moved, many } = press;
  press = null;
  const point = at(event);
  if (many) return;
  if (!moved) click(point, event.shiftKey);
  else if (held) mark(held, toPicture(point), event.shiftKey);
});
photo.addEventListener("pointercancel", (event) => {
  fingers.delete(event.pointerId);
  press = null;
});
photo.addEventListener("pointerleave", () => {
  pointer = null;
  draw();
});
photo.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(-event.deltaY / 400), at(event));
}, { passive: false });

function enlarge() {
  factor = (factor + 1) % FACTORS.length;
  $("factor").textContent = `× ${FACTORS[factor]}`;
  draw();
}

const reject = () => chosen && post({ act: "reject", id: chosen });
const withdraw = () => chosen && marker(chosen)?.mark && post({ act: "withdraw", id: chosen });
const escape = () => (question ? answer(false) : choose(null));
const KEYS = {
  n: () => nextLost(1), p: () => nextLost(-1), r: reject, u: withdraw, e: rename, x: enlarge,
  "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: showAll,
  "[": () => open(number - 1), "]": () => open(number + 1), escape,
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

document.addEventListener("keydown", (event) => {
  const typing = ["INPUT", "SELECT"].includes(event.target.tagName);
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (typing) {
    if (["Escape", "Enter"].includes(event.key)) photo.focus();
    return;
  }
  if (!state) return;
  const arrow = ARROWS[event.key];
  const act = KEYS[event.key.toLowerCase()];
  if (arrow && event.target === photo) {
    event.preventDefault();
    const step = event.shiftKey ? 5 : 0.5;
    nudge(step * arrow[0], step * arrow[1]);
  } else if (act) {
    event.preventDefault();
    act();
  }
});

$("picture").addEventListener("change", (event) => open(Number(event.target.value)));
$("before").addEventListener("click", () => open(number - 1));
$("after").addEventListener("click", () => open(number + 1));
$("next").addEventListener("click", () => state && nextLost(1));
$("reject").addEventListener("click", reject);
$("withdraw").addEventListener("click", withdraw);
$("rename").addEventListener("click", rename);
$("to").addEventListener("change", (event) => {
  const to = event.target.value;
  event.target.hidden = true;
  photo.focus();
  if (to && chosen) post({ act: "rename", id: chosen, to });
});
$("out").addEventListener("click", () => zoom(1 / 1.5));
$("in").addEventListener("click", () => zoom(1.5));
$("whole").addEventListener("click", showAll);
$("factor").addEventListener("click", enlarge);
$("yes").addEventListener("click", () => answer(true));
$("no").addEventListener("click", () => answer(false));
new ResizeObserver(resize).observe(photo);

fetchJson("/pictures.json").then((got) => {
  pictures = got.pictures;
  return open(0);
}).catch((error) => say(error.message, true));
