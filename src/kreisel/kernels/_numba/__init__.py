"""Types and operations of compiled code: the only door to the inside of Numba."""
