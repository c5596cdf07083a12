"""Flows, n = 3, from time 0 to any time at once: kernels that set up and jump, for many tops or free bodies.

Of the free body: `kreisel.kernels.exact.motions`.  Over the period of nutation the flow of the Lagrange top is a
rotation about p; over the remaining time it is `count` times D_eps, minus the rotation of D_eps: `leap` of
`kreisel.kernels.exact.motions`.  Each lane has an estimate of its error; some need more digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.exact.motion import half_turns
from kreisel.exact.nutation import Integrals, darboux
from kreisel.graph.arranging import Formula
from kreisel.graph.double import DoubleDouble
from kreisel.graph.graph import Graph, Operand, array_of, nearest, where_less
from kreisel.graph.llvm import Function, Lanes, Value
from kreisel.graph.machine import Kernel, Link, address_of, kernel, register_width
from kreisel.graph.recording import as_operands, constants_of, count_of, flat_constants
from kreisel.kernels.exact.motions import leap, of_turns, rotated
from kreisel.kernels.layout import Floats, on_threads
from kreisel.method.scheme import Jump, Scheme, Spin

TOLERANCE = 1e-16  # of a rotation and of a period: more that a jump may be off, and more digits are taken
ROWS = {Spin: 100_000, Jump: 200_000}  # of a run that are jumps: about as long as the set-up in many digits
WORK = 5_000  # a jump is worth this number of operations on lanes
MOST = 64  # maps in a jump


class Rows(NamedTuple):
    """Arguments of a kernel for rows first, first + 1, ...: state, constants and time; new state, error.

    unit  of the times
    """

    states: Lanes
    constants: Lanes
    times: Lanes
    unit: Value
    new: Lanes
    errors: Lanes

    def input(self, letter: str, index: int) -> Value:
        """The values of an input of a graph: z the state, c the constants, t the time and its unit."""
        if letter == "t":
            return self.unit if index else self.times[0]
        return (self.states if letter == "z" else self.constants)[index]


class _Jumping:
    """The kernel of a scheme's jumps: kernel(room, constants, first, last, lanes, times) for some of the lanes.

    room  the unit of time, times, states (lanes, d), room for new states (times, lanes, d) and errors (times, lanes)
    """

    def __init__(self, scheme: Scheme, columns: Mapping[str, slice]):
        jump = None if scheme.orbits is None else scheme.orbits.jump
        if jump is None:
            raise TypeError(f"the scheme {scheme.name} states no jump")
        self._scheme, self._kinds = scheme, scheme.kinds
        self._state = algebra.coordinate_count(self._kinds, scheme.n)
        self._columns = columns
        self._constants, self._width = count_of(self._columns), register_width()
        self._single = isinstance(jump, Spin)  # a number needs 1.1 us, a vector of eight 1.7 us
        self._write = self._top(jump) if isinstance(jump, Jump) else self._body(jump)

    def kernel(self) -> Kernel:
        """Compiled, or from the disk."""
        key = "jump", *self._key, self._kinds, self._state, self._constants, self._width
        return kernel(key, 6, self._function)

    def _by_name(self, c: Array) -> dict[str, Array]:
        return constants_of(self._scheme, c, self._columns)

    def _parts(self, z: Array) -> tuple[Array, ...]:
        return algebra.restore(z, self._kinds, self._scheme.n)

    def _function(self, f: Function) -> None:
        room, constants, first, last, lanes, times = f.arguments
        numbers, width, d = f.doubles(room), self._width, self._state
        states = numbers.beyond(times + 1)
        new = states.beyond(lanes * d)
        errors = new.beyond(times * lanes * d)
        count = last - first
        rows = count * times

        def write(row: Any, width: int) -> None:
            at = [f.integer(k) for k in f.lanes(row, width, rows)]
            when, which = [k // count for k in at], [first + k % count for k in at]
            places = [t * lanes + lane for t, lane in zip(when, which, strict=True)]
            self._write(
                f,
                Rows(
                    Lanes(states, which, d),
                    Lanes(f.doubles(constants), which, self._constants),
                    Lanes(numbers.beyond(1), when, 1),
                    Lanes(numbers, [f.integer(0)] * width, 0)[0],
                    Lanes(new, places, d),
                    Lanes(errors, places, 1),
                ),
            )

        f.vectors(width)
        if self._single:
            with f.otherwise(rows.compared("==", 1)) as (single, several):
                with single:
                    write(0, 1)
                with several, f.loop(0, rows, width) as row:
                    write(row, width)
        else:
            with f.loop(0, rows, width) as row:
                write(row, width)

    def _written(self, program: Callable[[Array, Array, Any], Sequence[Any]]) -> Callable[[Function, Rows], None]:
        """A writer of a program of state, constants and time, which returns the error and the new state."""

        @cache  # once for scalars and for vectors
        def recorded() -> tuple[Graph, list[Operand]]:
            graph = Graph()
            t = DoubleDouble(graph.input("t", 0)) * DoubleDouble(graph.input("t", 1))
            values = program(graph.inputs("z", self._state), graph.inputs("c", self._constants), t)
            return graph, as_operands(values)

        def write(f: Function, rows: Rows) -> None:
            rows.errors[0], *state = f.outputs(*recorded(), rows.input, rows.states.kind)
            rows.new.put(state)

        return write

    def _body(self, jump: Spin) -> Callable[[Function, Rows], None]:
        def start(z: Array) -> list[Any]:
            return list(jump.begin(*self._parts(z))[0])

        def end(z: Array, m: Array, turn: Array) -> Array:
            before = jump.begin(*self._parts(z))[1:]
            new = jump.finish(m, *(algebra.quaternion_product(g, turn) for g in before))
            return algebra.flatten(new, self._kinds)

        begin, finish = Formula(start, (self._state,)), Formula(end, (self._state,), (3,), (4,))
        moments = Formula(lambda c: jump.moments(**self._by_name(c)), (self._constants,))
        self._key = begin.digest(), finish.digest(), moments.digest()

        def program(z: Array, c: Array, t: Any) -> list[Any]:
            moments = jump.moments(**self._by_name(array_of([DoubleDouble(x) for x in c])))
            *new, off = rotated(moments, begin(z), t)
            return [off, *finish(z, new[:3], new[3:])]

        return self._written(program)

    def _top(self, jump: Jump) -> Callable[[Function, Rows], None]:
        oriented = "quaternion" in self._kinds

        def start(z: Array, c: Array) -> list[Any]:
            m, b, p, *alphas = jump.begin(*self._parts(z), **self._by_name(c))
            return [*m, *b, *p, *alphas]

        def carry(z: Array, b: Array, cos: Any, sin: Any) -> Array:
            """The orientation begins with a rotation about b."""
            spin = array_of([cos, *(sin / algebra.sqrt(algebra.dot(b, b)) * b)])
            return algebra.quaternion_product(spin, jump.orientation(self._parts(z)[-1]))

        def end(m: Array, b: Array, *arguments: Any) -> Array:
            q, (axis, cos, sin) = arguments[:-3], arguments[-3:]
            turn = array_of([cos, *(sin * axis)])
            new = [algebra.conjugated(turn, v) for v in (m, b)] + [
                algebra.unit(algebra.quaternion_product(turn, x)) for x in q
            ]
            return algebra.flatten(jump.finish(*new), self._kinds)

        shapes = (3,), (3,), *[(4,)] * oriented, (3,), (), ()
        begin, mapped, finish = (
            Formula(start, (self._state,), (self._constants,)),
            Formula(_d_eps, *shapes),
            Formula(end, *shapes),
        )
        carried = Formula(carry, (self._state,), (3,), (), ()) if oriented else None
        self._key = begin.digest(), finish.digest(), str(carried and carried.digest())

        def program(z: Array, c: Array, t: Any) -> list[Any]:
            *entries, above, within = begin(z, c)
            m, b, p = (array_of([DoubleDouble(x) for x in entries[k : k + 3]]) for k in (0, 3, 6))
            maps, eps, r, unit, turn, spin, off, off_all = leap(Integrals.of(m, b, p), (above, within), t)
            error = (off_all if oriented else off) + where_less(float(MOST), maps, 1.0, 0.0)
            spin = spin - 2.0 * nearest(0.5 * spin)
            q = carried(z, entries[3:6], *of_turns(0.5 * spin)) if carried else []

            def once(x: list[Any]) -> tuple[list[Any], Any]:
                left = x[-1] - 1.0
                return [*mapped(x[:-1], entries[6:], eps, r), left], left

            (*state, _), _ = maps.graph.loop(once, [*entries[:6], *q, maps], 0.0, MOST)
            cos, sin = of_turns(0.5 * turn - nearest(0.5 * turn))
            return [error, *finish(state, [x * unit for x in entries[6:]], cos, sin)]

        return self._written(program)


def _d_eps(m: Array, b: Array, *arguments: Any) -> list[Any]:
    """D_eps, with the orientation, which it rotates by R_a R_b."""
    q, (p, eps, r) = arguments[:-3], arguments[-3:]
    hat, new, a = darboux(algebra.hat(m), b, p, eps, r)
    turned = (algebra.unit(algebra.quaternion_product(half_turns(a, b), x)) for x in q)
    return [*algebra.axial(hat), *new, *(v for x in turned for v in x)]


class Leap(NamedTuple):
    """Memory of a jump of one state, and the link that makes it.

    z      the state (1, d) at time 0
    row    the state (1, 1, d) at the product of `time` (2,)
    error  (1,), at most TOLERANCE if the row is right
    """

    z: Floats
    row: Floats
    time: Floats
    error: Floats
    link: Link


def jumps_of(scheme: Scheme, lanes: int) -> Jumps:
    """The jumps of a scheme, of a single lane made once."""
    if lanes > 1:
        return Jumps(scheme, lanes)
    if Jumps not in scheme.compiled:
        scheme.compiled[Jumps] = Jumps(scheme, lanes)
    result: Jumps = scheme.compiled[Jumps]
    return result


class Jumps:
    """The states of tops or bodies at any times."""

    def __init__(self, scheme: Scheme, lanes: int):
        self._constants, columns = flat_constants(scheme, lanes)
        self._address = address_of(self._constants)
        of_rows = scheme.of_structure(scheme.definition_key)
        key = None if of_rows is None else (Jumps, of_rows)
        self._jump = reused(key, lambda: _Jumping(scheme, columns).kernel())

    def single(self, d: int) -> Leap:
        """A jump of one state of d scalars."""
        room = np.ones(3 + 2 * d)
        link = self._jump, (room, self._constants, 0, 1, 1, 1)
        return Leap(room[2 : 2 + d].reshape(1, d), room[2 + d : -1].reshape(1, 1, d), room[:2], room[-1:], link)

    def at(self, z: Floats, times: Floats, unit: float = 1.0) -> tuple[Floats, Array]:
        """The states (times, lanes, d) from z (lanes, d) at time 0, and which of them are right (times, lanes).

        At the exact products of `times` and `unit`.
        """
        (lanes, d), count = z.shape, len(times)
        before, after = 1 + count + lanes * d, 1 + count + (1 + count) * lanes * d
        room = np.empty(after + count * lanes)
        room[0], room[1 : 1 + count], room[1 + count : before] = unit, times, z.ravel()
        address, jump = address_of(room), self._jump.call
        if lanes == 1:
            jump(address, self._address, 0, 1, 1, count)
        else:
            work = WORK * lanes * count
            on_threads(lanes, work, lambda first, last: jump(address, self._address, first, last, lanes, count))
        return room[before:after].reshape(count, lanes, d), room[after:].reshape(count, lanes) <= TOLERANCE
