"""Compiled kernels for the CPU, made from a scheme's step by recording it.

Up to n = 8, if it is not too long, the record is straight-line scalar code; beyond, compiled array code with the
same operations.
The source is written to a cache folder, named by its hash, so that it can be read and debugged, and so that
Numba's disk cache finds it again.  The folder is KREISEL_CACHE, else kreisel/ in the user's cache folder.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib.util
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.layout import Floats
from kreisel.engines.trace import Line, Matrix, Scalar, Tape, text
from kreisel.methods.scheme import Scheme

STRAIGHT_LINE_N = 8
STRAIGHT_LINES = 5000  # beyond, compiling takes longer than array code is slow; n = 3 has fewer up to order 12
OPTIONS = 'cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"}'

HEAD = '''"""Made by kreisel.engines.cpu by recording {name}; not to be edited."""
from math import sqrt

import numpy as np
from numba import njit
from numpy import ascontiguousarray, eye, full
from numpy.linalg import solve

from kreisel.engines.fused import fma, plain_sum, sum_error

'''

ADVANCE = """
@njit("void(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8)", {options})
def kernel(z, c, s, out, every):
    for lane in range(z.shape[0]):
{load}
        for row in range(out.shape[0]):
            for _ in range(every):
                for stage in range(s.shape[1]):
{stage}
{body}
{close}
{save}
{store}
"""

RATE = """
@njit("void(f8[::1], f8[::1], f8[::1])", {options})
def kernel(z, c, out):
{load}
{body}
{save}
"""


def cache_folder() -> Path:
    """Where kernels are kept; a folder for this process alone if the usual one cannot be written."""
    base = os.environ.get("KREISEL_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) if os.environ.get("KREISEL_CACHE") else Path(base) / "kreisel"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return _folder_of_this_process()


@cache
def _folder_of_this_process() -> Path:
    """A private folder, removed at the end: a shared one could hold the code of somebody else."""
    folder = Path(tempfile.mkdtemp(prefix="kreisel-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def load(source: str) -> ModuleType:
    """Import generated source from the cache; writing is atomic, so two processes may do it at once."""
    name = "kreisel_kernel_" + hashlib.sha256(source.encode()).hexdigest()[:20]
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.exists():
        handle, scratch = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w") as file:
            file.write(source)
        os.replace(scratch, path)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"the kernel {path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


class Piece(NamedTuple):
    """A recorded function: its lines, and the names of the new state."""

    lines: list[Line]
    new: list[str]

    def source(self, state: list[str], indent: int) -> str:
        """The lines, and the new state in place of the old."""
        lines = [part for line in self.lines for part in line.text.splitlines()]
        return _indented([*lines, f"{', '.join(state)}, = {', '.join(self.new)},"], indent)


class Recording:
    """A scheme's step and `close`, or its rate, on recording numbers: source for loading, the pieces and storing.

    Constants are called c, those that vary with the stage s.
    """

    def __init__(
        self,
        scheme: Scheme,
        constants: Floats,
        columns: Mapping[str, slice],
        stage_columns: Mapping[str, slice] | None = None,
    ):
        self.scheme, self.n = scheme, scheme.n
        self.columns = {"c": columns, "s": stage_columns or {}}
        self.kinds = [kind for _, kind in scheme.components]
        self.places: list[tuple[str, slice, str]] = []
        functions = [_function(scheme), *([] if scheme.close is None else [scheme.close])]
        straight = scheme.n <= STRAIGHT_LINE_N
        if straight:
            self._straight_line(functions, constants)
            straight = scheme.n == 3 or self._length() <= STRAIGHT_LINES
        if not straight:
            self._array_code(functions)

    def _length(self) -> int:
        return sum(len(line.text.splitlines()) for piece in self.pieces for line in piece.lines)

    def _letters(self, k: int) -> str:
        """The constants that function k takes: the step those of the stages too."""
        return "cs" if k == 0 else "c"

    def _straight_line(self, functions: list[Callable[..., Any]], constants: Floats) -> None:
        """Record scalar code."""
        count = sum(layout.size(kind, self.n) for kind in self.kinds)
        self.state = [f"z{i}" for i in range(count)]
        varying = max((place.stop for place in self.columns["s"].values()), default=0)
        self.pieces: list[Piece] = []
        self.words: set[str] = set()
        for k, function in enumerate(functions):
            tape = Tape("e" * k)
            flat = np.array([Scalar(tape, name) for name in self.state], dtype=object)
            entries: dict[str, list[Any]] = {
                "c": [_folded(tape, f"c{j}", constants[:, j]) for j in range(constants.shape[1])],
                "s": [Scalar(tape, f"s{j}") for j in range(varying)],
            }
            known = {
                name: _shaped(entries[letter][place], (self.n,) * self.scheme.axes[name])
                for letter in self._letters(k)
                for name, place in self.columns[letter].items()
            }
            values = list(layout.flatten(function(*layout.restore(flat, self.kinds, self.n), **known), self.kinds))
            lines = tape.needed([v.name for v in values if isinstance(v, Scalar)])
            self.pieces.append(Piece(lines, [text(v) for v in values]))
            self.words |= {name for line in lines for name in line.needs} | {getattr(v, "name", "") for v in values}

    def _array_code(self, functions: list[Callable[..., Any]]) -> None:
        square = (self.n, self.n)
        shapes = {"skew": square, "symmetric": square, "matrix": square, "vector": (self.n,), "scalar": ()}
        self.state = [f"z{i}" for i in range(len(self.kinds))]
        self.pieces = []
        for k, function in enumerate(functions):
            tape = Tape("e" * k)
            parts = [Matrix(tape, name, shapes[kind]) for name, kind in zip(self.state, self.kinds, strict=True)]
            known = {
                name: Matrix(tape, f"{letter}_{name}", (self.n,) * self.scheme.axes[name])
                for letter in self._letters(k)
                for name in self.columns[letter]
            }
            new = function(*parts, **known)
            names = [
                f"{MIRRORS[kind]}({v.name})" if kind in MIRRORS else v.name
                for v, kind in zip(new, self.kinds, strict=True)
            ]
            self.pieces.append(Piece(tape.needed([v.name for v in new]), names))
        edges = np.cumsum([0, *(layout.size(kind, self.n) for kind in self.kinds)])
        self.places = [
            (kind, slice(int(a), int(b)), name)
            for kind, a, b, name in zip(self.kinds, edges[:-1], edges[1:], self.state, strict=True)
        ]

    def load(self, source: str, indent: int) -> str:
        """The state from a row."""
        if not self.places:
            return _indented([f"{name} = {source}{i}]" for i, name in enumerate(self.state)], indent)
        lines = [
            f"{name} = {LOADERS[kind]}({source}{place.start}:{place.stop}], {self.n})"
            for kind, place, name in self.places
        ]
        return _indented(lines, indent)

    def load_constants(self, letter: str, source: str, indent: int) -> str:
        """The constants of that letter from a row, those that are used."""
        lines = []
        for name, place in self.columns[letter].items():
            if self.places:
                loader = ("number", "vector", "matrix")[self.scheme.axes[name]]
                lines.append(f"{letter}_{name} = {loader}({source}{place.start}:{place.stop}], {self.n})")
            else:
                names = [(f"{letter}{j}", j) for j in range(place.start, place.stop)]
                lines += [f"{entry} = {source}{j}]" for entry, j in names if entry in self.words]
        return _indented(lines, indent)

    def body(self, indent: int) -> str:
        """The step or the rate."""
        return self.pieces[0].source(self.state, indent)

    def close(self, indent: int) -> str:
        """What ends a step with stages."""
        return "\n".join(piece.source(self.state, indent) for piece in self.pieces[1:])

    def save(self, target: str, names: list[str], indent: int) -> str:
        if not self.places:
            return _indented([f"{target}{i}] = {name}" for i, name in enumerate(names)], indent)
        lines = [
            f"{STORERS[kind]}({name}, {target}{place.start}:{place.stop}])"
            for (kind, place, _), name in zip(self.places, names, strict=True)
        ]
        return _indented(lines, indent)


MIRRORS = {"skew": "mirror", "symmetric": "mirror_symmetric"}
LOADERS = {"skew": "skew", "symmetric": "symmetric", "matrix": "matrix", "vector": "vector", "scalar": "number"}
STORERS = {
    "skew": "store_skew",
    "symmetric": "store_symmetric",
    "matrix": "store",
    "vector": "store",
    "scalar": "store_number",
}
ARRAY_HEAD = """
@njit({options})
def add(x, y):
    return x + y


