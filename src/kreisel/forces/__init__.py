"""Perturbed bodies: forces around an integrable motion."""
