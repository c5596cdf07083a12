"""engine="large": kernels of O(n) and O(n^2) a step against the definition, which they are recorded from."""

from typing import Any

import numpy as np
import pytest

import kreisel as kr
import walks
from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels.large import forms, kernel as large
from kreisel.kernels.large.structured import Dense, Matrix, Vector
from kreisel.method import Scheme, scheme
from kreisel.method.scheme import Steps
from kreisel.record.model import Model
from kreisel.runs.planning import make_plan
from sizes import FULL
from support import cpu_engine

DT = 0.1


def problem(name: str, n: int, lanes: tuple[int, ...] = ()) -> tuple[Model, dict[str, Array]]:
    draw = np.random.default_rng(n)
    X, v, p = draw.normal(size=(*lanes, n, n)) / np.sqrt(n), draw.normal(size=(*lanes, n)), draw.normal(size=n)
    v, q = v / np.sqrt((v * v).sum(-1, keepdims=True)), draw.normal(size=(*lanes, n)) / np.sqrt(n)
    b = draw.uniform(0.1, 2, n)
    q = q - v * (v * q).sum(-1, keepdims=True)
    return {
        "lagrange-top": (kr.LagrangeTop(p=p, alpha=0.7), {"m": X - X.mT, "a": v}),
        "lagrange-top-moving": (kr.LagrangeTopMoving(A=p, alpha=0.7), {"M": X - X.mT, "P": v}),
        "symmetric-top": (kr.SymmetricTop(A=p), {"M": X - X.mT, "P": v}),
        "neumann": (kr.Neumann(b=b), {"x": v, "q": q}),
        "clebsch": (kr.Clebsch(b=b), {"M": X - X.mT, "P": v}),
    }[name]


def prepared(name: str, n: int, method: str, order: int) -> tuple[Scheme, tuple[Array, ...], Scheme, Any]:
    """The scheme by the definition and its start; the same in the form of the engine, and its kernel."""
    model, state = problem(name, n)
    x0 = tuple(state.values())
    dense = scheme(model, method, DT, order, False).on(x0)
    form = forms.form_of(dense)
    assert form is not None
    own = form.on(dense, x0)
    start = algebra.flatten(own.prepare(x0), [kind for _, kind in own.components])
    return dense, dense.prepare(x0), own, cpu_engine(own, start[None], form)


CASES = [
    ("lagrange-top", 9, "suris", 1),
    ("lagrange-top", 10, "baecklund", 6),
    ("lagrange-top-moving", 10, "suris", 2),
    ("lagrange-top-moving", 4, "baecklund", 2),
    ("neumann", 9, "suris", 1),
    ("neumann", 10, "baecklund", 4),
    ("clebsch", 10, "suris", 1),
    *[("clebsch", 9, "baecklund", 2)] * FULL,
]


@pytest.mark.parametrize(("name", "n", "method", "order"), CASES)
def test_kernel_is_the_definition(name: str, n: int, method: str, order: int) -> None:
    dense, z, own, kernel = prepared(name, n, method, order)
    for _ in range(30):
        z = dense.advance(*z)
    kernel.advance(np.empty((1, *kernel.z.shape)), 30)
    found = own.observe(algebra.restore(kernel.z[0], [kind for _, kind in own.components], n))
    for letter, value in dense.observe(z).items():
        if own.outcomes[letter].kind == "state":
            assert abs(found[letter] - value).max() < 30 * n * np.finfo(float).eps * max(1, abs(value).max())


def test_a_wrong_solve_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: Woodbury's formula without its second term, in a step of which the first is most."""
    right = Matrix.record_solve
    monkeypatch.setattr(Matrix, "record_solve", lambda self, v: right(Matrix(self.n, self.diagonal, self.turn), v))
    dense, z, own, kernel = prepared("lagrange-top", 9, "suris", 1)
    kernel.advance(np.empty((1, *kernel.z.shape)), 1)
    found = own.observe(algebra.restore(kernel.z[0], [kind for _, kind in own.components], 9))
    assert abs(found["a"] - dense.observe(dense.advance(*z))["a"]).max() > 1e-6


