"""Taylor series of a motion in fixed point, with a bound of the error that the series itself yields.

z' = f(z, p) is recorded as a graph of sums and products.  In each step t = t0 + h s, 0 <= s <= 1, the polynomial
u(s) = sum z_k s^k follows from (k + 1) z_{k+1} = h f_k, in integers that count 2^-bits.  It satisfies u' = h (f(u) +
r); the defect r is bounded by Taylor models of the same operations (coefficients that were cut off, rounding).  So the
error e of u, in a norm |D^-1 e|, obeys

    |e(t + h)| <= exp(h mean mu) |e(t)| + exp(h mean max(mu, 0)) h max |r|,
    mu = the largest eigenvalue of (B + B^T)/2,  B = D^-1 J D,

with the Jacobian J of f along u, its eigenvalues at 128 points of a step and a bound between them.  The
diagonal D balances the mean of |J|: any D is right, a good one makes the bound small.
[Moore, Interval Analysis, 1966; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section I.10]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from operator import mul
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.graph.arranging import pushed
from kreisel.graph.graph import IN, MINUS, PLUS, TIMES, Graph, Number, Operand, evaluated

INFLATION = 1 + 1e-6  # covers the rounding of the bounds, which are doubles
TUBE = 1e-9  # covers the change of mu within the error of u, which is far smaller
MOST_STEPS = 100_000
GUARD = 12  # bits: coefficients below them are rounding
POINTS = 128
TIES = 1e-6  # entries of the mean |J| below this part of the largest do not matter to D


class Piece(NamedTuple):
    """A step: t = begin + length s, and the coefficients (d lists) of u(s)."""

    begin: Fraction
    length: Fraction
    coefficients: list[list[int]]


class Solution:
    """The solution of z' = f(z, p), z(0) = start, for 0 <= t <= end.

    flow     f(z, p) on arrays of recorded values: sums, differences and products
    start, parameters   rationals
    bits     fixed-point bits of the coefficients; the order of the series is 0.35 bits
    bounds   (pieces, d): bounds of the error of each component within each piece
    """

    def __init__(
        self,
        flow: Callable[[Any, Any], Sequence[Any]],
        start: Sequence[Fraction],
        parameters: Sequence[Fraction],
        end: Fraction,
        bits: int,
    ):
        self.bits, self.order, self.end = bits, int(0.35 * bits), end
        graph = Graph()
        z, p = graph.inputs("z", len(start)), graph.inputs("p", len(parameters))
        self._field = _Operations(graph, list(flow(z, p)))
        self._parameters = [_fixed(value, bits) for value in parameters]
        self.pieces = self._solved([_fixed(value, bits) for value in start])
        self._begins = [float(piece.begin) for piece in self.pieces]
        self.bounds = self._bounded(graph)

    def at(self, times: Sequence[Fraction]) -> tuple[Array, Array]:
        """The states (times, d), Fractions, and bounds (times, d) of their errors."""
        unit, d = math.ldexp(1.0, -self.bits), len(self._field.outputs)
        states, bounds = np.empty((len(times), d), dtype=object), np.empty((len(times), d))
        for row, time in enumerate(times):
            at = max(int(np.searchsorted(self._begins, float(time), side="right")) - 1, 0)
            while time < self.pieces[at].begin:
                at -= 1
            piece = self.pieces[at]
            s = _fixed((time - piece.begin) / piece.length, self.bits)
            states[row] = [Fraction(_horner(c, s, self.bits), 1 << self.bits) for c in piece.coefficients]
            slopes = [sum(k * abs(c) for k, c in enumerate(polynomial)) * unit for polynomial in piece.coefficients]
            bounds[row] = self.bounds[at] + (np.array(slopes) + 2 * self.order) * unit
        return states, bounds

    def _solved(self, state: list[int]) -> list[Piece]:
        """Pieces up to the end; the length of each is such that the last coefficients are about 2^-bits."""
        pieces, begin, length = list[Piece](), Fraction(0), self.end / 64
        while begin < self.end:
            length = min(length, self.end - begin)
            coefficients = self._series(state, length)
            sizes = [max(abs(c[k]) for c in coefficients) for k in range(1, self.order + 1)]
            last = max((k for k, size in enumerate(sizes, 1) if size >> GUARD), default=0)
            decay = 2 ** ((math.log2(sizes[last - 1]) - self.bits) / last) if last else 0.0
            factor = min(0.98 * 2 ** (-self.bits / self.order) / decay, 4.0) if decay else 4.0
            if not max(sizes[-2:]) >> GUARD:
                pieces.append(Piece(begin, length, coefficients))
                begin, state = begin + length, [sum(c) for c in coefficients]
            length = Fraction(float(length) * factor).limit_denominator(1 << 40)
            if len(pieces) > MOST_STEPS or not length:
                raise ArithmeticError("the Taylor series needs too many steps: the motion leaves every bound")
        return pieces

    def _series(self, state: list[int], length: Fraction) -> list[list[int]]:
        """The coefficients of u in a step."""
        field, bits, z = self._field, self.bits, [[value] for value in state]
        values = {at: z[index] for at, index in field.states}
        values.update({at: [self._parameters[index]] for at, index in field.parameters})
        values.update({key: [_fixed(Fraction(value), bits)] for key, value in field.floats.items()})
        values.update({node.at: list[int]() for node in field.nodes})
        steps = [
            (values[n.at], n.kind, values[n.left], n.left_sign, values[n.right], n.right_sign) for n in field.nodes
        ]
        outputs = [(row, *field.entry(output, values, bits)) for row, output in zip(z, field.outputs, strict=True)]
        numerator, denominator = length.numerator, length.denominator
        for k in range(self.order):
            for out, kind, left, left_sign, right, right_sign in steps:
                if kind == SERIES:
                    out.append((left_sign * right_sign * sum(map(mul, left, reversed(right)))) >> bits)
                elif kind == SCALED:
                    out.append((left_sign * right_sign * left[0] * right[k]) >> bits if k < len(right) else 0)
                else:
                    a, b = left[k] if k < len(left) else 0, right[k] if k < len(right) else 0
                    out.append(left_sign * a + right_sign * b)
            for row, values_of, sign in outputs:
                rate = sign * values_of[k] if k < len(values_of) else 0
                row.append(rate * numerator // (denominator * (k + 1)))
        return z

    def _bounded(self, graph: Graph) -> Array:
        """The bounds of the error at the end of each piece."""
        slopes, entries = _jacobian(graph, self._field.outputs)
        unit, order = math.ldexp(1.0, -self.bits), self.order
        parameters = [value * unit for value in self._parameters]
        scale = self._balance(slopes, entries, parameters)
        powers = ((np.arange(POINTS) + 0.5) / POINTS)[:, None] ** np.arange(order)
        rounding = unit * order * (order + 1) / 2
        error, bounds = float(np.linalg.norm(unit / scale)), []
        for piece in self.pieces:
            length = float(piece.length)
            models = _Models(parameters, piece.coefficients, order, unit)
            defects = [length * model.remainder + rounding for model in models.run(graph, self._field.outputs)]
            of = dict(zip(entries, models.run(slopes, list(entries.values())), strict=True))
            growth, outward = (length * rate + TUBE * length for rate in _growth(of, scale, powers))
            defect = float(np.linalg.norm(defects / scale))
            bounds.append(math.exp(outward * INFLATION) * (error + defect) * INFLATION * scale)
            error = (math.exp(growth + 1e-6 * abs(growth)) * error + math.exp(outward * INFLATION) * defect) * INFLATION
        return np.array(bounds)

    def _balance(self, slopes: Graph, entries: Mapping[tuple[int, int], Operand], parameters: list[float]) -> Array:
        """The diagonal of D: powers of two for which the rows and columns of D^-1 mean|J| D have like sums."""
        from scipy.linalg import matrix_balance

        d, unit = len(self._field.outputs), math.ldexp(1.0, -self.bits)
        mean = np.zeros((d, d))
        for piece in self.pieces[:: max(1, len(self.pieces) // 50)]:
            state = [c[0] * unit for c in piece.coefficients]
            arguments = {"z": state, "p": parameters}

            def inputs(letter: str, index: int, arguments: Mapping[str, list[float]] = arguments) -> float:
                return arguments[letter][index]

            values = evaluated(slopes, list(entries.values()), inputs)
            for place, value in zip(entries, values, strict=True):
                mean[place] += abs(value)
        mean[mean == 0] = TIES * mean.max()
        _, (scale, _) = matrix_balance(mean, permute=False, separate=True)
        return np.asarray(scale / scale.max())


SERIES, SCALED, SUM = range(3)


class _Step(NamedTuple):
    """An operation: its kind, its operands' places and signs."""

    kind: int
    at: int
    left: int
    left_sign: int
    right: int
    right_sign: int


