"""Equations of a record, derived with SymPy from its functions, and its texts as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp

from kreisel import algebra
from kreisel.errors import InputError
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Parameter, System
from kreisel.system import REGISTRY


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
    return algebra.axial(z) if kind == "skew" and z.shape[-1] == 3 else algebra.KINDS[kind].pack(z)


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


GREEK = "alpha gamma chi mu nu omega Omega eps pi Pi".split()
NAMES = ("sqrt", "tr", "diag", "log", "det", "sum", "perp", "dots", *GREEK)
WORD = re.compile(r"[A-Za-z][a-z][a-z'-]*|[a-z]+(?:-[a-z0-9]+)+")  # of prose, not of a formula
OPERATORS = ("=", "+", "-", "^", "/", "x", ">", "<", ">=", "<=", "<x")


def from_text(text: str) -> str:
    """A formula in plain text as LaTeX: m' = a ^ p, <x, Bx>, c_jk, sqrt(I1/(M g l)), M x Omega, sum of words."""
    tex = re.sub(r"(?<=\S)  (?=[A-Za-z])", "@", text)  # between equations
    tex = re.sub(r"(?:^| )over [a-z]+", lambda m: rf"\\ \\text{{{m[0].strip()}}}".replace("\\\\", "\\"), tex)
    tex = _roots(tex)
    tex = re.sub(r"((?:[A-Z]\w*|\)))(?:_\w)? x (?=\S)", lambda m: m[0][:-3] + r" \times ", tex)
    tex = re.sub(r" <x ", r" \\ltimes ", tex).replace(" ^ ", r" \wedge ")
    tex = re.sub(r"\bd([A-Z])/d([A-Z])\b", r"\\partial \1/\\partial \2", tex)
    tex = re.sub(r"<([^<>]*)>", r"\\langle \1 \\rangle", tex)
    tex = re.sub(r"\|([^|]+)\|", r"\\lvert \1\\rvert", tex)
    tex = tex.replace(">=", r"\ge ").replace("...", r"\ldots ")
    tex = re.sub(r"\bSz_(\w)", r"S^z_\1", tex)
    tex = re.sub(r"\b([BJ])z\b", r"\1_z", tex)
    tex = re.sub(r"(?<![\\A-Za-z])([A-Za-z]|chi)(\d+)\b", r"\1_{\2}", tex)
    tex = re.sub(r"([_^])\(([^()]*)\)", r"\1{\2}", tex)
    tex = re.sub(r"_(\w\w+)", r"_{\1}", tex)
    for name in GREEK:
        tex = re.sub(rf"(?<![\\A-Za-z]){name}(?![a-z])", "\\\\" + {"eps": "varepsilon"}.get(name, name), tex)
    tex = re.sub(r"(?<![\\A-Za-z])(tr|diag)\b", r"\\operatorname{\1}", tex)
    tex = re.sub(r"(?<![\\A-Za-z])(log|det|sum|perp)\b", r"\\\1", tex)
    return tex.replace(",@", r",\quad ").replace("@", r"\quad ")


def _roots(text: str) -> str:
    """sqrt(...) and (...)^(1/2) with their brackets."""
    text = re.sub(r"\(((?:[^()])*)\)\^\(1/2\)", r"sqrt(\1)", text)
    while (start := text.find("sqrt(")) >= 0:
        depth, end = 1, start + 5
        while depth:
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        text = f"{text[:start]}\\sqrt{{{text[start + 5 : end - 1]}}}{text[end:]}"
    return text


def space(name: str) -> str:
    """The name of a phase space as LaTeX: e*(n), (so(n) <x R^n)*, T*S^(n-1)."""
    tex = re.sub(r"\b(so|e)(\*?)\((\w)\)", lambda m: rf"\mathfrak{{{m[1]}}}({m[3]})" + "^*" * bool(m[2]), name)
    tex = tex.replace("<x", r"\ltimes").replace("R^n", r"\mathbb{R}^n").replace("T*S", "T^*S")
    tex = tex.replace("Sym", r"\operatorname{Sym}").replace(")*", ")^*")
    return re.sub(r"\^\(([^()]*)\)", r"^{\1}", tex)


