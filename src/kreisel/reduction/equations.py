"""Euler-Poincare equations of any Lagrangian on any matrix group with any representation, left and right.

Moving frame (left), L(Omega, P):   M' = ad*_Omega M + grad_P L <> P,    P' = -phi(Omega) P,   M = grad_Omega L
Rest frame (right), L(omega, a):    m' = -ad*_omega m - grad_a L <> a,   a' = phi(omega) a,    m = grad_omega L
Legendre transform:                 H = <M, Omega> - L,  F' = {H, F},  plus bracket (moving), minus (rest)

States are coordinates M (d,), P (q,); x (d,) are coordinates of Omega.
[Suris 2001, (EL left Ham red), (EL right Ham red)]

Discrete equations.  Moving frame (left), W_k = g_k^-1 g_(k+1), P_k = Phi(g_k^-1) p, Lambda(W_k, P_k):

    Ad*_(W_k^-1) M_(k+1) = M_k + grad_P Lambda <> P_k,   P_(k+1) = Phi(W_k^-1) P_k,   M_(k+1) = d'_W Lambda

Rest frame (right), w_k = g_(k+1) g_k^-1, a_k = Phi(g_k) A, Lambda(w_k, a_k):

    Ad*_(w_k) m_(k+1) = m_k - grad_a Lambda <> a_k,      a_(k+1) = Phi(w_k) a_k,      m_(k+1) = d_w Lambda

with <df(g), eta> = d/ds f(exp(s eta) g) and <d'f(g), eta> = d/ds f(g exp(s eta)) at s = 0.  As Ad*_(W^-1) d' = d, the
first equation is d_W Lambda = M_k + grad_P Lambda <> P_k (left), d'_w Lambda = m_k - grad_a Lambda <> a_k (right): an
implicit equation for W = retract(x), solved by Newton's method from W = I.  [Suris 2001, section 3]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.record.contract import Frame
from kreisel.reduction import numerics
from kreisel.reduction.groups import Group, Representation, random_element
from kreisel.reduction.numerics import double, jax

jnp = jax.numpy
INVARIANT = 1e-8
Lagrangian = Callable[..., Any]  # (Omega, P) or (W, P): an algebra element or a group element, and a point of V


def as_frame(frame: str | Frame) -> Frame:
    """The frame of this name.  Raises `InputError`."""
    try:
        return Frame(frame)
    except ValueError:
        raise InputError(f"frame must be 'moving' (M, P) or 'rest' (m, a), got {shown(frame)}.") from None


@dataclass(frozen=True, eq=False)
class Continuous:
    """A reduced Lagrangian `lagrangian(Omega, P)`, as the user writes it, and the equations that follow from it."""

    lagrangian: Lagrangian
    rep: Representation
    frame: str | Frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", as_frame(self.frame))

    def value(self, x: Array, P: Array) -> Array:
        """The Lagrangian in coordinates."""
        return self.lagrangian(self.rep.group.matrix(x), self.rep.space.array(P))

    def momentum(self, x: Array, P: Array) -> Array:
        """M = grad_Omega L, the Legendre transform."""
        return jax.grad(self.value)(x, P)

    def velocity(self, M: Array, P: Array) -> Array:
        """The x of Omega with grad_Omega L(Omega, P) = M, on the branch of Omega = 0; NaN if there is none."""
        return numerics.find_root(lambda x, M, P: self.momentum(x, P) - M, self.rep.group.dim, M, P)

    def energy(self, M: Array, P: Array) -> Array:
        """H = <M, Omega> - L."""
        x = self.velocity(M, P)
        return M @ x - self.value(x, P)

    def flow(self, M: Array, P: Array, x: Array | None = None) -> tuple[Array, Array]:
        """The left or right Euler-Poincare equations in (M, P); x of Omega if it is known."""
        x = self.velocity(M, P) if x is None else x
        sign = 1 if self.frame is Frame.MOVING else -1
        force = self.rep.diamond(jax.grad(self.value, 1)(x, P), P)
        return sign * (self.rep.group.ad_star(x, M) + force), -sign * self.rep.rate(x, P)

    def acceleration(self, x: Array, P: Array) -> tuple[Array, Array]:
        """The equations in (Omega, P): grad^2_Omega L Omega' = M' - (grad_P grad_Omega L) P'."""
        dM, dP = self.flow(self.momentum(x, P), P, x)
        inertia, coupling = jax.jacfwd(self.momentum, (0, 1))(x, P)
        return numerics.inverse(inertia) @ (dM - coupling @ dP), dP


