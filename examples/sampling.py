"""A posterior by NumPyro's NUTS through kr.differentiable, beside the values and errors of kr.fit.

The axis of a top is seen 16 times with errors of 0.1.

python examples/sampling.py      # needs numpyro
"""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import kreisel as kr
from kreisel import reduction as red

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of its imports
    import numpyro
    from numpyro.distributions import Normal
    from numpyro.infer import MCMC, NUTS

SIGMA, DT, EVERY, ROWS = 0.1, 0.1, 4, 15
HOW = {"method": "suris", "order": 2}
TRUTH, AXIS = np.array((1.3, 0.9, 0.0, 1.2)), np.array((0.6, 0, 0.8))  # p_3 and m; a
NAMES = ("p[2]", "m[0]", "m[1]", "m[2]")

top = kr.LagrangeTop(p=(0, 0, TRUTH[0]))
motion = kr.differentiable(top, **HOW)


def axes(x):
    """The axis (ROWS + 1, 3)."""
    start = {"m": x[1:], "a": AXIS}
    return motion(start, dt=DT, steps=EVERY * ROWS, every=EVERY, p=x[0] * jnp.array((0.0, 0.0, 1.0)))["a"]


def posterior(seen):
    """A wide prior, and the errors of the sightings."""
    x = numpyro.sample("x", Normal(jnp.zeros(4), 5.0).to_event(1))
    numpyro.sample("seen", Normal(axes(x), SIGMA), obs=seen)


with red.double():
    clean = np.asarray(axes(jnp.asarray(TRUTH)))
    seen = clean + SIGMA * np.random.default_rng(1).normal(size=clean.shape)
    sampler = MCMC(NUTS(posterior), num_warmup=200, num_samples=400, progress_bar=False)
    sampler.run(jax.random.PRNGKey(0), jnp.asarray(seen), init_params={"x": jnp.asarray(TRUTH)})
    samples = np.asarray(sampler.get_samples()["x"])

time = DT * EVERY * np.arange(ROWS + 1)
data = xr.Dataset({"a": (("time", "axis"), seen), "sigma_a": SIGMA}, {"time": time})
fit = kr.fit(top, data, free=["p[2]", "m"], x0={"m": TRUTH[1:], "a": AXIS}, dt=DT, **HOW)
for name, x in zip(NAMES, samples.T, strict=True):
    value, error = fit.values[name], fit.errors[name]
    print(f"{name}: {x.mean():.3f} +- {x.std():.3f} by NUTS, {value:.3f} +- {error:.3f} by kr.fit")
    # 400 samples of a posterior that is nearly normal: some hundredths of an error, and some percent of it
    assert abs(x.mean() - value) < 0.5 * error
    assert 0.7 < x.std() / error < 1.4
