"""kr.Table: a function of one variable by its values at given times, read inside the kernel.

Between the times t_r and t_(r+1), with u = (t - t_r)/(t_(r+1) - t_r), the value is the polynomial in u of degree 3 (or
5) that has the values and the first (and second) derivatives of both ends: Hermite interpolation, once (twice)
continuously differentiable.  Derivatives that are not given come from the cubic spline through the values, which is
twice continuously differentiable.

As a parameter of a system a table is the vector `packed`; a kernel has its address, and the row for a time by rounding,
if the times are equally spaced, or by bisection: that is exact for any times, while a resampling has an error.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, iteration
from kreisel.algebra.gradient import TracedNumber, with_slope
from kreisel.algebra.recorded import RecordedArray
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    from kreisel.record.model import Model

HEAD = 4  # entries of `packed` before the times: times, columns (0 for scalars), derivatives, whether it holds its ends
EVEN = 1e-9  # relative: differences of equally spaced times
ROUNDING = 1e-14  # relative: of the ends of a run
KINDS = ("spline", "pchip")
EMPTY = np.zeros(HEAD)  # no table: 0 everywhere


def packed_of(value: Any) -> Any:
    """A table, tables of lanes, or text of `text_of` as an array (..., size); other values unchanged."""
    if isinstance(value, Table):
        return value.packed
    if isinstance(value, str):
        try:
            flat = np.frombuffer(base64.b64decode(value, validate=True), dtype="<f8")
            return flat.reshape(-1, _size(flat)) if len(flat) > _size(flat) else flat
        except (ValueError, IndexError):
            return value
    if isinstance(value, list | tuple) and value and all(isinstance(x, Table) for x in value):
        if len({x.packed.shape for x in value}) > 1:
            raise InputError("Tables of lanes: expected the same number of times and components, got different ones.")
        return np.stack([x.packed for x in value])
    return value


def text_of(packed: Array) -> str:
    """Packed tables as text, to the last bit."""
    return base64.b64encode(np.asarray(packed, dtype="<f8").tobytes()).decode()


def _size(packed: Array) -> int:
    """The size of a packed table by its head."""
    count, columns, orders = (int(x) for x in packed[:3])
    return HEAD + count * (1 + max(columns, 1) * (1 + orders))


class Form(NamedTuple):
    """The parts of a table that a kernel is compiled for."""

    columns: int  # of a vector; 0 for scalars
    degree: int  # of the polynomials
    halvings: int  # of the bisection; 0 for equally spaced times


@explained
class Table:
    """A function of time by its values at given times, for the parameters of forces and for orbits.

        torque=lambda t, *, load: load(t),  params={"load": kr.Table(times, values)}

    times        (k,), increasing, in the unit of time of the system
    values       (k,) or (k, components)
    derivatives  in the shape of the values; or a pair of first and second ones, for polynomials of degree 5
    kind         of derivatives that are not given: "spline", of the cubic spline; "pchip", without overshoots
    hold         whether the table keeps its first and last value outside its times; else a run must lie within them

    Calling it with a time, an array, or inside a force gives its value.  Raises `InputError` for times that do not
    increase, values that are not finite, and other shapes.
    """

    def __init__(
        self, times: Any, values: Any, derivatives: Any = None, *, kind: str = "spline", hold: bool = False
    ) -> None:
        t, y = _floats(times, "times"), _floats(values, "values")
        if t.ndim != 1 or len(t) < 2 or y.ndim not in (1, 2) or len(y) != len(t) or not y.size:
            raise InputError(
                f"Table: expected at least two times (k,) and values (k,) or (k, components), got times of shape "
                f"{t.shape} and values of shape {y.shape}."
            )
        require_increasing(t, "Table")
        if kind not in KINDS or not isinstance(hold, bool):
            raise InputError(f"Table: expected kind='spline' or 'pchip' and hold=True or False, got {shown(kind)}.")
        if derivatives is None:
            from scipy.interpolate import CubicSpline, PchipInterpolator

            derivatives = (CubicSpline if kind == "spline" else PchipInterpolator)(t, y).derivative()(t)
        several = derivatives if isinstance(derivatives, tuple) else (derivatives,)
        orders = [_floats(x, "derivatives") for x in several]
        if len(orders) > 2 or any(x.shape != y.shape for x in orders):
            raise InputError(
                f"Table: expected derivatives of the shape {y.shape} of the values, or a tuple of first and second "
                f"ones, got {', '.join(str(x.shape) for x in orders) or 'none'}."
            )
        head = [len(t), y.shape[1] if y.ndim > 1 else 0, len(orders), hold]
        self.packed = np.concatenate([head, t, *(np.ravel(x) for x in (y, *orders))])
        self.packed.flags.writeable = False

    def __call__(self, time: Any, order: int = 0) -> Any:
        """The values (...) or (..., components) at times (...); of an order > 0, derivatives with respect to time.

        Raises `InputError` for times outside, unless they are held.
        """
        t = _floats(time, "time")
        first, last = self.span
        if not self.holds and t.size and not (first <= t.min() and t.max() <= last):
            raise InputError(f"Table: expected times from {first:g} to {last:g}, got {t.min():g} to {t.max():g}.")
        handle, _rows = handles(self.packed)  # rows, which are kept
        return Reader(handle, form_of(self.packed))(t, order)

    @property
    def times(self) -> Array:
        """The times."""
        return _parts(self.packed)[0]

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time."""
        return float(self.packed[HEAD]), float(self.packed[HEAD + int(self.packed[0]) - 1])

    @property
    def holds(self) -> bool:
        """Whether the table keeps its first and last value outside."""
        return bool(self.packed[3])

    def __repr__(self) -> str:
        count, columns, _, _ = self.packed[:HEAD].astype(int).tolist()
        first, last = self.span
        kind = f"{columns} components" if columns else "scalars"
        return f"<kreisel table: {count:,} times from {first:g} to {last:g}, {kind}>"


