"""Rapier's Python bindings: a body without shape; damping and sleeping off, fast rotation allowed.

Setting "without" turns off the gyroscopic forces, which are on by default.
"""

import rapier3d as rapier
from wire import serve


def start(job):
    world = rapier.PhysicsWorld(gravity=job["gravity"] or [0, 0, 0])
    world.integration_parameters.dt = job["dt"]
    moments = [job["inertia"][k][k] for k in range(3)]
    pose = rapier.Isometry3(job["arm"] or [0, 0, 0], rapier.Rotation3(*job["attitude"]))
    dynamic, fixed = rapier.RigidBodyType.DYNAMIC, rapier.RigidBodyType.FIXED
    made = rapier.RigidBodyBuilder(dynamic).position(pose).linvel(job["velocity"]).angvel(job["angular_velocity"])
    made = made.linear_damping(0.0).angular_damping(0.0).can_sleep(False).allow_fast_rotation(True)
    made = made.additional_mass_properties(rapier.MassProperties([0, 0, 0], job["mass"], moments))
    body = world.add_body(made.gyroscopic_forces(job["setting"] != "without"))
    if job["arm"]:
        ground = world.add_body(rapier.RigidBodyBuilder(fixed))
        joint = rapier.SphericalJointBuilder().local_anchor1([0, 0, 0]).local_anchor2([-a for a in job["arm"]])
        world.impulse_joints.insert(ground, body, joint.build(), True)

    def advance(n):
        for _ in range(n):
            world.step()

    def state():
        now = world.rigid_bodies[body]
        q, v = now.rotation, now.angvel
        return (q.w, q.i, q.j, q.k), (v.x, v.y, v.z)

    return advance, state


serve(start)
