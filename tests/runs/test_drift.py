"""What is not conserved shouts, what is conserved never does; and drift is read in blocks of rows."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import kreisel as kr
from kreisel import algebra
from kreisel.cli import NOT_CONSERVED, app
from kreisel.lab import exact
from kreisel.method import scheme
from kreisel.physical import Orbit, Satellite
from kreisel.record.contract import Map, System
from kreisel.runs import drift, integration
from kreisel.sweeps import sweep
from kreisel.system import REGISTRY
from sizes import FULL, PAPER
from support import configuration

# A step of order 8 that loses the Casimirs, by 6e-12 in a thousand steps.  With 1e4, runs from 34 of 40 starts that
# differ by 1e-15 end without numbers, and did so before products were fused by age.
TOO_LONG = 3e3


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """That much counts as broken."""
    monkeypatch.setattr(drift, "FAR", 1e-9)
    for module in (drift, sweep):
        monkeypatch.setattr(module, "FAR_RELATIVE", 1e-12)


CONFIG = configuration("order = 8\ndt = {dt}\nsteps = 1000", 'path = "top.zarr"')


@pytest.mark.parametrize("order", [1, 2])
def test_what_a_map_keeps_is_what_its_record_says(order: int) -> None:
    """conserves=(): nothing but the Casimirs, although the energy takes eps."""
    for keeps, kept in (((), {"casimir"}), (("energy",), {"casimir", "energy_eps"})):
        own = replace(kr.LagrangeTop, map=replace(kr.LagrangeTop.map, conserves=keeps))(p=(0, 0, 1))
        outcomes = scheme(own, "suris", 0.1, order, False).outcomes
        assert {name for name, outcome in outcomes.items() if outcome.conserved} == kept
        assert outcomes["energy"].kind == "integral" and not outcomes["energy"].conserved


@pytest.mark.parametrize("method", ["exact", "baecklund"])
def test_a_component_that_is_zero_may_round(method: str) -> None:
    """Without a field steps move P by some 1e-16 of M, so its Casimirs from 0: no warning."""
    top = kr.KovalevskayaTopE3()
    run = kr.simulate(top, top.state(M=(0.1, 0.3, 1.0), P=(0, 0, 0)), dt=0.05, steps=200, method=method)
    assert not kr.drift(run)["broken"].any()
    run["casimir"][100, 0] = 1e-12  # |P|^2 of a P that is a millionth
    assert kr.drift(run)["broken"]["casimir[0]"]


def test_work_and_clock_are_not_sizes_of_the_state() -> None:
    """A satellite that starts with no work done: its balance rounds like the energies there are, I n^2 by size."""
    orbit = Orbit.circular("500 km")
    cubesat = Satellite.cubesat(orbit, units=3)
    run = kr.simulate(cubesat, cubesat.state(attitude=cubesat.pointing(pitch="10 deg")), dt="15 s", steps=400)
    size = cubesat.inertia.max() * (2 * np.pi / orbit.period) ** 2
    for name in ("energy", "balance"):
        assert size < max(run[name].attrs["roundoff_scale"]) < 10 * size
        assert max(run[name].attrs["evaluation_scale"]) < 10 * size


def test_a_broken_run_shouts(top: System, x0: object, tmp_path: Path, strict: None) -> None:
    with pytest.warns(
        kr.ConservationWarning, match=r"casimir\[0\] is not conserved.*expected a change of some units"
    ) as caught:
        run = kr.simulate(top, x0, dt=TOO_LONG, steps=1000, order=8, project=False)
    assert caught[0].filename == __file__
    table = kr.drift(run)
    assert table.broken["casimir[0]"] and not table.broken["energy"]
    assert "BROKEN" in run.kreisel._repr_html_() and "is not conserved" in repr(run.kreisel)
    assert len(drift.broken(table)) == table.broken.sum()
    with pytest.warns(kr.ConservationWarning) as caught:
        kr.simulate(top, x0, dt=TOO_LONG, steps=1000, order=8, path=tmp_path / "top.zarr", project=False)
    assert caught[0].filename == __file__


def test_a_broken_run_that_is_projected_ends(top: System, x0: object, tmp_path: Path) -> None:
    """What was done until then is kept."""
    mutant = replace(kr.LagrangeTop, map=replace(kr.LagrangeTop.map, step=MUTANTS["a kick off by a millionth"]))
    with pytest.raises(kr.RunError, match=r"is not conserved, although.*--no-project"):
        kr.simulate(mutant(p=(0, 0, 1)), x0, dt=0.1, steps=20_000, every=10, method="suris", order=1)


def test_the_commands_shout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, strict: None) -> None:
    """Exit code 3 of run and resume, 1 of check; the archive is kept, the table says BROKEN, so does JSON."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(CONFIG.format(dt=TOO_LONG))
    do = CliRunner().invoke
    done = do(app, ["run", "top.toml", "--no-figure", "--no-project"])
    assert done.exit_code == NOT_CONSERVED == 3
    assert "BROKEN" in done.stdout and "casimir[0] is not conserved" in done.stderr
    assert kr.open_run("top.zarr").attrs["complete"]
    done = do(app, ["run", "top.toml", "--no-figure", "--no-project", "--overwrite", "--json"])
    printed = json.loads(done.stdout)
    assert done.exit_code == NOT_CONSERVED and printed["broken"] and printed["drift"][0]["broken"] is True
    done = do(app, ["check", "top.zarr"])
    assert done.exit_code == 1 and "FAULT: casimir[0] is not conserved" in done.stdout
    assert do(app, ["resume", "top.zarr", "--extend", "1100"]).exit_code == NOT_CONSERVED
    (tmp_path / "top.toml").write_text(CONFIG.format(dt=0.05))
    done = do(app, ["run", "top.toml", "--no-figure", "--overwrite", "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["broken"] == []


MUTANTS = {
    "sign of the rotation": lambda m, a, *, p, eps: _step(m, a, p, eps, turn=-1),
    "sign of the kick": lambda m, a, *, p, eps: _step(m, a, p, eps, kick=-1),
    "a lost half": lambda m, a, *, p, eps: _step(m, a, p, eps, turn=2),
    "old m in the rotation": lambda m, a, *, p, eps: (
        m + eps * algebra.wedge(a, p),
        algebra.cayley_act(eps / 2 * m, a),
    ),
    "a kick off by a millionth": lambda m, a, *, p, eps: _step(m, a, p, eps, kick=1 + 1e-6),
}


def _step(m, a, p, eps, kick=1, turn=1):
    m = m + kick * eps * algebra.wedge(a, p)
    return m, algebra.cayley_act(turn * eps / 2 * m, a)


@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_shouts(name: str, x0: object) -> None:
    mutant = replace(kr.LagrangeTop, map=replace(kr.LagrangeTop.map, step=MUTANTS[name]))(p=(0, 0, 1))
    with pytest.warns(kr.ConservationWarning):
        run = kr.simulate(mutant, x0, dt=0.1, steps=1000, method="suris", order=1, project=False)
    assert kr.drift(run).broken.any()
    with pytest.raises(kr.RunError, match="is not conserved, although the method conserves it"):
        kr.simulate(mutant, x0, dt=0.1, steps=20_000, every=20_000, method="suris", order=1)


LARGER = {4: ("lagrange-top-moving", *["clebsch", "euler-top"] * FULL), 5: ["symmetric-top", "neumann"] * FULL}


def by_its_map(phi: Map | None) -> str:
    """The method that steps a system's own map."""
    if phi is None:
        return ""
    return "veselov" if phi.symmetric else "brickwork" if phi.to_symmetric is None else "suris"


CASES = [
    (name, n, method)
    for name, system in REGISTRY.items()
    for n in (3, 4, 5)
    for method in ("baecklund", "suris", "veselov", "brickwork")
    if name in LARGER.get(n, REGISTRY)
    if (method == "baecklund" and system.baecklund is not None) or method == by_its_map(system.map)
] + [("lagrange-top", 3, "exact")]


def states(model: object, n: int) -> Iterator[tuple[str, tuple[np.ndarray, ...]]]:
    """Random, huge, tiny, at rest, asleep and upright, nearly so."""
    draw = exact.float_random(np.random.default_rng([17, n]))
    space = model.system.space
    z = space.point(n, draw)
    yield "random", z
    if space.constraints:
        return
    for size in (1e-8, 1e6):
        yield f"momenta times {size:g}", (size * z[0], *z[1:])
    if space.kinds[1:2] != ("vector",):
        return
    up, spin = np.eye(n)[-1], np.zeros((n, n))
    spin[0, 1], spin[1, 0] = -2, 2
    for off in (0.0, 1e-6):
        yield f"asleep, off by {off:g}", (spin + off * z[0], up + off * z[1], *z[2:])
        yield f"at rest, off by {off:g}", (off * z[0], up + off * z[1], *z[2:])


@pytest.mark.parametrize(("name", "n", "method"), CASES)
def test_a_right_map_never_shouts(name: str, n: int, method: str) -> None:
    """Close to the longest steps too.  Measured: 30 widths and less, but for steps that turn by many radians."""
    model = exact.random_model(REGISTRY[name], n, exact.float_random(np.random.default_rng([5, n])))
    phi = model.system.map
    runs = 0
    for label, z in states(model, n):
        z = tuple(np.asarray(part, dtype=np.float64) for part in z)
        state = dict(zip(model.system.space.letters, z, strict=True))
        bounded = method in ("suris", "veselov") and phi is not None and phi.largest_step is not None
        bounded &= FULL or name in PAPER or label == "random"
        steps = [0.3] + ([0.99 * min(1e3, model.largest_step(*z))] if bounded else [])
        for dt in steps:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", RuntimeWarning)
                    run = kr.simulate(model, state, dt=dt, steps=200, every=20, method=method)
            except (kr.InputError, kr.RunError):
                continue
            runs += 1
            assert not kr.drift(run).broken.any(), (label, dt, kr.drift(run).to_string())
    assert runs


def test_leaving_an_equilibrium_is_not_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first block is at rest to 1e-13, rounding errors of the rest are those of 1: the width is measured again."""
    monkeypatch.setattr(integration, "BLOCK_BYTES", 4 * 6 * 8 * 100)
    monkeypatch.setattr(drift, "SMALL", 0.0)  # so that the rounding errors of the rest do not count in the first block
    p = np.array((0.3, -0.2, 1))
    top, up = kr.LagrangeTop(p=p), p / np.linalg.norm(p)
    many = top.state(m=np.array([[1e-13, 2e-13, 3e-14], [1, 1, 1], [1, 0, 1], [0, 1, 1.0]]), a=np.stack([up] * 4))
    run = kr.simulate(top, many, dt=5e-3, steps=10_000, every=2)
    alone = run.isel(lane=0)
    for part in (run, alone):
        assert not kr.drift(part).broken.any(), kr.drift(part).to_string()
        assert kr.drift(part).ulps["casimir[1]"] < 100
    monkeypatch.setattr(drift, "whole_run", lambda *given: None)
    assert kr.drift(alone).ulps["casimir[1]"] > drift.FAR  # the test can fail
    assert not kr.drift(alone).broken.any()  # not measured again, and so let pass


@pytest.mark.parametrize("method", ["baecklund", "exact"])
def test_rounding_errors_of_a_body_next_to_rest_are_no_fault(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The momentum is 1e-10 and stays so; the torque that the step adds is the rounding error of products of size 1."""
    p = np.array((0.3, -0.2, 1))
    top = kr.LagrangeTop(p=p)
    hanging = top.state(m=(1e-10, 2e-10, 5e-11), a=-p / np.linalg.norm(p))
    options = {"dt": 0.05, "steps": 200, "every": 10, "method": method}
    assert not kr.drift(kr.simulate(top, hanging, **options)).broken.any()  # type: ignore[arg-type]
    monkeypatch.setattr(drift, "SMALL", 0.0)
    with pytest.warns(kr.ConservationWarning):  # the test can fail
        kr.simulate(top, hanging, **options)  # type: ignore[arg-type]


def test_an_energy_that_begins_at_0_is_compared_with_its_later_terms() -> None:
    """A level pendulum at rest: its energy is 0 and oscillates by 7.5e-5, as Kahan's map at dt = 0.05 lets it."""
    top, options = kr.LagrangeTop(p=(0, 0, 1)), {"dt": 0.05, "steps": 40, "method": "kahan"}
    with warnings.catch_warnings():
        warnings.simplefilter("error", kr.AccuracyWarning)
        run = kr.simulate(top, {"m": (0, 0, 0), "a": (1, 0, 0)}, **options)  # type: ignore[arg-type]
        kr.simulate(top, {"m": (0, 0, 0), "a": (1, 0, 0)}, **{**options, "dt": 0.025, "steps": 80, "every": 20})  # type: ignore[arg-type]
    assert 1e-5 < float(abs(run.energy).max()) < 1e-3
    with pytest.warns(kr.AccuracyWarning, match="energy oscillates"):
        kr.simulate(top, {"m": (0, 0, 0), "a": (1, 0, 0)}, **{**options, "dt": 1.5})  # type: ignore[arg-type]


def test_drift_reads_blocks_of_rows(top: System, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The figures of the definition, from pieces of the variables."""
    kr.simulate(top, x0, dt=0.05, steps=5000, path=tmp_path / "top.zarr")
    run = kr.open_run(tmp_path / "top.zarr")
    largest, whole = [], drift.read_values
    monkeypatch.setattr(
        drift, "read_values", lambda variable, *name: largest.append(variable.size) or whole(variable, *name)
    )
    monkeypatch.setattr(drift, "NUMBERS_AT_ONCE", 700)
    table = kr.drift(run)
    assert max(largest) <= 700
    time = run.time.values - run.time.values.mean()
    for label, row in table.iterrows():
        name, _, part = str(label).rstrip("]").partition("[")
        values = run[name].values[:, int(part)] if part else run[name].values
        change = values - values[0]
        assert (row.start, row.max_change) == (values[0], abs(change).max())
        assert row.slope == pytest.approx(time @ change / (time @ time), rel=1e-9, abs=1e-25)


def test_an_ensemble_is_judged_by_its_worst_lane(top: System) -> None:
    m = np.array([[0.1, 0.2, 1.5]] * 4)
    run = kr.simulate(top, top.state(m=m, a=[0.6, 0, 0.8]), dt=0.05, steps=100)
    run["energy"][-1, 2] += 1e-3
    table = kr.drift(run)
    assert table.broken["energy"] and table.broken.sum() == 1
    assert not kr.drift(run.isel(lane=[0, 1, 3])).broken.any()


def test_series_are_those_of_the_worst_lane(top: System) -> None:
    m = np.array([[0.1, 0.2, 1.5]] * 4)
    run: xr.Dataset = kr.simulate(top, top.state(m=m, a=[0.6, 0, 0.8]), dt=0.05, steps=100)
    run["casimir"][-1, 3, 1] += 1e-3
    found = {series.name: series for series in drift.all_series(run)}
    assert (found["casimir[1]"].values == run.casimir.values[:, 3, 1]).all()


def test_lanes_with_constants_of_their_own_are_measured(top: System, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps by pairs have constants for each lane, which the measure of some lanes lacks: its places are others."""
    angle = np.linspace(0.1, 3.0, 80)[:, None] * [1.0, 2.0, 3.0]
    start = top.state(m=1.5 * np.sin(angle), a=[0.6, 0, 0.8])
    every = kr.simulate(top, start, dt=0.05, steps=2, method="baecklund")
    monkeypatch.setattr(drift, "MANY_LANES", 79)
    some = kr.simulate(top, start, dt=0.05, steps=2, method="baecklund")
    for name in ("casimir", "energy", "spectrum", "noether"):
        for key in drift.SCALES:
            largest = drift.lane_scales(every, name, key).max(0)
            np.testing.assert_allclose(some[name].attrs[key], largest, rtol=1e-12)


def test_lanes_of_large_n_are_measured_in_their_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """There the part of m that does not act on p is a constant, without rounding errors."""
    top, draw = kr.LagrangeTop(p=np.eye(12)[-1]), np.random.default_rng(1)
    start = top.state(m=algebra.skew(draw.normal(size=(20, 66)), 12), a=draw.normal(size=(20, 12)))
    monkeypatch.setattr(drift, "MANY_LANES", 15)
    run = kr.simulate(top, start, dt=0.05, steps=2, method="suris")
    assert run.attrs["engine"] == "large" and not np.any(run.noether.attrs["roundoff_scale"])


@pytest.mark.filterwarnings("ignore:Lane .* more than half a revolution")
def test_lanes_of_a_sweep_shout(top: System, x0: object, tmp_path: Path, strict: None) -> None:
    """One lane has a step that is far too long; momenta of 1e-9 and a top at rest are right."""
    states = {"state.m[2]": [1.5, 1e-9, 0.0, 1.5], "run.dt": [0.05, 0.05, 0.05, TOO_LONG]}
    options = {"dt": 0.05, "steps": 1000, "order": 8, "workers": 0, "project": False}
    with pytest.warns(kr.ConservationWarning, match=r"^lane 3: casimir\[0\] is not conserved[^:]*:[^:]*$"):
        kr.sweep(top, x0, kr.Design(together=states), path=tmp_path / "sweep.zarr", **options)
    right = kr.Design(together={name: values[:3] for name, values in states.items()})
    kr.sweep(top, x0, right, path=tmp_path / "right.zarr", **options)
    do = CliRunner().invoke
    done = do(app, ["check", str(tmp_path / "sweep.zarr")])
    assert done.exit_code == 1 and "FAULT: lane 3: casimir[0]" in done.stdout
    assert do(app, ["check", str(tmp_path / "right.zarr")]).exit_code == 0
    text = (
        CONFIG.format(dt=0.05).replace("order = 8", "order = 8\nproject = false")
        + f"\n[sweep.list]\nrun.dt = [0.05, {TOO_LONG}]\n"
    )
    (tmp_path / "sweep.toml").write_text(text)
    done = do(app, ["sweep", str(tmp_path / "sweep.toml"), "--workers", "0", "--json", "--overwrite"])
    assert done.exit_code == NOT_CONSERVED and json.loads(done.stdout)["broken"][0].startswith("lane 1: ")


def test_drift_says_that_there_is_nothing_to_judge() -> None:
    """An empty table would look like a run without drift."""
    body, start = kr.EulerTop(J=(1, 2, 3)), {"M": (0.3, -0.4, 1.2)}
    run = kr.simulate(body, start, dt=0.1, steps=10, observe=[], progress=False)
    with pytest.raises(kr.InputError, match="saved none, observe="):
        kr.drift(run)
    with pytest.raises(kr.InputError, match="a Dataset without system"):
        kr.drift(xr.Dataset({"x": ("time", [1.0, 2.0])}, {"time": [0.0, 1.0]}))
    bare = run.copy()
    for variable in bare.variables.values():
        variable.attrs.clear()
    bare.attrs.pop("observe")
    with pytest.raises(kr.InputError, match="variables have no attributes"):
        kr.drift(bare)
