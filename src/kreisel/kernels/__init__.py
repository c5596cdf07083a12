"""Engines of a scheme: its functions recorded, printed, and compiled."""
