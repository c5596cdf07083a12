"""Rigid clouds of point masses under Newton's law: what extended bodies are judged by."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from support import cross, rotation_matrix

G = 6.67430e-11  # CODATA


def cloud(seed: int, mass: float, size: float) -> tuple[Any, Any]:
    """Masses and positions of a cloud about its centre of mass, along its principal axes."""
    draw = np.random.default_rng(seed)
    m = draw.uniform(0.5, 1.5, 7)
    x = draw.normal(size=(7, 3)) * (1.4, 1.0, 0.7)
    x -= m @ x / m.sum()
    x = x @ np.linalg.eigh(np.einsum("k,ki,kj->ij", m, x, x))[1]
    return m * mass / m.sum(), x * size


def newton(t: float, z: Any, clouds: Any) -> Any:
    """The rates of place, velocity, angular momentum and quaternion of each cloud, in an inertial frame."""
    rows = z.reshape(len(clouds), 13)
    arms = [x @ rotation_matrix(row[9:]).T for (_, x), row in zip(clouds, rows, strict=True)]
    pulls = [np.zeros_like(x) for x in arms]  # on each point
    for i, j in combinations(range(len(clouds)), 2):
        d = (rows[j, :3] + arms[j])[None] - (rows[i, :3] + arms[i])[:, None]
        pull = G * clouds[i][0][:, None, None] * clouds[j][0][:, None] * d / (d * d).sum(-1, keepdims=True) ** 1.5
        pulls[i] += pull.sum(1)
        pulls[j] -= pull.sum(0)
    rates = []
    for (m, _), y, row, pull in zip(clouds, arms, rows, pulls, strict=True):
        inertia, q = (m @ (y * y).sum(-1)) * np.eye(3) - np.einsum("k,ki,kj->ij", m, y, y), row[9:]
        w = np.linalg.lstsq(inertia, row[6:9])[0]
        turning = 0.5 * np.array([-w @ q[1:], *(q[0] * w + cross(w, q[1:]))])
        rates += [row[3:6], pull.sum(0) / m.sum(), sum(map(cross, y, pull)), turning]
    return np.concatenate(rates)


def integrated(first: Any, seconds: float, clouds: Any) -> Any:
    """The last rows by Newton's law from these first rows."""
    masses = np.array([m.sum() for m, _ in clouds])
    scale = 1e-13 * np.tile(np.maximum(abs(first).max(0), 1e-3), len(clouds))
    path = solve_ivp(newton, (0, seconds), first.ravel(), "DOP853", rtol=1e-12, atol=scale, args=(clouds,))
    rows = path.y[:, -1].reshape(first.shape)
    rows[:, :6] -= masses[:2] @ rows[:2, :6] / masses[:2].sum()  # the third body moves the barycentre
    return rows
