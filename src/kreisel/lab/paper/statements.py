"""Statements of the paper: places, texts and pairs of sides; derivatives, ranks; how statements are tested."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, identity, trace_log
from kreisel.errors import InputError, hint, shown
from kreisel.lab import exact, laws
from kreisel.lab.exact import jacobian
from kreisel.lab.law import Case, Sides, residual
from kreisel.record.contract import System
from kreisel.record.model import Model

DIMENSIONS = (3, 4, 5, 6)
CERTAIN_FAILURE = 1e-6  # of a printed form: four orders above the tolerance


class Setting:
    """Random data of one kind of number in R^n, on which the statements are tested."""

    def __init__(self, n: int, numbers: str, seed: int = 0):
        rng = np.random.default_rng([seed, n])
        self.n, self.numbers = n, numbers
        self.draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
        self.sign = (-1) ** (n + seed + (numbers == "exact"))  # of steps, and of -alpha: rationals and floats have both
        self.eps: Any = self.sign * abs(self.scalar()) / 4
        self.lam: Any = self.scalar() * 97 / 89  # no other number has such a denominator: Lax matrices have poles there

    def scalar(self) -> Any:
        """A random number."""
        return self.draw((1,))[0]

    def vector(self) -> Array:
        """A random vector of R^n."""
        return self.draw((self.n,))

    def unit(self) -> Array:
        """A random vector of length 1, rational when the values are: a column of a rotation."""
        return self.rotation()[:, 0]

    def skew(self) -> Array:
        """A random element of so(n)."""
        return algebra.skew(self.draw((self.n * (self.n - 1) // 2,)), self.n)

    def rotation(self) -> Array:
        """A random element of SO(n)."""
        return exact.random_rotation(self.n, self.draw)

    def symmetric(self) -> Array:
        """A random positive definite matrix."""
        square = self.draw((self.n, self.n))
        return square @ square.T / self.n + algebra.identity(self.n)

    def diagonal(self) -> Array:
        """A random diagonal (n,) with distinct entries of both signs, no two of which add up to 0."""
        return abs(self.vector()) / 4 + 2 * np.cumsum(0 * self.vector() + 1) - (self.n + 1)

    def case(self, system: System | Model) -> laws.Case:
        """A random case of a system, of an explicit map with a step of either sign, of a top with alpha of either sign."""
        case = laws.drawn_case(system, self.n, self.numbers, self.draw)
        if "alpha" in case.model.params:
            own = {**case.model.params, "alpha": -self.sign * abs(case.model.params["alpha"])}
            case = replace(case, model=case.system(**own))
        back = case.system.map is not None and case.system.map.rational and self.scalar() < 0
        return replace(case, eps=-case.eps) if back else case


SidesOf = Callable[[Setting], Sides]
Decorator = Callable[[Callable[..., Sides]], Callable[..., Sides]]


@dataclass(frozen=True)
class Statement:
    """Name, place and text of a statement, its two sides, and for an erratum the printed form.

    `numbers` are the kinds in which it is tested; the printed form must fail for each n of `misprinted`, and hold for others.
    """

    name: str
    place: str
    text: str
    sides: SidesOf
    printed: SidesOf | None = None
    erratum: str = ""
    numbers: tuple[str, ...] = ("exact", "float")
    dimensions: tuple[int, ...] = DIMENSIONS
    misprinted: tuple[int, ...] = DIMENSIONS
    by_laws: tuple[str, ...] = ()


@dataclass
class StatementResult:
    """A statement tested: the largest residuals over all n, of the printed form too, and the verdict."""

    statement: Statement
    over_q: float | None = None
    in_floats: float | None = None
    printed: float | None = None
    holds: bool = True
    dimensions: list[int] = field(default_factory=list)

    @property
    def computed(self) -> str:
        """The quantities that are compared, in words."""
        if self.statement.by_laws:
            return "laws " + ", ".join(self.statement.by_laws)
        return "ranks of differentials" if "float" not in self.statement.numbers else "both sides"

    @property
    def verdict(self) -> str:
        """One word or two for the table."""
        if not self.holds:
            return "FAILS"
        return "holds; the printed form fails" if self.statement.printed else "holds"


STATEMENTS: dict[str, Statement] = {}


def stated(
    name: str, place: str, erratum: str = "", printed: Mapping[str, Any] | None = None, **more: Any
) -> Decorator:
    """Register the decorated function as a statement, which its docstring states.

    `printed` are the arguments with which the function gives the printed form instead: it must fail.
    """

    def register(sides: Callable[..., Sides]) -> Callable[..., Sides]:
        if name in STATEMENTS:
            raise ValueError(f"two statements are called {name}")
        misprint = None if printed is None else partial(sides, **printed)
        STATEMENTS[name] = Statement(name, place, sides.__doc__ or "", sides, misprint, erratum, **more)
        return sides

    return register


def printed(name: str) -> Callable[[SidesOf], SidesOf]:
    """Register the decorated function as the printed form of a statement: it must fail."""

    def register(sides: SidesOf) -> SidesOf:
        STATEMENTS[name] = replace(STATEMENTS[name], printed=sides)
        return sides

    return register


def by_law(system: System, *names: str) -> SidesOf:
    """The sides of laws of `kreisel.lab.laws` for a system."""

    def sides(s: Setting) -> Iterator[tuple[Array, Array]]:
        case = s.case(system)
        for name in names:
            yield from laws.LAWS[name].sides(case)

    return sides


def stated_law(
    name: str, place: str, text: str, system: System, laws: Sequence[str], erratum: str = "", **more: Any
) -> None:
    """A statement that laws of the registry test."""
    statement = Statement(name, place, text, by_law(system, *laws), erratum=erratum, by_laws=tuple(laws), **more)
    STATEMENTS[name] = statement


def printed_law(name: str, system: System, law: str, **printed_functions: Any) -> None:
    """The printed form of a statement that is a law of the map of a system, with other functions for some of the map's."""
    assert system.map is not None
    printed(name)(by_law(replace(system, map=replace(system.map, **printed_functions)), law))


