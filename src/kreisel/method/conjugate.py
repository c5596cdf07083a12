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

from functools import cache, reduce
from typing import Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.baecklund import constant_turns, stage_points
from kreisel.method.observing import State, as_matrix, observer, scheme_of
from kreisel.method.scheme import Scheme, Steps
from kreisel.record.calling import Function, call
from kreisel.record.contract import ConjugatePairs, ExactMap
from kreisel.record.model import Model

REACH, FARTHEST = 0.4, 0.6  # of the distance of a branch point: of an x at the start of Newton's method, and later
DIGITS = 44.0  # natural logarithm of the relative error of the polynomials: 20 nodes at FARTHEST
RANK = 1e-10  # relative: fields that depend on others
SPAN = 1e-8  # relative: the distance of the flow from the other fields
SLACK = 1e-9  # of a price, beyond which a point is taken in place of another
STEPS, CLOSE = 12, 1e-10  # of Newton's method; a change, relative to the interval, whose square is rounding
ENOUGH, SMALL = 1e-12, 1e-5  # a miss, relative to the move; a move, relative to the state
TRIALS = 8  # each with more copies of the pairs
MOST_COPIES = 1_000_000
BETWEEN = 10  # steps between projections: the least interval, so that more pairs in other lanes change nothing
BETWEEN_MAPS = 4  # of a single map, whose rounding errors in |P|^2 are 3 last places a step
LIKE = 1e-6  # the orientation is off by 1e-16 over this ratio of two fields
WIDE = np.dtype(np.clongdouble)
PATH = 8  # points on the way to the branch of a complex x
NUMBERS = ("lam_re", "lam_im", "mu_re", "mu_im")


def has_points(model: Model) -> bool:
    """Whether pairs, or a map that is the flow, are known for the dimension of the body."""
    pairs = model.system.pairs
    return model.system.exact_map is not None or (pairs is not None and model.n in pairs.dimensions)


