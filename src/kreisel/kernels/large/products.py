"""Products of the dense form of large n, printed for Numba: a momentum M as its entries i < j, and kept inverses W.

Whatever is multiplied by the same matrix at the same place goes through it together, with the changes of the step
before: a step reads M twice and W twice, and writes each once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from kreisel.kernels.printing import Line

# The largest residual of a solve, relative and squared.  A solve is corrected by its residual, once, so what is left of
# an error of 1e-9 is below round-off.  An inverse that follows the changes loses sqrt(steps) ulp: its
# residuals are 1e-14 after 65,000 steps (n = 10, eps = 0.05 to 5).
NEAR = 1e-18

HEAD = '''"""Made by kreisel.kernels.large.products; not to be edited."""
import numpy as np
from numba import njit


'''
OPTIONS = 'cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"}'


class Change(NamedTuple):
    """Plus or minus x y^T: the source of a number, and the names of two vectors."""

    scale: str
    x: str
    y: str


@dataclass(frozen=True)
class Inverse:
    """A kept inverse, that of diagonal + turn M.

    check      |r|^2 and |v|^2 of a solve, r its residual
    changes    when M has changed
    """

    diagonal: str
    turn: str
    check: tuple[str, str]
    changes: tuple[Change, ...]


@dataclass(frozen=True)
class Upkeep:
    """What is done to M, by pairs scale x ^ y, and to the inverses, by Changes, before the new vectors are stored."""

    pairs: tuple[Change, ...]
    inverses: tuple[Inverse, ...]

    @property
    def words(self) -> set[str]:
        """All names."""
        texts = [t for inverse in self.inverses for t in (inverse.diagonal, inverse.turn, *inverse.check)]
        texts += [c.scale for c in (*self.pairs, *(c for inverse in self.inverses for c in inverse.changes))]
        return self.vectors | {t.strip("(-)") for t in texts}

    @property
    def vectors(self) -> set[str]:
        """Names of all vectors that are needed."""
        everything = [*self.pairs, *(c for inverse in self.inverses for c in inverse.changes)]
        return {v for change in everything for v in (change.x, change.y)}


def matrix_of(line: Line) -> str:
    """The matrix of a product, "M" or the number of an inverse, or "" for another line."""
    what = line.text.partition(" = ")[2].partition("(")[0]
    if what == "product":
        return "M"
    return what.removeprefix("kept").removeprefix("turned") if what.startswith(("kept", "turned")) else ""


def is_turned(line: Line) -> bool:
    """Whether it is a product with the transposed matrix."""
    return " = turned" in line.text


class GeneratedFunction(NamedTuple):
    """A function, and a module that it is alone in, so that it is compiled once for all n."""

    name: str
    source: str


def _generated(name: str, arguments: list[str], lines: list[str]) -> GeneratedFunction:
    text = [f"@njit({OPTIONS})", f"def {name}({', '.join(arguments)}):", *(f"    {line}" for line in lines)]
    return GeneratedFunction(name, HEAD + "\n".join([*text, ""]))


def _changed_pairs(count: int) -> tuple[list[str], str]:
    """For a row i: what is needed of the pairs, and the changed entry."""
    ks = range(count)
    of_row = [f"    e{k}, f{k}, g{k}, h{k} = s{k} * p{k}[i], s{k} * q{k}[i], q{k}[i + 1 :], p{k}[i + 1 :]" for k in ks]
    return of_row, "row[j]" + "".join(f" + (e{k} * g{k}[j] - f{k} * h{k}[j])" for k in ks)


def _changed_entries(count: int) -> tuple[list[str], str]:
    ks = range(count)
    return [f"    e{k} = s{k} * p{k}[i]" for k in ks], "row[j]" + "".join(f" + e{k} * q{k}[j]" for k in ks)


def _numbered_letters(letters: str, count: int) -> list[str]:
    return [f"{letter}{k}" for letter in letters for k in range(count)]


def momentum_times(changes: int, count: int) -> GeneratedFunction:
    """M += sum s p ^ q, then y = M x for `count` vectors."""
    ks = range(count)
    of_row, entry = _changed_pairs(changes)
    lines = [
        "n, at = len(x0), 0",
        *(f"y{k}[:] = 0.0" for k in ks),
        "for i in range(n - 1):",
        "    row = M[at : at + n - 1 - i]",
        *of_row,
        *(f"    a{k}, b{k}, c{k}, d{k} = 0.0, x{k}[i], x{k}[i + 1 :], y{k}[i + 1 :]" for k in ks),
        "    for j in range(len(row)):",
        f"        m = {entry}",
        *(["        row[j] = m"] if changes else []),
        *(f"        a{k} += m * c{k}[j]" for k in ks),
        *(f"        d{k}[j] -= m * b{k}" for k in ks),
        *(f"    y{k}[i] += a{k}" for k in ks),
        "    at += n - 1 - i",
    ]
    arguments = ["M", *_numbered_letters("spq", changes), *_numbered_letters("xy", count)]
    return _generated(f"momentum_times_{changes}_{count}", arguments, lines)


def inverse_times(changes: int, count: int, turned: int) -> GeneratedFunction:
    """W += sum s p q^T, then y = W x for `count` vectors, v = W^T u for `turned` others."""
    ks, ts = range(count), range(turned)
    of_row, entry = _changed_entries(changes)
    lines = [
        *(f"v{k}[:] = 0.0" for k in ts),
        "for i in range(W.shape[0]):",
        "    row = W[i]",
        *of_row,
        *(f"    a{k} = 0.0" for k in ks),
        *(f"    b{k} = u{k}[i]" for k in ts),
        "    for j in range(len(row)):",
        f"        m = {entry}",
        *(["        row[j] = m"] if changes else []),
        *(f"        a{k} += m * x{k}[j]" for k in ks),
        *(f"        v{k}[j] += m * b{k}" for k in ts),
        *(f"    y{k}[i] = a{k}" for k in ks),
    ]
    arguments = [
        "W",
        *_numbered_letters("spq", changes),
        *_numbered_letters("xy", count),
        *_numbered_letters("uv", turned),
    ]
    return _generated(f"inverse_times_{changes}_{count}_{turned}", arguments, lines)


def renewed() -> GeneratedFunction:
    """W = (diagonal + turn M)^-1; a state that is no longer finite is reported elsewhere.

    By elimination without pivoting, which is safe for a positive diagonal, as in `kreisel.algebra.solve`.  LAPACK is
    six times as fast at n = 1000 (0.07 s for 0.54), but takes 3 to 10 s to be compiled into a kernel.
    """
    lines = [
        "n, at, size = len(diagonal), 0, 0.0",
        "for i in range(n):",
        "    size += abs(diagonal[i])",
        "for m in M:",
        "    size += abs(m)",
        "if not size < np.inf:",
        "    return",
        "for i in range(n):",
        "    W[i, i] = diagonal[i]",
        "    for j in range(i + 1, n):",
        "        W[i, j], W[j, i] = turn * M[at], -turn * M[at]",
        "        at += 1",
        "for k in range(n):",
        "    pivot, scale = W[k], 1.0 / W[k, k]",
        "    pivot[k] = 1.0",
        "    for j in range(n):",
        "        pivot[j] *= scale",
        "    for i in range(n):",
        "        if i != k:",
        "            row, c = W[i], W[i, k]",
        "            row[k] = 0.0",
        "            for j in range(n):",
        "                row[j] -= c * pivot[j]",
    ]
    return _generated("renewed", ["M", "diagonal", "turn", "W"], lines)
