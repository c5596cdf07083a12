// PhysX as physx-js-webidl: a body without shape; damping and sleeping off, no limit of angular velocity.
// Setting "gyroscopic" turns on eENABLE_GYROSCOPIC_FORCES, bit 10, off by default.
// The package is compiled for web pages: node is hidden from it while it loads.
import { readFileSync } from "node:fs";
import PhysX from "physx-js-webidl";
import { serve } from "./wire.mjs";

await serve(async (job) => {
  const wasmBinary = readFileSync("node_modules/physx-js-webidl/physx-js-webidl.wasm"), { process } = globalThis;
  Object.assign(globalThis, { process: undefined, window: globalThis });
  const P = await PhysX({ wasmBinary });
  globalThis.process = process;
  const top = P.PxTopLevelFunctions.prototype;
  const foundation = top.CreateFoundation(P.PHYSICS_VERSION, new P.PxDefaultAllocator(), new P.PxDefaultErrorCallback());
  const scale = new P.PxTolerancesScale();
  const physics = top.CreatePhysics(P.PHYSICS_VERSION, foundation, scale);
  top.InitExtensions(physics);
  const vector = (v) => new P.PxVec3(...(v ?? [0, 0, 0]));
  const description = new P.PxSceneDesc(scale);
  description.gravity = vector(job.gravity);
  description.cpuDispatcher = top.DefaultCpuDispatcherCreate(0);
  description.filterShader = top.DefaultFilterShader();
  const scene = physics.createScene(description);
  const [w, x, y, z] = job.attitude;
  const body = physics.createRigidDynamic(new P.PxTransform(vector(job.arm), new P.PxQuat(x, y, z, w)));
  body.setMass(job.mass);
  body.setMassSpaceInertiaTensor(vector([0, 1, 2].map((k) => job.inertia[k][k])));
  body.setLinearDamping(0);
  body.setAngularDamping(0);
  body.setSleepThreshold(0);
  body.setMaxAngularVelocity(1e6);
  if (job.setting === "gyroscopic") body.setRigidBodyFlag(1 << 10, true);
  scene.addActor(body);
  body.setLinearVelocity(vector(job.velocity));
  body.setAngularVelocity(vector(job.angular_velocity));
  if (job.arm) {
    const still = new P.PxQuat(0, 0, 0, 1);
    const ground = physics.createRigidStatic(new P.PxTransform(vector(null), still));
    scene.addActor(ground);
    top.SphericalJointCreate(physics, ground, new P.PxTransform(vector(null), still),
      body, new P.PxTransform(vector(job.arm.map((a) => -a)), still));
  }
  return {
    step: () => { scene.simulate(job.dt); scene.fetchResults(true); body.wakeUp(); },
    state: () => {
      const q = body.getGlobalPose().q, v = body.getAngularVelocity();
      return [[q.w, q.x, q.y, q.z], [v.x, v.y, v.z]];
    },
  };
});
