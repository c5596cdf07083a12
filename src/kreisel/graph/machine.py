"""Machine code of functions, for this processor: compiled by LLVM, kept on disk, called with integers.

The processor is the machine's, or the one in KREISEL_CPU_NAME and KREISEL_CPU_FEATURES.  With KREISEL_CODE_LEVEL=0 LLVM
compiles faster, and steps are slower; their bits are equal.

Each kernel is a file, complete by the seal at its head or made again.  The files are in KREISEL_CACHE, else in kreisel/
in the cache folder of the platform.  The seal is the SHA-256 of the name and of all that follows; nothing of a file is
used before it was compared: half a file of machine code would be run.  Code that cannot be kept there is compiled in
memory.  A `Chain` of kernels is one call from Python, which needs as long as each of them.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial, reduce
from importlib import resources
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import llvmlite
import llvmlite.binding as llvm
import numpy as np
from platformdirs import user_cache_path

import kreisel
from kreisel.errors import InputError, shown
from kreisel.graph.llvm import DOUBLE, INDEX, Function, Memory, kind_of
from kreisel.kernels.layout import Floats

DOUBLES = {"avx512f": 8, "avx": 4}  # in a register, of processors with these features; 2 on others
_loaded: WeakValueDictionary[str, Kernel] = WeakValueDictionary()  # the kernels of a process


@cache
def processor() -> tuple[str, str, str]:
    """Triple, name and features of the processor that code is compiled for."""
    name, features = (os.environ.get(f"KREISEL_CPU_{kind}") for kind in ("NAME", "FEATURES"))
    wrong = [feature for feature in (features or "").split(",") if feature and feature[0] not in "+-"]
    if wrong:  # LLVM would end the process
        raise InputError(
            "KREISEL_CPU_FEATURES: expected features of a processor with + or - in front, separated by commas, such as "
            f"'+avx2,-avx512f', or '' for none, got {shown(wrong[0])}. Correct this variable of the environment, or "
            "unset it."
        )
    if features is None:
        features = "" if name == "generic" else llvm.get_host_cpu_features().flatten()
    return llvm.get_process_triple(), name or llvm.get_host_cpu_name(), features


@cache
def version() -> str:
    """Compiler, level and processor of compiled operations."""
    return repr((llvmlite.__version__, llvm.llvm_version_info, code_level(), processor()))


def register_width() -> int:
    """How many doubles a vector register of the processor holds."""
    features = processor()[2].split(",")
    return next((width for feature, width in DOUBLES.items() if f"+{feature}" in features), 2)


@cache
def _ready() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


# Of 3.  Below 2 there is no second scheduling behind that of the registers, which took a quarter of the time from
# operations to machine code.  The steps of 16 kernels need 0.96 to 1.04 of their time, the scatter of this measurement.
CODE_LEVEL = 1


def code_level() -> int:
    """LLVM's level for kernels: KREISEL_CODE_LEVEL, 0 or 1, default `CODE_LEVEL`.  Raises `InputError`."""
    asked = os.environ.get("KREISEL_CODE_LEVEL", str(CODE_LEVEL))
    if asked not in ("0", "1"):
        raise InputError(
            f"KREISEL_CODE_LEVEL: expected 0 or 1, got {shown(asked)}. Correct this variable of the environment, or "
            "unset it."
        )
    return int(asked)


def target_machine(level: int = CODE_LEVEL) -> Any:
    """LLVM's compiler for the processor."""
    _ready()
    triple, name, features = processor()
    target = llvm.Target.from_triple(triple)
    reloc = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(name, features, level, reloc, "jitdefault", jit=True)


def optimized(machine: Any, text: str, level: int = 0) -> Any:
    """LLVM's module of a text, optimized for a machine: by LLVM's passes of a level, of 0 by four of them.

    Graphs are arranged before they are written, so only registers are left to choose.  Level 3 needs ten
    times as long; by it the steps of 20 kernels need 0.9 to 1.05 of their time, the scatter of this measurement.
    """
    module = llvm.parse_assembly(text)
    module.data_layout = str(machine.target_data)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=level or 3))
    passes = builder.getModulePassManager() if level else llvm.create_new_module_pass_manager()
    if not level:
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_instruction_combine_pass()
        passes.add_loop_rotate_pass()
    passes.run(module, builder)
    return module


