"""Figures, the interactive page, and records for the eye."""
