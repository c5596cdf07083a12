"""The grader names a mistake that was made on purpose, by simulators of SciPy with rotation matrices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import kreisel as kr
from support import cross

Values = dict[str, np.ndarray]
ROWS = 61
BRICK, TOP, TILTED = "tumbling-brick", "kovalevskaya", "tilted-box"


class Body:
    """The numbers of a case as a user types them in."""

    def __init__(self, name: str):
        self.case = kr.checkcases.case(name)
        printed = self.case.given()
        self.w = np.array(printed["angular_velocity"])
        self.R = Rotation.from_quat(np.roll(printed["attitude"], -1)).as_matrix()
        self.I = np.array(printed["inertia"])
        self.arm, self.weight = (
            np.array(printed.get("arm", [0, 0, 0])),
            printed.get("mass", 0) * printed.get("gravity", 0),
        )
        self.down = np.array([0.0, 0, -1])
        self.times = self.case.times(ROWS)

    def torque(self, R: np.ndarray) -> np.ndarray:
        return cross(self.arm, R.T @ (self.weight * self.down))

    def acceleration(self, w: np.ndarray, R: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.I, self.torque(R) - cross(w, self.I @ w))

    def rotation_rate(self, w: np.ndarray, R: np.ndarray) -> np.ndarray:
        return R @ hat(w)

    def run(self, stretch: float = 1.0, later: float = 0.0) -> Values:
        def rates(t: float, z: np.ndarray) -> np.ndarray:
            w, R = z[:3], z[3:].reshape(3, 3)
            return np.concatenate([self.acceleration(w, R), self.rotation_rate(w, R).ravel()])

        rows, start = self.times * stretch + later, np.concatenate([self.w, self.R.ravel()])
        found = solve_ivp(rates, (0, rows[-1]), start, "DOP853", rows, rtol=1e-10, atol=1e-12)
        return values(found.y[:3].T, found.y[3:].T.reshape(-1, 3, 3))


def values(w: np.ndarray, R: np.ndarray) -> Values:
    return {"angular_velocity": w, "attitude": np.roll(Rotation.from_matrix(R).as_quat(), 1, -1)}


def hat(w: Any) -> np.ndarray:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def no_gyroscopic_term(b: Body) -> Values:
    b.acceleration = lambda w, R: np.linalg.solve(b.I, b.torque(R))
    return b.run()


def wrong_sign(b: Body) -> Values:
    b.acceleration = lambda w, R: np.linalg.solve(b.I, b.torque(R) + cross(w, b.I @ w))
    return b.run()


def not_turned(b: Body) -> Values:
    """w along the axes of space with a constant tensor."""

    def acceleration(w: np.ndarray, R: np.ndarray) -> np.ndarray:
        v = R @ w
        return R.T @ np.linalg.solve(b.I, R @ b.torque(R) - cross(v, b.I @ v))

    b.acceleration = acceleration
    return b.run()


def inertia(change: Callable[[Body], np.ndarray]) -> Callable[[Body], Values]:
    def made(b: Body) -> Values:
        b.I = change(b)
        return b.run()

    return made


def steiner(b: Body) -> np.ndarray:
    mass = b.case.given()["mass"]
    return mass * np.array([[b.arm @ b.arm * (i == j) - b.arm[i] * b.arm[j] for j in range(3)] for i in range(3)])


def rotation_rate(rate: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[Body], Values]:
    def made(b: Body) -> Values:
        b.rotation_rate = rate
        return b.run()

    return made


def of_output(change: Callable[[Values], Values]) -> Callable[[Body], Values]:
    def made(b: Body) -> Values:
        return change(b.run())

    return made


def in_space(v: Values) -> Values:
    R = Rotation.from_quat(np.roll(v["attitude"], -1, -1))
    return {**v, "angular_velocity": R.apply(v["angular_velocity"])}


def in_body(v: Values) -> Values:
    return {"angular_velocity_space": v["angular_velocity"], "attitude": v["attitude"]}


def changed(b: Body, **numbers: Any) -> Values:
    for name, value in numbers.items():
        setattr(b, name, value)
    return b.run()


def damped(b: Body) -> Values:
    right = b.acceleration
    b.acceleration = lambda w, R: right(w, R) - 0.003 * w
    return b.run()


def damped_only(b: Body) -> Values:
    """As engines have it: along the axes of space."""
    b.acceleration = lambda w, R: -0.04 * w
    run = in_space(b.run())
    return {"angular_velocity_space": run["angular_velocity"], "attitude": run["attitude"]}


def euler(late: bool, space: bool) -> Callable[[Body], Values]:
    """Euler's method with 20 steps a row, the rotation by Rodrigues' formula."""

    def made(b: Body) -> Values:
        w, R, parts = b.w, b.R, 20
        h, rows = b.times[1] / parts, [(b.w, b.R)]
        for k in range(1, parts * (ROWS - 1) + 1):
            new = w + h * b.acceleration(w, R)
            turned = R @ Rotation.from_rotvec(h * (new if late else w)).as_matrix()
            w, R = (turned.T @ R @ new if space else new), turned
            if k % parts == 0:
                rows.append((w, R))
        return values(np.array([w for w, _ in rows]), np.array([R for _, R in rows]))

    return made


def implicit(b: Body) -> Values:
    """Implicit Euler's method for w, with 10 steps a row."""
    w, R, h, rows = b.w, b.R, b.times[1] / 10, [(b.w, b.R)]
    for k in range(1, 10 * (ROWS - 1) + 1):
        w = fsolve(lambda new, w=w, R=R: new - w - h * b.acceleration(new, R), w, xtol=1e-13)
        R = R @ Rotation.from_rotvec(h * w).as_matrix()
        if k % 10 == 0:
            rows.append((w, R))
    return values(np.array([w for w, _ in rows]), np.array([R for _, R in rows]))


