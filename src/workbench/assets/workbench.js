// Keeps an open page true: it hears of changes, of other tabs too, and draws again what they touch. The live picture is drawn here.
"use strict";
(() => {
  // Figures in parts that were replaced.
  document.addEventListener("htmx:load", (e) => window.radcamFigures && window.radcamFigures(e.detail.elt));
  // The cell that is looked at stays in view, with its new numbers.
  let cell = "";
  document.addEventListener("htmx:afterRequest", (e) => { const path = e.detail.pathInfo?.requestPath ?? ""; if (path.startsWith("/cell?")) cell = path; });
  document.addEventListener("htmx:load", (e) => {
    if (cell && e.detail.elt.id === "main" && document.querySelector("#cell")) htmx.ajax("GET", cell, { target: "#cell", swap: "innerHTML" });
  });
  // An answer that is no page, such as a lost server, is said.
  const say = (text) => {
    let p = document.querySelector("#status .lost");
    if (!text) { if (p) p.remove(); return; }
    if (!p) { p = document.createElement("p"); p.className = "error lost"; p.setAttribute("role", "alert"); document.querySelector("#status").append(p); }
    p.textContent = text;
  };
  document.addEventListener("htmx:sendError", () => say("radcam workbench does not answer: it was ended, or runs no more."));
  document.addEventListener("htmx:responseError", (e) => say(e.detail.xhr.responseText || "The request failed."));

  const typing = () => { const a = document.activeElement; return a && a.closest("#main") && /INPUT|SELECT|TEXTAREA/.test(a.tagName); };
  const refresh = async (model) => {
    await htmx.ajax("GET", "/status", { target: "#status", swap: "outerHTML" });
    const main = document.querySelector("#main");
    if (main && main.dataset.room && +main.dataset.model !== model && !typing()) {
      const open = [...main.querySelectorAll("details")].map((d) => d.open);
      await htmx.ajax("GET", main.dataset.room + "?part=1", { target: "#main", swap: "outerHTML" });
      document.querySelectorAll("#main details").forEach((d, k) => { d.open = open[k] ?? false; });
    }
  };
  const hear = async () => {
    let seen = 0, idle = true;
    for (;;) {
      try {
        const answer = await fetch("/events?seen=" + seen);
        if (!answer.ok) throw new Error(await answer.text());
        const [model, all, busy] = (await answer.text()).split(",").map(Number);
        // After work has ended, once more.
        if (all !== seen || busy || !idle) await refresh(model);
        [seen, idle] = [all, !busy];
        say("");
      } catch {
        say("radcam workbench does not answer: it was ended, or runs no more.");
        await new Promise((r) => setTimeout(r, 2000));
      }
    }
  };
  addEventListener("DOMContentLoaded", hear);

  // The live picture.
  const live = async () => {
    const canvas = document.querySelector("#live");
    if (!canvas) return;
    const at = (id) => document.querySelector("#live-" + id);
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
        if (at("stretch").checked) {
          [low, high] = [65535, 0];
          for (const v of pixels) { if (v < low) low = v; if (v > high) high = v; }
        }
        const mark = at("mark").checked, out = new Uint32Array(image.data.buffer), scale = 255 / Math.max(1, high - low);
        for (let i = 0; i < pixels.length; i++) {
          const v = pixels[i], g = Math.min(255, Math.max(0, (v - low) * scale)) | 0;
          out[i] = mark && v >= full ? 0xff2020ff : 0xff000000 | (g << 16) | (g << 8) | g;
        }
        context.putImageData(image, 0, 0);
        after = +h("number");
        times.push(performance.now());
        times = times.filter((t) => t > times[times.length - 1] - 2000);
        for (const name of ["frame", "mean", "variance", "saturated"]) at(name).textContent = h(name) === "NaN" ? "–" : h(name);
        if (times.length > 2) at("rate").textContent = (((times.length - 1) * 1000) / (times[times.length - 1] - times[0])).toFixed(1);
        at("error").textContent = "";
      } catch (e) {
        at("error").textContent = e.message;
        await new Promise((r) => setTimeout(r, 1000));
      }
      if (document.hidden) await new Promise((r) => document.addEventListener("visibilitychange", r, { once: true }));
    }
  };
  addEventListener("DOMContentLoaded", live);
})();
