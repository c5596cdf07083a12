"""Common mistakes of simulators, each tried on the motion of a check case: the one that explains a trajectory.

A trial predicts the quantities of `Case.quantities`: the exact motion seen in the wrong way (order of the quaternion,
units, axes, time), wrong equations solved by DOP853, or a scheme of first order at the step of the simulator.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.checkcases.laws import FIELD, FREE, cross, exact as rational, quaternion_rate, rotation, times, to_body

if TYPE_CHECKING:
    from kreisel.checkcases.catalogue import Case

SIGNIFICANT = 1e-7  # relative: smaller errors need no explanation
FACTOR = 20  # by which a mistake must reduce the error
SURE = 1000  # beyond which no further mistakes are tried
SIMPLER = 2  # a later trial must be better by this factor: those in front are the simpler ones
EARLY = 3  # rows that decide whether a motion beyond the end of the case is worth its cost
TOLERANCE = 1e-11  # of DOP853
MOST_PIECES = 10_000  # of DOP853
BEYOND = 1.1  # of the duration or of the last row: the end of solutions
MOST_STEPS = 20_000  # of a scheme of first order
STEPS = 2000  # of the first try
TRIES = 6  # of the step
SMALL = 0.05  # relative error up to which it is taken to be proportional to the step
UNLIKE = 0.3  # of the square of a small error, which a scheme of first order leaves at most
LEAST = 1e-5  # decay of the rates for which damping is tried
DEGREE = math.pi / 180
RATES = ("angular_velocity", "angular_velocity_space", "momentum")

Quantities = Mapping[str, Array]
Trial = tuple[str, Quantities]
Flow = Callable[[list[float], list[float], list[float]], list[float]]  # w, q, x -> their rates


class Mistake(NamedTuple):
    """A mistake, the largest relative error of the trajectory with it, and without it."""

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


def misfit(values: Quantities, predicted: Quantities, exact: Quantities, rows: slice = slice(None)) -> float:
    """The largest error of any quantity, relative to its size; infinite if the prediction ends before."""
    errors = [differences(n, v[rows], predicted[n][rows]).max() / size(n, exact[n]) for n, v in values.items()]
    return float(max(errors)) if np.isfinite(errors).all() else math.inf


def body_rates(values: Quantities) -> Array | None:
    """The angular velocity along the body axes, from that in space and the attitude if need be; None if unknown."""
    if "angular_velocity" in values or not {"angular_velocity_space", "attitude"} <= set(values):
        return values.get("angular_velocity")
    q = values["attitude"] / np.linalg.norm(values["attitude"], axis=-1, keepdims=True)
    return np.stack(to_body(q.T, values["angular_velocity_space"].T), -1)


def likely(case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None) -> Mistake | None:
    """The mistake that explains the errors of values at times (rows,), or None."""
    error, best, trials = misfit(values, exact, exact), None, _Trials(case, rows, values, exact, step)
    stages = (trials.views, trials.clocks, trials.equations, trials.damped, trials.first_order)
    for stage in stages if error > SIGNIFICANT else ():
        for sentence, predicted in stage():
            residual = misfit(values, predicted, exact)
            if residual * FACTOR < error and (best is None or residual * SIMPLER < best.residual):
                best = Mistake(sentence, residual, error)
            if best and best.residual * SURE < error:
                return best
    return best


class _Trials:
    """The trials for a trajectory: times (rows,), s, its quantities, the exact ones, the step, s, if it is known."""

    def __init__(self, case: Case, rows: Array, values: Quantities, exact: Quantities, step: float | None):
        self.case, self.rows, self.values, self.exact, self.step = case, rows, values, exact, step
        self.spacing = float(rows[-1] - rows[0]) / (len(rows) - 1)

    def views(self) -> Iterator[Trial]:
        """The exact motion in other orders, units, frames and axes."""
        from scipy.spatial.transform import Rotation

        exact, rotations = self.exact, Rotation.from_quat(self.exact["attitude"], scalar_first=True)
        w, space, q = (exact[name] for name in ("angular_velocity", "angular_velocity_space", "attitude"))
        yield "the quaternion is (x, y, z, w), taken for (w, x, y, z)", {**exact, "attitude": np.roll(q, -1, -1)}
        yield "the quaternion is (w, x, y, z), taken for (x, y, z, w)", {**exact, "attitude": np.roll(q, 1, -1)}
        yield "the attitude is conjugate: it maps space to body", {**exact, "attitude": q * [1, -1, -1, -1]}
        for factor, text in ((1 / DEGREE, "deg/s, taken for rad/s"), (DEGREE, "rad/s, taken for deg/s")):
            rates = {"angular_velocity": w * factor, "angular_velocity_space": space * factor}
            yield f"the angular velocity is in {text}", {**exact, **rates}
        if "position" in exact:
            yield "the position is in feet, taken for metres", {**exact, "position": exact["position"] / 0.3048}
        yield "the angular velocity is along the axes of space, not of the body", {**exact, "angular_velocity": space}
        yield "the angular velocity is along the axes of the body, not of space", {**exact, "angular_velocity_space": w}
        body = np.stack(to_body(q.T, exact["momentum"].T), -1)
        yield "the momentum is along the axes of the body, not of space", {**exact, "momentum": body}
        vectors = [name for name, value in exact.items() if value.shape[1:] == (3,)]
        groups = {
            "axes": [*vectors, "attitude"],
            "axes of the angular velocity": vectors[:2],
            "axes of q": ["attitude"],
        }
        for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)):
            text = ", ".join("-" * (s < 0) + "xyz"[k] for k, s in zip(order, signs, strict=True))
            changed = {name: exact[name][:, order] * signs for name in vectors}
            changed["attitude"] = np.concatenate([q[:, :1], q[:, 1:][:, order] * signs], -1)
            if text == "x, y, z":
                continue
            for title, names in groups.items():
                yield f"{title}: the components are ({text})", {**exact, **{name: changed[name] for name in names}}
            conjugate = {**changed, "attitude": changed["attitude"] * [1, -1, -1, -1]}
            yield f"axes: the components are ({text}), and the attitude is conjugate", {**exact, **conjugate}
            if np.linalg.det(turn := np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0:
                turned = {name: changed[name] for name in vectors if name not in ("angular_velocity", "velocity")}
                turned["attitude"] = (Rotation.from_matrix(turn) * rotations).as_quat(scalar_first=True)
                yield f"axes of space: the components are ({text})", {**exact, **turned}

    def clocks(self) -> Iterator[Trial]:
        """The exact motion at other times."""
        end, rows = BEYOND * float(self.case.duration), self.rows
        shifts = sorted({self.spacing, self.step or self.spacing})
        for text, names, share in (
            ("state of one", [*self.exact], 1),
            ("attitude of one", ["attitude"], 1),
            ("angular velocity of one", RATES, 1),
            ("angular velocity of half a", RATES, 0.5),  # of a leapfrog
        ):
            for shift, (sign, word) in itertools.product(shifts, ((share, "later"), (-share, "earlier"))):
                moved = self.case.quantities(self._states("", rows + sign * shift))
                quantities = {**self.exact, **{name: moved[name] for name in names if name in moved}}
                yield f"each row has the {text} step of {shift:g} s {word}", quantities
        for factor, text in (
            (60, "the times are in minutes, taken for seconds"),
            (1e-3, "the times are in milliseconds, taken for seconds"),
            (1 / 60, "the times are in seconds, taken for minutes"),
            (2, "the motion is twice as fast as the times state"),
            (0.5, "the motion is half as fast as the times state"),
            (1 / DEGREE, "the equations read rates in deg/s as rad/s"),
            (DEGREE, "the equations read rates in rad/s as deg/s"),
        ):
            if rows[-1] * factor > end:
                few = slice(min(EARLY, int((rows * factor <= end).sum())))
                if self.case.law is not FREE or few.stop < 2:
                    continue
                predicted = self.case.quantities(self._states("", rows[few] * factor))
                if not SIMPLER * self.misfit(predicted, few) < self.misfit(self.exact, few):
                    continue
            yield text, self.case.quantities(self._states("", rows * factor))

    def equations(self) -> Iterator[Trial]:
        """Solutions of wrong equations, or from a wrong start, if the first row is that start."""
        for sentence, (_, start) in _wrong(self.case).items():
            if self.rows[0] > 0 or self.misfit(self.case.quantities(np.array([start])), slice(1)) < SMALL:
                yield sentence, self.case.quantities(self._states(sentence, self.rows))

    def damped(self) -> Iterator[Trial]:
        """A torque -c L; c is fitted, first to the decay of w I w, then by least squares."""
        rates = body_rates(self.values)
        if rates is None or self.rows[0] > 0 or self.misfit(self.exact, slice(1)) > SMALL:
            return
        constants, start = self.case.numeric(), _wrong(self.case)[""][1]
        with np.errstate(all="ignore"):
            decay = np.log(
                np.divide(
                    *(np.einsum("ri,ij,rj->r", w, constants["I"], w) for w in (rates, self.exact["angular_velocity"]))
                )
            )
        begin = -float((decay * self.rows).sum() / (2 * (self.rows**2).sum()))

        def predicted(gyroscopic: int, rate: float) -> Quantities:
            flow = _flow(self.case, constants, gyroscopic=gyroscopic, damping=rate)
            return self.case.quantities(_solved(flow, start, BEYOND * self.rows[-1])(self.rows))

        for gyroscopic, text in ((1, ""), (0, "w x I w is left out, and ")):
            rate = begin
            for _ in range(3 if begin > LEAST / self.rows[-1] else 0):
                at, near = (self._stacked(predicted(gyroscopic, c)) for c in (rate, rate * 1.001))
                slope = (near - at) / (rate * 0.001)
                rate = max(rate + float(slope @ (self._stacked(self.values) - at) / (slope @ slope)), begin / 2)
                yield f"{text}the rates are damped: a torque -c L, c = {rate:.4g} 1/s", predicted(gyroscopic, rate)

    def first_order(self) -> Iterator[Trial]:
        """Schemes of first order at the step, or at the integer part of the rows' spacing that fits best."""
        count = len(self.rows)
        if not np.allclose(self.rows, self.spacing * np.arange(count), atol=1e-4 * self.spacing):
            return
        truth = self._stacked(self.exact)
        error = self._stacked(self.values) - truth
        for name, scheme in SCHEMES.items():
            parts, last = round(self.spacing / self.step) if self.step else max(1, STEPS // count), 0
            for _ in range(0 if self.step else TRIES):
                if parts in (0, last) or parts * count > MOST_STEPS:
                    break
                trial = self._stacked(self.case.quantities(_stepped(self.case, scheme, self.rows, parts))) - truth
                small = (abs(error) < SMALL) & (abs(trial) < SMALL)
                ratio = float(trial[small] @ error[small] / max(trial[small] @ trial[small], 1e-300))
                missed = error[small] - ratio * trial[small]
                fits = ratio > 0 and missed @ missed < UNLIKE * (error[small] @ error[small])
                parts, last = max(1, round(parts / ratio)) if fits else 0, parts
            if 0 < parts * count <= MOST_STEPS:
                states = _stepped(self.case, scheme, self.rows, parts)
                text = f"a method of first order ({name}) at the step {self.spacing / parts:.4g} s"
                yield text, self.case.quantities(states)

    def misfit(self, predicted: Quantities, rows: slice) -> float:
        """The misfit of some rows."""
        return misfit(self.values, predicted, self.exact, rows)

    def _states(self, sentence: str, rows: Array) -> Array:
        after = _solution(self.case, sentence, BEYOND * float(rows[-1]))(np.maximum(rows, 0))
        if rows[0] >= 0:
            return after
        return np.where((rows < 0)[:, None], _solution(self.case, sentence, float(rows[0]))(np.minimum(rows, 0)), after)

    def _stacked(self, quantities: Quantities) -> Array:
        """All components relative to their sizes, attitudes with the sign of the exact ones."""
        columns = []
        for name, exact in self.exact.items():
            if name in self.values:
                column, flip = quantities[name], name == "attitude"
                signs = np.where((column * exact).sum(-1, keepdims=True) < 0, -1, 1) if flip else 1
                columns.append((column * signs).ravel() / size(name, exact))
        return np.concatenate(columns)


@cache
def _wrong(case: Case) -> dict[str, tuple[Flow, list[float]]]:
    """Sentence -> equations and start; the empty sentence has the right ones."""
    p, start = case.numeric(), [float(v) for v in (*case.angular_velocity, *case.attitude, *case.further)]

    def torque(sign: float) -> Any:
        return lambda w, q, x, p: [sign * v for v in case.law.torque(w, q, x, p)]

    def rate(turned: Callable[[list[float], list[float]], list[float]]) -> Flow:
        return _flow(case, p, rate=lambda q, w: quaternion_rate(q, turned(q, w)))

    flows = {
        "": _flow(case, p),
        "w x I w is left out: without a torque w stays constant": _flow(case, p, gyroscopic=0),
        "w x I w has the wrong sign": _flow(case, p, gyroscopic=-1),
        "the inertia tensor is kept constant in space, not turned with the body": _not_turned(case, p),
        "q' = q (0, w) lacks the factor 1/2": rate(lambda q, w: [2 * v for v in w]),
        "q' = q (0, w)/4 has the factor 1/2 twice": rate(lambda q, w: [v / 2 for v in w]),
        "q' = -q (0, w)/2 has the wrong sign": rate(lambda q, w: [-v for v in w]),
        "q' = (0, w) q/2 is used with rates along the body axes": rate(to_body),
        "q' = q (0, w)/2 is used with rates along the axes of space": rate(lambda q, w: times(rotation(q), w)),
        **{sentence: _flow(case, _with(p, tensor)) for sentence, tensor in _tensors(case)},
    }
    if case.law is not FREE:
        flows["the torque is left out"] = _flow(case, p, torque=torque(0))
        flows["the torque has the wrong sign: gravity, the field or the wheel in the other direction"] = _flow(
            case, p, torque=torque(-1)
        )
    for axis, word in enumerate(("first", "second") if case.law is FIELD else ()):
        flows[f"gravity or the field is along the {word} axis of space, not the third"] = _flow(
            case, p, torque=lambda w, q, x, p, axis=axis: cross(p["k"], rotation(q)[axis])
        )
    w, q, x = start[:3], start[3:7], start[7:]
    starts = {
        "the rates of the start, in deg/s, are taken for rad/s": [*(v / DEGREE for v in w), *q, *x],
        "the rates of the start, in rad/s, are taken for deg/s": [*(v * DEGREE for v in w), *q, *x],
        "the rates of the start are taken along the axes of space": [*to_body(q, w), *q, *x],
        "the attitude of the start is left out": [*w, 1.0, 0.0, 0.0, 0.0, *x],
        "the attitude of the start is conjugate": [*w, q[0], *(-v for v in q[1:]), *x],
    }
    moved = {text: (flows[""], z) for text, z in starts.items() if not np.allclose(z, start, 1e-9, 1e-12)}
    return {sentence: (flow, start) for sentence, flow in flows.items()} | moved


def _flow(case: Case, p: Any, **mistakes: Any) -> Flow:
    """The equations of a case with these options of `Law.flow`."""
    return lambda w, q, x: case.law.flow(w, q, x, p, **mistakes)


def _not_turned(case: Case, p: Any) -> Flow:
    def flow(w: list[float], q: list[float], x: list[float]) -> list[float]:
        R = np.array(rotation(q))
        constants = {**p, **{name: (R.T @ p[name] @ R).tolist() for name in ("I", "inverse")}}
        return case.law.flow(w, q, x, constants, torque=lambda w, q, x, _: case.law.torque(w, q, x, p))

    return flow


def _with(p: Any, tensor: Array) -> dict[str, Any]:
    return {**p, "I": tensor.tolist(), "inverse": np.linalg.inv(tensor).tolist()}


def _tensors(case: Case) -> Iterator[tuple[str, Array]]:
    """Wrong inertia tensors."""
    tensor = np.array(case.numeric()["I"])
    diagonal = np.diag(np.diag(tensor))
    for order in ((0, 2, 1), (2, 1, 0), (1, 0, 2), (1, 2, 0), (2, 0, 1)):
        text = ", ".join(str(k + 1) for k in order)
        yield f"the moments of inertia belong to the axes ({text})", tensor[np.ix_(order, order)]
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
    return _solved(*_wrong(case)[sentence], end)


def _solved(flow: Flow, start: list[float], end: float) -> Callable[[Array], Array]:
    """States (rows, d) at times (rows,) between 0 and the end by DOP853; NaN beyond those that are reached."""
    from scipy.integrate import DOP853, OdeSolution

    def rates(t: float, z: Array) -> list[float]:
        state: list[float] = z.tolist()
        return flow(state[:3], state[3:7], state[7:])

    scale = [max(1e-12, *map(abs, component)) for component in (start[:3], start[3:7], start[7:]) for _ in component]
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
    return lambda rows: np.where((np.abs(rows) <= abs(times[-1]))[:, None], solution(rows).T, np.nan)


SCHEMES = {  # acceleration; whether w is kept along the axes of space in a step; whether the new w rotates q
    "explicit Euler of w along the body axes, q by the old w": ("explicit", False, False),
    "explicit Euler of w along the axes of space, q by the old w": ("explicit", True, False),
    "explicit Euler of w, q by the new w": ("explicit", False, True),
    "implicit Euler of w, q by the new w": ("implicit", False, True),
    "q by w at the beginning of each step, the momentum exact": ("momentum", True, False),
    "q by w at the beginning of each step, w exact": ("exact", False, False),
    "q by w at the end of each step, w exact": ("exact", False, True),
}


def _stepped(case: Case, scheme: tuple[str, bool, bool], rows: Array, parts: int) -> Array:
    """States (rows, d) of a scheme with `parts` steps in a row; further variables of the law are exact."""
    kind, in_space, late = scheme
    count = parts * (len(rows) - 1)
    h, p = float(rows[-1]) / count, case.numeric()
    right = _solution(case, "", BEYOND * float(rows[-1]))(h * np.arange(count + 1)).tolist()
    out, flow = np.full((len(rows), len(right[0])), np.nan), _flow(case, p)
    out[0], w, q = right[0], right[0][:3], right[0][3:7]
    for k in range(count):
        x = right[k][7:]
        new = right[k + 1][:3] if kind == "exact" else [v + h * a for v, a in zip(w, flow(w, q, x), strict=False)]
        for _ in range(50 if kind == "implicit" else 0):
            last, new = new, [v + h * a for v, a in zip(w, flow(new, q, x), strict=False)]
            if max(abs(a - b) for a, b in zip(last, new, strict=True)) <= 1e-15 * max(map(abs, new)):
                break
        used = [h * v for v in (new if late else w)]
        angle = math.hypot(*used)
        if not angle < 1:
            break
        turn = [math.cos(angle / 2), *(v * math.sin(angle / 2) / (angle or 1) for v in used)]
        if kind == "momentum":
            m = [a + h * b for a, b in zip(times(p["I"], w), case.law.torque(w, q, x, p), strict=True)]
            new = times(p["inverse"], to_body(turn, m))
        w = to_body(turn, new) if in_space and kind != "momentum" else new
        q = [turn[0] * a + 2 * b for a, b in zip(q, quaternion_rate(q, turn[1:]), strict=True)]
        if (k + 1) % parts == 0:
            out[(k + 1) // parts] = [*w, *q, *right[k + 1][7:]]
    return out
