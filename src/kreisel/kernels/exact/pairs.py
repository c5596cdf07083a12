"""Points of conjugate pairs that are the flow over a time, compiled: their choice, and paths with integrals.

The conditions of `kreisel.method.conjugate`, sum_p int_0^(x_p) Re v(iy_p + t) dt = h f, by Gauss's nodes on the paths
from iy_p to iy_p + x_p and Newton's method, whose Jacobian has the fields at their ends.  A path follows mu by Rayleigh
quotients, each with the vectors of the one before; their error is that of the vectors squared, so the quotient of
vectors in doubles has the digits of double-doubles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, reduce
from math import cosh
from operator import add
from typing import Any, cast

import numpy as np
from llvmlite import ir

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import Complex
from kreisel.algebra.reuse import Identity, reused
from kreisel.baecklund import conjugate
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Lanes, Value, kind_of
from kreisel.graph.machine import Kernel, Link, address_of, kernel
from kreisel.kernels.exact.points import WIDTH, Choice, Formulas, Writing, complex_values, largest
from kreisel.kernels.layout import Floats, on_threads
from kreisel.kernels.steps import outputs_by_rows
from kreisel.method.conjugate import COPIES, FINE, MISSED, MOST_COPIES
from kreisel.record.calling import call
from kreisel.record.contract import ExactMap
from kreisel.record.model import Model

ROUNDS = 4  # of quotient and vectors at a node: an error of 0.2 of the vectors falls below 1e-10
NEAR = 1e-18  # relative: a squared change of mu, after which the next one is rounding
NODES = 14  # of a path, at most
REACH, FARTHEST = 0.4, 0.6  # of the distance of a branch point: of an x at the start of Newton's method, and later
MARGIN, LEAST = 1.25, 0.25  # of a share of such a distance, before Newton's method; of the largest, for any pair
DIGITS = 44.0  # natural logarithm of the relative error of the integrals: 11 nodes at FARTHEST
SHARES = [1 / cosh(DIGITS / (4 * k)) for k in range(1, NODES)]  # up to which 1, 2, ... nodes are enough
STEPS, MORE = (4, 1), (0, 2)  # of Newton's method, in doubles and in double-doubles; if fields are nearly dependent
SETTLED = 1e-10  # a change, relative to the interval, whose square is rounding
ENOUGH, SMALL = 1e-12, 1e-5  # a miss, relative to the move; a move, relative to the state
TRIALS = 8  # each with more copies of the pairs
WORK = 150_000  # a lane is worth this number of operations on lanes


class Paths(Formulas):
    """The conditions of a system, for at most d/2 pairs of one state.

    kernel(rooms, z, c, table, first, last, shares, count, phases, numbers): of lanes whose verdict is `FINE`, `numbers`
    (lanes, shares, most + 1, 4).  By Newton's steps in doubles, until changes are below `close`, and in
    double-doubles, in trials, each with more copies of the pairs, until they are the flow.  table (rows, 4) has nodes
    and weights, two doubles each; a path ends with a node 1.  At first a path follows the vectors from node to node;
    then all nodes begin with those stored there.

    With `count` complex shares, the pairs at iy + share slope instead, without a solution: the paths to x and, if there
    are three phases, before it to i Im x and from there to x, for the rotation, by a pair int Re Omega along it.
    """

    def __init__(self, model: Model):
        super().__init__(model)
        sums, d, m = 2 * (self.d + self.turns), self.d, self.most
        start = self._record(self.start, ("x", 3))
        v = len(start[1])
        self.pieces = {
            "start": start,
            "follow": self._record(self.follow, ("x", 4), ("v", v)),
            "add": self._record(self.add, ("x", 7), ("v", v), ("s", sums)),
            "together": self._record(self.together, ("v", sums * WIDTH)),
            "step": self._record(self.step, ("h", 1), ("s", sums), ("e", m * d), ("dual", m * d), ("none", m)),
        }
        functions: list[Callable[..., dict[str, Any]]] = [self.begin, self.plan, self.move, self.judge, self.finish]
        functions += [self.enter, self.lift, self.turn, self.reach]
        self.rules = {function.__name__: self._rule(function) for function in functions}
        pieces = [*self.pieces.values(), *(piece for piece, _ in self.rules.values())]
        key = "pairs", *(graph.digest(outputs) for graph, outputs in pieces)
        self.kernel = kernel(key, 10, lambda f: _Solving(self, f).write())

    # -- formulas ------------------------------------------------------------------------------------------

    def start(self, z: Array, inputs: Any, x: Array) -> list[Any]:
        """mu and the vectors at iy, from y and mu."""
        state, constants = self._converted(z, inputs, lambda v: v)
        return [*x[1:], *self._vectors(state, constants, Complex(0.0, x[0]), Complex(*x[1:]))[0]]

    def follow(self, z: Array, inputs: Any, x: Array, vectors: Array) -> list[Any]:
        """mu, vectors and fields at y, x t from the vectors at a node before; x: y, x, t."""
        state, constants = self._converted(z, inputs, lambda v: v)
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

    def add(self, z: Array, inputs: Any, x: Array, vectors: Array, total: Array) -> list[Any]:
        """The integrals of fields and Omega after a node, double-doubles; x: y, x, t, weight."""
        state, constants = self._converted(z, inputs, DoubleDouble)
        re, (t, weight) = DoubleDouble(x[1]), (DoubleDouble(*x[k : k + 2]) for k in (3, 5))
        lam = Complex(re * t, DoubleDouble(x[0]))
        mu = self._quotient(state, constants, lam, complex_values([DoubleDouble(v) for v in vectors[2:]]))
        rates = self._rates(state, constants, lam, self._of_pairs("projector", state, constants, lam, mu=mu))
        new = [DoubleDouble(*pair) + re * weight * rate for pair, rate in zip(total.reshape(-1, 2), rates, strict=True)]
        return [half for x in new for half in (x.upper, x.lower)]

    def together(self, z: Array, inputs: Any, total: Array) -> list[Any]:
        """The sums of double-doubles over lanes (..., 2, lanes)."""
        sums = [reduce(add, map(DoubleDouble, *lanes)) for lanes in total.reshape(-1, 2, WIDTH)]
        return [half for x in sums for half in (x.upper, x.lower)]

    def step(self, z: Array, inputs: Any, h: Array, total: Array, ends: Array, dual: Array, none: Array) -> list[Any]:
        """Defects of the integrals, h f minus them, changes of x, and the missing rotation of the body.

        dual  (d, most): of the fields at the starts
        none  1 for each missing pair
        """
        state, constants = self._converted(z, inputs, DoubleDouble)
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

    # -- trials --------------------------------------------------------------------------------------------

    def begin(self, slope: Array, radius: Array, none: Array, time: Any) -> dict[str, Any]:
        """The least number of copies."""
        far = reduce(largest, abs(slope * time / (radius + none)))
        copies = algebra.nearest(far / REACH + 0.5)
        verdict = algebra.where_less(copies, MOST_COPIES, FINE, COPIES)
        going = algebra.where_less(copies, MOST_COPIES, 1, 0)
        new = {"far": far, "copies": largest(copies, 1), "verdict": verdict, "going": going}
        return new | dict.fromkeys(("trial", "tight", "repeated"), 0)

    def plan(
        self, slope: Array, radius: Array, none: Array, time: Any, far: Any, copies: Any, tight: Any
    ) -> dict[str, Any]:
        """Small times, their reach, and nodes."""
        h, radius = time / copies, radius + none
        x, least = slope * h, LEAST * far / copies
        shares = [algebra.where_less(0, tight, FARTHEST, MARGIN * largest(s, least)) for s in abs(x) / radius]
        nodes = [1 + sum(algebra.where_less(most, share, 1, 0) for most in SHARES) for share in shares]
        return {
            "h": h,
            "x": [half for v in x for half in (v, 0.0)],
            "reach": [share * r + missing for share, r, missing in zip(shares, radius, none, strict=True)],
            "nodes": nodes,
            "row": [(k - 1) * (k + 2) / 2 for k in nodes],
            "narrow": STEPS[0],
            "last": sum(STEPS),
        }

    def move(self, x: Array, change: Array, close: Array) -> dict[str, Any]:
        """x with their changes, and how many of these are not small."""
        moving = sum(algebra.where_less(a, abs(b), 1, 0) for a, b in zip(close, change, strict=True))
        return {"x": [half for a, b in zip(x[::2], change, strict=True) for half in (a + b, 0.0)], "moving": moving}

    def judge(
        self,
        x: Array,
        reach: Array,
        change: Array,
        miss: Array,
        units: Array,
        h: Any,
        size: Any,
        copies: Any,
        trial: Any,
        tight: Any,
        repeated: Any,
    ) -> dict[str, Any]:
        """If the pairs are the flow; else more steps, or another trial."""
        select, enough = algebra.where_less, ENOUGH * largest(abs(h) * size, SMALL)
        outside = sum(select(abs(a), b, 0, 1) for a, b in zip(x[::2], reach, strict=True))
        unsettled = sum(select(SETTLED * b, abs(a), 1, 0) for a, b in zip(change, reach, strict=True))
        missed = sum(select(enough * b, abs(a), 1, 0) for a, b in zip(miss, units, strict=True))
        again = select(outside, 1, select(0, unsettled, 1 - repeated, 0), 0)
        next_trial = select(0, again, 0, select(0, outside + missed, 1, 0))
        copies = copies + next_trial * tight * largest(1, algebra.nearest(copies / 2 - 0.25))
        trial = trial + next_trial * tight
        return {
            "copies": copies,
            "trial": trial,
            "tight": select(0, next_trial, 1 - tight, tight),
            "repeated": again,
            "narrow": MORE[0],
            "last": sum(MORE),
            "going": select(trial, TRIALS, again + next_trial, 0),
            "verdict": select(trial, TRIALS, FINE, MISSED),
        }

    def finish(self, x: Array, y: Array, end: Array, mu: Array, none: Array) -> dict[str, Any]:
        identity = [0.0, y[0], *mu[:2]]
        rows = zip(none, x[::2], y + x[1::2], end[::2], end[1::2], strict=True)
        numbers = [
            algebra.where_less(0, missing, a, b) for missing, *row in rows for a, b in zip(identity, row, strict=True)
        ]
        return {"numbers": numbers + identity}

    # -- shares of a step of an order ----------------------------------------------------------------------

    def enter(self, y: Array, mu: Array, time: Any, copies: Any) -> dict[str, Any]:
        nodes, row = ([float(k)] * self.most for k in (NODES, (NODES - 1) * (NODES + 2) // 2))
        new = {"nodes": nodes, "row": row, "start": [*y, *mu], "h": time / copies, "going": 1.0, "narrow": 0.0}
        return new | dict.fromkeys(("rotation", "total"), [0.0] * self.turns)

    def lift(self, slope: Array, im: Any) -> dict[str, Any]:
        """To i Im x."""
        return {"x": [v for s in slope for v in (0.0, im * s)], "last": 0.0}

    def turn(self, y: Array, slope: Array, end: Array, re: Any, im: Any) -> dict[str, Any]:
        """From i Im x to x."""
        x = [v for s in slope for v in (re * s, 0.0)]
        return {"y": [*(y + im * slope)], "mu": [*end], "x": x, "last": 1.0}

    def reach(self, start: Array, slope: Array, rotation: Array, total: Array, re: Any, im: Any) -> dict[str, Any]:
        """To x."""
        x, new = [v * s for s in slope for v in (re, im)], {"total": [*(total + rotation)], "last": 0.0}
        return new | {"y": [*start[: self.most]], "mu": [*start[self.most :]], "x": x}


class _Solving(Writing):
    """Writes the kernel of `Paths`."""

    def __init__(self, of: Paths, f: Function):
        rooms, z, c, rows, self.first, self.beyond, shares, self.shares, self.phases, numbers = f.arguments
        super().__init__(of, f, rooms)
        self.share_of_step, self.numbers = f.doubles(shares), f.doubles(numbers)
        self.share, self.phase = f.variables(2, INTEGER)
        self.kind, sums = kind_of(WIDTH), 2 * (of.d + of.turns)
        self.rows, self.z, self.c = map(f.doubles, (rows, z, c))
        self.stride = len(of.pieces["start"][1])  # of mu and vectors at a node
        self.kept, self.turn = f.room(of.most * (NODES + 2) * self.stride), f.variables(1, INTEGER)[0]
        self.memory = {"e": f.room(of.most * of.d), "s": f.room(sums)}
        self.sums, self.wide_sums = f.room(of.d, self.kind), f.room(sums, self.kind)
        f.vectors(WIDTH)

    def run(self, name: str, x: Sequence[Value] = (), v: Any = None, kind: ir.Type = DOUBLE) -> list[Value]:
        def value(letter: str, i: int) -> Value:
            if letter in "xv":
                return (x if letter == "x" else v)[i]
            if kind != DOUBLE and letter == "s":
                return self.wide_sums[i]
            return self.f.spread(self.memory[letter][i], kind)

        graph, outputs = self.of.pieces[name]
        return self.f.outputs(graph, outputs, value, kind)

    def flag(self, name: str) -> Value:
        return self.is_less(self.value(0.0), self.out[self.at(name)])

    def write(self) -> None:
        f, of, rooms = self.f, self.of, self.out
        solved = self.shares.compared("==", 0)
        with f.loop(self.first, self.beyond) as lane:
            self.out = rooms.beyond(lane * of.size)
            self.memory |= {"z": self.z.beyond(lane * of.d), "c": self.c.beyond(lane * of.constants)}
            self.memory |= {k: self.out.beyond(self.at(k)) for k in ("h", "dual", "none")}
            self.share[0], self.phase[0] = 0, 3 - self.phases
            with f.where(f.builder.fcmp_ordered("==", self.out[self.at("verdict")], self.value(FINE))):
                with f.otherwise(solved) as (trials, paths):
                    with trials:
                        self.apply("begin")
                    with paths:
                        self.out[self.at("copies")] = self.shares.double()
                        self.apply("enter")
                with f.while_(lambda: self.flag("going")):
                    with f.otherwise(solved) as (trials, paths):
                        with trials, f.where(f.builder.not_(self.flag("repeated"))):
                            self.apply("plan")
                        with paths:
                            self.begin_path()
                    self.solve()
                    self.finish(lane)
                    self.out[self.at("going")] = 0.0
                    with f.otherwise(solved) as (trials, paths):
                        with trials:
                            self.apply("judge")
                        with paths:
                            self.end_path()

    def begin_path(self) -> None:
        """The path of a phase."""
        self.out.put(self.share_of_step.get(2, self.share[0] * 2), self.at("re"))
        for phase, rule in enumerate(("lift", "turn", "reach")):
            with self.f.where(self.phase[0].compared("==", phase)):
                self.apply(rule)

    def end_path(self) -> None:
        """The next phase, or the first one of the next share."""
        self.phase[0] = self.phase[0] + 1
        with self.f.where(self.phase[0].compared("==", 3)):
            self.phase[0] = 3 - self.phases
            self.share[0] = self.share[0] + 1
        self.out[self.at("going")] = (self.shares - self.share[0]).double()

    def finish(self, lane: Integer) -> None:
        """The numbers of a share."""
        self.apply("finish")
        size = 4 * (self.of.most + 1)
        share = lane * (self.shares + self.shares.below(1)) + self.share[0]
        self.numbers.put(self.out.get(size, self.at("numbers")), share * size)

    def solve(self) -> None:
        """Newton's steps, narrow ones in doubles, and mu at the ends."""
        f, turn, d = self.f, self.turn, self.d
        count, (narrow, last) = self.integer("count"), (self.integer(name) for name in ("narrow", "last"))
        self.memory["e"].put([0.0] * (self.of.most * d))
        turn[0] = 0
        with f.while_(lambda: turn[0].compared("<=", last)):
            exact = f.builder.and_(turn[0].compared(">=", narrow), turn[0].compared("<", last))
            self.wide_sums.put([0.0] * (2 * (d + self.of.turns)))
            self.memory["s"].put([0.0] * (2 * (d + self.of.turns)))
            self.sums.put([0.0] * d)
            with f.loop(0, count) as p:
                nodes, row, slot = self.integer("nodes", p), self.integer("row", p), p * (NODES + 2)
                path = [self.out[p + self.at("y")], *self.out.get(2, p * 2 + self.at("x"))]
                with f.otherwise(turn[0].compared("==", 0)) as (begin, again):
                    with begin:
                        self.walk(p, path, slot, nodes, row)
                    with again:
                        first = f.builder.select(turn[0].compared("==", last), nodes.value, INTEGER(0))
                        self.repeat(p, path, slot, nodes, row, Integer(f.builder, first))
                with f.where(exact):
                    self.add(path, slot, nodes, row)
            with f.where(exact):
                self.memory["s"].put(self.run("together", v=self.wide_sums.of(DOUBLE)))
            with f.where(turn[0].compared("<", last)):
                self.out.put(self.run("step"), self.at("miss"))
                self.apply("move")
                settled = f.builder.not_(self.flag("moving"))
                with f.where(f.builder.and_(settled, turn[0].compared("<", narrow))):
                    turn[0] = narrow - 1
            turn[0] = turn[0] + 1

    def walk(self, p: Integer, path: list[Value], slot: Integer, nodes: Integer, row: Integer) -> None:
        """From node to node."""
        mu = self.out.get(2, p * 2 + self.at("mu"))
        self.kept.put(self.run("start", [path[0], *mu]), slot * self.stride)
        with self.f.loop(0, nodes + 1) as k:
            t, _, weight, _ = self.rows.get(4, (k + row) * 4)
            new = self.run("follow", [*path, t], self.kept.beyond((slot + k) * self.stride))
            self.kept.put(new[: self.stride], (slot + k + 1) * self.stride)
            self.put_end(p, new)
            for i, rate in enumerate(new[self.stride :]):
                change = self.times(self.times(path[1], weight), rate)
                self.memory["s"][2 * i] = self.plus(self.memory["s"][2 * i], change)

    def repeat(
        self, p: Integer, path: list[Value], slot: Integer, nodes: Integer, row: Integer, first: Integer
    ) -> None:
        """Nodes from the first one on, each from its vectors in the step before."""
        f, wide_path = self.f, [self.f.spread(x, self.kind) for x in path]
        with f.loop(first, nodes + 1, WIDTH) as k:
            lanes = f.lanes(k, WIDTH, nodes + 1)  # the end, again and again, has no weight
            t, _, weight, _ = Lanes(self.rows, [lane + row for lane in lanes], 4).get(range(4))
            kept = Lanes(self.kept, [slot + lane + 1 for lane in lanes], self.stride)
            new = self.run("follow", [*wide_path, t], kept, self.kind)
            kept.put(new[: self.stride])
            for i, rate in enumerate(new[self.stride :]):
                self.sums[i] = self.plus(self.sums[i], self.times(self.times(wide_path[1], weight), rate))
            self.put_end(p, [f.builder.extract_element(x, INDEX(WIDTH - 1)) for x in new])
        for i in range(self.d):
            self.memory["s"][2 * i] = reduce(self.plus, self.sums.of(DOUBLE).get(WIDTH, WIDTH * i))

    def put_end(self, p: Integer, new: list[Value]) -> None:
        self.out.put(new[:2], p * 2 + self.at("end"))
        self.memory["e"].put(new[self.stride :], p * self.d)

    def add(self, path: list[Value], slot: Integer, nodes: Integer, row: Integer) -> None:
        """The integrals in double-doubles."""
        with self.f.loop(0, nodes, WIDTH) as k:
            lanes = self.f.lanes(k, WIDTH, nodes + 1)  # the end of the table has no weight
            vectors = Lanes(self.kept, [slot + lane + 1 for lane in lanes], self.stride)
            node = Lanes(self.rows, [lane + row for lane in lanes], 4).get(range(4))
            x = [*(self.f.spread(value, self.kind) for value in path), *node]
            self.wide_sums.put(self.run("add", x, vectors, self.kind))


