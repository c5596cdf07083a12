"""method="exact" as a product of conjugate pairs of Bäcklund maps near the imaginary axis of lam.

A pair at lam = x + iy is the flow of a function of the integrals whose field at the state of the start is

    int_0^x Re v(iy + t) dt,   v = `rates` of the record, analytic in lam.

Commuting fields that agree at one state agree on its torus, so points with sum_j int_0^(x_j) Re v(iy_j + t) dt = h f,
f the field of the flow, make a step that is the flow over h.  These are the Abelian conditions, without the integrals.
The heights y_j and the branches of mu are chosen where the x_j are smallest against the distance of the branch points,
by linear programming; Newton's method finds x_j, the fields at its ends are the columns of the Jacobian.  The body
rotates by int Omega; the difference to the angular velocity of the flow commutes with all it carries: a constant.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.baecklund.conjugate import legendre
from kreisel.errors import InputError
from kreisel.method.baecklund import constant_turns
from kreisel.method.observing import State, as_matrix, observer, scheme_of
from kreisel.method.scheme import Scheme, Steps
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs, ExactMap
from kreisel.record.model import Model

REACH, FARTHEST = 0.4, 0.6  # of the distance of a branch point: of an x at the start of Newton's method, and later
NODES = 20  # half of them on each side of 0: the error of the integrals is about 3^-40 at FARTHEST
RANK = 1e-10  # relative: fields that depend on others
SPAN = 1e-8  # relative: the distance of the flow from the other fields
SLACK = 1e-9  # of a price, beyond which a point is taken in place of another
STEPS = 12  # of Newton's method; in extended precision after a miss, relative to the move, below CLOSE
CLOSE, ENOUGH, SMALL = 1e-6, 1e-12, 1e-5  # SMALL: a move, relative to the state
TRIALS = 8  # each with more copies of the pairs
MOST_COPIES = 1_000_000
BETWEEN = 10  # steps between projections: the least interval, so that more pairs in other lanes change nothing
BETWEEN_MAPS = 4  # of a single map, whose rounding errors in |P|^2 are 3 last places a step
LIKE = 1e-6  # the orientation is off by 1e-16 over this ratio of two fields
NUMBERS = ("lam_re", "lam_im", "mu_re", "mu_im")


def has_pairs(model: Model) -> bool:
    """Whether pairs are known for the dimension of the body."""
    return model.system.pairs is not None and model.n in model.system.pairs.dimensions


def exact_by_pairs(model: Model, dt: float, oriented: bool) -> Scheme:
    """The exact flow.  Raises `InputError` where no points are found."""
    record = model.system.pairs
    if record is None:
        raise TypeError(f"{model.system.name} states no conjugate pairs")
    count = len(model.system.space.letters)

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        if oriented:
            _require_like_fields(model, x0[:count])
        points, turn = constants(model, x0[:count], dt)
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

    return scheme_of(
        "exact",
        model,
        Steps(step, close if oriented else None),
        observer(model, oriented, conserved=("casimir", "energy", *model.system.integrals)),
        oriented,
        axes={**model.axes, **dict.fromkeys(NUMBERS, 0), "turn0": 2, "turn1": 2},
        trajectory=trajectory,
        between=BETWEEN,
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


def exact_by_map(model: Model, dt: float, oriented: bool) -> Scheme:
    """The exact flow by copies of one map.  Raises `InputError` for an orientation, and where no point is found."""
    record = cast("ExactMap", model.system.exact_map)
    if oriented:
        raise InputError(
            f"orientation: expected none for method='exact' of {model.system.name}, whose map has no rotation of "
            f"the body. "
            "Use method='dop853'."
        )

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        batch, lanes = _lanes(model, x0)
        steps = [one_map(model, *lane, dt) for lane in lanes]
        count = max(copies for copies, _, _ in steps)
        points = np.stack([np.stack([a] * n + [b] * (count - n), -1) for n, a, b in steps])
        return {}, {k: points[:, i].reshape(*batch, count) for i, k in enumerate(NUMBERS)}

    return scheme_of(
        "exact",
        model,
        Steps(record.step),
        observer(model, conserved=("casimir", "energy", *model.system.integrals)),
        axes={**model.axes, **dict.fromkeys(NUMBERS, 0)},
        trajectory=trajectory,
        between=BETWEEN_MAPS,
    )


def one_map(model: Model, state: State, params: dict[str, Array], dt: float) -> tuple[int, Array, Array]:
    """How many maps make a step, and `NUMBERS` of these and of the identity, which fills shorter lanes."""
    record = cast("ExactMap", model.system.exact_map)
    state = tuple(np.asarray(z, np.longdouble) for z in state)
    wide = {k: np.longdouble(v) for k, v in params.items()}

    def numbers(time: Array) -> Array | None:
        with np.errstate(all="ignore"):
            point = call(record.point, state, {**wide, "dt": time})
        return None if point is None else np.array([float(point[k]) for k in NUMBERS])

    copies = 1
    while copies <= MOST_COPIES:
        if (found := numbers(np.longdouble(dt) / copies)) is not None:
            return copies, found, cast("Array", numbers(np.longdouble(0)))
        copies *= 2
    raise InputError(
        f"No map was found that is the flow of {model.system.name} over dt = {dt:g} or parts of it. Usual cause: a "
        "step far too long, or a state that is not finite. Use a smaller dt."
    )


# -- the points of a trajectory -----------------------------------------------------------------------


def constants(model: Model, state: State, dt: float) -> tuple[Array, Array]:
    """Points (..., 4, stages), `NUMBERS` of each, and the missing rotation of the body in a step (..., n,
    n).
    """
    batch, lanes = _lanes(model, state)
    steps = [Torus(model, *lane).step(dt) for lane in lanes]
    count = max(numbers.shape[-1] for numbers, _, _ in steps)
    points = np.stack([np.append(a, b[:, None].repeat(count - a.shape[-1], -1), -1) for a, b, _ in steps])
    turns = np.stack([turn for _, _, turn in steps])
    return points.reshape(batch + points.shape[1:]), turns.reshape(batch + turns.shape[1:])


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
    """Points lam = iy, mu of their branches, x of their pairs in a unit of small times, distances of branch points."""

    y: Array
    mu: Array
    x: Array
    radius: Array


class Moves(NamedTuple):
    """Pairs: the sums of the integrals of their fields and of Omega, the fields at their ends as columns, mu there."""

    state: Array
    turn: Array
    ends: Array
    mu: Array


class Torus:
    """The commuting fields at one state, in extended precision where the platform has it; points for its flow."""

    def __init__(self, model: Model, state: State, params: dict[str, Array]):
        system = model.system
        self.system, self.record = system, cast("ConjugatePairs", system.pairs)
        self.state = tuple(np.asarray(z, np.longdouble) for z in state)
        constants = {k: np.asarray(v, np.longdouble) for k, v in params.items()}
        with np.errstate(all="ignore"):
            self.constants = constants | (call(system.derive, (), constants) if system.derive is not None else {})
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

    def _matrix(self, lam: Array) -> Array:
        return call(self.record.matrix, self.state, {**self.constants, "lam": lam})

    def _levels(self, lam: Array) -> tuple[Array, Array, Array]:
        """mu (..., k), left and right vectors (..., k, m), in the precision of lam if the record states them."""
        if self.record.levels is not None:
            return call(self.record.levels, self.state, {**self.constants, "lam": lam})
        values, vectors = np.linalg.eig(self._matrix(lam).astype(complex))
        return values, np.linalg.inv(vectors), vectors.mT

    def _fields(self, lam: Array, left: Array, right: Array) -> tuple[Array, Array]:
        vectors = {"left": left / algebra.vec((left * right).sum(-1)), "right": right}
        rates, Omega = call(self.record.rates, self.state, {**self.constants, "lam": lam, **vectors})
        return self._flat(rates), Omega

    def _points(self) -> Points:
        """The points with the least sum of |x|/radius."""
        y, pole = (np.asarray(v, np.float64) for v in call(self.record.heights, self.state, self.constants))
        lam, near = 1j * y, 1e-5 * pole
        L = self._matrix(lam).astype(complex)
        if not (np.isfinite(L).all() and np.isfinite(self.flow.astype(float)).all()):
            raise InputError(
                f"{self.system.name}: expected products of the state and the parameters that a double can hold, for "
                "method='exact', got larger ones. Usual cause: units. Use method='dop853'."
            )
        mu, left, right = (v.astype(complex) for v in self._levels(lam))
        count = mu.shape[-1]
        slope = (self._matrix(lam + near) - self._matrix(lam - near)) / (2 * near[:, None, None])
        change = left @ slope.astype(complex) @ right.mT
        gap, ends = mu[:, :, None] - mu[:, None, :], np.diagonal(change, 0, -2, -1)
        # Two levels meet where (gap + t (a - b))^2 + 4 t^2 c d = 0.
        meet = abs(gap) / np.sqrt(abs((ends[:, :, None] - ends[:, None, :]) ** 2 + 4 * change * change.mT))
        radius = np.minimum(np.where(np.eye(count) > 0, np.inf, meet).min(-1), pole[:, None]).ravel()
        fields, _ = self._fields(lam.repeat(count), *(v.reshape(-1, v.shape[-1]) for v in (left, right)))
        C, f = (fields.real.astype(float) * radius[:, None]).T, self.flow.astype(float)
        if not f.any():  # at rest: the pair of any mu but an eigenvalue is the identity for x = 0
            return Points(y[:1], 2 * abs(mu).max(keepdims=True).reshape(1) + pole[:1], np.zeros(1), pole[:1])
        chosen, x = least(C, f, self._rank() // 2)
        if not abs(C[:, chosen] @ x - f).max() <= SPAN * abs(f).max():
            raise InputError(
                f"{self.system.name}: expected a flow that combines the flows of its Lax matrix, got another. Usual "
                "cause: parameters that are equal, or components of the state of very different sizes. Use another "
                "method, such as 'dop853'."
            )
        return Points(y.repeat(count)[chosen], mu.ravel()[chosen], x * radius[chosen], radius[chosen])

    def _rank(self) -> int:
        """The rank of the bracket in units of each component: small fields count as large ones do."""
        tensor = call(self.system.space.tensor, self.state, self.constants)
        full = [np.full(z.shape, size) for z, size in zip(self.state, self.sizes, strict=True)]
        units = algebra.flatten(full, self.system.space.kinds)
        return int(np.linalg.matrix_rank((tensor / units[:, None] / units).astype(float), rtol=RANK))

    def copies(self, dt: float) -> int:
        """How many copies of the pairs a step needs.  Raises `InputError` for too many."""
        far = float((abs(self.points.x * dt) / (REACH * self.points.radius)).max())
        if not far < MOST_COPIES:
            raise InputError(
                f"dt: expected at most {abs(dt) * MOST_COPIES / far:.3g}, {MOST_COPIES:,} pairs of maps of "
                f"{self.system.name}, for method='exact', got {dt:g}. Use a smaller dt, and every=... to save as few "
                "rows."
            )
        return max(1, int(np.ceil(far)))

    def step(self, dt: float) -> tuple[Array, Array, Array]:
        """`NUMBERS` (4, ...) of all pairs of a step, (4,) of the identity, and the rest of the rotation.

        Each lane has its number of pairs, so that none depends on the others: the identity fills the shorter ones.
        Raises `InputError` where no points are found.
        """
        points = self.points
        identity = np.stack([0 * points.y, points.y, points.mu.real, points.mu.imag])[:, 0]
        if not points.x.any():
            return identity[:, None], identity, self._rest(dt, 0, np.longdouble(0))
        copies = self.copies(dt)
        for _ in range(TRIALS):
            if (done := self.solved(dt, copies)) is not None:
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

    def solved(self, dt: float, copies: int) -> tuple[Array, Array] | None:
        """`NUMBERS` (4, count) of the pairs of a part of a step, and the rest of the rotation in the step.

        None if Newton's method leaves the domain of these points.
        """
        h, points, least, moves = np.longdouble(dt) / copies, self.points, np.inf, None
        x = following = points.x * h
        for _ in range(STEPS):
            trial = self._moved(following, least < np.inf)
            rest = h * self.flow - trial.state
            miss = abs(rest).max() / max(abs(h * self.flow).max(), SMALL)
            if moves is not None and not miss < least / 2:  # rounding
                break
            if least < np.inf:
                x, moves = following, trial
            least = miss if miss < CLOSE else np.inf
            following = following + np.linalg.lstsq(trial.ends.astype(float), rest.astype(float))[0]
            if not (abs(following) < FARTHEST * points.radius).all():
                return None
        if moves is None or least > ENOUGH:
            return None
        return np.stack([x.astype(float), points.y, moves.mu.real, moves.mu.imag]), self._rest(dt, copies, moves.turn)

    def _moved(self, x: Array, wide: bool) -> Moves:
        nodes, weights = legendre(NODES)
        lam = 1j * self.points.y[:, None] + x[:, None] * np.append(nodes, 1)
        lam = lam if wide else lam.astype(complex)
        values, inverse, vectors = self._levels(lam)
        last, branch = self.points.mu, list[Array]()
        for row in values.swapaxes(0, 1):
            branch.append(abs(row - last[:, None]).argmin(-1))
            last = np.take_along_axis(row, branch[-1][:, None], -1)[:, 0]
        at = (*np.ogrid[: len(x), : len(nodes) + 1], np.stack(branch, -1))
        mu, right, left = values[at], vectors[at], inverse[at]
        if wide and self.record.levels is None:
            L = self._matrix(lam)
            (_, left), (mu, right) = refined(L.mT, mu, left), refined(L, mu, right)
        fields, Omega = self._fields(lam, left, right)
        weights = x[:, None] * weights
        turn = (weights[..., None, None] * Omega[:, :-1].real).sum((0, 1))
        state = (weights[..., None] * fields[:, :-1].real).sum((0, 1))
        return Moves(state, turn, fields[:, -1].real.T, mu[:, -1].astype(complex))


def refined(L: Array, mu: Array, q: Array) -> tuple[Array, Array]:
    """An eigenvalue (...) and its vector (..., m) of L in extended precision, by Newton's method from doubles."""
    corner, bordered = np.zeros((*mu.shape, 1, 1)), L.astype(complex) - algebra.mat(mu) * np.eye(L.shape[-1])
    ends = np.concatenate([q.conj()[..., None, :], corner], -1)
    inverse = np.linalg.inv(np.concatenate([np.concatenate([bordered, -q[..., None]], -1), ends], -2))
    for _ in range(2):
        miss = (algebra.vec(mu) * q - algebra.act(L, q)).astype(complex)
        change = algebra.act(inverse[..., :-1], miss)
        q, mu = q + change[..., :-1], mu + change[..., -1]
    return mu, q


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
        basis = C[:, chosen]
        x = np.linalg.solve(basis, f)
        signs = np.where(x < 0, -1.0, 1.0)
        price = np.linalg.solve(basis.T, signs) @ C
        entering = int(abs(price).argmax())
        if abs(price[entering]) <= 1 + SLACK:
            break
        slope = np.linalg.solve(basis, C[:, entering] * np.sign(price[entering]))
        reach = np.where(slope * signs > 0, x / slope, np.inf)
        chosen[int(reach.argmin())] = entering
    return chosen, x
