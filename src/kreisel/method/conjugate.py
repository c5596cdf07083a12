"""method="exact" and "baecklund" as products of conjugate pairs of Bäcklund maps near the imaginary axis of lam.

A pair at lam = x + iy is the flow of a function of the integrals whose field at the state of the start is

    int_0^x Re v(iy + t) dt,   v = `rates` of the record, analytic in lam.

Commuting fields that agree at one state agree on its torus, so points with sum_j int_0^(x_j) Re v(iy_j + t) dt = h f,
f the field of the flow, make a step that is the flow over h.  These are the Abelian conditions, without the integrals.
The heights y_j and the branches of mu are chosen where the x_j are smallest against the distance of the branch points,
by linear programming; Newton's method finds x_j, the fields at its ends are the columns of the Jacobian.  The body
rotates by int Omega; the difference to the angular velocity of the flow commutes with all it carries: a constant.

Without Newton's method, x_j = c_j h with sum c_j Re v(iy_j) = f is a step of order 2, since the pair is odd in x.  The
maps commute, and the pair at iy + x is defined for complex x too: with x_j = c_j eps_i, eps_i = 2 h/zeta_i for the
zeros of `kreisel.method.baecklund`, the order is 2 K.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from math import prod
from pkgutil import resolve_name
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import Identity, cached_property, reused
from kreisel.errors import InputError
from kreisel.exact.quadrics import lift
from kreisel.method.baecklund import constant_turns, stage_points
from kreisel.method.scheme import Scheme, State, Steps, as_matrix, observer, scheme_of
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs, ExactMap
from kreisel.record.model import Model

RANK = 1e-10  # relative: fields that depend on others
MOST_COPIES = 1_000_000
FINE, DEPENDENT, BEYOND, ELSEWHERE, COPIES, MISSED = range(6)  # verdicts of compiled code on a lane
BLOCK = 4096  # lanes at once
LIKE = 1e-6  # the orientation is off by 1e-16 over this ratio of two fields
COMPILED = "kreisel.kernels.exact.pairs"
NODES = 12  # of Gauss's rule, of a path without solving, and in a time
RULE = np.polynomial.legendre.leggauss(NODES)
SHARES, WEIGHTS = [*((1 + RULE[0]) / 2).tolist(), 1.0], (RULE[1] / 2).tolist()
NUMBERS, OF_MAP = ("lam_re", "lam_im", "mu_re", "mu_im"), ("z_re", "z_im", "w_re", "w_im")


def has_points(model: Model) -> bool:
    """Whether pairs, or a map that is the flow, are known for the dimension of the body."""
    pairs = model.system.pairs
    return model.system.exact_map is not None or (pairs is not None and model.n in pairs.dimensions)


def products(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The exact flow, or products of Bäcklund maps of an order.

    Raises `InputError` for an orientation that the map lacks, and where no points are found.
    """
    make = by_pairs if model.system.exact_map is None else by_map
    return make(model, dt, oriented, order)


def by_pairs(model: Model, dt: float, oriented: bool, order: int | None = None) -> Scheme:
    """The exact flow, or a step of an order, by conjugate pairs."""
    record = cast("ConjugatePairs", model.system.pairs)
    count, params = len(model.system.space.letters), parameter_rows(model)
    if record.require is not None:
        call(record.require, (), model.params)

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        if oriented:
            _require_like_fields(model, x0[:count])
        points, turn = constants(model, x0[:count], dt, order, params, oriented)
        stages = {name: points[..., i] for i, name in enumerate(NUMBERS)}
        if not oriented:
            return {}, stages
        g = as_matrix(model, x0[count])
        return constant_turns("turn", g @ algebra.skew(turn, model.n) @ g.mT, lambda theta: theta), stages

    def links(z: Array, stages: Array) -> list[Any]:
        c = np.ascontiguousarray(np.broadcast_to(params, (len(z), params.shape[-1])))
        return cast("list[Any]", _kernels().Rooms(model, z, c, dt, fractions(dt, order), 1).links(stages))

    def inner_angle(model: Model, x0: State) -> float:
        """Twice x over the distance of a branch point: its Padé approximant there has the error of an order."""
        _, z, c = _rows(model, x0[:count], parameter_rows(model))
        rooms = Tori(model, z, c, dt, 2, False).rooms
        return float(2 * np.max(abs(rooms["slope"] * dt) / (rooms["radius"] + rooms["none"])))

    def step(*z: Array, lam_re: Array, lam_im: Array, mu_re: Array, mu_im: Array, **constants: Array) -> State:
        point = {"lam": algebra.complex_number(lam_re, lam_im), "mu": algebra.complex_number(mu_re, mu_im)}
        state, turns = call(record.pair, z[:count], {**constants, **point})
        return (*state, *(reduce(algebra.turn_right, turns, g) for g in z[count:]))

    def close(*z: Array, turn0: Array, turn1: Array, **constants: Array) -> State:
        return (*z[:count], algebra.turn_left(turn1, algebra.turn_left(turn0, z[count])))

    name, options = _named(order)
    return scheme_of(
        name,
        model,
        Steps(step, close if oriented else None),
        observer(model, oriented, conserved=("casimir", "energy", *model.system.integrals)),
        oriented,
        axes={**model.axes, **dict.fromkeys(NUMBERS, 0), "turn0": 2, "turn1": 2},
        trajectory=trajectory,
        links=None if oriented else links,
        inner_angle=inner_angle,
        between=record.between,
        **options,
    )


