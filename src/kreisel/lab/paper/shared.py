"""What several sections need: matrices of the proofs, ranks on a leaf."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, identity, trace_log
from kreisel.lab import laws
from kreisel.lab.paper.statements import rank


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


def leaf_rank(case: laws.Case, names: tuple[str, ...]) -> int:
    """The rank on the leaf of the differentials of the energy and the named integrals, at a random rational point."""
    gradients = [case.jacobian(case.system.space.casimirs)[1]]
    casimirs = rank(np.concatenate(gradients))
    for name in ("energy", *names):
        function = case.system.energy if name == "energy" else case.system.integrals[name]
        gradients.append(np.atleast_2d(case.jacobian(function)[1]).reshape(-1, gradients[0].shape[-1]))
    return rank(np.concatenate(gradients)) - casimirs
