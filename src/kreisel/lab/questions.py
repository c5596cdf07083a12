"""The questions of an investigation, and the weight of their evidence.

A map is integrable if its integrals fill each leaf of a bracket that it preserves, and it maps each leaf to itself:
half the dimension in involution (Liouville), or rank + dimension of the tori = dimension of the leaf; or if d - 1
integrals and a volume of d dimensions are conserved, which are a bracket with d - 2 Casimirs, and one integral.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.lab import brackets, dynamics, growth, integrals
from kreisel.lab.brackets import Lax, counted
from kreisel.lab.darboux import Bases, Darboux, bases, darboux
from kreisel.lab.modular import PRIMES, gradients, random_residues
from kreisel.lab.subject import CLOSE, Subject, difference, differential, float_start

MONOMIALS = 400  # of the integral finder, as a rule
UNKNOWNS = 150  # of the search for brackets and volumes
ITERATES, FEWER = 9, 6  # with up to 6 coordinates, and beyond
MORE, GREAT = (14, 20, 28), 400  # if no recurrence is found, or d coordinates may delay it, and degrees stay below
PERIODS = 24
DARBOUX = {2: (2, 4), 3: (2, 4), 4: (2,)}  # number of coordinates -> degrees
QUOTIENTS = {2: 4, 3: 2}
ORBITS = 3
TIME, COUNTS = 0.5, (64, 128, 256, 512)  # for the order
EXACT = 1e-13  # errors below it are errors of the flow: the map is exact, or of a high order
LARGEST, BASES = 8, 60  # coordinates of maps, and monomials beyond degree 2, of which Hirota-Kimura bases are sought


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
        self.numeric: integrals.Numerical | None = None  # of a map that is not a rational function
        self.in_floats = False
        self.orbits: list[dynamics.Dynamics] = []

    def darboux(self, degree: int) -> Darboux | None:
        """Darboux polynomials of maps of few free coordinates."""
        if not self.rational or self.subject.dim not in DARBOUX or self.subject.model is not None:
            return None
        if degree not in self._darboux:
            try:
                self._darboux[degree] = darboux(replace(self.subject, start=None), degree, self.seed)
            except (InputError, ArithmeticError):
                self._darboux[degree] = None
        return self._darboux[degree]

    @property
    def rational(self) -> bool:
        return not self.subject.implicit

    @property
    def independent(self) -> int:
        """How many independent integrals are known, as functions or as coefficients of bases."""
        return max(len(self.integrals), self.bases.integrals if self.bases else 0)


# -- the verdict -------------------------------------------------------------------------------------


def liouville(
    subject: Subject,
    tensor: Callable[[Array], Array],
    functions: list[Any],
    seed: int,
    coefficients: Bases | None = None,
) -> Lax:
    """The counts of `Lax` for functions that are known to be conserved, and coefficients of bases if they are given."""
    x = subject.point(random_residues(np.random.default_rng([seed, 5]), PRIMES[0], 1))
    x, further = (x, []) if coefficients is None else (coefficients.point, [coefficients.slopes])
    G = np.concatenate([gradients(functions, x, PRIMES[0]), *further])
    return counted(replace(subject, tensor=tensor), x, G, G, PRIMES[0], isospectral=True)


def rank_on_leaves(c: Clues) -> None:
    """The counts of the integrals for the bracket; of those that were found, for one whose leaves they fill, if any."""
    if c.tensor is None or not c.independent:
        return
    first, *others = c.unaided or [c.tensor]
    for tensor in (first, *others, first):
        c.tensor, c.ranks = tensor, liouville(c.subject, tensor, c.integrals, c.seed, c.bases)
        if filled(c):
            break


def by_volume(c: Clues) -> bool:
    """Whether all integrals but one and a volume are conserved: {x_i, x_j} = minors of the gradients / rho."""
    return bool(c.volume) and 1 < c.subject.dim <= c.independent + 1


def filled(c: Clues) -> bool:
    """Whether the integrals make the map integrable."""
    return by_volume(c) or (c.ranks is not None and leaves_stay(c) and c.ranks.enough)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def leaves_stay(c: Clues) -> bool:
    """Whether each leaf of the bracket is mapped to itself: its Casimirs are conserved, as many as it has.

    A map may preserve a bracket and permute its leaves: z' = 2 z next to a rotation of (x, y), with {x, y} = 1.
    """
    counts = [
        ranks.rank - ranks.on_leaf == ranks.dimension - ranks.leaf for ranks in (c.ranks, c.lax) if ranks is not None
    ]
    if c.numeric is not None and c.numeric.clear:
        counts.append(c.numeric.count - c.numeric.on_leaf == c.subject.dim - c.numeric.leaf)
    return c.leaves or any(counts) or _is_one_leaf(c)


def _is_one_leaf(c: Clues) -> bool:
    """Whether the bracket has full rank: no Casimirs, and one leaf."""
    if c.tensor is None:
        return False
    tensor = np.asarray(c.tensor(float_start(c.subject, c.seed)), dtype=np.float64)
    return bool(np.linalg.matrix_rank(tensor) == c.subject.dim)


def verdict(c: Clues) -> tuple[str, str]:
    """The verdict and its reason."""
    if c.period:
        return "periodic", f"step^{c.period} is the identity"
    for_it, against = [], []
    where = "in floats" if c.in_floats else "exactly"
    if c.tensor is not None and leaves_stay(c):
        if c.ranks is not None and c.ranks.enough:
            count = _counted(c.ranks.with_more, "independent integral")
            for_it.append(f"{count} on leaves of dimension {c.ranks.leaf} found exactly")
        if c.lax is not None and c.lax.isospectral and c.lax.involution and c.lax.enough:
            supplement = "" if c.lax.on_leaf == c.lax.needed else ", with the further integrals of the record"
            for_it.append(f"a Lax pair whose spectrum{supplement} is complete, conserved {where}")
        if c.numeric is not None and c.numeric.enough:
            count = _counted(c.numeric.on_leaf, "integral")
            for_it.append(f"{count} on leaves of dimension {c.numeric.leaf} conserved in floats")
    if not for_it and by_volume(c):
        count = _counted(c.independent, "independent integral")
        for_it.append(f"{count} and {c.volume} in {c.subject.dim} dimensions, found exactly")
    if c.growth is not None and c.growth.exponential:
        against.append(f"the degrees grow exponentially (entropy {c.growth.estimate})")
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

Answer = tuple[str, str]  # with its evidence


def _poisson(c: Clues) -> Answer:
    subject, tensor, casimirs = c.subject, c.subject.tensor, c.subject.casimirs
    why = "no bracket is stated"
    if tensor is not None and subject.model is None and not brackets.obeys_jacobi(subject, tensor, c.seed):
        tensor, why = None, "the bracket given with it is not antisymmetric, or violates Jacobi's identity"
    if tensor is not None:
        off = brackets.defect(subject, tensor, c.seed)
        if off < CLOSE:
            c.tensor, c.in_floats = tensor, not c.rational
            c.leaves = casimirs is not None and CLOSE > difference(
                subject, lambda x, step, _: (casimirs(step(x)), casimirs(x)), c.seed
            )
        if not c.rational:
            return "yes" if off < CLOSE else "no", f"J Pi(x) J^T - Pi(x') is {off:.1e} in floats"
        if off < CLOSE:
            return "yes", "J Pi(x) J^T = Pi(x') at 20 random points modulo two primes, the bracket given with it"
        why = "the bracket given with it is not preserved"
    if subject.dim < 2:
        return "does not apply", "one coordinate"
    pairs = math.comb(subject.dim, 2)
    degree = next((d for d in (2, 1, 0) if pairs * math.comb(subject.dim + d, d) <= UNKNOWNS), 0)
    bivectors = brackets.brackets(subject, degree, c.seed)
    tensors = [partial(brackets.tensor_of, b.entries) for b in bivectors]

    def combined(x: Array) -> Array:  # of maps that do not interact, each with a bracket
        return sum(k * tensor(x) for k, tensor in enumerate(tensors, 1))

    c.unaided = [tensor for tensor, b in zip(tensors, bivectors, strict=True) if b.poisson]
    if len(tensors) > 1 and brackets.obeys_jacobi(subject, combined, c.seed):
        c.unaided.insert(0, combined)
    if not c.unaided:
        return "no bracket found", f"{why}; none with entries of degree {degree} or less"
    c.tensor, good = c.unaided[0], next((b for b in bivectors if b.poisson), "a combination of bivectors")
    return "yes", f"{why}, but {good} is preserved ({len(bivectors)} of degree {degree} or less)"


def _volume(c: Clues) -> Answer:
    subject = c.subject
    if subject.model is not None and subject.model.system.space.constraints:
        answer = "yes" if c.tensor is not None else "unknown"
        return answer, "its coordinates are not free; a Poisson map preserves the volume of the leaves"
    if not c.rational:
        _, J = differential(partial(subject.step, **subject.floats), float_start(subject, c.seed))
        off = float(np.linalg.det(J)) - 1
        return "yes" if abs(off) < CLOSE else "not dx", f"det J - 1 = {off:.1e} in floats"
    degree = next(d for d in (2, 1, 0) if math.comb(subject.dim + d, d) <= UNKNOWNS // 4 or d == 0)
    densities = [str(v) for v in brackets.volumes(subject, degree, c.seed)]
    for further in DARBOUX.get(subject.dim, ()):
        result = None if densities else c.darboux(further)
        densities = densities if result is None else [f"dx / ({D})" for D in result.densities]
    if not densities:
        return "none found", f"no density or inverse density of degree {degree} or less"
    c.volume = densities[0]
    return "yes", f"{densities[0]}: rho(x') det J = rho(x) modulo three primes"


def _period(c: Clues) -> Answer:
    if not c.rational:
        return "does not apply", c.subject.implicit
    orbits = [c.subject.some_orbits(p, c.seed + 17, 8, PERIODS) for p in PRIMES[:2]]
    returns = [next((k for k in range(1, PERIODS + 1) if (x[k] == x[0]).all()), 0) for x in orbits]
    c.period = max(returns) if all(returns) else 0
    if c.period:
        return str(c.period), f"step^{c.period} = 1 at random points modulo two primes"
    brackets.require_invertible(c.subject, c.seed)
    steps = np.diff(orbits[0][:5], axis=0) % PRIMES[0]  # (steps, d, lanes)
    same = [i for i in range(c.subject.dim) if (steps[:, i] == steps[0, i, 0]).all() and steps[0, i, 0]]
    c.clock = c.subject.names[same[0]] if same else ""
    return "none", f"no iterate up to {PERIODS} is the identity{f'; {c.clock} counts the steps' if same else ''}"


def _reversible(c: Clues) -> Answer:
    subject = c.subject

    def reverses(R: Callable[..., Array]) -> bool:
        def sides(x: Array, step: Callable[[Array], Array], constants: Mapping[str, Any]) -> tuple[Array, Array]:
            return R(step(R(step(x), **constants)), **constants), x

        try:
            return difference(subject, sides, c.seed, 4) < CLOSE
        except InputError:
            return False

    if subject.involution is not None:
        return "yes" if reverses(subject.involution) else "no", "R step R step = 1 for the involution of the record"
    if not c.rational:
        return "unknown", "no involution is stated"
    places, count = np.arange(subject.dim), 0
    for order in [places] + ([places[::-1]] if subject.dim == 2 else []):
        for signs in itertools.product((1, -1), repeat=min(subject.dim, 8)):
            s = np.array([*signs, *[1] * (subject.dim - len(signs))])
            if order[0] != 0 and s[0] != s[1]:  # of order 4
                continue
            count += 1
            if reverses(lambda x, order=order, s=s, **constants: x[order] * s):
                images = [("-" if sign < 0 else "") + subject.names[k] for k, sign in zip(order, s, strict=True)]
                return "yes", f"R step R step = 1 for R: ({', '.join(subject.names)}) -> ({', '.join(images)})"
    return "unknown", f"none of {count} changes of signs, with a swap in the plane, reverses it"


def _order(c: Clues) -> Answer:
    subject = c.subject
    if subject.flow is None:
        return "no flow stated", "nothing to compare the map with"
    if "eps" not in subject.constants:
        return "no step stated", "the step has no parameter eps, its length in time"
    from scipy.integrate import solve_ivp

    from kreisel.lab.law import fitted_orders

    x, rate = float_start(subject, c.seed), partial(subject.flow, **subject.floats)
    try:
        flowed = solve_ivp(lambda t, y: rate(y), (0, TIME), x, method="DOP853", rtol=1e-13, atol=1e-14)
        if not flowed.success:
            return "unknown", f"the flow has no solution up to the time {TIME:g} from a random start: {flowed.message}"
        ends = []
        for count in COUNTS:
            finer = replace(subject, constants={**subject.constants, "eps": TIME / count})
            ends.append(dynamics.CompiledOrbit(finer, x).advance(count)[0])
    except RunError as error:
        return "unknown", str(error)
    errors = np.array([abs(end - flowed.y[:, -1]).max() for end in ends])
    if errors[0] < EXACT * (1 + abs(x).max()):
        return (
            "exact to round-off",
            f"error against the flow over time {TIME:g} with {COUNTS[0]} steps: {errors[0]:.1e}",
        )
    (slope,) = fitted_orders(TIME / np.array(COUNTS), errors[:, None])
    steps = f"over time {TIME:g} with {COUNTS[0]} to {COUNTS[-1]} steps: {errors[0]:.1e} to {errors[-1]:.1e}"
    return f"{slope:.2f}" if slope > 0.8 else "not consistent", f"error against the flow {steps}"


def _growth(c: Clues) -> Answer:
    if not c.rational:
        return "does not apply", c.subject.implicit
    further = () if c.fixed_iterates else (*MORE, 2 * c.subject.dim + 1)
    for iterates in sorted({c.iterates, *further}):
        growing = c.growth = growth.growth(c.subject, max(iterates, c.iterates), c.seed)
        settled = growing.recurrence is not None and iterates > 2 * c.subject.dim  # d steps may move a coordinate each
        if settled or len(growing.degrees) <= iterates or growing.degrees[-1] > GREAT:
            break
    if growing.recurrence is None and math.isinf(growing.uncertainty):
        answer = "too few degrees"
    elif growing.recurrence is None:
        answer = f"entropy {growing.estimate}"
    elif growing.power is None:
        answer = f"exponential, entropy {growing.entropy:.6g}"
    else:
        answer = f"k^{growing.power}, entropy 0"
    drops = f"; singularities confine first at iterate {growing.drops[0]}" if growing.drops else "; no degree is lost"
    return answer, f"degrees {', '.join(map(str, growing.degrees))} on two primes{drops}"


def _singularities(c: Clues) -> Answer:
    if not c.rational or c.subject.dim != 2 or c.subject.model is not None:
        return "not followed", "this needs a rational map of the plane"
    try:
        curves = growth.singularities(replace(c.subject, start=None), seed=c.seed)
    except (InputError, ArithmeticError) as error:
        return "unknown", str(error)
    if not curves:
        return "none", "no curve is contracted"
    steps = min((s.steps for s in curves if not s.confined), default=0)
    return f"not all confined in {steps} steps" if steps else "confined", "; ".join(map(str, curves))


def _integrals(c: Clues) -> Answer:
    subject = c.subject
    if not c.rational:
        try:
            numeric = c.numeric = integrals.integrals_in_floats(replace(subject, tensor=c.tensor), 2, c.seed)
        except RunError as error:
            return "unknown", str(error)
        counts = f"{numeric.on_leaf} on leaves of dimension {numeric.leaf}"
        return f"{numeric.count} of degree 2 or less, in floats; {counts}", str(numeric)
    c.integrals = list(integrals.integrals(subject, c.degree, seed=c.seed))
    rank_on_leaves(c)

    def add(functions: Sequence[Any]) -> None:
        if functions:
            c.integrals = integrals.without_dependent(subject, [*c.integrals, *functions], c.seed)
            rank_on_leaves(c)

    for degree in DARBOUX.get(subject.dim, ()):
        result = None if filled(c) else c.darboux(degree)
        add(() if result is None else result.integrals)
    if not filled(c):
        add(integrals.stated(subject, c.seed))
    if not filled(c) and subject.dim in QUOTIENTS:
        add(integrals.integrals(subject, QUOTIENTS[subject.dim], quotients=True, seed=c.seed))
    # Hirota-Kimura bases if integrals are too few, and the degrees may not grow
    slow = not (c.growth is not None and c.growth.exponential) and subject.dim <= LARGEST
    for degree in range(2, 10) if slow else ():
        if filled(c) or (degree > 2 and math.comb(subject.dim + degree, degree) > BASES):
            break
        with suppress(InputError):
            hirota_kimura = bases(subject, degree, c.seed)
            if hirota_kimura.integrals > c.independent:
                c.bases = hirota_kimura
                rank_on_leaves(c)
    of_record = sum(isinstance(f, integrals.Stated) for f in c.integrals)
    count = f"{len(c.integrals) - of_record} of degree {c.degree} or less"
    count += f", {of_record} stated" if of_record else ""
    if c.ranks is not None:
        count += f"; {c.ranks.with_more} on leaves of dimension {c.ranks.leaf}, "
        count += "in involution" if c.ranks.involution else "not all in involution"
    answers = [count] if c.integrals else []
    texts = (text if len(text) < 160 else text[:150] + " ..." for text in map(str, c.integrals))
    shown = ["; ".join(texts) or f"no polynomial of degree {c.degree} or less"]
    if c.bases is not None:
        answers.append(f"{c.bases.integrals} as coefficients")
        shown.append(f"Hirota-Kimura bases, {c.bases}")
    return "; ".join(answers) or "none found", "; ".join(shown)


def _lax(c: Clues) -> Answer:
    subject, matrix = c.subject, c.subject.lax
    if matrix is None and subject.model is not None and subject.model.map.pencil is not None:
        return "of a pencil", "the law discrete-lax-pencil tests it"
    if matrix is None:
        return "none stated", "give lax and conjugator to test one"
    ranks = c.lax = brackets.lax(replace(subject, tensor=c.tensor), seed=c.seed)
    if ranks.isospectral is None:

        def spectra(x: Array, step: Callable[[Array], Array], constants: Mapping[str, Any]) -> list[Array]:
            at = ([np.asarray(matrix(z, lam, **constants), dtype=float) for lam in (0.7, 1.9)] for z in (step(x), x))
            return [np.array([np.poly(L) for L in matrices]) for matrices in at]

        if difference(subject, spectra, c.seed) < CLOSE:
            ranks = c.lax = replace(ranks, isospectral=True)
            c.in_floats = True
    if ranks.isospectral is not True:
        return "no Lax pair of this map", str(ranks)
    return "complete" if ranks.complete else "superintegrable" if ranks.superintegrable else "not complete", str(ranks)


def _chaos(c: Clues) -> Answer:
    c.orbits, trouble = dynamics.several(c.subject, c.steps, ORBITS, c.seed)
    if not c.orbits:
        return "unknown", trouble
    kinds = [o.word for o in c.orbits]
    worst = max(c.orbits, key=lambda o: (o.chaotic, float(o.exponents[0])))
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return f"{counts} of {len(kinds)} orbits", str(worst)


QUESTIONS: dict[str, Callable[[Clues], Answer]] = {
    "period": _period,
    "Poisson": _poisson,
    "volume": _volume,
    "reversible": _reversible,
    "order": _order,
    "degree growth": _growth,
    "singularities": _singularities,
    "integrals": _integrals,
    "Lax pair": _lax,
    "Lyapunov": _chaos,
}
