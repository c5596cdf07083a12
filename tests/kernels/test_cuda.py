"""engine="cuda": on the CUDA simulator, in a process of its own; without a GPU a plain word."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.kernels import cuda
from kreisel.kernels.recording import flat_constants, flat_stages
from kreisel.method import scheme

SIMULATED = """
import numpy as np
import kreisel as kr
from kreisel import algebra
from kreisel.runs.planning import make_plan

draw = np.random.default_rng(3)
lanes = 5
top = kr.LagrangeTop(p=draw.normal(size=(lanes, 3)), alpha=0.7)
x0 = top.state(m=draw.normal(size=(lanes, 3)), a=draw.normal(size=(lanes, 3)))
body = kr.Clebsch(b=(0.3, 0.7, 1.9, 1.1))
X = draw.normal(size=(2, 4, 4))
y0 = body.state(M=X - X.mT, P=draw.normal(size=(2, 4)))
for model, start, method, order, g in (
    (top, x0, "suris", 1, (1, 0, 0, 0)), (top, x0, "baecklund", 6, None), (body, y0, "variational", 2, None),
    (body, y0, "kahan", 4, None),
):
    for engine in ("cuda", "cuda-float32"):
        if method in ("variational", "kahan") and engine == "cuda-float32":
            continue
        more = {"method": method, "order": order, "orientation": g, "engine": engine}
        plan = make_plan(model, start, dt=0.1, steps=4, every=2, **more)
        z, out = algebra.restore(plan.engine.z.copy(), plan.kinds, model.n), np.empty((2, *plan.engine.z.shape))
        plan.engine.advance(out, 2)
        for _ in range(4):
            z = plan.scheme.advance(*z)
        assert (plan.engine.z == out[-1]).all()
        print(engine, abs(out[-1] - algebra.flatten(z, plan.kinds)).max(), flush=True)
plans = [make_plan(top, x0, dt=0.1, steps=30, every=2, method="suris", order=1, orientation=None, engine=engine)
         for engine in ("cuda", "cpu")]
rows = [np.empty((15, *plan.engine.z.shape)) for plan in plans]
for plan, out in zip(plans, rows):
    plan.engine.projection.every = 7
    plan.engine.advance(out, 2)
    assert plan.engine.projection.done == 2 and (plan.engine.projection.worst < 10).all()
    assert (plan.engine.projection.worst > 0).any(0).all()
    worst = plan.engine.projection.worst.copy()
    assert (plan.engine.projection.peek(out[0] * (1 + 1e-9)) > 1e4).all()
    assert (plan.engine.projection.worst == worst).all() and (plan.engine.z == out[-1]).all()
assert abs(plans[0].engine.projection.targets - plans[1].engine.projection.targets).max() < 1e-14
print("projected", abs(rows[0] - rows[1]).max())
one = kr.LagrangeTop(p=(0, 0, 1))
start = one.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
run = kr.simulate(one, start, dt=0.1, steps=4, engine="cuda", progress=False, method="suris", path="run.zarr")
print(run.attrs["engine"], 0.0)
more = kr.resume("run.zarr", extend=6, progress=False)
whole = kr.simulate(one, start, dt=0.1, steps=6, engine="cuda", progress=False, method="suris")
assert (more.a.values == whole.a.values).all()
"""


FORCED = """
import numpy as np
import kreisel as kr

draw = np.random.default_rng(3)
body = kr.perturbed(
    kr.EulerTop(J=(1, 2, 2.5)),
    potential=lambda g, t, *, k: k * np.exp(-np.sin(t)) * g[2, 2] ** 2 + np.log(2 + g[0, 1]),
    damping=0.01,
    params={"k": draw.normal(size=5)},
)
x0 = body.state(M=draw.normal(size=(5, 3)))
struck = {"time": 0.23, "M": draw.normal(size=(5, 3))}
runs = [kr.simulate(body, x0, dt=0.1, times=[0, 0.2, 0.37, 0.6], method="splitting", order=(4, 2), engine=engine,
                    impulses=struck, orientation=(1, 0, 0, 0), progress=False) for engine in ("cuda", "cpu")]