class Points(Formulas):
    """z and w of the one map of a system that is the flow over a time."""

    def __init__(self, model: Model):
        super().__init__(model)
        self.map = cast("ExactMap", self.system.exact_map)
        letters = {"z": (self.d, False), "c": (self.constants, False)}
        self._kernels = [
            outputs_by_rows(*self._record(function, ("x", count)), {**letters, "x": (count, True)})
            for count, function in enumerate((self._of_time, self._of_point), 1)
        ]

    def _of_time(self, z: Array, inputs: Any, x: Array) -> list[Any]:
        state, constants = self._converted(z, inputs, DoubleDouble)
        point, sound = call(self.map.point, state, {**constants, "dt": x[0]})
        return [*self._of_point(z, inputs, algebra.parts(point)), sound]

    def _of_point(self, z: Array, inputs: Any, x: Any) -> list[Any]:
        state, constants = self._converted(z, inputs, lambda v: v)
        return [*x, *algebra.parts(call(self.map.level, state, {**constants, "z": Complex(*x)}))]

    def __call__(self, z: Floats, c: Floats, x: Floats) -> Floats:
        """`OF_MAP` (rows, lanes, 4) of states and parameters (lanes, ...), for points x (rows, lanes, 2).

        For times x (rows, lanes, 1) also whether they are sound: positive if so.
        """
        rows, lanes, count = x.shape
        out = np.empty((rows, lanes, 6 - count))
        self._kernels[count - 1](*map(address_of, (z, c, x, out)), rows, lanes)
        return out


