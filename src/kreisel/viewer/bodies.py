"""Shapes to be drawn: a top about its point, an ellipsoid; triangles of two colours, so that a rotation is visible."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, axial, hat
from kreisel.record.model import Model

SECTORS, AROUND = 6, 36
TOP = (  # radius, height along the axis: peg, disc, handle
    (0.0, 0.0),
    (0.06, 0.16),
    (0.12, 0.30),
    (0.50, 0.50),
    (0.55, 0.56),
    (0.50, 0.62),
    (0.10, 0.70),
    (0.05, 0.78),
    (0.05, 0.95),
    (0.0, 1.0),
)
THINNEST = 0.12  # semi-axis to the longest


def gyration(model: Model, carried: Array) -> Array | None:
    """The tensor tr(I)/2 - I (3, 3) of the body's inertia I, from M -> Omega of the record; None where it is none."""
    try:
        columns = [axial(model.call(model.system.velocity, hat(e), carried)) for e in np.eye(3)]
        inertia = np.linalg.inv(np.stack(columns, -1))
    except (np.linalg.LinAlgError, ValueError, TypeError):
        return None
    inertia = (inertia + inertia.T) / 2
    return np.trace(inertia) / 2 * np.eye(3) - inertia if np.isfinite(inertia).all() else None


def _semi_axes(tensor: Array) -> tuple[Array, Array]:
    """Semi-axes, the longest 1, and their directions as columns of a rotation."""
    squares, axes = np.linalg.eigh(tensor)
    size = np.sqrt(np.maximum(squares, 0))
    size = np.maximum(size / (size.max() or 1.0), THINNEST)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return size, axes


def ellipsoid(tensor: Array | None, radius: float) -> tuple[dict[str, Any], Array]:
    """The ellipsoid with that gyration tensor, and its longest axis."""
    size, axes = _semi_axes(np.eye(3) if tensor is None else tensor)
    ring = [(np.sin(v), -np.cos(v)) for v in np.linspace(0, np.pi, 17)]
    points, faces, shade = _revolved(ring)
    return _mesh(radius * (points * size) @ axes.T, faces, shade), axes[:, int(size.argmax())]


def top(axis: Array, tensor: Array | None, length: float) -> dict[str, Any]:
    """A top about the point 0 along `axis`, its disc stretched as the inertia across the axis is."""
    third = axis / np.linalg.norm(axis)
    first = np.eye(3)[int(np.abs(third).argmin())]
    first = first - third * (first @ third)
    first /= np.linalg.norm(first)
    across = np.stack([first, np.cross(third, first)], -1)
    if tensor is not None:
        size, turn = np.linalg.eigh(across.T @ tensor @ across)
        size = np.sqrt(np.maximum(size, 0))
        across = across @ turn @ np.diag(np.maximum(size / (size.max() or 1.0), THINNEST)) @ turn.T
    points, faces, shade = _revolved(TOP)
    return _mesh(length * (points[:, :2] @ across.T + points[:, 2:] * third), faces, shade)


def _revolved(profile: Any) -> tuple[Array, Array, Array]:
    """Points, triangles and a shade 0 or 1 for each triangle of a surface of revolution about the third axis."""
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    points = [(r * np.cos(u), r * np.sin(u), z) for r, z in profile for u in angle]
    faces, shade = [], []
    for ring in range(len(profile) - 1):
        for i in range(AROUND):
            j = (i + 1) % AROUND
            a, b, c, d = (ring * AROUND + i, ring * AROUND + j, (ring + 1) * AROUND + i, (ring + 1) * AROUND + j)
            faces += [(a, b, d), (a, d, c)]
            shade += [(i * SECTORS // AROUND + (2 * ring >= len(profile) - 1)) % 2] * 2
    return np.array(points), np.array(faces), np.array(shade)


def _mesh(points: Array, faces: Array, shade: Array) -> dict[str, Any]:
    return {"points": np.round(points, 5).tolist(), "faces": faces.tolist(), "shade": shade.tolist()}
