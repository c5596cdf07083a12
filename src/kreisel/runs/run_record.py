"""The attributes of a run, typed, with their conversion to and from the attributes of its Dataset; its citation."""

from __future__ import annotations

import importlib.resources
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra.reuse import cached_property
from kreisel.bodies import KNOWN, find, known_system
from kreisel.errors import InputError, counted, explained, shown
from kreisel.files import parsed
from kreisel.method import METHODS, default_method
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.record.perturbation import WITH_WHEELS
from kreisel.record.units import OF_SYSTEM, BodyFrame
from kreisel.runs.settings import count_of_rows

if TYPE_CHECKING:
    import xarray as xr


FORMAT = 1
SOFTWARE = """@software{{kreisel,
  author  = {{{{The Kreisel developers}}}},
  title   = {{Kreisel: spinning bodies simulated with integrators that keep every first integral}},
  version = {{{version}}},
  license = {{BSD-3-Clause}}
}}"""
FORM, SI = "kreisel_form", "SI"  # the attribute of a run of a body in SI: `kreisel.runs.in_si`
OF_A_RUN: dict[str, Any] = {  # attributes and their types
    **dict.fromkeys(("title", "references", "source", "system", "equations", "components", "frame", "parameters"), str),
    **dict.fromkeys(("method", "options"), str),
    **dict.fromkeys(("n", "steps", "every", "rows_in_block"), Integral),
    "dt": Real,
}


