// Starts the interactive parts for which the page has data; without this script the page shows its drawings as printed.
const addCsvButton = (table, name) => {
  const host = table.closest(".scroll") ?? table;
  // A rebuilt table already has its button.
  const before = host.previousElementSibling;
  const bar = before?.classList.contains("taking") ? before : document.createElement("div");
  bar.className = "tools taking";
  bar.replaceChildren();
  addButton(bar, "CSV", "save the table as CSV", () => saveCsv(tableRows(table), name()));
  host.before(bar);
};

const tableTitle = (element) => {
  const summary = element.closest("details")?.querySelector("summary");
  if (summary) return summary.textContent.trim();
  let at = element;
  while (at) {
    const before = at.previousElementSibling;
    if (before && /^H[1-4]$/.test(before.tagName)) return before.textContent.trim();
    at = before ?? at.parentElement;
  }
  return "table";
};

const startPage = () => {
  document.documentElement.classList.add("script");
  const read = (element) => JSON.parse(element.textContent);
  for (const place of document.querySelectorAll("script.chart")) new Chart(place.parentElement, read(place), place);
  for (const table of document.querySelectorAll("table")) addCsvButton(table, () => tableTitle(table));
  for (const svg of document.querySelectorAll("figure > svg:only-of-type")) {
    if (svg.parentElement.querySelector("script.chart")) continue;
    const bar = document.createElement("div");
    bar.className = "tools";
    const whole = makeZoomable(svg);
    addButton(bar, "All", "show the full figure", whole);
    addSaveButtons(bar, () => svg, () => svg.getAttribute("aria-label") ?? "figure");
    svg.before(bar);
  }
  const frames = document.getElementById("frames-data");
  if (frames) {
    const deflection = document.querySelector("script.chart[data-of=deflection]");
    new FrameViewer(document.getElementById("frames"), read(frames), deflection && read(deflection));
  }
};
startPage();
