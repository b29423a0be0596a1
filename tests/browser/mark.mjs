#!/usr/bin/env node
// Markers are marked by clicking in a real Chromium: a frame whose ten markers are scribbled over gets them back, the program
// is killed in between, the store verifies, and the deflection is what the frame was drawn with.
//
// usage: node tests/browser/mark.mjs WINGD [FOLDER]
//        WINGD is the program; FOLDER gets pictures of each state, to be looked at.
//
// Needs Node 18, the package playwright-core (PLAYWRIGHT: the folder that holds it) and a Chromium (CHROMIUM: the program). Exit
// status 1 where something does not hold.
import { createRequire } from "node:module";
import { execFileSync, spawn } from "node:child_process";
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const require = createRequire(`${process.env.PLAYWRIGHT ?? process.cwd()}/`);
const { chromium } = require("playwright-core");
const [program, folder] = process.argv.slice(2);
if (!program) throw new Error("usage: mark.mjs WINGD [FOLDER]");
if (folder) mkdirSync(folder, { recursive: true });
const wingd = resolve(program);
const dev = join(dirname(fileURLToPath(import.meta.url)), "../../fixtures/dev");

// Drawn over, and clicked back: both kinds, near and far, the tip's pair among them.
const HIDDEN = ["M03", "M05", "M08", "M10", "M11", "M13", "M15", "M17", "M19", "M20"];
// How well the hand of this test points, px: uniform to both sides, standard deviation 1.2 px.
const HAND_PX = 2;
// Killed after so many clicks.
const KILLED_AFTER = 4;
// Standard deviations by which the deflection may miss what was drawn.
const SIGMAS = 1.3;

let faults = 0;
const check = (right, text) => {
  if (!right) faults += 1;
  console.log(`${right ? "ok   " : "FAULT"} ${text}`);
};
// The same numbers in every run (mulberry32).
let seed = 51;
const random = () => {
  seed = (seed + 0x6d2b79f5) | 0;
  let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
  t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
  return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
};
const off = () => (2 * random() - 1) * HAND_PX;

const work = mkdtempSync(join(tmpdir(), "mark-"));
const run = (...args) => execFileSync(wingd, args, { cwd: work, encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
const truth = JSON.parse(readFileSync(join(dev, "truth.json"), "utf8")).frames.find((f) => f.image === "flight-1.jpg");
const drawn = new Map(truth.markers.map((m) => [m.id, m]));

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync"],
});

// Strokes of the skin's grey over a marker: an eye sees what is behind them, a fit does not.
const scribbled = async (page, jpeg, boxes) => {
  const url = `data:image/jpeg;base64,${jpeg.toString("base64")}`;
  const png = await page.evaluate(async ([from, all]) => {
    const image = new Image();
    image.src = from;
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width: image.naturalWidth, height: image.naturalHeight });
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0);
    for (const { u, v, width, height } of all) {
      const grey = pen.getImageData(Math.round(u - width * 0.7), Math.round(v), 1, 1).data[0];
      const step = Math.max(height / 6, 3);
      pen.lineWidth = step * 0.55;
      for (const [shade, shift] of [[grey, 0], [grey * 0.45, step / 2]]) {
        pen.strokeStyle = `rgb(${shade}, ${shade}, ${shade})`;
        for (let x = -width; x < width; x += step * 2.2) {
          pen.beginPath();
          pen.moveTo(u + x + shift, v - height * 0.75);
          pen.lineTo(u + x + shift + height * 0.9, v + height * 0.75);
          pen.stroke();
        }
      }
    }
    return canvas.toDataURL("image/png").split(",")[1];
  }, [url, boxes]);
  return Buffer.from(png, "base64");
};

const serve = (...args) => new Promise((done, fail) => {
  const child = spawn(wingd, ["mark", ...args, "--listen", "127.0.0.1:0", "--who", "ada"], { cwd: work, stdio: ["ignore", "ignore", "pipe"] });
  let said = "";
  child.stderr.on("data", (bytes) => {
    said += bytes;
    // A line comes in pieces: what has no end yet is not the whole of it.
    const url = said.match(/(http:\/\/\S+)\s/)?.[1];
    if (url) done({ child, url });
  });
  child.on("exit", () => fail(new Error(said)));
});
const ended = (child, signal) => new Promise((done) => {
  child.removeAllListeners("exit");
  child.on("exit", (code) => done(code));
  child.kill(signal);
});