assert runs[0].attrs["engine"] == "cuda"
for name in ("M", "g", "work"):
    print(name, abs(runs[0][name].values - runs[1][name].values).max(), abs(np.ptp(runs[1][name].values, 0)).max())
swung = kr.perturbed(
    kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
    potential=lambda P, t, *, k: k * P[0] * np.cos(t), params={"k": 1e-3},
)
asked = {"dt": 0.5, "steps": 6, "every": 2, "order": (10, 2), "orientation": (1, 0, 0, 0), "progress": False}
runs = [kr.simulate(swung, {"M": (0.3, 0.2, 1.1), "P": (0.6, 0, 0.8)}, engine=engine, **asked)
        for engine in ("cpu", "cuda")]
print("corrected", abs(runs[0].M.values - runs[1].M.values).max(), abs(np.ptp(runs[1].M.values, 0)).max())
"""


def test_forces_on_the_gpu(tmp_path: Path) -> None:
    """sin, exp and log of forces, time, damping, orientation, parameters by lane, impulses, rows within steps, a
    corrector: the same numbers as on the CPU.
    """
    env = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    run = [sys.executable, "-c", FORCED]
    out = subprocess.run(run, capture_output=True, text=True, env=env, check=False, cwd=tmp_path, timeout=300)
    assert out.returncode == 0, out.stderr
    for line in out.stdout.splitlines():
        _, apart, change = line.split()
        assert float(apart) < 1e-13 < 1e-4 < float(change)
    assert len(out.stdout.splitlines()) == 4


def test_the_kernel_of_the_gpu_is_the_definition(tmp_path: Path) -> None:
    """Per-lane parameters, orientation, stages and `close`, a recorded loop; the simulator does not fuse products."""
    env = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    run = [sys.executable, "-c", SIMULATED]
    out = subprocess.run(run, capture_output=True, text=True, env=env, check=False, cwd=tmp_path, timeout=300)
    assert out.returncode == 0, out.stderr
    apart = [line.split() for line in out.stdout.splitlines()]
    assert [name for name, _ in apart] == ["cuda", "cuda-float32"] * 2 + ["cuda", "cuda", "projected", "cuda"]
    for name, value in apart:
        assert float(value) < (1e-3 if name == "cuda-float32" else 1e-12)
        assert name != "cuda-float32" or float(value) > 1e-9  # float32 it is


def test_without_a_gpu_it_says_so(top: object, x0: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba.cuda", None)
    with pytest.raises(kr.InputError, match=r"needs an NVIDIA GPU.*engine='cpu'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda")


def test_what_no_gpu_runs(top: object, x0: object) -> None:
    with pytest.raises(kr.InputError, match="Did you mean 'cuda'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cude")
    with pytest.raises(kr.InputError, match="runs maps, not method='dop853'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda", method="dop853")
    with pytest.raises(kr.InputError, match="implicit"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda-float32", method="variational")


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_products_are_rounded_and_literals_are_of_the_precision(top: object, precision: str) -> None:
    plan = scheme(top, "suris", 0.1, 1, False)
    (constants, columns), (_, stages) = flat_constants(plan, 1), flat_stages(plan, 1)
    text = cuda.cuda_source(cuda.recorded_for_gpu(plan, constants, columns, stages), precision)
    body = text.partition("def kernel(")[2]
    assert " * " not in body
    assert "cuda.fma(" in body
    assert ("real(2.0)" in body) == (precision == "float32")
    big = kr.LagrangeTop(p=np.eye(11)[0])
    plan = scheme(big, "suris", 0.1, 1, False)
    (constants, columns), (_, stages) = flat_constants(plan, 1), flat_stages(plan, 1)
    with pytest.raises(kr.InputError, match="n = 11"):
        cuda.recorded_for_gpu(plan, constants, columns, stages)
