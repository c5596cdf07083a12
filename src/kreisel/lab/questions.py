"""The questions of an investigation, and the weight of their evidence.

The rule of the verdict.

    periodic         an iterate is the identity.
    linear           all iterates have degree 1, and the integrals do not make it integrable.
    integrable       the map preserves a Poisson bracket and maps each of its leaves to itself, and half as many
                     independent functions in involution as a leaf has dimensions are conserved (Liouville), or so many
                     more that the leaf is filled: rank + dimension of the tori = dimension of the leaf
                     (superintegrable); or d - 1 integrals and a volume of d dimensions are conserved, which are a
                     bracket with d - 2 Casimirs, and one integral; the coefficients of Hirota-Kimura bases are
                     integrals.  Exact identities at random points; of implicit maps in floats, where they must be
                     conserved to round-off, with a gap in the singular values.
    not integrable   the degrees of the iterates grow exponentially, by a recurrence or by an estimate beyond its
                     uncertainty; or an orbit is chaotic (a float experiment, not a proof).
    undecided        everything else, evidence for both, and maps with a coordinate that counts the steps.
"""

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
from kreisel.lab.brackets import Lax, counted, lax
from kreisel.lab.darboux import Bases, Darboux, bases, darboux
from kreisel.lab.exact import PRIMES, Mod, Pole, independent, random_residues, residues_at, slopes
from kreisel.lab.growth import singularities
from kreisel.lab.integrals import Numerical, Stated, integrals_in_floats, stated
from kreisel.lab.subject import Subject

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
LARGEST = 8  # coordinates of maps of which Hirota-Kimura bases are looked for


@dataclass(frozen=True)
class Finding:
    """A question, the answer and the evidence."""

    question: str
    answer: str
    evidence: str


class Clues:
    """Results of one question that others use."""

    def __init__(self, subject: Subject, degree: int | None, iterates: int | None, steps: int, seed: int):
        self.subject, self.steps, self.seed = subject, steps, seed
        self.fixed_iterates = iterates is not None
        self.iterates = iterates or (ITERATES if subject.dim <= 6 else FEWER)
        self.degree = degree or next(d for d in (4, 3, 2, 1) if math.comb(subject.dim + d, d) <= MONOMIALS or d == 1)
        self.tensor: Callable[[Array], Array] | None = None  # of a bracket that is preserved
        self.unaided: list[Callable[[Array], Array]] = []  # all brackets that were found
        self.leaves = False  # the Casimirs that the record states are conserved
        self.growth: growth.Growth | None = None
        self.integrals: list[Any] = []
        self.bases: Bases | None = None  # where they give more integrals
        self.volume = ""  # an invariant one
        self.period = 0
        self._darboux: dict[int, Darboux | None] = {}
        self.clock = ""  # a coordinate that counts the steps
        self.lax: Lax | None = None
        self.ranks: Lax | None = None
        self.numeric: Numerical | None = None  # of a map that is not a rational function
        self.in_floats = False
        self.orbits: list[dynamics.Dynamics] = []

    def darboux(self, degree: int) -> Darboux | None:
        """Darboux polynomials of maps of few free coordinates."""
        if degree not in self._darboux:
            self._darboux[degree] = self._looked_for(degree)
        return self._darboux[degree]

    def _looked_for(self, degree: int) -> Darboux | None:
        if not self.rational or self.subject.dim not in DARBOUX or self.subject.model is not None:
            return None
        try:
            return darboux(replace(self.subject, start=None), degree, self.seed)
        except (InputError, ArithmeticError):
            return None

    @property
    def rational(self) -> bool:
        return not self.subject.implicit

    def float_jacobian(self) -> tuple[Array, Array, Array]:
        """A point, its image and the Jacobian in floats."""
        x = dynamics.float_start(self.subject, self.seed)
        new = self.subject.step(independent(x), **self.subject.floats)
        values = np.array([float(getattr(v, "value", v)) for v in new])
        return x, values, np.asarray(slopes(new, self.subject.dim), dtype=float)


