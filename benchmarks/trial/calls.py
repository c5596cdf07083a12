"""Calls of the public Python API from a grammar: a good value, or a documented exception; nothing infinite unexplained.

A call is a function and a kind for each of its arguments (`arguments.py`); most values are of the kind, some at its
edge, some of no kind at all.  The runs, archives and states that calls are about are created once in each process.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import random
import re
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import arguments
import corruptions
import grammar
import numpy as np
from forks import apart
from pool import note

LONGEST = 2000
DATES_OR_LATER = ("epoch", "draws", "rng")  # arguments that are dates, and those that a sweep checks
SHOWN = 300
# Python's message on a call that does not fit the signature, before any code of Kreisel's runs.
MISCALLED = re.compile(r"unexpected keyword argument|missing \d+ required|positional argument|multiple values")
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]")


def make(base: Path) -> None:
    """The archives that are opened, and the kernels of the runs, created once."""
    corruptions.make(base)
    apart(arguments.make, base)


def case(rng: random.Random, folder: Path) -> str:
    """One call."""
    import api

    import kreisel as kr

    api.kinds()
    table = api.calls()
    call = rng.choices(table, [c.weight for c in table])[0]
    around = arguments.around(folder)
    with np.errstate(all="ignore"):
        given, keywords = arguments.drawn(call, around, rng)
    note(f"{call.name}({shown(given, keywords)})")
    with warnings.catch_warnings(record=True) as said, quiet() as printed:
        warnings.simplefilter("always")
        try:
            value = call.function(around)(*given, **keywords)
            if call.then is not None:
                value = call.then(value)
        except (kr.InputError, kr.RunError) as error:
            words = str(error)
            if len(words) < 20 or len(words) > LONGEST:
                raise AssertionError(f"a message of {len(words)} characters: {words[:200]!r}") from None
            return f"{call.group}: refused"
        except TypeError as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            if MISCALLED.search(str(error)) and Path(last.filename).parent == Path(__file__).parent:
                return f"{call.group}: refused"
            raise
        except AttributeError as error:
            if call.attribute and "has the components" in str(error):
                return f"{call.group}: refused"
            raise
    numbers = {k: v for k, v in (*enumerate(given), *keywords.items()) if k not in DATES_OR_LATER}
    nonsense = [name for name, v in numbers.items() if grammar.no_number(v)]
    if nonsense:
        raise AssertionError(f"accepted, though no number can be read from it: argument {nonsense[0]}")
    if printed.getvalue():
        raise AssertionError(f"it prints: {printed.getvalue()[:200]!r}")
    loud = [w for w in said if issubclass(w.category, RuntimeWarning) and w.category.__name__ != "ConservationWarning"]
    if loud and not call.infinite:
        raise AssertionError(f"a warning, {loud[0].message}, and no error")
    lost = infinite(value)
    if lost and not call.infinite:
        raise AssertionError(f"not finite, and nothing was said: {lost}")
    leftover = [n for n in os.listdir(folder) if re.search(r"\.lock$|\.old-|\.new$", n)]
    if leftover:
        raise AssertionError(f"left {leftover}")
    return f"{call.group}: carried out"


@contextlib.contextmanager
def quiet() -> Any:
    """Printed text, caught."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        yield out


def shown(given: list[Any], keywords: dict[str, Any]) -> str:
    """Arguments as text, shortened."""
    words = [_text(v) for v in given] + [f"{k}={_text(v)}" for k, v in keywords.items()]
    return ", ".join(words)


def _text(value: Any) -> str:
    try:
        if type(value).__name__ == "Dataset":
            return f"<run {value.attrs.get('system')} {dict(value.sizes)}>"
        return repr(value)[:SHOWN]
    except Exception as error:
        return f"<{type(value).__name__}: {type(error).__name__}>"


def infinite(value: Any, path: str = "value") -> str:
    """Where a number is not finite, if anywhere; of the values that come back, whatever they are."""
    kind = type(value).__name__
    if isinstance(value, bool | str | bytes) or value is None:
        return ""
    if isinstance(value, float | np.floating):
        return "" if math.isfinite(value) else path
    if isinstance(value, np.ndarray):
        return path if value.dtype.kind in "fc" and not np.isfinite(value).all() else ""
    if kind == "Dataset":
        found = (infinite(np.asarray(v.values), f"{path}[{k!r}]") for k, v in value.variables.items())
        return next((f for f in found if f), "")
    if kind in ("DataFrame", "Series", "DataArray"):
        columns = value.items() if kind == "DataFrame" else [("", value)]
        found = (infinite(np.asarray(v), f"{path}[{k!r}]") for k, v in columns)
        return next((f for f in found if f), "")
    if isinstance(value, Mapping):
        return next((f for f in (infinite(v, f"{path}[{k!r}]") for k, v in value.items()) if f), "")
    if isinstance(value, list | tuple):
        return next((f for f in (infinite(v, f"{path}[{i}]") for i, v in enumerate(value)) if f), "")
    return ""


def ignored(value: Any) -> None:
    """A result that is text, a picture or a page: it only has to exist."""
