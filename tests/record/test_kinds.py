"""Kinds of components: coordinates, rotations and what users see, by their laws, exactly and on arrays of JAX."""

from __future__ import annotations

import numpy as np
import pytest

from kreisel import algebra
from kreisel.algebra import KINDS
from kreisel.lab import exact

NAMES = ("skew", "symmetric", "vector", "matrix")
OTHERS = ("scalar", "quaternion", "R^6")


@pytest.mark.parametrize("n", [3, 4])
@pytest.mark.parametrize("name", NAMES)
def test_rotations_act_as_their_velocities_say(name, n):
    kind, draw = KINDS[name], exact.rational_random(np.random.default_rng(n))
    z, X = kind.unpack(draw((kind.count(n),)), n), algebra.skew(draw((n * (n - 1) // 2,)), n)
    assert z.shape == kind.shape(n)
    R = algebra.cayley(X)
    assert (kind.turned(X, z) == kind.rotated(R, z)).all() and (kind.rotated(R.mT, kind.rotated(R, z)) == z).all()
    near = kind.turned(exact.along(0 * X, X), z)  # cay(s X) = 1 + 2 s X + ...
    assert (exact.slopes(near, 1)[..., 0] == kind.rate(2 * X, z)).all()
    assert (kind.unpack(kind.pack(kind.rotated(R, z)), n) == kind.rotated(R, z)).all()  # it is of this kind again
    assert (kind.from_user(kind.for_user(z), n) == z).all() and kind.for_user(z).shape == kind.shown(n).shape(n)


@pytest.mark.parametrize("n", [3, 4])
def test_coordinates_are_those_of_the_components_one_after_the_other(n):
    pytest.importorskip("jax")
    from kreisel.reduction.numerics import double, jax

    kinds = (*NAMES, *OTHERS)
    size = algebra.coordinate_count(kinds, n)
    x = np.random.default_rng(0).normal(size=(2, 5, size))
    parts = algebra.restore(x, kinds, n)
    assert [z.ndim - 2 for z in parts] == [KINDS[kind].axes for kind in kinds]
    M, S = parts[:2]
    assert (M.mT == -M).all() and (S.mT == S).all() and (algebra.flatten(parts, kinds) == x).all()
    names = [name for kind in kinds for name in KINDS[kind].names(kind, n)]
    assert len(set(names)) == len(names) == size
    alone = algebra.flatten((parts[0], *(z[0, 0] for z in parts[1:])), kinds)  # batches are broadcast
    assert alone.shape == x.shape and (alone[1, 3, M.shape[-1] * (n - 1) // 2 :] == x[0, 0, n * (n - 1) // 2 :]).all()
    with double():
        again = jax.jit(lambda x: algebra.flatten(algebra.restore(x, kinds, n), kinds))(x)
    assert (np.asarray(again) == x).all()
