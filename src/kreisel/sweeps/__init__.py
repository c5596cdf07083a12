"""Ensembles over parameters and initial states."""
