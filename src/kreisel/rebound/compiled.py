"""The parts of a step on all bodies and particles, compiled: `kreisel.rebound.interaction` recorded.

p (N, ...) are REBOUND's particles in their memory, rows of x, v, a, m and more; `masses` (N,) are the active masses.  A
body is a particle `index`, a row L, g of `z` and a row of `c`: the entries that `ROTOR` and `FIGURE` list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from kreisel.exact import rotor_step
from kreisel.graph.graph import Graph, Operand
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Memory, Value, constant
from kreisel.graph.machine import Kernel, kernel
from kreisel.graph.recording import recorded_function
from kreisel.rebound import interaction

ROTOR = {"inverse": (3,), "rates": (3,), "curvatures": (3,)}
FIGURE = {"I": (3,), "D": (3,), "tide": (), "fluid": (), "lag": ()}
COLUMNS, OF_FIGURE, LAG = 18, 9, 17
BALL = 1e-12  # of the moments: rounding of a ball
MOST_PARTS = 100_000  # of a rotation: a step with more parts is meaningless

# The words of a frame: addresses, then counts: values per particle, active particles, bodies, particles, rows of q (0
# unless coordinates are Jacobi's) and their values, steps; and whether pairs are in reverse order.
ADDRESSES = (
    "p",
    "masses",
    "index",
    "z",
    "c",
    "dv",
    "times",
    "done",
    "q",
    "simulation",
    "step",
    "N",
    "modified",
    "status",
)
FRAME = (*ADDRESSES, "width", "active", "bodies", "particles", "jacobi", "jacobi_width", "steps", "backwards")
TURNED_OFTEN = -1  # `done` if a body rotates too often


class Recorded(NamedTuple):
    """A function of `interaction`, recorded; its constants begin at `first` in a row of c."""

    graph: Graph
    outputs: list[Operand]
    first: int

    @classmethod
    def of(
        cls,
        function: Callable[..., Any],
        inputs: Mapping[str, tuple[int, ...]],
        constants: Mapping[str, tuple[int, ...]],
        without: tuple[str, ...] = (),
        first: int = 0,
    ) -> Recorded:
        """A function of inputs, one after the other, and of constants, `without` some that it does not need."""

        def called(**arguments: Any) -> list[Any]:
            return list(function(**{name: value for name, value in arguments.items() if name not in without}))

        graph, outputs, _ = recorded_function(called, inputs, constants)
        return cls(graph, outputs, first)

    def __call__(self, code: Code, body: Integer, values: Sequence[Value]) -> list[Value]:
        """The outputs of the function for a body."""
        c = code.doubles["c"].beyond(body * COLUMNS + self.first)
        return code.f.outputs(self.graph, self.outputs, lambda letter, i: values[i] if letter == "z" else c[i])


@cache
def _recorded() -> dict[str, Recorded]:
    L, g, one = (3,), (4,), ()
    of_turn = {"L": L, "g": g, "h": one}
    of_pair = {"L": L, "g": g, "h": one, "m": one}
    kick = {"r": L, **of_pair, "G": one}
    friction = {"r": L, "v": L, **of_pair, "own": one, "G": one}
    return {
        "kick": Recorded.of(interaction.kick, kick, FIGURE, ("lag",), OF_FIGURE),
        "friction": Recorded.of(interaction.friction, friction, FIGURE, ("D", "fluid"), OF_FIGURE),
        "turn": Recorded.of(interaction.turn, of_turn, ROTOR),
        "turn_of_ball": Recorded.of(interaction.turn_of_ball, of_turn, {"I": (3,)}, first=OF_FIGURE),
        "reach": Recorded.of(interaction.reach, of_turn, ROTOR),
    }


class Code:
    """Code that the kernels share: the words of the frame, the actions of particles and bodies in a part of a step."""

    def __init__(self, f: Function, react: Reaction):
        self.f, self.react = f, react
        self.words = dict(zip(FRAME, f.integers(f.arguments[0]).get(len(FRAME)), strict=True))
        self.doubles = {name: f.doubles(self.words[name]) for name in ("p", "masses", "z", "c", "dv", "times", "q")}
        self.index, self.done = f.integers(self.words["index"]), f.integers(self.words["done"])
        self.dt, self.G = self.doubles["times"].get(2)

    def particle(self, i: Integer) -> Memory:
        """The values of a particle: x, v, a, m and more."""
        return self.doubles["p"].beyond(i * self.words["width"])

    def act_on_all(self, h: Value, backwards: Any) -> None:
        """Interaction of particles and bodies over a time h, pair after pair; or in reverse order."""
        f, words = self.f, self.words
        with f.loop(0, words["particles"] * 3) as k:
            self.doubles["dv"][k] = 0.0
        pairs = words["bodies"] * words["active"]
        zero = constant(DOUBLE, 0.0)
        with f.loop(0, pairs) as number:
            place = backwards * (pairs - 1 - number * 2) + number
            body, j = place // words["active"], place % words["active"]
            i = self.index[body]
            lag = self.doubles["c"][body * COLUMNS + LAG]
            lagging = Integer(f.builder, f.builder.zext(f.builder.fcmp_ordered("!=", lag, zero), INTEGER))
            with f.where(i.compared("!=", j)):
                with f.where((lagging * (1 - backwards)).compared("==", 1)):
                    self._act(i, j, body, h, lagging=True)
                self._act(i, j, body, h, lagging=False)
                with f.where((lagging * backwards).compared("==", 1)):
                    self._act(i, j, body, h, lagging=True)

    def _act(self, i: Integer, j: Integer, body: Integer, h: Value, lagging: bool) -> None:
        f, builder = self.f, self.f.builder
        first, second = self.particle(i), self.particle(j)
        r = [builder.fsub(x, y) for x, y in zip(second.get(3), first.get(3), strict=True)]
        z, m = self.doubles["z"].beyond(body * 7), self.doubles["masses"][j]
        if lagging:
            v = [builder.fsub(x, y) for x, y in zip(second.get(3, 3), first.get(3, 3), strict=True)]
            change = _recorded()["friction"](self, body, [*r, *v, *z.get(7), h, m, first[9], self.G])
        else:
            change = _recorded()["kick"](self, body, [*r, *z.get(7), h, m, self.G])
        dv = self.doubles["dv"]
        self.react(f, (first, dv.beyond(i * 3), first[9]), (second, dv.beyond(j * 3), m), z, r, change)

    def turn_all(self, h: Value) -> None:
        """Rotate the bodies freely over a time h; `done` is `TURNED_OFTEN` if one rotates too often in it."""
        f, builder, functions = self.f, self.f.builder, _recorded()
        one, two, most = (constant(DOUBLE, x) for x in (1.0, 2.0, float(MOST_PARTS)))
        with f.loop(0, self.words["bodies"]) as body:
            z = self.doubles["z"].beyond(body * 7)
            L, c = z.get(3), self.doubles["c"].beyond(body * COLUMNS + OF_FIGURE)
            (reach,) = functions["reach"](self, body, [*z.get(7), h])
            parts = builder.fadd(one, builder.fmul(two, f.intrinsic("sqrt", reach)))  # rotations by up to 4 radians
            few = builder.fcmp_ordered("<", parts, most)
            with f.otherwise(few) as (turns, refused):
                with turns:
                    count = Integer(builder, builder.fptosi(parts, INTEGER))
                    share, g = builder.fdiv(h, count.double()), z.beyond(3)
                    zero = constant(DOUBLE, 0.0)
                    ball = builder.and_(*(builder.fcmp_ordered("==", c[k], zero) for k in (3, 4)))
                    with f.loop(0, count), f.otherwise(ball) as (of_ball, of_body):
                        with of_ball:
                            g.put(functions["turn_of_ball"](self, body, [*L, *g.get(4), share]))
                        with of_body:
                            g.put(functions["turn"](self, body, [*L, *g.get(4), share]))
                with refused:
                    self.done[0] = TURNED_OFTEN

    def change_jacobi(self) -> None:
        """Velocities of Jacobi's coordinates, by the changes dv of the others."""
        f, builder, masses = self.f, self.f.builder, self.doubles["masses"]
        dv, rows = self.doubles["dv"], self.words["jacobi"]
        momentum, mass = f.variables(2)
        with f.where(rows.compared(">", 0)), f.loop(0, 3) as k:
            momentum[0], mass[0] = builder.fmul(masses[0], dv[k]), masses[0]
            with f.loop(1, rows) as i:
                v = self.doubles["q"].beyond(i * self.words["jacobi_width"] + 3 + k)
                change = dv[i * 3 + k]
                v[0] = builder.fadd(v[0], builder.fsub(change, builder.fdiv(momentum[0], mass[0])))
                momentum[0] = builder.fadd(momentum[0], builder.fmul(masses[i], change))
                mass[0] = builder.fadd(mass[0], masses[i])

    def advance(self) -> None:
        """Steps of bodies and particles, by REBOUND's step between the halves of their interaction."""
        f, words, builder = self.f, self.words, self.f.builder
        half, present, status = (
            builder.fdiv(self.dt, constant(DOUBLE, 2.0)),
            f.integers(words["N"]),
            self._small("status"),
        )
        count, ended = present[0], f.integers(words["done"]).beyond(1)
        ended[0] = 0
        with f.loop(0, words["steps"]):
            with f.where(ended[0].compared("==", 0)):
                self.act_on_all(half, f.integer(0))
                self.change_jacobi()
                self.turn_all(self.dt)
                with f.where(self.done[0].compared("<", 0)):
                    ended[0] = 1
                with f.where(ended[0].compared("==", 0)):
                    with f.where(words["jacobi"].compared("==", 0)):
                        builder.store(INDEX(1), self._small("modified"))
                    f.call(words["step"], words["simulation"], 1)
                    stopped = builder.icmp_signed(">", builder.load(status), INDEX(0))
                    with f.otherwise(builder.or_(present[0].compared("!=", count), stopped)) as (stop, go_on):
                        with stop:
                            ended[0] = 1
                        with go_on:
                            self.act_on_all(half, f.integer(1))
                            self.change_jacobi()

    def _small(self, name: str) -> Value:
        """A pointer to an integer of 32 bits."""
        return self.f.builder.inttoptr(self.words[name].value, INDEX.as_pointer())


