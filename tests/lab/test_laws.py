"""Every law over the whole registry, n = 3...6, exactly over Q and in floats.

n = 6 of the systems beyond the paper, which takes minutes, is for `make test-full`; so is the law of the order, a slope
over many steps, beyond their lowest n.
"""

from __future__ import annotations

from functools import cache

import pytest

from kreisel.lab import laws
from kreisel.system import REGISTRY
from sizes import FULL, costly

CLAIMS = [
    (name, law, n, numbers)
    for name, system in REGISTRY.items()
    for law, stated in laws.LAWS.items()
    if stated.needs(system)
    for n in ((3, 4, 5, 6)[: 3 if costly(name) else None] if system.n is None else (system.n,))
    if law != "order" or n in (3, system.n) or not costly(name)
    for numbers in stated.numbers(system)
]
# A rational identity of degree d that is wrong holds at a random point of a box of N values with a chance below d/N:
# one point is enough, and a second for n = 3 sees branches.
SEEDS = {3: range(20 if FULL else 2), 4: range(2 if FULL else 1), 5: range(1), 6: range(1)}


@cache
def case(name: str, n: int, numbers: str, seed: int) -> laws.Case:
    return laws.make_case(REGISTRY[name], n, numbers, seed)


@pytest.mark.parametrize(("name", "law", "n", "numbers"), CLAIMS, ids=lambda v: str(v))
def test_law(name: str, law: str, n: int, numbers: str) -> None:
    for seed in SEEDS[n] if FULL or law != "order" else (0,):  # a slope over many steps: half the time of all laws
        verdict = laws.test(laws.LAWS[law], case(name, n, numbers, seed), seed)
        assert verdict.holds, f"{laws.LAWS[law].statement}: residual {verdict.residual:.3g}, seed {seed}"


def test_check_runs_every_law_that_applies() -> None:
    verdicts = laws.check(REGISTRY["neumann"], dimensions=(3,), numbers=("exact", "float"))
    assert {v.law for v in verdicts} == {n for n, law in laws.LAWS.items() if law.needs(REGISTRY["neumann"])}
    assert all(v.holds for v in verdicts)
