"""The command line: new, run, resume, sweep, check, plot, view, export, systems, methods, checkcase, verify, bench, ...

Exit codes: 0; 1 if `check` or `verify` finds a fault; 2 and one message for bad input; 3 if an invariant of the method
is not conserved (the archive is kept); 128 and more for signals.
"""

from __future__ import annotations

import io
import signal
import sys
import warnings
from typing import Any

from kreisel.cli import checkcases, new, runs, subjects  # noqa: F401 - each registers its commands
from kreisel.cli.output import NOT_CONSERVED, TOO_MUCH, app, say
from kreisel.errors import InputError, RunError, Stopped, disk_trouble

__all__ = ["NOT_CONSERVED", "app", "main"]


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    say(f"kreisel: warning: {message}", file=sys.stderr)


def main() -> None:
    """The entry point: errors that a user can mend become one message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for a terminal that lacks the letter
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # scratch files are removed
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            app()
    except Stopped as stopped:
        say(f"kreisel: {stopped}", file=sys.stderr)
        sys.exit(128 + stopped.number)
    except (InputError, RunError) as error:
        for line in f"kreisel: {error}".split("\n"):
            say(line, file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        say(f"kreisel: expected less than the memory that is free, got {error or 'more'}. {TOO_MUCH}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        say("kreisel: interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:  # a name that is too long, a folder without access
        say(f"kreisel: {disk_trouble(error, error.filename or 'a file', 'be used', '')}", file=sys.stderr)
        sys.exit(2)
