"""`make test-machines`: its lists name tests that there are, and its settings do what they say."""

from __future__ import annotations

import platform
import re
import subprocess
import sys

import pytest

from machines import MACHINES, OLDEST, PART, QUICK, environment
from support import ROOT

HERE = ROOT / "tests"


@pytest.mark.parametrize("name", sorted({*PART, *QUICK}))
def test_the_tests_are_there(name: str) -> None:
    file, _, test = name.partition("::")
    text = (HERE / file).read_text()
    assert not test or re.search(rf"^def {test.partition('[')[0]}\(", text, re.MULTILINE)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the names are those of x86-64")
def test_the_libraries_choose_other_code() -> None:
    code = (
        "from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__\n"
        "from kreisel.graph.machine import register_width\n"
        "from kreisel.kernels.layout import thread_count\n"
        "print(any(__cpu_features__[name] for name in __cpu_dispatch__), register_width(),"
        " thread_count())"
    )
    run = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(run, env=environment(OLDEST), capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == ["False", "2", "1"]


def test_every_setting_is_among_those_of_the_oldest_machine() -> None:
    assert {key for machine in MACHINES.values() for key in machine} == OLDEST.keys()
