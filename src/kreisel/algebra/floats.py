"""Real numbers of any origin as an array of doubles."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np

from kreisel.algebra.backend import Array


def floats(value: Any) -> Array:
    """Doubles (...) of real numbers: lists, arrays of NumPy, xarray or JAX, fractions; a copy unless they are doubles.

    NaN, without axes, for everything else: text, dates, complex and truth values, ragged lists, numbers beyond the
    range of doubles, and numbers whose meaning would be lost: masked entries, quantities with units.
    """
    if loses(value):
        return np.asarray(np.nan)
    try:
        array = np.asarray(value)
        real = array.dtype.kind in "iuf" or (array.dtype == object and all(map(_is_real, array.flat)))
        if real:
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    return np.asarray(np.nan)


def is_number(value: Any) -> bool:
    """Whether one value is a number of any kind that may be real: a fraction, a symbol, a number that records."""
    if isinstance(value, type | timedelta | complex | str | np.generic):
        return isinstance(value, np.generic) and value.dtype.kind in "iuf"
    return hasattr(value, "__mul__") and hasattr(value, "__truediv__")


def _is_real(value: Any) -> bool:
    return is_number(value) and hasattr(value, "__float__")


def loses(value: Any) -> bool:
    """True if an array of the value would lose its masks or its units; lists are searched one level deep."""
    if isinstance(value, list | tuple):
        return any(loses(v) for v in value if not isinstance(v, list | tuple | float | int))
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    return hasattr(value, "magnitude") or (isinstance(value, np.ndarray) and hasattr(value, "unit"))
