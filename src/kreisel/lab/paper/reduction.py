"""Sections 2 and 3: Euler-Poincare equations, continuous and discrete, of a generic Lagrangian.

The general theory for functions that couple everything to everything, at G = SO(n), V = R^n, Phi(g) v = g v; and for
GL(n) and its triangular subgroup on symmetric matrices, Phi(g) S = g S g^T.  Neither of these is compact, the second is
solvable and not unimodular, and phi* is not -phi: signs that SO(n) on R^n cannot tell apart count.  Elements of g* are
their values on a basis of g.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, act, bracket, coordinates, dot, identity, objects, pairing, triangle, wedge
from kreisel.lab.exact import Jet, coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.setting import Rotation, Setting, Skew, Vector
from kreisel.lab.paper.statements import stated
from kreisel.record.contract import MOVING_SPACE

Function = Callable[[Array, Array], Any]


class Action:
    """SO(n) on vectors, in Cayley's chart, or the matrices with entries at `places` on symmetric ones, in the chart 1 + X.

    `units` and `axes` are bases of the algebra and of V; `charted` are the velocity, `scale` X' at X = 0, and the vector
    in a chart g = g0 c(X) (left) or c(X) g0 (right).
    """

    def __init__(self, s: Setting, places: Sequence[tuple[int, int]] = ()):
        E = identity(s.n * s.n).reshape(s.n, s.n, s.n, s.n)
        self.s, self.orthogonal, self.scale = s, not places, 1 if places else 2
        self.places = places or list(zip(*triangle(s.n), strict=True))
        self.units = [E[i, j] - E[j, i] if self.orthogonal else E[i, j] for i, j in self.places]
        symmetric = [E[i, j] | E[j, i] for i in range(s.n) for j in range(i, s.n)]
        self.axes = list(identity(s.n)) if self.orthogonal else symmetric
        self.identity, self.t = identity(s.n) + 0 * s.draw((s.n, s.n)), generator(0, 1 + 0 * s.scalar())

    def element(self) -> Array:
        return sum(self.s.scalar() * E for E in self.units)

    def member(self) -> Array:
        return self.s.rotation() if self.orthogonal else 3 * self.identity + self.element() / 2

    def vector(self) -> Array:
        return sum(self.s.scalar() * axis for axis in self.axes)

    def generic(self) -> Function:
        """A function of a matrix and a vector, with nothing special about it."""
        K, (C, F, H) = self.s.draw((self.s.n, self.s.n)), (self.s.draw(self.axes[0].shape) for _ in range(3))

        def function(w: Array, v: Array) -> Any:
            coupled, along = (C * (w @ v)).sum(), (F * v).sum()
            potential = (H * v * v).sum() / 2 + along**3 / 6
            return ((3 + w * K) * w * K).sum() + coupled + coupled**2 / 4 + coupled * along / 3 + potential

        return function

    def inverse(self, g: Array) -> Array:
        return g.T if self.orthogonal else algebra.solve(g, self.identity + 0 * g)

    def move(self, g: Array, v: Array) -> Array:
        return act(g, v) if self.orthogonal else g @ v @ g.T

    def phi(self, xi: Array, v: Array) -> Array:
        return act(xi, v) if self.orthogonal else xi @ v + v @ xi.T

    def charted(self, X: Array, rate: Array, v: Array, left: bool) -> tuple[Array, Array]:
        if self.orthogonal:
            R = algebra.resolvent(X, self.identity + 0 * X)
            return 2 * (R.T @ rate @ R if left else R @ rate @ R.T), algebra.cayley_act(-X if left else X, v)
        back = self.inverse(self.identity + X)
        return back @ rate if left else rate @ back, self.move(back if left else self.identity + X, v)

    def components(self, xi: Array) -> Array:
        return objects(xi[place] for place in self.places)

    def entries(self, v: Array) -> Array:
        return v if self.orthogonal else v[np.triu_indices(self.s.n)]

    def diamond(self, y: Array, v: Array) -> Array:
        """<y <> v, E> = -<y, phi(E) v>; y are the slopes along the axes of V."""
        return objects(-(y @ self.entries(self.phi(E, v))) for E in self.units)

    def coadjoint(self, xi: Array, M: Array) -> Array:
        """<ad*_xi M, E> = <M, [xi, E]>."""
        return objects(M @ self.components(bracket(xi, E)) for E in self.units)

    def tensor(self, M: Array, P: Array) -> Array:
        """(PB left red) of M_i = <M, E_i> and the coordinates of P."""
        MM = np.array([self.coadjoint(E, M) for E in self.units])
        MP = np.array([-self.entries(self.phi(E, P)) for E in self.units])
        return self.plain(np.block([[MM, MP], [-MP.T, 0 * (self.entries(P)[:, None] * self.entries(P))]]))

    def slopes(self, function: Callable[[Array], Any], directions: list[Array]) -> Array:
        """The derivatives of function(E) at 0 along each E, as jets in t."""
        h = generator(1, 1 + 0 * self.s.scalar())
        values = [function(E * h) for E in directions]
        return objects(Jet({0: coefficient(v, 0b10), 1: coefficient(v, 0b11)}) for v in values)

    def plain(self, x: Array) -> Array:
        return x.astype(np.float64) if self.s.numbers == "float" else x

    def at_0(self, x: Array) -> Array:
        return self.plain(coefficient(x, 0))

    def rate(self, x: Array) -> Array:
        return self.plain(coefficient(x, 1))


def groups(s: Setting) -> Iterator[Action]:
    """GL(n) for n = 3, and the triangular subgroup."""
    places = [(i, j) for i in range(s.n) for j in range(s.n)]
    if s.n == 3:
        yield Action(s, places)
    yield Action(s, [(i, j) for i, j in places if i <= j])


# -- section 2 --------------------------------------------------------------------------------------


@stated("phi-star", "Section 2, definition of phi*")
def phi_star(xi: Skew, eta: Skew, y: Vector, v: Vector) -> Sides:
    """<phi*(xi) y, v> = <y, phi(xi) v>; phi* is an anti-representation"""
    yield dot(act(-xi, y), v), dot(y, act(xi, v))
    yield act(-bracket(xi, eta), y), act(-eta, act(-xi, y)) - act(-xi, act(-eta, y))


@stated("diamond", "Section 2, definition of the diamond, and section 4")
def diamond(xi: Skew, y: Vector, v: Vector) -> Sides:
    """<y <> v, xi> = -<y, phi(xi) v> with y <> v = v ^ y"""
    yield pairing(wedge(v, y), xi), -dot(y, act(xi, v))


@stated("ad-star", "Section 2, coadjoint actions")
def ad_star(xi: Skew, eta: Skew, M: Skew, g: Rotation) -> Sides:
    """<ad*_xi M, eta> = <M, [xi, eta]> with ad*_xi M = [M, xi]; Ad*_g M = g^T M g"""
    yield pairing(bracket(M, xi), eta), pairing(M, bracket(xi, eta))
    yield pairing(g.T @ M @ g, eta), pairing(M, g @ eta @ g.T)


@stated("well-defined", "Sections 2 and 3, reduced Lagrangians")
def well_defined(g: Rotation, g1: Rotation, v: Vector, xi: Skew) -> Sides:
    """h in G^[p]: (hg, Omega) and (hg, W) have the P of (g, Omega), (g, W); h in G^[A]: (gh, w) has the a of (g, w)"""
    h = algebra.cayley(algebra.project_out(xi, v) / dot(v, v))
    yield act(h, v), v
    yield act((h @ g).T, v), act(g.T, v)
    yield (h @ g).T @ (h @ g1), g.T @ g1
    yield act(g @ h, v), act(g, v)
    yield (g1 @ h) @ (g @ h).T, g1 @ g.T


@stated("right-section", "Section 3, right version", printed={"in_algebra": True})
def right_section(g: Rotation, g1: Rotation, A: Vector, xi: Skew, in_algebra: bool = False) -> Sides:
    """the section is G x O_A: (w, a) fix (g_k, g_(k+1)) up to h in G^[A], (g_k h, g_(k+1) h) = (g, w g) with gA = a (printed g x O_A, E9)"""
    w, a = g1 @ g.T, act(g, A)
    second = algebra.cayley(algebra.project_out(xi, a) / dot(a, a)) @ g  # another g with gA = a
    yield act(second, A), a
    h = g.T @ second
    yield act(h, A), A
    yield g1 @ h, w @ second
    yield (w + w.T, 0 * w) if in_algebra else (w.T, algebra.solve(w, identity(len(w)) + 0 * w))


# -- Theorem 2.1: the Euler-Lagrange equation in a chart, at X(0) = 0, against the reduced one --------


def reduced(a: Action, left: bool) -> list[tuple[Array, Array]]:
    """Both sides in the chart; the rate of the vector; and the equations against the field of H, grad_M H = Omega."""
    L, v, speed, push = a.generic(), a.vector(), a.element(), a.element()
    along = a.slopes(lambda E: L(*a.charted(speed * a.t, speed + push * a.t + E, v, left)), a.units)
    across = a.slopes(lambda E: L(*a.charted(E, speed + 0 * E, v, left)), a.units)
    velocity, moved = a.charted(speed * a.t, speed + push * a.t, v, left)
    M = a.slopes(lambda E: L(velocity + E, moved), a.units)
    xi, sign = a.at_0(velocity), 1 if left else -1
    force = a.at_0(a.slopes(lambda E: L(xi + 0 * E, v + E), a.axes))
    turning = sign * a.plain(a.coadjoint(xi, a.at_0(M)) + a.diamond(force, v))
    v_rate = -sign * a.phi(xi, v)
    field = sign * (np.concatenate([a.components(xi), -force]) @ a.tensor(a.at_0(M), v))  # grad_P H = -grad_P L
    return [
        (a.rate(along) - a.at_0(across), a.scale * (a.rate(M) - turning)),
        (a.rate(moved), v_rate),
        (np.concatenate([turning, a.entries(v_rate)]), a.plain(field)),
    ]


@stated("theorem-2.1a", "Section 2, Theorem 2.1 a), (EL left Ham red)")
def theorem_2_1_a(s: Setting) -> Sides:
    """Euler-Lagrange in a chart <=> M' = ad*_Omega M + grad_P L <> P, P' = -phi(Omega) P, for a generic L(Omega, P)"""
    yield from reduced(Action(s), left=True)[:2]


@stated("right-euler-poincare", "Section 2, (EL right Ham red)")
def right_euler_poincare(s: Setting) -> Sides:
    """Euler-Lagrange in a chart <=> m' = -ad*_omega m - grad_a L <> a, a' = phi(omega) a, for a generic L(omega, a)"""
    yield from reduced(Action(s), left=False)[:2]


@stated("theorem-2.1b", "Section 2, Theorem 2.1 b)", printed={"sign": -1})
def theorem_2_1_b(s: Setting, sign: int = 1) -> Sides:
    """the reduced equations are z' = {H, z}, H = <M, Omega> - L, for a generic L (E14: not {z, H})"""
    for left in (True, False):
        rates, field = reduced(Action(s), left)[2]
        yield rates, sign * field


