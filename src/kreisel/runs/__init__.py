"""Runs: settings, plans, the rows that an engine fills, their description, drift and geometry."""
