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

from kreisel.record.contract import Frame, Parameter
from kreisel.reduction.equations import (
    Continuous,
    Discrete,
    Unreduced,
    left_derivative,
    reduce,
    right_derivative,
    symmetric_rule,
)
from kreisel.reduction.groups import (
    SE3,
    SO,
    SU2,
    Group,
    Representation,
    adjoint,
    casimir_count,
    casimir_gradients,
    matrix_group,
    product,
    quadratic_casimirs,
    representation,
    standard,
    trivial,
    unit_sums,
)
from kreisel.reduction.numerics import double
from kreisel.reduction.records import system

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
