"""Large n: kernels of O(n) a step, from the definition of the step run on vectors and matrices with structure.

Two forms are known.  About an axis: one momentum m that changes by s ^ p alone, p a constant, and vectors, for steps
that mean the same in every orthonormal basis.  The part of m that does not touch p is then constant; in its real
Schur form (2 x 2 blocks theta) a product and a solve with m cost O(n).  Plain: vectors alone, as they stand.
Which form a step has, if any, is found by recording it (`kreisel.engines.structured`).

The kernel has a loop over the entries for each stretch between two sums over them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.engines.layout import Floats
from kreisel.engines.lines import Line, arranged, split
from kreisel.engines.recording import indented
from kreisel.engines.structured import AXIS, Matrix, Vector
from kreisel.engines.trace import Scalar, Tape, text
from kreisel.errors import InputError
from kreisel.methods.scheme import Scheme

AXIS_NAME, TURN_NAME = "axis", "turn"
TURN = f"c_{TURN_NAME}"
SHORTEST = 1e-100  # of an axis
LEAST_N = 4  # for n = 3 the definitions have closed forms of their own
IN_PLANES = 1e-10  # how far a constant matrix may be from a turn in the planes of T, relative

KERNEL = """
@njit({total})
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

    axis     the letter of the constant p, or "" for the plain form
    roles    of each constant whether it belongs to the trajectory (c) or to the stage (s), and what it is: a number,
             the axis, a turn in the planes of T, or a vector
    """

    n: int
    axis: str
    roles: Mapping[str, tuple[str, str]]

    @property
    def h(self) -> int:
        """Entries in a block: planes of p^perp, or n."""
        return self.n // 2 if self.axis else self.n

    def blocks(self, kind: str) -> tuple[str, ...]:
        """The blocks of a component, by letter; t is a number."""
        if not self.axis:
            return ("x",)
        return ("x", "y") if kind == "skew" else ("x", "y", "t")

    def size(self, kind: str) -> int:
        """Numbers of a component."""
        return sum(1 if block == "t" else self.h for block in self.blocks(kind))

    # -- recording -------------------------------------------------------------------------------

    def state(self, tape: Tape, kinds: list[str]) -> tuple[Vector | Matrix, ...]:
        """The recorded state."""
        return tuple(self._component(tape, f"z{i}", kind) for i, kind in enumerate(kinds))

    def _component(self, tape: Tape, name: str, kind: str) -> Vector | Matrix:
        x, *more = (Scalar(tape, f"{name}{block}") for block in self.blocks(kind))
        if kind != "skew":
            return Vector(self.n, (x, *more[:1]), more[1]) if more else Vector(self.n, (x,))
        s = Vector(self.n, (x, *more), 0.0)
        return Matrix(self.n, turn=Scalar(tape, TURN)).with_pair(s, self._p(tape))

    def _p(self, tape: Tape, name: str = AXIS) -> Vector:
        return Vector(self.n, (0.0, 0.0), Scalar(tape, AXIS))

    def known(self, tape: Tape, letters: str) -> dict[str, Any]:
        """The recorded constants that a function takes: c those of the trajectory, s those that vary with the stage."""
        makers = {"number": self._number, "axis": self._p, "turn": self._turn, "vector": self._vector}
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
            vector = _momentum(value) if kind == "skew" else value
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
        into, back = (basis.into, basis.back) if basis else (_same, _same)
        constants = basis.constants(self, scheme) if basis else dict(scheme.constants)
        axes = {name: int(self.roles.get(name, ("c", "turn"))[1] in ("turn", "vector")) for name in constants}
        return replace(
            scheme,
            components=tuple((letter, f"R^{self.size(kind)}") for letter, kind in scheme.components),
            constants=constants,
            axes={**scheme.axes, **axes, AXIS_NAME: 0},
            prepare=lambda x: into(scheme.prepare(x)),
            observe=lambda z, **known: scheme.observe(back(z), **known),
            reopen=lambda x: into(scheme.reopen(x)),
            numbers="structured",
        )


def _same(z: tuple[Array, ...]) -> tuple[Array, ...]:
    return z


def _momentum(value: Any) -> Vector:
    """S of m = T + s ^ p, with the T that it had before."""
    if not isinstance(value, Matrix) or not isinstance(value.turn, Scalar) or value.turn.signed != TURN:
        raise TypeError("a momentum whose constant part has changed")
    if len(value.pairs) != 1 or isinstance(value.diagonal, Vector) or value.diagonal != 0.0:
        raise TypeError("a momentum that is not T + s ^ p")
    ((s, _),) = value.pairs.values()
    return s


def form_of(scheme: Scheme) -> Form | None:
    """The form that a scheme with the constants of its trajectories has, found by recording it; None for none."""
    if scheme.step is None or scheme.numbers != "any" or scheme.n < LEAST_N:
        return None
    kinds = [kind for _, kind in scheme.components]
    vectors = [name for name in scheme.constants if scheme.axes[name] == 1]
    about = kinds.count("skew") == 1 and len(vectors) == 1
    if not set(kinds) <= {"skew", "vector"} or ("skew" in kinds and not about):
        return None
    if about and not (_lengths(scheme.constants[vectors[0]]) > SHORTEST).all():
        return None
    axes = {name: (letter, scheme.axes[name]) for letter in "cs" for name in _names(scheme, letter)}
    kind_of = ("number", "axis", "turn") if about else ("number", "vector", "")
    roles = {name: (letter, kind_of[count]) for name, (letter, count) in axes.items()}
    form = Form(scheme.n, vectors[0] if about else "", roles)
    try:
        for function, letters in _functions(scheme):
            recorded(form, kinds, function, letters)
    except (TypeError, KeyError):
        return None
    return form


def _names(scheme: Scheme, letter: str) -> list[str]:
    return [*(scheme.constants if letter == "c" else scheme.stages)]


def _functions(scheme: Scheme) -> Iterator[tuple[Callable[..., Any], str]]:
    """The step and `close`, and the constants that they take."""
    if scheme.step is not None:
        yield scheme.step, "cs"
    if scheme.close is not None:
        yield scheme.close, "c"


def recorded(form: Form, kinds: list[str], function: Callable[..., Any], letters: str) -> tuple[list[Line], list[str]]:
    """Lines and the new state of a step or of `close`; TypeError where the form does not hold."""
    tape = Tape("e" * (letters == "c"))
    new = form.outputs(function(*form.state(tape, kinds), **form.known(tape, letters)), kinds)
    wanted = [v.name for v in new if isinstance(v, Scalar)]
    if any(not isinstance(v, Scalar | float | int) for v in new):
        raise TypeError("a new state that is complex")
    return arranged(tape.needed(wanted), wanted), [text(v) for v in new]


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
        return Basis(x, y, p, _lengths(p), theta, T, kinds)

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
            v = algebra.act(value, self.p) / algebra.vec(self.length**2) if kind == "skew" else value
            along = [] if kind == "skew" else [algebra.vec(algebra.dot(v, self.p) / self.length)]
            out.append(np.concatenate([algebra.act(self.x.mT, v), algebra.act(self.y.mT, v), *along], -1))
        return tuple(out)

    def back(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """The components of blocks."""
        out: list[Array] = []
        h = self.theta.shape[-1]
        for value, kind in zip(z, self.kinds, strict=True):
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

    def __call__(
        self, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], head: str, options: str
    ) -> str:
        """The source; `columns` say where each constant stands in its row."""
        pieces = [recorded(self.form, self.kinds, *function) for function in _functions(self.scheme)]
        h = self.form.h
        place = 0
        load, numbers, store, stored, save, saved = ([f"for k in range({h}):"], [], [f"for k in range({h}):"], [], [f"for k in range({h}):"], [])  # fmt: skip
        for name in self.names:
            if name[-1] == "t":
                numbers.append(f"{name} = z[lane, {place}]")
                stored.append(f"z[lane, {place}] = {name}")
                saved.append(f"out[row, lane, {place}] = {name}")
                place += 1
                continue
            row = self._keep(name)
            load.append(f"    w[{row * h} + k] = z[lane, {place} + k]")
            store.append(f"    z[lane, {place} + k] = w[{row * h} + k]")
            save.append(f"    out[row, lane, {place} + k] = w[{row * h} + k]")
            place += h
        for name, where in columns.items():
            if (
                where.stop - where.start == 1
                and self.form.roles.get(name, ("c", "turn"))[1] != "vector"
                and name != TURN_NAME
            ):
                numbers.append(f"c_{name} = c[lane, {where.start}]")
            else:
                row = self._keep(f"c_{name}")
                load.append(f"    w[{row * h} + k] = c[lane, {where.start} + k]")
        stage = [f"s_{name} = s[lane, stage, {where.start}]" for name, where in stage_columns.items()]
        constant = {f"c_{name}" for name in columns}
        fixed: list[Line] = []
        bodies = []
        for lines, new in pieces:
            once, rest = split(lines, constant)
            fixed += once
            bodies.append((rest, new))
        wanted = {n for rest, new in bodies for line in rest for n in line.needs} | {
            v.strip("(-)") for _, new in bodies for v in new
        }
        first = self._printed(fixed, wanted, None)
        body, *close = [self._printed(rest, set(), new) for rest, new in bodies]
        return head + KERNEL.format(
            total=SUM, options=options, room=self.rows * h, load=indented(load + numbers, 8), once=indented(first, 8),
            stage=indented(stage, 20), body=indented(body, 20),
            close=indented([line for lines in close for line in lines], 16),
            save=indented(save + saved, 12), store=indented(store + stored, 8),
        )  # fmt: skip

    def _keep(self, name: str) -> int:
        self.entries.add(name)
        self.room[name] = self.rows
        self.rows += 1
        return self.room[name]

    def _printed(self, lines: list[Line], wanted: Collection[str], new: list[str] | None) -> list[str]:
        """Numbers, then a loop over the entries, level by level; a sum over the entries ends a level.

        Entries that are `wanted` afterwards stay; the new state is written in the last loop.
        """
        h, level, entry = self.form.h, dict[str, int](), set(self.entries)
        for line in lines:
            deep = max((level.get(n, 0) for n in line.needs), default=0)
            if _is_total(line):
                level[line.names[0]] = deep + 1
            else:
                level[line.names[0]] = deep
                if not entry.isdisjoint(line.needs):
                    entry.add(line.names[0])
        outputs = dict(zip(self.names, new, strict=True)) if new is not None else {}
        last = max(level.values(), default=0)
        ends = {name: value for name, value in outputs.items() if name[-1] != "t" and value != name}
        used: dict[str, int] = {}  # the last level at which an entry is needed
        for line in lines:
            at = level[line.names[0]] - (0.5 if _is_total(line) else 0)
            for n in line.needs:
                used[n] = max(used.get(n, 0), at)
        for value in ends.values():
            used[value.strip("(-)")] = last
        made = {name for line in lines for name in line.names if name in entry and not _is_total(line)}
        kept = {n for n in made if used.get(n, 0) > level[n] or n in wanted}
        free: list[int] = []
        done: set[str] = set()
        held: dict[str, int] = {}
        out: list[str] = []
        for at in range(last + 1):
            for n in [n for n in held if n not in done and used.get(n, 0) < at]:
                free.append(held[n])  # a sum at this level still reads it, before the loop
                done.add(n)
            here = [line for line in lines if level[line.names[0]] == at]
            for line in here:
                if _is_total(line):
                    (source,) = line.needs
                    out.append(f"{line.names[0]} = total(w, {self._row(source, held) * h}, {h})")
                elif line.names[0] not in entry:
                    out.append(line.text)
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
        return out

    def _row(self, name: str, held: Mapping[str, int]) -> int:
        return held[name] if name in held else self.room[name]

    def _new_row(self) -> int:
        self.rows += 1
        return self.rows - 1


def _is_total(line: Line) -> bool:
    return " = total(" in line.text