def baecklund(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """Products of Bäcklund maps of an order.  Raises `InputError` for an orientation, and where no points are found."""
    if oriented:
        raise InputError(
            f"orientation: expected none for method='baecklund' of {model.system.name}, whose maps determine the "
            f"rotation of the body only to the order of the step. Use another method, such as 'dop853'."
        )
    return by_pairs(model, dt, False, order) if model.system.exact_map is None else by_map(model, dt, order)


def exact(model: Model, dt: float, order: None, oriented: bool) -> Scheme:
    """The exact flow.  Raises `InputError` for an orientation that the map lacks, and where no points are found."""
    if oriented and model.system.exact_map is not None:
        raise InputError(
            f"orientation: expected none for method='exact' of {model.system.name}, whose map has no rotation of "
            "the body. Use method='dop853'."
        )
    return by_pairs(model, dt, oriented) if model.system.exact_map is None else by_map(model, dt)


def by_pairs(model: Model, dt: float, oriented: bool, order: int | None = None) -> Scheme:
    """The exact flow, or a step of an order, by conjugate pairs."""
    record = cast("ConjugatePairs", model.system.pairs)
    count = len(model.system.space.letters)

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        if oriented:
            _require_like_fields(model, x0[:count])
        points, turn = constants(model, x0[:count], dt, order)
        stages = {name: points[..., i, :] for i, name in enumerate(NUMBERS)}
        if not oriented:
            return {}, stages
        g = as_matrix(model, x0[count])
        return constant_turns("turn", g @ turn @ g.mT, lambda theta: theta), stages

    def step(*z: Array, lam_re: Array, lam_im: Array, mu_re: Array, mu_im: Array, **known: Array) -> State:
        point = {"lam": algebra.complex_number(lam_re, lam_im), "mu": algebra.complex_number(mu_re, mu_im)}
        state, turns = call(record.pair, z[:count], {**known, **point})
        return (*state, *(reduce(algebra.turn_right, turns, g) for g in z[count:]))

    def close(*z: Array, turn0: Array, turn1: Array, **known: Array) -> State:
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
        between=BETWEEN,
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


def by_map(model: Model, dt: float, order: int | None = None) -> Scheme:
    """The exact flow by copies of one map, or a step of an order by several."""
    record = cast("ExactMap", model.system.exact_map)

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        batch, lanes = _lanes(model, x0)
        try:
            points = _stacked(batch, [maps(model, *lane, dt, order) for lane in lanes])
        except np.linalg.LinAlgError as error:
            raise _out_of_range(model.system.name) from error
        return {}, {name: points[..., i, :] for i, name in enumerate(NUMBERS)}

    name, options = _named(order)
    return scheme_of(
        name,
        model,
        Steps(record.step),
        observer(model, conserved=("casimir", "energy", *model.system.integrals)),
        axes={**model.axes, **dict.fromkeys(NUMBERS, 0)},
        trajectory=trajectory,
        between=BETWEEN_MAPS,
        **options,
    )


def maps(
    model: Model, state: State, params: dict[str, Array], dt: float, order: int | None = None
) -> tuple[Array, Array]:
    """`NUMBERS` (4, count) of the maps of a step, and (4,) of the identity, which fills shorter lanes."""
    record = cast("ExactMap", model.system.exact_map)
    state = tuple(np.asarray(z, np.longdouble) for z in state)
    wide = {k: np.longdouble(v) for k, v in params.items()}

    def numbers(lam: Array) -> Array:
        return _numbers(lam, call(record.level, state, {**wide, "lam": lam}))

    with np.errstate(all="ignore"):
        identity = numbers(call(record.point, state, {**wide, "dt": np.longdouble(0)}))
        if order is not None:
            return numbers(2j / fractions(dt, order)), identity
        copies = 1
        while copies <= MOST_COPIES:
            if (lam := call(record.point, state, {**wide, "dt": np.longdouble(dt) / copies})) is not None:
                return numbers(lam)[:, None].repeat(copies, 1), identity
            copies *= 2
    raise InputError(
        f"No map was found that is the flow of {model.system.name} over dt = {dt:g} or parts of it. Usual cause: a "
        "step far too long, or a state that is not finite. Use a smaller dt."
    )


def _numbers(lam: Array, mu: Array) -> Array:
    return np.stack([lam.real, lam.imag, mu.real, mu.imag]).astype(float)


def fractions(dt: float, order: int) -> Array:
    """eps (order/2,), complex, whose maps make a step of the order."""
    eps = [2 / mu for mu in stage_points(order, dt)]
    return np.array([*eps, *(e.conjugate() for e in eps if isinstance(e, complex))], complex)


def _named(order: int | None) -> tuple[str, dict[str, Any]]:
    return ("exact", {}) if order is None else ("baecklund", {"options": {"order": order}})


# -- the points of a trajectory -----------------------------------------------------------------------


def constants(model: Model, state: State, dt: float, order: int | None = None) -> tuple[Array, Array]:
    """Points (..., 4, stages), `NUMBERS` of each, and the missing rotation of the body in a step (..., n,
    n).
    """
    batch, lanes = _lanes(model, state)
    try:
        steps = [Torus(model, *lane).step(dt, order) for lane in lanes]
    except np.linalg.LinAlgError as error:
        raise _out_of_range(model.system.name) from error
    turns = np.stack([turn for _, _, turn in steps])
    return _stacked(batch, [step[:2] for step in steps]), turns.reshape(batch + turns.shape[1:])


def _out_of_range(name: str) -> InputError:
    return InputError(
        f"{name}: expected products of the state and the parameters that a double can hold, got larger or smaller "
        "ones. Usual cause: units. Use method='dop853'."
    )


def _stacked(batch: tuple[int, ...], steps: list[tuple[Array, Array]]) -> Array:
    """Points (..., 4, stages), the shorter lanes filled with their identities."""
    count = max(numbers.shape[-1] for numbers, _ in steps)
    points = np.stack([np.append(a, b[:, None].repeat(count - a.shape[-1], -1), -1) for a, b in steps])
    return points.reshape(batch + points.shape[1:])


def _lanes(model: Model, state: State) -> tuple[tuple[int, ...], list[tuple[State, dict[str, Array]]]]:
    """The shape of a batch, and state and parameters of each lane."""
    axes = [algebra.KINDS[kind].axes for kind in model.system.space.kinds]
    batch = np.broadcast_shapes(model.batch, *(z.shape[: z.ndim - k] for z, k in zip(state, axes, strict=True)))
    spread = [np.broadcast_to(z, batch + z.shape[z.ndim - k :]) for z, k in zip(state, axes, strict=True)]
    params = {p.letter: model.params[p.letter] for p in model.system.parameters}
    params = {k: np.broadcast_to(v, batch + v.shape[v.ndim - model.axes[k] :]) for k, v in params.items()}
    return batch, [
        (tuple(z[lane] for z in spread), {k: v[lane] for k, v in params.items()}) for lane in np.ndindex(batch)
    ]


class Points(NamedTuple):
    """Points lam = iy, x of their pairs in a unit of small times, distances of branch points; mu and vectors there."""

    y: Array
    x: Array
    radius: Array
    mu: Array
    left: Array
    right: Array


@cache
def chebyshev(count: int) -> tuple[Array, Array]:
    """Positive nodes (count,), rising, for even functions on [-1, 1], and their coefficients by T_0, T_2, ..."""
    theta = (2 * np.arange(count)[::-1] + 1) * np.arccos(np.longdouble(-1)) / (4 * count)
    coefficients = 2 * np.cos(2 * np.arange(count)[:, None] * theta) / count
    coefficients[0] /= 2
    return np.cos(theta), coefficients


def series(at: Array, count: int) -> tuple[Array, Array]:
    """T_2j (..., count) at points of [-1, 1], and their integrals from 0."""
    theta, j = np.arccos(at)[..., None], np.arange(count)
    odd = np.cos((2 * j + 1) * theta) / (2 * j + 1)
    return np.cos(2 * j * theta), (odd + np.concatenate([odd[..., :1], -odd[..., :-1]], -1)) / 2


class Torus:
    """The commuting fields at one state, in extended precision where the platform has it; points for its flow."""

    def __init__(self, model: Model, state: State, params: dict[str, Array]):
        system = model.system
        self.system, self.record = system, cast("ConjugatePairs", system.pairs)
        self.state = tuple(np.asarray(z, np.longdouble) for z in state)
        constants = {k: np.asarray(v, np.longdouble) for k, v in params.items()}
        with np.errstate(all="ignore"):
            self.constants = constants | (call(system.derive, (), constants) if system.derive is not None else {})
            self.doubles = tuple(z.astype(float) for z in self.state)
            self.known = {k: np.asarray(v, float) for k, v in self.constants.items()}
            rates = call(system.flow, self.state, self.constants)
            self.sizes = self._sizes(rates)
            self.flow = self._flat(rates)
            self.points = self._points()

    def _sizes(self, rates: State) -> list[Array]:
        """Units of the components: sizes that they have or reach before the body rotates by about a radian.

        M may be far smaller than it soon becomes; Newton's method must not solve for its last places then.
        """
        velocity = self.system.velocity
        turns = [z[0] if velocity is None else call(velocity, z, self.constants) for z in (self.state, rates)]
        now, later = (np.linalg.norm(Omega.astype(float)) for Omega in turns)
        time = 1 / rate if (rate := now + np.sqrt(later)) else 0.0
        pairs = zip(self.state, rates, strict=True)
        return [max(abs(z).max(initial=0), time * abs(rate).max(initial=0)) or np.longdouble(1) for z, rate in pairs]

    def _flat(self, rates: State) -> Array:
        """Coordinates (..., d) in units of each component."""
        scaled = [rate / size for rate, size in zip(rates, self.sizes, strict=True)]
        return algebra.flatten(scaled, self.system.space.kinds)

    def _of_record(self, function: Function, lam: Array, **vectors: Array) -> Any:
        """A function of the record, in the precision of lam."""
        state, constants = (self.state, self.constants) if lam.dtype == WIDE else (self.doubles, self.known)
        return call(function, state, {**constants, "lam": lam, **vectors})

    def _levels(self, lam: Array, L: Array) -> tuple[Array, Array, Array, Array]:
        """mu (..., k), left and right vectors (..., k, m), S; in the precision of lam if the record states them."""
        if self.record.levels is not None:
            return cast("tuple[Array, Array, Array, Array]", self._of_record(self.record.levels, lam))
        values, vectors = np.linalg.eig(L.astype(complex))
        return values, np.linalg.inv(vectors), vectors.mT, np.ones(1)

    def _fields(self, lam: Array, left: Array, right: Array) -> tuple[Array, Array]:
        left = left / algebra.vec((left * right).sum(-1))
        rates, Omega = self._of_record(self.record.rates, lam, left=left, right=right)
        return self._flat(rates), Omega

    def _points(self) -> Points:
        """The points with the least sum of |x|/radius."""
        y, pole = (np.asarray(v, np.float64) for v in call(self.record.heights, self.doubles, self.known))
        lam, near = 1j * y, 1e-5 * pole
        L, after, before = self._of_record(self.record.matrix, np.stack([lam, lam + near, lam - near]))
        if not (L.size and np.isfinite(L).all() and np.isfinite(self.flow.astype(float)).all()):
            raise _out_of_range(self.system.name)
        mu, left, right, _ = self._levels(lam, L)
        count = mu.shape[-1]
        change = left @ ((after - before) / (2 * near[:, None, None])) @ right.mT
        gap, ends = mu[:, :, None] - mu[:, None, :], np.diagonal(change, 0, -2, -1)
        # Two levels meet where (gap + t (a - b))^2 + 4 t^2 c d = 0.
        meet = abs(gap) / np.sqrt(abs((ends[:, :, None] - ends[:, None, :]) ** 2 + 4 * change * change.mT))
        radius = np.minimum(np.where(np.eye(count) > 0, np.inf, meet).min(-1), pole[:, None]).ravel()
        mu, (left, right) = mu.ravel(), (v.reshape(-1, v.shape[-1]) for v in (left, right))
        fields, _ = self._fields(lam.repeat(count), left, right)
        C, f = (fields.real.astype(float) * radius[:, None]).T, self.flow.astype(float)
        if not f.any():  # at rest: the pair of any mu but an eigenvalue is the identity for x = 0
            return Points(y[:1], np.zeros(1), pole[:1], 2 * abs(mu).max(keepdims=True) + pole[:1], left[:1], right[:1])
        chosen, x = least(C, f, self._rank() // 2)
        if not abs(C[:, chosen] @ x - f).max() <= SPAN * abs(f).max():
            raise InputError(
                f"{self.system.name}: expected a flow that combines the flows of its Lax matrix, got another. Usual "
                "cause: parameters that are equal, or components of the state of very different sizes. Use another "
                "method, such as 'dop853'."
            )
        levels = (v[chosen] for v in (mu, left, right))
        return Points(y.repeat(count)[chosen], x * radius[chosen], radius[chosen], *levels)

    def _rank(self) -> int:
        """The rank of the bracket in units of each component: small fields count as large ones do."""
        tensor = call(self.system.space.tensor, self.state, self.constants)
        full = [np.full(z.shape, size) for z, size in zip(self.state, self.sizes, strict=True)]
        units = algebra.flatten(full, self.system.space.kinds)
        return int(np.linalg.matrix_rank((tensor / units[:, None] / units).astype(float), rtol=RANK))

    def far(self, dt: float) -> float:
        """Largest x of a step, relative to the distance of a branch point."""
        return float((abs(self.points.x * dt) / self.points.radius).max())

    def copies(self, dt: float) -> int:
        """How many copies of the pairs a step needs.  Raises `InputError` for too many."""
        far = self.far(dt) / REACH
        if not far < MOST_COPIES:
            raise InputError(
                f"dt: expected at most {abs(dt) * MOST_COPIES / far:.3g}, {MOST_COPIES:,} pairs of maps of "
                f"{self.system.name}, for method='exact', got {dt:g}. Use a smaller dt, and every=... to save as few "
                "rows."
            )
        return max(1, int(np.ceil(far)))

    def step(self, dt: float, order: int | None = None) -> tuple[Array, Array, Array]:
        """`NUMBERS` (4, ...) of all pairs of a step, (4,) of the identity, and the rest of the rotation, if exact.

        Each lane has its number of pairs, so that none depends on the others: the identity fills the shorter ones.
        Raises `InputError` where no points are found.
        """
        points = self.points
        identity = _numbers(1j * points.y[0], points.mu[0])
        if not points.x.any():
            return identity[:, None], identity, self._rest(dt, 0, np.longdouble(0))
        if order is not None:
            x, end = points.x[:, None] * fractions(dt, order), np.arange(1, PATH + 1) / PATH
            lam = (1j * points.y[:, None] + 0 * x).reshape(-1, 1) + x.reshape(-1, 1) * end
            mu = self._followed(lam, *(v.repeat(x.shape[1], 0) for v in (points.left, points.right)))[1]
            return _numbers(lam[:, -1], mu[:, -1]), identity, self._rest(dt, 0, np.longdouble(0))
        copies = self.copies(dt)
        for _ in range(TRIALS):
            for share in (FARTHEST / REACH * self.far(dt) / copies, FARTHEST):
                if (done := self.solved(dt, copies, share)) is not None:
                    numbers, turn = done
                    return np.tile(numbers, copies), identity, turn
            copies += max(1, copies // 2)
        raise InputError(
            f"No conjugate pairs were found that are the flow of {self.system.name} over dt = {dt:g} or parts of it. "
            "Use another method, such as 'dop853', for this state."
        )

    def _rest(self, dt: float, copies: int, turn: Array) -> Array:
        """The rotation of the body in a step without the rotations of the pairs."""
        if self.system.velocity is None:
            return np.zeros((self.state[0].shape[-1],) * 2)
        Omega = call(self.system.velocity, self.state, self.constants)
        return np.asarray(dt * Omega - copies * turn, float)

    def solved(self, dt: float, copies: int, share: float) -> tuple[Array, Array] | None:
        """`NUMBERS` (4, count) of the pairs of a part of a step, and the rest of the rotation in the step.

        Even polynomials of the fields, by Chebyshev's nodes on a share of the way to the branch points, are integrated.
        None if Newton's method leaves it.
        """
        h, points = np.longdouble(dt) / copies, self.points
        x, reach = points.x * h, share * points.radius
        nodes, coefficients = chebyshev(int(np.ceil(DIGITS / 2 / np.arccosh(1 / share))))
        values, size, count = self._nodes(reach, nodes), len(self.flow), len(nodes)
        c, f = coefficients @ values, h * self.flow
        inverse = np.linalg.pinv(values[:, 0, :size].astype(float))
        reduced, goal = c[..., :size] @ inverse, f @ inverse
        last = np.inf
        for _ in range(STEPS):
            if not (abs(x) < reach).all():
                return None
            ends, moves = series(x / reach, count)
            if last < CLOSE:
                break
            miss = goal - np.einsum("p,pj,pjd->d", reach, moves, reduced)
            change = np.linalg.solve(np.einsum("pj,pjd->dp", ends, reduced).astype(float), miss.astype(float))
            if not (step := abs(change / reach).max()) < last / 2:  # rounding
                break
            x, last = x + change, step
        total = np.einsum("p,pj,pjd->d", reach, moves, c)
        if not abs(f - total[:size]).max() <= ENOUGH * max(abs(f).max(), SMALL):
            return None
        re, im = np.einsum("pj,pjd->dp", ends, c[..., -2:])
        turn = total[size:-2].reshape((self.state[0].shape[-1],) * 2)
        return np.stack([x, points.y, re * x / reach, im]).astype(float), self._rest(dt, copies, turn)

    def _followed(self, lam: Array, left: Array, right: Array) -> tuple[Array, Array, Array, Array]:
        """L, mu and vectors along paths lam (paths, nodes), from the vectors at the start of each, in doubles.

        tr Pi Pi' of projectors identifies a branch, however near another level runs.
        """
        L = self._of_record(self.record.matrix, lam)
        mu, inverse, vectors, S = self._levels(lam, L)
        branch, every = np.empty(lam.shape, int), np.arange(len(lam))
        for k in range(lam.shape[1]):
            rows, columns = inverse[:, k], vectors[:, k]
            same = (rows @ (S * right)[..., None])[..., 0] * (columns @ (S * left)[..., None])[..., 0]
            branch[:, k] = abs(same).argmax(-1)
            left, right = rows[every, branch[:, k]], columns[every, branch[:, k]]
        at = (*np.ogrid[: lam.shape[0], : lam.shape[1]], branch)
        return L, mu[at], inverse[at], vectors[at]

    def _nodes(self, reach: Array, nodes: Array) -> Array:
        """Even functions (pairs, nodes, ...) of x = reach nodes: the fields, Omega, Re mu/nodes and Im mu."""
        lam = 1j * self.points.y[:, None] + reach[:, None] * nodes
        L, mu, left, right = self._followed(lam, self.points.left, self.points.right)
        if self.record.levels is None:
            mu, left, right = refined(L, mu, left, right)
        fields, Omega = self._fields(lam, left, right)
        levels = np.stack([mu.real / nodes, mu.imag], -1)
        return np.concatenate([fields.real, Omega.real.reshape(*lam.shape, -1), levels], -1)


def refined(L: Array, mu: Array, left: Array, right: Array) -> tuple[Array, Array, Array]:
    """An eigenvalue (...) and its vectors (..., m) of L in extended precision, by Newton's method from doubles."""
    size = L.shape[-1]
    bordered = np.zeros((*mu.shape, size + 1, size + 1), complex)
    bordered[..., :-1, :-1] = L - algebra.mat(mu) * np.eye(size)
    bordered[..., :-1, -1], bordered[..., -1, :-1] = -right, left
    inverse = np.linalg.inv(bordered)[..., :-1]
    for _ in range(2):
        misses = [(algebra.vec(mu) * q - algebra.act(A, q)).astype(complex) for A, q in ((L, right), (L.mT, left))]
        change = algebra.act(inverse, misses[0])
        left = left + algebra.act(inverse[..., :-1, :].mT, misses[1])
        right, mu = right + change[..., :-1], mu + change[..., -1]
    return mu, left, right


def least(C: Array, f: Array, most: int) -> tuple[list[int], Array]:
    """Columns of C and factors x with the least sum |x_j| among those with sum x_j C_j = f, by the simplex method.

    most  the rank of C without rounding errors
    """
    C = np.where(np.isfinite(C), C, 0)
    U, sizes, _ = np.linalg.svd(C, full_matrices=False)
    rank = min(most, int((sizes > RANK * sizes[0]).sum())) if f.any() else 0
    C, f = U[:, :rank].T @ C, U[:, :rank].T @ f
    rest, chosen, x = C.copy(), list[int](), np.zeros(rank)
    for _ in range(rank):
        chosen.append(int((rest * rest).sum(0).argmax()))
        unit = rest[:, chosen[-1]] / np.linalg.norm(rest[:, chosen[-1]])
        rest = rest - np.outer(unit, unit @ rest)
    for _ in range(100 * rank):
        inverse = np.linalg.inv(C[:, chosen])
        x = inverse @ f
        signs = np.where(x < 0, -1.0, 1.0)
        price = signs @ inverse @ C
        entering = int(abs(price).argmax())
        if abs(price[entering]) <= 1 + SLACK:
            break
        slope = inverse @ C[:, entering] * np.sign(price[entering])
        reach = np.where(slope * signs > 0, x / slope, np.inf)
        chosen[int(reach.argmin())] = entering
    return chosen, x
