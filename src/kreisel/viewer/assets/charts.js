"use strict";
// Strips: quantities of the motion, then the change of every integral, against time; and a section.  All know the cursor.
const Charts = (() => {
  const TICK = 64, FOOT = 38, LOWEST = 62, FONT = "11px system-ui, sans-serif"; // pixels

  class Strips {
    constructor(box, cursor) { Object.assign(this, { box, cursor, focus: null, strips: [] }); }

    get plot() { return this.strips.at(-1).plot; } // the one with the axis of time

    draw(D, colours) {
      for (const s of this.strips) s.plot.destroy();
      Object.assign(this, { D, colours });
      this.box.replaceChildren();
      this.strips = [...this.motion(), ...this.drifts()];
      this.box.parentElement.style.minHeight = `${LOWEST * this.strips.length + FOOT}px`;
      this.strips.forEach((s, k) => this.add(s, k === this.strips.length - 1));
      if (this.focus !== null) this.emphasize(this.focus);
      this.place(this.time ?? D.time[0]);
    }

    motion() {
      const { D, colours } = this;
      if (!D.charts) return [];
      const x = Array.from(D.charts.time, (t) => t / D.clock.size), finite = (v) => (Number.isNaN(v) ? null : v);
      return D.charts.panels.map((p) => {
        const dots = p.values.some((v) => v.some(Number.isNaN)); // angles that jump from 180 to -180: no lines between
        const look = dots ? { paths: () => null, points: { show: true, size: 2.4, width: 0 } } : { width: 1.3, points: { show: false } };
        return {
          title: p.unit ? `${p.title} (${p.unit})` : p.title, shaded: true, data: [x, ...p.values.map((v) => Array.from(v, finite))],
          lines: p.names.map((name, k) => { const stroke = colours.colours[k % colours.colours.length]; return { label: name, stroke, ...look, points: { ...look.points, fill: stroke } }; }),
        };
      });
    }

    drifts() { // a strip for each family of integrals that changes; one with the band alone if none does
      const { D, colours } = this, x = Array.from(D.edges, (t) => t / D.clock.size), [begun, end] = this.ends(), families = new Map();
      D.series.forEach((s, i) => {
        if (!s.change.some((v) => v !== 0)) return;
        const name = s.name.replace(/\[[^\]]*\]$/, "");
        families.set(name, [...(families.get(name) ?? []), i]);
      });
      const band = x.map((t) => (D.steps > 0 ? D.band * Math.sqrt(Math.max(1, D.steps * (t - begun) / (end - begun))) : null));
      const dashed = { label: "", stroke: colours.ink, width: 1, dash: [7, 4], points: { show: false } }, range = this.range();
      const strip = (title, members) => ({
        title, range, members, data: [x, ...members.map((i) => Array.from(D.series[i].change, (v) => (v ? Math.max(range[0], Math.abs(v) / D.series[i].scale) : null))), band],
        lines: [...members.map((i) => ({ label: "", stroke: colours.colours[i % colours.colours.length], width: D.series[i].conserved ? 1.4 : 1, dash: D.series[i].conserved ? [] : [3, 3], spanGaps: true, points: { show: D.series[i].change.filter((v) => v).length === 1 } })), dashed],
      });
      return families.size ? [...families].map(([name, members]) => strip(name, members)) : [strip("no integral changes", [])];
    }

    add(strip, last) {
      const { colours, box } = this, holder = document.createElement("div"), title = document.createElement("p");
      holder.className = "strip"; title.className = "striptitle"; title.textContent = strip.title;
      if (strip.lines.length > 1) for (const each of strip.lines) if (each.label) { const name = document.createElement("b"); name.textContent = ` ${each.label}`; name.style.color = each.stroke; title.append(name); }
      holder.append(title); box.append(holder);
      const axis = { stroke: colours.ink, grid: { stroke: colours.grid, width: 1 }, ticks: { stroke: colours.grid, width: 1 }, font: FONT, values: (u, all) => all.map((v) => `${+v.toPrecision(12)}`) };
      const log = strip.range ? { distr: 3, range: () => strip.range } : { range: (u, a, b) => (b > a ? [a - 0.06 * (b - a), b + 0.12 * (b - a)] : [a - 1, a + 1]) };
      const y = strip.range ? { ...axis, size: TICK, filter: (u, all) => all, splits: (u) => this.decades(strip.range, u.bbox.height / devicePixelRatio), values: (u, all) => all.map((v) => `1e${Math.round(Math.log10(v))}`) } : { ...axis, size: TICK, space: 22 };
      strip.plot = new Library.uPlot({
        ...this.shape(last), legend: { show: false }, cursor: { show: false }, focus: { alpha: 0.12 },
        padding: [4, 26, last ? 0 : 4, 0], scales: { x: { time: false, range: () => this.ends() }, y: log },
        axes: [last ? { ...axis, label: this.D.clock.label, labelSize: 16, labelFont: FONT, size: 26, labelGap: 0 } : { ...axis, size: 0, values: () => [], ticks: { show: false } }, y],
        series: [{}, ...strip.lines], hooks: { drawClear: [(u) => this.shade(u, strip)], draw: [(u) => this.marks(u, last)] },
      }, strip.data, holder);
    }

    shape(last) {
      const count = Math.max(1, this.strips.length), free = Math.max(this.box.clientHeight, LOWEST * count + FOOT) - FOOT;
      return { width: Math.max(200, this.box.clientWidth), height: Math.floor(free / count) + (last ? FOOT : 0) };
    }

    decades([low, high], height) { // inside the strip: at least two, at most one in 24 pixels
      const a = Math.round(Math.log10(low)) + 1, b = Math.round(Math.log10(high)) - 1, step = Math.max(1, Math.min(b - a, Math.ceil((b - a) / Math.max(1, height / 24)))), list = [];
      for (let k = a; k <= b; k += step) list.push(10 ** k);
      return list;
    }

    ends() { const { D } = this, a = D.time[0] / D.clock.size, b = D.time[D.count - 1] / D.clock.size; return [a, b > a ? b : a + 1]; }

    range() { // down to 1e-17, or to the largest change of each integral
      const { D } = this, largest = D.series.map((s) => s.change.reduce((most, v) => Math.max(most, Math.abs(v) / s.scale), 0)).filter((v) => v > 0);
      const most = Math.max(1e-14, D.band * Math.sqrt(D.steps), ...largest), least = Math.min(1e-17, ...largest.map((v) => v / 10));
      return [10 ** Math.floor(Math.log10(least)), 10 ** Math.min(3, Math.ceil(Math.log10(most) + 0.3))];
    }

    shade(u, strip) { // shadows, below the lines
      if (!strip.shaded) return;
      const { D, colours } = this, c = u.ctx, { top, height } = u.bbox;
      c.save(); c.globalAlpha = 0.2; c.fillStyle = colours.faint;
      for (const [a, b] of D.charts.shadows) { const x = u.valToPos(a / D.clock.size, "x", true), w = u.valToPos(b / D.clock.size, "x", true) - x; c.fillRect(x, top, Math.max(1, w), height); }
      c.restore();
    }

    marks(u, last) { // stretches that can be played, and events
      const { D, colours } = this, c = u.ctx, { left, top, height } = u.bbox, at = (t) => u.valToPos(t / D.clock.size, "x", true);
      c.save();
      if (last && !(D.windows.length === 1 && D.windows[0][1] - D.windows[0][0] === D.count - 1)) {
        c.fillStyle = colours.colours[0];
        for (const [a, b] of D.windows) { const x = at(D.time[a]); c.fillRect(x, top + height - 4, Math.max(2, at(D.time[b]) - x), 4); }
      }
      c.strokeStyle = colours.colours[1]; c.setLineDash([2, 3]);
      for (const [time] of D.events) { const x = at(time); if (x >= left) { c.beginPath(); c.moveTo(x, top); c.lineTo(x, top + height); c.stroke(); } }
      c.restore();
    }

    emphasize(i) {
      this.focus = i;
      for (const s of this.strips) { const k = s.members?.indexOf(i) ?? -1; s.plot.setSeries(k < 0 ? null : k + 1, { focus: k >= 0 }, false); }
    }

    size() {
      if (!this.strips.length || !this.box.clientWidth) return;
      this.strips.forEach((s, k) => s.plot.setSize(this.shape(k === this.strips.length - 1)));
      this.place(this.time);
    }

    place(time) {
      this.time = time;
      const { D } = this, outer = this.box.getBoundingClientRect(), over = this.plot.over.getBoundingClientRect(), top = this.strips[0].plot.over.getBoundingClientRect().top;
      const x = this.plot.valToPos(Math.min(Math.max(time, D.time[0]), D.time[D.count - 1]) / D.clock.size, "x");
      Object.assign(this.cursor.style, { transform: `translateX(${over.left - outer.left + x - 1}px)`, top: `${top - outer.top}px`, height: `${over.bottom - top}px` });
    }

    timeAt(clientX) {
      const box = this.plot.over.getBoundingClientRect(), [a, b] = this.ends();
      return (a + Math.min(1, Math.max(0, (clientX - box.left) / box.width)) * (b - a)) * this.D.clock.size;
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

  return { Strips, Section };
})();
