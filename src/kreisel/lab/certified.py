"""Statements that are certain: enclosures of orbits in ball arithmetic, and identities proved.

The step runs unchanged on balls of python-flint (Arb).  Against the wrapping of rotations a set c + Q r is carried,
Q close to orthogonal, r a box:  phi(c + Q r) is in phi(c) + Dphi(X) Q r, X a box around c + Q r, Dphi from dual values
over balls, the new Q from a QR decomposition of the middle of Dphi(X) Q, whose longest columns come first.
[Lohner 1987; Neumaier, Reliable Computing 8 (2002); Arb: Johansson, IEEE Trans. Computers 66 (2017)]

Identities are proved with a variable of rational functions over Q for each coordinate, parameter and eps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.lab.exact import Dual, fraction, generators, independent, rationals, require_flint, slopes
from kreisel.lab.integrals import Polynomial
from kreisel.lab.subject import Subject, coordinate_names
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.settings import within

Function = Callable[[Array], Any]


@dataclass(frozen=True)
class Certified:
    """Enclosures of an orbit, and of functions along it.

    steps      the enclosures of steps 0 ... `steps` have radii of at most `tolerance`
    stopped    why no further: "" if as many as asked for
    radius     the largest radius of the last enclosure
    middle     its middle (d,) as floats
    enclosure  the last enclosure, a ball (python-flint's arb) for each coordinate
    integrals  name -> (lowest, highest) over the complete orbit, as floats rounded outwards
    plain      how many steps balls last, mapped without any cure of wrapping
    """

    name: str
    precision: int
    tolerance: float
    steps: int
    stopped: str
    radius: float
    middle: Array
    enclosure: Array
    integrals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    plain: int | None = None

    def __str__(self) -> str:
        text = f"{self.name}: {self.steps:,} steps certified to {self.tolerance:g} with {self.precision} bits"
        text += f" (radius {self.radius:.1e} at the end)"
        text += f"; balls without it last {self.plain:,}" if self.plain is not None else ""
        for name, (low, high) in self.integrals.items():
            text += f"\n    {name} in [{low!r}, {high!r}], width {high - low:.1e}"
        return text + (f"\n    stopped: {self.stopped}" if self.stopped else "")


@explained
def certify(
    subject: Subject,
    x: Any,
    steps: int = 1000,
    *,
    precision: int = 128,
    tolerance: float = 1e-6,
    radius: Any = 0,
    functions: Mapping[str, Function] | None = None,
    plain: bool = False,
) -> Certified:
    """Enclose the orbit from x, integers and fractions (d,), or from the box of that `radius` about x.

    functions  name -> f(x) of coordinates, polynomial or rational, to be enclosed along the orbit; by default the
               energy of the record, as the map deforms it
    plain      also try the step only on balls, for comparison

    Ends where an enclosure is larger than `tolerance` or meets a pole.  Raises `InputError` without python-flint, for
    implicit maps and for a start that does not fit.
    """
    subject.require_rational(x)
    steps, precision = within(steps, "steps"), within(precision, "precision", 24)
    if not 0 <= fraction(radius) <= tolerance or tolerance == 0:
        raise InputError(
            f"tolerance > 0 and a radius from 0 to it were expected, got {shown(tolerance)} and {shown(radius)}: the "
            "enclosure of step 0 is the box of the radius."
        )
    flint = require_flint()
    with flint.ctx.workprec(precision):
        constants = {k: _balls(v) for k, v in subject.constants.items()}

        def step(z: Array) -> Array:
            try:
                return np.asarray(subject.step(z, **constants), dtype=object)
            except TypeError as error:
                raise InputError(
                    f"The step of {subject.name} failed on balls: {error}. Usual cause: a fraction in the step. Give "
                    "it as a constant of the map, subject(step, names=..., a=...), with step(x, a)."
                ) from error

        if functions is None:
            functions = {} if subject.energy is None else {"energy": partial(subject.energy, **constants)}
        named = {  # with the coefficients of polynomials as balls
            k: replace(f, terms={e: _balls(c) for e, c in f.terms.items()}) if isinstance(f, Polynomial) else f
            for k, f in functions.items()
        }
        start, box = np.asarray(_balls(x)), flint.arb(0, _balls(radius))
        reached, stopped, X, ranges = _lohner(flint, step, start, box, steps, tolerance, named)
        alone, z = 0 if plain else None, start + box
        while alone is not None and alone < steps:
            z = step(z)
            if not _all_finite(z) or max(float(v.rad()) for v in z) > tolerance:
                break
            alone += 1
        middle = np.array([float(v.mid()) for v in X])
        radii = max(float(v.rad()) for v in X)
    return Certified(subject.name, precision, tolerance, reached, stopped, radii, middle, X, ranges, alone)


def _balls(v: Any) -> Any:
    """Exact balls of a number or an array of values."""
    return np.vectorize(require_flint().arb, otypes=[object])(rationals(v))[()]


def _lohner(
    flint: Any, step: Function, start: Array, box: Any, steps: int, tolerance: float, named: Mapping[str, Function]
) -> tuple[int, str, Array, dict[str, tuple[float, float]]]:
    d = len(start)
    c = np.array([v.mid() for v in start], dtype=object)
    r = (start - c) + box
    Q = np.array([[flint.arb(int(i == j)) for j in range(d)] for i in range(d)], dtype=object)
    X, done = c + Q @ r, 0
    ranges: dict[str, tuple[float, float]] = {}
    while True:
        # the mean value theorem needs the segments from c to the set; cut unchanged, the box may have lost c itself
        X = np.array([a.union(b) for a, b in zip(X, c, strict=True)], dtype=object)
        for name, f in named.items():
            value = f(independent(X))
            if isinstance(value, Dual):  # by the mean-value form, cut with the value on the box
                value = _intersection(f(c) + value.slope @ Q @ r, value.value)
            low, high = ranges.get(name, (np.inf, -np.inf))
            lowest, highest = np.nextafter((float(value.lower()), float(value.upper())), (-np.inf, np.inf))
            ranges[name] = min(low, float(lowest)), max(high, float(highest))
        if done == steps:
            return done, "", X, ranges
        new, images = step(c), step(independent(X))
        A = slopes(images, d) @ Q
        following = np.array([v.mid() for v in new], dtype=object)
        if not _all_finite(A) or not _all_finite(new):
            return done, "an enclosure meets a pole", X, ranges
        # columns sorted by their contribution; the entries of U are exact
        middle = np.array([[float(v.mid()) for v in row] for row in A])
        sizes = np.linalg.norm(middle, axis=0) * np.array([float(abs(v).upper()) for v in r])
        near = np.linalg.qr(middle[:, np.argsort(-sizes, kind="stable")])[0]
        U = np.array([[flint.arb(float(v)) for v in row] for row in near], dtype=object)
        back = np.array(flint.arb_mat(d, d, list(U.ravel())).inv().tolist(), dtype=object)
        inner = (back @ A) @ r + back @ (new - following)
        mapped = (getattr(v, "value", v) for v in images)
        box_of = np.array(
            [_intersection(a, b) for a, b in zip(following + U @ inner, mapped, strict=True)], dtype=object
        )
        if max(float(v.rad()) for v in box_of) > tolerance:
            return done, f"the next enclosure is wider than {tolerance:g}", X, ranges
        c, Q, r, X, done = following, U, inner, box_of, done + 1


def _intersection(a: Any, b: Any) -> Any:
    """The intersection of two enclosures of one number."""
    return a.intersection(b)


def _all_finite(values: Array) -> bool:
    return all(getattr(v, "is_finite", lambda: True)() for v in np.ravel(values))


# -- identities proved -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Proof:
    """A statement, whether it holds identically, and in which unknowns."""

    statement: str
    holds: bool
    unknowns: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.statement}: {'proved' if self.holds else 'false'}, for all {', '.join(self.unknowns)}"


@explained
def prove(claimed: System | Model, names: tuple[str, ...] = ("casimir", "energy"), n: int = 3) -> list[Proof]:
    """For each name, "casimir", "energy" or an integral of the record: f(step(z)) = f(z) identically.

    Of a system its parameters are unknowns too; of a model they are the values given.  Raises `InputError` without
    python-flint, for implicit maps, for states that are not free, and for names that the record does not state.
    """
    system = claimed.system if isinstance(claimed, Model) else claimed
    mapped = system.map
    if mapped is None or mapped.turn is not None or system.numbers != "any":
        raise InputError(f"{system.name} has no map that is a rational function: nothing can be proved.")
    if system.space.constraints:
        raise InputError(f"The coordinates of {system.name} are not free; prove it for the system that contains it.")
    functions = {"casimir": system.space.casimirs, "energy": system.energy, **system.integrals}
    for name in names:
        if functions.get(name) is None:
            raise InputError(f"{system.name} states no {shown(name)}; it states {', '.join(functions)}.")
    n = claimed.n if isinstance(claimed, Model) else n
    parameters = system.parameters if isinstance(claimed, System) else ()
    for p in parameters:
        if p.kind not in ("scalar", "vector"):
            raise InputError(f"The parameter {p.letter} of {system.name} is not a scalar or vector: give a model.")
    named = [*system.space.components, *((p.letter, p.kind) for p in parameters)]
    unknowns = (*coordinate_names(tuple(named), n), "eps")
    *coordinates, eps = generators(unknowns)
    values = algebra.restore(np.array(coordinates, dtype=object), [kind for _, kind in named], n)
    state, parameter_values = values[: len(system.space.letters)], values[len(system.space.letters) :]
    constants: dict[str, Any] = {"eps": eps, **{p.letter: v for p, v in zip(parameters, parameter_values, strict=True)}}
    if isinstance(claimed, Model):
        constants |= {k: rationals(v) for k, v in claimed.constants.items()}
    new = tuple(call(mapped.step, state, constants))
    proofs = []
    for name in names:
        before, after = (np.ravel(np.asarray(call(functions[name], z, constants), dtype=object)) for z in (state, new))
        holds = all(getattr(difference, "n", difference) == 0 for difference in after - before)
        proofs.append(Proof(f"{system.name}, n = {n}: {name}", holds, unknowns))
    return proofs
