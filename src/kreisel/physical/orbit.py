"""Orbits of satellites, in SI units."""

from __future__ import annotations

import contextlib
import datetime as dt
import math
import re
import warnings
from dataclasses import InitVar, dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import orbit as formulas_of_orbits
from kreisel.errors import InputError, InputWarning, doubt, explained, shown
from kreisel.physical.measures import convert_fields, finite_floats, in_range, si_number, si_numbers
from kreisel.record.table import EMPTY, Reader, Table, form_of, require_increasing
from kreisel.runs.geometry import orbit_frame

formulas = cast("Any", formulas_of_orbits)  # of a page, without types


@explained
class Primary(NamedTuple):
    """The central body: gravitational parameter mu, m^3/s^2; radius R, m; magnetic field R^3 g_1^0, T m^3; J2.

    Then the flattening of its ellipsoid, and whether it has the Earth's field, rotation, Sun and air at a date.

    B = -grad V,  V = R (R/r)^2 g_1^0 cos(theta) of the dipole along the axis: g_1^0 < 0 for the Earth, whose field
    points north over its equator.
    """

    name: str
    mu: float
    radius: float
    field: float = 0.0
    J2: float = 0.0
    flattening: float = 0.0
    earthly: bool = False


# mu, radius: WGS 84 for the Earth, with its flattening, JPL's planetary satellite ephemerides (SAT441) for Saturn,
# IAU 2015 B3 for the Sun.
# The field of the Earth: g_1^0 = -29350.0 nT of IGRF-14 (2025) for a radius of 6371.2 km.  Of Saturn: 21136 nT for
# 60268 km, Burton et al., Geophysical Research Letters 37 (2010) L24105.  J2: WGS 84, and of Saturn 16290.57e-6
# for 60330 km, Iess et al., Science 364 (2019) eaat2965.
EARTH = Primary(
    "Earth", formulas.EARTH, 6_378_137.0, -29_350.0e-9 * 6_371_200.0**3, 1.08262998905e-3, 1 / 298.257223563, True
)
SATURN = Primary("Saturn", 3.7931206e16, 6.0268e7, 21_136.0e-9 * 60_268_000.0**3, 16_290.57e-6 * (60_330 / 60_268) ** 2)
ASTRONOMICAL_UNIT = formulas.ASTRONOMICAL_UNIT
SUN = Primary("Sun", formulas.MU_SUN, 6.957e8)


def _checked(primary: Any) -> Primary:
    """The primary in SI.  Raises `InputError`."""
    if not isinstance(primary, Primary):
        raise InputError(f"primary: expected kr.physical.EARTH or another Primary, got {shown(primary)}.")
    mu = si_number(primary.mu, "m^3/s^2", "mu", positive=True)
    radius = si_number(primary.radius, "m", "radius of the primary", least=0.0)
    field, J2 = si_number(primary.field, "T m^3", "field"), si_number(primary.J2, "1", "J2 of the primary")
    return primary._replace(mu=mu, radius=radius, field=field, J2=J2)


DAY, MOST_DEGREE, MOST_ROWS = 86_400.0, 5, 2_000_000
CONSISTENT = 0.02  # of the length of a path: the largest part that is not by the velocities
CLOSE = 1e-9  # relative, of times
LOOSE = 3e-4  # of the distance: an error between rows, 2 km in a low orbit
FALLING = 0.05  # of mu/r^2: the oblateness of the Earth has 0.002, a polar orbit in a frame of the Earth 0.1
AHEAD_OF_UTC = {"TDB": 69.184, "TT": 69.184, "TAI": 37.0, "GPS": 18.0}  # s
J2000 = dt.datetime(2000, 1, 1, 12, tzinfo=dt.UTC)


