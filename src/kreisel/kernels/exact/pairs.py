"""Points of conjugate pairs that are the flow over a time, compiled: paths in doubles, integrals in double-doubles.

The conditions of `kreisel.method.conjugate`, sum_p int_0^(x_p) Re v(iy_p + t) dt = h f, by Gauss's nodes on the paths
from iy_p to iy_p + x_p and Newton's method, whose Jacobian has the fields at their ends.  A path follows mu by Rayleigh
quotients, each with the vectors of the one before; their error is that of the vectors squared, so the quotient of
vectors in doubles has the digits of double-doubles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Complex
from kreisel.algebra.reuse import Identity, reused
from kreisel.baecklund.conjugate import legendre, longest
from kreisel.graph.arranging import arranged
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import Graph, repeated
from kreisel.graph.llvm import Function, Value
from kreisel.graph.machine import Kernel, address_of, kernel
from kreisel.graph.recording import as_operands
from kreisel.kernels.layout import Floats
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs
from kreisel.record.model import Model

columns: Callable[..., Any] = longest
ROUNDS = 4  # of quotient and vectors at a node: an error of 0.2 of the vectors falls below 1e-10
Recorded = Callable[..., list[Any]]
Piece = tuple[Graph, list[Any]]


class Paths:
    """The conditions of a system, for at most d/2 pairs of one state.

    kernel(room, z, c, table, nodes, pairs, steps, wide): Newton's steps, from the one `wide` on with double-doubles,
    then the paths once more for mu at their ends.  `room` is laid out as in `places`, table (nodes + 1, 4) has nodes
    and weights, two doubles each.
    """

    def __init__(self, model: Model):
        self.system, self.n = model.system, model.n
        self.pairs = cast("ConjugatePairs", self.system.pairs)
        self.kinds = model.system.space.kinds
        self.d, self.turns = algebra.coordinate_count(self.kinds, self.n), self.n * (self.n - 1) // 2
        self.axes = {p.letter: model.axes[p.letter] for p in model.system.parameters if p.kind != "dimension"}
        self.most = most = self.d // 2
        sizes = {"h": 1, "y": most, "x": 2 * most, "mu": 2 * most, "end": 2 * most, "fields": self.d * most}
        sizes |= {"none": most, "miss": self.d, "change": most, "turn": self.turns}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self.places = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
        self.size = ends[-1]
        self.kernel = self._kernel()

    # -- formulas ------------------------------------------------------------------------------------------

    def _record(self, function: Recorded, *letters: tuple[str, int]) -> Piece:
        """A function of state and constants, and of inputs of these letters, as a graph."""
        graph = Graph()
        shapes = {k: (self.n,) * axes for k, axes in self.axes.items()}
        ends = np.cumsum([0, *(int(np.prod(s)) for s in shapes.values())]).tolist()
        z, c = graph.inputs("z", self.d), graph.inputs("c", ends[-1])
        known = {k: c[a:b].reshape(s)[()] for (k, s), a, b in zip(shapes.items(), ends, ends[1:], strict=False)}
        more = [graph.inputs(letter, size) for letter, size in letters]
        return arranged(graph, as_operands(function(z, known, *more)))

    def _known(self, z: Array, known: dict[str, Array], kind: Any) -> tuple[tuple[Array, ...], dict[str, Array]]:
        """State and constants of a kind of number."""
        wide = np.frompyfunc(kind, 1, 1)
        constants = {k: wide(v) for k, v in known.items()} | {"n": np.asarray(self.n)}
        if self.system.derive is not None:
            constants |= call(self.system.derive, (), constants)
        return algebra.restore(wide(z), self.kinds, self.n), constants

    def _of_pairs(self, name: str, state: Any, known: Any, lam: Complex, **more: Any) -> Any:
        return call(getattr(self.pairs, name), state, {**known, "lam": lam, **more})

    def _rates(self, state: Any, known: Any, lam: Complex, Pi: Array) -> list[Any]:
        """The real parts of the fields and of Omega."""
        rates, Omega = self._of_pairs("rates", state, known, algebra.objects([lam], ()), Pi=Pi)
        flat = [*algebra.flatten(rates, self.kinds), *algebra.coordinates(Omega)]
        return [x.re if isinstance(x, Complex) else x for x in flat]

    def _quotient(self, state: Any, known: Any, lam: Complex, vectors: Array) -> Any:
        left, right = vectors.reshape(2, -1)
        metric = self.pairs.metric
        weighted = left if metric is None else left * call(metric, (), known)
        return (left * (self._of_pairs("matrix", state, known, lam) @ right)).sum() / (weighted * right).sum()

    def _vectors(self, state: Any, known: Any, lam: Complex, mu: Complex) -> tuple[list[Any], Array]:
        """The parts of the left and the right vector, and the projector."""
        Pi = self._of_pairs("projector", state, known, lam, mu=mu)
        return [x for V in (Pi.mT, Pi) for pair in zip(*columns(V)[:2], strict=True) for x in pair], Pi

    def start(self, z: Array, known: Any, x: Array) -> list[Any]:
        """The vectors at iy, from y and mu."""
        state, constants = self._known(z, known, lambda v: v)
        return self._vectors(state, constants, Complex(0.0, x[0]), Complex(*x[1:]))[0]

    def follow(self, z: Array, known: Any, x: Array, vectors: Array) -> list[Any]:
        """mu, vectors and fields at y, x t from the vectors at a node before; x: y, x, t."""
        state, constants = self._known(z, known, lambda v: v)
        y, re, im, t = x
        lam = Complex(re * t, y + im * t)

        def nearer(vectors: Sequence[Any]) -> list[Any]:
            mu = self._quotient(state, constants, lam, _complex(vectors))
            return self._vectors(state, constants, lam, mu)[0]

        new = repeated(nearer, vectors, ROUNDS - 1)
        mu = self._quotient(state, constants, lam, _complex(new))
        new, Pi = self._vectors(state, constants, lam, mu)
        return [mu.re, mu.im, *new, *self._rates(state, constants, lam, Pi)[: self.d]]

    def add(self, z: Array, known: Any, x: Array, vectors: Array, total: Array) -> list[Any]:
        """The integrals of fields and Omega after a node, double-doubles; x: y, x, t, weight."""
        state, constants = self._known(z, known, DoubleDouble)
        re, (t, weight) = DoubleDouble(x[1]), (DoubleDouble(*x[k : k + 2]) for k in (3, 5))
        lam = Complex(re * t, DoubleDouble(x[0]))
        mu = self._quotient(state, constants, lam, _complex([DoubleDouble(v) for v in vectors]))
        rates = self._rates(state, constants, lam, self._of_pairs("projector", state, constants, lam, mu=mu))
        new = [DoubleDouble(*pair) + re * weight * rate for pair, rate in zip(total.reshape(-1, 2), rates, strict=True)]
        return [part for x in new for part in (x.upper, x.lower)]

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

    def _kernel(self) -> Kernel:
        sums, d, m = 2 * (self.d + self.turns), self.d, self.most
        start = self._record(self.start, ("x", 3))
        v = len(start[1])
        follow = self._record(self.follow, ("x", 4), ("v", v))
        add = self._record(self.add, ("x", 7), ("v", v), ("s", sums))
        step = self._record(self.step, ("h", 1), ("s", sums), ("e", m * d), ("fields", m * d), ("none", m))
        key = "pairs", *(graph.digest(outputs) for graph, outputs in (start, follow, add, step))
        return kernel(key, 8, lambda f: self._write(f, start, follow, add, step))

    def _write(self, f: Function, start: Piece, follow: Piece, add: Piece, step: Piece) -> None:
        room, z, c, table, nodes, pairs, steps, wide = f.arguments
        numbers, rows, d = f.doubles(room), f.doubles(table), self.d
        at = {name: place.start for name, place in self.places.items()}
        memory = {"z": f.doubles(z), "c": f.doubles(c), "v": f.room(len(start[1])), "e": f.room(self.most * d)}
        memory |= {"s": f.room(2 * (d + self.turns)), **{k: numbers.beyond(at[k]) for k in ("h", "fields", "none")}}
        memory["e"].put([0.0] * (self.most * d))
        plus, times = f.builder.fadd, f.builder.fmul

        def run(piece: Piece, x: Sequence[Value] = ()) -> list[Value]:
            return f.outputs(*piece, lambda letter, i: x[i] if letter == "x" else memory[letter][i])

        with f.loop(0, steps + 1) as turn:
            memory["s"].put([0.0] * (2 * (d + self.turns)))
            with f.loop(0, pairs) as p:
                y, x = numbers[p + at["y"]], numbers.get(2, p * 2 + at["x"])
                memory["v"].put(run(start, [y, *numbers.get(2, p * 2 + at["mu"])]))
                with f.loop(0, nodes + 1) as k:
                    t, low, *weight = rows.get(4, k * 4)
                    new = run(follow, [y, *x, t])
                    numbers.put(new[:2], p * 2 + at["end"])
                    memory["v"].put(new[2:-d])
                    memory["e"].put(new[-d:], p * d)
                    with f.otherwise(turn.compared("<", wide)) as (narrow, wider):
                        with narrow:
                            for i, rate in enumerate(new[-d:]):
                                memory["s"][2 * i] = plus(memory["s"][2 * i], times(times(x[0], weight[0]), rate))
                        with wider, f.where(turn.compared("<", steps)):
                            memory["s"].put(run(add, [y, *x, t, low, *weight]))
            with f.where(turn.compared("<", steps)):
                numbers.put(run(step), at["miss"])
                for i in range(self.most):
                    numbers[at["x"] + 2 * i] = plus(numbers[at["x"] + 2 * i], numbers[at["change"] + i])

    def run(self, z: Floats, c: Floats, table: Floats, steps: tuple[int, int], **values: Any) -> dict[str, Floats]:
        """The room after Newton's steps in doubles and in double-doubles, from these values, by name."""
        room, pairs = np.zeros(self.size), len(values["y"])
        for name, value in values.items():
            room[self.places[name].start :][: len(value)] = value
        room[self.places["none"]][pairs:] = 1
        self.kernel(*map(address_of, (room, z, c, table)), len(table) - 1, pairs, sum(steps), steps[0])
        return {name: room[place] for name, place in self.places.items()}


def paths(model: Model) -> Paths:
    """The compiled conditions of a system."""
    return reused((Paths, Identity(model.system), model.n), lambda: Paths(model))


@cache
def gauss(count: int) -> Floats:
    """A table of nodes and weights, for even functions on [-1, 1]."""
    columns = np.array([[*column, end] for column, end in zip(legendre(2 * count), (1, 0), strict=True)])
    first = columns.astype(float)
    return np.ascontiguousarray(np.stack([first, (columns - first).astype(float)], -1).swapaxes(0, 1).reshape(-1, 4))


@cache
def evenly(count: int) -> Floats:
    """A table of nodes of which the last is the end."""
    return np.outer(np.arange(1, count + 1) / count, [1.0, 0, 0, 0])


def _complex(values: Sequence[Any]) -> Array:
    """Complex values of their parts."""
    return algebra.objects(Complex(*values[k : k + 2]) for k in range(0, len(values), 2))
