"""Kernels equal the definition; one lane equals a single run; the recorded arithmetic is exact in its foldings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel import algebra
from kreisel.contract import Frame
from kreisel.engines import cpu, layout
from kreisel.engines.cpu import Kernel, compiled_rate, flat_constants
from kreisel.engines.trace import Scalar, Tape, text
from kreisel.lab import exact
from kreisel.methods import Scheme, scheme
from kreisel.model import Model
from kreisel.systems import REGISTRY

MAPS = {name: system.map for name, system in REGISTRY.items() if system.map is not None}
FLOPS_TOLERANCE = 2.0**12 * float(np.finfo(float).eps)


def random_start(name: str, n: int, seed: int = 0) -> tuple[Model, tuple[np.ndarray, ...]]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, exact.random_state(REGISTRY[name].space, n, draw)


def first_scheme(model: Model, oriented: bool) -> Scheme:
    """The system's map itself."""
    symmetric = model.map.symmetric
    return scheme(model, "veselov" if symmetric else "suris", 0.1, 2 if symmetric else 1, oriented)


@pytest.mark.parametrize(("n", "oriented"), [(3, False), (3, True), (4, True), (5, False), (9, True)])
@pytest.mark.parametrize("name", MAPS)
def test_kernel_equals_definition(name: str, n: int, oriented: bool) -> None:
    model, x0 = random_start(name, n)
    if oriented:
        x0 += (np.array([1.0, 0, 0, 0]) if n == 3 else np.eye(n),)
    plan = first_scheme(model, oriented)
    kinds = [kind for _, kind in plan.components]
    kernel = Kernel(plan, layout.flatten(plan.prepare(x0), kinds)[None])
    out = np.empty((4, 1, kernel.z.shape[1]))
    kernel.advance(out, 2)
    z = plan.prepare(x0)
    for row in out:
        for _ in range(2):
            z = plan.advance(*z)
        flat = layout.flatten(z, kinds)
        assert abs(row[0] - flat).max() < FLOPS_TOLERANCE * (1 + abs(flat).max())


@pytest.mark.parametrize("n", [3, 4, 9])
@pytest.mark.parametrize("name", list(REGISTRY))
def test_compiled_rate_equals_flow(name: str, n: int) -> None:
    model, x0 = random_start(name, n)
    plan = scheme(model, "dop853", 0.1, None, True)
    kinds = [kind for _, kind in plan.components]
    state = (*x0, exact.random_rotation(n, exact.float_random(np.random.default_rng(1))))
    rate = compiled_rate(plan)(0.0, layout.flatten(state, kinds), flat_constants(plan, 1)[0][0])
    flow = layout.flatten(plan.rate(*state, **plan.constants), kinds)
    assert abs(rate - flow).max() < FLOPS_TOLERANCE * (1 + abs(flow).max())
    omega = model.call(model.system.velocity, *x0)
    turn = omega @ state[-1] if model.system.frame is Frame.REST else state[-1] @ omega
    assert abs(flow[-n * n :] - turn.ravel()).max() == 0


@pytest.mark.parametrize("name", MAPS)
def test_lane_equals_single_run_bitwise(name: str) -> None:
    starts = [random_start(name, 3, seed) for seed in range(3)]
    model = starts[0][0]
    plan = first_scheme(model, False)
    kinds = [kind for _, kind in plan.components]
    rows = np.stack([layout.flatten(plan.prepare(x), kinds) for _, x in starts])
    together = Kernel(plan, rows)
    out = np.empty((3, 3, rows.shape[1]))
    together.advance(out, 7)
    for lane, row in enumerate(rows):
        alone = np.empty((3, 1, rows.shape[1]))
        Kernel(plan, row[None]).advance(alone, 7)
        assert (alone[:, 0] == out[:, lane]).all()


def test_special_parameters_give_the_same_numbers_as_general_ones() -> None:
    """p = (0, 0, 1) is folded into the code; beside a lane with another p it is not."""
    top = REGISTRY["lagrange-top"]
    state = (algebra.hat(np.array([0.1, 0.2, 1.5])), np.array([0.6, 0, 0.8]))
    special = scheme(top(p=(0, 0, 1)), "suris", 0.05, 1, False)
    general = scheme(top(p=[(0, 0, 1), (0.3, 0.1, 0.7)]), "suris", 0.05, 1, False)
    row = layout.flatten(state, ["skew", "vector"])
    one, two = np.empty((50, 1, 6)), np.empty((50, 2, 6))
    Kernel(special, row[None]).advance(one, 1)
    Kernel(general, np.stack([row, row])).advance(two, 1)
    assert abs(one[:, 0] - two[:, 0]).max() < FLOPS_TOLERANCE


def test_source_is_kept_for_reading_and_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KREISEL_CACHE", str(tmp_path))
    source = f'"""Kernel number {tmp_path.name}."""\nVALUE = 7\n'
    assert cpu.load(source).VALUE == 7
    (kept,) = tmp_path.glob("kreisel_kernel_*.py")
    assert kept.read_text() == source
    assert cpu.load(source) is cpu.load(source)