@stated("legendre", "Section 2, Hamilton function")
def legendre(s: Setting, xi: Skew, v: Vector, d_xi: Skew, d_v: Vector) -> Sides:
    """H = <M, Omega> - L has grad_M H = Omega and grad_P H = -grad_P L"""
    a = Action(s)
    lagrangian, moved = a.generic(), (xi + d_xi * a.t, v + d_v * a.t)
    M = a.slopes(lambda E: lagrangian(moved[0] + E, moved[1]), a.units)
    force = a.at_0(a.slopes(lambda E: lagrangian(xi + 0 * E, v + E), a.axes))
    dH = a.rate(M) @ coordinates(xi) + a.at_0(M) @ coordinates(d_xi) - coefficient(lagrangian(*moved), 1)
    yield dH, a.rate(M) @ coordinates(xi) - dot(force, d_v)


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
    return np.block([[MM, MP], [-MP.T, 0 * (P[:, None] * P[None, :])]])


@stated("lie-poisson", "Section 2, (PB left red) and the remark; section 4, (en LP br 1, 2)")
def lie_poisson_bracket(s: Setting, M: Skew, P: Vector, X: Skew, Y: Skew, x: Vector, y: Vector) -> Sides:
    """<M, [X, Y]> + <x, Y P> - <y, X P> = <M, [X, Y]> + <P, phi*(Y) x - phi*(X) y> = the bracket in coordinates"""
    value = pairing(M, bracket(X, Y)) + dot(x, act(Y, P)) - dot(y, act(X, P))
    yield in_coordinates(M, P), MOVING_SPACE.tensor(M, P)
    yield in_coordinates(M, P), Action(s).tensor(coordinates(M), P)
    yield value, pairing(M, bracket(X, Y)) + dot(P, act(-Y, x) - act(-X, y))
    yield value, np.concatenate([coordinates(X), x]) @ in_coordinates(M, P) @ np.concatenate([coordinates(Y), y])


