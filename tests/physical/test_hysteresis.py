"""Hysteresis rods: the loop by an integration of the published equation, its area, and energy that they take."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.physical import Orbit, Satellite, hysteresis_rods

MU_0 = 4e-7 * np.pi
BR, BS, HC = 0.004, 0.025, 12.0  # of CubeSats: Princeton Satellite Systems, CubeSat Toolbox
RODS: dict[str, Any] = {"volume": 3e-7, "coercivity": HC, "remanence": BR, "saturation": BS}


def loop(H: np.ndarray) -> np.ndarray:
    """B of one rod at each H, T."""
    law, memory = hysteresis_rods((0, 0, 1), **RODS).law, {"inner": np.zeros(1), "before": np.zeros(1), "begun": 0.0}
    out = []
    for h in H:
        new = law(field=np.array([0, 0, MU_0 * h]), **memory)
        out.append(new["dipole"][2] * MU_0 / RODS["volume"])
        memory = {name: new[name] for name in memory}
    return np.array(out)


def published(H: np.ndarray) -> np.ndarray:
    """The equation of Flatley and Henretty in H and B, from the middle of the loop."""
    k = np.tan(np.pi * BR / (2 * BS)) / HC
    out = [2 * BS / np.pi * np.arctan(k * H[0])]
    for a, b in pairwise(H):
        side = np.sign(b - a)

        def slope(h: float, B: np.ndarray, side: float = side) -> np.ndarray:
            edge = np.tan(np.pi * B / (2 * BS)) / k - side * HC
            share = (h - edge) / (2 * HC)
            return 2 / np.pi * k * BS * share**2 * np.cos(np.pi * B / (2 * BS)) ** 2

        out.append(solve_ivp(slope, (a, b), [out[-1]], rtol=1e-10, atol=1e-14).y[0, -1])
    return np.array(out)


def test_the_loop_is_that_of_the_equation() -> None:
    t = np.linspace(0, 4 * np.pi, 60)
    H = 25 * np.sin(t) * np.exp(-0.1 * t) + 5 * np.cos(3.3 * t)
    B = loop(H)
    assert abs(B - published(H)).max() < 1e-8  # of 0.007
    assert abs(loop(1.02 * H) - published(H)).max() > 1e-5


def test_remanence_coercivity_and_area_of_a_saturated_loop() -> None:
    big = HC * np.sinh(np.linspace(0, 9, 400))  # to 4000 H_c
    B = loop(np.array([0, big[-1], 0, -HC]))
    assert B[2] == pytest.approx(BR, rel=1e-3) and abs(B[3]) < 1e-3 * BR
    H = np.concatenate([big, big[::-1], -big, -big[::-1], big])
    B = loop(H)
    area = np.sum(((H[1:] + H[:-1]) / 2 * np.diff(B))[400:1999])  # from saturation to saturation
    assert area == pytest.approx(4 * BS * HC, rel=0.02)  # the sides are 2 H_c apart at each B from -B_s to B_s


def test_rods_take_energy_from_a_satellite() -> None:
    orbit = Orbit.circular("600 km", "65 deg")
    for volume, braked in ((3e-6, True), (1e-12, False)):
        rods = hysteresis_rods([(1, 0, 0), (0, 1, 0)], every=2, **{**RODS, "volume": volume})
        body = Satellite((0.01, 0.02, 0.022), orbit, control=rods)
        run = kr.simulate(body, body.state(("2 deg/s", "1 deg/s", "3 deg/s")), dt="2 s", t_end="3 h", every="10 min")
        lost = 1 - float((run.momentum[-1] ** 2).sum() / (run.momentum[0] ** 2).sum())
        assert (lost > 0.05) == braked and abs(lost) > 0
        assert run.inner.shape == (19, 2)


@pytest.mark.parametrize("wrong", [{"volume": 0}, {"remanence": 0.03}, {"coercivity": (1, 2)}, {"saturation": "1 m"}])
def test_rods_that_cannot_be(wrong: dict[str, Any]) -> None:
    with pytest.raises(kr.InputError, match="|".join([*wrong, "saturation"])):
        hysteresis_rods((0, 0, 1), **{**RODS, **wrong})
