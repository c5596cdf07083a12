"""Ensembles of n = 3 trajectories against C++: `kreisel.bench.ensemble`, into results/ensemble.json."""

from __future__ import annotations

from cases import parser, write

from kreisel.bench.ensemble import STEPS, TURNS, measure


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    options = parser(__doc__, "ensemble")
    options.add_argument("--steps", type=int, default=STEPS)
    options.add_argument("--turns", type=int, default=TURNS)
    asked = options.parse_args(arguments)
    write(measure(asked.turns, asked.steps), asked.output)


if __name__ == "__main__":
    main()
