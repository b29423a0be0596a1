#!/usr/bin/env node
// Each interaction of a report once, in a real Chromium, at 1400 and 390 px, in the light and in the dark; printed at the end.
//
// usage: node tests/browser/report.mjs REPORT.html [FOLDER]
//        FOLDER gets images of each state and the print for inspection.
//
// Needs Node 18, the package playwright-core (PLAYWRIGHT: the folder that holds it) and a Chromium (CHROMIUM: the program). Exit
// status 1 if an interaction fails.
import { createRequire } from "node:module";
import { mkdirSync, readFileSync } from "node:fs";
import { resolve } from "node:path";

const require = createRequire(`${process.env.PLAYWRIGHT ?? process.cwd()}/`);
const { chromium } = require("playwright-core");
const [file, folder] = process.argv.slice(2);
if (!file) throw new Error("usage: report.mjs REPORT.html [FOLDER]");
if (folder) mkdirSync(folder, { recursive: true });

// Minimum contrast of text by WCAG 2.1, level AA.
const CONTRAST = 4.5;
// Maximum time until the page is loaded, ms.
const READY = 1000;
let faults = 0;
const check = (right, text) => {
  if (!right) faults += 1;
  console.log(`${right ? "ok   " : "FAULT"} ${text}`);
};

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync"],
});

// Text with too little contrast to its background, and content wider than the page.
const seen = () => {
  const channel = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const rgb = (text) => text.match(/[\d.]+/g)?.map(Number) ?? [0, 0, 0, 0];
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0.5) return colour.slice(0, 3);
    }
    return [255, 255, 255];
  };
  const weak = [];
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((child) => child.nodeType === 3 && child.textContent.trim() !== "");
    if (!own || ["SCRIPT", "STYLE", "OPTION", "TITLE"].includes(element.tagName.toUpperCase()) || element.closest("svg.photo, title")) continue;
    if (element.getClientRects().length === 0) continue;
    const style = getComputedStyle(element);
    const inverted = [...document.querySelectorAll("figure > svg, div.plot")].some((one) => one.contains(element) && getComputedStyle(one).filter !== "none") && !element.closest(".tip");
    const fore = rgb(element.closest("svg") ? style.fill : style.color).slice(0, 3);
    const back = inverted ? [235, 231, 225] : ground(element.closest("svg")?.parentElement ?? element);
    const [a, b] = [light(fore), light(back)].sort((x, y) => y - x);
    const contrast = (a + 0.05) / (b + 0.05);
    if (contrast < 4.5) weak.push(`${element.tagName}.${element.className?.baseVal ?? element.className} "${element.textContent.trim().slice(0, 30)}" ${contrast.toFixed(2)}`);
  }
  return { weak: [...new Set(weak)], wide: document.documentElement.scrollWidth - innerWidth };
};

const outside = () => {
  const beyond = [];
  for (const svg of document.querySelectorAll("figure > svg, svg.figure")) {
    if (svg.getClientRects().length === 0) continue;
    // Ticks and labels lie in the margin of the plot.
    const box = (svg.matches(".figure") ? svg.closest("figure") : svg).getBoundingClientRect();
    for (const text of svg.querySelectorAll("text")) {
      const t = text.getBoundingClientRect();
      if (t.width === 0) continue;
      if (t.left < box.left - 1 || t.right > box.right + 1 || t.top < box.top - 1 || t.bottom > box.bottom + 1) beyond.push(`${svg.getAttribute("aria-label")}: ${text.textContent}`);
    }
  }
  return beyond;
};

const download = async (page, click) => {
  const [got] = await Promise.all([page.waitForEvent("download", { timeout: 10000 }), click()]);
  return { name: got.suggestedFilename(), bytes: readFileSync(await got.path()) };
};

