"""Round-off, in one place: the projection onto the invariants of the start."""
