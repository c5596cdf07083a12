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
from kreisel.kernels.cpu import EXACT, HEAD, load_kernel
from kreisel.kernels.recording import indented, recorded_function
from kreisel.rebound import interaction

ROTOR = {"inverse": (3,), "rates": (3,), "gaps": (3,), "curvatures": (3,)}
FIGURE = {"I": (3,), "D": (3,), "tide": (), "fluid": (), "lag": ()}
COLUMNS, OF_FIGURE, LAG = 21, 12, 20
BALL = 1e-12  # of the moments: what rounding may make of a ball
MOST_PARTS = 100_000  # of a turn: a step in which a body turns so often is no step

ROWS = "f8[:,::1], f8[::1], i8[::1], f8[:,::1], f8[:,::1], f8[:,::1]"  # p, masses, index, z, c, dv

FUNCTION = """
@njit(error_model="numpy", forceinline=True)
def {name}(w, c, out):
{load}
{body}
{save}

"""

KERNELS = """
@njit(error_model="numpy", forceinline=True)
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


@njit(error_model="numpy", forceinline=True)
def act(p, masses, z, c, dv, i, j, body, h, G, lagging, w, out):
    for k in range(3):
        w[k] = p[j, k] - p[i, k]
    if lagging:
        for k in range(3):
            w[3 + k] = p[j, 3 + k] - p[i, 3 + k]
        for k in range(7):
            w[6 + k] = z[body, k]
        w[13], w[14], w[15], w[16] = h, masses[j], p[i, 9], G
        friction(w, c[body, {figure}:], out)
    else:
        for k in range(7):
            w[3 + k] = z[body, k]
        w[10], w[11], w[12] = h, masses[j], G
        kick(w, c[body, {figure}:], out)
    apply(p, masses, z, dv, i, j, body, w, out)


@njit("void({rows}, f8, f8, b1)", {options})
def act_on_all(p, masses, index, z, c, dv, h, G, backwards):
    w, out = np.empty(17), np.empty(3)
    dv[:] = 0.0
    pairs = len(index) * len(masses)
    for number in range(pairs):
        k = pairs - 1 - number if backwards else number
        body, j = k // len(masses), k % len(masses)
        i, lagging = index[body], c[body, {lag}] != 0.0
        if i != j:
            if lagging and backwards == False:
                act(p, masses, z, c, dv, i, j, body, h, G, True, w, out)
            act(p, masses, z, c, dv, i, j, body, h, G, False, w, out)
            if lagging and backwards:
                act(p, masses, z, c, dv, i, j, body, h, G, True, w, out)


@njit("i8(f8[:,::1], f8[:,::1], f8)", {options})
def turn_all(z, c, h):
    w, out, most = np.empty(8), np.empty(4), 0
    for body in range(len(z)):
        for k in range(7):
            w[k] = z[body, k]
        w[7] = h
        reach(w, c[body], out)
        parts = 1.0 + 2.0 * sqrt(out[0])  # turns by up to 4 radians
        if not parts < {most}:
            return -1
        w[7] = h / int(parts)
        ball = c[body, {figure} + 3] == 0.0 and c[body, {figure} + 4] == 0.0
        for _ in range(int(parts)):
            if ball:
                turn_of_ball(w, c[body, {figure}:], out)
            else:
                turn(w, c[body], out)
            w[3:7] = out
        z[body, 3:] = out
    return 0


@njit("void(f8[:,::1], f8[::1], f8[:,::1])", {options})
def change_jacobi(q, masses, dv):
    for k in range(3):
        momentum, mass = masses[0] * dv[0, k], masses[0]
        for i in range(1, len(q)):
            q[i, 3 + k] += dv[i, k] - momentum / mass
            momentum += masses[i] * dv[i, k]
            mass += masses[i]


@njit("i8({rows}, f8, f8, f8[:,::1], i8, i8, i8[::1], u4[::1], i4[::1], i8)", {options})
def advance(p, masses, index, z, c, dv, h, G, q, step, simulation, counts, modified, status, steps):
    count = counts[0]
    for k in range(steps):
        act_on_all(p, masses, index, z, c, dv, h / 2, G, False)
        change_jacobi(q, masses, dv)
        if turn_all(z, c, h) < 0:
            return -1 - k
        if len(q) == 0:
            modified[0] = 1
        call_at_address(step, (simulation, 1))
        if counts[0] != count or status[0] > 0:
            return k + 1
        act_on_all(p, masses, index, z, c, dv, h / 2, G, True)
        change_jacobi(q, masses, dv)
    return steps
"""


@cache
def kernels() -> ModuleType:
    """`act_on_all`, `turn_all` and `advance`, compiled once for this machine."""
    return load_kernel(source(), by_numba=True)


def source() -> str:
    """Their text."""
    L, g, one = (3,), (4,), ()
    texts = [
        _function(interaction.kick, {"r": L, "L": L, "g": g, "h": one, "m": one, "G": one}, FIGURE, ("lag",)),
        _function(
            interaction.friction,
            {"r": L, "v": L, "L": L, "g": g, "h": one, "m": one, "own": one, "G": one},
            FIGURE,
            ("D", "fluid"),
        ),
        _function(interaction.turn, {"L": L, "g": g, "h": one}, ROTOR),
        _function(interaction.turn_of_ball, {"L": L, "g": g, "h": one}, {"I": (3,)}),
        _function(interaction.reach, {"L": L, "g": g, "h": one}, ROTOR),
    ]
    head = HEAD.format(name="bodies of a REBOUND simulation")
    head += "from kreisel.kernels._numba.pointers import call_at_address\n\n"
    text = KERNELS.format(rows=ROWS, options=EXACT, figure=OF_FIGURE, lag=LAG, most=MOST_PARTS)
    return head + "".join(texts) + text


def _function(
    function: Callable[..., Any],
    inputs: Mapping[str, tuple[int, ...]],
    constants: Mapping[str, tuple[int, ...]],
    without: tuple[str, ...] = (),
) -> str:
    """A function of arrays as one of rows w and c, which writes the row `out`."""

    def called(**given: Any) -> list[Any]:
        return list(function(**{name: value for name, value in given.items() if name not in without}))

    lines, values, _ = recorded_function(called, inputs, constants)
    used = {name for line in lines for name in line.needs} | {value.strip("(-)") for value in values}
    rows = {"z": "w", "c": "c"}
    load = sorted(f"{n} = {rows[n[0]]}[{n[1:]}]" for n in used if n[0] in rows and n[1:].isdigit())
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
