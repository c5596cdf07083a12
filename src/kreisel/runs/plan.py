"""Plans from a model, a state and settings: checks, scheme, layout, and the engine that carries them out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, shown
from kreisel.graph.machine import Chain
from kreisel.graph.recording import STRAIGHT_LINE_N
from kreisel.kernels.cpu import CpuEngine, point_links, points, row_function
from kreisel.kernels.engines import Engine, Rows, corrections, engine_of
from kreisel.kernels.layout import Floats
from kreisel.method import Outcome, Scheme, default_method
from kreisel.method.scheme import ORIENTATION, Flow, Orbits, with_orientation
from kreisel.process import spent_on
from kreisel.record.model import Model, State
from kreisel.record.perturbation import require_bodies
from kreisel.record.values import common_batch
from kreisel.runs.settings import LARGE, MOST_STEPS, WHOLE, Event, Settings, count_of_rows, initial_orientation

if TYPE_CHECKING:
    from kreisel.kernels.cpu import RowFunction
    from kreisel.kernels.large.forms import LargeForm
    from kreisel.record.model import OrientationLike

TIMES = "times"  # the times of the rows, next to the state in `Plan.start`
BREAKS = "breaks/"  # prefixes of the names of impulses and events in a snapshot
FEW = 64  # entries
COMPUTED = ("constants", "stages", "basis")  # constants of a scheme
NOT_CONSERVED = (  # the usual cause, and the fix
    "a step far too long for this state, a state far smaller than a parameter or next to an equilibrium, moments of "
    "very different sizes, or a map or an integral that contradicts its record. Use a smaller dt, or for such a state "
    "or such moments method='dop853', tol=1e-13."
)


@dataclass
class Plan:
    """A run about to start, as data; `engine` makes its steps."""

    model: Model
    scheme: Scheme
    settings: Settings
    first: Floats  # the start (lanes, d) in the method's variables
    batched: bool
    start: Mapping[str, Floats]  # the state at time 0 as given by the user, the orientation, and the times of rows
    general: Scheme | None = None  # the scheme without the constants of the trajectories
    large: LargeForm | None = None  # of the kernel of engine="large"
    events: tuple[Event, ...] = ()
    lost: frozenset[str] = frozenset()  # integrals that the method conserves and impulses or events change
    end: tuple[int, float] | None = None  # rows, and the time of the last, of a run that an event stopped
    fired: list[tuple[float, int]] = field(default_factory=list)  # the times and indices of past events

    @property
    def dt(self) -> float:
        """The step."""
        return self.settings.dt

    @property
    def steps(self) -> int:
        """The number of steps of the run."""
        return self.settings.steps

    @property
    def every(self) -> int:
        """The steps from one saved row to the next."""
        return self.settings.every

    @cached_property
    def outcomes(self) -> dict[str, Outcome]:
        """The computed variables, each with its description."""
        chosen = self.settings.observe
        return {
            name: replace(outcome, conserved=False) if name in self.lost else outcome
            for name, outcome in self.scheme.outcomes.items()
            if chosen is None or name in chosen or outcome.kind in ("state", "orientation")
        }

    @property
    def broken(self) -> bool:
        """Whether steps are broken: by impulses or events."""
        return bool(self.settings.impulses or self.events)

    @cached_property
    def times(self) -> Floats | None:
        """The times of the rows, if they were given."""
        return None if self.settings.times is None else np.array(self.settings.times)

    @cached_property
    def _places(self) -> tuple[list[int], list[float]]:
        """Steps before each row at a given time, and the time after the last of these steps."""
        times = np.array(self.settings.times)
        steps = np.floor(times / self.dt * (1 + WHOLE))
        within = times - steps * self.dt
        return steps.astype(np.int64).tolist(), np.where(within > WHOLE * self.dt, within, 0.0).tolist()

    def step_of(self, row: int) -> int:
        """The steps before a row; 0 before the first."""
        if self.times is None:
            return min(row * self.every, self.steps)
        return self._places[0][min(row, len(self.times) - 1)] if row >= 0 else 0

    def within_step(self, row: int) -> float:
        """The time of a row after its last step."""
        return 0.0 if self.times is None else self._places[1][row]

    def times_of(self, rows: Floats) -> Floats:
        """The times of rows: of the steps 0, every, 2 every, ... and the last, or the given times."""
        if self.times is None:
            result = np.minimum(rows * self.every, self.steps) * self.dt
            result = result + self.settings.t_start if self.settings.t_start else result
        else:
            result = self.times[np.minimum(rows, len(self.times) - 1).astype(int)]
        return result if self.end is None else np.where(rows == self.end[0] - 1, self.end[1], result)

    @property
    def irregular(self) -> bool:
        """Whether rows or steps differ from each `every`-th multiple of dt."""
        return self.settings.times is not None or self.broken

    @property
    def lanes(self) -> int:
        """The number of trajectories that are stepped together."""
        return len(self.first)

    @property
    def where(self) -> str:
        """The name of the engine."""
        return self.settings.engine or ("cpu" if self.large is None else "large")

    @cached_property
    def engine(self) -> Engine:
        """The engine at the start; compiled on first use.  Raises `InputError`."""
        return self.engine_at(self.first)

    def engine_at(self, z: Floats) -> Engine:
        """The engine at the state z."""
        with spent_on("kernels"):
            return engine_of(
                self.scheme,
                z.copy(),
                name=self.where,
                dt=self.dt,
                steps=self.steps,
                every=self.every,
                large=self.large,
                project=self.settings.project,
            )

    @property
    def repeatable(self) -> bool:
        """Whether the plan of one trajectory may be begun again; others are not kept, since they may be large."""
        unbroken = not (self.batched or self.irregular or self.large or self.settings.t_start)
        return unbroken and self.general is not None and not self.general.corrector

    @cached_property
    def _renew(self) -> Callable[[], bool] | None:
        """The call that computes the constants of another trajectory in the engine; None if there is none."""
        general, engine = self.general, self.engine
        if general is None or not self.repeatable:
            return None
        if general.trajectory is None and isinstance(general.motion, Orbits):
            return lambda: True
        if not isinstance(engine, CpuEngine) or (general.trajectory and general.point is None):
            return None
        if not general.trajectory:
            return lambda: True
        links = point_links(general, engine, self.dt)
        if links is None:
            return None
        chain, points = Chain(*links), engine.stages[:, :, engine.stages.shape[2] // 2 :]
        of_points = general.links is None  # 0 for a field that is 0, whose cause a new plan states
        return lambda: math.isfinite(chain()) and (not of_points or bool(points.all()))

    def begin(self, model: Model, parts: tuple[Array, ...]) -> bool:
        """Begin again from another state, for rows in memory; false if a plan must be made for it.

        The constants of the trajectory are renewed in the engine, but not in `scheme`.
        """
        z = algebra.flatten(self.scheme.prepare(parts), self.kinds)
        if self._renew is None or z.ndim > 1:
            return False
        self.model, self.first, self.start, engine = model, z[None], _parts_by_name(model, parts), self.engine
        self.__dict__.pop("example", None)
        if isinstance(self.scheme.motion, Orbits):
            del self.engine
            return True
        engine.z[:] = z
        if not self._renew() or not engine.begin(self.first, self.scheme, MOST_STEPS):
            return False
        if self.general is not self.scheme and self.compiled is not None:
            self.compiled.constants[...] = cast("CpuEngine", engine).constants
        return True

    @property
    def rows(self) -> int:
        """The number of saved rows."""
        if self.end is not None:
            return self.end[0]
        return count_of_rows(self.steps, self.every) if self.times is None else len(self.times)

    @property
    def kinds(self) -> list[str]:
        """The kinds of the components that are stepped."""
        return self.scheme.kinds

    @property
    def computed(self) -> dict[str, Floats]:
        """The constants that steps and outputs use, computed from the parameters and the start.

        LAPACK and libm compute some of them, so that their last bits depend on the processor.  A run that resumes on
        another machine reads them from its checkpoint.
        """
        params = self.model.params
        return {
            f"{group}-{name}": np.array(value, dtype=np.float64)
            for group in COMPUTED
            for name, value in getattr(self.scheme, group).items()
            if name not in params or not np.array_equal(value, self.model.constants[name])
        }

    def adopt(self, computed: Mapping[str, Floats]) -> None:
        """Continue with these values of `computed`, of the same names and shapes."""
        mine = self.computed
        if all(mine[name].tobytes() == value.tobytes() for name, value in computed.items()):
            return
        parts: dict[str, Any] = {group: dict(getattr(self.scheme, group)) for group in COMPUTED}
        for name, value in computed.items():
            group, letter = name.split("-", 1)
            parts[group][letter] = value
        self.scheme = replace(self.scheme, **parts)
        for attribute in ("engine", "compiled", "corrections"):
            self.__dict__.pop(attribute, None)

    def observe(self, z: Floats) -> dict[str, Array]:
        """Outputs of rows z (rows, lanes, d), without the lane axis if there is only one lane."""
        z = self.corrections[1](z)
        compiled = self.compiled
        return self._shaped(z, self._together(z, self._plainly(z) if compiled is None else compiled.named(z)))

    @cached_property
    def example(self) -> dict[str, Array]:
        """The outputs of the start, in the shapes of `observe` for one row; nothing is compiled for them."""
        with np.errstate(all="ignore"):
            return self._shaped(self.first[None], self._together(self.first[None], self._plainly(self.first[None])))

    def _together(self, z: Floats, outputs: Mapping[str, Array]) -> Mapping[str, Array]:
        """The outputs, and the outputs of all lanes together if lanes act on each other."""
        if self.scheme.coupling is None or self.settings.observe == ():
            return outputs
        result = self.scheme.coupling.together(outputs, algebra.restore(z, self.kinds, self.model.n))
        return {name: result[name] for name in self.outcomes}

    def _plainly(self, z: Floats) -> dict[str, Array]:
        return self.variables(algebra.restore(z, self.kinds, self.model.n), **self.scheme.keywords)

    def _shaped(self, z: Floats, outputs: Mapping[str, Array]) -> dict[str, Array]:
        out = {}
        for name, value in outputs.items():
            if value.shape[:2] != z.shape[:2]:
                value = np.broadcast_to(value, (*z.shape[:2], *value.shape[2:]))
            out[name] = value if self.batched else value[:, 0]
        return out

    @cached_property
    def corrections(self) -> tuple[Rows, Rows]:
        """Maps of rows (rows, lanes, d): from prepared to stepped variables, and from stepped to observed variables."""
        return corrections(self.scheme)

    def variables(self, parts: tuple[Array, ...], /, **constants: Array) -> dict[str, Array]:
        """The observed variables of a state in the method's variables."""
        alone = self.scheme.coupling is None or self.settings.observe == ()
        outputs = self.scheme.observe(parts, self.settings.observe if alone else None, **constants)
        chosen = self.outcomes if alone else self.scheme.outcomes
        return {
            name: algebra.KINDS[outcome.axes].for_user(outputs[name]) if outcome.axes else outputs[name]
            for name, outcome in chosen.items()
            if name in outputs
        }

    @cached_property
    def compiled(self) -> RowFunction | None:
        """`variables` in a kernel; independent of the number of rows, so a longer run has the same bits."""
        if isinstance(self.scheme.motion, Flow) or not self.scheme.recordable:
            return None
        with spent_on("kernels"):
            return row_function(self.scheme, self.variables, self.lanes, ("observe", self.settings.observe))


