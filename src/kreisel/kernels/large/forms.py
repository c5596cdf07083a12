"""Large n: kernels of O(n) or O(n^2) a step, from the definition run on vectors and matrices with structure.

Three forms are known.  About an axis: one momentum m that changes by s ^ p alone, p a constant, and vectors, for steps
that mean the same in every orthonormal basis.  The part of m that does not touch p is then constant; in its real
Schur form (2 x 2 blocks theta) a product and a solve with m cost O(n).  Plain: vectors alone, as they stand.
Dense: one momentum M of n^2 numbers that changes by a few pairs s ^ t; each solve has an inverse of its own, which is
part of the state and follows the changes by Woodbury's formula.  It starts as 0; where the residual of a solve is too
large, it is made anew and the step done again.
Which form a step has, if any, is found by recording it (`kreisel.kernels.large.structured`).

About an axis an orientation may be carried along, known by its columns or its rows, which are turned alike.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.graph.graph import Number
from kreisel.kernels.large.basis import AXIS_NAME, BASIS_AXES, SHORTEST, TURN_NAME, Basis, _axis_lengths
from kreisel.kernels.large.dense_momentum import Dense, changed_inverse
from kreisel.kernels.large.products import Change, Inverse, Upkeep
from kreisel.kernels.large.structured import StructuredColumns, StructuredMatrix, StructuredRows, StructuredVector
from kreisel.kernels.printing import Line, arranged, split
from kreisel.kernels.tape import Scalar, Tape, source_of
from kreisel.method.scheme import Part, Scheme, Steps

AXIS, TURN = f"c_{AXIS_NAME}", f"c_{TURN_NAME}"  # as they are called on the tape
INVERSE = "inverse"
LEAST_N = 4  # for n = 3 the definitions have closed forms of their own


@dataclass(frozen=True)
class LargeForm:
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

    def state(self, tape: Tape, kinds: list[str]) -> tuple[StructuredVector | StructuredMatrix | StructuredRows, ...]:
        """The recorded state."""
        return tuple(self._component(tape, f"z{i}", kind) for i, kind in enumerate(kinds))

    def _component(self, tape: Tape, name: str, kind: str) -> StructuredVector | StructuredMatrix | StructuredRows:
        if kind == "skew" and not self.axis:
            return StructuredMatrix(self.n, turn=1.0, dense=Dense(tape, name))
        if kind == "matrix":
            x, y, t = (Scalar(tape, f"{name}{block}") for block in self.blocks(kind))
            return StructuredVector(self.n, (x, y), t).mT if self.by_rows else StructuredColumns(self.n, (x, y), t)
        x, *more = (Scalar(tape, f"{name}{block}") for block in self.blocks(kind))
        if kind != "skew":
            return StructuredVector(self.n, (x, *more[:1]), more[1]) if more else StructuredVector(self.n, (x,))
        s = StructuredVector(self.n, (x, *more), 0.0)
        return StructuredMatrix(self.n, turn=Scalar(tape, TURN)).with_pair(s, self._p(tape))

    def _p(self, tape: Tape, name: str = AXIS) -> StructuredVector:
        return StructuredVector(self.n, (0.0, 0.0), Scalar(tape, AXIS), axis=True)

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

    def _turn(self, tape: Tape, name: str) -> StructuredMatrix:
        return StructuredMatrix(self.n, turn=Scalar(tape, name))

    def _vector(self, tape: Tape, name: str) -> StructuredVector:
        return StructuredVector(self.n, (Scalar(tape, name),))

    def outputs(self, new: tuple[Any, ...], kinds: list[str]) -> list[Any]:
        """The new state in the order of `names`; TypeError where it has left the form."""
        out: list[Any] = []
        for value, kind in zip(new, kinds, strict=True):
            if kind == "skew" and not self.axis:
                continue
            vector = _momentum(value) if kind == "skew" else value
            if kind == "matrix" and self.by_rows:
                vector = value.mT
            if not isinstance(vector, StructuredVector):
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
            p = StructuredVector(self.n, (0.0, 0.0), _scalar_or_plain(known[AXIS_NAME]), axis=True)
            T = StructuredMatrix(self.n, turn=known[TURN_NAME], kept=True)
            parts: list[Any] = []
            for value, kind in zip(z, self.kinds, strict=False):
                x, y = value[: self.h], value[self.h : 2 * self.h]
                if kind == "skew":
                    parts.append(T.with_pair(StructuredVector(self.n, (x, y), 0.0), p))
                elif kind == "vector":
                    parts.append(StructuredVector(self.n, (x, y), _scalar_or_plain(value[-1])))
            own: dict[str, Any] = {}
            for name, (letter, role) in self.roles.items():
                if letter == "c" and role != "axis":
                    own[name] = (
                        _scalar_or_plain(known[name])
                        if role == "number"
                        else StructuredMatrix(self.n, turn=known[name])
                    )
            return observe(tuple(parts), **own, **{self.axis: p})

        return of_blocks

    def _back(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """The inverse of `_into`."""
        return tuple(algebra.skew(v, self.n) if k == 2 else v for v, k in zip(z, self._axes, strict=False))

    def _into(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        """The state as the kernel has it, without inverses yet."""
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
    """A number that is recorded, or a plain one."""
    return x if isinstance(x, Scalar | Number) else float(x)


def _momentum(value: Any) -> StructuredVector:
    """s of m = T + s ^ p, with the T that it had before."""
    if not isinstance(value, StructuredMatrix) or not isinstance(value.turn, Scalar) or value.turn.signed != TURN:
        raise TypeError("a momentum whose constant part has changed")
    if len(value.pairs) != 1 or isinstance(value.diagonal, StructuredVector) or value.diagonal != 0.0:
        raise TypeError("a momentum that is not T + s ^ p")
    ((_, s, t),) = value.pairs.values()
    if not t.axis:
        raise TypeError("about an axis, momenta change by pairs with the axis alone")
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
            pieces = [recorded_large(form, list(kinds), part) for part in scheme.parts]
        except (TypeError, KeyError, AttributeError):
            continue
        upkeep = pieces[0].upkeep
        if upkeep is None and "matrix" not in kinds:
            return form
        if len(pieces) == 1 and scheme.stage_count == 1:
            return replace(form, inverses=len(upkeep.inverses) if upkeep else 0)
    return None


class LargeFunction(NamedTuple):
    """A recorded function: its lines, the new state, and what is done to a dense momentum."""

    lines: list[Line]
    new: list[str]
    upkeep: Upkeep | None


def recorded_large(form: LargeForm, kinds: list[str], part: Part) -> LargeFunction:
    """A step or `close` on recorded numbers; TypeError where the form does not hold."""
    tape = Tape("" if part.staged else "e")
    values = part.function(*form.state(tape, kinds), **form.known(tape, part.letters))
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
    return LargeFunction(lines, [source_of(v) for v in new], upkeep)


def _upkeep(M: Any) -> tuple[Upkeep, list[str]]:
    """How the new momentum and its inverses come from the old ones, and the recorded names that this needs."""
    if not isinstance(M, StructuredMatrix) or M.dense is None or (M.turn, M.diagonal) != (1.0, 0.0):
        raise TypeError("a momentum that has changed by other than pairs")
    pairs = [*M.pairs.values()]
    names: list[str] = []

    def number(x: Any) -> str:
        if not isinstance(x, Scalar | float | int):
            raise TypeError("a dense momentum changed by complex numbers")
        names.extend([x.name] if isinstance(x, Scalar) else [])
        return source_of(x)

    def change(scale: Any, x: StructuredVector, y: StructuredVector) -> Change:
        (a,), (b,) = x.blocks, y.blocks
        if not isinstance(a, Scalar) or not isinstance(b, Scalar):
            raise TypeError("a dense momentum changed by plain numbers")
        names.extend([a.name, b.name])
        return Change(number(-scale if a.negative != b.negative else scale), a.name, b.name)

    moved = tuple(change(*pair) for pair in pairs)
    inverses = []
    for k, (diagonal, turn) in enumerate(M.dense.inverses):
        res, size = M.dense.checks[k]
        diagonal = diagonal.blocks[0] if isinstance(diagonal, StructuredVector) else diagonal
        changes = tuple(change(-1.0, x, r) for x, r in changed_inverse(M.dense, k, pairs))
        inverses.append(Inverse(number(diagonal), number(turn), (number(res), number(size)), changes))
    return Upkeep(moved, tuple(inverses)), names
