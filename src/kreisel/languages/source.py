"""kr.code: one short file of another language with the step of a body, from the recorded step of the kernels.

The free body is in closed form; any other method is its scheme, made with a recorded number for dt.
A free body is also an FMU (FMI 3.0, co-simulation): torque in, attitude and angular velocity out, in SI units.
[Modelica Association, Functional Mock-up Interface Specification 3.0, 2022]
"""

from __future__ import annotations

import copy
import hashlib
import importlib.metadata
import io
import math
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import SECOND, THIRD, Array
from kreisel.algebra.recorded import NotRecorded
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, require_one_of, shown
from kreisel.graph.arranging import Rolled
from kreisel.graph.graph import Graph
from kreisel.languages.bodies import (
    CONVENTIONS,
    HELD,
    MESSAGES,
    MOMENTS,
    Convention,
    check,
    check_moments,
    free_body,
    watched,
)
from kreisel.languages.dialects import LANGUAGES
from kreisel.languages.writer import CHANGED, HUGE, NEW, READ, Body, Field, Function, Values, assembled, numbers_of
from kreisel.method import find
from kreisel.method.scheme import ORIENTATION, Orbits, Scheme, Steps
from kreisel.method.splitting import closed_form
from kreisel.record.body import as_body
from kreisel.record.calling import call
from kreisel.record.table import require_none
from kreisel.runs.examples import example
from kreisel.runs.geometry import to_third_axis
from kreisel.runs.in_si import scaled
from kreisel.runs.plan import Plan
from kreisel.runs.planning import make_plan
from kreisel.runs.settings import check_model

if TYPE_CHECKING:
    from kreisel.record.body import Body as PhysicalBody
    from kreisel.record.model import Model, OrientationLike, StateLike
    from kreisel.runs.plan import Plan


NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
DEFECT = "defect"
MOST = 10
ORBIT = "The constants belong to the orbit of the initial state: from another one the step is another map."
AXES = "The state has other axes than the body: a vector of the body is R v, its orientation g R^T, with"
COUNT = "Forces are at the time _count dt: set _count to begin at another time, and again with another dt."
STOPS = "  In 32 bits it does not count beyond 16777216: their time ends there."
LABELS = {"c": "c_"}  # of parameters, in arguments next to the constants c of the file
POSITIVE = ("the parameters are finite, and positive where they have to be", MESSAGES[-1])


