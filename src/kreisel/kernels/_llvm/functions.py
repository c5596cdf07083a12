"""Functions of text, and their lines."""

from __future__ import annotations

import ast
import linecache
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any


@dataclass(frozen=True, eq=False)
class Straight:
    """A function of text."""

    py_func: Any


def straight(function: Callable[..., Any]) -> Any:
    """The same function for compiled code; it is written into the code that calls it."""
    return Straight(function)


@lru_cache(12)  # the operations, and a few kernels
def _definitions(text: str) -> dict[int, ast.FunctionDef]:
    """The functions of a file by their first lines."""
    found = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    return {min([node.lineno, *(line.lineno for line in node.decorator_list)]): node for node in found}


def definition_of(function: Any) -> ast.FunctionDef:
    """The lines of a function.  Raises `TypeError` for one that takes names of a function around it."""
    code = function.__code__
    found = _definitions("".join(linecache.getlines(code.co_filename)))[code.co_firstlineno]
    if code.co_freevars:
        raise TypeError(f"expected a function that stands alone, got {function.__name__} with {code.co_freevars}")
    return found
