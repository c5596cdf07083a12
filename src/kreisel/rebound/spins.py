"""Spin and orientation of particles of a REBOUND simulation, split symmetrically from its integrator.

A step of the length h is K(h/2) (N(h) and the free rotation, exactly) K(h/2), N a step of REBOUND and K the interaction
of each body with other particles: order 2.  Inside WHFast K(h) is a part of its kick, between half drifts and half
rotations, with pairs in reverse order in each second step.  K changes the velocities of both particles and the spins by
the gradient of one potential and conserves linear and angular momentum to rounding.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, hint, on_disk, shown
from kreisel.files import place
from kreisel.process import scratch
from kreisel.rebound import compiled
from kreisel.rebound.body import ENDS, Body, Pairs, rotor
from kreisel.rebound.compiled import energy
from kreisel.record.body import UPRIGHT
from kreisel.runs.settings import MOST_STEPS, within

FIXED = ("whfast", "leapfrog", "saba", "mercurius", "trace")  # a step is dt
ADAPTIVE = ("ias15", "bs")
CHUNK = 50_000  # steps between two checks of the result
LATE = 1e-9  # of a step: rounding of the time
INSIDE = {"forces": "_additional_forces"}  # kernels, by the functions that REBOUND calls
AROUND = {"before": "_pre_timestep_modifications", "after": "_post_timestep_modifications"}
FIELDS = {"N": "N", "steps_done": "steps_done", "modified": "did_modify_particles", "status": "_status"}


OFFSETS = {"x": 0, "y": 8, "z": 16, "vx": 24, "vy": 32, "vz": 40, "m": 72}  # bytes, of a particle
SPECIAL = "coordinates", "kernel", "corrector", "corrector2"  # of WHFast: 0 for one kick in Jacobi's coordinates
MODIFYING = "_heartbeat", "_pre_timestep_modifications", "_post_timestep_modifications"
FORMAT = 4  # of a file: NumPy's archive of plain arrays, one of them the bytes of REBOUND's simulation
NEEDED = "The simulation and its bodies need a file name such as spins.npz"
FILES = "simulation", "whole.npz"
SHAPES = {"z": 7, "c": int(ENDS[-1]), "axes": 4}


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


@cache
def offset(integrator: str, name: str) -> int:
    """Where an option is in the state of an integrator, whose attributes look for it anew each time, in 70 us."""
    sim = rebound().Simulation()
    sim.integrator = integrator
    return int(sim.integrator.callbacks.field_descriptor_list.field_descriptor_for_name(name).offset)


def option(sim: Any, name: str) -> Array:
    """An option of the integrator, in its memory."""
    where = sim.integrator.state + offset(str(sim.integrator), name)
    return np.ctypeslib.as_array((ctypes.c_uint32 * 1).from_address(where))


def is_plain(sim: Any) -> bool:
    """Whether a kick of WHFast can have spins: one kick a step, and nothing that needs synchronized particles."""
    if str(sim.integrator) != "whfast" or sim.gravity == "custom":
        return False
    alone = str(sim.boundary) == str(sim.collision) == "none" and not (sim.exit_max_distance or sim.exit_min_distance)
    return alone and not any(getattr(sim, name) for name in MODIFYING) and not any(option(sim, x)[0] for x in SPECIAL)


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
    if str(sim.integrator) in ("whfast", "saba") and option(sim, "keep_unsynchronized")[0]:
        raise InputError("sim.integrator.keep_unsynchronized: expected 0, got 1. Bodies act on synchronized particles.")
    if sim.simulationarchive_filename:
        raise InputError(
            f"expected no archive that REBOUND writes, got {sim.simulationarchive_filename!r}. It has no "
            "spins, and is written in the middle of a step. Use spins.save(path)."
        )


def index_of(sim: Any, name: int | str) -> int:
    """The index of a particle.  Raises `InputError`."""
    names = particle_names(sim)
    if isinstance(name, str) and name and name in names:
        return names.index(name)
    if isinstance(name, int | np.integer) and not isinstance(name, bool) and 0 <= name < sim.N:
        return int(name)
    named = [n for n in names if n]
    expected = f"expected an index below {sim.N} or the name of a particle, one of {named}"
    raise InputError(f"{expected}, got {shown(name)}.{hint(name, named)}")


def particle_names(sim: Any) -> list[str]:
    """The names of all particles, "" for none."""
    return [p.name or "" for p in sim.particles]


def restored(data: bytes, names: Iterable[str]) -> Any:
    """The simulation of REBOUND's bytes, with these names of its particles.

    REBOUND 5.2 replaces the addresses of names one after the other: a name at the former address of another becomes
    that one, in 4 of 5 simulations that are read after the end of the first (1000 tries).
    """
    sim = rebound().Simulation(data)
    for particle, name in zip(sim.particles, names, strict=True):
        if name and particle.name != name:
            particle.name = name
    return sim


# -- the bodies of a simulation --------------------------------------------------------------------------


@explained
class Spins:
    """The bodies of a simulation `sim`; a result of `attach`.

    dt      the step; with an adaptive integrator the time between two kicks, else the dt of the simulation
    names   the particles that are bodies, as given by the user
    """

    def __init__(self, sim: Any, names: Iterable[int | str], z: Array, c: Array, axes: Array, kick: float | None):
        check_simulation(sim)
        try:
            self.sim, self.names = sim, list(names)
        except TypeError:
            raise InputError(f"Spins: expected names of particles in a list, got {shown(names)}.") from None
        arrays = z, c, axes = algebra.floats(z), algebra.floats(c), algebra.floats(axes)
        shapes = tuple((len(self.names), width) for width in SHAPES.values())
        if tuple(a.shape for a in arrays) != shapes or not all(np.isfinite(a).all() for a in arrays):
            raise InputError(
                f"Spins: expected finite rows z {shapes[0]}, c {shapes[1]} and axes {shapes[2]} of the bodies, got "
                f"{shown(z)}, {shown(c)}, {shown(axes)}. kreisel.rebound.attach(sim, bodies) makes them."
            )
        self._index = np.array([index_of(sim, name) for name in self.names], dtype=np.int64)
        self._state = np.concatenate([z, [[0, 0, 0, *UPRIGHT]]])  # the last one of points
        self._z, self._c, self._axes, self._kick, self._count = self._state[:-1], c, axes, kick, int(sim.N)
        self._rotors = np.array([rotor(row) for row in c])
        self._frame, self._hooks = np.zeros(len(compiled.FRAME), dtype=np.int64), dict[Any, Any]()
        self._last_pairs: Pairs | None = None
        self._arrays = dict[str, Array]()
        self._check()

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and copy: `_z` is a part of `_state`, and hooks have addresses; copies have their simulation."""
        data, names = self.sim.__reduce__()[1][0], particle_names(self.sim)
        return _restored, (data, names, self.names, self._z.copy(), self._c, self._axes, self._kick)

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
        count = within(count, "count", 0, MOST_STEPS)
        self._check()
        self.sim.synchronize()
        for first in range(0, count, CHUNK):
            self._advance(dt, min(CHUNK, count - first))
            self.sim.process_messages()
            self._check_finite()

    def _advance(self, dt: float, count: int) -> None:
        """Steps, in WHFast's loop if it can be; `fault` and REBOUND's status tell whether all were made."""
        inside = self._kick is None and is_plain(self.sim)
        status = self._field("_status", np.int32)
        status[0] = -1  # running
        self._field("did_modify_particles", np.uint32)[0] = 1
        kinds, fault = self._prepare(dt, count, inside), self._arrays["fault"]
        if self._kick is not None:
            before, after = (compiled.compiled(name, kinds) for name in ("before", "after"))
            for _ in range(count):
                before(self._frame.ctypes.data)
                if not fault[0]:
                    self.sim.integrate(self.sim.t + dt)
                    self._check_count()
                    after(self._frame.ctypes.data)
        else:
            with self._hooked(INSIDE if inside else AROUND, kinds):
                compiled.compiled("advance", ())(self._frame.ctypes.data)
        if fault[0] == compiled.TURNED_OFTEN:
            self._check_finite()
            raise RunError(
                f"t = {self.sim.t}: expected bodies that rotate less than {compiled.MOST_PARTS} times in dt = {dt}, "
                "got a faster one. Usual cause: a spin in other units than the simulation."
            )
        self._check_count()
        if status[0] > 0:
            self.sim.process_messages()
            raise RunError(
                f"REBOUND stopped at t = {self.sim.t}: expected to run on, got its status {status[0]}. Usual cause: a "
                "collision, or exit_min_distance or exit_max_distance of the simulation."
            )

    @contextlib.contextmanager
    def _hooked(self, fields: Mapping[str, str], kinds: tuple[compiled.Kind, ...]) -> Iterator[None]:
        """REBOUND with kernels in its steps, which call the functions of the user; outside its safe mode inside them.

        Safe mode recomputes WHFast's coordinates in each step, which rounds the angular momentum of a hierarchy by up
        to 1.4e-16 a step, always in one direction, and computes its drift twice.
        """
        sim, changes = self.sim, []
        for name, field in fields.items():
            if (name, kinds) not in self._hooks:
                function = compiled.compiled(name, kinds)
                self._hooks[name, kinds] = compiled.hook(function, self._frame), function
            changes.append((self._field(field, np.uint64), self._hooks[name, kinds][0].address))
            self._frame[compiled.FRAME.index(name)] = changes[-1][0][0]
        if "forces" in fields:
            velocities = sim.force_is_velocity_dependent or any(kind.lags for kind in kinds)
            changes.append((option(sim, "safe_mode"), 0))
            changes.append((self._field("force_is_velocity_dependent", np.int32), velocities))
        before = [int(word[0]) for word, _ in changes]
        try:
            for word, value in changes:
                word[0] = value
            yield
        finally:
            for (word, _), value in zip(changes, before, strict=True):
                word[0] = value

    def spin(self, which: int | str) -> Array:
        """The angular velocity (3,) of a body in the frame of the simulation.  Raises `InputError`."""
        k = self._number(which)
        R = algebra.rotation_matrix(self._z[k, 3:])
        return R @ ((self._z[k, :3] @ R) / self._c[k, :3])

    def orientation(self, which: int | str) -> Array:
        """The unit quaternion (4,) of a body, from the axes in which it was given to the frame of the simulation."""
        k = self._number(which)
        return algebra.quaternion_product(self._z[k, 3:], self._axes[k])

    def spin_angular_momentum(self, which: int | str) -> Array:
        """The spin angular momentum (3,) of a body."""
        return self._z[self._number(which), :3].copy()

    def angular_momentum(self) -> Array:
        """The angular momentum (3,) of all orbits and spins, except spins of bodies without mass."""
        massive = self._particles()[self._index, 9] > 0
        return np.array([*self.sim.angular_momentum()]) + self._z[massive, :3].sum(0)

    def energy(self) -> float:
        """The energy of particles, rotation and interaction; tides with a lag dissipate it.

        Bodies without mass, and what acts only on test particles, do not count.
        """
        p, total = self._particles(), float(self.sim.energy())
        for row, constants, i in zip(self._z, self._c, self._index, strict=True):
            M = row[:3] @ algebra.rotation_matrix(row[3:])
            total += M @ (M / constants[:3]) / 2 if p[i, 9] > 0 else 0.0
        for kind, (i, j, *bodies), factors in self._pairs(1.0).rows:
            if not kind.lags and factors["on1"] * factors["on2"]:
                total += energy(p[j, :3] - p[i, :3], *(self._state[k] for k in bodies), **factors)
        return float(total)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one file with the simulation, as REBOUND's data, and the bodies; `kreisel.rebound.load` reads it.

        The file is complete or not there.  Raises `RunError` if the disk refuses.
        """
        target, names = place(path, NEEDED), [("#" * isinstance(name, str)) + str(name) for name in self.names]
        with on_disk(path, "be written"), scratch(target.parent, ".kreisel-", files=FILES) as folder:
            simulation, archive = (folder / name for name in FILES)
            self.sim.save_to_file(str(simulation))
            arrays: dict[str, Any] = {
                "format": FORMAT,
                "simulation": np.frombuffer(simulation.read_bytes(), dtype=np.uint8),
            }
            arrays |= {"particles": np.array(particle_names(self.sim), dtype=np.str_), "names": names}
            with archive.open("wb") as file:
                kick = np.nan if self._kick is None else self._kick
                np.savez(file, allow_pickle=False, **arrays, z=self._z, c=self._c, axes=self._axes, dt=kick)
                file.flush()
                os.fsync(file.fileno())
            archive.replace(target)

    # -- data of the kernels --------------------------------------------------------------------------------

    def _particles(self) -> Array:
        size = ctypes.sizeof(rebound().Particle) // 8
        rows = (ctypes.c_double * size * self._count).from_address(ctypes.addressof(self.sim._particles.contents))
        return np.ctypeslib.as_array(rows)

    def _prepare(self, dt: float, count: int, inside: bool) -> tuple[compiled.Kind, ...]:
        sim, pairs = self.sim, self._pairs(dt if inside else dt / 2)
        times = np.array([dt, dt / 2, dt / 2 if inside else 0.0, sim.G])
        self._arrays = {"p": self._particles(), "z": self._state, "c": self._rotors, "pairs": pairs.places}
        self._arrays |= {"factors": pairs.factors, "times": times, "fault": np.zeros(1, dtype=np.int64)}
        self._arrays |= {name: np.zeros((self._count, 3)) for name in ("dv", "v")}
        active = self._count if sim.testparticle_type else pairs.key[2]
        self._arrays["masses"] = (np.arange(self._count) < active) * self._arrays["p"][:, 9]  # of Jacobi's coordinates
        words = dict.fromkeys(compiled.FRAME, 0) | {name: x.ctypes.data for name, x in self._arrays.items()}
        words |= {word: self._field(name, np.uint8).ctypes.data for word, name in FIELDS.items()}
        words |= {"simulation": ctypes.addressof(sim), "bodies": len(self._index)}
        words |= {"width": self._arrays["p"].shape[1], "particles": self._count, "count": len(pairs.rows)}
        words |= {"bursts": 1, "burst": count} if inside else {"bursts": count, "burst": 1}
        words["advance"] = ctypes.cast(rebound().clibrebound.reb_simulation_steps, ctypes.c_void_p).value or 0
        self._frame[:] = [words[name] for name in compiled.FRAME]
        return pairs.kinds

    def _pairs(self, h: float) -> Pairs:
        sim, masses = self.sim, self._particles()[:, 9]
        key = h, sim.G, int(min(self._count, sim.N_active)), sim.testparticle_type, masses.tobytes()
        if self._last_pairs is None or self._last_pairs.key != key:
            self._last_pairs = Pairs.of(key, masses, self._index, self._c)
        return self._last_pairs

    def _field(self, name: str, kind: Any) -> Array:
        where = ctypes.addressof(self.sim) + getattr(type(self.sim), name).offset
        size = np.dtype(kind).itemsize
        return np.frombuffer((ctypes.c_char * size).from_address(where), dtype=kind)

    def _number(self, which: int | str) -> int:
        if which not in self.names:
            near = hint(which, map(str, self.names))
            raise InputError(f"expected one of the bodies {self.names}, got {shown(which)}.{near}")
        return self.names.index(which)

    def _check(self) -> None:
        self._check_count()
        check_simulation(self.sim)
        _ = self.dt
        for name, i in zip(self.names, self._index, strict=True):
            if isinstance(name, str) and self.sim.particles[int(i)].name != name:
                raise RunError(
                    f"t = {self.sim.t}: expected the particle {name!r} at its index {i}, got another. Usual cause: "
                    "sim.remove and sim.add between two calls. Attach the bodies again."
                )
        for name, m, row in zip(self.names, self._particles()[self._index, 9], self._c, strict=True):
            if row[-2] and not m > 0:
                raise InputError(
                    f"particle {name!r}: expected a mass > 0 for a body with tides, got {m}. Usual cause: a test "
                    "particle; its tides would accelerate it infinitely. Give it a mass, or no love=."
                )

    def _check_count(self) -> None:
        if self.sim.N != self._count:
            raise RunError(
                f"t = {self.sim.t}: expected the {self._count} particles that there were, got {self.sim.N}. Usual "
                "cause: a collision that merged two, an open boundary, sim.add or sim.remove. Attach the bodies again."
            )

    def _check_finite(self) -> None:
        p = self._particles()
        if not (np.isfinite(self._z).all() and np.isfinite(p[:, :6]).all()):
            raise RunError(
                f"t = {self.sim.t}: expected finite positions, velocities and spins, got others. Usual cause: a body "
                "at the place of another particle, or a step too long for a close encounter."
            )


def _restored(data: bytes, names: list[str], *parts: Any) -> Spins:
    return Spins(restored(data, names), *parts)


def is_finite(value: Any) -> bool:
    """Whether the value is a finite number."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))


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
    rows = [body._of_particle(sim.particles[i]) for body, i in zip(bodies.values(), index, strict=True)]
    z, c = (np.array(column) for column in zip(*rows, strict=True))
    return Spins(sim, bodies, z, c, np.array([body._axes() for body in bodies.values()]), dt)


