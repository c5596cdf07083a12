"""Sweeps of systems with functions from Python: controllers and forces, here and in worker processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel.physical import Orbit, Satellite
from kreisel.record.model import Model
from kreisel.sweeps.sweep import one_lane

SPIN = {"spin": ("4 deg/s", "-3 deg/s", "2 deg/s")}
RUN = {"dt": "1 s", "t_end": "40 s", "every": "4 s", "progress": False}
RATE = 1e-3


def satellite(gain: float, most: float) -> Satellite:
    """A satellite that is braked by magnets; its law is no function of a module."""

    def law(field, rates, *, gain):
        return {"dipole": gain * np.cross(field, rates)}

    control = kr.Control(law, parameters={"gain": gain}, limits={"dipole": most}, noise={"rates": {"bias": RATE}})
    return Satellite.cubesat(Orbit.circular("500 km", inclination="60 deg"), units=3, control=control)


def test_values_of_a_controller_vary(tmp_path: Path) -> None:
    over = {"control.parameters.gain": [2e3, 4e3], "control.limits.dipole": [0.01, 0.002]}
    more = {"save": ("trajectories",), "workers": 0, **RUN}
    run = kr.sweep(satellite(1e3, 0.01), SPIN, over=over, path=tmp_path / "sweep.zarr", **more)
    for place, (gain, most) in enumerate(((2e3, 0.01), (4e3, 0.002))):
        body = satellite(gain, most)
        alone = kr.simulate(body, body.state(**SPIN), **RUN)
        lane = run.isel({f"body.{name}": place for name in over})
        for name in ("momentum", "attitude", "commanded_dipole"):
            assert np.array_equal(lane[name], alone[name]), name
        largest = float(abs(lane.commanded_dipole).max())
        assert largest == most if place else 0 < largest < most


def braked(sign: float) -> Model:
    return kr.perturbed(kr.EulerTop(J=(1, 2, 3)), torque=lambda M, *, rub: -sign * rub * M, params={"rub": 0.1})


def swept(path: Path, sign: float = 1.0, **more: object) -> xr.Dataset:
    body, design = braked(sign), kr.Design(grid={"system.rub": [0.0, 0.1, 0.3]})
    more = {"save": ("trajectories",), "dt": 0.05, "steps": 40, "block": 2, "progress": False, **more}
    return kr.sweep(body, body.state(M=(0.1, 1.0, 0.2)), design, path=path, **more)


def test_workers_have_a_force_and_another_force_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sweep.zarr"
    here, there = swept(tmp_path / "here.zarr", workers=0), swept(path, workers=2)
    assert all(np.array_equal(here[name], there[name], equal_nan=True) for name in here.data_vars)
    size = np.sqrt((here.M.values[-1] ** 2).sum(-1))  # |M|' = -rub |M|
    assert size == pytest.approx(size[0] * np.exp([0.0, -0.2, -0.6]), rel=1e-3)
    assert swept(path, workers=0).attrs["created"] == there.attrs["created"]
    with pytest.raises(kr.InputError, match="holds another sweep"):
        swept(path, sign=-1.0, workers=0)
    with pytest.raises(kr.InputError, match="whose code no archive holds"):
        one_lane(path, 1)
