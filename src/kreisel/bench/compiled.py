"""C++ by hand, compiled on the spot: what the kernels are measured against."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

FLAGS = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
MISSING = "g++ is not on the PATH, or does not work: no comparison with C++ (install it, as the package g++ of Debian)"


def compiler() -> str | None:
    """The path of g++, None where there is none that works."""
    path = shutil.which("g++")
    return path if path and _works(path) else None


@cache
def _works(path: str) -> bool:
    """Whether it compiles a library with these flags that can be loaded."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "one.cpp", Path(folder) / "one.so"
        source.write_text('extern "C" double one() { return 1; }')
        try:
            subprocess.run([path, *FLAGS, str(source), "-o", str(target)], check=True, capture_output=True, timeout=60)
            ctypes.CDLL(str(target))
        except (OSError, subprocess.SubprocessError):
            return False
    return True


def version() -> str:
    """What g++ says of itself."""
    text = subprocess.run([_present(), "--version"], capture_output=True, text=True, check=True).stdout
    return text.splitlines()[0]


def build(name: str, folder: Path) -> ctypes.CDLL:
    """NAME.cpp of this folder as a library in `folder`.  Raises `FileNotFoundError` without g++."""
    source, target = Path(__file__).with_name(f"{name}.cpp"), folder / f"{name}.so"
    subprocess.run([_present(), *FLAGS, str(source), "-o", str(target)], check=True)
    return ctypes.CDLL(str(target))


def _present() -> str:
    found = compiler()
    if found is None:
        raise FileNotFoundError(MISSING)
    return found
