"""Quantities with units into the physical bodies, and out of their runs."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel import analysis, units
from kreisel.physical import Ellipsoid, FreeBody, Gyroscope, HeavyBody

pint = pytest.importorskip("pint")

PLAIN = Gyroscope(mass=3.0, axial_moment=0.17, transverse_moment=0.18, lever=0.15, gravity=9.81)
RPM = 2 * math.pi / 60


def gyroscope(**changes: object) -> Gyroscope:
    data = {
        "mass": "3 kg",
        "axial_moment": "0.17 kg m^2",
        "transverse_moment": "1800 kg cm^2",
        "lever": "15 cm",
        "gravity": "9.81 m/s^2",
    }
    return Gyroscope(**{**data, **changes})


def test_strings_quantities_and_plain_numbers_say_the_same() -> None:
    ureg = pint.get_application_registry()
    quantities = {
        "mass": 3000 * ureg.gram,
        "axial_moment": 0.17 * ureg.newton * ureg.meter * ureg.second**2,
        "transverse_moment": 0.18 * ureg.kilogram * ureg.meter**2,
        "lever": 150 * ureg.millimeter,
        "gravity": 9.81 * ureg.meter / ureg.second**2,
    }
    for body in (gyroscope(), gyroscope(**quantities)):
        for name in ("mass", "axial_moment", "transverse_moment", "lever", "gravity"):
            assert getattr(body, name) == pytest.approx(getattr(PLAIN, name), rel=1e-15)
            assert type(getattr(body, name)) is float
    assert Gyroscope.flat("3 kg", "0.17 kg m^2", "15 cm") == Gyroscope.flat(3.0, 0.17, 0.15)


def test_states_from_degrees_and_turns_a_minute() -> None:
    here = PLAIN.state(tilt="70 deg", spin="180 rpm", precession="-3 deg/s", nutation="0.1 rad/s")
    there = PLAIN.state(math.radians(70), 180 * RPM, math.radians(-3), 0.1)
    assert np.allclose(here.axial.m, there.axial.m, rtol=1e-14) and np.allclose(here.a, there.a, rtol=1e-14)
    assert PLAIN.slow_precession("180 rpm") == pytest.approx(PLAIN.slow_precession(180 * RPM), rel=1e-14)
    assert PLAIN.steady_precession("70 deg", "500 rpm") == pytest.approx(
        PLAIN.steady_precession(math.radians(70), 500 * RPM), rel=1e-13
    )
    assert PLAIN.nutation_rate("1 turn/s") == pytest.approx(PLAIN.nutation_rate(2 * math.pi))
    assert np.allclose(PLAIN.orientation("70 deg"), PLAIN.orientation(math.radians(70)), rtol=1e-14)
    assert PLAIN.dt("1 ms") == pytest.approx(1e-3 / PLAIN.time_unit) == PLAIN.dt(1e-3)


def test_an_ellipsoid_with_units() -> None:
    plain = Ellipsoid.of_density((0.15, 0.1, 0.05), 998.2, 998.2)
    body = Ellipsoid.of_density(("15 cm", "10 cm", "5 cm"), "0.9982 g/cm^3", "998.2 kg/m^3")
    assert np.allclose(body.added_masses, plain.added_masses, rtol=1e-13)
    x, y = body.state(("0.1 m/s", "1 mm/s", 0.0), ("0 rpm", "1 rpm", 0.01)), plain.state((0.1, 1e-3, 0), (0, RPM, 0.01))
    assert np.allclose(x.axial.M, y.axial.M, rtol=1e-13) and np.allclose(x.P, y.P, rtol=1e-13)


@pytest.mark.parametrize("rate", ["3 Hz", "0.003 kHz", "3 1/s", "180 1/min", "3 cps"])
def test_a_frequency_is_no_angular_velocity(rate: str) -> None:
    """Pint takes a hertz for a radian a second, though three turns are 18.85 rad; 1/s and 1/min may count either."""
    ureg = pint.get_application_registry()
    assert ureg.Quantity(rate).to("rad/s").magnitude == pytest.approx(3.0)
    calls = (
        lambda: PLAIN.slow_precession(rate),
        lambda: PLAIN.nutation_rate(ureg.Quantity(rate)),
        lambda: PLAIN.state(1.0, rate),
        lambda: PLAIN.state(1.0, 1.0, precession=rate),
        lambda: FreeBody((1, 2, 3)).state((0, 0, rate)),
        lambda: FreeBody((1, 2, 3)).rotation(rate, (1, 1, 1)),
        lambda: FreeBody((1, 2, 3)).stability(rate),
        lambda: BODY.state((0, rate, 0)),
        lambda: Ellipsoid.of_density((0.15, 0.1, 0.05), 998.2, 998.2).state((0, 0, 0), (0, 0, rate)),
    )
    for call in calls:
        with pytest.raises(kr.InputError, match="'3 turn/s' or '180 rpm'"):
            call()


def test_rates_of_turns_and_of_radians() -> None:
    """By hand, pint and astropy: three turns a second are 18.85 rad/s."""
    from astropy import units as u

    turns = ("3 turn/s", "180 rpm", "3 rps", "3 cycle/s", "3 revolution/s", "1080 deg/s", "18.84955592153876 rad/s")
    for rate in (*turns, 3 * u.cycle / u.s, 1080 * u.deg / u.s):
        assert PLAIN.nutation_rate(rate) == pytest.approx(PLAIN.nutation_rate(3 * 2 * math.pi), rel=1e-14)
    with pytest.raises(kr.InputError, match="'20 rpm' or '3 turn/s', got '3 rev/s'"):
        PLAIN.nutation_rate("3 rev/s")
    with pytest.raises(u.UnitConversionError):
        (3 * u.Hz).to("rad/s")
    with pytest.raises(kr.InputError, match="not convertible"):
        PLAIN.nutation_rate(3 * u.Hz)


def test_quantities_of_astropy_have_their_units() -> None:
    from astropy import units as u

    body = gyroscope(mass=3000 * u.g, axial_moment=1700 * u.kg * u.cm**2, lever=15 * u.cm)
    assert body.mass == pytest.approx(3.0) and body.axial_moment == pytest.approx(0.17)
    assert body.lever == pytest.approx(0.15)
    assert HeavyBody("2 kg", [0.11, 0.13, 0.15], [2, 5, 12] * u.cm).arm == pytest.approx((0.02, 0.05, 0.12))
    assert HeavyBody("2 kg", [0.11, 0.13, 0.15], (2 * u.cm, "5 cm", 0.12)).arm == pytest.approx((0.02, 0.05, 0.12))
    with pytest.raises(kr.InputError, match="mass must have the dimension of kg"):
        gyroscope(mass=3 * u.m)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mass": "3 m"}, "mass must have the dimension of kg, got 3 meter"),
        ({"lever": "3"}, "lever must have the dimension of m"),
        ({"lever": "3 furlongz"}, "lever must be a quantity such as '1 m', got '3 furlongz'"),
        ({"lever": "--"}, "lever must be a quantity"),
        ({"lever": "1,5 cm"}, "lever must be a quantity such as '1 m', got '1,5 cm': write 1.5"),
        ({"lever": "0,015 m"}, "lever must be a quantity"),
        ({"mass": "1 500 g"}, "mass must be a quantity such as '1 kg', got '1 500 g'"),
        ({"lever": f"{np.float64(3.0)!r} cm"}, r"got 'np.float64\(3.0\) cm'"),
        ({"lever": "-15 cm"}, "lever must be a finite number > 0"),
        ({"lever": "nan cm"}, "lever"),
        ({"mass": [["3 kg", "4 kg"]]}, "Lane 0: mass must be a finite number"),
    ],
)
def test_wrong_quantities(changes: dict[str, object], said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        gyroscope(**changes)


def test_plain_numbers_need_no_pint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pint", None)
    units.registry.cache_clear()
    try:
        run = kr.simulate(PLAIN.model(), PLAIN.state(1.2, 20.0), dt=PLAIN.dt(1e-3), steps=5)
        assert units.measured(run, PLAIN.scales()).time[-1] == pytest.approx(5e-3)
        with pytest.raises(kr.InputError, match=r"kreisel\[units\]"):
            gyroscope()
    finally:
        units.registry.cache_clear()


def test_a_run_in_si_and_other_units() -> None:
    run = kr.simulate(PLAIN.model(), PLAIN.state(1.2, 20.0), dt=PLAIN.dt("1 ms"), steps=50)
    si = units.measured(run, PLAIN.scales())
    assert si.time[-1] == pytest.approx(0.05) and si.time.units == "s" and "time" in si.indexes
    joules = PLAIN.axial_moment**2 / PLAIN.transverse_moment * 200 + PLAIN.weight_torque * math.cos(1.2)
    assert si.energy[0] == pytest.approx(joules, rel=1e-13) and si.energy.units == "J"
    momentum = PLAIN.axial_moment * 20.0
    assert si.m.values[0] @ run.a.values[0] == pytest.approx(momentum, rel=1e-13) and si.m.units == "kg m^2/s"
    assert np.array_equal(si.a, run.a) and si.spectrum.units == "1"
    other = units.measured(run, PLAIN.scales(), time="ms", energy="mJ")
    assert other.time[-1] == pytest.approx(50) and other.time.units == "ms"
    assert np.allclose(other.energy, 1000 * si.energy)
    assert units.quantity(other.energy).to("J").magnitude[0] == pytest.approx(joules)
    assert run.time[-1] == pytest.approx(50 * PLAIN.dt(1e-3))  # the run itself is as it was
    assert "dt" not in si.attrs and "title" in si.attrs
    with pytest.raises(kr.InputError, match="got 'speed'"):
        units.measured(run, PLAIN.scales(), speed="m/s")
    with pytest.raises(kr.InputError, match="dimension"):
        units.measured(run, PLAIN.scales(), time="kg")
    with pytest.raises(kr.InputError, match="unit that pint knows"):
        units.measured(run, PLAIN.scales(), time="secondz")
    with pytest.raises(kr.InputError, match="no attribute units"):
        units.quantity(run.m.drop_attrs())


def test_arrays_of_xarray_state_their_units() -> None:
    """A number with the attribute `units` is a quantity: what `units.measured` returns, and what files hold."""
    body = FreeBody((1, 2, 2.5))
    run = kr.simulate(body, body.state((0.1, 0.2, 1)), dt=0.1, steps=4)
    other = units.measured(run, time="ms", angular_velocity="deg/s", momentum="g cm^2/s")
    assert abs(other.angular_velocity[0] - np.rad2deg((0.1, 0.2, 1))).max() < 1e-12
    w = other.angular_velocity[-1]
    for rate in (w, run.angular_velocity[-1], [w[0], w[1], w[2]]):
        assert abs(body.state(rate).M - body.state(run.angular_velocity[-1].values).M).max() < 1e-14
    later = kr.simulate(body, body.state(w), dt=other.time[1], steps=2, t_start=other.time[3])
    assert abs(later.time - (0.3, 0.4, 0.5)).max() < 1e-15
    assert abs(kr.at(body, body.state(w), other.time[:3]).time - (0, 0.1, 0.2)).max() < 1e-15
    assert abs(body.angular_velocity(other.momentum) - run.angular_velocity).max() < 1e-14
    assert (
        body.inertia.tolist() == FreeBody(xr.DataArray([1e4, 2e4, 2.5e4], attrs={"units": "kg cm^2"})).inertia.tolist()
    )
    for units_of_it in ("m", "1/s", "furlongs"):
        with pytest.raises(kr.InputError, match="spin"):
            body.state(w.assign_attrs(units=units_of_it))


def test_rates_are_those_of_steady_precession() -> None:
    """In rad/s, the roots of Goldstein's quadratic; from variables in any unit, which they state."""
    slow, _ = PLAIN.steady_precession(1.2, 40.0)
    run = kr.simulate(PLAIN.model(), PLAIN.state(1.2, 40.0, precession=slow), dt=PLAIN.dt("1 ms"), steps=50)
    rates = analysis.rates(run)
    assert np.allclose(rates.precession, slow, rtol=1e-9) and np.allclose(rates.spin, 40, rtol=1e-9)
    assert rates.precession.units == rates.spin.units == "rad/s" and rates.tilt.units == "rad"
    in_units = [units.measured(run, m=unit).m for unit in ("kg m^2/s", "g cm^2/s")]
    for m in (run.m, run.m.values, *in_units):
        motion = PLAIN.motion(m, run.a)
        assert np.allclose(motion.precession, slow, rtol=1e-9) and np.allclose(motion.spin, 40, rtol=1e-9)
    with pytest.raises(kr.InputError, match=r"dimension of kg m\^2/s"):
        PLAIN.motion(run.m.assign_attrs(units="kg"), run.a)


