"""Discrete and continuous spectra of a Lax matrix.

Along the paper's map with a large step the eigenvalues of the continuous Lax matrix l(lambda) wobble; those of the
discrete one, of
the same map, stand still to round-off.  Along the default method it is those of the continuous matrix that stand
still.

Source: Suris 2001, sections 5 and 6.1, the matrices l(lambda) and their deformation b = a - (eps/2) m a + (eps^2/4)
|a|^2 p.
"""

import numpy as np

import kreisel as kr
from kreisel.algebra import hat
from kreisel.system import lagrange_top
from kreisel.viewer.charts import figure

DT, LAMBDA = 0.5, 0.7
top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))


def eigenvalues(run, eps):
    """Real and imaginary parts (time, 8) of the spectrum of l(LAMBDA), in one order for all times."""
    l = lagrange_top.lax_matrix(hat(run.m.values), run.a.values, p=top.params["p"], lam=LAMBDA, eps=eps)
    mu = np.linalg.eigvals(l)
    order = np.argsort(np.round(mu.imag, 6) + 1e-3 * np.round(mu.real, 6), axis=-1)
    return np.take_along_axis(mu, order, -1)


suris = kr.simulate(top, x0, dt=DT, steps=400, method="suris", order=1)
ours = kr.simulate(top, x0, dt=DT, steps=400)
spectra = {
    "the paper's map, l(λ) of the flow": eigenvalues(suris, 0),
    "the paper's map, l(λ) of the map": eigenvalues(suris, DT),
    "Bäcklund, l(λ) of the flow": eigenvalues(ours, 0),
}
moved = {name: abs(mu - mu[0]).max(-1) for name, mu in spectra.items()}
for name, change in moved.items():
    print(f"{name}: eigenvalues move by up to {change.max():.1e}")
wobble, still, ours_still = (change.max() for change in moved.values())
assert wobble > 1e-2 and still < 1e-12 and ours_still < 1e-12

with figure("light", 9.0, 3.6) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1, 1.3])
    for (name, mu), marker, colour, size in zip(spectra.items(), ".x+", theme.colours, (3, 6, 8), strict=False):
        left.plot(mu.real.ravel(), mu.imag.ravel(), marker, color=colour, markersize=size, label=name)
    left.set(xlabel="Re μ", ylabel="Im μ", title=f"eigenvalues at λ = {LAMBDA}, 400 steps of {DT}")
    for (name, change), colour in zip(moved.items(), theme.colours, strict=False):
        right.semilogy(suris.time[1:], change[1:] + 1e-17, color=colour, label=name)
    right.set(xlabel="time", title="largest change of an eigenvalue", ylim=(1e-17, 10))
    right.legend(loc="center right")
    made.savefig("lax_spectra.png")
