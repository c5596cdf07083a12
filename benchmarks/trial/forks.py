"""Functions in a forked process: none of them may have started threads before, and none leaves them behind."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any


class Apart(Exception):
    """The exception of a function in a separate process; `kind` is the name of its class."""

    def __init__(self, kind: str, words: str):
        self.kind = kind
        super().__init__(f"{kind}: {words}")


def apart(function: Callable[..., Any], *args: Any) -> Any:
    """The value of a function, as JSON keeps it, computed in a separate process.  Raises `Apart`."""
    read, write = os.pipe()
    pid = begun(_answering, write, function, *args)
    os.close(write)
    try:
        with os.fdopen(read) as file:
            text = file.read()
    except BaseException:  # the alarm of the case
        ended(pid, signal.SIGKILL)
        raise
    status = ended(pid)
    if not text:
        raise Apart("Died", f"status {status}")
    answer = json.loads(text)
    if "raised" in answer:
        raise Apart(answer["raised"], answer["words"])
    return answer["value"]


def begun(function: Callable[..., Any], *args: Any) -> int:
    """Start a function in a separate process; its process id.  It ends with 0, or 1 if it raises."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        signal.setitimer(signal.ITIMER_REAL, 0)  # of the processor's time a child has none
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        function(*args)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(BaseException):
            sys.stderr.flush()
        os._exit(code)


def ended(pid: int, number: int | None = None, patience: float = 60.0) -> int:
    """Wait for a process, after a signal if there is one: its exit code, minus the signal that ended it.

    A process that does not end is killed; raises `TimeoutError`.
    """
    if number is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, number)
    end = time.monotonic() + patience
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    raise TimeoutError(f"a process did not end within {patience:g} s")


def _answering(write: int, function: Callable[..., Any], *args: Any) -> None:
    try:
        answer = {"value": function(*args)}
    except BaseException as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "kreisel" in f.filename]
        where = " <- ".join(f"{f.name}:{f.lineno}" for f in reversed(frames[-3:]))
        answer = {"raised": type(error).__name__, "words": f"{error} [{where}]"}
    with os.fdopen(write, "w") as file:
        json.dump(answer, file)
