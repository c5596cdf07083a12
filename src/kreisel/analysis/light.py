"""kr.analysis.light_curve: the brightness of a body that rotates, from its convex shape and a law of scattering.

With the cosines mu_0, mu of the angles of the Sun and of the observer above the surface, where both are > 0,

    flux = f(alpha) integral S(mu_0, mu) dA,   S = mu mu_0/(mu + mu_0)   Lommel-Seeliger
                                               S = mu mu_0               Lambert
                                               S = mu                    geometric: the lit, visible cross-section

Facets are summed.  For an ellipsoid with half axes a, b, c and p = (s_1/a, s_2/b, s_3/c), q in the same way of the
observer's direction, the first and the last integral are

    (pi/2) a b c (|p||q| + p.q) h(y)/(|p| + |q|),   h = (1 - (1 - y^2) artanh(y)/y)/y^2,  y = |p + q|/(|p| + |q|),
    (pi/2) a b c (|p||q| + p.q)/|p|.

[Muinonen, Lumme, A&A 584 (2015) A23; Kaasalainen, Torppa, Muinonen, Icarus 153 (2001) 37: f(alpha), and the sum of the
first two laws with the weights 1 and 0.1]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array, dot, vec
from kreisel.analysis.quantities import rows_of
from kreisel.errors import InputError, doubt, explained, shown
from kreisel.physical.measures import finite_floats, si_number, si_numbers
from kreisel.physical.shapes import Facets
from kreisel.record.table import Table
from kreisel.runs.geometry import attitude_of
from kreisel.runs.in_si import is_in_si
from kreisel.runs.run_record import a_run, frame_of

LAWS = ("lommel-seeliger", "lambert", "geometric")
DAMIT = {"lommel-seeliger": 1.0, "lambert": 0.1}
SPEED_OF_LIGHT = 299_792_458.0  # m/s
BLOCK = 4_000_000  # facets times rows at a time
TINY = 1e-200  # 0 ln 0 = 0, and derivatives at opposition
THIN, TERMS = 0.05, 12  # y^2, and terms of the series in it

Light = Callable[[Array, Array], tuple[Array, Callable[[], tuple[Array, ...]]]]
# the flux of unit vectors (..., 3) to Sun and observer, and a function for its derivatives with respect to them


@explained
def light_curve(
    run: xr.Dataset,
    shape: Any = None,
    *,
    sun: Any,
    observer: Any,
    law: Any = "lommel-seeliger",
    phase: Any = None,
    light_time: bool = False,
) -> xr.Dataset:
    """The flux and the magnitude of a body at the rows of a run, or of `kr.at` states, that have an orientation.

    shape       half axes (3,) of an ellipsoid or `kr.physical.Facets`, along the axes in which the body was given;
                default: the shape of the body, `FreeBody.ellipsoid`
    sun         the vector from the body to the Sun in space: (3,), (time, 3), (time, lane, 3), or a `kr.Table` of time
                in s; only its direction counts: -run.position of an `Asteroid`
    observer    the vector from the body to the observer
    law         as for `brightness`, and phase
    light_time  if true, `observer` is in m, and the coordinate `arrival` is the time at which the light of each row
                arrives.  Rows are times at the body; the Sun is where its light comes from at that time

    Returns a Dataset (time) or (time, lane): flux, in the square of the unit of the shape (for unit distances and
    albedo), magnitude -2.5 log10(flux), phase_angle in rad.  Raises `InputError` for a run without an orientation.
    """
    g = attitude_of(a_run(run, "system"))
    dims, coords = rows_of(run)
    times = np.asarray(run["time"].values, dtype=np.float64) * (1 if is_in_si(run) else frame_of(run).time_unit)
    in_m = not isinstance(shape, Facets)  # which may have any unit
    shape = _shape_of(run) if shape is None else shape
    light = brightness(shape, law=law, phase=phase)
    ways = [_vectors(v, times, g.shape[:-1], name) for v, name in ((sun, "sun"), (observer, "observer"))]
    if max(v.ndim for v in ways) < g.ndim:  # the same of all lanes
        vectors = [v[:, None] for v in ways]
    else:
        vectors = ways = [v if v.ndim == g.ndim else v[:, None] for v in ways]
    flux, facets = np.empty(g.shape[:-1]), len(shape.faces) if isinstance(shape, Facets) else 1
    at = max(1, BLOCK // (facets * g[0].size))
    for i in range(0, len(g), at):
        rows = algebra.rotation_matrix(g[i : i + at]).mT
        flux[i : i + at] = light(*(algebra.act(rows, v[i : i + at]) for v in vectors))
    angle = _angle(*(v / np.linalg.norm(v, axis=-1, keepdims=True) for v in ways))
    with np.errstate(divide="ignore"):
        magnitude = -2.5 * np.log10(flux)
    data = {
        "flux": (dims, flux, {"long_name": "flux"} | ({"units": "m2"} if in_m else {})),
        "magnitude": (dims, magnitude, {"long_name": "magnitude", "units": "mag"}),
        "phase_angle": (dims[: angle.ndim], angle, {"long_name": "angle from the Sun to the observer", "units": "rad"}),
    }
    out = xr.Dataset(data, coords, {"title": run.attrs.get("title", "")})
    if light_time:
        near = float(np.linalg.norm(ways[1], axis=-1).min())
        if in_m and near < np.max(shape):
            doubt(
                f"observer: expected distances in m for light_time, got {near:g} m, inside the body. Usual cause: "
                "au for m. Give (values, 'au')."
            )
        arrival = (times + (np.linalg.norm(ways[1], axis=-1) / SPEED_OF_LIGHT + 0 * angle).T).T
        out = out.assign_coords(arrival=(dims[: angle.ndim], arrival, {"long_name": "time of arrival", "units": "s"}))
    return out


@explained
def brightness(shape: Any, *, law: Any = "lommel-seeliger", phase: Any = None) -> Callable[[Array, Array], Array]:
    """The flux as a function f(sun, observer) of vectors (..., 3) along the axes of the body, from it: of any length.

    shape   half axes (3,) of an ellipsoid, or `kr.physical.Facets`
    law     "lommel-seeliger", "lambert", "geometric", "damit", or weights: {"lommel-seeliger": 1, "lambert": 0.1} is
            "damit".  Lambert's law has no closed form for ellipsoids: `Facets.ellipsoid`
    phase   (A, D, k) of f(alpha) = A exp(-alpha/D) + k alpha + 1, alpha in rad; default: f = 1.  Raises `InputError`
            for f <= 0 at an angle, warns with `InputWarning` of D above pi

    The function works on arrays of NumPy and of JAX, with derivatives: with the orientation g of an observable of
    `kr.fit` it is f(g.T @ sun, g.T @ observer).  Raises `InputError`.
    """
    weights = weights_of(law)
    if isinstance(shape, Facets):
        body = of_facets(shape, weights)
    else:
        axes = si_numbers(shape, "m", "shape", ((3,),))
        if axes.min() <= 0:
            raise InputError(f"shape: expected three half axes > 0, or Facets, got {shown(shape)}.")
        if "lambert" in weights:
            raise InputError(
                f"law: expected one of lommel-seeliger and geometric for an ellipsoid, got {shown(law)}, which has no "
                "closed form. Give shape=kr.physical.Facets.ellipsoid(half_axes)."
            )
        body = of_ellipsoid(axes, weights)
    of_phase = phase_function(phase)

    def flux(sun: Array, observer: Array) -> Array:
        ways = (np.asarray(v, np.float64) if isinstance(v, list | tuple) else v for v in (sun, observer))
        s, o = (v / algebra.vec(algebra.sqrt(dot(v, v))) for v in ways)
        return body(s, o)[0] * of_phase(s, o)

    return flux


def phase_function(phase: Any) -> Callable[[Array, Array], Any]:
    """f(alpha) of unit vectors, by its (A, D, k), or 1 for None.  Raises `InputError`."""
    if phase is None:
        return lambda s, o: 1.0
    A, D, k = si_numbers(phase, "1", "phase", ((3,),))
    if D == 0:
        raise InputError(f"phase: expected (A, D, k) with D other than 0, got {shown(phase)}.")
    if abs(D) > np.pi:
        doubt(f"phase: expected D below pi, got {D:g} rad. Usual cause: degrees for radians, in k too.")

    def factor(s: Array, o: Array) -> Array:
        alpha = _angle(s, o)
        value = A * _namespace(alpha).exp(-alpha / D) + k * alpha + 1
        if not isinstance(s, np.ndarray) or (value > 0).all():  # arrays of JAX have no values
            return value
        raise InputError(
            f"phase: expected (A, D, k) with f > 0, got {shown(phase)}, f = {value.min():.3g} at the phase angle "
            f"{alpha[value <= 0].min():.3g}. Usual cause: a fit to smaller phase angles, or degrees for radians."
        )

    return factor


def of_facets(shape: Facets, weights: Mapping[str, float]) -> Light:
    """The flux of a convex shape and its slopes."""
    normals, areas = shape.normals, shape.areas

    def light(s: Array, o: Array) -> tuple[Array, Callable[[], tuple[Array, ...]]]:
        mu0, mu = s @ normals.T, o @ normals.T
        seen = (mu0 > 0) & (mu > 0)
        share = mu / (mu + mu0 + (1 - seen) * 4)
        laws = {"lommel-seeliger": lambda: share * mu0, "lambert": lambda: mu * mu0, "geometric": lambda: mu}

        def slopes() -> tuple[Array, ...]:
            by_sun = {"lommel-seeliger": lambda: share * share, "lambert": lambda: mu, "geometric": lambda: 0 * mu}
            by_view = {"lommel-seeliger": lambda: (1 - share) ** 2, "lambert": lambda: mu0, "geometric": lambda: 1.0}
            ways = (sum(w * by[name]() for name, w in weights.items()) for by in (by_sun, by_view))
            return tuple((way * seen * areas) @ normals for way in ways)

        return (sum(w * laws[name]() for name, w in weights.items()) * seen) @ areas, slopes

    return light


def of_ellipsoid(axes: Array, weights: Mapping[str, float]) -> Light:
    """The flux of ellipsoids with half axes (..., 3) and its slopes, the third with respect to 1/axes^2."""
    inverse, size = 1 / axes, np.pi / 2 * axes.prod(-1)
    lommel, geometric = weights.get("lommel-seeliger", 0), weights.get("geometric", 0)

    def light(s: Array, o: Array) -> tuple[Array, Callable[[], tuple[Array, ...]]]:
        p, q = s * inverse, o * inverse
        P, Q, C, X2 = algebra.sqrt(dot(p, p)), algebra.sqrt(dot(q, q)), dot(p, q), _cross_squared(p, q) + TINY
        where, S, near = _namespace(C).where, P + Q, P * Q + abs(C)
        sum_, apart = where(C < 0, X2 / near, near), where(C < 0, near, X2 / near)  # |p||q| + p.q, |p||q| - p.q
        W2 = (P - Q) ** 2 + 2 * sum_
        h, A = _shares(W2 / (S * S), 2 * apart / (S * S), where)
        flux = size * sum_ * (lommel * h / S + geometric / P)

        def slopes() -> tuple[Array, ...]:
            k = lommel * sum_ * (2 * A - 3 * h) / (2 * W2 * S)
            along = lommel * h / S
            by_sum = along * sum_ / S + 2 * k * W2 / S
            P2 = size * ((along * Q - by_sum) / (2 * P) + k - geometric * C / (2 * P**3))
            Q2 = size * ((along * P - by_sum + geometric) / (2 * Q) + k)
            by_C = size * (along + 2 * k + geometric / P)
            u, v = p * inverse, q * inverse
            by_sun, by_view = (2 * vec(x) * y + vec(by_C) * z for x, y, z in ((P2, u, v), (Q2, v, u)))
            return by_sun, by_view, vec(P2) * s * s + vec(Q2) * o * o + vec(by_C) * s * o - vec(flux / 2) * axes * axes

        return flux, slopes

    return light


def _shares(y2: Array, remainder: Array, where: Any) -> tuple[Array, Array]:
    """h = (1 - (1 - y^2) A)/y^2 and A = artanh(y)/y, by y^2 and 1 - y^2."""
    thin = y2 < THIN
    y = algebra.sqrt(where(thin, THIN, y2))
    ratio = (algebra.log(1 + y) - algebra.log(where(thin, 1 - THIN, remainder)) / 2) / y
    h, A = 0 * y2, 0 * y2
    for k in range(TERMS - 1, -1, -1):
        h, A = h * y2 + 2 / ((2 * k + 1) * (2 * k + 3)), A * y2 + 1 / (2 * k + 1)
    return where(thin, h, (1 - remainder * ratio) / (y * y)), where(thin, A, ratio)


def _cross_squared(p: Array, q: Array) -> Array:
    return sum((p[..., i] * q[..., j] - p[..., j] * q[..., i]) ** 2 for i, j in ((1, 2), (2, 0), (0, 1)))


def _angle(s: Array, o: Array) -> Array:
    """The angle between unit vectors, precise if it is small."""
    return _namespace(s).atan2(algebra.sqrt(_cross_squared(s, o) + TINY), dot(s, o))


def _namespace(x: Array) -> Any:
    return x.__array_namespace__()


def weights_of(law: Any) -> dict[str, float]:
    """The weights of the laws, by name.  Raises `InputError`."""
    if isinstance(law, Mapping):
        weights = {name: si_number(w, "1", f"law, {shown(name)}") for name, w in law.items()}
    else:
        weights = {} if not isinstance(law, str) else DAMIT if law == "damit" else {law: 1.0}
    if not weights or not set(weights) <= set(LAWS) or min(weights.values()) < 0:
        raise InputError(
            f"law: expected one of {', '.join(LAWS)}, damit, or weights >= 0 of the first three by name, got "
            f"{shown(law)}."
        )
    return {name: w for name, w in weights.items() if w}


def _shape_of(run: xr.Dataset) -> Any:
    """The shape of the body of a run: half axes or facets.  Raises `InputError`."""
    kind, *half = frame_of(run).shape or ("",)
    if kind not in ("ellipsoid", "box") or not half:
        raise InputError(
            "shape: expected half axes (3,) of an ellipsoid, or kr.physical.Facets, got none, and a body without a "
            "shape or its size, which FreeBody.ellipsoid and Asteroid.ellipsoid have."
        )
    corners = np.array(np.meshgrid(*((-x, x) for x in half))).reshape(3, -1).T
    return np.array(half) if kind == "ellipsoid" else Facets.hull(corners)


def _vectors(value: Any, times: Array, rows: tuple[int, ...], name: str) -> Array:
    """Vectors (time, 3), or (time, lane, 3) if they are of each lane."""
    try:
        v = value(times) if isinstance(value, Table) else finite_floats(value, "m", name)
    except InputError as error:
        raise InputError(f"{name}: {str(error).removeprefix(f'{name}: ')}") from None
    if v.shape not in ((3,), (len(times), 3), (*rows, 3)):
        raise InputError(
            f"{name}: expected a vector from the body (3,), one for each of {len(times)} times (and lanes), or a "
            f"kr.Table with three components, got the shape {v.shape}."
        )
    if not (v * v).sum(-1).all():
        raise InputError(f"{name}: expected a direction from the body, got the zero vector.")
    return v if v.ndim > 2 else np.broadcast_to(v, (len(times), 3))
