"""Section 7, proof of Theorem 7.1: the identities (dClebsch spec aux)."""

from __future__ import annotations

from kreisel.algebra import Array, identity
from kreisel.algebra.matrices import diagonal
from kreisel.lab.law import Sides
from kreisel.lab.paper.shared import outer
from kreisel.lab.paper.statements import Setting, printed, stated
from kreisel.system import clebsch


class Step:
    """A step of the map and the matrices of the proof, P = P_k, |P| = 1 unless `unit` is False."""

    def __init__(self, s: Setting, unit: bool = True):
        self.e, self.b = s.eps, s.diagonal()
        self.M, self.P = s.skew(), s.unit() if unit else s.vector()
        self.M1, self.P1 = clebsch.step(self.M, self.P, b=self.b, eps=self.e)
        one = identity(s.n)
        den = clebsch.denominator(self.P, b=self.b, eps=self.e)
        S = one + self.e**2 / 4 * diagonal(self.b)
        self.Q, self.R = outer(self.P) @ S / den, S @ outer(self.P) / den
        self.script = self._script(self.M, self.P, one)
        self.script1 = self._script(self.M1, self.P1, one)
        self.dM, self.one = self.M1 - self.M, one

    def _script(self, M: Array, P: Array, one: Array) -> Array:  # (dClebsch spec P)
        return (one + self.e / 2 * M) @ outer(P) @ (one - self.e / 2 * M)


@stated(
    "clebsch-aux1",
    "Section 7, (dClebsch spec aux1)",
    "(I - eps/(2 lambda) R)(lambda B + M_(k+1) + P_(k+1)/lambda)(I + eps/(2 lambda) Q) = the same with signs turned, M_k, P_k; |P| = 1",
)
def aux1(s: Setting) -> Sides:
    k = Step(s)
    B, turn = s.lam * diagonal(k.b), k.e / (2 * s.lam)
    new, old = B + k.M1 + k.script1 / s.lam, B + k.M + k.script / s.lam
    yield (k.one - turn * k.R) @ new @ (k.one + turn * k.Q), (k.one + turn * k.R) @ old @ (k.one - turn * k.Q)


@stated("clebsch-aux3", "Section 7, (dClebsch spec aux3)", "lambda^0: M_(k+1) - M_k = eps (R_k B - B Q_k)")
def aux3(s: Setting) -> Sides:
    k = Step(s)
    yield k.dM, k.e * (k.R * k.b - k.b[:, None] * k.Q)


@stated(
    "clebsch-aux4",
    "Section 7, (dClebsch spec aux4)",
    "lambda^-1: P_(k+1) - P_k = (eps/2) R_k (M_(k+1) + M_k) - (eps/2)(M_(k+1) + M_k) Q_k, script P",
)
def aux4(s: Setting) -> Sides:
    k = Step(s)
    yield k.script1 - k.script, k.e / 2 * (k.R @ (k.M1 + k.M) - (k.M1 + k.M) @ k.Q)


@stated(
    "clebsch-aux5",
    "Section 7, (dClebsch spec aux5)",
    "lambda^-2: (P_(k+1) + P_k) Q_k - R_k (P_(k+1) + P_k) = (eps/2) R_k dM Q_k = 0",
)
def aux5(s: Setting) -> Sides:
    k = Step(s)
    left = (k.script1 + k.script) @ k.Q - k.R @ (k.script1 + k.script)
    yield left, k.e / 2 * k.R @ k.dM @ k.Q
    yield left, 0 * left


@stated(
    "clebsch-aux6",
    "Section 7, (dClebsch spec aux6)",
    "R_k (P_(k+1) - P_k) Q_k = 0; it stands at lambda^-3 of (aux1), aux3 to aux5 at 0, -1, -2 (printed lambda^-2, E5)",
    "E5",
)
def aux6(s: Setting) -> Sides:
    k = Step(s)
    value = k.R @ (k.script1 - k.script) @ k.Q
    yield value, 0 * value
    yield from _expansion(s, 3)


def _expansion(s: Setting, order: int) -> Sides:
    """(aux1) for any matrices in the powers of lambda, with R (P_(k+1) - P_k) Q at lambda^-order."""
    B, R, Q, M, M1, P, P1 = (s.draw((s.n, s.n)) for _ in range(7))
    one, t, lam = identity(s.n), s.eps / 2, s.lam
    new = (one - t / lam * R) @ (lam * B + M1 + P1 / lam) @ (one + t / lam * Q)
    old = (one + t / lam * R) @ (lam * B + M + P / lam) @ (one - t / lam * Q)
    at_0 = M1 - M - 2 * t * (R @ B - B @ Q)
    at_1 = P1 - P - t * (R @ (M1 + M) - (M1 + M) @ Q)
    at_2 = t * ((P1 + P) @ Q - R @ (P1 + P)) - t**2 * R @ (M1 - M) @ Q
    yield new - old, at_0 + at_1 / lam + at_2 / lam**2 - t**2 * R @ (P1 - P) @ Q / lam**order


@printed("clebsch-aux6")
def aux6_printed(s: Setting) -> Sides:
    yield from _expansion(s, 2)


@stated(
    "clebsch-aux8",
    "Section 7, (dClebsch spec aux8)",
    "Q_k = P P^T (I + eps/4 dM), R_k = (I - eps/4 dM) P P^T, Q_k^2 = Q_k; |P| = 1 (E10)",
    "E10",
)
def aux8(s: Setting) -> Sides:
    yield from _aux8(Step(s))


def _aux8(k: Step) -> Sides:
    yield k.Q, outer(k.P) @ (k.one + k.e / 4 * k.dM)
    yield k.R, (k.one - k.e / 4 * k.dM) @ outer(k.P)
    yield k.Q @ k.Q, k.Q


@printed("clebsch-aux8")
def aux8_printed(s: Setting) -> Sides:
    yield from _aux8(Step(s, unit=False))


@stated(
    "clebsch-aux9",
    "Section 7, (dClebsch spec aux9)",
    "P_(k+1) = (I - eps/2 M_(k+1)) P_k P_k^T (I + eps/2 M_(k+1)), script P on the left",
)
def aux9(s: Setting) -> Sides:
    k = Step(s)
    yield k.script1, (k.one - k.e / 2 * k.M1) @ outer(k.P) @ (k.one + k.e / 2 * k.M1)


@stated(
    "clebsch-last-display",
    "Section 7, last display of the proof",
    "(P_(k+1) + P_k) Q_k = R_k (P_(k+1) + P_k) = 2 (I - eps/4 dM) P P^T (I + eps/4 dM) (E3: the 2)",
    "E3",
)
def last_display(s: Setting) -> Sides:
    yield from _last_display(Step(s), 2)


def _last_display(k: Step, factor: int) -> Sides:
    right = factor * (k.one - k.e / 4 * k.dM) @ outer(k.P) @ (k.one + k.e / 4 * k.dM)
    yield (k.script1 + k.script) @ k.Q, right
    yield k.R @ (k.script1 + k.script), right


@printed("clebsch-last-display")
def last_display_printed(s: Setting) -> Sides:
    yield from _last_display(Step(s), 1)