const chart = async (page, at) => {
  const one = page.locator("figure:has(svg.figure)").first();
  const svg = one.locator("svg.figure");
  await svg.scrollIntoViewIfNeeded();
  const box = await svg.boundingBox();
  const xLabels = () => svg.locator("text").allTextContents();
  const before = (await xLabels()).join();
  await page.mouse.move(box.x + 0.6 * box.width, box.y + 0.5 * box.height);
  let shown = false;
  for (let k = 1; k < 10 && !shown; k++) {
    await page.mouse.move(box.x + 0.6 * box.width, box.y + (k / 10) * box.height);
    shown = await one.locator(".tip").isVisible();
  }
  const tip = shown ? await one.locator(".tip").innerText() : "";
  check(/-?\d+\.\d+.*±/s.test(tip), `${at}: hover shows value and sigma: ${tip.replaceAll("\n", " | ")}`);
  await page.mouse.move(box.x + 0.3 * box.width, box.y + 0.5 * box.height);
  await page.mouse.down();
  await page.mouse.move(box.x + 0.5 * box.width, box.y + 0.52 * box.height, { steps: 4 });
  await page.mouse.up();
  const zoomed = (await xLabels()).join();
  check(zoomed !== before, `${at}: a stroke zooms`);
  await one.getByRole("button", { name: /^All: show the full/ }).click();
  check((await xLabels()).join() === before, `${at}: All shows the full range again`);
  await svg.focus();
  await page.keyboard.press("ArrowRight");
  check(await one.locator(".tip").isVisible(), `${at}: arrow keys go from point to point`);
  const switches = one.locator(".legend button[aria-pressed]");
  if ((await switches.count()) > 1) {
    const lines = () => svg.locator("[data-track]:not([hidden])").count();
    const all = await lines();
    await switches.first().click();
    check((await lines()) === all - 1, `${at}: a track is switched off`);
    await switches.first().click();
    check((await lines()) === all, `${at}: and on`);
  }
  const vector = await download(page, () => one.getByRole("button", { name: /^SVG/ }).click());
  check(vector.bytes.toString().startsWith("<svg") && vector.name.endsWith(".svg"), `${at}: ${vector.name}, ${vector.bytes.length} B`);
  const png = await download(page, () => one.getByRole("button", { name: /^PNG/ }).click());
  check(png.bytes.subarray(1, 4).toString() === "PNG" && png.name.endsWith(".png"), `${at}: ${png.name}, ${png.bytes.length} B`);
  const csv = await download(page, () => one.getByRole("button", { name: /^CSV/ }).click());
  check(csv.bytes.toString().split("\r\n").length > 3, `${at}: ${csv.name}, ${csv.bytes.length} B`);
};

const frames = async (page, at) => {
  const viewer = page.locator("#frames");
  const select = viewer.locator("select").first();
  const first = await viewer.locator("p[role=status]").first().innerText();
  const [count, chosen] = [await select.locator("option").count(), await select.inputValue()];
  await viewer.getByRole("button", { name: /next frame/ }).click();
  check(count < 2 || (await select.inputValue()) !== chosen, `${at}: another of ${count} frames is shown; first: ${first}`);
  for (let k = 0; k < Math.min(count, 12); k++) await viewer.getByRole("button", { name: /next frame/ }).click();
  await select.selectOption({ index: 0 });
  check((await viewer.locator("p[role=status]").first().innerText()) === first, `${at}: the frame that ranks first again`);
  const drawn = await viewer.evaluate((root) => {
    const { surveyed, frames } = JSON.parse(document.getElementById("frames-data").textContent);
    const name = root.querySelector("h3").textContent;
    const { markers } = frames.find(({ series, image }) => `${series} ${image}` === name);
    const meant = (used) => markers.filter((m) => surveyed && m[0] === used && m[2] !== null && m[4]).length;
    const dots = (track) => (root.querySelector(`figure.curve [data-name="${track}"] .dot`).getAttribute("d").match(/M/g) ?? []).length;
    return [[dots("markers"), meant(true)], [dots("markers, predicted"), meant(false)]];
  });
  check(drawn.every(([dots, meant]) => dots === meant), `${at}: used and predicted markers of the frame are drawn apart: ${drawn.join("; ")}`);
  const wing = viewer.locator(".wing svg.figure");
  await wing.scrollIntoViewIfNeeded();
  const state = () => wing.innerHTML();
  const before = await state();
  const box = await wing.boundingBox();
  await page.mouse.move(box.x + 100, box.y + 100);
  await page.mouse.down();
  await page.mouse.move(box.x + 160, box.y + 120, { steps: 3 });
  await page.mouse.up();
  check((await state()) !== before, `${at}: the wing turns`);
  await viewer.locator(".wing select").selectOption("5");
  check(/enlarged 5 times/.test(await viewer.locator(".wing .caption").innerText()), `${at}: its exaggeration is shown`);
  await viewer.locator("summary").click();
  const table = await download(page, () => viewer.locator(".tools").last().getByRole("button", { name: /^CSV/ }).click());
  check(table.bytes.length > 20, `${at}: ${table.name}, ${table.bytes.length} B`);
};

