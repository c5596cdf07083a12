"""Base of the engines of compiled steps on the CPU."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.algebra import Array
from kreisel.graph.recording import fill, flat_constants, flat_stages, special_constants
from kreisel.kernels.layout import Floats
from kreisel.kernels.projection.corrections import Corrections
from kreisel.method.scheme import Scheme


class SteppedEngine:
    """Rows of state `z` (lanes, d), the constants of a scheme and of its stages as rows, and a projection or None.

    Kernels have the addresses of the arrays: their scalars may be changed, and no other array replaces them.
    """

    projection: Corrections | None = None

    def __init__(self, scheme: Scheme, z0: Floats):
        self.scheme, self.z = scheme, np.array(z0, dtype=np.float64, order="C")
        self.constants, self.columns = flat_constants(scheme, len(self.z))
        self.stages, self.stage_columns = flat_stages(scheme, len(self.z))

    def adopts(self, scheme: Scheme, z: Floats) -> bool:
        """Go on from z by a scheme of the same kernel, with other constants; whether that can be."""
        if scheme.kernel_key is None or scheme.kernel_key != self.scheme.kernel_key or len(z) != len(self.z):
            return False
        if scheme is not self.scheme:
            changed = _changed(scheme.constants, self.scheme.constants)
            if changed:
                constants = self.constants.copy()
                fill(constants, self.columns, changed, scheme.axes)
                if special_constants(constants) != special_constants(self.constants):  # in the code of the kernel
                    return False
                self.constants[:] = constants
            fill(self.stages, self.stage_columns, _changed(scheme.stages, self.scheme.stages), scheme.axes)
            self.scheme = scheme
        self.z[:] = z
        return True

    def snapshot(self) -> dict[str, Floats]:
        return {"z": self.z, **(self.projection.snapshot() if self.projection else {})}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self.z[:] = snapshot["z"]
        if self.projection:
            self.projection.restore(snapshot)


def _changed(new: Mapping[str, Array], old: Mapping[str, Array]) -> dict[str, Array]:
    return {name: value for name, value in new.items() if value is not old[name]}
