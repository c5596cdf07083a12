"""method="exact": the flow of the Lagrange top and of free bodies, n = 3, in closed form; others by their modules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact import gyrostat
from kreisel.exact.motion import UNTURNED, TopMotion
from kreisel.exact.nutation import MpNumber, mp_number, rationals
from kreisel.exact.rotor import Rotor
from kreisel.method.observing import State, observer, scheme_of
from kreisel.method.pairs import exact_pair
from kreisel.method.scheme import Jump, Orbits, Scheme, Spin, Steps
from kreisel.record.calling import call
from kreisel.record.contract import Frame, Orbit, States
from kreisel.record.model import Model


def motion_of_top(model: Model, state: State, constants: Mapping[str, Array], reach: float) -> TopMotion:
    """The motion in space of the top that the record states.  Raises `InputError` if it states none."""
    m, b, p = call(model.system.closed_form.top, state[:2], constants)
    kappa = 1 / Fraction(float(constants.get("alpha", 1.0))) - 1  # omega = m + kappa (m.b) b/|b|^2
    return TopMotion(algebra.axial(m), b, p, reach=reach, spin_factor=kappa)


def iterated(model: Model, z0: State, constants: Mapping[str, Array], reach: float) -> Orbit:
    """The iterates of a map that is D_eps in other variables, n = 3.

    The clock counts steps: k of them are the flow over k tau, then the rotation k theta about p.  In the moving frame
    (-M, P, A) is the (m, a, p) of the rest frame.  Both branches of rho as a function of the integrals occur; the state
    states which.
    """
    (fixed,) = (p.letter for p in model.system.parameters if p.fixed)
    sign = -model.system.space.sign
    eps = Fraction(float(constants["eps"]))
    exactly = {"eps": eps, fixed: rationals(constants[fixed])}
    hat, b, rho = call(model.map.darboux, tuple(rationals(z) for z in z0), exactly)
    m, p, s = sign * algebra.axial(hat), exactly[fixed], eps * eps / 4
    r = rho / s
    top = TopMotion(m, b, p, reach=0.0)
    integrals = top.integrals
    root = 2 * (integrals.A + s * integrals.J**2) / r - (
        1 + 2 * s * integrals.E + 2 * s * s * integrals.J * integrals.c
    )

    def clock() -> tuple[MpNumber, MpNumber]:
        step = mp_number(top.ctx, eps)
        return (top.nutation.tau(step), top.nutation.theta(step)) if root >= 0 else top.nutation.beyond(step)

    top = TopMotion(m, b, p, reach=reach * abs(float(clock()[0])))

    def finish(m: Array, b: Array, q: Array, *, eps: Array, shift: Array) -> State:
        hat = algebra.hat(m)
        return sign * hat, algebra.resolvent(eps / 2 * hat, (b - shift)[..., None])[..., 0]

    return top.orbit(finish, {"eps": np.asarray(float(eps)), "shift": float(s * r) * p.astype(np.float64)}, clock())


def _top(model: Model, oriented: bool) -> Orbits:
    """In the moving frame (-M, P, A) is the (m, a, p) of the rest frame."""
    inside = model.system.frame is Frame.MOVING

    def begin(*z: Array, **constants: Array) -> tuple[Array, Array, Array, Array, Array]:
        m, b, p = call(model.system.closed_form.top, z[:2], constants)
        axial, alpha = algebra.axial(m), constants.get("alpha", 1.0)
        return (-axial, p, b, alpha, 1.0) if inside else (axial, b, p, 1.0, alpha)

    def orientation(g: Array) -> Array:
        return algebra.inverse_turn(g) if inside else g

    def finish(m: Array, b: Array, *q: Array) -> State:
        return (-algebra.hat(m) if inside else algebra.hat(m), b, *map(orientation, q))

    def orbit(z0: State, constants: Mapping[str, Array], reach: float) -> Orbit:
        start = orientation(z0[2] if oriented else UNTURNED)
        top = motion_of_top(model, z0, constants, reach)
        return top.orbit(lambda m, b, q: finish(m, b, *(q,) * oriented), {}, inside=inside, start=start)

    return Orbits(orbit, Jump(begin, orientation, finish))


def _body(model: Model, oriented: bool) -> Orbits:
    form, letters = model.system.closed_form.moments, [p.letter for p in model.system.parameters]

    def orbit(z0: State, constants: Mapping[str, Array], reach: float) -> Orbit:
        moments = call(form, (), {letter: rationals(constants[letter]) for letter in letters})
        return Rotor(algebra.axial(z0[0]), moments, reach, z0[1] if oriented else None).orbit()

    def begin(M: Array, *g: Array) -> State:
        return algebra.axial(M), *g

    def moments(**constants: Array) -> Array:
        return np.asarray(call(form, (), constants))

    return Orbits(orbit, Spin(begin, moments, lambda M, *g: (algebra.hat(M), *g)))


def _gyrostat(model: Model, dt: float, oriented: bool) -> Scheme:
    """The exact flow of a gyrostat; see `kreisel.exact.gyrostat`."""
    observed = observer(model, oriented, conserved=("casimir", "energy"))

    def of(z: State, constants: Mapping[str, Array]) -> gyrostat.Body:
        params = {p.letter: constants[p.letter] for p in model.system.parameters}
        return gyrostat.Body(algebra.axial(z[0]), params, model.system, oriented)

    def orbit(z0: State, constants: Mapping[str, Array], reach: float) -> States:
        body = of(z0, constants)

        def states(mantissa: Array, exponent: Array) -> State:
            times = [Fraction(int(m)) * Fraction(2) ** int(e) for m, e in zip(mantissa, exponent, strict=True)]
            M, *g = body.after(times, z0[1:])
            return algebra.hat(M.astype(float)), *(v.astype(float) for v in g)

        return states

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        body = of(x0, model.constants)
        time = np.full(body.L.shape, dt, dtype=np.longdouble)
        if not oriented:
            for lane in np.argwhere(body.speed * dt > gyrostat.FAR):
                (time[tuple(lane)],), _, _ = body.remainders(tuple(lane), [Fraction(dt)])
        constants, stage, maps = body.numbers(time)
        stages = {k: np.repeat(np.expand_dims(v.astype(float), time.ndim), maps, time.ndim) for k, v in stage.items()}
        return {k: v.astype(float) for k, v in constants.items()}, stages

    motion = Steps(gyrostat.step, iterates=Orbits(orbit))
    axes = {**model.axes, **gyrostat.AXES}
    return scheme_of("exact", model, motion, observed, oriented, axes=axes, trajectory=trajectory)


def exact(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The exact flow, at any dt and any time, for the Lagrange top with n = 3 in either frame, and for free bodies.

    The states are those at the exact times k dt, each from the closed form: errors do not grow with time, and
    all integrals are conserved.  Systems with only Bäcklund transformations use `exact_pair`, whose error grows.
    """
    form = model.system.closed_form
    if form.gyrostat is not None:
        return _gyrostat(model, dt, oriented)
    if form.moments is None and form.top is None:
        return exact_pair(model, dt, oriented)
    observe, outcomes = observer(model, oriented)
    outcomes = {k: replace(o, conserved=o.kind in ("casimir", "integral")) for k, o in outcomes.items()}
    motion = _top if form.moments is None else _body
    return scheme_of("exact", model, motion(model, oriented), (observe, outcomes), oriented)
