"""Sections 2 and 3: Euler-Poincare equations, continuous and discrete, of a generic Lagrangian.

The general theory at G = SO(n), V = R^n, Phi(g) v = g v, with Lagrangians that couple everything to everything; and for
other G and V: GL(n) and its triangular subgroup on symmetric matrices, Phi(g) S = g S g^T.  Neither is compact, the
second is solvable and not unimodular, and phi* is not -phi: signs that SO(n) on R^n cannot tell apart count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import (
    Array,
    act,
    bracket,
    cayley,
    cayley_act,
    coordinates,
    dot,
    identity,
    objects,
    pairing,
    project_out,
    resolvent,
    skew,
    triangle,
    wedge,
)
from kreisel.lab.exact import Jet, coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.statements import Setting, gradient, left_derivative, printed, right_derivative, stated
from kreisel.record.contract import MOVING_SPACE, REST_SPACE


def generic_lagrangian(s: Setting) -> Callable[[Array, Array], Any]:
    """L(xi, v) on so(n) x R^n: kinetic energy, couplings of velocity and vector, a cubic potential."""
    J, B, u, q = s.symmetric(), s.symmetric(), s.vector(), s.vector()

    def lagrangian(xi: Array, v: Array) -> Any:
        kinetic = pairing(xi, J @ xi + xi @ J) / 2
        coupled = dot(v, act(xi, u)) + dot(v, act(xi, q)) ** 2 / 8
        return kinetic + coupled + dot(v, act(B, v)) / 2 + dot(q, v) ** 3 / 6

    return lagrangian


def generic_discrete(s: Setting) -> Callable[[Array, Array], Any]:
    """Lambda(w, v) on SO(n) x R^n."""
    K, B, u, q = s.draw((s.n, s.n)), s.symmetric(), s.vector(), s.vector()

    def discrete(w: Array, v: Array) -> Any:
        turned = dot(v, act(w, u))
        return 3 * (K * w).sum(-1).sum(-1) + turned + turned**2 / 4 + dot(v, act(B, v)) / 2 + dot(q, v) * turned / 3

    return discrete


# -- section 2 --------------------------------------------------------------------------------------


@stated("phi-star", "Section 2, definition of phi*")
def phi_star(s: Setting) -> Sides:
    """<phi*(xi) y, v> = <y, phi(xi) v>; phi* is an anti-representation"""
    xi, eta, y, v = s.skew(), s.skew(), s.vector(), s.vector()
    yield dot(act(-xi, y), v), dot(y, act(xi, v))
    yield act(-bracket(xi, eta), y), act(-eta, act(-xi, y)) - act(-xi, act(-eta, y))


@stated("diamond", "Section 2, definition of the diamond, and section 4")
def diamond(s: Setting) -> Sides:
    """<y <> v, xi> = -<y, phi(xi) v> with y <> v = v ^ y"""
    xi, y, v = s.skew(), s.vector(), s.vector()
    yield pairing(wedge(v, y), xi), -dot(y, act(xi, v))


@stated("ad-star", "Section 2, coadjoint actions")
def ad_star(s: Setting) -> Sides:
    """<ad*_xi M, eta> = <M, [xi, eta]> with ad*_xi M = [M, xi]; Ad*_g M = g^T M g"""
    xi, eta, M, g = s.skew(), s.skew(), s.skew(), s.rotation()
    yield pairing(bracket(M, xi), eta), pairing(M, bracket(xi, eta))
    yield pairing(g.T @ M @ g, eta), pairing(M, g @ eta @ g.T)


@stated("well-defined", "Sections 2 and 3, reduced Lagrangians")
def well_defined(s: Setting) -> Sides:
    """h in G^[p]: (hg, Omega) and (hg, W) have the P of (g, Omega), (g, W); h in G^[A]: (gh, w) has the a of (g, w)"""
    g, g1, v = s.rotation(), s.rotation(), s.vector()
    h = cayley(project_out(s.skew(), v) / dot(v, v))
    yield act(h, v), v
    yield act((h @ g).T, v), act(g.T, v)
    yield (h @ g).T @ (h @ g1), g.T @ g1
    yield act(g @ h, v), act(g, v)
    yield (g1 @ h) @ (g @ h).T, g1 @ g.T


@stated("right-section", "Section 3, right version", "E9")
def right_section(s: Setting) -> Sides:
    """the section is G x O_A: (w, a) fix (g_k, g_(k+1)) up to h in G^[A], (g_k h, g_(k+1) h) = (g, w g) with gA = a (printed g x O_A, E9)"""
    g, g1, A = s.rotation(), s.rotation(), s.vector()
    w, a = g1 @ g.T, act(g, A)
    other = cayley(project_out(s.skew(), a) / dot(a, a)) @ g  # another g with gA = a
    yield act(other, A), a
    h = g.T @ other
    yield act(h, A), A
    yield g1 @ h, w @ other


@printed("right-section")
def right_section_printed(s: Setting) -> Sides:
    g, g1 = s.rotation(), s.rotation()
    w = g1 @ g.T
    yield w + w.T, 0 * w  # in g


# -- section 2, Theorem 2.1: the raw Euler-Lagrange equation in a chart against the reduced one -------


def _charted(lagrangian: Callable[[Array, Array], Any], X: Array, rate: Array, v: Array, left: bool) -> Any:
    """The Lagrangian in the chart g = g0 cay(X) (left) or cay(X) g0 (right), with v = P0 or a0 at X = 0."""
    R = resolvent(X, identity(X.shape[-1]) + 0 * X)
    velocity = 2 * (R.T @ rate @ R if left else R @ rate @ R.T)
    return lagrangian(velocity, cayley_act(-X if left else X, v))


def _units(s: Setting) -> Iterator[Array]:
    """The coordinate directions of so(n)."""
    count = s.n * (s.n - 1) // 2
    for i in range(count):
        unit = 0 * coordinates(s.skew())
        unit[i] = unit[i] + 1
        yield skew(unit, s.n)


def euler_lagrange(s: Setting, left: bool) -> Sides:
    """Raw: d/dt dL/dX' - dL/dX along any curve with X(0) = 0, so xi = 2 X', xi' = 2 X''.  Reduced: twice M' - ..."""
    lagrangian = generic_lagrangian(s)
    speed, push, v = s.skew(), s.skew(), s.vector()
    xi, pushed = 2 * speed, 2 * push
    one = 1 + 0 * s.scalar()
    t, h = generator(0, one), generator(1, one)
    v_rate = -act(xi, v) if left else act(xi, v)
    raw, momentum_rate = [], []
    for unit in _units(s):
        along = _charted(lagrangian, speed * t, speed + push * t + unit * h, v, left)
        across = _charted(lagrangian, unit * h, speed + 0 * unit * h, v, left)
        raw.append(coefficient(along, 0b11) - coefficient(across, 0b10))
        momentum_rate.append(coefficient(lagrangian(xi + pushed * t + unit * h, v + v_rate * t), 0b11))
    M = gradient(lambda x: lagrangian(x, v + 0 * x[0]), xi)
    force = gradient(lambda x: lagrangian(xi + 0 * x[0], x), v)
    turning = bracket(M, xi) if left else bracket(xi, M)
    pull = wedge(v, force) if left else -wedge(v, force)
    yield objects(raw), 2 * (objects(momentum_rate) - coordinates(turning + pull))


@stated("theorem-2.1a", "Section 2, Theorem 2.1 a), (EL left Ham red)")
def theorem_2_1_a(s: Setting) -> Sides:
    """Euler-Lagrange in a chart <=> M' = ad*_Omega M + grad_P L <> P, P' = -phi(Omega) P, for a generic L(Omega, P)"""
    yield from euler_lagrange(s, left=True)


@stated("right-euler-poincare", "Section 2, (EL right Ham red)")
def right_euler_poincare(s: Setting) -> Sides:
    """Euler-Lagrange in a chart <=> m' = -ad*_omega m - grad_a L <> a, a' = phi(omega) a, for a generic L(omega, a)"""
    yield from euler_lagrange(s, left=False)


def _hamiltonian(s: Setting, left: bool) -> Sides:
    lagrangian = generic_lagrangian(s)
    xi, v = s.skew(), s.vector()
    M = gradient(lambda x: lagrangian(x, v + 0 * x[0]), xi)
    force = gradient(lambda x: lagrangian(xi + 0 * x[0], x), v)
    if left:
        rate = bracket(M, xi) + wedge(v, force), -act(xi, v)
    else:
        rate = bracket(xi, M) - wedge(v, force), act(xi, v)
    space = MOVING_SPACE if left else REST_SPACE
    slope = np.concatenate([coordinates(xi), -force])  # grad_M H = Omega, grad_P H = -grad_P L
    yield np.concatenate([coordinates(rate[0]), rate[1]]), slope @ space.tensor(M, v)


@stated("theorem-2.1b", "Section 2, Theorem 2.1 b)", "E14")
def theorem_2_1_b(s: Setting) -> Sides:
    """the reduced equations are z' = {H, z}, H = <M, Omega> - L, for a generic L (E14: not {z, H})"""
    yield from _hamiltonian(s, left=True)
    yield from _hamiltonian(s, left=False)


