"""SciPy: solve_ivp on Euler's equations and the quaternion's, written here.  Setting: method, rtol, atol.

The solver chooses its steps; dt is the time between rows of a table without meaning for it.
"""

import numpy as np
from scipy.integrate import solve_ivp
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
    now = [0, z]

    def advance(n):
        span = now[0] * job["dt"], (now[0] + n) * job["dt"]
        solution = solve_ivp(rate, span, now[1], method=method, rtol=float(rtol), atol=float(atol))
        now[:] = now[0] + n, solution.y[:, -1]

    return advance, lambda: (now[1][:4], now[1][4:])


serve(start, frame="body")
