"""Records from which bodies derive: values that vary from lane to lane, user-defined forces; bodies as lanes."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, hint, shown
from kreisel.forces.body import AXES_OF_LANES, MOTION, UNIT_OF_LANES, in_body, perturbed
from kreisel.physical.control import Control, Wheels, at_the_start, controlled_by
from kreisel.physical.measures import are_diagonals, attitude_quaternion, finite_floats, in_range, si_number
from kreisel.record.body import UPRIGHT, Body, joined, started
from kreisel.record.model import Model, State
from kreisel.record.units import AXES, BODY, BodyFrame, Scale, Scales, one_unit
from kreisel.record.values import is_vector
from kreisel.runs.operations import operations_of

VECTORS = (
    "angular_velocity", "arm", "attitude", "attitude1", "attitude2", "attitude3", "axis", "center_of_buoyancy",
    "center_of_mass", "current", "diameters", "harmonics", "linear_drag", "magnetic_moment", "position", "potential",
    "quadratic_drag", "semi_axes", "sides", "spin", "spin1", "spin2", "spin3", "sun", "torque", "up",
    "velocity",
)  # fmt: skip
MATRICES = {"inertia": 3, "added_mass": 6}  # or their diagonals
PLATES = 3  # axes: plates, a plate, a vector
Arguments = Mapping[str, Any]


class OfLanes(type):
    """The type of bodies: a constructor with an axis of lanes in front of an argument returns an `Ensemble`."""

    def __init__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]):
        super().__init__(name, bases, namespace)
        for key, value in namespace.items():
            if isinstance(value, classmethod):
                setattr(cls, key, classmethod(_of_lanes(value.__func__)))

    @property
    def __signature__(cls) -> inspect.Signature:
        """The arguments of the class, as for `__call__`."""
        full = inspect.signature(cls.__init__)  # type: ignore[misc]
        return full.replace(parameters=list(full.parameters.values())[1:], return_annotation=inspect.Signature.empty)

    def __call__(cls, *values: Any, **named: Any) -> Any:  # noqa: D102 - of the class
        return _created(super().__call__, getattr(cls, "__match_args__", ()), values, named)[0]


def _of_lanes(function: Callable[..., Any]) -> Callable[..., Any]:
    names = list(inspect.signature(function).parameters)[1:]

    @functools.wraps(function)
    def constructor(cls: Any, *values: Any, **named: Any) -> Any:
        body, arguments = _created(functools.partial(function, cls), names, values, named)
        if isinstance(body, cls):
            object.__setattr__(body, "_construction", (cls, function.__name__, arguments))
        return body

    return constructor


def _created(call: Callable[..., Any], names: Sequence[str], values: tuple[Any, ...], named: Arguments) -> Any:
    """call(*values, **named), or the ensemble of its bodies; the arguments by name."""
    arguments = {**dict(zip(names, values, strict=False)), **named}
    lanes = _lanes(arguments) if len(arguments) == len(values) + len(named) else []
    return Ensemble(_call_in_lanes(call, lanes)) if lanes else call(*values, **named), arguments


@explained
class Varied(Body, metaclass=OfLanes):
    """Bodies that are records: their values can vary from lane to lane."""

    def __repr__(self) -> str:
        """The arguments that differ from their defaults, in order."""
        shown_values = [
            f"{name}={value.tolist() if isinstance(value, np.ndarray) else value!r}"
            for name, p in inspect.signature(type(self)).parameters.items()
            if (value := getattr(self, name)) is not p.default and not np.array_equal(value, p.default)
        ]
        return f"{type(self).__name__}({', '.join(shown_values)})"

    def dt(self, duration: Any) -> float:
        """A duration, s, in the unit of time of the scaled system.  Raises `InputError`."""
        return float(in_range("dt", lambda: si_number(duration, "s", "dt") / self._body_frame.time_unit))

    def orientation(self, attitude: Any = UPRIGHT) -> Array:
        """The `orientation` of the axes of the scaled system for `kr.simulate`, from the attitude of the body axes.

        Both are unit quaternions (..., 4) = (w, x, y, z), body to space.  Raises `InputError`.
        """
        return algebra.quaternion_product(attitude_quaternion(attitude, "attitude"), self._body_frame.quaternion)

    def attitude(self, g: Any) -> Array:
        """The inverse of `orientation`: the attitude of the body axes (..., 4) from the orientation g of a run.

        An array is read as g of a state; results of `kreisel.analysis` already refer to the body axes.
        """
        q = attitude_quaternion(g, "g")
        return q if getattr(g, "attrs", {}).get(AXES) == BODY else self._body_frame.attitude(q)

    def scales(self) -> Scales:
        """The units of the variables of a run of `model()`, for `kreisel.units.measured`."""
        return {name: Scale(unit, size) for name, (unit, size) in self._body_frame.units.items()}

    @cached_property
    def _body_frame(self) -> BodyFrame:
        return self.model().body_frame

    _construction: tuple[Any, ...] = ()  # a class, its method and the arguments, from which the body was created

    def _varied(self, changes: Sequence[Mapping[str, Any]]) -> Body:
        """The bodies with changed arguments, such as "mass" or "orbit.inclination", as lanes.  Raises `InputError`."""
        owner, method, arguments = self._construction or (type(self), "", _table(self))
        call = getattr(owner, method) if method else owner
        usual = {name: p.default for name, p in inspect.signature(call).parameters.items() if p.default is not p.empty}
        arguments = usual | arguments
        return Ensemble(
            _call_in_lanes(
                lambda changes: call(**_replaced(arguments, changes, "body")), [{"changes": c} for c in changes]
            )
        )


def _replaced(record: Any, changes: Mapping[str, Any], path: str) -> Any:
    """A record, or a dict, with values changed by functions of them, by name."""
    inner: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        first, _, remainder = name.partition(".")
        inner.setdefault(first, {})[remainder] = value
    table = dict(record) if isinstance(record, Mapping) else _table(record)
    for name, change in inner.items():
        if name not in table and (path != "body" or "" not in change):
            raise InputError(f"{path}.{name}: expected one of {', '.join(table)}.{hint(name, table)}")
        table[name] = change[""](table.get(name)) if "" in change else _replaced(table[name], change, f"{path}.{name}")
    return table if isinstance(record, Mapping) else type(record)(**table)


def _table(record: Any) -> dict[str, Any]:
    """The arguments of a record."""
    return {f.name: getattr(record, f.name) for f in fields(record) if f.init} if is_dataclass(record) else {}


@explained
class Ensemble(Body):
    """Bodies of one kind, each with separate values, orbit and parameters of forces: the lanes of a run.

        many = Satellite(inertia, orbit, magnetic_moment=moments)  # moments (lanes, 3)
        run = kr.simulate(many, many.state(spin), dt="10 s", t_end="1 day")

    A body with an axis of lanes in front of any of its arguments is an ensemble; `Ensemble(bodies)` joins a list.
    `many[lane]` is a body; values of the bodies, such as `many.mass`, are arrays (lanes, ...).  The unit of time of the
    scaled system is lane 0's.

    names   of the lanes, the coordinate `lane` of a run

    Raises `InputError` with the lane for a body that cannot be, and for bodies whose systems or functions differ.
    """

    def __init__(self, bodies: Sequence[Any], names: Sequence[str] | None = None):
        self.bodies = tuple(bodies)
        if not self.bodies or not all(isinstance(body, Body) for body in self.bodies):
            raise InputError(f"Ensemble: expected a list of bodies of kr.physical, got {shown(bodies)}.")
        first = type(self.bodies[0])
        for lane, body in enumerate(self.bodies):
            if not isinstance(body, first) and not issubclass(first, type(body)):
                raise InputError(f"Lane {lane}: expected a {first.__name__} as in lane 0, got a {type(body).__name__}.")
        self.names = () if names is None else tuple(names)
        texts = {name for name in self.names if isinstance(name, str) and name}
        if self.names and not len(texts) == len(self.names) == len(self.bodies):
            raise InputError(f"names: expected {len(self.bodies)} different names, one a lane, got {shown(names)}.")
        self._joined()

    def __len__(self) -> int:
        return len(self.bodies)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.bodies)

    def __getitem__(self, lane: int) -> Any:
        return self.bodies[lane]

    def __repr__(self) -> str:
        return f"Ensemble of {len(self.bodies)}, the first {self.bodies[0]!r}"

    def __getattr__(self, name: str) -> Any:
        bodies = () if name.startswith("_") else self.__dict__.get("bodies", ())
        if not bodies or not hasattr(bodies[0], name):
            raise AttributeError(f"an ensemble has no {name!r}")
        values = [getattr(body, name) for body in bodies]
        if callable(values[0]) and not isinstance(values[0], Body):
            raise AttributeError(f"{name} belongs to one body: many[lane].{name}(...)")  # noqa: TRY004
        return np.stack(values) if isinstance(values[0], float | int | np.ndarray) else values

    def model(self) -> Model:
        """The common system, with the parameters of each lane."""
        return self._model

    def dt(self, duration: Any) -> float:
        """A duration, s, in the common unit of time of the scaled systems.  Raises `InputError`."""
        return float(self.members[0].dt(duration))

    def scales(self) -> Scales:
        """The units of the variables of the scaled systems.  Raises `InputError` if they differ."""
        if self._model.body_frame.differs:
            raise InputError("scales: expected bodies with equal units, got others: many[lane].scales().")
        return self.members[0].scales()

    def _joined(self) -> None:
        """The bodies as lanes, with a common unit of time, and their model."""
        for differ in (False, True):
            distinct = {
                id(body): body._as_lane(self.bodies, differ) for body in {id(b): b for b in self.bodies}.values()
            }
            self.members = [distinct[id(body)] for body in self.bodies]
            models = _call_in_lanes(lambda body: body.model(), [{"body": body} for body in self.members])
            first, frames = models[0], [model.body_frame for model in models]
            alike = len({model.system.name for model in models}) == 1 and all(f.is_like(frames[0]) for f in frames)
            if alike and len({tuple(v.shape for v in model.params.values()) for model in models}) == 1:
                break
        for lane, (body, model) in enumerate(zip(self.members, models, strict=True)):
            if model.system.name != first.system.name:
                raise InputError(f"Lane {lane}: expected the system {first.system.name}, got {model.system.name}.")
            if _functions(body) != _functions(self.members[0]) and operations_of(model) != operations_of(first):
                raise InputError(
                    f"Lane {lane}: expected the functions of lane 0, which act in all lanes, got others. Numbers that "
                    "differ are params={...} of forces, parameters={...} of a Control; its every and delay are common."
                )
        params = {}
        for p in first.system.parameters:
            values = [model.params[p.letter] for model in models]
            unequal = next((k for k, value in enumerate(values) if not np.array_equal(value, values[0])), None)
            if unequal is not None and (p.axes is None or values[unequal].shape != values[0].shape):
                raise InputError(
                    f"Lane {unequal}: expected {p.letter} as in lane 0, of shape {values[0].shape}, got others."
                )
            params[p.letter] = values[0] if unequal is None else np.stack(values)
        frame, letters = frames[0], first.system.space.letters
        units, axes = dict(frame.units), np.stack([lane_frame.axes for lane_frame in frames])
        for name, (unit, size) in frame.units.items():
            sizes = np.array([lane_frame.size(name) for lane_frame in frames])
            if (sizes != size).any():  # of vectors (lanes, 1)
                units[name] = unit, sizes[:, None] if name in letters else sizes
        axes = axes if (axes != frame.axes).any() else frame.axes
        epoch = frame.epoch if all(lane_frame.epoch == frame.epoch for lane_frame in frames) else ""
        self._model = Model(first.system, params, replace(frame, axes=axes, units=units, epoch=epoch, lanes=self.names))

    def _doubts(self, seconds: float) -> Sequence[str]:
        return next((result for body in self.bodies if (result := body._doubts(seconds))), ())

    def state(self, *args: Any, **kwargs: Any) -> State:
        """The states of the bodies; an argument with an axis of lanes in front has a value for each."""
        names = list(inspect.signature(self.bodies[0].state).parameters)
        arguments = dict(zip(names, args, strict=False)) | kwargs
        scalars = ("spin",) if "tilt" in names or arguments.get("axis") is not None else ()
        lanes = _lanes(arguments, scalars) or [arguments] * len(self)
        if len(lanes) != len(self) or len(arguments) < len(args) + len(kwargs):
            raise InputError(
                f"state: expected one value for all, or one for each of {len(self)} lanes, got {len(lanes)}."
            )
        several = [{"body": body, "values": values} for body, values in zip(self.members, lanes, strict=True)]
        states = _call_in_lanes(lambda body, values: body.state(**values), several)
        return joined(self._model, states)

    @property
    def words(self) -> dict[str, str]:
        """The names of the variables of a run in SI, by the letters of the state."""
        return self.bodies[0].words

    @property
    def title(self) -> str:
        """The name of the bodies in the title of their runs."""
        return f"{len(self)} of {self.bodies[0].title}"

    @property
    def _shape(self) -> tuple[Any, ...]:  # type: ignore[override]
        """The shape of all bodies, or its kind if their half lengths differ."""
        shapes = {body._shape for body in self.bodies}
        kinds = {shape[:1] for shape in shapes}
        return next(iter(shapes if len(shapes) == 1 else kinds)) if len(kinds) == 1 else ()


def _functions(body: Any) -> tuple[Any, ...]:
    """The functions of a body and their attributes: bodies with equal ones share their operations."""
    control, torque = getattr(body, "control", None), getattr(body, "torque", None)
    out = () if control is None else (control.law, control.every, control.delay, *control.noise, *control.limits)
    if control is not None or getattr(body, "wheels", None) is not None:  # whose units are common to all lanes
        out += (getattr(body, "time_unit", 1.0), getattr(body, "momentum_unit", 1.0))
    steady = None if isinstance(torque, np.ndarray) else torque
    return (*out, steady, getattr(body, "potential", None), getattr(body, "damping", None) is None)


def _call_in_lanes(call: Callable[..., Any], lanes: Sequence[Arguments]) -> list[Any]:
    """call(**arguments) of each lane, once for the same objects.  Raises `InputError` with the lane."""
    out, results = [], dict[tuple[int, ...], Any]()
    for lane, arguments in enumerate(lanes):
        key = tuple(map(id, arguments.values()))
        try:
            if key not in results:
                results[key] = call(**arguments)
            out.append(results[key])
        except InputError as error:
            if "has no argument" in str(error):  # in any lane
                raise
            raise InputError(f"Lane {lane}: {error}") from error
    return out


def _lanes(arguments: Arguments, scalars: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The arguments of each lane; none if no argument has an axis of lanes.  Raises `InputError`."""
    arguments = {name: algebra.lanes_in_front(value) for name, value in arguments.items()}
    counts = {name: _count(name, value, scalars) for name, value in arguments.items()}
    counts = {name: count for name, count in counts.items() if count}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{count} of {name}" for name, count in counts.items())
        raise InputError(
            f"expected one value for all lanes, or one for each, got values for different lanes: {listed}."
        )
    return [
        {name: _at(value, lane, count, name in counts) for name, value in arguments.items()}
        for count in set(counts.values())
        for lane in range(count)
    ]