# -- the verdict -------------------------------------------------------------------------------------


def liouville(subject: Subject, tensor: Callable[[Array], Array], functions: list[Any], seed: int) -> Lax:
    """The counts of `Lax` for functions that are known to be conserved."""
    p = PRIMES[0]
    x = subject.point(random_residues(np.random.default_rng([seed, 5]), p, 1))
    point = residues_at(x, 1, p)[0].astype(object)
    G = np.array([f.gradient_at(point, p) for f in functions], dtype=object)
    return counted(replace(subject, tensor=tensor), x, G, G, p, isospectral=True)


def enough(ranks: Lax) -> bool:
    """Whether integrals of these counts fill a leaf: Liouville, or superintegrable."""
    if ranks.leaf == 0:
        return False
    return (bool(ranks.involution) and ranks.on_leaf == ranks.needed) or ranks.with_more + ranks.torus == ranks.leaf


def rank_on_leaves(c: Clues) -> None:
    """The counts of the integrals for the bracket; of those that were found, for one whose leaves they fill, if any."""
    if c.tensor is None or not c.integrals:
        return
    first, *others = c.unaided or [c.tensor]
    for tensor in (first, *others, first):
        c.tensor, c.ranks = tensor, liouville(c.subject, tensor, c.integrals, c.seed)
        if filled(c):
            break


def by_volume(c: Clues) -> bool:
    """Whether all integrals but one and a volume are conserved: {x_i, x_j} = minors of the gradients / rho."""
    return bool(c.volume) and 1 < c.subject.dim <= max(len(c.integrals), c.bases.integrals if c.bases else 0) + 1


def coefficients(c: Clues) -> None:
    """Looks for Hirota-Kimura bases: where integrals are too few, and the degrees may not grow."""
    if filled(c) or (c.growth is not None and c.growth.exponential) or c.subject.dim > LARGEST:
        return
    try:
        hirota_kimura = bases(c.subject, 2, c.seed)
    except InputError:
        return
    if hirota_kimura.integrals > len(c.integrals):
        c.bases = hirota_kimura


def filled(c: Clues) -> bool:
    """Whether the integrals make the map integrable."""
    return by_volume(c) or (c.ranks is not None and leaves_stay(c) and enough(c.ranks))


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def leaves_stay(c: Clues) -> bool:
    """Whether each leaf of the bracket is mapped to itself: its Casimirs are conserved, as many as it has.

    A map may preserve a bracket and permute its leaves: z' = 2 z next to a rotation of (x, y), with {x, y} = 1.
    """
    counts = [
        ranks.rank - ranks.on_leaf == ranks.dimension - ranks.leaf for ranks in (c.ranks, c.lax) if ranks is not None
    ]
    if c.numeric is not None:
        counts.append(c.numeric.count - c.numeric.on_leaf == c.subject.dim - c.numeric.leaf)
    return c.leaves or any(counts)


