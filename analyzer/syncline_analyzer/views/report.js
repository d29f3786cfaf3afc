"use strict";
(() => {
  const all = (what, where = document) => [...where.querySelectorAll(what)];
  const one = (what, where = document) => where.querySelector(what);
  const make = (name, fields = {}) => Object.assign(document.createElement(name), fields);
  const data = JSON.parse(one("#report-data").textContent);
  const whole = [0, data.seconds];
  const LEAST = Math.min(1e-5, data.seconds);
  const UNITS = 1000, NEAR_END = 0.9;
  let range = whole;

  // -- words

  const two = (n) => String(n).padStart(2, "0");
  const places = (span) => (span < 0.05 ? 6 : 3);

  function captureTime(s, digits) {
    const scale = 10 ** digits, ticks = Math.round(Math.abs(s) * scale);
    const minutes = Math.floor(ticks / scale / 60), hours = Math.floor(minutes / 60);
    const rest = ticks - minutes * 60 * scale;
    const part = digits ? "." + String(rest % scale).padStart(digits, "0") : "";
    const head = hours ? `${hours}:${two(minutes % 60)}` : `${minutes}`;
    return `${s < 0 && ticks ? "-" : ""}${head}:${two(Math.floor(rest / scale))}${part}`;
  }

  function utc(s, digits) {
    const ms = data.start_ms + s * 1000, scale = 10 ** (digits - 3);
    const us = Math.round(ms * scale), day = new Date(Math.floor(us / scale)).toISOString();
    const fine = digits > 3 ? String(us % scale).padStart(digits - 3, "0") : "";
    return `${several ? day.slice(5, 10) + " " : ""}${day.slice(11, digits ? 23 : 19)}${fine}`;
  }
  const dated = data.start_ms !== null;
  const dayOf = (s) => Math.floor((data.start_ms / 1000 + s) / 86400);
  const several = dated && dayOf(data.begin) !== dayOf(data.begin + data.seconds);

  function moment(s, digits) {
    const at = data.begin + s;
    return captureTime(at, digits) + (dated ? ` (${utc(at, digits)} UTC)` : "");
  }

  const TIMES = [];
  for (let p = -6; p < 0; p += 1) for (const k of [1, 2, 5]) TIMES.push(k * 10 ** p);
  TIMES.push(1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800);
  for (const h of [1, 2, 3, 6, 12, 24, 48, 120, 240]) TIMES.push(h * 3600);

  function timeTicks(from, to, most) {
    const step = TIMES.find((t) => (to - from) / t < most) || TIMES[TIMES.length - 1];
    const digits = step >= 1 ? 0 : step >= 0.001 ? 3 : 6, found = [];
    for (let n = Math.ceil((from + data.begin) / step); n * step <= to + data.begin && found.length < most; n += 1)
      found.push([n * step - data.begin, captureTime(n * step, digits), digits]);
    return found;
  }

  function valueTicks(low, high, most, unit) {
    const span = high - low;
    if (!(span > 0) || !isFinite(span)) return [];
    let step = 90;
    if (unit !== "deg" || span <= 200) {
      const power = 10 ** Math.floor(Math.log10(span / most));
      step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= (span / most) * (1 - 1e-9));
    }
    const count = () => Math.floor(high / step) - Math.ceil(low / step) + 1;
    while (count() > most) step *= 2;
    const digits = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))), found = [];
    for (let n = Math.ceil(low / step); n <= Math.floor(high / step); n += 1) found.push([n * step, (n * step).toFixed(digits)]);
    return found;
  }

  const told = (value, reach) => {
    const digits = Math.max(0, Math.min(9, 4 - Math.ceil(Math.log10(reach || 1))));
    return String(Number(value.toFixed(digits)));
  };

  // -- pictures: what is in the page once, read back as numbers, and drawn for a stretch of time

  const place = (s) => ((s - range[0]) / (range[1] - range[0])) * UNITS;
  const clipped = (units) => Math.min(Math.max(units, -5), UNITS + 5);

  function stretches(svg) {
    return all("rect", svg).map((el) => ({ el, x: +el.getAttribute("x"), width: +el.getAttribute("width"), kind: el.parentNode.getAttribute("class") }));
  }

  function drawStretches(rects) {
    for (const { el, x, width } of rects) {
      const from = place(x), to = place(x + width);
      if (to < -1 || from > UNITS + 1) { el.setAttribute("display", "none"); continue; }
      el.removeAttribute("display");
      el.setAttribute("x", clipped(from).toFixed(3));
      el.setAttribute("width", Math.max(0, clipped(to) - clipped(from)).toFixed(3));
    }
  }

  function strokes(svg, what) {
    return all(what, svg).map((el) => {
      const d = el.getAttribute("d"), first = /^M\S+ (\S+?)V([\d.]+)/.exec(d);
      const xs = d.slice(1).split("M").map(parseFloat);
      return { el, xs, top: +first[1], bottom: +first[2] };
    });
  }

  function drawStrokes(paths, scale) {
    for (const { el, xs, top, bottom } of paths) {
      const seen = xs.filter((x) => x >= range[0] && x <= range[1]);
      el.setAttribute("d", seen.map((x) => `M${place(x).toFixed(3)} ${top * scale}V${bottom * scale}`).join(""));
    }
  }

  function span(text, left) {
    const el = make("span", { textContent: text });
    el.style.left = `${left / (UNITS / 100)}%`;
    if (left > NEAR_END * UNITS) el.className = "end";
    return el;
  }

  function drawTicks(box, withUtc) {
    box.replaceChildren(...timeTicks(range[0], range[1], box.clientWidth < 500 ? 4 : 7).map(([s, text, digits]) => {
      const el = span(text, place(s));
      if (withUtc && dated) el.append(make("small", { textContent: utc(data.begin + s, digits) }));
      return el;
    }));
  }

  const LETTERS = { "s-initialising": "I", "s-pre-operational": "P", "s-stopped": "S", "s-lost": "L" };

  class Lane {
    constructor(area) {
      this.area = area;
      this.svg = one("svg", area);
      this.height = this.svg.viewBox.baseVal.height;
      this.rects = stretches(this.svg);
      this.paths = strokes(this.svg, "path");
      this.flags = all(".flag", area).map((el) => ({ el, at: +el.dataset.at }));
    }
    draw() {
      this.svg.setAttribute("viewBox", `0 0 ${UNITS} ${this.height}`);
      drawStretches(this.rects);
      drawStrokes(this.paths, 1);
      this.fit();
    }
    /** What depends on the width of the screen. */
    fit() {
      if (!this.area.clientWidth) return;
      this.letter();
      this.stack();
    }
    letter() {
      const least = (13 / this.area.clientWidth) * UNITS;
      all(".letter", this.area).forEach((el) => el.remove());
      for (const { x, width, kind } of this.rects.slice(0, 400)) {
        const from = Math.max(place(x), 0), to = Math.min(place(x + width), UNITS);
        if (!LETTERS[kind] || to - from < least) continue;
        const el = span(LETTERS[kind], from);
        el.className = "letter";
        el.setAttribute("aria-hidden", "true");
        this.area.append(el);
      }
    }
    /** Flags that would cover one another go below one another, as far as there is room. */
    stack() {
      if (!this.flags.length) return;
      const ends = [], wide = (26 / this.area.clientWidth) * UNITS;
      for (const { el, at } of this.flags) {
        const left = Math.min(place(at), UNITS - wide);
        let row = ends.findIndex((end) => end <= left);
        if (row < 0) row = ends.length;
        el.hidden = place(at) < 0 || place(at) > UNITS || row >= 4;
        if (el.hidden) continue;
        ends[row] = left + wide;
        el.style.left = `${left / 10}%`;
        el.style.setProperty("--row", row);
      }
      this.area.parentNode.style.setProperty("--rows", Math.max(ends.length, 1));
    }
    words(s) {
      const here = this.rects.filter((r) => r.x <= s && s < r.x + r.width).pop();
      return here ? here.kind.slice(2).toUpperCase() : "";
    }
  }

  function points(el, high) {
    const xs = [], ys = [];
    for (const part of el.getAttribute("d").split("M")) {
      const numbers = part.trim().split(" ");
      for (let i = 0; i + 1 < numbers.length; i += 2) { xs.push(+numbers[i]); ys.push(high - numbers[i + 1]); }
      xs.push(NaN); ys.push(NaN);
    }
    return { xs, ys };
  }

  class Plot {
    constructor(figure) {
      this.figure = figure;
      this.area = one(".area", figure);
      this.svg = one("svg", figure);
      this.unit = figure.dataset.unit;
      this.limits = [+figure.dataset.low, +figure.dataset.high];
      this.rects = stretches(this.svg);
      this.marks = strokes(this.svg, ".mark");
      this.items = all(".keys li", figure);
      this.lines = all(".line, .area-of", this.svg).map((el, i) => ({ el, filled: el.classList.contains("area-of"), key: this.items[i] }));
      this.grid = one(".grid", this.svg);
      for (const line of this.lines.filter((each) => !each.filled)) {
        line.dots = line.el.cloneNode();
        line.dots.setAttribute("class", `${line.el.getAttribute("class").replace("line", "dots")}`);
        line.dots.setAttribute("d", "");
        line.el.after(line.dots);
      }
      for (const line of this.lines) {
        line.value = make("b");
        const name = one("span", line.key), hide = make("button", { type: "button" });
        if (this.lines.length > 1) {
          hide.setAttribute("aria-pressed", "true");
          hide.title = "Show or hide this line";
          name.replaceWith(hide);
          hide.append(name);
          hide.addEventListener("click", () => this.toggle(line, hide));
          line.key.addEventListener("pointerenter", () => this.lines.forEach((o) => o.el.classList.toggle("pale", o !== line)));
          line.key.addEventListener("pointerleave", () => this.lines.forEach((o) => o.el.classList.remove("pale")));
        }
        line.key.append(line.value);
      }
    }
    /** The numbers are read when they are first needed: a page of many plots opens at once. */
    load() {
      if (this.loaded) return;
      this.loaded = true;
      for (const line of this.lines) Object.assign(line, points(line.el, this.limits[1]));
    }
    toggle(line, button) {
      line.hidden = !line.hidden;
      button.setAttribute("aria-pressed", String(!line.hidden));
      for (const el of [line.el, line.dots]) if (el) el.classList.toggle("off", line.hidden);
      this.draw();
    }
    reach() {
      const zoomed = range !== whole;
      if (!zoomed && !this.lines.some((line) => line.hidden)) return this.limits;
      let low = Infinity, high = -Infinity;
      for (const { xs, ys, hidden } of this.lines) {
        if (hidden) continue;
        for (let i = 0; i < xs.length; i += 1) if (xs[i] >= range[0] && xs[i] <= range[1]) { low = Math.min(low, ys[i]); high = Math.max(high, ys[i]); }
      }
      if (!(high > low)) {
        if (!isFinite(low)) return this.limits;
        const room = Math.abs(low) * 0.01 || (this.limits[1] - this.limits[0]) * 0.05;
        return [low - room, high + room];
      }
      const room = high - low;
      return [low - 0.06 * room, high + 0.14 * room];
    }
    draw() {
      this.load();
      const [low, high] = this.reach(), tall = UNITS / (high - low);
      this.svg.setAttribute("viewBox", `0 0 ${UNITS} ${UNITS}`);
      drawStretches(this.rects);
      for (const { el } of this.rects) el.setAttribute("height", UNITS);
      drawStrokes(this.marks, UNITS / (this.limits[1] - this.limits[0]));
      const down = (value) => Math.min(Math.max((high - value) * tall, -9 * UNITS), 9 * UNITS);
      for (const line of this.lines) {
        line.el.setAttribute("d", line.filled ? outline(line, down) : stroke(line, down));
        if (line.dots) line.dots.setAttribute("d", samples(line, down));
      }
      const ticks = valueTicks(low, high, 5, this.unit);
      this.grid.setAttribute("d", ticks.map(([value]) => `M0 ${down(value).toFixed(2)}H${UNITS}`).join(""));
      one(".values", this.area).replaceChildren(...ticks.map(([value, text]) => {
        const el = make("span", { textContent: text });
        el.style.top = `${down(value) / 10}%`;
        return el;
      }));
      drawTicks(one(".ticks", this.area), false);
    }
    read(s) {
      this.load();
      const reach = this.limits[1] - this.limits[0], near = (range[1] - range[0]) * 0.003, words = [];
      for (const { xs, ys, value, filled, hidden, key } of this.lines) {
        if (filled || hidden) continue;
        const best = nearest(xs, s, near);
        const text = best < 0 ? "" : `${told(ys[best], reach)} ${this.unit}`;
        value.textContent = text;
        if (text) words.push(`${one("span", key).textContent} ${text}`);
      }
      return words.join(", ");
    }
  }

  /** The sample next to a moment: one that a line leads to from before or after it, or one within reach. */
  function nearest(xs, s, reach) {
    let best = -1, off = Infinity;
    for (let i = 0; i < xs.length; i += 1) {
      const d = Math.abs(xs[i] - s), joined = d <= reach || (xs[i] <= s && xs[i + 1] >= s) || (xs[i] >= s && xs[i - 1] <= s);
      if (joined && d < off) { off = d; best = i; }
    }
    return best;
  }

  /** A line within the range; what crosses an edge is cut there, so that no far end is rounded. */
  function stroke({ xs, ys }, down) {
    const edge = (range[1] - range[0]) * 0.02, from = range[0] - edge, to = range[1] + edge;
    const parts = [];
    const at = (x, y) => `${place(x).toFixed(2)} ${down(y).toFixed(2)}`;
    const cut = (i, j, x) => at(x, ys[i] + ((ys[j] - ys[i]) * (x - xs[i])) / (xs[j] - xs[i]));
    const side = (x) => (x < from ? -1 : x > to ? 1 : 0);
    for (let i = 0; i < xs.length; i += 1) {
      if (isNaN(xs[i])) continue;
      const here = side(xs[i]), joined = i > 0 && !isNaN(xs[i - 1]), before = joined ? side(xs[i - 1]) : here;
      if (joined && before && here !== before) parts.push(`M${cut(i - 1, i, before < 0 ? from : to)}`);
      if (!here) parts.push(`${joined ? (before ? "L" : " ") : "M"}${at(xs[i], ys[i])}`);
      else if (joined && here !== before) parts.push(`L${cut(i - 1, i, here < 0 ? from : to)}`);
    }
    return parts.join("");
  }

  /** Single samples, where there are few enough to be told apart. */
  function samples({ xs, ys }, down) {
    const seen = [];
    for (let i = 0; i < xs.length; i += 1) if (xs[i] >= range[0] && xs[i] <= range[1]) seen.push(i);
    return seen.length > 150 || range === whole ? "" : seen.map((i) => `M${place(xs[i]).toFixed(2)} ${down(ys[i]).toFixed(2)}h0`).join("");
  }

  function outline({ xs, ys }, down) {
    const parts = [];
    let pen = "M";
    for (let i = 0; i < xs.length; i += 1) {
      if (isNaN(xs[i])) { pen = "M"; continue; }
      parts.push(`${pen}${Math.min(Math.max(place(xs[i]), -50 * UNITS), 50 * UNITS).toFixed(2)} ${down(ys[i]).toFixed(2)}`);
      pen = " ";
    }
    return parts.join("");
  }

  const lanes = all(".lane .area").map((area) => new Lane(area));
  const plots = all("figure.plot").map((figure) => new Plot(figure));
  const pictures = [...lanes, ...plots];
  const axes = all(".axis .ticks");
  const stale = new Set();

  const inSight = (el) => { const box = el.getBoundingClientRect(); return box.height > 0 && box.bottom > -400 && box.top < innerHeight + 400; };
  const redraw = (picture) => { if (stale.delete(picture)) picture.draw(); };
  const redrawAll = () => [...stale].forEach(redraw);
  let later = 0;

  function show(from, to) {
    if (!(to - from >= LEAST)) { const c = (from + to) / 2; from = c - LEAST / 2; to = c + LEAST / 2; }
    const wide = Math.min(to - from, data.seconds);
    from = Math.min(Math.max(from, 0), data.seconds - wide);
    range = wide >= data.seconds ? whole : [from, from + wide];
    axes.forEach((box) => drawTicks(box, true));
    pictures.forEach((picture) => stale.add(picture));
    pictures.filter((picture) => picture instanceof Lane || inSight(picture.area)).forEach(redraw);
    clearTimeout(later);
    later = setTimeout(redrawAll, 60);
    say();
  }

  function say() {
    const shown = one("#shown");
    if (!shown) return;
    const digits = places(range[1] - range[0]);
    const [a, b] = range.map((s) => captureTime(data.begin + s, digits));
    const day = dated ? `, ${utc(data.begin + range[0], digits)} to ${utc(data.begin + range[1], digits)} UTC` : "";
    shown.replaceChildren(`${range === whole ? "All" : "Shown"}: ${a} to ${b}`, make("span", { className: "wide", textContent: day }));
  }

  // -- pointer and keys

  let cursor = null;
  for (const { area } of pictures) {
    area.append(make("div", { className: "cursor" }));
  }

  function point(s) {
    cursor = s;
    for (const { area } of pictures) {
      if (!inSight(area)) continue;
      const line = area.lastElementChild.classList.contains("cursor") ? area.lastElementChild : one(".cursor", area);
      line.style.display = s === null ? "none" : "block";
      if (s !== null) line.style.left = `${place(s) / 10}%`;
    }
    const where = one("#cursor");
    if (where) where.textContent = s === null ? "" : `Cursor ${moment(s, places(range[1] - range[0]))}`;
    if (s !== null) plots.filter((plot) => inSight(plot.area)).forEach((plot) => plot.read(s));
  }

  const areaOf = (event) => (event.target.closest ? event.target.closest(".lane .area, .plot .area") : null);
  function secondAt(area, event) {
    const box = area.getBoundingClientRect();
    const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1);
    return range[0] + share * (range[1] - range[0]);
  }

  let drag = null, frame = 0;
  document.addEventListener("pointermove", (event) => {
    const area = drag ? drag.area : areaOf(event);
    if (!area && cursor === null) return;
    cancelAnimationFrame(frame);
    frame = requestAnimationFrame(() => point(area ? secondAt(area, event) : null));
    if (!drag) return;
    const box = drag.area.getBoundingClientRect(), x = Math.min(Math.max(event.clientX, box.left), box.right);
    drag.moved = drag.moved || Math.abs(x - drag.x) > 4;
    drag.box.style.left = `${Math.min(x, drag.x) - box.left}px`;
    drag.box.style.width = `${Math.abs(x - drag.x)}px`;
  });
  document.addEventListener("pointerdown", (event) => {
    const area = areaOf(event);
    if (!area || event.button !== 0 || event.target.closest("a")) return;
    drag = { area, x: event.clientX, from: secondAt(area, event), box: make("div", { className: "chosen" }), moved: false };
    area.append(drag.box);
    if (event.pointerType !== "touch") event.preventDefault();
  });
  const release = (event) => {
    if (!drag) return;
    const { area, from, box, moved } = drag, to = secondAt(area, event);
    box.remove();
    drag = null;
    if (moved && event.type === "pointerup") show(Math.min(from, to), Math.max(from, to));
  };
  document.addEventListener("pointerup", release);
  document.addEventListener("pointercancel", release);
  document.addEventListener("dblclick", (event) => { if (areaOf(event)) show(...whole); });
  document.addEventListener("wheel", (event) => {
    const area = areaOf(event);
    if (!area || !event.ctrlKey) return;
    event.preventDefault();
    zoom(secondAt(area, event), event.deltaY > 0 ? 1.6 : 1 / 1.6);
  }, { passive: false });

  function zoom(around, factor) {
    show(around - (around - range[0]) * factor, around + (range[1] - around) * factor);
  }

  /** A handle for the keyboard and for those who listen: moves the cursor and says what is there. */
  function handle(area, name, words) {
    const el = make("div", { className: "hand", tabIndex: 0 });
    const attributes = { role: "slider", "aria-label": name, "aria-valuemin": 0, "aria-valuemax": data.seconds, "aria-valuenow": 0,
      "aria-valuetext": moment(0, 3), "aria-description": "Arrow keys move, plus and minus zoom, 0 shows the whole capture" };
    Object.entries(attributes).forEach(([key, value]) => el.setAttribute(key, value));
    el.addEventListener("keydown", (event) => {
      const wide = range[1] - range[0], s = cursor === null ? range[0] : cursor;
      const moves = { ArrowLeft: -0.01, ArrowDown: -0.01, ArrowRight: 0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1 };
      let at = null;
      if (event.key in moves) at = s + moves[event.key] * wide * (event.shiftKey ? 0.1 : 1);
      else if (event.key === "Home") at = range[0];
      else if (event.key === "End") at = range[1];
      else if (event.key === "+") zoom(s, 0.5);
      else if (event.key === "-") zoom(s, 2);
      else if (event.key === "0") show(...whole);
      else if (event.key === "Escape") { point(null); return; }
      else return;
      event.preventDefault();
      if (at !== null) {
        at = Math.min(Math.max(at, 0), data.seconds);
        if (at < range[0] || at > range[1]) show(at - wide / 2, at + wide / 2);
      }
      point(at === null ? s : at);
      el.setAttribute("aria-valuenow", String(cursor));
      el.setAttribute("aria-valuetext", [moment(cursor, places(range[1] - range[0])), words(cursor)].filter(Boolean).join(": "));
    });
    area.append(el);
  }

  function statesAt(s) {
    const loud = [], box = one("#lanes");
    for (const lane of lanes) {
      if (!box.contains(lane.area) || lane.flags.length) continue;
      const state = lane.words(s);
      if (state && state !== "OPERATIONAL") loud.push(`${one(".label", lane.area.parentNode).textContent} ${state}`);
    }
    return loud.length ? loud.slice(0, 8).join(", ") : "all nodes OPERATIONAL";
  }

  for (const plot of plots) handle(plot.area, `Moment in ${one("figcaption", plot.figure).textContent}`, (s) => plot.read(s));
  if (one("#lanes .axis")) handle(one("#lanes .axis"), "Moment in the timeline", statesAt);

  // -- links, filter and details

  function open(hash) {
    let target = null;
    try { target = document.getElementById(decodeURIComponent(hash.slice(1))); } catch { return; }
    for (let el = target; el; el = el.parentElement) if (el.tagName === "DETAILS") el.open = true;
  }

  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    if (link) open(link.getAttribute("href"));
    if (link && "from" in link.dataset) {
      const from = +link.dataset.from, to = "to" in link.dataset ? +link.dataset.to : from;
      const room = Math.max((to - from) * data.room, data.least_room);
      show(from - room, to + room);
      point(from);
    }
    const button = event.target.closest("[data-zoom]");
    if (button) {
      const [a, b] = range, wide = b - a, c = (a + b) / 2;
      const moves = { in: [c - wide / 4, c + wide / 4], out: [c - wide, c + wide], back: [a - wide / 2, b - wide / 2], on: [a + wide / 2, b + wide / 2], all: whole };
      show(...moves[button.dataset.zoom]);
    }
  });
  addEventListener("hashchange", () => open(location.hash));
  if (location.hash) open(location.hash);

  const form = one(".filter");
  function filter() {
    const wanted = new FormData(form), words = String(wanted.get("words")).trim().toLowerCase().split(/\s+/);
    const severities = wanted.getAll("severity"), node = wanted.get("node");
    const stories = all(".stories > li");
    let left = 0;
    for (const story of stories) {
      const text = story.textContent.toLowerCase();
      const fits = severities.includes(story.dataset.severity) && (!node || story.dataset.nodes.split(" ").includes(node)) && words.every((word) => text.includes(word));
      story.hidden = !fits;
      left += fits;
      const flag = one(`.flag[href="#${story.id}"]`);
      if (flag) flag.classList.toggle("off", !fits);
    }
    const rest = one("details.rest");
    if (rest && left < stories.length) rest.open = true;
    one("output", form).textContent = left < stories.length ? `${left} of ${stories.length} findings` : "";
  }
  if (form) {
    form.hidden = false;
    form.addEventListener("input", filter);
    form.addEventListener("submit", (event) => event.preventDefault());
  }
  const only = one("#only-trouble");
  if (only) only.addEventListener("change", () => one("#lanes").classList.toggle("only-trouble", only.checked));
  const everything = one("#everything");
  if (everything) everything.addEventListener("click", () => {
    const open_ = everything.getAttribute("aria-pressed") !== "true";
    everything.setAttribute("aria-pressed", String(open_));
    all("main details").forEach((el) => { el.open = open_ || el.classList.contains("rest"); });
  });

  const fit = () => lanes.forEach((lane) => lane.fit());
  addEventListener("resize", fit);
  document.addEventListener("toggle", (event) => { if (event.target.open) fit(); }, true);
  fit();
  addEventListener("scroll", () => { if (stale.size) pictures.filter((p) => stale.has(p) && inSight(p.area)).forEach(redraw); }, { passive: true });
  let closed = [];
  addEventListener("beforeprint", () => { redrawAll(); closed = all("details.rest:not([open])"); closed.forEach((el) => { el.open = true; }); });
  addEventListener("afterprint", () => closed.forEach((el) => { el.open = false; }));
  say();
  document.documentElement.dataset.ready = "true";
})();
