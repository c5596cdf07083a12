"""The section of each check case on the page: physics, numbers, exact answer, picture."""

from __future__ import annotations

from pathlib import Path

from kreisel import checkcases
from kreisel.viewer.charts import plot_case


def write(docs: Path) -> None:
    """generated/check-cases.md, and a picture of each case in generated/figures."""
    figures = docs / "generated" / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    parts = []
    for name in checkcases.cases():
        case = checkcases.case(name)
        plot_case(case).savefig(figures / f"checkcase-{name}.png", dpi=110)
        parts.append(_section(case))
    (docs / "generated" / "check-cases.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _section(case: checkcases.Case) -> str:
    w, q = (row.tolist() for row in _end(case))
    numbers = "; ".join(f"{key.replace('_', ' ')} {text}" for key, text in case.numbers.items())
    answers = [f"{answer.meaning} {answer.value:.12g} {answer.unit}" for answer in case.answers(case)]
    lines = [
        f"### {case.name}",
        f"{case.title}. {case.about}",
        f"Given: {numbers}. Source: {case.source}.",
        f"![{case.name}: angular velocity against time, and the path of a body axis in space]"
        f"(generated/figures/checkcase-{case.name}.png)",
        f"At {float(case.duration):g} s, certain to {case.digits} digits: angular velocity ({_row(w)}) rad/s, attitude "
        f"({_row(q)}).",
        *([f"Further: {'; '.join(answers)}."] if answers else []),
    ]
    return "\n\n".join(lines)


def _end(case: checkcases.Case) -> tuple:
    end = case.reference([float(case.duration)])
    return end.angular_velocity.values[0], end.attitude.values[0]


def _row(values: list[float]) -> str:
    return ", ".join(f"{value:.15g}" for value in values)
