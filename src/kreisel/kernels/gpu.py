"""Ensembles on an NVIDIA GPU: the kernel of `kreisel.kernels.steps`, one thread a trajectory, the time loop inside.

It is written from the same graph, so in float64 each operation is the CPU's; float32 is for those who ask for it.
Arrays and kernels of the GPU are CuPy's; tests run the same code on this processor, one thread after the other.

LLVM writes PTX from the same operations: each product is rounded separately, unless the graph fuses it.  sin,
cos, exp and log come from NVIDIA's libdevice, in the package nvidia-cuda-nvcc.
"""

from __future__ import annotations

import importlib
import importlib.util
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from kreisel.errors import InputError
from kreisel.graph.graph import TRANSCENDENTAL, TooLong
from kreisel.graph.invariants import Program, program_of, program_of_orientation, recordable
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Memory, Value
from kreisel.graph.machine import optimized
from kreisel.graph.project import GAIN, Corrections, Projected, in_loops, interval
from kreisel.graph.recording import Recording, flat_constants, flat_stages
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.kernels.steps import Split, pieces_of_step
from kreisel.method.scheme import Scheme

TRIPLE = "nvptx64-nvidia-cuda"
FLOAT = ir.FloatType()
Body = Callable[[Function, Integer, Sequence[Integer]], None]  # (f, lane, arguments): the code of one lane


class Column:
    """The values of one lane, of an array (count, lanes) of one type."""

    def __init__(self, numbers: Memory, lane: Integer, lanes: Integer):
        self._numbers, self._lane, self._lanes = numbers, lane, lanes

    def __getitem__(self, i: Any) -> Value:
        return self._numbers[self._lanes * i + self._lane]

    def __setitem__(self, i: Any, x: Any) -> None:
        self._numbers[self._lanes * i + self._lane] = x

    def beyond(self, i: Any) -> Column:
        """The values from i on."""
        return Column(self._numbers.beyond(self._lanes * i), self._lane, self._lanes)


class _Thread(Function):
    """A function of a GPU: its name is called with its lane, by thread and block."""

    on_host = False

    def __init__(self, arguments: int):
        super().__init__(arguments, triple=TRIPLE)
        self.function.calling_convention = "ptx_kernel"

    def lane(self) -> Integer:
        """The number of this thread among all."""
        block, size, thread = (self._register(name) for name in ("ctaid.x", "ntid.x", "tid.x"))
        return block * size + thread

    def _register(self, name: str) -> Integer:
        kind = ir.FunctionType(ir.IntType(32), [])
        read = ir.Function(self.module, kind, f"llvm.nvvm.read.ptx.sreg.{name}")
        return Integer(self.builder, self.builder.zext(self.builder.call(read, []), INTEGER))

    def intrinsic(self, name: str, *values: Value) -> Value:
        if name not in TRANSCENDENTAL:
            return super().intrinsic(name, *values)
        full, kind = f"__nv_{name}{'f' if values[0].type == FLOAT else ''}", values[0].type
        function = self.module.globals.get(full)
        return self.builder.call(function or ir.Function(self.module, ir.FunctionType(kind, [kind]), full), values)


@cache
def _targets() -> None:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()


@cache
def _libdevice() -> bytes:
    """NVIDIA's functions.  Raises `InputError` where the package is missing."""
    result = importlib.util.find_spec("nvidia.cuda_nvcc") if importlib.util.find_spec("nvidia") else None
    for folder in (result.submodule_search_locations or ()) if result else ():
        for file in Path(folder).glob("nvvm/libdevice/libdevice*.bc"):
            return file.read_bytes()
    raise InputError(
        "engine='cuda' needs the package nvidia-cuda-nvcc-cu12 for sin, cos, exp and log, and it was not found here. "
        "Use pip install 'kreisel[cuda]', or engine='cpu'."
    )


def ptx(arguments: int, body: Body, capability: str) -> str:
    """PTX of a kernel of integers, the last of which is the number of lanes, for GPUs of a capability such as "90"."""
    _targets()
    f = _Thread(arguments)
    lane = f.lane()
    with f.where(lane.compared("<", f.arguments[-1])):
        body(f, lane, f.arguments)
    machine = llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=f"sm_{capability}", opt=3)
    text = f.text()
    if "__nv_" not in text:
        return str(machine.emit_assembly(optimized(machine, text, 3)))
    module = llvm.parse_assembly(text)
    module.data_layout = str(machine.target_data)
    library = llvm.parse_bitcode(_libdevice())
    library.data_layout, library.triple = module.data_layout, TRIPLE
    module.link_in(library)
    for function in module.functions:
        if not function.is_declaration and function.name != "kernel":
            function.linkage = "internal"
    return str(machine.emit_assembly(optimized(machine, str(module), 3)))


THREADS = 128  # in a block
PRECISIONS = {"cuda": "float64", "cuda-float32": "float32"}
ROOM = 1 << 30  # bytes on the GPU for projections


