// cannon-es: a body without shape; damping and sleeping off.
import * as CANNON from "cannon-es";
import { serve } from "./wire.mjs";

await serve((job) => {
  const vector = (v) => new CANNON.Vec3(...(v ?? [0, 0, 0]));
  const world = new CANNON.World({ gravity: vector(job.gravity), allowSleep: false });
  const [w, x, y, z] = job.attitude;
  const body = new CANNON.Body({ mass: job.mass, linearDamping: 0, angularDamping: 0, position: vector(job.arm) });
  body.quaternion.set(x, y, z, w);
  body.velocity.copy(vector(job.velocity));
  body.angularVelocity.copy(vector(job.angular_velocity));
  // Without a shape the moments are not computed: they are set, and turned into space before the first step.
  const moments = [0, 1, 2].map((k) => job.inertia[k][k]);
  body.inertia.set(...moments);
  body.invInertia.set(...moments.map((m) => 1 / m));
  body.updateInertiaWorld(true);
  world.addBody(body);
  if (job.arm) {
    const ground = new CANNON.Body({ mass: 0 });
    world.addBody(ground);
    world.addConstraint(new CANNON.PointToPointConstraint(ground, vector(null), body, vector(job.arm.map((a) => -a)), 1e9));
  }
  return {
    step: () => world.step(job.dt),
    state: () => {
      const q = body.quaternion, v = body.angularVelocity;
      return [[q.w, q.x, q.y, q.z], [v.x, v.y, v.z]];
    },
  };
});
