"""Shares of lanes, or of rows, for threads: as many as Numba has (NUMBA_NUM_THREADS)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

WIDTH = 64  # shares are whole multiples of it
LEAST_WORK = 50_000  # lane-steps below which threads cost more than they give
Result = TypeVar("Result")


def shares(count: int, work: int) -> Iterator[tuple[int, int]]:
    """First and last one of the shares of the threads, whole blocks where there are many."""
    threads = numba.config.NUMBA_NUM_THREADS if work >= LEAST_WORK else 1  # type: ignore[attr-defined]
    size = -(-count // threads)
    if threads > 1 and size > 4 * WIDTH:
        size = -(-size // (4 * WIDTH)) * WIDTH  # four shares a thread: another process may slow one down
    for first in range(0, count, max(size, 1)):
        yield first, min(first + size, count)


def on_threads(count: int, work: int, do: Callable[[int, int], Result]) -> list[Result]:
    """What `do(first, last)` gives for each share, in order; by this thread where there is one share."""
    parts = list(shares(count, work))
    if len(parts) < 2:
        return [do(0, count)]
    with ThreadPoolExecutor(len(parts)) as pool:  # made for each call: none is left behind when a process forks
        return list(pool.map(lambda part: do(*part), parts))
