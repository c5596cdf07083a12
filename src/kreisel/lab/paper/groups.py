"""Sections 2 and 3 for other G and V: GL(n) and its triangular subgroup on symmetric matrices, Phi(g) S = g S g^T.

Neither is compact, the second is solvable and not unimodular, and phi* is not -phi: signs that SO(n) on R^n cannot tell
apart count.  Elements of g* are their values on a basis.  Both groups are open in an algebra of matrices, so that 1 + X is
a chart, and g (1 + t E) (1 + h E') gives derivatives along left-invariant fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, bracket, identity
from kreisel.lab.jets import Jet, coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.statements import Setting, stated

Function = Callable[[Array, Array], Any]
PLACE = "Sections 2 and 3, any G and V"
ON = "G = GL(n) and upper triangular matrices, V = symmetric matrices"


def trace(A: Array) -> Any:
    """tr A."""
    return (A * identity(A.shape[-1])).sum(-1).sum(-1)


class Action:
    """A matrix group with the units E_ij for which `free` holds, on symmetric matrices; generic functions on it."""

    def __init__(self, s: Setting, free: Callable[[int, int], bool]):
        self.s, n = s, s.n
        self.places = [(i, j) for i in range(n) for j in range(n) if free(i, j)]
        self.units = [self._unit(i, j) for i, j in self.places]
        self.axes = [self._unit(i, j) | self._unit(j, i) for i in range(n) for j in range(i, n)]
        self.one = identity(n) + 0 * s.draw((n, n))

    def _unit(self, i: int, j: int) -> Array:
        return np.arange(self.s.n)[:, None] * self.s.n + np.arange(self.s.n) == i * self.s.n + j

    def element(self) -> Array:
        """A random element of the algebra."""
        return sum(self.s.scalar() * E for E in self.units)

    def member(self) -> Array:
        """A random element of the group."""
        return 3 * self.one + self.element() / 2

    def vector(self) -> Array:
        """A random element of V."""
        S = self.s.draw((self.s.n, self.s.n))
        return S + S.T

    def components(self, xi: Array) -> Array:
        """The coefficients of an element of the algebra."""
        return np.array([xi[place] for place in self.places], dtype=object)

    def entries(self, v: Array) -> Array:
        """The coordinates of an element of V."""
        i, j = np.triu_indices(self.s.n)
        return v[i, j]

    def move(self, g: Array, v: Array) -> Array:
        """Phi(g) v."""
        return g @ v @ g.T

    def phi(self, xi: Array, v: Array) -> Array:
        """The representation of the algebra."""
        return xi @ v + v @ xi.T

    def inverse(self, g: Array) -> Array:
        """g^-1."""
        return algebra.solve(g, self.one + 0 * g)

    def diamond(self, y: Array, v: Array) -> Array:
        """<y <> v, E> = -<y, phi(E) v>; y are the slopes along the axes of V."""
        return np.array([-(y @ self.entries(self.phi(1 * E, v))) for E in self.units], dtype=object)

    def coadjoint(self, xi: Array, M: Array) -> Array:
        """<ad*_xi M, E> = <M, [xi, E]>."""
        return np.array([M @ self.components(bracket(xi, 1 * E)) for E in self.units], dtype=object)

    def tensor(self, M: Array, P: Array) -> Array:
        """(PB left red) of M_i = <M, E_i> and the coordinates of P."""
        MM = np.array([self.coadjoint(1 * E, M) for E in self.units])
        MP = np.array([-self.entries(self.phi(1 * E, P)) for E in self.units])
        return np.block([[MM, MP], [-MP.T, 0 * (self.entries(P)[:, None] * self.entries(P))]])

    def generic(self) -> Function:
        """A function of a matrix and an element of V, with nothing special about it."""
        s, n = self.s, self.s.n
        K, C, D, F, H = s.draw((n, n)), s.draw((n, n)), s.draw((n, n)), s.draw((n, n)), s.draw((n, n))

        def function(xi: Array, v: Array) -> Any:
            coupled = trace(C @ xi @ v)
            kinetic = (xi * xi * (K * K)).sum(-1).sum(-1) + trace(xi @ D @ xi) / 3
            return kinetic + coupled + coupled * trace(F @ v) / 5 + trace(H @ v @ v) + trace(D @ xi) ** 3 / 7

        return function

    def slopes(self, function: Callable[[Array], Any], directions: list[Array], bit: int = 1) -> Array:
        """Derivatives of function(h E) for each direction E, in the generator h of that bit; jets where others are left."""
        h = generator(bit, 1 + 0 * self.s.scalar())
        return np.array([_part(function(E * h), 1 << bit) for E in directions], dtype=object)


def _part(value: Any, mask: int) -> Any:
    """The coefficient of h as a jet in the first generator."""
    return Jet({0: coefficient(value, mask), 1: coefficient(value, mask | 1)})


def _split(x: Array) -> tuple[Array, Array]:
    """The value and the slope in the first generator."""
    return tuple(np.array([coefficient(v, k) for v in x], dtype=object) for k in (0, 1))  # type: ignore[return-value]


def actions(s: Setting) -> Iterator[Action]:
    """GL(n) for n = 3, and the triangular subgroup."""
    if s.n == 3:
        yield Action(s, lambda i, j: True)
    yield Action(s, lambda i, j: i <= j)


def _plain(s: Setting, x: Array) -> Array:
    return x.astype(np.float64) if s.numbers == "float" else x


def euler_lagrange(a: Action, left: bool) -> Sides:
    """In the chart g = g0 (1 + X) (left) or (1 + X) g0 (right), X(0) = 0, against the Euler-Poincare equations."""
    s, L, v = a.s, a.generic(), a.vector()
    speed, push, t = a.element(), a.element(), generator(0, 1 + 0 * a.s.scalar())

    def charted(X: Array, rate: Array) -> Any:
        back = a.inverse(a.one + X)
        return L(back @ rate if left else rate @ back, a.move(back if left else a.one + X, v))

    along = a.slopes(lambda E: charted(speed * t, speed + push * t + E), a.units)
    across = a.slopes(lambda E: charted(E, speed + 0 * E), a.units)
    xi, turned = speed, push - speed @ speed
    v_rate = -a.phi(xi, v) if left else a.phi(xi, v)
    M = a.slopes(lambda E: L(xi + turned * t + E, v + v_rate * t), a.units)
    force = _split(a.slopes(lambda E: L(xi + 0 * E, v + E), a.axes))[0]
    turn, pull = a.coadjoint(xi, _split(M)[0]), a.diamond(force, v)
    yield (
        _plain(s, _split(along)[1] - _split(across)[0]),
        _plain(s, _split(M)[1] - (turn + pull if left else -turn - pull)),
    )
    if left:
        rates = np.concatenate([turn + pull, a.entries(v_rate)])
        field = np.concatenate([a.components(xi), -force]) @ a.tensor(_split(M)[0], v)
        yield _plain(s, rates), _plain(s, field)


@stated(
    "theorem-2.1-any-group",
    f"{PLACE}: Theorem 2.1 and (EL right Ham red)",
    f"{ON}: Euler-Lagrange in a chart <=> the left and the right Euler-Poincare equations; the left ones are z' = {{H, z}} "
    "by (PB left red)",
    dimensions=(3, 4),
)
def theorem_2_1(s: Setting) -> Sides:
    for a in actions(s):
        yield from euler_lagrange(a, left=True)
        yield from euler_lagrange(a, left=False)


def discrete(a: Action, left: bool) -> Sides:
    """Both Lie derivatives of L(g, h) against (dEL left/right Ham red), and J Pi J^T = Pi' for the map that they define."""
    s, Lambda, w, v = a.s, a.generic(), a.member(), a.vector()
    sign = 1 if left else -1

    def momenta(w: Array, v: Array) -> tuple[Array, Array, Array]:
        """M_k, M_(k+1) and P_(k+1) (or m, a), as jets in the first generator."""
        after = a.slopes(lambda E: Lambda(w @ (a.one + E) if left else (a.one + E) @ w, v), a.units)
        force = a.slopes(lambda E: Lambda(w, v + E), a.axes)
        back = a.inverse(w)
        carried = [w @ E @ back if not left else back @ E @ w for E in a.units]
        M = np.array([after @ a.components(E) for E in carried], dtype=object)  # Ad* of the momentum after
        return M - sign * a.diamond(force, v), after, a.entries(a.move(back if left else w, v))

    t = generator(0, 1 + 0 * s.scalar())
    M, M1, _ = (_split(x)[0] for x in momenta(w + 0 * w * t, v + 0 * v * t))
    g = a.member()  # L(g, h) at h = g w (left) or w g (right)
    fixed = a.move(g, v) if left else a.move(a.inverse(g), v)

    def whole(g: Array, h: Array) -> Any:
        back = a.inverse(g)
        return Lambda(back @ h, a.move(back, fixed)) if left else Lambda(h @ back, a.move(g, fixed))

    h = g @ w if left else w @ g
    move = (lambda g, E: g @ (a.one + E)) if left else (lambda g, E: (a.one + E) @ g)
    yield _plain(s, _split(a.slopes(lambda E: whole(g + 0 * E, move(h, E)), a.units))[0]), _plain(s, M1)
    yield _plain(s, _split(a.slopes(lambda E: whole(move(g, E), h + 0 * E), a.units))[0]), _plain(s, -M)
    old, new = [], []
    for turn, axis in [(E, 0 * v) for E in a.units] + [(0 * w, E) for E in a.axes]:
        before, after, vector = momenta(w + w @ turn * t, v + axis * t)
        old.append(np.concatenate([_split(before)[1], a.entries(axis + 0 * v)]))
        new.append(np.concatenate([_split(after)[1], _split(vector)[1]]))
    J_old, J_new = (_plain(s, np.stack(columns)) for columns in (old, new))
    J = algebra.solve(J_old, J_new).T
    end = a.move(a.inverse(w) if left else w, v)
    yield J @ _plain(s, a.tensor(M, v)) @ J.T, _plain(s, a.tensor(M1, end))


