"""Calls of the trial, and the kinds of their arguments."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grammar
import numpy as np
from grammar import ENGINES, METHODS, TEXTS, maybe_python, never_long, odd

Function = Callable[..., Any]


@dataclass(frozen=True)
class Call:
    """A function of the API: how to get it, the kinds of its arguments, whether its results may be infinite."""

    name: str
    function: Callable[[Around], Function]
    given: tuple[str, ...] = ()
    keywords: dict[str, str] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    weight: float = 1.0
    infinite: bool = False
    then: Function | None = None
    attribute: bool = False

    @property
    def group(self) -> str:
        """Where it belongs."""
        return self.name.split(".")[0] if "." in self.name else "kr"


@dataclass
class Around:
    """Subjects of calls: systems, states, runs in memory and on disk."""

    base: Path
    folder: Path
    runs: list[Any]
    stores: list[Path]


_made: dict[str, Any] = {}


def make(base: Path) -> None:
    """The runs of this process."""
    import kreisel as kr

    _made["runs"] = [
        _run("lagrange-top", 3, orientation=(1, 0, 0, 0), steps=300),
        _run("lagrange-top", 3, lanes=2, steps=60),
        _run("lagrange-top-moving", 3, orientation=(1, 0, 0, 0), steps=120),
        _run("clebsch", 3, steps=200),
        _run("clebsch", 4, steps=60),
        _run("heavy-top", 3, lanes=2, steps=60, orientation=(1, 0, 0, 0)),
        _run("euler-top", 3, steps=60),
        _run("lagrange-top", 3, steps=3, every=2),
    ]
    _made["stores"] = sorted((base / "stores" / "true").iterdir())
    _made["sweep"] = kr.open_run(base / "stores" / "true" / "sweep.zarr")


def around(folder: Path) -> Around:
    """Subjects of the calls of a case."""
    return Around(folder.parent.parent, folder, _made["runs"], _made["stores"])


def _run(name: str, n: int, lanes: int = 0, **options: Any) -> Any:
    import stores

    import kreisel as kr

    system, state = stores.model(name, n, lanes)
    return kr.simulate(system, state, **{"dt": 0.1, **options}, progress=False)


def drawn(call: Call, here: Around, rng: random.Random) -> tuple[list[Any], dict[str, Any]]:
    """Arguments of a call.  If one is a model, the states are states of it."""
    chosen: dict[str, Any] = {}
    given = [value(kind, here, rng, chosen) for kind in call.given]
    keywords = {}
    for name, kind in call.keywords.items():
        if name in call.optional and rng.random() < 0.6:
            continue
        if rng.random() < 0.01:
            continue
        keywords[name] = value(kind, here, rng, chosen)
    if rng.random() < 0.005:
        keywords[rng.choice(["nothing", "x", "n"])] = odd(rng, True)
    return given, keywords


def value(kind: str, here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    """A value of a kind, or not quite."""
    if rng.random() < grammar.ODD and kind not in ALWAYS:
        return never_long(odd(rng, True)) if kind in ("steps", "extend", "reach") else odd(rng, True)
    return KINDS[kind](here, rng, chosen)


def _model(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    from kreisel.system import REGISTRY

    name = rng.choice(
        ["lagrange-top"] * 6 + ["lagrange-top-moving", "symmetric-top", "clebsch", "euler-top", *REGISTRY]
    )
    system = REGISTRY[name]
    n = grammar.dimension(system, rng)
    chosen["model"] = system(**grammar.parameters(system, n, rng))
    return chosen["model"]


def _state(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    model = chosen.get("model") or _model(here, rng, chosen)
    parts = grammar.state(model.system, model.n, rng, rng.choice([0, 0, 0, 0, 2]))
    share = rng.random()
    if share < 0.15:
        parts = {k: grammar.scaled(v, rng) if rng.random() < 0.5 else v for k, v in parts.items()}
    elif share < 0.2:
        parts = {k: odd(rng, True) if rng.random() < 0.5 else v for k, v in parts.items()}
    elif share < 0.22:
        parts = {k: v for k, v in parts.items() if rng.random() < 0.5} | {rng.choice(["x", "m", "P"]): [1, 2, 3]}
    elif share < 0.3:
        return model.state(**parts)
    elif share < 0.4:
        parts = {k: np.array(v, dtype=rng.choice(["f8", "f4", "O"])) for k, v in parts.items()}
    return parts


def _parts(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    found = _state(here, rng, chosen)
    return {str(k): v for k, v in dict(found).items()}


def _orientation(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    return maybe_python(grammar.orientation(chosen["model"].n if "model" in chosen else 3, rng), rng, 0.3)


def _steps(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    return rng.choice([1, 2, 5, 20, 50, np.int64(7), 10**16, -1, 0, True, 2.0, 2.5])


def _run_of(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    share = rng.random()
    run = rng.choice(here.runs[:1] * 4 + here.runs)
    chosen["run"] = run
    if share < 0.75:
        return run
    if share < 0.8:
        return _made["sweep"]
    import xarray as xr

    changes: list[Function] = [
        lambda: run.isel(time=slice(0, rng.choice([0, 1, 2, 5]))),
        lambda: run.isel(time=slice(None, None, rng.choice([2, -1]))),
        lambda: run.isel(time=-1),
        lambda: run.isel(lane=0) if "lane" in run.dims else run,
        lambda: run.drop_vars(rng.choice([str(k) for k in run.variables])),
        lambda: run.drop_attrs(),
        lambda: run.assign_attrs({rng.choice(["parameters", "system", "components", "options"]): odd(rng, True)}),
        lambda: run * rng.choice([0.0, 1e-200, 1e200]),
        lambda: run.map(lambda v: v * rng.choice([1.0, 1e160, np.nan]), keep_attrs=True),
        lambda: run.rename({rng.choice([str(k) for k in run.data_vars]): "other"}),
        lambda: run[rng.choice([str(k) for k in run.data_vars])],
        lambda: run.assign_coords(time=run.time * rng.choice([0, -1, np.inf])),
        lambda: run.astype("f4", keep_attrs=True),
        lambda: run.transpose(*reversed(list(run.sizes))),
        lambda: xr.Dataset(),
        lambda: xr.Dataset({"a": ("x", [1, 2])}),
    ]
    return rng.choice(changes)()


def _dataset(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    found = _run_of(here, rng, chosen)
    return found if hasattr(found, "data_vars") else here.runs[0]


def _quantity(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    names = ["a[0]", "a[1]", "a[2]", "m[0]", "M[1]", "P[0]", "energy", "M[0,1]", "spectrum[0]", "g[1]", "casimir[0]"]
    strange = [
        "a",
        "a[7]",
        "a[-1]",
        "q[0]",
        "a[0",
        "a[0]]",
        "time",
        "energy[0]",
        "",
        "a[1e3]",
        "a[0,0]",
        "lane",
        "a[" + "9" * 400 + "]",
    ]
    functions: list[Any] = [
        lambda *x: x[0][..., 0],
        lambda *x: x[0] * 0,
        lambda *x: np.nan,
        lambda *x: "text",
        lambda: 1,
        lambda *x: x[0],
        lambda *x: x[0][..., 0] + 1j * x[0][..., 1],
    ]
    return rng.choices([rng.choice(names), rng.choice(strange), rng.choice(functions)], [0.7, 0.15, 0.15])[0]


def _path_out(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    names = [
        "run.zarr",
        "deep/run.zarr",
        "räume.zarr",
        Path("p.zarr"),
        "",
        ".",
        "..",
        "x" * 300,
        "a\x00b",
        b"bytes",
        "~/a.zarr",
    ]
    return rng.choices([rng.choice(names), here.folder / "inside.zarr"], [0.8, 0.2])[0]


def _file_out(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    return rng.choice(
        ["a.nc", "a.h5", "a.parquet", "deep/a.nc", "a.txt", "a", "", ".", "x" * 300 + ".nc", Path("b.nc"), "a\x00.nc"]
    )


def _store(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    return rng.choices(
        [rng.choice(here.stores), rng.choice(["none.zarr", "", ".", "/", "a\x00", here.folder])], [0.8, 0.2]
    )[0]


def _copied(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    import shutil

    store = rng.choice(here.stores)
    shutil.copytree(store, here.folder / store.name)
    return here.folder / store.name


def _times(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    good = [
        0.5,
        [0.5, -3.0, 1e12],
        [0, 1, 2],
        np.linspace(0, 9, 50),
        [10**15],
        1e300,
        5e-324,
        [],
        [[0, 1]],
        "1",
        [1e308],
    ]
    return rng.choice(good)


def _number(*good: Any) -> Function:
    return lambda here, rng, chosen: maybe_python(rng.choice(good), rng, 0.05)


def _measure(*good: Any) -> Function:
    """A number in SI, or with a unit."""
    more = [
        "3 kg",
        "15 cm",
        "180 rpm",
        "1 ms",
        "70 deg",
        "2 kg m^2",
        "1 furlong",
        "kg",
        "",
        "1e400 kg",
        "nan kg",
        "1 kg/0",
        "9" * 400,
    ]
    return lambda here, rng, chosen: rng.choices(
        [rng.choice(good), rng.choice(more), rng.choice(grammar.EDGES), odd(rng, True)], [0.8, 0.07, 0.08, 0.05]
    )[0]


def _vector(here: Around, rng: random.Random, chosen: dict[str, Any]) -> Any:
    good = [rng.uniform(0.5, 2.0) for _ in range(3)]
    return maybe_python(good, rng, 0.15)


def _choice(*words: Any) -> Function:
    return lambda here, rng, chosen: rng.choice(words)


ALWAYS = ("model", "parts", "parameters", "system name", "name", "dataset")  # what Python itself would refuse otherwise


def _brake(rates: Any) -> Any:
    return {"torque": -rates}


KINDS: dict[str, Function] = {
    "model": _model,
    "state": _state,
    "parts": _parts,
    "orientation": _orientation,
    "dt": _number(0.05, 0.1, 0.1, 0.1, 1.0, 1e4, 1e-12),
    "steps": _steps,
    "every": _choice(1, 1, 2, 3, 7, 100, 0),
    "method": _choice(None, None, *METHODS, "exact"),
    "order": _choice(None, 1, 2, 2, 4, 6, 8, 3, 24, 26, 2.0, np.int64(4), "auto", "two"),
    "tol": _choice(None, 1e-3, 1e-9, 1e-14, 1e-300, 0, 1.0),
    "engine": _choice(None, "cpu", "cpu", "large", *ENGINES),
    "run": _run_of,
    "dataset": _dataset,
    "quantity": _quantity,
    "path": _path_out,
    "file": _file_out,
    "store": _store,
    "copy": _copied,
    "times": _times,
    "extend": _choice(None, None, 90, 100, 85, 0, -1, 10**16, 86.0, "x"),
    "flag": _choice(True, False, False),
    "progress": _choice(False),
    "rising": _choice(None, True, False),
    "level": _number(0.0, 0.1, 0.5, -0.3, 100.0),
    "lines": _choice(1, 2, 3, 8, 0, -1),
    "power": _choice(0, 1, 2, 3, 8, 9, -1),
    "returns": _choice(1, 2, 3, 0, -1, 100),
    "system": lambda here, rng, chosen: None if rng.random() < 0.7 else _model(here, rng, {}),
    "theme": _choice("light", "light", "dark", "grey"),
    "lane": _choice(0, 0, 0, 1, -1, 99),
    "name": lambda here, rng, chosen: rng.choice(["m", "a", "axial", "none", *TEXTS]),
    "anything": lambda here, rng, chosen: odd(rng, True),
    "mass": _measure(3.0, 1.0, 0.2),
    "moment": _measure(0.17, 0.02),
    "lever": _measure(0.15, 0.3),
    "angle": _measure(1.2, 0.0, 3.0, -0.5),
    "rate": _measure(20.0, 0.0, -5.0, 100.0),
    "density": _measure(1000.0, 0.0, 500.0),
    "vector": _vector,
    "unit": _choice("kg", "m/s", "rad/s", "kg m^2", "furlong", "", "1"),
    "grid": _choice(
        {"system.alpha": [0.9, 1.1]}, {"run.dt": [0.05, 0.1]}, {"state.m[2]": [1.0, 2.0]}, {"x": 1}, {}, [1], 3
    ),
    "listed": _choice({"run.dt": [0.1, 0.2]}, {"run.steps": [2, 3]}, {"state.none": [1]}, {"system.alpha": []}, "x"),
    "random": _choice({"system.alpha": {"uniform": [0.5, 1]}}, {"state.a": {"sphere": 1.0}}, {"x": {}}, {"run.dt": 3}),
    "save": _choice(["drift"], ["drift", "trajectories"], ["frequencies"], ["x"], [], "drift", 3),
    "seed": _choice(0, 1, 7, -1),
    "count": _choice(1, 2, 5, 10, 0, -1),
    "law": _choice(_brake, _brake, None, 3, "law"),
    "memory": _choice({}, {}, {"before": (0, 0, 0)}, {"x": "y"}, 3, "memory"),
    "air": _choice(None, None, "exponential", "harris-priester", "thick", 3),
    "dimension": _choice(3, 4, 5, 1, 0, -1),  # kernels for n = 10 need half a minute to compile
    "eps": _choice(None, 1, "1/3", 0, 0.25),
}
