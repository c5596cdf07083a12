"""Functions of text as machine code: compiled for this processor, kept as bytes, called with arrays and numbers.

The processor is that of the machine, or what NUMBA_CPU_NAME and NUMBA_CPU_FEATURES say, which Numba reads too.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from kreisel.kernels._llvm.functions import Straight
from kreisel.kernels._llvm.memory import contiguous
from kreisel.kernels._llvm.numbers import DOUBLE, INTEGER
from kreisel.kernels._llvm.text import written

DOUBLES = {"avx512f": 8, "avx": 4}  # in a register, of processors with these features; 2 on others
FLOAT = np.dtype(np.float64)
KINDS = {"f8": (DOUBLE, FLOAT), "i8": (INTEGER, np.dtype(np.int64))}
ARGUMENT = re.compile(r"(f8|i8)(\[[:,1]*\])?")


@dataclass(frozen=True, eq=False)
class Entry(Straight):
    """A function that is called from outside, and the kinds of its arguments."""

    form: str


def compiled(form: str) -> Callable[[Any], Any]:
    """Let a function without a result be called from outside; `form`: "f8[:,::1], i8, f8" and the like.

    f8 and i8 are doubles and whole numbers; of arrays the numbers of the last axis lie side by side.
    """
    return lambda function: Entry(function, form)


def _arguments(form: str) -> list[tuple[ir.Type, Any, int]]:
    """Of each argument its kind in LLVM and NumPy and how many axes it has."""
    return [(*KINDS[kind], axes.count(":") - axes.count("::")) for kind, axes in ARGUMENT.findall(form)]


# -- the processor ---------------------------------------------------------------------------------


@cache
def processor() -> tuple[str, str, str]:
    """Triple, name and features of what is compiled for."""
    name, features = (os.environ.get(f"NUMBA_CPU_{what}") for what in ("NAME", "FEATURES"))
    if features is None:
        features = "" if name == "generic" else llvm.get_host_cpu_features().flatten()
    return llvm.get_process_triple(), name or llvm.get_host_cpu_name(), features


@cache
def version() -> str:
    """What the same text is compiled by, and for."""
    return repr((llvmlite.__version__, llvm.llvm_version_info, processor()))


def register_width() -> int:
    """How many doubles a vector register of the processor holds."""
    features = processor()[2].split(",")
    return next((width for feature, width in DOUBLES.items() if f"+{feature}" in features), 2)


@cache
def _ready() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def _machine() -> Any:
    _ready()
    triple, name, features = processor()
    target = llvm.Target.from_triple(triple)
    reloc = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(name, features, 3, reloc, "jitdefault", jit=True)


# -- compiling -------------------------------------------------------------------------------------


def _module(entries: Mapping[str, Entry]) -> str:
    """LLVM's text of functions."""
    module = ir.Module()
    module.triple = processor()[0]
    for name, entry in entries.items():
        arguments = _arguments(entry.form)
        kinds = [
            one for kind, _, axes in arguments for one in ([kind.as_pointer()] if axes else [kind]) + [INTEGER] * axes
        ]
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), kinds), name)
        builder, words = ir.IRBuilder(function.append_basic_block("entry")), iter(function.args)
        given = []
        for _, _, axes in arguments:
            word = next(words)
            given.append(contiguous(builder, word, [next(words) for _ in range(axes)]) if axes else word)
        written(builder, entry.py_func, given)
        builder.ret_void()
    return str(module)


def _optimized(entries: Mapping[str, Entry]) -> tuple[Any, Any]:
    machine = _machine()
    module = llvm.parse_assembly(_module(entries))
    module.data_layout = str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine, module


def object_code(entries: Mapping[str, Entry]) -> bytes:
    """Machine code of functions, for `loaded`."""
    machine, module = _optimized(entries)
    return bytes(machine.emit_object(module))


def assembly(entries: Mapping[str, Entry]) -> str:
    """The same to be read."""
    machine, module = _optimized(entries)
    return str(machine.emit_assembly(module))


# -- calling ---------------------------------------------------------------------------------------


class Code:
    """A compiled function of arrays and numbers.

    address  for other compiled code
    call     the same function of numbers alone: of an array its `array_words`
    """

    def __init__(self, engine: Any, name: str, form: str):
        self._kinds = [(kind, axes) for _, kind, axes in _arguments(form)]
        self.address = engine.get_function_address(name)
        words = [
            word
            for kind, axes in self._kinds
            for word in (
                [ctypes.c_void_p] + [ctypes.c_int64] * axes
                if axes
                else [ctypes.c_double if kind.kind == "f" else ctypes.c_int64]
            )
        ]
        call: Any = ctypes.CFUNCTYPE(None, *words)(self.address)
        call.engine = engine  # whoever has the one has the other
        self.call = call

    def __call__(self, *given: Any) -> None:
        words: list[Any] = []
        for value, (kind, axes) in zip(given, self._kinds, strict=True):
            words += array_words(value, kind, axes) if axes else [value]
        self.call(*words)


def array_words(array: Any, kind: Any, axes: int) -> tuple[int, ...]:
    """The address of a contiguous array, and how many numbers it has along each axis.

    Raises `TypeError` for another kind of array.
    """
    if array.dtype != kind or array.ndim != axes or not array.flags.c_contiguous:
        raise TypeError(f"expected a contiguous array of {kind} with {axes} axes, got {array.dtype} {array.shape}")
    return (array.__array_interface__["data"][0], *array.shape)


def loaded(code: bytes, forms: Mapping[str, str]) -> dict[str, Code]:
    """Functions of `object_code` by their names, and how they are called."""
    machine = _machine()
    backing = llvm.parse_assembly("")
    engine = llvm.create_mcjit_compiler(backing, machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return {name: Code(engine, name, form) for name, form in forms.items()}


def entries_of(names: Mapping[str, Any]) -> dict[str, Entry]:
    """Those functions among the names of a module that are called from outside."""
    return {name: value for name, value in names.items() if isinstance(value, Entry)}
