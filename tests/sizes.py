"""What `make test` leaves to `make test-full`."""

import os
from typing import Any

import pytest

FULL = "KREISEL_FULL" in os.environ
PAPER = ("heavy-top", "lagrange-top", "lagrange-top-moving", "symmetric-top", "kirchhoff", "clebsch", "neumann")


def costly(name: str) -> bool:
    """Whether the largest n of this system is of `make test-full`: it is if the system is not of the paper."""
    return not FULL and name not in PAPER


def full(*values: Any) -> list[Any]:
    """Values of a parameter, or tuples of values of several, that are cases of `make test-full`."""
    mark = pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
    return [pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=mark) for value in values]
