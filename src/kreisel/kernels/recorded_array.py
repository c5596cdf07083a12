"""Recorded arrays, for n beyond straight-line code: each operation is one line of NumPy that Numba compiles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from kreisel.kernels.tape import Tape, literal

# Solves of at most this n by elimination in the kernel: at n = 10 it takes 0.8 us, 1.3 complex, LAPACK 1.8 and 3.3, and
# seconds to be compiled into a kernel; at n = 32 12.6 and 22 us for 15.8 and 14.
ELIMINATED_N = 24


class RecordedMatrix:
    """A recorded real array of fixed shape, printed as NumPy code that Numba compiles."""

    __array_ufunc__ = None  # so that NumPy arrays leave their operators to us
    dtype: ClassVar[np.dtype[Any]] = np.dtype(np.float64)

    def __init__(self, tape: Tape, name: str, shape: tuple[int, ...]):
        self.tape, self.name, self.shape = tape, name, shape
        if tape.shapes is not None:
            tape.shapes[name] = shape

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def __array_namespace__(self) -> type[MatrixNamespace]:
        return MatrixNamespace

    def _new(self, expression: str, shape: tuple[int, ...], *needs: str, real: bool = False) -> RecordedMatrix:
        name = self.tape.record(expression, needs)
        if not real and not self.tape.complex_names.isdisjoint(needs):
            self.tape.complex_names.add(name)
        return RecordedMatrix(self.tape, name, shape)

    def record_complex(self, im: RecordedMatrix) -> RecordedMatrix:
        out = self._new(f"({self.name} + 1j * {im.name})", self.shape, self.name, im.name)
        self.tape.complex_names.add(out.name)
        return out

    def record_parts(self) -> tuple[RecordedMatrix, RecordedMatrix | None]:
        if self.name not in self.tape.complex_names:
            return self, None
        texts = [f"{self.name}.{part}" for part in ("real", "imag")]
        texts = [f"ascontiguousarray({t})" if self.shape else t for t in texts]
        re, im = (self._new(t, self.shape, self.name, real=True) for t in texts)
        return re, im

    def _operand(self, other: Any) -> tuple[str, tuple[int, ...], tuple[str, ...]] | None:
        if isinstance(other, RecordedMatrix):
            return other.name, other.shape, (other.name,)
        if np.ndim(other) == 0:
            return literal(float(other)), (), ()
        if isinstance(other, np.ndarray) and other.ndim == 2 and (other == np.eye(len(other))).all():
            return f"eye({len(other)})", other.shape, ()
        return None

    def _binary(self, other: Any, operation: str, reverse: bool = False) -> Any:
        """By a function of the engine: written as an operator, Numba would compile each one anew, for 0.2 s."""
        operand = self._operand(other)
        if operand is None:
            return NotImplemented
        name, shape, needs = operand
        left, right = (name, self.name) if reverse else (self.name, name)
        return self._new(f"{operation}({left}, {right})", np.broadcast_shapes(self.shape, shape), self.name, *needs)

    def __add__(self, other: Any) -> Any:
        return (
            self
            if np.ndim(other) == 0 and not isinstance(other, RecordedMatrix) and other == 0
            else self._binary(other, "add")
        )

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._binary(other, "subtract")

    def __rsub__(self, other: Any) -> Any:
        return self._binary(other, "subtract", reverse=True)

    def __mul__(self, other: Any) -> Any:
        return self._binary(other, "multiply")

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._binary(other, "divide")

    def __rtruediv__(self, other: Any) -> Any:
        return self._binary(other, "divide", reverse=True)

    def __pow__(self, exponent: int) -> Any:
        return self._binary(exponent, "power")

    def __neg__(self) -> RecordedMatrix:
        return self._new(f"negative({self.name})", self.shape, self.name)

    def __matmul__(self, other: RecordedMatrix) -> RecordedMatrix:
        shape = (*self.shape[:-1], *other.shape[1:])
        return self._new(f"{self.name} @ {other.name}", shape, self.name, other.name)

    @property
    def mT(self) -> RecordedMatrix:
        return self._new(f"ascontiguousarray({self.name}.T)", self.shape[::-1], self.name)

    def sum(self, axis: int) -> RecordedMatrix:
        if self.ndim == 1:
            return self._new(f"{self.name}.sum()", (), self.name)
        place = axis % self.ndim
        return self._new(f"{self.name}.sum({place})", self.shape[:place] + self.shape[place + 1 :], self.name)

    def __getitem__(self, index: Any) -> RecordedMatrix:
        """Only new axes, whole axes and one leading or trailing place, which is all that `algebra` asks for."""
        index = [i for i in (index if isinstance(index, tuple) else (index,)) if i is not Ellipsis]
        if None in index:
            if self.ndim == 0:
                shape = (1,) * len(index)
                return self._new(f"full({shape}, {self.name})", shape, self.name)
            size = iter(self.shape)
            shape = tuple(1 if i is None else next(size) for i in self._padded(index))
            return self._new(f"{self.name}.reshape({shape})", shape, self.name)
        if index == [0] and self.ndim == 2:
            return self._new(f"ascontiguousarray({self.name}[:, 0])", self.shape[:1], self.name)
        if len(index) == 1 and isinstance(index[0], slice):
            count = len(range(*index[0].indices(self.shape[-1])))
            places = f"{index[0].start or ''}:{index[0].stop or ''}"
            comma = ":, " * (self.ndim - 1)
            return self._new(f"ascontiguousarray({self.name}[{comma}{places}])", (*self.shape[:-1], count), self.name)
        raise TypeError(f"a recorded array cannot be indexed by {index!r}")

    def _padded(self, index: list[Any]) -> list[Any]:
        whole = sum(i is not None for i in index)
        return [slice(None)] * (self.ndim - whole) + index

    def record_solve(self, B: Any) -> RecordedMatrix:
        name, shape, needs = self._operand(B) or ("", (), ())
        if self.name in self.tape.complex_names and self.tape.complex_names.isdisjoint(needs):
            name = f"{name} + 0j"  # both sides of one type
        by = "eliminated" if self.shape[-1] <= ELIMINATED_N else "solve"
        return self._new(f"{by}({self.name}, {name})", shape, self.name, *needs)

    def record_shift(self, k: int) -> RecordedMatrix:
        """x_(i+k) of a vector on a ring."""
        return self._new(f"shifted({self.name}, {k})", self.shape, self.name)

    def sqrt(self) -> RecordedMatrix:
        return self._new(f"root({self.name})", self.shape, self.name)

    def maximum(self, other: RecordedMatrix) -> RecordedMatrix:
        return self._new(f"max({self.name}, {other.name})", (), self.name, other.name)

    def record_loop(
        self,
        body: Callable[..., tuple[tuple[RecordedMatrix, ...], RecordedMatrix]],
        start: tuple[RecordedMatrix, ...],
        small: float,
        most: int,
    ) -> tuple[tuple[RecordedMatrix, ...], RecordedMatrix]:
        """`x, defect = body(*x)`, repeated, for arrays x."""

        def arrays(names: list[str]) -> tuple[RecordedMatrix, ...]:
            return tuple(RecordedMatrix(self.tape, name, x.shape) for name, x in zip(names, start, strict=True))

        def on_names(names: list[str]) -> tuple[list[Any], Any]:
            new, defect = body(*arrays(names))
            return list(new), defect

        names, defect = self.tape.loop(on_names, list(start), small, most)
        return arrays(names), RecordedMatrix(self.tape, defect, ())

    @property
    def signed(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"{self.name}{self.shape}"


class MatrixNamespace:
    """What `algebra` needs of a library for recorded arrays."""

    @staticmethod
    def concatenate(parts: list[RecordedMatrix], axis: int) -> RecordedMatrix:
        """Vectors one after the other."""
        if any(part.ndim != 1 for part in parts):
            raise TypeError("recorded matrices are not joined by any step")
        names = [part.name for part in parts]
        return parts[0]._new(f"concatenate(({', '.join(names)}))", (sum(part.shape[0] for part in parts),), *names)
