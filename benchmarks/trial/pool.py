"""Numbered cases in separate processes, each with limits of time and memory, from one seed.

A case is a function (rng, folder) -> its outcome, in a word; whatever it raises is a fault.  Its random numbers
depend only on the seed, the part and its number, so that one case can be repeated.
"""

from __future__ import annotations

import json
import os
import random
import re
import resource
import selectors
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sandbox

SECONDS = 20  # of a case, of processor time: a busy machine is not a fault
PATIENCE = 3  # times as long on the clock
GRACE = 5.0  # seconds beyond, before a process that obeys no signal is killed
ADDRESS_SPACE = 8 << 30
RECYCLED = 1500  # cases of a process: memory and open files do not add up
TELL = 10.0  # seconds between two lines of progress
MOST_FAULTS = 60  # listed in full

Case = Callable[[random.Random, Path], str]


_listening: list[Any] = []  # the pipe to the parent


def note(text: str) -> None:
    """The subject of the case, reported at once, in case it hangs or dies."""
    for out in _listening:
        print(json.dumps({"note": text[:2000]}), file=out, flush=True)


class Hang(BaseException):
    """A case that took too long; no `Exception`, so that nothing under trial catches it."""


@dataclass
class Part:
    """A part of the trial: its name, one case, how many for 30 minutes, their share of the time, the legend."""

    name: str
    case: Case
    count: int
    share: float
    seconds: int = SECONDS
    before: Callable[[Path], Any] = lambda folder: None
    warm: Callable[[Path], Any] = lambda base: None  # in each process, before its cases


@dataclass
class Tally:
    """The outcome of a part."""

    asked: int
    done: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: list[dict[str, Any]] = field(default_factory=list)
    seconds: float = 0.0
    slow: Counter[str] = field(default_factory=Counter)  # seconds by outcome

    @property
    def failed(self) -> int:
        """How many cases did not hold."""
        return self.outcomes["fault"]


@contextmanager
def limit(seconds: float) -> Iterator[None]:
    """Raises `Hang` after some seconds of the processor, or three times as many on the clock."""

    def ring(number: int, _: object) -> None:
        clock = number == signal.SIGALRM
        raise Hang(f"more than {PATIENCE * seconds if clock else seconds:g} s {'' if clock else 'of the processor'}")

    timers = ((signal.SIGALRM, signal.ITIMER_REAL, PATIENCE * seconds), (signal.SIGPROF, signal.ITIMER_PROF, seconds))
    for number, timer, span in timers:
        signal.signal(number, ring)
        signal.setitimer(timer, span)
    try:
        yield
    finally:
        for _, timer, _ in timers:
            signal.setitimer(timer, 0)


def carried_out(part: Part, number: int, seed: int, folder: Path) -> dict[str, Any]:
    """One case in an empty folder, and its outcome."""
    rng = random.Random(f"{seed} {part.name} {number}")
    begun = time.monotonic()
    sentinel = folder.parent.parent / "sentinel"
    before = sandbox.listing(sentinel)
    folder.mkdir(parents=True)
    os.chdir(folder)
    try:
        with limit(part.seconds):
            outcome: dict[str, Any] = {"outcome": part.case(rng, folder)}
    except BaseException as error:
        outcome = {"outcome": "fault", "what": f"{type(error).__name__}: {error}"[:1000], "where": _where(error)}
    if not sandbox.stays(sentinel, before):
        outcome = {
            "outcome": "fault",
            "what": f"a file outside the case's folder was touched; {outcome}",
            "where": "",
        }
    os.chdir("/")
    emptied(folder)
    return {"case": number, "seconds": round(time.monotonic() - begun, 2), **outcome}


def emptied(folder: Path) -> None:
    """Remove a folder, whatever its modes are."""

    def mend(remove: Any, path: str, _: Any) -> None:
        with suppress(OSError):
            os.chmod(os.path.dirname(path), 0o700)
            os.chmod(path, 0o700)
            remove(path)

    shutil.rmtree(folder, onerror=mend)


def _where(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    places = [
        f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in frames if "kreisel" in f.filename or f is frames[-1]
    ]
    return " <- ".join(reversed(places[-4:]))


def work(part: Part, numbers: list[int], seed: int, base: Path, pipe: int) -> None:
    """Cases one after the other, each reported on the pipe; does not return."""
    code = 1
    try:
        os.setsid()
        sandbox.die_with_parent()
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1):
            os.dup2(null, number)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with os.fdopen(pipe, "w") as out:
            _listening.append(out)
            part.warm(base)
            for number in numbers[:RECYCLED]:
                print(json.dumps({"begins": number}), file=out, flush=True)
                outcome = carried_out(part, number, seed, base / "cases" / f"{os.getpid()}-{number}")
                print(json.dumps(outcome), file=out, flush=True)
                if outcome.get("what", "").startswith("Hang"):
                    break  # something may still be waiting in here
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


