// Starts the interactive parts; without this script the page shows its figures as printed.
const tableTitle = (element) => {
  const heads = [...document.querySelectorAll("h1, h2, h3")].filter((head) => head.compareDocumentPosition(element) & Node.DOCUMENT_POSITION_FOLLOWING);
  return (element.closest("details")?.querySelector("summary") ?? heads.pop()).textContent.trim();
};

const tableRows = (table) =>
  [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent.trim().replace(/^[–-]$/, "")));

// Sorts a table by a column, numbers by value and before words; once more: in reverse.
const sortTable = (table, k) => {
  const heads = [...table.tHead.rows[0].cells];
  const sign = heads[k].getAttribute("aria-sort") === "ascending" ? -1 : 1;
  for (const head of heads) head.removeAttribute("aria-sort");
  heads[k].setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
  const key = (row) => {
    const text = row.cells[k].textContent.trim();
    return [row, text !== "" && isFinite(text) ? Number(text) : Infinity, text];
  };
  const keys = [...table.tBodies[0].rows].map(key);
  keys.sort((a, b) => sign * (a[1] - b[1] || a[2].localeCompare(b[2], "en", { numeric: true })));
  table.tBodies[0].append(...keys.map(([row]) => row));
};

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
    [...table.tHead.rows[0].cells].forEach((head, k) => {
      const name = head.textContent;
      head.replaceChildren();
      addElement(head, "button", { type: "button", title: "sort by this column", onclick: () => sortTable(table, k) }, name);
    });
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
