#!/usr/bin/env node
"use strict";
// The live page in a real Chromium, on a desk and on a phone, before a real recorder: stopped, killed, hanging, its pictures
// gone, black frames, the global test rejecting, slow, forty browsers.
//
//   make test-browser, or: tests/live/page.js target/release/wingd [SCREENSHOTS]
//
// Needs Node 18, the package playwright-core (PLAYWRIGHT: the folder that holds it) and a Chromium (CHROMIUM: the program).
//
// Exit status 1 where a number older than three intervals is shown as if it were new, or a page does not come back by itself.

const { spawn, execFileSync } = require("node:child_process");
const fs = require("node:fs");
const { createRequire } = require("node:module");
const os = require("node:os");
const path = require("node:path");
const { chromium } = createRequire(`${process.env.PLAYWRIGHT ?? process.cwd()}/`)("playwright-core");

const ROOT = path.resolve(__dirname, "../..");
const WINGD = path.resolve(process.argv[2] ?? "target/release/wingd");
const SHOTS = process.argv[3] && path.resolve(process.argv[3]);
const PORT = 18097;
// Slow enough for a machine that draws the page, too.
const RATE_HZ = 2;
const BROWSERS = 40;
const CHROMIUM = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync"];
const sleep = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });
const dir = fs.mkdtempSync(path.join(os.tmpdir(), "wingd-page-"));
const at = (...names) => path.join(dir, ...names);
const children = new Set();
let failures = 0;

const check = (yes, words, seen) => {
  failures += yes ? 0 : 1;
  console.log(`${yes ? "ok    " : "FAILED"}  ${words}${yes ? "" : `: ${JSON.stringify(seen)}`}`);
};

const run = (args, log) => {
  const child = spawn(WINGD, args, { cwd: dir, stdio: ["ignore", "ignore", fs.openSync(at(log), "a")] });
  children.add(child);
  child.on("exit", () => children.delete(child));
  return child;
};
const end = (child, signal) => new Promise((resolve) => { child.on("exit", resolve); child.kill(signal); });

// With the ground frame's orientation.
const installation = () => {
  fs.mkdirSync(at("installation"));
  for (const file of ["installation.toml", "camera.toml", "survey.csv"]) {
    fs.copyFileSync(path.join(ROOT, "fixtures/dev/installation", file), at("installation", file));
  }
  const ground = path.join(ROOT, "fixtures/dev/frames/ground.jpg");
  execFileSync(WINGD, ["orient", "--installation", at("installation"), ground], { stdio: "ignore" });
};

const configure = (rateHz) => fs.writeFileSync(at("wingd.toml"), `installation = "installation"
[camera]
kind = "replay"
folder = "frames"
[store]
path = "store"
reserve_mb = 0
[status]
socket = "wingd.sock"
[series]
interval = "10h"
shots = 1
stale_window = 0
[live]
rate_hz = ${rateHz}
series = false
[live.keep]
ring_mb = 0
[serve]
listen = "127.0.0.1:${PORT}"
`);

const pictures = () => {
  for (let k = 1; k <= 5; k++) {
    fs.copyFileSync(path.join(ROOT, `fixtures/dev/frames/flight-${k}.jpg`), at("next.jpg"));
    fs.renameSync(at("next.jpg"), at("frames", `${k}.jpg`));
  }
};
// Five pictures made in the browser, by a function of a canvas' context, the picture's number and a bundled frame.
const drawn = async (page, draw) => {
  const frame = fs.readFileSync(path.join(ROOT, "fixtures/dev/frames/flight-1.jpg")).toString("base64");
  for (let k = 1; k <= 5; k++) {
    const base64 = await page.evaluate(async ([text, number, jpeg]) => {
      const image = new Image();
      image.src = `data:image/jpeg;base64,${jpeg}`;
      await image.decode();
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [image.width, image.height];
      new Function("context", "number", "image", text)(canvas.getContext("2d"), number, image);
      return canvas.toDataURL("image/jpeg", 0.95).split(",")[1];
    }, [draw, k, frame]);
    fs.writeFileSync(at("next.jpg"), Buffer.from(base64, "base64"));
    fs.renameSync(at("next.jpg"), at("frames", `${k}.jpg`));
  }
};
// Nothing in them, each another.
const BLACK = "context.fillStyle = `rgb(${number},${number},${number})`; context.fillRect(0, 0, image.width, image.height);";
// Stripes of the wing are shifted up or down by some pixels, which no wing does.
const SHIFTED = `context.drawImage(image, 0, 0);
for (let x = 0, k = number; x < image.width; x += 120, k++) {
  context.drawImage(image, x, 0, 120, image.height, x, [3, -3, 0][(k * 7) % 3], 120, image.height);
}`;

