"""What `make test` leaves to `make test-full`."""

import os

FULL = "KREISEL_FULL" in os.environ
DENSE = ("lagrange-top-moving", "clebsch", "neumann")  # array code takes a quarter of a minute to compile for each


def costly(name: str) -> bool:
    """Whether the largest n of this system, in array code, is of `make test-full`."""
    return not FULL and name not in DENSE
