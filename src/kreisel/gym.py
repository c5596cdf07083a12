"""Environments of reinforcement learning: the extra `gym` (gymnasium).

import kreisel as kr

satellite = kr.physical.Satellite.cubesat(kr.physical.Orbit.circular("500 km"))
envs = kr.gym.Attitude(512, satellite, limit="0.1 mN m", every="1 s", duration="2 min")
seen, info = envs.reset(seed=1)
seen, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.forces.control import COMMANDS
from kreisel.forces.kicks import WHEELS
from kreisel.physical import Control, Satellite
from kreisel.physical.measures import attitude_quaternion, si_number, si_numbers
from kreisel.runs.propagation.of_body import propagator
from kreisel.runs.settings import within

try:
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise InputError(f"kr.gym needs gymnasium: pip install 'kreisel[gym]'. {error}") from error

__all__ = ["Attitude"]
ACTUATORS = ("torque", "wheel_torque", "dipole")
Start = tuple[Array, dict[str, Any]]
MOST, FIELD = 1_000_000, 5e-5  # lanes; T, about the largest field in a low orbit


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
        if not isinstance(satellite, Satellite) or satellite.control is not None:
            raise InputError(f"satellite: expected a Satellite without a controller, got {shown(satellite)}.")
        if actuator not in ACTUATORS or (actuator == "wheel_torque") > (satellite.wheels is not None):
            allowed = f"one of {', '.join(ACTUATORS)}, the second for a satellite with wheels"
            raise InputError(f"actuator: expected {allowed}, got {shown(actuator)}.")
        self.num_envs, self.reward = within(num_envs, "num_envs", 1, MOST), reward
        self.target = attitude_quaternion(target, "target")
        asked = {"limit": COMMANDS[actuator], "rates": "rad/s", "every": "s", "duration": "s"}
        values = zip((limit, rates, every, duration), asked.items(), strict=True)
        self.limit, self.rates, self._period, end = (si_number(x, unit, k, positive=True) for x, (k, unit) in values)
        self._steps, self._stored = round(end / self._period), self.limit * end  # N m s
        if self._steps < 1:
            raise InputError(f"duration: expected every = {self._period:g} s or more, got {end:g} s.")
        wheels, sees = 0 if satellite.wheels is None else len(satellite.wheels.axes), actuator == "dipole"
        self._size = wheels if actuator == "wheel_torque" else 3
        self._body = replace(satellite, control=_control(actuator, self._size, self._period))
        self._motion = propagator(self._body, dt=every if dt is None else dt, orientation=True)
        self.single_observation_space = Box(-np.inf, np.inf, (7 + wheels + 3 * sees,), np.float64)
        self.single_action_space = Box(-1.0, 1.0, (self._size,), np.float64)
        spaces = self.single_observation_space, self.single_action_space
        self.observation_space, self.action_space = (batch_space(space, self.num_envs) for space in spaces)
        self._state, self._count = dict[str, Array](), 0

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Start:
        """New episodes in all lanes: the first observations, and an empty dict."""
        super().reset(seed=seed)
        turns, spins = (self.np_random.normal(size=(self.num_envs, count)) for count in (4, 3))
        start = {"attitude": algebra.unit(turns), "spin": spins * self.rates, **(options or {})}
        if len(start) > 2:
            raise InputError(f"options: expected attitude and spin, got {', '.join(map(str, options or ()))}.")
        momentum = si_numbers(start["spin"], "rad/s", "spin") @ self._body.inertia
        state = {"momentum": momentum, "attitude": attitude_quaternion(start["attitude"], "attitude")}
        if self._body.wheels is not None:
            state[WHEELS] = self._body.wheels.momenta
        self._count, lanes, command = 0, np.zeros((self.num_envs, 1)), np.zeros(self._size)
        self._state = {name: lanes + state.get(name, command) for name in self._motion.names}
        return self._observed(), {}

    def _observed(self) -> Array:
        """The observations of the state."""
        state, inverse = self._state, np.linalg.inv(self._body.inertia)
        error = algebra.quaternion_product(algebra.inverse_turn(self.target), state["attitude"])
        more = [state[name] / unit for name, unit in ((WHEELS, self._stored), ("seen", FIELD)) if name in state]
        rates = state["momentum"] @ inverse / self.rates
        return np.concatenate([np.where(error[:, :1] < 0, -error, error), rates, *more], -1)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """The observations after `every`, rewards, and whether episodes ended; after an end, a reset."""
        if not self._state:
            raise InputError("expected envs.reset() before envs.step(...), got none.")
        none = np.zeros(self.num_envs, dtype=bool)
        if self._count == self._steps:
            return self.reset()[0], np.zeros(self.num_envs), none, none, {}
        action = algebra.floats(actions)
        if action.shape != self.action_space.shape or not np.isfinite(action).all():
            expected = f"finite values of shape {self.action_space.shape}"
            raise InputError(f"actions: expected {expected}, got {shown(actions)}.")
        action = np.clip(action, -1.0, 1.0)
        begun, self._count = self._count * self._period, self._count + 1
        self._state = self._motion.to(self._state | {"command": action * self.limit}, self._count * self._period, begun)
        seen = self._observed()
        angle = 2 * np.arctan2(np.linalg.norm(seen[:, 1:4], axis=-1), seen[:, 0])
        reward = np.asarray(self.reward(angle, seen[:, 4:7], action), dtype=np.float64)
        return seen, reward, none, none | (self._count == self._steps), {}


def _control(actuator: str, size: int, period: float) -> Control:
    """A controller whose commands are in its memory, where the environment writes them; so is the field, if needed."""
    memory = {"command": np.zeros(size)}
    if actuator != "dipole":
        return Control(lambda command: {actuator: command, "command": command}, every=period, memory=memory)

    def law(field: Any, command: Any, seen: Any) -> dict[str, Any]:
        return {"dipole": command, "command": command, "seen": field}

    return Control(law, every=period, memory=memory | {"seen": np.zeros(3)})
