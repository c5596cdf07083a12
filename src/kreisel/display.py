"""What is shown by code above the caller: `kreisel` registers where it is, and it is loaded when it is called."""

from __future__ import annotations

import importlib
from typing import Any

SHOWN: dict[str, str] = {}  # name: module:function


def show(what: str, shown: Any, **options: Any) -> Any:
    """`shown` as registered under that name."""
    module, _, function = SHOWN[what].partition(":")
    return getattr(importlib.import_module(module), function)(shown, **options)
