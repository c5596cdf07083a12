// Jolt Physics: a box whose moments are overridden; damping and sleeping off, no limit of angular velocity.
// Setting "gyroscopic" turns on mApplyGyroscopicForce, which is off by default.
import initJolt from "jolt-physics";
import { serve } from "./wire.mjs";

await serve(async (job) => {
  const J = await initJolt();
  const settings = new J.JoltSettings();
  const broad = new J.BroadPhaseLayerInterfaceTable(1, 1), pairs = new J.ObjectLayerPairFilterTable(1);
  broad.MapObjectToBroadPhaseLayer(0, new J.BroadPhaseLayer(0));
  settings.mObjectLayerPairFilter = pairs;
  settings.mBroadPhaseLayerInterface = broad;
  settings.mObjectVsBroadPhaseLayerFilter = new J.ObjectVsBroadPhaseLayerFilterTable(broad, 1, pairs, 1);
  const jolt = new J.JoltInterface(settings);
  const system = jolt.GetPhysicsSystem();
  const bodies = system.GetBodyInterface();
  const vector = (v) => new J.Vec3(...(v ?? [0, 0, 0]));
  system.SetGravity(vector(job.gravity));
  const add = (place, turn, motion, finish) => {
    const made = new J.BodyCreationSettings(
      new J.SphereShape(0.01), new J.RVec3(...(place ?? [0, 0, 0])), turn, motion, 0);
    finish?.(made);
    const body = bodies.CreateBody(made);
    bodies.AddBody(body.GetID(), J.EActivation_Activate);
    return body;
  };
  const [w, x, y, z] = job.attitude;
  const body = add(job.arm, new J.Quat(x, y, z, w), J.EMotionType_Dynamic, (made) => {
    made.mApplyGyroscopicForce = job.setting === "gyroscopic";
    made.mLinearDamping = made.mAngularDamping = 0;
    made.mAllowSleeping = false;
    made.mMaxAngularVelocity = made.mMaxLinearVelocity = 1e6;
    made.mLinearVelocity = vector(job.velocity);
    made.mAngularVelocity = vector(job.angular_velocity);
    made.mOverrideMassProperties = J.EOverrideMassProperties_MassAndInertiaProvided;
    made.mMassPropertiesOverride.mMass = job.mass;
    made.mMassPropertiesOverride.mInertia = J.Mat44.prototype.sIdentity();
  });
  const inverse = [0, 1, 2].map((k) => 1 / job.inertia[k][k]);
  body.GetMotionProperties().SetInverseInertia(vector(inverse), new J.Quat(0, 0, 0, 1));
  if (job.arm) {
    const ground = add(null, new J.Quat(0, 0, 0, 1), J.EMotionType_Static);
    const joint = new J.PointConstraintSettings();
    joint.mPoint1 = joint.mPoint2 = new J.RVec3(0, 0, 0);
    system.AddConstraint(joint.Create(ground, body));
  }
  return {
    step: () => jolt.Step(job.dt, 1),
    state: () => {
      const q = body.GetRotation(), v = body.GetAngularVelocity();
      return [[q.GetW(), q.GetX(), q.GetY(), q.GetZ()], [v.GetX(), v.GetY(), v.GetZ()]];
    },
  };
});
