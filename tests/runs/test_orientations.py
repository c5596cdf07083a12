"""Quaternions of rows: of the two signs of a rotation the one that is continuous, whatever computes the row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra

TURN = (0.5, 0.5, -0.5, 0.5)
TOP = kr.LagrangeTop(p=(0, 0, 1), alpha=0.6)
INSIDE = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.6)
CLEBSCH = kr.Clebsch(b=(-0.9, -0.6, -0.25))
X0, IN_WATER = ((0.1, 0.2, 1.5), (0.6, 0.0, 0.8)), ((0.3, -0.4, 1.2), (0.5, 0.2, 0.9))
CASES = [
    (TOP, X0, "exact"),
    (TOP, X0, "baecklund"),
    (TOP, X0, "suris"),
    (TOP, X0, "dop853"),
    (INSIDE, X0, "exact"),
    (CLEBSCH, IN_WATER, "exact"),
    (CLEBSCH, IN_WATER, "baecklund"),
    (kr.EulerTop(J=(1, 2, 3)), IN_WATER[:1], "exact"),
]


def continuous(q: np.ndarray) -> bool:
    return bool((algebra.dot(q[1:], q[:-1]) > 0.9).all())


def state(model: Any, parts: tuple[Any, ...]) -> dict[str, Any]:
    return dict(zip(model.system.space.letters, parts, strict=True))


@pytest.mark.parametrize(("model", "parts", "method"), CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_rows_of_a_run(model: Any, parts: tuple[Any, ...], method: str) -> None:
    run = kr.simulate(model, state(model, parts), dt=0.05, steps=1000, method=method, orientation=TURN, progress=False)
    q = run.g.values
    assert continuous(q) and (q[:, 0] < 0).any()
    assert np.allclose(q[0], TURN, atol=1e-15)
    assert not continuous(q * np.sign(q[:, :1]))  # the mutant: w >= 0


@pytest.mark.parametrize("seed", range(8))
def test_rows_of_tops_in_closed_form(seed: int) -> None:
    """Any winding numbers of a period: the quaternion may have the other sign after one."""
    draw = np.random.default_rng(seed)
    top = kr.LagrangeTop(p=draw.normal(size=3), alpha=0.5 + draw.random())
    start = {"m": 2 * draw.normal(size=3), "a": draw.normal(size=3)}
    asked = {"dt": 0.05, "orientation": TURN, "progress": False}
    run = kr.simulate(top, start, steps=1000, method="exact", **asked)
    assert continuous(run.g.values)
    times = run.time.values[np.random.default_rng(1).permutation(1001)]
    q = kr.at(top, start, times, orientation=TURN).g.values[np.argsort(times)]
    assert continuous(q) and abs(abs(algebra.dot(q, run.g.values)) - 1).max() < 1e-13
    p = kr.propagator(top, method="exact", orientation=True)
    q = np.asarray(p.at({**start, "g": TURN}, run.time.values)["g"])
    assert continuous(q)


def test_rows_that_go_on_in_an_archive(tmp_path: Path) -> None:
    """In a run that is extended, bit for bit."""
    asked = {"dt": 0.05, "method": "exact", "orientation": TURN, "progress": False}
    whole = kr.simulate(TOP, state(TOP, X0), steps=600, **asked)
    kr.simulate(TOP, state(TOP, X0), steps=301, path=tmp_path / "a.zarr", **asked)
    longer = kr.resume(tmp_path / "a.zarr", extend=600, progress=False)
    assert (longer.g.values == whole.g.values).all() and continuous(longer.g.values)


def test_rows_of_events() -> None:
    run = kr.simulate(TOP, state(TOP, X0), dt=0.05, steps=2000, orientation=TURN, progress=False)
    q = kr.analysis.events(run, "a[0]", 0.0).g.values
    assert (algebra.dot(q[1:], q[:-1]) >= 0).all()
