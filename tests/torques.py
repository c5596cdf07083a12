"""Torques on a body of `kreisel.bodies`, as its record has them."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra


def torque_on(body: Any, g: np.ndarray, t: float, spin: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    """M' - M x Omega (3,), N m, along the principal axes, g those axes in space."""
    model, M = body.model(), body.body.principal.moments * np.asarray(spin)
    wheels = () if body.wheels is None else (body.wheels.momenta,)
    rate, *_ = model.call(model.system.flow, algebra.hat(M), *wheels, g=g, t=np.float64(t))
    return np.asarray(algebra.axial(rate) - np.cross(M, spin))