class Stepped:
    """The functions of a plan of one trajectory.

    variable   the scheme with a recorded dt; if it is `fitted`, its constants belong to the orbit of the initial state
    orbit      constants of the trajectory that a function of the file computes from the state: name -> count
    kinds      of the components; the user's form of a skew matrix is an axial vector for n = 3
    """

    def __init__(self, plan: Plan, single: bool = False):
        _require_steps(plan)
        self.model, self.fixed, self.plan = plan.model, plan.scheme, plan
        self.by_moments = self.model.system.name == "euler-top" and self.model.n == 3
        self.stages = self.fixed.stage_count
        self.huge = HUGE[single]
        self.held = single and self.by_moments and self.stages == 1
        self.restores = single and self.model.n == 3 and ORIENTATION in dict(self.fixed.components)
        self.letters = [name for name, o in self.fixed.outcomes.items() if o.kind in ("state", "orientation")]
        self.kinds = {name: algebra.KINDS[kind] for name, kind in self.fixed.components}
        recorded = self._recorded(Graph().input("dt", 0))
        self.fitted, self.variable = recorded is None, recorded or self.fixed
        phi = None if self.fitted or self.variable.trajectory is None else self.model.map
        self.turning = None if phi is None else phi.trajectory
        new = sorted({*self.fixed.stages} - {*self.variable.stages})
        self.orbit = {} if self.turning is None else dict.fromkeys(new, self.stages)

    def _recorded(self, dt: Any, constants: Values = MappingProxyType({})) -> Scheme | None:
        fixed, model = self.fixed, copy.copy(self.model)
        model.constants = {**model.constants, **constants}
        if isinstance(fixed.motion, Orbits):
            return fixed
        oriented = ORIENTATION in dict(fixed.components)
        graph, shapes = Graph(), {k: np.shape(v) for k, v in self.model.params.items()}
        try:
            derived = self._derived(
                {k: np.reshape(graph.inputs(k, math.prod(shape)), shape)[()] for k, shape in shapes.items()}
            )
            if any(np.shape(v) != np.shape(model.constants[k]) for k, v in derived.items()):  # principal axes, n > 3
                return None
            scheme = find(fixed.name).make(model, dt, fixed.options.get("order"), oriented)
        except (TypeError, AttributeError, NotRecorded, InputError):
            return None
        usable = scheme.trajectory is None or (fixed.name == "veselov" and isinstance(scheme.motion, Steps))
        return scheme if usable else None

    def _derived(self, parameters: Values) -> Values:
        derive = self.model.system.derive
        return {} if derive is None else call(derive, (), parameters)

    def scheme(self, c: Values) -> Scheme:
        """With dt, and parameters if the method accepts recorded ones, among the constants of the file."""
        if self.fitted:
            return self.fixed
        constants = self._constants(c)
        recorded = self._recorded(c["dt"], {k: constants[k] for k in self.model.constants if k in constants})
        return recorded or cast("Scheme", self._recorded(c["dt"]))

    @property
    def parameters(self) -> dict[str, Field]:
        """Parameters of the system, and dt; none if the constants belong to an orbit."""
        if self.fitted:
            return {}
        params, meanings = self.model.params, {p.letter: p.meaning for p in self.model.system.parameters}
        names = (k for k in meanings if k in params and k not in self._tables)
        fields = {LABELS.get(k, k): _field(params[k], meanings[k]) for k in names}
        if self.by_moments:
            fields = {"I": _field(params["J"][SECOND] + params["J"][THIRD], MOMENTS)}
        return {**fields, "dt": Field(0, "time step", self.plan.dt)}

    @cached_property
    def _values(self) -> dict[str, Any]:
        stages = {k: v for k, v in self.variable.stages.items() if k not in self.orbit}
        values = {**self.variable.constants, **(self.variable.basis if self.fitted else {}), **stages}
        return {k: v for k, v in values.items() if k not in self._tables}

    @cached_property
    def _tables(self) -> dict[str, Array]:
        """The empty tables of the model, which has no others; a file has none."""
        letters = [p.letter for p in self.model.system.parameters if p.kind == "table"]
        return {k: self.model.constants[k] for k in letters}

    @property
    def constants(self) -> dict[str, Field]:
        """All that a step reads, and dt."""
        fields = {k: _field(v, stage=k in self.variable.stages) for k, v in self._values.items()}
        return {**fields, "dt": Field(0)}

    def prepare(self, **parameters: Any) -> dict[str, Any]:
        """The constants from the parameters."""
        values = {**self._values, "dt": self.plan.dt}
        if not self.fitted:
            dt = parameters.pop("dt")
            if self.by_moments:
                I = parameters.pop("I")  # noqa: E741
                parameters["J"] = 0.5 * (I[SECOND] + I[THIRD] - I)
            scheme: Any = self._recorded(dt)
            names = {LABELS.get(k, k): k for k in self.model.params}
            shaped = {names[k]: np.reshape(v, np.shape(self.model.params[names[k]])) for k, v in parameters.items()}
            values = {**scheme.constants, **scheme.stages, **shaped, **self._derived(shaped), "dt": dt}
        return {f"c.{name}": values[name] for name in self.constants}

    def check(self, dt: Any, **parameters: Any) -> Any:
        """The status: 0, or the place of a message."""
        if self.by_moments:
            return check_moments(parameters["I"], dt, most=1.0, huge=self.huge)
        positive = {LABELS.get(p.letter, p.letter) for p in self.model.system.parameters if p.positive}
        entries = [(x, name in positive) for name, value in parameters.items() for x in np.ravel(value)]
        pairs = [pair for x, above in entries for pair in [(0.0, x)] * above + [(abs(x), self.huge)]]
        return check(dt, pairs, self.huge)

    def _constants(self, c: Values, stage: bool = False) -> dict[str, Any]:
        stages = self.variable.stages
        shapes = {k: np.shape(v)[k in stages :] for k, v in self._values.items() if stage or k not in stages}
        values = {k: np.reshape(np.asarray(c[k], dtype=object), shape)[()] for k, shape in shapes.items()}
        graph = c["dt"].graph
        for name, table in self._tables.items():  # inputs, so that operations are fused as they are in the kernel
            values[name] = graph.inputs(name, table.size).reshape(table.shape)
            graph.values.update({(name, i): x for i, x in enumerate(table.ravel().tolist())})
        return values

    @property
    def state(self) -> dict[str, Field]:
        """The variables of the method, in the user's form."""
        outcomes, n = self.fixed.outcomes, self.model.n
        meanings = {name: outcomes[name].meaning if name in outcomes else "" for name in self.kinds}
        fields = {k: Field(kind.count(n), meanings[k]) for k, kind in self.kinds.items() if k != DEFECT}
        return {**fields, **(HELD if self.held else {}), **{k: Field(self.stages, stage=1) for k in self.orbit}}

    def _inside(self, s: Values) -> tuple[Any, ...]:
        n = self.model.n
        return tuple(
            kind.from_user(kind.shown(n).unpack(s[k], n), n) if k in s else 0.0 for k, kind in self.kinds.items()
        )

    def _entries(self, name: str, value: Any) -> Any:
        kind = self.kinds[name]
        return kind.shown(self.model.n).pack(kind.for_user(value))

    def _outside(self, z: tuple[Any, ...]) -> dict[str, Any]:
        return {f"s.{k}": self._entries(k, value) for k, value in zip(self.kinds, z, strict=False) if k != DEFECT}

    def step(self, c: Values, s: Values) -> dict[str, Any]:
        """A step, or a stage of one."""
        return watched(self._moved, True, c, s) if self.held else self._moved(c, s)

    def _moved(self, c: Values, s: Values) -> dict[str, Any]:
        constants = {**self._constants(c, True), **{name: s[name][0] for name in self.orbit}}
        motion: Any = self.scheme(c).motion
        if isinstance(motion, Orbits):
            z, count = self._inside(s), len(self.model.system.space.letters)
            closed: Any = closed_form(self.model.system, self.model.n)
            state, g = closed.move(z[:count], z[count:], c["dt"], constants)
            return self._restored((*state, *g))
        return self._restored(motion.step(*self._inside(s), **constants))

    def _restored(self, z: tuple[Any, ...]) -> dict[str, Any]:
        out, name = self._outside(z), f"s.{ORIENTATION}"
        return out | {name: algebra.unit(out[name])} if self.restores else out  # 32 bits lose 1e-8 of its length a step

    def close(self, c: Values, s: Values) -> dict[str, Any]:
        """The end of a step that has stages."""
        motion: Any = self.scheme(c).motion
        return self._restored(motion.close(*self._inside(s), **self._constants(c)))

    def begin(self, c: Values, s: Values) -> dict[str, Any]:
        """The variables of the method from a user's state, and the constants of the trajectory."""
        x = tuple(z for z, name in zip(self._inside(s), self.kinds, strict=True) if name in self.letters)
        out = self._outside(self.scheme(c).reopen(x))
        if self.turning is not None:
            state, constants = x[: len(self.model.system.space.letters)], self._constants(c)
            (name,) = self.orbit
            out[f"s.{name}"] = np.stack([call(self.turning, state, {**constants, "eps": eps}) for eps in c["eps"]])
        return out

    def observe(self, c: Values, s: Values) -> dict[str, Any]:
        """The state of the user, if the method steps other variables, and energies."""
        values = self.scheme(c).observe(self._inside(s), None, **self._constants(c))
        energies = {k: np.ravel(np.asarray(v, dtype=object)) for k, v in values.items() if k.startswith("energy")}
        return {k: self._entries(k, values[k]) for k in self.kinds if self.begins and k in values} | energies

    def body(self) -> Body:
        """The contents of the file."""
        arguments = {k: ("array" if f.count else "number", f.count) for k, f in self.parameters.items()}
        closes = isinstance(self.fixed.motion, Steps) and self.fixed.motion.close is not None
        staged, names = self.stages > 1 or closes, self._names()
        functions = [
            *([Function("check", self.check, arguments, "status")] if arguments else []),
            Function("prepare", self.prepare, {**NEW, **arguments}),
            *([Function("begin", self.begin, CHANGED)] if self.begins or self.orbit else []),
            Function("stage" if staged else "step", self.step, CHANGED | ({"k": ("index", 0)} if staged else {})),
            *([Function("close", self.close, CHANGED)] if closes else []),
            *([Function("observe", self._observed, {**READ, "out": ("out", len(names))})] if names else []),
        ]
        first = dict(zip(self.kinds, algebra.restore(self.plan.first[0], self.fixed.kinds, self.model.n), strict=True))
        first |= {name: np.asarray(self.plan.start[name]) for name in self.kinds if name in self.letters}
        return Body(
            head=_head(self, names),
            parameters=self.parameters,
            constants=self.constants,
            state=self.state,
            functions=functions,
            messages=(MESSAGES if self.by_moments else POSITIVE) if arguments else (),
            start={k.removeprefix("s."): np.ravel(v) for k, v in self._outside((*first.values(),)).items()},
            stages=self.stages if staged else 0,
        )

    def _observed(self, c: Values, s: Values) -> dict[str, Any]:
        return {"out": np.concatenate([*self.observe(c, s).values()])}

    def _inputs(self) -> tuple[Values, Values]:
        graph = Rolled(tables=False)
        return numbers_of(graph, "c", self.constants), numbers_of(graph, "s", self.state)

    def _names(self) -> list[str]:
        sizes = {name: len(value) for name, value in self.observe(*self._inputs()).items()}
        return [f"{name}[{i}]" if size > 1 else name for name, size in sizes.items() for i in range(size)]

    @cached_property
    def begins(self) -> bool:
        """Whether the variables of the method differ from the user's."""
        c, s = self._inputs()
        new = self.begin(c, s)
        pairs = ((x, y) for k in self.letters for x, y in zip(np.ravel(s[k]), np.ravel(new[f"s.{k}"]), strict=True))
        return any(getattr(y, "key", None) != x.key for x, y in pairs)


