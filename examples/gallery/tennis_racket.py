"""The tennis racket's flip, by the discrete free body of Moser and Veselov.

A free body that turns about its middle axis flips over, again and again.  The map of the discrete Lagrangian
Tr(J (1 - W))/dt keeps |M|^2 and, for n = 3, the energy to round-off; the flips come at the times of Jacobi's elliptic
functions, up to the square of the step.

Source: J. Moser, A. P. Veselov, Commun. Math. Phys. 139 (1991) 217; L. D. Landau, E. M. Lifshitz, Mechanics, section
37.
"""

import os

import jax.numpy as jnp
import numpy as np
from scipy.special import ellipk

import kreisel as kr
from kreisel import reduction as red
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ


def moser_veselov(W, *, J, eps):
    return jnp.trace(J[:, None] * (jnp.eye(3) - W)) / eps


def free(Omega, *, J):
    return -jnp.trace(Omega @ (J[:, None] * Omega)) / 2


I = np.array((1.0, 2.0, 3.0))
group = red.SO(3)
Body = red.system(
    "moser-veselov",
    group=group,
    lagrangian=free,
    discrete=moser_veselov,
    representation=red.trivial(group),
    order=2,
    title="Moser and Veselov's free body",
    source="J. Moser, A. P. Veselov 1991",
)
body = Body(J=I.sum() / 2 - I)
M0 = I * np.array((0.02, 1.0, 0.01))
DT, STEPS = 0.05, 1200 if SMALL else 4000
run = kr.simulate(body, body.state(M=M0), dt=DT, steps=STEPS)

M, time = run.M.values, run.time.values
energy, square = (M * M / I).sum(-1) / 2, (M * M).sum(-1)
print(f"energy off by {abs(energy / energy[0] - 1).max():.1e}, |M|^2 by {abs(square / square[0] - 1).max():.1e}")
assert max(abs(energy / energy[0] - 1).max(), abs(square / square[0] - 1).max()) < 1e-11

# Landau and Lifshitz (37.10), for M^2 > 2 E I2; the other case by exchanging 1 and 3
E, M2 = energy[0], square[0]
(a, b, c) = I if M2 > 2 * E * I[1] else I[::-1]
k2 = (b - a) * (2 * E * c - M2) / ((c - b) * (M2 - 2 * E * a))
period = 4 * ellipk(k2) * np.sqrt(a * b * c / ((c - b) * (M2 - 2 * E * a)))
i = np.nonzero(M[1:, 1] * M[:-1, 1] < 0)[0]
flips = time[i] - M[i, 1] * DT / (M[i + 1, 1] - M[i, 1])
measured = 2 * np.diff(flips).mean()
print(f"period of two flips: {measured:.4f}, in closed form {period:.4f}")
assert abs(measured / period - 1) < 2e-3

with figure("light", 9.0, 3.6) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1.5, 1])
    shown = time < 4.2 * period
    for j in range(3):
        left.plot(time[shown], M[shown, j] / I[j], color=theme.colours[j], label=f"Ω{'₁₂₃'[j]}")
    for flip in flips[flips < 4.2 * period]:
        left.axvline(flip, color=theme.faint, linewidth=0.6, linestyle=":")
    left.set(xlabel="time", title="angular velocity in the body; dotted: flips")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    right.semilogy(time[1:], abs(energy / energy[0] - 1)[1:] + 1e-17, color=theme.colours[0], label="energy")
    right.semilogy(time[1:], abs(square / square[0] - 1)[1:] + 1e-17, color=theme.colours[1], label="|M|²")
    right.set(xlabel="time", title="relative change", ylim=(1e-17, 1e-10))
    right.legend(loc="upper left")
    made.savefig("tennis_racket.png")
