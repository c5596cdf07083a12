"""Products of the dense form of large n, printed for Numba: a momentum M as its entries i < j, and kept inverses W.

Whatever is multiplied by the same matrix at the same place goes through it together: beyond n = 100 or so the time is
that of reading the matrices.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from kreisel.engines.lines import Line

# Of the residual of a solve, relative and squared.  The definitions correct a solve by its residual, once, so what is
# left of an error of 1e-9 is below round-off.  Following the changes costs sqrt(steps) ulp: 2e-14 after 65,000.
NEAR = 1e-18

HEAD = '''"""Made by kreisel.engines.products; not to be edited."""
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
    """A kept inverse: of diagonal + turn M, as sources; the residual and the right-hand side of its check; its changes."""

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


class Function(NamedTuple):
    """A function, and a module that it is alone in, so that it is compiled once for all n."""

    name: str
    source: str


def _function(name: str, arguments: list[str], lines: list[str]) -> Function:
    text = [f"@njit({OPTIONS})", f"def {name}({', '.join(arguments)}):", *(f"    {line}" for line in lines)]
    return Function(name, HEAD + "\n".join([*text, ""]))


def _changed_pairs(count: int) -> tuple[list[str], str]:
    """For a row i: what is needed of the pairs, and the changed entry."""
    ks = range(count)
    of_row = [f"    e{k}, f{k}, g{k}, h{k} = s{k} * p{k}[i], s{k} * q{k}[i], q{k}[i + 1 :], p{k}[i + 1 :]" for k in ks]
    return of_row, "row[j]" + "".join(f" + (e{k} * g{k}[j] - f{k} * h{k}[j])" for k in ks)


def _changed_entries(count: int) -> tuple[list[str], str]:
    ks = range(count)
    return [f"    e{k} = s{k} * p{k}[i]" for k in ks], "row[j]" + "".join(f" + e{k} * q{k}[j]" for k in ks)


def _named(letters: str, count: int) -> list[str]:
    return [f"{letter}{k}" for letter in letters for k in range(count)]


def momentum_times(changes: int, count: int) -> Function:
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
    arguments = ["M", *_named("spq", changes), *_named("xy", count)]
    return _function(f"momentum_times_{changes}_{count}", arguments, lines)


def inverse_times(changes: int, count: int, turned: int) -> Function:
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
    arguments = ["W", *_named("spq", changes), *_named("xy", count), *_named("uv", turned)]
    return _function(f"inverse_times_{changes}_{count}_{turned}", arguments, lines)


def momentum_changed(changes: int) -> Function:
    """M += sum s p ^ q."""
    of_row, entry = _changed_pairs(changes)
    lines = [
        "n, at = len(p0), 0",
        "for i in range(n - 1):",
        "    row = M[at : at + n - 1 - i]",
        *of_row,
        "    for j in range(len(row)):",
        f"        row[j] = {entry}",
        "    at += n - 1 - i",
    ]
    return _function(f"momentum_changed_{changes}", ["M", *_named("spq", changes)], lines)


def inverse_changed(changes: int) -> Function:
    """W += sum s p q^T."""
    of_row, entry = _changed_entries(changes)
    lines = [
        "for i in range(W.shape[0]):",
        "    row = W[i]",
        *of_row,
        "    for j in range(len(row)):",
        f"        row[j] = {entry}",
    ]
    return _function(f"inverse_changed_{changes}", ["W", *_named("spq", changes)], lines)


def renewed() -> Function:
    """W = (diagonal + turn M)^-1; a state that is no longer finite is reported elsewhere."""
    lines = [
        "n, k, size = len(diagonal), 0, 0.0",
        "A = np.empty((n, n))",
        "for i in range(n):",
        "    A[i, i] = diagonal[i]",
        "    size += abs(diagonal[i])",
        "    for j in range(i + 1, n):",
        "        A[i, j], A[j, i] = turn * M[k], -turn * M[k]",
        "        size += abs(A[i, j])",
        "        k += 1",
        "if size < np.inf:",
        "    W[:] = np.linalg.inv(A)",
    ]
    return _function("renewed", ["M", "diagonal", "turn", "W"], lines)
