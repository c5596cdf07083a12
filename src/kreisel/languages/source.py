"""kr.code: one short file of another language with the step of a body, from the recorded step of the kernels."""

from __future__ import annotations

import importlib.metadata
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel import algebra
from kreisel.errors import InputError, explained, require_one_of, shown
from kreisel.languages.bodies import CONVENTIONS, Convention, free_body
from kreisel.languages.dialects import LANGUAGES
from kreisel.languages.schemes import Stepped
from kreisel.languages.writer import Body, Field, assembled
from kreisel.method.scheme import Orbits
from kreisel.record.body import as_body
from kreisel.record.calling import call
from kreisel.record.table import require_none
from kreisel.runs.examples import example
from kreisel.runs.planning import make_plan
from kreisel.runs.settings import check_model

if TYPE_CHECKING:
    from kreisel.record.body import Body as PhysicalBody
    from kreisel.record.model import Model, OrientationLike, StateLike
    from kreisel.runs.plan import Plan

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)


@explained
def code(
    system: Model | PhysicalBody,
    x0: StateLike | None = None,
    *,
    dt: float = 1 / 60,
    language: str = "c",
    method: str | None = None,
    order: int | None = None,
    orientation: OrientationLike | None = None,
    name: str | None = None,
    single: bool = False,
    convention: str | None = None,
) -> str:
    """The text of one short file, without dependencies, with the step of a body.

    language      "c" (C99), "cpp" (C++11), "cuda" (also HIP), "rust", "csharp", "js" (an ES module), "julia",
                  "gdscript" (Godot), "python" or "wgsl" (single precision)
    system, x0    a system with parameters or a body of `kr.physical`, and a state; without x0 an example.  Parameters,
                  dt and state are arguments in the file, these their default values; only with "baecklund" and
                  "splitting" the constants of the step belong to x0
    method, order, orientation  as in `kr.simulate`; methods that make steps, n <= 10, and "exact", n = 3.  A body of
                  `kr.physical` carries its orientation
    single        32-bit values, in "c", "cpp", "cuda", "rust" and "julia"
    convention    of a free body of `kr.physical`: axes, units and order of the quaternion of "ros", "unity", "unreal",
                  "godot", "bevy" or "three"
    name          of the body: prefix of names in C, the module in Julia; letters, digits and _.  Default: the system's

    In C, C++, CUDA and Rust the step is bitwise equal to the kernel without projection, of bodies on orbits up to
    rounding: a file iterates Kepler's equation a fixed number of times.  The others have no fused multiply-add.  Raises
    `InputError`.
    """
    require_one_of(LANGUAGES, language, "language")
    if convention is not None:
        require_one_of(CONVENTIONS, convention, "convention")
    engine = None if convention is None else CONVENTIONS[convention]
    dialect, body = LANGUAGES[language], as_body(system)
    dialect = dialect.in_single() if single else dialect
    if name is not None and (not isinstance(name, str) or not NAME.fullmatch(name)):
        raise InputError(f"name: expected letters, digits and _, a letter first, such as wheel_1, got {shown(name)}.")
    if name is not None and name.lower() in dialect.reserved.split():
        raise InputError(f"name: expected one that {dialect.name} and the file do not have already, got {name!r}.")
    body = body if engine is None else _along(engine, system, body, x0)
    model: Any = system if body is None else body.model()
    _require_code(model)
    if body is not None:
        dt, orientation = body.dt(dt), (1.0, 0.0, 0.0, 0.0) if orientation is None else orientation
    start = model.state(**example(model.system, model.n, dict(model.params)).state) if x0 is None else x0
    closed = model.n == 3 and any(getattr(model.system.closed_form, k) is not None for k in ("moments", "top"))
    if method is None and order is None and closed and model.system.perturbation is None:
        method = "exact"
    plan = make_plan(model, start, orientation=orientation, dt=dt, steps=1, method=method, order=order)
    result = contents(plan, body, dialect.single)
    if engine is not None:
        if not _is_free(plan):
            raise InputError(f"convention: expected a free body, got {plan.model.system.name}.")
        result = engine.body(result)
    default = "free_body" if _is_free(plan) else plan.model.system.name.replace("-", "_")
    licence = f"BSD-3-Clause, as Kreisel; made by `kreisel code`, Kreisel {importlib.metadata.version('kreisel')}."
    return assembled(replace(result, head=[*result.head, licence]), dialect, name or default)


def _require_code(model: Any) -> None:
    check_model(model)
    require_none(model, "kr.code")
    if model.system.perturbation is not None and model.system.perturbation.control is not None:
        raise InputError(
            f"code: expected a body without control and `wheels`, got {model.system.name}. Call the law in your "
            "program, between steps of the body with its commands as parameters."
        )


def _along(engine: Convention, system: Any, body: PhysicalBody | None, x0: Any) -> PhysicalBody:
    """A free body along the axes and in the units of an engine.  Raises `InputError`."""
    if x0 is not None or body is None or not hasattr(body, "inertia"):
        raise InputError(
            f"convention: expected a free body of kr.physical without a state, got {shown(system)}"
            f"{'' if x0 is None else ' with one'}. Write kr.physical.FreeBody(inertia); the engine sets the state."
        )
    return cast("PhysicalBody", replace(cast("Any", body), inertia=engine.tensor(body.inertia)))


def _is_free(plan: Plan) -> bool:
    return isinstance(plan.scheme.motion, Orbits) and plan.model.system.closed_form.moments is not None


def contents(plan: Plan, body: PhysicalBody | None = None, single: bool = False) -> Body:
    """The contents of the file for a plan; of a body in SI units, with them.  Raises `InputError`."""
    if plan.batched:
        raise InputError(
            "code: expected one body in one state, got an ensemble. A file has the step of one: write it for one lane; "
            "your program keeps an array of its states and steps each."
        )
    model = plan.model
    scales = {} if body is None else body.scales()
    if _is_free(plan):
        moments = np.asarray(call(model.system.closed_form.moments, (), model.constants))
        M, dt, unit, time = algebra.axial(np.asarray(plan.start["M"])), plan.dt, 1.0, 1.0
        if body is not None:
            unit, time = scales["M"].size, scales["time"].size
            moments = moments * (unit * time)
        result = free_body(moments, dt * time, M * unit, plan.start.get("g"), "SI" if body is not None else "", single)
        tensor = np.asarray(getattr(body, "inertia", np.zeros((3, 3))))[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]
        field = {"T": Field(6, "inertia tensor", tensor)} if tensor[3:].any() else {}
        return replace(result, parameters={**result.parameters, **field})
    result = Stepped(plan, single).body()
    units = [f"One unit of {name} is {scale.size!r} {scale.unit}." for name, scale in scales.items()]
    return replace(result, head=[*result.head, *units])
