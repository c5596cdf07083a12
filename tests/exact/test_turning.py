"""Turns by any vector: against many digits, at nothing, and together."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from kreisel import algebra
from kreisel.algebra import conjugated, turn

ULP = 2.0**-52
AXIS = np.array([0.48, -0.6, 0.64])


@pytest.mark.parametrize(("angle", "squarings"), [(0.0, 2), (1e-200, 2), (1e-9, 2), (1.0, 2), (-8.0, 2), (2.0, 0)])
def test_turns(angle: float, squarings: int) -> None:
    with mp.workdps(40):
        v = [mp.mpf(float(x)) for x in angle * AXIS]
        size = mp.sqrt(sum(x * x for x in v))
        ratio = mp.sin(size / 2) / size if size else mp.mpf(0.5)
        want = [mp.cos(size / 2), *(ratio * x for x in v)]
        got = turn(angle * AXIS, squarings)
        assert max(abs(float(x - float(y))) for x, y in zip(want, got, strict=True)) < 12 * ULP


def test_any_length_turns_alike() -> None:
    q, v = np.random.default_rng(2).normal(size=(6, 4)), np.array([0.3, -0.2, 0.9])
    want = algebra.act(algebra.rotation_matrix(algebra.unit(q)), v)
    assert abs(conjugated(q, v) - want).max() < 8 * ULP
    assert (conjugated(np.array([2.0, 0, 0, 0]), v) == v).all()