# -- any body on a fixed point ------------------------------------------------------------------------


BODY = HeavyBody(mass=2.0, inertia=[[0.11, 0.02, 0.0], [0.02, 0.13, 0.01], [0.0, 0.01, 0.15]], arm=(0.02, 0.05, 0.12))
OMEGA, UP = np.array([3.0, -1.0, 4.0]), np.array([0.48, 0.6, 0.64])


def test_a_heavy_body_in_joules_and_back() -> None:
    x0 = BODY.state(OMEGA, UP)
    run = kr.simulate(BODY.model(), x0, dt=BODY.dt(1e-3), steps=200, order=4)
    si = units.measured(run, BODY.scales())
    joules = OMEGA @ BODY.inertia @ OMEGA / 2 + BODY.mass * BODY.gravity * BODY.arm @ UP
    assert float(si.energy[0]) == pytest.approx(joules, rel=1e-13)
    assert np.allclose(si.M[0], BODY.inertia @ OMEGA, rtol=1e-13)
    for M in (run.M, si.M, units.measured(run, M="g cm^2/s").M):
        assert np.allclose(BODY.angular_velocity(M)[0], OMEGA, rtol=1e-13)
    with pytest.raises(kr.InputError, match=r"row of units\.measured"):
        kr.simulate(BODY.model(), units.measured(run, M="g cm^2/s").isel(time=-1), dt=0.1, steps=1)
    assert float(abs(si.energy - si.energy[0]).max()) < 1e-9 * joules


