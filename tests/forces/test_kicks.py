"""Parts of kicks that stand alone."""

from __future__ import annotations

import mpmath
import pytest

from kreisel.forces.kicks import expm1


@pytest.mark.parametrize("x", [0.0, 1e-300, -1e-12, 3e-5, -0.01, 0.7, -1.0, 8.0, -20.0, -200.0])
def test_expm1_is_right_to_rounding(x: float) -> None:
    """32 roundings, each of which the doublings may carry on by a small factor."""
    with mpmath.workdps(60):
        exact = mpmath.expm1(mpmath.mpf(x))
        assert abs(mpmath.mpf(expm1(x)) - exact) <= 64 * 1.2e-16 * abs(exact)
