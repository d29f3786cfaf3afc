/* What a page must be for people who cannot see it, use keys alone, or have a small screen: answers with all faults. */
const faults = [];
const all = (what, where = document) => [...where.querySelectorAll(what)];
const words = (el) => el.outerHTML.slice(0, 120);
const shown = (el) => el.checkVisibility();
for (const el of all("details")) el.open = true;

/* Names: every picture, control, table and region says what it is. */
for (const svg of all("svg")) {
  if (svg.getAttribute("role") !== "img" || !svg.getAttribute("aria-label")) faults.push(`picture without a name: ${words(svg)}`);
  if (!svg.firstElementChild || svg.firstElementChild.tagName !== "title") faults.push(`picture without a title: ${words(svg)}`);
}
const named = (el) => {
  const by = (el.getAttribute("aria-labelledby") || "").split(" ").filter(Boolean);
  if (by.some((id) => !document.getElementById(id))) return false;
  const label = el.labels && el.labels.length ? el.labels[0].textContent : "";
  return Boolean(by.length || el.getAttribute("aria-label") || label.trim() || el.textContent.trim());
};
for (const el of all("a[href], button, input, select, summary, [tabindex], [role=region], [role=group], [role=slider], nav, section, article, form"))
  if (!named(el)) faults.push(`no name: ${words(el)}`);
for (const table of all("table")) {
  if (!table.caption || !table.caption.textContent.trim()) faults.push(`table without a caption: ${words(table)}`);
  for (const th of all("th", table)) if (!["col", "row"].includes(th.scope)) faults.push(`head without a scope: ${words(th)}`);
  for (const row of all("tbody tr", table)) if (all("th[scope=row]", row).length !== 1) faults.push(`row without a head: ${words(row)}`);
}

/* Structure: headings follow one another, landmarks are there once, anchors lead somewhere. */
let level = 0;
for (const heading of all("h1, h2, h3, h4, h5, h6")) {
  const here = Number(heading.tagName[1]);
  if (here > level + 1) faults.push(`heading after level ${level}: ${words(heading)}`);
  level = here;
}
for (const one of ["h1", "main", "header", "footer", "nav"]) if (all(one).length !== 1) faults.push(`${all(one).length} times ${one}`);
if (!document.documentElement.lang || !document.title) faults.push("no language or title");
const identities = all("[id]").map((el) => el.id);
for (const id of new Set(identities)) if (identities.filter((each) => each === id).length > 1) faults.push(`id twice: ${id}`);
for (const link of all("a[href^='#']")) if (!document.getElementById(decodeURIComponent(link.hash.slice(1)))) faults.push(`dead link: ${words(link)}`);
for (const el of all("[tabindex]")) if (el.tabIndex > 0) faults.push(`own tab order: ${words(el)}`);

/* Contrast of every text that is seen: 4.5 to 1, 3 to 1 for large text. */
const channel = (c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
const colour = (text) => { const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number); return { r, g, b, a }; };
const light = ({ r, g, b }) => 0.2126 * channel(r / 255) + 0.7152 * channel(g / 255) + 0.0722 * channel(b / 255);
const ground = (el) => {
  for (let at = el; at; at = at.parentElement) { const c = colour(getComputedStyle(at).backgroundColor); if (c.a === 1) return c; }
  return { r: 255, g: 255, b: 255, a: 1 };
};
const seen = new Set();
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const el = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || el.closest("svg, script, style, option, .letter, .skip") || !shown(el)) continue;
  const style = getComputedStyle(el), front = light(colour(style.color)), back = light(ground(el));
  const ratio = (Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05);
  const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
  const kind = `${el.tagName}.${el.className} ${style.color} on ${JSON.stringify(ground(el))}`;
  if (ratio < (large ? 3 : 4.5) && !seen.has(kind)) { seen.add(kind); faults.push(`contrast ${ratio.toFixed(2)}: ${kind}`); }
}

/* Narrow screens: nothing but a table's own region scrolls sideways. */
if (document.documentElement.scrollWidth > innerWidth) {
  const wide = all("main *, header *, .top *").filter((el) => shown(el) && el.getBoundingClientRect().right > innerWidth + 1 && !el.closest(".scroll, nav, svg"));
  faults.push(`wider than the screen: ${document.documentElement.scrollWidth} > ${innerWidth}: ${wide.slice(0, 3).map(words).join(" | ")}`);
}

/* Plots: each line of each plot has ink, and each lane a bar. */
let ink = 0;
for (const path of all(".plot .line, .plot .area-of")) {
  const box = path.getBBox();
  if (box.width > 0 || box.height > 0 || path.classList.contains("lone")) ink += 1;
  else faults.push(`nothing drawn: ${words(path.closest("figure"))}`);
}
const wide = (el) => el.getBoundingClientRect().width > 0;
for (const lane of all(".lane")) if (shown(lane) && !all("rect", lane).some(wide)) faults.push(`empty lane: ${words(lane)}`);
answer({ faults, ink, plots: all("figure.plot").length, lanes: all("#lanes .lane").length, ready: document.documentElement.dataset.ready, focusable: all("a[href], button, input, select, summary, [tabindex='0']").length });
