"""Forces on a body in addition to an integrable motion: a part of the record of a perturbed system."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra.recorded import run
from kreisel.errors import InputError
from kreisel.record.calling import call
from kreisel.record.table import Form, Reader

if TYPE_CHECKING:
    from kreisel.algebra import Array
    from kreisel.record.contract import System
    from kreisel.record.model import Model

TIME = "t"
WITH_WHEELS = "-with-wheels"  # ends the name of a system with wheels and no law
PAIRS = "pairs"
FIRST, SECOND = "1", "2"  # behind the letters of the two bodies of a pair


class Field(NamedTuple):
    """A quantity of the place of a satellite, in space: its name in forces, unit, shape and meaning."""

    symbol: str
    unit: str
    shape: tuple[int, ...]
    meaning: str


FIELDS = {  # of `Perturbation.environment`
    "position": Field("r", "m", (3,), "position of the satellite in space"),
    "velocity": Field("v", "m/s", (3,), "velocity of the satellite in space"),
    "field": Field("B", "T", (3,), "magnetic field at the satellite, in space"),
    "sun": Field("sun", "1", (3,), "direction of the Sun in space"),
    "light": Field("light", "1", (), "fraction of the Sun's disc that is seen from the satellite"),
    "density": Field("density", "kg/m^3", (), "density of the air at the satellite"),
}


@dataclass(frozen=True)
class Force:
    """A function and its arguments: letters of the state, g and t by place, parameters by keyword.

    chooses     whether it chooses values by comparisons: it may have corners and jumps
    tables      the forms of parameters that are tables
    units       times of a table over t, if they differ
    """

    function: Callable[..., Any]
    arguments: tuple[str, ...]
    parameters: tuple[str, ...]
    chooses: bool = False
    tables: Mapping[str, Form] = field(default_factory=dict)
    units: Mapping[str, float] = field(default_factory=dict)

    def named(self, values: Iterable[Any]) -> dict[str, Any]:
        """The parameters by name, with readers of tables in place of their handles."""
        named = dict(zip(self.parameters, values, strict=True))
        readers = {name: Reader(named[name], form) for name, form in self.tables.items()}
        return {name: value if isinstance(value, Reader) else readers.get(name, value) for name, value in named.items()}

    def names(self, letter: str) -> bool:
        """Whether this letter is an argument."""
        return letter in self.arguments


@dataclass(frozen=True)
class Controller:
    """A user-defined law, called at samples; its commands are held from one sample to the next.

    law        a function of sensors, memory and parameters by name, which returns commands and memory by name; None
               for wheels only
    arguments  the names that it needs
    every      time between two samples, in the unit of time of the model
    memory     the values that it keeps: the shape of each, () or (k,)
    commands   the length of each command, in order
    wheels     the number of wheels, whose momenta are a part of the state
    delay      samples until a command is applied
    noise      the sensors that have noise, in order
    limits     the commands that have a limit
    time, momentum   units of the model, s and N m s: sensors, commands and the momenta of wheels are in SI
    """

    law: Callable[..., Any] | None = None
    arguments: tuple[str, ...] = ()
    every: float = np.inf
    memory: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    commands: Mapping[str, int] = field(default_factory=dict)
    wheels: int = 0
    delay: int = 0
    noise: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    time: float = 1.0
    momentum: float = 1.0


def together(*forces: Force | None) -> Force | None:
    """The sum of forces; None without any."""
    present = tuple(force for force in forces if force is not None)  # a tuple: digests of code leave out lists
    if len(present) < 2:
        return present[0] if present else None
    arguments = tuple(dict.fromkeys(name for force in present for name in force.arguments))
    parameters = tuple(dict.fromkeys(name for force in present for name in force.parameters))

    def total(*values: Any, **constants: Any) -> Any:
        by_name = dict(zip(arguments, values, strict=True))
        terms = [
            run(
                f.function, *(by_name[name] for name in f.arguments), **{name: constants[name] for name in f.parameters}
            )
            for f in present
        ]
        return sum(np.asarray(out, dtype=object)[()] for out in terms)

    tables = {name: form for force in present for name, form in force.tables.items()}
    units = {name: unit for force in present for name, unit in force.units.items()}
    return Force(total, arguments, parameters, any(force.chooses for force in present), tables, units)


@dataclass(frozen=True)
class Perturbation:
    """Forces around the motion of the system `base`.

    potential   V: H = H_base + V, of vectors carried by the body, the orientation g and the time t
    torque      the additional rate tau of the momentum, in the frame of the state; an axial vector for n = 3
    force       the rate F of the momentum P of a body that moves through space, a vector in the frame of the body
    friction    (*state, constants) -> rates of the state, which change momenta only and are small, and of the work
    rubbing     the parameters of which one is not 0 if there is friction
    damping     whether there is a parameter `damping`: M' = -damping M in addition, a rate for all axes or one for each
    inertia     whether there is a parameter `inertia`: the principal moments of the body, instead of `base`'s
    coupling    whether there is a parameter `coupling`: K in M.KP, for a body in a fluid in addition to T(M) + V(P)
    corners     constants -> whether forces that choose nothing have corners; else None
    pair        V of two bodies, for each row (i, j) of the parameter `pairs`: lanes are bodies that act on each other.
                Letters of body i end in 1, those of body j in 2
    environment `FIELDS` as functions of t, by name; None for a body without a place
    smooth      constants -> the time in which a polynomial of degree 5 follows these fields
    control     the law that commands actuators; the state then has its memory, its commands and the wheels' momenta
    inner       the order to which the map of `base` is composed for its motion in a splitting; None for the best known
    """

    base: System
    potential: Force | None = None
    torque: Force | None = None
    force: Force | None = None
    friction: Callable[..., Any] | None = None
    rubbing: tuple[str, ...] = ()
    damping: bool = False
    inertia: bool = False
    coupling: bool = False
    corners: Callable[..., bool] | None = None
    pair: Force | None = None
    environment: Force | None = None
    smooth: Callable[..., Any] | None = None
    control: Controller | None = None
    inner: int | None = None

    @property
    def sampled(self) -> bool:
        """Whether a law is called at samples."""
        return self.control is not None and self.control.law is not None

    @property
    def functions(self) -> dict[str, Force]:
        """The forces on one body that are functions."""
        named = {"potential": self.potential, "torque": self.torque, "force": self.force}
        return {label: force for label, force in named.items() if force is not None}

    def names(self, letter: str) -> bool:
        """Whether this letter is an argument of a force."""
        alone = any(force.names(letter) for force in self.functions.values())
        alone = alone or (self.control is not None and letter in ("g", TIME))
        if self.pair is None:
            return alone
        return alone or any(self.pair.names(letter + mark) for mark in ("", FIRST, SECOND))

    def has_corners(self, constants: Mapping[str, Any]) -> bool:
        """Whether the forces may have corners, at which no order is higher than 2."""
        forces = [*self.functions.values(), *([self.pair] if self.pair else [])]
        return any(f.chooses for f in forces) or (self.corners is not None and call(self.corners, (), constants))

    @property
    def loaded(self) -> bool:
        """Whether there are loads without a potential."""
        return self.torque is not None or self.force is not None or self.control is not None

    @property
    def beside(self) -> bool:
        """Whether there are forces other than potentials."""
        return self.loaded or self.rubbed or self.inertia or self.coupling

    @property
    def driven(self) -> bool:
        """Whether the energy changes by work: forces without a potential, or that depend on time."""
        return self.loaded or self.rubbed or self.names(TIME)

    @property
    def rubbed(self) -> bool:
        """Whether momenta are damped."""
        return self.damping or self.friction is not None

    def rubs(self, constants: Mapping[str, Any]) -> bool:
        """Whether there is friction in some lane."""
        return any(bool(np.any(constants[name])) for name in self.rubbing)


def pairs_of(model: Model) -> Array | None:
    """The bodies that act on each other, (pairs, 2); None if the lanes are independent."""
    record = model.system.perturbation
    if record is None or record.pair is None:
        return None
    return np.ascontiguousarray(model.params[PAIRS], dtype=np.int64)


def require_bodies(model: Model, batch: tuple[int, ...]) -> None:
    """Raises `InputError` if the lanes of a run are not the bodies of the pairs."""
    pairs = pairs_of(model)
    if pairs is not None and batch != (pairs.max() + 1,):
        raise InputError(
            f"{model.system.name}: expected a state of {pairs.max() + 1} bodies along a first axis, since pairs has "
            f"the bodies 0 to {pairs.max()}, got {f'axes {batch}' if batch else 'one body'}."
        )
