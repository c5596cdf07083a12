"""Archives of user-defined forces and events go on with the same operations only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.record.contract import ClosedForm, System
from kreisel.record.model import Model
from kreisel.runs.operations import operations_of
from kreisel.sweeps.sweep import check_archive

TOP = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
START = {"M": np.array([0.3, 0.2, 1.1]), "P": np.array([0.6, 0.0, 0.8])}
DRAG = 0.001


def torque(M: Any) -> Any:
    return -DRAG * M


def closed(value: Any, sign: int = 1) -> Callable[..., Any]:
    return lambda M: -sign * value * M


def renamed(M: Any) -> Any:
    """The torque of `torque` in other words."""
    momentum, unused = M, M * 3  # noqa: F841 - neither comments nor names nor dead code matter
    factor = 0.001
    return momentum * -factor


def body(function: Callable[..., Any], **more: Any) -> Model:
    return kr.perturbed(TOP, torque=function, **more)


def cubic(k: float) -> System:
    """A system of one's own, of which only the flow knows k."""
    from dataclasses import replace

    record = kr.LagrangeTopMoving
    still = {"map": None, "baecklund": None, "closed_form": ClosedForm()}
    return replace(record, name="cubic", **still, flow=lambda M, P, *, A: (0 * M, k * P))


SAME = body(torque)
OTHERS = {
    "sign": body(closed(DRAG, -1)),
    "value": body(closed(0.002)),
    "the last bit": body(closed(np.nextafter(DRAG, 1))),
    "component": body(lambda M: -DRAG * M * (1, 1, 0)),
    "order": body(lambda M: -DRAG * M[::-1]),
    "kind of force": kr.perturbed(TOP, potential=lambda P: DRAG * P[0]),
    "damping": body(torque, damping=0.1),
    "integrable part": kr.perturbed(kr.EulerTop(J=(1, 2, 2.5)), torque=torque, name=SAME.system.name),
    "map within": body(torque, inner=2),
}


def test_a_digest_sees_operations_and_nothing_else() -> None:
    assert operations_of(TOP) is None
    digest = operations_of(SAME)
    for function in (closed(DRAG), closed(np.float64(DRAG)), renamed, lambda M: M * 1 * -0.001):
        assert operations_of(body(function)) == digest
    digests = {name: operations_of(other) for name, other in OTHERS.items()}
    assert digest not in digests.values() and len({*digests.values()}) == len(digests)
    systems = [operations_of(cubic(k)(A=(0, 0, 1), alpha=1)) for k in (1.0, 1.0, 2.0)]
    assert systems[0] == systems[1] != systems[2]


def test_functions_that_cannot_be_recorded_have_their_code() -> None:
    """A branch on a value, which recorded numbers refuse."""

    def branch(limit: float, names: list[int]) -> Callable[..., Any]:
        def inner(x: Any) -> float:
            height = float(x["P"][2])
            names.append(1)
            return height if height > limit else limit

        return inner

    def other_names(limit: float, log: list[int]) -> Callable[..., Any]:
        def inner(y: Any) -> float:
            """Another text."""
            z = float(y["P"][2])
            log.append(1)
            return z if z > limit else limit  # a comment

        return inner

    def events(quantity: Callable[..., Any]) -> str:
        run = kr.simulate(SAME, START, dt=0.05, steps=2, events=kr.Event(quantity))
        return str(run.attrs["events"]).split("sha256")[1]

    here = events(branch(-0.5, []))
    assert here == events(branch(-0.5, [1, 2])) == events(other_names(-0.5, []))
    assert here != events(branch(-0.25, []))


def test_an_archive_goes_on_with_its_force_only(tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(SAME, START, dt=0.05, steps=20, path=path)
    for name in ("sign", "value", "component"):
        with pytest.raises(kr.InputError, match="expected perturbed-lagrange-top-moving with the functions of the run"):
            kr.resume(path, extend=40, system=OTHERS[name])
        with pytest.raises(kr.InputError, match="with the functions of the run, got other functions under this name"):
            kr.analysis.angular_velocity(kr.open_run(path), OTHERS[name])
    run = kr.resume(path, extend=40, system=body(renamed)).load()
    longer = kr.simulate(SAME, START, dt=0.05, steps=40)
    assert run.M.values.tobytes() == longer.M.values.tobytes() and check_archive(path)[1] == []


def height(x: Any) -> Any:
    return x["P"][2] + 0.3


def back(x: Any) -> Any:
    return {**x, "M": -x["M"]}


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (kr.Event(height), "got 'height"),
        (kr.Event(height, back, rising=True), "rising=True"),
        (kr.Event(lambda x: x["P"][2] + 0.3, back), "<lambda>"),
        (kr.Event(kr.Event(height, back).action, back), "back"),
        ([kr.Event(height, back)] * 2, "height"),
        ((), "got 'none'"),
    ],
)
def test_events_are_those_of_the_run(other: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(SAME, START, dt=0.05, steps=20, path=path, events=kr.Event(height, back))
    with pytest.raises(kr.InputError, match=r"events: expected the events of the run") as error:
        kr.resume(path, extend=40, system=SAME, events=other)
    assert message in str(error.value)


def test_functions_of_events_are_those_of_the_run(tmp_path: Path) -> None:
    """Every lambda has one name."""

    def event(place: int, shift: float, sign: int) -> kr.Event:
        return kr.Event(lambda x: x["P"][place] + shift, lambda x: {**x, "M": sign * x["M"]})

    path = tmp_path / "run.zarr"
    kr.simulate(SAME, START, dt=0.05, steps=20, path=path, events=event(2, 0.3, -1))
    for mutant in (event(1, 0.3, -1), event(2, 0.2, -1), event(2, 0.3, 1)):
        with pytest.raises(kr.InputError, match="got 'other functions under these names'"):
            kr.resume(path, extend=40, system=SAME, events=mutant)
    run = kr.resume(path, extend=400, system=SAME, events=event(2, 0.3, -1)).load()
    longer = kr.simulate(SAME, START, dt=0.05, steps=400, events=event(2, 0.3, -1))
    assert run.M.values.tobytes() == longer.M.values.tobytes()
    assert run.attrs["event_times"] == longer.attrs["event_times"] != "[]"
