"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const kinds = { f4: Float32Array, f8: Float64Array, i4: Int32Array };
  const BYTES_TURN = 4;
  const PATH = 1, TRAIL = 2, AXIS = 3, ARROW = 4, BODY = 5; // traces; 0 is the sphere
  const PERIOD = 60; // saved states a second at speed 1
  const REST = 400; // milliseconds without a new state after which the whole path is shown again

  function unpack(text, kind) {
    const raw = atob(text), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return new kinds[kind](bytes.buffer);
  }

  function decode(text) {
    const d = JSON.parse(text);
    d.time = unpack(d.time, "f8");
    d.tip = unpack(d.tip, "f4");
    d.turn = d.turn === null ? null : unpack(d.turn, "f4");
    d.path = unpack(d.path, "i4");
    d.few = unpack(d.few, "i4");
    d.edges = unpack(d.edges, "f8");
    for (const s of d.series) s.change = unpack(s.change, "f4");
    d.count = d.time.length;
    d.gap = d.count > 1 ? (d.time[d.count - 1] - d.time[0]) / (d.count - 1) : 1;
    return d;
  }

  let D = decode($("data").textContent);
  const state = { frame: 0, time: D.time[0], playing: false, ready: false, drawn: -1, whole: true, moved: 0 };
  const axes3 = D.coordinates.slice();
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const theme = () => D.themes[dark.matches ? "dark" : "light"];
  const still = { displayModeBar: false, responsive: true, plotGlPixelRatio: 1 };

  // ---- data of the traces

  function pick(rows) {
    const x = [], y = [], z = [], [a, b, c] = axes3, n = D.n;
    for (const k of rows) { x.push(D.tip[k * n + a]); y.push(D.tip[k * n + b]); z.push(D.tip[k * n + c]); }
    return { x, y, z };
  }

  function trailRows() {
    const most = 2 ** Number($("trail").value), from = Math.max(0, state.frame - most), rows = [];
    const stride = Math.max(1, Math.ceil((state.frame - from) / 1500));
    for (let k = from; k < state.frame; k += stride) rows.push(k);
    rows.push(state.frame);
    return rows;
  }

  function surroundings() { // a sphere, or the floor under a path
    const x = [], y = [], z = [], r = D.radius;
    const push = (a, b, c) => { x.push(a); y.push(b); z.push(c); };
    if (D.kind === "path") {
      for (let i = -4; i <= 4; i++) {
        push(-r, i * r / 4, -r); push(r, i * r / 4, -r); push(null, null, null);
        push(i * r / 4, -r, -r); push(i * r / 4, r, -r); push(null, null, null);
      }
      return { x, y, z };
    }
    for (let i = 0; i < 6; i++) {
      const u = Math.PI * i / 6;
      for (let j = 0; j <= 48; j++) { const v = 2 * Math.PI * j / 48; push(r * Math.cos(u) * Math.sin(v), r * Math.sin(u) * Math.sin(v), r * Math.cos(v)); }
      push(null, null, null);
    }
    for (let i = 1; i < 6; i++) {
      const h = r * Math.cos(Math.PI * i / 6), s = r * Math.sin(Math.PI * i / 6);
      for (let j = 0; j <= 48; j++) { const v = 2 * Math.PI * j / 48; push(s * Math.cos(v), s * Math.sin(v), h); }
      push(null, null, null);
    }
    return { x, y, z };
  }

  function turned(P) {
    const k = D.turn.length === BYTES_TURN ? 0 : state.frame;
    const [w, a, b, c] = D.turn.subarray(4 * k, 4 * k + 4);
    const [p, q, r] = D.kind === "path" ? D.tip.subarray(3 * state.frame, 3 * state.frame + 3) : [0, 0, 0];
    const m = [1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b),
               2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a),
               2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)];
    const x = new Array(P.length), y = new Array(P.length), z = new Array(P.length);
    for (let i = 0; i < P.length; i++) {
      const [u, v, t] = P[i];
      x[i] = p + m[0] * u + m[1] * v + m[2] * t; y[i] = q + m[3] * u + m[4] * v + m[5] * t; z[i] = r + m[6] * u + m[7] * v + m[8] * t;
    }
    return { x, y, z };
  }

  function pointer() {
    if (D.kind === "path") return turned([[0, 0, 0], D.nose]);
    const { x, y, z } = pick([state.frame]);
    return { x: [0, x[0]], y: [0, y[0]], z: [0, z[0]] };
  }

  // ---- the two figures

  function sceneTraces() {
    const t = theme(), c = t.colours, base = { type: "scatter3d", hoverinfo: "skip", showlegend: false };
    const trace = (rows, colour, width, joined) => ({ ...base, ...pick(rows), mode: joined ? "lines" : "markers",
      line: { color: colour, width }, marker: { color: colour, size: Math.max(1.2, width / 1.5), line: { width: 0 } } });
    const out = [
      { ...base, ...surroundings(), mode: "lines", line: { color: t.grid, width: 1 } },
      trace(D.path, t.faint, 1.5, D.path_joined),
      trace(trailRows(), c[0], 5, D.joined),
      { ...base, ...pointer(), mode: "lines+markers", line: { color: c[1], width: 4 }, marker: { color: c[1], size: [0, 6] } },
      { ...base, x: [0, 0], y: [0, 0], z: [0, 0], mode: "lines", line: { color: c[2], width: 5 } },
    ];
    if (D.arrow) { const [x, y, z] = D.arrow; Object.assign(out[ARROW], { x: [0, x], y: [0, y], z: [0, z] }); }
    if (D.body) {
      const F = D.body.faces, shades = [c[0], c[4]];
      out.push({ type: "mesh3d", hoverinfo: "skip", ...turned(D.body.points), i: F.map((f) => f[0]), j: F.map((f) => f[1]), k: F.map((f) => f[2]),
        facecolor: D.body.shade.map((s) => shades[s]), flatshading: true, opacity: 1,
        lighting: { ambient: 0.65, diffuse: 0.6, specular: 0.15, roughness: 0.8 } });
    }
    return out;
  }

  function sceneLayout() {
    const r = 1.3 * D.radius, axis = { visible: false, range: [-r, r], autorange: false };
    const labels = D.kind === "projection" ? { visible: true, showgrid: false, showticklabels: false, zeroline: false, showspikes: false, color: theme().faint } : {};
    const named = (i) => ({ ...axis, ...labels, title: { text: D.kind === "projection" ? String(axes3[i] + 1) : "" } });
    return { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: theme().paper, uirevision: "stay", showlegend: false,
      scene: { xaxis: named(0), yaxis: named(1), zaxis: named(2), aspectmode: "cube", uirevision: "stay",
        camera: { eye: { x: 0.95, y: -1.12, z: 0.6 } } } };
  }

  const MARGIN = { l: 62, r: 12, t: 26, b: 40 };

  function driftTraces() {
    const x = Array.from(D.edges);
    return D.series.map((s, i) => ({ type: "scatter", mode: "lines", hoverinfo: "skip", showlegend: false, x,
      connectgaps: true, y: Array.from(s.change, (v) => (v ? Math.abs(v) / s.scale : null)),
      line: { color: theme().colours[i % theme().colours.length], width: s.conserved ? 1.3 : 1, dash: s.conserved ? "solid" : "dot" } })).concat(band());
  }

  function band() {
    if (!(D.steps > 0)) return [];
    const x = [], y = [], t0 = D.time[0], T = D.time[D.count - 1] - t0;
    for (let i = 1; i <= 60; i++) { const u = (i / 60) ** 2; x.push(t0 + T * u); y.push(D.band * Math.sqrt(Math.max(1, D.steps * u))); }
    return [{ type: "scatter", mode: "lines", hoverinfo: "skip", showlegend: false, x, y, line: { color: theme().ink, width: 1, dash: "dash" } }];
  }

  function driftLayout() {
    const t = theme(), end = D.time[D.count - 1], line = { color: t.ink, gridcolor: t.grid, automargin: false, fixedrange: true };
    return { margin: MARGIN, paper_bgcolor: t.paper, plot_bgcolor: t.paper, font: { color: t.ink, size: 11 }, showlegend: false,
      title: { text: "change since the start, relative; dashed: eps \u221asteps", font: { size: 12 }, x: 0.02, y: 0.98, yanchor: "top" },
      xaxis: { ...line, title: { text: "time" }, range: [D.time[0], end > D.time[0] ? end : D.time[0] + 1] },
      yaxis: { ...line, type: "log", dtick: 1, exponentformat: "power", range: driftRange() } };
  }

  function driftRange() {
    let most = Math.max(1e-14, D.band * Math.sqrt(D.steps));
    for (const s of D.series) for (const v of s.change) most = Math.max(most, Math.abs(v) / s.scale);
    return [-17, Math.min(3, Math.log10(most) + 0.5)];
  }

  // ---- text, always as text

  function tell() {
    $("title").textContent = D.title;
    $("facts").textContent = D.facts.filter(Boolean).join(" \u00b7 ");
    $("note").textContent = D.note;
    const legend = $("legend");
    legend.replaceChildren();
    const item = (colour, text) => {
      const box = document.createElement("span"), mark = document.createElement("i");
      mark.className = "swatch"; mark.style.background = colour;
      box.append(mark, document.createTextNode(text)); legend.append(box);
    };
    if (D.legend.tip) item(theme().colours[1], D.legend.tip);
    if (D.legend.arrow) item(theme().colours[2], D.legend.arrow);
    const body = $("table").tBodies[0];
    body.replaceChildren();
    D.series.forEach((s, i) => {
      const row = body.insertRow(), cell = (text) => { row.insertCell().textContent = text; };
      const mark = document.createElement("i");
      mark.className = "swatch"; mark.style.background = theme().colours[i % theme().colours.length];
      row.insertCell().append(mark);
      cell(s.name); cell(s.conserved ? "yes" : "no"); cell(s.start === null ? "-" : s.start.toPrecision(6)); cell(""); cell(s.most === null ? "-" : s.most.toExponential(1));
    });
    $("scrub").max = D.count - 1;
  }

  // ---- the cursor

  function below(list, value) { // the last place with list[place] <= value
    let low = 0, high = list.length - 1;
    while (low < high) { const mid = (low + high + 1) >> 1; if (list[mid] <= value) low = mid; else high = mid - 1; }
    return low;
  }

  function placeCursor() {
    const box = $("drift").getBoundingClientRect(), first = D.time[0], last = D.time[D.count - 1];
    const share = last > first ? (D.time[state.frame] - first) / (last - first) : 0;
    const cursor = $("cursor").style;
    cursor.left = `${MARGIN.l + share * (box.width - MARGIN.l - MARGIN.r) - 1}px`;
    cursor.top = `${MARGIN.t}px`;
    cursor.height = `${box.height - MARGIN.t - MARGIN.b}px`;
    const stretch = below(D.edges, D.time[state.frame]), rows = $("table").tBodies[0].rows;
    D.series.forEach((s, i) => { rows[i].cells[4].textContent = s.change[stretch].toExponential(1); });
    $("now").textContent = `time ${D.time[state.frame].toPrecision(7)}, state ${state.frame + 1} of ${D.count}`;
  }

  function seek(frame) {
    state.frame = Math.max(0, Math.min(D.count - 1, frame));
    state.time = D.time[state.frame];
    $("scrub").value = state.frame;
  }

  // The path stands still, but every picture draws it anew: while something moves, fewer points of it.
  function showPath(whole) {
    if (state.whole === whole || D.few.length === D.path.length) return;
    state.whole = whole;
    const { x, y, z } = pick(whole ? D.path : D.few);
    Plotly.restyle("scene", { x: [x], y: [y], z: [z], mode: (whole ? D.path_joined : D.few_joined) ? "lines" : "markers" }, [PATH]);
  }

  function draw(now) {
    if (!state.ready) return;
    if (state.drawn === state.frame) {
      if (!state.playing && now - state.moved > REST) showPath(true);
      return;
    }
    if (state.drawn >= 0) { showPath(false); state.moved = now; }
    state.drawn = state.frame;
    const parts = [pick(trailRows()), pointer()], traces = [TRAIL, AXIS];
    if (D.body && D.turn.length > BYTES_TURN) { parts.push(turned(D.body.points)); traces.push(BODY); }
    Plotly.restyle("scene", { x: parts.map((p) => p.x), y: parts.map((p) => p.y), z: parts.map((p) => p.z) }, traces);
    placeCursor();
    document.body.dataset.frame = state.frame;
  }

  // ---- playing

  const pace = () => 2 ** Number($("speed").value);

  function play(on) {
    state.playing = on;
    if (on && state.frame >= D.count - 1 && !following()) seek(0);
    $("play").textContent = on ? "\u275a\u275a" : "\u25b6";
    document.body.dataset.playing = on;
  }

  let before = null, pictures = 0, since = null;

  function tick(now) {
    if (before !== null && state.playing) {
      state.time += Math.min(now - before, 200) / 1000 * PERIOD * D.gap * pace();
      const last = D.time[D.count - 1];
      if (state.time >= last) { state.time = last; if (!following()) play(false); }
      const time = state.time;
      seek(below(D.time, time));
      state.time = time;
      pictures += 1;
      if (since === null) since = now;
      if (now - since > 500) { document.body.dataset.fps = (1000 * pictures / (now - since)).toFixed(1); pictures = 0; since = now; }
    } else since = null;
    before = now;
    draw(now);
    requestAnimationFrame(tick);
  }

  // ---- following a run that goes on

  const following = () => D.follow !== null && $("follow").checked && !D.complete;

  async function news() {
    if (!document.hidden) {
      try {
        const answer = await fetch(location.pathname, { headers: { Accept: "application/json", "If-None-Match": state.tag || "" }, cache: "no-store" });
        if (answer.status === 200) {
          state.tag = answer.headers.get("ETag");
          const atEnd = state.frame >= D.count - 1;
          D = decode(await answer.text());
          tell();
          seek($("follow").checked && atEnd && !state.playing ? D.count - 1 : below(D.time, state.time));
          await redraw();
        }
      } catch { $("note").textContent = "The server has ended; this is the last state that it sent."; return; }
    }
    if (!D.complete) setTimeout(news, 1000 * D.follow);
  }

  async function redraw() {
    await Plotly.react("scene", sceneTraces(), sceneLayout(), still);
    await Plotly.react("drift", driftTraces(), driftLayout(), still);
    state.drawn = -1;
    state.whole = true;
    document.body.dataset.count = D.count;
  }

  // ---- begin

  function choices() {
    if (D.kind !== "projection") return;
    $("choice").hidden = false;
    for (let i = 0; i < 3; i++) {
      const box = $("c" + i);
      for (let j = 0; j < D.n; j++) box.add(new Option(String(j + 1), j));
      box.value = axes3[i];
      box.addEventListener("change", () => { axes3[i] = Number(box.value); redraw(); });
    }
  }

  function listen() {
    const pause = () => play(false);
    $("play").addEventListener("click", () => play(!state.playing));
    $("scrub").addEventListener("input", () => { pause(); seek(Number($("scrub").value)); });
    $("speed").addEventListener("input", () => { $("pace").textContent = `\u00d7 ${pace()}`; });
    $("trail").addEventListener("input", () => { state.drawn = -1; });
    $("chart").addEventListener("click", (event) => {
      const box = $("drift").getBoundingClientRect();
      const share = (event.clientX - box.left - MARGIN.l) / (box.width - MARGIN.l - MARGIN.r);
      pause();
      seek(below(D.time, D.time[0] + Math.min(1, Math.max(0, share)) * (D.time[D.count - 1] - D.time[0])));
    });
    document.addEventListener("keydown", (event) => {
      if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || event.target instanceof HTMLButtonElement) return;
      if (event.key === " ") { event.preventDefault(); play(!state.playing); }
      if (event.key === "ArrowRight") { pause(); seek(state.frame + 1); }
      if (event.key === "ArrowLeft") { pause(); seek(state.frame - 1); }
    });
    addEventListener("resize", () => { state.drawn = -1; });
    dark.addEventListener("change", () => { tell(); redraw(); });
    $("pace").textContent = `\u00d7 ${pace()}`;
    if (D.follow !== null) { $("following").hidden = false; setTimeout(news, 1000 * D.follow); }
  }

  async function begin() {
    tell();
    choices();
    listen();
    await Plotly.newPlot("scene", sceneTraces(), sceneLayout(), still);
    await Plotly.newPlot("drift", driftTraces(), driftLayout(), still);
    state.ready = true;
    document.body.dataset.count = D.count;
    document.body.dataset.ready = true;
    requestAnimationFrame(tick);
  }

  begin();
})();