const opened = async (page, url) => {
  await page.goto(url);
  const ready = page.waitForSelector("#photo[data-ready='0']", { timeout: 60000 });
  await ready.catch(async () => {
    throw new Error(`the page is not ready: ${await page.textContent("#said")}`);
  });
};
// Where a place of the picture is on the screen.
const on = (page, u, v) => page.evaluate(([u, v]) => {
  const photo = document.getElementById("photo");
  const box = photo.getBoundingClientRect();
  const { u: left, v: top, scale } = photo.dataset;
  return [box.left + (u - left) * scale, box.top + (v - top) * scale];
}, [u, v]);
const marked = (page) => page.evaluate(() => Number(document.getElementById("photo").dataset.marks ?? 0));
const row = (page, id) => page.locator("#markers tbody tr", { has: page.locator(`button:text-is("${id}")`) });

// Chooses a lost marker in the table, which brings it near, and clicks its centre as well as a hand does.
const clicked = async (page, id) => {
  const before = await marked(page);
  const { u, v } = drawn.get(id);
  await row(page, id).locator("button").click();
  const [x, y] = await on(page, u + off(), v + off());
  await page.mouse.click(x, y);
  await page.waitForFunction((n) => Number(document.getElementById("photo").dataset.marks) === n, before + 1, { timeout: 20000 })
    .catch(async () => {
      await picture(page, `stuck-${id}`);
      throw new Error(`${id} is not marked: ${await page.textContent("#said")}`);
    });
};
const deflection = async (page) => (await page.textContent("#deflection")).trim();
const picture = async (page, name) => folder && page.screenshot({ path: join(folder, `mark-${name}.png`), fullPage: true });
const tip = () => {
  const lines = run("solve", "store", "--json", "--sigma", "prior").trim().split("\n").filter(Boolean);
  return lines.length ? JSON.parse(lines[0]) : null;
};

