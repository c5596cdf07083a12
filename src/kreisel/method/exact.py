"""method="exact": the flow of the Lagrange top and of free bodies, n = 3, in closed form; others by their modules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact.gyrostat import gyrostat
from kreisel.exact.motion import UNTURNED, TopMotion
from kreisel.exact.nutation import MpNumber, mp_number, rationals
from kreisel.exact.pairs import exact_pair
from kreisel.exact.rotor import Rotor
from kreisel.method.observing import observer, with_orientation
from kreisel.method.scheme import Jump, Orbit, Orbits, Scheme, Spin
from kreisel.record.calling import call
from kreisel.record.contract import Frame
from kreisel.record.model import Model


def motion(model: Model, state: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> TopMotion:
    """The motion in space of the top that the record states.  Raises `InputError` if it states none."""
    m, b, p = call(model.system.closed_form.top, state[:2], constants)
    kappa = 1 / Fraction(float(constants.get("alpha", 1.0))) - 1  # omega = m + kappa (m.b) b/|b|^2
    return TopMotion(algebra.axial(m), b, p, reach=reach, spin_factor=kappa)


def iterates(model: Model) -> Orbits | None:
    """The iterates of a map that is D_eps in other variables, n = 3, in closed form; None where it is not known to be.

    Its clock counts steps: k of them are the flow over k tau, then the turn k theta about p.  In the moving frame
    (-M, P, A) is the (m, a, p) of the rest frame.
    """
    if model.n != 3 or model.map.darboux is None:
        return None
    (fixed,) = (p.letter for p in model.system.parameters if p.fixed)
    sign = -model.system.space.sign

    def orbit(z0: tuple[Array, ...], given: Mapping[str, Array], reach: float) -> Orbit:
        return _iterated(model, tuple(z0), given, fixed, sign, reach)

    return Orbits(orbit)


def _iterated(
    model: Model, z0: tuple[Array, ...], given: Mapping[str, Array], fixed: str, sign: int, reach: float
) -> Orbit:
    """Both branches of rho as a function of the integrals occur; the state says which."""
    eps = Fraction(float(given["eps"]))
    exactly = {"eps": eps, fixed: rationals(given[fixed])}
    hat, b, rho = call(model.map.darboux, tuple(rationals(z) for z in z0), exactly)
    m, p, s = sign * algebra.axial(hat), exactly[fixed], eps * eps / 4
    r = rho / s
    here = TopMotion(m, b, p, reach=0.0)
    known = here.integrals
    root = 2 * (known.A + s * known.J**2) / r - (1 + 2 * s * known.E + 2 * s * s * known.J * known.c)

    def clock() -> tuple[MpNumber, MpNumber]:
        step = mp_number(here.ctx, eps)
        return (here.nutation.tau(step), here.nutation.theta(step)) if root >= 0 else here.nutation.beyond(step)

    here = TopMotion(m, b, p, reach=reach * abs(float(clock()[0])))
    constants = {"eps": np.asarray(float(eps)), "shift": float(s * r) * p.astype(np.float64)}

    def finish(m: Array, b: Array, q: Array, *, eps: Array, shift: Array) -> tuple[Array, ...]:
        hat = algebra.hat(m)
        return sign * hat, algebra.resolvent(eps / 2 * hat, (b - shift)[..., None])[..., 0]

    return here.orbit(finish, constants, clock())


def _jump(model: Model) -> Jump:
    """In the moving frame (-M, P, A) is the (m, a, p) of the rest frame."""
    inside = model.system.frame is Frame.MOVING

    def begin(*z: Array, **constants: Array) -> tuple[Array, Array, Array, Array, Array]:
        m, b, p = call(model.system.closed_form.top, z[:2], constants)
        axial, alpha = algebra.axial(m), constants.get("alpha", 1.0)
        return (-axial, p, b, alpha, 1.0) if inside else (axial, b, p, 1.0, alpha)

    def orientation(g: Array) -> Array:
        return algebra.inverse_turn(g) if inside else g

    def finish(m: Array, b: Array, *q: Array) -> tuple[Array, ...]:
        return (-algebra.hat(m) if inside else algebra.hat(m), b, *map(orientation, q))

    return Jump(begin, orientation, finish)


def _spin(model: Model) -> Spin:
    def begin(M: Array, *g: Array) -> tuple[Array, ...]:
        return algebra.axial(M), *g

    def moments(**constants: Array) -> Array:
        return np.asarray(call(model.system.closed_form.moments, (), constants))

    return Spin(begin, moments, lambda M, *g: (algebra.hat(M), *g))


def _orbit_of_top(model: Model, oriented: bool) -> Callable[..., Orbit]:
    inside = model.system.frame is Frame.MOVING

    def orbit(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Orbit:
        start = z0[2] if oriented else UNTURNED

        def finish(m: Array, b: Array, q: Array) -> tuple[Array, ...]:
            state = (-algebra.hat(m) if inside else algebra.hat(m)), b
            return (*state, algebra.inverse_turn(q) if inside else q) if oriented else state

        known = motion(model, z0, constants, reach)
        return known.orbit(finish, {}, inside=inside, start=algebra.inverse_turn(start) if inside else start)

    return orbit


def _orbit_of_body(model: Model, oriented: bool) -> Callable[..., Orbit]:
    def orbit(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Orbit:
        exactly = {p.letter: rationals(constants[p.letter]) for p in model.system.parameters}
        moments = call(model.system.closed_form.moments, (), exactly)
        return Rotor(algebra.axial(z0[0]), moments, reach, z0[1] if oriented else None).orbit()

    return orbit


def exact(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The exact flow, at any dt and any time, for the Lagrange top with n = 3 in either frame, and for free bodies.

    The states are those at the exact times k dt, each from the closed form: errors do not grow with time, and
    all integrals are conserved. Systems with
    Bäcklund transformations alone go by `exact_pair`, whose error grows.
    """
    system = model.system
    free = system.closed_form.moments is not None
    if system.closed_form.gyrostat is not None:
        return gyrostat(model, dt, oriented)
    if not free and system.closed_form.top is None:
        return exact_pair(model, dt, oriented)
    observe, outcomes = observer(model, None, None, oriented=oriented)
    outcomes = {k: replace(o, conserved=o.kind in ("casimir", "integral")) for k, o in outcomes.items()}
    return Scheme(
        name="exact",
        components=with_orientation(model, oriented),
        constants=dict(model.constants),
        axes=model.axes,
        n=model.n,
        prepare=tuple,
        observe=observe,
        reopen=tuple,
        motion=Orbits(_orbit_of_body(model, oriented), _spin(model))
        if free
        else Orbits(_orbit_of_top(model, oriented), _jump(model)),
        outcomes=outcomes,
    )