def verdict(c: Clues) -> tuple[str, str]:
    """The verdict and its reason."""
    if c.period:
        return "periodic", f"step^{c.period} is the identity"
    for_it, against = [], []
    where = "in floats" if c.in_floats else "exactly"
    if c.tensor is not None and leaves_stay(c):
        if c.ranks is not None and enough(c.ranks):
            count = _counted(c.ranks.with_more, "independent integral")
            for_it.append(f"{count} on leaves of dimension {c.ranks.leaf} found exactly")
        if c.lax is not None and c.lax.isospectral and c.lax.involution and enough(c.lax):
            more = "" if c.lax.on_leaf == c.lax.needed else ", with the further integrals of the record"
            for_it.append(f"a Lax pair whose spectrum{more} is complete, conserved {where}")
        if c.numeric is not None and c.numeric.enough:
            count = _counted(c.numeric.on_leaf, "integral")
            for_it.append(f"{count} on leaves of dimension {c.numeric.leaf} conserved in floats")
    if not for_it and by_volume(c):
        count = _counted(max(len(c.integrals), c.bases.integrals if c.bases else 0), "independent integral")
        for_it.append(f"{count} and {c.volume} in {c.subject.dim} dimensions, found exactly")
    if c.growth is not None and c.growth.exponential:
        against.append(f"the degrees grow exponentially (entropy {c.growth.entropy:.3g})")
    chaotic = [o for o in c.orbits if o.chaotic]
    if chaotic:
        against.append(f"{len(chaotic)} of {len(c.orbits)} orbits are chaotic in floats")
    if for_it and against:
        return "undecided", f"the evidence contradicts itself: {'; '.join(for_it)}; but {'; '.join(against)}"
    if for_it and not c.clock:
        return "integrable", "; ".join(for_it)
    if against:
        return "not integrable", "; ".join(against)
    if c.growth is not None and set(c.growth.degrees) == {1}:
        return "linear", "all iterates have degree 1: they are the powers of one matrix in projective coordinates"
    if c.clock:
        squares = c.growth is not None and c.growth.power == 2
        like = "; the degrees grow like k^2, as for discrete Painleve equations" if squares else ""
        reason = f"{c.clock} goes up by the same number in every step: the map is not autonomous, no orbit is bounded"
        return "undecided", reason + like
    if c.tensor is not None and not leaves_stay(c):
        return "undecided", (
            "the Casimirs of the bracket that was found are not all among the integrals: the map may permute its leaves"
        )
    few = f" ({c.bases.integrals} as coefficients of Hirota-Kimura bases)" if c.bases else ""
    return "undecided", f"neither enough integrals{few}, nor exponential growth, nor a chaotic orbit was found"


# -- the questions -----------------------------------------------------------------------------------


def _poisson(c: Clues) -> Finding:
    subject = c.subject
    if subject.tensor is not None and c.rational:
        if brackets.preserves(subject, subject.tensor, c.seed):
            c.tensor, c.leaves = subject.tensor, _casimirs_conserved(c)
            return Finding(
                "Poisson", "yes", "J Pi(x) J^T = Pi(x') modulo a prime at 20 random points, the bracket given with it"
            )
        return _other_bracket(c, "the bracket given with it is not preserved")
    if subject.tensor is not None:
        x, new, J = c.float_jacobian()
        before, after = (np.asarray(subject.tensor(v), dtype=float) for v in (x, new))
        off = abs(J @ before @ J.T - after).max() / (1 + abs(after).max())
        if off < CLOSE:
            c.tensor, c.in_floats, c.leaves = subject.tensor, True, _casimirs_conserved(c)
        return Finding("Poisson", "yes" if off < CLOSE else "no", f"J Pi(x) J^T - Pi(x') is {off:.1e} in floats")
    return _other_bracket(c, "no bracket is stated")


def _casimirs_conserved(c: Clues) -> bool:
    subject = c.subject
    if subject.casimirs is None:
        return False
    if not c.rational:
        x, new, _ = c.float_jacobian()
        return bool(
            np.abs(subject.casimirs(new) - subject.casimirs(x)).max() < CLOSE * (1 + np.abs(subject.casimirs(x)).max())
        )
    x = subject.some_orbits(PRIMES[0], c.seed + 23, 8, 1)
    old, new = (subject.casimirs(np.array([Mod(v, PRIMES[0]) for v in z], dtype=object)) for z in x)
    return all(not np.any((v - w).v) for v, w in zip(old, new, strict=True))


