"""Calls in a kernel for products with a dense momentum and its inverses, and the changes that go with them.

The changes that a step makes in a matrix wait for its first product in the next step: that saves a way through it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from kreisel.kernels.cache import load_kernel
from kreisel.kernels.large import products
from kreisel.kernels.large.forms import INVERSE
from kreisel.kernels.large.products import Change, GeneratedFunction, Upkeep
from kreisel.kernels.large.workspace import Workspace, WorkspaceRows
from kreisel.kernels.printing import Line


class MatrixProducts:
    """The calls; `momentum` is the name of M in the kernel, and each inverse has a number.

    functions  those that are called, with their modules: one for all n
    """

    def __init__(self, work: Workspace, momentum: str):
        self.work, self.momentum = work, momentum
        self.functions: dict[str, str] = {}
        self.waiting: dict[str, tuple[Change, ...]] = {}  # what is still to be done to each matrix, by its name
        self._first: dict[
            str, tuple[GeneratedFunction, int, int]
        ] = {}  # what does it in the next step, and how many products

    def wait(self, upkeep: Upkeep | None) -> list[str]:
        """Rows for the changes of a step; the lines that put 0 there."""
        for name, changes in self._changes(upkeep).items():
            places = []
            for k in range(len(changes)):
                places.append(Change(*(f"{letter}{k}_{name}" for letter in "cxy")))
                for vector in places[-1][1:]:
                    self.work.keep(vector)
            self.waiting[name] = tuple(places)
        out = []
        for changes in self.waiting.values():
            out += [f"{c.scale} = 0.0" for c in changes]
            out += [f"{self._staying(name)} = 0.0" for c in changes for name in (c.x, c.y)]
        return out

    def calls(self, lines: list[Line], rows: WorkspaceRows, touched: set[str]) -> list[str]:
        """The products of a level, one call for each matrix, the first with what waits; rows are made for them."""
        for line in lines:
            rows.take(line.names[0])
        out = []
        for matrix in dict.fromkeys(map(products.matrix_of, lines)):
            own = [line for line in lines if products.matrix_of(line) == matrix]
            name = self.momentum if matrix == "M" else f"{INVERSE}{matrix}"
            changes = () if name in touched else self.waiting[name]
            touched.add(name)
            turned = [line for line in own if products.is_turned(line)]
            plain = [line for line in own if line not in turned]
            arguments = self._arguments(changes)
            for group in (plain, turned):
                arguments += [rows.vector(line.needs[0]) for line in group]
                arguments += [rows.vector(line.names[0]) for line in group]
            counts = len(changes), len(plain), len(turned)
            function = products.momentum_times(*counts[:2]) if matrix == "M" else products.inverse_times(*counts)
            out += [self._call(function, name, arguments), *(f"{c.scale} = 0.0" for c in changes)]
            if changes:
                self._first.setdefault(name, (function, len(plain), len(turned)))
        return out

    def tests(self, upkeep: Upkeep, known: Collection[str]) -> list[str]:
        """Inverses that have become too poor are made anew, and the step is done again."""
        out = []
        for k, inverse in enumerate(upkeep.inverses):
            residual, size = inverse.check
            if residual in known:
                diagonal = inverse.diagonal
                stays = diagonal in self.work.stay
                full = self._staying(diagonal) if stays else f"full({self.work.h}, {diagonal})"
                renew = self._call(products.renewed(), self.momentum, [full, inverse.turn, f"{INVERSE}{k}"])
                out += [f"if attempt == 0 and not {residual} <= {products.NEAR!r} * {size}:"]
                out += [f"    {renew}", "    continue"]
        return out

    def put_off(self, upkeep: Upkeep, rows: WorkspaceRows) -> list[str]:
        """Put the changes of this step where they wait."""
        out, loop = [], []
        for name, changes in self._changes(upkeep).items():
            for change, place in zip(changes, self.waiting[name], strict=True):
                out.append(f"{place.scale} = {change.scale}")
                for source, to in zip(change[1:], place[1:], strict=True):
                    loop.append(f"    {self.work.entry(self.work.stay[to])} = {rows.entry(source)}")
        return [*out, f"for k in range({self.work.h}):", *loop]

    def done(self) -> list[str]:
        """What waits is done, by the function of the next step, whose bits they then are wherever the rows are cut."""
        out = []
        for name, changes in self.waiting.items():
            if changes:
                function, *counts = self._first[name]
                arguments, read = self._arguments(changes), self._staying(changes[0].x)
                for count in counts:
                    results = [self.work.vector(self.work.new()) for _ in range(count)]
                    arguments += [read] * count + results
                out += [self._call(function, name, arguments), *(f"{c.scale} = 0.0" for c in changes)]
        return out

    def _changes(self, upkeep: Upkeep | None) -> dict[str, tuple[Change, ...]]:
        if upkeep is None:
            return {}
        inverses = {f"{INVERSE}{k}": inverse.changes for k, inverse in enumerate(upkeep.inverses)}
        return {self.momentum: upkeep.pairs, **inverses}

    def _arguments(self, changes: tuple[Change, ...]) -> list[str]:
        vectors = [self._staying(name) for letter in "xy" for name in (getattr(c, letter) for c in changes)]
        return [*(c.scale for c in changes), *vectors]

    def _staying(self, name: str) -> str:
        return self.work.vector(self.work.stay[name])

    def _call(self, function: GeneratedFunction, matrix: str, arguments: Iterable[str]) -> str:
        self.functions[function.name] = load_kernel(function.source, by_numba=True).__name__
        return f"{function.name}({', '.join([matrix, *arguments])})"
