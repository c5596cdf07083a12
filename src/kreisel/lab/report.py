"""The page of an investigation, for the terminal and as one HTML file."""

from __future__ import annotations

import io
import math
import os
from html import escape
from typing import TYPE_CHECKING, Any

from kreisel.files import place, written

if TYPE_CHECKING:
    from kreisel.lab.investigation import Investigation

STYLE = """
:root { color-scheme: light dark; --ink: #111; --paper: #fff; --line: #d8d8d8; --faint: #666; --accent: #0072B2; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #f0f0f0; --paper: #16181d; --line: #3a3e46; --faint: #a5aab3; --accent: #56B4E9; } }
body { margin: 2rem auto; max-width: 62rem; padding: 0 1rem; font: 15px/1.5 system-ui, sans-serif;
  color: var(--ink); background: var(--paper); }
h1 { font-size: 1.3rem; margin: 0; }
.about, figcaption { color: var(--faint); font-size: .9rem; overflow-wrap: anywhere; }
.verdict { font-size: 1.15rem; font-weight: 600; margin: 1.2rem 0 0; }
table { border-collapse: collapse; width: 100%; margin: 1.2rem 0; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-top: 1px solid var(--line); }
th { white-space: nowrap; font-weight: 600; }
td:last-child { overflow-wrap: anywhere; font-size: .9rem; }
figure { margin: 0; }
svg { max-width: 26rem; height: auto; }
svg text { fill: var(--faint); font-size: 11px; }
"""
RULE = (
    "“Integrable” needs a Poisson bracket that the map preserves with its leaves and a complete set of integrals "
    "(Liouville, or superintegrable), or all integrals but one and a volume. “Periodic” is a map with an iterate "
    "that is the identity, “linear” one of degree 1. “Not integrable” needs exponential growth of degrees, or a "
    "chaotic orbit, which is a float experiment. Everything else is undecided. Exact statements are identities at "
    "random points modulo primes."
)


def terminal_table(investigation: Investigation, width: int = 110) -> str:
    """A table for the terminal."""
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, show_header=False)
    for style in ("bold", "", "dim"):
        grid.add_column(style=style)
    for f in investigation.findings:
        grid.add_row(f.question, _literal(f.answer), _literal(f.evidence))
    console = Console(file=io.StringIO(), width=width, highlight=False, no_color=True)
    console.print(f"{_literal(investigation.name)}: {_literal(investigation.about)}\n")
    console.print(grid)
    console.print(f"\n[bold]{investigation.verdict}[/bold]: {_literal(investigation.reason)}")
    return str(console.file.getvalue()).rstrip()  # type: ignore[attr-defined]


def _literal(text: str) -> str:
    return text.replace("[", r"\[")


def table_html(investigation: Investigation) -> str:
    """The verdict and the table, for a page or a notebook."""
    rows = "".join(
        f"<tr><th>{escape(f.question)}</th><td>{escape(f.answer)}</td><td>{escape(f.evidence)}</td></tr>"
        for f in investigation.findings
    )
    return (
        f'<h1>{escape(investigation.name)}</h1><p class="about">{escape(investigation.about)}</p>'
        f'<p class="verdict">{escape(investigation.verdict)}</p><p>{escape(investigation.reason)}</p>'
        f"<table>{rows}</table>"
    )


def report_page(investigation: Investigation) -> str:
    """One HTML file: no script, nothing from elsewhere."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="generator" content="Kreisel">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>{escape(investigation.name)}: {escape(investigation.verdict)}</title>"
        f"<style>{STYLE}</style></head><body>"
        f'{table_html(investigation)}{_degree_chart(investigation.degrees)}<p class="about">{RULE}</p></body></html>\n'
    )


def _degree_chart(degrees: tuple[int, ...]) -> str:
    """The degrees against the iterate, both on logarithmic scales: a power is a straight line."""
    known = [(k, d) for k, d in enumerate(degrees) if k and d > 0]
    if len(known) < 3:
        return ""
    across, up = math.log(known[-1][0]), max(math.log(max(d for _, d in known)), 1e-9)

    def place(k: int, d: int) -> tuple[float, float]:
        return 50 + 330 * math.log(k) / across, 190 - 170 * math.log(d) / up

    points = [place(k, d) for k, d in known]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="var(--accent)"/>' for x, y in points)
    (x0, _), (x1, y1) = points[0], points[-1]
    labels = (
        f'<text x="{x0:.0f}" y="206" text-anchor="middle">1</text>'
        f'<text x="{x1:.0f}" y="206" text-anchor="middle">{known[-1][0]}</text>'
        f'<text x="{x1 + 6:.0f}" y="{y1 + 4:.0f}">{known[-1][1]}</text>'
    )
    return (
        '<figure><svg viewBox="0 0 430 214" role="img" aria-label="Degrees of the iterates">'
        '<path d="M50 20V190H385" fill="none" stroke="var(--line)"/>'
        f'<polyline points="{line}" fill="none" stroke="var(--accent)" stroke-width="1.2"/>{dots}{labels}</svg>'
        "<figcaption>Degree against iterate, both logarithmic: a power of k is a straight line.</figcaption></figure>"
    )


def save(investigation: Investigation, path: str | os.PathLike[str]) -> None:
    """Write the page; a page that Kreisel wrote is replaced.

    Raises `InputError` where anything else has that name, and `RunError` where it cannot be written.
    """
    with written(place(path, "The page needs a name such as map.html")) as scratch:
        scratch.write_text(report_page(investigation), encoding="utf-8")


def markdown(results: list[tuple[str, Investigation]]) -> str:
    """A table of the documentation: one row a map."""
    head = "| map | Poisson | reversible | order | degree growth | integrals | Lax pair | Lyapunov | verdict |"
    lines = [head, "|" + "---|" * 9]
    for name, investigation in results:
        cells = [
            investigation[q].answer
            for q in ("Poisson", "reversible", "order", "degree growth", "integrals", "Lax pair")
        ]
        cells += [investigation["Lyapunov"].answer, f"**{investigation.verdict}**: {investigation.reason}"]
        lines.append("| " + " | ".join([name, *(cell.replace("|", "\\|") for cell in cells)]) + " |")
    return "\n".join(lines) + "\n"


def plain_data(investigation: Investigation) -> dict[str, Any]:
    """The same as plain data."""
    findings = [{"question": f.question, "answer": f.answer, "evidence": f.evidence} for f in investigation.findings]
    return {
        "map": investigation.name,
        "about": investigation.about,
        "verdict": investigation.verdict,
        "reason": investigation.reason,
        "degrees": list(investigation.degrees),
        "findings": findings,
    }


HEAD = """# Every map, investigated

`kreisel investigate` on every map of the registry, n = 3 (the bitop: 4), eps = 1/3, small numbers for other parameters,
and on three negative controls (`kreisel.lab.controls`): the equations of a heavy top of equal moments by
Euler's method; the map of the Lagrange top in a field that grows with height and breaks its symmetry; and the symmetric
variational step of a heavy top with three unequal moments. What the columns mean and the rule of the verdict:
[the laboratory](integrability.md).

Made by `make investigate` (`kreisel investigate --markdown`).

"""
