// Theme, sorting, scroll hints and print of a page. The abscissa is in figures.js, the 3-D scene in scene.js.
"use strict";
(() => {
  const root = document.documentElement;
  const print = matchMedia("print");

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const toggle = document.getElementById("theme");
  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : dark.matches);
  const announce = () => {
    toggle.setAttribute("aria-pressed", String(isDark()));
    document.dispatchEvent(new Event("themechange"));
  };
  toggle.hidden = false;
  toggle.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    announce();
  });
  dark.addEventListener("change", announce);
  announce();

  // A cell without a number comes last, whichever way the column is sorted.
  const compare = (one, other, sign) => {
    const [a, b] = [parseFloat(one), parseFloat(other)];
    if (Number.isNaN(a) && Number.isNaN(b)) return sign * one.localeCompare(other);
    if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) ? 1 : -1;
    return sign * (a - b);
  };
  const sort = (header) => {
    const sign = header.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const other of header.parentNode.children) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", sign === 1 ? "ascending" : "descending");
    const text = (row) => row.cells[header.cellIndex].textContent;
    const body = header.closest("table").tBodies[0];
    body.append(...[...body.rows].sort((a, b) => compare(text(a), text(b), sign)));
  };
  for (const header of document.querySelectorAll("table.sortable th[scope=col]")) {
    const button = document.createElement("button");
    button.type = "button";
    const what = header.querySelector("a.what");
    if (what) what.remove();
    button.textContent = header.textContent.trim();
    header.replaceChildren();
    button.addEventListener("click", () => sort(header));
    header.append(button, ...(what ? [" ", what] : []));
  }

  // A box that does not show all that is in it says so.
  const boxes = [...document.querySelectorAll(".wide")];
  const hint = (box) => box.toggleAttribute("data-overflows", box.scrollWidth > box.clientWidth + 1);
  const sizes = new ResizeObserver((entries) => {
    for (const entry of entries) hint(entry.target);
  });
  for (const box of boxes) {
    hint(box);
    sizes.observe(box);
  }

  // On paper nothing can be opened.
  let opened = [];
  print.addEventListener("change", () => {
    if (print.matches) opened = [...document.querySelectorAll("details:not([open])")];
    for (const item of opened) item.open = print.matches;
  });
})();
