"""Common mistakes of simulators, each tried on the motion of a check case: the one that explains a trajectory.

A trial predicts the quantities of `Case.quantities`: the exact motion seen in the wrong way (order of the quaternion,
units, axes, time), or wrong equations solved by DOP853, or schemes of first order at the step of the simulator.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.checkcases.exactly import exact as rational
from kreisel.checkcases.laws import FIELD, FREE, cross, quaternion_rate, rotation, times, to_body

if TYPE_CHECKING:
    from kreisel.checkcases.motion import Case

SIGNIFICANT = 1e-7  # relative: smaller errors need no explanation
FACTOR = 20  # by which a mistake must reduce the error
SURE = 1000  # beyond which no further mistakes are tried
SIMPLER = 2  # a later trial must be better by this factor: those in front are the simpler ones
TOLERANCE = 1e-11  # of DOP853
BEYOND = 1.1  # of the duration or of the last row: the end of solutions
MOST_PIECES = 10_000  # of DOP853
MOST_STEPS = 20_000  # of a scheme of first order; beyond, its error is proportional to the step
STEPS = 4000
REFINEMENTS = 5  # of the step
UNLIKE = 0.3  # of the square of the error, which a scheme of first order leaves at most at small errors
SMALL = 0.05  # relative error up to which it is taken to be proportional to the step
DEGREE = math.pi / 180

Quantities = Mapping[str, Array]
Trial = tuple[str, Quantities]
Flow = Callable[[list[float], list[float], list[float]], list[float]]  # w, q, x -> their rates


class Mistake(NamedTuple):
    """A mistake, the largest relative error of the trajectory with it, and that without it."""

    sentence: str
    residual: float
    error: float

    def __str__(self) -> str:
        return f"{self.sentence}. With this, the trajectory agrees to {self.residual:.1e}; without, to {self.error:.1e}"


def differences(name: str, value: Array, exact: Array) -> Array:
    """Errors (rows,) of a quantity: lengths, and for attitudes angles, rad."""
    if name != "attitude":
        return np.asarray(np.linalg.norm(value - exact, axis=-1) if value.ndim > 1 else abs(value - exact))
    q, p = (a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-300) for a in (value, exact))
    near = np.where((q * p).sum(-1, keepdims=True) < 0, -q, q)
    return np.asarray(4 * np.arcsin(np.minimum(np.linalg.norm(near - p, axis=-1) / 2, 1)))


def size(name: str, exact: Array) -> float:
    """The largest length of a quantity; 1 rad for attitudes."""
    return 1.0 if name == "attitude" else float(np.linalg.norm(exact.reshape(len(exact), -1), axis=-1).max()) or 1.0


def misfit(values: Quantities, predicted: Quantities, exact: Quantities) -> float:
    """The largest error of any quantity, relative to its size."""
    errors = [
        differences(name, value, predicted[name]).max() / size(name, exact[name]) for name, value in values.items()
    ]
    return float(max(errors)) if np.isfinite(errors).all() else math.inf


def likely(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Mistake | None:
    """The mistake that explains the errors of values at times (rows,), or None."""
    error = misfit(values, exact, exact)
    if error < SIGNIFICANT:
        return None
    best = None
    for trials in (_views, _clocks, _equations, _damped, _first_order):
        for sentence, predicted in trials(case, rows, values, exact, step):
            residual = misfit(values, predicted, exact)
            if residual * FACTOR < error and (best is None or residual * SIMPLER < best.residual):
                best = Mistake(sentence, residual, error)
                if residual * SURE < error:
                    return best
    return best


def _views(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Iterator[Trial]:
    """The exact motion in other orders, units, frames and axes."""
    w, space, q, L = (exact[name] for name in ("angular_velocity", "angular_velocity_space", "attitude", "momentum"))
    yield "the quaternion is (x, y, z, w), taken for (w, x, y, z)", {**exact, "attitude": np.roll(q, -1, -1)}
    yield "the quaternion is (w, x, y, z), taken for (x, y, z, w)", {**exact, "attitude": np.roll(q, 1, -1)}
    conjugate = q * [1, -1, -1, -1]
    yield "the attitude is conjugate: space to body in place of body to space", {**exact, "attitude": conjugate}
    for factor, sentence in (
        (1 / DEGREE, "the angular velocity is in deg/s, taken for rad/s"),
        (DEGREE, "the angular velocity is in rad/s, taken for deg/s"),
        (30 / math.pi, "the angular velocity is in rpm, taken for rad/s"),
    ):
        yield sentence, {**exact, "angular_velocity": w * factor, "angular_velocity_space": space * factor}
    if "position" in exact:
        yield "the position is in feet, taken for metres", {**exact, "position": exact["position"] / 0.3048}
    yield "the angular velocity is along the axes of space, not of the body", {**exact, "angular_velocity": space}
    yield "the angular velocity is along the axes of the body, not of space", {**exact, "angular_velocity_space": w}
    body = np.stack(to_body(np.moveaxis(q, -1, 0), np.moveaxis(L, -1, 0)), -1)
    yield "the momentum is along the axes of the body, not of space", {**exact, "momentum": body}
    vectors = [name for name, value in exact.items() if value.shape[1:] == (3,)]
    groups = {"axes": [*vectors, "attitude"], "axes of the angular velocity": vectors[:2], "axes of q": ["attitude"]}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            text = ", ".join("-" * (s < 0) + "xyz"[k] for k, s in zip(order, signs, strict=True))
            turned = {name: exact[name][:, order] * signs for name in vectors}
            turned["attitude"] = np.concatenate([q[:, :1], q[:, 1:][:, order] * signs], -1)
            for title, names in groups.items():
                if text != "x, y, z":
                    yield f"{title}: the components are ({text})", {**exact, **{n: turned[n] for n in names}}


def _clocks(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Iterator[Trial]:
    """The exact motion at other times."""
    spacing = float(np.median(np.diff(rows)))
    for shift in {spacing, step or spacing}:
        for sign, text in (
            (1, "late: row k has the state of row k + 1"),
            (-1, "early: row k has the state of row k - 1"),
        ):
            yield (
                f"the times are one step of {shift:g} s too {text}",
                case.quantities(_states(case, "", rows + sign * shift)),
            )
    for factor, text in (
        (60, "the times are in minutes, taken for seconds"),
        (1e-3, "the times are in milliseconds, taken for seconds"),
        (1 / 60, "the times are in seconds, taken for minutes"),
        (2, "the step of time is half of that of the motion"),
        (0.5, "the step of time is twice that of the motion"),
        (1 / DEGREE, "the rates of the start, in deg/s, are taken for rad/s by the equations"),
        (DEGREE, "the rates of the start, in rad/s, are taken for deg/s by the equations"),
    ):
        if rows[-1] * factor > BEYOND * float(case.duration):
            few = rows[:3]
            head = {name: value[: len(few)] for name, value in values.items()}
            before = {name: exact[name][: len(few)] for name in exact}
            if case.law is not FREE or few[-1] * factor > BEYOND * float(case.duration):
                continue
            predicted = case.quantities(_states(case, "", few * factor))
            if not misfit(head, predicted, before) * SIMPLER < misfit(head, before, before):
                continue
        yield text, case.quantities(_states(case, "", rows * factor))


def _equations(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Iterator[Trial]:
    """Solutions of wrong equations, or from a wrong start."""
    first = {name: value[:1] for name, value in values.items()}
    size_of = {name: value[:1] for name, value in exact.items()}
    for sentence, (_, start) in _wrong(case).items():
        begins = case.quantities(np.array([start]))
        if rows[0] > 0 or misfit(first, begins, size_of) < SMALL:
            yield sentence, case.quantities(_states(case, sentence, rows))


@cache
def _wrong(case: Case) -> dict[str, tuple[Flow, list[float]]]:
    """Sentence -> equations and start."""
    p, start = case.numeric(), [float(v) for v in (*case.angular_velocity, *case.attitude, *case.further)]
    flows = {
        "": _flow(case, p),
        "w x I w is left out: without a torque w stays constant": _flow(case, p, gyroscopic=0),
        "w x I w has the wrong sign": _flow(case, p, gyroscopic=-1),
        "the inertia tensor is kept constant in space, not turned with the body": _not_turned(case, p),
        "q' = q (0, w) lacks the factor 1/2": _flow(case, p, rate=lambda q, w: quaternion_rate(q, [2 * v for v in w])),
        "q' = q (0, w)/4 has the factor 1/2 twice": _flow(
            case, p, rate=lambda q, w: quaternion_rate(q, [v / 2 for v in w])
        ),
        "q' = -q (0, w)/2 has the wrong sign": _flow(case, p, rate=lambda q, w: quaternion_rate(q, [-v for v in w])),
        "q' = (0, w) q/2 is used with rates along the body axes": _flow(
            case, p, rate=lambda q, w: quaternion_rate(q, to_body(q, w))
        ),
        "q' = q (0, w)/2 is used with rates along the axes of space": _flow(
            case, p, rate=lambda q, w: quaternion_rate(q, times(rotation(q), w))
        ),
        **{sentence: _flow(case, _with(p, tensor)) for sentence, tensor in _tensors(case)},
    }
    if case.law is not FREE:
        flows["the torque is left out"] = _flow(case, p, torque=lambda w, q, x, p: [0.0, 0.0, 0.0])
        flows["the torque has the wrong sign: gravity, the field or the wheel in the other direction"] = _flow(
            case, p, torque=lambda w, q, x, p: [-v for v in case.law.torque(w, q, x, p)]
        )
    for axis, word in enumerate(("first", "second")):
        if case.law is FIELD:
            flows[f"gravity or the field is along the {word} axis of space, not the third"] = _flow(
                case, p, torque=lambda w, q, x, p, axis=axis: cross(p["k"], rotation(q)[axis])
            )
    out = {sentence: (flow, start) for sentence, flow in flows.items()}
    w, q, x = start[:3], start[3:7], start[7:]
    for sentence, begin in {
        "the rates of the start, in deg/s, are taken for rad/s": [*(v / DEGREE for v in w), *q, *x],
        "the rates of the start, in rad/s, are taken for deg/s": [*(v * DEGREE for v in w), *q, *x],
        "the rates of the start are taken along the axes of space": [*to_body(q, w), *q, *x],
        "the attitude of the start is left out": [*w, 1.0, 0.0, 0.0, 0.0, *x],
        "the attitude of the start is conjugate": [*w, q[0], -q[1], -q[2], -q[3], *x],
    }.items():
        if not np.allclose(begin, start, 1e-9, 1e-12):
            out[sentence] = flows[""], begin
    return out


def _flow(
    case: Case, p: Any, gyroscopic: float = 1, damping: float = 0, torque: Any = None, rate: Any = quaternion_rate
) -> Flow:
    """I w' = torque - gyroscopic w x I w - damping I w, with the rate of q."""
    torque = torque or case.law.torque

    def flow(w: list[float], q: list[float], x: list[float]) -> list[float]:
        m = times(p["I"], w)
        terms = zip(torque(w, q, x, p), cross(w, m), m, strict=True)
        push = [t - gyroscopic * g - damping * v for t, g, v in terms]
        return [*times(p["inverse"], push), *rate(q, w), *case.law.rates(w, q, x, p)]

    return flow


