"""The parts of a step on all bodies and particles, compiled: `kreisel.rebound.interaction` recorded.

p (N, ...) are REBOUND's particles where they lie in memory, rows of x, v, a, m and more; `masses` (N,) those with which
they act.  A body is a particle `index`, a row L, g of `z` and a row of `c`: what `ROTOR` and `FIGURE` list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from kreisel.exact import rotor_step
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.recording import indented, recorded_function
from kreisel.kernels.simd import HEAD
from kreisel.rebound import interaction

ROTOR = {"inverse": (3,), "rates": (3,), "gaps": (3,), "curvatures": (3,)}
FIGURE = {"I": (3,), "D": (3,), "tide": (), "fluid": (), "lag": ()}
COLUMNS, OF_FIGURE, LAG = 21, 12, 20
BALL = 1e-12  # of the moments: what rounding may make of a ball
MOST_PARTS = 100_000  # of a turn: a step in which a body turns so often is no step

ROWS = "f8[:,::1], f8[::1], i8[::1], f8[:,::1], f8[:,::1], f8[:,::1]"  # p, masses, index, z, c, dv
ROOM = 17, 4  # numbers of w and out: what a function takes and gives

FUNCTION = """
@straight
def {name}(w, c, body, out):
{load}
{body}
{save}

"""

KERNELS = """
@straight
def apply(p, masses, z, dv, i, j, body, r, out):
    own, m = p[i, 9], masses[j]
    for k in range(3):
        p[j, 3 + k] += out[k]
        dv[j, k] += out[k]
        p[i, 3 + k] -= m / own * out[k]
        dv[i, k] -= m / own * out[k]
        out[k] *= m
    z[body, 0] -= r[1] * out[2] - r[2] * out[1]
    z[body, 1] -= r[2] * out[0] - r[0] * out[2]
    z[body, 2] -= r[0] * out[1] - r[1] * out[0]


@straight
def act(p, masses, z, c, dv, i, j, body, h, G, lagging, w, out):
    for k in range(3):
        w[k] = p[j, k] - p[i, k]
    if lagging:
        for k in range(3):
            w[3 + k] = p[j, 3 + k] - p[i, 3 + k]
        for k in range(7):
            w[6 + k] = z[body, k]
        w[13], w[14], w[15], w[16] = h, masses[j], p[i, 9], G
        friction(w, c, body, out)
    else:
        for k in range(7):
            w[3 + k] = z[body, k]
        w[10], w[11], w[12] = h, masses[j], G
        kick(w, c, body, out)
    apply(p, masses, z, dv, i, j, body, w, out)


@compiled("{rows}, f8, f8, i8, f8[::1], f8[::1]")
def act_on_all(p, masses, index, z, c, dv, h, G, backwards, w, out):
    for j in range(len(dv)):
        for k in range(3):
            dv[j, k] = 0.0
    pairs = len(index) * len(masses)
    for number in range(pairs):
        k = pairs - 1 - number if backwards else number
        body, j = k // len(masses), k % len(masses)
        i, lagging = index[body], c[body, {lag}] != 0.0
        if i != j:
            if lagging and not backwards:
                act(p, masses, z, c, dv, i, j, body, h, G, True, w, out)
            act(p, masses, z, c, dv, i, j, body, h, G, False, w, out)
            if lagging and backwards:
                act(p, masses, z, c, dv, i, j, body, h, G, True, w, out)


@compiled("f8[:,::1], f8[:,::1], f8, f8[::1], f8[::1], i8[::1]")
def turn_all(z, c, h, w, out, done):
    for body in range(len(z)):
        for k in range(7):
            w[k] = z[body, k]
        w[7] = h
        reach(w, c, body, out)
        parts = 1.0 + 2.0 * sqrt(out[0])  # turns by up to 4 radians
        if not parts < {most}:
            done[0] = -1
            return
        w[7] = h / int(parts)
        first, second = c[body, {figure} + 3], c[body, {figure} + 4]
        ball = first == 0.0 and second == 0.0
        for _ in range(int(parts)):
            if ball:
                turn_of_ball(w, c, body, out)
            else:
                turn(w, c, body, out)
            for k in range(4):
                w[3 + k] = out[k]
        for k in range(4):
            z[body, 3 + k] = out[k]


@straight
def change_jacobi(q, masses, dv):
    for k in range(3):
        momentum, mass = masses[0] * dv[0, k], masses[0]
        for i in range(1, len(q)):
            q[i, 3 + k] += dv[i, k] - momentum / mass
            momentum += masses[i] * dv[i, k]
            mass += masses[i]


