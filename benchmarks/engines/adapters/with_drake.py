"""Drake: MultibodyPlant with a free body, or a ball joint if there is a pivot.

Setting "discrete" is a plant with a time step, "continuous" one without, by the third-order Runge-Kutta method that the
Simulator has by default, here in steps of dt.  The ball joint has roll, pitch and yaw as coordinates: roll is the turn
about y, and pitch is counted from the plane across (-1, 1, 1), a direction that the heavy top's axis stays away from.
"""

import math

import pydrake.all as drake
from wire import serve


def start(job):
    discrete = job["setting"] == "discrete"
    builder = drake.DiagramBuilder()
    plant = builder.AddSystem(drake.MultibodyPlant(time_step=job["dt"] if discrete else 0.0))
    plant.mutable_gravity_field().set_gravity_vector(job["gravity"] or [0, 0, 0])
    moments = drake.RotationalInertia(*(job["inertia"][k][k] for k in range(3)))
    arm = job["arm"] or [0, 0, 0]
    body = plant.AddRigidBody("body", drake.SpatialInertia.MakeFromCentralInertia(job["mass"], arm, moments))
    roll = drake.RotationMatrix.MakeZRotation(math.pi / 2)  # x is the body's y
    space = drake.RotationMatrix.MakeFromOneVector([-1, 1, 1], axis_index=2)
    if job["arm"]:
        frames = [
            plant.AddFrame(drake.FixedOffsetFrame(name, parent.body_frame(), drake.RigidTransform(turn)))
            for name, parent, turn in (("turned space", plant.world_body(), space), ("turned body", body, roll))
        ]
        joint = plant.AddJoint(drake.BallRpyJoint("pivot", *frames))
    plant.Finalize()
    simulator = drake.Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    if not discrete:
        drake.ResetIntegratorFromFlags(simulator, "runge_kutta3", job["dt"])
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
    if job["arm"]:
        joint.set_angles(context, drake.RollPitchYaw(space.inverse() @ roll).vector())
        joint.set_angular_velocity(context, space.inverse() @ job["angular_velocity"])
    else:
        pose = drake.RigidTransform(drake.Quaternion(job["attitude"]), [0, 0, 0])
        plant.SetFreeBodyPose(context, body, pose)
        spin = pose.rotation() @ job["angular_velocity"]
        plant.SetFreeBodySpatialVelocity(context, body, drake.SpatialVelocity(spin, [0, 0, 0]))
    simulator.Initialize()
    steps = [0]

    def advance(n):
        steps[0] += n
        simulator.AdvanceTo(steps[0] * job["dt"])

    def state():
        pose = plant.EvalBodyPoseInWorld(context, body)
        velocity = plant.EvalBodySpatialVelocityInWorld(context, body)
        return pose.rotation().ToQuaternion().wxyz(), velocity.rotational()

    return advance, state


serve(start)