def _not_turned(case: Case, p: Any) -> Flow:
    moments, inverse = np.array(p["I"]), np.array(p["inverse"])

    def flow(w: list[float], q: list[float], x: list[float]) -> list[float]:
        R = np.array(rotation(q))
        constants = {**p, "I": (R.T @ moments @ R).tolist(), "inverse": (R.T @ inverse @ R).tolist()}
        return _flow(case, constants, torque=lambda w, q, x, _: case.law.torque(w, q, x, p))(w, q, x)

    return flow


def _with(p: Any, tensor: Array) -> dict[str, Any]:
    return {**p, "I": tensor.tolist(), "inverse": np.linalg.inv(tensor).tolist()}


def _tensors(case: Case) -> Iterator[tuple[str, Array]]:
    """Wrong inertia tensors."""
    tensor = np.array([[float(v) for v in row] for row in case.inertia])
    diagonal = np.diag(np.diag(tensor))
    for order in ((0, 2, 1), (2, 1, 0), (1, 0, 2), (1, 2, 0), (2, 0, 1)):
        text = ", ".join(str(k + 1) for k in order)
        yield f"the moments of inertia are those of the axes ({text})", tensor[np.ix_(order, order)]
    yield "the inverse of the inertia tensor is taken for the tensor", np.linalg.inv(tensor)
    if not np.array_equal(diagonal, tensor):
        yield "the products of inertia have the wrong sign", 2 * diagonal - tensor
        yield "the products of inertia are left out", diagonal
    if "principal_axes" in case.numbers:
        R = np.array([float(v) for v in rational(case.numbers["principal_axes"])]).reshape(3, 3)
        yield "the tensor is R^T diag R, the rotation matrix R transposed", R.T @ (R.T @ tensor @ R) @ R
    if case.arm is not None and "mass" in case.numbers:
        arm = np.array([float(v) for v in case.arm])
        steiner = float(rational(case.numbers["mass"])) * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        if np.linalg.eigvalsh(tensor - steiner)[0] > 0:
            yield "the inertia about the centre of mass is taken for that about the pivot", tensor - steiner
        yield "the term of Steiner is added twice to the inertia about the pivot", tensor + steiner


