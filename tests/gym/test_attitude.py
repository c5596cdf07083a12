"""kr.gym.Attitude: textbook rotations under torques, wheels and dipoles; the interface of gymnasium; a law."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.physical import Orbit, Satellite, Wheels

BUS = Satellite((0.02, 0.03, 0.04), Orbit.circular("500 km", inclination="60 deg"))
LANES, LIMIT = 4, 1e-4
AT_REST = {"attitude": (1.0, 0.0, 0.0, 0.0), "spin": (0.0, 0.0, 0.0)}


def environment(actuator: str = "torque", **more: Any) -> Any:
    usual = {"satellite": BUS, "limit": LIMIT, "actuator": actuator, "duration": 20.0, "rates": 0.02}
    return kr.gym.Attitude(**{"num_envs": LANES, **usual, **more})


def after(envs: Any, action: np.ndarray, steps: int) -> np.ndarray:
    envs.reset(options=AT_REST)
    for _ in range(steps):
        seen, *_ = envs.step(action)
    return seen


def test_a_torque_about_an_axis() -> None:
    """omega = tau t/I and theta = tau t^2/(2 I), but for the gravity gradient, below 1e-7 N m."""
    action = np.zeros((LANES, 3))
    action[:3] = np.eye(3)
    seen = after(environment(), action, 10)
    for k, moment in enumerate((0.02, 0.03, 0.04)):
        assert seen[k, 4 + k] * 0.02 == pytest.approx(LIMIT * 10 / moment, rel=2e-3)
        assert 2 * np.arcsin(seen[k, 1 + k]) == pytest.approx(LIMIT * 100 / 2 / moment, rel=2e-3)
    assert abs(seen[3, 1:]).max() < 1e-3
    assert (after(environment(), 5 * action, 10) == seen).all()  # beyond [-1, 1] it is clipped


def test_a_motor_turns_wheel_and_body_in_opposite_directions() -> None:
    envs = environment("wheel_torque", satellite=Satellite(BUS.inertia, BUS.orbit, wheels=Wheels(np.eye(3))))
    seen = after(envs, np.tile([0.0, 1.0, 0.0], (LANES, 1)), 10)
    assert seen[0, 7:] == pytest.approx([0, 10 / 20, 0], abs=1e-9)  # of what the limit gives in the episode
    assert seen[0, 4:7] * 0.02 == pytest.approx([0, -LIMIT * 10 / 0.03, 0], abs=1e-4)
    assert seen.shape[1] == 10


def test_a_dipole_in_the_field() -> None:
    """I omega' = m x B, with the field that is observed: 20 to 65 microtesla in a low orbit."""
    envs = environment("dipole", limit=1.0)
    seen = after(envs, np.tile([0.5, 0.0, -1.0], (LANES, 1)), 1)
    B = seen[0, 7:] * 5e-5
    assert 2e-5 < np.linalg.norm(B) < 6.5e-5
    rates = np.cross([0.5, 0.0, -1.0], B) / (0.02, 0.03, 0.04)
    np.testing.assert_allclose(seen[0, 4:7] * 0.02, rates, atol=0.01 * abs(rates).max())


