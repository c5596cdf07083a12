"""Functions of a user for pickle: by their name, or, if they have none that can be imported, by cloudpickle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kreisel.errors import InputError, shown


@dataclass(frozen=True)
class Portable:
    """A function; pickle takes lambdas and functions within functions too, where cloudpickle is installed."""

    function: Any

    def __deepcopy__(self, memo: dict[int, Any]) -> Portable:
        return self

    def __reduce__(self) -> Any:
        if "<" not in getattr(self.function, "__qualname__", ""):
            return Portable, (self.function,)
        try:
            import cloudpickle
        except ImportError:
            raise InputError(
                f"pickle: expected a function at the top level of a module, got {shown(self.function)}. Usual cause: a "
                "lambda. Name it there, or install cloudpickle."
            ) from None
        return _loaded, (cloudpickle.dumps(self.function),)


def _loaded(function: bytes) -> Portable:
    import cloudpickle

    return Portable(cloudpickle.loads(function))
