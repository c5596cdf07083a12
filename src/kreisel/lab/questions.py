"""The questions of an investigation.  What their evidence carries is in `kreisel.lab.verdicts`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.lab import brackets, dynamics, growth, integrals
from kreisel.lab.confinement import singularities
from kreisel.lab.darboux import Darboux, darboux
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, Mod, Pole, random_residues
from kreisel.lab.hirota_kimura import Bases
from kreisel.lab.lax import Lax, lax
from kreisel.lab.numerical import Numerical, integrals_in_floats
from kreisel.lab.stated import Stated, stated
from kreisel.lab.subject import Subject
from kreisel.lab.verdicts import coefficients, enough, filled, rank_on_leaves

MONOMIALS = 400  # of the integral finder, as a rule
UNKNOWNS = 150  # of the search for brackets and volumes
ITERATES, FEWER = 9, 6  # with up to 6 coordinates, and beyond
MORE, GREAT = (14, 20, 28), 400  # where no recurrence is found and the degrees stay below
PERIODS = 24
DARBOUX = {2: (2, 4), 3: (2, 4), 4: (2,)}  # number of coordinates -> degrees
QUOTIENTS = {2: 4, 3: 2}
ORBITS = 3
CLOSE = 2.0**24 * float(np.finfo(float).eps)
TIME, COUNTS = 0.5, (64, 128, 256, 512)  # for the order


@dataclass(frozen=True)
class Finding:
    """A question, the answer and the evidence; `weight` +1 for integrability, -1 against it, 0 neither."""

    question: str
    answer: str
    evidence: str
    weight: int = 0


# -- the questions ----------------------------------------------------------------------------------


class Clues:
    """What one question found for the others."""

    def __init__(self, what: Subject, degree: int | None, iterates: int | None, steps: int, seed: int):
        self.what, self.steps, self.seed = what, steps, seed
        self.given = iterates is not None
        self.iterates = iterates or (ITERATES if what.dim <= 6 else FEWER)
        self.degree = degree or next(d for d in (4, 3, 2, 1) if math.comb(what.dim + d, d) <= MONOMIALS or d == 1)
        self.tensor: Callable[[Array], Array] | None = None  # of a bracket that is preserved
        self.unaided: list[Callable[[Array], Array]] = []  # all brackets that were found
        self.leaves = False  # the Casimirs that the record states are conserved
        self.growth: growth.Growth | None = None
        self.found: list[Any] = []
        self.bases: Bases | None = None  # where they give more integrals
        self.volume = ""  # an invariant one
        self.period = 0
        self._darboux: dict[int, Darboux | None] = {}
        self.clock = ""  # a coordinate that counts the steps
        self.lax: Lax | None = None
        self.ranks: Lax | None = None
        self.numeric: Numerical | None = None  # of a map that is no rational function
        self.in_floats = False
        self.orbits: list[dynamics.Dynamics] = []

    def darboux(self, degree: int) -> Darboux | None:
        """Darboux polynomials of maps of few free coordinates."""
        if degree not in self._darboux:
            self._darboux[degree] = self._looked_for(degree)
        return self._darboux[degree]

    def _looked_for(self, degree: int) -> Darboux | None:
        if not self.rational or self.what.dim not in DARBOUX or self.what.model is not None:
            return None
        try:
            return darboux(replace(self.what, start=None), degree, self.seed)
        except (InputError, ArithmeticError):
            return None

    @property
    def rational(self) -> bool:
        return not self.what.implicit

    def float_jacobian(self) -> tuple[Array, Array, Array]:
        """A point, its image and the Jacobian in floats."""
        x = dynamics.float_start(self.what, self.seed)
        new = self.what.step(independent(x), **self.what.floats)
        values = np.array([float(getattr(v, "value", v)) for v in new])
        return x, values, np.asarray(slopes(new, self.what.dim), dtype=float)


def _poisson(c: Clues) -> Finding:
    what = c.what
    if what.tensor is not None and c.rational:
        if brackets.preserves(what, what.tensor, c.seed):
            c.tensor, c.leaves = what.tensor, _casimirs_conserved(c)
            return Finding("Poisson", "yes", "J Pi(x) J^T = Pi(x') modulo a prime at 20 random points, its own bracket")
        return _other_bracket(c, "its own bracket is not preserved")
    if what.tensor is not None:
        x, new, J = c.float_jacobian()
        before, after = (np.asarray(what.tensor(v), dtype=float) for v in (x, new))
        off = abs(J @ before @ J.T - after).max() / (1 + abs(after).max())
        if off < CLOSE:
            c.tensor, c.in_floats, c.leaves = what.tensor, True, _casimirs_conserved(c)
        return Finding("Poisson", "yes" if off < CLOSE else "no", f"J Pi(x) J^T - Pi(x') is {off:.1e} in floats")
    return _other_bracket(c, "no bracket is stated")


def _casimirs_conserved(c: Clues) -> bool:
    what = c.what
    if what.casimirs is None:
        return False
    if not c.rational:
        x, new, _ = c.float_jacobian()
        return bool(np.abs(what.casimirs(new) - what.casimirs(x)).max() < CLOSE * (1 + np.abs(what.casimirs(x)).max()))
    x = what.some_orbits(PRIMES[0], c.seed + 23, 8, 1)
    old, new = (what.casimirs(np.array([Mod(v, PRIMES[0]) for v in z], dtype=object)) for z in x)
    return all(not np.any((v - w).v) for v, w in zip(old, new, strict=True))


def _other_bracket(c: Clues, why: str) -> Finding:
    if c.what.dim < 2:
        return Finding("Poisson", "does not apply", "one coordinate")
    pairs = math.comb(c.what.dim, 2)
    degree = next((d for d in (2, 1, 0) if pairs * math.comb(c.what.dim + d, d) <= UNKNOWNS), 0)
    found = brackets.brackets(c.what, degree, c.seed)
    good = next((b for b in found if b.poisson), None)
    if good is None:
        return Finding("Poisson", "no bracket found", f"{why}; none with entries of degree {degree} or less")
    c.unaided = [_tensor_of(b, c.what.dim) for b in found if b.poisson]
    c.tensor = c.unaided[0]
    return Finding("Poisson", "yes", f"{why}, but {good} is preserved ({len(found)} of degree {degree} or less)")


def _tensor_of(bivector: brackets.Bivector, dim: int) -> Callable[[Array], Array]:
    def tensor(x: Array) -> Array:
        out = np.zeros((dim, dim), dtype=object)
        for (i, j), f in bivector.entries.items():
            out[i, j] = f(x)
            out[j, i] = -out[i, j]
        return out

    return tensor


def _volume(c: Clues) -> Finding:
    if c.what.model is not None and c.what.model.system.space.constraints:
        answer = "yes" if c.tensor is not None else "unknown"
        return Finding(
            "volume", answer, "its coordinates are not free; a Poisson map preserves the volume of the leaves"
        )
    if not c.rational:
        det = float(np.linalg.det(c.float_jacobian()[2]))
        return Finding("volume", "yes" if abs(det - 1) < CLOSE else "no", f"det J - 1 = {det - 1:.1e} in floats")
    degree = next(d for d in (2, 1, 0) if math.comb(c.what.dim + d, d) <= UNKNOWNS // 4 or d == 0)
    found = [str(v) for v in brackets.volumes(c.what, degree, c.seed)]
    for further in DARBOUX.get(c.what.dim, ()):
        more = None if found else c.darboux(further)
        found = found if more is None else [f"dx / ({D})" for D in more.densities]
    if not found:
        return Finding("volume", "none found", f"no density or inverse density of degree {degree} or less")
    c.volume = found[0]
    return Finding("volume", "yes", f"{found[0]}: rho(x') det J = rho(x) modulo three primes")


def _period(c: Clues) -> Finding:
    if not c.rational:
        return Finding("period", "does not apply", c.what.implicit)
    periods = {_first_return(c, p) for p in PRIMES[:2]}
    c.period = max(periods) if 0 not in periods else 0
    if c.period:
        return Finding("period", str(c.period), f"step^{c.period} = 1 at random points modulo two primes", 1)
    return Finding("period", "none", f"no iterate up to {PERIODS} is the identity" + _clock(c))


def _first_return(c: Clues, p: int) -> int:
    x = c.what.some_orbits(p, c.seed + 17, 8, PERIODS)
    return next((k for k in range(1, PERIODS + 1) if (x[k] == x[0]).all()), 0)


def _clock(c: Clues) -> str:
    """A coordinate that goes up by the same number in every step."""
    x, p = c.what.some_orbits(PRIMES[0], c.seed + 19, 8, 4), PRIMES[0]
    steps = np.diff(x, axis=0) % p  # (steps, d, lanes)
    same = [i for i in range(c.what.dim) if (steps[:, i] == steps[0, i, 0]).all() and steps[0, i, 0]]
    c.clock = c.what.names[same[0]] if same else ""
    return f"; {c.clock} counts the steps" if same else ""


def _reversible(c: Clues) -> Finding:
    what = c.what
    if what.involution is not None:
        held = _reverses(c, what.involution)
        return Finding("reversible", "yes" if held else "no", "R step R step = 1 for the involution of the record")
    if not c.rational:
        return Finding("reversible", "unknown", "no involution is stated")
    tried = 0
    for R in _involutions(what.dim):
        tried += 1
        if _reverses(c, R):
            shown = ", ".join(f"{'-' if s < 0 else ''}{what.names[i]}" for i, s in _images(R, what.dim))
            return Finding("reversible", "yes", f"R step R step = 1 for R: ({', '.join(what.names)}) -> ({shown})")
    return Finding("reversible", "unknown", f"none of {tried} changes of signs, with a swap in the plane, reverses it")


def _images(R: Callable[..., Array], dim: int) -> list[tuple[int, int]]:
    image = R(np.arange(1, dim + 1))
    return [(abs(int(v)) - 1, 1 if v > 0 else -1) for v in image]


def _involutions(dim: int) -> list[Callable[..., Array]]:
    swaps = [list(range(dim))] + ([[1, 0]] if dim == 2 else [])
    out: list[Callable[..., Array]] = []
    for order, signs in itertools.product(swaps, itertools.product((1, -1), repeat=min(dim, 8))):
        s = np.array([*signs, *[1] * (dim - len(signs))])
        if order == [1, 0] and s[0] != s[1]:
            continue  # of order 4
        out.append(lambda x, order=order, s=s, **known: x[order] * s)
    return out


def _reverses(c: Clues, R: Callable[..., Array]) -> bool:
    what = c.what
    if not c.rational:
        known, x = what.floats, dynamics.float_start(what, c.seed)
        back = R(what.step(R(what.step(x, **known), **known), **known), **known)
        return bool(abs(back - x).max() < CLOSE)
    p = PRIMES[0]
    known, step = what.known(p), what.over(p)
    for attempt in range(5):
        try:
            x = what.point(random_residues(np.random.default_rng([c.seed, attempt, 11]), p, 4))
            back = R(step(R(step(x), **known)), **known)
            return not any(np.any((v - w).v) for v, w in zip(back, x, strict=True))
        except Pole:
            continue
    return False


def _order(c: Clues) -> Finding:
    what = c.what
    if what.flow is None:
        return Finding("order", "no flow stated", "nothing to compare the map with")
    if "eps" not in what.constants:
        return Finding("order", "no step stated", "the step takes no eps, its length in time")
    from scipy.integrate import solve_ivp

    from kreisel.lab.orders import fitted_orders

    x, known = dynamics.float_start(what, c.seed), what.floats
    rate: Any = what.flow
    try:
        exact = solve_ivp(lambda t, y: rate(y, **known), (0, TIME), x, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        ends = []
        for count in COUNTS:
            finer = replace(what, constants={**what.constants, "eps": TIME / count})
            ends.append(dynamics.CompiledOrbit(finer, x).advance(count)[0])
    except RunError as error:
        return Finding("order", "unknown", str(error))
    errors = np.array([abs(end - exact).max() for end in ends])
    (slope,) = fitted_orders(TIME / np.array(COUNTS), errors[:, None])
    agrees = slope > 0.8
    return Finding(
        "order",
        f"{slope:.2f}" if agrees else "not consistent",
        f"error against the flow over time {TIME:g} with {COUNTS[0]} to {COUNTS[-1]} steps: {errors[0]:.1e} to "
        f"{errors[-1]:.1e}",
    )


def _growth(c: Clues) -> Finding:
    if not c.rational:
        return Finding("degree growth", "does not apply", c.what.implicit)
    for iterates in sorted({c.iterates, *(() if c.given else MORE)}):
        found = c.growth = growth.growth(c.what, max(iterates, c.iterates), c.seed)
        if found.recurrence is not None or len(found.degrees) <= iterates or found.degrees[-1] > GREAT:
            break
    if found.recurrence is None:
        answer = f"entropy {found.entropy:.2g} ± {found.uncertainty:.1g}"
    elif found.power is None:
        answer = f"exponential, entropy {found.entropy:.6g}"
    else:
        answer = f"k^{found.power}, entropy 0"
    drops = f"; singularities confine first at iterate {found.drops[0]}" if found.drops else "; no degree is lost"
    evidence = f"degrees {', '.join(map(str, found.degrees))} on two primes{drops}"
    return Finding("degree growth", answer, evidence, 1 if found.power is not None else -1 if found.exponential else 0)


def _singularities(c: Clues) -> Finding:
    if not c.rational or c.what.dim != 2 or c.what.model is not None:
        return Finding("singularities", "not followed", "this needs a rational map of the plane")
    try:
        found = singularities(replace(c.what, start=None), seed=c.seed)
    except (InputError, ArithmeticError) as error:
        return Finding("singularities", "unknown", str(error))
    if not found:
        return Finding("singularities", "none", "no curve is contracted")
    answer = "confined" if all(s.confined for s in found) else "not all confined"
    return Finding("singularities", answer, "; ".join(map(str, found)))


def _integrals(c: Clues) -> Finding:
    what = c.what
    if not c.rational:
        try:
            numeric = c.numeric = integrals_in_floats(replace(what, tensor=c.tensor), 2, c.seed)
        except RunError as error:
            return Finding("integrals", "unknown", str(error))
        answer = (
            f"{numeric.count} of degree 2 or less, in floats; {numeric.on_leaf} on leaves of dimension {numeric.leaf}"
        )
        return Finding("integrals", answer, str(numeric), 1 if numeric.enough else 0)
    c.found = list(integrals.integrals(what, c.degree, seed=c.seed))
    rank_on_leaves(c)
    for degree in DARBOUX.get(what.dim, ()):
        more = None if filled(c) else c.darboux(degree)
        if more is not None and more.integrals:
            c.found = integrals.independent(what, [*c.found, *more.integrals], c.seed)
            rank_on_leaves(c)
    claimed = [] if filled(c) else stated(what, c.seed)
    if claimed:
        c.found = integrals.independent(what, [*c.found, *claimed], c.seed)
        rank_on_leaves(c)
    if not filled(c) and what.dim in QUOTIENTS:
        others = integrals.integrals(what, QUOTIENTS[what.dim], quotients=True, seed=c.seed)
        c.found = integrals.independent(what, [*c.found, *others], c.seed)
        rank_on_leaves(c)
    coefficients(c)
    ranks = c.ranks
    own = sum(isinstance(f, Stated) for f in c.found)
    count = f"{len(c.found) - own} of degree {c.degree} or less" + (f", {own} stated" if own else "")
    if ranks is not None:
        count += f"; {ranks.with_more} on leaves of dimension {ranks.leaf}, "
        count += "in involution" if ranks.involution else "not all in involution"
    answers = [count] if c.found else []
    shown = ["; ".join(_truncated(str(f)) for f in c.found) or f"none of degree {c.degree} or less"]
    if c.bases is not None and c.bases.integrals:
        answers.append(f"{c.bases.integrals} as coefficients")
        shown.append(f"Hirota-Kimura bases, {c.bases}")
    good = ranks is not None and enough(ranks)
    return Finding("integrals", "; ".join(answers) or "none found", "; ".join(shown), 1 if good else 0)


def _truncated(text: str) -> str:
    return text if len(text) < 160 else text[:150] + " ..."


def _lax(c: Clues) -> Finding:
    what = c.what
    if what.lax is None:
        return Finding("Lax pair", "none stated", "give lax and conjugator to test one")
    ranks = lax(replace(what, tensor=c.tensor), seed=c.seed)
    if ranks.isospectral is None and _isospectral_in_floats(c):
        ranks = replace(ranks, isospectral=True)
        c.in_floats = True
    c.lax = ranks
    answer = "complete" if ranks.complete else "superintegrable" if ranks.superintegrable else "not complete"
    if ranks.isospectral is not True:
        answer = "no Lax pair of this map"
    good = ranks.isospectral is True and ranks.involution is True and enough(ranks)
    return Finding("Lax pair", answer, str(ranks), 1 if good else 0)


def _isospectral_in_floats(c: Clues) -> bool:
    what, known = c.what, c.what.floats
    x: Array = dynamics.float_start(what, c.seed)
    matrix: Any = what.lax
    worst = 0.0
    for lam in (0.7, 1.9):
        old, new = (np.poly(np.asarray(matrix(z, lam, **known), dtype=float)) for z in (x, what.step(x, **known)))
        worst = max(worst, float(abs(old - new).max() / abs(old).max()))
    return worst < CLOSE


def _chaos(c: Clues) -> Finding:
    trouble = ""
    slow = c.what.model is not None and c.what.model.system.numbers == "jax"  # each step a root, found anew
    for k in range(ORBITS):
        try:
            c.orbits.append(dynamics.dynamics(c.what, steps=c.steps, count=1 if slow else None, seed=c.seed + 10 * k))
        except RunError as error:
            trouble = str(error)
    if not c.orbits:
        return Finding("Lyapunov", "unknown", trouble)
    kinds = ["chaotic" if o.chaotic else "regular" if o.regular else "unknown" for o in c.orbits]
    worst = max(c.orbits, key=lambda o: (o.chaotic, float(o.exponents[0])))
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return Finding("Lyapunov", f"{counts} of {len(kinds)} orbits", str(worst), -1 if worst.chaotic else 0)


QUESTIONS = (_period, _poisson, _volume, _reversible, _order, _growth, _singularities, _integrals, _lax, _chaos)
