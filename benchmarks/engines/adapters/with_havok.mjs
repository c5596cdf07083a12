// Havok, as Babylon.js has it: a body without shape; damping and sleeping off, no limit of speed.
import { readFileSync } from "node:fs";
import HavokPhysics from "@babylonjs/havok";
import { serve } from "./wire.mjs";

const wasmBinary = readFileSync("node_modules/@babylonjs/havok/lib/esm/HavokPhysics.wasm");
await serve(async (job) => {
  const hk = await HavokPhysics({ wasmBinary });
  const zero = [0, 0, 0], still = [0, 0, 0, 1];
  const world = hk.HP_World_Create()[1];
  hk.HP_World_SetGravity(world, job.gravity ?? zero);
  hk.HP_World_SetIdealStepTime(world, job.dt);
  hk.HP_World_SetSpeedLimit(world, 1e6, 1e6);
  const [w, x, y, z] = job.attitude;
  const add = (motion, place, turn) => {
    const body = hk.HP_Body_Create()[1];
    hk.HP_Body_SetMotionType(body, motion);
    hk.HP_Body_SetQTransform(body, [place, turn]);
    hk.HP_World_AddBody(world, body, false);
    return body;
  };
  const body = add(hk.MotionType.DYNAMIC, job.arm ?? zero, [x, y, z, w]);
  // The inertia is that of the body if its mass were 1.
  const moments = [0, 1, 2].map((k) => job.inertia[k][k] / job.mass);
  hk.HP_Body_SetMassProperties(body, [zero, job.mass, moments, still]);
  hk.HP_Body_SetLinearDamping(body, 0);
  hk.HP_Body_SetAngularDamping(body, 0);
  hk.HP_Body_SetActivationControl(body, hk.ActivationControl.ALWAYS_ACTIVE);
  hk.HP_Body_SetLinearVelocity(body, job.velocity ?? zero);
  hk.HP_Body_SetAngularVelocity(body, job.angular_velocity);
  if (job.arm) {
    const ground = add(hk.MotionType.STATIC, zero, still);
    const joint = hk.HP_Constraint_Create()[1];
    hk.HP_Constraint_SetParentBody(joint, ground);
    hk.HP_Constraint_SetChildBody(joint, body);
    hk.HP_Constraint_SetAnchorInParent(joint, zero, [1, 0, 0], [0, 1, 0]);
    hk.HP_Constraint_SetAnchorInChild(joint, job.arm.map((a) => -a), [1, 0, 0], [0, 1, 0]);
    for (const axis of ["LINEAR_X", "LINEAR_Y", "LINEAR_Z"])
      hk.HP_Constraint_SetAxisMode(joint, hk.ConstraintAxis[axis], hk.ConstraintAxisLimitMode.LOCKED);
    hk.HP_Constraint_SetEnabled(joint, true);
  }
  return {
    step: () => hk.HP_World_Step(world, job.dt),
    state: () => {
      const [qx, qy, qz, qw] = hk.HP_Body_GetOrientation(body)[1];
      return [[qw, qx, qy, qz], hk.HP_Body_GetAngularVelocity(body)[1]];
    },
  };
});