def prose(text: str) -> str:
    """A sentence of a record as Markdown, its formulas between dollars."""
    whole = r"(`[^`]+`|\[[A-Z][^\]]*\d{4}[^\]]*\]|\w+='\w+'|\([^()]+\) = \([^()]+\)"
    pieces = re.split(rf"{whole}|\b(?:{'|'.join(map(re.escape, REGISTRY))})\b(?![-\w]))", text)
    return "".join(_piece(piece) if at % 2 else _sentence(piece) for at, piece in enumerate(pieces))


def _piece(text: str) -> str:
    """What is no mixture: code, a reference, an argument, an equation of tuples, the name of a system."""
    if text in REGISTRY:
        return f"[`{text}`]({text}.md)"
    if text[0] == "(":
        return f"${from_text(text)}$"
    return text if text[0] in "`[" else f"`{text}`"


def _sentence(text: str) -> str:
    tokens = re.findall(r"\s+|\S+", text)
    out, run = "", ""
    for at, token in enumerate(tokens):
        if token.isspace():
            if run:
                run += token
            else:
                out += token
        elif _is_formula(tokens, at) or _open(run):
            if token[0] == "(" and tokens[at + 2 : at + 3] == ["="]:  # a remark begins
                out, run = out + _dollars(run), ""
            run += token
            if re.search(r"(?<!\.\.)[.,:;]$", token) and not (token[-1] == "," and _open(run)):  # the end of a formula
                out, run = out + _dollars(run), ""
        else:
            out, run = out + _dollars(run) + _escaped(token), ""
    return out + _dollars(run)


def _is_formula(tokens: list[str], at: int) -> bool:
    """Whether a word of a sentence belongs to a formula."""
    bare = tokens[at].strip("().,:;")
    before, after = (tokens[i] if 0 <= i < len(tokens) else "" for i in (at - 2, at + 2))
    near = before.lstrip("(") in OPERATORS or after in OPERATORS
    if bare == "a" or bare.isdigit():  # an article, a number of a sentence
        return near
    if bare in ("A", "I"):
        return near or (at > 0 and not (tokens[at][-1].isalpha() and WORD.fullmatch(after.strip("().,:;"))))
    if bare in OPERATORS or bare in NAMES or re.fullmatch(r"[a-zA-Z]|(?!SI)[A-Z]{2}", bare):
        return True
    if WORD.fullmatch(bare) or re.fullmatch(r"[\w-]*[a-z]{3,}[\w-]*|[A-Z][a-z]+'s?", bare):
        return False
    return bool(re.search(r"[_^=<>|+*/()]|\d|'|\.\.\.", bare))


def _open(run: str) -> bool:
    """Whether a bracket is open in a formula; one around all of it belongs to the sentence."""
    body = run.lstrip("(")
    angles = len(re.findall(r"<(?=[^\s=])", body)) - len(re.findall(r"(?<=\S)>", body))
    return angles > 0 or _unbalanced(body) > 0


def _dollars(run: str) -> str:
    """A formula between dollars; the brackets and stops around it are text."""
    if not run:
        return ""
    body = run.rstrip()
    end = run[len(body) :]
    while (body[-1:] in tuple(".,:;") and not body.endswith("...")) or (body[-1:] == ")" and _unbalanced(body) < 0):
        body, end = body[:-1], body[-1] + end
    start = ""
    if re.fullmatch(r"\([^()]*\)", body):  # a remark
        body, start, end = body[1:-1], "(", ")" + end
    while body[:1] == "(" and _unbalanced(body) > 0:
        body, start = body[1:], start + "("
    if not re.search(r"[A-Za-z]", body) or not body:
        return start + body + end
    return f"{start}${from_text(body)}${end}"


def _unbalanced(text: str) -> int:
    return text.count("(") - text.count(")")


def _escaped(text: str) -> str:
    return text.replace("_", r"\_").replace("*", r"\*").replace("<", "&lt;")