@compiled("{rows}, f8, f8, f8[:,::1], i8, i8, i8[::1], i8, i8, i8, f8[::1], f8[::1], i8[::1]")
def advance(p, masses, index, z, c, dv, h, G, q, step, simulation, counts, modified, status, steps, w, out, done):
    count = counts[0]
    for k in range(steps):
        act_on_all(p, masses, index, z, c, dv, h / 2.0, G, 0, w, out)
        change_jacobi(q, masses, dv)
        turn_all(z, c, h, w, out, done)
        if done[0] < 0:
            return
        if len(q) == 0:
            put_whole(modified, 0, 1)
        call_at_address(step, (simulation, 1))
        now, stopped = counts[0], whole_at(status, 0)
        if now != count or stopped > 0:
            return
        act_on_all(p, masses, index, z, c, dv, h / 2.0, G, 1, w, out)
        change_jacobi(q, masses, dv)
"""


@cache
def _kernels() -> ModuleType:
    """Compiled once for this machine."""
    return load_kernel(source())


def _room() -> list[Any]:
    return [np.empty(size) for size in ROOM]


def act_on_all(p: Any, masses: Any, index: Any, z: Any, c: Any, dv: Any, h: float, G: float, backwards: bool) -> None:
    """Interaction of particles and bodies over a time h, pair after pair; `backwards`: in the other order."""
    _kernels().act_on_all(p, masses, index, z, c, dv, h, G, int(backwards), *_room())


def turn_all(z: Any, c: Any, h: float) -> bool:
    """Turn the bodies freely over a time h; False where one turns too often in it."""
    done = np.zeros(1, dtype=np.int64)
    _kernels().turn_all(z, c, h, *_room(), done)
    return bool(done[0] == 0)


def advance(*arguments: Any) -> bool:
    """Steps of bodies and particles: the arguments of the kernel but for its room; False as of `turn_all`."""
    done = np.zeros(1, dtype=np.int64)
    _kernels().advance(*arguments, *_room(), done)
    return bool(done[0] == 0)


def source() -> str:
    """Their text."""
    L, g, number = (3,), (4,), ()
    texts = [
        _function(
            interaction.kick,
            {"r": L, "L": L, "g": g, "h": number, "m": number, "G": number},
            FIGURE,
            ("lag",),
            OF_FIGURE,
        ),
        _function(
            interaction.friction,
            {"r": L, "v": L, "L": L, "g": g, "h": number, "m": number, "own": number, "G": number},
            FIGURE,
            ("D", "fluid"),
            OF_FIGURE,
        ),
        _function(interaction.turn, {"L": L, "g": g, "h": number}, ROTOR),
        _function(interaction.turn_of_ball, {"L": L, "g": g, "h": number}, {"I": (3,)}, first=OF_FIGURE),
        _function(interaction.reach, {"L": L, "g": g, "h": number}, ROTOR),
    ]
    head = HEAD.format(name="bodies of a REBOUND simulation")
    head += "from kreisel.kernels._llvm.operations import put_whole, whole_at\n\n"
    text = KERNELS.format(rows=ROWS, figure=OF_FIGURE, lag=LAG, most=MOST_PARTS)
    return head + "".join(texts) + text


def _function(
    function: Callable[..., Any],
    inputs: Mapping[str, tuple[int, ...]],
    constants: Mapping[str, tuple[int, ...]],
    without: tuple[str, ...] = (),
    first: int = 0,
) -> str:
    """A function of arrays as one of the row w and of c[body] from number `first` on, which writes the row `out`."""

    def called(**arguments: Any) -> list[Any]:
        return list(function(**{name: value for name, value in arguments.items() if name not in without}))

    lines, values, _ = recorded_function(called, inputs, constants)
    used = {name for line in lines for name in line.needs} | {value.strip("(-)") for value in values}
    numbered = sorted(n for n in used if n[0] in "zc" and n[1:].isdigit())
    load = [f"{n} = w[{n[1:]}]" if n[0] == "z" else f"{n} = c[body, {first + int(n[1:])}]" for n in numbered]
    return FUNCTION.format(
        name=function.__name__,
        load=indented(load, 4),
        body=indented([line.text for line in lines], 4),
        save=indented([f"out[{k}] = {value}" for k, value in enumerate(values)], 4),
    )


def columns(moments: Any, tide: float, fluid: float, lag: float) -> Any:
    """The row c of a body."""
    rotor = rotor_step.constants(moments)
    D = np.zeros(3) if is_ball(moments) else moments - moments.sum() / 3
    return np.concatenate([*(rotor[name] for name in ROTOR), moments, D, [tide, fluid, lag]])


def is_ball(moments: Any) -> bool:
    """Whether moments are equal but for rounding."""
    return bool(np.ptp(moments) <= BALL * np.max(moments))
