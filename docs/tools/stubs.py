"""src/kreisel/__init__.pyi: what editors and type checkers know of `kreisel`, made from the records.

python docs/tools/stubs.py        # make stubs
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import kreisel as kr
from kreisel.record.contract import Parameter, System
from kreisel.system import NAMED

STUB = Path(kr.__file__).with_suffix(".pyi")
HEAD = """# Made by `make stubs` from the records; not to be edited.
from numpy.typing import ArrayLike

from kreisel.errors import AccuracyWarning as AccuracyWarning
from kreisel.errors import ConservationWarning as ConservationWarning
from kreisel.errors import InputError as InputError
from kreisel.errors import InputWarning as InputWarning
from kreisel.errors import RunError as RunError
from kreisel.method import Method
from kreisel.record.contract import System
from kreisel.record.model import Model
"""
FUNCTIONS = """
__version__: str

def methods() -> list[Method]: ...
def systems() -> list[str]: ...
"""


def text() -> str:
    """The stub."""
    parts = "".join(f"from kreisel import {name} as {name}\n" for name in kr._PARTS)
    lazy = "".join(f"from {module} import {name} as {name}\n" for name, module in sorted(kr._LAZY.items()))
    classes = "".join(_class(name, system) for name, system in NAMED.items())
    return HEAD + parts + lazy + FUNCTIONS + classes


def _class(name: str, system: System) -> str:
    required = [p for p in system.parameters if p.default is None]
    optional = [p for p in system.parameters if p.default is not None]
    arguments = "".join(f"        {_argument(p)},\n" for p in [*required, *optional])
    star = "        *,\n" if arguments else ""
    text = [f"{system.title.removesuffix('.')}.", "", *(f"{p.letter}: {p.meaning}" for p in system.parameters)]
    lines = [line for each in text for line in textwrap.wrap(each, 100, subsequent_indent="    ") or [""]]
    doc = "\n".join(f"        {line}".rstrip() for line in lines).strip()
    return (
        f"\nclass _{name}(System):\n    def __call__(\n        self,\n{star}"
        f'{arguments}    ) -> Model:\n        r"""{doc}"""\n\n{name}: _{name}\n'
    )


def _argument(p: Parameter) -> str:
    return f"{p.letter}: {'int' if p.kind == 'dimension' else 'ArrayLike'}" + (
        "" if p.default is None else f" = {p.default!r}"
    )


if __name__ == "__main__":
    STUB.write_text(text(), encoding="utf-8")
    print(STUB.name)
