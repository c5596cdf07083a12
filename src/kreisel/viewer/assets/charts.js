"use strict";
// The change of every integral against time, and a section; both know where the cursor is.
const Charts = (() => {
  const LEAST = 1e-18, TICK = 64;

  class Drift {
    constructor(box, cursor) { Object.assign(this, { box, cursor, focus: null }); }

    draw(D, colours) {
      this.plot?.destroy();
      Object.assign(this, { D, colours });
      const lines = D.series.map((s, i) => ({ label: s.name, stroke: colours.colours[i % colours.colours.length], width: s.conserved ? 1.4 : 1, dash: s.conserved ? [] : [3, 3], spanGaps: true, points: { show: false } }));
      const band = { label: "eps \u221asteps", stroke: colours.ink, width: 1, dash: [7, 4], points: { show: false } };
      const axis = { stroke: colours.ink, grid: { stroke: colours.grid, width: 1 }, ticks: { stroke: colours.grid, width: 1 }, font: "11px system-ui, sans-serif" };
      this.plot = new Library.uPlot({
        width: Math.max(200, this.box.clientWidth), height: Math.max(120, this.box.clientHeight), legend: { show: false }, cursor: { show: false }, focus: { alpha: 0.12 },
        scales: { x: { time: false, range: () => this.ends() }, y: { distr: 3, range: () => this.range() } },
        axes: [{ ...axis, label: "time", labelSize: 20, labelFont: "11px system-ui, sans-serif", size: 34 }, { ...axis, size: TICK, values: (u, all) => all.map((v) => (v === null || Math.abs(Math.log10(v) % 2) > 1e-6 ? "" : `1e${Math.round(Math.log10(v))}`)) }],
        series: [{}, ...lines, band],
        hooks: { draw: [(u) => this.marks(u)] },
      }, this.data(), this.box);
      if (this.focus !== null) this.emphasize(this.focus);
      this.place(this.time ?? D.time[0]);
    }

    ends() { const a = this.D.time[0], b = this.D.time[this.D.count - 1]; return [a, b > a ? b : a + 1]; }

    range() {
      const { D } = this;
      let most = Math.max(1e-14, D.band * Math.sqrt(D.steps));
      for (const s of D.series) for (const v of s.change) most = Math.max(most, Math.abs(v) / s.scale);
      return [1e-17, 10 ** Math.min(3, Math.ceil(Math.log10(most) + 0.3))];
    }

    data() {
      const { D } = this, x = Array.from(D.edges), [begun, end] = this.ends();
      const lines = D.series.map((s) => Array.from(s.change, (v) => (v ? Math.max(LEAST, Math.abs(v) / s.scale) : null)));
      const band = x.map((t) => (D.steps > 0 ? D.band * Math.sqrt(Math.max(1, D.steps * (t - begun) / (end - begun))) : null));
      return [x, ...lines, band];
    }

    marks(u) { // stretches that can be played, and events
      const { D, colours } = this, c = u.ctx, { left, top, height } = u.bbox;
      c.save();
      if (!(D.windows.length === 1 && D.windows[0][1] - D.windows[0][0] === D.count - 1)) {
        c.fillStyle = colours.colours[0];
        for (const [a, b] of D.windows) { const x = u.valToPos(D.time[a], "x", true), w = u.valToPos(D.time[b], "x", true) - x; c.fillRect(x, top + height - 4, Math.max(2, w), 4); }
      }
      c.strokeStyle = colours.colours[1]; c.setLineDash([2, 3]);
      for (const [time] of D.events) { const x = u.valToPos(time, "x", true); if (x >= left) { c.beginPath(); c.moveTo(x, top); c.lineTo(x, top + height); c.stroke(); } }
      c.restore();
    }

    emphasize(i) { this.focus = i; this.plot.setSeries(i === null ? null : i + 1, { focus: i !== null }, false); }

    size() { if (this.plot && this.box.clientWidth) { this.plot.setSize({ width: this.box.clientWidth, height: Math.max(120, this.box.clientHeight) }); this.place(this.time); } }

    place(time) {
      this.time = time;
      const over = this.plot.over, x = this.plot.valToPos(Math.min(Math.max(time, this.D.time[0]), this.D.time[this.D.count - 1]), "x");
      Object.assign(this.cursor.style, { transform: `translateX(${over.offsetLeft + x - 1}px)`, top: `${over.offsetTop}px`, height: `${over.clientHeight}px` });
    }

    timeAt(clientX) {
      const box = this.plot.over.getBoundingClientRect(), [a, b] = this.ends();
      return a + Math.min(1, Math.max(0, (clientX - box.left) / box.width)) * (b - a);
    }
  }

  class Section {
    constructor(canvas, selects) { Object.assign(this, { canvas, selects, seen: -1 }); for (const s of selects) s.addEventListener("change", () => this.draw()); }

    put(section, colours) {
      const fresh = this.section === undefined;
      Object.assign(this, { section, colours });
      if (fresh) this.selects.forEach((s, k) => { section.names.forEach((n, i) => s.add(new Option(n, i))); s.value = Math.min(k, section.names.length - 1); });
      this.draw();
    }

    draw() {
      const { section: S, canvas, colours } = this, scale = Math.min(2, devicePixelRatio), w = canvas.clientWidth, h = canvas.clientHeight, c = canvas.getContext("2d");
      canvas.width = w * scale; canvas.height = h * scale; c.setTransform(scale, 0, 0, scale, 0, 0);
      const n = S.names.length, [i, j] = this.selects.map((s) => Number(s.value)), ends = [i, j].map((k) => { let a = Infinity, b = -Infinity; for (let p = k; p < S.points.length; p += n) { a = Math.min(a, S.points[p]); b = Math.max(b, S.points[p]); } const pad = 0.06 * (b - a) || 1; return [a - pad, b + pad]; });
      const box = [46, 8, w - 54, h - 32], X = (v) => box[0] + (v - ends[0][0]) / (ends[0][1] - ends[0][0]) * box[2], Y = (v) => box[1] + box[3] - (v - ends[1][0]) / (ends[1][1] - ends[1][0]) * box[3];
      c.clearRect(0, 0, w, h); c.strokeStyle = colours.grid; c.strokeRect(...box);
      c.fillStyle = colours.ink; c.font = "11px system-ui, sans-serif";
      c.textAlign = "center";
      for (const f of [0.1, 0.5, 0.9]) { const v = ends[0][0] + f * (ends[0][1] - ends[0][0]); c.fillText(v.toPrecision(3), X(v), h - 10); }
      c.textAlign = "right";
      for (const f of [0.1, 0.5, 0.9]) { const v = ends[1][0] + f * (ends[1][1] - ends[1][0]); c.fillText(v.toPrecision(3), box[0] - 4, Y(v) + 4); }
      let last = -1;
      for (let k = 0; k < S.time.length; k++) {
        const passed = S.time[k] <= this.time;
        if (passed && (last < 0 || S.time[k] > S.time[last])) last = k;
        c.globalAlpha = passed ? 1 : 0.3; c.fillStyle = colours.colours[S.lane[k] % colours.colours.length];
        c.fillRect(X(S.points[n * k + i]) - 1, Y(S.points[n * k + j]) - 1, 2, 2);
      }
      c.globalAlpha = 1;
      if (last >= 0) { c.beginPath(); c.arc(X(S.points[n * last + i]), Y(S.points[n * last + j]), 4, 0, 7); c.strokeStyle = colours.colours[1]; c.lineWidth = 2; c.stroke(); c.lineWidth = 1; }
      this.seen = last;
    }

    place(time) {
      const before = this.time;
      this.time = time;
      if (!this.section || (before !== undefined && !this.crossed(before, time))) return;
      this.draw();
    }

    crossed(a, b) { const [low, high] = a < b ? [a, b] : [b, a]; for (const t of this.section.time) if (t > low && t <= high) return true; return false; }
  }

  return { Drift, Section };
})();
