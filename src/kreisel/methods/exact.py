"""method="exact": the flow of the Lagrange top for n = 3, in closed form at any time; others by their modules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.contract import Frame
from kreisel.errors import InputError
from kreisel.methods.exact_pair import exact_pair
from kreisel.methods.jacobi import jacobi
from kreisel.methods.motion import Motion
from kreisel.methods.nutation import Number, number, rationals
from kreisel.methods.observing import ORIENTATION, observer, orientation_outcome, with_orientation
from kreisel.methods.scheme import Orbit, Scheme
from kreisel.model import Model

KNOWN = ("lagrange-top", "lagrange-top-moving", "symmetric-top")
JACOBI = "euler-top"


def motion(frame: Frame, state: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Motion:
    """The motion in the rest frame; that of the moving frame at time 0 where the state is given there."""
    first, second = algebra.axial(state[0]), state[1]
    b, p = (second, constants["p"]) if frame is Frame.REST else (constants["A"], second)
    kappa = 1 / Fraction(float(constants.get("alpha", 1.0))) - 1  # omega = m + kappa (m.b) b/|b|^2
    return Motion(first, b, p, reach=reach, spin_factor=kappa)


def iterates(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Orbit:
    """The iterates of the paper's map in the rest frame, n = 3, in closed form; its clock counts steps.

    In (m, b), b = (I - eps/2 m) a + s |a|^2 p, the map is D_eps: k steps are the flow over k tau, then the turn k theta
    about p.  Both branches of r = |a|^2 as a function of the integrals occur; the state says which.
    """
    m, a, p = (rationals(v) for v in (algebra.axial(z0[0]), z0[1], constants["p"]))
    eps = Fraction(float(constants["eps"]))
    s, r, hat = eps * eps / 4, algebra.dot(a, a), algebra.hat(m)
    b = a - eps / 2 * algebra.act(hat, a) + s * r * p
    here = Motion(m, b, p, reach=0.0)
    known = here.integrals
    root = 2 * (known.A + s * known.J**2) / r - (1 + 2 * s * known.E + 2 * s * s * known.J * known.c)

    def clock() -> tuple[Number, Number]:
        step = number(here.ctx, eps)
        return (here.nutation.tau(step), here.nutation.theta(step)) if root >= 0 else here.nutation.beyond(step)

    here = Motion(m, b, p, reach=reach * abs(float(clock()[0])))
    tau, theta = clock()
    shift = float(s * r) * p.astype(np.float64)

    def at(M: Array, e: Array) -> tuple[Array, ...]:
        k = (M << np.maximum(e, 0).astype(object)) >> np.maximum(-e, 0).astype(object)
        m, b = here.iterate(k, tau, theta)
        hat = algebra.hat(m)
        return hat, algebra.resolvent(float(eps) / 2 * hat, (b - shift)[..., None])[..., 0]

    return at


def exact(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The exact flow, at any dt and any time, for the Lagrange top with n = 3 in either frame, and for the Euler top.

    The states are those at the exact times k dt, each from the closed form: errors do not grow with time, and
    all integrals are kept.  Raises `InputError` for other systems, n > 3 and an order.
    """
    system, frame = model.system, model.system.frame
    if system.baecklund is None and system.name not in (*KNOWN, JACOBI):
        raise InputError(
            f"No exact flow of {system.name} is known here: method='exact' is for the Lagrange top, Clebsch's case, "
            "Neumann's system and the Euler top with n = 3. Use another method, such as method='suris' or 'dop853'."
        )
    if model.n != 3:
        raise InputError(
            f"The exact flow is known for n = 3 only; n = {model.n} came. Use another method, such as method='suris'."
        )
    if order is not None:
        raise InputError(f"method='exact' has no order, it is the flow itself; order={order!r} came. Leave order out.")
    if system.name == JACOBI:
        return jacobi(model, oriented)
    if system.name not in KNOWN:
        if oriented:
            raise InputError(
                f"method='exact' of {system.name} does not carry the orientation. Use method='baecklund' with order=24."
            )
        return exact_pair(model, dt)
    observe, outcomes = observer(model, None, None)
    outcomes = {k: replace(o, kept=o.kind in ("casimir", "integral")) for k, o in outcomes.items()}
    if oriented:
        outcomes[ORIENTATION] = orientation_outcome(model)

    def orbit(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Orbit:
        here = motion(frame, z0, constants, reach)

        def at(M: Array, e: Array) -> tuple[Array, ...]:
            m, b, *turned = here.at(M, e, oriented=oriented or frame is Frame.MOVING)
            g = tuple(
                algebra.quaternion_product(start, q) if frame is Frame.MOVING else algebra.quaternion_product(q, start)
                for start, q in zip(z0[2:], turned, strict=False)
            )
            if frame is Frame.REST:
                return (algebra.hat(m), b, *g)
            back = algebra.rotation_matrix(turned[0]).mT
            return (algebra.hat(algebra.act(back, m)), algebra.act(back, z0[1]), *g)

        return at

    return Scheme(
        name="exact",
        components=with_orientation(model, oriented),
        constants=dict(model.constants),
        axes=model.axes,
        n=model.n,
        prepare=tuple,
        observe=observe,
        reopen=tuple,
        orbit=orbit,
        outcomes=outcomes,
    )