class _Operations:
    """The operations of a function of z and p, in order."""

    def __init__(self, graph: Graph, outputs: list[Operand]):
        self.outputs = outputs
        needed = graph.needed(outputs)
        inputs = [at for at in needed if graph.nodes[at][0] == IN]
        self.states = [(at, graph.nodes[at][2]) for at in inputs if graph.nodes[at][1] == "z"]
        self.parameters = [(at, graph.nodes[at][2]) for at in inputs if graph.nodes[at][1] == "p"]
        self.floats: dict[int, float] = {}
        constant = {at for at, _ in self.parameters}
        self.nodes = list[_Step]()
        for at in needed:
            operation, *operands = graph.nodes[at]
            if operation == IN:
                continue
            if operation not in (PLUS, MINUS, TIMES):
                raise TypeError(f"expected a field of sums, differences and products, got {operation}")
            left, right = (self._place(operand) for operand in operands)
            if operation == MINUS:
                right = right[0], -right[1]
            fixed = [place < 0 or place in constant for place, _ in (left, right)]
            if all(fixed):
                constant.add(at)
            if fixed[1] and not fixed[0]:
                left, right = right, left
            kind = SUM if operation != TIMES else SCALED if any(fixed) else SERIES
            self.nodes.append(_Step(kind, at, *left, *right))

    def _place(self, operand: Operand) -> tuple[int, int]:
        if isinstance(operand, Number):
            return operand.at, -1 if operand.negative else 1
        key = -1 - len(self.floats)
        self.floats[key] = float(operand)
        return key, 1

    @staticmethod
    def entry(output: Operand, values: Mapping[int, list[int]], bits: int) -> tuple[list[int], int]:
        """The coefficients of an output and their sign."""
        if isinstance(output, Number):
            return values[output.at], -1 if output.negative else 1
        return [_fixed(Fraction(float(output)), bits)], 1