def _field(value: Any, meaning: str = "", stage: bool = False) -> Field:
    return Field(np.size(value) if np.ndim(value) else 0, meaning, value, np.size(value[0]) if stage else 0)


def _require_steps(plan: Plan) -> None:
    """Raises `InputError` unless a plan is of one trajectory, by a step that is straight-line code."""
    scheme, model = plan.scheme, plan.model
    if scheme.corrector is not None:
        raise InputError(
            f"code: expected a method that steps the state itself, got the order {scheme.options['order']}, whose "
            "corrector comes before the steps and behind them. Use order=(8, 2) or (8, 6, 4)."
        )
    if taken := {"dt", *LABELS.values()} & {*model.params}:
        raise InputError(
            f"params: expected names that arguments of the file do not have, got {', '.join(sorted(taken))}. "
            "Give other names to parameters of the forces."
        )
    if not {*model.system.space.letters} <= {letter for letter, _ in scheme.components}:
        raise InputError(
            f"code: expected a method that steps the state itself, got method={scheme.name!r} of {model.system.name}, "
            "which steps another body. Use method='baecklund'."
        )
    if model.n > MOST:
        raise InputError(f"code: expected n <= {MOST}, got n = {model.n}. Longer steps are no straight-line code.")
    closed = isinstance(scheme.motion, Orbits) and closed_form(model.system, model.n) is not None
    if not (isinstance(scheme.motion, Steps) or closed) or plan.large is not None or scheme.coupling is not None:
        raise InputError(
            f"code: expected one body and a method that makes steps, got {scheme.name}. Give method='suris', "
            "'baecklund', 'veselov', 'variational' or 'kahan'; bodies that act on each other have no file."
        )


