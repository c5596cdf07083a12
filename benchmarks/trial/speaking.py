"""The command line in this process: its output, and how it ends."""

from __future__ import annotations

import contextlib
import io
import sys
from typing import Any


def said(words: list[str]) -> tuple[int, str, str]:
    """Exit code, output and messages of the command line in this process, warnings included."""
    from kreisel.cli import main

    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["kreisel", *words]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as stopped:
        code = stopped.code
    finally:
        sys.argv = before
    return code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue()
