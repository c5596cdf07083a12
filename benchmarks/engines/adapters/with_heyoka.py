"""heyoka: its Taylor integrator on Euler's equations and the quaternion's, written here.  Setting: its tolerance."""

import heyoka as hy
import numpy as np
from wire import about_pivot, serve


def start(job):
    inverse = np.linalg.inv(about_pivot(job))
    inertia = np.array(about_pivot(job))
    w, x, y, z, *omega = hy.make_vars("w", "x", "y", "z", "p", "q", "r")
    axis, spin = [x, y, z], np.array(omega)
    pull, arm = job["mass"] * np.array(job["gravity"] or [0.0] * 3), np.array(job["arm"] or [0.0] * 3)

    def cross(a, b):
        return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])

    weight = pull - 2.0 * w * cross(axis, pull) + 2.0 * cross(axis, cross(axis, pull))  # along the body axes
    torque = cross(arm, weight) - cross(spin, inertia @ spin)
    turned = [-0.5 * (x * omega[0] + y * omega[1] + z * omega[2]), *(0.5 * (w * spin + cross(axis, spin)))]
    rates = [*turned, *(inverse @ torque)]
    equations = list(zip([w, x, y, z, *omega], rates, strict=True))
    tolerance = {} if job["setting"] == "default" else {"tol": float(job["setting"])}
    integrator = hy.taylor_adaptive(equations, job["attitude"] + job["angular_velocity"], **tolerance)
    steps = [0]

    def advance(n):
        steps[0] += n
        integrator.propagate_until(steps[0] * job["dt"])

    return advance, lambda: (integrator.state[:4], integrator.state[4:])


serve(start, frame="body")