def _other_bracket(c: Clues, why: str) -> Finding:
    if c.subject.dim < 2:
        return Finding("Poisson", "does not apply", "one coordinate")
    pairs = math.comb(c.subject.dim, 2)
    degree = next((d for d in (2, 1, 0) if pairs * math.comb(c.subject.dim + d, d) <= UNKNOWNS), 0)
    bivectors = brackets.brackets(c.subject, degree, c.seed)
    good = next((b for b in bivectors if b.poisson), None)
    if good is None:
        return Finding("Poisson", "no bracket found", f"{why}; none with entries of degree {degree} or less")
    c.unaided = [_tensor_of(b, c.subject.dim) for b in bivectors if b.poisson]
    c.tensor = c.unaided[0]
    return Finding("Poisson", "yes", f"{why}, but {good} is preserved ({len(bivectors)} of degree {degree} or less)")


def _tensor_of(bivector: brackets.Bivector, dim: int) -> Callable[[Array], Array]:
    def tensor(x: Array) -> Array:
        out = np.zeros((dim, dim), dtype=object)
        for (i, j), f in bivector.entries.items():
            out[i, j] = f(x)
            out[j, i] = -out[i, j]
        return out

    return tensor


def _volume(c: Clues) -> Finding:
    if c.subject.model is not None and c.subject.model.system.space.constraints:
        answer = "yes" if c.tensor is not None else "unknown"
        return Finding(
            "volume", answer, "its coordinates are not free; a Poisson map preserves the volume of the leaves"
        )
    if not c.rational:
        det = float(np.linalg.det(c.float_jacobian()[2]))
        return Finding("volume", "yes" if abs(det - 1) < CLOSE else "no", f"det J - 1 = {det - 1:.1e} in floats")
    degree = next(d for d in (2, 1, 0) if math.comb(c.subject.dim + d, d) <= UNKNOWNS // 4 or d == 0)
    densities = [str(v) for v in brackets.volumes(c.subject, degree, c.seed)]
    for further in DARBOUX.get(c.subject.dim, ()):
        more = None if densities else c.darboux(further)
        densities = densities if more is None else [f"dx / ({D})" for D in more.densities]
    if not densities:
        return Finding("volume", "none found", f"no density or inverse density of degree {degree} or less")
    c.volume = densities[0]
    return Finding("volume", "yes", f"{densities[0]}: rho(x') det J = rho(x) modulo three primes")


def _period(c: Clues) -> Finding:
    if not c.rational:
        return Finding("period", "does not apply", c.subject.implicit)
    periods = {_first_return(c, p) for p in PRIMES[:2]}
    c.period = max(periods) if 0 not in periods else 0
    if c.period:
        return Finding("period", str(c.period), f"step^{c.period} = 1 at random points modulo two primes")
    return Finding("period", "none", f"no iterate up to {PERIODS} is the identity" + _clock(c))


def _first_return(c: Clues, p: int) -> int:
    x = c.subject.some_orbits(p, c.seed + 17, 8, PERIODS)
    return next((k for k in range(1, PERIODS + 1) if (x[k] == x[0]).all()), 0)


def _clock(c: Clues) -> str:
    """A coordinate that goes up by the same number in every step."""
    x, p = c.subject.some_orbits(PRIMES[0], c.seed + 19, 8, 4), PRIMES[0]
    steps = np.diff(x, axis=0) % p  # (steps, d, lanes)
    same = [i for i in range(c.subject.dim) if (steps[:, i] == steps[0, i, 0]).all() and steps[0, i, 0]]
    c.clock = c.subject.names[same[0]] if same else ""
    return f"; {c.clock} counts the steps" if same else ""


def _reversible(c: Clues) -> Finding:
    subject = c.subject
    if subject.involution is not None:
        held = _reverses(c, subject.involution)
        return Finding("reversible", "yes" if held else "no", "R step R step = 1 for the involution of the record")
    if not c.rational:
        return Finding("reversible", "unknown", "no involution is stated")
    tried = 0
    for R in _involutions(subject.dim):
        tried += 1
        if _reverses(c, R):
            shown = ", ".join(f"{'-' if s < 0 else ''}{subject.names[i]}" for i, s in _images(R, subject.dim))
            return Finding("reversible", "yes", f"R step R step = 1 for R: ({', '.join(subject.names)}) -> ({shown})")
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
        out.append(lambda x, order=order, s=s, **constants: x[order] * s)
    return out


def _reverses(c: Clues, R: Callable[..., Array]) -> bool:
    subject = c.subject
    if not c.rational:
        constants, x = subject.floats, dynamics.float_start(subject, c.seed)
        back = R(subject.step(R(subject.step(x, **constants), **constants), **constants), **constants)
        return bool(abs(back - x).max() < CLOSE)
    p = PRIMES[0]
    constants, step = subject.modulo(p), subject.over(p)
    for attempt in range(5):
        try:
            x = subject.point(random_residues(np.random.default_rng([c.seed, attempt, 11]), p, 4))
            back = R(step(R(step(x), **constants)), **constants)
            return not any(np.any((v - w).v) for v, w in zip(back, x, strict=True))
        except Pole:
            continue
    return False


def _order(c: Clues) -> Finding:
    subject = c.subject
    if subject.flow is None:
        return Finding("order", "no flow stated", "nothing to compare the map with")
    if "eps" not in subject.constants:
        return Finding("order", "no step stated", "the step has no parameter eps, its length in time")
    from scipy.integrate import solve_ivp

    from kreisel.lab.law import fitted_orders

    x, constants = dynamics.float_start(subject, c.seed), subject.floats
    rate: Any = subject.flow
    try:
        exact = solve_ivp(lambda t, y: rate(y, **constants), (0, TIME), x, method="DOP853", rtol=1e-13, atol=1e-14).y[
            :, -1
        ]
        ends = []
        for count in COUNTS:
            finer = replace(subject, constants={**subject.constants, "eps": TIME / count})
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
        return Finding("degree growth", "does not apply", c.subject.implicit)
    for iterates in sorted({c.iterates, *(() if c.fixed_iterates else MORE)}):
        growing = c.growth = growth.growth(c.subject, max(iterates, c.iterates), c.seed)
        if growing.recurrence is not None or len(growing.degrees) <= iterates or growing.degrees[-1] > GREAT:
            break
    if growing.recurrence is None:
        answer = f"entropy {growing.entropy:.2g} ± {growing.uncertainty:.1g}"
    elif growing.power is None:
        answer = f"exponential, entropy {growing.entropy:.6g}"
    else:
        answer = f"k^{growing.power}, entropy 0"
    drops = f"; singularities confine first at iterate {growing.drops[0]}" if growing.drops else "; no degree is lost"
    evidence = f"degrees {', '.join(map(str, growing.degrees))} on two primes{drops}"
    return Finding("degree growth", answer, evidence)


def _singularities(c: Clues) -> Finding:
    if not c.rational or c.subject.dim != 2 or c.subject.model is not None:
        return Finding("singularities", "not followed", "this needs a rational map of the plane")
    try:
        curves = singularities(replace(c.subject, start=None), seed=c.seed)
    except (InputError, ArithmeticError) as error:
        return Finding("singularities", "unknown", str(error))
    if not curves:
        return Finding("singularities", "none", "no curve is contracted")
    answer = "confined" if all(s.confined for s in curves) else "not all confined"
    return Finding("singularities", answer, "; ".join(map(str, curves)))


def _integrals(c: Clues) -> Finding:
    subject = c.subject
    if not c.rational:
        try:
            numeric = c.numeric = integrals_in_floats(replace(subject, tensor=c.tensor), 2, c.seed)
        except RunError as error:
            return Finding("integrals", "unknown", str(error))
        answer = (
            f"{numeric.count} of degree 2 or less, in floats; {numeric.on_leaf} on leaves of dimension {numeric.leaf}"
        )
        return Finding("integrals", answer, str(numeric))
    c.integrals = list(integrals.integrals(subject, c.degree, seed=c.seed))
    rank_on_leaves(c)
    for degree in DARBOUX.get(subject.dim, ()):
        more = None if filled(c) else c.darboux(degree)
        if more is not None and more.integrals:
            c.integrals = integrals.without_dependent(subject, [*c.integrals, *more.integrals], c.seed)
            rank_on_leaves(c)
    claimed = [] if filled(c) else stated(subject, c.seed)
    if claimed:
        c.integrals = integrals.without_dependent(subject, [*c.integrals, *claimed], c.seed)
        rank_on_leaves(c)
    if not filled(c) and subject.dim in QUOTIENTS:
        others = integrals.integrals(subject, QUOTIENTS[subject.dim], quotients=True, seed=c.seed)
        c.integrals = integrals.without_dependent(subject, [*c.integrals, *others], c.seed)
        rank_on_leaves(c)
    coefficients(c)
    ranks = c.ranks
    of_record = sum(isinstance(f, Stated) for f in c.integrals)
    count = f"{len(c.integrals) - of_record} of degree {c.degree} or less" + (
        f", {of_record} stated" if of_record else ""
    )
    if ranks is not None:
        count += f"; {ranks.with_more} on leaves of dimension {ranks.leaf}, "
        count += "in involution" if ranks.involution else "not all in involution"
    answers = [count] if c.integrals else []
    shown = ["; ".join(_truncated(str(f)) for f in c.integrals) or f"none of degree {c.degree} or less"]
    if c.bases is not None and c.bases.integrals:
        answers.append(f"{c.bases.integrals} as coefficients")
        shown.append(f"Hirota-Kimura bases, {c.bases}")
    return Finding("integrals", "; ".join(answers) or "none found", "; ".join(shown))


def _truncated(text: str) -> str:
    return text if len(text) < 160 else text[:150] + " ..."


def _lax(c: Clues) -> Finding:
    subject = c.subject
    if subject.lax is None and subject.model is not None and subject.model.map.pencil is not None:
        return Finding("Lax pair", "of a pencil", "the law discrete-lax-pencil tests it")
    if subject.lax is None:
        return Finding("Lax pair", "none stated", "give lax and conjugator to test one")
    ranks = lax(replace(subject, tensor=c.tensor), seed=c.seed)
    if ranks.isospectral is None and _isospectral_in_floats(c):
        ranks = replace(ranks, isospectral=True)
        c.in_floats = True
    c.lax = ranks
    answer = "complete" if ranks.complete else "superintegrable" if ranks.superintegrable else "not complete"
    if ranks.isospectral is not True:
        answer = "no Lax pair of this map"
    return Finding("Lax pair", answer, str(ranks))


def _isospectral_in_floats(c: Clues) -> bool:
    subject, constants = c.subject, c.subject.floats
    x: Array = dynamics.float_start(subject, c.seed)
    matrix: Any = subject.lax
    worst = 0.0
    for lam in (0.7, 1.9):
        old, new = (
            np.poly(np.asarray(matrix(z, lam, **constants), dtype=float)) for z in (x, subject.step(x, **constants))
        )
        worst = max(worst, float(abs(old - new).max() / abs(old).max()))
    return worst < CLOSE


def _chaos(c: Clues) -> Finding:
    c.orbits, trouble = dynamics.several(c.subject, c.steps, ORBITS, c.seed)
    if not c.orbits:
        return Finding("Lyapunov", "unknown", trouble)
    kinds = ["chaotic" if o.chaotic else "regular" if o.regular else "unknown" for o in c.orbits]
    worst = max(c.orbits, key=lambda o: (o.chaotic, float(o.exponents[0])))
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return Finding("Lyapunov", f"{counts} of {len(kinds)} orbits", str(worst))


QUESTIONS = (_period, _poisson, _volume, _reversible, _order, _growth, _singularities, _integrals, _lax, _chaos)
