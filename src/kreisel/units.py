"""Quantities with units, by pint (extra `units`): "3 kg", "20 rpm", pint quantities in; SI or any other unit out.

    wheel = kr.physical.Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm")
    run = kr.simulate(wheel.model(), wheel.state(tilt="70 deg", spin="180 rpm"), dt=wheel.dt("1 ms"), steps=1000)
    run = units.measured(run, time="ms")       # energy in J, m in kg m^2/s, time in ms

Plain values are in SI and do not need pint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import floats
from kreisel.errors import InputError, explained, shown
from kreisel.record.body_frame import AXES, BODY, BodyFrame
from kreisel.record.contract import Frame
from kreisel.runs.geometry import in_body_axes, model_for, velocity_of
from kreisel.runs.run_record import RunRecord

if TYPE_CHECKING:
    import pint
    import xarray as xr

KEPT = (
    "Conventions",
    "title",
    "source",
    "references",
    "system",
    "equations",
    "n",
    "method",
    "options",
    "created",
    "versions",
)
SUMMARIES = ("drift", "extremes", "frequencies")  # kinds of variables of a sweep
MOST_AXES = 4  # lists within lists
RUN_ONLY = ("kind", "conserved", "roundoff_scale", "evaluation_scale")  # attributes of variables of a run


@explained
@dataclass(frozen=True)
class Scale:
    """The unit of one variable of a scaled system: `size` of the SI unit `unit`."""

    unit: str
    size: float

    def __post_init__(self) -> None:
        size = floats(self.size)
        if size.ndim or np.isnan(size) or not isinstance(self.unit, str):
            raise InputError(
                f"Scale: expected a unit and its size, a number, got {shown(self.unit)}, {shown(self.size)}."
            )

    def scaled(self, value: Any, name: str = "the value") -> Any:
        """A measured value, with units or in SI, in the unit of the scaled system.  Raises `InputError`."""
        array = floats(si(value, self.unit, name))
        if not np.isfinite(array).all():
            raise InputError(f"{name}: expected numbers in {self.unit}, or a quantity, got {shown(value)}.")
        return array / self.size


Scales = Mapping[str, Scale]


@cache
def registry() -> pint.UnitRegistry[Any]:
    """Pint's registry of the process, so that its quantities mix with yours.  Raises `InputError` without pint."""
    try:
        import pint
    except ImportError:
        raise InputError(
            "Units need pint, which is not installed: pip install 'kreisel[units]'. Plain numbers are SI and need none."
        ) from None
    return pint.get_application_registry()  # type: ignore[no-untyped-call]


@explained
def si(value: Any, unit: str, name: str) -> Any:
    """A quantity in the named SI unit; plain values are already in SI.

    A string such as "3 kg", a quantity of pint, astropy or unyt, lists of these or of floats, nested like a matrix, or
    values with one unit for all, (values, "kg cm^2").  Returns a float or an array (...).  Raises `InputError` for
    other dimensions, unknown units, and rates in Hz or 1/s for angular velocities.
    """
    for part, text in (("unit", unit), ("name", name)):
        if not isinstance(text, str):
            raise InputError(f"{part}: expected text such as 'kg m^2' or 'inertia', got {shown(text)}.")
    if hasattr(value, "to_value"):
        try:
            return value.to_value(unit)
        except Exception as error:  # of its package
            raise InputError(f"{name} must have the dimension of {unit}, got {shown(value)}: {error}.") from None
    value = value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind in "OU" else value
    if isinstance(value, str):
        value = _parsed(value, unit, name)
    elif isinstance(value, list | tuple) and _one_unit(value):
        value = _floats(value[0], unit, name) * _parsed_unit(value[1], name)
    elif isinstance(value, list | tuple) and _has_units(value):
        parts = [si(v, unit, name) for v in value]
        return np.array(parts) if len({np.shape(part) for part in parts}) == 1 else value
    if not _is_quantity(value):
        if algebra.loses(value) or isinstance(value, complex) or getattr(value, "dtype", np.dtype(float)).kind == "c":
            raise InputError(f"{name} must be real numbers in SI units ({unit}), or a quantity, got {shown(value)}.")
        return value
    try:
        return _converted(value, unit, name).magnitude * 1.0
    except OverflowError:
        raise InputError(f"{name}: expected a number that a double can hold, got {shown(value)}.") from None


