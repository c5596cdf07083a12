"""User-defined functions that cannot be recorded: errors that name the function, its line and the operation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import is_known_zero
from kreisel.algebra.gradient import TracedNumber
from kreisel.errors import InputError
from kreisel.graph.graph import Graph, array_of
from kreisel.record.contract import FREE_SPACE, System

STATE = (0.0, 0.3, 1.5)


def user_system(rate: Callable[[Any], Any], **integrals: Callable[..., Any]) -> System:
    """A body whose momentum, an axial vector, changes at a rate."""

    def flow(M: Any) -> Any:
        return (kr.algebra.hat(rate(kr.algebra.axial(M))),)

    return System(
        name="of-a-user",
        title="",
        equations="",
        source="",
        space=FREE_SPACE,
        flow=flow,
        scaling="",
        n=3,
        integrals=integrals,
    )


def stopping(m: Any) -> Any:
    return np.array([-x if x == 0.3 else 0 * x for x in m])


def moving(m: Any) -> Any:
    return -m if m[1] != 0.3 else 0 * m


def truthful(m: Any) -> Any:
    return -m if m[0] else 0 * m


def ordered(m: Any) -> Any:
    return -m if m[0] < 0 else m


def largest(m: Any) -> Any:
    return m * max(m)


def plain(m: Any) -> Any:
    return np.maximum(np.array([m[0], m[1], m[2]]), 0)


REFUSED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "equality": (stopping, r"stopping \(test_refusals.py, line \d+: .* the comparison x == y"),
    "inequality": (moving, r"moving \(test_refusals.py, line \d+: .* the comparison x != y"),
    "truth": (truthful, r"truthful .* the truth of a number"),
    "any": (lambda m: -m if (m == 0).any() else m, "x == y"),
    "order": (ordered, r"ordered .* got the truth of a comparison.*np\.where\(x > 0, y, z\)"),
    "largest": (largest, r"largest .* got the truth of a comparison.*np\.maximum"),
    "a plain array": (plain, r"plain .* got the truth of a comparison.*np\.stack\(\[x, y\]\)"),
    "tanh": (lambda m: np.tanh(m), "got np.tanh.*Recorded are"),
    "arctan2": (lambda m: np.arctan2(m, m), "got np.arctan2"),
    "root": (lambda m: m**0.5, r"x\*\*0.5.*np.sqrt"),
    "math": (lambda m: np.array([math.sin(x) for x in m]), "a conversion to a float.*np.sin"),
    "float": (lambda m: np.array([float(x) for x in m]), "a conversion to a float"),
    "floats": (lambda m: np.asarray(m, dtype=float), "a conversion to a float"),
    "int": (lambda m: m * int(m[0]), "a conversion to an integer"),
    "remainder": (lambda m: m % 2, "a remainder"),
    "attribute": (lambda m: m.momentum, "got AttributeError"),
    "shapes": (lambda m: m + np.ones(2), "got ValueError"),
    "index": (lambda m: m * m[7], "got IndexError"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_flow_that_cannot_be_recorded_is_named(name: str) -> None:
    rate, message = REFUSED[name]
    system = user_system(rate)()
    with pytest.raises(InputError, match=message):
        kr.simulate(system, system.state(M=STATE), dt=0.1, steps=2, method="dop853", progress=False)


@pytest.mark.parametrize("load", ["torque", "potential"])
def test_a_force_that_cannot_be_recorded_is_named(load: str) -> None:
    def drag(M: Any) -> Any:
        return -M if M[0] > 0 else M

    def well(g: Any) -> Any:
        return g[0, 0] if g[0, 0] == 1 else g[1, 1]

    forces = {"torque": drag, "potential": well}
    with pytest.raises(
        InputError, match=rf"{forces[load].__name__} \(test_refusals.py, line \d+: .* (the truth of a|the) comparison"
    ):
        kr.perturbed(kr.EulerTop(J=(1, 2, 4)), **{load: forces[load]})


def test_an_integral_with_a_branch_is_named() -> None:
    """Silently recorded as one of its branches, it would be 0 in all rows here."""

    def kept(M: Any) -> Any:
        m = kr.algebra.axial(M)
        return m @ m if m[0] == 0 else 0 * m[0]

    system = user_system(lambda m: 0 * m, kept=kept)()
    with pytest.raises(InputError, match=r"kept \(test_refusals.py, line \d+: return m @ m"):
        kr.simulate(system, system.state(M=STATE), dt=0.1, steps=2, method="dop853", progress=False)


def by_jax() -> Any:
    from kreisel.kernels import jax_numbers

    return jax_numbers.Number(jax_numbers.jnp.asarray(1.0))


@pytest.mark.parametrize("make", [lambda: Graph().input("x", 0), lambda: TracedNumber([], 1.0), by_jax])
def test_numbers_without_values_compare_to_nothing(make: Callable[[], Any]) -> None:
    x = make()
    for y in (0, 0.5, np.float64(1), np.int8(1), make()):
        for compare in (lambda x, y: x == y, lambda x, y: y != x, lambda x, y: bool(x < y), lambda x, y: bool(y >= x)):
            with pytest.raises(InputError, match="comparison"):
                compare(x, y)
    for refuse in (bool, float, int, round, math.floor):
        with pytest.raises(TypeError, match="no `if`"):
            refuse(x)
    assert x is not None and not (x == "x")
    assert not is_known_zero(array_of([0.0, x]))
    assert is_known_zero(np.zeros(2))


@pytest.mark.parametrize("size", [1e-8, 1e-3, 1.0, 1e3, 1e8])
def test_phase_spaces_in_any_unit(size: float) -> None:
    """M in units of size, P of its square: <M, P> of a state that is off was 1e-24, of a state that is on 1e-7."""
    top, P = kr.GoryachevChaplygin(gamma=0.3 * size), np.array([0.6, 0.1, 0.7])
    off = np.array([1.3, 0.2, 0.5])
    on = off - P * (off @ P) / (P @ P)
    assert np.allclose(top.state(M=size * on, P=size**2 * P).P, size**2 * P, rtol=1e-15)
    with pytest.raises(kr.InputError, match=r"must lie on .* not projected across another.*dop853"):
        top.state(M=size * off, P=size**2 * P)
    particle, x = kr.Neumann(b=(1, 2, 3)), np.array([0.6, 0.48, 0.64])
    q = size * (off - x * (off @ x))
    assert (particle.state(x=x, q=q).x == particle.state(x=x, q=0 * q).x).all()
    for wrong in ({"x": x, "q": size * off}, {"x": (1 + 1e-9) * x, "q": q}, {"x": 0 * x, "q": 0 * q}):
        with pytest.raises(kr.InputError, match="must lie on"):
            particle.state(**wrong)


def test_a_system_without_a_flow_is_not_told_to_leave_the_method_out() -> None:
    system = replace(user_system(stopping), flow=None)()
    with pytest.raises(InputError, match=r"states its flow, got of-a-user with n = 3\. None fits"):
        kr.simulate(system, system.state(M=STATE), dt=0.1, steps=3)
    with pytest.raises(InputError, match="Leave method out"):
        kr.simulate(kr.EulerTop(J=(1, 2, 3)), {"M": STATE}, dt=0.1, steps=3, method="brickwork")
