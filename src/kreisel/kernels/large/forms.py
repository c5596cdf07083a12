"""Large n: steps of O(n) or O(n^2), from the definition run on vectors and matrices with structure.

About an axis: one momentum m = T + s ^ p that changes by s only, p a constant, and vectors, for steps that mean the
same in every orthonormal basis.  T is constant, with 2 x 2 blocks theta in a basis in which a product and a solve with
m are O(n).  An orientation may be carried along, by its columns or its rows, which are rotated alike.  Plain: only
vectors.  Dense: one momentum M that changes by a few pairs s ^ t; the inverses that its solves need are part of the
state and follow by Woodbury's formula.  They start as 0 and are made anew if the residual of a solve is too large.

The form of a step, if it has one, is found by recording it (`kreisel.kernels.large.structured`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property, reused
from kreisel.errors import InputError
from kreisel.graph.arranging import arranged, independent
from kreisel.graph.graph import IN, Graph, Number, Operand
from kreisel.kernels.large.structured import MOMENTUM, Dense, Matrix, Vector, key_of
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Part, Scheme, Steps

AXIS, TURN, BASIS = "axis", "turn", "basis_Q"  # constants of the form about an axis: |p|, theta (h,), Q (n, 2 h + 1)
IN_PLANES = 1e-10  # how far a constant matrix may be from a rotation in the planes of T, relative
SHORTEST = 1e-100  # of an axis
LEAST_N = 4  # for n = 3 the definitions have separate closed forms


class Change(NamedTuple):
    """scale x y^T, or for the momentum scale x ^ y: a number and two vectors, by their entries."""

    scale: Operand
    x: Operand
    y: Operand


class Solve(NamedTuple):
    """A solve of v by the inverse of diagonal + turn M: |r|^2, r its residual, and |v|^2."""

    diagonal: Operand
    turn: Operand
    residual: Operand
    size: Operand


@dataclass(frozen=True)
class LargeFunction:
    """A recorded function: its graph and the new state; of a dense momentum changes, and a solve for each inverse.

    changes  with their matrix: MOMENTUM, or the number of an inverse
    """

    graph: Graph
    new: list[Operand]
    changes: list[tuple[Any, Change]]
    solves: list[Solve]

    @cached_property
    def outputs(self) -> list[Operand]:
        return [*self.new, *(x for _, change in self.changes for x in change), *(x for y in self.solves for x in y)]

    def arranged(self) -> LargeFunction:
        """The function with its graph made ready for a compiler."""
        graph, outputs = arranged(self.graph, self.outputs)
        following = iter(outputs)
        new = [next(following) for _ in self.new]
        changes = [(name, Change(*islice(following, 3))) for name, _ in self.changes]
        return LargeFunction(graph, new, changes, [Solve(*islice(following, 4)) for _ in self.solves])

    @cached_property
    def nodes(self) -> list[int]:
        return self.graph.needed(self.outputs)

    @cached_property
    def fixed(self) -> set[int]:
        """The nodes that do not vary along a trajectory."""
        inputs = {node[1] for node in (self.graph.nodes[at] for at in self.nodes) if node[0] == IN}
        return independent(self.graph, self.nodes, {name for name in inputs if name.startswith("c_")})


@dataclass(frozen=True)
class LargeForm:
    """How the state and the constants of a scheme are laid out: blocks of h entries, and scalars.

    axis     the letter of the constant p, or "" for the other forms
    roles    of each constant whether it belongs to the trajectory (c) or to the stage (s), and its kind: a number,
             the axis, a rotation in the planes of T, or a vector
    kinds    of the components
    by_rows  whether an orientation is known by its rows, not by its columns
    pieces   the functions of the scheme, recorded
    """

    n: int
    axis: str
    roles: Mapping[str, tuple[str, str]]
    kinds: tuple[str, ...]
    by_rows: bool = False
    pieces: tuple[LargeFunction, ...] = field(default=(), repr=False, compare=False)

    @property
    def h(self) -> int:
        """Entries in a block: planes of p^perp, or n."""
        return self.n // 2 if self.axis else self.n

    @property
    def inverses(self) -> int:
        """How many of the dense momentum there are."""
        return len(self.pieces[0].solves) if self.pieces else 0

    @property
    def dense(self) -> bool:
        """Whether the momentum is a full matrix: skew, without an axis."""
        return "skew" in self.kinds and not self.axis

    def _blocks(self, kind: str) -> str:
        return "x" * (kind != "skew") if not self.axis else "xy" if kind == "skew" else "xyt"

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each block, number (t), matrix and inverse is in the state."""
        sizes, n = dict[str, int](), self.n
        for i, kind in enumerate(self.kinds):
            if kind == "matrix" or not self._blocks(kind):
                sizes[f"z{i}"] = n * (2 * self.h + 1) if kind == "matrix" else n * (n - 1) // 2
            else:
                sizes |= {f"z{i}{block}": 1 if block == "t" else self.h for block in self._blocks(kind)}
        sizes |= {f"inverse{k}": n * n for k in range(self.inverses)}
        ends = np.cumsum([*sizes.values()]).tolist()
        return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return max(place.stop for place in self.places.values())

    @property
    def names(self) -> list[str]:
        """The recorded scalars of the state."""
        return [f"z{i}{block}" for i, kind in enumerate(self.kinds) for block in self._blocks(kind)]

    def letter_of(self, kind: str) -> str:
        """The letter of the component of that kind; one that no component has for none."""
        return f"z{self.kinds.index(kind)}" if kind in self.kinds else "none"

    def has_entries(self, constant: str) -> bool:
        """Whether an input of a constant is known entry by entry."""
        name = constant.removeprefix("c_")
        return name == TURN or (name != AXIS and self.roles[name][1] != "number")

    # -- recording -------------------------------------------------------------------------------

    def state(self, kinds: Collection[str], entry: Callable[[str], Any], turn: Any, axis: Any, kept: bool) -> list[Any]:
        """Components of these kinds, with entries by their names."""
        out: list[Any] = []
        for i, kind in enumerate(kinds):
            blocks = [entry(f"z{i}{block}") for block in self._blocks(kind)]
            if kind != "skew":
                out.append(Vector(self.n, tuple(blocks), rows=self.by_rows if kind == "matrix" else None))
            elif self.axis:
                s, p = Vector(self.n, (*blocks, 0.0)), self.constant("axis", axis)
                out.append(Matrix(self.n, turn=turn, kept=kept).with_pair(1.0, s, p))
            else:
                out.append(Matrix(self.n, turn=1.0, dense=Dense(entry(f"z{i}"))))
        return out

    def constant(self, role: str, entry: Any) -> Any:
        """A constant of that role."""
        if role in ("number", "turn"):
            return entry if role == "number" else Matrix(self.n, turn=entry)
        return Vector(self.n, (0.0, 0.0, entry) if role == "axis" else (entry,), axis=role == "axis")

    def recorded(self, part: Part) -> LargeFunction:
        """A step or `close` on recorded scalars; TypeError if it does not have this form."""
        graph = Graph()

        def entry(name: str) -> Number:
            return graph.input(name, 0)

        turn, axis = entry(f"c_{TURN}"), entry(f"c_{AXIS}")
        constants = {
            name: self.constant(role, axis if role == "axis" else entry(f"{letter}_{name}"))
            for name, (letter, role) in self.roles.items()
            if letter in part.letters
        }
        values = part.function(*self.state(self.kinds, entry, turn, axis, False), **constants)
        result = LargeFunction(graph, [], [], [])
        for value, kind in zip(values, self.kinds, strict=True):
            if kind == "skew" and self.dense:
                _follow(value, result)
                continue
            vector = _momentum(value, turn) if kind == "skew" else value
            if not isinstance(vector, Vector) or bool(vector.rows) != (kind == "matrix" and self.by_rows):
                raise TypeError("a component that is no longer a vector")
            result.new.extend(vector.entries[: len(self._blocks(kind))])
        if any(not isinstance(x, Number | float | int) for x in result.outputs):
            raise TypeError("a new state that is complex")
        result = result.arranged()
        if any(isinstance(x, Number) and x.at not in result.fixed for solve in result.solves for x in solve[:2]):
            raise TypeError("a solve with more than the momentum in its matrix that varies")
        return result

    # -- schemes ---------------------------------------------------------------------------------

    def on(self, scheme: Scheme, x0: tuple[Array, ...]) -> Scheme:
        """The scheme in this form for the trajectories from x0, whose constants it has."""
        z0 = scheme.prepare(x0)
        constants, basis = self._about_axis(scheme, z0) if self.axis else (dict(scheme.constants), {})
        axes = {name: int(self.has_entries(name)) for name in constants}
        sizes = [sum(at.stop - at.start for name, at in self.places.items() if name[:2] == f"z{i}") for i in range(9)]
        components = [(letter, f"R^{size}") for (letter, _), size in zip(scheme.components, sizes, strict=False)]
        components += [(name, f"R^{self.n**2}") for name in self.places if name.startswith("inverse")]
        plane = {**basis, **{name: constants[name] for name in (AXIS, TURN) if basis}}

        def into(z: tuple[Array, ...]) -> tuple[Array, ...]:
            return self._into(z, **plane)

        def observe(
            z: tuple[Array, ...], only: Collection[str] | None = None, /, **constants: Array
        ) -> dict[str, Array]:
            state = self._back(z, **{name: constants.pop(name, value) for name, value in plane.items()})
            return scheme.observe(state, only, **constants)

        return replace(
            scheme,
            components=(*components,),
            constants=constants,
            axes={**scheme.axes, **axes, BASIS: 2},
            prepare=lambda x: into(scheme.prepare(x)),
            observe=observe,
            reopen=lambda x: into(scheme.reopen(x)),
            conserved=self._conserved(scheme.observe) if self.axis else None,
            recordable=False,
            basis=basis,
            definition_key=None,
            structure=None,
            kernel_key=None if scheme.kernel_key is None else (scheme.kernel_key, repr(self)),
        )

    def _about_axis(self, scheme: Scheme, z0: tuple[Array, ...]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Constants and Q.  Raises `InputError` for a rotation that is not in the planes of T."""
        p, m = (np.asarray(x, dtype=np.float64) for x in (scheme.constants[self.axis], z0[self.kinds.index("skew")]))
        batch, h = np.broadcast_shapes(p.shape[:-1], m.shape[:-2]), self.h
        p, T = np.broadcast_to(p, (*batch, self.n)), algebra.project_out(m, p) / algebra.mat(algebra.dot(p, p))
        T = np.broadcast_to((T - T.mT) / 2, (*batch, self.n, self.n))
        Q, theta = np.empty((*batch, self.n, 2 * h + 1)), np.empty((*batch, h))
        for lane in np.ndindex(batch):
            Q[lane], theta[lane] = _planes(T[lane], p[lane])
        constants = {AXIS: np.sqrt(algebra.dot(p, p)), TURN: theta}
        for name, value in scheme.constants.items():
            role = self.roles[name][1]
            if role == "number":
                constants[name] = value
            elif role == "turn":
                image, y = value @ Q[..., :h], Q[..., h : 2 * h]
                constants[name] = (y * image).sum(-2)
                off = abs(image - y * constants[name][..., None, :]).max(initial=0)
                if off > IN_PLANES * max(1.0, abs(value).max(initial=0)):
                    raise InputError(
                        f"engine='large' cannot compute the rotation {name} of method={scheme.name!r}; use 'cpu'."
                    )
        return constants, {BASIS: Q}

    def _into(self, z: tuple[Array, ...], **plane: Array) -> tuple[Array, ...]:
        """Blocks of the components, one after the other (..., size), and inverses that are 0."""
        out = []
        for value, kind in zip(z, self.kinds, strict=True):
            if not self.axis:
                out.append(algebra.coordinates(value) if kind == "skew" else value)
                continue
            Q = plane[BASIS]
            if kind == "matrix":
                blocks = (value if self.by_rows else value.mT) @ Q
                out.append(blocks.reshape((*blocks.shape[:-2], -1)))
            elif kind == "skew":  # m = T + s ^ p with s = m p/|p|^2
                out.append(algebra.act(Q.mT, algebra.act(value, Q[..., -1]))[..., :-1] / algebra.vec(plane[AXIS]))
            else:
                out.append(algebra.act(Q.mT, value))
        batch = out[0].shape[:-1]
        return (*out, *(np.zeros((*batch, self.n**2)) for _ in range(self.inverses)))

    def _back(self, z: tuple[Array, ...], **plane: Array) -> tuple[Array, ...]:
        """The components of blocks."""
        out: list[Array] = []
        for value, kind in zip(z, self.kinds, strict=False):
            if not self.axis:
                out.append(algebra.skew(value, self.n) if kind == "skew" else value)
                continue
            Q, h = plane[BASIS], self.h
            if kind == "matrix":
                g = value.reshape((*value.shape[:-1], self.n, 2 * h + 1)) @ Q.mT
                out.append(g if self.by_rows else g.mT)
            elif kind == "skew":
                half, s = (
                    (Q[..., h : 2 * h] * plane[TURN][..., None, :]) @ Q[..., :h].mT,
                    algebra.act(Q[..., :-1], value),
                )
                out.append((half - half.mT) + algebra.wedge(s, Q[..., -1] * algebra.vec(plane[AXIS]) + 0 * s))
            else:
                out.append(algebra.act(Q, value))
        return tuple(out)

    def _conserved(self, observe: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, Array]]:
        """`observe` of the blocks about an axis as they are; an orientation does not count."""

        def of_blocks(z: tuple[Array, ...], /, **constants: Array) -> dict[str, Array]:
            def plain(x: Any) -> Any:
                return x if isinstance(x, Number) else float(x)

            def entry(name: str) -> Any:
                value, h = z[int(name[1])], self.h
                return plain(value[-1]) if name[2] == "t" else value[:h] if name[2] == "x" else value[h : 2 * h]

            axis = plain(constants[AXIS])
            arguments = {
                name: self.constant(
                    role, axis if role == "axis" else constants[name] if role == "turn" else plain(constants[name])
                )
                for name, (letter, role) in self.roles.items()
                if letter == "c"
            }
            kinds = [kind for kind in self.kinds[: len(z)] if kind != "matrix"]
            return observe(tuple(self.state(kinds, entry, constants[TURN], axis, True)), **arguments)

        return of_blocks


def _planes(T: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Q (n, 2 h + 1) and theta (h,) of a skew matrix T with T p = 0, by its real Schur form across p.

    The columns of Q are x_k, y_k, of which the last is 0 if n is even, and p/|p|: T x_k = theta_k y_k.
    """
    from scipy.linalg import schur

    n, axis = len(p), p / np.sqrt(p @ p)
    u = axis.copy()
    u[-1] += np.copysign(1.0, u[-1])
    across = (np.eye(n) - 2 / (u @ u) * np.outer(u, u))[:, :-1]
    inner = across.T @ T @ across
    blocks, rotation = schur((inner - inner.T) / 2, output="real")
    full = across @ rotation
    for _ in range(2):  # orthonormal to the last digit, and orthogonal to p
        full = np.column_stack([full[:, : n - 1], axis])
        full = full @ (1.5 * np.eye(n) - 0.5 * full.T @ full)
    pairs = [i for i in range(n - 2) if blocks[i + 1, i] != 0]  # of the others T is 0
    single = [i for i in range(n - 1) if i not in pairs and i - 1 not in pairs]
    x, y = full[:, pairs + single[::2]], full[:, [i + 1 for i in pairs] + single[1::2]]
    theta = [full[:, i + 1] @ T @ full[:, i] for i in pairs] + [0.0] * (x.shape[1] - len(pairs))
    y = np.column_stack([y, np.zeros((n, x.shape[1] - y.shape[1]))])
    return np.column_stack([x, y, axis]), np.array(theta)


# -- forms found by recording --------------------------------------------------------------------------


def form_of(scheme: Scheme) -> LargeForm | None:
    """The form that a scheme with the constants of its trajectories has; None for none."""
    kinds = tuple(scheme.kinds)
    if not isinstance(scheme.motion, Steps) or not scheme.recordable or scheme.corrector or scheme.n < LEAST_N:
        return None
    if not {*kinds} <= {"skew", "vector", "matrix"} or kinds.count("skew") > 1 or kinds.count("matrix") > 1:
        return None
    letters = {"c": scheme.constants, "s": scheme.stages}
    axes = {name: (letter, scheme.axes[name]) for letter, names in letters.items() for name in names}
    vectors, forms = [name for name in scheme.constants if scheme.axes[name] == 1], list[LargeForm]()

    def add(axis: str, kind_of: tuple[str, ...], by_rows: bool) -> None:
        roles = {name: (letter, kind_of[count]) for name, (letter, count) in axes.items()}
        forms.append(LargeForm(scheme.n, axis, roles, kinds, by_rows))

    if "skew" in kinds and len(vectors) == 1:
        p = np.asarray(scheme.constants[vectors[0]], dtype=np.float64)
        if not (np.sqrt(algebra.dot(p, p)) > SHORTEST).all():
            return None
        for by_rows in (False, True) if "matrix" in kinds else (False,):
            add(vectors[0], ("number", "axis", "turn"), by_rows)
    if all(count < 2 for _, count in axes.values()) and "matrix" not in kinds:
        add("", ("number", "vector"), False)

    def first() -> LargeForm | None:
        for form in forms:
            try:
                pieces = tuple(form.recorded(part) for part in scheme.parts)
            except (TypeError, KeyError, AttributeError):
                continue
            if (not form.dense and "matrix" not in kinds) or (len(pieces) == 1 and scheme.stage_count == 1):
                return replace(form, pieces=pieces)
        return None

    return reused(None if scheme.kernel_key is None else (form_of, scheme.kernel_key), first)


def _momentum(value: Any, turn: Number) -> Vector:
    """s of m = T + s ^ p, with the T that it had before."""
    if not isinstance(value, Matrix) or key_of(value.turn) != turn.key or key_of(value.diagonal) != 0.0:
        raise TypeError("a momentum whose constant part has changed")
    if len(value.pairs) != 1 or not value.used()[0][2].axis:
        raise TypeError("about an axis, momenta change only by pairs with the axis")
    return value.used()[0][1]


def _follow(M: Any, result: LargeFunction) -> None:
    """The changes of a momentum and of its inverses, and the solves, into `result`."""
    if not isinstance(M, Matrix) or M.dense is None or (key_of(M.turn), key_of(M.diagonal)) != (1.0, 0.0):
        raise TypeError("a momentum that has changed by other than pairs")
    changes: list[tuple[Any, Any, Vector, Vector]] = [(MOMENTUM, *pair) for pair in M.pairs.values()]
    for k, (diagonal, turn) in enumerate(M.dense.inverses):
        changes += [(k, -1.0, x, r) for x, r in M.dense.change(k, [*M.pairs.values()])]
        diagonal = diagonal.entries[0] if isinstance(diagonal, Vector) else diagonal
        result.solves.append(Solve(diagonal, turn, *M.dense.checks[k]))
    for name, scale, x, y in changes:
        if not isinstance(x.entries[0], Number) or not isinstance(y.entries[0], Number):
            raise TypeError("a dense momentum changed by plain or complex values")
        result.changes.append((name, Change(scale, x.entries[0], y.entries[0])))