def size_in_si(attribute: str | None, unit: str, size: float, name: str) -> float:
    """The size in SI of the unit of a variable, from its attribute `units`.

    Without it, or for "1": the size in the state, `size` times `unit`.  Raises `InputError` for another dimension.
    """
    if attribute is None or attribute == "1":
        return size
    return 1.0 if attribute == unit else float(si(([1.0], attribute), unit, name)[0])


def _one_unit(value: Sequence[Any]) -> bool:
    """Whether it is (values, unit), such as ([1, 2, 3], "cm") or (3, "cm"); "3 cm" is a single quantity."""
    if len(value) != 2 or not isinstance(value[1], str) or isinstance(value[0], str) or _is_quantity(value[0]):
        return False
    return isinstance(value[0], list | tuple | np.ndarray) or value[1].strip()[:1].isalpha()


def _has_units(value: Any, levels: int = MOST_AXES) -> bool:
    """Whether there is text or a quantity in lists within lists."""
    if isinstance(value, list | tuple) and levels:
        return any(_has_units(v, levels - 1) for v in value)
    return isinstance(value, str) or _is_quantity(value) or hasattr(value, "to_value")


def _floats(value: Any, unit: str, name: str) -> Any:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: expected numbers and one unit, (values, '{unit}'), got {shown(value)}.") from None


@explained
def quantity(variable: xr.DataArray) -> Any:
    """A variable of `measured` as a pint quantity.  Raises `InputError` if it has no units."""
    if "units" not in getattr(variable, "attrs", ()):
        name = shown(getattr(variable, "name", variable))
        raise InputError(f"{name} has no attribute units; take it from units.measured(run, scales).")
    return registry().Quantity(variable.values, _parsed_unit(variable.attrs["units"], str(variable.name)))


@explained
def measured(run: xr.Dataset, scales: Scales | None = None, **wanted: str) -> xr.Dataset:
    """A run of a scaled system in SI units, or in chosen units of a variable: `measured(run, time="ms")`.

    scales   the units of the variables, `body.scales()`; a run of a body of `kr.physical` has them

    A run of such a body is returned along the user's axes of the body, momenta as well as the attitude g, with its
    angular velocity Omega along these axes (for a system in the rest frame omega, along the axes of space).  Every
    variable has the attribute `units`; variables without a scale (directions, Casimirs, spectra) are unchanged, in
    units of the scaled system, "1".  The result is a plain Dataset for reading, plotting and `kr.export`, and can no
    longer be resumed.  Raises `InputError` for variables that have no scale or do not exist, and units of another
    dimension.
    """
    frame = RunRecord.from_attrs(getattr(run, "attrs", {})).body_frame
    if scales is None and frame is not None:
        scales = {name: Scale(unit, size) for name, (unit, size) in frame.units.items()}
    scaled = isinstance(scales, Mapping) and all(isinstance(scale, Scale) for scale in scales.values())
    if not hasattr(run, "data_vars") or not isinstance(scales, Mapping) or not scaled:
        raise InputError(
            f"expected a run and its scales, got {shown(type(run).__name__)} and {shown(scales)}. A run of a body of "
            "kr.physical knows them; for another system say which units its variables have."
        )
    turned, scales = (run, scales) if frame is None else _with_velocity(_of_sweep(run, frame), frame, scales)
    scales = scales if frame is None else {**_scales_of_summaries(run, frame, scales), **scales}
    for name in wanted:
        if name not in scales or name not in turned.variables:
            there = ", ".join(k for k in scales if k in turned.variables)
            raise InputError(f"Only {there} of this run have units, got {shown(name)}.")
    kept = {k: run.attrs[k] for k in KEPT if k in run.attrs}
    mark = "SI units or named ones" + ("" if frame is None else "; along the axes in which the body was given")
    out = turned.drop_attrs().assign_attrs(kept, kreisel_measured=mark)
    for name in map(str, turned.variables):
        variable = turned[name].variable
        attrs = {k: v for k, v in variable.attrs.items() if k not in RUN_ONLY}
        scale = scales.get(name)
        if scale is None:
            out[name].attrs = attrs
            continue
        unit, size = scale.unit, scale.size
        if name in wanted:
            size *= _converted(registry().Quantity(1.0, scale.unit), wanted[name], name).magnitude
            unit = wanted[name]
        out = out.assign_coords({name: variable * size}) if name in run.coords else out.assign({name: variable * size})
        out[name].attrs = {**attrs, "units": unit}
    return out


