"""The free body, n = 3, with its orientation in many digits, by other formulas than those of the package.

Legendre's form of the integral of the third kind and an arctangent, against which the Landen form of
`kreisel.exact.rotor` is held; checked itself against Taylor series of the equations of motion.
"""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np


def product(a: list[Any], b: list[Any]) -> list[Any]:
    """Of quaternions (w, x, y, z)."""
    (w, x, y, z), (p, q, r, s) = a, b
    return [
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ]


def conjugate(q: list[Any]) -> list[Any]:
    return [q[0], *(-v for v in q[1:])]


def lift(M: list[Any], L: Any) -> list[Any]:
    q = [L + M[2], M[1], -M[0], mp.mpf(0)]
    size = mp.sqrt(sum(v * v for v in q))
    return [v / size for v in q]


def relabelling(I: list[Any], M: list[Any], L2: Any, T2: Any) -> tuple[list[int], np.ndarray]:  # noqa: E741
    """The order of the axes and the rotation onto them: about the third, M_3 > 0."""
    order = sorted(range(3), key=lambda i: I[i])
    if L2 < T2 * I[order[1]]:
        order.reverse()
    R = np.eye(3, dtype=int)[order]
    if np.linalg.det(R) < 0:
        R[1] = -R[1]
    if M[order[2]] < 0:
        R[1:] = -R[1:]
    return order, R


def as_turn(R: np.ndarray) -> list[Any]:
    """A signed permutation, as a quaternion."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(R).as_quat(scalar_first=True)
    rounded = [mp.sign(v) * mp.sqrt(round(4 * v * v)) / 2 for v in q]
    return rounded


def closed_form(moments: Any, M: Any, g: Any, t: Any, digits: int = 60) -> tuple[list[Any], list[Any]]:
    """(M, g) at time t; not for steady motions, nor on the separatrix."""
    with mp.workdps(digits):
        I, M, g = ([mp.mpf(v) for v in x] for x in (moments, M, g))  # noqa: E741
        L2, T2 = sum(v * v for v in M), sum(v * v / i for v, i in zip(M, I, strict=True))
        order, R = relabelling(I, M, L2, T2)
        r, N = as_turn(R), [sum(int(R[i][j]) * M[j] for j in range(3)) for i in range(3)]
        N, h = _about_the_third([I[k] for k in order], N, product(g, conjugate(r)), mp.mpf(t))
        return [sum(int(R[i][j]) * N[i] for i in range(3)) for j in range(3)], product(h, r)


def _about_the_third(I: list[Any], M: list[Any], g: list[Any], t: Any) -> tuple[list[Any], list[Any]]:  # noqa: E741
    (I1, I2, I3), L2 = I, sum(v * v for v in M)
    T2, L = sum(v * v / i for v, i in zip(M, I, strict=True)), mp.sqrt(L2)
    D, E = T2 * I3 - L2, L2 - T2 * I1
    a1, a2, a3 = mp.sqrt(I1 * D / (I3 - I1)), mp.sqrt(I2 * D / (I3 - I2)), mp.sqrt(I3 * E / (I3 - I1))
    lam, m = mp.sqrt((I3 - I2) * E / (I1 * I2 * I3)), (I2 - I1) * D / ((I3 - I2) * E)
    n, c = -I3 * (I2 - I1) / (I1 * (I3 - I2)), mp.sqrt(I2 * (I3 - I1) / (I1 * (I3 - I2)))
    s = 1 if I3 > I1 else -1
    phi0 = mp.atan2(s * M[1] / a2, M[0] / a1)
    u, K = mp.ellipf(phi0, m) + lam * t, mp.ellipk(m)
    whole = mp.nint(u / (2 * K))
    sn, cn = (mp.ellipfun(f, u - 2 * K * whole, m=m) for f in ("sn", "cn"))
    phi = mp.atan2(sn, cn) + whole * mp.pi
    new = [a1 * mp.cos(phi), s * a2 * mp.sin(phi), a3 * mp.sqrt(1 - m * mp.sin(phi) ** 2)]

    def turned(x: Any) -> Any:
        k = mp.nint(x / mp.pi)
        return L * mp.ellippi(n, x, m) - a3 / c * (mp.atan(c * mp.tan(x - k * mp.pi)) + k * mp.pi)

    psi = L * t / I3 + (I3 - I1) / (I1 * I3 * lam) * (turned(phi) - turned(phi0))
    z = [mp.cos(psi / 2), mp.mpf(0), mp.mpf(0), mp.sin(psi / 2)]
    return new, product(product(product(g, conjugate(lift(M, L))), z), lift(new, L))


def by_taylor(moments: Any, M: Any, g: Any, t: float, digits: int = 40) -> tuple[list[Any], list[Any]]:
    """(M, g) at time t by Taylor series of M' = M x Omega, g' = g Omega/2 about successive times."""
    with mp.workdps(digits + 10):
        inverse, M, g = [1 / mp.mpf(v) for v in moments], [mp.mpf(v) for v in M], [mp.mpf(v) for v in g]
        fastest = max(inverse) * mp.sqrt(sum(v * v for v in M))
        steps = int(mp.ceil(abs(t) * fastest * 2)) or 1
        for _ in range(steps):
            M, g = _taylor_step(inverse, M, g, mp.mpf(t) / steps, 2 * digits)
        return M, g


def _taylor_step(inverse: list[Any], M: list[Any], g: list[Any], h: Any, orders: int) -> tuple[list[Any], list[Any]]:
    Ms, gs = [[v] for v in M], [[v] for v in g]
    of = lambda a, b: mp.fdot(a, b[::-1])  # noqa: E731
    for k in range(orders):
        W = [[i * v for v in series] for i, series in zip(inverse, Ms, strict=True)]
        dM = [of(Ms[i], W[j]) - of(Ms[j], W[i]) for i, j in ((1, 2), (2, 0), (0, 1))]
        (s, x, y, z), (a, b, c) = gs, W
        dg = [
            -of(x, a) - of(y, b) - of(z, c),
            of(s, a) + of(y, c) - of(z, b),
            of(s, b) + of(z, a) - of(x, c),
            of(s, c) + of(x, b) - of(y, a),
        ]
        for series, rate in zip((*Ms, *gs), (*dM, *(v / 2 for v in dg)), strict=True):
            series.append(rate * h / (k + 1))
            # coefficients in h, so the rates are taken per h too
    return [mp.fsum(v) for v in Ms], [mp.fsum(v) for v in gs]
