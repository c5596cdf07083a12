"""Rows of doubles that kernels work on: their types, and shares of rows or lanes for threads.

There are KREISEL_NUM_THREADS threads, else one for each processor.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
MACHINE_EPSILON = float(np.finfo(np.float64).eps)
LANES = 4  # doubles that kernels for rows take at once
Look = Callable[[], None]
WIDTH = 64  # shares are integer multiples of it
LEAST_WORK = 20_000_000  # operations on lanes, about 1 ms, for each thread: to begin one takes 0.15 to 0.3 ms
Result = TypeVar("Result")


def no_look() -> None:
    """For kernels at work without anybody who may stop them."""


def processors() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """How many threads there are for large work."""
    asked = os.environ.get("KREISEL_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) > 0 else processors()


def threads_for(work: int) -> int:
    """How many threads that many operations are worth."""
    return max(1, min(thread_count(), work // LEAST_WORK))


def shares(count: int, work: int) -> Iterator[tuple[int, int]]:
    """First and last one of the shares of the threads, complete blocks if there are many."""
    threads = threads_for(work)
    size = -(-count // threads)
    if threads > 1 and size > 4 * WIDTH:
        size = -(-size // (4 * WIDTH)) * WIDTH  # four shares a thread: another process may slow one down
    for first in range(0, count, max(size, 1)):
        yield first, min(first + size, count)


def on_threads(count: int, work: int, do: Callable[[int, int], Result]) -> list[Result]:
    """The results of `do(first, last)` for each share, in order; by this thread if there is one share.

    `work`: operations of all of them.
    """
    parts = list(shares(count, work))
    if len(parts) < 2:
        return [do(0, count)]
    with ThreadPoolExecutor(len(parts)) as pool:  # made for each call: none is left behind when a process forks
        return list(pool.map(lambda share: do(*share), parts))