// The first screen answers; tables sort; the other references are a click away.
const answer = async (page, at) => {
  const sentence = page.locator("p.answer");
  const [text, box] = [await sentence.innerText(), await sentence.boundingBox()];
  check(/deflection/i.test(text) && box.y + box.height < 844, `${at}: the first screen says: ${text}`);
  const remarks = page.locator("details", { hasText: "of remarks" }).first();
  if ((await remarks.count()) > 0) {
    const [list, figure] = [remarks.locator("ul"), page.locator("figure").first()];
    const open = await list.isVisible();
    check((await remarks.boundingBox()).y < (await figure.boundingBox()).y, `${at}: the remarks come before the figures`);
    await remarks.locator("summary").click();
    check((await list.isVisible()) !== open, `${at}: a click folds or shows the remarks`);
    await remarks.locator("summary").click();
  }
  const references = page.locator("details", { hasText: "the other references" }).first();
  const table = references.locator("table");
  check(!(await table.isVisible()), `${at}: the other references are folded`);
  await references.locator("summary").click();
  check(/against the survey/.test(await table.innerText()), `${at}: a click shows them`);
  const column = async (k) => (await table.locator(`tbody td:nth-child(${k})`).allInnerTexts()).map(Number);
  const ordered = (values, sign) => values.every((v, k) => k === 0 || sign * (v - values[k - 1]) >= 0);
  const head = table.locator("th:nth-child(3) button");
  await head.click();
  check(ordered(await column(3), 1), `${at}: a heading sorts its column`);
  await head.click();
  check(ordered(await column(3), -1), `${at}: once more in reverse`);
  await references.locator("summary").click();
  const size = (selector) => page.locator(selector).first().evaluate((dot) => dot.getBoundingClientRect().width);
  if ((await page.locator(".legend i.small").count()) > 0) {
    check((await size(".legend i.dot:not(.small)")) > (await size(".legend i.small")), `${at}: the legend's dot of a mean is larger than that of a frame`);
  }
  for (const media of ["print", "screen"]) {
    await page.emulateMedia({ media });
    const struck = await page.evaluate(() => [...document.querySelectorAll(".legend button")]
      .filter((one) => one.getClientRects().length > 0 && getComputedStyle(one).textDecorationLine !== "none").length);
    check(struck === 0, `${at}: no legend is struck through, ${media}`);
  }
  // Chromium blurs the dots of a drawing with a filter of its own.
  const filtered = await page.evaluate(() => [...document.querySelectorAll("svg.figure")].filter((one) => getComputedStyle(one).filter !== "none").length);
  check(filtered === 0, `${at}: no drawing is filtered itself`);
};

for (const width of [1400, 390]) {
  for (const scheme of ["light", "dark"]) {
    const at = `${width} px, ${scheme}`;
    const context = await browser.newContext({ viewport: { width, height: 900 }, colorScheme: scheme, acceptDownloads: true });
    const page = await context.newPage();
    const asked = [];
    page.on("request", (request) => { if (!/^(file|data|blob):/.test(request.url())) asked.push(request.url()); });
    page.on("pageerror", (error) => check(false, `${at}: ${error.message}`));
    await page.goto(`file://${resolve(file)}`);
    const ready = await page.evaluate(() => performance.getEntriesByType("navigation")[0].loadEventEnd);
    check(ready < READY, `${at}: ready after ${ready.toFixed(0)} ms`);
    check(asked.length === 0, `${at}: no network requests`);
    await answer(page, at);
    await chart(page, at);
    if ((await page.locator("#frames").count()) > 0) await frames(page, at);
    const { weak, wide } = await page.evaluate(seen);
    check(weak.length === 0, `${at}: contrast ${CONTRAST} and more ${weak.slice(0, 8).join("; ")}`);
    check(wide <= 0, `${at}: nothing is wider than the page (${wide} px)`);
    const beyond = await page.evaluate(outside);
    check(beyond.length === 0, `${at}: no text outside its picture ${beyond.slice(0, 5).join("; ")}`);
    if (folder) {
      await page.evaluate(() => scrollTo(0, 0));
      await page.screenshot({ path: `${folder}/${width}-${scheme}.png`, fullPage: true });
      if (scheme === "dark") await page.pdf({ path: `${folder}/print-${width}.pdf`, format: "A4", preferCSSPageSize: true });
    }
    await context.close();
  }
}
await browser.close();
console.log(faults === 0 ? "all interactions work" : `${faults} faults`);
process.exit(faults === 0 ? 0 : 1);
