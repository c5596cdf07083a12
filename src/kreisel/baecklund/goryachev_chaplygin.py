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

from kreisel.algebra import axial, complex_number, conjugate, dot, hat, parts, sqrt
from kreisel.baecklund.conjugate import legendre
from kreisel.record.contract import ExactMap

REACH = 0.5  # of the distance of a branch point, for 1/l
NODES = 20  # on [0, 1/l]: the error of the integrals is below 4^-40
BEYOND = 16  # of the largest branch point: there the map is the identity
STEPS, ENOUGH = 20, 1e-13  # of Newton's method; a miss of the time
HALF, SHARES = legendre(NODES)
PLACES, WEIGHTS = np.concatenate([1 - HALF, 1 + HALF, [2]]) / 2, np.concatenate([SHARES, SHARES]) / 2  # and the end


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
    """lam for one state in extended precision, z = 1/lam; None if z lies too near a branch point.

    For dt = 0 a real lam, a power of 2: the map is the identity without rounding errors.
    """
    H, G, square = integrals(M, P, gamma)
    trace, ends = np.array([-2 * G, -2 * H, gamma, 1]), 2 * np.sqrt(square) * np.array([0, 1, 0, 0])
    companions = np.zeros((2, 3, 3))
    companions[:, 1, 0] = companions[:, 2, 1] = 1
    companions[:, 0] = [-(trace + sign * ends)[2::-1] for sign in (-1, 1)]
    largest = max(abs(np.linalg.eigvals(companions)).max(), np.finfo(float).tiny)
    far = REACH / largest
    if dt == 0:
        return np.longdouble(2) ** np.ceil(np.log2(BEYOND * largest)) + 0j
    z, change, miss = -0.5j * dt, np.inf, np.inf
    for _ in range(STEPS):
        if not abs(z) < far or abs(change) <= np.finfo(np.longdouble).eps * abs(z):
            break
        change, miss = _newton(z, dt, trace, ends)
        z = z + change
    if not abs(z) < far or miss > ENOUGH * abs(dt):
        return None
    return 1 / z


def level(M, P, *, gamma, lam):
    """The large eigenvalue w at a point."""
    H, G, square = integrals(M, P, gamma)
    half = ((lam + gamma) * lam / 2 - H) * lam - G
    return half * (1 + sqrt(1 - square * lam * lam / (half * half)))


def _newton(z, dt, trace, ends):
    """The change of z by a step of Newton's method, whose Jacobian has the integrands at z, and the miss."""
    X = z * PLACES
    squares = [sum(c * X ** (3 - k) for k, c in enumerate(trace + sign * ends)) for sign in (-1, 1)]
    f = 2 / (np.sqrt(squares[0]) * np.sqrt(squares[1]))
    a, b = f[-1], X[-1] * f[-1]
    first, second = (z * (WEIGHTS * g[:-1]).sum() for g in (f, X * f))
    miss = (-first.imag - dt, -second.imag)
    det = a.imag * b.real - a.real * b.imag
    x, y = miss[0] * b.real - miss[1] * a.real, miss[1] * a.imag - miss[0] * b.imag
    return (x + 1j * y) / det, max(abs(miss[0]), abs(miss[1]))


EXACT = ExactMap(point=point, level=level, step=step)
