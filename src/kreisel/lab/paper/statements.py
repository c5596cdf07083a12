"""Statements of the paper: places, texts and pairs of sides; derivatives, ranks; how statements are tested."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from typing import Any, get_type_hints

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, identity
from kreisel.errors import InputError, hint, shown
from kreisel.lab import exact, laws
from kreisel.lab.exact import jacobian
from kreisel.lab.law import Case, Sides, residual
from kreisel.lab.paper.setting import Setting
from kreisel.record.contract import System
from kreisel.system import REGISTRY

DIMENSIONS = (3, 4, 5, 6)
CERTAIN_FAILURE = 1e-6  # of a printed form: four orders above the tolerance

SidesOf = Callable[[Setting], Sides]
Decorator = Callable[[Callable[..., Sides]], Callable[..., Sides]]


@dataclass(frozen=True)
class Statement:
    """Name, place and text of a statement, its two sides, and for an erratum, which the text names, the printed form.

    `numbers` are the kinds in which it is tested; the printed form must fail for each n of `misprinted`, and hold for others.
    `ranks`: its sides are ranks of differentials.
    """

    name: str
    place: str
    text: str
    sides: SidesOf
    printed: SidesOf | None = None
    numbers: tuple[str, ...] = ("exact", "float")
    dimensions: tuple[int, ...] = DIMENSIONS
    misprinted: tuple[int, ...] = DIMENSIONS
    by_laws: tuple[str, ...] = ()
    ranks: bool = False

    @property
    def erratum(self) -> str:
        """The errata that the printed form shows."""
        return ", ".join(dict.fromkeys(re.findall(r"\bE\d+", self.text))) if self.printed is not None else ""


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
        return "ranks of differentials" if self.statement.ranks else "both sides"

    @property
    def verdict(self) -> str:
        """One word or two for the table."""
        if not self.holds:
            return "FAILS"
        return "holds; the printed form fails" if self.statement.printed else "holds"


STATEMENTS: dict[str, Statement] = {}


def drawn(function: Callable[..., Sides], **options: Any) -> SidesOf:
    """The sides in a setting: the annotated arguments of the function are drawn, `s` is the setting itself."""

    @wraps(function)
    def sides(s: Setting) -> Sides:
        values: dict[str, Any] = {}
        for name, note in get_type_hints(function, include_extras=True).items():
            for kind in getattr(note, "__metadata__", ()):
                value = kind(s) if callable(kind) else getattr(s, kind)
                values[name] = value() if callable(value) else value
        return function(**({"s": s} if "s" in function.__annotations__ else {}), **values, **options)

    return sides


def stated(
    name: str, place: str, printed: Mapping[str, Any] | None = None, ranks: bool = False, **options: Any
) -> Decorator:
    """Register the decorated function as a statement, which its docstring states.

    `printed` are the arguments with which the function gives the printed form instead: it must fail.  Ranks are exact.
    """
    options = {"ranks": ranks, **({"numbers": ("exact",)} if ranks else {}), **options}

    def register(sides: Callable[..., Sides]) -> Callable[..., Sides]:
        if name in STATEMENTS:
            raise ValueError(f"two statements are called {name}")
        misprint = None if printed is None else drawn(sides, **printed)
        STATEMENTS[name] = Statement(name, place, sides.__doc__ or "", drawn(sides), misprint, **options)
        return sides

    return register


def by_laws(s: Setting, system: System, names: Iterable[str]) -> Iterator[tuple[Array, Array]]:
    """The sides of laws of `kreisel.lab.laws` for a system."""
    case = s.case(system)
    for name in names:
        yield from laws.LAWS[name].sides(case)


def stated_laws(
    table: Mapping[str, Mapping[tuple[str, str], tuple[str, str]]], dimensions: tuple[int, ...] = DIMENSIONS
) -> None:
    """Statements that laws test: name of a system -> (name, place) -> (text, names of the laws)."""
    for system in table:
        record = REGISTRY[system]
        sizes = dimensions if record.n is None else (record.n,)
        for (name, place), (text, listed) in table[system].items():
            names = tuple(listed.split())
            kinds = [laws.LAWS[law].numbers(record) for law in names]
            numbers = tuple(kind for kind in ("exact", "float") if all(kind in constants for constants in kinds))
            sides = partial(by_laws, system=record, names=names)
            STATEMENTS[name] = Statement(name, place, text, sides, None, numbers, sizes, by_laws=names)


def printed_law(name: str, system: System, law: str, **printed_functions: Any) -> None:
    """The printed form of a statement that is a law of the map of a system, with other functions for some of the map's."""
    assert system.map is not None
    misprinted = replace(system, map=replace(system.map, **printed_functions))
    STATEMENTS[name] = replace(STATEMENTS[name], printed=partial(by_laws, system=misprinted, names=(law,)))


def section(item: tuple[str, Statement]) -> float:
    """The section of a named statement, 9 for those that a section does not contain."""
    number = re.match(r"Sections? (\d(\.\d)?)", item[1].place)
    return float(number[1]) if number else 9.0


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
    result = [s for s in STATEMENTS.values() if s.name.startswith(name)]
    if not result:
        raise InputError(
            f"No statement is called {shown(name)}.{hint(name, STATEMENTS)} `kreisel verify --list` names them all."
        )
    return result


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


# -- derivatives, expansions along curves, matrices of the proofs, ranks ------------------------------

HALF_LEAF = {3: 2, 4: 4, 5: 6, 6: 9}
SPECTRAL_RANK = {3: 2, 4: 3, 5: 4, 6: 5}


def gradient(function: Callable[[Array], Any], point: Array) -> Array:
    """The gradient of a scalar function of a vector, or of a skew matrix for the pairing <X, Y> = -tr(XY)/2."""
    kinds = ("vector",) if point.ndim == 1 else ("skew",)
    return algebra.restore(jacobian(function, (point,), kinds, len(point))[1], kinds, len(point))[0]


def left_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d f: <d f(g), eta> = d/ds f(exp(s eta) g)."""
    return gradient(lambda eta: function(g + eta @ g), 0 * (g - g.T))


def right_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d' f: <d' f(g), eta> = d/ds f(g exp(s eta))."""
    return gradient(lambda eta: function(g + g @ eta), 0 * (g - g.T))


def series(x: Any) -> Array:
    """The coefficients of 1, e and e^2 of a number or an array along a curve: e^2 is twice the product of the generators."""
    return np.array([exact.coefficient(x, 0), exact.coefficient(x, 1), exact.coefficient(x, 3) / 2])


def rank(vectors: Array) -> int:
    """The rank of the rows of a rational matrix, by elimination with pivoting."""
    A, count = np.array(vectors, dtype=object), 0
    for column in range(A.shape[1]):
        pivots = count + np.flatnonzero(A[count:, column] != 0)
        if len(pivots):
            A[[count, pivots[0]]] = A[[pivots[0], count]]
            remainder = pivots[1:]
            A[remainder] = A[remainder] - np.multiply.outer(A[remainder, column] / A[count, column], A[count])
            count += 1
    return count


def half(w: Array) -> Array:
    """(w - I)/(w + I), written as in the paper."""
    n = w.shape[-1]
    return algebra.solve((w + identity(n)).T, (w - identity(n)).T).T


def trace_log_of(w: Array) -> Any:
    """Tr log(2I + w + w^-1)."""
    return algebra.trace_log(2 * identity(w.shape[-1]) + w + w.T)


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
