"""The process or the Dask workers that compute the blocks of a sweep."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from kreisel.errors import InputError, RunError
from kreisel.process import Stop, signals_to
from kreisel.record.contract import System
from kreisel.runs.settings import within
from kreisel.sweeps.store import LOST, compute

LOSSES = 5  # workers that a block may lose before it is blamed
LOOK = 0.5  # seconds between two looks at the workers
PATIENCE = 120.0  # seconds that local workers may need to start, or may all be missing
CLOSING = 20.0  # seconds after which they are killed
ANSWER = 20.0  # seconds in which the scheduler of another cluster must answer


class Here:
    """The process itself, one item after the other."""

    def map(
        self, function: Callable[..., Any], items: Sequence[Any], stop: Stop | None = None, noun: str = ""
    ) -> Iterator[tuple[Any, Any]]:
        """The index of each item and function(item), in order.  A signal of `stop` ends the present item at once."""
        for place, item in enumerate(items):
            if stop is not None and stop.signal is not None:
                return
            result = []
            try:
                with contextlib.nullcontext() if stop is None else _at_once(stop):
                    result = [function(item)]
            except KeyboardInterrupt:  # on the way out of `with`
                if stop is None or stop.signal is None:
                    raise
            yield from ((place, value) for value in result)


class Pool:
    """Dask's workers."""

    def __init__(self, client: Any, address: str | None):
        self._client, self._address, self._seen = client, address, time.monotonic()

    def map(
        self, function: Callable[..., Any], items: Sequence[Any], stop: Stop | None = None, noun: str = "Item"
    ) -> Iterator[tuple[int, Any]]:
        """The index of each item and function(item), in the order of completion; lost tasks are submitted again.

        Only a few are with the workers at a time, none after a signal of `stop`.
        """
        import distributed

        waiting, losses = iter(range(len(items))), [0] * len(items)
        at_work: dict[Any, int] = {}

        def submit(place: int) -> None:
            at_work[self._client.submit(function, items[place], pure=False)] = place

        try:
            while stop is None or stop.signal is None:
                room = 2 * max(2, sum(self._client.ncores().values())) - len(at_work)
                for place in itertools.islice(waiting, max(0, room)):
                    submit(place)
                if not at_work:
                    return
                for future in self._ended(at_work):
                    place = at_work[future]
                    try:
                        result = self._fetched(future)
                    except distributed.KilledWorker:
                        del at_work[future]
                        losses[place] += 1
                        if losses[place] >= LOSSES:
                            raise RunError(
                                f"{noun} {items[place]} lost its worker again and again. Usual cause: too little "
                                f"memory for it. Use a smaller block or memory in [sweep]. {LOST}"
                            ) from None
                        submit(place)
                        continue
                    if result:
                        del at_work[future]
                        yield place, result[0]
        except (OSError, distributed.CancelledError) as error:
            raise RunError(f"The scheduler {self._address or 'here'} went away: {error}. {LOST}") from error
        finally:
            with contextlib.suppress(Exception):
                self._client.cancel(list(at_work), force=True)

    def _fetched(self, future: Any) -> list[Any]:
        """The result of a finished task; none if its worker vanished with it, and then it is computed again."""
        try:
            return [future.result(PATIENCE)]
        except TimeoutError:
            if future.status == "error":
                raise  # the error of the task itself
            return []

    def _ended(self, at_work: Iterable[Any]) -> Iterable[Any]:
        """The finished tasks, perhaps none after a while.  Raises `RunError` if no worker is left.

        The workers of another cluster may wait in a queue for hours.  A local worker restarts after a kill, but not
        after it loses its connection, as happens with a task that it cannot read.
        """
        import distributed

        try:
            return set(distributed.wait(list(at_work), timeout=LOOK, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            pass
        if self._client.status not in ("running", "connecting"):
            raise RunError(f"The scheduler {self._address or 'here'} went away. {LOST}")
        if self._address is not None or self._client.ncores():
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > PATIENCE:
            raise RunError(
                f"No worker has been there for {PATIENCE:g} s, and none started again. Usual cause: code that they "
                f"cannot import, or too little memory. {LOST}"
            )
        return ()


def computed(
    hands: Here | Pool, folder: str, source: Path | System | None, digest: str, todo: Sequence[int], stop: Stop
) -> Iterator[dict[str, Any]]:
    """The counts of blocks as they are computed, see `kreisel.sweeps.store.compute`."""
    for _, counts in hands.map(partial(compute, folder, source, digest), todo, stop, "Block"):
        yield counts


def check_workers(workers: Any, scheduler: str | None) -> None:
    """Raises `InputError` if workers and scheduler contradict each other."""
    if workers is not None:
        within(workers, "workers, a number of processes", 0, 4096)
    if scheduler is not None and workers is not None:
        raise InputError("A scheduler has workers: give either scheduler or workers.")


@contextlib.contextmanager
def pool(workers: int | None, scheduler: str | None, progress: bool | None) -> Iterator[Here | Pool]:
    """The process or pool that computes the blocks.  Raises `InputError` without Dask, or if no scheduler answers."""
    if workers == 0:
        yield Here()
        return
    try:
        import distributed
        from distributed.utils import silence_logging_cmgr
    except ImportError:
        raise InputError(
            "Sweeps on several processes need Dask: pip install 'kreisel[sweep]'. --workers 0 needs none."
        ) from None
    with contextlib.ExitStack() as stack:
        stack.enter_context(silence_logging_cmgr(logging.CRITICAL))  # errors come as exceptions
        if scheduler is None:
            address = stack.enter_context(_processes(workers or os.cpu_count() or 1))
        else:
            address = scheduler
        try:
            client = distributed.Client(address, timeout=PATIENCE if scheduler is None else ANSWER)
            stack.callback(_closed, client)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"No Dask scheduler answers at {scheduler}: {error}. Run `dask scheduler`.") from None
        if sys.stderr.isatty() if progress is None else progress:
            print(f"dashboard: {client.dashboard_link}", file=sys.stderr)
        yield Pool(client, scheduler)


@contextlib.contextmanager
def _at_once(stop: Stop) -> Iterator[None]:
    """A context in which Ctrl-C and SIGTERM end the present block at once; it is computed again on resuming.

    Main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    inside = False

    def end(number: int, frame: FrameType | None) -> None:
        stop.signal = number
        if inside:
            raise KeyboardInterrupt

    with signals_to(end):
        try:
            try:
                inside = True
                yield
            finally:
                inside = False  # a signal that arrives while the handlers are restored
        except KeyboardInterrupt:
            if stop.signal is None:
                raise


@contextlib.contextmanager
def _processes(count: int) -> Iterator[Any]:
    """A local scheduler and `count` worker processes.  Raises `RunError` if they do not start."""
    import distributed
    import psutil

    try:
        cluster = distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            death_timeout=PATIENCE,
        )
    except (TimeoutError, OSError, RuntimeError) as error:
        reason = str(error).rstrip(".") or type(error).__name__
        raise RunError(
            f"The {count} worker processes did not start: {reason}. Usual cause: a script that calls this outside of "
            "`if __name__ == '__main__':`. Or ask for fewer workers, or 0 for none."
        ) from error
    try:
        yield cluster
    finally:
        ids = [getattr(nanny, "pid", None) for nanny in cluster.workers.values()]
        if not _closed(cluster):
            for process in filter(None, ids):
                with contextlib.suppress(psutil.NoSuchProcess):
                    psutil.Process(process).kill()


def _closed(resource: Any) -> bool:
    try:
        resource.close(timeout=CLOSING)
    except TimeoutError:
        return False
    return True
