"""What saving costs: `kreisel.bench.saving`, into results/saving.json."""

from __future__ import annotations

from cases import parser, write

from kreisel.bench.saving import TURNS, measure


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    options = parser(__doc__, "saving")
    options.add_argument("--turns", type=int, default=TURNS)
    options.add_argument("--part", type=int, default=1, help="a part of the steps, for a quick look")
    asked = options.parse_args(arguments)
    write(measure(asked.turns, asked.part), asked.output)


if __name__ == "__main__":
    main()
