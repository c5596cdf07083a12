"""Figures, the interactive page, and records for the eye.  `kr.view(run)` is the page: the package can be called."""

from __future__ import annotations

import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kreisel.view.page import View


class _Package(types.ModuleType):
    """The package `kreisel.view`, which stands under the same name as the function that users call."""

    def __call__(self, run: Any, *, lane: int = 0) -> View:
        from kreisel.view.page import view

        return view(run, lane=lane)


sys.modules[__name__].__class__ = _Package
