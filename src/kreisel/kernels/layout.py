"""Types and constants of the rows of doubles that kernels work on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
MACHINE_EPSILON = float(np.finfo(np.float64).eps)
LANES = 4  # doubles that kernels for rows take at once
Look = Callable[[], None]


def no_look() -> None:
    """For kernels at work without anybody who may stop them."""
