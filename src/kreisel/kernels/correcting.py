"""States taken through the corrector of a scheme, or back, by its compiled step."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from kreisel.kernels.engines import Engine, engine_of
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Numbers, Scheme

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
                return self._made(z)
        return engine if engine.begin(z, self._scheme, 1) else self._made(z)

    def _made(self, z: Floats) -> Engine:
        return engine_of(self._scheme, z.copy(), name="cpu", dt=1.0, steps=1, every=1, large=None, project=False)


def corrections(scheme: Scheme) -> tuple[Rows, Rows]:
    """From rows that are prepared to the variables that are stepped, and from these to those that are observed."""
    if scheme.corrector is None:
        return _same, _same
    return Correction(scheme, scheme.corrector.back), Correction(scheme, scheme.corrector.out)


def _same(rows: Floats) -> Floats:
    return rows
