"""method="baecklund": products of commuting Bäcklund transformations, which conserve all integrals of the flow.

log D_eps is an odd series in eps with commuting coefficients, so K maps with sum eps_i = dt and
sum eps_i^k = 0 for k = 3, 5, ..., 2K - 1 make a step of order 2K.  With eps_i = 2 dt/zeta_i these say that
prod (1 + z/zeta_i)/(1 - z/zeta_i) is e^z up to z^(2K+1): the zeta_i are the zeros of the denominator of its
diagonal Padé approximant.  They come in conjugate pairs in the right half plane, one real zero when K is odd.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.scheme import SPINS, Points, Scheme, State, Steps, as_matrix, observer, scheme_of
from kreisel.record.calling import call
from kreisel.record.contract import Baecklund, Frame
from kreisel.record.model import Model
from kreisel.record.values import in_lane

DIGITS = 60
CLOSED_N = 5  # up to which a skew matrix has two rates at most
APART, TINY = 1e-16, 1e-300  # of the squared sum of the squares of two rates; next to 0
MANY = 4096  # values of a component: from here on one point after the other
WHOLE_TURN = 2.0  # radians that one Cayley factor makes with tan(theta/2) of size about 1


def pade_denominator(k: int) -> list[Any]:
    """Coefficients of 1, z, ... z^k in the denominator of the diagonal Padé approximant of exp, of mpmath's digits."""
    import mpmath

    return [
        (-1) ** j * mpmath.binomial(k, j) * mpmath.factorial(2 * k - j) / mpmath.factorial(2 * k) for j in range(k + 1)
    ]


