"""The bits of some hundred runs, on the processor and with the versions for which they are known."""

from __future__ import annotations

import json
import string
from typing import Any

import numpy as np
import pytest

import golden
import kreisel as kr
from sizes import costly
from support import ROOT

TABLE = json.loads((ROOT / "tests" / "golden.json").read_text())
RUNS = {name: value for name, value in TABLE.items() if name != "machine"}
SYSTEMS = sorted({name.split()[0] for name in RUNS})
SOME = [name for name in SYSTEMS if name in (*golden.THOROUGH, "archive", "sweep") or not costly(name)]


def test_the_table_is_whole() -> None:
    assert len(RUNS) > 200
    assert all(golden.few(name) for name in RUNS)
    assert all(len(value) == 16 and {*value} <= {*string.hexdigits} for value in RUNS.values())
    assert TABLE["machine"].count("numpy") == 1


@pytest.mark.parametrize("system", SOME)
def test_bits_are_those_of_the_table(system: str) -> None:
    if TABLE["machine"] != golden.machine():
        pytest.skip("the table of bits is of another processor or of other versions")
    right = {name: value for name, value in RUNS.items() if name.split()[0] == system}
    assert golden.digests(right.__contains__) == {"machine": TABLE["machine"], **right}


def test_the_last_bit_counts(top: Any, x0: Any) -> None:
    run = kr.simulate(top, x0, dt=0.1, steps=3)
    before = golden.digest(run)
    run.m.values[-1, 0] = np.nextafter(run.m.values[-1, 0], 9)
    assert golden.digest(run) != before
