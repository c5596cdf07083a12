"use strict";
// A satellite: arrows from its centre, and the primary with its night side, the orbit and the place on it, in a corner.
const Orbiting = (() => {
  const T = Library, V = T.Vector3, UP = new V(0, 0, 1), SHARE = 0.36, MOST = 2000; // of the picture; points of an orbit

  const BALL = {
    vertexShader: "varying vec3 n; void main() { n = normalize(position); gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: `varying vec3 n; uniform vec3 sun, day, night, mesh; uniform float known;
      float near(float angle) { float a = angle / radians(30.0), d = abs(fract(a + 0.5) - 0.5); return 1.0 - smoothstep(0.0, 1.6 * fwidth(a), d); }
      void main() { float lit = mix(1.0, smoothstep(-0.06, 0.12, dot(n, sun)), known), around = atan(n.y, n.x);
        float lines = max(near(asin(clamp(n.z, -1.0, 1.0))), abs(around) > 3.0 ? 0.0 : near(around)) * step(abs(n.z), 0.985);
        gl_FragColor = vec4(mix(mix(night, day, lit), mesh, 0.35 * lines), 1.0);
        #include <colorspace_fragment>
      }`,
  };

  function arrows(stage, body, radius, colours, named) {
    return body.arrows.map((each) => {
      const group = new T.Group(), colour = colours[each.colour];
      group.add(Lines.arrow(stage, 1.12 * radius, 0.01 * radius, colour));
      if (named) { const name = Lines.word(each.name, colour, 0.026); name.position.z = 1.2 * radius; group.add(name); }
      group.to = each.to;
      return group;
    });
  }

  const aim = new V();

  function point(group, mixed) { group.quaternion.setFromUnitVectors(UP, aim.set(mixed(group.to, 0), mixed(group.to, 1), mixed(group.to, 2)).normalize()); }

  class Globe {
    constructor(stage, D, colours, dark) {
      const half = { value: new T.Vector2(1, 1) }, proxy = { half }, color = (c) => new T.Color(c), { globe } = D;
      Object.assign(this, { D, half, scene: new T.Scene(), camera: new T.PerspectiveCamera(30, 1, 0.1, 50) });
      const shades = globe.earth ? ["#3f83c4", "#10202f", "#ffffff"] : ["#b9a98c", "#2b2620", "#ffffff"];
      const [day, night, mesh] = shades.map(color);
      this.ball = new T.Mesh(new T.SphereGeometry(globe.size, 64, 40), new T.ShaderMaterial({ ...BALL, uniforms: { sun: { value: new V(1, 0, 0) }, known: { value: globe.sun ? 1 : 0 }, day: { value: day }, night: { value: night }, mesh: { value: mesh } } }));
      this.scene.add(this.ball);
      this.scene.add(Lines.line(proxy, [[0, 0, globe.size], [0, 0, 1.25 * globe.size]], colours.ink, 1.4, 0.9));
      const pole = Lines.word("N", colours.ink, 0.055); pole.position.z = 1.36 * globe.size; this.scene.add(pole);
      this.dots = D.bodies.map((body, k) => {
        const colour = colours.colours[D.bodies.length > 1 ? k % colours.colours.length : 0], step = Math.ceil(D.count / MOST), list = [];
        for (let i = 0; i < D.count; i += step) list.push([...body.place.subarray(3 * i, 3 * i + 3)]);
        this.scene.add(Lines.line(proxy, list, colour, 2, 0.75));
        const dot = new T.Mesh(new T.SphereGeometry(0.055, 20, 14), stage.surface({ color: colours.colours[1], emissive: colours.colours[1], emissiveIntensity: 0.8 }));
        dot.place = body.place; this.scene.add(dot);
        return dot;
      });
      if (globe.sun) {
        this.ray = new T.Group(); this.ray.to = globe.sun;
        this.ray.add(Lines.line(proxy, [[0, 0, 1.03], [0, 0, 1.22]], colours.colours[4], 3.5, 1));
        const name = Lines.word("Sun", colours.colours[4], 0.055); name.position.z = 1.36; this.ray.add(name); this.scene.add(this.ray);
      }
      this.scene.add(new T.HemisphereLight(0xffffff, 0xffffff, dark ? 1.6 : 2));
    }

    pose(mixed) {
      for (const dot of this.dots) dot.position.set(mixed(dot.place, 0), mixed(dot.place, 1), mixed(dot.place, 2));
      if (this.ray) { point(this.ray, mixed); this.ball.material.uniforms.sun.value.copy(aim); }
    }

    paint(renderer, camera, target, width, height) { // in the lower right corner, seen from the direction of the main camera
      const side = Math.round((this.dots.length > 1 ? 0.7 : 1) * SHARE * Math.min(width, height)), x = width - side - 6, y = 6;
      this.half.value.set(side / 2, side / 2);
      this.camera.position.copy(camera.position).sub(target).normalize().multiplyScalar(6.6);
      this.camera.up.copy(camera.up); this.camera.lookAt(0, 0, 0);
      renderer.autoClear = false; renderer.clearDepth();
      renderer.setViewport(x, y, side, side); renderer.setScissor(x, y, side, side); renderer.setScissorTest(true);
      renderer.render(this.scene, this.camera);
      renderer.setScissorTest(false); renderer.setViewport(0, 0, width, height); renderer.autoClear = true;
    }
  }

  return { Globe, arrows, point };
})();
