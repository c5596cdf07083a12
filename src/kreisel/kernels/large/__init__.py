"""Kernels of O(n) and O(n^2) a step, for large n."""
