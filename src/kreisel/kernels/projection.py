"""The projection in doubles, for n > 10 by the definitions on arrays, and for steps of JAX.

Values of invariants then have rounding errors of their own, of a few units in the last place; they do not add up.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.graph.project import EPS, GAIN, TAU, Corrections, interval
from kreisel.kernels.layout import Floats
from kreisel.kernels.traced import Namespace, Traced, cost, gradient
from kreisel.method.scheme import ORIENTATION, Scheme

FLAT = 2.0**-4  # as in `kreisel.graph.project`, where values have more digits
MOST_N = 100  # beyond, an evaluation needs a second; from 82 on BLAS may give other bits for other counts of threads
MOST_WORK = 1e10  # multiplications of a solution: the 4,851 momenta of Ratiu's top with n = 100 need minutes
STEPS = 2  # of Newton: after one, nearly redundant invariants drift, by 160 ulp after 8e6 steps of a top with n = 100
VECTORS = 3  # operations of a step are counted as n^2 a line, also of vectors: 4 % of the time, n = 20, where it was 11
SAMPLES = 8  # states that give the size of an invariant's terms
NONE = 1e-300  # instead of a length of 0
CHANGED = 1e-11  # relative: a change below this is rounding


def scales(z: Array, J: Array, size: Array) -> tuple[Array, Array]:
    """Factors that scale rows of J = dI/dz to about 1, and the distance that 1 of each invariant then is, in eps |z|.

    z is the state (d,), size that of the terms of I.
    """
    length = (z * z).sum() ** 0.5 + NONE
    scale = 1 / ((J * J).sum(-1) + (FLAT * size / length) ** 2 + NONE) ** 0.5
    return scale, scale / (EPS * length)


def gauss_newton(z: Array, J: Array, lack: Array, scale: Array) -> Array:
    """One step of Gauss and Newton from the state z (d,), which lacks so much of the invariants."""
    J = scale[:, None] * J
    y = algebra.solve(J @ J.T + TAU * algebra.identity(len(lack)), (scale * lack)[:, None])[:, 0]
    return z - y @ J


def led(lack: Array, lead: Array, unit: Array, worst: Array) -> tuple[Array, Array]:
    """The farthest that each invariant was off yet, as a distance, and by how much it is to lead.

    No farther than that: where the gradient of an invariant vanishes, a step along it would be far too long.
    """
    lead = lead + GAIN * ((lack + lead) / 2 - lead)
    distance, ahead = unit * abs(lack), unit * abs(lead)
    worst = worst * (worst >= distance) + distance * (worst < distance)
    return worst, lead * (ahead <= worst)


class InDoubles(Corrections):
    """The projection of rows z (lanes, d), corrected one after the other or together by `_corrected`."""

    _z: Floats

    def _values(self, z: Floats) -> Mapping[str, Floats]:
        """The families of invariants that are projected, (lanes, members) each."""
        raise NotImplementedError

    def _corrected(self, z: Floats) -> tuple[Floats, Floats, Floats]:
        """The projected rows, and of each invariant (lanes, invariants) the farthest that it was off, and the lead."""
        raise NotImplementedError

    _start: Floats | None = None

    def _begin(self, counts: Mapping[str, int], every: int) -> None:
        """Keep the rows at the start; `counts` has the number of members of each family of invariants."""
        labels = tuple(f"{name}[{i}]" if count > 1 else name for name, count in counts.items() for i in range(count))
        super().__init__(labels, every, len(self._z))
        self._start = self._z.copy() if labels else None

    def _aim(self) -> None:
        """Compute the values at the start: 17 evaluations, deferred to the first projection or checkpoint."""
        if self._start is None:
            return
        now = self._z.copy()
        self._z[:] = self._start
        try:
            self._measure(self._state())
        finally:  # an interrupt here must not leave the state of the start
            self._z[:] = now
        self._start = None

    def _measure(self, z: Floats) -> None:
        """The values of the invariants at rows z, and the size of their terms, into `targets`."""

        def at(state: Floats) -> Floats:
            return np.concatenate(list(self._values(state).values()), -1)

        def largest(size: Floats, values: Floats) -> Floats:
            return np.fmax(size, np.where(np.isfinite(values), abs(values), 0))

        values = at(z)
        rms, size = np.sqrt((z * z).sum(-1, keepdims=True) / z.shape[-1]), largest(0 * values, values)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (SAMPLES, z.shape[-1]))
        for sign in signs:
            size = largest(size, at(rms * sign))
        for sign in signs[: SAMPLES // 2]:  # a second difference shows the rounding of the values themselves
            close = 8 * EPS * rms * sign
            size = largest(size, (at(z + close) + at(z - close) - 2 * values) / EPS)
        self.targets[..., 0], self.targets[..., 2] = values, size

    def _state(self) -> Floats:
        """The rows without an orientation."""
        return self._z

    def apply(self) -> None:
        """Project the state, in place; rows that cannot be projected are unchanged."""
        self._aim()
        new, self.worst, self.targets[..., 3] = self._corrected(self._z)
        self._z[:] = np.where(np.isfinite(new).all(-1, keepdims=True), new, self._z)

    def peek(self, z: Floats) -> Floats:
        # Where nothing was projected yet a short run need not wait for it: `kr.drift` sees what changed.
        return self._corrected(z)[1] if self.worst.any() else np.full_like(self.worst, np.nan)

    def snapshot(self) -> dict[str, Floats]:
        self._aim()
        return super().snapshot()

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self._start = None
        super().restore(snapshot)


class Observed:
    """Conserved quantities of rows z (lanes, d) of a kernel, by the definitions on arrays of any kind.

    size     how many entries of a row are the state's, without orientation and other variables of the kernel
    function the definitions: on the form of the kernel, if there are any
    members  of each family those that change with these scalars; others stay by the form of the kernel
    """

    def __init__(self, scheme: Scheme, z: Floats):
        self.scheme, self.z = scheme, z
        self.function: Callable[..., dict[str, Array]]
        sizes = [(letter, kind, algebra.KINDS[kind].count(scheme.n)) for letter, kind in scheme.components]
        self._kinds = [kind for _, kind, _ in sizes]
        self.size = sum(size for letter, _, size in sizes if letter in scheme.outcomes and letter != ORIENTATION)
        self._constants_of_lanes = [self._constants(lane) for lane in range(len(z))]
        in_form, self.members = reused(
            None if scheme.kernel_key is None else (Observed, scheme.kernel_key), self._form_and_members
        )
        self.function = scheme.conserved if in_form and scheme.conserved else scheme.observe

    def _form_and_members(self) -> tuple[bool, dict[str, Array]]:
        """Whether the definitions are known in the form of the kernel, and the members."""
        if self.scheme.conserved is not None:
            self.function = self.scheme.conserved
            with contextlib.suppress(Exception):  # whatever a function that expects arrays makes of that form
                return True, self._changing()
        self.function = self.scheme.observe
        return False, self._changing()

    def _constants(self, lane: int) -> dict[str, Array]:
        """All that `observe` needs, of one lane."""
        axes = self.scheme.axes
        return {
            name: np.asarray(value)[lane] if np.ndim(value) > axes[name] else value
            for name, value in self.scheme.keywords.items()
        }

    def at(self, row: Any, lane: int) -> dict[str, Array]:
        """The conserved variables at z[lane] with the values of `row` in place of its first ones."""
        return self._at(row, lane, self._constants_of_lanes[lane])

    def _at(self, row: Any, lane: int, constants: Mapping[str, Array]) -> dict[str, Array]:
        parts: list[Array] = []
        for kind, place in zip(self._kinds, algebra.slices(self._kinds, self.scheme.n), strict=True):
            numbers = row[place] if place.stop <= self.size else self.z[lane, place]
            parts.append(algebra.KINDS[kind].unpack(numbers, self.scheme.n))
        result = self.function(tuple(parts), **constants)
        return {name: value for name, value in result.items() if self.scheme.outcomes[name].conserved}

    def _changing(self) -> dict[str, Array]:
        """By random scalars in place of state and constants, so that lanes do not depend on each other."""
        if self.function is self.scheme.observe:
            return {name: np.arange(np.size(value)) for name, value in self.at(self.z[0, : self.size], 0).items()}
        draw, out = np.random.default_rng(0), {}
        constants = {name: draw.normal(size=np.shape(value)) for name, value in self._constants_of_lanes[0].items()}
        first, second = (self._at(draw.normal(size=self.size), 0, constants) for _ in range(2))
        for name, value in first.items():
            a, b = np.ravel(value), np.ravel(second[name])
            members = np.flatnonzero(abs(a - b) > CHANGED * np.maximum(abs(a), abs(b)))
            if len(members):
                out[name] = members
        return out

    def together(self, z: Floats) -> dict[str, Floats]:
        """`at` of all lanes, with the first scalars of `z`, by the definitions on arrays of all lanes."""
        rows = np.concatenate([z[:, : self.size], self.z[:, self.size :]], -1)
        constants = self.scheme.keywords
        result = self.scheme.observe(algebra.restore(rows, self._kinds, self.scheme.n), **constants)
        return {
            name: np.broadcast_to(value, (len(z), *np.shape(value)[1:])).reshape(len(z), -1)
            for name, value in result.items()
            if self.scheme.outcomes[name].conserved
        }


class ArrayProjection(InDoubles):
    """The projection of the states of a kernel by the definitions themselves, on arrays."""

    def __init__(self, observed: Observed, work: float):
        self._observed, self._z = observed, observed.z
        scheme, d = observed.scheme, observed.size
        k = sum(map(len, observed.members.values()))
        if not k or k * k * d > MOST_WORK:
            super().__init__((), 1, len(self._z))
            return
        key = None if scheme.kernel_key is None else (ArrayProjection, scheme.kernel_key)
        work *= min(1.0, VECTORS * d / scheme.n**2)
        self._begin(
            {name: len(kept) for name, kept in observed.members.items()},
            interval(STEPS * (reused(key, self._cost) + k * k * d + k**3 / 3), work),
        )

    def _cost(self) -> float:
        """The cost of the invariants and their gradients; operations without an adjoint fail here."""
        first, state = self._recorded(self._z[0], 0)
        gradient(first, state)
        return cost(first)

    def _state(self) -> Floats:
        return self._z[:, : self._observed.size]

    def _recorded(self, row: Floats, lane: int) -> tuple[Traced, Traced]:
        """The invariants (k,) at z[lane] with the first scalars of `row`, and these scalars, traced."""
        z = Traced(row[: self._observed.size])
        result = self._observed.at(z, lane)
        members = self._observed.members.items()
        return Namespace.concatenate([np.ravel(result[name])[kept] for name, kept in members]), z

    def _values(self, z: Floats) -> dict[str, Floats]:
        with np.errstate(all="ignore"):
            result = self._observed.together(z)
        return {name: result[name][:, kept] for name, kept in self._observed.members.items()}

    def _corrected(self, z: Floats) -> tuple[Floats, Floats, Floats]:
        new, worst, d = z.copy(), self.worst.copy(), self._observed.size
        start, _, size, lead = np.moveaxis(self.targets.copy(), -1, 0)
        with np.errstate(all="ignore"):
            for lane, row in enumerate(new):
                for again in range(STEPS):
                    values, state = self._recorded(row, lane)
                    J, lack = gradient(values, state), values.value - start[lane]
                    finite = np.isfinite(J).all(-1) & np.isfinite(lack)
                    J, lack = np.where(finite[:, None], J, 0), np.where(finite, lack, 0)
                    scale, unit = scales(row[:d], J, size[lane])
                    if not again:
                        worst[lane], lead[lane] = led(lack, np.where(finite, lead[lane], 0), unit, worst[lane])
                    row[:d] = gauss_newton(row[:d], J, lack + lead[lane], scale)
        return new, worst, lead


def _outer_products(a: Floats, b: Floats) -> Floats:
    """a b^T of each lane, with the same bits for any number of threads."""
    return np.einsum("lij,lkj->lik", a, b)


def orthogonal(scheme: Scheme, z: Floats) -> None:
    """Make the orientations in rows z (lanes, d) orthogonal again: g <- g (3 - g^T g)/2."""
    for (letter, _), place in zip(scheme.components, algebra.slices(scheme.kinds, scheme.n), strict=True):
        if letter == ORIENTATION:
            g = z[:, place].reshape((len(z), scheme.n, -1))
            z[:, place] = (1.5 * g - 0.5 * _outer_products(_outer_products(g, g), g.mT)).reshape((len(z), -1))
