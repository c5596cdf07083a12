"""The result of a trial as a table, in the terminal and on the page of promises."""

from __future__ import annotations

from typing import Any

BEGINS, ENDS = "<!-- the trial -->\n", "<!-- that was the trial -->\n"
WORDS = {
    "kills": "runs and sweeps killed, at named moments and at random ones; opened, checked, drawn, resumed, every byte "
    "compared",
    "clusters": "sweeps on worker processes and on a separate scheduler; client, worker or scheduler killed",
    "modes": "archives of which a file or folder may not be read or written",
    "corruptions": "archives damaged once, in {ways} ways; checked, opened, read",
    "configurations": "configurations and commands from a grammar, through the command line",
    "calls": "calls of the Python API from a grammar",
}


def text(parts: dict[str, Any]) -> str:
    """A line for each part."""
    lines = [f"{'part':<16}{'asked':>8}{'done':>8}{'hold':>8}{'do not':>8}{'seconds':>9}"]
    for name, part in parts.items():
        numbers = (part["asked"], part["done"], part["done"] - part["do_not_hold"], part["do_not_hold"])
        lines.append(f"{name:<16}" + "".join(f"{n:>8}" for n in numbers) + f"{part['seconds']:>9.0f}")
    return "\n".join(lines)


def page(result: dict[str, Any]) -> str:
    """The part of the page of promises, between its two marks."""
    lines = ["| what | done | do not hold |", "|---|---|---|"]
    for name, part in result["parts"].items():
        words = WORDS[name].format(ways=len(part["outcomes"]))
        lines.append(f"| {name}: {words} | {part['done']:,} | {part['do_not_hold']} |")
    versions = ", ".join(f"{name} {result['versions'][name]}" for name in ("python", "numpy", "zarr"))
    lines += ["", f"{result['date'][:10]}, {result['machine']['processor']}, {result['workers']} processes,"]
    lines += [f"{result['seconds'] / 60:.0f} minutes, seed {result['seed']}; {versions}. In {result['place']}."]
    return "\n".join(lines) + "\n"


def entered(text: str, result: dict[str, Any]) -> str:
    """The page with this result between its marks."""
    before, rest = text.split(BEGINS)
    return before + BEGINS + page(result) + ENDS + rest.split(ENDS)[1]
