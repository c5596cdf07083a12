"""Motions in closed form, n = 3, and pairs of maps that are a flow, in compiled code."""
