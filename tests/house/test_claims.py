"""Every claim of can.md and faq.md is a test or a block that runs: named here, row by row, question by question."""

from __future__ import annotations

import ast
import re

import pytest

from support import DOCS, ROOT

# Of can.md: the beginning of a row that says yes; of faq.md: of a question.  A page is one whose blocks run.
ROWS = {
    "a top, a gyroscope, a free body": ["start.md", "physical/test_physical.py::nutation_rate_of_a_fast_top"],
    "a body of any shape with a fixed point": ["tutorial-body.md", "system/test_other_flows.py"],
    "dimension n > 3": ["sweeps/test_sweep.py::more_dimensions", "lab/test_laws.py"],
    "friction in a bearing, drag of a fluid": ["perturbed.md", "physical/test_submerged.py::terminal_speed"],
    "a torque that depends on time": ["perturbed.md", "forces/test_perturbed.py::order_of_forces_in_a_fluid"],
    "a satellite": ["satellites.md", "physical/test_satellite.py"],
    "a controller in the loop": ["control.md", "physical/test_control.py::a_controller_is_that_of_an_independent_loop"],
    "an impulse, a stop at an event": [
        "runs/test_breaks.py::an_impulse_is_added_at_its_time",
        "runs/test_breaks.py::an_event_stops_the_run_where_it_happens",
    ],
    "bodies that attract each other": ["forces/test_pairs.py::a_chain_of_tops_is_that_of_its_equations"],
    "two bodies that rotate each other": [
        "binaries.md",
        "physical/test_binary.py::the_potential_has_all_terms_of_the_fourth_degree",
    ],
    "spins and tides of bodies on orbits": ["physical/test_rebound.py::the_moon_recedes_and_the_day_gets_longer"],
    "a body in water or air": ["water.md", "physical/test_submerged.py::against_equations_about_another_point"],
    "chains of classical spins": ["spin-chains.md", "system/test_spin_chains.py::runs_and_archives"],
    "a user-defined potential or Lagrangian": ["tutorial-lagrangian.md", "own-system.md"],
    "a gradient with respect to parameters, a fit": ["derivatives.md", "inference.md"],
    "millions of bodies": ["sweeps.md", "runs/test_simulate.py::lanes_equal_single_runs_bitwise"],
    "a GPU": ["kernels/test_cuda.py::the_kernel_of_the_gpu_is_that_of_the_cpu"],
    "the state at t = 10": ["exact.md", "exact/test_exact.py::a_million_million_periods_on"],
    "archives and sweeps on Windows": ["house/test_platforms.py::runs_without_the_modules_of_posix"],
    "is my map integrable?": ["integrability.md", "lab/test_verdicts.py"],
}
QUESTIONS = {
    "Which way does gravity pull?": ["faq.md", "conventions.md"],
    "What are the units?": ["units.md"],
    "What are `m` and `M`?": ["faq.md"],
    "Where is the angular velocity?": ["faq.md"],
    "Where is the orientation?": ["faq.md"],
    "Which method should I use?": ["runs/test_simulate.py::default_method_and_names"],
    "How long may a step be?": ["faq.md", "method/test_auto.py::the_tolerance_is_reached_and_not_wasted"],
    "My integral is not conserved.": ["faq.md", "runs/test_drift.py::what_a_map_keeps_is_what_its_record_says"],
    "My results differ from yours": ["house/test_promises.py"],
    "Why does only the first run need seconds?": ["kernels/test_cache.py"],
    "Can I stop a long run?": ["storage/test_resume.py::killed_at_random_moments"],
    "How do I get the data into another program?": ["storage/test_export.py", "faq.md"],
    "How do I cite Kreisel?": ["faq.md"],
    "Can Kreisel do": ["can.md"],
}
NO = re.compile(r"no$|partly")


def claims(page: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    if page == "faq.md":
        return re.findall(r"^\*\*(.+?)\*\*", text, re.MULTILINE)
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    return [row[0] for row in rows[1:] if not NO.match(row[1])]


@pytest.mark.parametrize(("page", "evidence"), [("can.md", ROWS), ("faq.md", QUESTIONS)])
def test_every_claim_has_a_test_or_a_block_that_runs(page: str, evidence: dict[str, list[str]]) -> None:
    found = claims(page)
    assert len(found) >= 12
    for claim in found:
        assert [key for key in evidence if claim.startswith(key)], f"{page}: nothing shows {claim!r}"
    for key in evidence:
        assert [claim for claim in found if claim.startswith(key)], f"{page} does not say {key!r} any more"


def test_what_is_named_exists() -> None:
    for place in {place for lists in (*ROWS.values(), *QUESTIONS.values()) for place in lists} - {"can.md"}:
        if place.endswith(".md"):
            text = (DOCS / place).read_text(encoding="utf-8")
            assert "```python" in text or "<!-- python" in text, f"no block of {place} runs"
            continue
        file, _, name = place.partition("::")
        tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
        functions = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
        assert not name or f"test_{name}" in functions, f"{file} has no test_{name}"


def test_concepts_has_every_word_of_the_drift_table() -> None:
    from kreisel.method.scheme import KINDS
    from kreisel.runs.drift import COLUMNS

    text = (DOCS / "concepts.md").read_text(encoding="utf-8")
    for word in (*COLUMNS, *KINDS):
        assert f"`{word}`" in text, word
