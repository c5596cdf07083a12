"""Flows, n = 3, from time 0 to any time at once: kernels that set up and jump, for many tops or free bodies.

Of the free body: `kreisel.kernels.exact.rotating`.  Over the period of nutation the flow of the Lagrange top is a turn
about p; over what is left of the time it is `count` times D_eps, less the turn of D_eps.  The formulas of
`kreisel.exact.nutation` are recorded here, for doubles and double-doubles alike; `kreisel.kernels.exact.nutating` puts
them together.  Each lane tells what it may be off; some need more digits.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import astuple
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.exact.motion import half_turns
from kreisel.exact.nutation import Integrals, darboux, squared_length, turning
from kreisel.exact.turning import turned
from kreisel.kernels._llvm.machine import register_width
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.layout import Floats
from kreisel.kernels.printing import arranged
from kreisel.kernels.recording import count_of, flat_constants, indented
from kreisel.kernels.simd import HEAD
from kreisel.kernels.tape import Scalar, Tape, source_of
from kreisel.kernels.threads import on_threads
from kreisel.method.scheme import Jump, Scheme, Spin

TOLERANCE = 1e-16  # of a turn and of a period: more that a jump may be off, and more digits are taken
FEW = 10_000  # times that are jumps: the set-up of a motion in many digits takes as long as 10^5 of them
ROWS = 10**6  # of a run of a free body that are jumps: its set-up takes as long, 50 ms
WORK = 200  # a jump is worth so many steps of a map in an ensemble
# What the kernel imports beside the operations of all kernels.
TEXTS = ("elliptic.py", "nutating.py", "rotating.py")

FUNCTION = """
@straight
def {name}({arguments}):
{body}
    return {result}

"""

KERNEL = """
MOST = 64  # maps in a jump


@straight
def moment(time, step):
    return pair(time, 0.0) * step


