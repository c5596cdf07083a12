"""Cases of the measurements, and the folder of the results."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kreisel.bench import SEEDS, BenchCase, cases, machine, unit

RESULTS = Path(__file__).parent / "results"

__all__ = ["RESULTS", "SEEDS", "BenchCase", "cases", "machine", "parser", "unit", "write"]


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
