// Rapier, https://rapier.rs: a body without shape; damping and sleeping off.
import RAPIER from "@dimforge/rapier3d-compat";
import { serve } from "./wire.mjs";

const vector = ([x, y, z]) => ({ x, y, z });

await RAPIER.init();
await serve((job) => {
  const world = new RAPIER.World(vector(job.gravity ?? [0, 0, 0]));
  world.timestep = job.dt;
  const moments = [0, 1, 2].map((k) => job.inertia[k][k]);
  const [w, x, y, z] = job.attitude;
  const body = world.createRigidBody(
    RAPIER.RigidBodyDesc.dynamic()
      .setTranslation(...(job.arm ?? [0, 0, 0]))
      .setRotation({ w, x, y, z })
      .setAdditionalMassProperties(job.mass, vector([0, 0, 0]), vector(moments), { w: 1, x: 0, y: 0, z: 0 })
      .setLinearDamping(0)
      .setAngularDamping(0)
      .setCanSleep(false)
      .setLinvel(...(job.velocity ?? [0, 0, 0]))
      .setAngvel(vector(job.angular_velocity)),
  );
  if (job.arm) {
    const ground = world.createRigidBody(RAPIER.RigidBodyDesc.fixed());
    const joint = RAPIER.JointData.spherical(vector([0, 0, 0]), vector(job.arm.map((a) => -a)));
    world.createImpulseJoint(joint, ground, body, true);
  }
  return {
    step: () => world.step(),
    state: () => {
      const q = body.rotation(), v = body.angvel();
      return [[q.w, q.x, q.y, q.z], [v.x, v.y, v.z]];
    },
  };
});
