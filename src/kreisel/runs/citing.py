"""kr.cite: BibTeX entries of the software, the system and the method, from the attributes of records and runs."""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from kreisel.errors import InputError, explained
from kreisel.method import METHODS, default_method
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.run_record import RunRecord, as_made

if TYPE_CHECKING:
    import xarray as xr

SOFTWARE = """@software{{kreisel,
  author  = {{{{The Kreisel developers}}}},
  title   = {{Kreisel: spinning bodies simulated with integrators that keep every first integral}},
  version = {{{version}}},
  license = {{BSD-3-Clause}}
}}"""


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
