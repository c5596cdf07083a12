"""Environments of reinforcement learning: the extra `gym` (gymnasium).

import kreisel as kr

satellite = kr.physical.Satellite.cubesat(kr.physical.Orbit.circular("500 km"))
envs = kr.gym.Attitude(512, satellite, limit="0.1 mN m", every="1 s", duration="2 min")
seen, info = envs.reset(seed=1)
seen, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
"""

from __future__ import annotations

from kreisel.errors import InputError

try:
    from kreisel.gym.attitude import Attitude
except ImportError as error:
    raise InputError(f"kr.gym needs gymnasium: pip install 'kreisel[gym]'. {error}") from error

__all__ = ["Attitude"]