def _date(epoch: Any, name: str = "epoch") -> dt.datetime | None:
    """A date in UTC, from ISO text, a date of Python, NumPy, pandas, astropy; None for None.  Raises `InputError`."""
    if epoch is None:
        return None
    epoch = _of_astropy(epoch)
    if isinstance(epoch, str):
        day, scale = re.fullmatch(r"(.*?)\s*([A-Za-z]{2,}\d?)?\s*", epoch, re.DOTALL).groups()  # type: ignore[union-attr]
        scale = (scale or "").upper()
        if scale in AHEAD_OF_UTC:
            raise InputError(
                f"{name}: expected a date in UTC, got {scale}, which is {AHEAD_OF_UTC[scale]:g} s ahead since 2017. "
                "Subtract these seconds, and leave the scale out."
            )
        epoch = day if scale == "UTC" else epoch
    try:
        day = epoch.item() if isinstance(epoch, np.datetime64) else epoch
        if isinstance(day, int):  # of nanoseconds
            day = epoch.astype("datetime64[us]").item()
        date = dt.datetime.fromisoformat(day if isinstance(day, str) else day.isoformat())
        return date.replace(tzinfo=dt.UTC) if date.tzinfo is None else date.astimezone(dt.UTC)
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise InputError(
            f"{name}: expected a date in UTC such as '2026-03-20T14:46:00', or a datetime, got {shown(epoch)}."
        ) from None


def _of_astropy(times: Any) -> Any:
    """A `Time` of astropy, of any scale, as dates of NumPy in UTC; other values unchanged."""
    return getattr(getattr(times, "utc", None), "datetime64", times)


class Rates(NamedTuple):
    """Secular rates of an orbit, rad/s."""

    node: float
    perigee: float
    mean_anomaly: float