def _head(stepped: Stepped, names: list[str]) -> list[str]:
    plan, system = stepped.plan, stepped.model.system
    method, order = find(stepped.fixed.name), stepped.fixed.options.get("order")
    conserved = [n for n, o in plan.outcomes.items() if o.conserved]
    constants = ", ".join(f"{k} = {np.asarray(v).tolist()}" for k, v in stepped.model.params.items())
    of_orbit = "" if stepped.fixed.trajectory is None else f"  {ORBIT}"
    return [
        f"{system.title}: {system.equations}",
        f"[{system.source}]",
        f"Method {method.name}: {method.title}{'' if order is None else f', order {order}'}.",
        f"It conserves {', '.join(conserved) or 'none of the outputs'}.  {system.scaling}",
        "Skew matrices are axial vectors for n = 3, else the entries above the diagonal, row by row; symmetric ones "
        "those on and above it; g is a unit quaternion (w, x, y, z), body to space, or a matrix.",
        f"Outputs: {', '.join(names)}.",
        *([f"{constants}, dt = {plan.dt!r}.{of_orbit}"] if stepped.fitted else []),
    ]


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
                  dt and state are arguments in the file, these their default values; with "baecklund" and "splitting"
                  the constants of the step belong to x0, and a `HeavyTop` with n > 3 has its own
    method, order, orientation  as in `kr.simulate`; methods that make steps, n <= 10, and "exact", n = 3.  A body of
                  `kr.physical` carries its orientation
    single        32-bit values, in "c", "cpp", "cuda", "rust" and "julia"
    convention    of a free body of `kr.physical`: axes, units and order of the quaternion of "ros", "unity", "unreal",
                  "godot", "bevy" or "three"
    name          of the body: prefix of names in C, the module in Julia; letters, digits and _.  Default: the system's

    In C, C++, CUDA and Rust the step is bitwise equal to the kernel without projection, of bodies on orbits and of the
    closed form of a top up to rounding; constants that follow from the parameters may be rounded otherwise.  The others
    have no fused multiply-add.  Raises `InputError`.
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
    model: Any = system if body is None else body.in_si()
    _require_code(model)
    start = model.state(**example(model.system, model.n, dict(model.params)).state) if x0 is None else x0
    if body is not None:
        _, start, orientation, settings, _ = scaled(body, start, orientation, {"dt": dt, "steps": 1})
        dt, orientation = settings["dt"], _attitude(model, start) if orientation is None else orientation
    closed = model.n == 3 and any(getattr(model.system.closed_form, k) is not None for k in ("moments", "top"))
    if method is None and order is None and closed and model.system.perturbation is None:
        method = "exact"
    plan = make_plan(model, start, orientation=orientation, dt=dt, steps=1, method=method, order=order)
    result = contents(plan, dialect.single, getattr(body, "inertia", None))
    if engine is not None:
        if not _is_free(plan):
            raise InputError(f"convention: expected a free body, got {plan.model.system.name}.")
        result = engine.body(result)
    default = "free_body" if _is_free(plan) else plan.model.system.name.replace("-", "_")
    licence = f"BSD-3-Clause, as Kreisel; made by `kreisel code`, Kreisel {importlib.metadata.version('kreisel')}."
    return assembled(replace(result, head=[*result.head, licence]), dialect, name or default)