def after(steps: int, kernel: Any, own: Scheme, n: int) -> Array:
    """The entries i < j of M, and P, after some steps."""
    kernel.advance(np.empty((1, *kernel.z.shape)), steps)
    return kernel.z[0, : n * (n + 1) // 2].copy()


def spoiled_inverse(n: int = 10) -> tuple[float, float]:
    """How far 20 steps of Clebsch's map are from the definition, and W (I + eps/2 M) from 1, after W is spoiled."""
    dense, z, own, kernel = prepared("clebsch", n, "suris", 1)
    for k in range(40):
        z = dense.advance(*z)
        if k == 19:
            after(20, kernel, own, n)
            kernel.z[0, n * (n + 1) // 2 :] *= 1.01
    found = after(20, kernel, own, n)
    M = algebra.restore(found, ("skew", "vector"), n)[0]
    W = kernel.z[0, n * (n + 1) // 2 :].reshape(n, n)
    return abs(found - algebra.flatten(z, ("skew", "vector"))).max(), abs(
        W @ (np.eye(n) + DT / 2 * M) - np.eye(n)
    ).max()


def test_inverse_is_made_anew_when_the_residual_says_so() -> None:
    """At the start, when it is 0, and whenever it has become poor; the step is then done again."""
    off, lack = spoiled_inverse()
    assert off < 1e-14
    assert lack < 1e-13


def test_inverse_that_is_not_made_anew_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: no residual is too large once the start is over."""
    monkeypatch.setattr(large, "NEAR", 0.5)
    off, lack = spoiled_inverse()
    assert off > 1e-7
    assert lack > 1e-4


def test_inverse_that_does_not_follow_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: Woodbury's formula with a lost sign.  The residual sees it: steps stay right, by elimination."""
    right = Dense.change
    monkeypatch.setattr(Dense, "change", lambda *given: [(-x, r) for x, r in right(*given)])
    dense, z, own, kernel = prepared("clebsch", 10, "suris", 1)
    after(1, kernel, own, 10)
    M = algebra.restore(kernel.z[0, :55], ("skew", "vector"), 10)[0]
    W = kernel.z[0, 55:].reshape(10, 10)
    assert abs(W @ (np.eye(10) + DT / 2 * M) - np.eye(10)).max() > 1e-4
    for _ in range(3):
        z = dense.advance(*z)
    assert abs(after(2, kernel, own, 10) - algebra.flatten(z, ("skew", "vector"))).max() < 1e-14


def test_dense_momentum_in_runs(tmp_path) -> None:
    """Chosen by itself; every integral kept, lanes are single runs, a resumed run has the same bits."""
    model, state = problem("clebsch", 11, (2,))
    options = {"dt": DT, "every": 50, "method": "suris", "order": 1}
    both = kr.simulate(model, model.state(**state), steps=5000, **options)
    assert both.attrs["engine"] == "large"
    walks.assert_still(both)
    single = model.state(**{k: v[1] for k, v in state.items()})
    kr.simulate(model, single, steps=2500, path=tmp_path / "a.zarr", **options)
    longer = kr.resume(tmp_path / "a.zarr", extend=5000)
    for letter in ("M", "P", "energy_eps"):
        assert (longer[letter].values == both[letter].isel(lane=1).values).all()


CUT = [
    ("lagrange-top", 10, "baecklund", 4), ("neumann", 10, "suris", 1), ("clebsch", 17, "suris", 2),
    ("clebsch", 10, "baecklund", 2), ("clebsch", 4, "baecklund", 6), ("lagrange-top", 3, "exact", None),
    ("lagrange-top", 3, "variational", 4), ("clebsch", 3, "dop853", None),
    *[("lagrange-top", 10, "suris", 1), ("lagrange-top-moving", 10, "suris", 2), ("symmetric-top", 10, "baecklund", 2),
      ("clebsch", 10, "suris", 1), ("clebsch", 10, "baecklund", 4)] * FULL,
]  # fmt: skip


@pytest.mark.parametrize(("name", "n", "method", "order"), CUT)
def test_bits_do_not_depend_on_the_cut_into_calls(name: str, n: int, method: str, order: int | None) -> None:
    """Calls are cut by the clock: a run, the same resumed and one on a busy machine must agree."""
    model, state = problem(name, n)
    found = []
    for cuts in ([120], [60, 60], [1] * 120, [1, 2, 4, 8, 16, 32, 57]):
        plan = make_plan(
            model, model.state(**state), dt=DT, steps=120, every=1, method=method, order=order, orientation=None
        )
        for steps in cuts:
            out = np.empty((1, *plan.engine.z.shape))
            plan.engine.advance(out, steps)
        found.append(plan.engine.z.tobytes())
        assert (out[-1] == plan.engine.z).all()
    assert found == [found[0]] * 4


def oriented(name: str, n: int, steps: int = 30) -> tuple[dict[str, Array], dict[str, Array]]:
    """State and orientation by the definition and by the kernel."""
    model, state = problem(name, n)
    g = np.linalg.qr(np.random.default_rng(n + 1).normal(size=(n, n)))[0]
    g[:, 0] *= np.sign(np.linalg.det(g))
    x0 = (*state.values(), g)
    dense = scheme(model, "suris", DT, 1, True).on(x0)
    form = forms.form_of(dense)
    assert form is not None
    own, z = form.on(dense, x0), dense.prepare(x0)
    kinds = [kind for _, kind in own.components]
    kernel = cpu_engine(own, algebra.flatten(own.prepare(x0), kinds)[None], form)
    for _ in range(steps):
        z = dense.advance(*z)
    kernel.advance(np.empty((1, *kernel.z.shape)), steps)
    names = (*state, "g")
    both = dense.observe(z), own.observe(algebra.restore(kernel.z[0], kinds, n))
    right, found = ({name: values[name] for name in names} for values in both)
    return right, found


@pytest.mark.parametrize(("name", "n"), [("lagrange-top", 9), ("lagrange-top-moving", 10), ("symmetric-top", 9)])
def test_orientation_is_that_of_the_definition(name: str, n: int) -> None:
    right, found = oriented(name, n)
    for letter, value in right.items():
        assert abs(found[letter] - value).max() < 30 * n * np.finfo(float).eps * max(1, abs(value).max())


def test_a_lost_pair_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: the orientation's solve without its second pair, a ^ a'; the state does not have it."""
    right = Matrix._solved

    def first_pair(self: Matrix, v: Vector, pairs: list[Any]) -> Vector:
        return right(self, v, pairs[:1])

    monkeypatch.setattr(Matrix, "_solved", first_pair)
    wanted, found = oriented("lagrange-top", 9, 1)
    assert abs(found["a"] - wanted["a"]).max() < 1e-14
    assert abs(found["g"] - wanted["g"]).max() > 1e-6


def test_which_steps_have_the_form() -> None:
    found = {}
    for name in ("lagrange-top", "lagrange-top-moving", "symmetric-top", "neumann", "clebsch"):
        for method in ("suris", "baecklund"):
            model, state = problem(name, 12)
            if method == "baecklund" and model.system.baecklund is None:
                continue
            plan = scheme(model, method, DT, 2, False).on(tuple(state.values()))
            found[name, method] = forms.form_of(plan) is not None
    assert found and all(found.values())
    model, state = problem("clebsch", 12)
    for order in (4, 6):  # complex stages
        assert forms.form_of(scheme(model, "baecklund", DT, order, False).on(tuple(state.values()))) is None


def test_runs_choose_it_and_keep_every_integral() -> None:
    model, state = problem("lagrange-top", 9)
    run = kr.simulate(model, model.state(**state), dt=DT, steps=20_000, every=200, method="suris", order=1)
    assert run.attrs["engine"] == "large"
    walks.assert_still(run)
    with pytest.raises(kr.InputError, match="engine='large' needs"):
        still = kr.LagrangeTop(p=np.zeros(9))
        kr.simulate(still, still.state(**state), dt=DT, steps=1, engine="large")


def test_lane_is_the_single_run_and_a_longer_run_begins_the_same() -> None:
    model, states = problem("lagrange-top", 9, (3,))
    both = {}
    for lane in (None, 1):
        state = states if lane is None else {k: v[lane] for k, v in states.items()}
        both[lane] = kr.simulate(model, model.state(**state), dt=DT, steps=40, every=4, method="suris", order=1)
    for letter in ("m", "a", "energy_eps"):
        assert (both[None][letter].isel(lane=1).values == both[1][letter].values).all()


def test_resumed_run_has_the_same_bits(tmp_path) -> None:
    model, state = problem("lagrange-top", 9)
    x0, options = model.state(**state), {"dt": DT, "method": "suris", "order": 1}
    whole = kr.simulate(model, x0, steps=60, every=4, **options)
    kr.simulate(model, x0, steps=30, every=4, path=tmp_path / "a.zarr", **options)
    longer = kr.resume(tmp_path / "a.zarr", extend=60)
    assert longer.attrs["engine"] == "large"
    assert (longer.a.values == whole.a.values).all()


def test_planes_of_degenerate_and_vanishing_turns() -> None:
    """Equal theta, a kernel, and m = 0: the start comes back."""
    n = 9
    for m in (np.zeros((n, n)), np.kron(np.eye(3), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0.0]]))):
        top = kr.LagrangeTop(p=np.eye(n)[0] + np.eye(n)[4])
        x0 = top.state(m=m, a=np.eye(n)[1])
        plan = make_plan(top, x0, dt=DT, steps=1, every=1, method="suris", order=1, orientation=None)
        assert plan.where == "large"
        got = plan.observe(plan.engine.z[None])
        assert abs(got["m"][0] - m).max() < 1e-14
        assert abs(got["a"][0] - x0.a).max() < 1e-14


@pytest.mark.parametrize("n", [8, 9, 15])
def test_entries_beyond_the_last_do_not_count(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole vectors are summed: of x + 1 the places beyond the last entry are 1; the mutant counts them."""

    def step(x: Array) -> tuple[Array]:
        moved = x + 1.0
        return (x / (algebra.dot(moved, moved)),)

    plan = Scheme(
        name=f"a map of {n} entries",
        components=(("x", "vector"),),
        constants={},
        axes={},
        n=n,
        prepare=lambda z: z,
        observe=lambda z, only=None, /, **_: {"x": z[0]},
        outcomes={},
        reopen=lambda z: z,
        motion=Steps(step),
    )
    x = np.random.default_rng(n).normal(size=n)
    form = forms.form_of(plan)
    assert form is not None

    def off() -> float:
        engine = cpu_engine(form.on(plan, (x,)), x[None], form)
        engine.advance(np.empty((1, 1, n)), 1)
        return float(abs(engine.z[0] - x / ((x + 1) @ (x + 1))).max())

    assert off() < 1e-15
    monkeypatch.setattr(large._Lane, "_within", lambda self, k, value: value)
    monkeypatch.setattr(large, "NEAR", large.NEAR / 2)  # part of the kernel's key
    assert (off() > 1e-3) == (n % 8 > 0)


def test_constants_of_a_pair_are_those_of_arrays_where_a_state_is_too_long_for_a_graph() -> None:
    """n = 230: the entries of m alone are more than the operations that are compiled."""
    n, random = 230, np.random.default_rng(1)
    A, a = random.normal(size=(n, n)) / n, random.normal(size=n)
    top = kr.LagrangeTop(p=np.eye(n)[-1])
    state = top.state(m=A - A.T, a=a / np.linalg.norm(a))
    run = kr.simulate(top, state, dt=0.05, steps=3, method="baecklund", observe=["energy"])
    assert abs(run.energy.values / run.energy.values[0] - 1).max() < 1e-12
    assert abs(run.a.values[-1] - run.a.values[0]).max() > 1e-4  # it has moved