# -- discrete equations ----------------------------------------------------------------------------


def left_derivative(f: Callable[[Array], Array], g: Array, group: Group) -> Array:
    """Df: <df(g), eta> = d/ds f(exp(s eta) g)."""
    return jax.grad(lambda x: f(g + group.matrix(x) @ g))(jnp.zeros(group.dim))


def right_derivative(f: Callable[[Array], Array], g: Array, group: Group) -> Array:
    """d'f: <d'f(g), eta> = d/ds f(g exp(s eta))."""
    return jax.grad(lambda x: f(g + g @ group.matrix(x)))(jnp.zeros(group.dim))


@dataclass(frozen=True, eq=False)
class Discrete:
    """A reduced discrete Lagrangian `lagrangian(W, P)`, as the user writes it, and the map that follows from it."""

    lagrangian: Lagrangian
    rep: Representation
    frame: str | Frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", as_frame(self.frame))

    @property
    def _left(self) -> bool:
        return self.frame is Frame.MOVING

    def value(self, W: Array, P: Array) -> Array:
        """The Lagrangian with P in coordinates."""
        return self.lagrangian(W, self.rep.space.array(P))

    def before(self, W: Array, P: Array) -> Array:
        """The momentum that belongs to (W_k, P_k) before the step.

        M_k = d_W Lambda - grad_P Lambda <> P_k (left), m_k = d'_w Lambda + grad_a Lambda <> a_k (right).  As
        -<grad_P Lambda <> P, eta> = <grad_P Lambda, phi(eta) P>, this is one derivative, along
        (W + eta W, P + phi(eta) P) or (w + w eta, a - phi(eta) a).
        """
        matrix, rate = self.rep.group.matrix, self.rep.rate

        def varied(x: Array) -> Array:
            if self._left:
                return self.value(W + matrix(x) @ W, P + rate(x, P))
            return self.value(W + W @ matrix(x), P - rate(x, P))

        return jax.grad(varied)(jnp.zeros(self.rep.group.dim))

    def after(self, W: Array, P: Array) -> Array:
        """The momentum after the step, M_(k+1) = d'_W Lambda (left) or d_w Lambda (right)."""
        derivative = right_derivative if self._left else left_derivative
        return derivative(lambda W: self.value(W, P), W, self.rep.group)

    def carried(self, W: Array, P: Array) -> Array:
        """P_(k+1) = Phi(W^-1) P_k (left) or a_(k+1) = Phi(w) a_k (right)."""
        return self.rep.act(self.rep.group.inverse(W) if self._left else W, P)

    def brought(self, W: Array, P: Array) -> Array:
        """P_k from P_(k+1)."""
        return self.rep.act(W if self._left else self.rep.group.inverse(W), P)

    def turn(self, M: Array, P: Array) -> Array:
        """W_k from (M_k, P_k); NaN beyond the end of the branch with the continuous limit."""
        return self.rep.group.solved(lambda W, M, P: self.before(W, P) - M, M, P)

    def step(self, M: Array, P: Array) -> tuple[Array, Array]:
        """(M_k, P_k) -> (M_(k+1), P_(k+1))."""
        W = self.turn(M, P)
        return self.after(W, P), self.carried(W, P)

    def turn_back(self, M: Array, P: Array) -> Array:
        """W_k from (M_(k+1), P_(k+1))."""
        return self.rep.group.solved(lambda W, M, P: self.after(W, self.brought(W, P)) - M, M, P)

    def inverse(self, M: Array, P: Array) -> tuple[Array, Array]:
        """(M_(k+1), P_(k+1)) -> (M_k, P_k)."""
        W = self.turn_back(M, P)
        old = self.brought(W, P)
        return self.before(W, old), old

    def reconstruct(self, g: Array, W: Array) -> Array:
        """g_(k+1) = g_k W_k (left) or w_k g_k (right)."""
        return g @ W if self._left else W @ g


def symmetric_rule(continuous: Continuous, eps: Array) -> Discrete:
    """The default discretization of a continuous Lagrangian: second order and self-adjoint.

    Lambda(W, P) = eps/2 (L(Omega, P) + L(Omega, P')), eps Omega = retract^-1(W), P' = Phi(W^-1) P (moving frame) or
    a' = Phi(w) a (rest frame).  For L = T(Omega) - V(P) and W = cay(eps Omega/2) it is
    eps T(Omega) - eps/2 (V(P_k) + V(P_(k+1))).
    """
    rep = continuous.rep
    side = Discrete(continuous.lagrangian, rep, continuous.frame)

    def rule(W: Array, shown: Array) -> Array:
        P = rep.space.coordinates(shown)
        x = rep.group.unretract(W) / eps
        return eps / 2 * (continuous.value(x, P) + continuous.value(x, side.carried(W, P)))

    return Discrete(rule, rep, continuous.frame)


