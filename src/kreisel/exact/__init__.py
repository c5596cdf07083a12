"""Closed forms in time, in extended digits."""