class _Worker:
    """A process with its cases, as its parent sees it."""

    def __init__(self, part: Part, numbers: list[int], seed: int, base: Path):
        self.part, self.left, self.seed, self.base = part, numbers, seed, base
        self.start()

    def start(self) -> None:
        """Begin with the cases that are left."""
        mine, theirs = os.pipe()
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if not self.pid:
            os.close(mine)
            work(self.part, self.left, self.seed, self.base, theirs)
        os.close(theirs)
        os.set_blocking(mine, False)
        self.pipe, self.text, self.current, self.about = mine, b"", None, ""
        self.since = time.monotonic()

    def kill(self) -> None:
        """End the process and all that it started."""
        for target in (lambda: os.killpg(self.pid, signal.SIGKILL), lambda: os.kill(self.pid, signal.SIGKILL)):
            with suppress(ProcessLookupError, PermissionError):
                target()

    def lines(self) -> tuple[list[dict[str, Any]], bool]:
        """Reports since the last call, and whether the process has ended."""
        ended = False
        while True:
            try:
                data = os.read(self.pipe, 1 << 16)
            except BlockingIOError:
                break
            ended = not data
            if ended:
                break
            self.text += data
        *whole, self.text = self.text.split(b"\n")
        return [json.loads(line) for line in whole], ended


def carry_out(part: Part, count: int, seconds: float, seed: int, base: Path, workers: int) -> Tally:
    """All cases of a part, or as many as the time allows."""
    part.before(base)
    tally, begun, last = Tally(count), time.monotonic(), time.monotonic()
    hands = [_Worker(part, list(range(w, count, workers)), seed, base) for w in range(min(workers, count))]
    while hands:
        with selectors.DefaultSelector() as look:
            for hand in hands:
                look.register(hand.pipe, selectors.EVENT_READ)
            look.select(0.5)
        for hand in list(hands):
            _look_at(hand, tally, part)
            late = time.monotonic() - begun > seconds
            if late or not hand.left:
                hand.kill()
                os.waitpid(hand.pid, 0)
                os.close(hand.pipe)
                hands.remove(hand)
        if time.monotonic() - last > TELL:
            last = time.monotonic()
            print(f"{part.name}: {tally.done} of {count}, {tally.failed} do not hold", file=sys.stderr, flush=True)
    tally.seconds = round(time.monotonic() - begun, 1)
    shutil.rmtree(base / "cases", ignore_errors=True)
    (base / "cases").mkdir(exist_ok=True)
    return tally


def _look_at(hand: _Worker, tally: Tally, part: Part) -> None:
    lines, ended = hand.lines()
    for line in lines:
        hand.since = time.monotonic()
        if "note" in line:
            hand.about = line["note"]
            continue
        if "begins" in line:
            hand.current, hand.about = line["begins"], ""
            continue
        if line["outcome"] == "fault" and hand.about:
            line["about"] = brief(hand.about)
        hand.left.remove(line["case"])
        hand.current = None
        _count(tally, line)
    stuck = hand.current is not None and time.monotonic() - hand.since > PATIENCE * part.seconds + GRACE
    if stuck:
        hand.kill()
    if (ended or stuck) and hand.left:
        _, status = os.waitpid(hand.pid, 0)
        os.close(hand.pipe)
        if hand.current is not None or status:
            number = hand.current if hand.current is not None else hand.left[0]
            how = "hangs, and obeys no signal" if stuck else f"the process died: status {status}"
            hand.left.remove(number)
            _count(tally, {"case": number, "outcome": "fault", "what": how, "where": "", "about": brief(hand.about)})
        hand.start()


def brief(text: str) -> str:
    """Text without repetitions, and not too long."""
    return re.sub(r"(.)\1{40,}", r"\1\1\1...", text)[:1500]


def _count(tally: Tally, line: dict[str, Any]) -> None:
    tally.done += 1
    tally.outcomes[line["outcome"]] += 1
    tally.slow[line["outcome"]] += line.get("seconds", 0.0)
    if line["outcome"] == "fault":
        print(f"FAULT {json.dumps(line)}", file=sys.stderr, flush=True)
        if len(tally.faults) < MOST_FAULTS:
            tally.faults.append(line)