@dataclass(frozen=True, kw_only=True)
class Heading:
    """Attributes by which other programs identify a file."""

    Conventions: str = "CF-1.11"
    title: str
    source: str
    references: str
    kreisel_format: int = FORMAT


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Attributes of the moving body: the system, its parameters, the state at the start."""

    system: str
    system_sha256: str | None = None  # of a user-defined system: `kreisel.runs.operations`
    equations: str
    body: str | None = None  # JSON: axes and units of the body from which the model was created
    components: str  # JSON
    frame: str
    bracket: str
    n: int
    parameters: str  # JSON
    fixed: str | None = (
        None  # JSON: of a user-defined system, the place where a parameter is at rest, "space" or "body"
    )
    start_sha256: str

    @cached_property
    def body_frame(self) -> BodyFrame:
        """Axes and units of the body from which the model was created, else `OF_SYSTEM`.  Raises `InputError`."""
        return OF_SYSTEM if self.body is None else BodyFrame.from_table(_an_object(self.body, "body"))

    @property
    def bare(self) -> str:
        """The name of the system without its wheels."""
        return self.system.removesuffix(WITH_WHEELS)

    @property
    def is_own(self) -> bool:
        """Whether the system is user-defined: an archive holds no code, so its model is not available."""
        return self.bare not in KNOWN or (self.system in KNOWN and self.system_sha256 is not None)

    @cached_property
    def model(self) -> Model:
        """The model of the run.

        Raises `InputError` for damaged attributes, and for a user-defined system.
        """
        if self.is_own:
            raise InputError(
                f"{self.system} is none of Kreisel's systems, or a record of yours under this name, and a run holds no "
                "code. Give it as system=... to kr.resume or kr.analysis.error, or its TOML file to `kreisel resume "
                "--config`, or run it again with more steps."
            )
        values, frame = _an_object(self.parameters, "parameters"), self.body_frame
        return Model(known_system(self.system, values, frame), values, frame)

    @cached_property
    def kinds(self) -> dict[str, str]:
        """The kinds of the components of the state, by letter.  Raises `InputError`."""
        if not self.is_own and self.bare == self.system:
            return dict(find(self.system).space.components)
        return {str(letter): str(kind) for letter, kind in _an_object(self.components, "components").items()}

    @property
    def carried(self) -> str:
        """The vector that rotates with the body (rest frame) or is seen from it (moving); else the first letter."""
        return next((letter for letter, kind in self.kinds.items() if kind == "vector"), next(iter(self.kinds)))

    def missing_from(self, run: xr.Dataset) -> list[str]:
        """The components of the state that a Dataset lacks."""
        return [letter for letter in self.kinds if letter not in run]


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """Attributes of the computation."""

    method: str
    options: str  # JSON
    observe: str | None = None  # JSON; None for all
    engine: str = "cpu"
    projection: int

    def _option(self, name: str, expected: str, fits: Callable[[Any], bool]) -> Any:
        value = _an_object(self.options, "options").get(name)
        if value is not None and not fits(value):
            raise InputError(f"The attribute options is damaged: expected {expected} as {name}, got {shown(value)}.")
        return value

    @property
    def order(self) -> int | tuple[int, ...] | None:
        """The order of the method.  Raises `InputError`."""
        order = self._option("order", "an integer", lambda v: all(isinstance(k, int) for k in np.ravel(v).tolist()))
        return tuple(order) if isinstance(order, list) else order

    @property
    def tolerance(self) -> float | None:
        """The tolerance of an adaptive method; None for a fixed step.  Raises `InputError`."""
        tolerance: float | None = self._option("rtol", "a number", lambda v: isinstance(v, float))
        return tolerance

    @property
    def observed(self) -> list[str] | None:
        """The names of quantities observed in addition to the state, or None for all.  Raises `InputError`."""
        if self.observe is None:
            return None
        names = parsed(self.observe, "The attribute observe")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(f"The attribute observe is damaged: expected a list of names, got {shown(names)}.")
        return names


CLOCKS = ("dt", "asked_dt", "t_start")  # in s in a run of a body in SI


@dataclass(frozen=True, kw_only=True)
class Course:
    """Attributes of the steps, the rows, and their interruptions."""

    dt: float
    asked_dt: float | None = None  # if t_end is not a multiple of it
    t_start: float | None = None  # unless it is 0
    steps: int
    every: int
    rows: int | None = None  # if they differ from the times of every `every`-th step
    stopped: float | None = None  # the time at which an event stopped the run
    impulses: str | None = None  # JSON
    events: str | None = None  # JSON, their names, directions and checksums: an archive holds no code
    event_times: str | None = None  # JSON, (time, index of the event)
    rows_in_block: int

    @property
    def stepped(self) -> bool:
        """Whether steps were made, and dt is their length; states of `kr.at` are at given times."""
        return "dt" in self.__dict__

    @property
    def pace(self) -> str:
        """The steps in words, and whether dt is the requested step."""
        asked = self.asked_dt
        return f"{counted(self.steps, 'step')} of {self.step_text(self.dt)}" + (
            "" if asked is None else f" (asked for: dt = {self.step_text(asked)}, of which t_end is not a multiple)"
        )

    def step_text(self, dt: float) -> str:
        """A step in words: of a body in s."""
        return (self.body_frame if isinstance(self, RunRecord) else OF_SYSTEM).time_text(dt)

    @property
    def row_count(self) -> int:
        """The number of rows of the run."""
        return count_of_rows(self.steps, self.every) if self.rows is None else self.rows

    @property
    def at_times(self) -> bool:
        """Whether rows are at given times."""
        return self.rows is not None and self.stopped is None

    @property
    def broken(self) -> bool:
        """Whether impulses or events break steps."""
        return self.impulses is not None or self.events is not None

    @property
    def struck(self) -> tuple[dict[str, Any], ...]:
        """The impulses.  Raises `InputError` for damaged ones."""
        return () if self.impulses is None else tuple(parsed(self.impulses, "The attribute impulses"))


@dataclass(frozen=True, kw_only=True)
class RunRecord(Course, Numerics, Subject, Heading):
    """The attributes of a run by name; properties decode those in JSON.

    A Dataset may lack some, which xarray has dropped or `kr.at` does not write.  Reading one of these raises
    `InputError`.
    """

    complete: int = 1  # an integer: NetCDF has no truth values
    created: str
    versions: str  # JSON
    recovered: str | None = None

    @classmethod
    def from_attrs(cls, attrs: Mapping[str, Any]) -> RunRecord:
        """The record of the attributes of a Dataset or of an archive, its steps in units of the state.

        Raises `InputError` for damaged attributes.
        """
        as_made(attrs)
        record = object.__new__(cls)
        record.__dict__.update((field.name, attrs[field.name]) for field in fields(cls) if field.name in attrs)
        if attrs.get(FORM) == SI:
            unit = record.body_frame.time_unit
            record.__dict__.update((k, attrs[k] / unit) for k in CLOCKS if attrs.get(k) is not None)
        return record

    @classmethod
    def of_values(cls, **values: Any) -> RunRecord:
        """The record with these attributes, each of its type; the constructor needs ten times as long."""
        record = object.__new__(cls)
        record.__dict__.update(DEFAULTS | values)
        return record

    @classmethod
    def of(cls, run: Any, *attributes: str, rows: bool = True) -> RunRecord:
        """The record of a Dataset, which is checked by `a_run`."""
        return cls.from_attrs(a_run(run, *attributes, rows=rows).attrs)

    def to_attrs(self) -> dict[str, Any]:
        """The attributes."""
        values = self.__dict__
        return {name: values[name] for name in NAMES if values[name] is not None}

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            raise (AttributeError if name.startswith("_") else InputError)(
                f"expected the attributes of a run, got none named {name}. Usual cause: a sweep, whose lanes are no "
                "runs, an operation of xarray, which drops attributes, or kr.at, which makes no steps."
            )


NAMES = tuple(field.name for field in fields(RunRecord))
DEFAULTS = {field.name: field.default for field in fields(RunRecord) if field.default is not MISSING}


def _an_object(text: str, name: str) -> dict[str, Any]:
    value = parsed(text, f"The attribute {name}")
    if not isinstance(value, dict):
        raise InputError(f"The attribute {name} is damaged: expected an object, got {text[:80]!r}.")
    return value


def as_made(attrs: Mapping[str, Any]) -> Mapping[str, Any]:
    """The attributes of a run themselves.  Raises `InputError` if one has not the type of a run's attribute."""
    wrong = [name for name, kind in OF_A_RUN.items() if name in attrs and not isinstance(attrs[name], kind)]
    if wrong or not 0 < attrs.get("dt", 1.0) < math.inf:
        name = wrong[0] if wrong else "dt"
        raise InputError(
            f"expected the attributes of a run as Kreisel made them, got {name} = {shown(attrs[name])}. Usual cause: "
            "it was set by hand. Give the run as kr.simulate or kr.open_run returned it."
        )
    return attrs


