"""Points of conjugate pairs that are the flow over a time, compiled: their choice, and paths with integrals.

The conditions of `kreisel.method.conjugate`, sum_p int_0^(x_p) Re v(iy_p + t) dt = h f, by Gauss's nodes on the paths
from iy_p to iy_p + x_p and Newton's method, whose Jacobian has the fields at their ends.  A path follows mu by Rayleigh
quotients, each with the vectors of the one before; their error is that of the vectors squared, so the quotient of
vectors in doubles has the digits of double-doubles.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from operator import add
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Complex
from kreisel.algebra.reuse import Identity, reused
from kreisel.baecklund import conjugate
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Lanes, Memory, Value, kind_of
from kreisel.graph.machine import address_of, kernel
from kreisel.kernels.exact.points import Choice, Formulas, Piece, complex_values
from kreisel.kernels.layout import Floats
from kreisel.kernels.steps import outputs_by_rows
from kreisel.record.calling import call
from kreisel.record.contract import ExactMap
from kreisel.record.model import Model

ROUNDS = 4  # of quotient and vectors at a node: an error of 0.2 of the vectors falls below 1e-10
NEAR = 1e-18  # relative: a squared change of mu, after which the next one is rounding
NODES, WIDTH = 14, 4  # of a path, at most; of vectors of nodes in double-doubles


class Paths(Formulas):
    """The conditions of a system, for at most d/2 pairs of one state.

    kernel(room, z, c, table, pairs, narrow, wide): Newton's steps in doubles, until changes are below `close`, and in
    double-doubles, then mu at the ends of the paths.  table (rows, 4) has nodes and weights, two doubles each; a path
    ends with a node 1.  At first a path follows the vectors from node to node; then from those stored there.
    """

    def __init__(self, model: Model):
        super().__init__(model)
        sums, d, m = 2 * (self.d + self.turns), self.d, self.most
        start = self._record(self.start, ("x", 3))
        v = len(start[1])
        follow = self._record(self.follow, ("x", 4), ("v", v))
        add = self._record(self.add, ("x", 7), ("v", v), ("s", sums))
        together = self._record(self.together, ("v", sums * WIDTH))
        step = self._record(self.step, ("h", 1), ("s", sums), ("e", m * d), ("dual", m * d), ("none", m))
        key = "pairs", *(graph.digest(outputs) for graph, outputs in (start, follow, add, together, step))
        self.kernel = kernel(key, 7, lambda f: self._write(f, start, follow, add, together, step))

    # -- formulas ------------------------------------------------------------------------------------------

    def start(self, z: Array, known: Any, x: Array) -> list[Any]:
        """mu and the vectors at iy, from y and mu."""
        state, constants = self._known(z, known, lambda v: v)
        return [*x[1:], *self._vectors(state, constants, Complex(0.0, x[0]), Complex(*x[1:]))[0]]

    def follow(self, z: Array, known: Any, x: Array, vectors: Array) -> list[Any]:
        """mu, vectors and fields at y, x t from the vectors at a node before; x: y, x, t."""
        state, constants = self._known(z, known, lambda v: v)
        y, re, im, t = x
        lam = Complex(re * t, y + im * t)

        def nearer(vectors: Sequence[Any]) -> tuple[Sequence[Any], Any]:
            mu = self._quotient(state, constants, lam, complex_values(vectors[2:]))
            change, size = mu - Complex(*vectors[:2]), mu.re * mu.re + mu.im * mu.im
            new = self._vectors(state, constants, lam, mu)[0]
            return [mu.re, mu.im, *new], (change.re * change.re + change.im * change.im) / size

        new, _ = y.graph.loop(nearer, [*vectors], NEAR, ROUNDS)
        left, right = complex_values(new[2:]).reshape(2, -1)
        Pi = right[:, None] * (left * (1 / (self._weighted(left, constants) * right).sum()))
        return [*new, *self._rates(state, constants, lam, Pi)[: self.d]]

    def add(self, z: Array, known: Any, x: Array, vectors: Array, total: Array) -> list[Any]:
        """The integrals of fields and Omega after a node, double-doubles; x: y, x, t, weight."""
        state, constants = self._known(z, known, DoubleDouble)
        re, (t, weight) = DoubleDouble(x[1]), (DoubleDouble(*x[k : k + 2]) for k in (3, 5))
        lam = Complex(re * t, DoubleDouble(x[0]))
        mu = self._quotient(state, constants, lam, complex_values([DoubleDouble(v) for v in vectors[2:]]))
        rates = self._rates(state, constants, lam, self._of_pairs("projector", state, constants, lam, mu=mu))
        new = [DoubleDouble(*pair) + re * weight * rate for pair, rate in zip(total.reshape(-1, 2), rates, strict=True)]
        return [part for x in new for part in (x.upper, x.lower)]

    def together(self, z: Array, known: Any, total: Array) -> list[Any]:
        """The sums of double-doubles over lanes (..., 2, lanes)."""
        sums = [reduce(add, map(DoubleDouble, *lanes)) for lanes in total.reshape(-1, 2, WIDTH)]
        return [part for x in sums for part in (x.upper, x.lower)]

    def step(self, z: Array, known: Any, h: Array, total: Array, ends: Array, dual: Array, none: Array) -> list[Any]:
        """Defects of the integrals, h f minus them, changes of x, and the missing rotation of the body.

        dual  (d, most): of the fields at the starts
        none  1 for each missing pair
        """
        state, constants = self._known(z, known, DoubleDouble)
        sums, time = [DoubleDouble(*pair) for pair in total.reshape(-1, 2)], DoubleDouble(h[0])
        flow = algebra.flatten(call(self.system.flow, state, constants), self.kinds)
        miss = [upper(time * f - s) for f, s in zip(flow, sums, strict=False)]
        dual = dual.reshape(self.d, self.most)
        J = (ends.reshape(self.most, self.d) @ dual).T + algebra.identity(self.most) * none  # near 1
        change = algebra.solve(J, (algebra.objects(miss) @ dual)[:, None])[:, 0]
        turn = [0.0] * self.turns
        if self.system.velocity is not None:
            Omega = algebra.coordinates(call(self.system.velocity, state, constants))
            turn = [upper(time * v - s) for v, s in zip(Omega, sums[self.d :], strict=True)]
        return [*miss, *change, *turn]

    # -- code ----------------------------------------------------------------------------------------------

    def _write(self, f: Function, start: Piece, follow: Piece, add: Piece, together: Piece, step: Piece) -> None:
        room, z, c, table, pairs, narrow, wide = f.arguments
        numbers, rows, d, width = f.doubles(room), f.doubles(table), self.d, len(start[1])
        at = {name: place.start for name, place in self.places.items()}
        memory = {"z": f.doubles(z), "c": f.doubles(c), "e": f.room(self.most * d)}
        memory |= {"s": f.room(2 * (d + self.turns)), **{k: numbers.beyond(at[k]) for k in ("h", "dual", "none")}}
        kept, (turn,) = f.room(self.most * (NODES + 2) * width), f.variables(1, INTEGER)
        plus, times, last = f.builder.fadd, f.builder.fmul, narrow + wide

        kind = kind_of(WIDTH)
        wide_sums = f.room(2 * (d + self.turns), kind)
        f.vectors(WIDTH)

        def run(piece: Piece, x: Sequence[Value] = (), v: Any = None, in_lanes: bool = False) -> list[Value]:
            numbers_kind = kind if in_lanes else DOUBLE

            def value(letter: str, i: int) -> Value:
                if letter in "xv":
                    return (x if letter == "x" else v)[i]
                return wide_sums[i] if in_lanes and letter == "s" else f.spread(memory[letter][i], numbers_kind)

            return f.outputs(*piece, value, numbers_kind)

        memory["e"].put([0.0] * (self.most * d))
        turn[0] = 0
        with f.while_(lambda: turn[0].compared("<=", last)):
            later = turn[0].compared(">", 0)
            final = f.builder.and_(later, turn[0].compared("==", last))
            exact = f.builder.and_(turn[0].compared(">=", narrow), turn[0].compared("<", last))
            own = Integer(f.builder, f.builder.zext(later, INTEGER))
            wide_sums.put([0.0] * (2 * (d + self.turns)))
            memory["s"].put([0.0] * (2 * (d + self.turns)))
            with f.loop(0, pairs) as p:
                y, x, slot = numbers[p + at["y"]], numbers.get(2, p * 2 + at["x"]), p * (NODES + 2)
                nodes, row = (f.builder.fptoui(numbers[p + at[name]], INTEGER) for name in ("nodes", "row"))
                begin, end = f.builder.select(final, nodes, INTEGER(0)), Integer(f.builder, nodes) + 1
                with f.where(own.compared("==", 0)):
                    kept.put(run(start, [y, *numbers.get(2, p * 2 + at["mu"])]), slot * width)
                with f.loop(Integer(f.builder, begin), end) as k:
                    t, _, weight, _ = rows.get(4, (k + Integer(f.builder, row)) * 4)
                    new = run(follow, [y, *x, t], kept.beyond((slot + k + own) * width))
                    kept.put(new[:-d], (slot + k + 1) * width)
                    numbers.put(new[:2], p * 2 + at["end"])
                    memory["e"].put(new[-d:], p * d)
                    for i, rate in enumerate(new[-d:]):
                        memory["s"][2 * i] = plus(memory["s"][2 * i], times(times(x[0], weight), rate))
                with f.where(exact), f.loop(0, end, WIDTH) as k:  # the end of the table has no weight
                    lanes = f.lanes(k, WIDTH, end)
                    vectors = Lanes(kept, [slot + lane + 1 for lane in lanes], width)
                    node = Lanes(rows, [lane + Integer(f.builder, row) for lane in lanes], 4).get(range(4))
                    x_wide = [*(f.spread(value, kind) for value in (y, *x)), *node]
                    wide_sums.put(run(add, x_wide, vectors, True))
            with f.where(exact):
                memory["s"].put(run(together, v=wide_sums.of(DOUBLE)))
            with f.where(turn[0].compared("<", last)):
                numbers.put(run(step), at["miss"])
                near = f.builder.and_(self._moved(f, numbers), turn[0].compared("<", narrow))
                with f.where(near):
                    turn[0] = narrow - 1
            turn[0] = turn[0] + 1

    def _moved(self, f: Function, numbers: Memory) -> Value:
        """Whether all changes of x, which are added, are below `close`: a bit."""
        (far,) = f.variables(1)
        far[0] = -np.inf
        x, changes, close = (self.places[name].start for name in ("x", "change", "close"))
        for i in range(self.most):
            change = numbers[changes + i]
            numbers[x + 2 * i] = f.builder.fadd(numbers[x + 2 * i], change)
            beyond = f.builder.fsub(f.intrinsic("fabs", change), numbers[close + i])
            far[0] = f.builder.select(f.builder.fcmp_ordered("<", far[0], beyond), beyond, far[0])
        return f.builder.fcmp_ordered("<=", far[0], numbers.value_of(0.0))


class Points(Formulas):
    """lam and mu of the one map of a system that is the flow over a time."""

    def __init__(self, model: Model):
        super().__init__(model)
        self.map = cast("ExactMap", self.system.exact_map)
        letters = {"z": (self.d, False), "c": (sum(self.n**axes for axes in self.axes.values()), False)}
        self._kernels = [
            outputs_by_rows(*self._record(function, ("x", count)), {**letters, "x": (count, True)})
            for count, function in enumerate((self._of_time, self._of_lam), 1)
        ]

    def _of_time(self, z: Array, known: Any, x: Array) -> list[Any]:
        state, constants = self._known(z, known, DoubleDouble)
        lam, sound = call(self.map.point, state, {**constants, "dt": x[0]})
        return [*self._of_lam(z, known, algebra.parts(lam)), sound]

    def _of_lam(self, z: Array, known: Any, x: Any) -> list[Any]:
        state, constants = self._known(z, known, lambda v: v)
        return [*x, *algebra.parts(call(self.map.level, state, {**constants, "lam": Complex(*x)}))]

    def __call__(self, z: Floats, c: Floats, x: Floats) -> Floats:
        """`NUMBERS` (rows, lanes, 4) of states and parameters (lanes, ...), for lam x (rows, lanes, 2).

        For times x (rows, lanes, 1) also whether they are sound: positive if so.
        """
        rows, lanes, count = x.shape
        out = np.empty((rows, lanes, 6 - count))
        self._kernels[count - 1](*map(address_of, (z, c, x, out)), rows, lanes)
        return out


class Room:
    """The row of doubles of a state z (d,) with parameters c, and the calls of the kernels that share it."""

    def __init__(self, model: Model, z: Floats, c: Floats):
        self._choice, self._paths = reused(
            (Room, Identity(model.system), model.n), lambda: (Choice(model), Paths(model))
        )
        self.values, self._z, self._c, self.most = np.zeros(self._choice.size), z, c, self._choice.most
        self._addresses = [address_of(x) for x in (self.values, z, c)]

    def __getitem__(self, name: str) -> list[float]:
        values: list[float] = self.values[self._choice.places[name]].tolist()
        return values

    def __setitem__(self, name: str, values: Any) -> None:
        self.values[self._choice.places[name].start :][: len(values)] = values

    def choose(self, most: int) -> None:
        """Write the points of `most` pairs or fewer."""
        self._choice.kernel(*self._addresses, most)

    def follow(self, nodes: Sequence[int], narrow: int = 0, wide: int = 0) -> None:
        """Newton's steps with Gauss's nodes for each path, narrow ones in doubles."""
        self["nodes"], self["row"] = nodes, [(k - 1) * (k + 2) // 2 for k in nodes]
        self._paths.kernel(*self._addresses, address_of(gauss()), len(nodes), narrow, wide)


@cache
def gauss() -> Floats:
    """Tables of nodes and weights, for even functions on [-1, 1]: 1, 2, ... nodes and the end, row by row."""
    tables = []
    for count in range(1, NODES + 1):
        columns = np.array([[*column, end] for column, end in zip(conjugate.legendre(2 * count), (1, 0), strict=True)])
        first = columns.astype(float)
        tables.append(np.stack([first, (columns - first).astype(float)], -1).swapaxes(0, 1).reshape(-1, 4))
    return np.concatenate(tables)