def _attitude(model: Any, start: Any) -> Array:
    """An orientation g with the axis a = g e_3 or the vertical P = g^T e_3, by the least rotation."""
    names = model.body_frame.names
    g = to_third_axis(np.ravel(start["P"])[:3] if names.get("P") == "up" else np.array([0.0, 0.0, 1.0]))
    if names.get("a") == "axis":
        g = to_third_axis(np.ravel(start["a"])[:3]).T
    return algebra.unit_quaternion(g)


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


def contents(plan: Plan, single: bool = False, inertia: Any = None) -> Body:
    """The contents of the file for a plan; of a body, with its units, axes and tensor.  Raises `InputError`."""
    if plan.batched:
        raise InputError(
            "code: expected one body in one state, got an ensemble. A file has the step of one: write it for one lane; "
            "your program keeps an array of its states and steps each."
        )
    model, frame = plan.model, plan.model.body_frame
    if _is_free(plan):
        unit, time = frame.size("M"), frame.size("time")
        moments = np.asarray(call(model.system.closed_form.moments, (), model.constants)) * (unit * time)
        M = algebra.axial(np.asarray(plan.start["M"])) * unit
        result = free_body(moments, plan.dt * time, M, plan.start.get("g"), "SI" if frame else "", single)
        tensor = np.asarray(frame.axes * moments @ frame.axes.T if inertia is None else inertia)
        tensor = tensor[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]]
        field = {"T": Field(6, "inertia tensor", tensor)} if frame.turned else {}
        return replace(result, parameters={**result.parameters, **field})
    result = Stepped(plan, single).body()
    words = [f"One unit of {name} is {size!r} {unit}." for name, (unit, size) in frame.units.items()]
    if frame.turned:
        words += [f"{AXES} R = {frame.axes.tolist()}, by rows."]
    if "_count" in result.state:
        words += [COUNT + single * STOPS]
    return replace(result, head=[*result.head, *words])