def _require_like_fields(model: Model, state: State) -> None:
    """Raises `InputError` for a field so small next to another that its rounding would rotate the projected
    orientation.

    A step mixes the fields; a projection keeps the direction in space of each (an error of 7e-4 at a ratio of 1e-12).
    """
    space = model.system.space
    if len(space.carried) < 2:
        return
    sizes = np.stack([np.sqrt((state[i] * state[i]).sum(-1)) for i in space.carried])
    ratio = (sizes.min(0) / np.maximum(sizes.max(0), np.finfo(float).tiny)).min()
    if ratio < LIKE:
        raise InputError(
            f"orientation: expected fields {', '.join(space.letters[i] for i in space.carried)} of like sizes with "
            f"method='exact' of {model.system.name}, got one that is {ratio:.1g} of another; {LIKE:g} is the least. "
            "Use method='suris', or for one field kr.KovalevskayaTopE3."
        )


def by_map(model: Model, dt: float, oriented: bool, order: int | None = None) -> Scheme:
    """The exact flow by copies of one map, or a step of an order by several.

    The body rotates by g(t) = g z(psi) p, p P(t) = P the shortest rotation, z(psi) the rotation about P by psi' =
    |P| Omega.(P + P(t))/(|P|^2 + P.P(t)), by Gauss's rule: the states at its nodes result from more maps.
    """
    record, size = cast("ExactMap", model.system.exact_map), 1 + NODES * oriented
    if oriented and order is not None:
        raise InputError(
            f"orientation: expected none for method='baecklund' of {model.system.name}, whose maps have complex "
            "points: the states between them are not those of the motion. Use method='exact'."
        )

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        if oriented and not abs(x0[1]).max(-1).all():
            raise InputError(
                f"orientation: expected a field P that is not zero for method='exact' of {model.system.name}, got P = "
                "0. Use method='dop853'."
            )
        rows = maps(model, x0[:2], dt, order, SHARES[-size:])
        points = rows[..., 1:].reshape(*rows.shape[:-1], size, 4)
        stages = {name: points[..., i] if oriented else points[..., 0, i] for i, name in enumerate(OF_MAP)}
        return {}, stages | ({"span": rows[..., 0]} if oriented else {})

    def step(M: Array, P: Array, g: Array, *, span: Array, **constants: Array) -> State:
        def at(node: int) -> State:
            numbers = {name: constants[name][..., node][()] for name in OF_MAP}
            return tuple(call(record.step, (M, P), {**constants, **numbers}))

        def rate(M: Array, P: Array) -> Array:
            Omega, x = algebra.axial(call(model.system.velocity, (M, P), constants)), P * algebra.vec(share)
            return algebra.dot(Omega, e + x) / (1 + algebra.dot(e, x))

        share, psi = 1 / algebra.sqrt(algebra.dot(P, P)), 0 * span
        e = P * algebra.vec(share)
        for node, weight in enumerate(WEIGHTS):
            psi = psi + weight * rate(*at(node))
        new = at(NODES)
        turn = algebra.quaternion_product(
            algebra.turn(algebra.vec(span * psi) * e), lift(e, new[1] * algebra.vec(share))
        )
        return (*new, algebra.quaternion_product(g, algebra.unit(turn)))

    name, options = _named(order)
    return scheme_of(
        name,
        model,
        Steps(step if oriented else record.step),
        observer(model, oriented, conserved=("casimir", "energy", *model.system.integrals)),
        oriented,
        axes={**model.axes, **dict.fromkeys(OF_MAP, int(oriented)), "span": 0},
        trajectory=trajectory,
        between=ConjugatePairs.between,
        **options,
    )


