// Clicking a heading of a leaderboard sorts every group: best first, on a second click worst first.
// Filters choose lines of the leaderboard below them.
"use strict";

for (const form of document.querySelectorAll("form.filters")) {
  form.addEventListener("change", () => {
    const chosen = [...form.querySelectorAll("select")].filter((choice) => choice.value);
    for (const line of form.nextElementSibling.querySelectorAll("tr[data-learned]")) {
      line.hidden = !chosen.every((choice) => line.dataset[choice.dataset.filter] === choice.value);
    }
  });
}

for (const table of document.querySelectorAll("table.grid")) {
  const headings = [...table.querySelectorAll("thead th")];
  headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
    const ascending = heading.ariaSort === "descending" || (column === 0 && heading.ariaSort !== "ascending");
    headings.forEach((other) => other.removeAttribute("aria-sort"));
    heading.ariaSort = ascending ? "ascending" : "descending";
    const key = (line) => (column ? Number(line.cells[column].dataset.value) : line.dataset.name);
    for (const group of table.tBodies) {
      const lines = [...group.rows].filter((line) => line.dataset.name);
      lines.sort((a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : 0));
      if (!ascending) lines.reverse();
      group.append(...lines);
    }
  }));
}
