"""The code of a GPU on this processor, one lane after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kreisel.graph.llvm import Function
from kreisel.graph.machine import Kernel, kernel
from kreisel.kernels.gpu import Body


def here(key: Sequence[Any], arguments: int, body: Body) -> Kernel:
    """The kernel for this processor, one lane after the other."""

    def write(f: Function) -> None:
        with f.loop(0, f.arguments[-1]) as lane:
            body(f, lane, f.arguments)

    return kernel(("gpu", *key), arguments, write)


class Here:
    """The processor at work, which runs the code of a GPU one thread after the other."""

    def array(self, values: Any) -> Any:
        return np.array(values)

    def empty(self, shape: tuple[int, ...], kind: np.dtype[Any]) -> Any:
        return np.full(shape, np.nan, kind)

    def host(self, array: Any) -> Any:
        return np.array(array)

    def fill(self, array: Any, values: Any) -> None:
        array[...] = values

    def compiled(self, key: Sequence[Any], arguments: int, body: Body) -> Any:
        return here(key, arguments, body)

    def launch(self, kernel: Any, lanes: int, *arguments: Any) -> None:
        kernel(*(x if isinstance(x, int) else x.ctypes.data for x in (*arguments, lanes)))
