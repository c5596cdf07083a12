"""Systems, states, propagators, bodies and runs go through pickle, copy, spawned processes and Dask."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest

import kreisel as kr
from kreisel import reduction as red
from kreisel.bodies import BODIES, KNOWN
from kreisel.record.model import Model
from kreisel.runs.examples import example
from kreisel.sweeps.sweep import check_archive

TOP = kr.LagrangeTop(p=(0, 0, 1))
STATE = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))


def through_dask(x: Any) -> Any:
    from distributed.protocol import deserialize, serialize

    return deserialize(*serialize(x, serializers=["pickle"]))


WAYS: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda x: pickle.loads(pickle.dumps(x)),
    "cloudpickle": lambda x: pickle.loads(cloudpickle.dumps(x)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "dask": through_dask,
}


def drag(m: Any, *, k: Any) -> Any:
    return -k * m


def bodies() -> dict[str, Model]:
    factor = 0.1
    return {
        "named force": kr.perturbed(TOP, torque=drag, params={"k": 0.01}, damping=0.01),
        "lambda": kr.perturbed(TOP, torque=lambda m: -factor * m, name="mine"),
        "product": kr.perturbed(
            [TOP, kr.LagrangeTop(p=(0, 0, 1), alpha=0.5)], potential=lambda a1, a2: 0.1 * (a1 @ a2)
        ),
    }


def equal(x: Any, y: Any) -> bool:
    return all(np.array_equal(x[name], y[name]) for name in y)


@pytest.mark.parametrize("way", WAYS)
def test_every_system_with_parameters_and_a_state(way: str) -> None:
    through = WAYS[way]
    for name, system in KNOWN.items():
        assert through(system) is system, name
    for name in ("lagrange-top", "clebsch", "neumann", "heavy-top", "spin-chain"):
        case = example(KNOWN[name])
        x = case.model.state(**case.state)
        model, state = through((case.model, x))
        assert model.system is case.model.system and equal(model.constants, case.model.constants)
        assert equal(state, x) and equal(state.axial, x.axial) and repr(state) == repr(x)
        with pytest.raises(AttributeError, match="this state has the components"):
            _ = state.nothing


@pytest.mark.parametrize("way", WAYS)
def test_bodies_and_propagators_and_runs(way: str) -> None:
    through = WAYS[way]
    for name, body in bodies().items():
        again = through(body)
        assert again.system.name == body.system.name and repr(again) == repr(body), name
        state = [STATE.m, STATE.a] * (len(body.system.space.letters) // 2)
        assert all((a == b).all() for a, b in zip(again.flow(*state), body.flow(*state), strict=True))
    p = kr.propagator(TOP, dt=0.05)
    fresh = through(p)
    after = p.steps(STATE, 3)
    for each in (fresh, through(p)):
        assert equal(each.steps(STATE, 3), after)
    run = kr.simulate(TOP, STATE, dt=0.05, steps=3)
    assert through(run).identical(run)
    event = through(kr.Event(lambda x: x["a"][2] - 0.5, rising=True))
    assert event.rising and event.quantity({"a": (0, 0, 2)}) == 1.5


def test_bodies_in_si_units_and_their_propagators() -> None:
    free = kr.physical.FreeBody((1.0, 2.0, 2.5))
    physical = {
        "gyroscope": kr.physical.Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15),
        "heavy": kr.physical.HeavyBody(mass=1.0, inertia=(1.0, 1.5, 2.0), arm=(0, 0, 0.1)),
        "free": free,
        "rotation": free.rotation((0.1, 0.2, 0.3)),
        "ellipsoid": kr.physical.Ellipsoid(semi_axes=(0.3, 0.2, 0.1), mass=25.0, fluid_density=1000.0),
        "submerged": kr.physical.SubmergedBody(1.0, (0.02, 0.02, 0.02), (5.0, 5.0, 26.0, 0.1, 0.2, 0.3)),
        "asteroid": kr.physical.Asteroid((1e24, 2e24, 2.5e24), kr.physical.Orbit.circular(550e3)),
        "satellite": kr.physical.Satellite((0.03, 0.05, 0.06), kr.physical.Orbit.circular(550e3)),
    }
    for name, body in physical.items():
        p = kr.propagator(body.model(), dt=0.01) if name in ("gyroscope", "heavy", "free") else None
        for way, through in WAYS.items():
            again = through(body)
            assert type(again) is type(body) and again.__dict__.keys() == body.__dict__.keys(), (name, way)
            assert repr(again) == repr(body) or "object at" in repr(body)
            assert p is None or repr(through(p)) == repr(p)
    for system in BODIES.values():
        model = example(system).model
        again = WAYS["pickle"](model)
        assert again.system is system and equal(again.constants, model.constants)
        assert again.body_frame.table == model.body_frame.table


def test_a_system_of_a_lagrangian() -> None:
    def lagrangian(W: Any, P: Any, *, J: Any) -> Any:
        return J * (W * W).sum() / 4 - P[2]

    group = red.SO(3)
    system = red.system("heavy-ball", group=group, lagrangian=lagrangian, representation=red.standard(group))
    again = WAYS["pickle"](system)(J=2.0)
    x = again.state(M=(0.1, 0.2, 0.3), P=(0.6, 0, 0.8))
    assert all(
        np.array_equal(a, b) for a, b in zip(again.flow(*x.values()), system(J=2.0).flow(*x.values()), strict=True)
    )


def test_an_opened_run(tmp_path: Path) -> None:
    kr.simulate(TOP, STATE, dt=0.05, steps=30, path=tmp_path / "run.zarr")
    run = kr.open_run(tmp_path / "run.zarr")
    for through in WAYS.values():
        assert through(run).load().equals(run.load())
    assert check_archive(tmp_path / "run.zarr")[1] == []


def stepped(sent: tuple[Any, ...]) -> list[Any]:
    propagator, body, state = sent
    return [propagator.steps(state, 3)["m"], body.flow(*state.values())[0]]


def test_a_spawned_process() -> None:
    body = bodies()["lambda"]
    p = kr.propagator(TOP, dt=0.05)
    expected = stepped((p, body, STATE))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.apply(stepped, ((p, body, STATE),))
    assert all((x == y).all() for x, y in zip(found, expected, strict=True))
