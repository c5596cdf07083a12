"""The projection in doubles, for n > 10 by the definitions on arrays, and for steps of JAX.

Values of invariants then have rounding errors of their own, of a few units in the last place; they do not add up.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, ClassVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.kernels.layout import Floats
from kreisel.kernels.projection.corrections import EPS, GAIN, TAU, Corrections, interval
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import Scheme

FLAT = 2.0**-4  # as in `kreisel.graph.project`, where values have more digits
MOST_N = 100  # beyond, an evaluation takes a second; from 82 on BLAS may give other bits for other numbers of threads
STEPS = 2  # of Newton: one leaves what is nearly redundant, 160 ulp after 8e6 steps of a top with n = 100
VECTORS = 3  # operations of a step are counted as n^2 a line, also of vectors: 4 % of the time, n = 20, where it was 11
SAMPLES = 8  # states that give the size of an invariant's terms
NONE = 1e-300  # instead of a length of 0
MOVED, CHANGED = 1e-3, 1e-11  # relative: how far a state is moved, and less than what then changes stays by itself


def scales(z: Array, J: Array, size: Array) -> tuple[Array, Array]:
    """What makes rows of J = dI/dz about 1, and the distance that 1 of each invariant then is, in eps |z|.

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

    No farther than that: where the gradient of an invariant vanishes, what it led by elsewhere is a long way.
    """
    lead = lead + GAIN * ((lack + lead) / 2 - lead)
    distance, ahead = unit * abs(lack), unit * abs(lead)
    worst = worst * (worst >= distance) + distance * (worst < distance)
    return worst, lead * (ahead <= worst)


class InDoubles(Corrections):
    """The projection of rows z (lanes, d), corrected one after the other or together by `_corrected`."""

    def _values(self, z: Floats) -> Mapping[str, Floats]:
        """Those families of invariants that are projected, (lanes, members) each."""
        raise NotImplementedError

    def _corrected(self, z: Floats) -> tuple[Floats, Floats, Floats]:
        """The projected rows, and of each invariant (lanes, invariants) the farthest that it was off, and the lead."""
        raise NotImplementedError

    def _begin(self, z: Floats, every: int) -> None:
        """Take the values at the start from the rows z."""
        found = self._values(z)
        labels = tuple(f"{k}[{i}]" if v.shape[1] > 1 else k for k, v in found.items() for i in range(v.shape[1]))
        super().__init__(labels, every, len(z))
        if not labels:
            return

        def at(state: Floats) -> Floats:
            return np.concatenate(list(self._values(state).values()), -1)

        def largest(size: Floats, other: Floats) -> Floats:
            return np.fmax(size, np.where(np.isfinite(other), abs(other), 0))

        here = np.concatenate(list(found.values()), -1)
        rms, size = np.sqrt((z * z).sum(-1, keepdims=True) / z.shape[-1]), largest(0 * here, here)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (SAMPLES, z.shape[-1]))
        for sign in signs:
            size = largest(size, at(rms * sign))
        for sign in signs[: SAMPLES // 2]:  # what a second difference shows is rounding in the values themselves
            close = 8 * EPS * rms * sign
            size = largest(size, (at(z + close) + at(z - close) - 2 * here) / EPS)
        self.targets[..., 0], self.targets[..., 2] = here, size

    def applied(self, z: Floats) -> Floats:
        """The projected rows; as they were where they could not be."""
        new, self.worst, self.targets[..., 3] = self._corrected(z)
        return np.where(np.isfinite(new).all(-1, keepdims=True), new, z)

    def peek(self, z: Floats) -> Floats:
        # Where nothing was projected yet a short run need not wait for it: `kr.drift` sees what changed.
        return self._corrected(z)[1] if self.worst.any() else np.full_like(self.worst, np.nan)


class Observed:
    """What is conserved of rows z (lanes, d) of a kernel, by the definitions on arrays of any kind.

    own      how many numbers of a row are the state's, without orientation and what the kernel keeps beside
    function the definitions: on what is left in the form of the kernel, where they are known there
    members  of each family those that change with these numbers; others stay by the form of the kernel
    """

    def __init__(self, scheme: Scheme, z: Floats):
        self.scheme, self.z = scheme, z
        self.function: Callable[..., dict[str, Array]]
        sizes = [(letter, kind, algebra.KINDS[kind].count(scheme.n)) for letter, kind in scheme.components]
        self._kinds = [kind for _, kind, _ in sizes]
        self.own = sum(size for letter, _, size in sizes if letter in scheme.outcomes and letter != ORIENTATION)
        self._known = [self._constants(lane) for lane in range(len(z))]
        in_form, self.members = reused(
            None if scheme.kernel_key is None else (Observed, scheme.kernel_key), self._found
        )
        self.function = scheme.conserved if in_form and scheme.conserved else scheme.observe

    def _found(self) -> tuple[bool, dict[str, Array]]:
        """Whether the definitions are known in the form of the kernel, and the members."""
        if self.scheme.conserved is not None:
            self.function = self.scheme.conserved
            with contextlib.suppress(Exception):  # whatever a function that expects arrays makes of that form
                return True, self._changing()
        self.function = self.scheme.observe
        return False, self._changing()

    def _constants(self, lane: int) -> dict[str, Array]:
        """All that `observe` takes, of one lane."""
        axes = self.scheme.axes
        return {
            name: np.asarray(value)[lane] if np.ndim(value) > axes[name] else value
            for name, value in self.scheme.known.items()
        }

    def at(self, row: Any, lane: int) -> dict[str, Array]:
        """The conserved variables at z[lane] with the numbers of `row` in place of its first ones."""
        return self._at(row, lane, self._known[lane])

    def _at(self, row: Any, lane: int, known: Mapping[str, Array]) -> dict[str, Array]:
        parts: list[Array] = []
        for kind, place in zip(self._kinds, algebra.slices(self._kinds, self.scheme.n), strict=True):
            numbers = row[place] if place.stop <= self.own else self.z[lane, place]
            parts.append(algebra.KINDS[kind].unpack(numbers, self.scheme.n))
        found = self.function(tuple(parts), **known)
        return {name: value for name, value in found.items() if self.scheme.outcomes[name].conserved}

    def _changing(self) -> dict[str, Array]:
        """By random numbers in place of state and constants, so that lanes do not depend on each other."""
        if self.function is self.scheme.observe:
            return {name: np.arange(np.size(value)) for name, value in self.at(self.z[0, : self.own], 0).items()}
        draw, out = np.random.default_rng(0), {}
        known = {name: draw.normal(size=np.shape(value)) for name, value in self._known[0].items()}
        here, there = (self._at(draw.normal(size=self.own), 0, known) for _ in range(2))
        for name, value in here.items():
            a, b = np.ravel(value), np.ravel(there[name])
            members = np.flatnonzero(abs(a - b) > CHANGED * np.maximum(abs(a), abs(b)))
            if len(members):
                out[name] = members
        return out

    def together(self, z: Floats) -> dict[str, Floats]:
        """`at` of all lanes, with the first numbers of `z`, by the definitions on arrays of all lanes."""
        rows = np.concatenate([z[:, : self.own], self.z[:, self.own :]], -1)
        known = self.scheme.known
        found = self.scheme.observe(algebra.restore(rows, self._kinds, self.scheme.n), **known)
        return {
            name: np.broadcast_to(value, (len(z), *np.shape(value)[1:])).reshape(len(z), -1)
            for name, value in found.items()
            if self.scheme.outcomes[name].conserved
        }


class ArrayProjection(InDoubles):
    """The projection of the states of a kernel by the definitions themselves, on arrays."""

    def __init__(self, observed: Observed, work: float):
        self._observed, self._z = observed, observed.z
        if not observed.members:
            super().__init__((), 1, len(self._z))
            return
        (first, own), d = self._recorded(self._z[0], 0), observed.own
        gradient(first, own)  # what cannot be traced back fails here
        k = first.shape[0]
        work *= min(1.0, VECTORS * d / observed.scheme.n**2)
        self._begin(self._z[:, :d], interval(STEPS * (cost(first) + k * k * d + k**3 / 3), work))

    def _recorded(self, row: Floats, lane: int) -> tuple[Traced, Traced]:
        """The invariants (k,) at z[lane] with the first numbers of `row`, and these numbers, traced."""
        z = Traced(row[: self._observed.own])
        found = self._observed.at(z, lane)
        members = self._observed.members.items()
        return Namespace.concatenate([_as_row(found[name])[kept] for name, kept in members]), z

    def _values(self, z: Floats) -> dict[str, Floats]:
        with np.errstate(all="ignore"):
            found = self._observed.together(z)
        return {name: found[name][:, kept] for name, kept in self._observed.members.items()}

    def _corrected(self, z: Floats) -> tuple[Floats, Floats, Floats]:
        new, worst, d = z.copy(), self.worst.copy(), self._observed.own
        start, _, size, lead = np.moveaxis(self.targets.copy(), -1, 0)
        with np.errstate(all="ignore"):
            for lane, row in enumerate(new):
                for again in range(STEPS):
                    values, own = self._recorded(row, lane)
                    J, lack = gradient(values, own), values.value - start[lane]
                    known = np.isfinite(J).all(-1) & np.isfinite(lack)
                    J, lack = np.where(known[:, None], J, 0), np.where(known, lack, 0)
                    scale, unit = scales(row[:d], J, size[lane])
                    if not again:
                        worst[lane], lead[lane] = led(lack, np.where(known, lead[lane], 0), unit, worst[lane])
                    row[:d] = gauss_newton(row[:d], J, lack + lead[lane], scale)
        return new, worst, lead

    def apply(self) -> None:
        """Project the state, in place."""
        self._z[:] = self.applied(self._z)


def _outer_products(a: Floats, b: Floats) -> Floats:
    """a b^T of each lane, with the same bits for any number of threads."""
    return np.einsum("lij,lkj->lik", a, b)


def _as_row(x: Any) -> Any:
    """An array as a row."""
    return x.reshape((x.value.size,)) if isinstance(x, Traced) else np.ravel(x)


def orthogonal(scheme: Scheme, z: Floats) -> None:
    """Make the orientations in rows z (lanes, d) orthogonal again: g <- g (3 - g^T g)/2."""
    for (letter, _), place in zip(scheme.components, algebra.slices(scheme.kinds, scheme.n), strict=True):
        if letter == ORIENTATION:
            g = z[:, place].reshape((len(z), scheme.n, -1))
            z[:, place] = (1.5 * g - 0.5 * _outer_products(_outer_products(g, g), g.mT)).reshape((len(z), -1))


# -- gradients of functions of arrays, by a reverse sweep ----------------------------------------------
# A `Traced` array has its value and how slopes go back through the operation that made it.  A definition runs on it as
# it is written.  Slopes of k numbers go back at once: they are (k, ...) for an array (...).

Back = Callable[[Floats], Floats]
CALL = 1e4  # operations of a kernel that take as long as NumPy takes to begin one
TOGETHER = 64  # slopes that go back at once

_creation_order = count()


class Namespace:
    """What `kreisel.algebra` and `kreisel.algebra.invariants` need of a library for such arrays."""

    @staticmethod
    def concatenate(parts: Sequence[Any], axis: int = 0) -> Traced:
        """The parts one after the other along an axis."""
        values = [_value(part) for part in parts]
        edges = np.cumsum([value.shape[axis] for value in values])[:-1].tolist()

        def back(i: int) -> Back:
            return lambda g: np.split(g, edges, axis if axis < 0 else axis + 1)[i]

        return Traced(
            np.concatenate(values, axis), *((part, back(i)) for i, part in enumerate(parts) if isinstance(part, Traced))
        )

    @staticmethod
    def stack(parts: Sequence[Any], axis: int = 0) -> Traced:
        """The parts along a new last axis."""
        if axis != -1:
            raise TypeError("traced arrays are stacked along a new last axis")
        return Namespace.concatenate([part[..., None] for part in parts], -1)

    @staticmethod
    def broadcast_to(x: Any, shape: tuple[int, ...]) -> Any:
        """The array with axes repeated."""
        return x + np.zeros(shape) if isinstance(x, Traced) else np.broadcast_to(x, shape)


class Traced:
    """A recorded array of doubles: `value`, and the arrays that it was made of with the way of slopes back to them."""

    __array_ufunc__: ClassVar[None] = None  # so that NumPy arrays leave their operators to us
    dtype: ClassVar[np.dtype[Any]] = np.dtype(np.float64)

    def __init__(self, value: Any, *parents: tuple[Traced, Back], cost: float = 0):
        self.value = np.asarray(value, dtype=np.float64)
        self.parents, self.place, self.cost = parents, next(_creation_order), cost or self.value.size

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    @property
    def ndim(self) -> int:
        return self.value.ndim

    @property
    def mT(self) -> Traced:
        return Traced(self.value.mT, (self, lambda g: g.mT))

    def __array_namespace__(self) -> type[Namespace]:
        return Namespace

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a traced array is no array of NumPy")

    def __array_function__(self, function: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        if function in (np.ndim, np.shape):
            return getattr(args[0], function.__name__)
        own = getattr(Namespace, function.__name__, None)
        if own is None:
            raise TypeError(f"np.{function.__name__} of traced arrays is not known")
        return own(*args, **kwargs)

    def _with(self, value: Floats, other: Any, mine: Back, its: Back) -> Traced:
        """An entrywise result; slopes are added up over axes along which an array was repeated."""
        parents = [(self, lambda g: _unrepeated(mine(g), self.shape))]
        if isinstance(other, Traced):
            parents.append((other, lambda g: _unrepeated(its(g), other.shape)))
        return Traced(value, *parents)

    def __neg__(self) -> Traced:
        return Traced(-self.value, (self, np.negative))

    def __add__(self, other: Any) -> Traced:
        return self._with(self.value + _value(other), other, lambda g: g, lambda g: g)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Traced:
        return self._with(self.value - _value(other), other, lambda g: g, np.negative)

    def __rsub__(self, other: Any) -> Traced:
        return self._with(_value(other) - self.value, other, np.negative, lambda g: g)

    def __mul__(self, other: Any) -> Traced:
        y = _value(other)
        return self._with(self.value * y, other, lambda g: g * y, lambda g: g * self.value)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Traced:
        y = _value(other)
        value = self.value / y
        return self._with(value, other, lambda g: g / y, lambda g: -g * (value / y))

    def __rtruediv__(self, other: Any) -> Traced:
        value = _value(other) / self.value
        return Traced(value, (self, lambda g: _unrepeated(-g * (value / self.value), self.shape)))

    def __pow__(self, exponent: int) -> Traced:
        return Traced(self.value**exponent, (self, lambda g: g * (exponent * self.value ** (exponent - 1))))

    def __matmul__(self, other: Any) -> Traced:
        return _product(self, other)

    def __rmatmul__(self, other: Any) -> Traced:
        return _product(other, self)

    def __getitem__(self, index: Any) -> Traced:
        places = index if isinstance(index, tuple) else (index,)

        def back(g: Floats) -> Floats:
            out = np.zeros((len(g), *self.shape))
            np.add.at(out, (slice(None), *places), g)
            return out

        return Traced(self.value[index], (self, back))

    def sqrt(self) -> Traced:
        value = np.sqrt(self.value)
        return Traced(value, (self, lambda g: g * (0.5 / value)))

    def log(self) -> Traced:
        return Traced(np.log(self.value), (self, lambda g: g / self.value))

    def sum(self, axis: int) -> Traced:
        if axis >= 0:
            raise TypeError("traced arrays are added up along an axis counted from the last one")
        return Traced(
            self.value.sum(axis),
            (self, lambda g: np.broadcast_to(np.expand_dims(g, axis), (len(g), *self.shape))),
            cost=self.value.size,
        )

    def reshape(self, shape: tuple[int, ...]) -> Traced:
        return Traced(self.value.reshape(shape), (self, lambda g: g.reshape((len(g), *self.shape))))


def _value(x: Any) -> Floats:
    return x.value if isinstance(x, Traced) else np.asarray(x)


def _unrepeated(g: Floats, shape: tuple[int, ...]) -> Floats:
    """The slopes (k, ...) of an array that was repeated, added up to (k, *shape)."""
    extra = g.ndim - 1 - len(shape)
    g = g.sum(tuple(range(1, 1 + extra))) if extra > 0 else g
    repeated = tuple(i + 1 for i, size in enumerate(shape) if size == 1 and g.shape[i + 1] > 1)
    return g.sum(repeated, keepdims=True) if repeated else g


def _product(x: Any, y: Any) -> Traced:
    """The product of two matrices."""
    a, b = _value(x), _value(y)
    if a.ndim != 2 or b.ndim != 2:
        raise TypeError(f"products of traced arrays are those of two matrices, not of shapes {a.shape} and {b.shape}")
    ways = ((x, lambda g: g @ b.T), (y, lambda g: a.T @ g))
    return Traced(a @ b, *((z, back) for z, back in ways if isinstance(z, Traced)), cost=a.size * b.shape[1])


def _reached(y: Traced) -> list[Traced]:
    """All arrays that y was made of, y among them, the last one first."""
    found, waiting = {y.place: y}, [y]
    while waiting:
        for parent, _ in waiting.pop().parents:
            if parent.place not in found:
                found[parent.place] = parent
                waiting.append(parent)
    return [found[place] for place in sorted(found, reverse=True)]


def gradient(y: Traced, z: Traced) -> Floats:
    """dy/dz (k, d) for y (k,) and z (d,)."""
    nodes, rows = _reached(y), len(y.value)
    out = np.zeros((rows, len(z.value)))
    for first in range(0, rows, TOGETHER):
        slopes = {y.place: np.eye(rows)[first : first + TOGETHER]}
        for node in nodes:
            g = slopes.pop(node.place, None)
            if g is None:
                continue
            if node is z:
                out[first : first + TOGETHER] = g
            for parent, back in node.parents:
                slope = back(g)
                slopes[parent.place] = slopes[parent.place] + slope if parent.place in slopes else slope
    return out


def cost(y: Traced) -> float:
    """About how many operations of a kernel take as long as y and its gradient."""
    rows = len(y.value)
    calls = 1 + 2 * -(-rows // TOGETHER)
    return sum(CALL * calls + node.cost * (1 + 2 * rows) for node in _reached(y))
