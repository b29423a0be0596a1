// The screenshots of the pages, taken from the program: docs/images/report.png, live.png, calibration.png.
//
//   make pictures, or: node tests/browser/pictures.mjs target/release/wingd docs/images
//
// Needs Node 18, the package playwright-core (PLAYWRIGHT: the folder that holds it) and a Chromium (CHROMIUM: the program).

import { spawn, execFileSync } from "node:child_process";
import { mkdtempSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

const { chromium } = createRequire(`${process.env.PLAYWRIGHT ?? process.cwd()}/`)("playwright-core");
const [wingd, target] = process.argv.slice(2, 4).map((path) => resolve(path));
const folder = mkdtempSync(join(tmpdir(), "wingd-pictures-"));
const board = resolve("config/new/board.toml");
const PORT = 18098;
const SECONDS = 40;
const run = (...args) => execFileSync(wingd, args, { cwd: folder, stdio: "ignore" });
const sleep = (ms) => new Promise((done) => { setTimeout(done, ms); });

run("demo", "--output", "demo");
// A wing that swings by 0.2 m at 0.1 Hz, at 4 frames a second.
const deflections = Array.from({ length: SECONDS }, (_, k) => (2.1 + 0.2 * Math.sin(0.157 * k)).toFixed(3)).join(",");
run("simulate", "--output", ".", "--seed", "4", "--size", "2000", "1500", "--focal", "2400", "--tip-deflections", deflections,
  "--board", board);
run("orient", "frames/ground.jpg");
run("calibrate", "--board", board, "--output", "camera.toml", "--report", "calibration.html", "board");
execFileSync("sh", ["-c", "mkdir flight && mv frames/flight-*.jpg flight"], { cwd: folder });
writeFileSync(join(folder, "wingd.toml"), `installation = "installation"
[camera]
kind = "replay"
folder = "flight"
[store]
path = "store"
[status]
socket = "wingd.sock"
[serve]
listen = "127.0.0.1:${PORT}"
[live]
rate_hz = 4
series = false
socket = "live.sock"
`);
const recorder = spawn(wingd, ["run"], { cwd: folder, stdio: "ignore" });
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu", "--hide-scrollbars"],
});
try {
  const page = await browser.newPage({ colorScheme: "light" });
  // The head of a page down to a height, px.
  const picture = async (address, name, height, wait = 0) => {
    await page.setViewportSize({ width: 1100, height });
    await page.goto(address);
    await sleep(wait);
    await page.screenshot({ path: join(target, name) });
  };
  await picture(`file://${folder}/demo/report.html`, "report.png", 1080);
  await picture(`file://${folder}/calibration.html`, "calibration.png", 990);
  await picture(`http://127.0.0.1:${PORT}/live`, "live.png", 1440, 1000 * SECONDS);
} finally {
  await browser.close();
  recorder.kill("SIGTERM");
}
