"""The questions of an investigation, and what their evidence carries.

The verdict follows from the evidence alone:

    integrable       the map preserves a Poisson bracket, and half as many independent functions in involution as a leaf
                     has dimensions (Liouville), or so many more that the leaf is filled: rank + dimension of the tori =
                     dimension of the leaf (superintegrable).  Exact identities at random points; of implicit maps in
                     floats, where they must be conserved to round-off, with a gap in the singular values.
    not integrable   the degrees of the iterates grow exponentially, by a recurrence or by an estimate beyond its
                     uncertainty; or an orbit is chaotic (a float experiment, not a proof).
    undecided        everything else, and evidence for both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import RunError
from kreisel.lab import brackets, dynamics, growth, integrals
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, Pole, random_residues
from kreisel.lab.lax import Lax, counted, lax
from kreisel.lab.numerical import Numerical, integrals_in_floats
from kreisel.lab.subject import Subject

MONOMIALS = 400  # of the integral finder, as a rule
UNKNOWNS = 150  # of the search for brackets and volumes
ITERATES, FEWER = 9, 6  # with up to 6 coordinates, and beyond
ORBITS = 3
CLOSE = 2.0**24 * float(np.finfo(float).eps)
TIME, COUNTS = 0.5, (64, 128, 256, 512)  # for the order
ENTROPY = 0.1  # the least estimate without a recurrence that counts


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
        self.iterates = iterates or (ITERATES if what.dim <= 6 else FEWER)
        self.degree = degree or next(d for d in (4, 3, 2, 1) if math.comb(what.dim + d, d) <= MONOMIALS or d == 1)
        self.tensor: Callable[[Array], Array] | None = None  # of a bracket that is preserved
        self.unaided = False  # that bracket was found: its Casimirs need not be conserved
        self.growth: growth.Growth | None = None
        self.found: list[Any] = []
        self.lax: Lax | None = None
        self.ranks: Lax | None = None
        self.numeric: Numerical | None = None  # of a map that is no rational function
        self.in_floats = False
        self.orbits: list[dynamics.Dynamics] = []

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
            c.tensor = what.tensor
            return Finding("Poisson", "yes", "J Pi(x) J^T = Pi(x') modulo a prime at 20 random points, its own bracket")
        return _other_bracket(c, "its own bracket is not preserved")
    if what.tensor is not None:
        x, new, J = c.float_jacobian()
        before, after = (np.asarray(what.tensor(v), dtype=float) for v in (x, new))
        off = abs(J @ before @ J.T - after).max() / (1 + abs(after).max())
        if off < CLOSE:
            c.tensor, c.in_floats = what.tensor, True
        return Finding("Poisson", "yes" if off < CLOSE else "no", f"J Pi(x) J^T - Pi(x') is {off:.1e} in floats")
    return _other_bracket(c, "no bracket is stated")


def _other_bracket(c: Clues, why: str) -> Finding:
    if c.what.dim < 2:
        return Finding("Poisson", "does not apply", "one coordinate")
    pairs = math.comb(c.what.dim, 2)
    degree = next((d for d in (2, 1, 0) if pairs * math.comb(c.what.dim + d, d) <= UNKNOWNS), 0)
    found = brackets.brackets(c.what, degree, c.seed)
    good = next((b for b in found if b.poisson), None)
    if good is None:
        return Finding("Poisson", "no bracket found", f"{why}; none with entries of degree {degree} or less")
    c.tensor, c.unaided = _tensor_of(good, c.what.dim), True
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
    found = brackets.volumes(c.what, degree, c.seed)
    if not found:
        return Finding("volume", "none found", f"no density or inverse density of degree {degree} or less")
    return Finding("volume", "yes", f"{found[0]}: rho(x') det J = rho(x) modulo three primes")


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
    if what.flow is None or "eps" not in what.constants:
        return Finding("order", "no flow stated", "nothing to compare the map with")
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
    found = c.growth = growth.growth(c.what, c.iterates, c.seed)
    if found.recurrence is None:
        answer = f"entropy {found.entropy:.2g} ± {found.uncertainty:.1g}"
    elif found.power is None:
        answer = f"exponential, entropy {found.entropy:.6g}"
    else:
        answer = f"k^{found.power}, entropy 0"
    drops = f"; singularities confine first at iterate {found.drops[0]}" if found.drops else "; no degree is lost"
    evidence = f"degrees {', '.join(map(str, found.degrees))} on two primes{drops}"
    return Finding(
        "degree growth", answer, evidence, 1 if found.power is not None else -1 if _exponential(found) else 0
    )


def _exponential(found: growth.Growth) -> bool:
    if found.recurrence is not None:
        return found.power is None
    return len(found.degrees) > 4 and found.entropy > max(ENTROPY, 2 * found.uncertainty)


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
    c.found = list(integrals.integrals(what, c.degree, quotients=what.dim == 2, seed=c.seed))
    if c.tensor is not None and c.found:
        c.ranks = liouville(what, c.tensor, c.found, c.seed)
    ranks = c.ranks
    count = f"{len(c.found)} of degree {c.degree} or less"
    if ranks is not None:
        count += f"; {ranks.with_more} on leaves of dimension {ranks.leaf}, "
        count += "in involution" if ranks.involution else "not all in involution"
    shown = "; ".join(_truncated(str(f)) for f in c.found) or f"none of degree {c.degree} or less"
    return Finding(
        "integrals", count if c.found else "none found", shown, 1 if ranks is not None and enough(ranks) else 0
    )


def _truncated(text: str) -> str:
    return text if len(text) < 160 else text[:150] + " ..."


def liouville(what: Subject, tensor: Callable[[Array], Array], found: list[Any], seed: int) -> Lax:
    """The counts of `Lax` for functions that are known to be conserved."""
    p = PRIMES[0]
    x = what.point(random_residues(np.random.default_rng([seed, 5]), p, 1))
    whole = np.array([int(np.ravel(v.v)[0]) for v in x], dtype=object)
    G = np.array([f.gradient_at(whole, p) for f in found], dtype=object)
    return counted(replace(what, tensor=tensor), x, G, G, p, isospectral=True)


def enough(ranks: Lax) -> bool:
    """Whether integrals of these counts fill a leaf: Liouville, or superintegrable."""
    if ranks.leaf == 0:
        return False
    return (bool(ranks.involution) and ranks.on_leaf == ranks.needed) or ranks.with_more + ranks.torus == ranks.leaf


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


# -- the verdict ------------------------------------------------------------------------------------


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def leaves_stay(c: Clues) -> bool:
    """Whether each leaf of the bracket is mapped to itself: as many Casimirs as it has are among the integrals.

    A map may preserve a bracket and permute its leaves: z' = 2 z beside a turn of (x, y), with {x, y} = 1.
    """
    counts = [
        ranks.rank - ranks.on_leaf == ranks.dimension - ranks.leaf for ranks in (c.ranks, c.lax) if ranks is not None
    ]
    return not c.unaided or any(counts)


def verdict(c: Clues) -> tuple[str, str]:
    """The verdict and its reason."""
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
    if c.growth is not None and _exponential(c.growth):
        against.append(f"the degrees grow exponentially (entropy {c.growth.entropy:.3g})")
    chaotic = [o for o in c.orbits if o.chaotic]
    if chaotic:
        against.append(f"{len(chaotic)} of {len(c.orbits)} orbits are chaotic in floats")
    if for_it and against:
        return "undecided", f"the evidence contradicts itself: {'; '.join(for_it)}; but {'; '.join(against)}"
    if for_it:
        return "integrable", "; ".join(for_it)
    if against:
        return "not integrable", "; ".join(against)
    if c.tensor is not None and not leaves_stay(c):
        return "undecided", (
            "the Casimirs of the bracket that was found are not all among the integrals: the map may permute its leaves"
        )
    return "undecided", "neither enough integrals, nor exponential growth, nor a chaotic orbit was found"


QUESTIONS = (_poisson, _volume, _reversible, _order, _growth, _integrals, _lax, _chaos)
