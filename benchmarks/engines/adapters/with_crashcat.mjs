// crashcat: an empty shape with the mass properties given; damping and sleeping off, no limit of angular velocity.
import * as cat from "crashcat";
import { serve } from "./wire.mjs";

await serve((job) => {
  cat.registerAll();
  const settings = cat.createWorldSettings();
  settings.gravity = job.gravity ?? [0, 0, 0];
  const layer = cat.addObjectLayer(settings, cat.addBroadphaseLayer(settings));
  const world = cat.createWorld(settings);
  const zero = [0, 0, 0], moments = [0, 1, 2].map((k) => job.inertia[k][k]);
  const [w, x, y, z] = job.attitude;
  const add = (motionType, more) => cat.rigidBody.create(world, {
    motionType, objectLayer: layer, shape: cat.sphere.create({ radius: 0.01 }), ...more });
  const body = add(cat.MotionType.DYNAMIC, {
    position: job.arm ?? zero, quaternion: [x, y, z, w], allowSleeping: false, linearDamping: 0, angularDamping: 0,
    maxAngularVelocity: 1e6, maxLinearVelocity: 1e6,
    massPropertiesOverride: {
      mass: job.mass, inertia: [moments[0], 0, 0, 0, 0, moments[1], 0, 0, 0, 0, moments[2], 0, 0, 0, 0, 1] },
  });
  cat.rigidBody.setLinearVelocity(world, body, job.velocity ?? zero);
  cat.rigidBody.setAngularVelocity(world, body, job.angular_velocity);
  if (job.arm) {
    const ground = add(cat.MotionType.STATIC, { position: zero });
    cat.pointConstraint.create(world, { bodyIdA: ground.id, bodyIdB: body.id, pointA: zero, pointB: zero });
  }
  return {
    step: () => cat.updateWorld(world, undefined, job.dt),
    state: () => {
      const [qx, qy, qz, qw] = body.quaternion;
      return [[qw, qx, qy, qz], [...body.motionProperties.angularVelocity]];
    },
  };
});