@njit({options})
def subtract(x, y):
    return x - y


@njit({options})
def multiply(x, y):
    return x * y


@njit({options})
def divide(x, y):
    return x / y


@njit({options})
def power(x, y):
    return x**y


@njit({options})
def negative(x):
    return -x


@njit({options})
def number(flat, n):
    return flat[0]


@njit({options})
def vector(flat, n):
    return flat.copy()


@njit({options})
def matrix(flat, n):
    return flat.copy().reshape((n, n))


@njit({options})
def skew(flat, n):
    X, k = np.zeros((n, n)), 0
    for i in range(n):
        for j in range(i + 1, n):
            X[i, j], X[j, i] = flat[k], -flat[k]
            k += 1
    return X


@njit({options})
def mirror(X):
    # the entries i < j are the state; the others would drift away from their negatives
    n = X.shape[0]
    for i in range(n):
        X[i, i] = 0.0
        for j in range(i + 1, n):
            X[j, i] = -X[i, j]
    return X


@njit({options})
def symmetric(flat, n):
    X, k = np.empty((n, n)), 0
    for i in range(n):
        for j in range(i, n):
            X[i, j] = X[j, i] = flat[k]
            k += 1
    return X


@njit({options})
def mirror_symmetric(X):
    n = X.shape[0]
    for i in range(n):
        for j in range(i + 1, n):
            X[j, i] = X[i, j]
    return X


