"""Goryachev-Chaplygin's top with a rotor, n = 3, on <M, P> = 0.  State (M, P) in e(3)*: axial vectors, body frame.

The moments of inertia are (1, 1, 1/4) and the centre of mass is on the first axis; gamma is the momentum of the rotor.
The second integral is one on <M, P> = 0 only.  Plus bracket, F' = {H, F}.
[Goryachev 1900; Chaplygin 1901; named in Suris 2001, Introduction]

The flow over a time is a Bäcklund map.  T(u) = [[A, B], [C, D]] [[k, -1], [-1, 0]], k = u + 2 M_3 + gamma, with
M_+- = M_1 +- i M_2, P_+- likewise, and

    A = u^2 - 2 M_3 u - M_+ M_-,  B = u P_- - P_3 M_-,  C = u P_+ - P_3 M_+,  D = -P_3^2

has tr T = t(u) = u^3 + gamma u^2 - 2 H u - 2 G and det T = |P|^2 u^2.  For a complex l = 1/z let w be the large root of
w^2 - t w + |P|^2 u^2 at l, with the eigenvector (1, p).  That of the small root at l^- = conj l is (1, l^- + m) with
m = 2 M_3 + gamma - p^-, and n = m - p is real.  T' = (u - X) T (u - X)^-1 for the X with these vectors and the
eigenvalues l, l^-.  With f = p/z, s = 1 + n z, d = (z^- - z)/s^-, h = m M_- - P_3 and U the phase of z^3 w s^-,

    P_+' = P_+ - d (n f + (f - P_+)/z + z^- (1 - n d) f^2),  M_3' = M_3 + Re d f,
    M_-' = U (M_- - d^- h),  P_3' = Re U (P_3 + d f (M_- + z^- h)).

All changes are of order z: the constants of a step are rounded alike each time, so the integrals would drift by as
many last places a step as these terms have.  With y^2 = t^2 - 4 |P|^2 u^2 the map is the flow over h if
Im int_oo^l 2 u du/y = h and Im int_oo^l 2 du/y = 0.
[T: Sklyanin; the map and its conditions are Kreisel's, proved in paper/maps.tex]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import (
    act,
    axial,
    complex_number,
    conjugate,
    cross,
    dot,
    hat,
    identity,
    parts,
    rounded,
    sqrt,
    vec,
    wedge,
    where_less,
)
from kreisel.algebra.backend import Complex
from kreisel.algebra.invariants import stack
from kreisel.baecklund.conjugate import legendre
from kreisel.record.contract import MOVING_SPACE, ExactMap, Parameter, System, named

INVERSE_MOMENTS = np.array([1, 1, 4], dtype=np.int8)
REACH = 0.5  # of the distance of a branch point, for 1/l
NODES = 16  # on [0, 1/l]: the error of the integrals is below 5^-32 times a bound of the integrands
CLOSE, STEPS, ENOUGH = 1e-16, 20, 1e-13  # of Newton's method: a squared change, relative; steps; a miss of the time
HALF, SHARES = legendre(NODES)
RULE = np.stack([np.append(1 - HALF, 1 + HALF), np.append(SHARES, SHARES)], -1) / 2
ROWS = np.stack([RULE, RULE - RULE.astype(float)], -1).astype(float).reshape(-1, 4).tolist()  # two doubles each


def velocity(M, P, *, gamma):  # Omega = (M_1, M_2, 4 M_3 + gamma)
    return hat(INVERSE_MOMENTS * axial(M) + vec(gamma) * identity(3)[2])


def flow(M, P, *, gamma):  # M' = [M, Omega] + e_1 ^ P,   P' = -Omega P
    Omega = velocity(M, P, gamma=gamma)
    return M @ Omega - Omega @ M + wedge(identity(3)[0], P), -act(Omega, P)


def energy(M, P, *, gamma):
    u = axial(M)
    return dot(u, INVERSE_MOMENTS * u) / 2 + gamma * u[..., 2] + P[..., 0]


def chaplygin(M, P, *, gamma):  # (M_3 + gamma/2)(M_1^2 + M_2^2) - M_1 P_3
    x, y, z = (axial(M)[..., i] for i in range(3))
    return (z + gamma / 2) * (x * x + y * y) - x * P[..., 2]


def on_leaf(n, draw):
    """M with <M, P> = 0: a cross product with P."""
    P = draw((3,))
    return hat(cross(P, draw((3,)))), P


# -- the flow over a time as a Bäcklund map --------------------------------------------------------------


def integrals(M, P, gamma):
    """The integrals H and G, and |P|^2."""
    x, y, z = (axial(M)[..., i] for i in range(3))
    H = (x * x + y * y) / 2 + 2 * z * z + gamma * z + P[..., 0]
    return H, chaplygin(M, P, gamma=gamma), dot(P, P)


def step(M, P, *, gamma, z_re, z_im, w_re, w_im):
    (x, y, m3), (first, second, P3) = ([V[..., i] for i in range(3)] for V in (axial(M), P))
    z, bar, w, double = complex_number(z_re, z_im), complex_number(z_re, -z_im), complex_number(w_re, w_im), 2 * m3
    minus, plus, P_minus, P_plus = (complex_number(*v) for v in ((x, -y), (x, y), (first, -second), (first, second)))
    u, square = double + (x * x + y * y) * z, z * z
    A, B, C, k = 1 - z * u, P_minus - z * (P3 * minus), P_plus - z * (P3 * plus), 1 + z * (double + gamma)
    f = (C * k + square * (P3 * P3)) / (w + square * C)  # by w of the start; Newton's method makes it that of the state
    slope = z * (2 * A * f + B - C)
    e = (k * (u * P_plus - P3 * plus) + z * (P3 * P3 - A * f * f) + slope * P_plus) / (A * k - z * slope)
    f = P_plus + z * e
    p = z * f
    n = double + gamma - 2 * parts(p)[0]
    d = (bar - z) / (1 + n * bar)
    h, df = (n + p) * minus - P3, d * f
    re, im = parts((A * k - square * (B + A * f)) * (1 + n * bar))
    t = im / (re + sqrt(re * re + im * im))  # tan of half the phase of U, which is below 2.1 rad
    share = 2 * t / (1 + t * t)
    turn = complex_number(-t * share, share)  # U - 1
    first, second = parts(P_plus - (n * df + d * e + bar * ((1 - n * d) * (df * f))))
    last = P3 + parts(turn * P3 + (1 + turn) * (df * (minus + bar * h)))[0]
    u, v = parts(minus + (turn * minus - (1 + turn) * (conjugate(d) * h)))
    return hat(np.stack([u, -v, m3 + parts(df)[0]], -1)), np.stack([first, second, last], -1)


def point(M, P, *, gamma, dt):
    """z = 1/lam for a recorded state, in its digits, positive if it is right and not too near a branch point."""
    H, G, length = integrals(M, P, gamma)
    curve = gamma, H, G, sqrt(length)

    def square(z):
        return z.re * z.re + z.im * z.im

    def nearer(x):
        z = Complex(*x)
        change, _ = newton(z, dt, [rounded(v) for v in curve])
        return list(parts(z + change)), square(change) / square(z)

    (x, y), _ = dt.graph.loop(nearer, [0.0, -dt / 2], CLOSE, STEPS)
    z = Complex(x + 0 * H, y + 0 * H)
    change, miss = newton(z, dt, curve)
    z, sound = z + change, where_less(miss, ENOUGH * abs(dt), 1.0, -1.0)
    gamma, H, G, length = (rounded(v) for v in curve)
    R = sqrt(square(rounded(z))) / REACH
    for sign in (-1, 1):  # Jury's conditions for the roots of t -+ 2 |P| u, times R
        a, b, c = gamma * R, 2 * (sign * length - H) * R * R, -2 * G * R * R * R
        for room in (1 + b - abs(a + c), 3 - b - abs(a - 3 * c), 1 + a * c - c * c - b):
            sound = where_less(0, room, sound, -1.0)
    return rounded(z), sound


def level(M, P, *, gamma, z):
    """w z^3, of the large eigenvalue w at a point."""
    H, G, square = integrals(M, P, gamma)
    half = (1 + z * (gamma - 2 * z * (H + G * z))) / 2
    return half * (1 + sqrt(1 - square * (z / half * z) * (z / half * z)))


def integrand(x, gamma, H, G, length):
    """2 u^3/y at u = 1/x."""
    t, s = 1 + (gamma - (2 * H + 2 * G * x) * x) * x, 2 * length * (x * x)
    return 2 / (sqrt(t - s) * sqrt(t + s))


def newton(z, dt, curve):
    """The change of z by a step of Newton's method, whose Jacobian has the integrands at z, and the miss."""
    first, second = 0, 0
    for place, after, weight, weight_low in ROWS:
        x = z * place + z * after
        f = integrand(x, *curve)
        f = f * weight + f * weight_low
        first, second = first + f, second + x * f
    a = integrand(rounded(z), *map(rounded, curve))
    b = rounded(z) * a
    p, q = (rounded(-parts(z * total)[1] - time) for total, time in ((first, dt), (second, 0)))
    det = a.im * b.re - a.re * b.im
    change = Complex((p * b.re - q * a.re) / det, (q * a.im - p * b.im) / det)
    q = q / dt  # a time, as p is
    return change, where_less(abs(p), abs(q), abs(q), abs(p))


EXACT = ExactMap(point=point, level=level, step=step)

SYSTEM = System(
    name="goryachev-chaplygin",
    title="Goryachev-Chaplygin top",
    equations="M' = M x Omega + P x e_1,  P' = P x Omega,  Omega = (M_1, M_2, 4 M_3 + gamma)",
    source="Goryachev 1900, Chaplygin 1901; Suris 2001, Introduction",
    space=replace(
        MOVING_SPACE,
        name="e*(3), <M, P> = 0",
        casimirs=lambda M, P: stack([dot(P, P), dot(axial(M), P)]),  # not its square: without a gradient no projection
        constraints={"<M, P>": lambda M, P: dot(axial(M), P)},
        draw=on_leaf,
    ),
    parameters=(Parameter("gamma", "scalar", "the momentum of a rotor along the third axis", None, 0.0),),
    **named(flow, energy, velocity),
    scaling="The transverse moment of inertia and m g l are 1; the axial moment is 1/4.",
    integrals={"chaplygin": chaplygin},
    commuting=("chaplygin",),
    exact_map=EXACT,
    n=3,
    notes="No explicit map is known; method='exact'.",
)