def of_momentum(b: Body) -> Values:
    """A free body whose momentum is constant in space, with 20 steps a row."""
    R, h, L, rows = b.R, b.times[1] / 20, b.R @ b.I @ b.w, [(b.w, b.R)]
    for k in range(1, 20 * (ROWS - 1) + 1):
        R = Rotation.from_rotvec(h * R @ np.linalg.solve(b.I, R.T @ L)).as_matrix() @ R
        if k % 20 == 0:
            rows.append((np.linalg.solve(b.I, R.T @ L), R))
    return values(np.array([w for w, _ in rows]), np.array([R for _, R in rows]))


def attitude_only(late: bool) -> Callable[[Body], Values]:
    """Exact w, the rotation in each of 20 steps a row by w at one of its ends."""

    def made(b: Body) -> Values:
        right, times = b.run(), b.times
        b.times = np.linspace(0, times[-1], 20 * (ROWS - 1) + 1)
        w = b.run()["angular_velocity"]
        R = [b.R]
        for k in range(len(w) - 1):
            R.append(R[-1] @ Rotation.from_rotvec(b.times[1] * w[k + late]).as_matrix())
        b.times = times
        return {**right, "attitude": values(w[::20], np.array(R[::20]))["attitude"]}

    return made


def faster(b: Body) -> Values:
    """Degrees taken for radians by the equations, of which the rates are printed in degrees again."""
    b.times = b.times[:5]
    return changed(b, w=np.degrees(b.w)) | {"angular_velocity": np.radians(b.run()["angular_velocity"])}


def slower(b: Body) -> Values:
    b.w = np.radians(b.w)
    run = b.run()
    return {**run, "angular_velocity": np.degrees(run["angular_velocity"])}


def earlier(b: Body) -> Values:
    """Rows k with the states of rows k - 1; the first by the motion backwards."""
    b.w = -b.w
    first = {name: value[1:2] for name, value in b.run().items()}
    b.w = -b.w
    right = b.run()
    return {
        "angular_velocity": np.concatenate([-first["angular_velocity"], right["angular_velocity"][:-1]]),
        "attitude": np.concatenate([first["attitude"], right["attitude"][:-1]]),
    }


def momentum(b: Body) -> Values:
    """Along the body axes."""
    return {"momentum": b.run()["angular_velocity"] @ b.I}


def position(b: Body) -> Values:
    return {"position": Rotation.from_quat(np.roll(b.run()["attitude"], -1, -1)).apply(b.arm) / 0.3048}


def mirrored(v: Values) -> Values:
    return {"angular_velocity": v["angular_velocity"] * [-1, 1, 1], "attitude": v["attitude"] * [1, -1, 1, 1]}


def swapped(v: Values) -> Values:
    return {**v, "angular_velocity": v["angular_velocity"][:, [0, 2, 1]]}


def degrees(v: Values) -> Values:
    return {**v, "angular_velocity": np.degrees(v["angular_velocity"])}


def upward(v: Values) -> Values:
    """In the space of an engine whose second axis points up."""
    turn = Rotation.from_euler("x", -90, degrees=True)
    return {**v, "attitude": (turn * Rotation.from_quat(v["attitude"], scalar_first=True)).as_quat(scalar_first=True)}


