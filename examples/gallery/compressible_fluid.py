"""A compressible fluid as the motion of a group: a simple wave, the circulation, the energy.

Section 8 of Suris 2001 wishes for a discretization of compressible fluids.  Group: N x N matrices, column sums 1.
They act on the masses rho_i = D h_i of the N cells of a ring.  Algebra: omega_ij is the rate of mass from cell j to i.
Shallow water with g = 1:

    L(omega, rho) = sum_(i != j) rho_j omega_ij^2/(2 c_ij) - sum_i rho_i^2/(2 D),   c_ij = 1/(2 D^2) for neighbours.

On momenta m_ij = rho_j (theta_i - theta_j) its discrete Euler-Poincare equations (symmetric rule, section 3) are the
method of Stoermer and Verlet for H(theta, rho).  With neighbours alone, v = (theta_(i+1) - theta_i)/D, and
K_i = (u_(i-1/2)^2 + u_(i+1/2)^2)/4, a step is

    v_k = u + eps/2 d(K + h_k),   h_(k+1) = h_k - eps/2 d(u mean(h_k + h_(k+1))),   v_(k+1) = u - eps/2 d(K + h_(k+1))

with the central difference d and the mean over two cells.  Left: a simple wave before it breaks, and its error.
Right: the energy over a long time after waves have broken; mass and circulation.

Source: W. Bauer and F. Gay-Balmaz, arXiv 1711.10617 (the group); G. B. Whitham, Linear and Nonlinear Waves, 1974.
"""

import os
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from kreisel import reduction as red
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
TIME = 0.2  # this wave breaks at 0.43
SWEEPS = 30  # of the iterations for u and h, each of which takes a factor of about eps u/(2 D)


# -- all of the group, at a few cells
def places(count):
    """i, j of the basis of `red.unit_sums`."""
    j, i = np.nonzero(~np.eye(count, dtype=bool))
    return i, j


