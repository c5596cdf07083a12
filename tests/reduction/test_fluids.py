"""Fluids as the motion of matrices with unit column sums: the study of the gallery, and mutants that its checks see."""

from __future__ import annotations

import runpy
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import kreisel as kr
from kreisel import reduction as red
from sizes import FULL
from support import ROOT


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "examples" / "gallery" / "compressible_fluid.py"))


def test_unit_sums_move_masses() -> None:
    group = red.unit_sums(4)
    assert group.dim == 12 and group.retraction == "cayley"
    assert (group.basis.sum(1) == 0).all()
    j, i = np.nonzero(~np.eye(4, dtype=bool))
    for E, row, column in zip(group.basis, i, j, strict=True):
        assert E[row, column] == 1 and E[column, column] == -1 and abs(E).sum() == 2
    with red.double():
        g = np.asarray(group.retract(jnp.linspace(-0.3, 0.4, 12)))
    assert np.allclose(g.sum(0), 1, atol=1e-14) and np.allclose(np.linalg.inv(g).T.sum(1), 1, atol=1e-14)
    for wrong in (1, 2.0, "4"):
        with pytest.raises(kr.InputError, match="integer N >= 2"):
            red.unit_sums(wrong)


def test_the_equations_of_the_whole_group_are_verlet(study: dict[str, Any]) -> None:
    """Section 3 by automatic derivatives, and theta and rho by hand; the Noether momenta of any state."""
    maps, mass, noether, moved = study["whole_group"](study["verlet"])
    assert maps < 1e-10 and mass < 1e-13 and noether < 1e-9 and moved > 1e-3


@pytest.mark.parametrize("wrong", ["weights", "kick", "sign"])
def test_another_map_is_seen_on_the_whole_group(study: dict[str, Any], wrong: str) -> None:
    verlet = study["verlet"]

    def mutant(theta: Any, rho: Any, weights: Any, eps: float) -> Any:
        if wrong == "weights":
            return verlet(theta, rho, 1.01 * weights, eps)
        if wrong == "sign":
            return verlet(-theta, rho, weights, eps)
        new, moved = verlet(theta, rho, weights, eps)
        return new + eps / 2 * len(rho) * (moved - rho), moved  # the old depth in the second kick

    assert study["whole_group"](mutant, steps=1)[0] > 1e-5


def test_fluxes_between_neighbours_are_constrained_motion(study: dict[str, Any]) -> None:
    """In all directions that the reach of L's derivative covers; without circulation in all."""
    for count, reach, whole in (*[(12, 5, 3)] * FULL, (8, 3, 1)):
        gaps = study["constrained"](study["step"], count=count, reach=reach)
        assert max(gaps[:whole]) < 1e-14 and max(gaps[whole:]) > 1e-6
    assert max(study["constrained"](study["step"], count=7, reach=3, mean=0)) < 1e-14


@pytest.mark.parametrize("wrong", ["kinetic", "old depth", "upwind"])
def test_another_step_is_seen_between_neighbours(study: dict[str, Any], wrong: str) -> None:
    half, kinetic, slope, step = (study[k] for k in ("half", "kinetic", "slope", "step"))

    def mutant(v: Any, h: Any, width: float, eps: float) -> Any:
        u, new = half(v, h, width, eps), step(v, h, width, eps)[1]
        if wrong == "upwind":
            flux = u * (h + new) / 2
            new = h - eps * (flux - jnp.roll(flux, 1)) / width
        share = 2 if wrong == "kinetic" else 1
        return u - eps / 2 * slope(share * kinetic(u) + (h if wrong == "old depth" else new), width), new

    assert study["constrained"](mutant)[0] > 1e-5


def test_the_simple_wave_is_exact(study: dict[str, Any]) -> None:
    """Both equations of shallow water, by differences of the closed form."""
    x, at, near = np.linspace(0, 1, 7, endpoint=False), 0.15, 1e-4

    def wave(shift: float, later: float) -> Any:
        h = study["simple_wave"](x + shift, at + later)
        return np.array([h, 2 * np.sqrt(h) - 2])

    h, u = wave(0, 0)
    ht, ut = (wave(0, near) - wave(0, -near)) / (2 * near)
    hx, ux = (wave(near, 0) - wave(-near, 0)) / (2 * near)
    assert abs(hx).max() > 0.5
    assert abs(ht + u * hx + h * ux).max() < 1e-5 and abs(ut + u * ux + hx).max() < 1e-5
