"""Optimal control: one thruster brings a tumbling satellite to rest.

A satellite has one pair of thrusters, fixed in its body along an oblique axis b, and fires it twenty times: each time
the momentum changes by u b. No single kick can stop the body, but between two kicks it turns freely. The derivatives of
the momentum that is left by all kicks at once come from sweeps back through the motion, and SciPy's least squares needs
some tens of them. Replayed by `kr.simulate` with `impulses=`, and by another integrator, the body comes to rest. Along
the first principal axis the same thruster cannot do it: kicks then change M₁ alone, and both they and the free motion
leave (1/I₁ - 1/I₂) M₂² + (1/I₁ - 1/I₃) M₃² as it is.

Source: Euler's equations; `jax.grad` through `kr.differentiable`, the closed form of the free body.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import kreisel as kr
from kreisel import reduction as red
from kreisel.viewer.charts import figure

BODY = kr.EulerTop(J=(1.0, 2.0, 3.5))
I = np.array((5.5, 4.5, 3.0))
START = np.array((1.0, 2.0, -0.5))
OBLIQUE, PRINCIPAL = np.array((0.48, 0.6, 0.64)), np.array((1.0, 0, 0))
KICKS, STEPS, DT, MOST = 20, 8, 0.25, 1.0  # a kick of at most 1 every 2 units of time
free_motion = kr.differentiable(BODY, method="exact")


def left(kicks, axis):
    """M/sqrt(2 I) at the end, whose square is the energy."""

    def fire(M, u):
        return free_motion({"M": M + u * axis}, dt=DT, steps=STEPS)["M"], None

    return jax.lax.scan(fire, jnp.asarray(START), kicks)[0] / np.sqrt(2 * I)


def best(axis):
    """The kicks (KICKS,) that leave the least energy."""
    with red.double():
        value = jax.jit(lambda u: left(u, axis))
        slope = jax.jit(jax.jacrev(lambda u: left(u, axis)))
        start = 0.3 * np.random.default_rng(1).normal(size=KICKS)
        h = 1e-5 * np.eye(KICKS)[3]
        near = np.asarray(value(start + h) - value(start - h)) / 2e-5
        assert abs(near - np.asarray(slope(start))[:, 3]).max() < 1e-8  # the derivative is that of differences
        return least_squares(
            lambda u: np.asarray(value(u)),
            start,
            lambda u: np.asarray(slope(u)),
            bounds=(-MOST, MOST),
            xtol=1e-15,
            max_nfev=100,
        )


energy = START @ (START / I) / 2
found, other = best(OBLIQUE), best(PRINCIPAL)
print(f"oblique axis: energy {energy:.3f} to {2 * found.cost:.1e} by {KICKS} kicks, {found.njev} Jacobians")
print(f"principal axis: energy {energy:.3f} to {2 * other.cost:.3f}")
assert 2 * found.cost < 1e-12 * energy and abs(found.x).max() <= MOST
weights = 1 / I[0] - 1 / I
stays = weights @ START**2  # of weights M^2, both of one sign
least = (stays / weights[1:] / I[1:]).min() / 2  # the energy where M_1 = 0, and M_2 or M_3
print(f"along a principal axis no less than {least:.3f} can be reached")
assert least - 1e-9 < 2 * other.cost < 1.5 * least

impulses = [{"time": k * STEPS * DT, "M": u * OBLIQUE} for k, u in enumerate(found.x)]
start, dt = BODY.state(M=START + impulses[0]["M"]), 0.05
how = {"method": "kahan", "order": 8, "every": 4}
run = kr.simulate(BODY, start, dt=dt, steps=round(STEPS * DT / dt) * KICKS, impulses=impulses[1:], **how)
print(f"kr.simulate: energy {float(run.energy[-1]):.1e} at the end")
assert float(run.energy[-1]) < 1e-10 * energy

M = START
for u in found.x:
    made = solve_ivp(lambda t, M: np.cross(M, M / I), (0, STEPS * DT), M + u * OBLIQUE, rtol=1e-11, atol=1e-13)
    M = made.y[:, -1]
print(f"SciPy: energy {M @ (M / I) / 2:.1e}")
assert M @ (M / I) / 2 < 1e-10 * energy

with figure("light", 9.0, 3.5) as (drawn, theme):
    rates, kicks = drawn.subplots(1, 2, width_ratios=[1.7, 1])
    for j in range(3):
        rates.plot(run.time, run.M.values[:, j] / I[j], color=theme.colours[j], label=f"Ω{'₁₂₃'[j]}")
    rates.set(xlabel="time", title="angular velocity in the body")
    rates.legend(ncols=3)
    kicks.stem(STEPS * DT * np.arange(KICKS), found.x, basefmt=" ")
    kicks.axhline(0, color=theme.colours[1], linewidth=0.8)
    kicks.set(xlabel="time", title="kicks along the oblique axis")
    drawn.savefig("satellite_to_rest.png")
