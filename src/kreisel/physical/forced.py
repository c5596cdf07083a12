"""Bodies with user-defined forces in addition to the built-in ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, cross
from kreisel.errors import InputError, explained, shown
from kreisel.forces.body import AXES_OF_LANES, MOTION, UNIT_OF_LANES, in_body, perturbed
from kreisel.physical.control import Control, Wheels, at_the_start, controlled_by
from kreisel.physical.ensemble import Varied
from kreisel.physical.measures import finite_floats, si_numbers
from kreisel.record.body import started
from kreisel.record.model import Model, State
from kreisel.record.values import CLOSE


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


@explained
@dataclass(frozen=True, eq=False)
class EddyCurrents:
    """The torque of eddy currents in a conducting body, `torque=` of a `Satellite`: (T (Omega x B - B_rate)) x B.

    tensor     T, S m^4, (3, 3) along the body axes, its diagonal, or one value; B_rate is the rate of the field along
               the orbit, in space

    [N. Ortiz Gomez, S. J. I. Walker, Acta Astronautica 114 (2015) 34; L. B. M. Sagnieres, thesis, McGill University,
    2018, equation 2.20]
    """

    tensor: Any

    def __post_init__(self) -> None:
        value = si_numbers(self.tensor, "S m^4", "tensor", ((), (3,), (3, 3)))
        tensor = value * np.eye(3) if value.ndim < 2 else value
        if abs(tensor - tensor.T).max() > CLOSE * abs(tensor).max() or np.linalg.eigvalsh(tensor)[0] < 0:
            raise InputError(f"tensor: expected a symmetric matrix with eigenvalues >= 0, got {shown(self.tensor)}.")
        object.__setattr__(self, "tensor", tensor)

    def __call__(self, Omega: Any, B: Any, B_rate: Any) -> Any:
        """The torque (3,), N m."""
        return cross(self.tensor @ (cross(Omega, B) - B_rate), B)
