"""method="variational": the variational Lie-Poisson integrator of H = T(M) + V(vector), and its compositions.

In the moving frame, with W_k = g_k^T g_(k+1) = cay(X), X = (h/2) Omega, and T~(Omega) the kinetic energy, the
discrete Lagrangian is

    L(g_k, g_(k+1)) = h T~(Omega) - (h/2) (V(P_k) + V(P_(k+1))).

Its map is half a kick by V, a free step, half a kick.  With d'_W X: delta X = (I + X) eta (I - X) / 2, the free step
needs N = dT~/dOmega from

    M = (I + X) N (I - X),   X = (h/2) I^-1 N,   and then   M' = W^T M W = (I - X) N (I + X),   P' = W^T P.

The rest frame has -X for X.  The map is symmetric, of order 2, Poisson for the bracket of the system, and keeps
Casimirs and the momenta of symmetries (Noether), since T, V and the discrete Lagrangian share them; the energy
oscillates by O(h^2).  [Marsden, Pekarsky, Shkoller, Discrete Euler-Poincare and Lie-Poisson equations,
Nonlinearity 12 (1999); Suris 2001, sections 2 and 3]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.iteration import repeat
from kreisel.method.composition import DEFECT, composed
from kreisel.method.scheme import Guard, Scheme, State, observer, turned as rotated
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model

NEWTON_STEPS = 4
NEWTON_LIMIT = 1e-8  # of the last correction of X: the error is of the order of its square
MOST_SWEEPS = 100
SWEEP_LIMIT = 1e-15

Linear = Callable[[Array], Array]
Constants = Mapping[str, Array]


def variational(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The variational integrator with step dt, of order 2, or composed to order 4, 6 or 8.

    The implicit equation is solved in every stage; its largest last correction, an angle squared, is carried
    along as the component "defect" and guarded.
    """
    energy = f"Hamiltonian H, not conserved: it oscillates by O(dt^{order}), without a trend"
    watched = observer(model, oriented, conserved=("casimir", "noether"), meanings={"energy": energy})

    def taken(state: State, turned: State, eps: Array, constants: Constants) -> tuple[State, State, list[Array]]:
        state, turned, defect = stage(model.system, state, eps, constants, turned)
        return state, turned, [defect]

    guard = Guard(
        "The implicit equation of the variational step was not solved to round-off",
        "a step in which the body rotates too far, or a singular kinetic energy. Use a smaller dt.",
        DEFECT,
        (NEWTON_LIMIT if model.n == 3 else SWEEP_LIMIT) ** 2,
    )
    return composed("variational", model, dt, order, oriented, taken, watched, guard)


def stage(
    system: System, state: State, eps: Array, constants: Constants, turned: State = ()
) -> tuple[State, State, Array]:
    """The symmetric step of order 2: the new state, the orientations `turned` along, and the defect."""
    state = kick(system, state, eps / 2, constants)
    X, defect = half_turn(system, state, eps, constants)
    if turned and system.spin is not None:  # which does not change the carried vectors
        spin = eps / 2 * call(system.spin, state, constants)
        turned = tuple(rotated(system.frame, spin, g) for g in turned)
    turned = tuple(rotated(system.frame, system.space.sign * X, g) for g in turned)
    return kick(system, coadjoint(system, X, state), eps / 2, constants), turned, defect


def kick(system: System, state: State, time: Array, constants: Constants) -> State:
    """The flow of V: the momenta grow at the rate that they have at rest, carried vectors are constant."""
    carried = system.space.carried
    if not carried:
        return state
    still = tuple(z if i in carried else 0 * z for i, z in enumerate(state))
    rate = call(system.flow, still, constants)
    return tuple(z if i in carried else z + time * rate[i] for i, z in enumerate(state))


def coadjoint(system: System, X: Array, state: State) -> State:
    """The state turned by W^T = cay(-X): matrices W^T M W, vectors W^T P."""
    return tuple(algebra.KINDS[kind].turned(-X, z) for kind, z in zip(system.space.kinds, state, strict=True))


def half_turn(system: System, state: State, eps: Array, constants: Constants) -> tuple[Array, Array]:
    """X of the free step, and the square of the last correction of X."""
    inverse_inertia: Any = system.inverse_inertia
    momentum: Any = system.space.momentum

    def turn(N: Array) -> Array:
        return system.space.sign * eps / 2 * call(inverse_inertia, (N,), constants)

    M = momentum(*state)
    N, defect = newton(turn, M) if M.shape[-1] == 3 else sweeps(turn, M)
    return turn(N), defect


def newton(turn: Linear, M: Array) -> tuple[Array, Array]:
    """N from M = (I + X) N (I - X), X = turn(N), by two sweeps and a fixed number of Newton steps.

    Largest last correction of X for twenty random heavy tops, n = 3, with h = 0.1, 0.4, 0.8 (|X| about 0.01, 0.06,
    0.11): 6e-18, 2e-12, 3e-8 with two Newton steps; 3e-18, 2e-17, 6e-16 with three; round-off with four.
    """
    N = M
    for _ in range(2):
        N, _ = fixed_point_sweep(turn, M, N)
    defect: Any = 0
    for _ in range(NEWTON_STEPS):
        N, defect = newton_step(turn, M, N)
    return N, defect


def newton_step(turn: Linear, M: Array, N: Array) -> tuple[Array, Array]:
    """N improved once, and the square of the change of X."""
    n = M.shape[-1]
    X = turn(N)
    XN = X @ N
    residual = (N - M) + (XN - XN.mT) - XN @ X

    def slope(D: Array) -> Array:  # of (I + X) N (I - X) along D
        dX = turn(D)
        B = X @ D + dX @ N
        return algebra.coordinates(D + (B - B.mT) - B @ X - XN @ dX)

    basis = np.eye(n * (n - 1) // 2, dtype=np.int8)
    slopes = np.stack([slope(algebra.skew(e, n) + 0 * N) for e in basis], -1)
    change = algebra.skew(algebra.solve(slopes, algebra.coordinates(residual)[..., None])[..., 0], n)
    return N - change, _square(turn(change))


def sweeps(turn: Linear, M: Array) -> tuple[Array, Array]:
    """N by fixed-point sweeps, as many as round-off needs: for n > 3, where a Newton step costs O(n^6)."""

    def improved(N: Array) -> tuple[tuple[Array], Array]:
        new, defect = fixed_point_sweep(turn, M, N)
        return (new,), defect

    (N,), defect = repeat(improved, (M,), SWEEP_LIMIT**2, MOST_SWEEPS, ("skew",))
    return N, defect


def fixed_point_sweep(turn: Linear, M: Array, N: Array) -> tuple[Array, Array]:
    """N <- M - [X, N] + X N X."""
    X = turn(N)
    XN = X @ N
    new = M - (XN - XN.mT) + XN @ X
    return new, _square(turn(new) - X)


def _square(X: Array) -> Array:
    return algebra.pairing(X, X)
