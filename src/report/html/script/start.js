// Puts the parts together where the page has their data; without this script the page shows its drawings as they are printed.
const csvButton = (table, name) => {
  const host = table.closest(".scroll") ?? table;
  // A table that is made anew has its button already.
  const before = host.previousElementSibling;
  const bar = before?.classList.contains("taking") ? before : document.createElement("div");
  bar.className = "tools taking";
  bar.replaceChildren();
  button(bar, "CSV", "take the table away", () => saveCsv(tableRows(table), name()));
  host.before(bar);
};

const heading = (element) => {
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

const start = () => {
  document.documentElement.classList.add("script");
  const read = (element) => JSON.parse(element.textContent);
  for (const place of document.querySelectorAll("script.chart")) new Chart(place.parentElement, read(place), place);
  for (const table of document.querySelectorAll("table")) csvButton(table, () => heading(table));
  for (const svg of document.querySelectorAll("figure > svg:only-of-type")) {
    if (svg.parentElement.querySelector("script.chart")) continue;
    const bar = document.createElement("div");
    bar.className = "tools";
    const whole = zoomable(svg);
    button(bar, "All", "the whole figure", whole);
    takeAway(bar, () => svg, () => svg.getAttribute("aria-label") ?? "figure");
    svg.before(bar);
  }
  const frames = document.getElementById("frames-data");
  if (frames) {
    const deflection = document.querySelector("script.chart[data-of=deflection]");
    new Frames(document.getElementById("frames"), read(frames), deflection && read(deflection));
  }
};
start();
