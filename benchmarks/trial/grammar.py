"""Values from a grammar: good ones of each kind, the edges of each kind, and values of no kind at all."""

from __future__ import annotations

import datetime
import decimal
import fractions
import math
import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

ODD = 0.07  # of the productions yield something at the edge, or of another kind
NUMBERS = [0, -0.0, -1, 1, 0.5, 2, -3.5, 1e-3, 1e3, 7, 1e-8, 1e8]
EDGES = [0, 0.0, -0.0, 5e-324, 2.2e-308, 1e-300, 1e-160, 1e-20, 1e20, 1e77, 1e154, 1e160, 1e300, 1.7e308, -1.7e308]
NO_NUMBERS = [math.nan, math.inf, -math.inf]
HUGE = [2**31, 2**53, 2**63 - 1, 2**63, -(2**63), 2**64, 10**18, 10**40, 10**309, -(10**4400)]
TEXTS = ["", " ", "x", "lagrange-top", "ä\u202etxet", "\x1b[31mred\x1b[0m", "a\x00b", "\n\n", "nan", "1", "1e3",
         "../../x", "\ud800", "\U0001d4db", "kreisel: all is well", "%s %d {0}", "'; --", "None", "auto", "\x07\x08\r",
         "z" * 5000]  # fmt: skip
METHODS = ["baecklund", "suris", "veselov", "exact", "variational", "lagrangian", "dop853", "kahan", "Suris"]
ENGINES = ["cpu", "large", "cuda", "cuda-float32", "gpu", "CPU"]


def nested(rng: random.Random) -> Any:
    """Lists in lists."""
    value: Any = rng.choice([0, 1.0, "x", []])
    for _ in range(rng.choice([1, 2, 3, 30, 90, 150])):
        value = [value]
    return value


def wrong_shape(rng: random.Random) -> Any:
    """Lists of floats and integers, of any shape, some ragged."""
    kinds: list[Callable[[], Any]] = [
        lambda: [],
        lambda: [[]],
        lambda: [rng.choice(NUMBERS) for _ in range(rng.choice([1, 2, 3, 4, 5, 9, 200]))],
        lambda: [[rng.choice(NUMBERS) for _ in range(rng.randrange(1, 5))] for _ in range(rng.randrange(1, 5))],
        lambda: [[1.0, 2.0, 3.0], [1.0]],
        lambda: [1.0, [2.0, 3.0], 4.0],
        lambda: [1.0, "x", 3.0],
        lambda: [[[0.1, 0.2, 1.5]] * 2] * 3,
        lambda: [True, False, True],
        lambda: [1, rng.choice(HUGE), 0],
        lambda: [rng.choice(NO_NUMBERS), 0.0, 1.0],
        lambda: [[0.0] * 4] * 4,
    ]
    return rng.choice(kinds)()


def plain(rng: random.Random) -> Any:
    """Something that TOML can say, of any kind."""
    kinds: list[Callable[[], Any]] = [
        lambda: rng.choice(NUMBERS),
        lambda: rng.choice(EDGES),
        lambda: rng.choice(NO_NUMBERS),
        lambda: rng.choice(HUGE),
        lambda: rng.choice(TEXTS),
        lambda: rng.choice([True, False]),
        lambda: rng.choice([{}, {"a": 1}, {"uniform": [0, 1]}, {"a": {"b": {}}}]),
        lambda: datetime.date(1979, 5, 27),
        lambda: nested(rng),
        lambda: wrong_shape(rng),
    ]
    return rng.choice(kinds)()


def no_number(value: Any) -> bool:
    """Whether a value looks numeric and is not: hidden entries, dates, complex numbers, impossible moments."""
    if isinstance(value, list | tuple):
        return value in ([3.0, 5.0, 9.0], [1, "x"]) or any(no_number(v) for v in value if not isinstance(v, list))
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.kind in "mMc"
    return isinstance(value, complex)


class Strange:
    """An object that is nothing."""

    def __repr__(self) -> str:
        return "<strange>"


def strange(rng: random.Random) -> Any:
    """Something that only Python can say."""
    one: list[Callable[[], Any]] = [
        lambda: None,
        lambda: np.float32(0.5),
        lambda: np.float64(rng.choice(EDGES)),
        lambda: np.int64(rng.choice([0, 1, 2, 7, 2**62])),
        lambda: np.uint8(3),
        lambda: np.bool_(True),
        lambda: np.array(rng.choice([2, 0.5, math.nan])),
        lambda: np.array([0.1, 0.2, 1.5], dtype=rng.choice(["f4", "f8", "O", "c16", "U5", "i2", "f2"])),
        lambda: np.zeros((0, 3)),
        lambda: np.ones((2, 3)),
        lambda: np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0]),
        lambda: np.array(["2020-01-01"], dtype="M8[D]"),
        lambda: fractions.Fraction(1, 3),
        lambda: decimal.Decimal("0.1"),
        lambda: 1 + 2j,
        lambda: b"bytes",
        lambda: {1, 2, 3},
        lambda: range(3),
        lambda: (x for x in (1.0, 2.0, 3.0)),
        lambda: Strange(),
        lambda: Strange,
        lambda: len,
        lambda: Path("x.zarr"),
        lambda: datetime.timedelta(1),
        lambda: [None, None, None],
        lambda: {"m": [0, 0, 1]},
    ]
    return rng.choice(one)()