def require_increasing(t: Array, name: str) -> None:
    """Raises `InputError` for times that do not increase."""
    late = np.flatnonzero(np.diff(t) <= 0)
    if late.size:
        i = int(late[0])
        raise InputError(
            f"{name}: expected times that increase, got {t[i]:g} and then {t[i + 1]:g} at index {i + 1}. Usual cause: "
            "a time twice, or a log that is not sorted: numpy.unique(times, return_index=True) mends both."
        )


def _floats(value: Any, name: str) -> Array:
    array = algebra.floats(value)
    if not np.isfinite(array).all():
        raise InputError(f"Table: expected finite {name}, got {algebra.first_not_finite(array) or shown(value)}.")
    return array


# -- as a parameter: checked, its rows in memory, its handle ------------------------------------------------------


def _parts(packed: Array) -> tuple[Array, Array]:
    """Times (k,), and values and derivatives (orders, k, components)."""
    count, columns, orders = (int(x) for x in packed[:3])
    return packed[HEAD : HEAD + count], packed[HEAD + count :].reshape(1 + orders, count, max(columns, 1))


def _spacing(t: Array) -> float:
    """The difference of equally spaced times, else 0."""
    h = (t[-1] - t[0]) / (len(t) - 1)
    return h if (abs(t - (t[0] + h * np.arange(len(t)))) <= EVEN * h).all() else 0.0


def form_of(packed: Array) -> Form:
    """The form of packed tables (..., size)."""
    tables = packed.reshape(-1, packed.shape[-1])
    count, columns, orders = (int(x) for x in tables[0, :3])
    even = all(_spacing(_parts(table)[0]) for table in tables)
    rows = count - 1 + 2 * bool(tables[:, 3].any())
    return Form(columns, 2 * orders + 1, 0 if even else max(1, math.ceil(math.log2(rows))))


def check(packed: Array, name: str, form: Form) -> None:
    """Raises `InputError` for anything but packed tables of this form."""
    tables = packed.reshape(-1, packed.shape[-1])
    if tables.shape[1] < HEAD or any(_size(table) != len(table) for table in tables):
        raise InputError(f"{name}: expected kr.Table(times, values), got {shown(packed)}.")
    if tables.shape[1] > HEAD and form_of(packed) != form:
        raise InputError(
            f"{name}: expected a table of the form {form}, for which its forces were recorded, got one of the form "
            f"{form_of(packed)}. Make the system anew with this table."
        )


_ROWS: WeakValueDictionary[bytes, np.ndarray] = WeakValueDictionary()


def _rows_of(packed: Array) -> Array:
    """Rows of t_r, 1/(t_(r+1) - t_r) and the coefficients of each component, (rows, 2 + components (degree + 1))."""
    key = hashlib.sha256(packed.tobytes()).digest()
    result = _ROWS.get(key)
    if result is not None:
        return result
    t, (y, m, *s) = _parts(packed)
    h = np.diff(t)[:, None]
    D, m0, m1 = np.diff(y, axis=0), h * m[:-1], h * m[1:]
    if s:
        s0, s1 = h * h * s[0][:-1], h * h * s[0][1:]
        higher = 10 * D - 6 * m0 - 4 * m1 - 1.5 * s0 + s1 / 2, -15 * D + 8 * m0 + 7 * m1 + 1.5 * s0 - s1
        powers = [y[:-1], m0, s0 / 2, *higher, 6 * D - 3 * (m0 + m1) - (s0 - s1) / 2]
    else:
        powers = [y[:-1], m0, 3 * D - 2 * m0 - m1, m0 + m1 - 2 * D]
    rows = np.concatenate([t[:-1, None], 1 / h, np.stack(powers, -1).reshape(len(h), -1)], -1)
    if packed[3]:
        ends = np.zeros((2, rows.shape[1]))
        ends[:, 0], ends[:, 2 :: len(powers)] = t[[0, -1]], y[[0, -1]]
        rows = np.concatenate([ends[:1], rows, ends[1:]])
    out = _ROWS[key] = np.ascontiguousarray(rows)
    return out


