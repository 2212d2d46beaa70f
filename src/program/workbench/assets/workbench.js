// Keeps an open page true: it hears of changes, of other tabs too, and draws again what they touch. The live picture is drawn here.
"use strict";
(() => {
  // Figures in parts that were replaced.
  document.addEventListener("htmx:load", (e) => window.radcamFigures && window.radcamFigures(e.detail.elt));
  // What was added is judged at the top of the page.
  document.addEventListener("htmx:afterSettle", (e) => {
    const path = e.detail.pathInfo?.requestPath ?? "";
    if (path === "/model/add" || path === "/model/own") document.querySelector("#main").scrollIntoView();
  });
  // The cell that is looked at stays in view, with its new numbers.
  let cell = "";
  document.addEventListener("htmx:afterRequest", (e) => { const path = e.detail.pathInfo?.requestPath ?? ""; if (path.startsWith("/cell?")) cell = path; });
  document.addEventListener("htmx:load", (e) => {
    if (cell && e.detail.elt.id === "main" && document.querySelector("#cell")) htmx.ajax("GET", cell, { target: "#cell", swap: "innerHTML" });
  });
  // What a request was refused for stands until the next one succeeds; that nobody answers, until somebody does.
  const at = (id) => document.querySelector(id);
  const say = (text) => { at("#said").textContent = text; at("#said").classList.toggle("error", text !== ""); };
  const GONE = "radcam workbench does not answer: it was ended, or runs no more.";
  document.addEventListener("htmx:sendError", () => say(GONE));
  document.addEventListener("htmx:responseError", (e) => say(e.detail.xhr.responseText || "The request failed."));
  document.addEventListener("htmx:afterRequest", (e) => { if (e.detail.successful) say(""); });
  // The error, for whoever does not see it change.
  let error = "";
  document.addEventListener("htmx:load", (e) => {
    const now = at("#error")?.innerText ?? "";
    if (e.detail.elt.id === "main" && now && now !== error) {
      if (error) at("#heard").textContent = `Error ${now}, was ${error}. ${at("h1")?.innerText ?? ""}`;
      error = now;
    }
  });
  // The picture of residuals is one stop of the keyboard; arrow keys move in it.
  const stops = (root) => root.querySelectorAll("table.heat").forEach((t) => t.querySelectorAll("button.cell").forEach((b, k) => { b.tabIndex = k ? -1 : 0; }));
  document.addEventListener("htmx:load", (e) => stops(e.detail.elt));
  addEventListener("DOMContentLoaded", () => { stops(document); error = at("#error")?.innerText ?? ""; });
  document.addEventListener("keydown", (e) => {
    const cell = e.target.closest?.("table.heat button.cell");
    const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[e.key];
    if (!cell || !move) return;
    e.preventDefault();
    const rows = [...cell.closest("table").querySelectorAll("tbody tr")].map((r) => [...r.querySelectorAll("button.cell")]);
    const row = rows.findIndex((r) => r.includes(cell));
    const next = move[0] ? rows[row + move[0]]?.[Math.min(rows[row].indexOf(cell), rows[row + move[0]].length - 1)] : rows[row][rows[row].indexOf(cell) + move[1]];
    if (next) { cell.tabIndex = -1; next.tabIndex = 0; next.focus(); }
  });

  const typing = () => { const a = document.activeElement; return a && a.closest("#main") && /INPUT|SELECT|TEXTAREA/.test(a.tagName); };
  // Replaced where more than its progress differs: what is under the pointer or has the keyboard stays.
  const status = async () => {
    const answer = await fetch("/status");
    if (!answer.ok) throw new Error(await answer.text());
    const now = new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("#status"), was = at("#status");
    if (now.dataset.key === was.dataset.key) {
      const [a, b] = [was.querySelector(".job"), now.querySelector(".job")];
      if (a && b) {
        a.querySelector(".what").textContent = b.querySelector(".what").textContent;
        if (b.querySelector("progress").hasAttribute("value")) a.querySelector("progress").value = b.querySelector("progress").value;
      }
      return;
    }
    const focus = document.activeElement?.id;
    was.replaceWith(now);
    htmx.process(now);
    if (focus && now.querySelector("#" + CSS.escape(focus))) now.querySelector("#" + CSS.escape(focus)).focus();
  };
  const stale = (model) => { const main = at("#main"); return main && main.dataset.room && +main.dataset.model !== model; };
  const refresh = async (model) => {
    await status();
    if (stale(model) && !typing()) {
      const open = [...at("#main").querySelectorAll("details")].map((d) => d.open);
      await htmx.ajax("GET", at("#main").dataset.room + "?part=1", { target: "#main", swap: "outerHTML" });
      document.querySelectorAll("#main details").forEach((d, k) => { d.open = open[k] ?? false; });
    }
  };
  // What was not drawn again under the user's hands is, once they leave it.
  let last = 0;
  document.addEventListener("focusout", () => setTimeout(() => { if (stale(last) && !typing()) refresh(last).catch(() => {}); }, 100));
  const hear = async () => {
    let seen = 0, idle = true;
    for (;;) {
      try {
        const answer = await fetch("/events?seen=" + seen);
        if (!answer.ok) throw new Error(await answer.text());
        const [model, all, busy] = (await answer.text()).split(",").map(Number);
        // After work has ended, once more.
        if (all !== seen || busy || !idle || stale(model)) await refresh(model);
        [seen, idle, last] = [all, !busy, model];
        if (at("#said").textContent === GONE) say("");
      } catch (e) {
        say(e instanceof TypeError ? GONE : e.message);
        await new Promise((r) => setTimeout(r, 2000));
      }
    }
  };
  addEventListener("DOMContentLoaded", hear);

  // The live picture.
  const live = async () => {
    const canvas = document.querySelector("#live");
    if (!canvas) return;
    const of = (id) => document.querySelector("#live-" + id);
    const context = canvas.getContext("2d");
    let after = 0, image = null, times = [];
    for (;;) {
      try {
        const answer = await fetch("/live?after=" + after);
        if (!answer.ok) throw new Error(await answer.text());
        const h = (name) => answer.headers.get("x-" + name);
        const pixels = new Uint16Array(await answer.arrayBuffer());
        const [width, height, full] = [+h("width"), +h("height"), +h("full")];
        if (canvas.width !== width || canvas.height !== height || !image) {
          [canvas.width, canvas.height] = [width, height];
          image = context.createImageData(width, height);
        }
        let [low, high] = [0, full];
        if (of("stretch").checked) {
          [low, high] = [65535, 0];
          for (const v of pixels) { if (v < low) low = v; if (v > high) high = v; }
        }
        const mark = of("mark").checked, out = new Uint32Array(image.data.buffer), scale = 255 / Math.max(1, high - low);
        for (let i = 0; i < pixels.length; i++) {
          const v = pixels[i], g = Math.min(255, Math.max(0, (v - low) * scale)) | 0;
          out[i] = mark && v >= full ? 0xff2020ff : 0xff000000 | (g << 16) | (g << 8) | g;
        }
        context.putImageData(image, 0, 0);
        after = +h("number");
        times.push(performance.now());
        times = times.filter((t) => t > times[times.length - 1] - 2000);
        for (const name of ["frame", "mean", "variance", "saturated"]) of(name).textContent = h(name) === "NaN" ? "–" : h(name);
        if (times.length > 2) of("rate").textContent = (((times.length - 1) * 1000) / (times[times.length - 1] - times[0])).toFixed(1);
        of("error").textContent = "";
      } catch (e) {
        of("error").textContent = e.message;
        await new Promise((r) => setTimeout(r, 1000));
      }
      if (document.hidden) await new Promise((r) => document.addEventListener("visibilitychange", r, { once: true }));
    }
  };
  addEventListener("DOMContentLoaded", live);
})();
