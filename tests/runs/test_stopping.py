"""No engine is exempt: within a row a run obeys its signals, and one that would not end says so."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.runs import integration
from kreisel.runs.operations import load_system
from kreisel.sweeps import workers
from sizes import full
from support import ROOT, ended, started

CONFIG = """
[system]
name = "lagrange-top"
p = [0.0, 0.0, 1.0]
[state]
m = {m}
a = [0.6, 0.0, 0.8]
[run]
method = "dop853"
dt = 0.05
steps = 1000
[output]
path = "run.zarr"
"""


def contents(store: Path) -> dict[str, bytes]:
    return {str(p.relative_to(store)): p.read_bytes() for p in store.rglob("*") if p.is_file() and "/c/" in str(p)}


@pytest.mark.parametrize("size", [1e6, *full(1e9), 1e100, 1e200])
def test_dop853_gives_up_where_it_would_not_end(size: float, top: object) -> None:
    begun = time.monotonic()
    with pytest.raises(kr.RunError, match=r"expected .*, got .*Usual cause") as error:
        kr.simulate(top, {"m": (0.1 * size, 0.2 * size, size), "a": (0.6, 0, 0.8)}, dt=0.05, steps=4, method="dop853")
    assert time.monotonic() - begun < 30
    assert ("smaller dt" if size < 1e150 else "overflows") in str(error.value)


def test_dop853_without_a_first_step() -> None:
    """SciPy's choice of the first step is NaN where the right-hand side overflows, and its loop then never ends."""
    body = kr.Kirchhoff(C=[[0, 1, 2], [1, 0, 3], [2, 3, 0]], B=(-1, -2, -3))
    x0 = body.state(M=(1e200, 2e200, 3e200), P=(1e200, -1e200, 2e200))
    with pytest.raises(kr.RunError, match=r"expected a finite step, got nan.*Usual cause"):
        kr.simulate(body, x0, dt=0.05, steps=4, method="dop853")


def test_fast_motion_within_the_limit_of_dop853(top: object) -> None:
    """A turn in a thousandth of dt is no reason to give up, and as many rows as one likes are none."""
    x0 = top.state(m=(0, 0, 1e4), a=(0, 0, 1))
    run = kr.simulate(top, x0, dt=0.05, steps=4, every=4, method="dop853")
    np.testing.assert_allclose(run.m[-1], (0, 0, 1e4))


def stop_within_a_call(calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal while the engine is at work on a call that lasts, after so many calls."""
    original, count = integration.Integration._call, iter(range(10**9))

    def call(self: integration.Integration, out: np.ndarray, every: int) -> None:
        if next(count) == calls:
            os.kill(os.getpid(), signal.SIGTERM)
        original(self, out, every)

    monkeypatch.setattr(integration, "LONG_SECONDS", -1.0)
    monkeypatch.setattr("kreisel.storage.simulate.CHECKPOINT_SECONDS", 1e9)  # a call may take longer on a busy machine
    monkeypatch.setattr(integration.Integration, "_call", call)


@pytest.mark.parametrize("method", ["dop853", "exact"])
@pytest.mark.parametrize("calls", [1, 3])
def test_a_signal_within_a_call_keeps_the_last_checkpoint(
    method: str, calls: int, top: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, path = np.random.default_rng(1), tmp_path / "run.zarr"
    x0 = top.state(m=20 * rng.standard_normal((2, 3)), a=rng.standard_normal((2, 3)))
    options = {"dt": 0.05, "steps": 300, "every": 70, "method": method}
    kr.simulate(top, x0, path=tmp_path / "whole.zarr", **options)
    with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM after 0 steps"):
        stop_within_a_call(calls, patch)
        kr.simulate(top, x0, path=path, **options)  # its checkpoint is that before the first step
    kr.resume(path)
    assert contents(path) == contents(tmp_path / "whole.zarr")


def test_loops_of_jax_are_stopped_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = load_system("my-kovalevskaya-top", ROOT / "examples" / "own_lagrangian.py")(c=1.0)
    x0 = own.state(M=(1.2, 0.4, 0.9), P=(0.6, 0.0, 0.8))
    with pytest.raises(kr.RunError, match="stopped by SIGTERM after 0 steps"):
        stop_within_a_call(3, monkeypatch)
        kr.simulate(own, x0, dt=0.05, steps=300, every=70, path=tmp_path / "run.zarr")
    assert (tmp_path / "run.zarr.part" / "engine" / "checkpoint.npz").is_file()


SLOW = "[[0.0, 0.0, 2e4], " + ", ".join(f"[0.0, {k}.0, 2e4]" for k in range(1, 40)) + "]"  # 10 s a step


@pytest.mark.parametrize("number", [signal.SIGTERM, *full(signal.SIGINT)])
def test_the_command_line_stops_within_a_step(number: int, tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(CONFIG.format(m=SLOW))
    code = """
import sys
from kreisel.cli import main
from kreisel.kernels import ode
ode._bound, bound = lambda *args: print(flush=True) or bound(*args), ode._bound
sys.argv = ["kreisel", "run", "run.toml"]
main()
"""
    status, message, seconds = ended(started(tmp_path, code, 0.5), number)
    assert (status, "kreisel resume" in message) == (128 + number, True), message
    assert seconds < 8
    assert kr.open_run(tmp_path / "run.zarr.part").sizes["time"] == 1


def test_a_run_in_memory_obeys_ctrl_c(tmp_path: Path) -> None:
    code = f"""
import signal
import kreisel as kr
from kreisel.kernels import ode
signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell ignore it
ode._bound, bound = lambda *args: print(flush=True) or bound(*args), ode._bound  # at work: imports may lose a signal
top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m={SLOW}, a=(0.6, 0, 0.8))
kr.simulate(top, x0, dt=0.05, steps=1000, method="dop853")
"""
    status, message, seconds = ended(started(tmp_path, code, 0.5), signal.SIGINT)
    assert status == -signal.SIGINT, message
    assert "KeyboardInterrupt" in message
    assert seconds < 5


def test_a_sweep_in_this_process_stops_within_a_block(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, count = workers.compute, iter(range(10**9))
    design = kr.Design(together={"system.alpha": [0.5, 1.0, 1.5, 2.0]})
    options = {"design": design, "block": 1, "workers": 0, "dt": 0.1, "steps": 30}

    def compute(*args: object) -> dict[str, object]:
        if next(count) == 2:
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(10**4):  # as if it took its time
                time.sleep(0.01)
        return original(*args)

    kr.sweep(top, x0, path=tmp_path / "whole.zarr", **options)
    with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM after 2 of 4 blocks"):
        patch.setattr(workers, "compute", compute)
        kr.sweep(top, x0, path=tmp_path / "s.zarr", **options)
    kr.sweep(top, x0, path=tmp_path / "s.zarr", **options)
    assert contents(tmp_path / "s.zarr") == contents(tmp_path / "whole.zarr")