@explained
def load(path: str | os.PathLike[str]) -> Spins:
    """The saved simulation and its bodies, which continue bit for bit.

    Forces, heartbeats and other functions of the simulation are not in the file: set them again.  Raises `InputError`
    for any other file, `RunError` if it cannot be read.
    """
    source = place(path, NEEDED)
    try:
        with on_disk(path, "be read"), source.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("format", "simulation", "particles", *SHAPES, "names", "dt")}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected a file that spins.save wrote, got {shown(error)}.") from error
    names = arrays["names"] if arrays["names"].ndim == 1 and arrays["names"].dtype.kind == "U" else np.empty(0, str)
    fits = [arrays[name].shape == (len(names), width) for name, width in SHAPES.items()]
    fits += [name.startswith("#") or name.isdecimal() for name in names.tolist()]
    fits += [arrays[name].shape == () and arrays[name].dtype.kind in "if" for name in ("format", "dt")]
    fits += [arrays["simulation"].dtype == np.uint8]
    if not all(fits) or arrays["format"] != FORMAT:
        raise InputError(f"{path}: expected format {FORMAT} of kreisel.rebound, got {shown(arrays['format'])}.")
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            sim = restored(arrays["simulation"].tobytes(), arrays["particles"].tolist())
    except (RuntimeError, ValueError) as error:
        raise RunError(f"{path}: REBOUND could not read its part: {error}. Usual cause: another version.") from error
    for warning in said:
        if "corrupted" in str(warning.message):
            raise RunError(f"{path}: REBOUND could not read its part: {warning.message}")
        warnings.warn(str(warning.message), RuntimeWarning, stacklevel=2)
    keys = [name[1:] if name.startswith("#") else int(name) for name in names.tolist()]
    z, c, axes = (arrays[name] for name in SHAPES)
    return Spins(sim, keys, z, c, axes, None if np.isnan(arrays["dt"]) else float(arrays["dt"]))
