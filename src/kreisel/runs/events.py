"""Events of a run: where a quantity of the state changes its sign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from kreisel.errors import InputError, explained, shown
from kreisel.kernels.layout import Floats
from kreisel.record.portable import Portable
from kreisel.runs.settings import flag


@explained
@dataclass(frozen=True)
class Event:
    """Where a quantity of the state changes its sign: the run stops there, or an action changes the state.

    quantity  a function of the state, `lambda x: x["a"][2]`; x has the letters of the system (axial vectors for n = 3),
              and g with an orientation
    action    a function of the state -> the state with which the run goes on, as a dict of the same letters; None: the
              run stops there
    rising    True, False: only a change upward, downward; None: both

    The quantity is looked at after each step, so two changes within a step are missed; the place is found to rounding.
    Raises `InputError` for what is no function.
    """

    quantity: Callable[[Any], Any]
    action: Callable[[Any], Any] | None = None
    rising: bool | None = None

    def __post_init__(self) -> None:
        if not callable(self.quantity) or not (self.action is None or callable(self.action)):
            wrong = self.action if callable(self.quantity) else self.quantity
            raise InputError(f"kr.Event: expected functions of the state, got {shown(wrong)}.")
        if self.rising is not None:
            flag(self.rising, "rising")

    def __reduce__(self) -> Any:
        return _event, (Portable(self.quantity), Portable(self.action), self.rising)

    @property
    def name(self) -> str:
        """That of its functions."""
        return " -> ".join(getattr(f, "__name__", "function") for f in (self.quantity, self.action) if f is not None)


def _event(quantity: Portable, action: Portable, rising: bool | None) -> Event:
    return Event(quantity.function, action.function, rising)


class Stop(NamedTuple):
    """Where an event stops a run."""

    z: Floats
    time: float


def checked_events(events: Any) -> tuple[Event, ...]:
    """One event or several.  Raises `InputError`."""
    found = (events,) if isinstance(events, Event) else () if events is None else events
    if not isinstance(found, Sequence) or not all(isinstance(event, Event) for event in found):
        raise InputError(f"events: expected kr.Event(quantity), or a list of them, got {shown(events)}.")
    return tuple(found)