@cache
def pade_zeros(stages: int) -> tuple[Any, ...]:
    """Zeros, Im >= 0, of the denominator of the diagonal Padé approximant of exp, as mpmath values.

    Raises `ArithmeticError` if the order conditions on their inverses do not hold to half the digits.
    """
    import mpmath

    with mpmath.workdps(DIGITS):
        k = stages
        zeros = mpmath.polyroots(pade_denominator(k)[::-1], maxsteps=500, extraprec=4 * DIGITS)
        for power in range(1, 2 * k, 2):
            total = sum((2 / zeta) ** power for zeta in zeros)
            if abs(total - (power == 1)) > mpmath.mpf(10) ** (-DIGITS // 2):
                raise ArithmeticError(f"{k} stages: the sum of eps^{power} is {total}")
        upper = [z for z in zeros if mpmath.im(z) > mpmath.mpf(10) ** (-DIGITS // 2)]
        real = [mpmath.re(z) for z in zeros if abs(mpmath.im(z)) <= mpmath.mpf(10) ** (-DIGITS // 2)]
        if 2 * len(upper) + len(real) != k or len(real) != k % 2:
            raise ArithmeticError(f"{k} stages: {len(upper)} pairs and {len(real)} real zeros")
        return tuple(sorted(upper, key=mpmath.im)) + tuple(real)


def stage_points(order: int, dt: float) -> list[complex | float]:
    """mu = zeta/dt of each stage, rounded once; a complex one represents itself and its conjugate."""
    import mpmath

    with mpmath.workdps(DIGITS):
        scaled = [zeta / mpmath.mpf(dt) for zeta in pade_zeros(order // 2)]
        return [complex(mu) if isinstance(mu, mpmath.mpc) else float(mu) for mu in scaled]


class Product:
    """The maps of a step: conjugate pairs, the real one, and the rotations by angles that are the same at every
    step.
    """

    def __init__(self, model: Model, dt: float, order: int, oriented: bool):
        self.model, self.dt, self.order, self.oriented = model, dt, order, oriented
        self.record = cast("Baecklund", model.system.baecklund)
        self.points = stage_points(order, dt)
        self.pairs = [mu for mu in self.points if isinstance(mu, complex)]
        self.single = [mu for mu in self.points if isinstance(mu, float)]
        mus = np.array(self.pairs)
        self.stages = {"mu_re": mus.real, "mu_im": mus.imag} if self.pairs else {}
        self.constants = {"mu": np.array(self.single[0])} if self.single else {}
        self.count = len(model.system.space.letters)
        self.parameters = {name: _at_points(x, model.axes[name]) for name, x in model.constants.items()}
        self.rest_frame = model.system.frame is Frame.REST
        self.spins = self.record.spin is not None and not self.rest_frame

    def point(self, *z: Array, **constants: Array) -> Array:
        """The constant rho of the trajectory from z, for a mu."""
        return call(self.record.point, z[: self.count], constants)

    def spin(self, *z: Array, mu: Array, **constants: Array) -> Array:
        """The rotations `SPINS` of the trajectory from z in a time mu, (2, n, n)."""
        return np.stack(spin_turns(call(self.record.spin, z[: self.count], constants), mu), -3)

    def trajectory(self, x0: State, points: Points | None = None) -> tuple[dict[str, Array], dict[str, Array]]:
        """The constants of the trajectory from x0 and of its stages."""
        state = x0[: self.count]
        constants, stages = {**self.constants}, {**self.stages}
        if self.single:
            constants |= {"rho": self._rho(x0, np.array(self.single), points)[..., 0]}
        if self.pairs:
            rho = self._rho(x0, np.array(self.pairs), points)
            stages |= {"rho_re": rho.real, "rho_im": rho.imag}
        with np.errstate(all="ignore"):  # overflow is refused
            if self.spins:
                spins = None if points is None else points(x0, np.array([self.dt]), "spin")
                if spins is None or not np.isfinite(spins).all():
                    spins = self.spin(*x0, mu=self.dt, **self.model.constants)
                constants |= {name: spins[..., i, :, :] for i, name in enumerate(SPINS)}
            if self.oriented:
                constants |= self._orientation_turns(state, as_matrix(self.model, x0[self.count]))
        return constants, stages

    def pair(self, *z: Array, mu_re: Array, mu_im: Array, rho_re: Array, rho_im: Array, **constants: Array) -> State:
        """A conjugate pair of maps."""
        mu, rho = algebra.complex_number(mu_re, mu_im), algebra.complex_number(rho_re, rho_im)
        return stage(self.record, z, self.count, {**constants, "mu": mu, "rho": rho}, True, not self.rest_frame)

    def close(self, *z: Array, **constants: Array) -> State:
        """The real map and the rotations."""
        z = stage(self.record, z, self.count, constants, False, not self.rest_frame) if self.single else z
        state, g = z[: self.count], z[self.count :]
        if self.spins:
            state = turned_with_body(self.model.system.space.kinds, state, constants, self.record.axis)
        return (*state, *(_turned_by_constants(h, constants, self.rest_frame, self.record.spin is not None) for h in g))

    def _rho(self, x0: State, mus: Array, points: Points | None) -> Array:
        """The constants of the trajectory (..., points): compiled, and by NumPy where that gives none."""
        rho = None if points is None else points(x0, mus)
        if rho is None or not np.isfinite(rho).all():
            wide = self._wide_rho(x0[: self.count], mus)
            rho = wide if rho is None else np.where(np.isfinite(rho), rho, wide)
        zero = (np.atleast_1d(rho) == 0).any(-1)
        if zero.any() and (self.pairs or self.oriented):
            name, letter = self.model.system.name, self.model.system.space.letters[1]
            raise InputError(
                f"method='baecklund' of {name}: expected a vector {letter} that is not zero{in_lane(zero)}, got 0, for "
                "which pairs of maps and orientations have no direction. Use order=2 without an orientation, or "
                "method='exact' or 'suris'."
            )
        return rho

    def _wide_rho(self, state: State, mus: Array) -> Array:
        """The constants in extended precision if the platform has it.

        NumPy's complex doubles are no choice: their last bits depend on how they lie in an array, and so on the lanes.
        """
        if len(mus) > 1 and state[0].size > MANY:  # arrays of all points would leave the cache
            return np.concatenate([self._wide_rho(state, mus[i : i + 1]) for i in range(len(mus))], -1)
        wide, kinds = np.clongdouble if np.iscomplexobj(mus) else np.longdouble, self.model.system.space.kinds
        wide_state = tuple(_at_points(x, algebra.KINDS[kind].axes) for kind, x in zip(kinds, state, strict=True))
        with np.errstate(all="ignore"):
            try:
                rho = call(self.record.point, wide_state, {**self.parameters, "mu": mus.astype(wide)})
            except np.linalg.LinAlgError:  # next to values so large the others vanish
                rho = np.array(np.nan)
        if np.isfinite(rho).all():
            return rho.astype(mus.dtype)
        name, largest, lane = self.model.system.name, np.inf, in_lane(~np.isfinite(np.atleast_1d(rho)).all(-1))
        if self.record.largest_step is not None and not np.iscomplexobj(mus):
            with np.errstate(all="ignore"):
                bound = np.min(self.model.call(self.record.largest_step, *state))
                largest = float(bound) * float(mus[0]) * self.dt / 2
        if not 0 < largest <= abs(self.dt):  # not the reason
            raise InputError(
                f"The spectral curve of {name} has no point for this state{lane} and dt = {self.dt:g}: look for a dt "
                "or a state so large that its square overflows, or a state or a field that is zero."
            )
        raise InputError(
            f"The real Bäcklund transformation of {name} does not reach as far as dt = {self.dt:g} from this "
            f"state{lane} at order {self.order}: dt < {largest:.6g} works. Use a smaller dt, or a higher order, which "
            "reaches further; orders 4, 8, 12, ... allow any dt."
        )

    def _orientation_turns(self, state: State, g: Array) -> dict[str, Array]:
        """Constants of the rotation of g on the other side than the state's: prod cay(eps/2 block), and the body's
        spin.
        """

        def moved(X: Array) -> Array:
            return g.mT @ X @ g if self.rest_frame else g @ X @ g.mT

        def by_maps(theta: Array) -> Array:
            return sum(np.arctan(theta / mu).real * (4 if isinstance(mu, complex) else 2) for mu in self.points)

        out = constant_turns("turn", moved(self.model.call(self.record.block, *state)), by_maps)
        if self.record.spin is not None:
            spin = self.model.call(self.record.spin, *state)
            out |= constant_turns("body", moved(spin) if self.rest_frame else spin, lambda theta: self.dt * theta)
        return out


def _at_points(x: Array, axes: int) -> Array:
    """With an axis of the points before those of the constant, in extended precision."""
    x = np.asarray(x, dtype=np.longdouble)
    lead = x.ndim - axes
    return x.reshape((*x.shape[:lead], 1, *x.shape[lead:]))


def baecklund(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """A step of K = order/2 Bäcklund transformations, conjugate pairs in real arithmetic.

    Raises `InputError` for steps beyond the domain.
    """
    maps = Product(model, dt, order, oriented)
    observed = observer(model, oriented, conserved=("casimir", "energy", *model.system.integrals))
    axes = dict.fromkeys(["mu", "mu_re", "mu_im", "rho", "rho_re", "rho_im"], 0)
    axes |= {f"{k}{j}": 2 for k in ("spin", "turn", "body") for j in (0, 1)}
    motion = Steps(
        maps.pair if maps.pairs else maps.close,
        maps.close if maps.pairs and (maps.single or maps.spins or oriented) else None,
    )
    return scheme_of(
        "baecklund",
        model,
        motion,
        observed,
        oriented,
        axes={**model.axes, **axes},
        options={"order": order},
        trajectory=maps.trajectory,
        point=maps.point,
        spin=maps.spin if maps.spins else None,
        dt_in_constants=True,
    )


def stage(record: Baecklund, z: State, count: int, constants: dict[str, Array], paired: bool, right: bool) -> State:
    """One map, or one conjugate pair, of a state of `count` components; orientations behind it, turned as P is."""
    e = call(record.vector, z[:count], constants)
    move, arc = (record.pair, record.arc_of_pair) if paired else (record.step, record.arc)
    state, (x, y) = (call(function, (*z[:count], e), constants) for function in (move, arc))
    return (*state, *(algebra.double_turn(x, y, g, right=right) for g in z[count:]))


# -- rotations that are the same at every step ----------------------------------------------------------


def constant_turns(name: str, K: Array, angle: Callable[[Array], Array]) -> dict[str, Array]:
    """V0, V1 with cay(V0) cay(V1) the rotation by angle(theta) in each plane where the skew matrix K rotates by
    theta.
    """
    _require_finite(K)
    theta, U = np.linalg.eigh(-1j * K)
    turn = np.remainder(angle(theta) + np.pi, 2 * np.pi) - np.pi
    twice = abs(turn).max(-1, keepdims=True) > WHOLE_TURN  # of each lane, as if it were a separate run
    half = np.tan(turn / np.where(twice, 4, 2))
    V = (U * (1j * half)[..., None, :] @ U.conj().mT).real
    V = (V - V.mT) / 2
    return {f"{name}0": V, f"{name}1": V * twice[..., None]}


def _require_finite(K: Array) -> None:
    if not np.isfinite(K).all():
        raise InputError("expected a body whose angular velocity a double can hold, got one beyond. Use other units.")


def _turned_by_constants(g: Array, constants: dict[str, Array], remainder: bool, spins: bool) -> Array:
    for j in (0, 1):
        V = constants[f"turn{j}"]
        g = algebra.turn_right(g, V) if remainder else algebra.turn_left(V, g)
        g = algebra.turn_right(g, constants[f"body{j}"]) if spins else g
    return g


def spin_turns(K: Array, dt: Array) -> tuple[Array, Array]:
    """The rotations `SPINS` by dt K, as `constant_turns`; n <= 5 for any kind of number.

    With S = -K^2, whose eigenvalues s1 >= s2 are the squares of the rates, and g(s) = tan(turn/2)/s^(1/2),
    V = K (g(s1) + (g(s1) - g(s2))/(s1 - s2) (S - s1)).  Equal rates are taken apart by less than the interpolation
    shows; their turns are wrapped together, so that the quotient stays bounded.
    """
    n = K.shape[-1]
    if n > CLOSED_N:
        V0, V1 = constant_turns("spin", K, lambda theta: dt * theta).values()
        return V0, V1
    total, minors = algebra.pairing(K, K), itertools.combinations(range(n), 4)
    pfaffians = [
        K[..., a, b] * K[..., c, d] - K[..., a, c] * K[..., b, d] + K[..., a, d] * K[..., b, c] for a, b, c, d in minors
    ]
    product, square = sum(x * x for x in pfaffians), total * total
    apart = algebra.sqrt(algebra.maximum(square - 4 * product, APART * square)) if n > 3 else total
    s1 = (total + apart) / 2 + TINY
    s2 = product / s1
    rates = algebra.sqrt(s1), algebra.sqrt(s2 + TINY)
    turn1, difference = (_wrapped(dt * x, 2 * np.pi) for x in (rates[0], rates[1] - rates[0]))
    turn2 = turn1 + difference
    turn2 = turn2 - 2 * np.pi * algebra.nearest(turn2 / (3 * np.pi))
    largest = algebra.maximum(abs(turn1), abs(turn2))
    halves = [algebra.where_less(WHOLE_TURN, largest, x / 4, x / 2) for x in (turn1, turn2)]
    g1, g2 = (np.sin(x) / np.cos(x) / rate for x, rate in zip(halves, rates, strict=True))
    V = algebra.mat(g1) * K
    if n > 3:
        V = V - algebra.mat((g1 - g2) / (s1 - s2 + TINY)) * (K @ K @ K + algebra.mat(s1) * K)
    V = (V - V.mT) / 2
    if not algebra.holds_objects(V):
        _require_finite(V)
    return V, algebra.mat(algebra.where_less(WHOLE_TURN, largest, 1 + 0 * largest, 0 * largest)) * V


def _wrapped(x: Array, period: float) -> Array:
    return x - period * algebra.nearest(x / period)


def turned_with_body(kinds: tuple[str, ...], state: State, constants: dict[str, Array], axis: str) -> State:
    """The state in a body turned by `SPINS`."""
    for half in SPINS:
        state = tuple(
            algebra.KINDS[kind].turned(-constants[half], x, constants[axis])
            for x, kind in zip(state, kinds, strict=True)
        )
    return state