def a_run(run: Any, *attributes: str, rows: bool = True) -> Any:
    """The Dataset of a run itself, with these attributes and, unless `rows` is false, its rows along time in front.

    Raises `InputError` for anything else.
    """
    if not hasattr(run, "data_vars") or not hasattr(run, "attrs"):
        raise InputError(
            f"expected a run, the Dataset of kr.simulate or kr.open_run, got {shown(type(run).__name__)}. "
            "An archive is opened by kr.open_run(path); several motions are the lanes of one run."
        )
    if attributes and "kreisel_measured" in run.attrs:
        raise InputError("expected a run, got a result of units.measured, a plain Dataset. Give the run itself.")
    missing = [name for name in attributes if name not in run.attrs]
    missing += ["time"] if "time" not in run.variables else []
    if missing and "kreisel_sweep" in run.attrs:
        raise InputError(
            f"expected a run, got a sweep, a Dataset of its lanes without {', '.join(missing)}. `kreisel plot "
            "sweep.zarr` draws its summaries, `kreisel view sweep.zarr --lane 7` writes the page of a lane; "
            "kr.simulate with the values of a lane gives its run."
        )
    if missing:
        raise InputError(
            f"expected a run with its times and attributes, got a Dataset without {', '.join(missing)}. Usual cause: "
            "an operation of xarray, which drops attributes; xarray.set_options(keep_attrs=True) keeps them."
        )
    as_made(run.attrs)
    last = [str(name) for name, v in run.variables.items() if "time" in v.dims[1:] or "lane" in v.dims[2:]]
    last = [] if "kreisel_sweep" in run.attrs else last
    if last or (rows and (run["time"].dims != ("time",) or not run.sizes["time"])):
        raise InputError(
            f"expected a run with at least one row, and time, then lane as the first axes, got one with the times "
            f"{run['time'].shape}{' and ' + shown(last) if last else ''}. run.isel(time=[-1]) keeps the axis."
        )
    if rows and not all(math.isfinite(t) for t in run["time"][[0, -1]].values):
        raise InputError("expected a run with finite times, got others.")
    return run