@compiled(
    "f8[:,::1], f8[:,::1], f8[::1], f8, f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1]"
)
def jump(z, c, times, step, out, off, states, constants, when):
    lanes, rows = len(z), len(out)
{single}
    for k in range(rows):
        put_numbers(states, (k,), numbers(z, (k % lanes,), {state}, ()), ())
        put_numbers(constants, (k,), numbers(c, (k % lanes,), {constants}, ()), ())
        when[k, 0] = times[k // lanes]
    for row in range(0, rows, {width}):
        (number,) = gather(when, 1, row, rows, {width})
        t = moment(number, step)
        now = gather(states, {state}, row, rows, {width})
        known = gather(constants, {constants}, row, rows, {width})
{body}
"""

TOP = """
        m0, m1, m2, b0, b1, b2, p0, p1, p2, above, within = begin(*now, *known)
        conserved = integrals({pairs})
        count, eps, r, unit, turn, spin, off_state, off_all = leap(conserved, (above, within), t, turning, length)
        {carry}
        most = MOST
        if largest(count) < MOST:
            most = int(largest(count))
        for k in range(most):
            {mapped} = mapped(
                {mapped}, p0, p1, p2, where_less(float(k), count, eps, 0.0), r
            )
        cos, sin = of_turns(0.5 * (turn - nearest(turn)))
        new = finish({mapped}, p0 * unit, p1 * unit, p2 * unit, cos, sin)
        scatter(out, (), row, rows, new, {width})
        scatter(off, (), row, rows, ({error} + where_less(float(MOST), count, 1.0, 0.0),), {width})
"""

# The orientation begins with a turn about b.
CARRY = """
        spin = spin - nearest(spin)
        q0, q1, q2, q3 = carried(*now, b0, b1, b2, *of_turns(0.5 * spin))
"""

BODY = """
        new = rotated(moments({pairs}), begin(*now), t)
        scatter(out, (), row, rows, finish(*now, *new[:7]), {width})
        scatter(off, (), row, rows, (new[7],), {width})
"""

# A number takes 1.1 us, a vector of eight 1.7 us.
SINGLE = """
    if rows == 1:
        now, known = numbers(z, (0,), {state}, ()), numbers(c, (0,), {constants}, ())
        new = rotated(moments({pairs}), begin(*now), moment(times[0], step))
        put_numbers(out, (0,), finish(*now, *new[:7]), ())
        off[0, 0] = new[7]
        return
"""

IMPORTS = """from kreisel.kernels._llvm.operations import largest, nearest, pair, where_less
from kreisel.kernels.exact.elliptic import of_turns
from kreisel.kernels.exact.nutating import leap
from kreisel.kernels.exact.rotating import rotated

"""


def _function_source(name: str, function: Callable[..., Any], *shapes: tuple[int, ...], fuse: bool = True) -> str:
    """Source of a function of numbers, from one of arrays of these shapes; `fuse`: products into sums."""
    tape = Tape()
    names: list[str] = []
    given: list[Any] = []
    for shape in shapes:
        own = [f"x{len(names) + k}" for k in range(int(np.prod(shape)))]
        names += own
        array: Any = np.array([Scalar(tape, x) for x in own], dtype=object).reshape(shape)
        given.append(array[()])
    values = list(function(*given))
    outputs = [v.name for v in values if isinstance(v, Scalar)]
    lines = tape.needed(outputs)
    body = [line.text for line in (arranged(lines, outputs) if fuse else lines)]
    result = ", ".join(map(source_of, values))
    return FUNCTION.format(
        name=name,
        arguments=", ".join(names),
        body=indented(body or ["pass"], 4),
        result=result if len(values) == 1 else f"({result})",
    )


@cache
def _formulas() -> str:
    """What is the same for all systems: the integrals and `turning`, for double-doubles too, r, and D_eps."""

    def integrals(m: Array, b: Array, p: Array) -> list[Any]:
        known = Integrals.of(m, b, p)
        return [*astuple(known), known.K, *known.depressed, known.dual.K]

    three = (3,), (3,), (3,)
    return (
        _function_source("integrals", integrals, *three, fuse=False)
        + _function_source("turning", lambda *x: [turning(*x)], *[()] * 5, fuse=False)
        + _function_source("length", lambda *x: [squared_length(*x)], *[()] * 6)
    )


@cache
def _map_source(oriented: bool) -> str:
    """D_eps; with the orientation, which each map turns by R_a R_b."""

    def mapped(m: Array, b: Array, *rest: Any) -> list[Any]:
        q, (p, eps, r) = rest[:-3], rest[-3:]
        hat, new, a = darboux(algebra.hat(m), b, p, eps, r)
        turned = (algebra.unit(algebra.quaternion_product(half_turns(a, b), x)) for x in q)
        return [*algebra.axial(hat), *new, *(v for x in turned for v in x)]

    return _function_source("mapped", mapped, (3,), (3,), *[(4,)] * oriented, (3,), (), ())


def _jump_source(scheme: Scheme, columns: Mapping[str, slice]) -> str:
    jump = None if scheme.orbits is None else scheme.orbits.jump
    if jump is None:
        raise TypeError(f"the scheme {scheme.name} states no jump")
    state = algebra.coordinate_count(scheme.kinds, scheme.n)
    constants, width = count_of(columns), register_width()
    if isinstance(jump, Jump):
        functions, body, single = _of_top(scheme, jump, state, columns, width)
    else:
        functions, body, single = _of_body(scheme, jump, state, columns, width)
    return (
        HEAD.format(name=f"{scheme.name} of {[kind for _, kind in scheme.components]}, jumps")
        + IMPORTS
        + f"# {_imported_operations()}\n"
        + functions
        + KERNEL.format(
            width=width,
            state=state,
            constants=constants,
            body=body.strip("\n"),
            single=single.strip("\n"),
        )
    )


def _constants_by_name(c: Array, scheme: Scheme, columns: Mapping[str, slice]) -> dict[str, Array]:
    return {name: c[place].reshape((scheme.n,) * scheme.axes[name])[()] for name, place in columns.items()}


def _of_top(scheme: Scheme, jump: Jump, state: int, columns: Mapping[str, slice], width: int) -> tuple[str, str, str]:
    """The functions of a top, and what the kernel does with them."""
    kinds, n = [kind for _, kind in scheme.components], scheme.n
    constants, oriented = count_of(columns), "quaternion" in kinds

    def begin(z: Array, c: Array) -> list[Any]:
        m, b, p, *alphas = jump.begin(*algebra.restore(z, kinds, n), **_constants_by_name(c, scheme, columns))
        return [*m, *b, *p, *alphas]

    def carried(z: Array, b: Array, cos: Any, sin: Any) -> list[Any]:
        spin = np.array([cos, *(sin / algebra.sqrt(algebra.dot(b, b)) * b)], dtype=object)
        return list(algebra.quaternion_product(spin, jump.orientation(algebra.restore(z, kinds, n)[-1])))

    def finish(m: Array, b: Array, *rest: Any) -> list[Any]:
        q, (axis, cos, sin) = rest[:-3], rest[-3:]
        turn = np.array([cos, *(sin * axis)], dtype=object)
        new = [turned(turn, v) for v in (m, b)] + [algebra.unit(algebra.quaternion_product(turn, x)) for x in q]
        return list(algebra.flatten(jump.finish(*new), kinds))

    four = [(4,)] * oriented
    names = [f"{letter}{k}" for letter in "mb" for k in range(3)] + [f"q{k}" for k in range(4)] * oriented
    return (
        _function_source("begin", begin, (state,), (constants,))
        + (_function_source("carried", carried, (state,), (3,), (), ()) if oriented else "")
        + _function_source("finish", finish, (3,), (3,), *four, (3,), (), ())
        + _formulas()
        + _map_source(oriented),
        TOP.format(
            pairs=", ".join(f"pair({letter}{k}, 0.0)" for letter in "mbp" for k in range(3)),
            carry=CARRY.strip() if oriented else "",
            mapped=", ".join(names),
            error="off_all" if oriented else "off_state",
            width=width,
        ),
        "",
    )


def _of_body(scheme: Scheme, jump: Spin, state: int, columns: Mapping[str, slice], width: int) -> tuple[str, str, str]:
    """The same of a free body."""
    kinds, n = [kind for _, kind in scheme.components], scheme.n
    constants = count_of(columns)

    def begin(z: Array) -> list[Any]:
        return list(jump.begin(*algebra.restore(z, kinds, n))[0])

    def moments(c: Array) -> list[Any]:
        return list(jump.moments(**_constants_by_name(c, scheme, columns)))

    def finish(z: Array, m: Array, turn: Array) -> list[Any]:
        before = jump.begin(*algebra.restore(z, kinds, n))[1:]
        return list(algebra.flatten(jump.finish(m, *(algebra.quaternion_product(g, turn) for g in before)), kinds))

    pairs = ", ".join(f"pair(known[{k}], 0.0)" for k in range(constants))
    return (
        _function_source("begin", begin, (state,))
        + _function_source("moments", moments, (constants,), fuse=False)
        + _function_source("finish", finish, (state,), (3,), (4,)),
        BODY.format(pairs=pairs, width=width),
        SINGLE.format(
            pairs=pairs,
            state=state,
            constants=constants,
        ),
    )


@cache
def _imported_operations() -> str:
    """Of the text of what the kernel imports, which is compiled into it."""
    texts = b"".join((Path(__file__).parent / name).read_bytes() for name in TEXTS)
    return hashlib.sha256(texts).hexdigest()


class Jumps:
    """The states of so many tops or bodies at any times."""

    def __init__(self, scheme: Scheme, lanes: int):
        self._constants, columns = flat_constants(scheme, lanes)
        key = None if scheme.definition_key is None else (Jumps, scheme.definition_key)
        self._jump = reused(key, lambda: load_kernel(_jump_source(scheme, columns)).jump.call)

    def at(self, z: Floats, times: Floats, unit: float = 1.0) -> tuple[Floats, Array]:
        """The states (times, lanes, d) from z (lanes, d) at time 0, and which of them are right (times, lanes).

        At the exact products of `times` and `unit`.
        """
        z, c, count = np.ascontiguousarray(z), self._constants, len(z)
        out, off = np.empty((len(times), *z.shape)), np.empty((len(times), count))

        def jump(first: int, last: int) -> None:
            given = z[first:last], c[first:last]
            if len(times) == 1:  # rows as they lie
                when = np.empty((last - first, 1))
                self._jump(*given, times, unit, out[0, first:last], off[0, first:last, None], *given, when)
                return
            rows = len(times) * (last - first)
            states, errors = np.empty((rows, z.shape[1])), np.empty((rows, 1))
            room = [np.empty((rows, length)) for length in (z.shape[1], c.shape[1], 1)]
            self._jump(*given, times, unit, states, errors, *room)
            out[:, first:last] = states.reshape(len(times), last - first, -1)
            off[:, first:last] = errors.reshape(len(times), -1)

        on_threads(count, WORK * count * len(times) if count > 1 else 0, jump)
        return out, off <= TOLERANCE
