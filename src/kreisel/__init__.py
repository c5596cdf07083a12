"""Kreisel: spinning bodies simulated with integrators that keep every first integral to round-off.

    import kreisel as kr
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    run = kr.simulate(top, x0, dt=0.05, steps=1_000_000, every=100)
    kr.drift(run)
    kr.plot(run)

Conventions: <X, Y> = -tr(XY)/2 on so(n), x ^ y = x y^T - y x^T, rest frame (m, a) with the minus bracket,
moving frame (M, P) with the plus bracket, F' = {H, F}.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from kreisel.display import SHOWN
from kreisel.errors import (
    AccuracyWarning,
    ConservationWarning,
    InputError,
    InputWarning,
    RunError,
    explained,
    hint,
)
from kreisel.system import NAMED, REGISTRY

if TYPE_CHECKING:
    from kreisel.method import Method

__version__ = "0.2.0"

_LAZY = {
    "perturbed": "kreisel.forces.body",
    "Control": "kreisel.physical.control",
    "Event": "kreisel.runs.settings",
    "Table": "kreisel.record.table",
    "Design": "kreisel.sweeps.design",
    "differentiable": "kreisel.runs.differentiable",
    "tangent": "kreisel.runs.differentiable",
    "fit": "kreisel.analysis.fit",
    "nutation": "kreisel.runs.closed_form",
    "at": "kreisel.runs.closed_form",
    "cite": "kreisel.runs.run_record",
    "code": "kreisel.languages.source",
    "propagator": "kreisel.runs.propagation.propagator",
    "simulate": "kreisel.storage.simulate",
    "resume": "kreisel.storage.simulate",
    "open_run": "kreisel.sweeps.grids",
    "drift": "kreisel.runs.drift",
    "compare": "kreisel.analysis.method_comparison",
    "export": "kreisel.storage.exporting",
    "to_numpy": "kreisel.storage.exporting",
    "failures": "kreisel.sweeps.sweep",
    "sweep": "kreisel.sweeps.sweep",
    "plot": "kreisel.viewer.plots",
    "view": "kreisel.viewer.page",
}
SHOWN.update({kind: f"kreisel.viewer.record:{kind}_html" for kind in ("system", "model", "state", "run")})
SHOWN.update(plot="kreisel.viewer.plots:plot", view="kreisel.viewer.page:view")
_PARTS = ("analysis", "checkcases", "gym", "lab", "physical", "rebound", "reduction", "units")
_EXTRAS = ("gym", "rebound", "reduction")  # packages that need gymnasium, REBOUND and JAX

__all__ = ["AccuracyWarning", "ConservationWarning", "InputError", "InputWarning", "RunError", "methods", "systems"]
__all__ += [*NAMED, *_LAZY, *(name for name in _PARTS if name not in _EXTRAS)]


@explained
def methods() -> list[Method]:
    """The records of all methods: use, orders, conserved quantities; `kreisel methods` prints them."""
    from kreisel.method import METHODS

    return list(METHODS.values())


@explained
def systems() -> list[str]:
    """The names of all systems, as in a TOML file; `kreisel systems NAME` prints a record."""
    return list(REGISTRY)


def __getattr__(name: str) -> Any:
    if name in _PARTS:
        return importlib.import_module(f"kreisel.{name}")
    if name in _LAZY:
        value = getattr(importlib.import_module(_LAZY[name]), name)
        globals()[name] = value
        return value
    if name in NAMED:  # __init__.pyi lists them for editors and type checkers
        return NAMED[name]
    message = f"module 'kreisel' has no attribute {name!r}.{hint(name, __all__)}"
    raise AttributeError(message, name=name, obj=None)  # without an object Python adds no second hint


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