@printed("theorem-2.1b")
def bracket_turned(s: Setting) -> Sides:
    for rate, field in _hamiltonian(s, left=True):
        yield rate, -field


@stated("legendre", "Section 2, Hamilton function")
def legendre(s: Setting) -> Sides:
    """H = <M, Omega> - L has grad_M H = Omega and grad_P H = -grad_P L"""
    lagrangian = generic_lagrangian(s)
    xi, v, d_xi, d_v = s.skew(), s.vector(), s.skew(), s.vector()
    one = 1 + 0 * s.scalar()
    t, r = generator(0, one), generator(1, one)
    moved = xi + d_xi * t, v + d_v * t
    momentum = [lagrangian(moved[0] + unit * r, moved[1]) for unit in _units(s)]
    M = objects([coefficient(p, 0b10) for p in momentum])
    dM = objects([coefficient(p, 0b11) for p in momentum])
    dH = dM @ coordinates(xi) + M @ coordinates(d_xi) - coefficient(lagrangian(*moved), 0b01)
    force = gradient(lambda x: lagrangian(xi + 0 * x[0], x), v)
    yield dH, dM @ coordinates(xi) - dot(force, d_v)


def in_coordinates(M: Array, P: Array) -> Array:
    """(en LP br 1, 2) as printed, in the coordinates (M_ij, i < j; P_k).

    {M_ij, M_kl} = M_il d_jk - M_kj d_li - M_ik d_jl + M_lj d_ki, {M_ij, P_k} = P_i d_jk - P_j d_ik, {P_i, P_j} = 0.
    """
    n = M.shape[-1]
    i, j = (index[:, None] for index in triangle(n))
    k, l = (index[None, :] for index in triangle(n))  # noqa: E741 - the formula's own letter
    MM = M[i, l] * (j == k) - M[k, j] * (l == i) - M[i, k] * (j == l) + M[l, j] * (k == i)
    k = np.arange(n)[None, :]
    MP = P[i + 0 * k] * (j == k) - P[j + 0 * k] * (i == k)
    PP = 0 * (P[:, None] * P[None, :])
    return np.block([[MM, MP], [-MP.T, PP]])


