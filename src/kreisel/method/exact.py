"""method="exact": the flow of the Lagrange top and of free bodies, n = 3, in closed form; others by a pair of maps.

The flow over dt is then that of copies of one conjugate pair of Bäcklund maps.  For n = 3 the commuting fields span two
directions in addition to the symmetry of the state, so two parameters suffice: mu, complex, with
D_eps D_conj(eps) = Phi_h, eps = 2/mu.  It is found once a trajectory by Newton's method in extended precision against a
product of order 24; near h = 0 it is the zero of the Padé approximant of order 4 over h.  The integrals of the map are
those of the flow.  A rotation that commutes with the maps, `spin`, is applied as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact import gyrostat
from kreisel.exact.motion import UNTURNED, TopMotion
from kreisel.exact.nutation import MpNumber, mp_number, rationals
from kreisel.exact.rotor import Rotor
from kreisel.method.baecklund import pade_zeros, spin_turns, stage, stage_points, turned_with_body
from kreisel.method.records import METHODS
from kreisel.method.scheme import SPINS, Jump, Only, Orbits, Scheme, Spin, State, Steps, observer, scheme_of
from kreisel.record.calling import call
from kreisel.record.contract import Frame, Orbit, States
from kreisel.record.model import Model
from kreisel.record.values import in_lane
from kreisel.system import find


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


REACH = 6.0  # rate times time of a pair that is tried first: of 40 random bodies it was found for all
MOST_TRIALS = 8  # each with more copies
NEWTON_STEPS = 14
SETTLED = 64  # residual in units of the last place of the extended values
FAR = 1e-9  # residual above which M and P may count alike
# Of each attempt: the shift of mu for differences, the ridge of the squares, and the residual above which it holds and
# M and P count alike.  The first has neither.
SLOPES = (np.sqrt(np.finfo(np.longdouble).eps), 0.0, np.inf), (1e-7, 1e-13, FAR), (3e-10, 1e-10, FAR)
BETWEEN = 20  # steps between projections at most: 1 % of the time; with 500 errors are four to twenty times as large
LEAST_REAL = 0.5  # of mu h, which is 3 for short times
MOST_COPIES = 1_000_000  # of a pair in a step: tens of megabytes a lane


def exact_pair(model: Model, dt: float, oriented: bool) -> Scheme:
    """The exact flow of a body in e*(3) with Bäcklund maps, or of its leaf; see the module.

    Raises `InputError` where no pair is found.
    """
    body, carry, back = _in_coadjoint(model)
    record: Any = body.system.baecklund
    spins = record.spin is not None
    observe, outcomes = observer(model, oriented, conserved=("casimir", "energy", *model.system.integrals))

    def observed(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        out = observe((*back(z[:2]), *z[2:]), only, **constants)
        # on a leaf <x, q> = 0 is <M, P> = 0, which (x, q) do not show and rounding would lose
        if body is not model and "casimir" in out:
            out["casimir"] = np.stack([out["casimir"][..., 0], algebra.dot(algebra.axial(z[0]), z[1])], -1)
        return out

    def prepare(x0: State) -> State:
        return (*carry(x0[:2]), *x0[2:])

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        state = carry(x0[:2])
        copies, mu = parameter(body, state, dt)
        rho = call(record.point, _wide(state), {**_wide_constants(body), "mu": mu})
        numbers = {"mu_re": mu.real, "mu_im": mu.imag, "rho_re": rho.real, "rho_im": rho.imag}
        stages = {k: np.repeat(np.asarray(v, dtype=np.float64)[..., None], copies, -1) for k, v in numbers.items()}
        constants = _turn_in_space(body, state, x0[2], dt, copies, mu) if oriented else {}
        turns = spin_turns(body.call(record.spin, *state), dt) if spins else ()
        return constants | dict(zip(SPINS, turns, strict=False)), stages

    def step(*z: Array, mu_re: Array, mu_im: Array, rho_re: Array, rho_im: Array, **constants: Array) -> State:
        mu, rho = algebra.complex_number(mu_re, mu_im), algebra.complex_number(rho_re, rho_im)
        return stage(record, z, 2, {**constants, "mu": mu, "rho": rho}, True, True)

    def close(*z: Array, **constants: Array) -> State:
        state = turned_with_body(body.system.space.kinds, z[:2], constants, record.axis) if spins else z[:2]
        for g in z[2:]:  # turned in space by the quaternion (cos, sin), and in the body by the spin
            turn = algebra.quaternion(constants["cos"], constants["sin"] + 0 * g[..., 1:])
            g = algebra.unit(algebra.quaternion_product(turn, g))
            for half in SPINS if spins else ():
                g = algebra.turn_right(g, constants[half])
            state = (*state, g)
        return tuple(state)

    numbers = dict.fromkeys(["mu_re", "mu_im", "rho_re", "rho_im", "cos"], 0)
    return scheme_of(
        "exact",
        body,
        Steps(step, close if oriented or spins else None),
        (observed, outcomes),
        oriented,
        axes={**body.axes, **numbers, "sin": 1, **dict.fromkeys(SPINS, 2)},
        prepare=prepare,
        reopen=prepare,
        trajectory=trajectory,
        between=BETWEEN,
    )


def _in_coadjoint(model: Model) -> tuple[Model, Callable[[State], State], Callable[[State], State]]:
    """The body in e*(3) that moves as the model does, and the change of state there and back."""
    if "skew" in model.system.space.kinds:
        return model, lambda x: tuple(x[:2]), lambda z: z

    (relation,) = (r for r in model.system.relations if r.back is not None)
    params = {p.letter: model.constants[p.letter] for p in model.system.parameters}

    def carry(x: State) -> State:
        return tuple(relation.carry(*x[:2], None, **params)[0])

    def back(z: State) -> State:
        return tuple(call(relation.back, z, {}))

    return find(relation.target)(**params), carry, back


# -- the parameter of the pair ------------------------------------------------------------------------


def parameter(model: Model, state: State, dt: float) -> tuple[int, Array]:
    """(copies, mu): the pair with parameter mu, ([lane]), is the flow over dt/copies."""
    fastest = float(np.max(_rate(model, state)))
    if dt * fastest > MOST_COPIES * REACH:
        raise InputError(
            f"dt: expected at most {MOST_COPIES * REACH / fastest:.3g}, {MOST_COPIES:,} pairs of maps of "
            f"{model.system.name}, for method='exact', got {dt:g}. Use a smaller dt, and every=... to save as few rows."
        )
    copies = max(1, int(np.ceil(dt * fastest / REACH)))
    record: Any = model.system.baecklund
    first = np.asarray(complex(pade_zeros(2)[0]) / dt)
    with np.errstate(all="ignore"):
        result = np.isfinite(model.call(record.point, *state, mu=first))
    for _ in range(MOST_TRIALS if result.all() else 0):
        for slopes in SLOPES:
            mu, result = _newton(model, state, dt / copies, *slopes)
            if result.all():
                return copies, mu.astype(complex)
        copies = copies + max(1, copies // 2)
    zero = ~np.any(state[1], -1)
    if zero.any():
        raise InputError(
            f"method='exact' of {model.system.name}: expected a field P that is not zero{in_lane(zero)}, got 0, for "
            "which its pairs of maps have no direction. Use method='suris', of order 2, or 'dop853'; Clebsch's case is "
            "exact as kr.ClebschGeneral(a=b, b=b)."
        )
    raise InputError(
        f"No conjugate pair was found that is the flow of {model.system.name} over dt = {dt:g} or parts of it"
        f"{in_lane(~result)}. Usual causes: entries of b that are equal or nearly so; a state that is not finite. Use "
        "method='baecklund' with a high order, or 'dop853'."
    )


def _rate(model: Model, state: State) -> Array:
    """About the fastest rate of the motion, from its right-hand side linearised along the state."""
    flat, kinds, slopes = _flat(state), model.system.space.kinds, []
    sizes = _of_components(flat)
    for way in np.moveaxis(np.eye(6) * np.where(sizes > 0, sizes, 1)[..., None], -1, 0):
        # exact: the field is quadratic
        up, down = (model.flow(*algebra.restore(flat + s * way, kinds, 3)) for s in (0.5, -0.5))
        slopes.append((_flat(up) - _flat(down)) / way.max(-1, keepdims=True))
    J = np.stack(slopes, -1)
    across, back = (np.linalg.norm(block, axis=(-2, -1)) for block in (J[..., :3, 3:], J[..., 3:, :3]))
    unit = np.sqrt(np.divide(across, back, out=np.ones_like(back), where=(across > 0) & (back > 0)))[..., None, None]
    J[..., :3, 3:] /= unit  # of M over P: rates of any units
    J[..., 3:, :3] *= unit
    return np.linalg.norm(J, 2, (-2, -1))


def _flat(z: State) -> Array:
    return np.concatenate([algebra.coordinates(z[0]), z[1]], -1)


def _of_components(flat: Array) -> Array:
    """The largest |entry| of M, three times, and of P."""
    return abs(flat).reshape(*flat.shape[:-1], 2, 3).max(-1).repeat(3, -1)


def _wide(state: State) -> State:
    return tuple(np.asarray(x).astype(np.longdouble) for x in state)


def _wide_constants(model: Model) -> dict[str, Array]:
    return {k: np.asarray(v).astype(np.longdouble) for k, v in model.constants.items()}


def _pair(model: Model, z: State, mu: Array) -> State:
    """The conjugate pair in extended precision; it rotates an orientation too, but for a rotation about P in space."""
    record: Any = model.system.baecklund
    with np.errstate(all="ignore"):
        constants = {**_wide_constants(model), "mu": mu}
        constants["rho"] = call(record.point, z[:2], constants)
        return stage(record, z, 2, constants, True, True)


def _newton(model: Model, state: State, h: float, shift: float, ridge: float, least: float) -> tuple[Array, Array]:
    """mu of each lane in extended precision, and if it is one of the near branch."""
    z = _wide(state)
    batch = np.broadcast_shapes(*(v.shape for v in model.constants.values() if v.ndim > 1), ())[:-1]
    batch = np.broadcast_shapes(batch, state[1].shape[:-1])
    want, _ = _flown(model, z, h, batch)
    target, last = _flat(want), np.finfo(np.longdouble).eps
    mu = np.full(batch, complex(pade_zeros(2)[0]) / h, dtype=np.clongdouble)
    sizes = _of_components(np.maximum(abs(_flat(z)), abs(target)))
    sizes = np.where(sizes > 0, sizes, 1)

    def missed(mu: Array) -> Array:
        return np.asarray((_flat(_pair(model, z, mu[()])) - target) / sizes)

    for _ in range(NEWTON_STEPS):
        miss = missed(mu)
        if (abs(miss) <= SETTLED * last).all():
            break
        change = shift * abs(mu)
        slopes = np.stack([(missed(mu + change * way) - miss) / change[..., None] for way in (1, 1j)])
        # next to a small P, M hardly changes: far from mu, what P misses to second order would hide the slope of M
        far, rates = abs(miss).max(-1) > least, _of_components(slopes).max(0)
        weights = np.where(far[..., None], np.maximum(rates, FAR * rates.max(-1, keepdims=True)), 1)
        change = _least_squares(slopes / weights, -miss / weights, np.where(far, ridge, last))
        most = abs(mu) / 3
        size_of = abs(change)
        mu = mu + change * np.where(size_of > most, most / np.where(size_of > 0, size_of, 1), 1)
    near = (abs(miss).max(-1) <= SETTLED * last) & (mu.real * h > LEAST_REAL)
    return mu, near


def _flown(model: Model, z: State, h: float, batch: tuple[int, ...]) -> tuple[State, list[Array]]:
    """The flow over h by a product of order 24, and the mu of its pairs."""
    parts = max(1, int(np.ceil(h * float(np.max(_rate(model, tuple(x.astype(float) for x in z[:2])))))))
    points = [
        np.full(batch, mu, dtype=np.clongdouble)[()] for mu in stage_points(METHODS["baecklund"].orders[-1], h / parts)
    ] * parts
    for point in points:
        z = _pair(model, z, point)
    return z, points


def _turn_in_space(model: Model, state: State, g: Array, dt: float, copies: int, mu: Array) -> dict[str, Array]:
    """The rotation about p = g P that a step of the flow makes beyond the pairs: with them it commutes, so it is
    constant.

    In the product of order 24 each pair rotates by prod cay(eps/2 block) about p; the exact pair by the difference.
    """
    record: Any = model.system.baecklund
    unit = np.zeros((*mu.shape, 4), dtype=np.longdouble)
    unit[..., 0] = 1
    start = (*_wide(state), unit)
    true, points = _flown(model, start, dt / copies, mu.shape)
    pair = _pair(model, start, mu.astype(np.clongdouble)[()])
    P = state[1].astype(np.longdouble)
    along = P / np.sqrt(algebra.dot(P, P))[..., None]
    theta = algebra.dot(algebra.axial(call(record.block, start[:2], _wide_constants(model))), along)
    by_maps = sum(4 * np.arctan(theta / point).real for point in points)
    back = pair[2] * np.array([1, -1, -1, -1])
    left = algebra.quaternion_product(true[2], back)
    half = copies * (by_maps / 2 + np.arctan2(algebra.dot(left[..., 1:], along), left[..., 0]))
    axis = algebra.act(algebra.rotation_matrix(g.astype(np.longdouble)), along)
    axis = axis / np.sqrt(algebra.dot(axis, axis))[..., None]
    return {"cos": np.cos(half).astype(float), "sin": (np.sin(half)[..., None] * axis).astype(float)}


def _least_squares(slopes: Array, want: Array, ridge: Array) -> Array:
    """x + iy with x slopes[0] + y slopes[1] nearest to `want`."""
    (a, b), dot = slopes, algebra.dot
    aa, bb, ab, aw, bw = dot(a, a), dot(b, b), dot(a, b), dot(a, want), dot(b, want)
    ridge = ridge * (aa + bb)
    det = (aa + ridge) * (bb + ridge) - ab * ab
    return ((bb + ridge) * aw - ab * bw + 1j * ((aa + ridge) * bw - ab * aw)) / det
