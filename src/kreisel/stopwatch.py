"""Times of a run, for the commands to report: loading or compilation of kernels, and steps."""

from __future__ import annotations

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator

SPENT: defaultdict[str, float] = defaultdict(float)  # seconds of this process by their use


@contextlib.contextmanager
def spent_on(what: str) -> Iterator[None]:
    """Count the seconds of the block."""
    begun = time.perf_counter()
    try:
        yield
    finally:
        SPENT[what] += time.perf_counter() - begun
