"""Interaction of two particles in a short time, and its kernels inside REBOUND's steps.

The interaction is a change of momentum and spin by figures, tides and their lag.  r and v go from body 1 to body 2; L
is the spin angular momentum of a body and q its orientation, both in the frame of the simulation.  The mutual potential
to the fourth degree and the force of tides that lag are taken from `kreisel.bodies.binary`, with masses 1 and with
factors that have time, masses and constant of gravity.  A fluid ball flattened by its rotation Omega adds for the mass
m of the other body

    m k_2 R^5 (3 (Omega.u)^2 - Omega^2)/(6 r^3)                u = r/|r|   [Eggleton 1998]

The changes are p, which body 2 receives and body 1 loses, and the torques T1, T2 with T1 + T2 + r x p = 0.

In the kernels p (N, ...) are REBOUND's particles in their memory, rows of x, v, a, m and more.  A body is a row L, q of
`z` and a row of `c`, the entries of `ROTOR`.  A pair is a row of `pairs`, its kind and the places of both particles and
bodies, and a row of `factors`, the entries of `PAIR` for the time of a kick.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, cross, dot
from kreisel.algebra.gradient import value_and_gradient
from kreisel.bodies import binary
from kreisel.exact import rotor_step
from kreisel.graph.graph import Graph, Operand
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Memory, Value, constant
from kreisel.graph.machine import Kernel, kernel, object_code
from kreisel.graph.recording import recorded_function

formulas = cast("Any", binary)  # of a page, without types
Changes = tuple[Array, Array, Array]
LEAST = {"D": 2, "degree_3_": 4, "degree_4_": 4}  # degree of the figures that have it; all over the mass of the body
FIGURES = {f"{name}{i}": (count,) for name, count in zip(LEAST, (3, 7, 9), strict=True) for i in (1, 2)}
BODIES = {"inverse1": (3,), "inverse2": (3,), "on1": (), "on2": ()}
FLUID = {"fluid1": (), "fluid2": (), **BODIES}
LAG = {"lag1": (), "lag2": (), "into1": (), "into2": (), **BODIES}


def potential(r: Array, q1: Array, q2: Array, *, raised: Any, **figures: Array) -> Any:
    """V_12 of masses 1, in SI; `raised`: (m2 tide1/m1 + m1 tide2/m2)."""
    return formulas.potential(r, q1, q2, m1=1.0, m2=1.0, tide1=raised, tide2=0.0, **figures)


def flattening(r: Array, W: Array) -> Any:
    """The energy of a fluid ball with the angular velocity W for m k_2 R^5 = 1."""
    square = dot(r, r)
    return (3 * dot(W, r) * dot(W, r) / square - dot(W, W)) / (6 * square * algebra.sqrt(square))


def kick(r: Array, q1: Array, q2: Array, *, strength: Any, raised: Any, **figures: Array) -> Changes:
    """Changes by the mutual potential while positions and orientations stay; `strength`: of V_12."""

    def energy(r: Array, turn: Array) -> Any:
        turned = algebra.quaternion_product(algebra.quaternion(1 + 0 * turn[0], 0.5 * turn), q2)
        return potential(r, q1, turned, raised=raised, **figures)

    _, (slope, torque) = value_and_gradient(energy, [(r, 1), (0 * r, 1)])
    p, T2 = -strength * slope, -strength * torque
    return p, -cross(r, p) - T2, T2


def flatten(
    r: Array, L1: Array, L2: Array, *, fluid1: Any, fluid2: Any, inverse1: Array, inverse2: Array, on1: Any, on2: Any
) -> Changes:
    """Changes by two fluid balls; `fluid`: m k_2 R^5 times the time.

    Each spin meanwhile rotates about r by 2 arctan |y|: midpoint rule.
    """
    square, changes = dot(r, r), []
    for L, fluid, inverse, on in ((L1, fluid1, inverse1, on1), (L2, fluid2, inverse2, on2)):
        W = L * inverse
        y = 0.5 * on * fluid * inverse[0] * dot(W, r) / (square * square * algebra.sqrt(square)) * r
        across = cross(y, W)
        W = W + (across + cross(y, across)) / (1 + dot(y, y))
        changes.append(-fluid * value_and_gradient(lambda x, W=W: flattening(x, W), [(r, 1)])[1][0])
    p1, p2 = changes
    return p1 + p2, -cross(r, p1), -cross(r, p2)


def energy(r: Array, state1: Array, state2: Array, *, strength: Any, raised: Any, **factors: Any) -> Any:
    """The energy of a kick of the time 1, `state`: L and q."""
    figures = {name: factors[name] for name in FIGURES}
    total = strength * potential(r, state1[3:], state2[3:], raised=raised, **figures)
    for n, state in ((1, state1), (2, state2)):
        total = total + factors[f"fluid{n}"] * flattening(r, state[:3] * factors[f"inverse{n}"])
    return total


def friction(
    r: Array, v: Array, L1: Array, q1: Array, L2: Array, q2: Array, *, inverse1: Array, inverse2: Array, into1: Any,
    into2: Any, on1: Any, on2: Any, **lags: Any,
) -> Changes:  # fmt: skip
    """Changes by tides that lag, by the midpoint rule; `lag`: m^2 k_2 R^5 times the lag and the time.

    into   the change of the velocity of a body by p: 1/m; on   1, or 0 for a body that does not react
    """
    constants = dict.fromkeys(("m1", "m2", "reduced", "tide1", "tide2"), 1.0) | {"rotor1": inverse1, "rotor2": inverse2}

    def changes(v: Array, L1: Array, L2: Array) -> Changes:
        _, p, T1, _, T2, _ = formulas.friction(r, v, L1, q1, L2, q2, **constants, **lags)[0]
        return p, T1, T2

    p, T1, T2 = changes(v, L1, L2)
    return changes(v + 0.5 * (into1 + into2) * p, L1 + 0.5 * on1 * T1, L2 + 0.5 * on2 * T2)


def turn(L: Array, q: Array, h: Any, **constants: Array) -> Array:
    """The orientation after the free motion over the time h, exactly; `constants`: of `rotor_step.constants`."""
    return rotor_step.step(L @ algebra.rotation_matrix(q), q, h=h, **constants)[1]


def turn_of_ball(L: Array, q: Array, h: Any, *, inverse: Array, **_: Array) -> Array:
    """The orientation after the free motion of a ball over the time h, for rotations up to 8 radians."""
    return algebra.quaternion_product(algebra.turn(h * inverse[0] * L), q)


def reach(L: Array, q: Array, h: Any, **constants: Array) -> list[Any]:
    """A measure of the length of that step, as in `rotor_step`."""
    return [rotor_step.reach(L @ algebra.rotation_matrix(q), h, **constants)]


def reach_of_ball(L: Array, q: Array, h: Any, *, inverse: Array, **_: Array) -> list[Any]:
    """`reach` of a ball."""
    return [rotor_step.reach(L, h, inverse=inverse, curvatures=0 * q[:3])]


# -- kernels --------------------------------------------------------------------------------------------


Recording = tuple[Graph, list[Operand]]
ROTOR = {"inverse": (3,), "rates": (3,), "curvatures": (3,)}
STATE = {"r": (3,), "v": (3,), "L1": (3,), "q1": (4,), "L2": (3,), "q2": (4,)}
PAIR: dict[str, tuple[int, ...]] = {"strength": (), "raised": (), **FIGURES, **FLUID, **LAG}
ENDS = np.cumsum([math.prod(shape) for shape in PAIR.values()]).tolist()
PLACES = {name: slice(end - math.prod(shape), end) for (name, shape), end in zip(PAIR.items(), ENDS, strict=True)}
MOST_PARTS = 100_000  # of a rotation: a step with more parts is meaningless
LOST, TURNED_OFTEN = 1, 2  # `fault`: particles, or a body that rotates too often

# The words of a frame: addresses of arrays, and of REBOUND's data and functions; counts.
ARRAYS = "p", "masses", "z", "c", "factors", "dv", "v", "times", "pairs", "fault"
OF_REBOUND = "simulation", "N", "steps_done", "modified", "status", "advance", "forces", "before", "after"
COUNTS = "width", "particles", "bodies", "count", "bursts", "burst"
FRAME = (*ARRAYS, *OF_REBOUND, *COUNTS)
TIMES = "dt", "rotation", "trailing", "G"  # a step; the rotation before the next kick, and after all steps


class Kind(NamedTuple):
    """A kind of interaction of two bodies; absent terms are not computed.

    first, second   the degrees of their figures, 0 of a ball or a point, 2 or 4
    fluids          balls that their rotation flattens: 0, 1 if it is the first, else 2
    lags            bodies with tides that lag: 0, 1 if it is the first, or 2: friction, and nothing else
    """

    first: int
    second: int
    fluids: int = 0
    lags: int = 0

    def changes(self, r: Any, v: Any, L1: Any, q1: Any, L2: Any, q2: Any, **factors: Any) -> list[Any]:
        """p, T1 and T2 in a row."""
        none, upright, degrees = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), (self.first, self.second)
        q1, q2 = q1 if self.first else upright, q2 if self.second else upright
        if self.lags:
            constants = {name: factors[name] for name in LAG}
            if self.lags == 1:
                L2, constants = none, constants | {"lag2": 0.0, "on2": 0.0, "inverse2": none}
            return [*np.concatenate(friction(r, v, L1, q1, L2, q2, **constants))]
        figures = {
            f"{name}{i}": factors[f"{name}{i}"] if degree >= least else np.zeros(FIGURES[f"{name}{i}"])
            for name, least in LEAST.items()
            for i, degree in zip((1, 2), degrees, strict=True)
        }
        p, T1, T2 = kick(r, q1, q2, strength=factors["strength"], raised=factors["raised"], **figures)
        T1 = T1 if self.first else none
        if self.fluids:
            constants = {name: factors[name] for name in FLUID}
            if self.fluids == 1:
                L2, constants = none, constants | {"fluid2": 0.0, "on2": 0.0, "inverse2": none}
            terms = flatten(r, L1, L2, **constants)
            p, T1, T2 = (x + y for x, y in zip((p, T1, T2), terms, strict=True))
        return [*np.concatenate([p, T1, T2])]


@cache
def recorded(kind: Kind) -> Recording:
    """The changes of a kind of pair."""
    return recorded_function(kind.changes, STATE, PAIR)[:2]


@cache
def rotations() -> dict[str, Recording]:
    """The rotation of a body and of a ball, and their length."""
    functions = turn, reach, turn_of_ball, reach_of_ball
    state = {"L": (3,), "q": (4,), "h": ()}
    return {function.__name__: recorded_function(function, state, ROTOR)[:2] for function in functions}


class Code:
    """Code that the kernels share: the words of the frame, and actions on particles and bodies."""

    def __init__(self, f: Function, kinds: tuple[Kind, ...]):
        self.f, self.kinds = f, kinds
        self.words = dict(zip(FRAME, f.integers(f.arguments[0]).get(len(FRAME)), strict=True))
        self.doubles = {name: f.doubles(self.words[name]) for name in ARRAYS[:-2]}
        self.fault = f.integers(self.words["fault"])
        self.times = {name: self.doubles["times"].beyond(k) for k, name in enumerate(TIMES)}

    def act(self, backwards: Any, inside: bool) -> None:
        """Interaction of all pairs, one after the other or in reverse order.

        inside  whether accelerations receive it, in a step of WHFast, else velocities
        """
        f, builder, words, dv, p = self.f, self.f.builder, self.words, self.doubles["dv"], self.doubles["p"]
        with f.loop(0, words["particles"] * 3) as k:
            dv[k] = 0.0
        if any(kind.lags for kind in self.kinds):
            self._velocities(inside)
        with f.loop(0, words["count"]) as number:
            place = backwards * (words["count"] - 1 - number * 2) + number
            kind, *pair = f.integers(words["pairs"]).get(5, place * 5)
            for at, interaction in enumerate(self.kinds):
                with f.where(kind.compared("==", at)):
                    self._act(interaction, pair, self.doubles["factors"].beyond(place * ENDS[-1]))
        share = builder.fdiv(constant(DOUBLE, 1.0), self.times["dt"][0]) if inside else constant(DOUBLE, 1.0)
        with f.loop(0, words["particles"]) as i, f.loop(0, 3) as k:
            target = p.beyond(i * words["width"] + (6 if inside else 3) + k)
            target[0] = builder.fadd(target[0], builder.fmul(share, dv[i * 3 + k]))

    def _act(self, kind: Kind, pair: list[Integer], factors: Memory) -> None:
        f, builder = self.f, self.f.builder
        i, j, *bodies = pair
        places = [self.doubles["p"].beyond(x * self.words["width"]).get(3) for x in (i, j)]
        r = [builder.fsub(y, x) for x, y in zip(*places, strict=True)]
        rows, dv = [self.doubles["z"].beyond(x * 7) for x in bodies], [self.doubles["dv"].beyond(x * 3) for x in (i, j)]

        def of_state(at: int) -> Value:
            if at < 3:
                return r[at]
            if at >= 6:
                return rows[(at - 6) // 7][(at - 6) % 7]
            first, second = (
                builder.fadd(self.doubles["v"][x * 3 + (at - 3)], dv[n][at - 3]) for n, x in enumerate((i, j))
            )
            return builder.fsub(second, first)

        changes = f.outputs(*recorded(kind), lambda letter, at: of_state(at) if letter == "z" else factors[at])
        into = {name: factors[PLACES[name].start] for name in ("into1", "into2", "on1", "on2")}
        for k in range(3):
            dv[0][k] = builder.fsub(dv[0][k], builder.fmul(into["into1"], changes[k]))
            dv[1][k] = builder.fadd(dv[1][k], builder.fmul(into["into2"], changes[k]))
        for at, (x, output) in enumerate(zip(changes[3:], recorded(kind)[1][3:], strict=True)):
            body, k = divmod(at, 3)
            if not (isinstance(output, float) and output == 0):
                rows[body][k] = builder.fadd(rows[body][k], builder.fmul(into[f"on{body + 1}"], x))

    def _velocities(self, inside: bool) -> None:
        """Velocities for friction: inside WHFast in the middle of its kick, with the terms of Jacobi's coordinates."""
        f, builder, words = self.f, self.f.builder, self.words
        p, v, width = self.doubles["p"], self.doubles["v"], words["width"]
        half = builder.fmul(constant(DOUBLE, 0.5 if inside else 0.0), self.times["dt"][0])
        with f.loop(0, words["particles"]) as i, f.loop(0, 3) as k:
            row = p.beyond(i * width + k)
            v[i * 3 + k] = builder.fadd(row[3], builder.fmul(half, row[6]))
        if not inside:
            return
        *sums, mass = f.variables(4)  # of mass times place, and of mass, of the particles further in
        for cell in (*sums, mass):
            cell[0] = 0.0
        scale = builder.fmul(half, self.times["G"][0])
        with f.loop(0, words["particles"]) as i:
            x, m = p.beyond(i * width).get(3), self.doubles["masses"][i]
            with f.where(i.compared(">", 1)):
                q = [builder.fsub(a, builder.fdiv(s[0], mass[0])) for a, s in zip(x, sums, strict=True)]
                self._undo_attraction(i, q, m, mass[0], scale)
            for a, cell in zip((*x, constant(DOUBLE, 1.0)), (*sums, mass), strict=True):
                cell[0] = builder.fadd(cell[0], builder.fmul(m, a))

    def _undo_attraction(self, i: Integer, q: list[Value], m: Value, inner: Value, scale: Value) -> None:
        """Changes of v without the attraction of particle i, at q from the centre, and the mass further in."""
        f, builder, v = self.f, self.f.builder, self.doubles["v"]
        square = builder.fadd(builder.fadd(*(builder.fmul(x, x) for x in q[:2])), builder.fmul(q[2], q[2]))
        share = builder.fdiv(scale, builder.fmul(square, f.intrinsic("sqrt", square)))
        for k, x in enumerate(q):
            change, passed = builder.fmul(share, x), v.beyond(i * 3 + k)
            passed[0] = builder.fadd(passed[0], builder.fmul(inner, change))
            with f.loop(0, i) as j:
                has = builder.fcmp_ordered("!=", self.doubles["masses"][j], constant(DOUBLE, 0.0))
                with f.where(has):
                    v[j * 3 + k] = builder.fsub(v[j * 3 + k], builder.fmul(m, change))

    def turn(self, h: Value) -> None:
        """Rotate the bodies freely over a time h."""
        f, builder = self.f, self.f.builder
        zero = constant(DOUBLE, 0.0)
        with f.loop(0, self.words["bodies"]) as body:
            z, c = self.doubles["z"].beyond(body * 7), self.doubles["c"].beyond(body * 9)
            ball = builder.and_(*(builder.fcmp_ordered("==", c[k], zero) for k in (3, 4)))
            with f.otherwise(ball) as (of_ball, of_body):
                with of_ball:
                    self._turn("_of_ball", z, c, h)
                with of_body:
                    self._turn("", z, c, h)

    def _turn(self, which: str, z: Memory, c: Memory, h: Value) -> None:
        """Rotate a body, in parts of up to 4 radians."""
        f, builder = self.f, self.f.builder
        unit, two, most = (constant(DOUBLE, x) for x in (1.0, 2.0, float(MOST_PARTS)))

        def outputs(name: str, share: Value) -> list[Value]:
            values = *z.get(7), share
            return f.outputs(*rotations()[name + which], lambda letter, at: values[at] if letter == "z" else c[at])

        (reach,) = outputs("reach", h)
        parts = builder.fadd(unit, builder.fmul(two, f.intrinsic("sqrt", reach)))
        with f.otherwise(builder.fcmp_ordered("<", parts, most)) as (few, many):
            with few:
                count = Integer(builder, builder.fptosi(parts, INTEGER))
                (share,) = f.variables(1)
                share[0] = h
                with f.where(count.compared(">", 1)):  # a branch: the rotation does not wait for the count
                    share[0] = builder.fdiv(h, count.double())
                with f.loop(0, count):
                    z.put(outputs("turn", share[0]), 3)
            with many:
                self.fault[0] = TURNED_OFTEN

    def forces(self) -> None:
        """Forces of WHFast's kick in the middle of its step: the rotation since the last one, and the interaction."""
        with self._unless_lost("forces"):
            self.turn(self.times["rotation"][0])
            self.times["rotation"][0] = self.times["dt"][0]
            self.act(self.f.integers(self.words["steps_done"])[0] % 2, inside=True)

    def before(self) -> None:
        """Half a kick and the rotation, before a step of REBOUND."""
        with self._unless_lost("before"):
            self.f.builder.store(INDEX(1), self._small("modified"))
            self.act(self.f.integer(0), inside=False)
            self.turn(self.times["dt"][0])

    def after(self) -> None:
        """Half a kick, after a step of REBOUND."""
        with self._unless_lost(""):
            self.act(self.f.integer(1), inside=False)
        self._call("after")

    def advance(self) -> None:
        """Steps of REBOUND, which calls the other kernels, and the rest of the rotation."""
        f, words, builder = self.f, self.words, self.f.builder
        with f.loop(0, words["bursts"]), f.where(self.fault[0].compared("==", 0)):
            f.call(words["advance"], words["simulation"], words["burst"])
            stopped = builder.icmp_signed(">", builder.load(self._small("status")), INDEX(0))
            with f.where(builder.or_(f.integers(words["N"])[0].compared("!=", words["particles"]), stopped)):
                self.fault[0] = LOST
        trailing = self.times["trailing"][0]
        left = builder.fcmp_ordered("!=", trailing, constant(DOUBLE, 0.0))
        with f.where(builder.and_(self.fault[0].compared("==", 0), left)):
            self.turn(trailing)

    def _unless_lost(self, user: str) -> Any:
        """A block for the particles of the frame, none lost; calls the function of the user first."""
        if user:
            self._call(user)
        count = self.f.integers(self.words["N"])[0]
        with self.f.where(count.compared("!=", self.words["particles"])):
            self.fault[0] = LOST
        return self.f.where(count.compared("==", self.words["particles"]))

    def _call(self, user: str) -> None:
        with self.f.where(self.words[user].compared("!=", 0)):
            self.f.call(self.words[user], self.words["simulation"])

    def _small(self, name: str) -> Value:
        return self.f.builder.inttoptr(self.words[name].value, INDEX.as_pointer())


def written(name: str, kinds: tuple[Kind, ...], mark: str = "") -> Kernel:
    """A kernel, a method of `Code`: a function of the address of a frame; `mark`: of changed code."""
    digests = [graph.digest(outputs) for graph, outputs in (*map(recorded, kinds), *rotations().values())]
    return kernel(("rebound", name, kinds, mark, *digests), 1, lambda f: getattr(Code(f, kinds), name)())


compiled = cache(written)


def hook(function: Kernel, frame: Any) -> Kernel:
    """A function that REBOUND calls with its simulation: a kernel with that frame; both have to live as long."""

    def write(f: Function) -> None:
        f.call(f.integer(function.address), f.integer(int(frame.ctypes.data)))

    return Kernel(object_code(1, write), 1)
