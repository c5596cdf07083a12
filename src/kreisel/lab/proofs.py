"""Identities proved for all states, all steps and all parameters of a given n, by SymPy.

The definition runs on rational functions (SymPy's sparse fraction fields, in normal form) with a generator for each
coordinate, parameter and for eps.  An identity whose two sides have the same normal form holds: a proof, where the laws
test at random points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.ring import Ring
from kreisel.errors import InputError, shown
from kreisel.lab.subject import coordinate_names
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model


class Expression(Ring):
    """A rational function of SymPy that lets arrays have their say."""

    __slots__ = ("f",)

    def __init__(self, f: Any):
        self.f = f

    def __add__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Expression(self.f + _inner(other))

    def __mul__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Expression(self.f * _inner(other))

    def __truediv__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Expression(self.f / _inner(other))

    def __rtruediv__(self, other: Any) -> Expression:
        return Expression(_inner(other) / self.f)

    def __neg__(self) -> Expression:
        return Expression(-self.f)


def _inner(x: Any) -> Any:
    return x.f if isinstance(x, Expression) else int(x)


@dataclass(frozen=True)
class Proof:
    """A statement, whether it holds identically, and in which unknowns."""

    statement: str
    holds: bool
    unknowns: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.statement}: {'proved' if self.holds else 'false'}, for all {', '.join(self.unknowns)}"


def prove(what: System | Model, names: tuple[str, ...] = ("casimir", "energy"), n: int = 3) -> list[Proof]:
    """For each name, "casimir", "energy" or an integral of the record: f(step(z)) = f(z) identically.

    Of a system its parameters are unknowns too; of a model they are the numbers given.  Raises `InputError` without
    SymPy, for implicit maps, for states that are not free, and for names that the record does not state.
    """
    system = what.system if isinstance(what, Model) else what
    mapped = system.map
    if mapped is None or mapped.turn is not None or system.numbers != "any":
        raise InputError(f"{system.name} has no map that is a rational function: nothing can be proved.")
    if system.space.constraints:
        raise InputError(f"The coordinates of {system.name} are not free; prove it for the system that contains it.")
    functions = {"casimir": system.space.casimirs, "energy": system.energy, **system.integrals}
    for name in names:
        if functions.get(name) is None:
            raise InputError(f"{system.name} states no {shown(name)}; it states {', '.join(functions)}.")
    n = what.n if isinstance(what, Model) else n
    state, known, unknowns = _symbols(what, system, n)
    new = tuple(call(mapped.step, state, known))
    return [
        Proof(f"{system.name}, n = {n}: {name}", _same(functions[name], state, new, known), unknowns) for name in names
    ]


def _same(f: Any, state: tuple[Array, ...], new: tuple[Array, ...], known: dict[str, Any]) -> bool:
    before, after = (np.ravel(np.asarray(call(f, z, known), dtype=object)) for z in (state, new))
    return all(_inner(a - b) == 0 for a, b in zip(before, after, strict=True))


def _symbols(what: System | Model, system: System, n: int) -> tuple[tuple[Array, ...], dict[str, Any], tuple[str, ...]]:
    try:
        from sympy import QQ
        from sympy.polys.fields import field
    except ImportError as error:
        raise InputError("A proof needs SymPy, which is missing. Install it with: pip install sympy") from error
    names = list(coordinate_names(system.space.components, n))
    sizes = {"scalar": (), "vector": (n,)}
    if isinstance(what, System):
        for p in system.parameters:
            if p.kind not in sizes:
                raise InputError(f"The parameter {p.letter} of {system.name} is no scalar or vector: give a model.")
            names += [p.letter] if p.kind == "scalar" else [f"{p.letter}{i + 1}" for i in range(n)]
    names.append("eps")
    K, *plain = field(names, QQ)
    generators = [Expression(f) for f in plain]
    count = algebra.coordinate_count(system.space.kinds, n)
    flat, rest = np.array(generators[:count], dtype=object), generators[count:]
    state = algebra.restore(flat, system.space.kinds, n)
    known: dict[str, Any] = {"eps": rest[-1]}
    if isinstance(what, Model):
        known |= {k: _rational_constants(K, v) for k, v in what.constants.items()}
    else:
        place = 0
        for p in system.parameters:
            size = 1 if p.kind == "scalar" else n
            chosen = rest[place : place + size]
            known[p.letter] = chosen[0] if p.kind == "scalar" else np.array(chosen, dtype=object)
            place += size
    return state, known, tuple(names)


def _rational_constants(K: Any, v: Any) -> Any:
    from kreisel.lab.fields import fraction

    def one(c: Any) -> Any:
        q = fraction(c)
        return Expression(K(q.numerator) / K(q.denominator))

    return np.vectorize(one, otypes=[object])(v)[()]
