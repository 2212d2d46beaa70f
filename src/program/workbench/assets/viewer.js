// Looks at the pixels of a frame: window and level, zoom, values, histogram, profiles.
"use strict";
addEventListener("DOMContentLoaded", () => {
  const root = document.querySelector("#viewer");
  if (!root) return;
  const $ = (id) => root.querySelector("#v-" + id);
  const canvas = $("image"), context = canvas.getContext("2d");
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  let image = null, bitmap = null, view = { x: 0, y: 0, zoom: 1 }, kept = null;
  const short = (v) => (Number.isInteger(v) ? String(v) : v.toPrecision(6));

  const whole = () => {
    if (!image) return;
    view.zoom = Math.min(canvas.width / image.width, canvas.height / image.height);
    view.x = (image.width - canvas.width / view.zoom) / 2;
    view.y = (image.height - canvas.height / view.zoom) / 2;
  };
  const develop = () => {
    const low = +$("low").value, high = +$("high").value, scale = 255 / (high - low || 1);
    const data = new ImageData(image.width, image.height), out = new Uint32Array(data.data.buffer);
    image.values.forEach((v, i) => { const g = Math.min(255, Math.max(0, (v - low) * scale)) | 0; out[i] = 0xff000000 | (g << 16) | (g << 8) | g; });
    bitmap = document.createElement("canvas");
    [bitmap.width, bitmap.height] = [image.width, image.height];
    bitmap.getContext("2d").putImageData(data, 0, 0);
  };
  const draw = () => {
    context.fillStyle = "#222";
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (!bitmap) return;
    context.imageSmoothingEnabled = view.zoom < 1;
    context.drawImage(bitmap, -view.x * view.zoom, -view.y * view.zoom, image.width * view.zoom, image.height * view.zoom);
    if (kept) {
      context.strokeStyle = "#ffb000";
      context.strokeRect((kept.x - view.x) * view.zoom, (kept.y - view.y) * view.zoom, Math.max(3, view.zoom), Math.max(3, view.zoom));
    }
  };
  const sizes = () => {
    const [w, h] = [Math.round(canvas.clientWidth), Math.round(canvas.clientHeight)];
    if (w && (canvas.width !== w || canvas.height !== h)) { [canvas.width, canvas.height] = [w, h]; whole(); draw(); }
  };

  const histogram = () => {
    const c = $("histogram"), g = c.getContext("2d"), whole = $("of").value === "frame" || $("of").value === "difference";
    // Codes are whole numbers: no bin is narrower than one.
    const low = image.low, span = image.high - image.low, bins = new Uint32Array(Math.max(1, Math.min(150, whole ? span + 1 : 150)));
    const width = (whole ? span + 1 : span) / bins.length || 1, wide = c.width / bins.length;
    image.values.forEach((v) => bins[Math.min(bins.length - 1, Math.floor((v - low) / width))]++);
    const top = Math.log1p(Math.max(...bins));
    g.clearRect(0, 0, c.width, c.height);
    g.fillStyle = style("--c0");
    bins.forEach((n, i) => { const h = ((c.height - 18) * Math.log1p(n)) / top; g.fillRect(i * wide, c.height - 18 - h, Math.max(1, wide - 0.5), h); });
    g.fillStyle = style("--soft");
    g.font = "11px system-ui";
    g.fillText(short(image.low), 0, c.height - 4);
    g.textAlign = "end";
    g.fillText(short(image.high) + " (log)", c.width, c.height - 4);
    g.textAlign = "start";
  };
  const profile = () => {
    const c = $("profile"), g = c.getContext("2d");
    g.clearRect(0, 0, c.width, c.height);
    if (!kept) return;
    const half = c.height / 2;
    const line = (values, top, colour, name) => {
      const low = Math.min(...values), high = Math.max(...values);
      g.strokeStyle = colour;
      g.beginPath();
      values.forEach((v, i) => g.lineTo((i / Math.max(1, values.length - 1)) * c.width, top + half - 4 - ((half - 20) * (v - low)) / (high - low || 1)));
      g.stroke();
      g.fillStyle = style("--soft");
      g.font = "11px system-ui";
      g.fillText(`${name}: ${short(low)} to ${short(high)}`, 2, top + 11);
    };
    const row = [...image.values.subarray(kept.y * image.width, (kept.y + 1) * image.width)];
    const column = Array.from({ length: image.height }, (_, y) => image.values[y * image.width + kept.x]);
    line(row, 0, style("--c0"), "row " + kept.y);
    line(column, half, style("--c1"), "column " + kept.x);
  };

  let asked = 0;
  const load = async () => {
    const mine = ++asked;
    const q = new URLSearchParams({ set: $("set").value, index: $("index").value || 0, of: $("of").value });
    $("other").hidden = $("of").value !== "difference";
    if ($("of").value === "difference") q.set("less", $("less").value || 0);
    const answer = await fetch("/pixels?" + q);
    // A slower answer to an earlier question is none to this one.
    if (mine !== asked) return;
    $("error").textContent = answer.ok ? "" : await answer.text();
    if (!answer.ok) return;
    const before = image && image.width + "x" + image.height;
    const values = new Float32Array(await answer.arrayBuffer());
    if (mine !== asked) return;
    let low = Infinity, high = -Infinity, sum = 0, squares = 0;
    for (const v of values) { if (v < low) low = v; if (v > high) high = v; sum += v; }
    const mean = sum / values.length;
    for (const v of values) squares += (v - mean) * (v - mean);
    image = { values, width: +answer.headers.get("x-width"), height: +answer.headers.get("x-height"), low, high };
    const sd = Math.sqrt(squares / values.length);
    $("low").value = short(Math.max(low, mean - 4 * sd));
    $("high").value = short(Math.min(high, mean + 4 * sd) > low ? Math.min(high, mean + 4 * sd) : low + 1);
    $("statistics").textContent = `${image.width} × ${image.height} px, mean ${short(mean)}, standard deviation ${short(sd)}, ${short(low)} to ${short(high)}`;
    document.querySelectorAll("button.set").forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.set === $("set").value)));
    develop();
    sizes();
    if (before !== image.width + "x" + image.height) { whole(); kept = null; }
    draw();
    histogram();
    profile();
    if (kept) read(kept);
  };
  const at = (e) => {
    const box = canvas.getBoundingClientRect();
    return { x: Math.floor(view.x + ((e.clientX - box.left) * canvas.width) / box.width / view.zoom), y: Math.floor(view.y + ((e.clientY - box.top) * canvas.height) / box.height / view.zoom) };
  };
  const inside = (p) => image && p.x >= 0 && p.y >= 0 && p.x < image.width && p.y < image.height;
  const read = (p) => { if (inside(p)) $("pixel").textContent = `x ${p.x}, y ${p.y}: ${short(image.values[p.y * image.width + p.x])} ${$("of").value === "variance" ? "DN²" : "DN"}`; };
  const zoom = (by, cx, cy) => {
    const [x, y] = [view.x + cx / view.zoom, view.y + cy / view.zoom];
    view.zoom = Math.min(64, Math.max(0.02, view.zoom * by));
    [view.x, view.y] = [x - cx / view.zoom, y - cy / view.zoom];
    draw();
  };
  let drag = null;
  canvas.addEventListener("pointerdown", (e) => { drag = { x: e.clientX, y: e.clientY, far: false }; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", (e) => {
    if (!image) return;
    if (drag) {
      const scale = canvas.width / canvas.clientWidth / view.zoom;
      if (Math.abs(e.clientX - drag.x) + Math.abs(e.clientY - drag.y) > 3 || drag.far) {
        view.x -= (e.clientX - drag.x) * scale;
        view.y -= (e.clientY - drag.y) * scale;
        drag = { x: e.clientX, y: e.clientY, far: true };
        draw();
      }
    } else read(at(e));
  });
  canvas.addEventListener("pointerup", (e) => {
    if (drag && !drag.far && inside(at(e))) { kept = at(e); read(kept); draw(); profile(); }
    drag = null;
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    const box = canvas.getBoundingClientRect();
    zoom(e.deltaY < 0 ? 1.25 : 0.8, e.clientX - box.left, e.clientY - box.top);
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const step = 40 / view.zoom, move = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[e.key];
    if (move) { view.x += move[0]; view.y += move[1]; }
    else if (e.key === "+" || e.key === "=") zoom(1.25, canvas.width / 2, canvas.height / 2);
    else if (e.key === "-") zoom(0.8, canvas.width / 2, canvas.height / 2);
    else return;
    e.preventDefault();
    draw();
    const middle = { x: Math.floor(view.x + canvas.width / 2 / view.zoom), y: Math.floor(view.y + canvas.height / 2 / view.zoom) };
    if (inside(middle)) { kept = middle; read(middle); draw(); profile(); }
  });
  for (const id of ["set", "index", "of", "less"]) $(id).addEventListener("change", load);
  $("set").addEventListener("change", () => { $("index").max = $("set").selectedOptions[0].dataset.frames - 1; });
  for (const id of ["low", "high"]) $(id).addEventListener("input", () => { if (image) { develop(); draw(); } });
  $("fit").addEventListener("click", () => { whole(); draw(); });
  document.querySelectorAll("button.set").forEach((b) => b.addEventListener("click", () => { $("set").value = b.dataset.set; $("index").value = 0; load(); root.scrollIntoView(); }));
  new ResizeObserver(sizes).observe(canvas);
  load();
});
