"""engine="large": kernels of O(n) a step against the definition, which they are recorded from."""

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import Array
from kreisel.engines import large, layout
from kreisel.engines.cpu import Kernel
from kreisel.engines.structured import Matrix
from kreisel.methods import Scheme, scheme
from kreisel.runs.plan import make_plan

DT = 0.1


def problem(name: str, n: int, lanes: tuple[int, ...] = ()) -> tuple[kr.model.Model, dict[str, Array]]:
    draw = np.random.default_rng(n)
    X, v, p = draw.normal(size=(*lanes, n, n)) / np.sqrt(n), draw.normal(size=(*lanes, n)), draw.normal(size=n)
    v, q = v / np.sqrt((v * v).sum(-1, keepdims=True)), draw.normal(size=(*lanes, n)) / np.sqrt(n)
    b = draw.uniform(0.1, 2, n)
    q = q - v * (v * q).sum(-1, keepdims=True)
    return {
        "lagrange-top": (kr.LagrangeTop(p=p), {"m": X - X.mT, "a": v}),
        "lagrange-top-moving": (kr.LagrangeTopMoving(A=p, alpha=0.7), {"M": X - X.mT, "P": v}),
        "symmetric-top": (kr.SymmetricTop(A=p), {"M": X - X.mT, "P": v}),
        "neumann": (kr.Neumann(b=b), {"x": v, "q": q}),
        "clebsch": (kr.Clebsch(b=b), {"M": X - X.mT, "P": v}),
    }[name]


def prepared(name: str, n: int, method: str, order: int) -> tuple[Scheme, tuple[Array, ...], Scheme, Kernel]:
    """The scheme by the definition and its start; the same in the form of the engine, and its kernel."""
    model, state = problem(name, n)
    x0 = tuple(state.values())
    dense = scheme(model, method, DT, order, False).on(x0)
    form = large.form_of(dense)
    assert form is not None
    own = form.on(dense, x0)
    start = layout.flatten(own.prepare(x0), [kind for _, kind in own.components])
    return dense, dense.prepare(x0), own, Kernel(own, start[None], large.Printer(form, dense))


CASES = [
    ("lagrange-top", 9, "suris", 1),
    ("lagrange-top", 10, "baecklund", 6),
    ("lagrange-top-moving", 10, "suris", 2),
    ("lagrange-top-moving", 4, "baecklund", 2),
    ("neumann", 9, "suris", 1),
    ("neumann", 10, "baecklund", 4),
]


@pytest.mark.parametrize(("name", "n", "method", "order"), CASES)
def test_kernel_is_the_definition(name: str, n: int, method: str, order: int) -> None:
    dense, z, own, kernel = prepared(name, n, method, order)
    for _ in range(30):
        z = dense.advance(*z)
    kernel.advance(np.empty((1, *kernel.z.shape)), 30)
    found = own.observe(layout.restore(kernel.z[0], [kind for _, kind in own.components], n))
    for letter, value in dense.observe(z).items():
        if own.outcomes[letter].kind == "state":
            assert abs(found[letter] - value).max() < 30 * n * np.finfo(float).eps * max(1, abs(value).max())


def test_a_wrong_solve_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: Woodbury's formula without its second term, in a step of which the first is most."""
    right = Matrix.record_solve
    monkeypatch.setattr(Matrix, "record_solve", lambda self, v: right(Matrix(self.n, self.diagonal, self.turn), v))
    dense, z, own, kernel = prepared("lagrange-top", 9, "suris", 1)
    kernel.advance(np.empty((1, *kernel.z.shape)), 1)
    found = own.observe(layout.restore(kernel.z[0], [kind for _, kind in own.components], 9))
    assert abs(found["a"] - dense.observe(dense.advance(*z))["a"]).max() > 1e-6


def test_which_steps_have_the_form() -> None:
    found = {}
    for name in ("lagrange-top", "lagrange-top-moving", "symmetric-top", "neumann", "clebsch"):
        for method in ("suris", "baecklund"):
            model, state = problem(name, 12)
            if method == "baecklund" and model.system.baecklund is None:
                continue
            plan = scheme(model, method, DT, 2, False).on(tuple(state.values()))
            found[name, method] = large.form_of(plan) is not None
    assert found.pop(("clebsch", "suris")) is False  # not the same in every basis
    assert found.pop(("clebsch", "baecklund")) is False
    assert found and all(found.values())


def test_runs_choose_it_and_keep_every_integral() -> None:
    model, state = problem("lagrange-top", 9)
    run = kr.simulate(model, model.state(**state), dt=DT, steps=20_000, every=200, method="suris", order=1)
    table = kr.drift(run)
    assert run.attrs["engine"] == "large"
    assert table.ratio[table.kept == True].max() < 4  # noqa: E712
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
    x0, told = model.state(**state), {"dt": DT, "method": "suris", "order": 1}
    whole = kr.simulate(model, x0, steps=60, every=4, **told)
    kr.simulate(model, x0, steps=30, every=4, path=tmp_path / "a.zarr", **told)
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
