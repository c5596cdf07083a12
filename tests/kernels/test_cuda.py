"""engine="cuda": the code of a GPU, one thread after the other on this processor; PTX that NVIDIA's assembler takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from gpus import Here, here
from kreisel.graph.graph import Graph
from kreisel.graph.llvm import Function, Integer
from kreisel.graph.recording import flat_constants, flat_stages
from kreisel.kernels import gpu
from kreisel.kernels.gpu import Body, Column, ptx
from kreisel.method import scheme
from kreisel.runs.planning import make_plan

LANES = 5


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> None:
    """The GPU of this machine; without one this processor, which runs the same code one thread after the other."""
    try:
        gpu.device()
    except kr.InputError:
        monkeypatch.setattr(gpu, "device", Here)


def starts() -> tuple[Any, Any, Any, Any]:
    """A top and a body of Clebsch's case, n = 4, with parameters by lane."""
    draw = np.random.default_rng(3)
    top = kr.LagrangeTop(p=draw.normal(size=(LANES, 3)), alpha=0.7)
    x0 = top.state(m=draw.normal(size=(LANES, 3)), a=draw.normal(size=(LANES, 3)))
    body, X = kr.Clebsch(b=(0.3, 0.7, 1.9, 1.1)), draw.normal(size=(2, 4, 4))
    return top, x0, body, body.state(M=X - X.mT, P=draw.normal(size=(2, 4)))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("case", ["orientation", "stages", "loop", "close"])
def test_the_kernel_of_the_gpu_is_that_of_the_cpu(case: str) -> None:
    """Parameters by lane, orientation, stages and `close`, a recorded loop: bit for bit; float32 it is."""
    top, x0, body, y0 = starts()
    model, start, method, order, g = {
        "orientation": (top, x0, "suris", 1, (1, 0, 0, 0)),
        "stages": (top, x0, "baecklund", 6, None),
        "loop": (body, y0, "variational", 2, None),
        "close": (body, y0, "kahan", 4, None),
    }[case]
    rows = {}
    for engine in ("cpu", "cuda", *(["cuda-float32"] if model is top else [])):
        asked = {"method": method, "order": order, "orientation": g, "engine": engine, "project": False}
        plan = make_plan(model, start, dt=0.1, steps=4, every=2, **asked)
        rows[engine] = np.empty((2, *plan.engine.z.shape))
        plan.engine.advance(rows[engine], 2)
        assert (plan.engine.z == rows[engine][-1]).all()
    assert (rows["cuda"] == rows["cpu"]).all()
    if "cuda-float32" in rows:
        assert 1e-9 < abs(rows["cuda-float32"] - rows["cpu"]).max() < 1e-3


@pytest.mark.usefixtures("device")
def test_the_projection_of_the_gpu() -> None:
    top, x0, *_ = starts()
    asked = {"dt": 0.1, "steps": 30, "every": 2, "method": "suris", "order": 1, "orientation": None}
    plans = [make_plan(top, x0, engine=engine, **asked) for engine in ("cuda", "cpu")]
    rows = [np.empty((15, *plan.engine.z.shape)) for plan in plans]
    for plan, out in zip(plans, rows, strict=True):
        plan.engine.projection.every = 7
        plan.engine.advance(out, 2)
        projection = plan.engine.projection
        assert projection.done == 2
        assert (projection.worst < 10).all()
        assert (projection.worst > 0).any(0).all()
        worst = projection.worst.copy()
        assert (projection.peek(out[0] * (1 + 1e-9)) > 1e4).all()
        assert (projection.worst == worst).all()
        assert (plan.engine.z == out[-1]).all()
    targets = [plan.engine.projection.targets for plan in plans]
    assert abs(targets[0] - targets[1]).max() < 1e-14
    assert abs(rows[0] - rows[1]).max() < 1e-12


@pytest.mark.usefixtures("device")
def test_runs_on_the_gpu_are_stored_and_go_on(tmp_path: Path) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    start = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    asked = {"dt": 0.1, "engine": "cuda", "progress": False, "method": "suris"}
    run = kr.simulate(top, start, steps=4, path=tmp_path / "run.zarr", **asked)
    assert run.attrs["engine"] == "cuda"
    more = kr.resume(tmp_path / "run.zarr", extend=6, progress=False)
    assert (more.a.values == kr.simulate(top, start, steps=6, **asked).a.values).all()


def forced() -> tuple[Any, Any, dict[str, Any]]:
    draw = np.random.default_rng(3)
    body = kr.perturbed(
        kr.EulerTop(J=(1, 2, 2.5)),
        potential=lambda g, t, *, k: k * np.exp(-np.sin(t)) * g[2, 2] ** 2 + np.log(2 + g[0, 1]),
        damping=0.01,
        params={"k": draw.normal(size=5)},
    )
    struck = {"time": 0.23, "M": draw.normal(size=(5, 3))}
    asked = {"dt": 0.1, "method": "splitting", "order": (4, 2), "orientation": (1, 0, 0, 0), "progress": False}
    return body, body.state(M=draw.normal(size=(5, 3))), {**asked, "times": [0, 0.2, 0.37, 0.6], "impulses": struck}


