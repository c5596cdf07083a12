"""A Lagrangian of one's own, not in the paper: Kovalevskaya's top, from its Lagrangian to trajectory and figure.

Moments of inertia 2 : 2 : 1 and the centre of mass in the equatorial plane.  Only the Lagrangian is written down;
Kreisel derives the equations, the symmetric discretization of order 2 and its implicit map.  The map is Poisson, so the
Casimirs stand still; the energy and Kovalevskaya's integral are not kept, but they do not drift either.  Beside it
SciPy's DOP853.

    python own_lagrangian.py            # or: kreisel run own-lagrangian.toml
"""

import jax.numpy as jnp
import numpy as np

import kreisel as kr
from kreisel import reduction as red
from kreisel.algebra import axial

J = (0.5, 0.5, 1.5)  # mass tensor: the moment about axis 1 is J2 + J3


def lagrangian(Omega, P, *, c=1.0):  # T - V
    return -jnp.trace(Omega @ (jnp.array(J)[:, None] * Omega)) / 2 - c * P[0]


def kovalevskaya(M, P, *, c=1.0):  # |(Omega1 + i Omega2)^2 - c (P1 + i P2)|^2
    x, y = axial(M)[:2] / 2
    return (x * x - y * y - c * P[0]) ** 2 + (2 * x * y - c * P[1]) ** 2


TOP = red.system(
    "my-kovalevskaya-top",
    group=red.SO(3),
    lagrangian=lagrangian,
    integrals={"kovalevskaya": kovalevskaya},
    title="Kovalevskaya's top",
    source="S. Kowalevski 1889",
)


def main():
    from matplotlib.figure import Figure

    top = TOP(c=1.0)
    x0 = top.state(M=(1.2, 0.4, 0.9), P=(0.6, 0.0, 0.8))
    run = kr.simulate(top, x0, dt=0.05, steps=3_000, every=1)
    print(kr.drift(run)[["conserved", "start", "max_change", "ulps"]].to_string())

    other = kr.simulate(top, x0, dt=0.05, steps=3_000, every=1, method="dop853")
    figure = Figure(figsize=(9.2, 4.2), layout="constrained")
    sphere, changes = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    u, v = np.mgrid[0 : 2 * np.pi : 49j, 0 : np.pi : 25j]
    ball = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
    sphere.plot_wireframe(*ball, rstride=4, cstride=4, color="0.8", linewidth=0.3)
    sphere.plot(*run.P[:1200].values.T, linewidth=0.8)
    sphere.set_box_aspect((1, 1, 1), zoom=1.4)
    sphere.set_axis_off()
    sphere.set_title("the vertical P, seen from the body, to time 60", y=1.02)
    for name, label in (("energy", "energy"), ("kovalevskaya", "Kovalevskaya's integral")):
        for data, style, method in ((run, "-", "map of the Lagrangian"), (other, ":", "DOP853")):
            change = abs(data[name] - data[name][0]).values
            worst = np.maximum.accumulate(change)  # the largest so far: it grows where there is a drift
            changes.plot(data.time[1:], worst[1:], style, label=f"{label}, {method}")
    casimirs = abs(run.casimir - run.casimir[0]).max("casimir_part").values
    changes.plot(run.time[1:], np.maximum.accumulate(casimirs)[1:], "k--", label="Casimirs, map of the Lagrangian")
    changes.set(xscale="log", yscale="log", xlabel="time", title="largest change so far")
    changes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    figure.savefig("own-lagrangian-compare.png", dpi=150)
    print("figure: own-lagrangian-compare.png")


if __name__ == "__main__":
    main()
