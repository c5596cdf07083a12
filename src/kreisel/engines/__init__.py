"""Engines: what runs a scheme."""
