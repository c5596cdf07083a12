"""Choice of the points of conjugate pairs for a flow, compiled, and the formulas of pairs, recorded."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import Complex
from kreisel.baecklund import conjugate
from kreisel.baecklund.conjugate import HEIGHTS
from kreisel.graph.arranging import arranged
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import Graph
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Lanes, Value, constant, kind_of
from kreisel.graph.machine import kernel
from kreisel.graph.recording import as_operands
from kreisel.method.conjugate import BEYOND, DEPENDENT, ELSEWHERE, FINE
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs
from kreisel.record.model import Model

columns: Callable[..., Any] = conjugate.longest
largest: Callable[..., Any] = conjugate.largest
levels: Callable[..., Any] = conjugate.levels
RANK = 1e-10  # relative: fields that depend on others
SLACK = 1e-9  # of a price, beyond which a point is taken in place of another
PIVOT = 1e-6  # of a point that is replaced; rounding of a share of 0 is smaller, and was taken for a pivot
CHANGES = 100  # of points, for each pair: the most
CLOSE = 1e-9  # a change of x, relative to the distance of a branch point, whose square is rounding
WIDTH = 4  # of vectors of heights, and of nodes
BESIDE = 1e-5  # of the distance of a pole: between two points for a derivative
EQUAL = 1e-7  # relative to the largest: double levels, up to the error of roots of a polynomial
VECTOR = 1e-5  # relative to its level: the defect of a vector; of triple levels the adjugate is rounding
NONE = 1e-8  # relative to the matrix: a level that counts as 0
SETTLED, ROUNDS = 1e-9, 4  # a relative change of a level, after which the next one is rounding; at most
CERTAIN = 1e-5  # relative: fields that surely do not depend on others
SPAN, ROUNDING = 1e-8, 1e-15  # relative: the distance of the flow from the other fields, and for a body at rest
SCALARS = (
    *("rank", "time", "verdict", "count", "copies", "heights", "size", "least", "off", "rate", "far", "h"),
    *("narrow", "last", "trial", "tight", "repeated", "going", "moving", "re", "im"),
)
Recorded = Callable[..., list[Any]]
Piece = tuple[Graph, list[Any]]


class Formulas:
    """The formulas of the pairs of a system, recorded, and the places in a row of doubles that kernels share.

    verdict                   `FINE`; fields that may be `DEPENDENT`, numbers `BEYOND` doubles, a flow `ELSEWHERE`, too
                              many `COPIES`, conditions that Newton's method `MISSED`
    rank                      of the fields; negative if it is to be found
    count, y, slope, radius   how many pairs, lam = iy, x in a unit of small times, distances of branch points
    x, mu                     of a step, complex; mu at iy
    time, copies, far         of a step; of all pairs; the largest x in a step over the radius, for small times
    reach, narrow, last       of x; steps in doubles, and all steps of Newton's method
    trial, tight, more        of copies; if paths end where reach begins to fail; if more steps follow
    going, moving             if trials, or steps in doubles, continue
    numbers                   Re lam, Im lam and mu of each pair, then those of the identity
    re, im, start             share of a step of an order; y and mu before it
    total                     of the rotations that are missing
    dual, none                of the fields at iy (d, most); 1 for each missing pair
    units, size, off, rate    of components; of the flow in these; of its part beyond the fields; of the rotation
    least, heights, first     the last pivot over the first; how many points were tried, and the first of them
    h, close, nodes, row      time; changes of x to be neglected; nodes of each path, and the first of its table
    end, miss, change         mu at iy + x; defects of the integrals, changes of x
    rotation                  of the body, which is missing
    """

    def __init__(self, model: Model):
        self.system, self.n = model.system, model.n
        self.pairs = cast("ConjugatePairs", self.system.pairs)
        self.kinds = model.system.space.kinds
        self.d, self.turns = algebra.coordinate_count(self.kinds, self.n), self.n * (self.n - 1) // 2
        self.axes = {p.letter: model.axes[p.letter] for p in model.system.parameters if p.kind != "dimension"}
        d, most = self.d, self.d // 2
        sizes = dict.fromkeys(SCALARS, 1)
        sizes |= dict.fromkeys(("y", "slope", "radius", "none", "close", "nodes", "row", "reach"), most)
        sizes |= {"x": 2 * most, "mu": 2 * most, "end": 2 * most, "dual": d * most, "units": d}
        sizes |= {"start": 3 * most, "total": self.turns}
        sizes["numbers"] = 4 * (most + 1)
        sizes |= {"miss": d, "change": most, "rotation": self.turns, "first": 2 + max(self.n, 4)}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        self.places = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
        self.places["counts"] = slice(self.places["verdict"].start, self.places["copies"].stop)
        self.size, self.most, self.constants = ends[-1], most, sum(self.n**axes for axes in self.axes.values())

    def _record(self, function: Recorded, *letters: tuple[str, int]) -> Piece:
        """A function of state and constants, and of inputs of these letters, as a graph."""
        graph = Graph()
        shapes = {k: (self.n,) * axes for k, axes in self.axes.items()}
        ends = np.cumsum([0, *(int(np.prod(s)) for s in shapes.values())]).tolist()
        z, c = graph.inputs("z", self.d), graph.inputs("c", ends[-1])
        inputs = {k: c[a:b].reshape(s)[()] for (k, s), a, b in zip(shapes.items(), ends, ends[1:], strict=False)}
        vectors = [graph.inputs(letter, size) for letter, size in letters]
        return arranged(graph, as_operands(function(z, inputs, *vectors)))

    def _rule(self, function: Callable[..., dict[str, Any]]) -> tuple[Piece, list[slice]]:
        """A function of places in a row, that returns new values for some, as a graph."""
        names, changed = list(inspect.signature(function).parameters), list[slice]()

        def values(_z: Array, _c: Array, *inputs: Array) -> list[Any]:
            arguments = {k: x[0] if k in SCALARS else x for k, x in zip(names, inputs, strict=True)}
            new = function(**arguments)
            changed.extend(self.places[k] for k in new)
            return [x for v in new.values() for x in (v if isinstance(v, list) else [v])]

        letters = [(k, self.places[k].stop - self.places[k].start) for k in names]
        return self._record(values, *letters), changed

    def _converted(self, z: Array, inputs: dict[str, Array], kind: Any) -> tuple[tuple[Array, ...], dict[str, Array]]:
        """State and constants of a kind of number."""
        wide = np.frompyfunc(kind, 1, 1)
        constants = {k: wide(v) for k, v in inputs.items()} | {"n": np.asarray(self.n)}
        if self.system.derive is not None:
            constants |= call(self.system.derive, (), constants)
        return algebra.restore(wide(z), self.kinds, self.n), constants

    def _of_pairs(self, name: str, state: Any, inputs: Any, lam: Complex, **variables: Any) -> Any:
        return call(getattr(self.pairs, name), state, {**inputs, "lam": lam, **variables})

    def _rates(self, state: Any, inputs: Any, lam: Complex, Pi: Array) -> list[Any]:
        """The real parts of the fields and of Omega."""
        rates, Omega = self._of_pairs("rates", state, inputs, algebra.objects([lam], ()), Pi=Pi)
        flat = [*algebra.flatten(rates, self.kinds), *algebra.coordinates(Omega)]
        return [x.re if isinstance(x, Complex) else x for x in flat]

    def _quotient(self, state: Any, inputs: Any, lam: Complex, vectors: Array) -> Any:
        left, right = vectors.reshape(2, -1)
        size = (self._weighted(left, inputs) * right).sum()
        return (left * (self._of_pairs("matrix", state, inputs, lam) @ right)).sum() / size

    def _vectors(self, state: Any, inputs: Any, lam: Complex, mu: Complex) -> tuple[list[Any], Array]:
        """The parts of the left and the right vector, and the projector."""
        Pi = self._of_pairs("projector", state, inputs, lam, mu=mu)
        return [x for V in (Pi.mT, Pi) for pair in zip(*columns(V)[:2], strict=True) for x in pair], Pi

    def _weighted(self, vector: Array, inputs: Any) -> Array:
        return vector if self.pairs.metric is None else vector * call(self.pairs.metric, (), inputs)


class Choice(Formulas):
    """Points of pairs for the flow at one state: those with the least sum |x|/radius, by the simplex method.

    kernel(rooms, z, c, first, last): of lanes.

    The tableau has a row for each coordinate of the state; its columns are the flow, the identity, and the candidates,
    fields times the distances of branch points.  Its largest entries are eliminated up to the rank, then those that
    prices name.
    """

    def __init__(self, model: Model):
        super().__init__(model)
        self.begin, self.level = self._record(self._start), self._record(self._level, ("x", 3))
        self.width = (len(self.level[1]) - self.d - 2) // 4  # of a vector
        self.meet = self._record(self._meet, ("v", 8 * self.width), ("x", 5))
        self.rules = {"judge": self._rule(self._judge)}
        self.heights, self.spectrum = self._record(self._heights), self._record(self._spectrum, ("x", 1))
        pieces = [self.begin, self.level, self.meet, self.heights, self.spectrum]
        self.rows, self.levels = len(self.heights[1]) // 4, len(self.spectrum[1]) - 1
        every = self.pairs.spectrum is None
        self.tried, self.used = (HEIGHTS, self.levels) if every else (2 * HEIGHTS, self.levels // 2)
        self.room = self.rows * self.tried  # of heights
        self.columns = 1 + self.d + self.rows * HEIGHTS * self.used
        pieces += [piece for piece, _ in self.rules.values()]
        key = "choice", self.tried, *(graph.digest(outputs) for graph, outputs in pieces)
        self.kernel = kernel(key, 5, lambda f: _Choosing(self, f).write())

    # -- formulas ------------------------------------------------------------------------------------------

    def _start(self, z: Array, inputs: Any) -> list[Any]:
        """The flow in units of the components, these, and the rate of a rotation.

        They are sizes that components have or reach before the body rotates by about a radian: M may be far smaller
        than it soon becomes; Newton's method must not solve for its last places then.
        """
        state, constants = self._converted(z, inputs, lambda v: v)
        rates, velocity = call(self.system.flow, state, constants), self.system.velocity
        turns = [y[0] if velocity is None else call(velocity, y, constants) for y in (state, rates)]
        now, later = (algebra.sqrt((turn * turn).sum()) for turn in turns)
        rate = now + algebra.sqrt(later)
        time, units = algebra.where_less(0, rate, 1 / rate, 0), []
        for component, change in zip(state, rates, strict=True):
            size, soon = (reduce(largest, abs(x).ravel()) for x in (component, change))
            unit = largest(size, time * soon)
            units.append(algebra.objects([algebra.where_less(0, unit, unit, 1.0)] * component.size, component.shape))
        units = algebra.flatten(units, self.kinds)
        exact = algebra.flatten(call(self.system.flow, *self._converted(z, inputs, DoubleDouble)), self.kinds)
        return [*(upper(f) / unit for f, unit in zip(exact, units, strict=True)), *units, rate]  # 0 where terms cancel

    def _heights(self, z: Array, inputs: Any) -> list[Any]:
        state, constants = self._converted(z, inputs, lambda v: v)
        return [x for row in call(self.pairs.heights, state, constants) for x in row]

    def _spectrum(self, z: Array, inputs: Any, x: Array) -> list[Any]:
        """Im mu of the branches at iy, and a number that is positive if they may be used."""
        state, constants = self._converted(z, inputs, lambda v: v)
        if self.pairs.spectrum is None:
            i = Complex(0.0, 1.0)
            return [*(-m for m in levels(i * self._of_pairs("matrix", state, constants, i * x[0]))), 1.0]
        mu, use = call(self.pairs.spectrum, state, {**constants, "y": x[0]})
        return [*mu, use]

    def _level(self, z: Array, inputs: Any, x: Array) -> list[Any]:
        """mu, the left vector with <p, S q> = 1, L' q, the real field at iy; x: y, the distance of a pole, Im mu."""
        state, constants = self._converted(z, inputs, lambda v: v)
        y, pole, m = x
        lam, near = Complex(0.0, y), BESIDE * pole
        vectors, _ = self._vectors(state, constants, lam, Complex(0.0, m))
        mu = self._quotient(state, constants, lam, complex_values(vectors))
        # NaN for a double level, which has no vectors
        mu = Complex(algebra.where_less(-np.inf, mu.re, mu.re, 0.0), algebra.where_less(-np.inf, mu.im, mu.im, m))
        vectors, Pi = self._vectors(state, constants, lam, mu)
        left, right = complex_values(vectors).reshape(2, -1)
        after, before = (self._of_pairs("matrix", state, constants, lam + s * near) for s in (1, -1))
        left = left * (1 / (self._weighted(left, constants) * right).sum())
        values = [mu, *left, *(((after - before) @ right) / (2 * near))]
        matrix = self._of_pairs("matrix", state, constants, lam)
        miss = matrix @ right - self._weighted(right, constants) * mu
        miss, *sizes = (sum((y * y).sum() for y in algebra.parts(x)) for x in (miss, matrix, right))
        large = mu.re * mu.re + mu.im * mu.im + NONE * NONE * sizes[0]
        sound = algebra.where_less(miss, VECTOR * VECTOR * large * sizes[1], 1.0, np.nan)
        rates = [sound * rate for rate in self._rates(state, constants, lam, Pi)[: self.d]]
        return [p for v in values for p in algebra.parts(v)] + rates

    def _meet(self, z: Array, inputs: Any, v: Array, x: Array) -> list[Any]:
        """The square of the distance at which two levels meet: (gap + t (a - b))^2 + 4 t^2 c d = 0.

        0 for levels that rounding cannot tell apart, next to the largest; x: both, complex, and that.
        """
        left, change, second, change_of_second = complex_values(v).reshape(4, -1)
        a, b = (left * change).sum(), (second * change_of_second).sum()
        slope = (a - b) * (a - b) + 4 * (left * change_of_second).sum() * (second * change).sum()
        gap = (x[0] - x[2]) * (x[0] - x[2]) + (x[1] - x[3]) * (x[1] - x[3])
        square = gap / algebra.sqrt(slope.re * slope.re + slope.im * slope.im)
        return [algebra.where_less(gap, EQUAL * x[4] * EQUAL * x[4], 0.0, square)]

    def _judge(self, size: Any, off: Any, rate: Any, least: Any, rank: Any, heights: Any) -> dict[str, Any]:
        select, room = algebra.where_less, largest(SPAN * size, ROUNDING * rate)
        verdict = select(room, off, ELSEWHERE, select(off, np.inf, FINE, ELSEWHERE))
        verdict = select(rank, 0, select(least, CERTAIN, DEPENDENT, verdict), verdict)
        return {"verdict": select(0, heights, select(size, np.inf, verdict, BEYOND), BEYOND)}