def address_of(array: Any) -> int:
    """Where the scalars of an array begin.  Raises `TypeError` for others than of 64 bits that lie in a row."""
    if array.itemsize != 8 or not array.flags.c_contiguous:
        raise TypeError(f"expected a contiguous array of 64-bit values, got {array.dtype} {array.shape}")
    if not array.size:
        return 0
    # its pointer by `array.ctypes.data` needs three times as long
    return ctypes.addressof(ctypes.c_char.from_buffer(array)) if array.flags.writeable else int(array.ctypes.data)


class Kernel:
    """A compiled function of integers of 64 bits, addresses among them.

    address  for other compiled code, as long as this object lives
    call     the function
    size     bytes of the code
    """

    def __init__(self, code: bytes, arguments: int):
        self.size = len(code)
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine())
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self.address: int = engine.get_function_address("kernel")
        form: Any = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * arguments)
        self.call = form(self.address)
        self.call.engine = engine  # the code lives as long as anything that may call it

    def __call__(self, *arguments: int) -> None:
        self.call(*arguments)


WRITERS = "algebra", "exact", "graph", "kernels", "rebound"  # the rooms whose operations are not all in digests


@cache
def _writers() -> bytes:
    package = resources.files("kreisel")
    texts = [text for room in WRITERS for text in _texts(package.joinpath(room))] or [kreisel.__version__.encode()]
    return hashlib.sha256(b"".join(texts)).digest()


def _texts(place: Any) -> Iterator[bytes]:
    for entry in sorted(place.iterdir(), key=lambda entry: str(entry.name)) if place.is_dir() else ():
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _texts(entry)
        elif entry.name.endswith((".py", ".pyc")):
            yield entry.read_bytes()


def kernel(key: Sequence[Any], arguments: int, write: Callable[[Function], None]) -> Kernel:
    """The kernel that `write` writes, compiled once for this machine.

    `key`: all that it depends on in addition to the code of Kreisel; digests of graphs, counts, widths, names.
    """
    text = f"{_writers().hex()} {version()} {arguments} {tuple(key)!r}"
    name = hashlib.sha256(text.encode()).hexdigest()
    result = _loaded.get(name)
    if result is None:
        result = _loaded[name] = Kernel(kept(name, lambda: object_code(arguments, write)), arguments)
    return result


def object_code(arguments: int, write: Callable[[Function], None]) -> bytes:
    """Machine code of a function."""
    machine = target_machine(code_level())
    return bytes(machine.emit_object(optimized(machine, _text(arguments, write))))


def assembly(arguments: int, write: Callable[[Function], None]) -> str:
    """A view to be read."""
    machine = target_machine()
    return str(machine.emit_assembly(optimized(machine, _text(arguments, write))))


def _text(arguments: int, write: Callable[[Function], None]) -> str:
    function = Function(arguments, triple=processor()[0])
    write(function)
    return function.text()


# -- machine code on disk ----------------------------------------------------------------------------


OTHERS_MAY_WRITE = 0o022


def cache_folder() -> Path | None:
    """Where kernels are kept; None if nothing can be, or should not be, because somebody else may write there.

    It holds code that is run.
    """
    asked = os.environ.get("KREISEL_CACHE")
    try:
        folder = Path(asked) if asked else user_cache_path("kreisel", appauthor=False)
        if not asked and not folder.is_absolute():  # no home
            return None
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except (OSError, RuntimeError, ValueError):  # a name that cannot be
        return None
    if not hasattr(os, "geteuid"):  # Windows, where the folder is the user's
        return folder
    if status.st_uid != os.geteuid() or status.st_mode & OTHERS_MAY_WRITE:
        _refused(str(folder), status.st_uid, status.st_mode & 0o777)
        return None
    return folder


@cache
def _refused(folder: str, owner: int, mode: int) -> None:
    warnings.warn(
        f"the cache of kernels {folder!r} is not used, and kernels are compiled in memory: expected a folder of user "
        f"{os.geteuid()} that nobody else may write to, because it holds code; got owner {owner}, mode {mode:03o}. "
        "Usual cause: a shared folder, or an umask that lets the group write. Use chmod 700, or name another folder in "
        "KREISEL_CACHE.",
        RuntimeWarning,
        stacklevel=2,
    )


SUFFIX, HALF, SEAL = ".kernel", ".kernel-", 32
LONG = 60.0  # seconds; a file is written in less


def kept(name: str, make: Callable[[], bytes]) -> bytes:
    """The code of that name: from its file, or made and kept there if that can be."""
    folder = cache_folder()
    if folder is None:
        return make()
    file = folder / (name + SUFFIX)
    code = _read(file)
    if code is None:
        code = make()
        with contextlib.suppress(OSError):  # a full disk, or a folder that nobody may write to
            _write(file, code)
    return code