def default(model: Model, settings: Settings) -> str:
    """The default method: one that makes steps if an order, or an engine for steps, is requested."""
    return default_method(model, stepped=settings.order is not None or settings.engine not in (None, "cpu"))


def planned(model: Model, scheme: Scheme, settings: Settings, parts: tuple[Array, ...], engine: str | None) -> Plan:
    """The plan of a scheme from these components of the state, by the requested engine or the engine for n."""
    general, (scheme, start, large) = scheme, _lanes(model, scheme, parts, engine)
    if settings.t_start:
        from kreisel.forces.control import require_whole_samples

        require_whole_samples(model, settings.dt, settings.t_start)
        scheme.set_clock(start, settings.t_start, settings.dt)
    back, _ = corrections(scheme)
    return Plan(
        model=model,
        scheme=scheme,
        settings=settings,
        first=back(start.reshape(1, -1, start.shape[-1]))[0],
        batched=start.ndim > 1,
        start=_parts_by_name(model, parts) | ({} if settings.times is None else {TIMES: np.array(settings.times)}),
        general=general,
        large=large,
    )


def initial_parts(model: Model, state: State, orientation: OrientationLike | None) -> tuple[Array, ...]:
    """The components of the initial state, and the checked orientation, if any."""
    parts: tuple[Array, ...] = tuple(state[letter] for letter in model.system.space.letters)
    return parts if orientation is None else (*parts, initial_orientation(orientation, model))


