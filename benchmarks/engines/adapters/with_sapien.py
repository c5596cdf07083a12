"""SAPIEN: a rigid body without shape, or with a joint of three rotations if there is a pivot; damping, sleeping off."""

import sapien
from wire import serve


def start(job):
    physx = sapien.physx
    config = physx.PhysxSceneConfig()
    config.gravity = job["gravity"] or [0, 0, 0]
    physx.set_scene_config(config)
    system = physx.PhysxCpuSystem()
    system.timestep = job["dt"]
    scene = sapien.Scene([system])
    body = physx.PhysxRigidDynamicComponent()
    body.mass = job["mass"]
    body.inertia = [job["inertia"][k][k] for k in range(3)]
    body.linear_damping = body.angular_damping = body.sleep_threshold = 0
    body.max_angular_velocity = 1e6
    entity = sapien.Entity()
    entity.add_component(body)
    entity.set_pose(sapien.Pose(job["arm"] or [0, 0, 0], job["attitude"]))
    if job["arm"]:
        joint = physx.PhysxDriveComponent(body)
        joint.pose_in_child = sapien.Pose([-a for a in job["arm"]])
        joint.parent, joint.pose_in_parent = None, sapien.Pose()
        joint.set_limit_x(0, 0), joint.set_limit_y(0, 0), joint.set_limit_z(0, 0)
        entity.add_component(joint)
    scene.add_entity(entity)
    body.set_linear_velocity(job["velocity"])
    body.set_angular_velocity(job["angular_velocity"])

    def advance(n):
        for _ in range(n):
            system.step()

    kept = scene, entity  # otherwise they are collected
    return advance, lambda: (kept[1].pose.q, body.angular_velocity)


serve(start)
