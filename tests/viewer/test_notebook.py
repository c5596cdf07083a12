"""Notebook manners: what is shown, cited, completed; states from any array library."""

from __future__ import annotations

import inspect
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.method import METHODS
from kreisel.runs.run_record import bibliography
from kreisel.system import REGISTRY


class Balanced(HTMLParser):
    """HTML whose tags close in order."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.cells.append(data)


@pytest.fixture(scope="module")
def run() -> object:
    top = kr.LagrangeTop(p=(0, 0, 1))
    return kr.simulate(top, top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.1, steps=200)


def test_a_run_shows_its_drift_table(run) -> None:
    cells = Balanced(run.kreisel._repr_html_()).cells
    table = kr.drift(run)
    for name, row in table.iterrows():
        here = cells.index(name)
        assert cells[here + 1] == ("yes" if row.conserved else "no")
        assert float(cells[here + 3]) == pytest.approx(row.max_change, rel=0.05)
    assert "200 steps of 0.1" in " ".join(cells)
    assert str(len(table)) and table.to_string() in repr(run.kreisel)


def test_the_accessor_stays_at_the_run_and_is_the_functions(run, tmp_path: Path) -> None:
    part = run.isel(time=slice(0, 50)).kreisel
    assert part.drift().equals(kr.drift(run.isel(time=slice(0, 50))))
    assert part.cite() == kr.cite(run)
    assert part.plot().axes
    assert part.model.params["p"].tolist() == [0, 0, 1]
    assert Balanced(run.isel(time=-1).kreisel._repr_html_()).cells
    kr.simulate(part.model, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.1, steps=5, path=tmp_path / "a.zarr")
    assert kr.open_run(tmp_path / "a.zarr").kreisel.drift().shape[0] > 0
    with pytest.raises(kr.InputError, match="not a run of Kreisel"):
        _ = run.drop_attrs().kreisel


def test_an_ensemble_and_states_at_times_are_shown() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    many = top.state(m=np.tile((0.1, 0.2, 1.5), (4, 1)), a=(0.6, 0, 0.8))
    assert "4 lanes" in kr.simulate(top, many, dt=0.1, steps=5).kreisel._repr_html_()
    at = kr.at(top, top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), [0.5, 2.0])
    assert Balanced(at.kreisel._repr_html_()).cells


@pytest.mark.parametrize("name", REGISTRY)
def test_systems_models_and_states_are_shown(name: str) -> None:
    system = REGISTRY[name]
    cells = Balanced(system._repr_html_()).cells
    assert system.equations in cells and all(any(p.meaning in c for c in cells) for p in system.parameters)
    top = kr.LagrangeTop(p=np.ones((7, 3)))
    assert "7 lanes" in " ".join(Balanced(top._repr_html_()).cells)
    assert "1.5" in " ".join(Balanced(top.state(m=(0, 0, 1.5), a=(1, 0, 0))._repr_html_()).cells)


def test_html_is_escaped() -> None:
    from dataclasses import replace

    evil = replace(kr.LagrangeTop, title="<script>x</script>", notes="<b>")
    assert "<script>" not in evil._repr_html_() and "<b>" not in evil._repr_html_()


def test_keywords_complete(run) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    assert list(inspect.signature(kr.LagrangeTop).parameters) == ["p", "alpha"]
    assert list(inspect.signature(top.state).parameters) == ["m", "a"]
    assert {"m", "a", "axial"} <= set(dir(top.state(m=(0, 0, 1), a=(1, 0, 0))))
    assert {"simulate", "drift", "cite"} <= set(dir(kr))
    assert {"drift", "plot", "cite", "model"} <= set(dir(run.kreisel))


# -- citations ---------------------------------------------------------------------------------------


def test_every_system_and_method_has_its_sources_in_the_list() -> None:
    known = bibliography()
    assert {key for m in METHODS.values() for order in (None, *m.orders) for key in m.cited(order)} <= set(known)
    for name, system in REGISTRY.items():
        text = kr.cite(system)
        assert "% further" not in text, f"{name}: a source without an entry in refs.bib"
        assert text.count("\n@") >= 1


def test_bibtex_is_well_formed(run) -> None:
    for key, entry in bibliography().items():
        assert entry.count("{") == entry.count("}") and entry.startswith("@") and key
    text = kr.cite(run)
    assert re.findall(r"^@\w+{(\w+),", text, re.MULTILINE) == [
        "kreisel",
        "suris2001",
        "kuznetsov2004",
        "zullo2011",
        "ragnisco2011",
    ]
    assert kr.__version__ in text


def test_a_citation_names_what_was_used(run) -> None:
    model = run.kreisel.model
    x0 = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    used = {
        "suzuki1990": {"method": "variational", "order": 4},
        "kahan1997": {"method": "variational", "order": 6},
        "hairer1993": {"method": "dop853"},
        "carlson1995": {"method": "exact"},
    }
    citations = {key: kr.cite(kr.simulate(model, x0, dt=0.1, steps=2, **options)) for key, options in used.items()}
    for key in used:
        assert [other for other in used if f"{{{key}," in citations[other]] == [key]


def test_a_source_of_ones_own_is_named_and_other_things_refused() -> None:
    from dataclasses import replace

    assert "% further: Kowalevski 1889" in kr.cite(replace(kr.HeavyTop, source="S. Kowalevski 1889"))
    for wrong in ("suris", None, np.zeros(3)):
        with pytest.raises(kr.InputError, match="A run, or a system"):
            kr.cite(wrong)


# -- arrays of any library -----------------------------------------------------------------------------


def libraries() -> list[str]:
    return ["list", "tuple", "numpy", "float32", "xarray", "dataset", "pandas", "jax"]


def given(kind: str, m: list[float], a: list[float]) -> object:
    if kind == "dataset":
        import xarray as xr

        return xr.Dataset({"m": ("axis", m), "a": ("axis", a)})
    if kind == "jax":
        pytest.importorskip("jax")
        from kreisel import reduction as red

        with red.double():
            import jax.numpy as jnp

            return {"m": jnp.array(m), "a": jnp.array(a)}
    if kind == "xarray":
        import xarray as xr

        return {"m": xr.DataArray(m, dims="axis"), "a": xr.DataArray(a, dims="axis")}
    if kind == "pandas":
        import pandas as pd

        return {"m": pd.Series(m), "a": pd.Series(a)}
    make = {"list": list, "tuple": tuple, "numpy": np.array, "float32": lambda v: np.array(v, np.float32)}[kind]
    return {"m": make(m), "a": make(a)}


@pytest.mark.parametrize("kind", libraries())
def test_states_and_parameters_from_any_library(kind: str) -> None:
    """The same bits from each; numbers that are exact in single precision."""
    m, a = [0.125, 0.25, 1.5], [0.5, 0.0, 0.75]
    x0 = given(kind, m, a)
    top = kr.LagrangeTop(p=x0["a"])
    assert top.params["p"].dtype == np.float64
    run = kr.simulate(top, x0, dt=0.1, steps=20)
    plain = kr.simulate(kr.LagrangeTop(p=a), kr.LagrangeTop(p=a).state(m=m, a=a), dt=0.1, steps=20)
    assert run.m.values.tobytes() == plain.m.values.tobytes()
    assert type(run.m.values) is np.ndarray


def test_the_last_state_of_a_run_starts_the_next(run) -> None:
    """A row of a run holds integrals too; those are none of the state's business."""
    last = run.isel(time=-1)
    more = kr.simulate(run.kreisel.model, last, dt=0.1, steps=5)
    assert np.array_equal(more.m.values[0], run.m.values[-1])
    with pytest.raises(kr.InputError, match="lacks"):
        kr.simulate(run.kreisel.model, last.drop_vars("a"), dt=0.1, steps=5)
