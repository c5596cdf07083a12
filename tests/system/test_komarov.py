"""Kovalevskaya's top on e(3), so(4), so(3,1) and Sokolov's case: the record over Q, the exact step, mutants."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg

import kreisel as kr
from kreisel import algebra
from kreisel.lab import laws
from kreisel.runs.planning import make_plan
from kreisel.system import REGISTRY, komarov
from sizes import FULL
from taylor import flow_of

SYSTEM = komarov.SYSTEM
CASES = {  # kappa, beta, c, gamma
    "e(3)": (0.0, 0.0, 1.0, 0.0),
    "so(4), rotor": (-0.4, 0.0, 1.0, 0.3),
    "so(3,1)": (0.4, 0.0, 1.0, 0.0),
    "so(4), Sokolov's terms, rotor": (-0.4, 0.6, 1.0, 0.3),
    "Sokolov's case": (0.0, 0.6, 0.0, 0.0),
    "Sokolov's case on so(3,1), rotor": (0.4, 0.6, 0.0, 0.2),
}
FEW = ("so(4), rotor", "so(4), Sokolov's terms, rotor", "Sokolov's case on so(3,1), rotor")


def case(name: str, seed: int = 0) -> tuple[Any, dict[str, np.ndarray]]:
    M, P = np.random.default_rng([5, seed]).normal(size=(2, 3)) * 0.7
    return kr.Komarov(**dict(zip(("kappa", "beta", "c", "gamma"), CASES[name], strict=True))), {"M": M, "P": P}


def eigenvalues(model: Any, z: Any, lam: complex) -> np.ndarray:
    """The finite mu of L q = mu S q but 0, by LAPACK; those next to lam and -lam first."""
    L, S = model.call(model.system.pairs.matrix, *z, lam=lam), np.diag(model.call(model.system.pairs.metric))
    mu = scipy.linalg.eigvals(L, S)
    return np.array(sorted(mu[np.isfinite(mu) & (abs(mu) > 1e-6)], key=lambda x: abs(x * x - lam * lam)))


def off(model: Any, state: dict[str, np.ndarray], dt: float, steps: int, digits: int = 20, **options: Any) -> float:
    """The error of the last row against a Taylor series, relative to the largest coordinate."""
    run = kr.simulate(model, state, dt=dt, steps=steps, every=steps, **({"method": "exact"} | options))
    z = model.state(**state)
    want = flow_of(model, (z["M"], z["P"]), dt * steps, digits=digits).astype(float)
    end = np.concatenate([algebra.coordinates(algebra.hat(run.M.values[-1])), run.P.values[-1]])
    return float(abs(end - want).max() / abs(want).max())


def test_a_state_too_small_for_the_maps_gets_a_method_that_accepts_it() -> None:
    """At 1e-8 next to c = 1 eight digits of the maps cancel: no dt is the cause, and the message names a method."""
    model, state = case("so(3,1)")
    state = {letter: 1e-8 * value for letter, value in state.items()}
    with pytest.raises(kr.RunError, match=r"far smaller than a parameter.*method='dop853', tol=1e-13"):
        kr.simulate(model, state, dt=0.1, steps=20, method="exact")
    assert off(model, state, 0.1, 20, method="dop853", tol=1e-13) < 1e-7


def test_the_record_over_q_at_twenty_points() -> None:
    verdicts = laws.check(SYSTEM, numbers=("exact",), seeds=range(20))
    assert {v.law for v in verdicts} == {
        *("hamiltonian-flow", "jacobi-identity", "casimirs", "integrals-of-the-flow", "involution", "lax-equation")
    }
    assert len(verdicts) == 120
    assert all(v.holds for v in verdicts)


@pytest.mark.parametrize("name", CASES)
def test_the_record_at_the_parameters_where_s_is_singular(name: str) -> None:
    assert all(v.holds for v in laws.check(case(name)[0], numbers=("float",)))


def lax_without_a_rotor(M: Any, P: Any, *, kappa: Any, beta: Any, c: Any, gamma: Any, lam: Any) -> Any:
    return komarov.lax(M, P, kappa=kappa, beta=beta, c=c, gamma=0 * gamma, lam=lam)


def lax_on_e3(M: Any, P: Any, *, kappa: Any, beta: Any, c: Any, gamma: Any, lam: Any) -> Any:
    return komarov.lax(M, P, kappa=0 * kappa, beta=beta, c=c, gamma=gamma, lam=lam)


def other_sign(M: Any, P: Any, *, kappa: Any) -> Any:
    return komarov.tensor(M, P, kappa=-kappa)


def without_the_casimir(M: Any, P: Any, *, kappa: Any, beta: Any, c: Any, gamma: Any) -> Any:
    K = komarov.komarov(M, P, kappa=kappa, beta=beta, c=c, gamma=gamma)
    return K - 2 * c * algebra.dot(algebra.axial(M), P) * algebra.axial(M)[..., 0]


@pytest.mark.parametrize(
    ("law", "mutant"),
    [
        ("lax-equation", replace(SYSTEM, lax=lax_without_a_rotor)),
        ("lax-equation", replace(SYSTEM, lax=lax_on_e3)),
        ("hamiltonian-flow", replace(SYSTEM, space=replace(SYSTEM.space, tensor=other_sign))),
        ("casimirs", replace(SYSTEM, space=replace(SYSTEM.space, tensor=other_sign))),
        ("involution", replace(SYSTEM, integrals={"komarov": without_the_casimir})),
    ],
)
def test_mutants_of_the_record(law: str, mutant: Any) -> None:
    (found,) = (v for v in laws.check(mutant, numbers=("exact",)) if v.law == law)
    assert not found.holds


def test_on_e3_it_is_kovalevskayas_top() -> None:
    """The flow of a record that shares no formula with this one."""
    model, state = case("e(3)")
    z = model.state(**state)
    for mine, other in zip(model.flow(z["M"], z["P"]), kr.KovalevskayaTopE3().flow(z["M"], z["P"]), strict=True):
        assert abs(mine - other).max() < 1e-15


def test_as_few_pairs_as_for_kovalevskayas_top() -> None:
    """The distance of the branch points is that of the other Lax matrix: vectors and pencil are in one order."""
    model, state = case("e(3)")
    counts = [
        make_plan(m, state, dt=0.3, steps=1, method="exact").scheme.stage_count for m in (model, kr.KovalevskayaTopE3())
    ]
    assert counts == [2, 2]


def test_points_do_not_depend_on_the_unit_of_p() -> None:
    """At order 2, whose error depends on the points."""
    name, ends = "so(4), Sokolov's terms, rotor", []
    (kappa, beta, c, gamma), (_, state) = CASES[name], case(name)
    for unit in (1.0, 2.0**20, 2.0**-20):
        model = kr.Komarov(kappa=kappa * unit**2, beta=beta / unit, c=c / unit, gamma=gamma)
        start = {"M": state["M"], "P": unit * state["P"]}
        run = kr.simulate(model, start, dt=0.1, steps=3, every=3, method="baecklund", order=2, observe=())
        ends.append(np.append(run.M.values[-1], run.P.values[-1] / unit))
    assert abs(ends[1] - ends[0]).max() < 1e-12 > abs(ends[2] - ends[0]).max()


@pytest.mark.parametrize("name", CASES if FULL else FEW)
@pytest.mark.parametrize(("dt", "steps"), [(0.3, 10), *[(0.3125, 160)] * FULL])
def test_the_exact_step_against_taylor(name: str, dt: float, steps: int) -> None:
    model, state = case(name)
    assert off(model, state, dt, steps, 40 if steps > 10 else 20) < 1e-13


@pytest.mark.parametrize("name", CASES)
def test_a_pair_keeps_the_integrals_and_the_form_of_the_pencil_wherever_its_point_is(name: str) -> None:
    model, state = case(name)
    z = model.state(**state)
    z = z["M"], z["P"]

    def values(state: Any) -> np.ndarray:
        functions = (SYSTEM.space.casimirs, SYSTEM.energy, komarov.komarov)
        return np.concatenate([np.ravel(model.call(f, *state)) for f in functions])

    for lam in (0.7 + 2.9j, -0.1 + 4.0j, 2.5 + 1.4j):
        mu = eigenvalues(model, z, lam)[0]
        new, _ = model.call(model.system.pairs.pair, *z, lam=np.complex128(lam), mu=mu)
        assert abs(values(new) - values(z)).max() < 1e-13 * (1 + abs(values(z)).max())
        assert abs(new[1] - z[1]).max() > 1e-3


def test_projectors_of_the_pencil() -> None:
    """Of nu b + m - mu S, for the four branches next to nu."""
    model, state = case("so(4), Sokolov's terms, rotor")
    z, lam = tuple(model.state(**state).values()), 0.7 + 2.9j
    S = np.diag(np.concatenate(komarov.forms(*(model.params[k] for k in ("kappa", "beta")))))
    L = model.call(model.system.pairs.matrix, *z, lam=lam)
    assert (np.diag(model.call(model.system.pairs.metric)) == S).all()
    for mu in eigenvalues(model, z, lam)[:4]:
        Pi = model.call(model.system.pairs.projector, *z, lam=lam, mu=mu)
        assert abs((L - mu * S) @ Pi).max() < 1e-13
        assert abs(Pi @ (L - mu * S)).max() < 1e-13
        assert abs(np.trace(S @ Pi) - 1) < 1e-14


@pytest.mark.filterwarnings("ignore::kreisel.ConservationWarning")
@pytest.mark.parametrize("mutant", ["rotor", "kappa", "turn"])
def test_mutants_of_the_maps(mutant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model, state = case("so(4), Sokolov's terms, rotor")
    record, changed = model.system.pairs, {"rotor": "gamma", "kappa": "kappa"}.get(mutant)

    def pair(M: Any, P: Any, *, kappa: Any, beta: Any, c: Any, gamma: Any, lam: Any, mu: Any) -> Any:
        values = {"kappa": kappa, "beta": beta, "c": c, "gamma": gamma}
        values |= {} if changed is None else {changed: 0 * values[changed]}
        return record.pair(M, P, **values, lam=lam, mu=mu)

    if changed is None:
        tangent = komarov.tangent
        monkeypatch.setattr(komarov, "tangent", lambda *numbers: -tangent(*numbers))
    system = replace(model.system, pairs=replace(record, pair=pair))
    assert off(system(**model.params), state, 0.25, 4, project=False) > 1e-3


def test_what_is_refused() -> None:
    state = {"M": (0.3, 0.5, 1.1), "P": (0.6, 0.0, 0.8)}
    with pytest.raises(kr.InputError, match=r"expected kappa beta\^2 < 1"):
        kr.simulate(kr.Komarov(kappa=1.0, beta=1.1), state, dt=0.1, steps=1, method="exact")
    with pytest.raises(kr.InputError, match="has no orientation"):
        kr.simulate(kr.Komarov(), state, dt=0.1, steps=1, orientation=(1, 0, 0, 0))


def test_lanes_with_a_bracket_each() -> None:
    """Lanes on e(3), so(4) and so(3,1): each is its single run."""
    kappas, state = (0.0, -0.4, 0.4), case("e(3)")[1]
    run = kr.simulate(kr.Komarov(kappa=kappas, gamma=0.3), state, dt=0.3, steps=10, every=10, method="exact")
    for i, kappa in enumerate(kappas):
        single = kr.simulate(kr.Komarov(kappa=kappa, gamma=0.3), state, dt=0.3, steps=10, every=10, method="exact")
        assert abs(run.M.values[-1, i] - single.M.values[-1]).max() < 1e-14
        assert abs(run.casimir.values[:, i] - single.casimir.values).max() < 1e-14


def test_beside_another_body_the_bracket_keeps_its_parameter() -> None:
    """A product: its tensor and Casimirs need kappa; the force acts on the other body only."""
    (one, state), vector = case("so(4), rotor"), (0.6, 0.0, 0.8)
    both = kr.perturbed([one, kr.KovalevskayaTopE3()], potential=lambda P2: 0.3 * P2[1])
    start = {f"{k}1": v for k, v in state.items()} | {"M2": (0.3, 0.5, 1.1), "P2": vector}
    run = kr.simulate(both, start, dt=0.05, steps=40, every=40, method="dop853")
    single = kr.simulate(one, state, dt=0.05, steps=40, every=40, method="dop853")
    assert abs(run.P1 - single.P).max() < 1e-7
    assert abs(run.casimir - run.casimir[0]).max() < 1e-7
    assert abs(run.casimir[0, :2] - single.casimir[0]).max() < 1e-14


@pytest.mark.parametrize("name", ["steklov-lyapunov", "komarov"])
def test_the_way_back_in_time_with_products_of_momenta(name: str) -> None:
    """As the message about a negative dt states: the complete state, and parameters of odd terms, change sign."""
    odd = {"c": 1.0, "gamma": 0.2} if name == "komarov" else {}
    even = {"kappa": 0.1, "beta": 0.5} if odd else {"b": (1, 2, 3), "s": 1.0, "l": 0.5}
    there, back = (REGISTRY[name](**even, **{k: sign * v for k, v in odd.items()}) for sign in (1, -1))
    start, options = {"M": (1, 2, -0.5), "P": (0.3, 0.2, 0.1)}, {"dt": 0.1, "steps": 10, "method": "dop853"}
    run = kr.simulate(there, start, **options)
    again = kr.simulate(back, {k: -run[k].values[-1] for k in start}, **options)
    assert all(again[k].values[-1] == pytest.approx(-np.array(v), abs=1e-8) for k, v in start.items())
