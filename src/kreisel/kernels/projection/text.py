"""The text of the projection for GPUs and other languages: `BLOCK` goes through any program."""

from __future__ import annotations

import numpy as np

from kreisel.graph.invariants import Program

BLOCK = """
{inline}
def put_pair(room, high, low, p, e):
    put(room, high, p)
    put(room, low, e)


{compiled}
def block(sizes, ops, runs, outs, ends, cones, columns, literals, targets, worst, z, c, room, lane, last, begin):
    d, k, lanes, constants, used, known, length, many, free = sizes
    base = d + used + known
    count = base + length
    S = 2 * count
    J = S + count
    G = J + k * d
    R = G + k * k
    T = R + k  # of each invariant the four numbers of `targets` and `worst`
    for w in range({width}):
        at = min(lane + w, last - 1)
        if not begin:
            for j in range(k):
                for i in range(4):
                    set_entry(room, T + 5 * j + i, w, number(targets, 4 * (at * k + j) + i))
                set_entry(room, T + 5 * j + 4, w, number(worst, at * k + j))
        for i in range(d):
            set_entry(room, i, w, number(z, {z}))
        for i in range(used):
            j = whole(columns, i)
            set_entry(room, d + i, w, number(c, {c}))
        for i in range(known):
            set_entry(room, d + used + i, w, number(literals, i))
    nothing = get(room, d + used)
    for i in range(count, count + base):
        put(room, i, nothing)
    i = 0
    for run in range(many):
        what, end = whole(runs, 2 * run), whole(runs, 2 * run + 1)
        if what == 2:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = times(a, b)
                put_pair(room, o, count + o, p, fma(a, lb, fma(la, b, fma(a, b, -p))))
                i += 1
        elif what == 0:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = a + b
                t = p - a
                put_pair(room, o, count + o, p, ((a - (p - t)) + (b - t)) + (la + lb))
                i += 1
        elif what == 1:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = a - b
                t = p - a
                put_pair(room, o, count + o, p, ((a - (p - t)) - (b + t)) + (la - lb))
                i += 1
        elif what == 3:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                r = 1.0 / b
                p = times(a, r)
                put_pair(room, o, count + o, p, times(fma(-p, b, a) + fma(-p, lb, la), r))
                put(room, whole(ops, 4 * i + 2), r)
                put(room, whole(ops, 4 * i + 3), -times(p, r))
                i += 1
        else:
            while i < end:
                o, x = base + i, whole(ops, 4 * i)
                a, la = get(room, x), get(room, count + x)
                p = sqrt(a)
                r = 0.5 / p
                put_pair(room, o, count + o, p, times(fma(-p, p, a) + la, r))
                put(room, whole(ops, 4 * i + 2), r)
                i += 1
    if begin:
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                set_number(targets, 4 * (at * k + j), entry(room, whole(outs, j), w))
                set_number(targets, 4 * (at * k + j) + 1, entry(room, count + whole(outs, j), w))
        for i in range(base):
            put(room, i, size(get(room, i)))
        i = 0
        for run in range(many):  # the terms of each sum, all with one sign
            what, end = whole(runs, 2 * run), whole(runs, 2 * run + 1)
            while i < end:
                a, b, o = get(room, whole(ops, 4 * i)), get(room, whole(ops, 4 * i + 1)), base + i
                if what == 2:
                    put(room, o, times(a, b))
                elif what < 2:
                    put(room, o, a + b)
                elif what == 3:
                    put(room, o, a / b)
                else:
                    put(room, o, sqrt(a))
                i += 1
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                set_number(targets, 4 * (at * k + j) + 2, entry(room, whole(outs, j), w))
        return
    for i in range(S, S + count):
        put(room, i, nothing)
    one = get(room, d + used + 1)
    start = 0
    for j in range(k):
        put(room, S + whole(outs, j), one)
        for n in range(start, whole(ends, j)):
            i = whole(cones, n)
            o, x, y = S + base + i, S + whole(ops, 4 * i), S + whole(ops, 4 * i + 1)
            g = get(room, o)
            put(room, o, nothing)
            put(room, x, fma(g, get(room, whole(ops, 4 * i + 2)), get(room, x)))
            put(room, y, fma(g, get(room, whole(ops, 4 * i + 3)), get(room, y)))
        start = whole(ends, j)
        for i in range(d):
            put(room, J + j * d + i, get(room, S + i) if i >= free else nothing)
            put(room, S + i, nothing)
    total = nothing
    for i in range(d):
        total = fma(get(room, i), get(room, i), total)
    unit = 1.0 / sqrt(total)
    for j in range(k):
        total = nothing
        for i in range(d):
            total = fma(get(room, J + j * d + i), get(room, J + j * d + i), total)
        flat = times(get(room, T + 5 * j + 2), times(unit, FLAT))
        total = sqrt(fma(flat, flat, total))
        scale = where_less(nothing, total, 1.0 / total, nothing)
        scale = where_less(total, HUGE, scale, nothing)  # of what is not finite here too
        for i in range(d):
            put(room, J + j * d + i, where_less(nothing, scale, times(scale, get(room, J + j * d + i)), nothing))
        lack = get(room, whole(outs, j)) - get(room, T + 5 * j)
        lack = lack + (get(room, count + whole(outs, j)) - get(room, T + 5 * j + 1))
        lack = where_less(size(lack), HUGE, lack, nothing)
        lead = get(room, T + 5 * j + 3)
        lead = fma(GAIN, fma(0.5, lack + lead, -lead), lead)
        distance = times(scale, times(unit, 1.0 / EPS))
        farthest = max(get(room, T + 5 * j + 4), times(size(lack), distance))
        lead = where_less(farthest, times(size(lead), distance), nothing, lead)
        if free > 0:  # what binds an orientation has no frequency
            lead = nothing
        put(room, T + 5 * j + 3, lead)
        put(room, T + 5 * j + 4, farthest)
        put(room, R + j, times(lack + lead, scale))
    for j in range(k):
        for q in range(j, k):
            total = nothing
            for i in range(d):
                total = fma(get(room, J + j * d + i), get(room, J + q * d + i), total)
            put(room, G + j * k + q, total + TAU if q == j else total)
    for j in range(k):
        pivot = 1.0 / get(room, G + j * k + j)
        for q in range(j + 1, k):
            f = -times(get(room, G + j * k + q), pivot)
            for i in range(q, k):
                put(room, G + q * k + i, fma(f, get(room, G + j * k + i), get(room, G + q * k + i)))
            put(room, R + q, fma(f, get(room, R + j), get(room, R + q)))
        put(room, G + j * k + j, pivot)
    for j in range(k - 1, -1, -1):
        total = get(room, R + j)
        for q in range(j + 1, k):
            total = fma(-get(room, G + j * k + q), get(room, R + q), total)
        put(room, R + j, times(total, get(room, G + j * k + j)))
    for i in range(d):
        total = get(room, i)
        for j in range(k):
            total = fma(-get(room, J + j * d + i), get(room, R + j), total)
        put(room, i, total)
    for w in range(min({width}, last - lane)):
        at = lane + w
        for i in range(d):
            set_number(z, {z}, entry(room, i, w))
        for j in range(k):
            set_number(targets, 4 * (at * k + j) + 3, entry(room, T + 5 * j + 3, w))
            set_number(worst, at * k + j, entry(room, T + 5 * j + 4, w))
"""


def projection_block(inline: str, compiled: str, z: str, c: str, width: int) -> str:
    """The text of the projection of `width` states, by decorators, and by where the numbers i of z and j of c stand."""
    return BLOCK.format(inline=inline, compiled=compiled, z=z, c=c, width=width)


def block_sizes(program: Program, lanes: int, constants: int) -> tuple[int, ...]:
    """Sizes that the text looks at, and `Program.first`."""
    used, literals = len(program.columns), len(program.literals)
    counts = len(program.ops), len(program.runs), program.first
    return program.size, len(program.outs), lanes, constants, used, literals, *counts


def block_arrays(program: Program) -> tuple[np.ndarray, ...]:
    """All numbers of a program, as the text has them."""
    runs, ends = program.runs[:, [0, 2]], program.ends[1:]
    integers = program.ops, runs, program.outs, ends, program.cones, program.columns
    return *(array.astype(np.int32) for array in integers), program.literals