const recorder = () => run(["run", "--config", at("wingd.toml")], "recorder.log");
const status = () => {
  try {
    return { exit: 0, ...JSON.parse(execFileSync(WINGD, ["status", "--json", "--socket", at("wingd.sock")], { stdio: ["ignore", "pipe", "ignore"] })) };
  } catch (error) {
    return { exit: error.status, ...(error.stdout?.length ? JSON.parse(error.stdout) : {}) };
  }
};

// What a person sees.
const look = (page) => page.evaluate(() => {
  const tile = (id) => {
    const node = document.getElementById(id);
    return { id, shown: node.textContent, beside: document.getElementById(`${id}-beside`).textContent, style: node.parentElement.className };
  };
  const drawn = (id, what) => document.querySelectorAll(`#${id} ${what}`).length;
  return {
    word: document.getElementById("word").textContent, reasons: document.getElementById("reasons").textContent,
    banner: document.getElementById("health").className,
    tiles: ["age", "deflection", "twist", "rate", "latency", "skipped", "test"].map(tile),
    curves: ["curve", "deflections", "twists"].map((id) => ({
      id, style: document.getElementById(id).className.replace("graph", "").trim(),
      lines: drawn(id, "g:not(.hole) > .curve[d*=M]"), doubt: drawn(id, ".doubt .curve[d*=M]"),
      note: document.querySelector(`#${id} .note`)?.textContent ?? "",
    })),
    caption: document.getElementById("frame-caption").textContent,
    picture: document.getElementById("frame").parentElement.className,
    tooWide: document.documentElement.scrollWidth - innerWidth,
  };
});

// Numbers in plain style.
const plain = ({ tiles, curves }) => [
  ...tiles.filter(({ shown, style }) => /\d/.test(shown) && !["old", "lost"].includes(style)).map(({ id }) => id),
  ...curves.filter(({ lines, style }) => lines > 0 && !["old", "lost"].includes(style)).map(({ id }) => id),
];

const until = async (page, wanted, words, withinS) => {
  const begun = Date.now();
  let seen = null;
  while (Date.now() - begun < 1000 * withinS) {
    seen = await look(page);
    if (wanted(seen)) {
      check(true, `${words} (${((Date.now() - begun) / 1000).toFixed(1)} s)`);
      return seen;
    }
    await sleep(50);
  }
  check(false, words, seen);
  return seen;
};
// On a machine with other work frames may be skipped, which is said.
const fine = ({ word, reasons }) => word === "ok" || reasons.split("\n").every((why) => why.includes("too slow"));
const well = (seen) => fine(seen) && seen.tiles.every(({ style }) => style === "") && seen.curves.every(({ lines }) => lines > 0);

const picture = async (pages, name) => {
  if (!SHOTS) return;
  for (const { page, width } of pages) await page.screenshot({ path: path.join(SHOTS, `${name}-${width}.png`), fullPage: true });
};

// From a moment on nothing comes, and what came is old after three intervals: then nothing may be shown as new.
const old = async (pages, name, forS = 4) => {
  await sleep(3000 / RATE_HZ + 300);
  const begun = Date.now();
  while (Date.now() - begun < 1000 * forS) {
    for (const { page, width } of pages) {
      const seen = await look(page);
      const left = plain(seen);
      if (left.length > 0 || seen.word === "ok") {
        check(false, `${name}, ${width} px: nothing old in plain style`, { left, seen });
        return;
      }
    }
    await sleep(200);
  }
  check(true, `${name}: nothing old in plain style after three intervals and for ${forS} s`);
  await picture(pages, name);
};

const back = async (pages, words, withinS = 30) => {
  for (const { page, width } of pages) await until(page, well, `${words}, ${width} px: good again`, withinS);
};

