"""What a method states about itself: `kr.methods`, defaults, checks, citations and tables come from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    from kreisel.method.scheme import Scheme
    from kreisel.record.contract import System
    from kreisel.record.model import Model


@dataclass(frozen=True)
class Suits:
    """Condition on a model: the fields below hold of its record.  Without any it holds for every model.

    states   attributes of the record that are neither None nor False, such as "map.symmetric": all of them
    either   attributes of which one at least is stated
    lacks    attributes that are not stated
    n        the dimension
    space    the name of the phase space
    kinds    the kinds of the components
    numbers  for which the record is written: one of these
    test     name of a function of the model, for what no attribute tells; imported if everything else holds
    """

    states: tuple[str, ...] = ()
    either: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    n: int | None = None
    space: str | None = None
    kinds: tuple[str, ...] | None = None
    numbers: tuple[str, ...] = ()
    test: str = ""

    def __call__(self, model: Model) -> bool:
        """Whether the condition holds."""
        system = model.system
        return (
            self.n in (None, model.n)
            and self.space in (None, system.space.name)
            and self.kinds in (None, system.space.kinds)
            and (not self.numbers or system.numbers in self.numbers)
            and all(_states(system, path) for path in self.states)
            and not any(_states(system, path) for path in self.lacks)
            and (not self.either or any(_states(system, path) for path in self.either))
            and (not self.test or bool(resolve_name(self.test)(model)))
        )


def _states(system: System, path: str) -> bool:
    """Whether a record states the attribute at the end of a path such as "map.symmetric"."""
    value: Any = system
    for name in path.split("."):
        value = getattr(value, name)
        if value is None or value is False:
            return False
    return True


@dataclass(frozen=True)
class Method:
    """A method.

    name, title  of it, in a word and in a line
    needs        what a system must state for it, in words
    cases        what a system must state for it: one of these conditions
    orders       that it has, rising; none for the flow itself; tuples for splittings.  `default` if none is asked for;
                 `words` for them, where `make` knows which there are
    poisson      whether its map is Poisson for the bracket of the system
    conserves    what stays constant up to rounding errors
    default_for  the models of which it may be the default, as `cases`, which None stands for
    steps        whether it makes steps: if not, it is no default where an order or an engine is asked for
    sources      keys of refs.bib; `composed` of single orders beside
    maker        name of the function (model, dt, order, oriented) -> Scheme, such as "kreisel.method.suris:suris",
                 which is imported when the method is first used
    """

    name: str
    title: str
    needs: str
    cases: tuple[Suits, ...]
    orders: tuple[Any, ...]
    default: Any
    poisson: str
    conserves: str
    sources: tuple[str, ...]
    maker: str
    default_for: tuple[Suits, ...] | None = None
    steps: bool = True
    words: str = ""  # for the orders, where no list says it
    composed: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    of_map: bool = False  # whether it steps the map of the system, which is cited then

    def __repr__(self) -> str:
        return f"<kreisel method {self.name!r}: {self.title}>"

    def make(self, model: Model, dt: float, order: Any, oriented: bool) -> Scheme:
        """The scheme for a model."""
        scheme: Scheme = resolve_name(self.maker)(model, dt, order, oriented)
        return scheme

    def applies(self, model: Model) -> bool:
        """Whether a model states what the method needs."""
        return any(suits(model) for suits in self.cases)

    def check(self, model: Model) -> None:
        """Raises `InputError` for a system that does not state what the method needs."""
        if not self.applies(model):
            raise InputError(
                f"method={self.name!r}: expected {self.needs}, got {model.system.name} with n = {model.n}. "
                "Leave method out for the one that fits, or see kr.methods()."
            )

    def may_be_default(self, model: Model) -> bool:
        """Whether it is one of the methods of which the first is the default."""
        cases = self.cases if self.default_for is None else self.default_for
        return any(suits(model) for suits in cases)

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