class Gpu:
    """Arrays and kernels of an NVIDIA GPU: `launch` runs a kernel on lanes, with addresses and integers.

    Raises `InputError` if there is none, or no CuPy.
    """

    def __init__(self) -> None:
        try:
            self._cupy: Any = importlib.import_module("cupy")
            present = self._cupy.cuda.runtime.getDeviceCount() > 0
        except Exception:  # no package, no driver, no device: CuPy raises various errors
            present = False
        if not present:
            raise InputError(
                "engine='cuda' needs an NVIDIA GPU with its driver and the package CuPy (pip install "
                "'kreisel[cuda]'), and none was found here. Use engine='cpu', the default."
            )
        self._kernels: dict[tuple[Any, ...], Any] = {}

    def array(self, values: Any) -> Any:
        return self._cupy.asarray(values)

    def empty(self, shape: tuple[int, ...], kind: np.dtype[Any]) -> Any:
        return self._cupy.empty(shape, kind)

    def host(self, array: Any) -> Any:
        return self._cupy.asnumpy(array)

    def fill(self, array: Any, values: Any) -> None:
        array.set(np.ascontiguousarray(values, dtype=array.dtype))

    def compiled(self, key: tuple[Any, ...], arguments: int, body: Body) -> Any:
        key = self._cupy.cuda.Device().id, *key
        if key not in self._kernels:
            text = ptx(arguments, body, self._cupy.cuda.Device().compute_capability)
            with tempfile.TemporaryDirectory() as folder:  # CuPy reads PTX only from files
                file = Path(folder) / "kernel.ptx"
                file.write_text(text)
                self._kernels[key] = self._cupy.RawModule(path=str(file)).get_function("kernel")
        return self._kernels[key]

    def launch(self, kernel: Any, lanes: int, *arguments: Any) -> None:
        words = [np.int64(x if isinstance(x, int) else x.data.ptr) for x in (*arguments, lanes)]
        kernel((-(-lanes // THREADS),), (THREADS,), tuple(words))


@cache
def device() -> Gpu:
    """The GPU."""
    return Gpu()


def recorded_for_gpu(scheme: Scheme, constants: Floats, columns: Any, stage_columns: Any) -> Recording:
    """The record of a step.  Raises `InputError` if it is too long to be written out."""
    try:
        return Recording(scheme, constants, columns, stage_columns)
    except TooLong:
        raise InputError(
            f"engine='cuda' needs steps that can be written out, n <= 10 or so, got n = {scheme.n}. Use engine='cpu'."
        ) from None


ARGUMENTS = 8  # of the kernel of steps: addresses of z, c, s, out; rows, every, stages, lanes


def steps_of_a_lane(record: Recording, precision: str) -> Body:
    """The code of a thread: `every` steps for each row of out (rows, d, lanes); z (d, lanes), s (stages, ., lanes)."""
    kind: ir.Type = {"float64": DOUBLE, "float32": FLOAT}[precision]
    splits = [Split.of(record, piece) for piece in record.pieces]
    count = record.state

    def body(f: Function, lane: Integer, arguments: Sequence[Integer]) -> None:
        rows, every, stages, lanes = arguments[4:]
        z, c, s, out = (Column(f.doubles(address).of(kind), lane, lanes) for address in arguments[:4])
        state = f.variables(count, kind)
        state.put(z[i] for i in range(count))
        fixed: list[dict[int, Any]] = [{} for _ in splits]
        for split, values in zip(splits, fixed, strict=True):
            split.values(f, split.fixed, {"c": c, "s": s}, kind, values)

        def piece(number: int, stage: Any) -> None:
            split, values = splits[number], dict(fixed[number])
            split.values(f, split.of_stage, {"c": c, "s": s.beyond(stage * record.count("s"))}, kind, values)
            (new,) = split.outputs(f, [(values, state.get())], kind, overlap=False)
            state.put(new)

        with f.loop(0, rows) as row:
            with f.loop(0, every):
                pieces_of_step(f, record, stages, piece)
            saved = out.beyond(row * count)
            for i, memory in enumerate(state):
                saved[i] = memory[0]
        for i, memory in enumerate(state):
            z[i] = memory[0]

    return body


def projection_of_a_lane(form: Any) -> Body:
    """The code of a thread that projects lane `first` + its number: any program, by its tables."""

    def body(f: Function, lane: Integer, arguments: Sequence[Integer]) -> None:
        z, c, targets, worst, literals, *tables, room, all_lanes, first, begin, threads = arguments
        at = first + lane
        integers = [f.integers(address) for address in tables]
        k = integers[0][1]
        numbers = {
            "z": Column(f.doubles(z), at, all_lanes),
            "c": Column(f.doubles(c), at, all_lanes),
            "t": f.doubles(targets).beyond(at * k * 4),
            "w": f.doubles(worst).beyond(at * k),
            "l": f.doubles(literals),
        }
        in_loops(f, form, GAIN, numbers, DOUBLE, begin, integers, Column(f.doubles(room), lane, threads))

    return body


class GpuProjection(Corrections):
    """The projection on a device, one thread a state, of z (d, lanes) and constants (count, lanes) that lie there."""

    def __init__(self, program: Program, also: Program | None, every: int, device: Gpu, z: Any, constants: Any):
        super().__init__(program.labels, every, z.shape[1], len(also.outs) if also else 0)
        self._device, self._z, self._constants = device, z, constants
        self._arrays = {name: device.array(vars(self).pop(name)) for name in ("targets", "worst", "bound")}
        targets, worst, bound = self._arrays.values()
        self._programs = [(*self._tables(program), targets, worst)]
        if also is not None:
            self._programs.append((*self._tables(also), bound, device.array(np.zeros(bound.shape[:2]))))
        rows = max(program.rows, also.rows if also else 0)
        self._threads = min(z.shape[1], max(THREADS, ROOM // (8 * rows)))
        self._room = device.array(np.zeros((rows, self._threads)))
        self._call(1)

    def __getattr__(self, name: str) -> Any:
        """`targets`, `worst`, `bound` stay on the device: copies would last longer than the steps."""
        if name not in vars(self).get("_arrays", ()):
            raise AttributeError(name)
        return self._device.host(self._arrays[name])

    def _tables(self, program: Program) -> tuple[Any, ...]:
        arguments = 4 + 1 + len(program.tables) + 5
        kernel = self._device.compiled(("projection", *program.form), arguments, projection_of_a_lane(program.form))
        arrays = [np.ascontiguousarray(table) for table in (program.literals, *program.tables)]
        return kernel, [self._device.array(array) for array in arrays]

    def _call(self, begin: int) -> None:
        lanes = self._z.shape[1]
        for kernel, tables, targets, worst in self._programs:
            for first in range(0, lanes, self._threads):
                arrays = self._z, self._constants, targets, worst, *tables, self._room
                self._device.launch(kernel, min(self._threads, lanes - first), *arrays, lanes, first, begin)

    def apply(self) -> None:
        """Project the state, in place."""
        self._call(0)

    def peek(self, z: Floats) -> Floats:
        state, before = self._device.host(self._z), self.snapshot()
        self._device.fill(self._z, z.T)
        self._call(0)
        worst = self.worst
        self._device.fill(self._z, state)
        self.restore(before)
        return worst

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        for name, array in self._arrays.items():
            self._device.fill(array, snapshot[name])
        self.done = int(snapshot["done"])


class GpuEngine(Projected):
    """The step on a GPU; `advance` as in `kreisel.kernels.cpu.CpuEngine`.  One number of all lanes lies in one row.

    float32 is not projected: its rounding errors are far larger.
    """

    def __init__(self, scheme: Scheme, z0: Floats, engine: str, project: bool = False):
        self._device, precision = device(), PRECISIONS[engine]
        self._real = np.dtype(precision)
        self.z = np.asarray(z0).astype(self._real).astype(np.float64)
        constants, columns = flat_constants(scheme, len(self.z))
        stages, stage_columns = flat_stages(scheme, len(self.z))
        record = recorded_for_gpu(scheme, constants, columns, stage_columns)
        key = "steps", record.digest(), record.state, record.count("s"), record.stages, precision
        self._kernel = self._device.compiled(key, ARGUMENTS, steps_of_a_lane(record, precision))
        self._stage_count = stages.shape[1]
        self._constants, self._stages = self._on_device(constants.T), self._on_device(stages.transpose(1, 2, 0))
        self._state = self._on_device(self.z.T)
        try:
            program = recordable(lambda: program_of(scheme, columns)) if project and engine == "cuda" else None
        except TooLong:
            program = None
        also = program_of_orientation(scheme) if program else None
        if program is not None and len(self.z):
            cost = program.cost + (also.cost if also else 0)
            every = interval(cost, record.work * scheme.stage_count, scheme.between)
            self.projection = GpuProjection(program, also, every, self._device, self._state, self._constants)

    def _on_device(self, values: Floats) -> Any:
        return self._device.array(np.ascontiguousarray(values, dtype=self._real))

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if not len(self.z):
            return
        rows = self._device.empty((len(out), *self.z.shape[::-1]), self._real)
        super().advance(rows, every, look)
        out[:] = self._device.host(rows.transpose(0, 2, 1))
        self.z[:] = out[-1]

    def _project(self) -> Any:
        super()._project()
        return self._state

    def _advance(self, rows: Any, every: int, look: Look) -> None:
        arrays = self._state, self._constants, self._stages, rows
        self._device.launch(self._kernel, len(self.z), *arrays, len(rows), every, self._stage_count)

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        super().restore(snapshot)
        self._device.fill(self._state, self.z.T)
