"""Rubanovskii's gyrostat: its record over Q at twenty points, and mutants."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from kreisel.lab import laws
from kreisel.system import rubanovskii, steklov_lyapunov

SYSTEM = rubanovskii.SYSTEM


def test_the_record_over_q_at_twenty_points() -> None:
    verdicts = laws.check(SYSTEM, numbers=("exact",), seeds=range(20))
    assert {"hamiltonian-flow", "integrals-of-the-flow", "involution", "lax-equation"} < {v.law for v in verdicts}
    assert all(v.holds for v in verdicts)


def lax_of_the_case(M: Any, P: Any, *, b: Any, s: Any, l: Any, h: Any, x: Any, y: Any, lam: Any) -> Any:  # noqa: E741
    return steklov_lyapunov.lax(M, P, b=b, s=s, l=l, x=x, y=y, lam=lam)


def half_a_rotor(M: Any, P: Any, *, b: Any, h: Any, beyond: Any) -> Any:
    return rubanovskii.traces(M, P, b=b, h=h / 2, beyond=beyond)


def force_of_lyapunov(*, b: Any, s: Any, l: Any, h: Any) -> Any:  # noqa: E741
    known = rubanovskii.constants(b=b, s=s, l=l, h=h)
    return {**known, "pushed": known["pushed"] - rubanovskii.constants(b=b, s=s, l=0 * l, h=h)["pushed"]}


@pytest.mark.parametrize(
    ("law", "mutant"),
    [
        ("lax-equation", replace(SYSTEM, lax=lax_of_the_case)),
        ("integrals-of-the-flow", replace(SYSTEM, integrals={"traces": half_a_rotor})),
        ("involution", replace(SYSTEM, integrals={"traces": half_a_rotor})),
        ("integrals-of-the-flow", replace(SYSTEM, derive=force_of_lyapunov)),
    ],
)
def test_mutants(law: str, mutant: Any) -> None:
    (found,) = (v for v in laws.check(mutant, numbers=("exact",)) if v.law == law)
    assert not found.holds