class _Model(NamedTuple):
    """A function of s: a polynomial in doubles, and a bound of the difference."""

    polynomial: Array
    remainder: float

    def __neg__(self) -> _Model:
        return _Model(-self.polynomial, self.remainder)

    def plus(self, term: _Model) -> _Model:
        short, long = sorted((self.polynomial, term.polynomial), key=len)
        total = long.copy()
        total[: len(short)] += short
        return _Model(total, self.remainder + term.remainder)

    def size(self) -> float:
        """A bound of the absolute value for 0 <= s <= 1."""
        return float(abs(self.polynomial).sum()) + self.remainder


class _Models:
    """Taylor models of one step, of polynomials below `order`.

    They represent the polynomials in integers: a product is rounded by one unit a coefficient, and the rest is cut off.
    """

    def __init__(self, parameters: list[float], coefficients: list[list[int]], order: int, unit: float):
        self.order, self.unit, self._parameters = order, unit, parameters
        self._states = [np.array([float(c) for c in row]) * unit for row in coefficients]

    def run(self, graph: Graph, outputs: Sequence[Operand]) -> list[_Model]:
        """The Taylor models of outputs of a graph."""
        operations = {
            PLUS: lambda x, y: self.of(x).plus(self.of(y)),
            MINUS: lambda x, y: self.of(x).plus(-self.of(y)),
            TIMES: lambda x, y: self.product(self.of(x), self.of(y)),
        }
        return [self.of(output) for output in evaluated(graph, outputs, self.input, operations)]

    def input(self, letter: str, index: int) -> _Model:
        """A component of the state, or a parameter."""
        return _Model(self._states[index], 0.0) if letter == "z" else self.of(self._parameters[index], self.unit)

    def of(self, value: Any, remainder: float = 0.0) -> _Model:
        """A model itself, or a float as a model."""
        return value if isinstance(value, _Model) else _Model(np.array([float(value)]), remainder)

    def product(self, left: _Model, right: _Model) -> _Model:
        if len(right.polynomial) == 1 < len(left.polynomial):
            left, right = right, left
        series, cut = np.convolve(left.polynomial, right.polynomial), 0.0
        if len(series) > self.order:
            sizes = np.convolve(abs(left.polynomial), abs(right.polynomial))
            series, cut = series[: self.order], float(sizes[self.order :].sum())
        errors = left.remainder * right.size() + right.remainder * (left.size() - left.remainder)
        return _Model(series, (errors + cut) * INFLATION + self.order * self.unit)


def _growth(of: Mapping[tuple[int, int], _Model], scale: Array, powers: Array) -> tuple[float, float]:
    """Bounds of the means over a step of mu and of max(mu, 0)."""
    d, (points, order) = len(scale), powers.shape
    between, polynomials = np.zeros((d, d)), np.zeros((order, d, d))
    for (i, j), model in of.items():
        factor = scale[j] / scale[i] / 2
        coefficients = model.polynomial[:order] * factor
        for place in ((i, j), (j, i)):
            polynomials[: len(coefficients), *place] += coefficients
            between[place] += model.remainder * factor + abs(model.polynomial[order:]).sum() * factor
    symmetric = np.einsum("mk,kij->mij", powers, polynomials)
    between += (abs(polynomials) * np.arange(order)[:, None, None]).sum(0) / (2 * points)
    largest = np.linalg.eigvalsh(symmetric)[:, -1]
    largest = largest + np.linalg.norm(between)
    return float(largest.mean()), float(np.maximum(largest, 0).mean())


def _jacobian(graph: Graph, outputs: list[Operand]) -> tuple[Graph, dict[tuple[int, int], Operand]]:
    """The entries (i, j) of the Jacobian of a function of z that are not 0, in a separate graph."""
    tangent, slopes = pushed(graph, outputs, "p")
    joined, entries, d = Graph(), dict[tuple[int, int], Operand](), len(outputs)
    for column in range(d):

        def inputs(letter: str, index: int, column: int = column) -> Any:
            return float(index == column) if letter == "vz" else joined.input(letter, index)

        for row, slope in enumerate(evaluated(tangent, slopes[d:], inputs)):
            if isinstance(slope, Number) or slope:
                entries[row, column] = slope
    return joined, entries


def _fixed(value: Fraction, bits: int) -> int:
    return (value.numerator << bits) // value.denominator


def _horner(coefficients: list[int], s: int, bits: int) -> int:
    total = 0
    for c in reversed(coefficients):
        total = ((total * s) >> bits) + c
    return total