@explained
@dataclass(frozen=True, eq=False)
class Orbit:
    """An orbit, in SI units, with time t in s from its epoch.

    semi_major_axis   m;  eccentricity, 0 <= e < 1
    inclination, node, perigee   rad: to the equator of the primary; of the ascending node; from it to the pericentre
    primary           `kr.physical.EARTH`, `SATURN`, `SUN`, or a user-defined `Primary`
    mean_anomaly      rad, at t = 0; 0, the default, at the pericentre
    true_anomaly      rad, at t = 0, instead of the mean anomaly
    epoch             the date of t = 0, UTC: ISO text such as "2026-03-20T14:46:00", or a datetime; None for no date
    J2                whether node, perigee and mean anomaly drift by the oblateness of the primary
    path              a `kr.Table` of displacements added to positions on this ellipse, m: see `from_table`

    Space is the frame of these angles; its third axis is the primary's.  Raises `InputError` unless the orbit is
    an ellipse outside the primary.  Warns with `InputWarning` of plain angles beyond 2 pi and of orbits in the air.
    The equations: `kreisel.bodies.orbit`.
    """

    semi_major_axis: float
    eccentricity: float = 0.0
    inclination: float = 0.0
    node: float = 0.0
    perigee: float = 0.0
    primary: Primary = EARTH
    mean_anomaly: float = 0.0
    epoch: Any = None
    J2: bool = False
    path: Table | None = None
    true_anomaly: InitVar[Any] = None

    def __post_init__(self, true_anomaly: Any) -> None:
        convert_fields(self, positive=True, semi_major_axis="m")
        convert_fields(self, eccentricity="1", inclination="rad", node="rad", perigee="rad", mean_anomaly="rad")
        vars(self).update(primary=_checked(self.primary), epoch=_date(self.epoch))
        formulas.check_eccentricity(np.array(self.eccentricity), "eccentricity")
        if true_anomaly is not None:
            self._set_mean_anomaly(si_number(true_anomaly, "rad", "true_anomaly"))
        if not isinstance(self.J2, bool):
            raise InputError(f"J2: expected True or False, got {shown(self.J2)}. The primary has its value.")
        if self.J2 and not self.primary.J2:
            raise InputError(f"J2=True: expected a primary with J2, got {self.primary.name}: Primary(..., J2=...).")
        if self.path is not None and not (isinstance(self.path, Table) and form_of(self.path.packed) == formulas.PATH):
            raise InputError(f"path: expected a table as Orbit.from_table has it, got {shown(self.path)}.")
        pericentre = np.asarray(self.pericentre)
        formulas.check_pericentre(pericentre, self.primary.radius, self.primary.name)
        for sentence in formulas.doubtful_orbit(pericentre, self.primary.radius, self.primary.name):
            doubt(sentence)
        in_range("The orbit", lambda: self.period)

    def _set_mean_anomaly(self, f: float) -> None:
        """M = E - e sin E,  tan E/2 = sqrt((1 - e)/(1 + e)) tan f/2."""
        if self.mean_anomaly:
            raise InputError("true_anomaly: expected none with a mean_anomaly, got both. Give one of the two.")
        e = self.eccentricity
        E = 2 * math.atan2(math.sqrt(1 - e) * math.sin(f / 2), math.sqrt(1 + e) * math.cos(f / 2))
        object.__setattr__(self, "mean_anomaly", E - e * math.sin(E))

    @classmethod
    def circular(
        cls, altitude: Any, inclination: Any = 0.0, node: Any = 0.0, primary: Primary = EARTH, **elements: Any
    ) -> Orbit:
        """A circular orbit at this altitude above the surface, m; `elements`: mean_anomaly, epoch, J2."""
        primary = _checked(primary)
        radius = si_number(altitude, "m", "altitude") + primary.radius
        return cls(radius, 0.0, inclination, node, 0.0, primary, **elements)

    @classmethod
    def from_state(cls, r: Any, v: Any, primary: Primary = EARTH, epoch: Any = None, J2: bool = False) -> Orbit:
        """The orbit through a position r (3,), m, with the velocity v (3,), m/s, in space at t = 0.

        With J2 it is a mean ellipse: its energy is the energy over the oblate primary, averaged over a
        revolution. So its speed at t = 0 differs from |v|, by some m/s in a low orbit, and its period is right.

        Raises `InputError` unless the orbit is an ellipse outside the primary.
        """
        r, v = (si_numbers(x, unit, name, ((3,),)) for x, unit, name in ((r, "m", "r"), (v, "m/s", "v")))
        primary = _checked(primary)
        h, size = np.cross(r, v), np.linalg.norm(r)
        energy = v @ v / 2 - primary.mu / size if size else 0.0
        if not energy < 0 or not h.any():
            raise InputError(
                f"r, v: expected a state on an ellipse, v^2 < 2 mu/r, got |r| = {size:g} m, |v| = "
                f"{np.linalg.norm(v):g} m/s. Usual cause: km for m, or a velocity along the position. A flyby is "
                "Orbit.from_table(times, positions, velocities)."
            )
        if J2:  # from the osculating to the mean energy: with the osculating one, 1000 km off after a day
            cls.from_state(r, v, primary)  # raises for an orbit through the primary, which has no mean ellipse
            sums = (3 * h[2] ** 2 / (h @ h) - 1) * (-2 * energy / (h @ h)) ** 1.5
            sums += 2 * (3 * (r[2] / size) ** 2 - 1) / size**3
            change = primary.mu * primary.J2 * primary.radius**2 / 4 * sums
            if not -v @ v / 2 < change < -energy:
                raise InputError(
                    f"r, v: expected a state with a mean ellipse, got the energy {energy:g} m^2/s^2, of which J2 = "
                    f"{primary.J2:g} makes {energy + change:g}. Usual cause: a nearly parabolic orbit. Use J2=False."
                )
            v, energy = v * math.sqrt(1 + 2 * change / (v @ v)), energy + change
            h = np.cross(r, v)
        node = math.atan2(h[0], 0.0 - h[1])  # an angle that is not defined is 0
        ascending = np.array([math.cos(node), math.sin(node), 0.0])
        across = np.cross(h / np.linalg.norm(h), ascending)
        to_perigee = np.cross(v, h) / primary.mu - r / size
        perigee = math.atan2(to_perigee @ across, to_perigee @ ascending)
        latitude = math.atan2(r @ across, r @ ascending)  # from the node
        return cls(
            -primary.mu / (2 * energy),
            float(np.linalg.norm(to_perigee)),
            math.atan2(math.hypot(h[0], h[1]), h[2]),
            node,
            perigee,
            primary,
            epoch=epoch,
            J2=J2,
            true_anomaly=latitude - perigee,
        )

    @classmethod
    def from_tle(cls, line1: str, line2: str, span: Any = None, every: Any = 60.0) -> Orbit:
        """The orbit of a two-line element set (needs sgp4), with t = 0 at its epoch.

        span    s, of a table of the positions of SGP4 from t = 0 on; None: the mean elements of the set, with the drift
                by J2 and without an end, some km from SGP4 in a low orbit, more with every day of drag
        every   s, from one position of the table to the next

        Velocities are the rates of the positions, from which SGP4's differ by 0.02 m/s in a low orbit.  Space is TEME,
        the true equator and mean equinox of the epoch.  Raises `InputError` for a set with another form or checksum,
        and for a satellite that decays within the span.
        """
        try:
            from sgp4.api import Satrec
        except ImportError:
            raise InputError("Orbit.from_tle needs the package sgp4: pip install 'kreisel[orbit]'.") from None
        for number, line in enumerate((line1, line2), 1):
            if not isinstance(line, str) or not re.fullmatch(f"{number} .{{67}}", line.rstrip()):
                raise InputError(
                    f"line{number}: expected line {number} of a two-line element set, 69 characters that begin with "
                    f"'{number} ', got {shown(line)}. Usual cause: the line with the name, or blanks that were lost."
                )
            digits = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
            if digits != int(line[68]):
                raise InputError(f"line{number}: expected the checksum {digits}, got {line[68]}: a digit is wrong.")
        sat = Satrec.twoline2rv(line1, line2)
        if sat.error:
            raise InputError(f"two-line elements: expected an orbit, got error {sat.error} of sgp4.")
        date = J2000 + dt.timedelta(days=(sat.jdsatepoch - 2451545.0) + sat.jdsatepochF)
        n = sat.xke * sat.a**-1.5 / 60  # rad/s
        elements = {"inclination": sat.inclo, "node": sat.nodeo, "perigee": sat.argpo, "mean_anomaly": sat.mo}
        mean = cls((EARTH.mu / n**2) ** (1 / 3), sat.ecco, **elements, epoch=date, J2=True)
        if span is None:
            return mean
        last, step = (si_number(x, "s", name, positive=True) for x, name in ((span, "span"), (every, "every")))
        times = np.linspace(0.0, last, max(MOST_DEGREE, math.ceil(last / step)) + 1)
        codes, km, _ = sat.sgp4_array(np.full(len(times), sat.jdsatepoch), sat.jdsatepochF + times / DAY)
        if codes.any():
            raise InputError(
                f"span: expected a time for which SGP4 has the satellite, got its error {codes.max()} after "
                f"{times[codes > 0][0] / DAY:.1f} days. Usual cause: a decayed orbit, or a set that is too old."
            )
        return mean._along(times, 1e3 * km, None)

    @classmethod
    def from_table(
        cls, times: Any, positions: Any, velocities: Any = None, primary: Primary = EARTH, epoch: Any = None
    ) -> Orbit:
        """The path through positions at given times, such as an ephemeris has.

        times       (k,), s from the epoch, or dates (k,) in UTC, with leap seconds, from the epoch or the first; k >= 6
        positions   (k, 3), m, in an inertial frame with the pole of the primary as third axis
        velocities  (k, 3), m/s; default: the rates of a spline through the positions

        Between the times it is a polynomial of degree 5 of the difference to an ellipse through the first state, whose
        elements `period` and the like have; with unequal times, resampled at equal ones.  Raises `InputError` for times
        that do not increase, positions inside the primary, velocities of another path, and times too unequal for that.
        Warns with `InputWarning` if most accelerations are not mu/r^2, as in a frame that rotates with the Earth, and
        of rows too far apart: without velocities fewer than about ten in a revolution, with velocities eight.
        """
        t, epoch, dated = None, _date(epoch), False
        with contextlib.suppress(TypeError, ValueError, AttributeError, InputError):  # of values with units
            dates = np.asarray([times] if isinstance(times, str) else _of_astropy(times))
            kind = dates.dtype.kind if dates.ndim == 1 else ""
            dated = kind == "M" or (kind in ("U", "O") and _date(dates[0]) is not None)
        if dated:
            from kreisel.storage.messages import leap_seconds

            rows = enumerate(dates if dates.dtype.kind == "M" else dates.tolist())
            days: list[Any] = [_date("None" if day is None else day, f"times[{i}]") for i, day in rows]
            days.insert(0, epoch or days[0])
            utc = np.array([day.replace(tzinfo=None) for day in days], dtype="datetime64[us]")
            t = (utc - utc[0]) / np.timedelta64(1, "s") + leap_seconds(utc) - leap_seconds(utc[0])
            t, epoch = t[1:], days[0]
        t = finite_floats(times, "s", "times") if t is None else t
        r = finite_floats(positions, "m", "positions")
        v = None if velocities is None else finite_floats(velocities, "m/s", "velocities")
        primary = _checked(primary)
        if t.ndim != 1 or len(t) <= MOST_DEGREE or r.shape != (len(t), 3) or (v is not None and v.shape != r.shape):
            raise InputError(
                f"from_table: expected six or more times (k,), and positions and velocities (k, 3), got times of shape "
                f"{t.shape}, positions of shape {r.shape}."
            )
        require_increasing(t, "times")
        distances = np.linalg.norm(r, axis=-1)
        if (least := distances.min()) <= primary.radius:
            raise InputError(
                f"positions: expected positions outside the {primary.name}, got {least:g} m from its centre at index "
                f"{distances.argmin()}. Usual cause: km for m."
            )
        return cls._near(t, r, v, primary, epoch)._along(t, r, v)

    @classmethod
    def _near(cls, t: Array, r: Array, v: Array | None, primary: Primary, epoch: Any) -> Orbit:
        """The ellipse through the first state; a circle as large as that, if there is none outside the primary."""
        from scipy.interpolate import make_interp_spline

        start = make_interp_spline(t, r, k=MOST_DEGREE).derivative()(t[0]) if v is None else v[0]
        with contextlib.suppress(InputError), warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # of an ellipse that nothing moves on
            orbit = cls.from_state(r[0], start, primary, epoch)
            back = orbit.mean_anomaly - orbit.mean_motion * t[0]
            return replace(orbit, mean_anomaly=math.remainder(back, 2 * math.pi))
        return cls(float(np.linalg.norm(r[0])), primary=primary, epoch=epoch)

    def _along(self, t: Array, r: Array, v: Array | None) -> Orbit:
        """The orbit with a path through these positions."""
        from scipy.interpolate import make_interp_spline

        near = self.at(t)
        spline = make_interp_spline(t, r - near[0], k=MOST_DEGREE)
        if v is None:
            slopes = spline.derivative()(t), spline.derivative(2)(t)
        else:
            rates = make_interp_spline(t, v - near[1], k=MOST_DEGREE)
            off, way = (abs(np.diff(x, axis=0)).sum() for x in (rates.antiderivative()(t) - (r - near[0]), r))
            if off > CONSISTENT * way:
                raise InputError(
                    f"velocities: expected the rates of the positions, got others, {off / way:.2%} of the path off. "
                    "Usual cause: km/s for m/s, times in another unit than s, a rotating frame, or rows too far apart."
                )
            slopes = v - near[1], rates.derivative()(t)
        table = Table(t, r - near[0], slopes)
        path = _equally_spaced(table)
        self._doubt_of(table)
        return replace(self, path=path)

    def _doubt_of(self, table: Table) -> None:
        """Warn of a path that does not fall by gravity, at its rows or between them."""

        def off(t: Array) -> tuple[Array, Array, Array]:
            near = self.at(t)[0]
            r = near + table(t)
            by_gravity, of_ellipse = (-self.primary.mu * (x.T / np.linalg.norm(x, axis=-1) ** 3).T for x in (r, near))
            return table(t, 2) + of_ellipse - by_gravity, by_gravity, r

        t = table.times
        wrong, gravity, _ = off(t)
        share = wrong / np.linalg.norm(gravity, axis=-1, keepdims=True)
        square = float(np.median((share[1:] * share[:-1]).sum(-1)))  # of noise, whose sign changes, it is negative
        if square > FALLING**2:
            return doubt(
                f"positions: expected a path with the acceleration mu/r^2 of the {self.primary.name}, got one that is "
                f"{math.sqrt(square):.0%} off. Usual cause: a frame that rotates with the Earth (ECEF, ITRF), or times "
                "in another unit than s."
            )
        middle, steps = (t[1:] + t[:-1]) / 2, np.diff(t)
        wrong, _, r = off(middle)
        error = np.linalg.norm(wrong, axis=-1) * (steps / math.pi) ** 2  # of a path that swings once in two steps
        worst = int(np.argmax(error / np.linalg.norm(r, axis=-1)))
        if error[worst] > LOOSE * np.linalg.norm(r[worst]):
            doubt(
                f"positions: expected rows close enough for a path that is exact to {LOOSE:g} of its distance, got one "
                f"that is off by about {error[worst] / 1e3:.0f} km at t = {middle[worst]:g} s. Usual cause: fewer than "
                "ten rows in a revolution, or steps too long for a pericentre. Give more rows, and velocities."
            )

    @property
    def mean_motion(self) -> float:
        """sqrt(mu/a^3), rad/s."""
        return math.sqrt(self.primary.mu / self.semi_major_axis) / self.semi_major_axis

    @property
    def period(self) -> float:
        """2 pi/mean_motion, s."""
        return 2 * math.pi / self.mean_motion

    @property
    def rates(self) -> Rates:
        """Rates of the node, of the perigee and of the mean anomaly, rad/s."""
        anomaly, _, _, _, node, perigee = self._constants[:6].tolist()
        return Rates(node, perigee, anomaly)

    @property
    def pericentre(self) -> float:
        """The least distance of the ellipse from the centre of the primary, m."""
        return self.semi_major_axis * (1 - self.eccentricity)

    @cached_property
    def distances(self) -> tuple[float, float]:
        """The least and the greatest distance from the centre of the primary, m; with a path, at its times."""
        if self.path is None:
            return self.pericentre, self.semi_major_axis * (1 + self.eccentricity)
        r = np.linalg.norm(self.at(self.path.times)[0], axis=-1)
        return float(r.min()), float(r.max())

    @property
    def days(self) -> float:
        """The epoch in days of UTC after 2000-01-01 12:00.  Raises `InputError` for an orbit without an epoch."""
        if self.epoch is None:
            raise InputError("The orbit has no date: expected Orbit(..., epoch='2026-03-20T14:46:00'), in UTC.")
        return float((self.epoch - J2000) / dt.timedelta(days=1))

    @property
    def elements(self) -> dict[str, Any]:
        """The orbit's parameters of `kreisel.bodies.orbit`."""
        names = ("semi_major_axis", "eccentricity", "inclination", "node", "perigee", "mean_anomaly")
        primary = {"mu": self.primary.mu, "radius": self.primary.radius, "J2": self.primary.J2 if self.J2 else 0.0}
        path = {"path": EMPTY if self.path is None else self.path.packed}
        return {name: getattr(self, name) for name in names} | primary | path

    @cached_property
    def _constants(self) -> Array:
        return formulas.of_elements(**{k: np.asarray(v) for k, v in self.elements.items() if k != "path"})

    @property
    def axes(self) -> Array:
        """At t = 0: to the pericentre, ahead of it, and the normal of the orbit, as columns (3, 3)."""
        return self.axes_at(0.0)

    def axes_at(self, time: Any) -> Array:
        """These axes of the mean ellipse at times (...), s, as columns (..., 3, 3): J2 rotates them."""
        return formulas.axes(finite_floats(time, "s", "time"), self._constants)

    def at(self, time: Any) -> tuple[Array, Array]:
        """Position, m, and velocity, m/s, at times in s (...): each (..., 3), in space.

        Raises `InputError` for times outside the path.
        """
        t = finite_floats(time, "s", "time")
        first, last = (-math.inf, math.inf) if self.path is None else self.path.span
        slack = CLOSE * (last - first)  # of dates as doubles
        if t.size and not first - slack <= t.min() <= t.max() <= last + slack:
            raise InputError(
                f"time: expected times of the path, {first:g} to {last:g} s from its epoch, got {t.min():g} to "
                f"{t.max():g}. Usual cause: state(...) and pointing(...), which begin at t = 0. Give state both "
                "attitude and spin, or count the times from another epoch."
            )
        path = Reader(np.zeros(4), formulas.PATH) if self.path is None else self.path
        r, v = formulas.place(np.clip(t, first, last), self._constants, path)
        return r, v

    def frame(self, time: Any) -> Array:
        """The axes of the orbit at times (...), as columns (..., 3, 3): up, ahead, and the normal of the orbit."""
        return orbit_frame(*self.at(time))

    @cached_property
    def first_frame(self) -> Array:
        """The axes of the orbit at t = 0."""
        return self.frame(0.0)

    def rate(self, time: Any = 0.0) -> Any:
        """The rate at which that frame rotates about the normal, |r x v|/r^2, rad/s."""
        r, v = self.at(time)
        return np.linalg.norm(np.cross(r, v), axis=-1) / (r * r).sum(-1)


def _equally_spaced(table: Table) -> Table:
    """The table, or one that has its values at equally spaced times to 1 m.  Raises `InputError`."""
    if not form_of(table.packed).halvings:
        return table
    t = table.times
    count = math.ceil((t[-1] - t[0]) / np.diff(t).min())
    if count < MOST_ROWS:
        even = np.linspace(t[0], t[-1], count + 1)
        result = Table(even, table(even), (table(even, 1), table(even, 2)))
        if abs(result(t) - table(t)).max() <= 1.0:
            return result
    raise InputError(
        f"from_table: expected times that are about equally spaced, got steps from {np.diff(t).min():g} to "
        f"{np.diff(t).max():g} s. Choose positions at equal steps from the ephemeris."
    )
