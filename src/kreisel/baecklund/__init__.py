"""Bäcklund transformations: points of the spectral curve, eigenvectors there, maps, and pairs in real arithmetic."""
