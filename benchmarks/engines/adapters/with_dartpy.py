"""DART: a skeleton of one body with a free joint, or a ball joint if there is a pivot."""

import dartpy as dart
import numpy as np
from wire import serve


def start(job):
    world = dart.simulation.World()
    world.setTimeStep(job["dt"])
    world.setGravity(job["gravity"] or [0, 0, 0])
    skeleton = dart.dynamics.Skeleton("body")
    make = skeleton.createBallJointAndBodyNodePair if job["arm"] else skeleton.createFreeJointAndBodyNodePair
    joint, body = make()
    inertia = dart.dynamics.Inertia(job["mass"], np.array(job["arm"] or [0.0] * 3), np.array(job["inertia"]))
    body.setInertia(inertia)
    joint.setPositions(np.zeros(joint.getNumDofs()))
    # The free joint's velocity is (angular, linear); both joints have it along the body axes.
    joint.setVelocities(np.array(job["angular_velocity"] + [0.0] * (joint.getNumDofs() - 3)))
    world.addSkeleton(skeleton)

    def advance(n):
        for _ in range(n):
            world.step()

    def state():
        frame = body.getWorldTransform()
        q = dart.math.Quaternion(frame.rotation()) if hasattr(dart.math, "Quaternion") else frame.quaternion()
        return q.wxyz() if callable(getattr(q, "wxyz", None)) else (
            q.w(),
            q.x(),
            q.y(),
            q.z(),
        ), body.getAngularVelocity()

    return advance, state


serve(start)
