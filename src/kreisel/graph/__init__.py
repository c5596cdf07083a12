"""Operations as data: what a definition does on numbers, kept as a graph that everything else reads."""
