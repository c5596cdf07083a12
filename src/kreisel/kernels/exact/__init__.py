"""The closed form of the Lagrange top, n = 3, in compiled code."""
