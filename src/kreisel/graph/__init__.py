"""Operations as data: what a definition does on scalars, kept as a graph that everything else reads."""
