// Draws the figures of a page with uPlot, from the numbers in their CSV links: values under the pointer, zoom by dragging. Without this script, and
// on paper, the drawings that are in the page are shown.
"use strict";
(() => {
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // Rows of CSV: fields may be quoted.
  const rows = (text) => text.trim().split("\n").map((line) => {
    const out = [];
    for (let i = 0; i <= line.length; ) {
      if (line[i] === '"') {
        let field = "";
        for (i++; i < line.length && (line[i] !== '"' || line[i + 1] === '"'); i++) field += line[line[i] === '"' ? ++i : i];
        out.push(field);
        i += 2;
      } else {
        const end = line.indexOf(",", i) < 0 ? line.length : line.indexOf(",", i);
        out.push(line.slice(i, end));
        i = end + 1;
      }
    }
    return out;
  });

  const short = (v) => {
    if (v == null || !isFinite(v)) return "";
    const a = Math.abs(v);
    return a !== 0 && (a >= 1e6 || a < 1e-3) ? v.toExponential(3) : String(+v.toPrecision(5));
  };

  // One table of x and y for each series; x that occur twice are set apart by less than is drawn.
  const tables = (figure, plot) => {
    const url = figure.querySelector("a.csv").href;
    const all = rows(decodeURIComponent(url.slice(url.indexOf(",") + 1))).slice(1);
    return plot.series.map((s) => {
      const points = all.filter((r) => r[0] === s.label).map((r) => r.slice(1).map((v) => (v === "" ? NaN : +v)));
      // Bins of a histogram that hold nothing stand at the floor of a logarithmic axis.
      const floor = Math.min(...points.map((p) => p[1]).filter((y) => y > 0)) / 2;
      points.forEach((p) => { if (plot.y.log && s.shape === "steps" && p[1] === 0) [p[1], p[3]] = [floor, true]; });
      const sound = points.filter(([x, y]) => isFinite(x) && isFinite(y) && (!plot.x.log || x > 0) && (!plot.y.log || y > 0));
      sound.sort((a, b) => a[0] - b[0]);
      sound.forEach((p, k) => { if (k > 0 && p[0] <= sound[k - 1][0]) p[0] = sound[k - 1][0] + Math.max(Math.abs(p[0]), 1e-9) * 1e-12; });
      return sound;
    });
  };

  const draw = (figure) => {
    const plot = JSON.parse(figure.dataset.plot);
    const points = tables(figure, plot);
    if (!points.some((p) => p.length)) return;
    const data = uPlot.join(points.map((p) => [p.map((q) => q[0]), p.map((q) => q[1])]));
    const errors = points.map((p) => new Map(p.map((q) => [q[0], q[2]])));
    const empty = points.map((p) => new Set(p.filter((q) => q[3]).map((q) => q[0])));
    const error = (k, x) => { const e = errors[k].get(x); return isFinite(e) ? e : NaN; };
    const colours = plot.series.map((_, k) => style("--c" + (k % 5)));
    const ink = style("--soft"), line = style("--line");
    const series = plot.series.map((s, k) => ({
      label: s.label.replaceAll("_", ""), stroke: colours[k], width: s.shape === "points" ? 0 : 1.5, spanGaps: true, dash: s.shape === "dashed" ? [5, 4] : undefined,
      paths: s.shape === "points" ? () => null : s.shape === "steps" ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear(),
      points: { show: s.shape === "points", size: 6, fill: colours[k] },
      value: (u, v, sidx, idx) => v == null ? "" : idx != null && empty[k].has(u.data[0][idx]) ? "0" : short(v) + (idx != null && isFinite(error(k, u.data[0][idx])) ? " ± " + short(error(k, u.data[0][idx])) : ""),
    }));
    // The nearest point that a series has.
    const near = (u, sidx, at) => {
      const list = u.data[sidx];
      for (let d = 0; d < list.length; d++) {
        if (at - d >= 0 && list[at - d] != null) return at - d;
        if (at + d < list.length && list[at + d] != null) return at + d;
      }
      return at;
    };
    const bars = (u) => {
      const c = u.ctx;
      c.save();
      c.setLineDash([]);
      c.beginPath();
      c.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      c.clip();
      points.forEach((list, k) => {
        if (!u.series[k + 1].show) return;
        const px = (x) => u.valToPos(x, "x", true);
        const py = (y) => u.valToPos(plot.y.log ? Math.max(y, u.scales.y.min) : y, "y", true);
        const known = list.filter((p) => isFinite(p[2]));
        c.strokeStyle = c.fillStyle = colours[k];
        c.lineWidth = devicePixelRatio;
        if (plot.series[k].shape === "points") {
          known.forEach(([x, y, e]) => { c.beginPath(); c.moveTo(px(x), py(y - e)); c.lineTo(px(x), py(y + e)); c.stroke(); });
        } else if (plot.series[k].shape === "line" && known.length > 1) {
          c.globalAlpha = 0.2;
          c.beginPath();
          known.forEach(([x, y, e]) => c.lineTo(px(x), py(y + e)));
          known.toReversed().forEach(([x, y, e]) => c.lineTo(px(x), py(y - e)));
          c.fill();
          c.globalAlpha = 1;
        }
      });
      c.restore();
    };
    const axis = (a) => ({ label: a.title.replaceAll("_", ""), stroke: ink, grid: { stroke: line, width: 1 }, ticks: { stroke: line }, labelSize: 22, font: "11px system-ui", labelFont: "12px system-ui" });
    const height = (wide) => Math.max(200, Math.round(wide * (figure.classList.contains("wide") ? 0.36 : 0.6)));
    // Points at the ends keep off the frame.
    const ends = (u, low, high) => {
      if (plot.x.log) return uPlot.rangeLog(low, high, 10, false);
      const room = high > low ? 0.03 * (high - low) : 1;
      return [low - room, high + room];
    };
    // With the error bars, of what is in view.
    const tall = (u, low, high) => {
      const { min, max } = u.scales.x;
      points.forEach((list, k) => {
        if (plot.series[k].shape !== "points" || !u.series[k + 1].show) return;
        for (const [x, y, e] of list) if (isFinite(e) && (min == null || (x >= min && x <= max))) { low = Math.min(low, y - e); high = Math.max(high, y + e); }
      });
      return uPlot.rangeNum(low ?? 0, high ?? 1, 0.05, true);
    };
    const width = figure.clientWidth;
    const old = figure.querySelector(".uplot");
    if (old) old.remove();
    figure.classList.add("live");
    const room = document.createElement("div");
    figure.querySelector("svg").after(room);
    const u = new uPlot({
      width, height: height(width), series: [{ label: plot.x.title.replaceAll("_", ""), value: (_, v) => short(v) }, ...series],
      scales: { x: { time: false, distr: plot.x.log ? 3 : 1, range: ends }, y: { distr: plot.y.log ? 3 : 1, range: plot.range ?? (plot.y.log ? undefined : tall) } },
      axes: [axis(plot.x), { ...axis(plot.y), size: 62 }],
      cursor: { dataIdx: (u, sidx, at) => (sidx === 0 ? at : near(u, sidx, at)), drag: { x: true, y: false } },
      hooks: { draw: [bars] },
    }, data, room);
    u.root.setAttribute("role", "img");
    u.root.setAttribute("aria-label", figure.querySelector("svg").getAttribute("aria-label"));
    let wide = width;
    new ResizeObserver(() => {
      if (figure.clientWidth && Math.abs(figure.clientWidth - wide) > 4) {
        wide = figure.clientWidth;
        u.setSize({ width: wide, height: height(wide) });
      }
    }).observe(figure);
  };

  const seen = new IntersectionObserver((entries) => entries.forEach((e) => {
    if (e.isIntersecting) { seen.unobserve(e.target); draw(e.target); }
  }), { rootMargin: "400px" });
  const all = (root) => root.querySelectorAll("figure[data-plot]:not(.live)").forEach((f) => seen.observe(f));
  all(document);
  window.radcamFigures = all;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.querySelectorAll("figure.live").forEach((f) => { f.classList.remove("live"); draw(f); }));
})();