@pytest.mark.usefixtures("device")
def test_forces_on_the_gpu() -> None:
    """sin, exp and log of forces, time, damping, orientation, parameters by lane, impulses, rows within steps, a
    corrector: the same numbers as on the CPU.
    """
    body, x0, asked = forced()
    runs = [kr.simulate(body, x0, engine=engine, **asked) for engine in ("cuda", "cpu")]
    assert runs[0].attrs["engine"] == "cuda"
    swung = kr.perturbed(
        kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
        potential=lambda P, t, *, k: k * P[0] * np.cos(t),
        params={"k": 1e-3},
    )
    asked = {"dt": 0.5, "steps": 6, "every": 2, "order": (10, 2), "orientation": (1, 0, 0, 0), "progress": False}
    corrected = [
        kr.simulate(swung, {"M": (0.3, 0.2, 1.1), "P": (0.6, 0, 0.8)}, engine=engine, **asked)
        for engine in ("cuda", "cpu")
    ]
    for (gpu_run, cpu_run), names in ((runs, ("M", "g", "work")), (corrected, ("M",))):
        for name in names:
            assert abs(gpu_run[name].values - cpu_run[name].values).max() < 1e-13
            assert abs(np.ptp(cpu_run[name].values, 0)).max() > 1e-4


def test_without_a_gpu_it_says_so(top: object, x0: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cupy", None)  # as if it were not installed
    monkeypatch.setattr(gpu, "device", gpu.Gpu)
    with pytest.raises(kr.InputError, match=r"needs an NVIDIA GPU.*engine='cpu'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda")


def test_what_no_gpu_runs(top: object, x0: object) -> None:
    with pytest.raises(kr.InputError, match="Did you mean 'cuda'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cude")
    with pytest.raises(kr.InputError, match="runs maps, not method='dop853'"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda", method="dop853")
    with pytest.raises(kr.InputError, match="implicit"):
        kr.simulate(top, x0, dt=0.1, steps=3, engine="cuda-float32", method="variational")
    big = kr.LagrangeTop(p=np.eye(11)[0])
    plan = scheme(big, "suris", 0.1, 1, False)
    (constants, columns), (_, stages) = flat_constants(plan, 1), flat_stages(plan, 1)
    with pytest.raises(kr.InputError, match="n = 11"):
        gpu.recorded_for_gpu(plan, constants, columns, stages)


# -- PTX ---------------------------------------------------------------------------------------------


def check_assembled(text: str, folder: Path) -> None:
    """NVIDIA's assembler, of its package, takes the text, or the test fails with what it says."""
    nvcc = pytest.importorskip("nvidia.cuda_nvcc")
    (assembler,) = [Path(place) / "bin" / "ptxas" for place in nvcc.__path__]
    (folder / "kernel.ptx").write_text(text)
    words = [str(assembler), "-arch=sm_80", str(folder / "kernel.ptx"), "-o", str(folder / "kernel.cubin")]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert (folder / "kernel.cubin").stat().st_size > 0


def body_of(model: Any, method: str, precision: str = "float64") -> Body:
    plan = scheme(model, method, 0.1, 1 if method == "suris" else 2, False)
    (constants, columns), (_, stages) = flat_constants(plan, 1), flat_stages(plan, 1)
    return gpu.steps_of_a_lane(gpu.recorded_for_gpu(plan, constants, columns, stages), precision)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_products_are_rounded_as_the_graph_says(top: object, precision: str, tmp_path: Path) -> None:
    text = ptx(gpu.ARGUMENTS, body_of(top, "suris", precision), "80")
    mark = {"float64": "f64", "float32": "f32"}[precision]
    other = {"f64": "f32", "f32": "f64"}[mark]
    assert f"fma.rn.{mark}" in text
    assert f"mul.rn.{mark}" in text  # not `mul`, which the assembler may fuse
    assert f".{other}" not in text.replace(f".reg .{other}", "")
    assert "ld.local" not in text
    check_assembled(text, tmp_path)


def test_what_the_assembler_refuses_fails(tmp_path: Path) -> None:
    with pytest.raises(AssertionError):
        check_assembled(".version 8.0\n.target sm_80\nnonsense", tmp_path)


def test_a_loop_and_a_projection_as_ptx(tmp_path: Path) -> None:
    check_assembled(ptx(gpu.ARGUMENTS, body_of(kr.Clebsch(b=(0.3, 0.7, 1.9)), "variational"), "80"), tmp_path)
    tables = 17
    for form in ((False, ()), (False, ((0, 3), (3, 6)))):
        check_assembled(ptx(tables, gpu.projection_of_a_lane(form), "80"), tmp_path)


def test_functions_of_nvidia_are_linked(tmp_path: Path) -> None:
    graph = Graph()
    x = graph.input("x", 0)
    outputs = [x.sin() + x.cos() * x.exp() - x.log()]

    def body(f: Function, lane: Integer, arguments: Any) -> None:
        source, target, lanes = arguments
        column = Column(f.doubles(source), lane, lanes)
        Column(f.doubles(target), lane, lanes)[0] = f.outputs(graph, outputs, lambda _, i: column[i])[0]

    text = ptx(3, body, "80")
    assert ".extern" not in text
    check_assembled(text, tmp_path)
    values, out = np.array([0.3, 0.7]), np.empty(2)
    here(("functions",), 3, body)(values.ctypes.data, out.ctypes.data, 2)
    right = np.sin(values) + np.cos(values) * np.exp(values) - np.log(values)
    np.testing.assert_allclose(out, right, rtol=1e-14)