# -- derivatives on the group and its algebra -------------------------------------------------------


def gradient(function: Callable[[Array], Any], point: Array) -> Array:
    """The gradient of a scalar function of a vector, or of a skew matrix for the pairing <X, Y> = -tr(XY)/2."""
    if point.ndim == 1:
        return _slopes(function(exact.independent(point)), len(point))
    n = point.shape[-1]
    coordinates = algebra.coordinates(point)
    return algebra.skew(_slopes(function(algebra.skew(exact.independent(coordinates), n)), len(coordinates)), n)


def left_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d f: <d f(g), eta> = d/ds f(exp(s eta) g)."""
    return _lie(lambda eta: function(g + eta @ g), g)


def right_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d' f: <d' f(g), eta> = d/ds f(g exp(s eta))."""
    return _lie(lambda eta: function(g + g @ eta), g)


def _lie(function: Callable[[Array], Any], g: Array) -> Array:
    n = g.shape[-1]
    zero = 0 * algebra.coordinates(g - g.T)
    return algebra.skew(_slopes(function(algebra.skew(exact.independent(zero), n)), len(zero)), n)


def _slopes(value: Any, count: int) -> Array:
    return exact.slopes(np.asarray(value, dtype=object), count).reshape(count)


def rank(vectors: Array) -> int:
    """The rank of the rows of a rational matrix, by elimination with pivoting."""
    rows = [list(v) for v in vectors]
    found = 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(found, len(rows)) if rows[i][column] != 0), None)
        if pivot is None:
            continue
        rows[found], rows[pivot] = rows[pivot], rows[found]
        head = rows[found]
        for i in range(found + 1, len(rows)):
            if rows[i][column] != 0:
                factor = rows[i][column] / head[column]
                rows[i] = [x - factor * y for x, y in zip(rows[i], head, strict=True)]
        found += 1
        if found == len(rows):
            break
    return found


# -- testing ------------------------------------------------------------------------------------------


def tested(statement: Statement, dimensions: Iterable[int] = DIMENSIONS, seed: int = 0) -> StatementResult:
    """Test one statement for each n, exactly over Q and in floats."""
    finding = StatementResult(statement)
    for n in dimensions:
        if n not in statement.dimensions:
            continue
        finding.dimensions.append(n)
        for numbers in statement.numbers:
            off = residual(statement.sides(Setting(n, numbers, seed)), numbers)
            if numbers == "exact":
                finding.over_q = max(finding.over_q or 0.0, off)
                finding.holds &= off == 0
            else:
                finding.in_floats = max(finding.in_floats or 0.0, off)
                finding.holds &= off < laws.TOLERANCE
        if statement.printed is not None:
            off = residual(statement.printed(Setting(n, statement.numbers[-1], seed)), statement.numbers[-1])
            if n not in statement.misprinted:
                finding.holds &= off < laws.TOLERANCE
                continue
            finding.printed = off if finding.printed is None else min(finding.printed, off)
            finding.holds &= off > CERTAIN_FAILURE
    return finding


tested.__test__ = False  # type: ignore[attr-defined]  # not for pytest to collect


def chosen(name: str | None) -> list[Statement]:
    """The statement of that name, or all whose names begin so.  Raises `InputError` with the nearest name."""
    if name is None:
        return list(STATEMENTS.values())
    if name in STATEMENTS:
        return [STATEMENTS[name]]
    found = [s for s in STATEMENTS.values() if s.name.startswith(name)]
    if not found:
        raise InputError(
            f"No statement is called {shown(name)}.{hint(name, STATEMENTS)} `kreisel verify --list` names them all."
        )
    return found


def verify(name: str | None = None, dimensions: Iterable[int] = DIMENSIONS, seed: int = 0) -> Iterator[StatementResult]:
    """Test the statement `name`, all statements whose names begin so, or all of them, one after the other.

    Each is tested at random points for each n (3, 4, 5, 6) exactly over Q and in floats; for an erratum the printed
    form must fail as well.  Raises `InputError` for an unknown name.
    """
    sizes = tuple(dimensions)
    return (tested(statement, sizes, seed) for statement in chosen(name))


def cells(finding: StatementResult) -> tuple[str, str, str, str]:
    """Text for a table: n, the residual over Q, that in floats, the verdict (with the printed form's residual)."""
    sizes = finding.dimensions
    spread = f"{sizes[0]}-{sizes[-1]}" if len(sizes) > 1 else str(sizes[0]) if sizes else "none"
    over_q = "-" if finding.over_q is None else f"{finding.over_q:.1g}"
    floats = "-" if finding.in_floats is None else f"{finding.in_floats:.0e}"
    by = "" if finding.printed is None else f" (residual {finding.printed:.1g})"
    return spread, over_q, floats, finding.verdict + by


# -- matrices of the proofs, ranks on a leaf ---------------------------------------------------------


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
    """The rank on the leaf of the differentials of the energy and the named integrals of a record."""
    system = case.system
    functions = [partial(case.call, f) for f in (system.energy, *(system.integrals[name] for name in names))]
    return rank_on_leaf(system, case.state, functions)
