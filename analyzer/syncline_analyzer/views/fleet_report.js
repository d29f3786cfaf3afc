"use strict";
(() => {
  const all = (what, where = document) => [...where.querySelectorAll(what)];
  const one = (what, where = document) => where.querySelector(what);
  const rows = all("table.map tbody tr");

  // -- map: one stop for the tab key, arrows go from cell to cell

  const isLink = (cell) => cell && one("a", cell);
  function words(cell) {
    const row = cell.parentElement, table = cell.closest("table");
    const head = table.tHead.rows[table.tHead.rows.length - 1].cells[cell.cellIndex];
    const several = cell.dataset.n ? `, worst of ${cell.dataset.n} captures` : "";
    const sign = cell.textContent.trim(), count = Number(sign.slice(1));
    const kind = { E: "error", W: "warning" }[sign[0]];
    const verdict = kind ? `${count} ${kind}${count === 1 ? "" : "s"}` : sign ? "healthy" : "nothing recorded";
    return `${row.dataset.name}, ${head.dataset.day}: ${verdict}${several}`;
  }
  const output = one("#cell");
  const tell = (target) => {
    const cell = target.closest && target.closest("table.map td");
    if (cell && output) output.textContent = words(cell);
  };
  addEventListener("focusin", (event) => tell(event.target));
  addEventListener("pointerover", (event) => tell(event.target));

  for (const table of all("table.map")) {
    const links = all("td a", table);
    links.forEach((link, n) => { link.tabIndex = n ? -1 : 0; });
    table.addEventListener("keydown", (event) => {
      const cell = event.target.closest("td");
      const way = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0], Home: [0, -Infinity], End: [0, Infinity] }[event.key];
      if (!cell || !way) return;
      const next = found(table, cell, way);
      event.preventDefault();
      if (!next) return;
      event.target.tabIndex = -1;
      one("a", next).tabIndex = 0;
      one("a", next).focus();
    });
  }

  function found(table, cell, [down, right]) {
    const shown = [...table.tBodies[0].rows].filter((row) => !row.hidden);
    let row = shown.indexOf(cell.parentElement), column = cell.cellIndex;
    if (!isFinite(right)) {
      const cells = [...cell.parentElement.cells].filter(isLink).filter((each) => each.tagName === "TD");
      return cells[right < 0 ? 0 : cells.length - 1];
    }
    for (;;) {
      row += down; column += right;
      const next = shown[row] && shown[row].cells[column];
      if (!next || next.tagName !== "TD") return null;
      if (isLink(next)) return next;
    }
  }

  // -- filter of the map and of the machines in trouble

  const form = one("#map .filter");
  if (form) {
    const count = one("output", form), cards = all("#machines li[data-name]");
    const apply = () => {
      const text = form.words.value.trim().toLowerCase();
      const kept = new Set(all("[name=verdict]:checked", form).map((box) => box.value));
      const isShown = (el) => (kept.has(el.dataset.verdict) || !el.dataset.verdict) && el.dataset.name.toLowerCase().includes(text);
      for (const el of [...rows, ...cards]) el.hidden = !isShown(el);
      const left = rows.filter((row) => !row.hidden).length;
      const filtered = left < rows.length;
      count.textContent = filtered ? `${left} of ${rows.length} machines` : "";
      const rest = one("details.map-rest");
      if (rest && filtered && all("tr", rest).some((row) => row.dataset.name && !row.hidden)) rest.open = true;
      for (const table of all("table.map")) stop(table);
    };
    form.hidden = false;
    form.addEventListener("input", apply);
    form.addEventListener("submit", (event) => event.preventDefault());
  }

  function stop(table) {
    const links = all("tbody tr:not([hidden]) td a", table);
    if (links.length && !links.some((link) => link.tabIndex === 0)) links[0].tabIndex = 0;
  }

  // -- all tables, paper, and links into what is closed

  const button = one("#everything");
  button.addEventListener("click", () => {
    const open = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(open));
    for (const el of all("details")) el.open = open;
  });
  let closed = [];
  addEventListener("beforeprint", () => { closed = all("details.rest:not([open]):not(.map-rest)"); closed.forEach((el) => { el.open = true; }); });
  addEventListener("afterprint", () => closed.forEach((el) => { el.open = false; }));
  function reveal() {
    const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (let at = target; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
    if (target) target.scrollIntoView();
  }
  addEventListener("hashchange", reveal);
  reveal();
  document.documentElement.dataset.ready = "true";
})();
