"""A small network learns to point CubeSats: policy gradient on `kr.gym.Attitude`, in NumPy.

Usage: python pointing_policy.py [ITERATIONS]

512 satellites of three units begin in any attitude, with rates of 1 degree a second, and have two minutes to reach the
target.  The gradient is that of REINFORCE, with the mean of all lanes as the baseline [Williams, Machine Learning 8
(1992) 229], and the optimizer is Adam [Kingma, Ba, arXiv:1412.6980].
"""

from __future__ import annotations

import sys
import time

import numpy as np

import kreisel as kr
from kreisel.physical import Orbit, Satellite

LANES, HIDDEN, NOISE, RATE, DISCOUNT = 512, 32, 0.3, 0.01, 0.95


def policy(weights: list[np.ndarray], seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The hidden layer, and the mean of the action: seen -> tanh -> linear."""
    inner, first, outer, second = weights
    hidden = np.tanh(seen @ inner + first)
    return hidden, hidden @ outer + second


def gradient(weights: list[np.ndarray], seen: np.ndarray, error: np.ndarray) -> list[np.ndarray]:
    """The derivatives of sum(error * mean) by the weights."""
    hidden, _ = policy(weights, seen)
    back = (error @ weights[2].T) * (1 - hidden**2)
    return [seen.T @ back, back.sum(0), hidden.T @ error, error.sum(0)]


def episode(envs: kr.gym.Attitude, weights: list[np.ndarray], rng: np.random.Generator, noise: float) -> tuple:
    """Observations, deviations of the actions from their means, and rewards, each (steps, lanes, ...)."""
    seen, _ = envs.reset()
    rows, end = [], False
    while not end:
        _, mean = policy(weights, seen)
        deviation = noise * rng.normal(size=mean.shape)
        after, reward, _, truncated, _ = envs.step(mean + deviation)
        rows.append((seen, deviation, reward))
        seen, end = after, truncated.all()
    return *(np.array(values) for values in zip(*rows, strict=True)), seen


def degrees(seen: np.ndarray) -> np.ndarray:
    """Angles to the target, from observations."""
    return np.degrees(2 * np.arctan2(np.linalg.norm(seen[:, 1:4], axis=-1), seen[:, 0]))


def main() -> None:
    iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    satellite = Satellite.cubesat(Orbit.circular("500 km", inclination="97.4 deg"), units=3)
    envs = kr.gym.Attitude(LANES, satellite, limit="0.3 mN m", every="2 s", duration="2 min", rates="1 deg/s")
    rng = np.random.default_rng(1)
    envs.reset(seed=1)
    width, size = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    weights = [0.3 * rng.normal(size=(width, HIDDEN)), np.zeros(HIDDEN), np.zeros((HIDDEN, size)), np.zeros(size)]
    moments = [[np.zeros_like(w), np.zeros_like(w)] for w in weights]
    begun = time.perf_counter()
    for k in range(1, iterations + 1):
        seen, deviation, reward, last = episode(envs, weights, rng, NOISE)
        future, after = np.zeros_like(reward), np.zeros(LANES)
        for step in reversed(range(len(reward))):
            future[step] = after = reward[step] + DISCOUNT * after
        advantage = (future - future.mean(1, keepdims=True)) / (future.std(1, keepdims=True) + 1e-9)
        error = (advantage[..., None] * deviation / NOISE).reshape(-1, size) / advantage.size
        slopes = gradient(weights, seen.reshape(-1, width), error)
        for weight, (mean, square), g in zip(weights, moments, slopes, strict=True):
            mean += 0.1 * (g - mean)
            square += 0.01 * (g * g - square)
            weight += RATE * (mean / (1 - 0.9**k)) / (np.sqrt(square / (1 - 0.99**k)) + 1e-12)
        if k == 1 or k % 10 == 0:
            print(
                f"{k:4}  reward {reward.sum(0).mean():8.1f}, at the end {np.median(degrees(last)):6.1f} deg off, median"
            )
    *_, last = episode(envs, weights, rng, 0.0)
    median, most = np.quantile(degrees(last), [0.5, 0.95])
    seconds = time.perf_counter() - begun
    print(f"without noise: median error {median:.2f} deg, 95 % below {most:.2f} deg; trained in {seconds:.0f} s")


if __name__ == "__main__":
    main()
