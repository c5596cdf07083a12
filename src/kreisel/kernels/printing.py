"""Straight-line records made ready to print: what a compiler may do or leave is decided here, once.

Kernels are compiled without leave to fuse or to reorder, so all that are made from one step, for one trajectory, for
an ensemble or with some parameters folded in, give the same bits.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection
from functools import lru_cache
from typing import NamedTuple

CYCLES, AT_ONCE = 4, 2  # of an operation, and how many begin in one; a quotient of 13 makes no step faster
KEPT = 32  # records whose arrangement is remembered: the same step is recorded for every run of it


class Line(NamedTuple):
    """`names` = what the source `text` computes from `needs`; a loop computes several."""

    names: tuple[str, ...]
    text: str
    needs: tuple[str, ...]


def needed(lines: list[Line], outputs: list[str]) -> list[Line]:
    """Those lines that the outputs depend on."""
    wanted, kept = set(outputs), []
    for line in reversed(lines):
        if not wanted.isdisjoint(line.names):
            wanted.update(line.needs)
            kept.append(line)
    return kept[::-1]


def operation(line: Line) -> tuple[str, str, str]:
    """(x, operator, y) of a line `name = x operator y`, else ("", "", "")."""
    words = line.text.partition(" = ")[2].split(" ")
    return (words[0], words[1], words[2]) if len(words) == 3 and words[1] in ("+", "-", "*", "/") else ("", "", "")


def arranged(lines: list[Line], outputs: list[str]) -> list[Line]:
    """Fused sums and shared reciprocals.

    A product that one sum alone needs is fused into it.  Several quotients by one number take its reciprocal.
    """
    return list(_arranged(tuple(lines), tuple(outputs)))


@lru_cache(KEPT)
def _arranged(lines: tuple[Line, ...], outputs: tuple[str, ...]) -> tuple[Line, ...]:
    lines = _with_reciprocals(lines)
    uses = Counter(n for line in lines for n in line.needs) + Counter(outputs)
    products = {line.names[0]: line for line in lines if operation(line)[1] == "*" and uses[line.names[0]] == 1}
    out, gone = [], set()
    for line in lines:
        x, operator, y = operation(line)
        name = line.names[0]
        inner = next((v for v in (x, y) if operator in ("+", "-") and v in products), None)
        if inner is None:
            out.append(line)
            continue
        p, _, q = operation(products[inner])
        other = y if inner == x else x
        signs = ("", "-") if inner == x else ("-", "")
        first, last = signs if operator == "-" else ("", "")
        needs = (*products[inner].needs, *(n for n in line.needs if n != inner))
        out.append(Line((name,), f"{name} = fma({first}{p}, {q}, {last}{other})", needs))
        gone.add(inner)
    return tuple(line for line in out if line.names[0] not in gone)


def _with_reciprocals(lines: tuple[Line, ...]) -> tuple[Line, ...]:
    quotients = [operation(line) for line in lines]
    shared = {y for y, count in Counter(y for _, o, y in quotients if o == "/").items() if count > 1 and y[0].isalpha()}
    out, made = [], set()
    for line, (x, operator, y) in zip(lines, quotients, strict=True):
        if operator != "/" or y not in shared:
            out.append(line)
            continue
        if y not in made:
            out.append(Line((f"r{y}",), f"r{y} = 1.0 / {y}", (y,)))
            made.add(y)
        name, needs = line.names[0], (*(n for n in line.needs if n == x), f"r{y}")
        out.append(Line((name,), f"{name} = r{y}" if x == "1.0" else f"{name} = {x} * r{y}", needs))
    return tuple(out)


def latest(lines: list[Line]) -> list[Line]:
    """The lines in the order in which a processor that does `AT_ONCE` of them at a time would begin them at the latest.

    Compilers keep near to it.  What waits longest comes first, and no result lies about long before it is needed: two
    steps on numbers of their own, one after the other, then overlap in the processor.
    """
    makes = {name: i for i, line in enumerate(lines) for name in line.names}
    needs = [[makes[n] for n in dict.fromkeys(line.needs) if n in makes] for line in lines]
    before, users = [0] * len(lines), [0] * len(lines)
    for i, own in enumerate(needs):
        before[i] = 1 + max((before[j] for j in own), default=0)
        for j in own:
            users[j] += 1
    after = [CYCLES] * len(lines)  # from the beginning of a line to the end of the step, backwards
    waiting = [(CYCLES, i) for i in range(len(lines)) if not users[i]]
    heapq.heapify(waiting)
    ready: list[tuple[int, int]] = []
    order: list[int] = []
    time = 0
    while waiting or ready:
        while waiting and waiting[0][0] <= time:
            _, i = heapq.heappop(waiting)
            heapq.heappush(ready, (-before[i], -i))
        for _ in range(min(AT_ONCE, len(ready))):
            i = -heapq.heappop(ready)[1]
            order.append(i)
            for j in needs[i]:
                after[j] = max(after[j], time + CYCLES)
                users[j] -= 1
                if not users[j]:
                    heapq.heappush(waiting, (after[j], j))
        time = time + 1 if ready or not waiting else max(time + 1, waiting[0][0])
    return [lines[i] for i in reversed(order)]


def split(lines: list[Line], known: Collection[str]) -> tuple[list[Line], list[Line]]:
    """The lines that need nothing but `known` names, and the others."""
    names, fixed, rest = set(known), [], []
    for line in lines:
        if names.issuperset(line.needs) and "\n" not in line.text:
            fixed.append(line)
            names.update(line.names)
        else:
            rest.append(line)
    return fixed, rest
