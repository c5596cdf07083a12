"""The engines by name.  An engine makes the steps of a scheme.

A new engine is a class in a separate file and an entry here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kreisel.errors import InputError, shown
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.method.scheme import CoupledSteps, Flow, JaxSteps, Numbers, Orbits, Scheme, Steps

if TYPE_CHECKING:
    from kreisel.graph.project import Corrections
    from kreisel.kernels.large.forms import LargeForm

ENGINES = ("cpu", "large", "cuda", "cuda-float32")


class Engine(Protocol):
    """An engine at work: rows of state `z` (lanes, d), advanced in place."""

    @property
    def z(self) -> Floats:
        """The state."""

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        """Make `every` steps for each row of `out` (rows, lanes, d) and store the state there.

        If one step may need seconds, `look` is called meanwhile; after an exception from it the engine is useless.
        """

    @property
    def projection(self) -> Corrections | None:
        """The projection onto the invariants; None without one."""

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        """Start again, for at most `steps` steps, from z, as many lanes, by a scheme of the same motion.

        False where that needs a new engine.
        """

    def snapshot(self) -> dict[str, Floats]:
        """All that the next step depends on."""

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        """Go on from a snapshot."""


def engine_of(
    scheme: Scheme,
    z: Floats,
    *,
    name: str,
    dt: float,
    steps: int,
    every: int,
    large: LargeForm | None,
    project: bool,
) -> Engine:
    """The engine of that name for rows z (lanes, d), which it may change, for so many steps, each `every`-th a row.

    `large`: the form of engine="large".  Raises `InputError` where it does not run such a scheme.
    """
    if name in ("cuda", "cuda-float32"):
        _require_map(scheme, name)
        from kreisel.kernels.gpu import GpuEngine

        return GpuEngine(scheme, z, name, project)
    match scheme.motion:
        case Steps():
            from kreisel.kernels.cpu import CpuEngine

            return CpuEngine(scheme, z, large, project)
        case CoupledSteps():
            from kreisel.kernels.coupled import CoupledEngine

            return CoupledEngine(scheme, z, project)
        case JaxSteps():
            from kreisel.kernels.jax import JaxEngine

            return JaxEngine(scheme, z, dt, project)
        case Orbits():
            from kreisel.kernels.exact.engine import ClosedForm

            return ClosedForm(scheme, z, dt, steps * dt, every).ready()
        case Flow():
            from kreisel.kernels.ode import ReferenceEngine

            return ReferenceEngine(scheme, z, dt)


def _require_map(scheme: Scheme, name: str) -> None:
    if isinstance(scheme.motion, CoupledSteps):
        raise InputError(
            f"engine={shown(name)}: expected lanes that are independent, got bodies that act on each other in pairs. "
            "Use engine='cpu'."
        )
    if not isinstance(scheme.motion, Steps):
        raise InputError(
            f"engine={shown(name)} runs maps, not method={shown(scheme.name)} for this system. Use engine='cpu'."
        )
    if scheme.guard is not None and name == "cuda-float32":
        raise InputError(
            f"method={shown(scheme.name)} is implicit and is solved to float64's round-off. Use engine='cuda'."
        )


# -- states taken through the corrector of a scheme, or back, by its compiled step ---------------------


Rows = Callable[[Floats], Floats]  # (rows, lanes, d)

AT_REST = 16  # engines that are kept for the next call


class Correction:
    """C or its inverse, of rows (rows, lanes, d); a lane and a row have the bits of a separate run."""

    def __init__(self, scheme: Scheme, numbers: Numbers):
        self._scheme, self._at_rest = scheme.by(numbers), deque[Engine](maxlen=AT_REST)

    def __call__(self, rows: Floats) -> Floats:
        out = np.empty(rows.shape)
        engine: Engine | None = None
        for k, row in enumerate(rows):
            engine = self._begun(row, engine)
            engine.advance(out[k : k + 1], 1)
        if engine is not None:
            self._at_rest.append(engine)
        return out

    def _begun(self, z: Floats, engine: Engine | None) -> Engine:
        if engine is None:
            try:
                engine = self._at_rest.pop()
            except IndexError:
                return self._new_engine(z)
        return engine if engine.begin(z, self._scheme, 1) else self._new_engine(z)

    def _new_engine(self, z: Floats) -> Engine:
        return engine_of(self._scheme, z.copy(), name="cpu", dt=1.0, steps=1, every=1, large=None, project=False)


def corrections(scheme: Scheme) -> tuple[Rows, Rows]:
    """From rows that are prepared to the variables that are stepped, and from these to those that are observed."""
    if scheme.corrector is None:
        return _same, _same
    return Correction(scheme, scheme.corrector.back), Correction(scheme, scheme.corrector.out)


def _same(rows: Floats) -> Floats:
    return rows
