"""Workers that do not start, die, or never come back: a result or one message, and no waiting for good."""

from __future__ import annotations

import os
import signal
import sys
import time
import types
from pathlib import Path
from typing import Any

import pytest

import kreisel as kr
from kreisel.sweeps import workers
from support import ROOT

distributed = pytest.importorskip("distributed")


def once(path: Path) -> int:
    """Kills its process when it is called for the first time."""
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return 7
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def itself(error: BaseException) -> None:
    raise error


def ignoring(_: int) -> None:
    """Does not end."""
    time.sleep(600)


def test_results_and_troubles_come_back_and_a_lost_worker_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT)  # where workers find this file
    with workers.pool(1, None, False) as hands:
        assert isinstance(hands, workers.Pool)
        assert sorted(hands.map(abs, [-1, 2, -3])) == [(0, 1), (1, 2), (2, 3)]
        assert list(hands.map(once, [tmp_path / "there"])) == [(0, 7)]
        for error in (kr.InputError("bad"), ZeroDivisionError("x")):
            with pytest.raises(type(error), match=str(error)):
                list(hands.map(itself, [error]))
        with pytest.raises(kr.RunError, match="late"):  # not taken for a result that is still to come
            list(hands.map(itself, [TimeoutError("late")]))


def test_without_workers_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 1.0)
    monkeypatch.setattr(workers, "LOOK", 0.1)
    with (
        distributed.LocalCluster(
            n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        begun = time.monotonic()
        with pytest.raises(kr.RunError, match="No worker has been there for 1 s"):
            list(workers.Pool(client, None).map(abs, [-1]))
        assert time.monotonic() - begun < 30
        hands = workers.Pool(client, "tcp://somewhere:1")  # whose workers may stand in a queue
        future = client.submit(abs, -1)
        until = time.monotonic() + 2
        while time.monotonic() < until:
            assert not list(hands._ended([future]))


def test_code_that_the_workers_cannot_import(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker leaves for good, and its task goes on waiting for one."""
    module = types.ModuleType("only_here")
    exec("def double(x): return 2 * x", module.__dict__)
    monkeypatch.setitem(sys.modules, "only_here", module)
    with workers.pool(1, None, False) as hands:
        monkeypatch.setattr(workers, "PATIENCE", 2.0)
        with pytest.raises(kr.RunError, match="code that they cannot import"):
            list(hands.map(module.double, [1]))


def test_workers_that_do_not_end_are_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "CLOSING", 0.01)
    seen: list[Any] = []
    with workers.pool(1, None, False) as hands:
        assert isinstance(hands, workers.Pool)
        seen = [hands._client.submit(ignoring, 0), *(n.pid for n in hands._client.cluster.workers.values())]
    until = time.monotonic() + 60
    while Path(f"/proc/{seen[1]}").exists():
        assert time.monotonic() < until
        time.sleep(0.1)


def test_workers_that_do_not_start_end_in_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    def cluster(**options: Any) -> None:
        assert options["death_timeout"] == workers.PATIENCE
        raise TimeoutError

    monkeypatch.setattr(distributed, "LocalCluster", cluster)
    with pytest.raises(kr.RunError, match="did not start"), workers.pool(1, None, False):
        pass


def test_a_signal_between_two_blocks_is_no_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    """It comes while the handlers are put back, when the block is done: the sweep ends as after any other signal."""
    real, stop = signal.signal, workers.Stop()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    put_back = []

    def late(number: int, handler: Any) -> Any:
        if put_back:
            put_back.pop()
            signal.raise_signal(signal.SIGTERM)
        return real(number, handler)

    monkeypatch.setattr(signal, "signal", late)
    with workers._at_once(stop):
        put_back.append(True)
    assert stop.signal == signal.SIGTERM
    monkeypatch.undo()
    assert {number: signal.getsignal(number) for number in before} == before
    with pytest.raises(ZeroDivisionError), workers._at_once(workers.Stop()):
        raise ZeroDivisionError
    again = workers.Stop()
    with workers._at_once(again):
        signal.raise_signal(signal.SIGINT)
    assert again.signal == signal.SIGINT
