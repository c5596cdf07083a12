// ammo.js, Bullet compiled for JavaScript: a sphere with the moments given; damping and sleeping off.
// Setting: the flag of btRigidBody for the gyroscopic term, 2 explicit, 4 implicit in space, 8 implicit in the body.
import { createRequire } from "node:module";
import { serve } from "./wire.mjs";

await serve(async (job) => {
  const A = await createRequire(`${process.cwd()}/`)(job.package)();
  const vector = (v) => new A.btVector3(...(v ?? [0, 0, 0]));
  const collision = new A.btDefaultCollisionConfiguration();
  const world = new A.btDiscreteDynamicsWorld(new A.btCollisionDispatcher(collision), new A.btDbvtBroadphase(),
    new A.btSequentialImpulseConstraintSolver(), collision);
  world.setGravity(vector(job.gravity));
  const add = (mass, moments, place, [w, x, y, z]) => {
    const frame = new A.btTransform();
    frame.setIdentity();
    frame.setOrigin(vector(place));
    frame.setRotation(new A.btQuaternion(x, y, z, w));
    const body = new A.btRigidBody(new A.btRigidBodyConstructionInfo(
      mass, new A.btDefaultMotionState(frame), new A.btSphereShape(0.01), vector(moments)));
    world.addRigidBody(body);
    return body;
  };
  const body = add(job.mass, [0, 1, 2].map((k) => job.inertia[k][k]), job.arm, job.attitude);
  body.setDamping(0, 0);
  body.setActivationState(4); // DISABLE_DEACTIVATION
  body.setLinearVelocity(vector(job.velocity));
  body.setAngularVelocity(vector(job.angular_velocity));
  if (job.setting) body.setFlags(Number(job.setting));
  if (job.arm) world.addConstraint(new A.btPoint2PointConstraint(body, vector(job.arm.map((a) => -a))), true);
  return {
    step: () => world.stepSimulation(job.dt, 0),
    state: () => {
      const q = body.getWorldTransform().getRotation(), v = body.getAngularVelocity();
      return [[q.w(), q.x(), q.y(), q.z()], [v.x(), v.y(), v.z()]];
    },
  };
});
