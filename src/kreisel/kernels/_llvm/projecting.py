"""The projection as a straight line of LLVM's operations, made from its program.

What is known before, numbers 0 and 1 above all, is not computed: slopes of sums, gradients that have few entries, the
second double of a state and of constants, which is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from kreisel.kernels._llvm.numbers import DOUBLE, INDEX, INTEGER, everywhere, llvm_intrinsic
from kreisel.kernels._llvm.operations import Operation

Number = Any  # of LLVM, or a float: known
Pair = tuple[Number, Number]  # the sum of two, the second within rounding errors of the terms of the first
ADD, SUBTRACT, MULTIPLY, DIVIDE = range(4)  # `OPERATIONS` of kreisel.kernels.projection.program
HUGE = 1e300
FMA, ROOT, SIZE = (llvm_intrinsic(name) for name in ("fma", "sqrt", "fabs"))


class Arithmetic:
    """Operations on numbers of one kind, in doubles and in pairs of them."""

    def __init__(self, builder: ir.IRBuilder, kind: ir.Type):
        self.builder, self.kind = builder, kind

    def value(self, x: Number) -> Any:
        """A number of LLVM."""
        return everywhere(self.kind, x) if isinstance(x, float) else x

    def plus(self, x: Number, y: Number) -> Number:
        if isinstance(x, float) and isinstance(y, float):
            return x + y
        if _is(x, 0) or _is(y, 0):
            return y if _is(x, 0) else x
        return self.builder.fadd(self.value(x), self.value(y))

    def minus(self, x: Number, y: Number) -> Number:
        if isinstance(y, float):
            return self.plus(x, -y)
        return self.builder.fneg(y) if _is(x, 0) else self.builder.fsub(self.value(x), y)

    def times(self, x: Number, y: Number) -> Number:
        if isinstance(x, float):
            x, y = y, x
        if isinstance(x, float):
            return x * y
        if _is(y, 0) or _is(y, 1):
            return x if y else 0.0
        return self.builder.fneg(x) if _is(y, -1) else self.builder.fmul(x, self.value(y))

    def fused(self, x: Number, y: Number, z: Number) -> Number:
        """x y + z, rounded once."""
        if _is(x, 0) or _is(y, 0):
            return z
        if _is(z, 0) or (isinstance(x, float) and isinstance(y, float)):
            return self.plus(self.times(x, y), z)
        if isinstance(x, float):
            x, y = y, x
        if _is(y, 1) or _is(y, -1):
            return self.plus(z, x) if y == 1 else self.minus(z, x)
        return FMA(self.builder, x, self.value(y), self.value(z))

    def negative(self, x: Number) -> Number:
        return self.times(x, -1.0)

    def over(self, x: Number, y: Number) -> Number:
        return self.builder.fdiv(self.value(x), self.value(y))

    def root(self, x: Number) -> Number:
        return ROOT(self.builder, self.value(x))

    def size(self, x: Number) -> Number:
        return abs(x) if isinstance(x, float) else SIZE(self.builder, x)

    def where_less(self, x: Number, y: Number, yes: Number, no: Number) -> Number:
        less = self.builder.fcmp_ordered("<", self.value(x), self.value(y))
        return self.builder.select(less, self.value(yes), self.value(no))

    def larger(self, x: Number, y: Number) -> Number:
        return self.where_less(x, y, y, x)

    def pair_sum(self, x: Pair, y: Pair, sign: float) -> Pair:
        """x + y, or x - y for sign -1."""
        (a, la), (b, lb) = x, y
        if _is(a, 0) or _is(b, 0):
            return self.fused(b, sign, a), self.fused(lb, sign, la)
        s = self.fused(b, sign, a)
        t = self.minus(s, a)
        error = self.plus(self.minus(a, self.minus(s, t)), self.minus(self.times(b, sign), t))
        return s, self.plus(error, self.fused(lb, sign, la))

    def pair_product(self, x: Pair, y: Pair) -> Pair:
        (a, la), (b, lb) = x, y
        p = self.times(a, b)
        error = 0.0 if _is_power(a) or _is_power(b) else self.fused(a, b, self.negative(p))
        return p, self.fused(a, lb, self.fused(la, b, error))

    def pair_quotient(self, x: Pair, y: Pair) -> tuple[Pair, Number]:
        """And the inverse of y."""
        (a, la), (b, lb) = x, y
        q = self.over(1.0, b)
        p = self.times(a, q)
        rest = self.plus(self.fused(self.negative(p), b, a), self.fused(self.negative(p), lb, la))
        return (p, self.times(rest, q)), q

    def pair_root(self, x: Pair) -> tuple[Pair, Number]:
        """And 1/2 over it."""
        p = self.root(x[0])
        q = self.over(0.5, p)
        return (p, self.times(self.plus(self.fused(self.negative(p), p, x[0]), x[1]), q)), q


def _is(x: Number, number: float) -> bool:
    return isinstance(x, float) and x == number


def _is_power(x: Number) -> bool:
    """Whether a known number is 0 or a power of 2, with which products are exact."""
    return isinstance(x, float) and math.frexp(x)[0] in (0, 0.5, -0.5)


class Rows:
    """The numbers of the lanes `at` in an array at an address, `stride` for each lane."""

    def __init__(self, numbers: Arithmetic, address: Any, at: Sequence[Any], stride: Any):
        self._numbers, self._builder = numbers, numbers.builder
        base = self._builder.inttoptr(address, DOUBLE.as_pointer())
        self._rows = [self._builder.gep(base, [self._builder.mul(lane, stride)]) for lane in at]

    def _place(self, row: Any, i: int) -> Any:
        return self._builder.gep(row, [INTEGER(i)])

    def get(self, i: int) -> Any:
        loaded = [self._builder.load(self._place(row, i)) for row in self._rows]
        if not isinstance(self._numbers.kind, ir.VectorType):
            return loaded[0]
        vector = ir.Constant(self._numbers.kind, ir.Undefined)
        for k, number in enumerate(loaded):
            vector = self._builder.insert_element(vector, number, INDEX(k))
        return vector

    def put(self, i: int, x: Number) -> None:
        value = self._numbers.value(x)
        for k, row in enumerate(self._rows):
            one = self._builder.extract_element(value, INDEX(k)) if len(self._rows) > 1 else value
            self._builder.store(one, self._place(row, i))


class Projection:
    """The operations of a projection.

    size, ops, outs, cones, columns, first   as in `Program`; ops are (what, x, y), one cone for each invariant
    literals                                 as in `Program`
    """

    def __init__(
        self, size: int, ops: Any, outs: Any, cones: Any, columns: Any, literals: Any, first: int, tau: float,
        flat: float, gain: float, eps: float,
    ):  # fmt: skip
        self.size, self.ops, self.outs, self.cones = size, ops, outs, cones
        self.columns, self.literals, self.first = columns, literals, first
        self.tau, self.flat, self.gain, self.eps = tau, flat, gain, eps

    def emit(self, builder: ir.IRBuilder, kind: ir.Type, table: Any, at: Sequence[Any], begin: Any) -> None:
        """Project the lanes `at` of what the table has the addresses of, or only take their values."""
        f = Arithmetic(builder, kind)
        words = builder.inttoptr(table, INTEGER.as_pointer())
        aims, worst, z, c, stride = (builder.load(builder.gep(words, [INTEGER(i)])) for i in range(5))
        k = len(self.outs)
        targets = Rows(f, aims, at, INTEGER(4 * k))
        state = Rows(f, z, at, INTEGER(self.size))
        constants = Rows(f, c, at, stride)
        x: list[Pair] = [(state.get(i), 0.0) for i in range(self.size)]
        x += [(constants.get(j), 0.0) for j in self.columns]
        x += [(float(number), 0.0) for number in self.literals]
        inverses = self._forward(f, x)
        with builder.if_else(builder.icmp_signed("!=", begin, INTEGER(0))) as (start, go_on):
            with start:
                self._start(f, x, targets)
            with go_on:
                J = self._gradients(f, [high for high, _ in x], inverses)
                self._correct(f, x, J, targets, Rows(f, worst, at, INTEGER(k)), state)

    def _forward(self, f: Arithmetic, x: list[Pair]) -> dict[int, Number]:
        """Add the results to the registers; and the inverses that slopes need."""
        inverses = {}
        for what, i, j in self.ops:
            if what in (ADD, SUBTRACT):
                x.append(f.pair_sum(x[i], x[j], 1.0 if what == ADD else -1.0))
            elif what == MULTIPLY:
                x.append(f.pair_product(x[i], x[j]))
            else:
                value, inverses[len(x)] = f.pair_quotient(x[i], x[j]) if what == DIVIDE else f.pair_root(x[i])
                x.append(value)
        return inverses

    def _start(self, f: Arithmetic, x: list[Pair], targets: Rows) -> None:
        """The values, and the sizes of their terms: each sum with all its terms of one sign."""
        base = len(x) - len(self.ops)
        sizes = [f.size(high) for high, _ in x[:base]]
        for what, i, j in self.ops:
            a, b = sizes[i], sizes[j]
            if what in (ADD, SUBTRACT):
                sizes.append(f.plus(a, b))
            elif what == MULTIPLY:
                sizes.append(f.times(a, b))
            else:
                sizes.append(f.over(a, b) if what == DIVIDE else f.root(a))
        for j, out in enumerate(self.outs):
            for i, value in enumerate((*x[out], sizes[out])):
                targets.put(4 * j + i, value)

    def _gradients(self, f: Arithmetic, x: list[Number], inverses: dict[int, Number]) -> list[dict[int, Number]]:
        """Of each invariant its slopes in the numbers of the state, those that are not 0."""
        base, rows = len(x) - len(self.ops), []
        varying = {*range(self.first, self.size), *(base + i for cone in self.cones for i in cone)}
        for out, cone in zip(self.outs, self.cones, strict=True):
            slopes: dict[int, Number] = {out: 1.0}

            def back(register: int, slope: Number, by: Number, slopes: dict[int, Number] = slopes) -> None:
                if register in varying:
                    slopes[register] = f.fused(slope, by, slopes.get(register, 0.0))

            for n in cone:
                what, i, j = self.ops[n]
                slope = slopes.pop(base + n, 0.0)
                if what in (ADD, SUBTRACT):
                    back(i, slope, 1.0)
                    back(j, slope, 1.0 if what == ADD else -1.0)
                elif what == MULTIPLY:
                    back(i, slope, x[j])
                    back(j, slope, x[i])
                else:
                    back(i, slope, inverses[base + n])
                    if what == DIVIDE:
                        back(j, slope, f.negative(f.times(x[base + n], inverses[base + n])))
            rows.append({i: slope for i, slope in sorted(slopes.items()) if not _is(slope, 0)})
        return rows

    def _correct(
        self, f: Arithmetic, x: list[Pair], J: list[dict[int, Number]], targets: Rows, worst: Rows, state: Rows
    ) -> None:
        """One step of Gauss and Newton, and what is known of it."""
        unit = f.over(1.0, f.root(_dot(f, {i: x[i][0] for i in range(self.size)})))
        lack = [self._lack(f, x[out], j, J[j], unit, targets, worst) for j, out in enumerate(self.outs)]
        k = len(J)
        G = {(j, q): _dot(f, J[j], J[q]) for j in range(k) for q in range(j, k)}
        G |= {(j, j): f.plus(G[j, j], self.tau) for j in range(k)}
        for j in range(k):
            pivot = f.over(1.0, G[j, j])
            for q in range(j + 1, k):
                factor = f.negative(f.times(G[j, q], pivot))
                for i in range(q, k):
                    G[q, i] = f.fused(factor, G[j, i], G[q, i])
                lack[q] = f.fused(factor, lack[j], lack[q])
            G[j, j] = pivot
        for j in reversed(range(k)):
            for q in range(j + 1, k):
                lack[j] = f.fused(f.negative(G[j, q]), lack[q], lack[j])
            lack[j] = f.times(lack[j], G[j, j])
        for i in range(self.first, self.size):
            value = x[i][0]
            for j in range(k):
                value = f.fused(f.negative(J[j].get(i, 0.0)), lack[j], value)
            state.put(i, value)

    def _lack(
        self, f: Arithmetic, found: Pair, j: int, row: dict[int, Number], unit: Number, targets: Rows, worst: Rows
    ) -> Number:
        """Make a row of J of length 1; by how much its invariant is to change, in that unit."""
        high, low, terms, lead = (targets.get(4 * j + i) for i in range(4))
        flat = f.times(terms, f.times(unit, self.flat))
        total = f.root(f.fused(flat, flat, _dot(f, row)))
        scale = f.where_less(0.0, total, f.over(1.0, total), 0.0)
        scale = f.where_less(total, HUGE, scale, 0.0)  # of what is not finite here too
        for i, slope in row.items():
            row[i] = f.where_less(0.0, scale, f.times(scale, slope), 0.0)
        lack = f.plus(f.minus(found[0], high), f.minus(found[1], low))
        lack = f.where_less(f.size(lack), HUGE, lack, 0.0)
        half = f.times(0.5, f.plus(lack, lead))
        lead = f.fused(self.gain, f.minus(half, lead), lead)
        distance = f.times(scale, f.times(unit, 1.0 / self.eps))
        farthest = f.larger(worst.get(j), f.times(f.size(lack), distance))
        if self.first:  # what binds an orientation has no frequency
            lead = 0.0
        else:
            lead = f.where_less(farthest, f.times(f.size(lead), distance), 0.0, lead)
            targets.put(4 * j + 3, lead)
        worst.put(j, farthest)
        return f.times(f.plus(lack, lead), scale)


def _dot(f: Arithmetic, x: dict[int, Number], y: dict[int, Number] | None = None) -> Number:
    total: Number = 0.0
    for i, number in x.items():
        total = f.fused(number, (x if y is None else y).get(i, 0.0), total)
    return total


def projection(width: int, **program: Any) -> Operation:
    """The projection of `width` lanes from `lane` on, called with (table, lane, last, begin).

    The table has the addresses of targets, worst, z, constants, and how many constants a lane has.
    """
    code = Projection(**program)
    kind = DOUBLE if width == 1 else ir.VectorType(DOUBLE, width)

    def emit(builder: ir.IRBuilder, table: Any, lane: Any, last: Any, begin: Any) -> None:
        builder.function.attributes.add("nounwind")
        builder.function.attributes.alignstack = 64
        end = builder.sub(last, INTEGER(1))
        each = [builder.add(lane, INTEGER(w)) for w in range(width)]
        at = [builder.select(builder.icmp_signed("<", one, end), one, end) for one in each]
        code.emit(builder, kind, table, at, begin)

    return Operation("projection", emit)
