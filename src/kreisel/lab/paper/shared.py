"""What several sections need: matrices of the proofs, ranks on a leaf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, identity, trace_log
from kreisel.lab.exact import jacobian
from kreisel.lab.law import Case
from kreisel.lab.paper.statements import rank
from kreisel.record.contract import System


def outer(x: Array) -> Array:
    """x x^T."""
    return x[..., :, None] * x[..., None, :]


def half(w: Array) -> Array:
    """(w - I)/(w + I), written as in the paper."""
    n = w.shape[-1]
    return algebra.solve((w + identity(n)).T, (w - identity(n)).T).T


def trace_log_of(w: Array) -> Any:
    """Tr log(2I + w + w^-1)."""
    return trace_log(2 * identity(w.shape[-1]) + w + w.T)


HALF_LEAF = {3: 2, 4: 4, 5: 6, 6: 9}
SPECTRAL_RANK = {3: 2, 4: 3, 5: 4, 6: 5}


def rank_on_leaf(system: System, state: tuple[Array, ...], functions: Sequence[Callable[..., Any]]) -> int:
    """The rank on the leaf of the differentials of functions of the state, at a rational point."""
    space, n = system.space, state[0].shape[-1]
    assert space.casimirs is not None
    slopes = [jacobian(f, state, space.kinds, n)[1] for f in (space.casimirs, *functions)]
    casimirs, *others = [x.reshape(-1, x.shape[-1]) for x in slopes]
    return rank(np.concatenate([casimirs, *others])) - rank(casimirs)


def leaf_rank(case: Case, names: tuple[str, ...]) -> int:
    """The same of the energy and the named integrals of a record."""
    system = case.system
    functions = [partial(case.call, f) for f in (system.energy, *(system.integrals[name] for name in names))]
    return rank_on_leaf(system, case.state, functions)
