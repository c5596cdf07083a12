"""The laws: what a record claims, tested at random points, exactly over Q and in floats.

    from kreisel.lab import laws
    laws.check(my_system)              # every law that applies, n = 3 and 4, exact and in floats
    laws.LAWS["poisson"]               # one law: its statement and its test

A law compares pairs of sides that must be equal.  In rational arithmetic they must be equal exactly, a
randomized identity test; in floats up to round-off.  Derivatives come from dual numbers, so they are exact too.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.lab import exact
from kreisel.lab.law import LAWS, TOLERANCE, Case, Law, Sides, Verdict
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.settings import within

# isort: split
from kreisel.lab import laws_of_flows, laws_of_maps  # noqa: F401 - each registers its laws, in this order

# isort: split
from kreisel.lab import laws_of_baecklund  # noqa: F401

__all__ = ["LAWS", "TOLERANCE", "Case", "Law", "Verdict", "check", "make_case", "real", "test"]


def make_case(system: System | Model, n: int, numbers: str, seed: int) -> Case:
    """A random state and step, and random parameters unless a model is given; `numbers` is "exact" or "float"."""
    record = system.system if isinstance(system, Model) else system
    if numbers == "exact" and record.numbers != "any":
        raise InputError(
            f"{record.name} takes floats only (numbers = {shown(record.numbers)}); use numbers=('float',)."
        )
    if numbers not in ("exact", "float"):
        raise InputError(f"numbers must be 'exact' or 'float', got {shown(numbers)}.")
    rng = np.random.default_rng([within(seed, "seed", 0, 2**63 - 1), n])
    draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
    return drawn_case(system, n, numbers, draw)


def drawn_case(system: System | Model, n: int, numbers: str, draw: exact.Random) -> Case:
    """The same with random numbers from `draw`."""
    record = system.system if isinstance(system, Model) else system
    model = system if isinstance(system, Model) else exact.random_model(system, n, draw)
    state = exact.random_state(record.space, n, draw)
    eps = abs(draw((1,)))[0] / 4  # short enough for the logarithms of Lagrangians in floats
    if record.map is not None and record.map.largest_step is not None and numbers == "float":
        eps = min(eps, float(model.call(record.map.largest_step, *state)) / 4)
    lam = draw((1,))[0] * 97 / 89  # no parameter is drawn with such a denominator: Lax matrices have poles there
    return Case(model, state, eps, lam, draw, numbers)


def test(law: Law, case: Case, seed: int = 0) -> Verdict:
    """One law at one case."""
    residual, holds = 0.0, True
    for left, right in real(law.sides(case)):
        difference = np.asarray(left - right)
        if case.numbers == "exact":
            holds = holds and all(v == 0 for v in difference.flat)
            residual = max(residual, algebra.magnitude(difference))
        else:
            worst = algebra.magnitude(difference) / (1 + max(algebra.magnitude(left), algebra.magnitude(right)))
            holds, residual = holds and worst < TOLERANCE, max(residual, worst)
    return Verdict(case.system.name, law.name, case.model.n, case.numbers, seed, residual, holds)


def real(sides: Iterable[tuple[Array, Array]]) -> Sides:
    """The same sides, complex ones by their real and imaginary parts."""
    for left, right in sides:
        (re, im), (other_re, other_im) = algebra.parts(left), algebra.parts(right)
        yield re, other_re
        if im is not None or other_im is not None:
            yield 0 * re if im is None else im, 0 * other_re if other_im is None else other_im


def check(
    system: System | Model,
    dimensions: Iterable[int] = (3, 4),
    numbers: Iterable[str] = ("exact", "float"),
    seeds: Iterable[int] = (0,),
) -> list[Verdict]:
    """Every law that applies to a system, or to a system with its parameters, for each n, kind of numbers and seed.

    A record of kreisel.reduction is tested in floats, in its own n.
    """
    record = system.system if isinstance(system, Model) else system
    kinds = tuple(kind for kind in numbers if kind == "float" or record.numbers == "any")
    chosen, out = tuple(seeds), []
    fixed = system.n if isinstance(system, Model) else record.n
    for n in dimensions if fixed is None else (fixed,):
        for kind in kinds:
            for seed in chosen:
                case = make_case(system, n, kind, seed)
                laws = [law for law in LAWS.values() if law.needs(record) and kind in law.numbers(record)]
                out += [test(law, case, seed) for law in laws]
    return out
