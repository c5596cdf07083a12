"""Time of one n = 3 trajectory without saving, against C++: `kreisel.bench.single`, into results/single.json."""

from __future__ import annotations

from cases import parser, write

from kreisel.bench.single import STEPS, TURNS, measure


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    options = parser(__doc__, "single")
    options.add_argument("--steps", type=int, default=STEPS)
    options.add_argument("--turns", type=int, default=TURNS)
    asked = options.parse_args(arguments)
    write(measure(asked.steps, asked.turns), asked.output)


if __name__ == "__main__":
    main()