@dataclass(frozen=True, eq=False)
class Unreduced:
    """A Lagrangian LL(g, h) on G x G and its discrete Euler-Lagrange equation.

    D1 LL(g_k, g_(k+1)) + D2 LL(g_(k-1), g_k) = 0.
    """

    lagrangian: Callable[[Array, Array], Any]
    group: Group

    def defect(self, before: Array, g: Array, after: Array) -> Array:
        """The left side of the equation, in g* by left translation (derivatives d')."""
        return right_derivative(lambda x: self.lagrangian(x, after), g, self.group) + self.momentum(before, g)

    def momentum(self, before: Array, g: Array) -> Array:
        """M_k = d'_2 LL(g_(k-1), g_k); in the rest frame m_k = d_2 LL = Ad*_(g_k^-1) M_k."""
        return right_derivative(lambda x: self.lagrangian(before, x), g, self.group)

    def turn(self, M: Array, g: Array) -> Array:
        """W with -d'_1 LL(g, g W) = M."""

        def off(W: Array, M: Array, g: Array) -> Array:
            return -right_derivative(lambda y: self.lagrangian(y, g @ W), g, self.group) - M

        return self.group.solved(off, M, g)

    def step(self, before: Array, g: Array) -> tuple[Array, Array]:
        """(g_(k-1), g_k) -> (g_k, g_(k+1)), on the branch with the continuous limit."""
        return g, g @ self.turn(self.momentum(before, g), g)


@explained
def reduce(
    lagrangian: Callable[[Array, Array, Array], Any], rep: Representation, frame: str | Frame, seed: int = 0
) -> Lagrangian:
    """Lambda(W, P) = LL(I, W, P) of LL(g, h, p), or Lambda(w, a) = LL(I, w, a) of LL(g, h, A); p, A are constants of V.

    LL must be invariant: LL(k g, k h, Phi(k) p) = LL(g, h, p) (moving frame), LL(g k, h k, Phi(k^-1) A) = LL(g, h, A)
    (rest frame); for k in the isotropy group of p or A that is the paper's condition on LL with p or A fixed.
    Raises `InputError` if it does not hold at random elements.
    """
    group, left = rep.group, as_frame(frame) is Frame.MOVING
    rng = np.random.default_rng(seed)
    with double():
        g, h, k = (jnp.asarray(random_element(group, rng)) for _ in range(3))
        v = jnp.asarray(rng.uniform(-1, 1, rep.dim))
        isotropic = rep.isotropy(np.asarray(v))
        isotropic = rng.uniform(-1, 1, len(isotropic)) @ isotropic

        def moved(k: Array) -> float:
            u = rep.act(k if left else group.inverse(k), v)
            pair = (k @ g, k @ h) if left else (g @ k, h @ k)
            return float(lagrangian(*pair, rep.space.array(u)))

        try:
            value = moved(jnp.eye(group.size))
        except (TypeError, ValueError) as error:
            raise InputError(f"LL(g, h, p) must accept two group elements and a point of V: {error}") from error
        off_isotropy = abs(moved(group.retract(jnp.asarray(isotropic))) - value)
        off = abs(moved(k) - value)
    letter, group_letter = ("p", "G^[p]") if left else ("A", "G^[A]")
    side = "left" if left else "right"
    if off_isotropy > INVARIANT * (1 + abs(value)):
        raise InputError(
            f"The Lagrangian LL(g, h) must be invariant under {side} translations by the isotropy group {group_letter} "
            f"of {letter}; at a random element it changes by {off_isotropy:.3g}. Usual cause: the other frame is "
            "meant, or a second constant vector; put both into one representation."
        )
    if off > INVARIANT * (1 + abs(value)):
        raise InputError(
            f"The Lagrangian LL(g, h, {letter}) must not change when g, h and {letter} are moved together by a group "
            f"element; it changes by {off:.3g}. Usual cause: {letter} is not the third argument but written into LL."
        )
    unit = jnp.eye(group.size)
    return lambda W, P: lagrangian(unit.astype(W.dtype), W, P)
