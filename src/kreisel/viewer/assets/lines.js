"use strict";
// Lines of a width that fade, words and arrows in the picture.
const Lines = (() => {
  const T = Library, V = T.Vector3;

  // ---- lines of a width in pixels that fade

  const LINE = {
    vertexShader: `attribute vec3 other; attribute vec2 look; uniform vec2 half_; uniform float width; varying float fade;
      void main() { vec4 p = projectionMatrix * modelViewMatrix * vec4(position, 1.0), q = projectionMatrix * modelViewMatrix * vec4(other, 1.0);
        vec2 d = (q.xy / q.w - p.xy / p.w) * half_; d = d / max(length(d), 1e-4);
        p.xy += vec2(-d.y, d.x) * look.x * width * (0.35 + 0.65 * look.y) / half_ * p.w; gl_Position = p; fade = look.y; }`,
    fragmentShader: `uniform vec3 colour; uniform float alpha; varying float fade;
      void main() { gl_FragColor = vec4(colour, alpha * fade);
        #include <colorspace_fragment>
      }`,
  };

  class Ribbon extends T.Mesh {
    constructor(stage, most, colour, width, alpha = 1) {
      const g = new T.BufferGeometry(), add = (name, n) => g.setAttribute(name, new T.BufferAttribute(new Float32Array(4 * most * n), n));
      add("position", 3); add("other", 3); add("look", 2);
      const index = new Uint32Array(6 * most);
      for (let k = 0; k < most; k++) index.set([4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 2, 4 * k + 1, 4 * k + 3], 6 * k);
      g.setIndex(new T.BufferAttribute(index, 1));
      super(g, new T.ShaderMaterial({ ...LINE, transparent: true, depthWrite: false, side: T.DoubleSide,
        uniforms: { half_: stage.half, width: { value: width / 2 }, alpha: { value: alpha }, colour: { value: new T.Color(colour) } } }));
      this.frustumCulled = false; this.renderOrder = 1; this.most = most;
    }
    // points: flat numbers; fade(k) of point k; breaks(k): no line from point k to the next
    put(points, count, fade = () => 1, breaks = () => false) {
      const { position, other, look } = this.geometry.attributes;
      let s = 0;
      for (let k = 0; k + 1 < count && s < this.most; k++) {
        if (breaks(k)) continue;
        for (let e = 0; e < 4; e++) {
          const near = 3 * (k + (e >> 1)), far = 3 * (k + 1 - (e >> 1)), v = 4 * s + e;
          for (let c = 0; c < 3; c++) { position.array[3 * v + c] = points[near + c]; other.array[3 * v + c] = points[far + c]; }
          look.array[2 * v] = (e & 1 ? 1 : -1) * (e >> 1 ? -1 : 1); look.array[2 * v + 1] = fade(k + (e >> 1));
        }
        s++;
      }
      this.geometry.setDrawRange(0, 6 * s);
      for (const a of [position, other, look]) { a.clearUpdateRanges(); a.addUpdateRange(0, 4 * s * a.itemSize); a.needsUpdate = true; }
      return this;
    }
  }

  function line(stage, list, colour, width, alpha) {
    const flat = list.flat();
    return new Ribbon(stage, Math.max(1, list.length - 1), colour, width, alpha).put(flat, list.length);
  }

  function circle(stage, radius, height, colour, width, alpha, turn) {
    const list = [];
    for (let k = 0; k <= 96; k++) { const v = 2 * Math.PI * k / 96, p = new V(radius * Math.cos(v), radius * Math.sin(v), height); if (turn) p.applyQuaternion(turn); list.push(p.toArray()); }
    return line(stage, list, colour, width, alpha);
  }

  function word(text, colour, size) {
    const canvas = document.createElement("canvas"), c = canvas.getContext("2d"), font = "600 44px system-ui, sans-serif";
    c.font = font; canvas.width = Math.ceil(c.measureText(text).width) + 16; canvas.height = 60;
    c.font = font; c.fillStyle = colour; c.textBaseline = "middle"; c.fillText(text, 8, 30);
    const map = new T.CanvasTexture(canvas); map.colorSpace = T.SRGBColorSpace;
    const sprite = new T.Sprite(new T.SpriteMaterial({ map, depthTest: false, transparent: true, sizeAttenuation: false, toneMapped: false }));
    sprite.scale.set(size * canvas.width / 60, size, 1); sprite.renderOrder = 3;
    return sprite;
  }

  function arrow(stage, length, thick, colour) { // along the third axis
    const g = new T.Group(), m = stage.surface({ color: colour, roughness: 0.5 }), head = 5.5 * thick;
    const rod = new T.Mesh(new T.CylinderGeometry(thick, thick, length - head, 20), m), tip = new T.Mesh(new T.ConeGeometry(2.6 * thick, head, 28), m);
    rod.position.z = (length - head) / 2; tip.position.z = length - head / 2;
    for (const part of [rod, tip]) { part.rotation.x = Math.PI / 2; part.castShadow = true; g.add(part); }
    return g;
  }

  function stride(n) { // takes them all, spread evenly from the first on
    let step = Math.max(1, Math.round(0.381966 * n));
    const common = (a, b) => (b ? common(b, a % b) : a);
    while (common(step, n) > 1) step++;
    return step;
  }

  return { Ribbon, line, circle, word, arrow, stride };
})();
