"""The engines by name.  An engine makes the steps of a scheme.

A new engine is a class in a separate file and an entry here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from kreisel.errors import InputError, shown
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.method.scheme import CoupledSteps, Flow, JaxSteps, Orbits, Scheme, Steps

if TYPE_CHECKING:
    from kreisel.kernels.large.kernel import Large
    from kreisel.kernels.projection.corrections import Corrections

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
    large: Large | None,
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
