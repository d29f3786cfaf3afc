"use strict";
(() => {
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const whole = [data.begin, data.begin + data.seconds];
  let range = whole;
  let moving = false;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const lanes = [...document.querySelectorAll(".lane svg")];
  const plots = [];

  const toX = (s) => (data.start_ms === null ? s : new Date(data.start_ms + s * 1000).toISOString());
  const fromX = (x) => (data.start_ms === null ? +x : (Date.parse(String(x).replace(" ", "T") + "Z") - data.start_ms) / 1000);
  const two = (n) => String(n).padStart(2, "0");

  function written(s) {
    const ms = Math.round(s * 1000), m = Math.floor(ms / 60000), h = Math.floor(m / 60);
    const rest = two(Math.floor(ms / 1000) % 60) + "." + String(ms % 1000).padStart(3, "0");
    return h ? `${h}:${two(m % 60)}:${rest}` : `${m}:${rest}`;
  }

  function show(from, to) {
    const least = Math.min(0.002, data.seconds);
    if (to - from < least) { const c = (from + to) / 2; from = c - least / 2; to = c + least / 2; }
    range = [Math.max(whole[0], from), Math.min(whole[1], to)];
    const span = range[1] - range[0];
    for (const svg of lanes) svg.setAttribute("viewBox", `${range[0]} 0 ${span} 20`);
    const ticks = document.querySelectorAll(".axis span");
    ticks.forEach((tick, i) => { tick.textContent = written(range[0] + (span * i) / (ticks.length - 1)); });
    moving = true;
    Promise.all(plots.map((p) => Plotly.relayout(p, { "xaxis.range": range.map(toX) }))).finally(() => { moving = false; });
  }

  function look() {
    const style = getComputedStyle(document.documentElement);
    const v = (name) => style.getPropertyValue(name).trim();
    const axis = { gridcolor: v("--line"), zerolinecolor: v("--line"), linecolor: v("--line") };
    return { fg: v("--fg"), dim: v("--dim"), axis };
  }

  function layout(plot) {
    const { fg, dim, axis } = look();
    const x = { ...axis, type: data.start_ms === null ? "linear" : "date", range: range.map(toX), title: { text: data.start_ms === null ? "s" : "UTC" } };
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: fg, size: 12 },
      margin: { l: 60, r: 12, t: 8, b: 44 }, hovermode: "closest", modebar: { orientation: "v", bgcolor: "rgba(0,0,0,0)", color: dim, activecolor: fg },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, showlegend: true,
      xaxis: x, yaxis: { ...axis, title: { text: plot.y_title }, ...(plot.y_range ? { range: plot.y_range } : {}) },
      shapes: plot.bands.map(([a, b, colour]) => ({
        type: "rect", xref: "x", yref: "paper", x0: toX(a), x1: toX(b), y0: 0, y1: 1, fillcolor: colour, opacity: 0.14, line: { width: 1, color: colour } })),
    };
  }

  function traces(plot) {
    return plot.traces.map((t) => ({ ...t, x: t.x.map(toX) }));
  }

  function draw() {
    for (const plot of data.plots) {
      const div = document.getElementById(plot.id);
      Plotly.newPlot(div, traces(plot), layout(plot), { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
      plots.push(div);
      div.on("plotly_relayout", (event) => {
        if (moving) return;
        if ("xaxis.range[0]" in event) show(fromX(event["xaxis.range[0]"]), fromX(event["xaxis.range[1]"]));
        else if (event["xaxis.autorange"]) show(...whole);
      });
    }
  }

  document.addEventListener("click", (event) => {
    const link = event.target.closest("[data-from]");
    if (link) {
      const from = +link.dataset.from, to = +link.dataset.to;
      const room = Math.max((to - from) * 0.5, data.seconds * 0.005, 0.05);
      show(from - room, to + room);
    }
    const button = event.target.closest("[data-zoom]");
    if (button) {
      const [a, b] = range, span = b - a, c = (a + b) / 2;
      const moves = { in: [c - span / 4, c + span / 4], out: [c - span, c + span], back: [a - span / 2, b - span / 2], on: [a + span / 2, b + span / 2], all: whole };
      show(...moves[button.dataset.zoom]);
    }
  });
  const opened = () => { const t = document.getElementById(decodeURIComponent(location.hash.slice(1))); if (t && t.tagName === "DETAILS") t.open = true; };
  addEventListener("hashchange", opened);
  opened();
  dark.addEventListener("change", () => data.plots.forEach((plot) => Plotly.relayout(plot.id, layout(plot))));
  draw();
  document.documentElement.dataset.ready = "true";
})();
