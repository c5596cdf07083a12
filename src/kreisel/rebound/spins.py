"""Spin and orientation of particles of a REBOUND simulation, split symmetrically from its integrator.

A step of the length h is K(h/2) (N(h) and the free rotation, exactly) K(h/2), N a step of REBOUND and K the interaction
of each body with the masses of the other particles: order 2.  K changes the velocities of both and the spin by the
gradient of one potential and conserves linear and angular momentum to rounding; the spin angular momentum is stored.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, hint, on_disk, shown
from kreisel.files import place
from kreisel.physical.free_body import FreeBody
from kreisel.physical.measures import RATE, si_numbers
from kreisel.process import scratch
from kreisel.rebound import compiled
from kreisel.rebound.compiled import COLUMNS, is_ball
from kreisel.rebound.interaction import potential
from kreisel.record.body import UPRIGHT
from kreisel.runs.settings import MOST_STEPS

# -- REBOUND, loaded when it is needed -------------------------------------------------------------


OFFSETS = {"x": 0, "y": 8, "z": 16, "vx": 24, "vy": 32, "vz": 40, "m": 72}  # bytes, of a particle


@cache
def rebound() -> ModuleType:
    """The module.  Raises `InputError` if it is not installed or stores its particles in another way."""
    try:
        import rebound as library
    except ImportError as error:
        raise InputError("expected REBOUND, got none. Install it: pip install 'kreisel[rebound]'.") from error
    offsets = {name: getattr(library.Particle, name).offset for name in OFFSETS}
    if offsets != OFFSETS:
        raise InputError(
            f"expected REBOUND 5, whose particles begin with x, v, a, m, got {library.__version__}. Usual cause: "
            "another version than the one that kreisel[rebound] asks for."
        )
    return library


# -- bodies ----------------------------------------------------------------------------------------


@explained
@dataclass(frozen=True, eq=False)
class Body:
    """An extended body, in the units of the simulation.

    inertia      moments of inertia about the centre of mass: one value for a ball, (3,) along the principal axes, or a
                 tensor (3, 3) in any body axes; or a body of `kreisel.physical` if the simulation is in SI units
    spin         angular velocity (3,) in the frame of the simulation
    orientation  unit quaternion (w, x, y, z), body axes to the frame of the simulation
    love         potential Love number k_2 of the tides; a ball is a fluid that its rotation flattens with the same k_2
    radius       R, for tides; default: the radius of the particle
    lag          time lag of the tides

    Bodies other than balls keep their figure, which the moments determine.  In REBOUNDx, `tau` of `tides_spin` is half
    the lag.  Raises `InputError` for impossible moments of inertia.
    """

    inertia: Any
    spin: Any = (0.0, 0.0, 0.0)
    orientation: Any = UPRIGHT
    love: float = 0.0
    radius: float | None = None
    lag: float = 0.0

    def __post_init__(self) -> None:
        self.state()
        for name in ("love", "lag"):
            self._not_negative(name)

    def principal(self) -> tuple[Array, Array]:
        """The moments (3,), and the orientation of the principal axes.  Raises `InputError`."""
        inertia = getattr(self.inertia, "inertia", self.inertia)
        number = isinstance(inertia, int | float | np.number)
        body = FreeBody(np.full(3, inertia) if number else inertia)
        moments = body.principal.moments
        if moments.min() <= 0:
            raise InputError(
                f"inertia: expected three moments > 0, got {shown(moments.tolist())}. Usual cause: a rod without "
                "thickness, or a point. Give it its thickness, or leave it a particle."
            )
        g = body.orientation(self.orientation)
        if g.shape != (4,):
            raise InputError(f"orientation: expected one unit quaternion (w, x, y, z), got {shown(self.orientation)}.")
        return moments, g

    def angular_velocity(self) -> Array:
        """The angular velocity (3,).  Raises `InputError`."""
        return si_numbers(self.spin, RATE, "spin, an angular velocity in the frame of the simulation,", ((3,),))

    def state(self) -> Array:
        """L and g, (7,)."""
        moments, g = self.principal()
        R = algebra.rotation_matrix(g)
        return np.concatenate([R @ (moments * (R.T @ self.angular_velocity())), g])

    def tides(self, radius: float) -> tuple[float, float, float]:
        """k_2 R^5, again k_2 R^5 for a fluid ball, else 0, and the lag; `radius`: of the particle.

        Raises `InputError`.
        """
        if not isinstance(radius, int | float | np.number):
            raise InputError(f"radius: expected a number, got {shown(radius)}.")
        love, lag = (self._not_negative(name) for name in ("love", "lag"))
        if lag and not love:
            raise InputError(
                f"lag: expected 0 for a body without tides, got {shown(self.lag)}. Usual cause: no love=, the Love "
                "number k_2 of the tides."
            )
        if not love:
            return 0.0, 0.0, 0.0
        size = radius if self.radius is None else self._not_negative("radius")
        if not size > 0:
            raise InputError(
                f"radius: expected a number > 0 for a body with tides, got {shown(self.radius)} and a particle of "
                f"radius {radius}. Usual cause: sim.add(..., r=...) is missing."
            )
        tide = love * size**5
        return tide, tide if is_ball(self.principal()[0]) else 0.0, lag

    def _not_negative(self, name: str) -> float:
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value < math.inf:
            raise InputError(f"{name}: expected a finite number >= 0, got {shown(value)}.")
        return float(value)


# -- the bodies of a simulation --------------------------------------------------------------------


FIXED = ("whfast", "leapfrog", "saba", "mercurius", "trace")  # a step is dt
ADAPTIVE = ("ias15", "bs")
CHUNK = 50_000  # steps between two checks of the result
LATE = 1e-9  # of a step: rounding of the time


@explained
class Spins:
    """The bodies of a simulation `sim`; a result of `attach`.

    dt      the step; with an adaptive integrator the time between two kicks, else the dt of the simulation
    names   the particles that are bodies, as given by the user
    """

    def __init__(self, sim: Any, names: Iterable[int | str], z: Array, c: Array, kick: float | None):
        check_simulation(sim)
        try:
            self.sim, self.names = sim, list(names)
        except TypeError:
            raise InputError(f"Spins: expected names of particles in a list, got {shown(names)}.") from None
        z, c = algebra.floats(z), algebra.floats(c)
        shapes = (len(self.names), 7), (len(self.names), compiled.COLUMNS)
        if (z.shape, c.shape) != shapes or not (np.isfinite(z).all() and np.isfinite(c).all()):
            raise InputError(
                f"Spins: expected finite rows z {shapes[0]} and c {shapes[1]} of the bodies, got {shown(z)}, "
                f"{shown(c)}. kreisel.rebound.attach(sim, bodies) makes them."
            )
        self._index = np.array([index_of(sim, name) for name in self.names], dtype=np.int64)
        self._z, self._c, self._kick = z, c, kick
        self._count = int(sim.N)
        self._dv, self._seen = np.zeros((self._count, 3)), np.full((self._count, 7), np.nan)
        self._check()

    @property
    def dt(self) -> float:
        """The step.  Raises `InputError` unless it is a float other than 0."""
        name = str(self.sim.integrator)
        if name not in (*FIXED, *ADAPTIVE):
            raise InputError(f"sim.integrator: expected one of {', '.join((*FIXED, *ADAPTIVE))}, got {shown(name)}.")
        if (self._kick is None) == (name in ADAPTIVE):
            raise InputError(
                f"dt: expected the time between two kicks with an adaptive integrator, else None and sim.dt, got "
                f"dt={self._kick} with {name}. Usual cause: REBOUND's default integrator is ias15; say "
                "sim.integrator = 'whfast', or attach(..., dt=...)."
            )
        dt = self.sim.dt if self._kick is None else self._kick
        if not is_finite(dt) or dt == 0:
            raise InputError(f"dt: expected a finite number that is not 0, got {shown(dt)}.")
        return float(dt)

    def integrate(self, t: float) -> None:
        """Integrate in steps of dt until the time is t or later, by less than a step.

        Raises `InputError` for a time in the past, `RunError` if particles are lost or a state is no longer finite, and
        the exceptions of `sim.integrate`.
        """
        dt = self.dt
        ahead = (t - self.sim.t) / dt if is_finite(t) else np.nan
        if not ahead >= -LATE:
            raise InputError(
                f"t: expected a time that dt = {dt} leads to from {self.sim.t}, got {shown(t)}. Usual cause: the sign "
                "of dt; set sim.dt = -sim.dt to go back."
            )
        self.steps(max(0, int(np.ceil(ahead - LATE))))

    def steps(self, count: int) -> None:
        """Make `count` steps.  Raises the exceptions of `integrate`."""
        dt = self.dt
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or not 0 <= count <= MOST_STEPS:
            raise InputError(f"count: expected an integer from 0 to {MOST_STEPS:,}, got {shown(count)}.")
        self._check()
        advance = self._by_calls if self._kick is not None else self._compiled
        for first in range(0, count, CHUNK):
            advance(dt, min(CHUNK, count - first))
            self.sim.process_messages()
            self._check_finite()

    def _compiled(self, dt: float, count: int) -> None:
        sim, library = self.sim, rebound().clibrebound
        count_now, modified = self._field("N", np.int64), self._field("did_modify_particles", np.uint32)
        status = self._field("_status", np.int32)
        status[0] = -1  # running
        step = ctypes.cast(library.reb_simulation_steps, ctypes.c_void_p).value
        where = ctypes.addressof(sim)
        with self._jacobi() as q:
            self._seen[:] = np.nan
            fields = count_now, modified.ctypes.data, status.ctypes.data
            rows: Any = *self._arguments(), self._dv, dt, float(sim.G), q, step, where, *fields, count
            turned = compiled.advance(*rows)
        if not turned:
            self._refuse_turns(dt)
        self._check_count()
        if status[0] > 0:
            sim.process_messages()
            raise RunError(
                f"REBOUND stopped at t = {sim.t}: expected to run on, got its status {status[0]}. Usual cause: a "
                "collision, or exit_min_distance or exit_max_distance of the simulation."
            )
        self._seen = self._state()

    def _by_calls(self, dt: float, count: int) -> None:
        G = float(self.sim.G)
        for _ in range(count):
            rows = self._arguments()
            compiled.act_on_all(*rows, self._dv, dt / 2, G, False)
            if not compiled.turn_all(self._z, self._c, dt):
                self._refuse_turns(dt)
            self.sim.did_modify_particles = 1
            self.sim.integrate(self.sim.t + dt)
            self._check_count()
            compiled.act_on_all(*self._arguments(), self._dv, dt / 2, G, True)

    def spin(self, which: int | str) -> Array:
        """The angular velocity (3,) of a body in the frame of the simulation.  Raises `InputError`."""
        k = self._number(which)
        R = algebra.rotation_matrix(self._z[k, 3:])
        return R @ ((self._z[k, :3] @ R) * self._c[k, :3])

    def orientation(self, which: int | str) -> Array:
        """The unit quaternion (4,) of the principal axes of a body, body to the frame of the simulation."""
        return self._z[self._number(which), 3:].copy()

    def spin_angular_momentum(self, which: int | str) -> Array:
        """The spin angular momentum (3,) of a body."""
        return self._z[self._number(which), :3].copy()

    def angular_momentum(self) -> Array:
        """The angular momentum (3,) of all orbits and spins."""
        return np.array([*self.sim.angular_momentum()]) + self._z[:, :3].sum(0)

    def energy(self) -> float:
        """The energy of particles, rotation and interaction; tides with a lag dissipate it."""
        p, masses, index, z, c = self._arguments()
        total = float(self.sim.energy())
        for i, row, columns in zip(index, z, c, strict=True):
            R = algebra.rotation_matrix(row[3:])
            M, D, (tide, fluid, _) = row[:3] @ R, columns[12:15], columns[15:]
            total += M @ (M * columns[:3]) / 2
            for j in range(self._count):
                if j != i and masses[j]:
                    b = (p[j, :3] - p[i, :3]) @ R
                    constants = {"D": D, "tide": tide, "fluid": fluid, "G": self.sim.G, "m": masses[j]}
                    total += masses[j] * potential(b, M * columns[:3], **constants)
        return float(total)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one file with the simulation, as REBOUND's data, and the bodies; `kreisel.rebound.load` reads it."""
        names = [("#" if isinstance(name, str) else "") + str(name) for name in self.names]
        kick = np.nan if self._kick is None else self._kick
        parts = {"z": self._z, "c": self._c, "names": np.array(names), "dt": np.array(kick), "seen": self._seen}
        write_file(path, self.sim, parts)

    # -- data of the kernels --------------------------------------------------------------------------------

    def _arguments(self) -> tuple[Array, Array, Array, Array, Array]:
        """Particles in their memory, the active masses, and the bodies."""
        sim, size = self.sim, ctypes.sizeof(rebound().Particle) // 8
        rows = (ctypes.c_double * size * self._count).from_address(ctypes.addressof(sim._particles.contents))
        p: Array = np.ctypeslib.as_array(rows)
        masses = p[:, 9].copy()
        if not sim.testparticle_type and sim.N_active < self._count:
            masses[sim.N_active :] = 0
        return p, masses, self._index, self._z, self._c

    @contextlib.contextmanager
    def _jacobi(self) -> Iterator[Array]:
        """WHFast's Jacobi coordinates in their memory, no rows for other integrators: they change with the particles.

        In REBOUND's safe mode each step computes them from the particles, which rounds the angular momentum of a
        hierarchy by up to 1.4e-16 a step, always in one direction.
        """
        sim, size = self.sim, ctypes.sizeof(rebound().Particle) // 8
        if str(sim.integrator) != "whfast" or sim.integrator.coordinates != "JACOBI":
            yield np.empty((0, size))
            return
        safe, sim.integrator.safe_mode = sim.integrator.safe_mode, 0
        rebound().clibrebound.reb_simulation_steps(ctypes.byref(sim), ctypes.c_size_t(0))  # allocates them
        if not np.array_equal(self._state(), self._seen):
            sim.did_modify_particles = 1
        state = sim.integrator
        offset = state.callbacks.field_descriptor_list.field_descriptor_for_name("p_jh").offset
        where = ctypes.c_uint64.from_address(state.state + offset).value
        rows = (ctypes.c_double * size * self._count).from_address(where)
        try:
            yield np.ctypeslib.as_array(rows)
        finally:
            sim.integrator.safe_mode = safe

    def _state(self) -> Array:
        """Positions, velocities and the active masses, (N, 7)."""
        p, masses, *_ = self._arguments()
        return np.column_stack([p[:, :6], masses])

    def _field(self, name: str, kind: Any) -> Array:
        """A scalar of the simulation in its memory."""
        where = ctypes.addressof(self.sim) + getattr(type(self.sim), name).offset
        size = np.dtype(kind).itemsize
        return np.frombuffer((ctypes.c_char * size).from_address(where), dtype=kind)

    def _number(self, which: int | str) -> int:
        if which not in self.names:
            raise InputError(
                f"expected one of the bodies {self.names}, got {shown(which)}.{hint(which, map(str, self.names))}"
            )
        return self.names.index(which)

    def _check(self) -> None:
        """Checks of the simulation and of the masses of its bodies.  Raises `InputError`."""
        self._check_count()
        check_simulation(self.sim)
        _ = self.dt
        _, masses, index, *_ = self._arguments()
        for name, i in zip(self.names, index, strict=True):
            if not masses[i] > 0:
                raise InputError(
                    f"particle {name!r}: expected a mass > 0 that acts on others, got {self.sim.particles[int(i)].m}. "
                    "Usual cause: a test particle; give it a mass, and N_active room for it."
                )

    def _check_count(self) -> None:
        if self.sim.N != self._count:
            raise RunError(
                f"t = {self.sim.t}: expected the {self._count} particles that there were, got {self.sim.N}. Usual "
                "cause: a collision that merged two, an open boundary, sim.add or sim.remove. Attach the bodies again."
            )

    def _check_finite(self) -> None:
        p = self._arguments()[0]
        if not (np.isfinite(self._z).all() and np.isfinite(p[:, :6]).all()):
            raise RunError(
                f"t = {self.sim.t}: expected finite positions, velocities and spins, got others. Usual cause: a body "
                "at the place of another particle, or a step too long for a close encounter."
            )

    def _refuse_turns(self, dt: float) -> NoReturn:
        self._check_finite()
        raise RunError(
            f"t = {self.sim.t}: expected bodies that rotate less than {compiled.MOST_PARTS} times in dt = {dt}, got a "
            "faster one. Usual cause: a spin in other units than the simulation."
        )


