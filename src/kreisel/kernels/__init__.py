"""Engines of a scheme: kernels from the graphs of its functions, the loops around them, JAX and SciPy."""