def test_the_equation_of_motion_in_si() -> None:
    """I Omega' = I Omega x Omega - m g l x up, by differences of a run."""
    h = 1e-4
    run = kr.simulate(BODY.model(), BODY.state(OMEGA, UP), dt=BODY.dt(h), steps=2, order=8)
    M, up = run.M.values * (BODY.unit_moment / BODY.time_unit), run.P.values
    torque = np.cross(M[1], BODY.angular_velocity(run.M)[1]) - BODY.mass * BODY.gravity * np.cross(BODY.arm, up[1])
    assert np.allclose((M[2] - M[0]) / (2 * h), torque, rtol=1e-5, atol=1e-5)
    assert np.allclose((up[2] - up[0]) / (2 * h), np.cross(up[1], BODY.angular_velocity(run.M)[1]), atol=1e-5)


def test_the_angular_velocity_is_that_of_the_model() -> None:
    model, x = BODY.model(), BODY.state(OMEGA, UP)
    turn = kr.algebra.axial(model.call(model.system.velocity, x.M, x.P)) / BODY.time_unit
    assert np.allclose(turn, OMEGA, rtol=1e-13)


def test_a_symmetric_heavy_body_is_the_gyroscope() -> None:
    """The height of the axis in time, by the variational integrator of order 8 and by the closed form."""
    body = HeavyBody("3 kg", ("0.18 kg m^2", "0.18 kg m^2", "0.17 kg m^2"), ("0 cm", "0 cm", "15 cm"), "9.81 m/s^2")
    tilt, spin = 1.2, 20.0
    x = body.state((0.0, 0.0, spin), (-math.sin(tilt), 0.0, math.cos(tilt)))
    run = kr.simulate(body.model(), x, dt=body.dt("5 ms"), steps=200, order=8)
    seconds = units.measured(run, body.scales()).time
    at = kr.at(PLAIN.model(), PLAIN.state(tilt, spin), seconds.values / PLAIN.time_unit)
    assert np.allclose(run.P[:, 2], at.a[:, 2], atol=1e-9)
    assert np.ptp(at.a[:, 2].values) > 0.01