def lanes_of(run: xr.Dataset, frame: BodyFrame) -> Any:
    """The numbers of the lanes of a run, (lanes,), or of its lane; the coordinate may have their names instead."""
    lanes = np.asarray(run["lane"].values)
    if lanes.dtype.kind in "iu" or not frame.lanes:
        return lanes
    numbers = {name: number for number, name in enumerate(frame.lanes)}
    missing = next((name for name in lanes.flat if name not in numbers), None)
    if missing is not None:
        raise InputError(f"lane: expected names among {shown(frame.lanes)}, got {shown(missing)}.")
    return np.vectorize(numbers.__getitem__, otypes=[np.int64])(lanes)


def lane_names(run: xr.Dataset) -> list[str]:
    """Names of the lanes of a run; "lane 3" without others."""
    frame = RunRecord.from_attrs(run.attrs).body_frame
    lanes = lanes_of(run, frame).tolist() if "lane" in run.coords else range(run.sizes["lane"])
    return [frame.lanes[k] if frame.lanes else f"lane {k}" for k in lanes]


def frame_of(run: xr.Dataset) -> BodyFrame:
    """Axes and units of the body of a run, of its lanes; `OF_SYSTEM` for another run.  Raises `InputError`."""
    frame = RunRecord.from_attrs(run.attrs).body_frame
    if not frame.differs:
        return frame
    if "lane" not in run.coords:
        raise InputError(
            "expected a run with the coordinate lane, since its bodies differ in axes or units, got one without. Usual "
            "cause: isel(lane=..., drop=True) or reset_coords. run.isel(lane=0) keeps it."
        )
    return frame.of_lanes(lanes_of(run, frame))


# -- kr.cite -----------------------------------------------------------------------------------------


@explained
def cite(what: xr.Dataset | Model | System) -> str:
    """BibTeX of a run: this version of Kreisel, the source of the system, the sources of the method.

    what    a run (`kr.simulate`, `kr.at`, `kr.open_run`), a system, or a system with its parameters (with its default
            method)

    A source that is not in Kreisel's list (for example of a user-defined system) is named in a comment at the end.
    Raises `InputError` for anything else.
    """
    import kreisel

    method: str | None = None
    order: int | tuple[int, ...] | None = None
    if isinstance(what, Model):
        method, version = default_method(what), kreisel.__version__
        references = METHODS[method].references(what.system)
    elif isinstance(what, System):
        references, version = what.source, kreisel.__version__
    else:
        attrs = getattr(what, "attrs", None)
        if isinstance(attrs, Mapping) and "kreisel_measured" in attrs:
            a_run(what, "source")
        if not isinstance(attrs, Mapping) or "kreisel_format" not in attrs:
            raise InputError(f"A run, or a system, was expected, got {type(what).__name__}. Say kr.cite(run).")
        missing = [name for name in ("references", "source", "method") if name not in as_made(attrs)]
        if missing:
            raise InputError(
                f"expected a run with its attributes, got one without {', '.join(missing)}. Give it as kr.simulate or "
                "kr.open_run returned it."
            )
        record = RunRecord.from_attrs(attrs)
        references, version = record.references, record.source.removeprefix("kreisel ")
        method, order = record.method, record.order
    entries = bibliography()
    sources = dict.fromkeys(re.findall(r"([A-Z][\w-]+(?:,? [A-Z][\w-]+)*) (\d{4})", references))
    named = {f"{name.split()[0].strip(',').lower()}{year}": f"{name} {year}" for name, year in sources}
    cited = METHODS[method].cited(order) if method in METHODS else ()
    keys = dict.fromkeys([*(key for key in named if key in entries), *cited])
    unknown = [name for key, name in named.items() if key not in entries]
    comment = [f"% further: {', '.join(unknown)}"] if unknown else []
    return "\n\n".join([SOFTWARE.format(version=version), *(entries[key] for key in keys), *comment])


def bibliography() -> dict[str, str]:
    """The entries of refs.bib by key."""
    text = importlib.resources.files("kreisel").joinpath("refs.bib").read_text(encoding="utf-8")
    return {re.split(r"[{,]", entry)[1]: entry.strip() for entry in re.split(r"\n(?=@)", text) if entry.strip()}