def maps(model: Model, state: State, dt: float, order: int | None, shares: Sequence[float]) -> Array:
    """The time, and `OF_MAP` for each of some shares of it, of each map of a step (..., maps, 1 + 4 shares).

    The identity fills shorter lanes.
    """
    find = reused((maps, Identity(model.system), model.n), lambda: _kernels().Points(model))
    batch, z, c = _rows(model, state, parameter_rows(model))
    if order is not None:
        inverse = _real(fractions(dt, order) / 2j).reshape(-1, 1, 2).repeat(len(z), 1)
        points = find(z, c, inverse).swapaxes(0, 1).reshape(*batch, len(inverse), 4)
        return np.concatenate([0 * points[..., :1], points], -1)
    copies, sound = np.ones(len(z), int), np.zeros(len(z), bool)
    while not sound.all():
        if copies.max() > MOST_COPIES:
            raise InputError(
                f"No map was found that is the flow of {model.system.name} over dt = {dt:g} or parts of it. Usual "
                f"cause: a step far too long, or {' or '.join(model.system.space.letters)} that is zero or not finite. "
                "Use a smaller dt or another method, such as 'dop853'."
            )
        points = find(z, c, np.multiply.outer(shares, dt / copies)[..., None])
        sound = (points[..., 4] > 0).all(0)
        copies[~sound] *= 2
    used = (np.arange(copies.max()) < copies[:, None])[..., None]
    numbers = np.concatenate([dt / copies[:, None], points[..., :4].swapaxes(0, 1).reshape(len(z), -1)], -1)
    rows = np.where(used, numbers[:, None], [0.0, *(0.0, 0.0, 1.0, 0.0) * len(shares)])
    return rows.reshape(*batch, *rows.shape[1:])


def fractions(dt: float, order: int | None) -> Array:
    """eps (order/2,), complex, whose maps make a step of the order; none for the flow."""
    if order is None:
        return np.empty(0, complex)
    eps = [2 / mu for mu in stage_points(order, dt)]
    return np.array([*eps, *(e.conjugate() for e in eps if isinstance(e, complex))], complex)


def _named(order: int | None) -> tuple[str, dict[str, Any]]:
    return ("exact", {}) if order is None else ("baecklund", {"options": {"order": order}})


# -- the points of a trajectory -----------------------------------------------------------------------


def constants(
    model: Model, state: State, dt: float, order: int | None = None, params: Array | None = None, oriented: bool = True
) -> tuple[Array, Array]:
    """Points (..., stages, 4), `NUMBERS` of each, and the missing rotation of the body in a step, its coordinates.

    params: the result of `parameter_rows`
    """
    batch, z, c = _rows(model, state, parameter_rows(model) if params is None else params)
    places = range(0, len(z), BLOCK)
    try:
        blocks = [Tori(model, z[k : k + BLOCK], c[k : k + BLOCK], dt, order, oriented).step() for k in places]
    except np.linalg.LinAlgError as error:
        raise _out_of_range(model.system.name) from error
    numbers, counts, turns = map(np.concatenate, zip(*blocks, strict=True))
    points = _kernels().stages(numbers, counts)
    return points.reshape(*batch, *points.shape[1:]), turns.reshape(*batch, turns.shape[-1])


def parameter_rows(model: Model) -> Array:
    """The entries of the parameters (..., count), in order."""
    rows = [np.empty((*model.batch, 0))]
    for p in model.system.parameters:
        if p.kind != "dimension":
            value, axes = model.params[p.letter], model.axes[p.letter]
            core = value.shape[value.ndim - axes :]
            rows.append(np.broadcast_to(value, model.batch + core).reshape(*model.batch, -1))
    return np.concatenate(rows, -1)


def _rows(model: Model, state: State, c: Array) -> tuple[tuple[int, ...], Array, Array]:
    """The shape of a batch, and state and parameters as rows (lanes, ...)."""
    z = algebra.flatten(state, model.system.space.kinds)
    batch = np.broadcast_shapes(c.shape[:-1], z.shape[:-1])
    states, params = (np.empty((*batch, x.shape[-1])) for x in (z, c))
    states[...], params[...] = z, c  # a third of the time that np.broadcast_to needs
    return batch, states.reshape(prod(batch), z.shape[-1]), params.reshape(prod(batch), c.shape[-1])


def _out_of_range(name: str) -> InputError:
    return InputError(
        f"{name}: expected products of the state and the parameters that a double can hold, got larger or smaller "
        "ones. Usual cause: units. Use method='dop853'."
    )


@cache
def _kernels() -> Any:
    return resolve_name(COMPILED)


