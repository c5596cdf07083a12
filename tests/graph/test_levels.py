"""KREISEL_CODE_LEVEL: other machine code of equal bits."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.reuse import forget
from kreisel.graph import machine


def test_levels_of_the_compiler_have_equal_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: dict[str, list[int]] = {"0": [], "1": []}
    draw, of_code, rows = np.random.default_rng(1), machine.object_code, []
    state = {"M": draw.normal(size=(9, 3)), "P": draw.normal(size=(9, 3))}
    for level in sizes:
        monkeypatch.setenv("KREISEL_CODE_LEVEL", level)
        monkeypatch.setenv("KREISEL_CACHE", str(tmp_path / level))
        monkeypatch.setattr(machine, "version", inspect.unwrap(machine.version))

        def measured(*arguments: Any, level: str = level) -> bytes:
            sizes[level].append(len(code := of_code(*arguments)))
            return code

        monkeypatch.setattr(machine, "object_code", measured)
        forget()
        run = kr.simulate(kr.Clebsch(b=(0.3, 0.7, 1.9)), state, dt=0.1, steps=200, method="suris", progress=False)
        rows.append([run.M.values, run.P.values, run.energy.values])
    assert len(sizes["0"]) == len(sizes["1"]) > 0 and sizes["0"] != sizes["1"]
    assert all((a == b).all() for a, b in zip(*rows, strict=True))


@pytest.mark.parametrize("level", ["", "2", "fast"])
def test_another_level_is_refused(level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KREISEL_CODE_LEVEL", level)
    with pytest.raises(kr.InputError, match="KREISEL_CODE_LEVEL: expected 0 or 1, got"):
        machine.code_level()