def test_an_unwritable_cache_is_no_obstacle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("KREISEL_CACHE", str(blocked / "cache"))
    assert cpu.cache_folder().is_dir()


def test_foldings_are_exact() -> None:
    tape = Tape()
    x, y = Scalar(tape, "x"), Scalar(tape, "y")
    assert x + 0 is x
    assert x * 1 is x
    assert x * 0 == 0.0
    assert x - x == 0.0
    assert text(-1 * (-x)) == "x"
    assert text((y - x) + 0) == text(-(x - y))  # one difference, recorded once
    assert text((x + y) - x) != "y"  # round-off is not simplified away
    assert text(x * y) == text(y * x)
    assert text(-x * y) == text(-(x * y))
    assert len(tape.lines) == 4


def test_recorded_arithmetic_is_python_arithmetic() -> None:
    rng = np.random.default_rng(3)
    tape = Tape()
    u, v = Scalar(tape, "u"), Scalar(tape, "v")
    formulas = [
        lambda a, b: a / b - 2 / a + (-a) * b - 3,
        lambda a, b: (a - b) * (b - a) / -2 + (1 - a),
        lambda a, b: -(a * -1.5) - (-b) / a + a**3 - 0.25,
        lambda a, b: 0 - a + b * -1 + (-a - b) - (0 - (-b)),
    ]
    for formula in formulas:
        result = formula(u, v)
        for a, b in rng.normal(size=(5, 2)):
            known = {"u": a, "v": b}
            for line in tape.lines:
                exec(line.text, {}, known)
            assert eval(text(result), {}, known) == pytest.approx(formula(a, b), rel=1e-15, abs=1e-15)


def test_a_recorded_loop_is_the_loop() -> None:
    """Newton's square root of a: what does not vary stands before the loop, and names within end with it."""
    tape = Tape()
    a = Scalar(tape, "a")

    def improve(x: np.ndarray) -> tuple[np.ndarray, object]:
        new = (x + (a / 3 * 3) / x) / 2
        change = (new - x)[0]
        return new, change * change

    (root,), defect = a.record_loop(improve, np.array([1.0], dtype=object), 1e-20, 50)
    before, loop = tape.lines[:-1], tape.lines[-1]
    assert [line.text.split(" = ")[1] for line in before] == ["a / 3.0", "t1 * 3.0"]
    assert "for _ in range(50):" in loop.text
    known = {"a": 7.0}
    exec("\n".join(line.text for line in tape.needed([text(root * defect)])), {}, known)
    assert known[text(root)] == pytest.approx(np.sqrt(7.0), abs=1e-15)
    assert known[text(defect)] < 1e-20
    assert text(a / 3 * 3) == before[-1].names[0]
    assert tape.knows(f"{text(root)} + 1.0") is None
    with pytest.raises(TypeError, match="loop within a loop"):
        a.record_loop(lambda x: improve(a.record_loop(improve, x, 0.0, 2)[0]), np.array([1.0], dtype=object), 0.0, 2)


def test_stages_are_one_step_each() -> None:
    """A step of three stages is three steps with the constants of each, also one lane beside another."""
    model, x0 = random_start("lagrange-top", 3)
    plan = scheme(model, "suris", 0.1, 1, False)
    fractions = np.array([[0.1, 0.25, -0.05], [0.2, 0.05, 0.3]])
    fixed = {k: v for k, v in plan.constants.items() if k != "eps"}
    staged = replace(plan, constants=fixed, stages={"eps": fractions})
    row = layout.flatten(x0, ["skew", "vector"])
    kernel, out = Kernel(staged, np.stack([row, row])), np.empty((1, 2, 6))
    kernel.advance(out, 2)
    for lane, steps in enumerate(fractions):
        z = x0
        for eps in (*steps, *steps):
            z = plan.step(*z, **{**plan.constants, "eps": eps})
        assert abs(out[0, lane] - layout.flatten(z, ["skew", "vector"])).max() < FLOPS_TOLERANCE
    one = replace(plan, constants=fixed, stages={"eps": fractions[0]})
    z = one.advance(*x0)
    for eps in fractions[0][::-1]:
        z = model.call(model.map.inverse, *z, eps=eps)
    assert abs(layout.flatten(z, ["skew", "vector"]) - row).max() < FLOPS_TOLERANCE


def test_a_recorded_skew_matrix_is_not_exact() -> None:
    """Else kernels would lack the correction of the Cayley transform, a fault below every tolerance of equality."""
    tape = Tape()
    X = algebra.skew(np.array([Scalar(tape, name) for name in "xyz"], dtype=object), 3)
    assert not algebra.exact(X)
    assert algebra.exact(algebra.skew(np.array([1, 2, 3], dtype=object), 3))
