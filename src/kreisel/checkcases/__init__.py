"""Check cases: exact motions of spinning bodies, and a grader for the trajectories of any simulator.

    case = kr.checkcases.case("tumbling-brick")
    case.reference([0, 10, 20, 30])                 # an xarray.Dataset, exact to the last digit of a double
    case.grade(times, angular_velocity=w)           # errors, drifts, order, and the likely mistake

SI units.  Angular velocities are along the body axes unless their name states space; attitudes are unit quaternions
(w, x, y, z), body to space.
"""

from __future__ import annotations

from functools import cache

from kreisel.checkcases.catalogue import Answer, Case, records
from kreisel.errors import InputError, explained, hint, shown

__all__ = ["Answer", "Case", "case", "cases"]


@cache
def _cases() -> dict[str, Case]:
    return records()


@explained
def cases() -> list[str]:
    """The names of all check cases; `kreisel checkcase` prints them with a line each."""
    return list(_cases())


@explained
def case(name: str) -> Case:
    """The check case of that name.  Raises `InputError`."""
    if not isinstance(name, str) or name not in _cases():
        raise InputError(
            f"expected a check case, one of {', '.join(_cases())}, got {shown(name)}.{hint(name, _cases())}"
        )
    return _cases()[name]
