"""A satellite held upright by the gradient of gravity: librations, the forced one of an eccentric orbit, capture.

Lengths and times are those of the orbit: semi-major axis 1, mean motion n = 1.  The potential is
V = (3/2) r.I r/r^5 with r = g^T r(t) the direction of the Earth in the body.  The axes of yaw (vertical), roll (along
the velocity) and pitch (normal to the orbit) have moments I_y < I_r < I_p.  Linear theory, k = (I_r - I_y)/I_p:

    pitch       omega^2 = 3 k
    roll, yaw   omega^4 - (1 + 3 k1 + k1 k3) omega^2 + 4 k1 k3 = 0,   k1 = (I_p - I_y)/I_r,   k3 = (I_p - I_r)/I_y
    forced      2 e/(3 k - 1) sin(t) on an orbit of small eccentricity e; with a torque -c (M - I n), which damps the
                rotation against the mean motion, its amplitude is 2 e sqrt((1 + c^2)/((3 k - 1)^2 + c^2))

On a circular orbit that torque can only lower H - n L, L the momentum along the normal; its minima are the four upright
attitudes, so a tumbling satellite is captured.

Source: P. C. Hughes, Spacecraft Attitude Dynamics, 1986, chapter 9.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.algebra import rotation_matrix
from kreisel.analysis.frequencies import lines_of
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
ORBIT, STEPS, DAMPING = 2 * np.pi, 48, 0.1


def anomaly(t, e):
    """The eccentric anomaly: Newton's method for E - e sin(E) = t, a fixed number of steps."""
    E = t + e * np.sin(t)
    for _ in range(2):
        E = E - (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
    return E


def potential(g, t, *, moments, e):
    E = anomaly(t, e)
    r = (np.cos(E) - e) * g[0] + np.sqrt(1 - e * e) * np.sin(E) * g[1]
    return 1.5 * (moments @ (r * r)) / (1 - e * np.cos(E)) ** 5


def damper(M, g, *, moments, rate):
    return -rate * (M - moments * g[2])


def simulated(I, rotvec, Omega, orbits, e=0.0, c=None, every=2):
    """Runs of satellites with moments I (yaw, roll, pitch), turned out of the upright attitude, Omega in the body."""
    I, rotvec, Omega = (np.atleast_2d(x) for x in np.broadcast_arrays(I, rotvec, Omega))
    half = np.linalg.norm(rotvec, axis=-1, keepdims=True) / 2
    g = np.concatenate((np.cos(half), rotvec * np.sinc(half / np.pi) / 2), -1)
    params = {"moments": I, "e": e} | ({} if c is None else {"rate": c})
    body = kr.perturbed(kr.EulerTop(J=I.sum(-1, keepdims=True) / 2 - I), potential=potential,
                        torque=None if c is None else damper, params=params)  # fmt: skip
    dt = ORBIT / STEPS
    run = kr.simulate(
        body, body.state(M=I * Omega), dt=dt, steps=orbits * STEPS, every=every, orientation=g, method="splitting"
    )
    E = anomaly(run.time.values, e)
    f = np.arctan2(np.sqrt(1 - e * e) * np.sin(E), np.cos(E) - e)[:, None, None, None]
    cos, sin, none = np.cos(f), np.sin(f), 0 * f
    to_orbit = np.block([[cos, sin, none], [-sin, cos, none], [none, none, 1 + none]])
    return run, to_orbit @ rotation_matrix(run.g.values)


def satellite(k):
    """Moments with I_r = 0.9 and I_p = 1."""
    return np.stack((0.9 - k, 0.9 + 0 * k, 1 + 0 * k), -1)


def pitch_of(R):
    return np.arctan2(R[..., 1, 0], R[..., 0, 0])


UPRIGHT = np.array((0, 0, 1.0))

# -- small librations on a circular orbit
k = np.linspace(0.1, 0.7, 4 if SMALL else 13)
run, R = simulated(satellite(k), np.full(3, 1e-4), UPRIGHT, 80)
I = satellite(k)
k1, k3 = (I[:, 2] - I[:, 0]) / I[:, 1], (I[:, 2] - I[:, 1]) / I[:, 0]


def theory(k, k1, k3):
    b = 1 + 3 * k1 + k1 * k3
    root = np.sqrt(b * b - 16 * k1 * k3)
    return np.sqrt(np.stack((3 * k, (b - root) / 2, (b + root) / 2), -1))


def strongest(values, lines):
    return sorted(lines_of(run.time.values, values, lines).frequency)


measured = np.array([(*strongest(pitch_of(R[:, j]), 1), *strongest(R[:, j, 2, 0], 2)) for j in range(len(k))])
off = abs(measured / theory(k, k1, k3) - 1).max(0)
print(f"frequencies off linear theory by {off[0]:.1e} (pitch), {off[1]:.1e} and {off[2]:.1e} (roll and yaw)")
assert off.max() < 5e-5

# -- forced libration on an eccentric orbit


def forced(k, e, orbits, c=None):
    """The amplitude at the frequency of the orbit; without damping from the start that linear theory gives."""
    swing = 2 * e / (3 * k - 1) if c is None else 0 * k
    start = np.sqrt(1 - e * e) / (1 - e) ** 2 + swing
    run, R = simulated(satellite(k), np.zeros(3), start[:, None] * UPRIGHT, orbits, e, c)
    late = run.time.values > (orbits - 10.01) * ORBIT
    t = run.time.values[late]
    fit = np.linalg.lstsq(np.stack((np.sin(t), np.cos(t)), -1), pitch_of(R[late]))[0]
    return np.hypot(*fit)


def damped(k, e, c):
    return 2 * e * np.sqrt((1 + c * c) / ((3 * k - 1) ** 2 + c * c))


aside = np.array((0.1, 0.2, 0.5, 0.6, 0.7))
undamped = {e: forced(aside, e, 20) for e in (1e-3, 1e-2)}
away = {e: abs(found / (2 * e / abs(3 * aside - 1)) - 1).max() for e, found in undamped.items()}
resonant = forced(k, 1e-3, 60, DAMPING)
off = abs(resonant / damped(k, 1e-3, DAMPING) - 1).max()
print("forced libration off 2 e/(3 k - 1) by", ", ".join(f"{v:.1e} at e = {e:g}" for e, v in away.items()))
print(f"with damping off theory by {off:.1e}, through the resonance at k = 1/3")
assert away[1e-3] < 5e-4 and away[1e-2] < 1e-2 and off < 2e-3

# -- capture on a circular orbit
TUMBLING = 6 if SMALL else 24
rng = np.random.default_rng(4)
body = satellite(np.array(0.5))
run, R = simulated(body, 2 * rng.normal(size=(TUMBLING, 3)), 1.5 * rng.normal(size=(TUMBLING, 3)), 60, c=DAMPING / 2)
tilt = np.degrees(np.arccos(np.clip(abs(R[..., 0, 0]), 0, 1)))
L = (rotation_matrix(run.g.values)[..., 2, :] * run.M.values).sum(-1)
jacobi = run.energy.values - L
rise, least = np.diff(jacobi, axis=0).max(), 1.5 * body[0] - body[2] / 2
least_upright = np.minimum(abs(R[-1, :, 0, 0]), abs(R[-1, :, 2, 2])).min()
left_over = np.degrees(np.arccos(min(least_upright, 1)))
print(f"{TUMBLING} tumbling satellites: H - n L from {jacobi[0].min():.2f} ... {jacobi[0].max():.2f} to {least:.2f}, "
      f"off by {abs(jacobi[-1] - least).max():.1e}; it rises by at most {rise:.1e}")  # fmt: skip
print(f"at the end upright to {left_over:.2f} degrees; "
      f"attitudes {len({tuple(x) for x in R[-1, :, [0, 2], [0, 2]].round().T.tolist()})} of 4")  # fmt: skip
assert rise < 1e-6 and abs(jacobi[-1] - least).max() < 1e-6 and left_over < 0.3

with figure("light", 11.5, 3.8) as (made, theme):
    left, centre, right = made.subplots(1, 3)
    fine = np.linspace(0.05, 0.75, 300)
    J = satellite(fine)
    curves = theory(fine, (J[:, 2] - J[:, 0]) / J[:, 1], (J[:, 2] - J[:, 1]) / J[:, 0])
    for j, name in enumerate(("pitch", "roll and yaw, slow", "roll and yaw, fast")):
        left.plot(fine, curves[:, j], color=theme.colours[j], linewidth=1)
        left.plot(k, measured[:, j], "o", markersize=4, color=theme.colours[j], label=name)
    left.set(
        xlabel="k = (I$_r$ - I$_y$)/I$_p$", ylabel="frequency over mean motion", title="small librations", ylim=(0, 2.6)
    )
    left.legend(loc="upper left")
    centre.semilogy(fine, 2 / abs(3 * fine - 1), ":", color=theme.faint, label="2/|3 k - 1|")
    centre.semilogy(fine, damped(fine, 1.0, DAMPING), color=theme.colours[1], linewidth=1, label="with damping c = 0.1")
    centre.semilogy(aside, undamped[1e-3] / 1e-3, "s", markersize=4, color=theme.colours[2], label="runs, no damping")
    centre.semilogy(k, resonant / 1e-3, "o", markersize=4, color=theme.colours[0], label="runs, damping")
    centre.set(xlabel="k = (I$_r$ - I$_y$)/I$_p$", ylabel="amplitude over e", title="forced libration", ylim=(1, 1000))
    centre.legend(loc="upper right")
    orbits = run.time.values / ORBIT
    for lane in range(3):
        right.plot(orbits, tilt[:, lane], color=theme.colours[lane], linewidth=0.8)
    right.set(
        xlabel="orbits",
        ylabel="yaw axis from the vertical, degrees",
        xlim=(0, 30),
        ylim=(0, 90),
        title="capture, c = 0.05",
    )
    made.savefig("gravity_gradient.png")
