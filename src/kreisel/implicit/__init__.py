"""How the implicit maps of Veselov, Moser, and Suris (2000) are solved: the branch that tends to 1, and n = 3."""
