// Oimo.js: a sphere whose moments are set; sleeping off.
import { createRequire } from "node:module";
import { serve } from "./wire.mjs";

const OIMO = createRequire(`${process.cwd()}/`)("oimo");

await serve((job) => {
  const world = new OIMO.World({ timestep: job.dt, iterations: 8, worldscale: 1, gravity: job.gravity ?? [0, 0, 0] });
  world.gravity.set(...(job.gravity ?? [0, 0, 0]));
  const body = world.add({ type: "sphere", size: [0.01], pos: job.arm ?? [0, 0, 0], move: true, density: 1 });
  const [w, x, y, z] = job.attitude;
  body.allowSleep = false;
  body.orientation.set(x, y, z, w);
  body.mass = job.mass;
  body.inverseMass = 1 / job.mass;
  body.localInertia.set(...job.inertia.flat());
  body.inverseLocalInertia.set(...job.inertia.flat().map((m) => (m ? 1 / m : 0)));
  body.syncShapes();
  body.linearVelocity.set(...job.velocity);
  body.angularVelocity.set(...job.angular_velocity);
  return {
    step: () => world.step(),
    state: () => {
      const q = body.orientation, v = body.angularVelocity;
      return [[q.w, q.x, q.y, q.z], [v.x, v.y, v.z]];
    },
  };
});
