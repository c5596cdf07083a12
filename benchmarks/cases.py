"""Cases of the measurements, and the folder of the results."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import kreisel as kr
from kreisel.bench import SEEDS, BenchCase, cases, machine, unit

RESULTS = Path(__file__).parent / "results"

__all__ = ["RESULTS", "SEEDS", "BenchCase", "cases", "machine", "parser", "steps_of", "unit", "write"]


def steps_of(model: Any, state: Mapping[str, Any], **options: Any) -> Callable[[int], Any]:
    """The state after a number of steps, as a user calls it: `steps` of a `kr.propagator` with these options."""
    propagator, start = kr.propagator(model, **options), model.state(**state)
    return lambda steps: propagator.steps(start, steps)


def parser(doc: str | None, name: str) -> argparse.ArgumentParser:
    """The options of a script, with --output results/NAME.json."""
    options = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--output", type=Path, default=RESULTS / f"{name}.json")
    return options


def write(result: Mapping[str, Any], output: Path) -> None:
    """The result as JSON."""
    output.parent.mkdir(exist_ok=True)
    output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"\nWritten: {output}")