@cache
def fluid(count, eps):
    """Weights c_ij of all pairs, and a step (m, rho) -> (W, m, rho) of the map of L."""
    i, j = places(count)
    away = abs((i - j + count // 2) % count - count // 2) / count
    weights = np.zeros((count, count))
    weights[i, j] = np.exp(-20 * away**2)
    weights /= (weights[0, 1:] * away[j == 0] ** 2).sum()

    def lagrangian(omega, rho):
        off = omega - jnp.diag(jnp.diag(omega))
        return (off**2 / (weights + np.eye(count)) @ rho).sum() / 2 - count * (rho @ rho) / 2

    rep = red.standard(red.unit_sums(count))
    rule = red.symmetric_rule(red.Continuous(lagrangian, rep, red.Frame.REST), eps)

    def step(m, rho):
        W = rule.turn(m, rho)
        return W, rule.after(W, rho), rule.carried(W, rho)

    return weights, rep, jax.jit(step)


def verlet(theta, rho, weights, eps):
    """Stoermer and Verlet for H = sum rho_j c_ij (theta_i - theta_j)^2/2 + sum rho_i^2/(2 D), any weights c_ij."""
    count, p = len(rho), theta

    def slope(p):
        return (weights * (p[:, None] - p) ** 2).sum(0) / 2

    for _ in range(SWEEPS):
        p = theta - eps / 2 * (slope(p) + count * rho)
    X = eps / 2 * weights * (p[:, None] - p)
    X = X - np.diag(X.sum(0))
    new = np.linalg.solve(np.eye(count) - X, rho + X @ rho)
    return p - eps / 2 * (slope(p) + count * new), new


def whole_group(verlet, count=5, eps=0.03, steps=100):
    """The differences of the two maps, and the changes of mass and of the Noether momenta from a state at random."""
    rng, (i, j) = np.random.default_rng(1), places(count)
    rho, theta = (1 + 0.2 * rng.uniform(-1, 1, count)) / count, 0.05 * rng.uniform(-1, 1, count)
    with red.double():
        weights, rep, step = fluid(count, eps)
        _, m, new = (np.asarray(z) for z in step(rho[j] * (theta[i] - theta[j]), rho))
        theta_1, rho_1 = verlet(theta, rho, weights, eps)
        maps = max(abs(new - rho_1).max(), abs(m - rho_1[j] * (theta_1[i] - theta_1[j])).max())
        isotropy = rep.isotropy(rho)  # the (N - 1)^2 directions that leave rho as it is
        g, m, a = np.eye(count), rng.uniform(-0.01, 0.01, len(i)), rho
        before = isotropy @ m
        for _ in range(steps):
            W, m, a = (np.asarray(z) for z in step(m, a))
            g = W @ g
        noether = abs(isotropy @ np.asarray(rep.group.Ad_star(g, m)) - before).max()
        moved = abs(isotropy @ m - before).max()
    return maps, abs(a.sum() - rho.sum()), noether, moved


# -- fluxes between neighbours alone
def slope(f, width):
    """From cells to the edges i + 1/2."""
    return (jnp.roll(f, -1) - f) / width


def half(v, h, width, eps):
    """u with v = u + eps/2 d(K + h)."""

    def better(_, u):
        return v - eps / 2 * slope(kinetic(u) + h, width)

    return jax.lax.fori_loop(0, SWEEPS, better, v)


def kinetic(u):
    return (u**2 + jnp.roll(u, 1) ** 2) / 4


def step(v, h, width, eps):
    """A step of the equations above."""
    u = half(v, h, width, eps)

    def better(_, new):
        flux = u * (h + new + jnp.roll(h + new, -1)) / 4
        return h - eps * (flux - jnp.roll(flux, 1)) / width

    new = jax.lax.fori_loop(0, SWEEPS, better, h)
    return u - eps / 2 * slope(kinetic(u) + new, width), new


def runge_kutta(v, h, width, eps):
    """The same equations in space by the classical method of order 4, for comparison."""

    def rate(v, h):
        flux = v * (h + jnp.roll(h, -1)) / 2
        return -slope(kinetic(v) + h, width), -(flux - jnp.roll(flux, 1)) / width

    k1 = rate(v, h)
    k2 = rate(v + eps / 2 * k1[0], h + eps / 2 * k1[1])
    k3 = rate(v + eps / 2 * k2[0], h + eps / 2 * k2[1])
    k4 = rate(v + eps * k3[0], h + eps * k3[1])
    return tuple(z + eps / 6 * (a + 2 * b + 2 * c + d) for z, a, b, c, d in zip((v, h), k1, k2, k3, k4, strict=True))


def ring(v, h, eps, steps, every=1, step=step):
    """Rows (v, h) after every so many steps, the start first."""
    width = 1 / len(h)

    def rows(z, _):
        z = jax.lax.fori_loop(0, every, lambda _, z: step(*z, width, eps), z)
        return z, z

    with red.double():
        start = jnp.asarray(v), jnp.asarray(h)
        out = jax.jit(lambda z: jax.lax.scan(rows, z, length=steps // every)[1])(start)
    return [np.concatenate([[a], b]) for a, b in zip(start, out, strict=True)]


def energy(v, h):
    return ((h + np.roll(h, -1, -1)) / 2 * v**2 + h**2).mean(-1) / 2


@cache
def locally(count, reach, eps):
    """d'_w Lambda + ... = m_k and d_w Lambda = m_(k+1) for omega between neighbours.

    Lambda wants L beside sparse omega too: there its derivative is rho_j (the circulation from j to i), |i - j| at most
    `reach`.
    """
    here, width = np.arange(count), 1 / count

    def lagrangian(omega, rho):
        forth = [rho * omega[(here + k) % count, here] for k in range(reach + 1)]
        back = [jnp.roll(rho, -k) * omega[here, (here + k) % count] for k in range(reach + 1)]
        u = width * (omega[(here + 1) % count, here] - omega[here, (here + 1) % count])
        path, value = width * u, (forth[1] * forth[1] / rho + back[1] * back[1] / jnp.roll(rho, -1)).sum() * width**2
        for k in range(2, reach + 1):
            path = path + width * jnp.roll(u, 1 - k)
            value += (path * (forth[k] - back[k])).sum()
        return value - rho @ rho / (2 * width)

    rule = red.symmetric_rule(red.Continuous(lagrangian, red.standard(red.unit_sums(count)), red.Frame.REST), eps)
    return jax.jit(rule.before), jax.jit(rule.after)


def constrained(step, count=12, reach=5, mean=0.3, eps=0.03, steps=3):
    """By |i - j|: how far the equation of section 3 is from holding in the directions E_ij, along steps from a state.

    mean   of v, the circulation
    """
    rng, width = np.random.default_rng(0), 1 / count
    h, v = 1 + 0.2 * rng.uniform(-1, 1, count), 0.1 * rng.uniform(-1, 1, count)
    v += mean - v.mean()
    here, (i, j) = np.arange(count), places(count)
    off, m = np.zeros(len(i)), None
    with red.double():
        before, after = locally(count, reach, eps)
        for _ in range(steps):
            u = np.asarray(half(jnp.asarray(v), jnp.asarray(h), width, eps))
            omega = np.zeros((count, count))
            omega[(here + 1) % count, here], omega[here, (here + 1) % count] = u / (2 * width), -u / (2 * width)
            X = eps / 2 * (omega - np.diag(omega.sum(0)))
            W = np.linalg.solve(np.eye(count) - X, np.eye(count) + X)
            new_v, new_h = (np.asarray(z) for z in step(jnp.asarray(v), jnp.asarray(h), width, eps))
            off = np.maximum(off, abs(W @ h - new_h).max())
            if m is not None:
                off = np.maximum(off, abs(np.asarray(before(W, width * h)) - m))
            m, v, h = np.asarray(after(W, width * h)), new_v, new_h
    away = abs((i - j + count // 2) % count - count // 2)
    return [off[away == k].max() for k in range(1, count // 2 + 1)]


# -- a simple wave: u = 2 (sqrt(h) - 1) moves with u + sqrt(h)
def depth(x):
    return 1 + 0.2 * np.sin(2 * np.pi * x) ** 3


def simple_wave(x, time):
    """Depth at points x of the ring, by Newton's method on x = x0 + time (3 sqrt(h(x0)) - 2)."""
    foot = x - time
    for _ in range(60):
        near = 1e-7
        speed, ahead = (3 * np.sqrt(depth(foot + s)) - 2 for s in (-near, near))
        foot = foot - (foot + time * (speed + ahead) / 2 - x) / (1 + time * (ahead - speed) / (2 * near))
    return depth(foot)


def wave_error(count, time=TIME, courant=0.5):
    steps = round(time * count / courant)
    edges, cells = np.arange(count) / count + 0.5 / count, np.arange(count) / count
    _, h = ring(2 * np.sqrt(depth(edges)) - 2, depth(cells), time / steps, steps, steps)
    return abs(h[-1] - simple_wave(cells, time)).max(), h[-1]


def standing_wave(count=32, waves=3, courant=0.8, tilt=1e-5):
    """The frequency of a small standing wave, measured and from sin(w eps/2) = (eps/D) sin(k D/2)."""
    eps, x = courant / count, np.arange(count) / count
    mode = np.cos(2 * np.pi * waves * x)
    expected = 2 / eps * np.arcsin(courant * np.sin(np.pi * waves / count))
    _, h = ring(np.zeros(count), 1 + tilt * mode, eps, 400)
    size = (h - 1) @ mode / (mode @ mode) / tilt
    # of a cosine: size_(k+1) + size_(k-1) = 2 cos(w eps) size_k
    measured = np.arccos(size[1:-1] @ (size[2:] + size[:-2]) / (2 * size[1:-1] @ size[1:-1])) / eps
    return measured, expected


if __name__ == "__main__":
    if not SMALL:  # the tests of `kreisel.reduction` have these, with mutants
        maps, mass, noether, moved = whole_group(verlet)
        print(f"whole group, 5 cells: the two maps differ by {maps:.0e}, mass by {mass:.0e}; 16 Noether momenta by "
              f"{noether:.0e}, without Ad* by {moved:.0e}")  # fmt: skip
        assert maps < 1e-10 and mass < 1e-13 and noether < 1e-9 and moved > 1e-3

        gaps, without = constrained(step), constrained(step, count=11, mean=0)
        print(
            "neighbours alone, 12 cells: off in the directions |i - j| = 1 ... 6: "
            + ", ".join(f"{g:.0e}" for g in gaps)
        )
        print(f"without circulation, 11 cells: off by {max(without):.0e} in all directions")
        assert max(gaps[:3]) < 1e-14 and gaps[5] > 1e-5 and max(without) < 1e-14

    counts = [128, 256] if SMALL else [32, 64, 128, 256, 512]
    errors = [wave_error(count)[0] for count in counts]
    slopes = -np.diff(np.log2(errors))
    measured, expected = standing_wave()
    print("simple wave: errors " + ", ".join(f"{e:.1e}" for e in errors) + f", slope {slopes[-1]:.2f}")
    print(f"standing wave: frequency {measured:.9f}, by the dispersion relation {expected:.9f}")
    assert abs(slopes[-1] - 2) < 0.15 and abs(measured / expected - 1) < 1e-8

    STEPS, EVERY = (20_000, 100) if SMALL else (200_000, 100)
    x, eps = np.arange(64) / 64, 0.5 / 64
    start = 0.2 + 0.1 * np.cos(2 * np.pi * x), 1 + 0.1 * np.sin(2 * np.pi * x)
    v, h = ring(*start, eps, STEPS, EVERY)
    total, other = (energy(*z) / energy(*start) - 1 for z in ((v, h), ring(*start, eps, STEPS, EVERY, runge_kutta)))
    masses, circulation = abs(h.mean(1) / h[0].mean() - 1), abs(v.mean(1) / v[0].mean() - 1)
    quarters = np.array_split(total[1:], 4)
    trend, spread = quarters[-1].mean() - quarters[0].mean(), max(part.std() for part in quarters)
    print(f"{STEPS} steps: energy within {abs(total).max():.1e}, last quarter less first {trend:.0e}, "
          f"spread {spread:.0e}, order 4 {other[-1]:.0e}; mass to {masses.max():.0e}, "
          f"circulation to {circulation.max():.0e}")  # fmt: skip
    assert abs(total).max() < 1e-3 and abs(trend) < 3 * spread and other[-1] < -1e-3  # of order 4: 200 spreads
    assert masses.max() < 1e-12 and circulation.max() < 1e-12

    with figure("light", 11.0, 4.0) as (made, theme):
        wave, error, long = made.subplots(1, 3, width_ratios=[1.2, 0.8, 1.2])
        fine = np.linspace(0, 1, 400)
        wave.plot(fine, depth(fine), color=theme.ink, linestyle=":", linewidth=1, label="start")
        wave.plot(fine, simple_wave(fine, TIME), color=theme.ink, linewidth=1, label="exact")
        wave.plot(np.arange(64) / 64, wave_error(64)[1], ".", color=theme.colours[0], label="64 cells")
        wave.set(xlabel="x", ylabel="depth h", title=f"a simple wave at t = {TIME:g}")
        wave.legend()
        error.loglog(counts, errors, "o-", color=theme.colours[0], label="largest error")
        error.loglog(counts, errors[-1] * (counts[-1] / np.array(counts)) ** 2, "--", color=theme.ink, label="slope 2")
        error.set(xlabel="cells N", title="error of h", xticks=counts, xticklabels=counts)
        error.minorticks_off()
        error.legend()
        time = eps * EVERY * np.arange(len(total))
        names = ("energy, Runge-Kutta 4", "energy", "circulation", "mass")
        for k, (change, name) in enumerate(zip((abs(other), abs(total), circulation, masses), names, strict=True)):
            long.loglog(time[1:], change[1:].clip(1e-17), color=theme.colours[k], linewidth=0.8, label=name)
        long.set(xlabel="time", title="changes in a long run", ylim=(1e-17, 1))
        long.legend(loc="center right")
        made.savefig("compressible_fluid.png")
