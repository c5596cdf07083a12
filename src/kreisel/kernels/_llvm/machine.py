"""Functions of text as machine code: compiled for this processor, kept as bytes, called with arrays and numbers.

The processor is that of the machine, or what NUMBA_CPU_NAME and NUMBA_CPU_FEATURES say, which Numba reads too.
"""

from __future__ import annotations

import ctypes
import os
import re
import struct
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from kreisel.errors import InputError, shown
from kreisel.kernels._llvm.functions import Straight
from kreisel.kernels._llvm.memory import contiguous
from kreisel.kernels._llvm.numbers import DOUBLE, INDEX, INTEGER
from kreisel.kernels._llvm.text import written

DOUBLES = {"avx512f": 8, "avx": 4}  # in a register, of processors with these features; 2 on others
KINDS = {"f8": (DOUBLE, "d"), "i8": (INTEGER, np.dtype(np.int64).char)}
# In words of 64 bits: what of an array lies where, and in its dtype the letters of its kind.
DATA, COUNT, LENGTHS, KIND, FLAGS = (object.__basicsize__ // 8 + k for k in (0, 1, 2, 5, 6))
LETTERS = object.__basicsize__ // 8 + 1
IN_A_ROW = 0x101  # of the flags: C-contiguous and aligned
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


def _arguments(form: str) -> list[tuple[ir.Type, str, int]]:
    """Of each argument its kind in LLVM, its letter in NumPy, and how many axes it has."""
    return [(*KINDS[kind], axes.count(":") - axes.count("::")) for kind, axes in ARGUMENT.findall(form)]


# -- the processor ---------------------------------------------------------------------------------


@cache
def processor() -> tuple[str, str, str]:
    """Triple, name and features of what is compiled for."""
    name, features = (os.environ.get(f"NUMBA_CPU_{what}") for what in ("NAME", "FEATURES"))
    wrong = [each for each in (features or "").split(",") if each and each[0] not in "+-"]
    if wrong:  # LLVM would end the process
        raise InputError(
            f"NUMBA_CPU_FEATURES: expected features of a processor with + or - in front, separated by commas, such as "
            f"'+avx2,-avx512f', or '' for none, got {shown(wrong[0])}. Correct this variable of the environment, or "
            "unset it."
        )
    if features is None:
        features = "" if name == "generic" else llvm.get_host_cpu_features().flatten()
    return llvm.get_process_triple(), name or llvm.get_host_cpu_name(), features


@cache
def version() -> str:
    """What the same text is compiled by, and for."""
    return repr((llvmlite.__version__, llvm.llvm_version_info, processor(), DATA))


def register_width() -> int:
    """How many doubles a vector register of the processor holds."""
    features = processor()[2].split(",")
    return next((width for feature, width in DOUBLES.items() if f"+{feature}" in features), 2)


@cache
def _ready() -> None:
    _require_layout()
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
        arguments, packed = _arguments(entry.form), _is_packed(entry.form)
        takes = [INTEGER.as_pointer()] if packed else [INTEGER] * len(arguments)
        function = ir.Function(module, ir.FunctionType(INTEGER if packed else ir.VoidType(), takes), name)
        builder = ir.IRBuilder(function.append_basic_block("entry"))
        words = [_word(builder, function.args[0], k) for k in range(len(arguments))] if packed else function.args
        given = [_taken(builder, word, *argument) for word, argument in zip(words, arguments, strict=True)]
        written(builder, entry.py_func, given)
        if packed:
            builder.ret(INTEGER(0))
        else:
            builder.ret_void()
    return str(module)


def _is_packed(form: str) -> bool:
    """Whether a function takes all its arguments in one piece of memory, 64 bits for each; not one of whole numbers."""
    return any(axes or kind != INTEGER for kind, _, axes in _arguments(form))


def _word(builder: ir.IRBuilder, address: Any, place: int, of: ir.Type = INTEGER, byte: int = 0) -> Any:
    """A number in memory, so many words and bytes behind an address."""
    at = builder.bitcast(builder.gep(address, [INTEGER(place)]), ir.IntType(8).as_pointer())
    return builder.load(builder.bitcast(builder.gep(at, [INTEGER(byte)]), of.as_pointer()), align=1)


def _taken(builder: ir.IRBuilder, word: Any, kind: ir.Type, letter: str, axes: int) -> Any:
    """An argument; an array of another kind ends the call, which returns 1."""
    if not axes:
        return builder.bitcast(word, kind)
    pointer = INTEGER.as_pointer()
    array, two, flag = builder.inttoptr(word, pointer), ir.IntType(16), INDEX(IN_A_ROW)
    wanted = two(int.from_bytes(f"{letter}=".encode(), sys.byteorder))
    letters = _word(builder, _word(builder, array, KIND, pointer), LETTERS, two, 1)
    right = builder.icmp_signed("==", letters, wanted)
    right = builder.and_(right, builder.icmp_signed("==", _word(builder, array, COUNT, INDEX), INDEX(axes)))
    in_a_row = builder.icmp_signed("==", builder.and_(_word(builder, array, FLAGS, INDEX), flag), flag)
    with builder.if_then(builder.not_(builder.and_(right, in_a_row))):
        builder.ret(INTEGER(1))
    lengths = _word(builder, array, LENGTHS, pointer)
    shape = [_word(builder, lengths, axis) for axis in range(axes)]
    return contiguous(builder, _word(builder, array, DATA, kind.as_pointer()), shape)


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

    address  of one of whole numbers alone, for other compiled code, as long as this object lives
    call     the same function.  Raises `TypeError` for an array of another kind than the form says, or whose numbers do
             not lie in a row.

    module   whose code it is

    No other thread may set the shape or the dtype of an array meanwhile.
    """

    def __init__(self, engine: Any, name: str, form: str):
        self.module: Any = None
        arguments = _arguments(form)
        self._form, self._arguments, self._engine = form, arguments, engine
        self.address = engine.get_function_address(name)
        packed = _is_packed(form)
        takes: list[Any] = [ctypes.c_char_p] if packed else [ctypes.c_int64] * len(arguments)
        function: Any = ctypes.CFUNCTYPE(ctypes.c_int64 if packed else None, *takes)(self.address)
        # All arguments in one expression: ctypes takes 0.15 us for each, a loop in Python 0.1.
        letters = "".join("d" if kind == DOUBLE and not axes else "q" for kind, _, axes in arguments)
        words = [
            f"(id(a{k}) if type(a{k}) is A else at(a{k}))" if n else f"a{k}" for k, (_, _, n) in enumerate(arguments)
        ]
        names = ", ".join(f"a{k}" for k in range(len(arguments)))
        known = {
            "A": np.ndarray,
            "at": self._at,
            "f": function,
            "pack": struct.Struct(letters).pack,
            "again": self._again,  # and so with the code goes the engine
        }
        line = f"f(pack({', '.join(words)})) and again({names})" if packed else f"f({names})"
        self.call: Any = eval(f"lambda {names}: {line}", known)

    def __call__(self, *given: Any) -> None:
        """`call`, which says of numbers too what was expected."""
        try:
            self.call(*given)
        except (struct.error, ctypes.ArgumentError) as error:
            raise TypeError(f"expected arrays and numbers {self._form}, got {given}: {error}") from error

    def _at(self, array: Any) -> int:
        if not isinstance(array, np.ndarray):
            raise TypeError(f"expected arrays and numbers {self._form}, got {type(array).__name__}")
        return id(array)

    def _again(self, *given: Any) -> None:
        """With dtypes under the letters that the code looks for: long and long long, = and < may be the same."""
        same = [
            np.ndarray.view(x, letter, np.ndarray)
            if n and x.dtype == letter and (x.dtype.char, x.dtype.byteorder) != (letter, "=")
            else x
            for x, (_, letter, n) in zip(given, self._arguments, strict=True)
        ]
        if any(x is not y for x, y in zip(given, same, strict=True)):
            self.call(*same)
            return
        got = [f"{x.dtype} {x.shape}" if isinstance(x, np.ndarray) else type(x).__name__ for x in given]
        raise TypeError(f"expected contiguous arrays and numbers {self._form}, got {', '.join(got)}")


def _require_layout() -> None:
    """Raises `ImportError` where arrays do not lie in memory as NumPy's C interface says: `PyArrayObject_fields`."""
    probe = np.empty((3, 5))
    words = (ctypes.c_int64 * (np.ndarray.__basicsize__ // 8)).from_address(id(probe))
    letters = ctypes.string_at(words[KIND] + 8 * LETTERS + 1, 2)
    lengths = (ctypes.c_int64 * 2).from_address(words[LENGTHS])
    flags, count = (words[k] & 0xFFFFFFFF for k in (FLAGS, COUNT))
    if (words[DATA], count, flags & IN_A_ROW, letters, *lengths) != (probe.ctypes.data, 2, IN_A_ROW, b"d=", 3, 5):
        raise ImportError("kernels need CPython and arrays that lie in memory as NumPy's C interface says")


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
