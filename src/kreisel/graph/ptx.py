"""Functions for NVIDIA GPUs: the operations of a graph as PTX, one thread a lane.

LLVM writes PTX from the same operations: each product is rounded separately, unless the graph fuses it.  sin,
cos, exp and log come from NVIDIA's libdevice, in the package nvidia-cuda-nvcc.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir

from kreisel.errors import InputError
from kreisel.graph.graph import TRANSCENDENTAL
from kreisel.graph.llvm import INTEGER, Function, Integer, Memory, Value
from kreisel.graph.machine import optimized

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
