"""Array code of vectors, entry by entry: operations on vectors that need no other place become one loop.

An array of its own for each operation costs an allocation, 0.1 us, and Numba a loop to compile.  A chain of 23 spins: a
step of the midpoint method 87 us as it was, 5 us in loops.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from kreisel.kernels.printing import Line

CALL = re.compile(r"(\w+)\((.*)\)")
ENTRYWISE = {"add": "{} + {}", "subtract": "{} - {}", "multiply": "{} * {}", "divide": "{} / {}", "power": "{}**{}"}
ENTRYWISE |= {"root": "sqrt({})", "negative": "-{}"}
SHIFTED = "shifted"

Shapes = Mapping[str, tuple[int, ...]]


def fused(lines: list[Line], outputs: Collection[str], shapes: Shapes) -> list[Line]:
    """The same lines, neighbours on vectors of one length in one loop; `shapes` of the real arrays among the names."""
    out: list[Line] = []
    group: list[Line] = []

    def close() -> None:
        if group:
            elsewhere = {name for line in lines if line not in group for name in line.needs} | set(outputs)
            out.append(_loop(group, [line.names[0] for line in group if line.names[0] in elsewhere], shapes))
            group.clear()

    for line in lines:
        length, inside = _length(line, shapes), {member.names[0] for member in group}
        by_itself = length is None or line.text.partition(" = ")[2].startswith(SHIFTED)
        other = group and length not in (None, _length(group[0], shapes))
        if other or (by_itself and not inside.isdisjoint(line.needs)):
            close()
        (out if length is None else group).append(line)
    close()
    return out


def _length(line: Line, shapes: Shapes) -> int | None:
    """Of the vectors that a line works on entry by entry; None where it does something else."""
    call = CALL.fullmatch(line.text.partition(" = ")[2])
    if len(line.names) > 1 or call is None or call[1] not in (*ENTRYWISE, SHIFTED):
        return None
    shape = shapes.get(line.names[0], ())
    return shape[0] if len(shape) == 1 and shape[0] > 1 and all(name in shapes for name in line.needs) else None


def _loop(group: list[Line], kept: list[str], shapes: Shapes) -> Line:
    """The loop that computes the vectors `kept`, and whatever they need, an entry at a time."""
    made = {line.names[0] for line in group}
    needs = tuple(dict.fromkeys(name for line in group for name in line.needs if name not in made))
    n = shapes[group[0].names[0]][0]
    before, body = [f"{name} = empty({n})" for name in kept], []
    entry = {name: f"{name}_i" for name in made}
    for name in needs:
        if shapes[name] == (1,):
            before.append(f"{name}_i = {name}[0]")
        if shapes[name]:
            entry[name] = f"{name}_i"
    for line in group:
        call = CALL.fullmatch(line.text.partition(" = ")[2])
        assert call is not None
        operands = call[2].split(", ")
        if call[1] == SHIFTED:
            k = int(operands[1])
            wrapped = f"i + {k} if i < {n - k} else i - {n - k}" if k > 0 else f"i - {-k} if i >= {-k} else i + {n + k}"
            body.append(f"{line.names[0]}_i = {operands[0]}[{wrapped}]")
        else:
            text = ENTRYWISE[call[1]].format(*(entry.get(x, x) for x in operands))
            body.append(f"{line.names[0]}_i = {text}")
    used = "\n".join(body)
    loads = [f"{name}_i = {name}[i]" for name in needs if shapes[name] == (n,) and re.search(rf"\b{name}_i\b", used)]
    body = [*loads, *body, *(f"{name}[i] = {name}_i" for name in kept)]
    text = "\n".join([*before, f"for i in range({n}):", *(f"    {line}" for line in body)])
    return Line(tuple(kept), text, needs)