@stated("lie-poisson", "Section 2, (PB left red) and the remark; section 4, (en LP br 1, 2)")
def lie_poisson_bracket(s: Setting) -> Sides:
    """<M, [X, Y]> + <x, Y P> - <y, X P> = <M, [X, Y]> + <P, phi*(Y) x - phi*(X) y> = the bracket in coordinates"""
    M, P, X, Y, x, y = s.skew(), s.vector(), s.skew(), s.skew(), s.vector(), s.vector()
    value = pairing(M, bracket(X, Y)) + dot(x, act(Y, P)) - dot(y, act(X, P))
    yield in_coordinates(M, P), MOVING_SPACE.tensor(M, P)
    yield value, pairing(M, bracket(X, Y)) + dot(P, act(-Y, x) - act(-X, y))
    yield value, np.concatenate([coordinates(X), x]) @ in_coordinates(M, P) @ np.concatenate([coordinates(Y), y])


# -- section 3, Theorem 3.1 -------------------------------------------------------------------------


def discrete_equations(s: Setting, left: bool) -> Sides:
    """The two Lie derivatives of L(g, h) = Lambda(g^T h, g^T p) (left) or Lambda(h g^T, g A) (right)."""
    discrete, g, h, fixed = generic_discrete(s), s.rotation(), s.rotation(), s.vector()

    def whole(g: Array, h: Array) -> Any:
        return discrete(g.T @ h, act(g.T, fixed)) if left else discrete(h @ g.T, act(g, fixed))

    derivative = right_derivative if left else left_derivative
    w, v = (g.T @ h, act(g.T, fixed)) if left else (h @ g.T, act(g, fixed))
    M1 = derivative(lambda x: discrete(x, v + 0 * x[0]), w)
    force = wedge(v, gradient(lambda x: discrete(w + 0 * x[0], x), v))
    M = w @ M1 @ w.T - force if left else w.T @ M1 @ w + force
    yield derivative(lambda x: whole(g + 0 * x, x), h), M1
    yield derivative(lambda x: whole(x, h + 0 * x), g), -M


@stated("theorem-3.1a", "Section 3, Theorem 3.1 a), (dEL left Ham red), (dEL syst)")
def theorem_3_1_a(s: Setting) -> Sides:
    """(dEL) <=> Ad*_(W_k^-1) M_(k+1) = M_k + grad_P Lambda <> P_k, P_(k+1) = W_k^-1 P_k, M_(k+1) = d'_W Lambda, generic Lambda"""
    yield from discrete_equations(s, left=True)


@stated("right-discrete-euler-poincare", "Section 3, (dEL right Ham red)")
def right_discrete(s: Setting) -> Sides:
    """(dEL) <=> Ad*_(w_k) m_(k+1) = m_k - grad_a Lambda <> a_k, a_(k+1) = w_k a_k, m_(k+1) = d_w Lambda, generic Lambda"""
    yield from discrete_equations(s, left=False)


