"""A top whose moments differ by one percent: the distance from an integrable top as a small parameter.

The heavy top I = (1, 1 + d, 1/2) with its weight on the axis is the Lagrange top I = (1, 1, 1/2), whose motion is
integrable, and a turn about the second axis at the rate (1/(1 + d) - 1) M2.  A splitting alternates the two.  Its error
has the terms d dt^p1, d^2 dt^p2, d^3 dt^p3 for order (p1, p2, p3), so long steps are good when d is small; the
variational integrator and DOP853 know nothing of d.  Reference: the variational integrator of order 8, steps of 1/64.

Left: error of the state at time 100 against the step, d = 0.01.  Centre: against d; (2, 2) and (8, 6, 4) fall like
d, (8, 2) like d^2, since with such steps d^2 dt^2 is its larger term.  Right: against evaluations of the perturbation
(splitting), stages (variational) or evaluations of the right-hand side (DOP853, for tolerances 1e-4 to 1e-11).  Steps
of the Lagrange top between two turns are not counted there.

Source: J. Touma, J. Wisdom, Astron. J. 107 (1994) 1189; J. Laskar, P. Robutel, Celest. Mech. Dyn. Astron. 80 (2001)
39, and S. Blanes et al., Appl. Numer. Math. 68 (2013) 58, for the splittings.
"""

import os

import numpy as np
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
T = 100
M, P = (0.3, 0.2, 1.2), (np.sin(1.0), 0.0, np.cos(1.0))


def moments(d):
    d = np.asarray(d, dtype=float)
    return np.stack((1 + 0 * d, 1 + d, 0.5 + 0 * d), -1)


def end(system, steps, method, **choices):
    """The state at time T, lane by lane."""
    lanes = choices.pop("lanes", ())
    x0 = system.state(M=np.broadcast_to(M, (*lanes, 3)), P=np.broadcast_to(P, (*lanes, 3)))
    run = kr.simulate(system, x0, dt=T / steps, steps=steps, every=steps, method=method, observe=(), **choices)
    return np.concatenate((run.M.values[-1], run.P.values[-1]), -1)


def heavy(d):
    I = moments(d)
    return kr.HeavyTop(J=(I.sum(-1, keepdims=True) / 2 - I)[..., None] * np.eye(3), A=(0, 0, 1))


def perturbed(d):
    return kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5), inertia=moments(d))


def off(system, steps, method, **choices):
    return abs(end(system, steps, method, **choices) - truth).max()


def slope(x, y):
    return np.polyfit(np.log(x), np.log(y), 1)[0]


D = 0.01
KICKS, STAGES = 7, 17  # of a step: order (8, 6, 4), and order 8 composed
truth = end(heavy(D), 64 * T, "variational", order=8)
other = off(perturbed(D), 16 * T, "splitting", order=8)
print(f"two methods agree to {other:.1e} at time {T}")
assert other < 1e-11

# -- against the step
steps = T * np.array((2, 4, 8) if SMALL else (1, 2, 3, 4, 6, 8))
finer = T * np.array((8, 16, 32) if SMALL else (4, 6, 8, 12, 16, 24, 32))
orders = ((2, 2), (4, 2), (8, 6, 4))
errors = {o: np.array([off(perturbed(D), int(n), "splitting", order=o) for n in steps]) for o in orders}
variational = np.array([off(heavy(D), int(n), "variational", order=8) for n in finer])
slopes = {o: -slope(steps[-3:], e[-3:]) for o, e in errors.items()} | {8: -slope(finer[-3:], variational[-3:])}
print("slopes in dt:", ", ".join(f"{o}: {v:.2f}" for o, v in slopes.items() if o != 8), f"variational: {slopes[8]:.2f}")
assert abs(slopes[2, 2] - 2) < 0.2 and 2 < slopes[4, 2] < 4.2 and slopes[8, 6, 4] > 6 and abs(slopes[8] - 8) < 0.2

# -- against the size of the perturbation
sizes = np.geomspace(1e-4, 3e-2, 5 if SMALL else 9)
lanes = (len(sizes),)
truths = end(heavy(sizes), 64 * T, "variational", order=8, lanes=lanes)
by_size = {
    (o, n): abs(end(perturbed(sizes), n * T, "splitting", order=o, lanes=lanes) - truths).max(-1)
    for o, n in (((2, 2), 8), ((8, 2), 4), ((8, 6, 4), 2))
}
small = (sizes > 3e-4) & (sizes < 1e-2)
powers = {o: slope(sizes[small], e[small]) for (o, _), e in by_size.items()}
print("powers of d:", ", ".join(f"{o}: {v:.2f}" for o, v in powers.items()))
assert abs(powers[2, 2] - 1) < 0.1 and abs(powers[8, 2] - 2) < 0.1 and 0.9 < powers[8, 6, 4] < 2

# -- against evaluations
I = moments(D)


def right_hand_side(_, y):
    M, P = y.reshape(2, 3)
    Omega = M / I
    twist, weight, turn = np.cross((M, P, P), (Omega, (0, 0, 1), Omega))
    return np.concatenate((twist + weight, turn))


def calls(tol):
    return solve_ivp(right_hand_side, (0, T), (*M, *P), method="DOP853", rtol=tol, atol=tol / 1000).nfev


tolerances = [1e-4, 1e-6, 1e-8, 1e-10] if SMALL else [10.0**-k for k in range(4, 12)]
work = {
    "splitting (8, 6, 4)": (KICKS * steps, errors[8, 6, 4]),
    "variational, order 8": (STAGES * finer, variational),
    "DOP853": (np.array([calls(tol) for tol in tolerances]),
               np.array([off(heavy(D), 1, "dop853", tol=tol) for tol in tolerances])),
}  # fmt: skip
AIM = 1e-8
cost = {name: np.exp(np.interp(np.log(AIM), np.log(e[::-1]), np.log(n[::-1]))) for name, (n, e) in work.items()}
print(f"evaluations for an error of {AIM:g}:", ", ".join(f"{name}: {v:.0f}" for name, v in cost.items()))
ours, *peers = cost.values()
assert peers[0] > 8 * ours and peers[1] > 3 * ours

with figure("light", 11.5, 4.0) as (made, theme):
    left, centre, right = made.subplots(1, 3)
    for (order, e), colour in zip(errors.items(), theme.colours, strict=False):
        left.loglog(T / steps, e, "o-", markersize=3.5, color=colour, label=f"splitting {order}")
    left.loglog(T / finer, variational, "s-", markersize=3.5, color=theme.colours[3], label="variational, order 8")
    left.set(xlabel="step", ylabel="error of the state at time 100", title="d = 0.01")
    for ((order, n), e), colour in zip(by_size.items(), (theme.colours[0], theme.colours[4], theme.colours[2]),
                                       strict=True):  # fmt: skip
        centre.loglog(sizes, e, "o-", markersize=3.5, color=colour, label=f"{order}, step 1/{n}")
    centre.set(xlabel="d", ylabel="error of the state at time 100", title="splittings")
    for (name, (n, e)), colour, mark in zip(work.items(), (theme.colours[2], theme.colours[3], theme.ink), "os^",
                                            strict=True):  # fmt: skip
        right.loglog(n, e, mark + "-", markersize=3.5, color=colour, label=name)
    right.set(xlabel="evaluations of force, stages", ylabel="error of the state at time 100", title="d = 0.01")
    for axes in (left, centre, right):
        axes.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.15), columnspacing=1, handlelength=1.2)
    made.savefig("unequal_top.png")