class Rooms:
    """The rows of doubles of states z (lanes, d) with parameters c (lanes, count), and the kernels that share them.

    shares   of a step of an order, complex; none for pairs that are the flow
    phases   of each share: 1, or 3 for the rotation too
    numbers  of pairs (lanes, shares, most + 1, 4): behind them those of the identity
    """

    def __init__(self, model: Model, z: Floats, c: Floats, dt: float, shares: Array, phases: int):
        self._choice, self._paths = reused(
            (Rooms, Identity(model.system), model.n), lambda: (Choice(model), Paths(model))
        )
        self.values = np.empty((len(z), self._choice.size))
        self.numbers = np.empty((len(z), max(1, len(shares)), self._choice.most + 1, 4))
        self.values[:, :2] = -1.0, dt  # rank and time
        self._before, self._after = (self.values, z, c), (shares.view(float), len(shares), phases, self.numbers)

    def __getitem__(self, name: str) -> Floats:
        return self.values[:, self._choice.places[name]]

    def _calls(self, first: int, last: int) -> list[Link]:
        paths = *self._before, gauss(), first, last, *self._after
        return [(self._choice.kernel, (*self._before, first, last)), (self._paths.kernel, paths)]

    def choose(self, first: int = 0, last: int | None = None) -> None:
        """Write the points of lanes, and those of a step."""

        def share(a: int, b: int) -> None:
            for code, arguments in self._calls(first + a, first + b):
                code(*(x if isinstance(x, int) else address_of(x) for x in arguments))

        count = (len(self.values) if last is None else last) - first
        on_threads(count, WORK * count, share)

    def links(self, out: Floats) -> list[Link]:
        """The calls that put the pairs of each lane into rows (lanes, stages, 4) of an engine, as `stages` does.

        All are NaN if a lane has no points, or none of them needs as many stages.
        """
        (lanes, shares, rows, _), (_, count, _), size = self.numbers.shape, out.shape, self.values.shape[1]
        counts = self.values.ravel()[self._choice.places["counts"].start :]
        into = _stages(rows - 1), (self.numbers, counts, out, shares, lanes, count, size, 1)
        return [*self._calls(0, lanes), into]