def _count(name: str, value: Any, scalars: Sequence[str]) -> int:
    """The number of lanes of an argument; 0 for a value without such an axis."""
    axes, single = _axes(value), int(name in (*VECTORS, *MATRICES) and name not in scalars)
    if not axes:
        return 0
    value = value[0] if one_unit(value) else value
    count = len(value)
    if name in MATRICES and axes > 1:
        single = 2 if axes > 2 or (count == MATRICES[name] and not (name == "inertia" and are_diagonals(value))) else 1
    elif name == "plates":
        single = PLATES
    elif name == "damping":
        single = int(is_vector(value, 3))
    return count if axes > single else 0


def _axes(value: Any) -> int:
    """The axes of a value with or without units."""
    if isinstance(value, str | Mapping):
        return 0
    if isinstance(value, list | tuple):
        return _axes(value[0]) if one_unit(value) else 1 + max(map(_axes, value), default=0)
    return int(np.ndim(getattr(value, "magnitude", value)))


def _at(value: Any, lane: int, count: int, has_lanes: bool) -> Any:
    """The value of an argument in a lane: of `params`, each that has lanes."""
    if has_lanes:
        return (value[0][lane], value[1]) if one_unit(value) else value[lane]
    if not isinstance(value, Mapping):
        return value
    out = dict(value)
    for name, entry in value.items():
        shape = () if callable(entry) else np.shape(entry)
        if shape[:1] == (count,) and (len(shape) > 1 or not is_vector(entry, 3)):
            out[name] = np.reshape(entry, (count, *(() if shape[1:] == (1,) else shape[1:])))[lane]
    return out


