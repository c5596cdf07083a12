"""The public surface of the package as calls: every function, class and method, with kinds of arguments by their names.

Nothing here names a function to call it: `surface` reads the names that the modules export, and the signatures.  A
parameter whose name has no kind is refused (`Unknown`), so that a new one cannot be left out.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import subjects
from arguments import KINDS, Around, Call, Function
from calls import ignored

MODULES = {
    "kr": "kreisel",
    "physical": "kreisel.physical",
    "analysis": "kreisel.analysis",
    "units": "kreisel.units",
    "rebound": "kreisel.rebound",
    "lab": "kreisel.lab",
}
# Called with special kinds in `api.py`, or constructors of results, whose fields nobody checks.
ELSEWHERE = {"kr.open_run", "kr.resume", "kr.sweep", "kr.export", "kr.systems", "kr.methods", "kr.failures"}
# Called by other modules of the package.
BODIES = (
    "FreeBody",
    "HeavyBody",
    "Gyroscope",
    "SubmergedBody",
    "Satellite",
    "Asteroid",
    "Ellipsoid",
    "Ensemble",
    "Binary",
)
INTERNAL = {"kr.Control.on", "physical.Control.on",
            *(f"physical.{body}.{name}" for body in BODIES for name in ("forced", "shaped", "in_si"))}  # fmt: skip
RESULTS = {"Comparison", "Lines", "Course", "Motion", "AxisStability", "FreeRotation", "Plate",
           "Primary", "Harmonics", "Part", "ThirdBody", "TumblerFit"}  # fmt: skip
SLOW = {"kr.fit": 0.2, "kr.differentiable": 0.2, "kr.tangent": 0.4, "kr.view": 0.5, "kr.plot": 0.2, "kr.code": 0.4,
        "analysis.megno": 0.5, "lab.investigate": 0.1, "View.movie": 0.05, "Lines.plot": 0.1,
        "Comparison.plot": 0.1, "kr.compare": 0.02}  # fmt: skip
OFTEN = ("kr.", "analysis.", "Propagator.")
INFINITE = {"physical.Gyroscope.motion", "physical.Gyroscope.steady_precession",
            "physical.FreeBody.stability", "physical.FreeBody.periods", "analysis.light_curve",
            "Comparison.apart", "Comparison.growth", "units.measured",
            "units.si", "analysis.rates", "analysis.mean_rates", "kr.drift",
            "analysis.angular_velocity", "analysis.compare", "kr.nutation", "kr.to_numpy"}  # fmt: skip
KIND_OF = {
    "n": "steps",
    "x0": "state",
    "a": "vector",
    "arm": "vector",
    "m": "vector",
    "altitude": "altitude",
    "angular_velocity": "vector",
    "attitude": "quaternion",
    "axial_moment": "moment",
    "axis": "vector",
    "center_of_buoyancy": "vector",
    "center_of_mass": "vector",
    "count": "count",
    "current": "vector",
    "damping": "vector",
    "degree": "count",
    "density": "density",
    "diameters": "vector",
    "diffuse": "part",
    "displaced_mass": "mass",
    "drag": "part",
    "duration": "duration",
    "eccentricity": "part",
    "eps": "eps",
    "evaluations": "count",
    "every": "every",
    "fluid_density": "density",
    "g": "quaternion",
    "gravity": "rate",
    "inclination": "angle",
    "inertia": "inertia",
    "iterates": "count",
    "lag": "part",
    "length": "lever",
    "lever": "lever",
    "light": "part",
    "linear_drag": "six",
    "love": "part",
    "magnetic_moment": "vector",
    "mass": "mass",
    "mirror": "part",
    "node": "angle",
    "nutation": "rate",
    "perigee": "angle",
    "period": "rate",
    "pitch": "angle",
    "points": "count",
    "precession": "rate",
    "quadratic_drag": "six",
    "radius": "lever",
    "ratio": "rate",
    "roll": "angle",
    "seconds": "times",
    "seed": "seed",
    "seen": "quantity",
    "semi_axes": "vector",
    "semi_major_axis": "distance",
    "sides": "vector",
    "size": "mass",
    "spin": "spin",
    "start": "vector",
    "steps": "steps",
    "sun": "vector",
    "system": "model",
    "tilt": "angle",
    "time_unit": "mass",
    "tolerance": "level",
    "torque": "vector",
    "transverse_moment": "moment",
    "up": "vector",
    "value": "level",
    "velocity": "vector",
    "yaw": "angle",
    "M": "vector",
    "added_mass": "six",
    "overwrite": "flag",
    "t": "reach",
    "magnetic_field": "part",
    "law": "law",
    "memory": "memory",
    "parameters": "memory",
    "noise": "memory",
    "delay": "count",
    "limits": "memory",
    "values": "times",
    "derivatives": "times",
    "kind": "anything",
    "hold": "anything",
    "target": "vector",
    "title": "text",
    "air": "air",
    "eclipse": "flag",
    "control": "anything",
    "tensor": "vector",
    "mean_anomaly": "angle",
    "J2": "flag",
    "true_anomaly": "angle",
    "r": "vector",
    "v": "vector",
    "positions": "vector",
    "velocities": "vector",
    "line1": "text",
    "line2": "text",
    "span": "duration",
    "momenta": "vector",
    "limit": "mass",
    "gain": "mass",
    "volume": "part",
    "coercivity": "rate",
    "remanence": "part",
    "saturation": "part",
    "stiffness": "part",
    "unloading": "part",
    "robot": "text",
    "link": "text",
    "axes": "vector",
    "wheels": "anything",
    "observer": "vector",
    "shape": "vector",
    "phase": "vector",
    "light_time": "flag",
    "vertices": "vector",
    "faces": "anything",
    "secondary": "gravity body",
    "third": "anything",
    "degree_3": "vector",
    "degree_4": "vector",
    "masses": "vector",
    "position": "vector",
    "spin1": "spin",
    "spin3": "spin",
    "spin2": "spin",
    "separation": "distance",
    "attitude1": "quaternion",
    "attitude3": "quaternion",
    "attitude2": "quaternion",
    "unbound": "flag",
    "rotation": "anything",
    "modes": "anything",
    "delta": "level",
}  # fmt: skip
BY_CALL = {
    "kr.compare(start)": "state",
    "physical.Satellite.cubesat(units)": "count",
    "physical.Asteroid.cubesat(units)": "count",
    "physical.Orbit.at(time)": "times",
    "physical.Orbit.frame(time)": "times",
    "physical.Orbit.rate(time)": "times",
    "physical.Gyroscope.state(spin)": "rate",
    "physical.Gyroscope.slow_precession(spin)": "rate",
    "physical.Gyroscope.steady_precession(spin)": "rate",
    "physical.Gyroscope.nutation_rate(spin)": "rate",
    "physical.FreeBody.stability(spin)": "rate",
    "physical.Satellite.angles(run)": "run of a body",
    "physical.Binary(primary)": "gravity body",
    "physical.Binary(start)": "memory",
    "physical.Binary.didymos(sun)": "flag",
    "physical.Binary.didymos(diameters)": "vector",
    "physical.Binary.angles(run)": "run of a body",
    "physical.Binary.angles(body)": "count",
    "physical.Binary.spins(run)": "run of a body",
    "physical.Facets.from_damit(path)": "numbers file",
    "physical.read_added_mass(path)": "numbers file",
    "kr.perturbed(torque)": "force",
    "kr.perturbed(name)": "text",
    "kr.nutation(system)": "model",
    "kr.simulate(path)": "path",
    "analysis.angular_velocity(frame)": "frame",
    "analysis.fit_light_curve(observations)": "anything",
    "analysis.path(start)": "vector",
    "units.si(value)": "mass",
    "units.si(name)": "text",
    "units.Scale(unit)": "unit",
    "rebound.load(path)": "spins file",
    "rebound.Spins(names)": "bodies",
    "rebound.Body(orientation)": "quaternion",
    "View.save(path)": "file",
    "View.movie(path)": "file",
    "Propagator.steps(time)": "level",
    "Propagator.to(time)": "level",
    "Propagator.until(time)": "level",
    "lab.investigate(n)": "dimension",
    "lab.investigate(names)": "names",
}


class Unknown(AssertionError):
    """A public parameter whose name no kind is known for."""


def surface() -> list[Call]:
    """Every public callable of the modules, and the methods of their classes, as calls."""
    KINDS.update(subjects.kinds())
    found = []
    for short, module in MODULES.items():
        for name, value in _exported(module):
            if f"{short}.{name}" in ELSEWHERE | INTERNAL or name in RESULTS:
                continue
            found.append(_call(f"{short}.{name}", _got(module, name), value))
            if inspect.isclass(value):
                found += _methods(f"{short}.{name}", value)
    for name in subjects.RESULTS:
        found += _methods(name, type(subjects.example(name)))
    return found


def _exported(module: str) -> Iterator[tuple[str, Any]]:
    """The functions and classes that a module exports, without the systems, which are called by their records."""
    from kreisel.system import NAMED

    loaded = importlib.import_module(module)
    names = getattr(loaded, "__all__", [k for k in vars(loaded) if not k.startswith("_")])
    for name in names:
        value = getattr(loaded, name)
        own = getattr(value, "__module__", "").startswith("kreisel" if hasattr(loaded, "__all__") else module)
        warning = inspect.isclass(value) and issubclass(value, Exception)
        if own and callable(value) and name not in NAMED and not warning and name != "shown":
            yield name, value


def _got(module: str, name: str) -> Callable[[Around], Function]:
    return lambda here: getattr(importlib.import_module(module), name)  # type: ignore[no-any-return]


def _methods(owner: str, kind: type) -> Iterator[Call]:
    """Class methods, and methods of an example."""
    for name in (k for k in dir(kind) if not k.startswith("_") and f"{owner}.{k}" not in INTERNAL):
        static = inspect.getattr_static(kind, name)
        if isinstance(static, classmethod | staticmethod):
            yield _call(f"{owner}.{name}", lambda here, n=name: getattr(kind, n), getattr(kind, name))
        elif inspect.isfunction(static):  # not the methods of tuples
            bound = getattr(subjects.example(owner.split(".")[-1]), name)
            yield _call(
                f"{owner}.{name}",
                lambda here, n=name: getattr(subjects.example(owner.split(".")[-1]), n),
                bound,
            )


def _call(name: str, function: Callable[[Around], Function], value: Any) -> Call:
    """The call of a callable, its kinds by the names of its parameters."""
    given: list[str] = []
    keywords: dict[str, str] = {}
    optional = []
    for p in inspect.signature(value).parameters.values():
        if p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL):
            continue
        kind = BY_CALL.get(f"{name}({p.name})") or KIND_OF.get(p.name, p.name)
        kind = "system" if kind == "model" and p.default is not p.empty else kind  # or none, as the run states it
        if kind not in KINDS:
            raise Unknown(f"{name}: the parameter {p.name} has no kind in benchmarks/trial/surface.py")
        if p.default is p.empty and p.kind is not p.KEYWORD_ONLY:
            given.append(kind)
        else:
            keywords[p.name] = kind
            optional += [p.name] if p.default is not p.empty else []
    return Call(
        name,
        function,
        tuple(given),
        keywords,
        tuple(optional),
        weight=SLOW.get(name, (2.0 if name.startswith(OFTEN) else 1.0) if given or keywords else 0.05),
        infinite=name in INFINITE,
        then=_used,
    )


def _used(value: Any) -> Any:
    """All descriptions of a result: its properties, its text; functions and pages are only created."""
    if callable(value) and not hasattr(value, "_repr_html_"):
        return None
    ignored(repr(value))
    if type(value).__module__.startswith("kreisel.physical") and not isinstance(value, tuple):
        names = [n for n in dir(type(value)) if isinstance(inspect.getattr_static(type(value), n), property)]
        found = [getattr(value, n) for n in names if n[0] != "_"]
        return found + [ignored(getattr(value, n)()) for n in ("model", "scales") if hasattr(value, n)]
    if hasattr(value, "data_vars") or isinstance(value, tuple | list | dict | float) or hasattr(value, "dtype"):
        return value
    return None


@cache
def calls_of_surface() -> tuple[Call, ...]:
    """The surface, computed once in a process."""
    return tuple(surface())