def _parts_by_name(model: Model, parts: tuple[Array, ...]) -> dict[str, Array]:
    return dict(zip((*model.system.space.letters, ORIENTATION), parts, strict=False))


def _lanes(
    model: Model, plan: Scheme, parts: tuple[Array, ...], engine: str | None
) -> tuple[Scheme, Floats, LargeForm | None]:
    """The scheme with its constants of the trajectories, the prepared start (d,) or (lanes, d), and its large form.

    The batch axes of states and parameters become one.  With engine="large", or with None if that engine is known and
    faster, scheme and start are in its form and form has its name.
    """
    count = len(model.system.space.letters)
    components = with_orientation(model, len(parts) > count)
    kinds = zip(parts, components, strict=True)
    batches = {letter: z.shape[: z.ndim - algebra.KINDS[kind].axes] for z, (letter, kind) in kinds}
    batch = common_batch("parameters and state", {"parameters": model.batch, **batches})
    if 0 in batch:
        raise InputError("At least one lane was expected, got a batch of none. Check how the batch was made.")
    if len(batch) > 1:
        raise InputError(f"One batch axis (lanes) was expected, got axes {batch}. Reshape the batch to one axis.")
    require_bodies(model, batch)
    spread = tuple(
        np.array(p if b == batch else np.broadcast_to(p, batch + p.shape[len(b) :]), dtype=np.float64)
        for p, b in zip(parts, batches.values(), strict=True)
    )
    plan, large = plan.on(spread, points), None
    if engine == "large" or (engine is None and plan.n >= LARGE):
        from kreisel.kernels.large.forms import LEAST_N, form_of

        large = form_of(plan)
        if engine is None and large is not None and large.dense and plan.n <= STRAIGHT_LINE_N:
            large = None  # n^2 entries of a momentum and its inverse: two to five times as long
        if large is None and engine is not None:
            raise InputError(
                f"No kernel of O(n) or O(n^2) a step of method={shown(plan.name)} is known for this system, n = "
                f"{plan.n}. engine='large' needs n >= {LEAST_N}, and one of these: momenta that change along one "
                "constant vector other than 0; only vectors; one momentum and a single real stage. It carries an "
                "orientation in the first case only, with method='suris'. Leave engine out."
            )
        plan = plan if large is None else large.on(plan, spread)
    return plan, np.asarray(algebra.flatten(plan.prepare(spread), plan.kinds)), large


