"""Equations of a record, derived with SymPy from its functions, and its texts as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp

from kreisel import algebra
from kreisel.errors import InputError
from kreisel.record.contract import Parameter, System, call, keywords


def symbols(letter: str, count: int = 3) -> np.ndarray:
    """letter_1, ..., letter_count."""
    return np.array(sp.symbols([f"{letter}_{i + 1}" for i in range(count)], real=True), dtype=object)


def entries(letter: str, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """letter_11, letter_12, ... of a matrix."""
    names = [f"{letter}_{i + 1}{j + 1}" for i, j in zip(rows, columns, strict=True)]
    return np.array(sp.symbols(names, real=True), dtype=object)


def components(letter: str, kind: str, n: int) -> np.ndarray:
    """The symbols of a component of the state: axial vectors for skew matrices when n = 3."""
    if kind == "symmetric":
        return entries(letter, *algebra.triangle_with_diagonal(n))
    if kind == "skew" and n > 3:
        return entries(letter, *algebra.triangle(n))
    return symbols(letter, n)


def flat(kind: str, z: np.ndarray) -> np.ndarray:
    """A component of the state as the numbers that have symbols."""
    return algebra.axial(z) if kind == "skew" and z.shape[-1] == 3 else algebra.coordinates_of(kind, z)


def matrix(kind: str, v: np.ndarray, n: int) -> np.ndarray:
    """The inverse of `flat`."""
    if kind == "skew":
        return algebra.hat(v) if n == 3 else algebra.skew(v, n)
    return algebra.symmetric(v, n) if kind == "symmetric" else v


def _parameter(p: Parameter, on_axis: bool) -> Any:
    if p.kind == "dimension":
        return np.array(3)
    if p.kind == "scalar":
        return np.array(sp.Symbol(p.letter, real=True), dtype=object)
    if p.kind == "vector":
        return np.array([0, 0, 1], dtype=object) if on_axis else symbols(p.letter)
    if p.kind != "symmetric":
        raise InputError(f"{p.letter} of kind {p.kind} has no symbols")
    try:  # a diagonal, unless the parameter has no use for one
        if p.check is not None:
            p.check(np.diag([1.0, 2.0, 2.5]), p.letter)
    except InputError:
        c = symbols(p.letter)  # c_i belongs to the plane without the axis i
        return np.array([[0, c[2], c[1]], [c[2], 0, c[0]], [c[1], c[0], 0]], dtype=object)
    return np.array(sp.diag(*symbols(p.letter)).tolist(), dtype=object)


class Symbolic:
    """A record with symbols for parameters and state, n = 3 if the system has no other; then axial vectors.

    With `on_axis` the vectors among the parameters are the third basis vector.
    """

    def __init__(self, system: System, on_axis: bool = False):
        self.system, self.on_axis, self.n = system, on_axis, system.n or 3
        self.state, self.names = [], []
        for letter, kind in system.space.components:
            if kind not in ("skew", "vector", "symmetric"):
                raise InputError(f"{letter} of kind {kind} has no symbols")
            v = components(letter, kind, self.n)
            self.names += list(v)
            self.state.append(matrix(kind, v, self.n))
        self.params = {p.letter: _parameter(p, on_axis) for p in system.parameters}
        self.bare = {k: v.item() if v.ndim == 0 else v for k, v in self.params.items()}

    def call(self, function: Callable[..., Any] | None, **extra: Any) -> Any:
        """A function of the record."""
        if function is None:
            raise InputError("not stated")
        available = {**self.bare, **extra}
        if self.system.derive is not None and keywords(function) - set(available):
            available |= call(self.system.derive, (), self.params)
        return call(function, tuple(self.state), available)

    def simplified(self, expression: Any) -> Any:
        """Expanded; what a constraint makes constant is put in (|x| = 1)."""
        out = sp.together(sp.sympify(expression))
        for constraint in self.system.space.constraints.values():
            value = sp.expand(constraint(*self.state))
            constant = value.subs(dict.fromkeys(self.names, 0))
            out = out.subs(value - constant, -constant)
        numerator, denominator = sp.fraction(sp.together(out))
        return sum((sp.factor(t) for t in self._terms(numerator, denominator)), sp.Integer(0))

    def _terms(self, numerator: Any, denominator: Any) -> list[Any]:
        """One fraction for each monomial of the state."""
        poly = sp.Poly(sp.expand(numerator), *self.names) if not denominator.has(*self.names) else None
        if poly is None:
            return [numerator / denominator]
        monomials = ((c, sp.prod(x**k for x, k in zip(self.names, powers, strict=True))) for powers, c in poly.terms())
        return [c * monomial / denominator for c, monomial in monomials]

    def rates(self) -> list[tuple[Any, Any]]:
        """(symbol, its derivative) for each component of the state."""
        out: list[Any] = []
        for kind, rate in zip(self.system.space.kinds, self.call(self.system.flow), strict=True):
            out += list(flat(kind, rate))
        return [(name, self.simplified(rate)) for name, rate in zip(self.names, out, strict=True)]

    def components(self) -> list[tuple[str, str]]:
        """(left side, right side) of each equation of motion."""
        return [(f"{latex(name)}'", latex(rate)) for name, rate in self.rates()]

    def hamiltonian(self) -> Any:
        """H, an expression."""
        return self.simplified(self.call(self.system.energy, eps=0))

    def energy(self) -> str:
        """H."""
        return latex(self.hamiltonian())

    def lax(self) -> tuple[str, str]:
        """L and U."""
        lam = sp.Symbol("lambda")
        return tuple(_matrix(_entries(X), self.simplified) for X in self.call(self.system.lax, lam=lam))


LONGEST = 200  # characters of LaTeX of an equation that still reads well


def typeset(system: System) -> Symbolic:
    """The record in symbols, its one vector on the third axis if the equations would be too long otherwise."""
    general = Symbolic(system)
    if [p.kind for p in system.parameters].count("vector") != 1:
        return general
    longest = max(len(right) for _, right in general.components())
    return Symbolic(system, on_axis=True) if longest > LONGEST else general


def _matrix(rows: list[list[Any]], simplified: Callable[[Any], Any]) -> str:
    lam = sp.Symbol("lambda")
    rows_in_tex = [" & ".join(latex(sp.collect(simplified(x), lam)) for x in row) for row in rows]
    return r"\begin{pmatrix}" + r" \\ ".join(rows_in_tex) + r"\end{pmatrix}"


def _entries(X: np.ndarray) -> list[list[Any]]:
    """The entries of a matrix, complex ones by SymPy's unit."""
    re, im = algebra.parts(X)
    return (re if im is None else re + sp.I * im).tolist()


def latex(expression: Any) -> str:
    """LaTeX without the brackets that MathML draws by itself."""
    return sp.latex(expression, fold_short_frac=False)


GREEK = {name: "\\" + name for name in ("Omega", "omega", "alpha", "gamma", "chi", "mu")}


def from_text(text: str) -> str:
    """The one line of plain text of a record as LaTeX: m' = a ^ p, <x, Bx>, c_jk."""
    tex = re.sub(r" \^ ", r" \\wedge ", text)
    tex = re.sub(r"<([^<>]*)>", r"\\langle \1 \\rangle", tex)
    tex = re.sub(r"\|([^|]+)\|", r"\\lvert \1\\rvert", tex)
    tex = re.sub(r"_(\w\w+)", r"_{\1}", tex)
    for word, symbol in GREEK.items():
        tex = re.sub(rf"\b{word}(?![a-z])", lambda _, symbol=symbol: symbol, tex)
    return tex.replace(",  ", r",\quad ")
