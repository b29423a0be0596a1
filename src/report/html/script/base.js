"use strict";
// Common functions of the figures: elements, numbers, ticks, saved files. The script makes no network requests.
const NAMESPACE = "http://www.w3.org/2000/svg";
const LIGHT = { ink: "#1c2430", soft: "#5b6573", grid: "#e4e8ed", frame: "#9aa3af", paper: "#ffffff", pale: 0 };
const DARK = { ink: "#e7ebf0", soft: "#b3bcc8", grid: "#2f3741", frame: "#6b7684", paper: "#14181e", pale: 70 };
const darkMode = matchMedia("(prefers-color-scheme: dark)");
const currentTheme = () => (darkMode.matches ? DARK : LIGHT);

// Adapts a colour of the light page to a dark one: same hue, lightness `pale` in %; 0 keeps the colour.
const tintColour = (hex, pale) => {
  if (pale === 0) return hex;
  const [r, g, b] = [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  const [most, least] = [Math.max(r, g, b), Math.min(r, g, b)];
  const width = most - least || 1;
  const hue = most === r ? (g - b) / width : most === g ? 2 + (b - r) / width : 4 + (r - g) / width;
  const full = (most - least) / (1 - Math.abs(most + least - 1) || 1);
  return `hsl(${Math.round(60 * hue)} ${Math.round(100 * full)}% ${pale}%)`;
};

const addSvgElement = (parent, name, attributes, content) => {
  const element = document.createElementNS(NAMESPACE, name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined) element.setAttribute(key, value);
  }
  if (content !== undefined) element.textContent = content;
  parent.append(element);
  return element;
};

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

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const roundToTenth = (value) => Math.round(10 * value) / 10;

// Number of decimals that shows two significant digits of a standard deviation.
const decimalsFor = (sigma) =>
  isNumber(sigma) && sigma > 0 ? Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(sigma / 0.995)))) : 3;

const formatMeasured = (value, sigma, unit) => {
  if (!isNumber(value)) return "–";
  const spread = isNumber(sigma) && sigma > 0 ? ` ± ${sigma.toFixed(decimalsFor(sigma))}` : "";
  return `${value.toFixed(decimalsFor(sigma))}${spread}${unit ? ` ${unit}` : ""}`;
};

// Returns 1, 2 or 5 times a power of ten, at least the raw step.
const roundStep = (raw) => {
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999) ?? 10);
};

const linearTicks = (low, high, maxTicks) => {
  const step = roundStep(Math.max((high - low) / maxTicks, 1e-300));
  const digits = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-6); k * step <= high + 1e-6 * step && ticks.length < 60; k++) {
    const text = Math.abs(k * step) >= 1e7 ? (k * step).toExponential(2) : (k * step).toFixed(digits);
    ticks.push([k * step, text === "-0" ? "0" : text.replace(/^-(0\.?0*)$/, "$1")]);
  }
  return ticks;
};

// Steps of a time axis: seconds, minutes, hours and days, s.
const TIME_STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];

const clockText = (ms, step) => {
  const iso = new Date(ms).toISOString();
  if (step >= 86400) return iso.slice(5, 10);
  if (step >= 60) return iso.slice(11, 16);
  return step >= 1 ? iso.slice(11, 19) : iso.slice(11, 23);
};

// Ticks at round times of day; positions are hours since `zero`, which is in ms.
const timeTicks = (low, high, zero, maxTicks) => {
  const raw = (3600 * (high - low)) / maxTicks;
  const step = raw < 1 ? roundStep(Math.max(raw, 1e-3)) : TIME_STEPS.find((s) => s >= raw) ?? 86400 * roundStep(raw / 86400);
  const ticks = [];
  const begin = zero / 1000 + 3600 * low;
  for (let k = Math.ceil(begin / step - 1e-6); ticks.length < 60; k++) {
    const hour = (k * step - zero / 1000) / 3600;
    if (hour > high + 1e-9) break;
    ticks.push([hour, clockText(1000 * k * step, step)]);
  }
  return ticks;
};

const saveFile = (blob, name) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name.replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^-+|-+$/g, "");
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
};

const COPIED = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "opacity", "font-size", "font-family",
  "font-weight", "text-anchor", "paint-order", "visibility"];

// Copies a drawing for use outside the page, with the styles of the page written into it.
const standaloneSvg = (svg) => {
  const copy = svg.cloneNode(true);
  const [from, to] = [svg, copy].map((root) => [root, ...root.querySelectorAll("*")]);
  from.forEach((original, k) => {
    const style = getComputedStyle(original);
    for (const name of COPIED) to[k].setAttribute(name, style.getPropertyValue(name));
  });
  const [, , width, height] = svg.getAttribute("viewBox").split(/\s+/).map(Number);
  const scale = width > 2400 ? 1600 / width : 1;
  copy.setAttribute("width", roundToTenth(width * scale));
  copy.setAttribute("height", roundToTenth(height * scale));
  copy.removeAttribute("style");
  return copy;
};

const svgBlob = (svg) => {
  svg.setAttribute("xmlns", NAMESPACE);
  return new Blob([new XMLSerializer().serializeToString(svg)], { type: "image/svg+xml" });
};

// Saves twice the drawing's size, on white.
const savePng = async (svg, name) => {
  const [width, height] = ["width", "height"].map((key) => Number(svg.getAttribute(key)));
  const url = URL.createObjectURL(svgBlob(svg));
  const image = new Image();
  image.src = url;
  await image.decode();
  const canvas = Object.assign(document.createElement("canvas"), { width: 2 * width, height: 2 * height });
  const context = canvas.getContext("2d");
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(url);
  canvas.toBlob((blob) => saveFile(blob, name), "image/png");
};

const csvText = (rows) => {
  const cell = (value) => (/[",\n\r]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  return `${rows.map((row) => row.map((value) => cell(String(value ?? ""))).join(",")).join("\r\n")}\r\n`;
};

const saveCsv = (rows, name) => saveFile(new Blob(["\ufeff", csvText(rows)], { type: "text/csv" }), `${name}.csv`);

const tableRows = (table) =>
  [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent.trim().replace(/^–$/, "")));
