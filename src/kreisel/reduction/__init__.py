"""Lagrangian reduction on any matrix group with any representation: sections 2 and 3 of Suris 2001, in JAX.

    import jax.numpy as jnp
    from kreisel import reduction as red

    def L(Omega, P, *, J, A):                       # heavy top
        return -jnp.trace(Omega @ (J[:, None] * Omega)) / 2 - P @ A

    Top = red.system("my-top", group=red.SO(3), lagrangian=L)
    top = Top(J=(1, 2, 3), A=(0, 0, 1))
    run = kr.simulate(top, top.state(M=(1, 0, 2), P=(0, 0, 1)), dt=0.05, steps=1000)

JAX computes in float64 inside `double()`; the user's settings remain unchanged.
"""

from kreisel.record.contract import Frame as Frame, Parameter as Parameter
from kreisel.reduction.equations import (
    Continuous as Continuous,
    Discrete as Discrete,
    Unreduced as Unreduced,
    left_derivative as left_derivative,
    reduce as reduce,
    right_derivative as right_derivative,
    symmetric_rule as symmetric_rule,
)
from kreisel.reduction.groups import (
    SE3 as SE3,
    SO as SO,
    SU2 as SU2,
    Group as Group,
    Representation as Representation,
    adjoint as adjoint,
    casimir_count as casimir_count,
    casimir_gradients as casimir_gradients,
    matrix_group as matrix_group,
    product as product,
    quadratic_casimirs as quadratic_casimirs,
    representation as representation,
    standard as standard,
    trivial as trivial,
    unit_sums as unit_sums,
)
from kreisel.reduction.numerics import double as double
from kreisel.reduction.records import system as system

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