Side = tuple[Memory, Memory, Value]  # of a pair: a particle, the sum of changes of its velocity, its mass
Reaction = Callable[[Function, Side, Side, Memory, Sequence[Value], Sequence[Value]], None]


def react(f: Function, first: Side, second: Side, z: Memory, r: Sequence[Value], change: Sequence[Value]) -> None:
    """Change of the velocity of the second particle, with its reaction on the first and on the spin z of the body."""
    builder, (particle, dv, own), (others, other_dv, m) = f.builder, first, second
    ratio = builder.fdiv(m, own)
    for k, x in enumerate(change):
        back = builder.fmul(ratio, x)
        for memory in (others.beyond(3 + k), other_dv.beyond(k)):
            memory[0] = builder.fadd(memory[0], x)
        for memory in (particle.beyond(3 + k), dv.beyond(k)):
            memory[0] = builder.fsub(memory[0], back)
    impulse = [builder.fmul(x, m) for x in change]
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        torque = builder.fsub(builder.fmul(r[i], impulse[j]), builder.fmul(r[j], impulse[i]))
        z[k] = builder.fsub(z[k], torque)


def compiled(part: str, reaction: Reaction = react) -> Kernel:
    """The kernel of a part: "act", "turn" or "advance", a function of the address of a frame."""
    digests = tuple(each.graph.digest(each.outputs) for each in _recorded().values())

    def write(f: Function) -> None:
        code = Code(f, reaction)
        if part == "act":
            code.act_on_all(code.dt, code.words["backwards"])
        elif part == "turn":
            code.turn_all(code.dt)
        else:
            code.advance()

    return kernel(("rebound", part, reaction.__name__, digests), 1, write)