# -- faults of rows --------------------------------------------------------------------------------


class Fault(NamedTuple):
    """Rows that violate a promise of a method, and the reason.

    good   (rows, lanes): which rows are good; the last row is the state of the engine
    text   the fault in words
    cause  the usual cause and the fix; "" for values that are not finite
    seen   whether the rows show it: it is then at the first bad row or before, else before
    """

    good: Array
    text: str
    cause: str
    seen: bool = True


def faults(scheme: Scheme, engine: Engine, rows: Floats, dt: float) -> Iterator[Fault]:
    """The faults of rows (rows, lanes, d) and of the state of the engine, in this order: see `Fault`."""
    good = None if is_finite(rows) and is_finite(engine.z) else _good(rows, engine.z, np.isfinite)
    if good is not None:
        yield Fault(good, "The state is no longer finite", "")
    guard, projection = scheme.guard, engine.projection
    if guard is not None and guard.component:
        good = _good(rows, engine.z, lambda z: scheme.guarded(algebra.restore(z, scheme.kinds, scheme.n)))
        if good is not None:
            yield Fault(good, guard.fault, guard.cause)
    if projection is not None and projection.worst.any():
        with np.errstate(all="ignore"):
            beyond = projection.beyond(dt * abs(engine.z).max(-1))
        if beyond.any():
            name = projection.labels[int(np.where(beyond, projection.worst, 0).max(0).argmax())]
            yield Fault(
                np.broadcast_to(~beyond.any(-1), (len(rows) + 1, len(engine.z))),
                f"{name} is not conserved, although the method conserves it",
                f"{NOT_CONSERVED} project=False (--no-project) shows the map without projection.",
                seen=False,
            )


def is_finite(x: Floats) -> bool:
    """Whether all entries are finite."""
    if x.size < FEW and math.isfinite(sum(x.ravel().tolist())):  # a tenth of the time of NumPy's sum
        return True
    with np.errstate(all="ignore"):  # the sum of finite entries may overflow
        return math.isfinite(np.add.reduce(x, None)) or bool(np.isfinite(x).all())


def _good(rows: Floats, z: Floats, holds: Callable[[Floats], Array]) -> Array | None:
    """The rows and lanes that are good; None if all are, which is decided without a copy."""
    of_rows, of_state = holds(rows), holds(z)
    if of_rows.all() and of_state.all():
        return None
    good = np.concatenate([np.broadcast_to(x, (len(x), len(z), *x.shape[2:])) for x in (of_rows, of_state[None])])
    return good.reshape((len(rows) + 1, len(z), -1)).all(-1)
