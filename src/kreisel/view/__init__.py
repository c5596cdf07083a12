"""Figures and records for the eye."""