@cache
def _solution(case: Case, sentence: str, end: float) -> Callable[[Array], Array]:
    """The solution of wrong equations as a function of times, of one sign, up to the end."""
    return _solved(*_wrong(case)[sentence], end)


def _solved(flow: Flow, start: list[float], end: float) -> Callable[[Array], Array]:
    """States (rows, d) at times (rows,) by DOP853; NaN beyond the times that are reached."""
    from scipy.integrate import DOP853, OdeSolution

    def rates(t: float, z: Array) -> list[float]:
        state: list[float] = z.tolist()
        return flow(state[:3], state[3:7], state[7:])

    parts = start[:3], start[3:7], start[7:]
    scale = [max(1e-12, *map(abs, part)) for part in parts for _ in part]
    make: Any = DOP853
    solver = make(rates, 0.0, start, end, rtol=TOLERANCE, atol=TOLERANCE * np.array(scale))
    times, pieces = [0.0], list[Any]()
    with np.errstate(all="ignore"):
        while solver.status == "running" and len(pieces) < MOST_PIECES:
            solver.step()
            if solver.status != "failed":
                times.append(solver.t)
                pieces.append(solver.dense_output())
    solution = OdeSolution(times, pieces)

    def states(rows: Array) -> Array:
        reached = np.abs(rows) <= abs(times[-1])
        return np.where(reached[:, None], solution(rows).T, np.nan)

    return states


