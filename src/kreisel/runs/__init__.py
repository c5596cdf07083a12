"""Runs: plans, simulation, archives, drift."""
