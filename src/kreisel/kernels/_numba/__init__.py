"""Operations of array code that Numba compiles: the only door to its inside."""
