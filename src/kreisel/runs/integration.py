"""A run under way: rows of states filled by an engine, blocks of outputs, and a snapshot from which it resumes.

The snapshot is taken between two calls of the engine, is exact, and does not depend on where the calls were cut:
a run that is stopped and restored gives the same bits as one that is not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Flow, Orbits, Steps
from kreisel.process import SPENT
from kreisel.record.values import in_lane
from kreisel.runs.plan import BREAKS, Plan, faults, is_finite
from kreisel.runs.planning import cause_of_no_numbers
from kreisel.runs.settings import LARGE, of_forces

if TYPE_CHECKING:
    from kreisel.runs.propagation.breaks import Breaks

BLOCK_BYTES = 1 << 21  # of states, held at once
END = BREAKS + "end"  # in a snapshot: the rows and the last time of a run that an event stopped
CHUNKS = 8  # of a block, each compressed separately; a block is a file of each variable
SHARDED = 512  # rows: a smaller block has only one chunk
TICK_SECONDS = 0.1  # between two looks at the clock
SHORT_STEPS = 1000  # of straight-line code, in the first call
LONG_SECONDS = 1.0  # a longer call of the engine can be interrupted


@dataclass(frozen=True)
class Snapshot:
    """The position of a run: the rows in finished blocks, the rows after them, the steps made since, and the engine.

    `engine` also holds `Plan.computed`, the constants of the trajectory.
    """

    flushed: int
    into: int
    rows: Floats
    engine: dict[str, Floats] = field(default_factory=dict)


def block_rows(plan: Plan) -> int:
    """Rows held at once, and rows in a shard of an archive."""
    numbers = max(plan.first.size, plan.lanes * algebra.coordinate_count(plan.model.system.space.kinds, plan.model.n))
    rows = int(max(1, min(plan.rows, BLOCK_BYTES // (8 * numbers))))
    return rows if rows < SHARDED else rows + -rows % CHUNKS


def chunk_rows(block: int) -> int:
    """Rows in a chunk of a block with `block` rows."""
    return block if block < SHARDED or block % CHUNKS else block // CHUNKS


class Integration:
    """The loop of a run, which fills rows 0, every, 2 every, ... and the last step.

    `between` is called between two calls of the engine, about every tenth of a second.  An exception there stops the
    run. `inside` is called within a call that lasts longer than a second, as a single step of large n may.  An
    exception there ends the run, and its last snapshot is the one before that call.

    A lane that fails ends the run, unless `faults` is given.  Then the lane and the reason are noted there, the outputs
    of the lane are NaN from then on, and the other lanes continue.
    """

    def __init__(
        self,
        plan: Plan,
        tick: Callable[[int], None] = lambda steps: None,
        rows_in_block: int | None = None,
        faults: dict[int, str] | None = None,
    ) -> None:
        self.plan, self.tick, self.most = plan, tick, rows_in_block or block_rows(plan)
        self._step_of = plan.step_of
        self.faults, self._ends = faults, np.full(plan.lanes, np.iinfo(np.int64).max)  # the first row that is lost
        self._first = plan.engine.z.copy()
        self.buffer = np.empty((self.most, *plan.engine.z.shape))
        self.buffer[0] = plan.engine.z
        self.filled, self.flushed, self.into = int(plan.settings.times is None), 0, 0
        self.inside: Callable[[], None] = lambda: None
        self._scratch = np.empty((1, *plan.engine.z.shape))
        short = isinstance(plan.scheme.motion, Steps) and plan.model.n < LARGE
        self._burst = max(1, SHORT_STEPS // plan.lanes) if short else 1  # a single step may need seconds
        by_itself = plan.settings.times is None or isinstance(plan.scheme.motion, Flow | Orbits)
        self._breaks: Breaks | None = None
        if not by_itself or plan.broken:
            from kreisel.runs.propagation.breaks import Breaks

            self._breaks = Breaks(plan)

    @property
    def rows(self) -> int:
        """Rows that are finished."""
        return self.flushed + self.filled

    @property
    def steps(self) -> int:
        """Steps that are finished."""
        return self._step_of(self.rows - 1) + self.into

    @property
    def lasting(self) -> int:
        """Rows that a longer run also has: without a last row that is not at a multiple of `every`."""
        ends = self.plan.times is not None or self.plan.end is not None  # limit of every longer run
        return self.plan.rows if ends else self.plan.steps // self.plan.every + 1

    def snapshot(self) -> Snapshot:
        """A copy of everything needed to resume.  Raises `RunError` if the state is no longer finite."""
        self._check()
        engine = {name: value.copy() for name, value in self.plan.engine.snapshot().items()} | self.plan.computed
        engine |= {} if self._breaks is None else self._breaks.snapshot()
        if self.plan.end is not None:
            engine[END] = np.array(self.plan.end)
        return Snapshot(self.flushed, self.into, self.buffer[: self.filled].copy(), engine)

    def restore(self, snapshot: Snapshot) -> None:
        """Resume from a snapshot of a run with the same plan, or of a shorter run.

        Raises `InputError` for a snapshot of another plan.
        """
        computed, rows = self.plan.computed, len(snapshot.rows)
        mine = {**self.plan.engine.snapshot(), **computed}
        of_breaks = {name: value for name, value in snapshot.engine.items() if name.startswith(BREAKS)}
        shapes = {name: value.shape for name, value in snapshot.engine.items() if name not in of_breaks}
        fits = (
            snapshot.rows.dtype == np.float64
            and snapshot.rows.shape == (rows, *self.buffer.shape[1:])
            and shapes == {name: np.shape(value) for name, value in mine.items()}
            and rows <= self.most
            and 0 <= snapshot.flushed <= self.plan.rows - rows
            and np.shape(of_breaks.get(END, (0, 0))) == (2,)
            and 0 <= snapshot.into < max(1, self.plan.steps if self.plan.irregular else self.plan.every)
        )
        if not fits or snapshot.flushed + rows < (self.plan.settings.times is None):
            raise InputError("The checkpoint does not belong to the attributes of its archive; one of them is damaged.")
        self.flushed, self.into, self.filled = snapshot.flushed, snapshot.into, len(snapshot.rows)
        self.buffer[: self.filled] = snapshot.rows
        self.plan.adopt({name: snapshot.engine[name] for name in computed})
        self.plan.engine.restore(snapshot.engine)
        if END in of_breaks:
            self.plan.end = int(of_breaks[END][0]), float(of_breaks[END][1])
        if self._breaks is not None:
            self._breaks.restore(of_breaks)

    def blocks(self, between: Callable[[], None] = lambda: None) -> Iterator[dict[str, Array]]:
        """Blocks of outputs, time in front, in order; the first holds the initial state."""
        while self.rows < self.plan.rows:
            if self.filled == self.most:
                yield self._finished()
                self.flushed, self.filled = self.rows, 0
            between()
            self._advance()
        between()
        if self.filled:
            yield self._finished()

    def _advance(self) -> None:
        """One call of the engine, of about a tick: some rows, or a part of one row."""
        times = self.plan.times
        if times is not None and self._breaks is None and isinstance(self.plan.scheme.motion, Orbits):
            when = times[self.rows : self.rows + self.most - self.filled]  # in closed form
            self.buffer[self.filled : self.filled + len(when)] = self.plan.engine.at(when)  # type: ignore[attr-defined]
            self.filled += len(when)
            return
        every = self._step_of(self.rows) - self._step_of(self.rows - 1)
        left = every - self.into
        quiet = self.plan.steps if self._breaks is None else self._breaks.quiet(self.steps)
        if times is not None or quiet < left:
            self._within_steps(left)
            return
        if left > self._burst:
            steps = self._burst  # the call changes it
            self._call(self._scratch, steps)
            self.into += steps
            return
        regular = self.plan.steps // self.plan.every + 1 - self.rows
        most = min(self.most - self.filled, regular, min(self._burst, quiet) // every)
        rows = 1 if self.into else max(1, most)
        self._call(self.buffer[self.filled : self.filled + rows], left)
        self.filled, self.into = self.filled + rows, 0

    def _within_steps(self, left: int) -> None:
        """At most `left` steps to the next row, which may lie within a step, as may an impulse or event."""
        steps = min(left, self._burst)
        if self._breaks is None:
            if steps:
                self._call(self._scratch, steps)
        else:
            breaks = self._breaks
            steps = self._timed(lambda look: breaks.advance(self.steps, steps, look)) if steps else 0
        self.into += steps
        stop = None if self._breaks is None else self._breaks.stop
        if stop is not None:
            self.buffer[self.filled] = stop.z
        elif steps == left:
            ahead, self.buffer[self.filled] = self.plan.within_step(self.rows), self.plan.engine.z
            if ahead and self._breaks is not None:
                self.buffer[self.filled], stop = self._breaks.row(self.steps, ahead)
            elif ahead:  # by a `ReferenceEngine`
                self.buffer[self.filled] = self.plan.engine.between(ahead)  # type: ignore[attr-defined]
        else:
            return
        self.filled, self.into = self.filled + 1, 0
        if stop is not None:
            self.plan.end = self.rows, stop.time

    def _call(self, out: Floats, every: int) -> None:
        def advance(look: Callable[[], None]) -> int:
            self.plan.engine.advance(out, every, look)
            return len(out) * every

        self._timed(advance)

    def _timed(self, advance: Callable[[Callable[[], None]], int]) -> int:
        """Call a function that makes steps, with a longer or shorter call next time.  Returns their number."""
        begun = time.perf_counter()

        def look() -> None:
            if time.perf_counter() - begun > LONG_SECONDS:
                self.inside()

        steps = advance(look)
        seconds = time.perf_counter() - begun
        SPENT["steps"] += seconds
        self.tick(steps * self.plan.lanes)
        if seconds < TICK_SECONDS:
            self._burst = min(2 * self._burst, 1 << 40)
        elif seconds > 2 * TICK_SECONDS:
            self._burst = max(1, self._burst // 2)
        return steps

    def _check(self) -> None:
        """Note or raise the first row that violates a promise of the method."""
        for fault in faults(self.plan.scheme, self.plan.engine, self.buffer[: self.filled], self.plan.dt):
            place = " at or before step {step} (time {time:g})" if fault.seen else ", before step {step}"
            self._lose(fault.good, fault.text, place, fault.cause)

    def _lose(self, good: Array, fault: str, place: str, cause: str) -> None:
        """The lanes that are no longer good (rows, lanes): raise `RunError`, or note them."""

        def text(step: int) -> str:
            return fault + place.format(step=step, time=step * self.plan.dt)

        row = int(np.argmin(good.all(1)))
        step = self._step_of(self.flushed + row)
        cause = cause or cause_of_no_numbers(self.plan, step, int(np.argmin(good[row])))
        if self.faults is None:
            raise RunError(f"{text(step)}{in_lane(~good[row])}. Usual cause: {cause}")
        for lane in np.flatnonzero(~good.all(0)).tolist():
            row = self.flushed + int(np.argmin(good[:, lane]))
            self._ends[lane] = min(self._ends[lane], row)
            self.faults.setdefault(lane, f"{text(self._step_of(row))}. Usual cause: {cause}")

    def _finished(self) -> dict[str, Array]:
        self._check()
        rows = self.buffer[: self.filled].copy()  # the buffer is filled again
        lost = np.arange(self.flushed, self.flushed + self.filled)[:, None] >= self._ends
        if lost.any():
            rows = np.where(lost[..., None], self._first, rows)
        step = chunk_rows(self.most)  # at once: temporary arrays stay small
        with np.errstate(all="ignore"):
            parts = [self.plan.observe(rows[first : first + step]) for first in range(0, len(rows), step)]
        block = {name: np.concatenate([outputs[name] for outputs in parts]) for name in parts[0]}
        cause = f"{of_forces(self.plan.model)}a state so large that its powers overflow. Use smaller units."
        for name in [name for name, value in block.items() if not is_finite(value)]:
            finite = np.isfinite(block[name]).reshape((self.filled, self.plan.lanes, -1)).all(-1)
            self._lose(finite, f"{name} is not finite, although the state is,", " at step {step}", cause)
            lost = lost | ~finite
        if lost.any():
            for name, value in block.items():
                apart = value.reshape((*lost.shape, -1))
                block[name] = np.where(lost[..., None], np.nan, apart).reshape(value.shape)
        return block