try {
  cpSync(join(dev, "installation"), join(work, "installation"), { recursive: true });
  cpSync(join(dev, "frames/ground.jpg"), join(work, "ground.jpg"));
  run("orient", "ground.jpg");
  const page = await browser.newPage({ viewport: { width: 1400, height: 900 } });
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  const boxes = HIDDEN.map((id) => drawn.get(id));
  writeFileSync(join(work, "spoiled.png"), await scribbled(page, readFileSync(join(dev, "frames/flight-1.jpg")), boxes));
  run("import", "spoiled.png", "--store", "store", "--installation", "installation");
  const bare = tip();
  const lost = bare.markers.filter((m) => !m.used).map((m) => m.id);
  check(HIDDEN.every((id) => lost.includes(id)), `without marks ${lost.length} markers are lost: ${lost.join(" ")}`);

  let { child, url } = await serve("store");
  await opened(page, url);
  await picture(page, "bare");
  for (const id of HIDDEN.slice(0, KILLED_AFTER)) await clicked(page, id);
  await ended(child, "SIGKILL");
  check(run("verify", "store").length >= 0, "after the kill the store verifies");
  ({ child, url } = await serve("store"));
  await opened(page, url);
  check(/open the address/.test(await page.evaluate(() => fetch("/pictures.json").then((a) => a.text()))), "without its token an address says so, and no password is asked for");
  check(await marked(page) === KILLED_AFTER, `killed after ${KILLED_AFTER} clicks, ${await marked(page)} marks are there`);
  for (const id of HIDDEN.slice(KILLED_AFTER)) await clicked(page, id);
  await page.keyboard.press("0");
  await picture(page, "marked");
  const shown = await deflection(page);

  // What is detected is not replaced unasked.
  await row(page, "M07").locator("button").click();
  const at = drawn.get("M07");
  const [x, y] = await on(page, at.u, at.v);
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 30, y + 20, { steps: 4 });
  await page.mouse.up();
  await page.waitForSelector("#ask:not([hidden])", { timeout: 20000 });
  await picture(page, "asked");
  await page.click("#no");
  check(await marked(page) === HIDDEN.length, "a detected marker that is dragged stays, unless the hand says yes");

  // Reject needs a reason, and is taken back.
  await page.locator("#photo").focus();
  await page.keyboard.press("r");
  await page.waitForFunction(() => /give a reason/.test(document.getElementById("said").textContent), null, { timeout: 20000 });
  await page.fill("#why", "an oil streak over its edge");
  await page.keyboard.press("Enter");
  await page.keyboard.press("r");
  await page.waitForFunction((n) => Number(document.getElementById("photo").dataset.marks) === n, HIDDEN.length + 1, { timeout: 20000 });
  check((await row(page, "M07").getAttribute("class")).includes("rejected"), "R rejects, with a reason");
  await page.keyboard.press("u");
  await page.waitForFunction((n) => Number(document.getElementById("photo").dataset.marks) === n, HIDDEN.length, { timeout: 20000 });
  check((await row(page, "M07").getAttribute("class")).includes("detected"), "U takes it back");

  // A mark is nudged with the arrows, and dragged back.
  await row(page, "M05").locator("button").click();
  await page.locator("#photo").focus();
  const said = page.locator("#said");
  const m05 = () => page.evaluate(() => fetch(`/picture/0.json${location.search}`).then((a) => a.json())
    .then((s) => s.markers.find((m) => m.id === "M05")));
  const before = (await m05()).u_px;
  await page.keyboard.press("ArrowRight");
  await page.waitForFunction((u) => fetch(`/picture/0.json${location.search}`).then((a) => a.json()).then((s) => s.markers.find((m) => m.id === "M05").u_px === u), before + 0.5, { timeout: 20000 });
  check(/M05/.test(await said.textContent()), "an arrow moves a mark by half a pixel");
  const goal = drawn.get("M05");
  await page.keyboard.press("Escape");
  await row(page, "M05").locator("button").click();
  const from = await m05();
  const [fx, fy] = await on(page, from.u_px, from.v_px);
  const [tx, ty] = await on(page, goal.u, goal.v);
  await page.mouse.move(fx, fy);
  await page.mouse.down();
  await page.mouse.move(fx + 12, fy + 9, { steps: 3 });
  await page.mouse.move(tx, ty, { steps: 3 });
  await page.mouse.up();
  await page.waitForFunction((u) => fetch(`/picture/0.json${location.search}`).then((a) => a.json()).then((s) => s.markers.find((m) => m.id === "M05").u_px !== u), from.u_px, { timeout: 20000 });
  check(await marked(page) === HIDDEN.length, "dragged, the mark is still one");

  for (const [scheme, width] of [["dark", 1400], ["light", 390], ["dark", 390]]) {
    await page.emulateMedia({ colorScheme: scheme });
    await page.setViewportSize({ width, height: 844 });
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    check(wide <= 0, `${scheme}, ${width} px: nothing reaches beyond the page`);
    await page.locator("#markers").scrollIntoViewIfNeeded();
    const top = await page.locator("#photo").evaluate((photo) => photo.getBoundingClientRect());
    check(width > 860 || (top.top >= 0 && top.bottom < 844), `${scheme}, ${width} px: the image stays in view beside its controls`);
    await page.evaluate(() => scrollTo(0, 0));
    await picture(page, `${scheme}-${width}`);
  }
  check(complaints.filter((c) => !/401|409|422|ERR_CONNECTION/.test(c)).length === 0, `the console is silent ${complaints.join("; ")}`);
  check(await ended(child, "SIGTERM") === 0, "it ends when it is told to");
  run("verify", "store");

  const now = tip();
  const by = now.markers.filter((m) => m.manual);
  check(by.length === HIDDEN.length, `solve uses ${by.length} marks by hand`);
  const wanted = drawn.get(now.tip.marker).deflection_m;
  const missed = (now.tip.deflection_m - wanted) / now.tip.sigma_deflection_m;
  const was = (bare.tip.deflection_m - drawn.get(bare.tip.marker).deflection_m) / bare.tip.sigma_deflection_m;
  console.log(`     without: ${bare.tip.marker} ${bare.tip.deflection_m.toFixed(4)} m ± ${(1e3 * bare.tip.sigma_deflection_m).toFixed(1)} mm, ${was.toFixed(2)} sigma; page: ${shown}`);
  for (const m of by) {
    const d = drawn.get(m.id);
    const normal = Math.hypot((m.u_px - d.u) / m.sigma_u_px, (m.v_px - d.v) / m.sigma_v_px) / Math.SQRT2;
    console.log(`     ${m.id} ${m.shape}: ${(m.u_px - d.u).toFixed(2)} ${(m.v_px - d.v).toFixed(2)} px off, sigma ${m.sigma_u_px.toFixed(2)} ${m.sigma_v_px.toFixed(2)} px, normalised ${normal.toFixed(2)}${m.used ? "" : ", not used: " + m.reason}`);
  }
  check(Math.abs(missed) < SIGMAS, `${now.tip.marker} ${now.tip.deflection_m.toFixed(4)} m ± ${(1e3 * now.tip.sigma_deflection_m).toFixed(1)} mm, drawn ${wanted.toFixed(4)} m: ${missed.toFixed(2)} sigma`);
  const again = execFileSync(wingd, ["solve", "store", "--json", "--sigma", "prior", "--no-marks"], { cwd: work, encoding: "utf8", stdio: ["ignore", "pipe", "ignore"] });
  check(again.trim() === "", "without marks the frame has its result already");
} finally {
  await browser.close();
  rmSync(work, { recursive: true, force: true });
}
console.log(faults ? `${faults} faults` : "all holds");
process.exit(faults ? 1 : 0);
