"""Environments of reinforcement learning (extra `gym`): envs = kr.gym.Attitude(512, satellite, limit="0.1 mN m")."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.algebra import Array, floats, inverse_turn, quaternion_product, unit
from kreisel.errors import InputError, explained, shown
from kreisel.forces.control import COMMANDS
from kreisel.physical import Control, Satellite
from kreisel.physical.measures import attitude_quaternion, convert_fields
from kreisel.runs.propagation.propagator import propagator
from kreisel.runs.settings import within

try:
    from gymnasium import spaces, vector
except ImportError as error:
    raise InputError(f"kr.gym needs gymnasium: pip install 'kreisel[gym]'. {error}") from error

ROUNDING = 1e-9  # relative, of the number of actions in an episode


@explained
@dataclass(eq=False, repr=False)
class Attitude(vector.VectorEnv[Array, Array, Array]):
    """Satellites, one a lane (`num_envs`), each of which an agent brings to rest at a target attitude.

    satellite   a `kr.physical.Satellite` without a controller, with wheels for "wheel_torque"
    actuator    "torque", "wheel_torque", "dipole": actions, entries in [-1, 1], are multiples of `limit`, N m or A m^2
    every, dt   s between actions, for which an action is held, and the step, by default `every`
    duration    s, of an episode, a multiple of `every`: then all lanes are truncated, and the next step resets them
    target      the attitude to reach, (w, x, y, z), body to space;  rates: rad/s, standard deviation at the start
    reward      a function of (angle to the target in rad, rates as observed, action), each with an axis of lanes

    An observation has the rotation from the target to the body, a quaternion with w >= 0 (4), the rates over `rates`
    (3), momenta of wheels over those that `limit` gives in `duration`, for dipoles the field over 5e-5 T at the last
    sample (3), the first one at the start, along the body axes.  `reset(options={"attitude": ..., "spin": ...})` sets
    the start at the time 0.
    """

    metadata = {"autoreset_mode": vector.AutoresetMode.NEXT_STEP}  # noqa: RUF012 - of gymnasium
    num_envs: int
    satellite: Satellite
    limit: Any
    actuator: str = "torque"
    every: Any = 1.0
    dt: Any = None
    duration: Any = 300.0
    target: Any = (1.0, 0.0, 0.0, 0.0)
    rates: Any = 0.02
    reward: Any = lambda angle, rates, action: -(angle**2) - (rates**2).sum(-1) / 10 - (action**2).sum(-1) / 100

    def __post_init__(self) -> None:
        body, name, self.target = self.satellite, self.actuator, attitude_quaternion(self.target, "target")
        if not isinstance(body, Satellite) or body.control is not None:
            raise InputError(f"satellite: expected a Satellite without a controller, got {shown(body)}.")
        wheels, sees = 0 if body.wheels is None else len(body.wheels.axes), name == "dipole"
        if not callable(self.reward):
            words = "a function of the angle, the rates and the action"
            raise InputError(f"reward: expected {words}, got {shown(self.reward)}.")
        if not (size := {"torque": 3, "wheel_torque": wheels, "dipole": 3}.get(name)):
            raise InputError(f"actuator: expected torque, dipole, or with wheels wheel_torque, got {shown(name)}.")
        convert_fields(self, positive=True, limit=COMMANDS[name], rates="rad/s", every="s", duration="s")
        steps = self.duration / self.every
        if abs(steps - round(steps)) > ROUNDING * steps:
            raise InputError(f"duration: expected a multiple of every = {self.every:g} s, got {self.duration:g} s.")
        counts = {"num_envs": self.num_envs, "duration over every": round(steps)}
        self.num_envs, self._steps = (within(count, key, 1, 10**6) for key, count in counts.items())
        laws: Any = (lambda command: {name: command, "command": command},)  # the memory has the actions
        laws += (lambda command, field: {name: command, "command": command, "seen": field},)
        memory = {"command": np.zeros(size)} | ({"seen": np.zeros(3)} if sees else {})
        self._body = replace(body, control=Control(laws[sees], every=self.every, memory=memory))
        self._motion = propagator(self._body, dt=self.every if self.dt is None else self.dt, orientation=True)
        self._state, self._units = dict[str, Array](), {"wheels": self.limit * self.duration, "seen": 5e-5}
        for key, most, count in (("observation", np.inf, 7 + wheels + 3 * sees), ("action", 1.0, size)):
            box = spaces.Box(-most, most, (count,), np.float64)
            self.__dict__[f"single_{key}_space"] = box
            self.__dict__[f"{key}_space"] = vector.utils.batch_space(box, self.num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """New episodes in all lanes: the first observations, and an empty dict."""
        super().reset(seed=seed)
        turns, spins = (self.np_random.normal(size=(self.num_envs, count)) for count in (4, 3))
        start = {"attitude": unit(turns), "spin": spins * self.rates, **(options or {})}
        state, self._count = self._motion.to(self._body.state(**start), 0.0), 0
        if wrong := {len(value) for value in state.values() if value.ndim > 1} - {1, self.num_envs}:
            raise InputError(f"options: expected values for one lane or {self.num_envs} lanes, got {min(wrong)}.")
        self._state = {name: np.zeros((self.num_envs, 1)) + value for name, value in state.items()}
        if "seen" in state:  # by the sample at 0
            self._state["seen"] = self._motion.to(self._state, self.every, 0.0)["seen"]
        return self._observed(), {}

    def _observed(self) -> Array:
        error = quaternion_product(inverse_turn(self.target), self._state["attitude"])
        rates = np.linalg.solve(self._body.inertia, self._state["momentum"].T).T / self.rates
        observed = [self._state[name] / unit for name, unit in self._units.items() if name in self._state]
        return np.concatenate([np.where(error[:, :1] < 0, -error, error), rates, *observed], -1)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Observations after `every`, rewards, and whether episodes ended; after an end, a reset."""
        none, action = np.zeros(self.num_envs, dtype=bool), np.clip(floats(actions), -1.0, 1.0)
        if not self._state:
            raise InputError("step: expected reset() before, which begins the episodes, got none. Call envs.reset().")
        if action.shape != (shape := self.action_space.shape):
            words = "a row for each lane, an entry for each axis, wheel or dipole"
            raise InputError(f"actions: expected the shape {shape}, {words}, got {action.shape}.")
        if len(rows := np.flatnonzero(np.isnan(action).any(-1))):
            got = f"{shown(action[rows[0]].tolist())} in lane {rows[0]}"
            raise InputError(f"actions: expected no NaN, got {got}. Usual cause: an agent that diverged.")
        if self._count == self._steps:
            return self.reset()[0], np.zeros(self.num_envs), none, none, {}
        state, begun, self._count = self._state, self._count * self.every, self._count + 1
        state |= {"command": action * self.limit}
        self._state = self._motion.to(state, self._count * self.every, begun)
        seen = self._observed()
        angle = 2 * np.arctan2(np.linalg.norm(seen[:, 1:4], axis=-1), seen[:, 0])
        reward = np.asarray(self.reward(angle, seen[:, 4:7], action), dtype=np.float64)
        if reward.shape != angle.shape or np.isnan(reward).any():
            got = "NaN" if reward.shape == angle.shape else f"the shape {reward.shape}"
            raise InputError(f"reward: expected a value for each lane, {angle.shape}, got {got}.")
        return seen, reward, none, none | (self._count == self._steps), {}
