"""Where the time of a run goes, for the commands to say: kernels that are loaded or compiled, and steps."""

from __future__ import annotations

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator

SPENT: defaultdict[str, float] = defaultdict(float)  # seconds of this process by what they were spent on


@contextlib.contextmanager
def spent_on(what: str) -> Iterator[None]:
    """Count the seconds of the block."""
    begun = time.perf_counter()
    try:
        yield
    finally:
        SPENT[what] += time.perf_counter() - begun