def test_an_episode_begins_with_the_field() -> None:
    """20 to 65 microtesla in a low orbit, along the body axes: those of a run at its start."""
    envs = environment("dipole")
    spin, q = (0.01, -0.02, 0.015), np.array([0.5, 0.5, -0.5, 0.5])
    seen, _ = envs.reset(options={"attitude": q, "spin": spin})
    B = seen[:, 7:] * 5e-5
    assert (np.linalg.norm(B, axis=-1) > 2e-5).all() and (np.linalg.norm(B, axis=-1) < 6.5e-5).all()
    run = kr.simulate(BUS, BUS.state(spin=spin, attitude=q), dt=1.0, t_end=1.0, progress=False)
    np.testing.assert_allclose(B[0], kr.algebra.rotation_matrix(q).T @ run.field.values[0], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(seen[0, :4], q, atol=1e-15)


def test_lanes_move_as_single_runs() -> None:
    """A torque that does not change, against kr.simulate of a satellite that has it."""
    envs = environment(dt=0.5)
    spin, q = (0.01, -0.02, 0.015), np.array([0.5, 0.5, -0.5, 0.5])
    envs.reset(options={"attitude": q, "spin": spin})
    action = np.linspace(-1, 1, 12).reshape(LANES, 3)
    for _ in range(20):
        seen, *_ = envs.step(action)
    for lane in (0, LANES - 1):
        body = Satellite((0.02, 0.03, 0.04), BUS.orbit, torque=LIMIT * action[lane])
        run = kr.simulate(body, body.state(spin=spin, attitude=q), dt=0.5, t_end=20.0, progress=False)
        end = run.attitude.values[-1]
        np.testing.assert_allclose(seen[lane, :4], end * np.sign(end[0]), atol=1e-9)
        np.testing.assert_allclose(seen[lane, 4:7] * 0.02, run.angular_velocity.values[-1], atol=1e-9)


def test_the_interface_of_gymnasium() -> None:
    envs = environment(target=(0.0, 1.0, 0.0, 0.0))
    seen, info = envs.reset(seed=3)
    assert envs.observation_space.contains(seen) and info == {} and (seen[:, 0] >= 0).all()
    again, _ = environment(num_envs=float(LANES), target=(0.0, 1.0, 0.0, 0.0)).reset(seed=3)
    assert (seen == again).all() and not (envs.reset()[0] == seen).any()
    for k in range(20):
        seen, reward, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert truncated.tolist() == [k == 19] * LANES and not terminated.any() and (reward < 0).all()
    last = seen
    seen, reward, _, truncated, _ = envs.step(envs.action_space.sample())  # the next step resets, as gymnasium has it
    assert not truncated.any() and not reward.any() and not np.isclose(seen, last).all()
    bad = np.zeros((LANES, 3))
    bad[2, 1] = np.nan
    for action, said in ((bad[:, :2], rf"the shape \({LANES}, 3\).*got \({LANES}, 2\)"), (bad, r"no NaN.*in lane 2")):
        with pytest.raises(kr.InputError, match=f"^actions: expected {said}") as caught:
            envs.step(action)
        assert "reset" not in str(caught.value)


@pytest.mark.parametrize(("sign", "points"), [(-1, True), (1, False)])
def test_a_law_that_points(sign: int, points: bool) -> None:
    """Proportional and derivative; with the other sign it must not."""
    envs = environment(limit=3e-4, duration=120.0)
    seen, _ = envs.reset(seed=1)
    total = 0.0
    for _ in range(120):
        seen, reward, *_ = envs.step(sign * (4 * seen[:, 1:4] + 0.5 * seen[:, 4:7]))
        total += reward.mean()
    angle = np.degrees(2 * np.arctan2(np.linalg.norm(seen[:, 1:4], axis=-1), seen[:, 0]))
    assert bool(angle.max() < 2) is points and bool(total > -300) is points


def test_one_spin_or_one_attitude_for_all_lanes() -> None:
    """Rates and quaternions that are seen are those given."""
    envs, spin, attitude = environment(), (0.0, 0.004, -0.01), (0.8, 0.0, 0.6, 0.0)
    seen, _ = envs.reset(seed=3, options={"spin": spin})
    np.testing.assert_allclose(seen[:, 4:7] * 0.02, np.tile(spin, (LANES, 1)), rtol=1e-12, atol=1e-15)
    assert len(np.unique(seen[:, 0])) == LANES  # attitudes are random
    seen, _ = envs.reset(seed=3, options={"attitude": attitude})
    np.testing.assert_allclose(seen[:, :4], np.tile(attitude, (LANES, 1)), atol=1e-12)


@pytest.mark.parametrize(
    "options", [{"spin": np.ones((2, 3))}, {"spin": np.ones((2, 3)), "attitude": [(1, 0, 0, 0)] * 2}]
)
def test_options_of_other_lanes(options: dict[str, Any]) -> None:
    with pytest.raises(
        kr.InputError, match=r"do not fit: momentum \(2,\)|expected values for one lane or 4 lanes, got 2"
    ):
        environment().reset(options=options)


def test_a_reward_has_a_value_for_each_lane() -> None:
    for wrong, got in (
        (lambda *_: 0.0, "the shape"),
        (lambda angle, rates, _: rates, "the shape"),
        (lambda angle, *_: angle * np.nan, "NaN"),
    ):
        envs = environment(reward=wrong)
        envs.reset()
        with pytest.raises(kr.InputError, match=rf"reward: expected a value for each lane, \(4,\), got {got}"):
            envs.step(np.zeros((LANES, 3)))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"satellite": kr.physical.FreeBody((1, 2, 3))}, "a Satellite without a controller"),
        ({"actuator": "thruster"}, "expected torque, dipole, or"),
        ({"actuator": "wheel_torque"}, "with wheels wheel_torque"),
        ({"limit": "1 N"}, "limit must have the dimension of N m"),
        ({"dt": 0.3}, "dt"),
        ({"dt": 0}, "dt"),
        ({"reward": 3}, "^reward: expected a function of the angle, the rates and the action, got 3"),
        ({"duration": 0.1}, "duration"),
        ({"duration": 20.0, "every": 3.0}, "^duration: expected a multiple of every = 3 s, got 20 s"),
        ({"target": (1, 1, 0, 0)}, "target"),
    ],
)
def test_bad_input(options: dict[str, Any], said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        kr.gym.Attitude(**{"num_envs": 2, "satellite": BUS, "limit": LIMIT, **options})
    with pytest.raises(kr.InputError, match=r"^step: expected reset\(\) before"):
        environment().step(np.zeros((LANES, 3)))


def test_without_gymnasium(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("kreisel.gym")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.startswith("gymnasium")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(kr.InputError, match=r"kreisel\[gym\]"):
        __import__("kreisel.gym")
