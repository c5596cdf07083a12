"""Random data on which the statements are tested, and the arguments of a statement that stand for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.lab import exact, laws
from kreisel.lab.law import Case
from kreisel.record.contract import System
from kreisel.record.model import Model


class Setting:
    """Random data of one kind of number in R^n, on which the statements are tested.

    A unit vector is a column of a rotation, so that it is rational if the values are; a symmetric matrix is positive; a
    diagonal (n,) has distinct entries of both signs, no two of which add up to 0.
    """

    def __init__(self, n: int, numbers: str, seed: int = 0):
        rng = np.random.default_rng([seed, n])
        self.n, self.numbers = n, numbers
        self.draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
        self.sign = (-1) ** (n + seed + (numbers == "exact"))  # of steps, and of -alpha: rationals and floats have both
        self.eps: Any = self.sign * abs(self.scalar()) / 4
        self.lam: Any = self.scalar() * 97 / 89  # no other number has such a denominator: Lax matrices have poles there

    def scalar(self) -> Any:
        return self.draw((1,))[0]

    def vector(self) -> Array:
        return self.draw((self.n,))

    def unit(self) -> Array:
        return self.rotation()[:, 0]

    def skew(self) -> Array:
        return algebra.skew(self.draw((self.n * (self.n - 1) // 2,)), self.n)

    def rotation(self) -> Array:
        return exact.random_rotation(self.n, self.draw)

    def symmetric(self) -> Array:
        square = self.draw((self.n, self.n))
        return square @ square.T / self.n + algebra.identity(self.n)

    def diagonal(self) -> Array:
        return abs(self.vector()) / 4 + 2 * np.cumsum(0 * self.vector() + 1) - (self.n + 1)

    def case(self, system: System | Model) -> Case:
        """A random case of a system, of an explicit map with a step of either sign, of a top with alpha of either sign."""
        case = laws.drawn_case(system, self.n, self.numbers, self.draw)
        if "alpha" in case.model.params:
            parameters = {**case.model.params, "alpha": -self.sign * abs(case.model.params["alpha"])}
            case = replace(case, model=case.system(**parameters))
        back = case.system.map is not None and case.system.map.rational and self.scalar() < 0
        return replace(case, eps=-case.eps) if back else case


def curve_of_rotations(s: Setting) -> tuple[Array, Array, Any]:
    """w(e) = cay(e omega/2 + e^2 u/2) in SO(n), its omega, and e, a step with e^3 = 0."""
    unit, omega, u = 1 + 0 * s.scalar(), s.skew(), s.skew()
    e = exact.generator(0, unit) + exact.generator(1, unit)
    return algebra.cayley(0 * omega + omega * (e / 2) + u * (e * e / 2)), omega, e


# Arguments of a statement, which are drawn in their order: attributes of `Setting`, or functions of it.
Scalar = Annotated[Any, "scalar"]
Vector = Annotated[Array, "vector"]
Unit = Annotated[Array, "unit"]
Skew = Annotated[Array, "skew"]
Rotation = Annotated[Array, "rotation"]
Symmetric = Annotated[Array, "symmetric"]
Diagonal = Annotated[Array, "diagonal"]
Eps = Annotated[Any, "eps"]
Lam = Annotated[Any, "lam"]
Curve = Annotated[Any, curve_of_rotations]