class Tori:
    """Commuting fields at states z (lanes, d), and pairs for their flow, by compiled code; c: the parameters.

    Raises `InputError` for the first lane that has none.
    """

    def __init__(self, model: Model, z: Array, c: Array, dt: float, order: int | None = None, oriented: bool = True):
        self.model, self.system, self.z, self.c, self.dt = model, model.system, z, c, dt
        self.shares, self.oriented = fractions(dt, order), oriented
        self.rooms = rooms = _kernels().Rooms(model, z, c, dt, self.shares, 3 if oriented else 1)
        rooms.choose()
        verdict = rooms["verdict"][:, 0]
        if verdict.any():
            for lane in np.flatnonzero(verdict == DEPENDENT).tolist():
                rooms["rank"][lane] = self._rank(lane)
                rooms.choose(lane, lane + 1)
            for lane in np.flatnonzero(verdict).tolist():
                raise self._refusal(lane)

    @cached_property
    def state(self) -> State:
        """The components."""
        return algebra.restore(self.z, self.system.space.kinds, self.model.n)

    def _of_lane(self, lane: int) -> tuple[State, dict[str, Array]]:
        """State, parameters and derived constants."""
        params, remainder, n = {"n": np.asarray(self.model.n)}, self.c[lane], self.model.n
        for p in self.system.parameters:
            if p.kind != "dimension":
                shape = (n,) * self.model.axes[p.letter]
                params[p.letter], remainder = np.split(remainder, [n ** len(shape)])
                params[p.letter] = params[p.letter].reshape(shape)[()]
        derived = call(self.system.derive, (), params) if self.system.derive is not None else {}
        return tuple(z[lane] for z in self.state), params | derived

    def _rank(self, lane: int) -> int:
        """The rank of the bracket in units of each component: small fields count as large ones do."""
        tensor, units = call(self.system.space.tensor, *self._of_lane(lane)), self.rooms["units"][lane]
        return int(np.linalg.matrix_rank(tensor / units[:, None] / units, rtol=RANK))

    def _refusal(self, lane: int) -> InputError:
        name, verdict = self.system.name, self.rooms["verdict"][lane]
        if verdict == BEYOND:
            return _out_of_range(name)
        if verdict == ELSEWHERE:
            return InputError(
                f"{name}: expected a flow that combines the flows of its Lax matrix, got another. Usual cause: "
                "parameters that are equal, components of the state of very different sizes, or units in which powers "
                "of the state leave the range of doubles. Use units of the size of the state, or another method, such "
                "as 'dop853'."
            )
        if verdict == COPIES:
            most = abs(self.dt) * MOST_COPIES * _kernels().REACH / self.rooms["far"][lane, 0]
            return InputError(
                f"dt: expected at most {most:.3g}, {MOST_COPIES:,} pairs of maps of {name}, for method='exact', got "
                f"{self.dt:g}. Use a smaller dt, and every=... to save as few rows."
            )
        return InputError(
            f"No conjugate pairs were found that are the flow of {name} over dt = {self.dt:g} or parts of it. Use "
            "another method, such as 'dop853', for this state."
        )

    def step(self) -> tuple[Array, Array, Array]:
        """Pairs (lanes, shares, most + 1, 4), the last one the identity; counts; the missing rotation of the body.

        Each lane has its number of pairs, so that none depends on the others.  The remainder of the rotation by a flow
        leaves the vectors and matrices that the body carries constant.
        """
        rooms, counts = self.rooms, self.rooms["counts"].copy()
        if not len(self.shares):
            return rooms.numbers, counts, counts[:, 2:] * rooms["rotation"]
        turns = rooms["total"].copy()
        if self.oriented:
            carried = [self.state[i] for i in self.system.space.carried or (0,)]
            for turn, *z in zip(turns, *carried, strict=True):
                turn[:] = algebra.coordinates(commuting(algebra.skew(turn, self.model.n), list(z)))
        return rooms.numbers, counts, turns


def commuting(Omega: Array, carried: list[Array]) -> Array:
    """The part of a skew matrix (n, n) that leaves vectors (n,) and matrices (n, n) constant."""
    n = len(Omega)
    basis = algebra.skew(np.eye(n * (n - 1) // 2), n)
    rates = [(basis @ z if z.ndim == 1 else algebra.bracket(basis, z)) / (abs(z).max() or 1.0) for z in carried]
    _, sizes, V = np.linalg.svd(np.concatenate([rate.reshape(len(basis), -1) for rate in rates], -1).T)
    still = V[int((sizes > LIKE).sum()) :]
    return algebra.skew(still.T @ (still @ algebra.coordinates(Omega)), n)


def _real(x: Array) -> Array:
    """The parts of complex values, one after another."""
    return np.ascontiguousarray(x, complex).view(float)
