"""Bodies, runs, files and functions that the public calls are about, and the kinds of arguments with them."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import cache
from typing import Any

import grammar
import numpy as np
from grammar import maybe_python, odd

RESULTS = ("Propagator", "View", "Lines", "Comparison", "FreeRotation")  # classes that functions return
ORBIT = {"semi_major_axis": 7e6, "eccentricity": 0.01, "inclination": 0.9}


@cache
def _brake(rates: Any) -> Any:
    return {"torque": -rates}


def example(name: str) -> Any:
    """An instance of a class, by its name."""
    import kreisel as kr
    from kreisel import analysis, physical

    orbit = physical.Orbit(**ORBIT)
    makers: dict[str, Callable[[], Any]] = {
        "Orbit": lambda: orbit,
        "Gyroscope": lambda: physical.Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15),
        "HeavyBody": lambda: physical.HeavyBody(1.0, (1.0, 2.0, 2.5), (0.0, 0.1, 0.2)),
        "FreeBody": lambda: physical.FreeBody((1.0, 2.0, 2.5)),
        "FreeRotation": lambda: physical.FreeBody((1.0, 2.0, 2.5)).rotation((0.1, 2.0, 0.1)),
        "Ellipsoid": lambda: physical.Ellipsoid((1.0, 2.0, 3.0), 10.0, 1.0),
        "SubmergedBody": lambda: physical.SubmergedBody.ellipsoid((0.1, 0.2, 0.3), 30.0, 1000.0),
        "Satellite": lambda: physical.Satellite((0.05, 0.04, 0.01), orbit),
        "GravityBody": lambda: physical.GravityBody.ellipsoid(4e11, (700.0, 600.0, 450.0)),
        "Binary": lambda: physical.Binary(example("GravityBody"), example("GravityBody")),
        "ThirdBody": lambda: physical.ThirdBody(1e12, (9000.0, 0.0, 0.0), (0.1, 0.2, 0.0)),
        "Asteroid": lambda: physical.Asteroid((1.0, 2.0, 2.5), orbit),
        "Control": lambda: kr.Control(_brake),
        "Table": lambda: kr.Table([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]),
        "Wheels": lambda: physical.Wheels([(1.0, 0.0, 0.0)]),
        "EddyCurrents": lambda: physical.EddyCurrents((1.0, 1.0, 1.0)),
        "Facets": lambda: physical.Facets.ellipsoid((3.0, 2.0, 1.0), 30),
        "Ensemble": lambda: physical.Ensemble([physical.Satellite((0.05, 0.04, k), orbit) for k in (0.01, 0.02)]),
        "Primary": lambda: physical.EARTH,
        "Scale": lambda: kr.units.Scale("m", 2.0),
        "Design": lambda: kr.Design(grid={"system.alpha": [0.9, 1.1]}),
        "Event": lambda: kr.Event(quantity_of_row),
        "Propagator": lambda: kr.propagator(kr.LagrangeTop(p=(0, 0, 1)), dt=0.05),
        "View": lambda: kr.view(run("lagrange-top")),
        "Lines": lambda: analysis.frequencies(run("lagrange-top"), "a[0]"),
        "Comparison": lambda: analysis.compare(run("lagrange-top"), run("lagrange-top")),
        "Body": lambda: kr.rebound.Body((1.0, 2.0, 2.5), spin=(0, 0.1, 1.0)),
        "Spins": lambda: kr.rebound.attach(simulation(), {1: kr.rebound.Body((1.0, 2.0, 2.5), spin=(0, 0.1, 1.0))}),
    }
    return makers[name]()


@cache
def run(name: str) -> Any:
    """A run of a system, or of a body."""
    import stores

    import kreisel as kr

    if name == "lagrange-top":
        system, state = stores.model(name, 3)
        return kr.simulate(system, state, dt=0.1, steps=100, orientation=(1, 0, 0, 0), progress=False)
    body = example(name)
    options: dict[str, Any] = {"orientation": (1, 0, 0, 0), "progress": False}
    if name == "Satellite":
        state, options["dt"] = body.state(spin=(0.0, 0.01, 0.002)), 5.0
    elif name == "SubmergedBody":
        state, options["dt"] = body.state(velocity=(0.1, 0.0, 0.0)), 0.05
    else:
        state, options["dt"] = body.state(spin=(0.1, 0.2, 1.0)), 0.05
    return kr.simulate(body.model(), state, steps=60, **options)


def simulation() -> Any:
    """Two particles of REBOUND."""
    import rebound

    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=1e-3, a=1.0, e=0.1, r=0.01)
    sim.integrator, sim.dt = "whfast", 0.01
    return sim


def quantity_of_row(row: Any) -> Any:
    """A number of a state."""
    return row["a"][2]


def _force(*state: Any, **more: Any) -> Any:
    return state[0] * 0.1


def _potential(*state: Any, **more: Any) -> Any:
    return state[-1][..., 0] ** 2


def _functions(*good: Callable[..., Any]) -> Any:
    more: list[Any] = [
        lambda: 1.0,
        lambda x: x[0],
        lambda *x: x,
        lambda *x: "text",
        lambda *x: np.nan,
        lambda *x: 1 / 0,
        lambda M, *, strength: strength * M[0],
        lambda a, *, k=0.1: k * a[2],
        lambda a, g, t: a[0] * t,
        lambda a: a @ a,
        lambda M, P: [M[1], M[2], M[0]],
        print,
        len,
        int,
    ]
    return lambda here, rng, chosen: rng.choice([*good, *good, *more])


def _text(here: Any, rng: random.Random, chosen: Any) -> Any:
    return rng.choice(["BODY", "drift", "my-top", *grammar.TEXTS])


def _inertia(here: Any, rng: random.Random, chosen: Any) -> Any:
    good = rng.choice(
        [
            [1.0, 2.0, 2.5],
            [0.05, 0.04, 0.02],
            [[2.0, 0.1, 0.0], [0.1, 2.5, 0.2], [0.0, 0.2, 3.0]],
            [1.0, 1.0, 1.0],
            [3.0, 5.0, 9.0],
            ["1 kg m^2", "2 kg m^2", "2.5 kg m^2"],
            [1e-320] * 3,
            [0.0, 1.0, 1.0],
        ]
    )
    return maybe_python(good, rng, 0.1)


def _orbit(here: Any, rng: random.Random, chosen: Any) -> Any:
    from kreisel import physical

    return rng.choice([physical.Orbit(**ORBIT), physical.Orbit(7e6), None, 7e6, physical.SUN, example("Gyroscope")])


def _quaternion(here: Any, rng: random.Random, chosen: Any) -> Any:
    good = grammar.orientation(3, rng)
    return maybe_python(rng.choice([good, [good, good], np.array(good)]), rng, 0.15)


def _spin(here: Any, rng: random.Random, chosen: Any) -> Any:
    return rng.choice(
        [0.5, [0.1, 0.2, 1.0], (0.0, 0.0, 0.0), "3 rpm", ["1 deg/s"] * 3, odd(rng, True), [[1, 2, 3]] * 2]
    )


def _rows(here: Any, rng: random.Random, chosen: Any) -> Any:
    return run(rng.choice(["Satellite", "SubmergedBody", "FreeBody", "lagrange-top"]))


def _files(here: Any, rng: random.Random, suffixes: tuple[str, ...], texts: tuple[bytes, ...]) -> Any:
    path = here.folder / f"file{rng.choice(suffixes)}"
    path.write_bytes(rng.choice(texts))
    return rng.choice([path, path, str(path), here.folder, here.folder / "none", "a\x00b", odd(rng, True)])


ROWS = b"\n".join([b"1 2 3 4 5 6"] * 6)
WAMIT = b"0.0 1 1 0.5\n0.0 2 2 0.25\n-1 3 3 0.1\n"
FACES = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
NOISE = (b"", b"\x00" * 84, b"solid", b"f 1 2 3", b"\xff\xfe" * 50, b"nan " * 36, b"1e999 " * 36, b"PK\x03\x04")


def _numbers_file(here: Any, rng: random.Random, chosen: Any) -> Any:
    return _files(here, rng, (".1", ".txt", ""), (ROWS, WAMIT, WAMIT, *NOISE))


def _mesh(here: Any, rng: random.Random, chosen: Any) -> Any:
    return _files(here, rng, (".obj", ".stl", ".ply"), (FACES, FACES, *NOISE))


def _spins_file(here: Any, rng: random.Random, chosen: Any) -> Any:
    path = here.folder / "spins.npz"
    example("Spins").save(path)
    whole = path.read_bytes()
    keep = rng.randrange(len(whole))
    damaged = whole[:keep] + bytes([rng.randrange(256)]) + whole[keep + 1 :]
    return _files(here, rng, (".npz",), (whole, whole, whole[:keep], damaged, *NOISE, _other_npz(rng)))


def _other_npz(rng: random.Random) -> bytes:
    import io

    names = ("format", "simulation", "z", "c", "axes", "names", "dt", "seen")
    file = io.BytesIO()
    values = [np.zeros(rng.choice([(), (1,), (1, 7), (2, 3)]), rng.choice(["f8", "i8", "U3", "u1"])) for _ in names]
    if rng.random() < 0.5:
        values[0] = np.array(1)
    np.savez(file, **dict(zip(names, values, strict=True)))
    return file.getvalue()


def _sim(here: Any, rng: random.Random, chosen: Any) -> Any:
    if rng.random() < 0.15:
        return odd(rng, True)
    sim = simulation()
    sim.integrator = rng.choice(["whfast", "whfast", "ias15", "leapfrog", "none"])
    sim.dt = rng.choice([0.01, 0.01, 0.0, -0.01, np.nan])
    return sim


def _bodies(here: Any, rng: random.Random, chosen: Any) -> Any:
    body = example("Body")
    return rng.choice(
        [{1: body}, {0: body, 1: body}, {7: body}, {"x": body}, {1: None}, {}, [body], [1], odd(rng, True)]
    )


def _observations(here: Any, rng: random.Random, chosen: Any) -> Any:
    rows = run("lagrange-top").isel(time=slice(0, 20))
    return rng.choice([rows, rows[["a"]], rows[["time"]], rows * np.nan, rows.isel(time=0), 3, odd(rng, True)])


def _section(here: Any, rng: random.Random, chosen: Any) -> Any:
    from kreisel import analysis

    return rng.choice([None, analysis.section(run("lagrange-top"), "a[0]"), run("lagrange-top"), odd(rng, True)])


def _plates(here: Any, rng: random.Random, chosen: Any) -> Any:
    from kreisel import physical

    plate = physical.Plate((1.0, 0.0, 0.0), (0.1, 0.0, 0.0), 0.02)
    return rng.choice([(), (plate,), (plate, plate), plate, [1], ((1, 2, 3),), "x", odd(rng, True)])


def _harmonics(here: Any, rng: random.Random, chosen: Any) -> Any:
    from kreisel import physical

    good = physical.Harmonics(6e24, 6.4e6, {(2, 0): (-1e-3, 0.0), (2, 2): (1e-6, 0.0)})
    return rng.choice([None, good, {}, 3, good._replace(coefficients=odd(rng, True)), good._replace(mass="x")])


def _choice(*values: Any) -> Any:
    return lambda here, rng, chosen: rng.choice([*values, *values, odd(rng, True)])


def _variable(here: Any, rng: random.Random, chosen: Any) -> Any:
    rows = run("FreeBody")
    return rng.choice([rows["M"], rows["energy"], rows, 3, rows["time"], odd(rng, True)])


def _scales(here: Any, rng: random.Random, chosen: Any) -> Any:
    good = example("FreeBody").scales()
    return rng.choice([good, good, {"m": (0, 0, 1)}, {"M": 3}, {}, [good], None, {1: 2}, odd(rng, True)])


def _lists(*good: Any) -> Any:
    return lambda here, rng, chosen: rng.choice([*good, *good, [], "energy", [1], {1}, odd(rng, True)])


def _edge(*good: Any) -> Any:
    from arguments import _measure

    return _measure(*good)


def kinds() -> dict[str, Any]:
    """The kinds by their names."""
    import kreisel as kr

    top = kr.LagrangeTop(p=(0, 0, 1))
    one, two = [0.1, 0.1, 0.1], [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    return {
        "altitude": _edge(5e5, 8e5, 3.6e7),
        "bodies": _bodies,
        "body": _choice("top", "box", "satellite", "ellipsoid", "gyroscope", None),
        "bounds": _choice(None, {"p[2]": (0, 2)}, {"p[2]": 3}, {"alpha": (0.5, 2)}, {"x": (0, 1)}, {1: (0, 1)}),
        "center": _text,
        "compare": _rows,
        "halvings": _choice(1, 2, 0, -1, 1.5, None),
        "subjects": _choice([top], {"a": (top, {"order": 4})}, [], ["x"], None, 3),
        "coupling": _choice(one, two, None, [[1, 2, 3]]),
        "distance": _edge(7e6, 4.2e7),
        "draws": _choice(1, 3, None, 0, -1),
        "duration": _edge(0.01, 1.0, "1 ms"),
        "end": _choice(1.0, 0.0, 3, -1.0, np.inf),
        "epoch": _choice("2026-01-01T00:00:00", "2026-01-01", "x", np.datetime64("2026-01-01"), np.datetime64("NaT")),
        "events": _choice((), example("Event"), [example("Event")], [1]),
        "action": _functions(lambda row: row, lambda row: {"a": row["a"]}),
        "force": _functions(_force, lambda a: 0.1 * a),
        "frame": _choice("body", "space", "moving", "rest", np.zeros(3)),
        "free": _choice(["p"], ["alpha"], {"p": (0, 0, 1.1)}, ["p[2]"], ["a"], [], "p", {"p": "x"}, {1: 2}),
        "gravity body": _choice(example("GravityBody"), None, 3),
        "harmonics": _harmonics,
        "identifier": _text,
        "impulses": _choice((), {"time": 1.0, "m": (0, 0, 0.1)}, [{"time": 1.0}], {"m": 1}, [{"time": 1.0, "m": "x"}]),
        "inertia": _inertia,
        "inner": _choice(1, 2, 4, 0, None, np.int64(2)),
        "language": _choice("c", "rust", "wgsl", "C", "fortran", {}),
        "convention": _choice(None, "unity", "godot", "Unity", "quake", 3),
        "mesh": _mesh,
        "names": _lists(["m"], ("M", "P"), None),
        "numbers file": _numbers_file,
        "observables": _choice(None, {"up": lambda a: a[2]}, {"up": 3}, {1: len}, {"up": lambda a: 1 / 0}),
        "observations": _observations,
        "observe": _lists((), ("energy",), None, ("x",)),
        "orbit": _orbit,
        "originator": _text,
        "second_run": _rows,
        "out": lambda here, rng, chosen: rng.choice(
            [here.folder / "a.aem", "a.aem", "", ".", "x" * 300, "a\x00", odd(rng, True)]
        ),
        "pair_potential": _functions(lambda M, N, *, k=1.0: k * M[0] * N[0]),
        "pairs": _choice([(0, 1)], [(0, 1), (1, 2)], [(0, 0)], [], None),
        "params": _choice(
            {"strength": 0.1}, {"k": 0.2}, None, {"k": "x"}, {1: 2}, {"k": [1, 2, 3]}, {"strength": None}
        ),
        "part": _edge(0.0, 0.1, 0.5, 1.0),
        "plates": _plates,
        "potential": _functions(_potential, lambda a: 0.1 * a[0] ** 2),
        "primary": _choice(example("Primary"), None, "Earth", example("Primary")._replace(mu=0.0)),
        "project": _choice(True, False),
        "single": _choice(False, True),
        "quaternion": _quaternion,
        "reach": lambda *case: grammar.never_long(_choice(1.0, 0.0, -1.0, np.nan, np.inf, 1e300)(*case)),
        "rng": _choice(0, 1, None, -1),
        "run of a body": _rows,
        "scales": _scales,
        "section": _section,
        "sim": _sim,
        "six": _choice([0.1] * 6, [0.0] * 6, [[1], [1, 2]], [0.1] * 3, np.diag([1.0] * 6), ["1 kg"] * 6),
        "spin": _spin,
        "spins file": _spins_file,
        "style": _choice("house", "paper", "x"),
        "t_start": _choice(None, 1.0, np.nan, "1 s"),
        "t_end": _choice(None, 1.0, 0.0, -1.0, np.inf, "1 s"),
        "text": _text,
        "time": _choice(0.0, 1.0, None, np.nan),
        "time_system": _choice("UTC", "TT", "x"),
        "together": _choice({"run.dt": [0.1, 0.2]}, None, {"state.none": [1]}),
        "units": _choice("deg/s", None, 3),
        "variable": _variable,
        "candidate": _rows,
        "what": _rows,
        "which": _choice(1, 0, "x", -1),
        "z": _choice(np.zeros((1, 7)), np.ones((2, 7)), [[0.0] * 7]),
        "c": _choice(np.zeros((1, 9)), [[0.0] * 9]),
        "kick": _choice(None, 0.1),
    }
