"""What the evidence of an investigation carries.

The rule.

    periodic         an iterate is the identity.
    linear           all iterates have degree 1, and the integrals do not make it integrable.
    integrable       the map preserves a Poisson bracket and maps each of its leaves to itself, and half as many
                     independent functions in involution as a leaf has dimensions are conserved (Liouville), or so many
                     more that the leaf is filled: rank + dimension of the tori = dimension of the leaf
                     (superintegrable); or d - 1 integrals and a volume of d dimensions are conserved, which are a
                     bracket with d - 2 Casimirs, and one integral; the coefficients of Hirota-Kimura bases are
                     integrals.  Exact identities at random points; of implicit
                     maps in floats, where they must be conserved to round-off, with a gap in the singular values.
    not integrable   the degrees of the iterates grow exponentially, by a recurrence or by an estimate beyond its
                     uncertainty; or an orbit is chaotic (a float experiment, not a proof).
    undecided        everything else, evidence for both, and maps with a coordinate that counts the steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.lab import hirota_kimura
from kreisel.lab.fields import PRIMES, random_residues
from kreisel.lab.lax import Lax, counted
from kreisel.lab.subject import Subject

if TYPE_CHECKING:
    from kreisel.lab.questions import Clues

LARGEST = 8  # coordinates of maps of which Hirota-Kimura bases are looked for


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


def rank_on_leaves(c: Clues) -> None:
    """The counts of the integrals for the bracket; of those that were found, for one whose leaves they fill, if any."""
    if c.tensor is None or not c.found:
        return
    first, *others = c.unaided or [c.tensor]
    for tensor in (first, *others, first):
        c.tensor, c.ranks = tensor, liouville(c.what, tensor, c.found, c.seed)
        if filled(c):
            break


def by_volume(c: Clues) -> bool:
    """Whether all integrals but one and a volume are conserved: {x_i, x_j} = minors of the gradients / rho."""
    return bool(c.volume) and 1 < c.what.dim <= max(len(c.found), c.bases.integrals if c.bases else 0) + 1


def coefficients(c: Clues) -> None:
    """Looks for Hirota-Kimura bases: where integrals are too few, and the degrees may not grow."""
    if filled(c) or (c.growth is not None and c.growth.exponential) or c.what.dim > LARGEST:
        return
    try:
        bases = hirota_kimura.bases(c.what, 2, c.seed)
    except InputError:
        return
    if bases.integrals > len(c.found):
        c.bases = bases


def filled(c: Clues) -> bool:
    """Whether the integrals make the map integrable."""
    return by_volume(c) or (c.ranks is not None and leaves_stay(c) and enough(c.ranks))


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def leaves_stay(c: Clues) -> bool:
    """Whether each leaf of the bracket is mapped to itself: its Casimirs are conserved, as many as it has.

    A map may preserve a bracket and permute its leaves: z' = 2 z beside a turn of (x, y), with {x, y} = 1.
    """
    counts = [
        ranks.rank - ranks.on_leaf == ranks.dimension - ranks.leaf for ranks in (c.ranks, c.lax) if ranks is not None
    ]
    if c.numeric is not None:
        counts.append(c.numeric.count - c.numeric.on_leaf == c.what.dim - c.numeric.leaf)
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
        count = _counted(max(len(c.found), c.bases.integrals if c.bases else 0), "independent integral")
        for_it.append(f"{count} and {c.volume} in {c.what.dim} dimensions, found exactly")
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
        like = "; the degrees grow like k^2, as those of discrete Painleve equations do" if squares else ""
        reason = f"{c.clock} goes up by the same number in every step: the map is not autonomous, no orbit is bounded"
        return "undecided", reason + like
    if c.tensor is not None and not leaves_stay(c):
        return "undecided", (
            "the Casimirs of the bracket that was found are not all among the integrals: the map may permute its leaves"
        )
    few = f" ({c.bases.integrals} as coefficients of Hirota-Kimura bases)" if c.bases else ""
    return "undecided", f"neither enough integrals{few}, nor exponential growth, nor a chaotic orbit was found"
