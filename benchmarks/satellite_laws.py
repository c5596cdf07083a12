"""The sampled laws of the guides, written again from their sources with NumPy only, for Basilisk and DOP853.

A law is called with B the field, T, w the angular velocity, h the momenta of three wheels along the body axes, all in
the body axes, C the matrix from body to space, r and v in space.  It returns a dipole, A m^2, and the torques of the
motors on the wheels, N m.
"""

import numpy as np

MU_0 = 4e-7 * np.pi
STEPS = 16  # of the equation of a rod between two samples


class Nothing:
    """No law."""

    def __call__(self, **seen):
        """No dipole and no torque."""
        return np.zeros(3), np.zeros(3)


class Bdot:
    """B-dot: m = -(gain/|B|^2) dB/dt, with the difference of two samples.

    [Stickler, Alfriend 1976]
    """

    def __init__(self, gain, every, limit):
        self.gain, self.every, self.limit, self.before = gain, every, limit, None

    def __call__(self, B, **seen):
        """The dipole from the field now and at the sample before."""
        rate = 0 * B if self.before is None else (B - self.before) / self.every
        self.before = B
        return np.clip(-self.gain * rate / (B @ B), -self.limit, self.limit), np.zeros(3)


class Pointing:
    """The torque -2 k sign(q_0) (q_1, q_2, q_3) - c (w - w_0) towards the frame of the orbit; magnets unload.

    [Markley, Crassidis 2014]
    """

    def __init__(self, stiffness, damping, unloading, limit, most):
        self.stiffness, self.damping, self.unloading, self.limit, self.most = stiffness, damping, unloading, limit, most

    def __call__(self, B, w, C, h, r, v):
        """The dipole and the torques of the motors."""
        normal = np.cross(r, v)
        across, down = -normal / np.linalg.norm(normal), -r / np.linalg.norm(r)
        E = np.column_stack([np.cross(across, down), across, down]).T @ C  # the body in the frame of the orbit
        v = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
        K = np.block([[E.trace(), v], [v[:, None], E + E.T - E.trace() * np.eye(3)]])
        q = np.linalg.eigh(K)[1][:, -1]  # the quaternion of E [Bar-Itzhack 2000]
        error = 2 * np.copysign(1, q[0]) * q[1:]
        torque = -self.stiffness * error - self.damping * (w - C.T @ normal / (r @ r))
        dipole = self.unloading * np.cross(h, B) / (B @ B)
        return np.clip(dipole, -self.most, self.most), np.clip(-torque, -self.limit, self.limit)


class Rods:
    """Rods: dB/dH = (2 k B_s/pi) cos^2(pi B/(2 B_s)) u^2, by Runge-Kutta steps.

    [Flatley, Henretty 1995]
    """

    def __init__(self, axes, volume, coercivity, remanence, saturation):
        self.axes, self.volume, self.Hc, self.Bs = np.array(axes), volume, coercivity, saturation
        self.k, self.before = np.tan(np.pi * remanence / (2 * saturation)) / coercivity, None

    def slope(self, H, b, side):
        """The derivative dB/dH."""
        edge = np.tan(np.pi * b / (2 * self.Bs)) / self.k - side * self.Hc
        u = (H - edge) / (2 * self.Hc)
        return 2 / np.pi * self.k * self.Bs * (u * np.cos(np.pi * b / (2 * self.Bs))) ** 2

    def __call__(self, B, **seen):
        """The dipole of the rods."""
        H = self.axes @ B / MU_0
        if self.before is None:
            self.b = 2 * self.Bs / np.pi * np.arctan(self.k * H)
        else:
            step, side = (H - self.before) / STEPS, np.sign(H - self.before)
            for i in range(STEPS):
                x = self.before + i * step
                k1 = self.slope(x, self.b, side)
                k2 = self.slope(x + step / 2, self.b + step / 2 * k1, side)
                k3 = self.slope(x + step / 2, self.b + step / 2 * k2, side)
                k4 = self.slope(x + step, self.b + step * k3, side)
                self.b = self.b + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.before = H
        return self.volume * self.b / MU_0 @ self.axes, np.zeros(3)


LAWS = {"none": Nothing, "bdot": Bdot, "pointing": Pointing, "rods": Rods}