def implicit_map(s: Setting, left: bool) -> Sides:
    """J Pi J^T = Pi' for z -> z' given by (w, v): both Jacobians in the coordinates of (w, v)."""
    discrete, w, v = generic_discrete(s), s.rotation(), s.vector()
    one = 1 + 0 * s.scalar()
    t, h = generator(0, one), generator(1, one)

    def momenta(w: Array, v: Array) -> tuple[Array, Array]:  # (M_k, M_(k+1)) as jets in t
        after = [
            discrete(w @ (identity(s.n) + unit * h) if left else (identity(s.n) + unit * h) @ w, v) for unit in units
        ]
        force = [discrete(w, v + axis * h) for axis in np.eye(s.n, dtype=np.int8)]
        M1, slope = (_times_h(entries) for entries in (after, force))
        M1 = skew(M1, s.n)
        pull = wedge(v, slope)
        return (w @ M1 @ w.T - pull if left else w.T @ M1 @ w + pull), M1

    def both(w: Array, v: Array) -> tuple[Array, Array]:
        M, M1 = momenta(w, v)
        v1 = act(w.T if left else w, v)
        return np.concatenate([coordinates(M), v]), np.concatenate([coordinates(M1), v1])

    units = list(_units(s))
    old, new, (here, there) = [], [], both(w + 0 * t, v + 0 * t)
    for i in range(len(units) + s.n):
        turn = units[i] * t if i < len(units) else 0 * units[0] * t
        axis = np.eye(s.n, dtype=np.int8)[i - len(units)] if i >= len(units) else np.zeros(s.n, dtype=np.int8)
        before, after = both(w + w @ turn, v + axis * t)
        old.append(coefficient(before, 0b01))
        new.append(coefficient(after, 0b01))
    J_old, J_new = (np.stack(columns).T for columns in (old, new))
    space = MOVING_SPACE if left else REST_SPACE
    count = len(units)
    M, P = skew(coefficient(here, 0)[:count], s.n), coefficient(here, 0)[count:]
    M1, P1 = skew(coefficient(there, 0)[:count], s.n), coefficient(there, 0)[count:]
    if s.numbers == "float":
        J_old, J_new, M, P, M1, P1 = (x.astype(np.float64) for x in (J_old, J_new, M, P, M1, P1))
    J = algebra.solve(J_old.T, J_new.T).T
    yield J @ space.tensor(M, P) @ J.T, space.tensor(M1, P1)


def _times_h(entries: list[Any]) -> Array:
    """The coefficient of h of jets in t and h, as jets in t."""
    return objects([Jet({0: coefficient(e, 0b10), 1: coefficient(e, 0b11)}) for e in entries])


@stated("theorem-3.1b", "Section 3, Theorem 3.1 b)")
def theorem_3_1_b(s: Setting) -> Sides:
    """the map (M_k, P_k) -> (M_(k+1), P_(k+1)) of a generic Lambda(W, P) is Poisson for the bracket of e*(n)"""
    yield from implicit_map(s, left=True)


@stated("right-poisson", "Section 3, after Theorem 3.1")
def right_poisson(s: Setting) -> Sides:
    """the map (m_k, a_k) -> (m_(k+1), a_(k+1)) of a generic Lambda(w, a) is Poisson for the minus bracket"""
    yield from implicit_map(s, left=False)


# -- other groups and representations: elements of g* are their values on a basis; 1 + X is a chart ------

Function = Callable[[Array, Array], Any]


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


def chart_equations(a: Action, left: bool) -> Sides:
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


@stated("theorem-2.1-any-group", "Sections 2 and 3, any G and V: Theorem 2.1 and (EL right Ham red)", dimensions=(3, 4))
def theorem_2_1(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: Euler-Lagrange in a chart <=> the left and the right Euler-Poincare equations; the left ones are z' = {H, z} by (PB left red)"""
    for a in actions(s):
        yield from chart_equations(a, left=True)
        yield from chart_equations(a, left=False)


def discrete_momenta(a: Action, left: bool) -> Sides:
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


@stated("theorem-3.1-any-group", "Sections 2 and 3, any G and V: Theorem 3.1 and (dEL right Ham red)", dimensions=(3,))
def theorem_3_1(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: (dEL) <=> the left and the right discrete Euler-Poincare equations of a generic Lambda; the maps are Poisson"""
    for a in actions(s):
        yield from discrete_momenta(a, left=True)
        yield from discrete_momenta(a, left=False)


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


@stated("cotangent-bundle", "Section 3, after (dEL syst)", dimensions=(3,))
def cotangent_bundle(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: the map (g_k, Pi_k) -> (g_(k+1), Pi_(k+1)) of a generic L(g_k, g_(k+1)) without symmetry conserves the two-form of T*G"""
    for a in actions(s):
        yield from two_forms(a)