def _seal(file: Path, code: bytes) -> bytes:
    return hashlib.sha256(file.name.encode() + code).digest()


def _read(file: Path) -> bytes | None:
    """The code of a complete file; None for all else, of which nothing is waited for or followed."""
    try:
        handle = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0))
        with os.fdopen(handle, "rb") as opened:
            content = opened.read() if stat.S_ISREG(os.fstat(handle).st_mode) else b""
    except OSError:
        return None
    seal, code = content[:SEAL], content[SEAL:]
    return code if seal == _seal(file, code) else None


@cache  # once for a process: to look through a folder of 5,000 kernels takes longer than to compile a small one
def _sweep(folder: Path) -> None:
    """Files of writers that were killed are deleted."""
    for half in folder.glob(f"{HALF}*"):
        with contextlib.suppress(OSError):
            if half.stat().st_mtime < time.time() - LONG:
                half.unlink()


def _write(file: Path, code: bytes) -> None:
    _sweep(file.parent)
    handle, name = tempfile.mkstemp(prefix=HALF, dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(_seal(file, code) + code)
        if file.is_dir() and not file.is_symlink():
            shutil.rmtree(file)
        os.replace(name, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


# -- kernels on fixed memory, one after the other ------------------------------------------------------

Link = tuple[Kernel, tuple[Any, ...]]  # a kernel and its arguments: integers, and arrays for their addresses
MANY = 100  # entries that are summed as vectors


class Chain:
    """Calls of kernels, and the sum of the entries of some arrays after them, which is finite only if they are.

    call     the calls; then `total.value` is the sum
    long     the calls, while other threads run
    """

    def __init__(self, links: Sequence[Link], summed: Sequence[Floats]):
        self._held, self.total = (links, summed), ctypes.c_double()  # the arrays live as long as the calls
        calls = [
            (code.address, *(x if type(x) is int else address_of(x) for x in arguments)) for code, arguments in links
        ]
        words = [*sum(calls, ()), *(word for x in summed for word in (address_of(x), x.size))]
        self._words, counts = np.array([*words, ctypes.addressof(self.total)]), [len(words) for words in calls]

        def write(f: Function) -> None:
            place, memory, total = 0, f.integers(f.arguments[0]), f.variable(0.0, DOUBLE)
            for count in counts:
                f.call(*memory.get(count, place))
                place += count
            for at in range(place, place + 2 * len(summed), 2):
                numbers, size, blocks = f.doubles(memory[at]), memory[at + 1], f.integer(0)
                if width:
                    blocks = size // width
                    total[0] = f.builder.fadd(total[0], _sum(f, numbers, blocks, width))
                with f.loop(blocks * width, size) as i:
                    total[0] = f.builder.fadd(total[0], numbers[i])
            f.doubles(memory[place + 2 * len(summed)])[0] = total[0]

        # additions of four registers do not wait for each other
        width = 4 * register_width() * any(x.size > MANY for x in summed)
        self._kernel = kernel(("chain", counts, len(summed), width), 1, write)

        def called(kind: Any) -> Any:
            call = kind(None)(self._kernel.address)  # of types that are not checked
            call.kernel = self._kernel  # the code lives as long as the call
            return partial(call, ctypes.c_int64(address_of(self._words)))

        # a short call keeps Python's lock, since to release it takes as long as some steps
        self.call, self.long = called(ctypes.PYFUNCTYPE), called(ctypes.CFUNCTYPE)

    def __call__(self, long: bool = False) -> float:
        """The sum after the calls."""
        (self.long if long else self.call)()
        return self.total.value

    def argument(self, link: int, place: int) -> Any:
        """The memory (1,) of an integer argument of a link, which may be changed."""
        before = sum(1 + len(arguments) for _, arguments in self._held[0][:link])
        return self._words[before + 1 + place :][:1]


def _sum(f: Function, numbers: Memory, blocks: Any, width: int) -> Any:
    """The sum of vectors of numbers, and of the entries of that."""
    total = f.variable(0.0, kind_of(width))
    with f.loop(0, blocks) as block:
        total[0] = f.builder.fadd(total[0], numbers.beyond(block * width).of(kind_of(width))[0])
    return reduce(f.builder.fadd, (f.builder.extract_element(total[0], INDEX(k)) for k in range(width)))