def handles(packed: Array) -> tuple[Array, tuple[Array, ...]]:
    """The handles (..., 4) of packed tables (..., size), and the rows in memory, which must be kept as long as these.

    A handle has the address of the rows, the last row, a time and a rate: with equally spaced times the row is the
    integer next to rate (t - time).
    """
    tables = packed.reshape(-1, packed.shape[-1])
    out, rows = np.zeros((len(tables), 4)), list[Array]()
    for i, table in enumerate(tables):
        if table[0]:
            t, held = _parts(table)[0], bool(table[3])
            h = _spacing(t) or 1.0
            rows.append(_rows_of(table))
            out[i] = iteration.address_of(rows[-1]), len(rows[-1]) - 1, t[0] + (0.5 - held) * h, 1 / h
    return out.reshape((*packed.shape[:-1], 4)), tuple(rows)


class Reader(NamedTuple):
    """A table by its handle (4,), for any kind of number: reader(t) is its value, (components,) or a number."""

    handle: Any
    form: Form

    def __call__(self, t: Any, order: int = 0) -> Any:
        """The value, or a derivative with respect to time; batches t (...) of floats give (..., components)."""
        t = float(t) if isinstance(t, int | Fraction) else t
        entries = _read([*map(_plain, self.handle)], t, self.form, order)
        if not self.form.columns:
            return entries[0]
        if isinstance(t, np.ndarray | float):
            return np.stack(np.broadcast_arrays(*entries), -1)
        return algebra.objects(entries).view(RecordedArray)


def _plain(x: Any) -> Any:
    while isinstance(x, TracedNumber):
        x = x.value
    return x.item() if isinstance(x, np.ndarray) and x.dtype == object else x


def _read(handle: Sequence[Any], t: Any, form: Form, order: int) -> list[Any]:
    if isinstance(t, TracedNumber):
        values, slopes = (_read(handle, t.value, form, k) for k in (order, order + 1))
        return [with_slope(lambda _, y=y: y, t, slope) for y, slope in zip(values, slopes, strict=True)]  # type: ignore[misc]
    t = _plain(t)
    address, last, first, rate = handle
    per = form.degree + 1
    stride = 2 + per * max(form.columns, 1)

    def entry(row: Any, column: int) -> Any:
        return iteration.entry(address, row, last, column, stride)

    if form.halvings:
        row: Any = 0.0
        for k in reversed(range(form.halvings)):
            half = 2.0**k
            row = row + (1 + algebra.sign(t - entry(row + half, 0))) * (half / 2)
    else:
        row = algebra.nearest((t - first) * rate)
    inverse = entry(row, 1)
    u, scale = (t - entry(row, 0)) * inverse, inverse if order else 1.0
    for _ in range(order - 1):
        scale = scale * inverse
    out = []
    for column in range(2, stride, per):
        value: Any = 0.0
        for power in range(form.degree, order - 1, -1):
            value = value * u + math.perm(power, order) * entry(row, column + power)
        out.append(value * scale)
    return out


# -- of models ---------------------------------------------------------------------------------------------------


def tables_of_time(model: Model) -> Iterator[tuple[str, Array, float]]:
    """The tables of forces that depend on time: the name, the tables packed, (..., size), their times over t."""
    record = model.system.perturbation
    forces = [] if record is None else [*record.functions.values(), *([record.pair] if record.pair else [])]
    units = {name: force.units.get(name, 1.0) for force in forces if force.names("t") for name in force.tables}
    return ((k, model.params[k], unit) for k, unit in units.items() if model.params[k].shape[-1] > HEAD)


def require_none(model: Model, label: str) -> None:
    """Raises `InputError` for a model with a table."""
    for p in model.system.parameters:
        if p.kind == "table" and model.params[p.letter].shape[-1] > HEAD:
            raise InputError(
                f"{label}: expected forces by formulas, got the table {p.letter}, which it does not hold. "
                "Write the force as a formula of the time."
            )


def tables_exceeded(model: Model, begin: Any, end: Any) -> Iterator[tuple[str, Array, float, Any]]:
    """Name, times, their unit over t, and whether a run exceeds them, of tables that do not hold its ends.

    The run lasts from `begin` to `end`, which may be arrays of JAX.  Its rounding errors do not count.
    """
    for name, packed, unit in tables_of_time(model):
        for table in packed.reshape(-1, packed.shape[-1]):
            t, slack = _parts(table)[0], ROUNDING * (abs(begin) + abs(end))
            if not table[3]:
                yield name, t, unit, ((begin + slack) * unit < t[0]) | ((end - slack) * unit > t[-1])


def require_within(model: Model, begin: float, end: float) -> None:
    """Raises `InputError` for a table that does not hold its ends and starts or ends within a time."""
    for name, t, unit, exceeded in tables_exceeded(model, begin, end):
        if exceeded:
            remedy = "a longer span of the orbit" if name == "path" else "more times"
            raise InputError(
                f"{name}: expected a table for all times of the run, {begin * unit:g} to {end * unit:g}, got one "
                f"from {t[0]:g} to {t[-1]:g}. Use a shorter run, {remedy}, or kr.Table(..., hold=True), which keeps "
                "its ends."
            )
