"""Large n: kernels of O(n) or O(n^2) a step, from the definition run on vectors and matrices with structure.

Three forms are known.  About an axis: one momentum m that changes by s ^ p alone, p a constant, and vectors, for steps
that mean the same in every orthonormal basis.  The part of m that does not touch p is then constant; in its real
Schur form (2 x 2 blocks theta) a product and a solve with m cost O(n).  Plain: vectors alone, as they stand.
Dense: one momentum M of n^2 numbers that changes by a few pairs s ^ t; each solve has an inverse of its own, which is
part of the state and follows the changes by Woodbury's formula.  It starts as 0; where the residual of a solve is too
large, it is made anew and the step done again.
Which form a step has, if any, is found by recording it (`kreisel.engines.structured`).

The kernel has a loop over the entries for each stretch between two sums over them, or products with a dense matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.engines import products
from kreisel.engines.cpu import load
from kreisel.engines.layout import Floats
from kreisel.engines.lines import Line, arranged, split
from kreisel.engines.products import Change, Function, Inverse, Upkeep
from kreisel.engines.recording import indented
from kreisel.engines.structured import AXIS, Columns, Dense, Matrix, Rows, Vector, changed_inverse
from kreisel.engines.trace import Scalar, Tape, text
from kreisel.errors import InputError
from kreisel.methods.scheme import Scheme

AXIS_NAME, TURN_NAME = "axis", "turn"
TURN = f"c_{TURN_NAME}"
INVERSE = "inverse"
WITHIN = "# each vector of the orientation"
SHORTEST = 1e-100  # of an axis
LEAST_N = 4  # for n = 3 the definitions have closed forms of their own
IN_PLANES = 1e-10  # how far a constant matrix may be from a turn in the planes of T, relative

KERNEL = """
@njit("f8(f8[::1], i8, i8)", {total})  # or Numba would compile it anew for each number that it is called with
def total(w, first, count):
    out = 0.0
    for k in range(first, first + count):
        out += w[k]
    return out


