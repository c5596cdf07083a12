"""Functions of a user-defined record are tried before a run: arguments, shapes, flow against energy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.algebra import act, dot, pairing, wedge
from kreisel.record.contract import MOVING_SPACE, REST_SPACE, Parameter, System

START: dict[str, Any] = {"M": (0.3, 0.1, 0.9), "P": (0.6, 0.0, 0.8)}


def flow(M: Any, P: Any, *, c: Any) -> Any:
    return wedge(c * P, P), -act(M, P)


def energy(M: Any, P: Any, *, c: Any) -> Any:
    return pairing(M, M) / 2 + dot(P, c * P) / 2


def system(**changes: Any) -> System:
    record = {"name": "mine", "title": "Mine", "equations": "", "source": "", "space": MOVING_SPACE}
    functions = {"parameters": (Parameter("c", "vector", "stiffness"),), "flow": flow, "energy": energy}
    return System(**{**record, **functions, **changes})


def run(record: System, c: Any = (1.0, 2.0, 3.0), **more: Any) -> Any:
    model = record(c=c)
    start = {"M": np.zeros((len(c), len(c))), "P": np.eye(len(c))[0]} if len(c) > 3 else START
    return kr.simulate(model, model.state(**start), dt=0.01, steps=100, method="dop853", progress=False, **more)


def test_a_record_that_fits_moves_by_its_equations() -> None:
    """Against SciPy, from the equations as cross products: M' = P x cP, P' = P x M."""
    c = np.array([1.0, 2.0, 3.0])

    def equations(t: float, y: Any) -> Any:
        return np.concatenate([np.cross(y[3:], c * y[3:]), np.cross(y[3:], y[:3])])

    end = solve_ivp(equations, (0, 1), [*START["M"], *START["P"]], "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    result = run(system())
    assert np.allclose([*result.M.values[-1], *result.P.values[-1]], end, atol=1e-9)


WRONG: dict[str, tuple[dict[str, Callable[..., Any]], str]] = {
    "one component": ({"flow": lambda M, P, *, c: (wedge(c * P, P),)}, r"flow: expected a tuple .* of 2, got 1 comp"),
    "no tuple": ({"flow": lambda M, P, *, c: wedge(c * P, P)}, r"flow: expected a tuple .* got the shape \(3, 3\)"),
    "shapes": ({"flow": lambda M, P, *, c: (P, P)}, r"flow: M \(skew\): expected the shape \(3, 3\), got \(3,\)"),
    "not skew": ({"flow": lambda M, P, *, c: (M @ M, -act(M, P))}, "flow: M: expected a skew matrix"),
    "keyword": (
        {"flow": lambda M, P, *, d: (d * M, P)},
        r"flow: expected keywords among the parameters, c, got d\. Write def fl",
    ),
    "order": (
        {"flow": lambda P, M, *, c: (M, P)},
        "flow: expected the components of the state, M, P, in order, .* P, M",
    ),
    "a component": ({"flow": lambda M, *, c: (M, M)}, "flow: expected the components of the state, M, P, in order"),
    "a vector": ({"energy": lambda M, P, *, c: P}, r"energy: expected one value, got the shape \(3,\)"),
    "letter of energy": ({"energy": lambda M, P, *, k: k}, "energy: expected keywords among the parameters"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_function_that_does_not_fit_is_named(fault: str) -> None:
    functions, said = WRONG[fault]
    with pytest.raises(kr.InputError, match=f"^mine: {said}"):
        run(system(**functions))


@pytest.mark.parametrize("n", [3, 5])
def test_a_flow_that_is_not_of_the_energy(n: int) -> None:
    """A lost sign or factor; the record that fits gives no warning."""
    c = np.arange(1.0, n + 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(system(), c)
    for wrong, letters in (
        (lambda M, P, *, c: (-wedge(c * P, P), -act(M, P)), "M'"),
        (lambda M, P, *, c: (wedge(c * P, P), act(M, P)), "P'"),
        (lambda M, P, *, c: (2 * wedge(c * P, P), -2 * act(M, P)), "M', P'"),
    ):
        with pytest.warns(kr.InputWarning, match=rf"mine: expected a flow F' = {{H, F}} .* another {letters}\."):
            run(system(flow=wrong), c)


def test_an_inverse_inertia_that_is_not_of_the_energy() -> None:
    """H = |M|^2/2 + V has dH/dM = M: with a lost factor, or if H is no sum T(M) + V, `variational` moves otherwise."""

    def coupled_flow(M: Any, P: Any, *, c: Any) -> Any:  # of H + |M|^2 P_1
        size = 1 + 2 * P[..., 0]
        return wedge(c * P + pairing(M, M) * np.array([1, 0, 0]), P), -size * act(M, P)

    def coupled(M: Any, P: Any, *, c: Any) -> Any:
        return energy(M, P, c=c) + P[..., 0] * pairing(M, M)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(system(inverse_inertia=lambda M: M))
        run(system(flow=coupled_flow, energy=coupled))
    for wrong in (
        system(inverse_inertia=lambda M: 2 * M),
        system(flow=coupled_flow, energy=coupled, inverse_inertia=lambda M: M),
    ):
        with pytest.warns(kr.InputWarning, match=r"mine: expected inverse_inertia\(M\) = dH/dM"):
            run(wrong)


def test_letters_and_fields_of_a_record() -> None:
    with pytest.raises(kr.InputError, match=r"expected one of .*vector.* got 'vektor'\. Did you mean 'vector'"):
        Parameter("c", "vektor", "")
    for letter in ("M", "eps"):
        with pytest.raises(kr.InputError, match=f"mine: parameters: expected letters .*got {letter}"):
            system(parameters=(Parameter(letter, "vector", ""),))
    with pytest.raises(kr.InputError, match=r"no argument 'enery'\. Did you mean 'energy'"):
        system(enery=energy)


def test_a_record_with_the_name_of_a_system_of_kreisel(tmp_path: Path) -> None:
    """A Lagrange top of twice the speed is not continued as the usual top: it needs the record again."""
    twice = system(
        name="lagrange-top",
        space=REST_SPACE,
        parameters=(Parameter("p", "vector", "up"),),
        flow=lambda m, a, *, p: (2 * wedge(a, p), 2 * act(m, a)),
        energy=lambda m, a, *, p: pairing(m, m) + 2 * dot(a, p),
    )
    model, usual = twice(p=(0, 0, 1)), kr.LagrangeTop(p=(0, 0, 1))
    start, settings = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}, {"method": "dop853", "progress": False}
    path = tmp_path / "twice.zarr"
    kr.simulate(model, start, dt=0.01, steps=10, path=path, **settings)
    for given in (None, usual):
        with pytest.raises(kr.InputError, match="lagrange-top"):
            kr.resume(path, extend=20, system=given)
    run = kr.resume(path, extend=20, system=model)
    fast = kr.simulate(usual, start, dt=0.02, steps=20, **settings)  # twice the time of the usual top
    assert np.allclose(run.a.values[-1], fast.a.values[-1], atol=1e-9)
    with pytest.raises(kr.InputError, match="give it as system"):
        kr.analysis.angular_velocity(run, None)
