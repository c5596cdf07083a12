"""What `make test` leaves to `make test-full`."""

import os

FULL = "KREISEL_FULL" in os.environ
PAPER = ("heavy-top", "lagrange-top", "lagrange-top-moving", "symmetric-top", "kirchhoff", "clebsch", "neumann")


def costly(name: str) -> bool:
    """Whether the largest n of this system is of `make test-full`: it is if the system is not of the paper."""
    return not FULL and name not in PAPER