class Writing:
    """The code of a kernel that works on rows of lanes: `out`."""

    def __init__(self, of: Any, f: Function, rooms: Integer):
        self.of, self.f, self.d, self.out = of, f, of.d, f.doubles(rooms)
        b = f.builder
        self.plus, self.minus, self.times, self.over = b.fadd, b.fsub, b.fmul, b.fdiv

    def size(self, x: Value) -> Value:
        return self.f.intrinsic("fabs", x)

    def is_less(self, x: Value, y: Value) -> Value:
        return self.f.builder.fcmp_ordered("<", x, y)

    def larger_of(self, x: Value, y: Value) -> Value:
        return self.f.builder.select(self.is_less(x, y), y, x)

    def value(self, x: float) -> Value:
        return self.out.value_of(x)

    def at(self, name: str) -> int:
        start: int = self.of.places[name].start
        return start

    def integer(self, name: str, place: Any = 0) -> Integer:
        return Integer(self.f.builder, self.f.builder.fptoui(self.out[place + self.at(name)], INTEGER))

    def apply(self, rule: str) -> None:
        (graph, outputs), changed = self.of.rules[rule]
        values = self.f.outputs(graph, outputs, lambda letter, i: self.out[self.at(letter) + i])
        for place in changed:
            new, values = values[: place.stop - place.start], values[place.stop - place.start :]
            self.out.put(new, place.start)