def _of_summary(run: xr.Dataset) -> dict[str, str]:
    """The variable of each summary of a sweep, such as M_max, by name."""
    kinds = {str(name): variable.attrs.get("kind") for name, variable in run.variables.items()}
    return {name: name.rpartition("_")[0] for name, kind in kinds.items() if kind in SUMMARIES}


def _of_sweep(run: xr.Dataset, frame: BodyFrame) -> xr.Dataset:
    """A run, or a sweep whose summaries state their axes."""
    axes = {name: frame.attributes(letter).get(AXES) for name, letter in _of_summary(run).items()}
    said = {name: run[name].assign_attrs({AXES: value}) for name, value in axes.items() if value is not None}
    return run.assign(said)


def _scales_of_summaries(run: xr.Dataset, frame: BodyFrame, scales: Scales) -> dict[str, Scale]:
    """The units of the summaries of a sweep."""
    rate, found = Scale("rad/s", 1 / frame.time_unit), _of_summary(run)
    known = {name: rate if name.endswith("_frequency") else scales.get(of) for name, of in found.items()}
    return {name: scale for name, scale in known.items() if scale is not None}


def _with_velocity(run: xr.Dataset, frame: BodyFrame, scales: Scales) -> tuple[xr.Dataset, Scales]:
    """A run along the axes of its body, with its angular velocity, if its state gives one."""
    out, record = in_body_axes(run), RunRecord.from_attrs(run.attrs)
    if record.is_own or "parameters" not in run.attrs or "event" in run.dims or record.missing_from(run):
        return out, scales
    rows = run if "time" in run.dims else run.expand_dims("time")
    model = model_for(rows, None)
    if model.system.velocity is None:
        return out, scales
    values = algebra.axial(velocity_of(rows, model))
    body = model.system.frame is Frame.MOVING
    name, meaning = ("Omega", "along the axes of the body") if body else ("omega", "in space")
    dims = tuple(d for d in ("time", "lane") if d in run.dims)
    values = (frame.vectors(values) if body else values).reshape(*(run.sizes[d] for d in dims), 3)
    variable = (
        (*dims, "axis"),
        values,
        {"long_name": f"angular velocity {name}, {meaning}", **({AXES: BODY} if body else {})},
    )
    return out.assign({name: variable}), {**scales, name: Scale("rad/s", 1 / frame.time_unit)}


def _is_quantity(value: Any) -> bool:
    return hasattr(value, "magnitude") and hasattr(value, "to")


def _turns(value: Any) -> bool:
    """Whether a unit counts angles: rpm and deg/s do, Hz and 1/s do not, which pint converts to rad/s."""
    return "radian" in dict((1 * value).to_root_units().unit_items())


def _parsed(text: str, unit: str, name: str) -> Any:
    try:
        return registry().Quantity(text)
    except InputError:
        raise
    except Exception as error:  # pint raises tokenize, syntax, attribute and further errors
        raise InputError(f"{name} must be a quantity such as '1 {unit}', got {shown(text)}: {error}.") from None


def _parsed_unit(unit: str, name: str) -> Any:
    try:
        return registry().Unit(unit)
    except Exception as error:  # as above
        raise InputError(f"{name} needs a unit that pint knows, such as 'rad/s', got {shown(unit)}: {error}.") from None


def _converted(value: Any, unit: str, name: str) -> Any:
    import pint

    target = _parsed_unit(unit, name)
    if str(value.dimensionality) == str(target.dimensionality) == "1 / [time]" and _turns(value) != _turns(target):
        raise InputError(
            f"{name} must be in {unit}, got {value:~}, which may count turns or radians. Usual cause: a frequency for "
            f"an angular velocity. Three turns a second are '3 turn/s' or '180 rpm', 3 * 2 pi = 18.85 rad/s; three "
            "radians a second are '3 rad/s'."
        )
    try:
        return value.to(target)
    except pint.DimensionalityError:
        raise InputError(f"{name} must have the dimension of {unit}, got {value}.") from None
