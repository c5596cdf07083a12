"use strict";
// The picture: bodies, trails, ground, axes.  D is the data of scene.py, decoded by page.js.
const Drawing = (() => {
  const T = Library, V = T.Vector3, { Ribbon, line, circle, word, arrow, stride } = Lines;
  const FOV = 30, MOST_TRAIL = 1500, STEP = 0.06; // degrees; points; radians between points of a trail
  const SLOW = 50, LEAST = 0.4, COARSER = 0.75; // milliseconds of a picture beyond which it is drawn coarser; the coarsest; a stage
  const REST = 350, MOVING = 400; // milliseconds until a picture at rest is drawn finely; dots of a path while it moves, without a GPU

  function isSoftware(gl) {
    const known = gl.getExtension("WEBGL_debug_renderer_info");
    return /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(known ? known.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  }

  function withoutGPU() {
    const gl = document.createElement("canvas").getContext("webgl2"), soft = gl !== null && isSoftware(gl);
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    return soft;
  }

  // ---- between frames: the cubic of `between` in frames.py

  function weights(D, i, u, W) {
    const last = D.count - 1;
    if (!D.joined[i] || u <= 0) { W.a = W.b = W.c = W.d = i; W.wa = W.wc = W.wd = 0; W.wb = 1; return W; }
    W.wa = (-u + 2 * u * u - u * u * u) / 2; W.wb = (2 - 5 * u * u + 3 * u * u * u) / 2;
    W.wc = (u + 4 * u * u - 3 * u * u * u) / 2; W.wd = (u * u * u - u * u) / 2;
    W.a = i - 1; W.b = i; W.c = i + 1; W.d = i + 2;
    if (i === 0 || !D.joined[i - 1]) { W.wb += 2 * W.wa; W.wc -= W.wa; W.wa = 0; W.a = i; }
    if (i + 2 > last || !D.joined[i + 1]) { W.wc += 2 * W.wd; W.wb -= W.wd; W.wd = 0; W.d = i + 1; }
    return W;
  }

  function mix(list, n, W, k) { return W.wa * list[n * W.a + k] + W.wb * list[n * W.b + k] + W.wc * list[n * W.c + k] + W.wd * list[n * W.d + k]; }

  function turnAt(body, W, q) {
    const s = body.turn.length === 4 ? { ...W, a: 0, b: 0, c: 0, d: 0 } : W;
    return q.set(mix(body.turn, 4, s, 1), mix(body.turn, 4, s, 2), mix(body.turn, 4, s, 3), mix(body.turn, 4, s, 0)).normalize();
  }

  const Q = new T.Quaternion(), WEIGHTS = {};

  function tipAt(D, body, i, u, axes, out) {
    const W = weights(D, i, u, WEIGHTS);
    if (body.axis) return out.fromArray(body.axis).applyQuaternion(turnAt(body, W, Q));
    const n = D.names.length;
    return out.set(mix(body.tip, n, W, axes[0]), mix(body.tip, n, W, axes[1]), mix(body.tip, n, W, axes[2]));
  }

  // ---- the stage

  class Stage {
    constructor(canvas) {
      this.canvas = canvas;
      this.soft = location.hash !== "#full" && withoutGPU();
      this.renderer = new T.WebGLRenderer({ canvas, antialias: !this.soft, powerPreference: "high-performance" });
      this.renderer.shadowMap.enabled = true;
      this.renderer.shadowMap.type = T.PCFShadowMap;
      this.renderer.toneMapping = T.ACESFilmicToneMapping;
      this.half = { value: new T.Vector2(1, 1) };
      this.camera = new T.PerspectiveCamera(FOV, 1, 0.01, 1000);
      this.camera.up.set(0, 0, 1);
      this.controls = new T.OrbitControls(this.camera, canvas);
      Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, maxPolarAngle: 0.93 * Math.PI });
      this.controls.addEventListener("change", () => { this.dirty = true; });
      this.controls.addEventListener("start", () => { this.touched = true; });
      this.environment = this.soft ? null : this.room();
      this.coarse = this.finestMoving = this.soft ? 0.75 : 1; this.scale = 1; this.last = 0; this.times = []; this.together = false; this.axes = true; this.follow = false; this.heading = null;
      this.canvas.addEventListener("webglcontextrestored", () => { this.dirty = true; });
    }

    room() { // light that metal mirrors
      const made = new T.PMREMGenerator(this.renderer), { texture } = made.fromScene(new T.RoomEnvironment(), 0.04);
      made.dispose();
      return texture;
    }

    surface(options) {
      const { metalness = 0, roughness = 0.5, ...rest } = options;
      if (!this.soft) return new T.MeshStandardMaterial(options);
      return new T.MeshPhongMaterial({ ...rest, shininess: metalness > 0.5 ? 60 : 120 * (1 - roughness) ** 2, specular: metalness > 0.5 ? 0xffffff : roughness > 0.7 ? 0x000000 : 0x666666 });
    }

    build(D, colours, dark, axes3) {
      for (const old of [this.scene, this.globe?.scene]) old?.traverse((o) => { o.geometry?.dispose(); for (const m of [o.material ?? []].flat()) { m.map?.dispose(); m.dispose(); } });
      Object.assign(this, { D, colours, dark, axes3, dirty: true, fresh: true });
      const s = this.scene = new T.Scene(), r = D.radius;
      s.background = this.backdrop();
      s.environment = this.environment; s.environmentIntensity = dark ? 0.42 : 0.55;
      s.add(new T.HemisphereLight(dark ? 0xb9c8e6 : 0xffffff, dark ? 0x20242c : 0xcfc8bf, (dark ? 0.55 : 0.9) * (this.soft ? 2.2 : 1)));
      this.palette = [colours.colours[0], dark ? "#f4f1ea" : "#f3efe6", dark ? "#aeb6c2" : "#9aa3ad", dark ? "#27408f" : "#1e3a8a", dark ? "#4a505c" : "#3a3f47", colours.colours[1]].map((c) => new T.Color(c));
      this.lanes = D.bodies.map((body, number) => this.lane(body, number));
      this.globe = D.globe ? new Orbiting.Globe(this, D, colours, dark) : null;
      this.arrange();
      const lamp = new T.DirectionalLight(0xfff4e6, dark ? 2.0 : 2.4), reach = 1.5 * this.extent;
      lamp.position.set(0.9 * this.extent, -1.2 * this.extent, 2.6 * this.extent);
      lamp.castShadow = true; lamp.shadow.mapSize.setScalar(this.soft ? 512 : 2048); lamp.shadow.radius = this.soft ? 2 : 5; lamp.shadow.bias = -0.0004; lamp.shadow.normalBias = 0.01 * r;
      Object.assign(lamp.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1 * r, far: 8 * this.extent });
      const rim = new T.DirectionalLight(0xa9c7ff, dark ? 0.9 : 0.5);
      rim.position.set(-2, 1.6, 0.8);
      s.add(lamp, rim);
      if (!this.touched) this.reset();
    }

    backdrop() {
      const canvas = document.createElement("canvas"), c = canvas.getContext("2d"), [top, low] = this.dark ? ["#232934", "#0d0f13"] : ["#ffffff", "#dfe5ec"];
      canvas.width = 2; canvas.height = 256;
      const g = c.createLinearGradient(0, 0, 0, 256); g.addColorStop(0, top); g.addColorStop(1, low);
      c.fillStyle = g; c.fillRect(0, 0, 2, 256);
      const t = new T.CanvasTexture(canvas); t.colorSpace = T.SRGBColorSpace;
      return t;
    }

    lane(body, number) {
      const { D, colours } = this, r = D.radius, group = new T.Group(), many = D.bodies.length > 1;
      const own = many ? colours.colours[number % colours.colours.length] : colours.colours[0];
      const lane = { body, group, tip: new V(), number };
      lane.ground = D.kind === "satellite" ? new T.Group() : this.ground(); group.add(lane.ground);
      lane.arrows = Orbiting.arrows(this, body, r, colours.colours, !many); for (const each of lane.arrows) group.add(each);
      if (D.kind !== "path" && D.kind !== "projection") for (const turn of [[0, 0, 0], [90, 0, 0], [0, 90, 0]]) {
        const q = new T.Quaternion().setFromAxisAngle(new V(turn[0] ? 1 : 0, turn[1] ? 1 : 0, 0), Math.PI / 2);
        group.add(circle(this, r, 0, colours.faint, 1.1, this.dark ? 0.4 : 0.45, turn[0] || turn[1] ? q : null));
      }
      if (D.kind === "projection") group.add(this.cage());
      lane.path = this.path(body, many ? own : colours.faint); group.add(lane.path);
      lane.trail = new Ribbon(this, MOST_TRAIL, own, 4.5); group.add(lane.trail);
      if (body.mesh !== null) { lane.mesh = this.solid(body.mesh, own, many); group.add(lane.mesh); }
      else if (D.kind !== "path") { lane.rod = new Ribbon(this, 1, colours.colours[1], 3.5); group.add(lane.rod); }
      if (D.kind === "seen") { lane.rod = new Ribbon(this, 1, colours.colours[1], 3.5); group.add(lane.rod); }
      lane.ball = new T.Mesh(new T.SphereGeometry((D.kind === "particle" ? 0.055 : 0.026) * r, 24, 16), this.surface({ color: colours.colours[1], roughness: 0.35 }));
      lane.ball.castShadow = true; group.add(lane.ball);
      lane.axes = this.spaceAxes(); group.add(lane.axes);
      if (many) lane.axes.visible = false;
      if (lane.mesh && D.spins) { lane.own = this.bodyAxes(body.triad); lane.mesh.add(lane.own); }
      if (D.up) group.add(this.vertical(number));
      if (D.up === "gravity" && this.floor() < 0) group.add(this.post());
      if (body.name) { const name = word(body.name, many ? own : colours.ink, 0.034); name.position.set(0, -1.38 * r, this.floor() - 0.1 * r); lane.name = name; group.add(name); }
      this.scene.add(group);
      return lane;
    }

    floor() {
      const { D } = this;
      if (D.kind === "body" && D.up === "gravity" && D.lowest > 0.05 * D.radius) return 0;
      return -1.16 * D.radius;
    }

    ground() {
      const r = this.D.radius, g = new T.Group(), h = this.floor(), reach = 1.3 * r;
      const plate = new T.Mesh(new T.CylinderGeometry(reach, reach * 1.015, 0.04 * r, 96), this.surface({ color: this.dark ? "#2b313b" : "#eef1f4", roughness: 0.85 }));
      plate.rotation.x = Math.PI / 2; plate.position.z = h - 0.022 * r; plate.receiveShadow = true;
      g.add(plate);
      for (const part of [0.25, 0.5, 0.75, 1]) g.add(circle(this, part * 1.2 * r, h + 0.003 * r, this.colours.faint, 1, part === 1 ? 0.8 : 0.3));
      for (let k = 0; k < 12; k++) { const u = Math.PI * k / 6, c = Math.cos(u) * r, s = Math.sin(u) * r; g.add(line(this, [[1.14 * c, 1.14 * s, h + 0.003 * r], [1.2 * c, 1.2 * s, h + 0.003 * r]], this.colours.faint, 1, 0.8)); }
      return g;
    }

    post() {
      const r = this.D.radius, h = -this.floor(), post = new T.Mesh(new T.CylinderGeometry(0.014 * r, 0.05 * r, h, 28), this.surface({ color: this.palette[2], metalness: 0.85, roughness: 0.35 }));
      post.rotation.x = Math.PI / 2; post.position.z = -h / 2 - 0.012 * r; post.castShadow = true;
      return post;
    }

    cage() {
      const r = this.D.radius, g = new T.Group();
      this.axes3.forEach((c, k) => {
        const end = [0, 0, 0]; end[k] = 1.08 * r;
        g.add(line(this, [end.map((v) => -v), end], this.colours.faint, 1.5, 0.8));
        const name = word(`${this.D.letter}${this.D.names[c]}`, this.colours.ink, 0.03); name.position.set(...end.map((v) => 1.07 * v)); g.add(name);
      });
      return g;
    }

    spaceAxes() {
      const { D, colours } = this, g = new T.Group(), r = D.radius, names = ["x", "y", "z"];
      if (!D.frame) return g;
      const long = D.kind === "path" ? 0.5 : 1.26;
      if (D.kind === "path") g.position.set(-0.8 * r, -0.8 * r, this.floor() + 0.52 * r);
      D.frame.forEach((d, k) => {
        const end = d.map((v) => long * r * v), name = word(names[k], colours.faint, 0.028);
        g.add(line(this, [[0, 0, 0], end], colours.faint, 1.4, 0.9));
        name.position.set(...end.map((v) => 1.05 * v)); g.add(name);
      });
      return g;
    }

    bodyAxes(turn) {
      const g = new T.Group(), r = (this.D.kind === "path" ? 0.3 : 0.82) * this.D.radius, colours = [this.colours.colours[3], this.colours.colours[2], this.colours.colours[5]];
      colours.forEach((colour, k) => {
        const end = [0, 0, 0]; end[k] = r;
        g.add(line(this, [[0, 0, 0], end], colour, 2.2, 0.95));
        const name = word(String(k + 1), colour, 0.027); name.position.set(...end.map((v) => 1.09 * v)); g.add(name);
      });
      if (turn) g.quaternion.set(turn[1], turn[2], turn[3], turn[0]);
      return g;
    }

    vertical(number) {
      const { D, colours } = this, r = D.radius, g = new T.Group(), down = D.up === "gravity", a = arrow(this, (down ? 0.5 : 1.3) * r, (down ? 0.016 : 0.013) * r, colours.colours[2]);
      if (down) { g.position.set(-0.98 * r, -0.42 * r, this.floor() + 0.75 * r); a.rotation.x = Math.PI; }
      g.add(a);
      if (this.D.bodies.length === 1) { const name = word(down ? "gravity" : D.legend.arrow.split(" ")[0], colours.colours[2], 0.028); name.position.z = down ? 0.09 * r : 1.4 * r; g.add(name); }
      return g;
    }

    solid(place, own, many) {
      const { points, faces, colour } = this.D.meshes[place], g = new T.BufferGeometry(), palette = this.palette.slice();
      if (many) palette[0] = new T.Color(own);
      g.setAttribute("position", new T.BufferAttribute(points, 3)); g.setIndex(new T.BufferAttribute(faces, 1));
      const shown = T.toCreasedNormals(g, 0.7), shades = new Float32Array(9 * colour.length), rough = [];
      colour.forEach((c, f) => { for (let k = 0; k < 3; k++) palette[c].toArray(shades, 9 * f + 3 * k); rough.push(c); });
      shown.setAttribute("color", new T.BufferAttribute(shades, 3));
      let from = 0; // a group for metal, a group for paint
      for (let f = 1; f <= rough.length; f++) if (f === rough.length || (rough[f] === 2) !== (rough[f - 1] === 2)) { shown.addGroup(3 * from, 3 * (f - from), rough[f - 1] === 2 ? 1 : 0); from = f; }
      const paint = this.surface({ vertexColors: true, roughness: 0.32, metalness: 0.05, side: T.DoubleSide }), metal = this.surface({ vertexColors: true, roughness: 0.28, metalness: 0.85, side: T.DoubleSide });
      const mesh = new T.Mesh(shown, [paint, metal]);
      mesh.castShadow = mesh.receiveShadow = true;
      return mesh;
    }

    path(body, colour) {
      const { D } = this, p = new V(), flat = [];
      const whole = D.count <= 2500 && D.windows.length === 1 && D.windows[0][1] - D.windows[0][0] === D.count - 1;
      if (whole) {
        for (let i = 0; i < D.count; i++) for (const u of i + 1 < D.count ? [0, 0.5] : [0]) flat.push(...tipAt(D, body, i, u, this.axes3, p).toArray());
        return new Ribbon(this, flat.length / 3, colour, D.kind === "path" ? 2 : 1.2, D.kind === "path" ? 0.9 : 0.5).put(flat, flat.length / 3);
      }
      for (let k = 0, step = stride(D.path.length); k < D.path.length; k++) { const i = D.path[k * step % D.path.length]; flat.push(...tipAt(D, body, i, 0, this.axes3, p).toArray()); }
      const g = new T.BufferGeometry();
      g.setAttribute("position", new T.BufferAttribute(new Float32Array(flat), 3));
      const dots = new T.Points(g, new T.PointsMaterial({ color: colour, size: 1.8, sizeAttenuation: false, transparent: true, opacity: 0.55, depthWrite: false, toneMapped: false }));
      dots.frustumCulled = false;
      return dots;
    }

    arrange() {
      const r = this.D.radius, L = this.lanes.length, apart = this.together ? 0 : 2.9 * r, columns = Math.ceil(Math.sqrt(L * (this.wide ? 1.6 : 0.7))), rows = Math.ceil(L / columns);
      const across = Math.min(L, columns);
      this.lanes.forEach((lane, k) => {
        const row = Math.floor(k / columns), inRow = Math.min(columns, L - row * columns);
        lane.group.position.set((k % columns - (inRow - 1) / 2) * apart, ((rows - 1) / 2 - row) * 1.35 * apart, 0);
        lane.ground.visible = !this.together || k === 0;
        if (lane.mesh) lane.mesh.visible = !this.together || L === 1;
        if (lane.name) lane.name.visible = !this.together && L > 1;
      });
      this.extent = this.together || L === 1 ? 1.35 * r : Math.max(across, rows) * 1.55 * r;
      this.box = this.together || L === 1 ? (this.D.kind === "satellite" ? [1.5 * r, 1.36 * r] : [1.42 * r, 1.25 * r]) : [(across - 1) * apart / 2 * 0.95 + 1.4 * r, (rows - 1) * apart * 0.42 + 1.45 * r];
      this.dirty = true;
    }

    reset() {
      const { D } = this, r = D.radius, up = this.floor() === 0 && this.lanes.length === 1, tan = Math.tan(FOV * Math.PI / 360);
      const away = Math.max(this.box[1] / tan, this.box[0] / (tan * this.camera.aspect)) * 1.06;
      this.controls.target.set(0, 0, up ? 0.42 * r : -0.02 * r);
      const side = this.lanes.length > 1 && !this.together, d = new V(side ? 0.02 : 0.62, side ? -1 : -0.72, side ? 0.75 : 0.4).normalize().multiplyScalar((up ? 0.86 : 1) * away);
      this.camera.position.copy(this.controls.target).add(d);
      Object.assign(this.camera, { near: 0.02 * r, far: 60 * away }); this.camera.updateProjectionMatrix();
      this.touched = false; this.heading = null; this.dirty = true;
    }

    size(same = false) {
      const { clientWidth: w, clientHeight: h } = this.canvas.parentElement;
      if (!w || !h) return;
      this.renderer.setPixelRatio(Math.min(2, devicePixelRatio) * this.scale);
      this.renderer.setSize(w, h, false);
      this.half.value.set(w / 2, h / 2);
      this.dirty = true;
      if (same) return;
      this.camera.aspect = w / h; this.camera.updateProjectionMatrix();
      const wide = w > h;
      if (this.lanes && wide !== this.wide) { this.wide = wide; this.arrange(); }
      if (this.lanes && !this.touched) this.reset();
      this.wide = wide; this.dirty = true;
    }

    // ---- one picture

    pose(frame, part, time, trail) {
      const { D } = this, p = new V(), moment = { ...weights(D, frame, part, WEIGHTS) }, mixed = (list, k) => mix(list, 3, moment, k);
      this.globe?.pose(mixed);
      for (const lane of this.lanes) {
        tipAt(D, lane.body, frame, part, this.axes3, lane.tip);
        lane.ball.position.copy(lane.tip);
        if (lane.mesh) {
          turnAt(lane.body, weights(D, frame, part, WEIGHTS), lane.mesh.quaternion);
          if (D.kind === "path") { lane.mesh.position.copy(lane.tip); lane.ball.position.add(p.fromArray(lane.body.nose).applyQuaternion(lane.mesh.quaternion)); }
        }
        lane.rod?.put([0, 0, 0, ...lane.tip.toArray()], 2);
        for (const each of lane.arrows) Orbiting.point(each, mixed);
        this.tail(lane, frame, time, trail);
      }
      if (this.follow) this.followed();
      this.dirty = true;
    }

    tail(lane, frame, time, trail) {
      const { D } = this, first = D.first[frame], begun = Math.max(D.time[first], time - trail), p = new V();
      const count = Math.max(2, Math.min(MOST_TRAIL, Math.ceil((time - begun) * D.rate / STEP)));
      if (!(time > begun)) { lane.trail.put([], 0); return; }
      const flat = new Float32Array(3 * count);
      let i = first;
      for (let low = first, high = frame; low < high;) { const mid = (low + high + 1) >> 1; if (D.time[mid] <= begun) low = mid; else high = mid - 1; i = low; }
      for (let k = 0; k < count; k++) {
        const t = k + 1 === count ? time : begun + (time - begun) * k / (count - 1);
        while (i + 1 < D.count && i < frame && D.time[i + 1] <= t) i++;
        const gap = D.time[Math.min(i + 1, D.count - 1)] - D.time[i];
        tipAt(D, lane.body, i, gap > 0 ? Math.min(1, (t - D.time[i]) / gap) : 0, this.axes3, p).toArray(flat, 3 * k);
      }
      const whole = time - trail <= D.time[first] ? 0.25 : 0;
      lane.trail.put(flat, count, (k) => Math.max(whole, k / (count - 1)) ** 1.4);
    }

    followed() { // with the body on its path, or around the vertical with the axis
      const tip = this.lanes[0].tip, heading = this.D.kind === "path" ? tip.clone() : Math.atan2(tip.y, tip.x), before = this.heading;
      this.heading = heading;
      if (before === null) return;
      if (this.D.kind === "path") { const d = heading.clone().sub(before); this.camera.position.add(d); this.controls.target.add(d); return; }
      const q = new T.Quaternion().setFromAxisAngle(new V(0, 0, 1), heading - before);
      this.camera.position.sub(this.controls.target).applyQuaternion(q).add(this.controls.target);
    }

    show(playing, now) {
      this.controls.update();
      if (this.dirty) this.moved = now;
      const rest = !playing && now - this.moved > REST, scale = rest ? Math.max(1, this.soft ? 1.7 / devicePixelRatio : 1) : this.coarse;
      if (scale !== this.scale) { this.scale = scale; this.size(true); }
      if (!this.dirty) return false;
      for (const lane of this.lanes) {
        lane.axes.visible = this.axes && (this.lanes.length === 1 || this.together && lane.number === 0);
        if (lane.own) lane.own.visible = this.axes && this.lanes.length === 1;
        if (this.soft && lane.path.isPoints) lane.path.geometry.setDrawRange(0, this.scale > 1 ? Infinity : Math.ceil(MOVING / this.lanes.length));
      }
      if (this.soft) { // a shadow for two pictures
        const { shadowMap } = this.renderer;
        shadowMap.autoUpdate = false; this.even = !this.even; shadowMap.needsUpdate = this.even || this.scale !== this.coarse || this.fresh;
        this.fresh = false;
      }
      this.paint();
      this.dirty = false;
      if (playing) this.adapt(now);
      this.last = now;
      return true;
    }

    adapt(now) { // coarser where pictures are slow, finer again where a stage finer (1.8 times the points) would not be
      if (now - this.last < 1000) this.times.push(now - this.last);
      if (this.times.length < 6) return;
      const typical = this.times.sort((a, b) => a - b)[3];
      this.times = [];
      if (typical > SLOW) this.coarse = Math.max(LEAST, this.coarse * COARSER);
      else if (typical < SLOW / 2) this.coarse = Math.min(this.finestMoving, this.coarse / COARSER);
    }

    finest() { // for a file
      this.scale = Math.max(1, 2 / devicePixelRatio); this.size(true);
      this.paint();
      this.dirty = true;
    }

    paint() {
      const { clientWidth: w, clientHeight: h } = this.canvas.parentElement;
      this.renderer.render(this.scene, this.camera);
      this.globe?.paint(this.renderer, this.camera, this.controls.target, w, h);
    }
  }

  return { Stage, tipAt };
})();