class _Choosing(Writing):
    """Writes the kernel of a `Choice`."""

    def __init__(self, of: Choice, f: Function):
        rooms, z, c, self.first, self.last = f.arguments
        super().__init__(of, f, rooms)
        self.kind = kind_of(WIDTH)  # of vectors of heights
        self.memory = {"z": f.doubles(z), "c": f.doubles(c), "v": f.room(8 * of.width, self.kind)}
        self.table, self.list = f.room(self.d * of.columns), f.room(of.room * (2 + of.levels))
        # levels of heights: mu, left, right, L' q, field
        self.branches = f.room(of.levels * (2 + 4 * of.width + self.d), self.kind)
        self.chosen = f.room(of.columns * 4)  # of the candidates: y, radius, mu
        self.basis, self.signs = f.room(self.d, INTEGER), f.room(self.d)
        self.count, self.candidates, self.most = f.variables(3, INTEGER)
        f.vectors(WIDTH)

    def piece(self, piece: Piece, *x: Value) -> list[Value]:
        kind = x[0].type if x else DOUBLE

        def value(letter: str, i: int) -> Value:
            number = x[i] if letter == "x" else self.memory[letter][i]
            return self.f.spread(number, kind) if number.type == DOUBLE else number

        graph, outputs = piece
        return self.f.outputs(graph, outputs, value, kind)

    def write(self) -> None:
        of, rooms, memory = self.of, self.out, dict(self.memory)
        with self.f.loop(self.first, self.last) as lane:
            self.out = rooms.beyond(lane * of.size)
            for letter, size in (("z", self.d), ("c", of.constants)):
                self.memory[letter] = memory[letter].beyond(lane * size)
            self.most[0] = of.most
            with self.f.where(self.is_less(self.value(-1.0), self.out[self.at("rank")])):
                self.most[0] = self.integer("rank") // 2
            self.write_lane()

    def write_lane(self) -> None:
        f, d, out = self.f, self.d, self.out
        start, large = self.piece(self.of.begin), self.value(0.0)
        with f.loop(0, d * (1 + d)) as k:
            self.table[(k // (1 + d)) * self.of.columns + k % (1 + d)] = 0.0
        for i, x in enumerate(start[:d]):
            self.table[i * self.of.columns], self.table[i * self.of.columns + 1 + i] = x, 1.0
            # NaN and infinity stay
            large = self.plus(self.larger_of(large, self.size(x)), self.times(x, self.value(0.0)))
        out[self.at("size")] = large
        out.put(start[d : 2 * d], self.at("units"))
        out[self.at("rate")] = start[2 * d]
        self.count[0] = self.candidates[0] = 0
        self.find_heights()
        out[self.at("heights")] = self.count[0].double()
        out.put(self.list.get(2 + self.of.levels), self.at("first"))
        self.find_candidates()
        self.solve()
        self.put_points()

    def find_heights(self) -> None:
        f, stride = self.f, 2 + self.of.levels
        rows, several = f.room(4 * self.of.rows), f.room(WIDTH)
        rows.put(self.piece(self.of.heights))
        with f.loop(0, self.of.rows) as row:
            origin, side, low, high = rows.get(4, row * 4)
            with f.where(self.is_less(self.value(0.0), low)):
                e, share = f.variable(low, DOUBLE), self.value(1 / (self.of.tried - 1))
                ratio = f.intrinsic("exp", self.times(f.intrinsic("log", self.over(high, low)), share))
                with f.loop(0, self.of.tried, WIDTH) as k:
                    poles = []
                    for _ in range(WIDTH):
                        poles.append(e[0])
                        e[0] = self.times(e[0], ratio)
                    y = [self.plus(origin, self.times(side, pole)) for pole in poles]
                    several.put(y)
                    *mu, use = self.piece(self.of.spectrum, several.of(self.kind)[0])
                    for i in range(WIDTH):
                        values = [f.builder.extract_element(x, INDEX(i)) for x in (use, *mu)]
                        useful = self.is_less(self.value(0.0), values[0])
                        with f.where(f.builder.and_(useful, (k + i).compared("<", self.of.tried))):
                            self.list.put([y[i], poles[i], *values[1:]], self.count[0] * stride)
                            self.count[0] = self.count[0] + 1

    def find_candidates(self) -> None:
        f, of, d, memory = self.f, self.of, self.d, self.memory["v"]
        step, at = (self.count[0] + of.rows * HEIGHTS - 1) // (of.rows * HEIGHTS), f.variable(0)
        size, w = 2 + 4 * of.width + d, 2 * of.width
        with f.while_(lambda: at[0].compared("<", self.count[0])):
            heights = [(at[0] + step * i).least(self.count[0] - 1) for i in range(WIDTH)]
            rows = Lanes(self.list, heights, 2 + of.levels)
            y, pole = rows.get(range(2))
            high = reduce(self.larger_of, map(self.size, rows.get(range(2, 2 + of.levels))))
            with f.loop(0, of.levels) as k:
                self.find_level(y, pole, rows[k + 2], k * size)
            with f.loop(0, of.used) as k:
                radius = f.variable(self.times(pole, pole), self.kind)
                first = k * size
                memory.put(self.branches.get(w, first + 2))
                memory.put(self.branches.get(w, first + 2 + w), w)
                with f.loop(0, of.levels) as partner, f.where(partner.compared("!=", k)):
                    second = partner * size
                    memory.put(self.branches.get(w, second + 2), 2 * w)
                    memory.put(self.branches.get(w, second + 2 + w), 3 * w)
                    mus = self.branches.get(2, first) + self.branches.get(2, second)
                    (square,) = self.piece(of.meet, *mus, high)
                    radius[0] = f.builder.select(self.is_less(square, radius[0]), square, radius[0])
                distance = f.intrinsic("sqrt", radius[0])
                fields = self.branches.get(d, first + 2 + 4 * of.width)
                units = [f.spread(unit, self.kind) for unit in self.out.get(d, self.at("units"))]
                column = [self.over(self.times(x, distance), u) for x, u in zip(fields, units, strict=True)]
                zero = constant(self.kind, 0.0)
                sound = f.builder.fcmp_ordered("==", self.times(reduce(self.plus, column), zero), zero)
                column = [f.builder.select(sound, x, zero) for x in column]
                for i in range(WIDTH):
                    values = [f.builder.extract_element(x, INDEX(i)) for x in (*column, y, distance)]
                    values += [f.builder.extract_element(x, INDEX(i)) for x in self.branches.get(2, first)]
                    n = self.candidates[0] + k + of.used * i
                    with f.where((at[0] + step * i).compared("<", self.count[0])):
                        for j, x in enumerate(values[:d]):
                            self.table[n + (j * of.columns + 1 + d)] = x
                        self.chosen.put(values[d:], n * 4)
            left = (self.count[0] - at[0] + step - 1) // step
            self.candidates[0] = self.candidates[0] + left.least(WIDTH) * of.used
            at[0] = at[0] + step * WIDTH

    def find_level(self, y: Value, pole: Value, m: Value, place: Integer) -> None:
        """A level from Im mu, repeated from the result if that is far: roots of polynomials lose digits."""
        f, kind, zero, unit = self.f, self.kind, self.value(0.0), constant(self.kind, 1.0)
        start, moving, left = f.variable(m, kind), f.variable(unit, kind), f.variable(ROUNDS)
        joint = f.builder.and_
        with f.while_(lambda: joint(left[0].compared(">", 0), self.is_less(zero, f.largest(moving[0])))):
            self.branches.put(self.piece(self.of.level, y, pole, start[0]), place)
            new, old = self.branches[place + 1], start[0]
            far = self.is_less(self.times(constant(kind, SETTLED), self.size(new)), self.size(self.minus(new, old)))
            start[0], left[0] = f.builder.select(far, new, old), left[0] - 1  # settled lanes repeat their result
            moving[0] = f.builder.select(far, unit, constant(kind, 0.0))

    def solve(self) -> None:
        """The basis of the tableau: its candidates, by rows."""
        f, of, d, is_less = self.f, self.of, self.d, self.is_less
        row, column = f.variables(2, INTEGER)
        best, sign, reach = f.variables(3)
        rank, going, steps = (f.variable(x) for x in (0, 1, 0))
        first, last = f.variable(0.0, DOUBLE), f.variable(0.0, DOUBLE)
        with f.loop(0, d) as i:
            self.basis[i], self.signs[i] = -1, 0.0
        width, candidates = of.columns, self.candidates[0]
        with f.while_(lambda: going[0].compared(">", 0)):
            row[0], best[0] = -1, 0.0
            with f.otherwise(going[0].compared("==", 1)) as (by_size, by_price):
                with by_size:
                    with f.loop(0, d) as i, f.where(self.basis[i].compared("<", 0)), f.loop(0, candidates) as j:
                        x = self.size(self.table[i * width + j + (1 + d)])
                        with f.where(is_less(best[0], x)):
                            best[0], row[0], column[0] = x, i, j
                    with f.where(rank[0].compared("==", 0)):
                        first[0] = best[0]
                    enough = is_less(self.times(first[0], self.value(RANK)), best[0])
                    enough = f.builder.and_(enough, rank[0].compared("<", self.most[0]))
                    with f.otherwise(enough) as (accepted, done):
                        with accepted:
                            last[0], rank[0] = best[0], rank[0] + 1
                        with done:
                            row[0], going[0] = -1, 2
                with by_price:
                    with f.loop(0, d) as i:
                        x = self.table[i * width]
                        value = f.builder.select(is_less(x, self.value(0.0)), self.value(-1.0), self.value(1.0))
                        self.signs[i] = f.builder.select(self.basis[i].compared("<", 0), self.value(0.0), value)
                    with f.loop(0, candidates) as j:
                        price = f.variable(0.0, DOUBLE)
                        with f.loop(0, d) as i:
                            product = self.times(self.signs[i], self.table[i * width + j + (1 + d)])
                            price[0] = self.plus(price[0], product)
                        with f.where(is_less(best[0], self.size(price[0]))):
                            best[0], column[0] = self.size(price[0]), j
                            sign[0] = f.builder.select(
                                is_less(price[0], self.value(0.0)), self.value(-1.0), self.value(1.0)
                            )
                    steps[0] = steps[0] + 1
                    useful = is_less(self.value(1 + SLACK), best[0])
                    useful = f.builder.and_(useful, steps[0].compared("<", rank[0] * CHANGES))
                    with f.where(useful):
                        reach[0] = np.inf
                        with f.loop(0, d) as i:
                            slope = self.times(sign[0], self.table[i * width + column[0] + (1 + d)])
                            x = self.over(self.table[i * width], slope)
                            toward = is_less(self.value(PIVOT), self.times(slope, self.signs[i]))
                            with f.where(f.builder.and_(toward, is_less(x, reach[0]))):
                                reach[0], row[0] = x, i
                    with f.where(row[0].compared("<", 0)):
                        going[0] = 0
            with f.where(row[0].compared(">=", 0)):
                self.eliminate(row[0], column[0])
        self.out[self.at("least")] = self.over(last[0], first[0])

    def eliminate(self, row: Any, column: Any) -> None:
        """Make the entry 1, and the others of its column 0."""
        f, table, width = self.f, self.table, self.of.columns
        self.basis[row] = column
        begin, all_columns = row * width, self.candidates[0] + (1 + self.d)
        inverse = self.over(self.value(1.0), table[begin + column + (1 + self.d)])
        with f.loop(0, all_columns) as k:
            table[begin + k] = self.times(table[begin + k], inverse)
        with f.loop(0, self.d) as i, f.where(i.compared("!=", row)):
            factor = table[i * width + column + (1 + self.d)]
            with f.loop(0, all_columns) as k:
                change = self.times(factor, table[begin + k])
                table[i * width + k] = self.minus(table[i * width + k], change)

    def put_points(self) -> None:
        f, out, d, most = self.f, self.out, self.d, self.of.most
        off, count = f.variable(0.0, DOUBLE), f.variable(0)
        moving = self.is_less(self.value(0.0), out[self.at("size")])
        with f.loop(0, d) as i:
            begin = i * self.of.columns
            x = self.table[begin]
            with f.otherwise(self.basis[i].compared("<", 0)) as (left, used):
                with left:
                    off[0] = self.larger_of(off[0], self.size(x))
                with used, f.where(moving):
                    y, radius, re, im = self.chosen.get(4, self.basis[i] * 4)
                    k = count[0]
                    out[k + self.at("y")], out[k + self.at("radius")] = y, radius
                    out[k + self.at("slope")], out[k + self.at("none")] = self.times(x, radius), 0.0
                    out.put([re, im], k * 2 + self.at("mu"))
                    out[k + self.at("close")] = self.times(radius, self.value(CLOSE))
                    for j in range(d):
                        value = self.times(self.table[begin + (1 + j)], radius)
                        out[k + (self.at("dual") + most * j)] = self.over(value, out[self.at("units") + j])
                    count[0] = k + 1
        out[self.at("off")] = off[0]
        out[self.at("count")] = count[0].double()
        with f.loop(count[0], most) as k:
            out[k + self.at("none")] = 1.0
            for name, size in (("y", 1), ("slope", 1), ("radius", 1), ("close", 1), ("dual", d)):
                for j in range(size):
                    out[k + (self.at(name) + most * j)] = 0.0
        with f.where(count[0].compared("==", 0)):  # the pair of any mu but an eigenvalue is the identity for x = 0
            y, pole, *mu = out.get(2 + self.of.levels, self.at("first"))
            high = reduce(self.larger_of, map(self.size, mu))
            out[self.at("y")] = y
            out.put([self.value(0.0), self.plus(self.times(high, self.value(2.0)), pole)], self.at("mu"))
        self.apply("judge")


def complex_values(values: Sequence[Any]) -> Array:
    """Complex values of their parts."""
    return algebra.objects(Complex(*values[k : k + 2]) for k in range(0, len(values), 2))
