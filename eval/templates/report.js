"use strict";
// The page is complete without this: it sorts tables, picks out a controller, hides a division.
(() => {
  const all = (selector, within = document) => Array.from(within.querySelectorAll(selector));

  const value = (row, column) => {
    const cell = row.cells[column];
    const text = cell.dataset.v ?? cell.textContent.trim();
    return text === "" || Number.isNaN(Number(text)) ? text : Number(text);
  };

  const compare = (a, b) => {
    if (a === "" || b === "") return (a === "") - (b === ""); // nothing known comes last
    if (typeof a === "number" && typeof b === "number") return a - b;
    return String(a).localeCompare(String(b));
  };

  const sort = (table, column, head) => {
    const down = head.getAttribute("aria-sort") === "ascending";
    all("thead th", table).forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const body = table.tBodies[0];
    const rows = Array.from(body.rows).filter((row) => !row.classList.contains("fixed"));
    const fixed = Array.from(body.rows).filter((row) => row.classList.contains("fixed"));
    rows.sort((first, second) => {
      const a = value(first, column), b = value(second, column);
      const order = compare(a, b);
      return down && a !== "" && b !== "" ? -order : order;
    });
    body.append(...rows, ...fixed);
  };

  for (const table of all("table.sortable")) {
    all("thead th", table).forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      button.addEventListener("click", () => sort(table, column, head));
      head.append(button);
    });
  }

  document.getElementById("pick").addEventListener("change", (event) => {
    const place = event.target.value;
    for (const element of all("[data-c]")) {
      const picked = place !== "" && element.dataset.c === place;
      element.classList.toggle("picked", picked);
      // What is drawn last lies on top.
      if (picked && element.ownerSVGElement) element.parentNode.append(element);
    }
  });

  document.getElementById("division").addEventListener("change", (event) => {
    for (const element of all("[data-division]")) {
      element.hidden = event.target.value !== "" && element.dataset.division !== event.target.value;
    }
  });

  const open = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target instanceof HTMLDetailsElement) target.open = true;
  };
  window.addEventListener("hashchange", open);
  window.addEventListener("beforeprint", () => {
    for (const details of all("details.card")) details.open = true;
  });
  open();
  document.getElementById("tools").hidden = false;
  document.documentElement.classList.add("ready");
})();
