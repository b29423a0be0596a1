// Starts the interactive parts; without this script the page shows its figures as printed.
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

const tableRows = (table) =>
  [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent.trim().replace(/^[–-]$/, "")));

const startPage = () => {
  document.documentElement.classList.add("script");
  const figures = new Map();
  for (const svg of document.querySelectorAll("svg.figure")) {
    const figure = svg.closest("figure");
    figures.set(figure, new InteractiveFigure(svg, !figure.matches(".wing")));
  }
  for (const table of document.querySelectorAll("table")) {
    const bar = addTools(table.closest(".scroll") ?? table);
    addButton(bar, "CSV", "save the table as CSV", () => saveCsv(tableRows(table), tableTitle(table)));
  }
  for (const svg of document.querySelectorAll("figure > svg")) {
    const bar = addTools(svg);
    addButton(bar, "All", "show the full figure", makeZoomable(svg));
    addSaveButtons(bar, () => copyPicture(svg), () => svg.closest("figure").dataset.frame ?? svg.getAttribute("aria-label") ?? "figure");
  }
  const frames = document.getElementById("frames");
  if (frames) new FrameViewer(frames, JSON.parse(document.getElementById("frames-data").textContent), figures);
};
startPage();
