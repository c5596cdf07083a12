"""Euler-Poincare equations of any Lagrangian on any matrix group with any representation, left and right.

Moving frame (left), L(Omega, P):   M' = ad*_Omega M + grad_P L <> P,    P' = -phi(Omega) P,   M = grad_Omega L
Rest frame (right), L(omega, a):    m' = -ad*_omega m - grad_a L <> a,   a' = phi(omega) a,    m = grad_omega L
Legendre transform:                 H = <M, Omega> - L,  F' = {H, F},  plus bracket (moving), minus (rest)

States are coordinates M (d,), P (q,); x (d,) are coordinates of Omega.
[Suris 2001, (EL left Ham red), (EL right Ham red)]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kreisel.algebra import Array
from kreisel.record.contract import Frame
from kreisel.reduction import linear, newton
from kreisel.reduction.double import jax
from kreisel.reduction.representations import Representation

jnp = jax.numpy
Lagrangian = Callable[..., Any]  # (Omega, P) or (W, P): an algebra element or a group element, and a point of V


@dataclass(frozen=True, eq=False)
class Continuous:
    """A reduced Lagrangian `lagrangian(Omega, P)`, as the user writes it, and what follows from it."""

    lagrangian: Lagrangian
    rep: Representation
    frame: Frame

    def value(self, x: Array, P: Array) -> Array:
        """The Lagrangian in coordinates."""
        return self.lagrangian(self.rep.group.matrix(x), self.rep.space.array(P))

    def momentum(self, x: Array, P: Array) -> Array:
        """M = grad_Omega L, the Legendre transform."""
        return jax.grad(self.value)(x, P)

    def velocity(self, M: Array, P: Array) -> Array:
        """The x of Omega with grad_Omega L(Omega, P) = M, on the branch of Omega = 0; NaN where there is none."""

        def off(x: Array, known: tuple[Array, Array]) -> Array:
            M, P = known
            return self.momentum(x, P) - M

        return newton.find_root(off, self.rep.group.dim, (M, P))

    def energy(self, M: Array, P: Array) -> Array:
        """H = <M, Omega> - L."""
        x = self.velocity(M, P)
        return M @ x - self.value(x, P)

    def flow(self, M: Array, P: Array) -> tuple[Array, Array]:
        """The left or right Euler-Poincare equations in (M, P)."""
        x = self.velocity(M, P)
        sign = 1 if self.frame is Frame.MOVING else -1
        force = self.rep.diamond(jax.grad(self.value, 1)(x, P), P)
        return sign * (self.rep.group.ad_star(x, M) + force), -sign * self.rep.rate(x, P)

    def acceleration(self, x: Array, P: Array) -> tuple[Array, Array]:
        """The same equations in (Omega, P): grad^2_Omega L Omega' = M' - (grad_P grad_Omega L) P'."""
        M = self.momentum(x, P)
        sign = 1 if self.frame is Frame.MOVING else -1
        force = self.rep.diamond(jax.grad(self.value, 1)(x, P), P)
        dM, dP = sign * (self.rep.group.ad_star(x, M) + force), -sign * self.rep.rate(x, P)
        inertia, coupling = jax.jacfwd(self.momentum, (0, 1))(x, P)
        return linear.inverse(inertia) @ (dM - coupling @ dP), dP
