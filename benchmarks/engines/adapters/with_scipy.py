"""SciPy: a solver of solve_ivp on Euler's equations and the quaternion's, written here.  Setting: method, rtol, atol.

The solver chooses its steps; dt is the time between rows of a table without meaning for it.
"""

import numpy as np
import scipy.integrate
from wire import about_pivot, serve


def start(job):
    inertia = np.array(about_pivot(job))
    inverse = np.linalg.inv(inertia)
    pull = job["mass"] * np.array(job["gravity"] or [0.0] * 3)
    arm = np.array(job["arm"] or [0.0] * 3)
    method, rtol, atol = job["setting"].split()

    def rate(_, z):
        (w, x, y, zeta), omega = z[:4] / np.linalg.norm(z[:4]), z[4:]
        axis = np.array([x, y, zeta])
        weight = pull - 2 * w * np.cross(axis, pull) + 2 * np.cross(axis, np.cross(axis, pull))  # along the body axes
        turned = np.concatenate([[-axis @ omega], w * omega + np.cross(axis, omega)]) / 2
        torque = np.cross(arm, weight)
        return np.concatenate([turned, inverse @ (torque - np.cross(omega, inertia @ omega))])

    z = np.array(job["attitude"] + job["angular_velocity"])
    end = job["steps"] * job["dt"]
    solver = getattr(scipy.integrate, method)(rate, 0.0, z, end, rtol=float(rtol), atol=float(atol))
    now = [0, z]

    def advance(n):
        now[0] += n
        time = now[0] * job["dt"]
        while solver.t < time:
            solver.step()
        now[1] = solver.y if solver.t == time else solver.dense_output()(time)

    return advance, lambda: (now[1][:4], now[1][4:])


serve(start, frame="body")
