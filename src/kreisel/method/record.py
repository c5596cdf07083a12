"""What a method states about itself: `kr.methods`, defaults, checks, citations and tables come from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

from kreisel.errors import InputError, shown
from kreisel.method.scheme import Scheme
from kreisel.record.contract import System
from kreisel.record.model import Model


@dataclass(frozen=True)
class Method:
    """A method.

    name, title  of it, in a word and in a line
    needs        what a system must state for it, in words; `applies` says so of a model
    orders       that it has, rising; none for the flow itself; tuples for splittings.  `default` if none is asked for;
                 `words` for them, where `make` knows which there are
    poisson      whether its map is Poisson for the bracket of the system
    conserves    what stays constant up to rounding errors
    rank         of all methods that suit a model the one with the lowest is its default; None: never
    suits        the models of which it may be the default; None: all that it applies to
    steps        whether it makes steps: if not, it is no default where an order or an engine is asked for
    sources      keys of refs.bib; `composed` of single orders beside
    make(model, dt, order, oriented) -> Scheme
    """

    name: str
    title: str
    needs: str
    applies: Callable[[Model], bool]
    orders: tuple[Any, ...]
    default: Any
    poisson: str
    conserves: str
    sources: tuple[str, ...]
    make: Callable[[Model, float, Any, bool], Scheme]
    rank: int | None = None
    suits: Callable[[Model], bool] | None = None
    steps: bool = True
    words: str = ""  # for the orders, where no list says it
    composed: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    of_map: bool = False  # whether it steps the map of the system, which is cited then

    def __repr__(self) -> str:
        return f"<kreisel method {self.name!r}: {self.title}>"

    def check(self, model: Model) -> None:
        """Raises `InputError` for a system that does not state what the method needs."""
        if not self.applies(model):
            raise InputError(
                f"method={self.name!r}: expected {self.needs}, got {model.system.name} with n = {model.n}. "
                "Leave method out for the one that fits, or see kr.methods()."
            )

    def may_be_default(self, model: Model) -> bool:
        """Whether it is one of the methods of which the first is the default."""
        return self.rank is not None and (self.suits or self.applies)(model)

    @property
    def order_text(self) -> str:
        """The orders in words."""
        if self.words:
            return self.words
        if len(self.orders) > 4 and all(isinstance(order, int) for order in self.orders):
            return f"{self.orders[0]}, {self.orders[1]}, ... {self.orders[-1]}"
        return ", ".join(map(str, self.orders)) or "none: it is the flow itself"

    def order(self, asked: Any) -> Any:
        """The order that was asked for, or the default.  Raises `InputError` for one that the method has not."""
        if asked is None:
            return self.default
        found = tuple(asked) if isinstance(asked, list) else asked
        if isinstance(found, Integral) and not isinstance(found, bool):
            found = int(found)
            if self.words:
                return found
        if type(found) not in (int, tuple) or found not in self.orders:
            raise InputError(
                f"method={self.name!r}: expected one of its orders ({self.order_text}), got order={shown(asked)}."
                + ("" if self.orders else " Leave order out.")
            )
        return found

    def cited(self, order: Any) -> tuple[str, ...]:
        """Keys of refs.bib for a run of that order."""
        return (*self.sources, *self.composed.get(order or 0, ()))

    def references(self, system: System) -> str:
        """The sources of a system, and those of its map where this method steps it."""
        return system.source + (f"; {system.map.source}" if self.of_map and system.map is not None else "")

    def summary(self) -> dict[str, Any]:
        """The record as plain data."""
        names = ("name", "title", "needs", "default", "poisson", "conserves")
        return {name: getattr(self, name) for name in names} | {
            "orders": list(self.orders),
            "sources": list(self.sources),
        }