# -- section 3, Theorem 3.1 -------------------------------------------------------------------------


def momenta(a: Action, Lambda: Function, w: Array, v: Array, left: bool) -> tuple[Array, Array, Array]:
    """M_k, M_(k+1) = d'_W Lambda and P_(k+1) (right: m_k, m_(k+1) = d_w Lambda and a_(k+1)), as jets in t."""
    after = a.slopes(lambda E: Lambda(w @ (a.identity + E) if left else (a.identity + E) @ w, v), a.units)
    force = a.slopes(lambda E: Lambda(w, v + E), a.axes)
    back = a.inverse(w)
    M = objects(after @ a.components(back @ E @ w if left else w @ E @ back) for E in a.units)  # Ad* of M_(k+1)
    return M - (1 if left else -1) * a.diamond(force, v), after, a.entries(a.move(back if left else w, v))


def discrete_equations(a: Action, left: bool) -> Sides:
    """The two Lie derivatives of L(g, h) = Lambda(g^-1 h, Phi(g^-1) p) (left) or Lambda(h g^-1, Phi(g) A) (right)."""
    Lambda, w, v, g = a.generic(), a.member(), a.vector(), a.member()
    fixed, h = (a.move(g, v), g @ w) if left else (a.move(a.inverse(g), v), w @ g)

    def lagrangian(g: Array, h: Array) -> Any:
        back = a.inverse(g)
        return Lambda(back @ h, a.move(back, fixed)) if left else Lambda(h @ back, a.move(g, fixed))

    def near(g: Array, E: Array) -> Array:
        return g @ (a.identity + E) if left else (a.identity + E) @ g

    # orthogonal to the first order only, so that the inverse of a rotation near g is its transpose
    M, M1, _ = momenta(a, Lambda, w + 0 * w * a.t, v + 0 * v * a.t, left)
    yield a.at_0(a.slopes(lambda E: lagrangian(g + 0 * E, near(h, E)), a.units)), a.at_0(M1)
    yield a.at_0(a.slopes(lambda E: lagrangian(near(g, E), h + 0 * E), a.units)), -a.at_0(M)