def _states(case: Case, sentence: str, rows: Array) -> Array:
    end = BEYOND * float(rows.max())
    after = _solution(case, sentence, end)(np.maximum(rows, 0))
    if rows.min() >= 0:
        return after
    before = _solution(case, sentence, -end)(np.minimum(rows, 0))
    return np.where((rows < 0)[:, None], before, after)


def _damped(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Iterator[Trial]:
    """A torque -c I w; c is fitted: first to the decay of the energy, then by least squares."""
    if "angular_velocity" not in values or rows[0] > 0:
        return
    p = case.numeric()
    energies = [np.einsum("ri,ij,rj->r", v, p["I"], v) for v in (values["angular_velocity"], exact["angular_velocity"])]
    with np.errstate(all="ignore"):
        ratio = np.log(energies[0] / energies[1])
    rate = -float((ratio * rows).sum() / (2 * (rows**2).sum()))
    if not math.isfinite(rate) or rate <= 0 or misfit_of_start(values, exact) > SMALL:
        return
    target, start = _stacked(values, values, exact), _wrong(case)[""][1]

    def predicted(c: float) -> Quantities:
        return case.quantities(_solved(_flow(case, p, damping=c), start, BEYOND * float(case.duration))(rows))

    for _ in range(3):
        at, near = (_stacked(values, predicted(c), exact) for c in (rate, rate * 1.001))
        slope = (near - at) / (rate * 0.001)
        rate += float(slope @ (target - at) / (slope @ slope))
        if not math.isfinite(rate) or rate <= 0:
            return
    yield f"the rates are damped: a torque -c L with c = {rate:.4g} 1/s", predicted(rate)


def misfit_of_start(values: Quantities, exact: Quantities) -> float:
    """The misfit of the first row."""
    first = {name: value[:1] for name, value in exact.items()}
    return misfit({name: value[:1] for name, value in values.items()}, first, first)


def _stacked(values: Quantities, chosen: Quantities, exact: Quantities) -> Array:
    """All components of the quantities of `values`, relative to their sizes, attitudes with the sign of the exact."""
    columns = []
    for name in values:
        column = chosen[name]
        if name == "attitude":
            column = column * np.where((column * exact[name]).sum(-1, keepdims=True) < 0, -1, 1)
        columns.append(column.ravel() / size(name, exact[name]))
    return np.concatenate(columns)


SCHEMES = {  # acceleration; whether w is kept along the axes of space in a step; whether q is turned by the new w
    "explicit Euler of w along the body axes, q by the old w": ("explicit", False, False),
    "explicit Euler of w along the axes of space, q by the old w": ("explicit", True, False),
    "explicit Euler of w, q by the new w": ("explicit", False, True),
    "implicit Euler of w, q by the new w": ("implicit", False, True),
    "q by w at the beginning of each step, the momentum exact": ("momentum", True, False),
    "q by w at the beginning of each step, w exact": ("exact", False, False),
    "q by w at the end of each step, w exact": ("exact", False, True),
}


def _first_order(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Iterator[Trial]:
    """Schemes of first order at the step, or at that part of the rows' spacing that fits best."""
    spacing = float(rows[-1] / (len(rows) - 1))
    if rows[0] != 0 or not np.allclose(rows, spacing * np.arange(len(rows)), atol=1e-4 * spacing):
        return
    truth = _stacked(values, exact, exact)
    error = _stacked(values, values, exact) - truth
    for name, scheme in SCHEMES.items():
        parts = round(spacing / step) if step else max(1, round(STEPS / len(rows)))
        for _ in range(0 if step else REFINEMENTS):
            slope = _stacked(values, case.quantities(_stepped(case, scheme, rows, parts)), exact) - truth
            small = (abs(error) < SMALL) & (abs(slope) < SMALL)
            ratio = float(slope[small] @ error[small] / max(slope[small] @ slope[small], 1e-300))
            rest = error[small] - ratio * slope[small]
            last = parts
            parts = round(parts / ratio) if ratio > 0 and rest @ rest < UNLIKE * (error[small] @ error[small]) else 0
            if parts in (0, last) or parts > MOST_STEPS / len(rows):
                break
        if 0 < parts <= MOST_STEPS / len(rows):
            sentence = f"a method of first order ({name}) at the step {spacing / parts:.4g} s"
            yield sentence, case.quantities(_stepped(case, scheme, rows, parts))


def _stepped(case: Case, scheme: tuple[str, bool, bool], rows: Array, parts: int) -> Array:
    """States (rows, d) of a scheme with `parts` steps in a row; further variables of the law are exact."""
    kind, in_space, late = scheme
    h, count = float(rows[-1] / (len(rows) - 1)) / parts, parts * (len(rows) - 1)
    p, right = case.numeric(), _states(case, "", h * np.arange(count + 1)).tolist()
    z = right[0]
    out, flow, law = [z], _flow(case, p), case.law
    for k in range(count):
        w, q, x = z[:3], z[3:7], right[k][7:]
        new = w if kind == "momentum" else [v + h * a for v, a in zip(w, flow(w, q, x), strict=False)]
        if kind == "exact":
            new = right[k + 1][:3]
        if kind == "implicit":
            for _ in range(50):
                last, new = new, [v + h * a for v, a in zip(w, flow(new, q, x), strict=False)]
                if max(abs(a - b) for a, b in zip(last, new, strict=True)) <= 1e-15 * max(map(abs, new)):
                    break
        turn = _turn([h * v for v in (new if late else w)])
        if kind == "momentum":
            m = [a + h * b for a, b in zip(times(p["I"], w), law.torque(w, q, x, p), strict=True)]
            new = times(p["inverse"], to_body(turn, m))
        elif in_space:
            new = to_body(turn, new)
        z = [*new, *_product(q, turn), *right[k + 1][7:]]
        if not all(map(math.isfinite, z)) or max(map(abs, new)) > 1e9:
            z = [math.nan] * len(z)
            out += [z] * (count - k)
            break
        out.append(z)
    return np.array(out[::parts])


def _turn(a: list[float]) -> list[float]:
    """The quaternion of the rotation by a vector of angles."""
    angle = math.hypot(*a)
    factor = math.sin(angle / 2) / angle if angle else 0.5
    return [math.cos(angle / 2), *(factor * v for v in a)]


def _product(q: list[float], r: list[float]) -> list[float]:
    """The product of quaternions."""
    turned = cross(q[1:], r[1:])
    scalar = q[0] * r[0] - sum(a * b for a, b in zip(q[1:], r[1:], strict=True))
    return [scalar, *(q[0] * r[i + 1] + r[0] * q[i + 1] + turned[i] for i in range(3))]
