"""Pinocchio: a free flyer, or a spherical joint if there is a pivot.

Pinocchio has accelerations and the exponential map of a joint; the step is its caller's: semi-implicit Euler, the step
of the simulations in its examples.
"""

import numpy as np
import pinocchio as pin
from wire import serve


def start(job):
    model = pin.Model()
    model.gravity = pin.Motion(np.array(job["gravity"] or [0.0] * 3), np.zeros(3))
    joint = pin.JointModelSpherical() if job["arm"] else pin.JointModelFreeFlyer()
    index = model.addJoint(0, joint, pin.SE3.Identity(), "joint")
    inertia = pin.Inertia(job["mass"], np.array(job["arm"] or [0.0] * 3), np.array(job["inertia"]))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    data, dt = model.createData(), job["dt"]
    w, x, y, z = job["attitude"]
    q = np.array([0.0] * (model.nq - 4) + [x, y, z, w])
    v = np.array([0.0] * (model.nv - 3) + job["angular_velocity"])
    tau, now = np.zeros(model.nv), [q, v]

    def advance(n):
        for _ in range(n):
            q, v = now
            v = v + dt * pin.aba(model, data, q, v, tau)
            now[:] = pin.integrate(model, q, dt * v), v

    def state():
        x, y, z, w = now[0][-4:]
        return (w, x, y, z), now[1][-3:]

    return advance, state


serve(start, frame="body")
