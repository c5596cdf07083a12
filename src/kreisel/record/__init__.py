"""Claims of a system about itself."""