@njit({options})
def store(X, flat):
    flat[:] = X.reshape(X.size)


@njit({options})
def store_number(x, flat):
    flat[0] = x


@njit({options})
def store_symmetric(X, flat):
    k = 0
    for i in range(X.shape[0]):
        for j in range(i, X.shape[0]):
            flat[k] = X[i, j]
            k += 1


@njit({options})
def store_skew(X, flat):
    k = 0
    for i in range(X.shape[0]):
        for j in range(i + 1, X.shape[0]):
            flat[k] = X[i, j]
            k += 1


"""


def _indented(lines: list[str], indent: int) -> str:
    return "\n".join(" " * indent + line for line in lines)


def _shaped(entries: list[Any], shape: tuple[int, ...]) -> Any:
    array: Any = np.array(entries, dtype=object).reshape(shape)
    return array[()]


def _folded(tape: Tape, name: str, values: Floats) -> Scalar | float:
    """A constant that is 0, 1 or -1 in every lane, as a plain number; else recorded."""
    first = float(values[0])
    return first if first in (0.0, 1.0, -1.0) and (values == first).all() else Scalar(tape, name)


def _function(scheme: Scheme) -> Callable[..., tuple[Array, ...]]:
    function = scheme.step if scheme.step is not None else scheme.rate
    if function is None:
        raise TypeError(f"the scheme {scheme.name} states neither a step nor a rate")
    return function


def flat_constants(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """All constants as rows (lanes, count), and where each stands."""
    return _rows(scheme.constants, scheme.axes, (lanes,))


def flat_stages(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """The constants of the stages as rows (lanes, stages, count), and where each stands."""
    return _rows(scheme.stages, scheme.axes, (lanes, scheme.stage_count))


def _rows(
    values: Mapping[str, Array], axes: Mapping[str, int], lead: tuple[int, ...]
) -> tuple[Floats, dict[str, slice]]:
    pieces, columns, start = [np.empty((*lead, 0))], {}, 0
    for name, value in values.items():
        array = np.asarray(value, dtype=np.float64)
        flat = array.reshape((*array.shape[: array.ndim - axes[name]], -1))
        pieces.append(np.broadcast_to(flat, (*lead, flat.shape[-1])))
        columns[name] = slice(start, start + flat.shape[-1])
        start += flat.shape[-1]
    return np.ascontiguousarray(np.concatenate(pieces, -1)), columns


class Kernel:
    """A compiled step, its state in rows (lanes, d), and its constants.

    `advance(out, every)` makes `every` steps for each row of `out` (rows, lanes, d) and stores the state there.
    """

    def __init__(self, scheme: Scheme, z0: Floats):
        self.z = np.array(z0, dtype=np.float64, order="C")
        self.constants, columns = flat_constants(scheme, len(self.z))
        self.stages, stage_columns = flat_stages(scheme, len(self.z))
        record = Recording(scheme, self.constants, columns, stage_columns)
        self.source = _head(scheme, record) + ADVANCE.format(
            options=OPTIONS,
            load=record.load("z[lane, ", 8) + "\n" + record.load_constants("c", "c[lane, ", 8),
            stage=record.load_constants("s", "s[lane, stage, ", 20),
            body=record.body(20),
            close=record.close(16),
            save=record.save("out[row, lane, ", record.state, 12),
            store=record.save("z[lane, ", record.state, 8),
        )
        self._kernel = load(self.source).kernel

    def advance(self, out: Floats, every: int) -> None:
        self._kernel(self.z, self.constants, self.stages, out, every)

    def snapshot(self) -> dict[str, Floats]:
        return {"z": self.z}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self.z[:] = snapshot["z"]


def _head(scheme: Scheme, record: Recording) -> str:
    head = HEAD.format(name=f"{scheme.name}, n = {scheme.n}")
    return head + (ARRAY_HEAD.format(options=OPTIONS) if record.places else "")


def compiled_rate(scheme: Scheme) -> Callable[[float, Floats, Floats], Floats]:
    """The right-hand side y' = f(t, y, constants) of a scheme that states a rate, compiled."""
    constants, columns = flat_constants(scheme, 1)
    record = Recording(scheme, np.full_like(constants, np.nan), columns)
    source = _head(scheme, record) + RATE.format(
        options=OPTIONS,
        load=record.load("z[", 4) + "\n" + record.load_constants("c", "c[", 4),
        body=record.body(4),
        save=record.save("out[", record.state, 4),
    )
    kernel = load(source).kernel

    def rate(t: float, y: Floats, c: Floats) -> Floats:
        out = np.empty_like(y)
        kernel(np.ascontiguousarray(y), c, out)
        return out

    return rate