@cache
def gauss() -> Floats:
    """Tables of nodes and weights, for even functions on [-1, 1]: 1, 2, ... nodes and the end, row by row."""
    tables = []
    for count in range(1, NODES + 1):
        columns = np.array([[*column, end] for column, end in zip(conjugate.legendre(2 * count), (1, 0), strict=True)])
        first = columns.astype(float)
        tables.append(np.stack([first, (columns - first).astype(float)], -1).swapaxes(0, 1).reshape(-1, 4))
    return np.concatenate(tables)


def stages(numbers: Floats, counts: Floats) -> Floats:
    """Points (lanes, stages, 4) of `numbers` and `counts` of rooms: of each share its pairs, or copies of a single one.

    The identity fills shorter lanes.
    """
    lanes, shares, rows, _ = numbers.shape
    count = max(1, int((counts[:, 1] * counts[:, 2]).max()))
    out = np.empty((lanes, count, 4))
    _stages(rows - 1)(*map(address_of, (numbers, counts, out)), shares, lanes, count, counts.shape[1], 0)
    return out


@cache
def _stages(most: int) -> Kernel:
    def write(f: Function) -> None:
        (numbers, counts, out), (shares, lanes, stages, size, exact) = map(f.doubles, f.arguments[:3]), f.arguments[3:]
        needed = f.variable(1.0, DOUBLE)
        with f.loop(0, lanes) as lane:
            verdict, count, copies = counts.get(3, lane * size)
            product = f.builder.fmul(count, copies)
            larger = f.builder.fcmp_ordered(">", product, needed[0])
            needed[0] = f.builder.select(larger, product, needed[0])
            with f.where(f.builder.fcmp_unordered("!=", verdict, counts.value_of(FINE))):
                needed[0] = math.nan
        with f.loop(0, lanes) as lane, f.loop(0, stages) as k:
            count, copies = (Integer(f.builder, f.builder.fptoui(x, INTEGER)) for x in counts.get(2, lane * size + 1))
            length = count + (f.integer(1) - count.least(1))  # 1 at least
            inside = k.compared("<", count * copies)
            place = Integer(f.builder, f.builder.select(inside, (k % length).value, INTEGER(most)))
            share = lane * shares + (k // length).least(shares - 1)
            out.put(numbers.get(4, (share * (most + 1) + place) * 4), (lane * stages + k) * 4)
        unequal = f.builder.fcmp_unordered("!=", needed[0], stages.double())
        with f.where(f.builder.and_(exact.compared("!=", 0), unequal)), f.loop(0, lanes * stages * 4) as i:
            out[i] = math.nan

    return kernel(("stages", most), 8, write)
