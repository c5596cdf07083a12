"""kr.gym.Attitude: satellites that an agent points at a target, as a vector environment of gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.forces.control import COMMANDS
from kreisel.forces.kicks import WHEELS
from kreisel.physical import Control, Satellite
from kreisel.physical.measures import attitude_quaternion, si_number, si_numbers
from kreisel.runs.propagation.of_body import propagator

ACTUATORS = ("torque", "wheel_torque", "dipole")
FIELD = 5e-5  # T, about the largest in a low orbit


def quadratic(angle: Array, rates: Array, action: Array) -> Array:
    """The usual reward of a step: -angle^2 - |rates|^2/10 - |action|^2/100; angle in rad, rates as observed."""
    return -(angle**2) - (rates**2).sum(-1) / 10 - (action**2).sum(-1) / 100


@explained
class Attitude(VectorEnv[Array, Array, Array]):
    """Satellites, one a lane, each of which an agent brings to rest at a target attitude.

    num_envs    lanes;  satellite: a `kr.physical.Satellite` without a controller, with wheels for "wheel_torque"
    actuator    "torque", "wheel_torque" or "dipole": an action, each entry in [-1, 1], is a multiple of `limit`
    limit       N m or A m^2, of each entry, or "0.1 mN m"
    every, dt   s between actions, for which an action is held, and the step, by default `every`
    duration    s, of an episode: then all lanes are truncated, and the next step resets them
    target      the attitude to reach, a unit quaternion (w, x, y, z), body to space
    rates       rad/s: the standard deviation of the rates at the start, whose attitudes are uniformly distributed
    reward      a function of (angle to the target in rad, rates as observed, action), each with an axis of lanes

    An observation is: the rotation from the target to the body, a quaternion with w >= 0 (4); the rates over `rates`
    (3), and, if there are any, the momenta of the wheels over those that `limit` gives in `duration`; for dipoles the
    field over 5e-5 T at the last sample (3): vectors along the body axes.  `reset(options={"attitude": ..., "spin":
    ...})` sets the start.  Time begins at 0 in every episode.  Raises `InputError`.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - of gymnasium

    def __init__(
        self,
        num_envs: int,
        satellite: Satellite,
        *,
        limit: Any,
        actuator: str = "torque",
        every: Any = 1.0,
        dt: Any = None,
        duration: Any = 300.0,
        target: Any = (1.0, 0.0, 0.0, 0.0),
        rates: Any = 0.02,
        reward: Callable[[Array, Array, Array], Array] = quadratic,
    ):
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise InputError(f"num_envs: expected a number of lanes, 1 or more, got {shown(num_envs)}.")
        if not isinstance(satellite, Satellite) or satellite.control is not None:
            raise InputError(f"satellite: expected a Satellite without a controller, got {shown(satellite)}.")
        if actuator not in ACTUATORS or (actuator == "wheel_torque") > (satellite.wheels is not None):
            raise InputError(
                f"actuator: expected one of {', '.join(ACTUATORS)}, the second for a satellite with wheels, got "
                f"{shown(actuator)}."
            )
        self.num_envs, self.reward, self.target = int(num_envs), reward, attitude_quaternion(target, "target")
        self.limit = si_number(limit, COMMANDS[actuator], "limit", positive=True)
        self.rates = si_number(rates, "rad/s", "rates", positive=True)
        times = {"every": every, "dt": dt or every, "duration": duration}
        period, step, end = (si_number(value, "s", name, positive=True) for name, value in times.items())
        self._substeps, self._steps, self._period = round(period / step), round(end / period), period
        if abs(self._substeps * step - period) > 1e-9 * period or self._steps < 1:
            raise InputError(
                f"dt, duration: expected dt = every / integer, duration >= every, got {step:g}, {end:g} s."
            )
        wheels = 0 if satellite.wheels is None else len(satellite.wheels.axes)
        self._size = size = wheels if actuator == "wheel_torque" else 3
        control = _control(actuator, size, period)
        self._body, self._memory = replace(satellite, control=control), control.memory
        self._motion = propagator(self._body, dt=step, orientation=True)
        self._stored = self.limit * end  # N m s
        self.single_observation_space = Box(-np.inf, np.inf, (7 + wheels + 3 * (actuator == "dipole"),), np.float64)
        self.single_action_space = Box(-1.0, 1.0, (size,), np.float64)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._state: dict[str, Array] = {}
        self._count = 0

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """New episodes in all lanes: the first observations, and an empty dict."""
        super().reset(seed=seed)
        asked = dict(options or {})
        turns = self.np_random.normal(size=(self.num_envs, 4))
        attitude = asked.pop("attitude", turns / np.linalg.norm(turns, axis=-1, keepdims=True))
        spin = asked.pop("spin", self.np_random.normal(size=(self.num_envs, 3)) * self.rates)
        if asked:
            raise InputError(f"options: expected attitude and spin, got {', '.join(map(str, asked))}.")
        start = {
            "momentum": si_numbers(spin, "rad/s", "spin") @ self._body.inertia,
            "attitude": attitude_quaternion(attitude, "attitude"),
            **self._memory,
            **({} if self._body.wheels is None else {WHEELS: self._body.wheels.momenta}),
        }
        self._count, lanes = 0, np.zeros((self.num_envs, 1))
        command = np.zeros(self._size)  # as it is held at the start
        self._state = {name: lanes + start.get(name, command) for name in self._motion.names}
        return self._observed(), {}

    def _observed(self) -> Array:
        """The observations of the state."""
        state, inverse = self._state, np.linalg.inv(self._body.inertia)
        error = algebra.quaternion_product(algebra.inverse_turn(self.target), state["attitude"])
        parts = [np.where(error[:, :1] < 0, -error, error), state["momentum"] @ inverse / self.rates]
        parts += [state[WHEELS] / self._stored] if WHEELS in state else []
        parts += [state["seen"] / FIELD] if "seen" in state else []
        return np.concatenate(parts, -1)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """The observations after `every`, rewards, and whether episodes ended; after an end, a reset."""
        if not self._state:
            raise InputError("expected envs.reset() before envs.step(...), got none.")
        none = np.zeros(self.num_envs, dtype=bool)
        if self._count == self._steps:
            return self.reset()[0], np.zeros(self.num_envs), none, none, {}
        action = algebra.floats(actions)
        if action.shape != self.action_space.shape or not np.isfinite(action).all():
            raise InputError(
                f"actions: expected finite values of shape {self.action_space.shape}, got {shown(actions)}."
            )
        action = np.clip(action, -1.0, 1.0)
        time = self._count * self._period
        self._state |= {"command": action * self.limit}
        self._state = self._motion.steps(self._state, self._substeps, time=time)
        self._count += 1
        seen = self._observed()
        angle = 2 * np.arctan2(np.linalg.norm(seen[:, 1:4], axis=-1), seen[:, 0])
        reward = np.asarray(self.reward(angle, seen[:, 4:7], action), dtype=np.float64)
        return seen, reward, none, none | (self._count == self._steps), {}


def _control(actuator: str, size: int, period: float) -> Control:
    """A controller whose commands are in its memory, where the environment writes them."""

    def law(command: Any) -> dict[str, Any]:
        return {actuator: command, "command": command}

    def seeing(field: Any, command: Any, seen: Any) -> dict[str, Any]:  # the field of the sample is kept
        return {**law(command), "seen": field}

    memory = {"command": np.zeros(size), **({"seen": np.zeros(3)} if actuator == "dipole" else {})}
    return Control(seeing if "seen" in memory else law, every=period, memory=memory)
