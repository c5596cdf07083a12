"""Why a test may be skipped where all of them have to run: `.ci/run` fails for any other reason.

A library, a compiler or a program that can be installed there is no reason.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from typing import Any

REASONS = (  # beginnings of the reasons that pytest shows
    "`make test-full` ",  # minutes
    "the names are those of x86-64",  # environment variables by which libraries choose their code
    "the loop is looked for in registers of AVX",
    "no llvm-mca that reads this assembly",  # older than the processor
    "no fork and no flock",  # Windows
    "in doubles what is left of a long period is not exact",  # no extended precision
    "no file system may be mounted here",  # needs root; another test stands in
    "no compiler: ",  # `.ci/programs` names those that no package index had; browser, Node and g++ it requires
    "the table of bits is of another processor",  # digests hold for one
    "no spiceypy",  # an extra
    "REBOUNDx was not built",  # only its source is in the package index
)


def counted(reasons: Iterable[str]) -> tuple[Counter[str], list[str]]:
    """How often each reason occurs, and those that are not in the list."""
    counts = Counter(reason.removeprefix("Skipped: ") for reason in reasons)
    return counts, [reason for reason in counts if not reason.startswith(REASONS)]


def _skipped(reporter: Any) -> tuple[Counter[str], list[str]]:
    return counted(report.longrepr[2] for report in reporter.stats.get("skipped", []))


def pytest_sessionfinish(session: Any) -> None:
    """With KREISEL_SKIPS=listed the run fails where a reason is not in the list."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and os.environ.get("KREISEL_SKIPS") == "listed" and _skipped(reporter)[1]:
        session.exitstatus = 1


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """How many tests were skipped, and why."""
    counts, others = _skipped(terminalreporter)
    for reason, count in counts.most_common():
        terminalreporter.write_line(f"{count} skipped: {reason}{'; not in tests/skips.py' if reason in others else ''}")