def is_finite(value: Any) -> bool:
    """Whether the value is a finite number."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


def check_simulation(sim: Any) -> None:
    """Raises `InputError` for simulations unsuitable for the splitting."""
    if not isinstance(sim, rebound().Simulation):
        raise InputError(f"sim: expected a rebound.Simulation, got {shown(sim)}.")
    if not (np.isfinite(sim.G) and sim.G > 0):
        raise InputError(f"sim.G: expected a number > 0, got {sim.G}. Usual cause: units; say sim.units = (...).")
    if sim.N_var:
        raise InputError(
            f"expected no variational particles, got {sim.N_var}. Usual cause: MEGNO. They do not know of the bodies; "
            "compare two simulations that begin close to each other."
        )
    if str(sim.boundary) not in ("none", "open"):
        raise InputError(f"sim.boundary: expected 'none' or 'open', got {sim.boundary!r}.")
    if str(sim.integrator) in ("whfast", "saba") and sim.integrator.keep_unsynchronized:
        raise InputError(
            "sim.integrator.keep_unsynchronized: expected 0, got 1. The bodies act on synchronized particles."
        )
    if sim.simulationarchive_filename:
        raise InputError(
            f"expected no archive that REBOUND writes, got {sim.simulationarchive_filename!r}. It has no "
            "spins, and is written in the middle of a step. Use spins.save(path)."
        )


def index_of(sim: Any, name: int | str) -> int:
    """The index of a particle.  Raises `InputError`."""
    names = [p.name for p in sim.particles]
    if isinstance(name, str) and name in names:
        return names.index(name)
    if isinstance(name, int | np.integer) and not isinstance(name, bool) and 0 <= name < sim.N:
        return int(name)
    named = [n for n in names if n]
    raise InputError(
        f"expected an index below {sim.N} or the name of a particle, one of {named}, got {shown(name)}."
        + hint(name, named)
    )


@explained
def attach(sim: Any, bodies: Mapping[int | str, Body], dt: float | None = None) -> Spins:
    """Make particles of a REBOUND simulation extended bodies, by index or name; the result moves `sim` itself.

    dt: the time between two kicks if the integrator is adaptive (ias15, bs); else the step is sim.dt.

        spins = kreisel.rebound.attach(sim, {"Mercury": Body(inertia=(A, B, C), spin=(0, 0, w))})
        spins.integrate(100.0)

    Raises `InputError`.
    """
    check_simulation(sim)
    if not isinstance(bodies, Mapping) or not bodies or not all(isinstance(b, Body) for b in bodies.values()):
        raise InputError(f"bodies: expected {{index or name: kreisel.rebound.Body(...), ...}}, got {shown(bodies)}.")
    index = [index_of(sim, name) for name in bodies]
    if len(set(index)) < len(index):
        raise InputError(f"bodies: expected each particle once, got {shown(list(bodies))}.")
    rows = [
        (b.state(), b.principal()[0], b.tides(sim.particles[i].r)) for b, i in zip(bodies.values(), index, strict=True)
    ]
    z = np.array([state for state, _, _ in rows])
    c = np.array([compiled.columns(moments, *tides) for _, moments, tides in rows])
    return Spins(sim, bodies, z, c, dt)


@explained
def load(path: str | os.PathLike[str]) -> Spins:
    """The saved simulation and its bodies, which continue bit for bit.

    Forces, heartbeats and other functions of the simulation are not in the file: set them again.  Raises `InputError`
    for any other file, `RunError` if it cannot be read.
    """
    sim, arrays = read_file(path)
    names = [name[1:] if name.startswith("#") else int(name) for name in arrays["names"].tolist()]
    kick = None if np.isnan(arrays["dt"]) else float(arrays["dt"])
    spins = Spins(sim, names, arrays["z"], arrays["c"], kick)
    spins._seen = arrays["seen"]
    return spins


# -- files: NumPy's archive of plain arrays, one of them the bytes of REBOUND's simulation ---------


FORMAT = 1
NEEDED = "The simulation and its bodies need a file name such as spins.npz"
FILES = "simulation", "whole.npz"
SHAPES = {"z": 7, "c": COLUMNS}


def write_file(path: str | os.PathLike[str], sim: Any, parts: Mapping[str, Any]) -> None:
    """Write `path` completely or not at all.  Raises `RunError` if the disk refuses."""
    target = place(path, NEEDED)
    with on_disk(path, "be written"), scratch(target.parent, ".kreisel-", files=FILES) as folder:
        simulation_file, whole = (folder / name for name in FILES)
        sim.save_to_file(str(simulation_file))
        data = np.frombuffer(simulation_file.read_bytes(), dtype=np.uint8)
        with whole.open("wb") as file:
            np.savez(file, format=np.array(FORMAT), simulation=data, **parts)
            file.flush()
            os.fsync(file.fileno())
        whole.replace(target)


def read_file(path: str | os.PathLike[str]) -> tuple[Any, dict[str, np.ndarray]]:
    """The simulation and the arrays of the file.

    Raises `InputError` for any other file, `RunError` if it cannot be read.
    """
    source = place(path, NEEDED)
    try:
        with on_disk(path, "be read"), source.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("format", "simulation", "z", "c", "names", "dt", "seen")}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected a file that spins.save wrote, got {shown(error)}.") from error
    names = arrays["names"] if arrays["names"].ndim == 1 and arrays["names"].dtype.kind == "U" else np.empty(0, str)
    fits = [arrays[name].shape == (len(names), width) for name, width in SHAPES.items()]
    fits += [name.startswith("#") or name.isdecimal() for name in names.tolist()]
    fits += [arrays[name].shape == () and arrays[name].dtype.kind in "if" for name in ("format", "dt")]
    fits += [arrays["seen"].dtype == np.float64, arrays["simulation"].dtype == np.uint8]
    if not all(fits) or arrays["format"] != FORMAT:
        raise InputError(f"{path}: expected format {FORMAT} of kreisel.rebound, got {shown(arrays['format'])}.")
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            sim = rebound().Simulation(arrays["simulation"].tobytes())
    except RuntimeError as error:
        raise RunError(
            f"{path}: REBOUND could not read its part: {error}. Usual cause: another version of it."
        ) from error
    for each in said:
        if "corrupted" in str(each.message):
            raise RunError(f"{path}: REBOUND could not read its part: {each.message}")
        warnings.warn(str(each.message), RuntimeWarning, stacklevel=2)
    return sim, arrays
