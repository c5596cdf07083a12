"""Methods by name.  Each makes a `Scheme` for a model, a step and an order."""

from __future__ import annotations

from collections.abc import Callable

from kreisel.errors import InputError, nearest, shown
from kreisel.methods.baecklund import baecklund
from kreisel.methods.exact import exact
from kreisel.methods.lagrangian import lagrangian
from kreisel.methods.reference import dop853
from kreisel.methods.scheme import Outcome, Scheme
from kreisel.methods.suris import suris
from kreisel.methods.variational import variational
from kreisel.methods.veselov import veselov
from kreisel.record.model import Model

METHODS: dict[str, Callable[[Model, float, int | None, bool], Scheme]] = {
    "baecklund": baecklund,
    "suris": suris,
    "veselov": veselov,
    "variational": variational,
    "lagrangian": lagrangian,
    "exact": exact,
    "dop853": dop853,
}

SOURCES: dict[str, tuple[str, ...]] = {  # keys of refs.bib
    "baecklund": ("suris2001",),
    "suris": ("suris2001",),
    "variational": ("marsden1999", "suris2001"),
    "lagrangian": ("suris2001",),
    "veselov": ("moser1991", "suris2000"),
    "exact": ("suris2001", "carlson1995", "whittaker1937"),
    "dop853": ("hairer1993",),
}
COMPOSED = {4: ("suzuki1990",), 6: ("kahan1997",), 8: ("kahan1997",)}  # orders of method="variational"

__all__ = ["METHODS", "Outcome", "Scheme", "default_method", "scheme", "sources"]


def sources(method: str, order: int | None) -> tuple[str, ...]:
    """Keys of refs.bib for a method at an order."""
    composed = COMPOSED.get(order or 0, ()) if method == "variational" else ()
    return (*SOURCES[method], *composed, *(("hairer2006",) if composed else ()))


def default_method(model: Model) -> str:
    """Bäcklund transformations where known, else the system's own map, the variational integrator, the reference."""
    if model.system.baecklund is not None:
        return "baecklund"
    if model.system.map is None:
        return "dop853" if model.system.inverse_inertia is None else "variational"
    if model.map.symmetric:
        return "veselov"
    return "lagrangian" if model.system.numbers == "jax" else "suris"


def scheme(model: Model, method: str | None, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The scheme of that name.  Raises `InputError` with the nearest name."""
    name = default_method(model) if method is None else method
    if not isinstance(name, str):
        raise InputError(f"method must be a name, one of {', '.join(METHODS)}; {shown(name)} came.")
    if name not in METHODS:
        raise InputError(f"No method is called {shown(name)}.{nearest(name, METHODS)} There are: {', '.join(METHODS)}.")
    return METHODS[name](model, dt, order, oriented)
