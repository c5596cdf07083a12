"""Orbits: dates, drifting elements of a satellite that runs, bad input; mathematics: `tests/outside/test_orbits.py`."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import kreisel as kr
from kreisel.physical import SUN, Orbit, Primary, Satellite

NOON = dt.datetime(2026, 3, 20, 12, tzinfo=dt.UTC)


@pytest.mark.parametrize(
    "epoch",
    [
        "2026-03-20T12:00:00",
        "2026-03-20T12:00:00Z",
        "2026-03-20T13:00:00+01:00",
        NOON,
        NOON.replace(tzinfo=None),
        np.datetime64("2026-03-20T12:00:00"),
        np.datetime64("2026-03-20T12:00:00", "ns"),
        pd.Timestamp("2026-03-20T12:00:00"),
    ],
)
def test_dates(epoch: object) -> None:
    """Julian day 2461120.0, by the almanac; J2000.0 is 2451545.0."""
    assert Orbit("7000 km", epoch=epoch).days == 2461120.0 - 2451545.0
    assert Orbit.circular("500 km", epoch=dt.date(2026, 3, 20)).epoch == NOON - dt.timedelta(hours=12)


def test_the_kernel_has_phase_and_drift() -> None:
    """A slender satellite falls about where `at` has it: gravity alone, against the torque at the places of `at`."""
    orbit = Orbit("7000 km", 0.05, "50 deg", "20 deg", "70 deg", true_anomaly="100 deg", J2=True)
    body = Satellite((1.0, 2.0, 2.5), orbit)
    run = kr.simulate(
        body.model(), body.state(spin=(0, 0, 0)), dt=1e-3, steps=1, orientation=body.orientation((1, 0, 0, 0))
    )
    r = orbit.at(5e-4)[0]
    want = 3 * orbit.primary.mu / np.linalg.norm(r) ** 5 * np.cross(r, np.diag([1.0, 2.0, 2.5]) @ r)
    assert run.M[-1].values / 1e-3 == pytest.approx(want, rel=1e-6)


def test_archives_hold_the_path(tmp_path: Path) -> None:
    """A run on a table of positions is resumed bit for bit by its archive alone; the body knows its own runs."""
    body = Satellite((1.0, 2.0, 2.5), Orbit.from_tle(FIRST, SECOND, span="2 h"))
    run: dict[str, Any] = {"dt": "30 s", "every": "300 s"}
    whole = kr.simulate(body, body.state(), t_end="6000 s", **run)
    kr.simulate(body, body.state(), t_end="3000 s", path=tmp_path / "run.zarr", **run)
    kr.resume(tmp_path / "run.zarr", extend=200)
    again = kr.open_run(tmp_path / "run.zarr")
    for name in ("momentum", "attitude", "position"):
        assert (again[name].values == whole[name].values).all()
    assert body.angles(again).pitch.shape == (21,)
    with pytest.raises(kr.InputError, match="got one with another"):
        Satellite((1.0, 2.0, 2.5), Orbit.from_tle(FIRST, SECOND)).angles(again)
    with pytest.raises(kr.InputError, match=r"path: expected .* 0 to 7500, got .* a longer span of the orbit"):
        kr.simulate(body, body.state(), t_end="7500 s", **run)


FIRST, SECOND = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991",
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482",
)
TIMES = np.arange(0.0, 20_000.0, 600.0)
MOVING = Orbit(7e6, 0.01, 0.9).at(TIMES)
DAYS = [f"2026-02-{day}" for day in range(24, 30)]  # the last is none


def with_row(values: np.ndarray, value: float) -> np.ndarray:
    """Rows with another value at the first place of the row 3."""
    out = np.array(values)
    out.reshape(len(out), -1)[3, 0] = value
    return out


def through(z: float, part: float) -> Orbit:
    """A path through an apsis over the pole of an oblate body, where v^2 is this part of mu/r."""
    body = Primary("disc", 4e14, 1e6, J2=0.3)
    return Orbit.from_state((0, 0, z), (np.sqrt(part * body.mu / z), 0, 0), body, J2=True)


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "epoch": (lambda: Orbit(7e6, epoch="20.3.2026"), "epoch: expected a date in UTC"),
    "number": (lambda: Orbit(7e6, epoch=2461120.0), "epoch: expected a date in UTC"),
    "no epoch": (lambda: Orbit(7e6).days, "no date.*epoch='2026"),
    "two anomalies": (lambda: Orbit(7e6, mean_anomaly=1.0, true_anomaly=1.0), "got both"),
    "J2": (lambda: Orbit(7e6, J2=1e-3), "J2: expected True or False"),
    "no J2": (lambda: Orbit(1e12, primary=SUN, J2=True), "expected a primary with J2, got Sun"),
    "escape": (lambda: Orbit.from_state((7e6, 0, 0), (0, 11.2e3, 0)), "expected a state on an ellipse"),
    "plunge": (lambda: Orbit.from_state((7e6, 0, 0), (-1e3, 0, 0)), "expected a state on an ellipse"),
    "fall with J2": (lambda: Orbit.from_state((0, 0, 7e6), (50, 0, 0), J2=True), "hits the Earth"),
    "no mean energy": (lambda: through(1.2e6, 1.99), "a mean ellipse, .* nearly parabolic"),
    "no mean speed": (lambda: through(1.2e6 * 499, 0.004), "a mean ellipse, .* nearly parabolic"),
    "in km": (lambda: Orbit.from_state((7e3, 0, 0), (0, 7.5, 0)), "hits the Earth.*km for m"),
    "name of a set": (lambda: Orbit.from_tle("ISS (ZARYA)", FIRST), "line1: expected line 1 of a two-line"),
    "lines swapped": (lambda: Orbit.from_tle(SECOND, FIRST), "line1: expected line 1 of a two-line"),
    "a digit": (lambda: Orbit.from_tle(FIRST, SECOND.replace("51.6439", "51.6440")), "line2: expected the checksum 4"),
    "after its end": (
        lambda: Orbit.from_tle(FIRST, SECOND, span=3600.0).at(3601.0),
        "expected times of the path, 0 to 3600 s",
    ),
    "decayed": (lambda: Orbit.from_tle(FIRST, SECOND, span="20000 day", every="100 day"), "error 6 after"),
    "positions in km": (lambda: Orbit.from_table(range(6), np.full((6, 3), 5e3)), "Usual cause: km for m"),
    "few positions": (lambda: Orbit.from_table(range(5), np.full((5, 3), 5e6)), "six or more times"),
    "a gap": (
        lambda: Orbit.from_table([0, 1e-3, 60, 120, 1e6, 2e6], np.outer([1, 1, 2, 1, 2, 1], [8e6, 0, 0])),
        "about equally spaced",
    ),
    "unsorted times": (lambda: Orbit.from_table(range(6, 0, -1), np.full((6, 3), 5e6)), "times that increase"),
    "NaN in a row": (lambda: Orbit.from_table(TIMES, with_row(MOVING[0], np.nan)), "positions: .* nan at index 3, 0"),
    "infinite": (lambda: Orbit.from_table(TIMES, MOVING[0], with_row(MOVING[1], np.inf)), "velocities: .*index 3, 0"),
    "inside": (
        lambda: Orbit.from_table(TIMES, np.where(np.arange(len(TIMES))[:, None] == 3, 9.0, MOVING[0])),
        "from its centre at index 3",
    ),
    "times twice": (lambda: Orbit.from_table(with_row(TIMES, TIMES[2]), MOVING[0]), "and then .* at index 3"),
    "no such day": (lambda: Orbit.from_table(DAYS, MOVING[0][: len(DAYS)]), r"times\[5\]: .*2026-02-29"),
    "no date": (
        lambda: Orbit.from_table(np.array([*DAYS[:5], "NaT"], "M8[s]"), MOVING[0][: len(DAYS)]),
        r"times\[5\]: .*NaT",
    ),
    "velocities in km/s": (lambda: Orbit.from_table(TIMES, MOVING[0], MOVING[1] / 1e3), "cause: km/s for m/s"),
    "of the rotating Earth": (
        lambda: Orbit.from_table(TIMES, MOVING[0], MOVING[1] - np.cross((0, 0, 7.292e-5), MOVING[0])),
        "velocities: expected the rates .* a rotating frame",
    ),
    "path": (lambda: Orbit(7e6, path=kr.Table([0, 1], [1, 2])), "path: expected a table as Orbit.from_table"),
    "anomaly": (lambda: Orbit(7e6, true_anomaly="3 kg"), "dimension of rad"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_orbits(name: str) -> None:
    call, message = BAD[name]
    with pytest.raises(kr.InputError, match=message):
        call()
