"""Code of a body serves bodies of the same system with other values: recorded once, with the bits of its own code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.reuse import forget
from kreisel.forces import records
from kreisel.graph.recording import Recording
from kreisel.lab import exact
from kreisel.method import METHODS
from kreisel.record.model import Model
from kreisel.system import REGISTRY
from sizes import FULL

Q = np.array([0.1, 0.2, 0.3, 0.4]) / np.sqrt(0.3)
MOMENTS = np.array([0.9, 1.3, 0.6])
FREE = kr.EulerTop(J=MOMENTS.sum() / 2 - MOMENTS)
ORBIT = kr.physical.Orbit.circular("500 km")


def weight(g: Any, *, k: Any) -> Any:
    return k * g[2] @ np.array([0.3, 0.1, 1.0])


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    steps, record = list[Any](), Recording.__init__
    monkeypatch.setattr(Recording, "__init__", lambda *args: steps.append(1) or record(*args))
    forget()
    return steps


def test_a_sweep_of_many_lanes_is_recorded_as_often_as_one_of_a_few(tmp_path: Path, recorded: list[Any]) -> None:
    """Single lanes, whose step is judged, and blocks of lanes."""
    body, counts = kr.perturbed(FREE, potential=weight, params={"k": 0.7}), []
    options: dict[str, Any] = {"dt": 0.1, "steps": 4, "block": 2, "orientation": Q, "workers": 0, "progress": False}
    for lanes in (2, 6):
        forget()
        recorded.clear()
        design = kr.Design(grid={"system.k": np.linspace(0.3, 0.4, lanes)})
        kr.sweep(body, {"M": (0.3, 0.2, 1.1)}, design, path=tmp_path / str(lanes), **options)
        counts.append(len(recorded))
    assert 1 <= counts[1] <= counts[0]


def test_satellites_one_after_another_are_recorded_once(recorded: list[Any]) -> None:
    for k in range(3):
        body = kr.physical.Satellite((1.13, 2.27 + 0.1 * k, 3.19), ORBIT, magnetic_moment=(0, 0, 0.3 + k))
        kr.simulate(body, body.state(spin=(0, 0, 0.01 * k)), dt="5 s", steps=4, progress=False)
        assert len(recorded) == 1


def same_bits(first: Model, second: Model, state: Any, method: str, order: Any, **options: Any) -> bool:
    """Whether a run and a propagator of the second model behind those of the first are those of the second alone."""

    def results(model: Model) -> list[np.ndarray]:
        run = kr.simulate(model, state, dt=0.01, steps=8, method=method, order=order, progress=False, **options)
        oriented = "orientation" in options
        motion = kr.propagator(model, dt=0.01, method=method, order=order, orientation=oriented)
        ahead = motion.steps({**state, **({"g": Q} if oriented else {})}, 8)
        return [run[name].values for name in run.data_vars] + [np.asarray(value) for value in ahead.values()]

    forget()
    results(first)
    behind = results(second)
    forget()
    alone = results(second)
    return all((x == y).all() for x, y in zip(behind, alone, strict=True))


SYSTEMS = {"lagrange-top", "neumann", "zhukovsky-volterra"}


@pytest.mark.parametrize("name", sorted(set(REGISTRY) if FULL else SYSTEMS))
def test_code_of_another_body_gives_the_bits_of_own_code(name: str) -> None:
    draw = exact.float_random(np.random.default_rng(1))
    n = REGISTRY[name].n or (8 if "chain" in name or "lattice" in name else 3)
    first, second = (exact.random_model(REGISTRY[name], n, draw) for _ in range(2))
    state = dict(zip(first.system.space.letters, first.system.space.point(n, draw), strict=True))
    tried = 0
    for method, record in METHODS.items():
        if not (record.applies(first) and record.applies(second)):
            continue
        for order in record.orders[:2] if FULL else record.orders[1:2] or (None,):
            with suppress(kr.InputError):  # a state or parameters outside the domain
                assert same_bits(first, second, state, method, order)
                tried += 1
    assert tried


def test_what_values_decide_is_not_shared() -> None:
    """Which axes a wheel is across, and about which axes a change of the moments turns."""
    wheels = [kr.ZhukovskyVolterra(J=(1, 2, 3), h=h) for h in ((0.0, 0.2, 0.5), (0.2, 0.0, 0.5))]
    assert same_bits(*wheels, {"M": (0.3, 0.2, 1.1)}, "kahan", 2)
    one = kr.perturbed(FREE, potential=weight, inertia=MOMENTS * (1.1, 1, 1), params={"k": 0.7})
    two = one.system(**{**one.params, "inertia": MOMENTS * (1, 1.1, 1)})
    assert same_bits(one, two, {"M": (0.3, 0.2, 1.1)}, "splitting", (8, 6, 4), orientation=Q)


def test_slopes_of_integrals_are_computed_once_for_all_values_of_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """The torque changes the length of M, unless it is 0."""
    slopes, of = list[Any](), records.value_and_jacobian
    monkeypatch.setattr(records, "value_and_jacobian", lambda *args: slopes.append(1) or of(*args))
    body = kr.perturbed(FREE, potential=weight, params={"k": 0.7})
    forget()
    assert records.conserved(body) == ()
    first = len(slopes)
    assert records.conserved(body.system(**{**body.params, "k": 0.3})) == () and len(slopes) == first
    free = records.conserved(body.system(**{**body.params, "k": 0.0}))
    assert free == ("spectrum",)
    moved = body.system(**{**body.params, "J": 2 * body.params["J"], "k": 0.0})
    assert records.conserved(moved) == free and len(slopes) > first