_kernels = cache(compiled)


def _run(part: str, arrays: Mapping[str, Any], **more: int) -> bool:
    """Run a kernel on arrays, and on addresses and counts; False if a body rotates too often."""
    done = np.zeros(2, dtype=np.int64)
    words = dict.fromkeys(FRAME, 0) | {name: int(array.ctypes.data) for name, array in arrays.items()}
    words |= {"done": done.ctypes.data, **more}
    frame = np.array([words[name] for name in FRAME], dtype=np.int64)
    _kernels(part)(frame.ctypes.data)
    return bool(done[0] == 0)


def _rows(
    p: Any, masses: Any, index: Any, z: Any, c: Any, dv: Any, h: float, G: float
) -> tuple[dict[str, Any], dict[str, int]]:
    arrays = {"p": p, "masses": masses, "index": index, "z": z, "c": c, "dv": dv, "times": np.array([h, G])}
    return arrays, {"width": p.shape[1], "active": len(masses), "bodies": len(index), "particles": len(dv)}


def act_on_all(p: Any, masses: Any, index: Any, z: Any, c: Any, dv: Any, h: float, G: float, backwards: bool) -> None:
    """Interaction of particles and bodies over a time h, pair after pair; `backwards`: in reverse order."""
    arrays, counts = _rows(p, masses, index, z, c, dv, h, G)
    _run("act", arrays, **counts, backwards=int(backwards))


def turn_all(z: Any, c: Any, h: float) -> bool:
    """Rotate the bodies freely over a time h; False if one rotates too often in it."""
    return _run("turn", {"z": z, "c": c, "times": np.array([h, 0.0])}, bodies=len(z))


def advance(
    p: Any, masses: Any, index: Any, z: Any, c: Any, dv: Any, h: float, G: float, q: Any, step: int, simulation: int,
    counts: Any, modified: int, status: int, steps: int,
) -> bool:  # fmt: skip
    """Steps of bodies and particles; False as for `turn_all`.

    step, simulation, modified, status  addresses of REBOUND's step and of its data; q: Jacobi's coordinates
    """
    arrays, sizes = _rows(p, masses, index, z, c, dv, h, G)
    of_rebound = {"step": step, "simulation": simulation, "modified": modified, "status": status, "steps": steps}
    jacobi = {"jacobi": len(q), "jacobi_width": q.shape[1]}
    return _run("advance", {**arrays, "q": q, "N": counts}, **sizes, **of_rebound, **jacobi)


def columns(moments: Any, tide: float, fluid: float, lag: float) -> Any:
    """The row c of a body."""
    rotor = rotor_step.constants(moments)
    D = np.zeros(3) if is_ball(moments) else moments - moments.sum() / 3
    return np.concatenate([*(rotor[name] for name in ROTOR), moments, D, [tide, fluid, lag]])


def is_ball(moments: Any) -> bool:
    """Whether moments are equal up to rounding."""
    return bool(np.ptp(moments) <= BALL * np.max(moments))
