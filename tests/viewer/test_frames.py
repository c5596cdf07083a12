"""Between saved states: interpolated, computed again, or said not to be known; sections beside."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

import kreisel as kr
from kreisel.bodies import find
from kreisel.physical import Orbit, Satellite
from kreisel.viewer.frames import between
from kreisel.viewer.scene import SHORT, scene
from scenes import IDENTITY, array, tip

TILTED = (0.9914448613738104, 0.0, 0.0, 0.13052619222005157)


def joined(data: dict) -> np.ndarray:
    out = np.zeros(len(array(data["time"], "f8")) - 1, dtype=bool)
    for first, last in data["windows"]:
        out[first:last] = True
    return out


def test_between_saved_states_the_motion_is_that_of_the_body(top, x0):
    """Against rows ten times as dense: the cubic between rows 0.36 rad apart, from the 16-bit turns of the page."""
    fine = kr.simulate(top, x0, dt=0.02, steps=1000, orientation=IDENTITY, progress=False)
    data = scene(fine.isel(time=slice(None, None, 10)))
    assert data["windows"] == [(0, 100)]
    q = array(data["bodies"][0]["turn"], "i2").reshape(-1, 4) / SHORT
    found = between(q, np.arange(0, 100, 0.1), joined(data))
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    angle = 2 * np.arccos(np.clip(abs((found * fine.g.values[:-1]).sum(-1)), 0, 1))
    assert angle.max() < 5e-3

    def kink(path):  # the jump of the velocity at saved rows, against the speed
        rate = np.diff(path, axis=0)
        return np.linalg.norm(rate[10:-10:10] - rate[9:-11:10], axis=-1).max() / np.linalg.norm(rate, axis=-1).mean()

    chords = q[:-1, None] + np.linspace(0, 1, 10, endpoint=False)[:, None] * np.diff(q, axis=0)[:, None]
    assert kink(found) < 0.4 * kink(chords.reshape(-1, 4))


def missed(data):
    """By how much the motion computed again is beside the next saved state, as the page says."""
    return float(re.search(r"next saved state to ([^;.]+)", data["note"])[1])


def test_a_splitting_is_computed_again_by_its_own_order():
    """The default order, (8, 6, 4), ends 6e-3 beside the next saved state."""
    satellite = find("satellite")(moments=(0.00665, 0.03325, 0.03326), semi_major_axis=6_878_137.0, inclination=1.7)
    x0 = satellite.state(M=(0, 0, 3.682e-5))
    run = kr.simulate(satellite, x0, dt=60.0, steps=2000, every=100, order=(2, 2), orientation=TILTED, progress=False)
    assert missed(scene(run)) < 1e-10


def test_states_far_apart_are_computed_again(top, x0):
    """Every second of all rows that the page shows is that of the run with all of them saved."""
    whole = kr.simulate(top, x0, dt=0.05, steps=4000, orientation=IDENTITY, progress=False)
    data = scene(whole.isel(time=slice(None, None, 400)).assign_attrs(every=400))
    time, steps = array(data["time"], "f8"), None
    steps = np.round(time / 0.05).astype(int)
    assert len(time) > 1000 and joined(data).all() and (np.diff(time) * 1.99 < 0.8).all()
    assert np.allclose(time, 0.05 * steps) and np.allclose(tip(data), whole.a.values[steps], atol=2e-4)
    assert "computed again" in data["note"]
    assert missed(data) < 1e-10


def test_a_long_sparse_run_has_stretches_and_says_so(top, x0):
    run = kr.simulate(top, x0, dt=0.05, steps=200_000, every=10_000, progress=False)
    data = scene(run)
    time = array(data["time"], "f8")
    lengths = [time[b] - time[a] for a, b in data["windows"]]
    assert len(lengths) == 12 and min(lengths) > 20 and "12 stretches" in data["note"] and "jumps" in data["note"]
    assert set(np.round(run.time.values, 9)) <= set(np.round(time, 9))


def test_what_cannot_be_known_between_states_is_not_invented(top, x0):
    run = kr.simulate(top, x0, dt=2.0, steps=50, progress=False)  # a step turns it by 4 rad
    data = scene(run)
    assert data["windows"] == [] and "one by one" in data["note"] and len(array(data["time"], "f8")) == 51
    own = run.assign_attrs(system="a-top-of-ones-own", frame="rest")
    assert scene(own)["windows"] == []


def test_a_forced_body_is_computed_again_with_its_clock():
    body = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1)), torque=lambda M, t: -0.02 * t * M)
    x0 = body.state(M=(0.3, 0.2, 1.1), P=(0.6, 0, 0.8))
    whole = kr.simulate(body, x0, dt=0.05, steps=400, orientation=IDENTITY, progress=False)
    from kreisel.runs.run_record import RunRecord
    from kreisel.viewer import frames

    sparse = whole.isel(time=slice(None, None, 100)).assign_attrs(every=100)
    found = frames.frames(sparse, RunRecord.of(sparse), body)
    assert found.run.sizes["time"] > 50 and "computed again" in found.note
    steps = np.round(found.run.time.values / 0.05).astype(int)
    assert np.allclose(found.run.M.values, whole.M.values[steps], atol=1e-7)


def test_a_section_and_events_stand_beside(top, x0):
    run = kr.simulate(top, x0, dt=0.05, steps=2000, progress=False)
    cut = kr.analysis.section(run, "a[2]", 0.5)
    data = scene(run, section=cut)["section"]
    table = array(data["points"], "f4").reshape(-1, len(data["names"]))
    assert np.allclose(table[:, data["names"].index("a[1]")], cut.a.values[:, 1], atol=1e-6)
    assert data["names"] == ["m[0]", "m[1]", "m[2]", "a[0]", "a[1]"]
    assert len(array(data["time"], "f8")) == cut.sizes["event"]
    with pytest.raises(kr.InputError, match="section: expected"):
        kr.view(run, section=run)


def test_a_satellite_at_rest_in_space_is_shown_on_its_circle():
    """A sphere feels no gravity gradient: without a rotation its rows tell nothing of the orbit, whose radius is 1."""
    body = Satellite((1.0, 1.0, 1.0), Orbit.circular("500 km", "97 deg"))
    x0 = body.state(attitude=IDENTITY, spin=(0.0, 0.0, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = kr.simulate(body, x0, dt=60.0, steps=600, every=25, progress=False)
    data = scene(run)
    place = array(data["bodies"][0]["place"], "f4").reshape(-1, 3)
    assert joined(data).all()
    radius = np.linalg.norm(between(place, np.arange(0, len(place) - 1, 0.1), joined(data)), axis=-1)
    assert abs(radius - 1).max() < 2e-2
    assert data["pace"] == pytest.approx(2.0 * body.orbit.period / (2 * np.pi), rel=1e-6)