@stated(
    "theorem-3.1-any-group",
    f"{PLACE}: Theorem 3.1 and (dEL right Ham red)",
    f"{ON}: (dEL) <=> the left and the right discrete Euler-Poincare equations of a generic Lambda; the maps are Poisson",
    dimensions=(3,),
)
def theorem_3_1(s: Setting) -> Sides:
    for a in actions(s):
        yield from discrete(a, left=True)
        yield from discrete(a, left=False)


def two_forms(a: Action) -> Sides:
    """The two-form of T*G in (g, M), M = L_g^* Pi, pulled back to G x G by (g_k, M_k) and by (g_(k+1), M_(k+1))."""
    s, whole, g, h = a.s, a.generic(), a.member(), a.member()
    other = a.generic()
    count, t = len(a.units), generator(0, 1 + 0 * s.scalar())

    def L(g: Array, h: Array) -> Any:  # without any invariance
        return whole(g, h) + other(h, g)

    def momenta(g: Array, h: Array) -> tuple[Array, Array]:
        one = a.one
        first = a.slopes(lambda E: L(g @ (one + E), h), a.units)
        return -first, a.slopes(lambda E: L(g, h @ (one + E)), a.units)

    columns: list[tuple[Array, Array]] = []
    for k in range(2 * count):
        E = a.units[k % count] * t
        moved = (g @ (a.one + E), h) if k < count else (g, h @ (a.one + E))
        before, after = momenta(*moved)
        columns.append((_split(before)[1], _split(after)[1]))
    values = [_split(x)[0] for x in momenta(g + 0 * g * t, h)]
    forms = []
    for k in (0, 1):
        places = np.eye(2 * count, dtype=np.int8)[k * count : (k + 1) * count]
        J = np.concatenate([places + 0 * columns[0][0][0], np.stack([c[k] for c in columns]).T])
        MM = np.array([a.coadjoint(1 * E, values[k]) for E in a.units])
        unit = np.eye(count, dtype=np.int8) + 0 * MM
        form = np.block([[-MM, -unit], [unit, 0 * unit]])
        forms.append(_plain(s, J.T @ form @ J))
    yield forms[0], forms[1]


@stated(
    "cotangent-bundle",
    "Section 3, after (dEL syst)",
    f"{ON}: the map (g_k, Pi_k) -> (g_(k+1), Pi_(k+1)) of a generic L(g_k, g_(k+1)) without symmetry conserves the two-form of T*G",
    dimensions=(3,),
)
def cotangent_bundle(s: Setting) -> Sides:
    for a in actions(s):
        yield from two_forms(a)
