"""The orthonormal basis of the form about an axis: the planes of T and the axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kreisel.kernels.large.forms import LargeForm

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Scheme

AXIS_NAME, TURN_NAME = "axis", "turn"
IN_PLANES = 1e-10  # how far a constant matrix may be from a turn in the planes of T, relative
BASIS = "basis_"
BASIS_AXES = {f"{BASIS}{letter}": count for letter, count in {"x": 2, "y": 2, "p": 1, "length": 0, "T": 2}.items()}
SHORTEST = 1e-100  # of an axis


def _axis_lengths(p: Array) -> Array:
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

    @property
    def arrays(self) -> dict[str, Array]:
        """What `back` takes, by name."""
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

    def observer(self, observe: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, Array]]:
        """`observe` of blocks, which also takes the `arrays` of this basis or of one to take its place."""

        def of_blocks(z: tuple[Array, ...], only: Collection[str] | None = None, /, **known: Array) -> dict[str, Array]:
            given = {name: known.pop(name) for name in self.arrays if name in known}
            return observe(self.with_arrays(given).back(z), only, **known)

        return of_blocks

    def with_arrays(self, known: Mapping[str, Array]) -> Basis:
        """The basis with these `arrays` in the place of its own."""
        return replace(self, **{name.removeprefix(BASIS): value for name, value in known.items()})

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