# -- FMU ---------------------------------------------------------------------------------------------

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-shared", "-fPIC", "-std=c99", "-O2", "-ffp-contract=off")
LIBRARIES = {"linux": ".so", "darwin": ".dylib"}
MACHINES = {"arm64": "aarch64", "AMD64": "x86_64"}
EPOCH = (1980, 1, 1, 0, 0, 0)  # of the files in an archive: the same bytes each time
INPUT = 'causality="input" variability="continuous"'
OUTPUT = 'causality="output" variability="continuous" initial="exact"'
PARAMETER = 'causality="parameter" variability="fixed" initial="exact"'
VARIABLES = (  # name, components, attributes of FMI, meaning
    ("torque", ".x .y .z", f'{INPUT} unit="N.m"', "torque along the body axes, constant within a communication step"),
    ("attitude", ".w .x .y .z", OUTPUT, "unit quaternion, body axes to space"),
    ("angular_velocity", ".x .y .z", f'{OUTPUT} unit="rad/s"', "angular velocity along the body axes"),
    ("inertia", ".xx .yy .zz .yz .zx .xy", f'{PARAMETER} unit="kg.m2"', "inertia tensor about the centre of mass"),
    ("step", "", f'{PARAMETER} unit="s"', "longest step within a communication step"),
)
FLOAT = '    <Float64 name="{}" valueReference="{}" {} start="{!r}" description="{}"/>'.format


def fmu(name: str, header: str, inertia: Array, dt: float) -> bytes:
    """The archive: a description, sources in C, and a library if a C compiler is installed (Linux, macOS).

    header   the file of C of a free body with this name
    inertia  the default tensor (3, 3), kg m^2;  dt the default of the longest step, s
    """
    tensor = inertia[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]].tolist()
    start = [0.0, *[0.0] * 3, 1.0, *[0.0] * 6, *tensor, dt]
    words = {"name": name, "title": "Free rigid body", "start": ", ".join(map(repr, start))}
    words["token"] = hashlib.sha256((header + words["start"]).encode()).hexdigest()
    entries = [(f"{group}{k}", *about) for group, parts, *about in VARIABLES for k in parts.split() or [""]]
    numbered = list(enumerate(entries, 1))
    words["variables"] = "\n".join(FLOAT(x, k, about, start[k], meaning) for k, (x, about, meaning) in numbered)
    words["outputs"] = "\n".join(f'    <Output valueReference="{k}"/>' for k, x in numbered if OUTPUT in x[1])
    sources = {f"{name}.c": _filled("fmu.c", words), f"{name}.h": header}
    files = {
        "modelDescription.xml": _filled("fmu.xml", words).encode(),
        "sources/buildDescription.xml": _filled("build.xml", words).encode(),
        **{f"sources/{path}": text.encode() for path, text in sources.items()},
        **_compiled(name, sources),
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as z:
        for path, content in files.items():
            z.writestr(zipfile.ZipInfo(path, EPOCH), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _filled(template: str, words: dict[str, str]) -> str:
    text = resources.files("kreisel.languages").joinpath("templates", template).read_text(encoding="utf-8")
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text


def _compiled(name: str, sources: dict[str, str]) -> dict[str, bytes]:
    compiler, suffix = next(filter(None, map(shutil.which, COMPILERS)), None), LIBRARIES.get(sys.platform)
    if compiler is None or suffix is None:
        return {}
    machine, library = MACHINES.get(platform.machine(), platform.machine()), f"{name}{suffix}"
    with tempfile.TemporaryDirectory() as folder:
        for path, text in sources.items():
            Path(folder, path).write_text(text, encoding="utf-8")
        command = [compiler, *FLAGS, f"{name}.c", "-o", library, "-lm"]
        if subprocess.run(command, cwd=folder, capture_output=True, check=False, timeout=120).returncode:
            return {}
        return {f"binaries/{machine}-{sys.platform}/{library}": Path(folder, library).read_bytes()}
