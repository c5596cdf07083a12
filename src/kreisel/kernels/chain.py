"""Kernels on fixed memory, called one after the other by one call from Python, which needs as long as each of them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import numpy as np

from kreisel.graph.llvm import INDEX, Function, Memory, kind_of
from kreisel.graph.machine import Kernel, address_of, kernel, register_width
from kreisel.kernels.layout import Floats

Link = tuple[Kernel, tuple[Any, ...]]  # a kernel and its arguments: integers, and arrays for their addresses


MANY = 100  # entries that are summed as vectors


class Chain:
    """Calls of kernels, and the sum of the entries of some arrays after them, which is finite only if they are.

    call     the calls; then `total.value` is the sum
    long     the calls, while other threads run
    """

    def __init__(self, links: Sequence[Link], summed: Sequence[Floats]):
        self._held, self.total = (links, summed), ctypes.c_double()  # the arrays live as long as the calls
        calls = [
            (code.address, *(x if type(x) is int else address_of(x) for x in arguments)) for code, arguments in links
        ]
        words = [*sum(calls, ()), *(word for x in summed for word in (address_of(x), x.size))]
        self._words, counts = np.array([*words, ctypes.addressof(self.total)]), [len(words) for words in calls]

        def write(f: Function) -> None:
            place, memory, total = 0, f.integers(f.arguments[0]), f.variables(1)[0]
            for count in counts:
                f.call(*memory.get(count, place))
                place += count
            total[0] = 0.0
            for at in range(place, place + 2 * len(summed), 2):
                numbers, size, blocks = f.doubles(memory[at]), memory[at + 1], f.integer(0)
                if width:
                    blocks = size // width
                    total[0] = f.builder.fadd(total[0], _sum(f, numbers, blocks, width))
                with f.loop(blocks * width, size) as i:
                    total[0] = f.builder.fadd(total[0], numbers[i])
            f.doubles(memory[place + 2 * len(summed)])[0] = total[0]

        # additions of four registers do not wait for each other
        width = 4 * register_width() * any(x.size > MANY for x in summed)
        self._kernel = kernel(("chain", counts, len(summed), width), 1, write)

        def called(kind: Any) -> Any:
            call = kind(None)(self._kernel.address)  # of types that are not checked
            call.kernel = self._kernel  # the code lives as long as the call
            return partial(call, ctypes.c_int64(address_of(self._words)))

        # a short call keeps Python's lock, since to release it takes as long as some steps
        self.call, self.long = called(ctypes.PYFUNCTYPE), called(ctypes.CFUNCTYPE)

    def __call__(self, long: bool = False) -> float:
        """The sum after the calls."""
        (self.long if long else self.call)()
        return self.total.value

    def argument(self, link: int, place: int) -> Any:
        """The memory (1,) of an integer argument of a link, which may be changed."""
        before = sum(1 + len(arguments) for _, arguments in self._held[0][:link])
        return self._words[before + 1 + place :][:1]


def _sum(f: Function, numbers: Memory, blocks: Any, width: int) -> Any:
    """The sum of vectors of numbers, and of the entries of that."""
    total = f.variables(1, kind_of(width))[0]
    total[0] = 0.0
    with f.loop(0, blocks) as block:
        total[0] = f.builder.fadd(total[0], numbers.beyond(block * width).of(kind_of(width))[0])
    return reduce(f.builder.fadd, (f.builder.extract_element(total[0], INDEX(k)) for k in range(width)))