const faults = async (pages, maker) => {
  const desk = pages[0].page;
  let rec = recorder();
  for (const { page } of pages) {
    for (let k = 0; k < 100; k++) {
      try { await page.goto(`http://127.0.0.1:${PORT}/live`); break; } catch { await sleep(100); }
    }
  }
  await back(pages, "at the start");
  await sleep(11_000);
  for (const { page, width } of pages) check((await look(page)).tooWide <= 0, `${width} px: not too wide`, await look(page));
  await picture(pages, "ok");
  const flying = status();
  const goes = flying.exit === 0 || flying.reasons?.every((why) => why.includes("too slow"));
  check(goes && (flying.exit === 0) === (flying.health === "ok") && flying.flight, "status: well, a flight", flying);

  await drawn(maker, BLACK);
  for (const { page, width } of pages) {
    const none = ({ tiles, curves, word }) => tiles[1].shown === "–" && curves[0].lines === 0 && word !== "ok";
    await until(page, none, `black frames, ${width} px: no deflection, no curve, not good`, 3);
  }
  await until(desk, ({ word, reasons }) => word === "failed" && reasons.includes("have no numbers"), "black frames: bad", 12);
  await until(desk, ({ caption }) => caption.includes("0 markers"), "black frames: the picture is theirs", 5);
  const dark = status();
  check(dark.health === "failed" && dark.exit === 1, "black frames: status bad, exit 1", dark);
  await picture(pages, "black");
  pictures();
  await back(pages, "light again");

  fs.renameSync(at("frames"), at("gone"));
  await old(pages, "pictures-gone", 8);
  check(status().exit === 1, "pictures gone: exit 1", status());
  fs.renameSync(at("gone"), at("frames"));
  await back(pages, "pictures are back", 60);

  await end(rec, "SIGTERM");
  await until(desk, ({ reasons }) => reasons.includes("Connection lost"), "recorder stopped: said at once", 0.5);
  await old(pages, "recorder-stopped");
  rec = recorder();
  await back(pages, "recorder started");

  await end(rec, "SIGKILL");
  await old(pages, "recorder-killed");
  rec = recorder();
  await back(pages, "recorder started after the kill");

  rec.kill("SIGSTOP");
  await old(pages, "recorder-hangs", 6);
  check((await look(desk)).reasons.includes("sends nothing"), "recorder hangs: said", await look(desk));
  rec.kill("SIGCONT");
  await back(pages, "recorder goes on");

  await drawn(maker, SHIFTED);
  for (const { page, width } of pages) {
    const doubted = ({ tiles, curves, word }) =>
      word === "degraded" && tiles[1].style === "degraded" && tiles[6].shown === "rejected" && curves[0].doubt > 0;
    await until(page, doubted, `test rejected, ${width} px: seen`, 20);
  }
  await sleep(4000);
  await picture(pages, "rejected");
  check(status().exit === 1, "test rejected: exit 1", status());
  pictures();

  await end(rec, "SIGTERM");
  configure(0.4);
  rec = recorder();
  await sleep(16_000);
  for (const { page, width } of pages) {
    const slow = ({ tiles, curves }) => tiles[1].style === "" && curves.every(({ lines }) => lines > 0);
    await until(page, slow, `0.4 Hz, ${width} px: plots are there, numbers are new`, 20);
  }
  await picture(pages, "slow");
  await end(rec, "SIGTERM");
  configure(RATE_HZ);
  recorder();
};

// Each shows data, or says why not and comes back by itself.
const crowd = async (browser) => {
  const pages = [];
  for (let k = 0; k < BROWSERS; k++) {
    const page = await (await browser.newContext({ viewport: { width: 390, height: 800 } })).newPage();
    await page.goto(`http://127.0.0.1:${PORT}/live`);
    pages.push(page);
  }
  await sleep(10_000);
  const state = async (page) => {
    const seen = await look(page);
    return seen.reasons.includes("browsers are already watching") ? "waits" : /\d/.test(seen.tiles[1].shown) ? "shows" : "nothing";
  };
  const states = () => Promise.all(pages.map(state));
  let all = await states();
  const count = (what) => all.filter((one) => one === what).length;
  check(count("nothing") === 0 && count("shows") >= 10, `${BROWSERS} browsers: ${count("shows")} show data, ${count("waits")} say why not`, all);
  if (SHOTS) await pages[all.indexOf("waits")]?.screenshot({ path: path.join(SHOTS, "waits-390.png") });
  // Those that watch go; the others come in by themselves.
  const watching = pages.filter((_, k) => all[k] === "shows");
  for (const page of watching) {
    await page.context().close();
    pages.splice(pages.indexOf(page), 1);
  }
  const [begun, wanted] = [Date.now(), Math.min(pages.length, 14)];
  while (Date.now() - begun < 30_000 && (all = await states()) && count("shows") < wanted) await sleep(500);
  check(count("shows") >= wanted, `${count("shows")} of those that waited show data after ${((Date.now() - begun) / 1000).toFixed(1)} s`, all);
};

const main = async () => {
  installation();
  fs.mkdirSync(at("frames"));
  pictures();
  configure(RATE_HZ);
  if (SHOTS) fs.mkdirSync(SHOTS, { recursive: true });
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: CHROMIUM });
  const open = async (width) => {
    const page = await (await browser.newContext({ viewport: { width, height: 900 } })).newPage();
    page.on("pageerror", (error) => check(false, `no error of the script, ${width} px`, String(error)));
    return { page, width };
  };
  try {
    const pages = [await open(1400), await open(390)];
    const { page: maker } = await open(200);
    await faults(pages, maker);
    await maker.context().close();
    await back(pages, "at the end");
    for (const { page } of pages) await page.context().close();
    await crowd(browser);
  } finally {
    await browser.close();
    for (const child of children) child.kill("SIGKILL");
    fs.rmSync(dir, { recursive: true, force: true });
  }
  process.exit(failures > 0 ? 1 : 0);
};

main().catch((error) => {
  console.error(error);
  for (const child of children) child.kill("SIGKILL");
  process.exit(1);
});
