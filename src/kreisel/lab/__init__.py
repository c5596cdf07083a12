"""The laboratory: laws, and the numbers they are tested in."""
