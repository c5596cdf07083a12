"""Gradients: the strength of gravity and the spin of a top, fitted to noisy observations of its axis.

The map is a pure function of JAX arrays, so a whole trajectory can be differentiated.  From 60 noisy sightings of the
axis Gauss and Newton's method finds |p| and the momentum along the axis, with error bars from the same Jacobian.

Source: the map of Suris 2001, section 6.1, by `jax.jacfwd` through `model.step`.
"""

import jax
import jax.numpy as jnp
import numpy as np

import kreisel as kr
from kreisel import reduction as red
from kreisel.algebra import hat
from kreisel.system import lagrange_top
from kreisel.viewer.charts import figure

DT, EVERY, SIGHTINGS, NOISE = 0.05, 4, 60, 0.02
TRUTH = np.array((1.3, 2.1))  # |p|, <m, a>
AXIS = np.array((0.6, 0.0, 0.8))


def sightings(unknown):
    """The axis (SIGHTINGS, 3) at times 0.2, 0.4, ..."""
    strength, spin = unknown
    axis = jnp.array(AXIS)
    p = strength * jnp.array((0.0, 0.0, 1.0))
    m = spin * jnp.array(hat(AXIS))

    def advance(state, _):
        for _ in range(EVERY):
            state = lagrange_top.step(*state, p=p, eps=DT)
        return state, state[1]

    start = (lagrange_top.half_kick_back(m, axis, p=p, eps=DT)[0], axis)  # of order 2
    return jax.lax.scan(advance, start, length=SIGHTINGS)[1]


with red.double():
    both = jax.jit(lambda u: (sightings(u), jax.jacfwd(sightings)(u)))
    clean = np.asarray(both(jnp.array(TRUTH))[0])
    seen = clean + NOISE * np.random.default_rng(3).normal(size=clean.shape)
    guess = np.array((1.0, 2.5))
    history = [guess]
    for _ in range(12):
        value, slope = (np.asarray(v) for v in both(jnp.array(guess)))
        A, r = slope.reshape(-1, 2), (seen - value).ravel()
        guess = guess + np.linalg.lstsq(A, r, rcond=None)[0]
        history.append(guess)
    fitted = np.asarray(both(jnp.array(guess))[0])
bars = NOISE * np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
print(
    f"|p| = {guess[0]:.4f} +- {bars[0]:.4f} (truth {TRUTH[0]}), "
    f"<m, a> = {guess[1]:.4f} +- {bars[1]:.4f} (truth {TRUTH[1]})"
)
assert (abs(guess - TRUTH) < 4 * bars).all() and (bars < 0.01).all()
assert np.linalg.norm(history[-1] - history[-2]) < 1e-10  # it has converged
# the differentiated map is the one that runs: the same states from kr.simulate
top = kr.LagrangeTop(p=(0, 0, TRUTH[0]))
run = kr.simulate(
    top, top.state(m=TRUTH[1] * AXIS, a=AXIS), dt=DT, steps=EVERY * SIGHTINGS, every=EVERY, method="suris"
)
print(f"against kr.simulate: {abs(run.a[1:].values - clean).max():.1e}")
assert abs(run.a[1:].values - clean).max() < 1e-12

with figure("light", 9.0, 3.5) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1.7, 1])
    time = DT * EVERY * np.arange(1, SIGHTINGS + 1)
    for j in range(3):
        left.plot(time, seen[:, j], ".", color=theme.colours[j], markersize=4)
        left.plot(time, fitted[:, j], color=theme.colours[j], label=f"a{'₁₂₃'[j]}")
    left.set(xlabel="time", title="the axis: sightings and fit")
    left.legend(ncols=3, loc="lower left")
    error = abs(np.array(history[:-1]) - guess) + 1e-17
    right.semilogy(error[:, 0], "o-", markersize=4, color=theme.colours[0], label="|p|")
    right.semilogy(error[:, 1], "s-", markersize=4, color=theme.colours[1], label="⟨m, a⟩")
    right.set(xlabel="iteration", title="distance from the fit")
    right.legend()
    made.savefig("fit_observations.png")
