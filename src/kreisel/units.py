"""Quantities with units, by pint (extra `units`): "3 kg", "20 rpm", pint quantities in; SI or any other unit out.

    wheel = kr.physical.Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm")
    run = kr.simulate(wheel, wheel.state(tilt="70 deg", spin="180 rpm"), dt="1 ms", t_end="1 s")  # in SI
    run = units.measured(run, time="ms")       # energy in J, momentum in kg m^2/s, time in ms

Plain values are in SI and do not need pint.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, explained, shown
from kreisel.record.units import OF_SYSTEM, Scale, Scales, converted, parsed_unit, registry, si
from kreisel.runs.in_si import in_units, is_in_si
from kreisel.runs.run_record import frame_of

if TYPE_CHECKING:
    import xarray as xr

OF_SUBJECT = ("Conventions", "title", "source", "references", "system", "equations", "n")
KEPT = (*OF_SUBJECT, "method", "options", "created", "versions")
__all__ = ["Scale", "measured", "quantity", "registry", "si"]

RUN_ONLY = ("kind", "conserved", "roundoff_scale", "evaluation_scale")  # attributes of variables of a run


@explained
def quantity(variable: xr.DataArray) -> Any:
    """A variable with units, of a run in SI or of `measured`, as a pint quantity.  Raises `InputError`."""
    if "units" not in getattr(variable, "attrs", ()):
        name = shown(getattr(variable, "name", variable))
        raise InputError(f"{name} has no attribute units; a run of a body of kr.physical and units.measured have them.")
    return registry().Quantity(variable.values, parsed_unit(variable.attrs["units"], str(variable.name)))


@explained
def measured(run: xr.Dataset, scales: Scales | None = None, **wanted: str) -> xr.Dataset:
    """A run in chosen units of a variable: `measured(run, time="ms")`; a run of a scaled system in SI units.

    scales   the units of the variables of a scaled system, `body.scales()`; a run of `body.model()` has them

    A run of `body.model()` is returned along the user's axes of the body, momenta as well as the attitude g, with its
    angular velocity Omega along these axes (for a system in the rest frame omega, along the axes of space).  Every
    variable has the attribute `units`; variables without a scale (directions, Casimirs, spectra) are unchanged, in
    units of the scaled system, "1".  The result is a plain Dataset for reading, plotting and `kr.export`, and can no
    longer be resumed.  Raises `InputError` for variables that have no scale or do not exist, and units of another
    dimension.
    """
    frame = frame_of(run) if hasattr(run, "attrs") and not is_in_si(run) else OF_SYSTEM
    if frame.differs:
        raise InputError("expected a run in SI, got one of bodies in different units: simulate the ensemble itself.")
    turned = in_units(run, frame) if frame else run
    if frame or is_in_si(run):
        units = {str(name): variable.attrs.get("units", "1") for name, variable in turned.variables.items()}
        scales = {name: Scale(unit, 1.0) for name, unit in units.items() if unit != "1"}
    scaled = isinstance(scales, Mapping) and all(isinstance(scale, Scale) for scale in scales.values())
    if not hasattr(run, "data_vars") or not isinstance(scales, Mapping) or not scaled:
        raise InputError(
            f"expected a run and its scales, got {shown(type(run).__name__)} and {shown(scales)}. A run of a body of "
            "kr.physical knows them; for another system say which units its variables have."
        )
    for name in wanted:
        if name not in scales or name not in turned.variables:
            listed = ", ".join(k for k in scales if k in turned.variables)
            raise InputError(f"Only {listed} of this run have units, got {shown(name)}.")
    kept = {k: run.attrs[k] for k in KEPT if k in run.attrs}
    along = "; along the axes in which the body was given" if frame or is_in_si(run) else ""
    out = turned.drop_attrs().assign_attrs(kept, kreisel_measured="SI units or named ones" + along)
    for name in map(str, turned.variables):
        variable = turned[name].variable
        attrs = {k: v for k, v in variable.attrs.items() if k not in RUN_ONLY}
        scale = scales.get(name)
        if scale is None:
            out[name].attrs = attrs
            continue
        unit, size = scale.unit, scale.size
        if name in wanted:
            converted(1.0 * parsed_unit(wanted[name], name), unit, name)  # a message in the words of the run
            size *= converted(registry().Quantity(1.0, unit), wanted[name], name).magnitude
            unit = wanted[name]
        variable = variable if size == 1 else variable * size
        out = out.assign_coords({name: variable}) if name in turned.coords else out.assign({name: variable})
        out[name].attrs = {**attrs, "units": unit}
    return out