def implicit_map(a: Action, left: bool) -> Sides:
    """J Pi J^T = Pi' for z -> z' given by (w, v): both Jacobians in the coordinates of (w, v)."""
    Lambda, w, v = a.generic(), a.member(), a.vector()
    M, M1, end = (a.at_0(x) for x in momenta(a, Lambda, w + 0 * w * a.t, v + 0 * v * a.t, left))
    old, new = [], []
    for turn, axis in [(E, 0 * v) for E in a.units] + [(0 * w, E) for E in a.axes]:
        before, after, vector = momenta(a, Lambda, w + w @ turn * a.t, v + axis * a.t, left)
        old.append(np.concatenate([a.rate(before), a.entries(axis + 0 * v)]))
        new.append(np.concatenate([a.rate(after), a.rate(vector)]))
    J = algebra.solve(a.plain(np.stack(old)), a.plain(np.stack(new))).T
    moved = a.move(a.inverse(w) if left else w, v)
    yield end, a.entries(moved)
    yield J @ a.tensor(M, v) @ J.T, a.tensor(M1, moved)


@stated("theorem-3.1a", "Section 3, Theorem 3.1 a), (dEL left Ham red), (dEL syst)")
def theorem_3_1_a(s: Setting) -> Sides:
    """(dEL) <=> Ad*_(W_k^-1) M_(k+1) = M_k + grad_P Lambda <> P_k, P_(k+1) = W_k^-1 P_k, M_(k+1) = d'_W Lambda, generic Lambda"""
    yield from discrete_equations(Action(s), left=True)