def left_handed(v: Values) -> Values:
    """Of a left-handed frame, right, up, forward, and from space to body."""
    return {
        "angular_velocity": -v["angular_velocity"][:, [0, 2, 1]],
        "attitude": v["attitude"][:, [0, 1, 3, 2]],
    }


def unnormalised(v: Values) -> Values:
    return {**v, "attitude": v["attitude"] * (1 + np.linspace(0, 0.02, ROWS))[:, None]}


TRANSPOSED = np.array([[0.6, -4 / 13, 48 / 65], [0.8, 3 / 13, -36 / 65], [0, 12 / 13, 5 / 13]])
MISTAKES = [
    (BRICK, no_gyroscopic_term, "w x I w is left out"),
    (TOP, no_gyroscopic_term, "w x I w is left out"),
    (BRICK, wrong_sign, "w x I w has the wrong sign"),
    (TOP, wrong_sign, "w x I w has the wrong sign"),
    (BRICK, not_turned, "constant in space, not turned"),
    (TOP, not_turned, "constant in space, not turned"),
    (BRICK, inertia(lambda b: b.I[np.ix_([1, 0, 2], [1, 0, 2])]), "belong to the axes (2, 1, 3)"),
    (TOP, inertia(lambda b: b.I[np.ix_([2, 1, 0], [2, 1, 0])]), "belong to the axes (3, 2, 1)"),
    (BRICK, inertia(lambda b: np.linalg.inv(b.I)), "inverse of the inertia tensor"),
    (TILTED, inertia(lambda b: np.linalg.inv(b.I)), "inverse of the inertia tensor"),
    (TILTED, inertia(lambda b: 2 * np.diag(np.diag(b.I)) - b.I), "products of inertia have the wrong sign"),
    (TILTED, inertia(lambda b: np.diag(np.diag(b.I))), "products of inertia are left out"),
    (TILTED, inertia(lambda b: TRANSPOSED.T @ np.diag([13, 10, 5]) @ TRANSPOSED / 1200), "R transposed"),
    (TOP, inertia(lambda b: b.I - steiner(b)), "about the centre of mass is taken for that about the pivot"),
    (TOP, inertia(lambda b: b.I + steiner(b)), "Steiner is added twice"),
    (BRICK, rotation_rate(lambda w, R: hat(w) @ R), "q' = (0, w) q/2"),
    (TOP, rotation_rate(lambda w, R: hat(w) @ R), "q' = (0, w) q/2"),
    (BRICK, rotation_rate(lambda w, R: R @ hat(R @ w)), "q' = q (0, w)/2 is used with rates along the axes of space"),
    (BRICK, rotation_rate(lambda w, R: 2 * R @ hat(w)), "lacks the factor 1/2"),
    (TOP, rotation_rate(lambda w, R: 2 * R @ hat(w)), "lacks the factor 1/2"),
    (BRICK, rotation_rate(lambda w, R: -R @ hat(w)), "q' = -q (0, w)/2"),
    (TOP, lambda b: changed(b, down=np.array([0.0, 0, 1])), "the torque has the wrong sign"),
    (TOP, lambda b: changed(b, down=np.array([0.0, -1, 0])), "along the second axis of space"),
    (TOP, lambda b: changed(b, weight=0), "the torque is left out"),
    (TOP, lambda b: changed(b, R=np.eye(3)), "attitude of the start is left out"),
    (TOP, lambda b: changed(b, R=b.R.T), "attitude of the start is conjugate"),
    (TOP, lambda b: changed(b, w=b.R.T @ b.w), "rates of the start are taken along the axes of space"),
    (BRICK, lambda b: changed(b, w=np.radians(b.w)), "in rad/s, are taken for deg/s"),
    (BRICK, lambda b: changed(b, w=np.degrees(b.w), times=b.times[:5]), "in deg/s, are taken for rad/s"),
    (BRICK, damped, "damped: a torque -c L, c = 0.003 1/s"),
    (TOP, damped, "damped: a torque -c L, c = 0.003 1/s"),
    (BRICK, damped_only, "w x I w is left out, and the rates are damped: a torque -c L, c = 0.04 1/s"),
    (BRICK, euler(late=False, space=False), "along the body axes, q by the old w) at the step 0.025 s"),
    (BRICK, euler(late=False, space=True), "along the axes of space, q by the old w) at the step 0.025 s"),
    (TOP, euler(late=True, space=True), "explicit Euler of w, q by the new w"),
    (BRICK, of_output(lambda v: {**v, "attitude": np.roll(v["attitude"], -1, -1)}), "(x, y, z, w), taken for"),
    (TOP, of_output(lambda v: {**v, "attitude": np.roll(v["attitude"], -1, -1)}), "(x, y, z, w), taken for"),
    (BRICK, of_output(lambda v: {**v, "attitude": v["attitude"] * [1, -1, -1, -1]}), "attitude is conjugate"),
    (TOP, of_output(lambda v: {**v, "attitude": v["attitude"] * [1, -1, -1, -1]}), "attitude is conjugate"),
    (BRICK, of_output(degrees), "in deg/s, taken for rad/s"),
    (TOP, of_output(degrees), "in deg/s, taken for rad/s"),
    (BRICK, of_output(in_space), "along the axes of space, not of the body"),
    (TOP, of_output(in_space), "along the axes of space, not of the body"),
    (BRICK, of_output(in_body), "along the axes of the body, not of space"),
    (BRICK, of_output(mirrored), "axes: the components are (-x, y, z)"),
    (TOP, of_output(swapped), "axes of the angular velocity: the components are (x, z, y)"),
    (BRICK, of_output(upward), "axes of space: the components are (x, z, -y)"),
    (TOP, of_output(upward), "axes of space: the components are (x, z, -y)"),
    (BRICK, of_output(left_handed), "axes: the components are (-x, -z, -y), and the attitude is conjugate"),
    (BRICK, of_output(unnormalised), "not normalised: its norm is off by up to 2.0e-02"),
    (TOP, of_output(unnormalised), "not normalised"),
    (BRICK, lambda b: b.run(later=b.times[1]), "each row has the state of one step of 0.5 s later"),
    (TOP, lambda b: b.run(later=b.times[1]), "later"),
    (BRICK, lambda b: {**b.run(), "attitude": earlier(b)["attitude"]}, "has the attitude of one step of 0.5 s earlier"),
    (BRICK, lambda b: {**b.run(later=b.times[1]), "attitude": b.run()["attitude"]}, "has the angular velocity of one"),
    (TOP, lambda b: {**b.run(later=b.times[1] / 2), "attitude": b.run()["attitude"]}, "velocity of half a step of"),
    (BRICK, lambda b: b.run(stretch=1e-3), "in milliseconds, taken for seconds"),
    (TOP, lambda b: b.run(stretch=0.5), "half as fast"),
    (BRICK, implicit, "implicit Euler of w, q by the new w) at the step 0.05 s"),
    (BRICK, of_momentum, "q by w at the beginning of each step, the momentum exact) at the step 0.025 s"),
    (BRICK, attitude_only(late=False), "q by w at the beginning of each step, w exact) at the step 0.025 s"),
    (BRICK, attitude_only(late=True), "q by w at the end of each step, w exact) at the step 0.025 s"),
    (BRICK, of_output(lambda v: {**v, "attitude": np.roll(v["attitude"], 1, -1)}), "(w, x, y, z), taken for"),
    (BRICK, of_output(lambda v: {"angular_velocity": np.radians(v["angular_velocity"])}), "in rad/s, taken for deg/s"),
    (TOP, position, "the position is in feet"),
    (BRICK, momentum, "the momentum is along the axes of the body"),
    (BRICK, of_output(lambda v: {**v, "attitude": v["attitude"] * [1, 1, 1, -1]}), "axes of q: the components"),
    (BRICK, earlier, "each row has the state of one step of 0.5 s earlier"),
    (BRICK, lambda b: changed(b, times=b.times / 60) and b.run(stretch=60), "in minutes, taken for seconds"),
    (BRICK, lambda b: b.run(stretch=1 / 60), "in seconds, taken for minutes"),
    (BRICK, lambda b: b.run(stretch=2), "twice as fast"),
    (BRICK, faster, "the equations read rates in deg/s as rad/s"),
    (BRICK, slower, "the equations read rates in rad/s as deg/s"),
    (BRICK, rotation_rate(lambda w, R: R @ hat(w) / 2), "q' = q (0, w)/4"),
    (TOP, lambda b: changed(b, down=np.array([-1.0, 0, 0])), "along the first axis of space"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "mistake", "sentence"), MISTAKES, ids=[f"{k}-{m[0]}" for k, m in enumerate(MISTAKES)])
def test_a_mistake_is_named(name: str, mistake: Callable[[Body], Values], sentence: str) -> None:
    body = Body(name)
    trajectory = mistake(body)
    grade = body.case.grade(body.times, **trajectory)
    assert grade.mistake, grade
    assert sentence in grade.mistake.sentence
    assert grade.mistake.residual * 20 < grade.mistake.error
    assert grade.mistake.sentence in str(grade)