@njit("void(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8, i8, i8)", {options})
def kernel(z, c, s, out, every, first, last):
    w = np.empty({room})
    for lane in range(first, last):
{load}
{once}
        for row in range(out.shape[0]):
            for _ in range(every):
                for stage in range(s.shape[1]):
{stage}
{body}
{close}
{save}
{store}
"""
SUM = 'cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"}'


@dataclass(frozen=True)
class Form:
    """How the state and the constants of a scheme are laid out: blocks of h entries, and numbers.

    axis     the letter of the constant p, or "" for the other forms
    inverses kept ones of the dense form, 0 for the other forms
    kinds    of the components
    by_rows  whether an orientation is known by its rows, not by its columns
    roles    of each constant whether it belongs to the trajectory (c) or to the stage (s), and what it is: a number,
             the axis, a turn in the planes of T, or a vector
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

    def state(self, tape: Tape, kinds: list[str]) -> tuple[Vector | Matrix | Rows, ...]:
        """The recorded state."""
        return tuple(self._component(tape, f"z{i}", kind) for i, kind in enumerate(kinds))

    def _component(self, tape: Tape, name: str, kind: str) -> Vector | Matrix | Rows:
        if kind == "skew" and not self.axis:
            return Matrix(self.n, turn=1.0, dense=Dense(tape, name))
        if kind == "matrix":
            x, y, t = (Scalar(tape, f"{name}{block}") for block in self.blocks(kind))
            return Vector(self.n, (x, y), t).mT if self.by_rows else Columns(self.n, (x, y), t)
        x, *more = (Scalar(tape, f"{name}{block}") for block in self.blocks(kind))
        if kind != "skew":
            return Vector(self.n, (x, *more[:1]), more[1]) if more else Vector(self.n, (x,))
        s = Vector(self.n, (x, *more), 0.0)
        return Matrix(self.n, turn=Scalar(tape, TURN)).with_pair(s, self._p(tape))

    def _p(self, tape: Tape, name: str = AXIS) -> Vector:
        return Vector(self.n, (0.0, 0.0), Scalar(tape, AXIS))

    def known(self, tape: Tape, letters: str) -> dict[str, Any]:
        """The recorded constants that a function takes: c those of the trajectory, s those that vary with the stage."""
        makers: dict[str, Callable[[Tape, str], Any]] = {
            "number": self._number,
            "axis": self._p,
            "turn": self._turn,
            "vector": self._vector,
        }
        return {
            name: makers[role](tape, f"{letter}_{name}")
            for name, (letter, role) in self.roles.items()
            if letter in letters
        }

    def _number(self, tape: Tape, name: str) -> Scalar:
        return Scalar(tape, name)

    def _turn(self, tape: Tape, name: str) -> Matrix:
        return Matrix(self.n, turn=Scalar(tape, name))

    def _vector(self, tape: Tape, name: str) -> Vector:
        return Vector(self.n, (Scalar(tape, name),))

    def outputs(self, new: tuple[Any, ...], kinds: list[str]) -> list[Any]:
        """The new state in the order of `names`; TypeError where it has left the form."""
        out: list[Any] = []
        for value, kind in zip(new, kinds, strict=True):
            if kind == "skew" and not self.axis:
                continue
            vector = _momentum(value) if kind == "skew" else value
            if kind == "matrix" and self.by_rows:
                vector = value.mT
            if not isinstance(vector, Vector):
                raise TypeError("a component that is no longer a vector")
            out += [*vector.blocks, *([vector.tail] if "t" in self.blocks(kind) else [])]
        return out

    def names(self, kinds: list[str]) -> list[str]:
        """The recorded numbers of the state."""
        return [f"z{i}{block}" for i, kind in enumerate(kinds) for block in self.blocks(kind)]

    # -- numbers ---------------------------------------------------------------------------------

    def on(self, scheme: Scheme, x0: tuple[Array, ...]) -> Scheme:
        """The scheme in this form for the trajectories from x0, whose constants it has."""
        basis = Basis.of(self, scheme, scheme.prepare(x0)) if self.axis else None
        into, back = (basis.into, basis.back) if basis else (self._into, self._back)
        constants = basis.constants(self, scheme) if basis else dict(scheme.constants)
        axes = {name: int(self.roles.get(name, ("c", "turn"))[1] in ("turn", "vector")) for name in constants}
        components = [(letter, f"R^{self.size(kind)}") for letter, kind in scheme.components]
        kept = [(f"{INVERSE}{k}", f"R^{self.n**2}") for k in range(self.inverses)]
        return replace(
            scheme,
            components=(*components, *kept),
            constants=constants,
            axes={**scheme.axes, **axes, AXIS_NAME: 0},
            prepare=lambda x: into(scheme.prepare(x)),
            observe=lambda z, **known: scheme.observe(back(z), **known),
            reopen=lambda x: into(scheme.reopen(x)),
            numbers="structured",
        )

    def _into(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """The state as the kernel has it, without inverses yet."""
        if not self.inverses:
            return z
        batch = np.broadcast_shapes(*(v.shape[: v.ndim - k] for v, k in zip(z, self._axes, strict=True)))
        own = (algebra.coordinates_of("skew", v) if k == 2 else v for v, k in zip(z, self._axes, strict=True))
        return (*own, *(np.zeros((*batch, self.n**2)) for _ in range(self.inverses)))

    def _back(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(algebra.skew(v, self.n) if k == 2 else v for v, k in zip(z, self._axes, strict=False))


def _momentum(value: Any) -> Vector:
    """S of m = T + s ^ p, with the T that it had before."""
    if not isinstance(value, Matrix) or not isinstance(value.turn, Scalar) or value.turn.signed != TURN:
        raise TypeError("a momentum whose constant part has changed")
    if len(value.pairs) != 1 or isinstance(value.diagonal, Vector) or value.diagonal != 0.0:
        raise TypeError("a momentum that is not T + s ^ p")
    ((_, s, t),) = value.pairs.values()
    if t.key[-1] != AXIS:
        raise TypeError("about an axis, momenta change by pairs with the axis alone")
    return s


def form_of(scheme: Scheme) -> Form | None:
    """The form that a scheme with the constants of its trajectories has, found by recording it; None for none."""
    if scheme.step is None or scheme.numbers != "any" or scheme.n < LEAST_N:
        return None
    kinds = tuple(kind for _, kind in scheme.components)
    if not set(kinds) <= {"skew", "vector", "matrix"} or kinds.count("skew") > 1 or kinds.count("matrix") > 1:
        return None
    axes = {name: (letter, scheme.axes[name]) for letter in "cs" for name in _names(scheme, letter)}
    vectors = [name for name in scheme.constants if scheme.axes[name] == 1]
    forms: list[tuple[str, tuple[str, ...], bool]] = []
    if "skew" in kinds and len(vectors) == 1:
        if not (_lengths(scheme.constants[vectors[0]]) > SHORTEST).all():
            return None
        about = ("number", "axis", "turn")
        forms += [(vectors[0], about, by_rows) for by_rows in ((False, True) if "matrix" in kinds else (False,))]
    if all(count < 2 for _, count in axes.values()) and "matrix" not in kinds:
        forms.append(("", ("number", "vector"), False))
    for axis, kind_of, by_rows in forms:
        roles = {name: (letter, kind_of[count]) for name, (letter, count) in axes.items()}
        form = Form(scheme.n, axis, roles, 0, kinds, by_rows)
        try:
            pieces = [recorded(form, list(kinds), *function) for function in _functions(scheme)]
        except (TypeError, KeyError, AttributeError):
            continue
        upkeep = pieces[0].upkeep
        if upkeep is None and "matrix" not in kinds:
            return form
        if len(pieces) == 1 and scheme.stage_count == 1:
            return replace(form, inverses=len(upkeep.inverses) if upkeep else 0)
    return None


def _names(scheme: Scheme, letter: str) -> list[str]:
    return [*(scheme.constants if letter == "c" else scheme.stages)]


def _functions(scheme: Scheme) -> Iterator[tuple[Callable[..., Any], str]]:
    """The step and `close`, and the constants that they take."""
    if scheme.step is not None:
        yield scheme.step, "cs"
    if scheme.close is not None:
        yield scheme.close, "c"


class Piece(NamedTuple):
    """A recorded function: its lines, the new state, and what is done to a dense momentum."""

    lines: list[Line]
    new: list[str]
    upkeep: Upkeep | None


def recorded(form: Form, kinds: list[str], function: Callable[..., Any], letters: str) -> Piece:
    """A step or `close` on recorded numbers; TypeError where the form does not hold."""
    tape = Tape("e" * (letters == "c"))
    values = function(*form.state(tape, kinds), **form.known(tape, letters))
    new = form.outputs(values, kinds)
    if any(not isinstance(v, Scalar | float | int) for v in new):
        raise TypeError("a new state that is complex")
    upkeep, also = None, list[str]()
    if "skew" in kinds and not form.axis:
        upkeep, also = _upkeep(values[kinds.index("skew")])
    wanted = [*(v.name for v in new if isinstance(v, Scalar)), *also]
    lines = arranged(tape.needed(wanted), wanted)
    if upkeep is not None:
        constant = {f"c_{name}" for name in form.known(tape, "c")}
        constant |= {n for line in split(lines, constant)[0] for n in line.names}
        given = {v.strip("(-)") for inverse in upkeep.inverses for v in (inverse.diagonal, inverse.turn)}
        if any(v[0].isalpha() for v in given - constant):
            raise TypeError("a solve with more than the momentum in its matrix that varies")
    return Piece(lines, [text(v) for v in new], upkeep)


def _upkeep(M: Any) -> tuple[Upkeep, list[str]]:
    """How the new momentum and its inverses come from the old ones, and the recorded names that this needs."""
    if not isinstance(M, Matrix) or M.dense is None or (M.turn, M.diagonal) != (1.0, 0.0):
        raise TypeError("a momentum that has changed by other than pairs")
    pairs = [*M.pairs.values()]
    names: list[str] = []

    def number(x: Any) -> str:
        if not isinstance(x, Scalar | float | int):
            raise TypeError("a dense momentum changed by complex numbers")
        names.extend([x.name] if isinstance(x, Scalar) else [])
        return text(x)

    def change(scale: Any, x: Vector, y: Vector) -> Change:
        (a,), (b,) = x.blocks, y.blocks
        if not isinstance(a, Scalar) or not isinstance(b, Scalar):
            raise TypeError("a dense momentum changed by plain numbers")
        names.extend([a.name, b.name])
        return Change(number(-scale if a.negative != b.negative else scale), a.name, b.name)

    moved = tuple(change(*pair) for pair in pairs)
    inverses = []
    for k, (diagonal, turn) in enumerate(M.dense.inverses):
        res, size = M.dense.checks[k]
        diagonal = diagonal.blocks[0] if isinstance(diagonal, Vector) else diagonal
        changes = tuple(change(-1.0, x, r) for x, r in changed_inverse(M.dense, k, pairs))
        inverses.append(Inverse(number(diagonal), number(turn), (number(res), number(size)), changes))
    return Upkeep(moved, tuple(inverses)), names


def _lengths(p: Array) -> Array:
    p = np.asarray(p, dtype=np.float64)
    return np.sqrt((p * p).sum(-1))


@dataclass(frozen=True)
class Basis:
    """An orthonormal basis for each trajectory, ([lane,] n, h) twice and p/|p|, in which T has blocks theta.

    T = pi m pi, pi = I - p p^T/|p|^2, takes x_k to theta_k y_k and y_k to -theta_k x_k.  Where n - 1 is odd the last
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

    @staticmethod
    def of(form: Form, scheme: Scheme, z0: tuple[Array, ...]) -> Basis:
        """The basis for the states z0."""
        kinds = tuple(kind for _, kind in scheme.components)
        p = np.asarray(scheme.constants[form.axis], dtype=np.float64)
        m = np.asarray(z0[kinds.index("skew")], dtype=np.float64)
        batch = np.broadcast_shapes(p.shape[:-1], m.shape[:-2])
        p = np.broadcast_to(p, (*batch, form.n))
        T = algebra.project_out(m, p) / algebra.mat(algebra.dot(p, p))
        T = np.broadcast_to((T - T.mT) / 2, (*batch, form.n, form.n))
        found = [_planes(T[lane], p[lane]) for lane in np.ndindex(batch)]
        x, y, theta = (np.array(part).reshape((*batch, *part[0].shape)) for part in zip(*found, strict=True))
        return Basis(x, y, p, _lengths(p), theta, T, kinds, form.by_rows)

    def constants(self, form: Form, scheme: Scheme) -> dict[str, Array]:
        """The constants in this basis.  Raises `InputError` for a turn that is not in the planes of T."""
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
                        f"engine='large' cannot make the turn {name} of method={scheme.name!r}; use 'cpu'."
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


# -- printing -----------------------------------------------------------------------------------------


class Printer:
    """The kernel of a scheme in a form, from the scheme as it was before it was put in this form."""

    def __init__(self, form: Form, scheme: Scheme):
        self.form, self.scheme = form, scheme
        self.kinds = [kind for _, kind in scheme.components]
        self.names = form.names(self.kinds)
        self.room: dict[str, int] = {}  # row of each entry that stays
        self.rows = 0
        self.entries: set[str] = set()
        self.functions: dict[str, str] = {}  # the modules of the products that are used, one for all n
        self.waiting: dict[str, tuple[Change, ...]] = {}  # what is still to be done to each dense matrix, by its name

    def __call__(
        self, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], head: str, options: str
    ) -> str:
        """The source; `columns` say where each constant stands in its row."""
        pieces = [recorded(self.form, self.kinds, *function) for function in _functions(self.scheme)]
        h, place = self.form.h, 0
        copies: list[tuple[int, int]] = []  # row of w and place in z of each block
        numbers: list[tuple[str, int]] = []
        matrices: list[tuple[str, int, int]] = []  # that stay in z
        for i, kind in enumerate(self.kinds):
            if kind == "matrix" or not self.form.blocks(kind):
                matrices.append((f"z{i}", place, place + self.form.size(kind)))
                place += self.form.size(kind)
            for block in self.form.blocks(kind) if kind != "matrix" else ():
                if block == "t":
                    numbers.append((f"z{i}t", place))
                    place += 1
                else:
                    copies.append((self._keep(f"z{i}{block}"), place))
                    place += h
        for k in range(self.form.inverses):
            matrices.append((f"{INVERSE}{k}", place, place + h * h))
            place += h * h
        load = [f"    w[{row * h} + k] = z[lane, {at} + k]" for row, at in copies]
        given = [f"{name} = z[lane, {at}]" for name, at in numbers]
        for name, where in columns.items():
            if self._is_number(name):
                given.append(f"c_{name} = c[lane, {where.start}]")
            else:
                load.append(f"    w[{self._keep(f'c_{name}') * h} + k] = c[lane, {where.start} + k]")

        self._wait(pieces[0].upkeep)
        for changes in self.waiting.values():
            given += [f"{c.scale} = 0.0" for c in changes]
            given += [f"{self._vector(name)} = 0.0" for c in changes for name in (c.x, c.y)]
        for name, at, end in matrices:
            given.append(f"{name} = z[lane, {at}:{end}]{f'.reshape(({h}, {h}))' * name.startswith(INVERSE)}")

        def put(target: str) -> list[str]:
            blocks = [f"    {target}{at} + k] = w[{row * h} + k]" for row, at in copies]
            return [f"for k in range({h}):", *blocks, *(f"{target}{at}] = {name}" for name, at in numbers)]

        stage = [f"s_{name} = s[lane, stage, {where.start}]" for name, where in stage_columns.items()]
        constant = {f"c_{name}" for name in columns}
        fixed: list[Line] = []
        bodies = []
        for piece in pieces:
            once, rest = split(piece.lines, constant)
            fixed += once
            bodies.append(piece._replace(lines=rest))
        wanted = {n for piece in bodies for line in piece.lines for n in line.needs}
        for piece in bodies:
            wanted |= {v.strip("(-)") for v in piece.new} | (piece.upkeep.words if piece.upkeep else set())
        first = self._printed(fixed, wanted, {})
        body, *close = [self._piece(piece) for piece in bodies]
        saved = self._done() + [f"out[row, lane, {at}:{end}] = z[lane, {at}:{end}]" for _, at, end in matrices]
        imports = [f"from {module} import {name}\n" for name, module in self.functions.items()]
        return (
            head
            + "".join(imports)
            + KERNEL.format(
                total=SUM,
                options=options,
                room=self.rows * h,
                load=indented([f"for k in range({h}):", *load, *given], 8),
                once=indented(first, 8),
                stage=indented(stage, 20),
                body=indented(body, 20),
                close=indented([line for lines in close for line in lines], 16),
                save=indented([*put("out[row, lane, "), *saved], 12),
                store=indented(put("z[lane, "), 8),
            )
        )

    def _is_number(self, name: str) -> bool:
        return name == AXIS_NAME or self.form.roles.get(name, ("c", "turn"))[1] == "number"

    def _keep(self, name: str) -> int:
        self.entries.add(name)
        self.room[name] = self.rows
        self.rows += 1
        return self.room[name]

    def _piece(self, piece: Piece) -> list[str]:
        """The source of a step or of `close`; what is done to each vector of an orientation stands in a loop."""
        outputs = dict(zip(self.names, piece.new, strict=True))
        if "matrix" not in self.kinds:
            return self._printed(piece.lines, set(), outputs, piece.upkeep)
        g = f"z{self.kinds.index('matrix')}"
        blocks = [f"{g}{block}" for block in self.form.blocks("matrix")]
        own, inner, lines = set(blocks), list[Line](), list[Line]()
        for line in piece.lines:
            (lines if own.isdisjoint(line.needs) else inner).append(line)
            own.update(() if own.isdisjoint(line.needs) else line.names)
        turned = {name: outputs.pop(name) for name in blocks}
        given = {n for line in inner for n in line.needs} | {v.strip("(-)") for v in turned.values()}
        out = self._printed(lines, given - own, outputs, within=given - own)
        h, size = self.form.h, self.form.size("vector")
        places = [
            (f"w[{self._keep(name) * h} + k]", f"{g}[column + {at * h} + k]") for at, name in enumerate(blocks[:2])
        ]
        text = [
            f"for column in range(0, {self.form.n * size}, {size}):",
            f"    for k in range({h}):",
            *(f"        {here} = {there}" for here, there in places),
            f"    {blocks[2]} = {g}[column + {2 * h}]",
            *(f"    {line}" for line in self._printed(inner, set(), turned)),
            f"    for k in range({h}):",
            *(f"        {there} = {here}" for here, there in places),
            f"    {g}[column + {2 * h}] = {blocks[2]}",
        ]
        at = out.index(WITHIN)
        return [*out[:at], *text, *out[at + 1 :]]

    def _printed(
        self,
        lines: list[Line],
        wanted: Collection[str],
        outputs: Mapping[str, str],
        upkeep: Upkeep | None = None,
        within: Collection[str] = (),
    ) -> list[str]:
        """Numbers, then a loop over the entries, level by level; a sum over the entries or a product ends a level.

        Entries that are `wanted` afterwards stay; the new state, `outputs`, is written in the last loop.  Where there
        is something `within`, which needs those names, its place is before that loop.
        """
        h, entry = self.form.h, set(self.entries)
        for line in lines:
            if not _is_total(line) and not entry.isdisjoint(line.needs):
                entry.add(line.names[0])
        late = upkeep.vectors if upkeep else {n for n in within if n in entry}
        level, last = _levels(lines, late)
        ends = {name: value for name, value in outputs.items() if name[-1] != "t" and value != name}
        used: dict[str, float] = dict.fromkeys(late, last - 0.5)  # the last level at which an entry is needed
        for line in lines:
            at = level[line.names[0]] - (0.5 if _ends_level(line) else 0)
            for n in line.needs:
                used[n] = max(used.get(n, 0), at)
        for value in ends.values():
            used[value.strip("(-)")] = last
        made = {name for line in lines for name in line.names if name in entry and not _ends_level(line)}
        kept = {n for n in made if used.get(n, 0) > level[n] or n in wanted}
        free: list[int] = []
        done: set[str] = set()
        held: dict[str, int] = {}
        out: list[str] = []
        touched: set[str] = set()
        for at in range(last + 1):
            here = [line for line in lines if level[line.names[0]] == at]
            out += self._products([line for line in here if products.matrix_of(line)], held, free, touched)
            for n in [n for n in held if n not in done and used.get(n, 0) < at]:
                free.append(held[n])  # a sum at this level still reads it, before the loop
                done.add(n)
            for line in here:
                if _is_total(line):
                    (source,) = line.needs
                    out.append(f"{line.names[0]} = total(w, {self._row(source, held) * h}, {h})")
                elif line.names[0] not in entry:
                    out.append(line.text)
            if upkeep:
                out += self._tests(upkeep, {n for line in here for n in line.names})
                out += self._upkeep(upkeep, held) if at == last else []
            out += [WITHIN] if within and at == last else []
            loop = [line for line in here if line.names[0] in made]
            here_ends = ends if at == last else {}
            if not loop and not here_ends:
                continue
            inside = {line.names[0] for line in loop}
            needs = {n for line in loop for n in line.needs} | {v.strip("(-)") for v in here_ends.values()}
            block = [f"{n} = w[{self._row(n, held) * h} + k]" for n in sorted(needs - inside) if n in entry]
            block += [line.text for line in loop]
            for n in sorted(inside & kept):
                if n in wanted:
                    row = self._keep(n)
                else:
                    row = held[n] = free.pop() if free else self._new_row()
                block.append(f"w[{row * h} + k] = {n}")
            block += [f"w[{self.room[name] * h} + k] = {value}" for name, value in here_ends.items()]
            out += [f"for k in range({h}):", *(f"    {line}" for line in block)]
        numbers = {name: value for name, value in outputs.items() if name[-1] == "t" and value != name}
        if numbers:
            out.append(f"{', '.join(numbers)}, = {', '.join(numbers.values())},")
        return ["for attempt in range(2):", *(f"    {line}" for line in (*out, "break"))] if upkeep else out

    def _vector(self, name: str, held: Mapping[str, int] | None = None) -> str:
        row, h = self._row(name, held or {}), self.form.h
        return f"w[{row * h}:{(row + 1) * h}]"

    def _call(self, function: Function, matrix: str, arguments: Iterable[str]) -> str:
        self.functions[function.name] = load(function.source).__name__
        return f"{function.name}({', '.join([matrix, *arguments])})"

    def _products(self, lines: list[Line], held: dict[str, int], free: list[int], touched: set[str]) -> list[str]:
        """The products of a level, one call for each matrix, the first with what waits; rows are made for them."""
        for line in lines:
            held[line.names[0]] = free.pop() if free else self._new_row()
        out = []
        for matrix in dict.fromkeys(map(products.matrix_of, lines)):
            own = [line for line in lines if products.matrix_of(line) == matrix]
            name = self._momentum if matrix == "M" else f"{INVERSE}{matrix}"
            changes = () if name in touched else self.waiting[name]
            touched.add(name)
            turned = [line for line in own if products.is_turned(line)]
            plain = [line for line in own if line not in turned]
            arguments = self._arguments(changes)
            for group in (plain, turned):
                arguments += [self._vector(line.needs[0], held) for line in group]
                arguments += [self._vector(line.names[0], held) for line in group]
            counts = len(changes), len(plain), len(turned)
            function = products.momentum_times(*counts[:2]) if matrix == "M" else products.inverse_times(*counts)
            out += [self._call(function, name, arguments), *(f"{c.scale} = 0.0" for c in changes)]
        return out

    def _arguments(self, changes: tuple[Change, ...]) -> list[str]:
        vectors = [self._vector(name) for letter in "xy" for name in (getattr(c, letter) for c in changes)]
        return [*(c.scale for c in changes), *vectors]

    def _tests(self, upkeep: Upkeep, known: Collection[str]) -> list[str]:
        """Inverses that have become too poor are made anew, and the step is done again."""
        out = []
        for k, inverse in enumerate(upkeep.inverses):
            residual, size = inverse.check
            if residual in known:
                diagonal = inverse.diagonal
                full = self._vector(diagonal) if diagonal in self.room else f"full({self.form.h}, {diagonal})"
                renew = self._call(products.renewed(), self._momentum, [full, inverse.turn, f"{INVERSE}{k}"])
                out += [f"if attempt == 0 and not {residual} <= {products.NEAR!r} * {size}:"]
                out += [f"    {renew}", "    continue"]
        return out

    def _wait(self, upkeep: Upkeep | None) -> None:
        """Places for the changes of a step, which go with the next product: that saves a way through the matrix."""
        for name, changes in self._changes(upkeep).items():
            places = []
            for k in range(len(changes)):
                places.append(Change(*(f"{letter}{k}_{name}" for letter in "cxy")))
                for vector in places[-1][1:]:
                    self._keep(vector)
            self.waiting[name] = tuple(places)

    def _changes(self, upkeep: Upkeep | None) -> dict[str, tuple[Change, ...]]:
        if upkeep is None:
            return {}
        inverses = {f"{INVERSE}{k}": inverse.changes for k, inverse in enumerate(upkeep.inverses)}
        return {self._momentum: upkeep.pairs, **inverses}

    def _upkeep(self, upkeep: Upkeep, held: Mapping[str, int]) -> list[str]:
        """Put the changes of this step where they wait."""
        out, loop = [], []
        for name, changes in self._changes(upkeep).items():
            for change, place in zip(changes, self.waiting[name], strict=True):
                out.append(f"{place.scale} = {change.scale}")
                for source, to in zip(change[1:], place[1:], strict=True):
                    h = self.form.h
                    loop.append(f"    w[{self.room[to] * h} + k] = w[{self._row(source, held) * h} + k]")
        return [*out, f"for k in range({self.form.h}):", *loop]

    def _done(self) -> list[str]:
        """What waits is done."""
        out = []
        for name, changes in self.waiting.items():
            make = products.momentum_changed if name == self._momentum else products.inverse_changed
            if changes:
                out += [self._call(make(len(changes)), name, self._arguments(changes))]
                out += [f"{c.scale} = 0.0" for c in changes]
        return out

    @property
    def _momentum(self) -> str:
        return f"z{self.kinds.index('skew')}"

    def _row(self, name: str, held: Mapping[str, int]) -> int:
        return held[name] if name in held else self.room[name]

    def _new_row(self) -> int:
        self.rows += 1
        return self.rows - 1


def _is_total(line: Line) -> bool:
    return " = total(" in line.text


def _ends_level(line: Line) -> bool:
    """A sum or a product, which needs all entries of what it takes."""
    return _is_total(line) or products.matrix_of(line) != ""


def _levels(lines: list[Line], late: Collection[str]) -> tuple[dict[str, int], int]:
    """The level of each line and the last one; `late` is needed in full at the last.

    Products with one matrix share a level where they can: one that may wait does, for one that may not.
    """
    free_to: dict[str, int] = {}  # no earlier than
    for again in (True, False):
        level: dict[str, int] = {}
        for line in lines:
            deep = max((level.get(n, 0) for n in line.needs), default=0)
            level[line.names[0]] = max(deep + _ends_level(line), free_to.get(line.names[0], 0))
        last = max([*level.values(), *(level.get(n, 0) + 1 for n in late)], default=0)
        if again:
            latest = dict.fromkeys(level, last) | dict.fromkeys(late, last - 1)
            for line in reversed(lines):
                for n in line.needs:
                    latest[n] = min(latest.get(n, last), latest[line.names[0]] - _ends_level(line))
            taken = [line for line in lines if products.matrix_of(line)]
            for line in taken:
                name, matrix = line.names[0], products.matrix_of(line)
                fixed = [other.names[0] for other in taken if products.matrix_of(other) == matrix]
                at = [level[n] for n in fixed if level[n] == latest[n] and level[name] <= level[n] <= latest[name]]
                free_to[name] = min(at, default=0)
    return level, last
