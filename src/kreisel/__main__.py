"""`python -m kreisel` is the command `kreisel`."""

from kreisel.cli import main

main()
