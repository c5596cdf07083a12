"""Bäcklund map of Goryachev-Chaplygin's top with a rotor g on <M, P> = 0, state (M, P), that is the flow over a time.

T(u) = [[A, B], [C, D]] [[k, -1], [-1, 0]], k = u + 2 M_3 + g, with M_+- = M_1 +- i M_2, P_+- likewise, and

    A = u^2 - 2 M_3 u - M_+ M_-,  B = u P_- - P_3 M_-,  C = u P_+ - P_3 M_+,  D = -P_3^2

has tr T = t(u) = u^3 + g u^2 - 2 H u - 2 G and det T = |P|^2 u^2.  For a complex l let w be the large root of
w^2 - t w + |P|^2 u^2 at l, with the eigenvector (1, p), v the small one at l^- = conj l, with (1, l^- + m): then
T' = (u - X) T (u - X)^-1 for the X with these vectors and the eigenvalues l, l^-.  n = m - p is real, and

    beta = (l + n)/(l^- + n),  M_3' = (2 M_3 + d (m + p - g + d p))/(2 beta),  d = (l - l^-)/(l^- + n),
    P_+' = beta (P_+ - X_21),  beta M_-' = c (X_11 M_- + X_12 P_3),  P_3' = c (X_21 M_- + X_22 P_3),

where X_11 = l + d p, X_12 = -d, X_21 = d p (l^- + m), X_22 = l^- - d p, and |c l| = 1 with c in the direction of
w (1 + n/l^-)/(l^3 l^-).  With y^2 = t^2 - 4 |P|^2 u^2 it is the flow over h if Im int_oo^l 2 u du/y = h and
Im int_oo^l 2 du/y = 0.
[T: Sklyanin; the map and its conditions are Kreisel's, proved in paper/maps.tex]
"""

import numpy as np

from kreisel.algebra import axial, complex_number, conjugate, dot, hat, parts, rounded, sqrt, where_less
from kreisel.algebra.complex import Complex
from kreisel.baecklund.conjugate import legendre
from kreisel.record.contract import ExactMap

REACH = 0.5  # of the distance of a branch point, for 1/l
NODES = 16  # on [0, 1/l]: the error of the integrals is below 5^-32 times a bound of the integrands
FAR = 2.0**120  # real, beyond all branch points: the identity without rounding errors; its 8th power is a double
CLOSE, STEPS, ENOUGH = 1e-16, 20, 1e-13  # of Newton's method: a squared change, relative; steps; a miss of the time
HALF, SHARES = legendre(NODES)
RULE = np.stack([np.append(1 - HALF, 1 + HALF), np.append(SHARES, SHARES)], -1) / 2
ROWS = np.stack([RULE, RULE - RULE.astype(float)], -1).astype(float).reshape(-1, 4).tolist()  # two doubles each


def integrals(M, P, gamma):
    """The integrals H and G, and |P|^2."""
    x, y, z = (axial(M)[..., i] for i in range(3))
    H = (x * x + y * y) / 2 + 2 * z * z + gamma * z + P[..., 0]
    return H, (z + gamma / 2) * (x * x + y * y) - x * P[..., 2], dot(P, P)


def step(M, P, *, gamma, lam_re, lam_im, mu_re, mu_im):
    (x, y, z), (first, second, P3) = ([V[..., i] for i in range(3)] for V in (axial(M), P))
    H, G, square = integrals(M, P, gamma)
    lam, bar, w = complex_number(lam_re, lam_im), complex_number(lam_re, -lam_im), complex_number(mu_re, mu_im)
    minus, plus, P_minus, P_plus = (complex_number(*v) for v in ((x, -y), (x, y), (first, -second), (first, second)))
    trace = ((lam + gamma) * lam - 2 * H) * lam - 2 * G
    w = w - ((w - trace) * w + square * lam * lam) / (2 * w - trace)  # of the very state
    C = lam * P_plus - P3 * plus
    p = (C * (lam + 2 * z + gamma) + P3 * P3) / (w + C)
    A, B = (bar - 2 * z) * bar - x * x - y * y, bar * P_minus - P3 * minus
    q = 2 * z - (B + conjugate(square * lam * lam / w)) / A  # m - gamma, which may be far smaller than gamma
    n = parts(q - p)[0] + gamma
    d = (lam - bar) / (bar + n)
    beta = 1 + d  # 1 for a real lam, without rounding
    c = w * (bar + n) / (lam * lam * lam * bar)
    re, im = parts(c)
    t = im / (re + sqrt(re * re + im * im))  # tan of half the phase, which is below 2.1 rad; 0 for a real lam
    c = complex_number((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)) / bar
    lower = d * p * (bar + gamma + q)
    u, v = parts(c * ((lam + d * p) * minus - d * P3) / beta)
    third = parts((2 * z + d * (q + p + d * p)) / (2 * beta))[0]
    first, second = parts(beta * (P_plus - lower))
    last = parts(c * (lower * minus + (bar - d * p) * P3))[0]
    return hat(np.stack([u, -v, third], -1)), np.stack([first, second, last], -1)


def point(M, P, *, gamma, dt):
    """lam = 1/z for a recorded state, in its digits, positive if z is right and not too near a branch point."""
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
    return rounded(1 / z), sound


def level(M, P, *, gamma, lam):
    """The large eigenvalue w at a point."""
    H, G, square = integrals(M, P, gamma)
    half = ((lam + gamma) * lam / 2 - H) * lam - G
    return half * (1 + sqrt(1 - square * lam * lam / (half * half)))


def integrand(x, gamma, H, G, length):
    """2 u^3/y at u = 1/x."""
    t, s = 1 + (gamma - (2 * H + 2 * G * x) * x) * x, 2 * length * (x * x)
    return 2 / (sqrt(t - s) * sqrt(t + s))


def newton(z, dt, curve):
    """The change of z by a step of Newton's method, whose Jacobian has the integrands at z, and the miss."""
    first, second = 0, 0
    for place, after, weight, more in ROWS:
        x = z * place + z * after
        f = integrand(x, *curve)
        f = f * weight + f * more
        first, second = first + f, second + x * f
    a = integrand(rounded(z), *map(rounded, curve))
    b = rounded(z) * a
    p, q = (rounded(-parts(z * total)[1] - time) for total, time in ((first, dt), (second, 0)))
    det = a.im * b.re - a.re * b.im
    change = Complex((p * b.re - q * a.re) / det, (q * a.im - p * b.im) / det)
    return change, where_less(abs(p), abs(q), abs(q), abs(p))


EXACT = ExactMap(point=point, level=level, still=(FAR, FAR**3), step=step)
