"""Operations as data: the scalar operations of a definition, kept as a graph that everything else reads."""
