"""Large n: kernels of O(n) or O(n^2) a step, from the definition run on vectors and matrices with structure.

Three forms are known.  About an axis: one momentum m that changes only by s ^ p, p a constant, and vectors, for steps
that mean the same in every orthonormal basis.  The part of m that does not touch p is then constant; in its real
Schur form (2 x 2 blocks theta) a product and a solve with m cost O(n).  Plain: only vectors, as they are.
Dense: one momentum M of n^2 scalars that changes by a few pairs s ^ t; each solve has a separate inverse, which is
part of the state and follows the changes by Woodbury's formula.  It starts as 0; where the residual of a solve is too
large, it is made anew and the step done again.
Which form a step has, if any, is found by recording it (`kreisel.kernels.large.structured`).

About an axis an orientation may be carried along, known by its columns or its rows, which are turned alike.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.errors import InputError
from kreisel.graph.arranging import arranged, independent
from kreisel.graph.graph import IN, Graph, Number, Operand
from kreisel.kernels.large.structured import Dense, StructuredMatrix, StructuredVector, changed_inverse
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Part, Scheme, Steps

AXIS_NAME, TURN_NAME = "axis", "turn"
IN_PLANES = 1e-10  # how far a constant matrix may be from a rotation in the planes of T, relative
BASIS = "basis_"
BASIS_AXES = {f"{BASIS}{letter}": count for letter, count in {"x": 2, "y": 2, "p": 1, "length": 0, "T": 2}.items()}
SHORTEST = 1e-100  # of an axis


AXIS, TURN = f"c_{AXIS_NAME}", f"c_{TURN_NAME}"  # letters of inputs
INVERSE = "inverse"
LEAST_N = 4  # for n = 3 the definitions have separate closed forms


@dataclass(frozen=True)
class LargeForm:
    """How the state and the constants of a scheme are laid out: blocks of h entries, and scalars.

    axis     the letter of the constant p, or "" for the other forms
    inverses kept ones of the dense form, 0 for the other forms
    kinds    of the components
    by_rows  whether an orientation is known by its rows, not by its columns
    roles    of each constant whether it belongs to the trajectory (c) or to the stage (s), and what it is: a number,
             the axis, a rotation in the planes of T, or a vector
    """

    n: int
    axis: str
    roles: Mapping[str, tuple[str, str]]
    inverses: int = 0
    kinds: tuple[str, ...] = ()
    by_rows: bool = False

    @property
    def _axes(self) -> list[int]:
        return [2 if kind == "skew" else 1 for kind in self.kinds]

    @property
    def h(self) -> int:
        """Entries in a block: planes of p^perp, or n."""
        return self.n // 2 if self.axis else self.n

    def blocks(self, kind: str) -> tuple[str, ...]:
        """The blocks of a component, by letter; t is a number."""
        if not self.axis:
            return () if kind == "skew" else ("x",)
        return ("x", "y") if kind == "skew" else ("x", "y", "t")

    def size(self, kind: str) -> int:
        """Numbers of a component."""
        if kind == "skew" and not self.axis:
            return self.n * (self.n - 1) // 2
        if kind == "matrix":
            return self.n * self.size("vector")
        return sum(1 if block == "t" else self.h for block in self.blocks(kind))

    # -- recording -------------------------------------------------------------------------------

    def _component(self, name: str, kind: str, entry: Callable[[str], Any], turn: Any) -> Any:
        if kind == "skew" and not self.axis:
            return StructuredMatrix(self.n, turn=1.0, dense=Dense(entry(name)))
        blocks = tuple(entry(f"{name}{block}") for block in self.blocks(kind))
        if kind == "skew":
            s, p = StructuredVector(self.n, (*blocks, 0.0)), self._constant("axis", entry(AXIS))
            return StructuredMatrix(self.n, turn=turn, kept=not isinstance(turn, Number)).with_pair(s, p)
        return StructuredVector(self.n, blocks, rows=self.by_rows if kind == "matrix" else None)

    def _constant(self, role: str, entry: Any) -> Any:
        if role == "number":
            return entry
        if role == "turn":
            return StructuredMatrix(self.n, turn=entry)
        return StructuredVector(self.n, (0.0, 0.0, entry) if role == "axis" else (entry,), axis=role == "axis")

    def recorded(self, part: Part) -> tuple[Graph, tuple[Any, ...]]:
        """The new state of a function on the recorded state, and on the constants of the letters that it needs."""
        graph = Graph()

        def entry(name: str) -> Number:
            return graph.input(name, 0)

        state = [self._component(f"z{i}", kind, entry, entry(TURN)) for i, kind in enumerate(self.kinds)]
        constants = {
            k: self._constant(role, entry(AXIS if role == "axis" else f"{letter}_{k}"))
            for k, (letter, role) in self.roles.items()
            if letter in part.letters
        }
        return graph, part.function(*state, **constants)

    def outputs(self, new: tuple[Any, ...]) -> list[Any]:
        """The new state in the order of `names`; TypeError if it has left the form."""
        out: list[Any] = []
        for value, kind in zip(new, self.kinds, strict=True):
            if kind == "skew" and not self.axis:
                continue
            vector = _momentum(value) if kind == "skew" else value
            if not isinstance(vector, StructuredVector) or bool(vector.rows) != (kind == "matrix" and self.by_rows):
                raise TypeError("a component that is no longer a vector")
            out += vector.entries[: len(self.blocks(kind))]
        return out

    @property
    def names(self) -> list[str]:
        """The recorded scalars of the state."""
        return [f"z{i}{block}" for i, kind in enumerate(self.kinds) for block in self.blocks(kind)]

    # -- scalars ---------------------------------------------------------------------------------

    def on(self, scheme: Scheme, x0: tuple[Array, ...]) -> Scheme:
        """The scheme in this form for the trajectories from x0, whose constants it has."""
        basis = Basis.of(self, scheme, scheme.prepare(x0)) if self.axis else None
        into = basis.into if basis else self._into
        constants = basis.constants(self, scheme) if basis else dict(scheme.constants)
        axes = {name: int(self.roles.get(name, ("c", "turn"))[1] in ("turn", "vector")) for name in constants}
        components = [(letter, f"R^{self.size(kind)}") for letter, kind in scheme.components]
        kept = [(f"{INVERSE}{k}", f"R^{self.n**2}") for k in range(self.inverses)]
        own = self.n, self.axis, tuple(self.roles.items()), self.inverses, self.kinds, self.by_rows
        return replace(
            scheme,
            components=(*components, *kept),
            constants=constants,
            axes={**scheme.axes, **axes, AXIS_NAME: 0, **BASIS_AXES},
            prepare=lambda x: into(scheme.prepare(x)),
            observe=basis.observer(scheme.observe) if basis else self._observer(scheme.observe),
            reopen=lambda x: into(scheme.reopen(x)),
            conserved=self._conserved(scheme.observe) if basis else None,
            recordable=False,
            basis=basis.arrays if basis else {},
            definition_key=None,
            kernel_key=None if scheme.kernel_key is None else (scheme.kernel_key, own),
        )

    def _conserved(self, observe: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, Array]]:
        """`observe` of the blocks about an axis as they are, of all but T."""

        def of_blocks(z: tuple[Array, ...], /, **known: Array) -> dict[str, Array]:
            h, values = self.h, {AXIS: _scalar_or_plain(known[AXIS_NAME])}
            for i, value in enumerate(z):
                values |= {f"z{i}x": value[:h], f"z{i}y": value[h : 2 * h], f"z{i}t": _scalar_or_plain(value[-1])}
            state = [
                self._component(f"z{i}", kind, values.__getitem__, known[TURN_NAME])
                for i, kind in enumerate(self.kinds[: len(z)])
                if kind != "matrix"
            ]
            constants = {}
            for name, role in ((name, role) for name, (letter, role) in self.roles.items() if letter == "c"):
                value = known[AXIS_NAME if role == "axis" else name]
                constants[name] = self._constant(role, value if role == "turn" else _scalar_or_plain(value))
            return observe(tuple(state), **constants)

        return of_blocks

    def _back(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(algebra.skew(v, self.n) if k == 2 else v for v, k in zip(z, self._axes, strict=False))

    def _into(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        if not self.inverses:
            return z
        batch = np.broadcast_shapes(*(v.shape[: v.ndim - k] for v, k in zip(z, self._axes, strict=True)))
        own = (algebra.coordinates(v) if k == 2 else v for v, k in zip(z, self._axes, strict=True))
        return (*own, *(np.zeros((*batch, self.n**2)) for _ in range(self.inverses)))

    def _observer(self, observe: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, Array]]:
        def of_rows(z: tuple[Array, ...], only: Collection[str] | None = None, /, **known: Array) -> dict[str, Array]:
            return observe(self._back(z), only, **known)

        return of_rows


def _scalar_or_plain(x: Any) -> Any:
    return x if isinstance(x, Number) else float(x)


def _momentum(value: Any) -> StructuredVector:
    """s of m = T + s ^ p, with the T that it had before."""
    turn = value.turn if isinstance(value, StructuredMatrix) else None
    if not isinstance(turn, Number) or turn.negative or turn.node != (IN, TURN, 0):
        raise TypeError("a momentum whose constant part has changed")
    if len(value.pairs) != 1 or isinstance(value.diagonal, StructuredVector) or value.diagonal != 0.0:
        raise TypeError("a momentum that is not T + s ^ p")
    ((_, s, t),) = value.pairs.values()
    if not t.axis:
        raise TypeError("about an axis, momenta change only by pairs with the axis")
    return s


def form_of(scheme: Scheme) -> LargeForm | None:
    """The form that a scheme with the constants of its trajectories has, found by recording it; None for none."""
    if not isinstance(scheme.motion, Steps) or not scheme.recordable or scheme.corrector or scheme.n < LEAST_N:
        return None
    kinds = tuple(scheme.kinds)
    if not set(kinds) <= {"skew", "vector", "matrix"} or kinds.count("skew") > 1 or kinds.count("matrix") > 1:
        return None
    constants = {"c": scheme.constants, "s": scheme.stages}
    axes = {name: (letter, scheme.axes[name]) for letter, names in constants.items() for name in names}
    vectors = [name for name in scheme.constants if scheme.axes[name] == 1]
    forms: list[tuple[str, tuple[str, ...], bool]] = []
    if "skew" in kinds and len(vectors) == 1:
        if not (_axis_lengths(scheme.constants[vectors[0]]) > SHORTEST).all():
            return None
        about = ("number", "axis", "turn")
        forms += [(vectors[0], about, by_rows) for by_rows in ((False, True) if "matrix" in kinds else (False,))]
    if all(count < 2 for _, count in axes.values()) and "matrix" not in kinds:
        forms.append(("", ("number", "vector"), False))
    roles = [{name: (letter, kind_of[count]) for name, (letter, count) in axes.items()} for _, kind_of, _ in forms]
    tried = [
        LargeForm(scheme.n, axis, r, 0, kinds, by_rows) for r, (axis, _, by_rows) in zip(roles, forms, strict=True)
    ]
    return reused(
        None if scheme.kernel_key is None else (form_of, scheme.kernel_key), lambda: _first_that_holds(tried, scheme)
    )


def _first_that_holds(forms: list[LargeForm], scheme: Scheme) -> LargeForm | None:
    for form in forms:
        kinds = form.kinds
        try:
            pieces = [recorded_large(form, part) for part in scheme.parts]
        except (TypeError, KeyError, AttributeError):
            continue
        dense = "skew" in kinds and not form.axis
        if (not dense and "matrix" not in kinds) or (len(pieces) == 1 and scheme.stage_count == 1):
            return replace(form, inverses=len(pieces[0].inverses))
    return None


class Change(NamedTuple):
    """scale x y^T, or for the momentum scale x ^ y: a number and two vectors, by their entries."""

    scale: Operand
    x: Operand
    y: Operand


class Inverse(NamedTuple):
    """A kept inverse, that of diagonal + turn M.

    residual, size  |r|^2 and |v|^2 of a solve, r its residual
    changes         when M has changed
    """

    diagonal: Operand
    turn: Operand
    residual: Operand
    size: Operand
    changes: tuple[Change, ...]


class LargeFunction(NamedTuple):
    """A recorded function: its graph, the new state, and of a dense momentum its changes and the kept inverses."""

    graph: Graph
    new: list[Operand]
    pairs: tuple[Change, ...] = ()
    inverses: tuple[Inverse, ...] = ()

    @property
    def upkeep(self) -> list[Operand]:
        """All scalars and entries of the changes."""
        return _leaves((self.pairs, self.inverses))


def _leaves(tree: Any) -> list[Any]:
    return [leaf for each in tree for leaf in _leaves(each)] if isinstance(tree, tuple) else [tree]


def _with_leaves(tree: Any, leaves: Iterator[Any]) -> Any:
    if not isinstance(tree, tuple):
        return next(leaves)
    values = [_with_leaves(each, leaves) for each in tree]
    return type(tree)(*values) if hasattr(tree, "_fields") else tuple(values)


def recorded_large(form: LargeForm, part: Part) -> LargeFunction:
    """A step or `close` on recorded scalars; TypeError where the form does not hold."""
    graph, values = form.recorded(part)
    new = form.outputs(values)
    dense = "skew" in form.kinds and not form.axis
    upkeep = _upkeep(values[form.kinds.index("skew")]) if dense else ((), ())
    if any(not isinstance(v, Number | float | int) for v in [*new, *_leaves(upkeep)]):
        raise TypeError("a new state that is complex")
    graph, outputs = arranged(graph, [*new, *_leaves(upkeep)])
    pairs, inverses = _with_leaves(upkeep, iter(outputs[len(new) :]))
    fixed = independent(graph, graph.needed(outputs), {f"c_{name}" for name in form.roles})
    if any(isinstance(x, Number) and x.at not in fixed for inverse in inverses for x in inverse[:2]):
        raise TypeError("a solve with more than the momentum in its matrix that varies")
    return LargeFunction(graph, outputs[: len(new)], pairs, inverses)


def _upkeep(M: Any) -> tuple[tuple[Change, ...], tuple[Inverse, ...]]:
    """How the new momentum and its inverses come from the old ones."""
    if not isinstance(M, StructuredMatrix) or M.dense is None or (M.turn, M.diagonal) != (1.0, 0.0):
        raise TypeError("a momentum that has changed by other than pairs")

    def change(scale: Any, x: StructuredVector, y: StructuredVector) -> Change:
        if not isinstance(x.entries[0], Number) or not isinstance(y.entries[0], Number):
            raise TypeError("a dense momentum changed by plain or complex values")
        return Change(scale, x.entries[0], y.entries[0])

    pairs, inverses = [*M.pairs.values()], []
    for k, (diagonal, turn) in enumerate(M.dense.inverses):
        diagonal = diagonal.entries[0] if isinstance(diagonal, StructuredVector) else diagonal
        changes = tuple(change(-1.0, x, r) for x, r in changed_inverse(M.dense, k, pairs))
        inverses.append(Inverse(diagonal, turn, *M.dense.checks[k], changes))
    return tuple(change(*pair) for pair in pairs), tuple(inverses)


# -- the orthonormal basis of the form about an axis ---------------------------------------------------


def _axis_lengths(p: Array) -> Array:
    p = np.asarray(p, dtype=np.float64)
    return np.sqrt((p * p).sum(-1))


@dataclass(frozen=True)
class Basis:
    """An orthonormal basis for each trajectory, ([lane,] n, h) twice and p/|p|, in which T has blocks theta.

    T = pi m pi, pi = I - p p^T/|p|^2, maps x_k to theta_k y_k and y_k to -theta_k x_k.  Where n - 1 is odd the last
    y is 0.  m = T + s ^ p with s = m p/|p|^2.
    """

    x: Array
    y: Array
    p: Array
    length: Array
    theta: Array
    T: Array
    kinds: tuple[str, ...]
    by_rows: bool

    @property
    def arrays(self) -> dict[str, Array]:
        """Arrays for `back`, by name."""
        return {name: getattr(self, name.removeprefix(BASIS)) for name in BASIS_AXES}

    @staticmethod
    def of(form: LargeForm, scheme: Scheme, z0: tuple[Array, ...]) -> Basis:
        """The basis for the states z0."""
        kinds = tuple(scheme.kinds)
        p = np.asarray(scheme.constants[form.axis], dtype=np.float64)
        m = np.asarray(z0[kinds.index("skew")], dtype=np.float64)
        batch = np.broadcast_shapes(p.shape[:-1], m.shape[:-2])
        p = np.broadcast_to(p, (*batch, form.n))
        T = algebra.project_out(m, p) / algebra.mat(algebra.dot(p, p))
        T = np.broadcast_to((T - T.mT) / 2, (*batch, form.n, form.n))
        found = [_planes(T[lane], p[lane]) for lane in np.ndindex(batch)]
        x, y, theta = (np.array(part).reshape((*batch, *part[0].shape)) for part in zip(*found, strict=True))
        return Basis(x, y, p, _axis_lengths(p), theta, T, kinds, form.by_rows)

    def constants(self, form: LargeForm, scheme: Scheme) -> dict[str, Array]:
        """The constants in this basis.  Raises `InputError` for a rotation that is not in the planes of T."""
        out: dict[str, Array] = {AXIS_NAME: self.length, TURN_NAME: self.theta}
        for name, value in scheme.constants.items():
            role = form.roles[name][1]
            if role == "number":
                out[name] = value
            elif role == "turn":
                moved = value @ self.x
                out[name] = (self.y * moved).sum(-2)
                off = abs(moved - self.y * out[name][..., None, :]).max(initial=0)
                if off > IN_PLANES * max(1.0, abs(value).max(initial=0)):
                    raise InputError(
                        f"engine='large' cannot compute the rotation {name} of method={scheme.name!r}; use 'cpu'."
                    )
        return out

    def into(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """Blocks of the components, one after the other (..., size)."""
        out = []
        for value, kind in zip(z, self.kinds, strict=True):
            if kind == "matrix":
                g = value if self.by_rows else value.mT  # the vectors of g, as rows
                along = g @ (self.p / algebra.vec(self.length))[..., None]
                blocks = np.concatenate([g @ self.x, g @ self.y, along], -1)
                out.append(blocks.reshape((*blocks.shape[:-2], -1)))
                continue
            v = algebra.act(value, self.p) / algebra.vec(self.length**2) if kind == "skew" else value
            along = [] if kind == "skew" else [algebra.vec(algebra.dot(v, self.p) / self.length)]
            out.append(np.concatenate([algebra.act(self.x.mT, v), algebra.act(self.y.mT, v), *along], -1))
        return tuple(out)

    def observer(self, observe: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, Array]]:
        """`observe` of blocks, which also needs the `arrays` of this basis or of its replacement."""

        def of_blocks(z: tuple[Array, ...], only: Collection[str] | None = None, /, **known: Array) -> dict[str, Array]:
            arrays = {name.removeprefix(BASIS): known.pop(name) for name in self.arrays if name in known}
            return observe(replace(self, **arrays).back(z), only, **known)

        return of_blocks

    def back(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """The components of blocks."""
        out: list[Array] = []
        h = self.theta.shape[-1]
        for value, kind in zip(z, self.kinds, strict=True):
            if kind == "matrix":
                n = self.p.shape[-1]
                g = value.reshape((*value.shape[:-1], n, 2 * h + 1))
                unit = (self.p / algebra.vec(self.length))[..., None, :]
                g = g[..., :h] @ self.x.mT + g[..., h : 2 * h] @ self.y.mT + g[..., 2 * h :] * unit
                out.append(g if self.by_rows else g.mT)
                continue
            v = algebra.act(self.x, value[..., :h]) + algebra.act(self.y, value[..., h : 2 * h])
            if kind == "skew":
                out.append(self.T + algebra.wedge(v, self.p + 0 * v))
            else:
                out.append(v + self.p * (value[..., 2 * h :] / algebra.vec(self.length)))
        return tuple(out)


def _planes(T: Floats, p: Floats) -> tuple[Floats, Floats, Floats]:
    """x, y (n, h) and theta (h) of one skew matrix T with T p = 0, by its real Schur form across p."""
    from scipy.linalg import schur

    n = len(p)
    u = p / np.sqrt(p @ p)
    u[-1] += np.copysign(1.0, u[-1])
    across = (np.eye(n) - 2 / (u @ u) * np.outer(u, u))[:, :-1]
    inner = across.T @ T @ across
    blocks, turn = schur((inner - inner.T) / 2, output="real")
    full = across @ turn
    for _ in range(2):  # orthonormal to the last digit, and orthogonal to p
        full = np.column_stack([full[:, : n - 1], p / np.sqrt(p @ p)])
        full = full @ (1.5 * np.eye(n) - 0.5 * full.T @ full)
    x, y, theta = [], [], []
    lone = []
    i = 0
    while i < n - 1:
        if i + 1 < n - 1 and blocks[i + 1, i] != 0:
            x.append(full[:, i])
            y.append(full[:, i + 1])
            theta.append(float(full[:, i + 1] @ T @ full[:, i]))
            i += 2
        else:
            lone.append(full[:, i])
            i += 1
    lone += [np.zeros(n)] * (len(lone) % 2)
    x, y = x + lone[::2], y + lone[1::2]
    theta += [0.0] * (len(lone) // 2)
    return np.column_stack(x), np.column_stack(y), np.array(theta)