def odd(rng: random.Random, python: bool = False) -> Any:
    """Values at the edge of every kind."""
    return strange(rng) if python and rng.random() < 0.45 else plain(rng)


def never_long(steps: Any) -> Any:
    """A number of steps that can be asked for and would take long is no fault: other numbers are tried."""
    if isinstance(steps, int | float) and 10**4 < steps <= 10**15:
        return 10**16
    return steps


def scaled(value: Any, rng: random.Random) -> Any:
    """A good array with entries at the edge: all of them, or one."""
    array = np.array(value, dtype=object)
    if not array.ndim:
        return rng.choice([value * rng.choice([-1, 1e-20, 1e20]), *EDGES])
    if not array.size or not all(isinstance(v, int | float) for v in array.flat):
        return value
    factor = rng.choice([0, -1, 1e-160, 1e-20, 1e20, 1e80, 1e160, 1e300])
    if rng.random() < 0.4:
        array = array * factor
    else:
        flat = array.reshape(-1)
        flat[rng.randrange(len(flat))] = rng.choice([*EDGES, *NO_NUMBERS, *HUGE[:4]])
    return array.tolist()


def maybe_python(good: Any, rng: random.Random, share: float = ODD) -> Any:
    """A good value, or one that is odd, or at the edge of its kind."""
    if rng.random() >= share:
        return good
    return scaled(good, rng) if isinstance(good, list | float) and rng.random() < 0.5 else odd(rng, True)


def parameters(system: Any, n: int, rng: random.Random) -> dict[str, Any]:
    """Good parameters of a system, as plain lists, floats and integers."""
    from kreisel.lab import exact

    draw = exact.float_random(np.random.default_rng(rng.randrange(20)))
    return {k: v.tolist() for k, v in exact.random_model(system, n, draw).params.items()}


def state(system: Any, n: int, rng: random.Random, lanes: int = 0) -> dict[str, Any]:
    """A good state, as plain lists, some with a batch axis; for n = 3 mostly axial vectors."""
    from kreisel import algebra
    from kreisel.lab import exact

    draw = exact.float_random(np.random.default_rng(rng.randrange(20)))
    points = [system.space.point(n, draw) for _ in range(max(1, lanes))]
    out = {}
    for place, (letter, kind) in enumerate(system.space.components):
        parts = [np.asarray(p[place], dtype=float) for p in points]
        if kind == "skew" and n == 3 and rng.random() < 0.8:
            parts = [algebra.axial(p) for p in parts]
        out[letter] = (np.stack(parts) if lanes else parts[0]).tolist()
    return out


def dimension(system: Any, rng: random.Random) -> int:
    """A dimension that a system can have."""
    return int(system.n or rng.choice([3, 3, 3, 3, 4]))


def orientation(n: int, rng: random.Random) -> Any:
    """A rotation, or for n = 3 mostly a unit quaternion."""
    if n == 3 and rng.random() < 0.8:
        q = np.array([rng.gauss(0, 1) for _ in range(4)])
        return (q / np.linalg.norm(q)).tolist()
    q, r = np.linalg.qr(np.random.default_rng(rng.randrange(9)).standard_normal((n, n)))
    q = q * np.sign(np.diag(r))
    q[0] *= np.sign(np.linalg.det(q))
    return q.tolist()


def toml(value: Any) -> str:
    """A value in TOML; a value that TOML cannot hold becomes text that is not TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return _digits(value)
    if isinstance(value, float):
        return {"nan": "nan", "inf": "inf", "-inf": "-inf"}.get(repr(value), repr(value))
    if isinstance(value, str):
        return '"' + "".join(_character(c) for c in value) + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key(k)} = {toml(v)}" for k, v in value.items()) + " }"
    return str(value)


def key(name: str) -> str:
    """A key, quoted if necessary."""
    bare = name and all(c.isascii() and (c.isalnum() or c in "_-") for c in name)
    return name if bare else toml(name)


def _digits(value: int) -> str:
    if abs(value) < 10**300:
        return str(value)
    return ("-" if value < 0 else "") + "1" + "0" * 5000


def _character(c: str) -> str:
    code = ord(c)
    if 0xD800 <= code < 0xE000:
        return "\\uD800"  # which TOML forbids
    if c in '"\\':
        return "\\" + c
    return f"\\u{code:04x}" if code < 32 or code == 127 else c