# -- user-defined forces ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Forced(Varied):
    """User-defined forces on a body, in SI, along the axes in which it was given.

    torque      a function, N m (3,), of quantities by name: momentum M, angular velocity Omega, orientation g (a
                matrix, body to space), time t, s; for a satellite also its position r and velocity v, the field B and
                its rate along the orbit, B_rate, the direction of the Sun, all along the body axes, light (0 to 1) and
                density; or a list of functions, whose sum acts
    potential   a function, J, of the same without M and Omega; its torque is derived from it
    damping     gamma in M' = -gamma M, 1/s: one value, or one for each axis
    params      further arguments of the functions by name, each with or without an axis of lanes
    wheels      `Wheels(axes, momenta=...)`, whose momenta are a part of the state; of a `FreeBody` or a satellite
    control     a `kr.Control`, compiled with the steps; its memory and its commands are a part of the state
    """

    torque: Any = None
    potential: Any = None
    damping: Any = None
    params: Mapping[str, Any] | None = None
    wheels: Wheels | None = None
    control: Control | None = None
    steady: ClassVar[bool] = False  # whether `torque` may be a vector

    @property
    def forced_by(self) -> bool:
        """Whether there are user-defined forces, wheels or a controller."""
        return self._by_functions or self.wheels is not None or self.control is not None

    @property
    def _by_functions(self) -> bool:
        by_torque = by_functions(self.torque) if self.steady else self.torque is not None
        return by_torque or self.potential is not None or self.damping is not None

    def forced(self, model: Model, quantities: tuple[str, ...] = MOTION) -> Model:
        """The model of the body with these forces, functions of these quantities.  Raises `InputError`."""
        if not self.forced_by:
            return model
        if "_forced" not in self.__dict__:
            for name, kind in (("wheels", Wheels), ("control", Control)):
                if not isinstance(value := getattr(self, name), kind | None):
                    arguments = ", ".join(f"{field.name}=..." for field in fields(kind))
                    raise InputError(f"{name}: expected kr.physical.{kind.__name__}({arguments}), got {shown(value)}.")
            model = self._with_functions(model, quantities) if self._by_functions else model
            if self.control is not None or self.wheels is not None:
                model = controlled_by(model, self.control, self.wheels)
            object.__setattr__(self, "_forced", model)
        return self.__dict__["_forced"]

    def _started(self, orientation: Array, M: Array, **components: Any) -> State:
        """The state with the momentum M (..., 3), and with wheels, memory and commands at the start."""
        model = self.model()
        carried = at_the_start(model, self.control, self.wheels, M.size // 3)
        M = M if M.ndim == 1 else algebra.hat(M)  # 3 x 3 values may be one matrix or three vectors
        return started(model, orientation, **{model.system.space.letters[0]: M}, **components, **carried)

    def _with_functions(self, model: Model, quantities: tuple[str, ...]) -> Model:
        params = {} if self.params is None else self.params
        if not isinstance(params, Mapping):
            raise InputError(f"params: expected a dict of names and values, got {shown(params)}.")
        if taken := [name for name in params if name in quantities]:
            raise InputError(f"params: expected names other than {', '.join(quantities)}, got {shown(taken[0])}.")
        axes = model.body_frame
        turn, momentum = axes.axes, axes.size(model.system.space.letters[0])
        frame: dict[str, Any] = {"axes": turn, "time": axes.time_unit, "momentum": momentum}
        if self._lanes:
            params = {**params, **dict(zip(AXES_OF_LANES, turn.T, strict=True)), UNIT_OF_LANES: momentum}
            frame |= {"axes": None, "momentum": None}
        still = tuple(name for name in quantities if name not in ("M", "Omega"))
        damping = None if self.damping is None else finite_floats(self.damping, "1/s", "damping") * axes.time_unit
        if damping is not None and damping.shape[-1:] == (3,) and axes.turned:
            raise InputError(
                "damping: expected one rate for a body in other than principal axes, got three. Give rates of the axes "
                "as torque=lambda Omega: -D @ Omega."
            )
        function = None if isinstance(self.torque, np.ndarray) else self.torque
        units = {**axes.units, **dict.fromkeys(("work", "balance"), axes.units["energy"])}
        return perturbed(
            model.of_body(replace(axes, units=units)),
            torque=in_body("torque", function, params, quantities, **frame),
            potential=in_body("potential", self.potential, params, still, **frame),
            damping=damping,
            params=params,
        )


def by_functions(torque: Any) -> bool:
    """Whether a torque is a function, or a list of functions."""
    return callable(torque) or (isinstance(torque, list | tuple) and any(map(callable, torque)))
