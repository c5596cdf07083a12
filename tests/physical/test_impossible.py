"""Moments that no body has are refused wherever a body is described, flat bodies with rounded moments by that cause."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.bodies import BODIES
from kreisel.cli import configuration as config
from kreisel.physical import FreeBody, Gyroscope, HeavyBody, Orbit, Satellite, SubmergedBody

LOW = Orbit.circular("500 km")
FREE, TOP = kr.EulerTop(J=(1.0, 2.0, 3.0)), kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
WAYS: dict[str, Callable[[Any], Any]] = {
    "FreeBody": lambda moments: FreeBody(moments),
    "tensor": lambda moments: FreeBody(np.diag(moments)),
    "units": lambda moments: FreeBody([f"{1e4 * x} kg cm^2" for x in moments]),
    "HeavyBody": lambda moments: HeavyBody(1.0, moments, (0, 0, 0)),
    "about_centre": lambda moments: HeavyBody.about_centre(1.0, moments, (0, 0, 0.1)),
    "Satellite": lambda moments: Satellite(moments, LOW),
    "SubmergedBody": lambda moments: SubmergedBody(1.0, moments),
    "satellite": lambda moments: BODIES["satellite"](moments=moments, semi_major_axis=7e6),
    "EulerTop": lambda moments: kr.EulerTop(J=np.sum(moments) / 2 - np.array(moments)),
    "HeavyTop": lambda moments: kr.HeavyTop(J=np.sum(moments) / 2 - np.array(moments), A=(0, 0, 1)),
    "HeavyTop of a tensor": lambda moments: kr.HeavyTop(
        J=np.diag(np.sum(moments) / 2 - np.array(moments)), A=(0, 0, 1)
    ),
    "ZhukovskyVolterra": lambda moments: kr.ZhukovskyVolterra(J=np.sum(moments) / 2 - np.array(moments), h=(0, 0, 1)),
    "perturbed": lambda moments: kr.perturbed(FREE, inertia=moments),
    "perturbed top": lambda moments: kr.perturbed(TOP, inertia=moments),
}


@pytest.mark.parametrize("way", WAYS)
def test_impossible_moments(way: str) -> None:
    """Those of issue reports, in any order; a possible body passes."""
    for moments in ((3.0, 5.0, 9.0), (9.0, 5.0, 3.0)):
        with pytest.raises(kr.InputError, match=r"No body has the principal moments 3, 5, 9 .* by 1\. Usual cause: "):
            WAYS[way](moments)
    assert WAYS[way]((3.0, 5.0, 7.0)) is not None


@pytest.mark.parametrize("way", WAYS)
def test_a_flat_body_with_rounded_moments(way: str) -> None:
    with pytest.raises(kr.InputError, match=r"by 0.001\. .*rounded.* 0.666, "):
        WAYS[way]((0.333, 0.333, 0.667))
    if way != "ZhukovskyVolterra":  # whose J has no 0
        assert WAYS[way]((0.25, 0.25, 0.5)) is not None


def test_every_principal_axis_is_looked_at() -> None:
    turned = algebra.rotation_matrix(np.array([0.5, 0.1, -0.7, 0.5]))
    tensor = turned @ np.diag([3.0, 5.0, 9.0]) @ turned.T
    for make in (FreeBody, lambda moments: kr.HeavyTop(J=np.trace(moments) / 2 * np.eye(3) - moments, A=(0, 0, 1))):
        with pytest.raises(kr.InputError, match="principal moments 3, 5, 9"):
            make((tensor + tensor.T) / 2)


def test_lanes_and_more_dimensions() -> None:
    with pytest.raises(kr.InputError, match="3, 5, 9"):
        kr.HeavyTop(J=np.stack([np.diag((1.0, 2.0, 3.0)), np.diag((5.5, 3.5, -0.5))]), A=(0, 0, 1))
    with pytest.raises(kr.InputError, match="expected a mass tensor"):
        kr.HeavyTop(J=(1.0, 1.0, 1.0, -0.1), A=(0, 0, 0, 1))


def test_a_body_in_a_fluid_has_the_moments_of_the_fluid_too() -> None:
    body = kr.KirchhoffRevolution(a1=1.0, a3=2.0, c1=1.0, c3=0.5)
    assert kr.perturbed(body, inertia=(3.0, 5.0, 9.0)).params["inertia"].tolist() == [3, 5, 9]
    with pytest.raises(kr.InputError, match="> 0"):
        kr.perturbed(body, inertia=(3.0, 5.0, -9.0))


def test_moments_about_the_pivot() -> None:
    """A body on a point has its m l^2 in its moments; a point on a light rod has nothing else."""
    with pytest.raises(kr.InputError, match=r"HeavyBody\.about_centre"):
        HeavyBody(1.0, (0.1, 0.1, 0.1), (0, 0, 1.0))
    assert HeavyBody.about_centre(1.0, (0.1, 0.1, 0.1), (0, 0, 1.0)).inertia[0, 0] == pytest.approx(1.1)
    with pytest.raises(kr.InputError, match=ROD):  # not of its moments about the centre, which are rounding
        HeavyBody(0.7, (0.7 * 0.3**2, 0.7 * 0.3**2, 0.0), (0, 0, 0.3))
    with pytest.raises(kr.InputError, match="add mass lever"):
        Gyroscope(1.0, 0.1, 0.1, 1.0)


ROD = r"inertia: expected three moments > 0, got 0, .* a rod without thickness"


@pytest.mark.parametrize("moments", [(1.0, 1.0, 0.0), (1.0, 0.0, 1.0), (1.0, 1.0, 1e-15)])
def test_a_rod_without_thickness(moments: tuple[float, ...]) -> None:
    """Two points on a line: no momentum determines the spin about the line.  Refused where it is described, in SI."""
    for make in (FreeBody, lambda tensor: Satellite(tensor, LOW), lambda tensor: HeavyBody(1.0, tensor, (0, 0, 0))):
        with pytest.raises(kr.InputError, match=r"inertia: expected three moments > 0, .* a rod without thickness"):
            make(np.diag(moments))
    with pytest.raises(kr.InputError, match=ROD):
        FreeBody.box(1.0, (0.0, 0.0, 1.0))
    in_water = SubmergedBody(1.0, moments, added_mass=(0, 1, 1, 1, 1, 1))  # the water resists that spin
    assert in_water.state((0, 0, 1.0), (0, 0, 0)).P is not None
    thin = FreeBody((1.0, 1.0, 1e-6))
    assert thin.angular_velocity(thin.state((0.1, 0.2, 0.3)).axial["M"]) == pytest.approx([0.1, 0.2, 0.3])


def test_toml() -> None:
    data = {"system": {"name": "heavy-top", "J": [5.5, 3.5, -0.5], "A": [0, 0, 1]}}
    rest = {"state": {"M": [0, 0, 1], "P": [0, 0, 1]}, "run": {"dt": 0.1, "steps": 2}, "output": {"path": "a.zarr"}}
    with pytest.raises(kr.InputError, match="3, 5, 9"):
        config.parse({**data, **rest})
