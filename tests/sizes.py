"""What `make test` leaves to `make test-full`."""

import os

FULL = "KREISEL_FULL" in os.environ
PAPER = ("heavy-top", "lagrange-top", "lagrange-top-moving", "symmetric-top", "kirchhoff", "clebsch", "neumann")
# array code takes a quarter of a minute to compile for each body, seconds for a chain
DENSE = ("clebsch", "lattice-landau-lifshitz", "spin-chain")


def costly(name: str) -> bool:
    """Whether the largest n of this system is of `make test-full`: it is if the system is not of the paper."""
    return not FULL and name not in PAPER


def costly_in_array_code(name: str) -> bool:
    """The same of its kernels in array code."""
    return not FULL and name not in DENSE