def test_steiner() -> None:
    centre = HeavyBody.about_centre("2 kg", (0.1, 0.1, 0.05), ("0 cm", "30 cm", "0 cm"))
    assert np.allclose(np.diag(centre.inertia), [0.1 + 2 * 0.09, 0.1, 0.05 + 2 * 0.09])
    assert np.allclose(BODY.mass_tensor, np.trace(BODY.inertia) / 2 * np.eye(3) - BODY.inertia)


def test_without_torque_the_time_unit_is_a_second() -> None:
    free = HeavyBody(1.0, (1.0, 2.0, 2.5), (0.0, 0.0, 0.0))
    assert free.time_unit == 1.0 and (free.model().params["A"] == 0).all()
    run = kr.simulate(free.model(), free.state((0.0, 3.0, 0.0)), dt=free.dt("10 ms"), steps=10)
    assert np.allclose(free.angular_velocity(run.M)[-1], (0, 3, 0))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"inertia": (1.0, 2.0, 3.5)}, "No body has"),
        ({"inertia": (-1.0, 1.0, 1.0)}, "No body has"),
        ({"inertia": (0.0, 0.0, 0.0)}, "No body has"),
        ({"inertia": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]}, "symmetric"),
        ({"inertia": 1.0}, "inertia must be finite values of shape"),
        ({"arm": (1.0, 2.0)}, "arm must be finite values of shape"),
        ({"arm": (1.0, 2.0, math.nan)}, "arm must be finite values"),
        ({"mass": 0.0}, "mass"),
        ({"gravity": -9.81}, "gravity must not be negative"),
    ],
)
def test_unphysical_bodies(changes: dict[str, object], said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        HeavyBody(**{"mass": 1.0, "inertia": (1.0, 1.0, 1.5), "arm": (0.0, 0.0, 0.1), **changes})


def test_unphysical_states() -> None:
    with pytest.raises(kr.InputError, match="up must not be the zero vector"):
        BODY.state(OMEGA, (0, 0, 0))
    with pytest.raises(kr.InputError, match="angular_velocity must be finite"):
        BODY.state((1, 2))


# -- tensors with units -------------------------------------------------------------------------------

SMALL = [[500.0, 100.0, -40.0], [100.0, 400.0, 60.0], [-40.0, 60.0, 300.0]]  # kg cm^2


def test_a_tensor_with_units() -> None:
    """Text in a matrix, one unit for all, quantities, arrays of any of them."""
    ureg, text = pint.get_application_registry(), [[f"{x} kg cm^2" for x in row] for row in SMALL]
    some = [["500 kg cm^2", 0.01, -0.004], [0.01, "0.04 kg m^2", 0.006], [-0.004, 0.006, 0.03]]
    forms = {
        "one unit": (SMALL, "kg cm^2"),
        "one unit of an array": (np.array(SMALL), "kg cm^2"),
        "text": text,
        "an array of text": np.array(text),
        "some text": some,
        "a quantity": np.array(SMALL) * ureg("kg cm^2"),
        "rows": [np.array(row) * ureg("kg cm^2") for row in SMALL],
        "quantities": [[x * ureg("kg cm^2") for x in row] for row in SMALL],
    }
    for name, value in forms.items():
        assert np.allclose(FreeBody(value).inertia, np.array(SMALL) * 1e-4, rtol=1e-14), name
    assert np.allclose(FreeBody(((5, 4, 3), "kg m^2")).inertia, np.diag([5.0, 4.0, 3.0]))
    assert FreeBody.box((3, "lb"), ([1, 2, 3], "ft")).mass == pytest.approx(3 * 0.45359237, rel=1e-12)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ((SMALL, "kg cm"), "must have the dimension of kg m"),
        ((SMALL, "furlongz"), "needs a unit that pint knows"),
        ((SMALL, "3 kg m^2"), "scaling factor"),
        ((["a", "b", "c"], "m"), "expected values and one unit"),
        ([["1 kg m^2", 2], [3]], r"'1 kg m\^2' for each or \(values, 'kg m\^2'\) for all"),
        (("3 kg m^2", "2 kg m^2"), r"'1 kg m\^2' for each"),
        ([[["1 kg m^2"] * 3] * 3] * 3, "Lane 0: No body has"),
    ],
)
def test_tensors_that_are_none(value: object, said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        FreeBody(value)
