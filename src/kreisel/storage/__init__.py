"""Archives on disk: written, read, checked, replaced."""
