// OimoPhysics: a body without shape; damping and sleeping off.
import { oimo } from "oimophysics";
import { serve } from "./wire.mjs";

const { common, dynamics } = oimo;
await serve((job) => {
  const vector = (v) => new common.Vec3(...(v ?? [0, 0, 0]));
  const world = new dynamics.World(2, vector(job.gravity));
  const add = (type) => {
    const config = new dynamics.rigidbody.RigidBodyConfig();
    config.type = type;
    config.autoSleep = false;
    config.linearDamping = config.angularDamping = 0;
    const body = new dynamics.rigidbody.RigidBody(config);
    world.addRigidBody(body);
    return body;
  };
  const body = add(dynamics.rigidbody.RigidBodyType.DYNAMIC);
  const data = new dynamics.rigidbody.MassData();
  data.mass = job.mass;
  data.localInertia = new common.Mat3(...job.inertia.flat());
  const [w, x, y, z] = job.attitude;
  body.setMassData(data);
  body.setPosition(vector(job.arm));
  body.setOrientation(new common.Quat(x, y, z, w));
  body.setLinearVelocity(vector(job.velocity));
  body.setAngularVelocity(vector(job.angular_velocity));
  if (job.arm) {
    const joint = new dynamics.constraint.joint.SphericalJointConfig();
    joint.init(add(dynamics.rigidbody.RigidBodyType.STATIC), body, vector(null));
    world.addJoint(new dynamics.constraint.joint.SphericalJoint(joint));
  }
  return {
    step: () => world.step(job.dt),
    state: () => {
      const q = body.getOrientation(), v = body.getAngularVelocity();
      return [[q.w, q.x, q.y, q.z], [v.x, v.y, v.z]];
    },
  };
});
