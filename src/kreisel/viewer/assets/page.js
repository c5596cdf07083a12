"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i2: Int16Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
  const SINGLE = 6; // saved states a second where the motion between them is not known

  function unpack(text, kind) {
    const raw = atob(text), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return new KINDS[kind](bytes.buffer);
  }

  function decode(text) {
    const d = JSON.parse(text);
    d.time = unpack(d.time, "f8"); d.count = d.time.length;
    d.path = unpack(d.path, "i4"); d.edges = unpack(d.edges, "f8");
    for (const s of d.series) s.change = unpack(s.change, "f4");
    for (const m of d.meshes) { m.points = unpack(m.points, "f4"); m.faces = unpack(m.faces, m.wide ? "u4" : "u2"); m.colour = unpack(m.colour, "u1"); }
    for (const b of d.bodies) { if (b.turn !== null) b.turn = unpack(b.turn, "i2"); if (b.tip !== null) b.tip = unpack(b.tip, "f4"); }
    if (d.charts) { d.charts.time = unpack(d.charts.time, "f8"); for (const p of d.charts.panels) p.values = p.values.map((v) => unpack(v, "f4")); }
    for (const b of d.bodies) { if (b.place !== null) b.place = unpack(b.place, "f4"); for (const a of b.arrows) a.to = unpack(a.to, "i2"); }
    if (d.globe?.sun) d.globe.sun = unpack(d.globe.sun, "i2");
    if (d.section) { d.section.points = unpack(d.section.points, "f4"); d.section.time = unpack(d.section.time, "f8"); d.section.lane = unpack(d.section.lane, "u1"); }
    d.joined = new Uint8Array(d.count); d.first = new Int32Array(d.count).map((_, i) => i); d.rate = 2 / d.pace;
    for (const [a, b] of d.windows) { d.joined.fill(1, a, b); d.first.fill(a, a, b + 1); }
    return d;
  }

  let D = decode($("data").textContent);
  const state = { frame: 0, part: 0, time: D.time[0], playing: false, moved: true, chosen: null, waited: 0, told: 0 };
  const axes3 = D.coordinates.slice(), system = matchMedia("(prefers-color-scheme: dark)");
  const dark = () => (state.chosen === null ? system.matches : state.chosen);
  const colours = () => D.themes[dark() ? "dark" : "light"];
  let stage = null;
  const drift = new Charts.Strips($("drift"), $("cursor")), section = new Charts.Section($("sectionplot"), [$("sx"), $("sy")]);

  // ---- text, always as text

  function chip(colour, text) {
    const box = document.createElement("span"), mark = document.createElement("i");
    mark.className = "swatch"; mark.style.background = colour;
    box.append(mark, document.createTextNode(text)); $("legend").append(box);
  }

  function tell() {
    const c = colours().colours;
    document.documentElement.dataset.theme = dark() ? "dark" : "light";
    $("title").textContent = D.title;
    $("facts").textContent = D.facts.filter(Boolean).join(" \u00b7 ");
    $("note").textContent = D.note;
    $("callout").textContent = D.callout; $("callout").hidden = !D.callout;
    $("legend").replaceChildren();
    if (D.legend.tip) chip(c[1], D.legend.tip);
    if (D.legend.arrow) chip(c[2], D.legend.arrow);
    for (const a of D.bodies[0].arrows) chip(c[a.colour], a.name);
    $("charttitle").textContent = `${D.charts ? "Motion, and relative" : "Relative"} change of each integral since the start; dashed: eps \u221asteps`;
    const body = $("table").tBodies[0];
    body.replaceChildren();
    D.series.forEach((s, i) => {
      const row = body.insertRow(), cell = (text, name = "") => { const made = row.insertCell(); made.textContent = text; made.className = name; };
      const mark = document.createElement("i");
      mark.className = "swatch"; mark.style.background = c[i % c.length];
      row.insertCell().append(mark);
      cell(s.name); cell(s.conserved ? "yes" : "no", "wide"); cell(s.start === null ? "-" : `${s.start.toPrecision(6)}${s.unit && ` ${s.unit}`}`, "wide"); cell(""); cell(s.most === null ? "-" : s.most.toExponential(1));
      row.addEventListener("click", () => { const on = drift.focus !== i; for (const r of body.rows) r.classList.remove("on"); if (on) row.classList.add("on"); drift.emphasize(on ? i : null); });
    });
    $("scrub").max = D.count - 1;
    $("together").hidden = D.bodies.length < 2;
    $("section").hidden = !D.section;
    if (D.section) $("sectiontitle").textContent = D.section.title;
  }

  // ---- where we are

  function below(list, value) { // the last place with list[place] <= value
    let low = 0, high = list.length - 1;
    while (low < high) { const mid = (low + high + 1) >> 1; if (list[mid] <= value) low = mid; else high = mid - 1; }
    return low;
  }

  function seek(frame) {
    state.frame = Math.max(0, Math.min(D.count - 1, frame)); state.part = 0;
    state.time = D.time[state.frame]; state.moved = true;
  }

  function at(time) { // a time within a stretch that can be played
    let i = state.frame;
    if (D.time[i] > time || i + 1 >= D.count || D.time[i + 1] <= time) i = below(D.time, time);
    state.frame = i; state.time = time; state.moved = true;
    state.part = D.joined[i] ? Math.min(1, (time - D.time[i]) / (D.time[i + 1] - D.time[i])) : 0;
  }

  function nearest(time) {
    const i = below(D.time, time), j = Math.min(i + 1, D.count - 1);
    if (D.joined[i]) at(Math.max(D.time[0], time)); else seek(D.time[j] - time < time - D.time[i] ? j : i);
  }

  const pace = () => 2 ** Number($("speed").value), length = () => D.trail * 2 ** Number($("trail").value);

  function draw() {
    if (!state.moved) return;
    state.moved = false;
    stage?.pose(state.frame, state.part, state.time, length());
    document.body.dataset.frame = state.frame;
    document.body.dataset.time = state.time;
    const now = performance.now(), since = state.playing ? now - state.told : Infinity;
    if (since < (stage?.soft ? 300 : 0)) return; // without a GPU the browser takes 0.04 s to paint them
    $("scrub").value = state.frame;
    drift.place(state.time); section.place(state.time);
    if (since < 120) return;
    state.told = now;
    const stretch = below(D.edges, state.time), rows = $("table").tBodies[0].rows;
    D.series.forEach((s, i) => { rows[i].cells[4].textContent = s.change[stretch].toExponential(1); });
    $("now").textContent = `time ${(state.time / D.clock.size).toPrecision(7)} of ${(D.time[D.count - 1] / D.clock.size).toPrecision(5)}${D.clock.unit && ` ${D.clock.unit}`}, state ${state.frame + 1} of ${D.count}`;
  }

  // ---- playing

  function play(on) {
    state.playing = on;
    if (on && state.frame >= D.count - 1 && !following()) seek(0);
    state.moved = true; // the text too
    $("play").textContent = on ? "\u275a\u275a" : "\u25b6";
    document.body.dataset.playing = on;
  }

  function advance(seconds) {
    if (D.joined[state.frame]) {
      const end = D.time[D.windows.find(([a, b]) => state.frame >= a && state.frame < b)[1]], time = state.time + seconds * D.pace * pace();
      if (time < end) { at(time); return; }
      seek(below(D.time, end)); return;
    }
    const next = D.windows.find(([a]) => a >= state.frame);
    if (next) { seek(next[0]); return; } // to the next stretch
    if (D.windows.length && state.frame >= D.windows.at(-1)[1] || state.frame >= D.count - 1) { seek(D.count - 1); if (!following()) play(false); return; }
    state.waited += seconds * SINGLE * pace();
    if (state.waited >= 1) { seek(state.frame + Math.floor(state.waited)); state.waited = 0; }
  }

  let before = null, pictures = 0, since = null;

  function tick(now) {
    if (before !== null && state.playing) {
      advance(Math.min(now - before, 200) / 1000);
      pictures += 1;
      if (since === null) since = now;
      if (now - since > 500) { document.body.dataset.fps = (1000 * pictures / (now - since)).toFixed(1); pictures = 0; since = now; }
    } else since = null;
    before = now;
    draw();
    stage?.show(state.playing, now);
    requestAnimationFrame(tick);
  }

  // ---- following a run that goes on

  const following = () => D.follow !== null && $("follow").checked && !D.complete;

  async function news() {
    let text = null;
    if (!document.hidden) {
      try {
        const answer = await fetch(location.pathname, { headers: { Accept: "application/json", "If-None-Match": state.tag || "" }, cache: "no-store" });
        if (answer.status === 200) { state.tag = answer.headers.get("ETag"); text = await answer.text(); }
      } catch { $("note").textContent = "The server has ended; this is the last state that it sent."; return; }
    }
    if (text !== null) {
      const atEnd = state.frame >= D.count - 1, time = state.time;
      D = decode(text);
      state.frame = Math.min(state.frame, D.count - 1);
      redraw();
      if ($("follow").checked && atEnd && !state.playing) seek(D.count - 1); else nearest(time);
    }
    if (!D.complete) setTimeout(news, 1000 * D.follow);
  }

  function redraw() {
    tell();
    stage?.build(D, colours(), dark(), axes3);
    drift.draw(D, colours());
    if (D.section) section.put(D.section, colours());
    state.moved = true;
    document.body.dataset.count = D.count;
  }

  // ---- files

  function save(blob, name) {
    const link = document.createElement("a"), url = URL.createObjectURL(blob);
    link.href = url; link.download = name; link.click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
    document.body.dataset.saved = `${name} ${blob.type} ${blob.size}`;
  }

  function picture() { if (stage) { stage.finest(); stage.canvas.toBlob((blob) => save(blob, "kreisel.png"), "image/png"); } }

  let recorder = null;

  function record() {
    if (recorder) { recorder.stop(); return; }
    const type = ["video/webm;codecs=vp9", "video/webm", "video/mp4"].find((t) => window.MediaRecorder?.isTypeSupported(t));
    if (!stage || !type) { $("callout").textContent = "This browser records no video; kreisel view --movie top.gif does."; $("callout").hidden = false; return; }
    const pieces = [];
    recorder = new MediaRecorder(stage.canvas.captureStream(30), { mimeType: type, videoBitsPerSecond: 8e6 });
    recorder.addEventListener("dataavailable", (event) => pieces.push(event.data));
    recorder.addEventListener("stop", () => { recorder = null; $("record").classList.remove("on"); play(false); save(new Blob(pieces, { type: type.split(";")[0] }), type.includes("mp4") ? "kreisel.mp4" : "kreisel.webm"); });
    recorder.start(250); $("record").classList.add("on"); play(true);
  }

  // ---- begin

  const toggles = {
    help: () => { const h = $("helpbox"); h.open ? h.close() : h.showModal(); },
    reset: () => { stage?.reset(); state.moved = true; },
    chase: () => { if (stage) { stage.follow = !stage.follow; stage.heading = null; $("chase").classList.toggle("on", stage.follow); state.moved = true; } },
    axes: () => { if (stage) { stage.axes = !stage.axes; stage.dirty = true; $("axes").classList.toggle("on", stage.axes); } },
    theme: () => { state.chosen = !dark(); redraw(); },
    together: () => { if (stage) { stage.together = !stage.together; $("together").classList.toggle("on", stage.together); stage.arrange(); stage.reset(); state.moved = true; } },
    png: picture, record,
  };
  const KEYS = { "?": "help", r: "reset", f: "chase", a: "axes", d: "theme", b: "together", s: "png", v: "record" };

  function choices() {
    if (D.kind !== "projection") return;
    $("choice").hidden = false;
    for (let i = 0; i < 3; i++) {
      const box = $("c" + i);
      D.names.forEach((name, j) => box.add(new Option(name, j)));
      box.value = axes3[i];
      box.addEventListener("change", () => { axes3[i] = Number(box.value); redraw(); });
    }
  }

  function speed(step) { const s = $("speed"); s.value = Number(s.value) + step; $("pace").textContent = `\u00d7 ${pace()}`; }

  function key(event) {
    const typing = event.target instanceof HTMLInputElement && event.target.type !== "range" || event.target instanceof HTMLSelectElement;
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const ours = { " ": () => play(!state.playing), ArrowRight: () => { play(false); seek(state.frame + (event.shiftKey ? 10 : 1)); }, ArrowLeft: () => { play(false); seek(state.frame - (event.shiftKey ? 10 : 1)); }, Home: () => seek(0), End: () => seek(D.count - 1), ArrowUp: () => speed(1), ArrowDown: () => speed(-1) };
    const act = ours[event.key] || toggles[KEYS[event.key.toLowerCase()]];
    if (act && !(event.key === " " && event.target instanceof HTMLButtonElement)) { event.preventDefault(); act(); }
  }

  function listen() {
    $("play").addEventListener("click", () => play(!state.playing));
    $("scrub").addEventListener("input", () => { play(false); seek(Number($("scrub").value)); });
    $("speed").addEventListener("input", () => speed(0));
    $("trail").addEventListener("input", () => { state.moved = true; });
    $("chart").addEventListener("pointerdown", (event) => { const go = (e) => { play(false); nearest(drift.timeAt(e.clientX)); }; go(event); const up = () => { removeEventListener("pointermove", go); removeEventListener("pointerup", up); removeEventListener("pointercancel", up); }; addEventListener("pointermove", go); addEventListener("pointerup", up); addEventListener("pointercancel", up); });
    for (const name of Object.keys(toggles)) $(name).addEventListener("click", toggles[name]);
    document.addEventListener("keydown", key);
    new ResizeObserver(() => { stage?.size(); drift.size(); if (D.section) section.draw(); }).observe($("scenebox"));
    addEventListener("resize", () => { stage?.size(); drift.size(); if (D.section) section.draw(); });
    system.addEventListener("change", () => { state.chosen = null; redraw(); });
    if (D.follow !== null) { $("following").hidden = false; setTimeout(news, 1000 * D.follow); }
    speed(0);
  }

  function begin() {
    try { stage = new Drawing.Stage($("scene")); } catch { $("scene").hidden = true; }
    choices();
    redraw();
    if (stage) { document.documentElement.dataset.soft = stage.soft; stage.size(); } else { $("callout").textContent = "This browser offers no WebGL, which the picture needs; charts and table are whole."; $("callout").hidden = false; }
    listen();
    const asked = new URLSearchParams(location.search);
    if (asked.has("scene")) { document.documentElement.dataset.scene = true; if (stage) { stage.controls.enableZoom = false; stage.size(); } }
    if (asked.has("play") && !matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
    document.body.dataset.count = D.count;
    document.body.dataset.ready = true;
    Object.defineProperty(window, "kreisel", { value: { get stage() { return stage; }, get state() { return state; }, get data() { return D; }, drift, section } });
    requestAnimationFrame(tick);
  }

  begin();
})();