@stated("right-discrete-euler-poincare", "Section 3, (dEL right Ham red)")
def right_discrete(s: Setting) -> Sides:
    """(dEL) <=> Ad*_(w_k) m_(k+1) = m_k - grad_a Lambda <> a_k, a_(k+1) = w_k a_k, m_(k+1) = d_w Lambda, generic Lambda"""
    yield from discrete_equations(Action(s), left=False)


@stated("theorem-3.1b", "Section 3, Theorem 3.1 b)")
def theorem_3_1_b(s: Setting) -> Sides:
    """the map (M_k, P_k) -> (M_(k+1), P_(k+1)) of a generic Lambda(W, P) is Poisson for the bracket of e*(n)"""
    yield from implicit_map(Action(s), left=True)


@stated("right-poisson", "Section 3, after Theorem 3.1")
def right_poisson(s: Setting) -> Sides:
    """the map (m_k, a_k) -> (m_(k+1), a_(k+1)) of a generic Lambda(w, a) is Poisson for the minus bracket"""
    yield from implicit_map(Action(s), left=False)


# -- other groups and representations ---------------------------------------------------------------


@stated("theorem-2.1-any-group", "Sections 2 and 3, any G and V: Theorem 2.1 and (EL right Ham red)", dimensions=(3, 4))
def theorem_2_1(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: Euler-Lagrange in a chart <=> the left and the right Euler-Poincare equations; the left ones are z' = {H, z} by (PB left red)"""
    for a in groups(s):
        for left in (True, False):
            yield from reduced(a, left)


@stated("theorem-3.1-any-group", "Sections 2 and 3, any G and V: Theorem 3.1 and (dEL right Ham red)", dimensions=(3,))
def theorem_3_1(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: (dEL) <=> the left and the right discrete Euler-Poincare equations of a generic Lambda; the maps are Poisson"""
    for a in groups(s):
        for left in (True, False):
            yield from discrete_equations(a, left)
            yield from implicit_map(a, left)


def two_forms(a: Action) -> Iterator[Array]:
    """The two-form of T*G in (g, M), M = L_g^* Pi, pulled back to G x G by (g_k, M_k) and by (g_(k+1), M_(k+1))."""
    forward, backward, g, h = a.generic(), a.generic(), a.member(), a.member()
    eye, count = a.identity, len(a.units)

    def L(g: Array, h: Array) -> Any:  # without any invariance
        return forward(g, h) + backward(h, g)

    def ends(g: Array, h: Array) -> tuple[Array, Array]:
        first = a.slopes(lambda E: L(g @ (eye + E), h), a.units)
        return -first, a.slopes(lambda E: L(g, h @ (eye + E)), a.units)

    moved = [(g @ (eye + E * a.t), h) for E in a.units] + [(g, h @ (eye + E * a.t)) for E in a.units]
    columns, values = [ends(*places) for places in moved], ends(g + 0 * g * a.t, h)
    for k in (0, 1):
        places = np.eye(2 * count, dtype=np.int8)[k * count : (k + 1) * count]
        J = np.concatenate([places, np.stack([a.rate(c[k]) for c in columns]).T])
        MM = np.array([a.coadjoint(E, a.at_0(values[k])) for E in a.units])
        unit = identity(count) + 0 * MM
        yield J.T @ a.plain(np.block([[-MM, -unit], [unit, 0 * unit]])) @ J


@stated("cotangent-bundle", "Section 3, after (dEL syst)", dimensions=(3,))
def cotangent_bundle(s: Setting) -> Sides:
    """G = GL(n) and upper triangular matrices, V = symmetric matrices: the map (g_k, Pi_k) -> (g_(k+1), Pi_(k+1)) of a generic L(g_k, g_(k+1)) without symmetry conserves the two-form of T*G"""
    for a in groups(s):
        before, after = two_forms(a)
        yield before, after
