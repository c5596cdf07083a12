"""Summaries of each lane of a run, computed block by block of its rows, without its trajectory.

    drift        NAME_start and NAME_drift: first value and largest |change| of each Casimir and integral
    extremes     NAME_min and NAME_max of each component of the state, over the saved rows
    frequencies  NAME_frequency: angular frequency of the largest harmonic of each component of the state

The frequency is computed by `harmonics` under Hann's window, for a quasi-periodic motion with an error O(1/T^4), T the
length of the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kreisel.algebra import Array
from kreisel.kernels.layout import Floats
from kreisel.method import Outcome
from kreisel.method.scheme import KINDS
from kreisel.runs import harmonics

STATES = ("state", "orientation")
FEWEST_ROWS = 32  # for a frequency
AT_ONCE = 1 << 18  # samples in a slab of the frequency analysis
ROUND_OFF = 1e-12  # relative: a component that changes less is constant


class Drift:
    """First value and largest change of the Casimirs and integrals."""

    kinds = KINDS

    def __init__(self, names: Sequence[str], rows: int, spacing: float):
        self._names = names
        self._start: dict[str, Array] = {}
        self._worst: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Add the outputs of a block (rows, lanes, ...); blocks come in order."""
        for name in self._names:
            start = self._start.setdefault(name, block[name][0].copy())
            change = abs(block[name] - start).max(0)
            self._worst[name] = np.maximum(self._worst.get(name, 0.0), change)

    def result(self) -> dict[str, Floats]:
        """The summaries (lanes, ...)."""
        return {f"{k}_start": v for k, v in self._start.items()} | {f"{k}_drift": v for k, v in self._worst.items()}

    @staticmethod
    def meanings(outcome: Outcome) -> dict[str, str]:
        """The summaries of a variable and their meaning, by the end of their name."""
        return {"start": "at time 0", "drift": f"largest |change|{'' if outcome.conserved else ', not conserved'}"}


class Extremes:
    """Least and greatest values of the state."""

    kinds = STATES

    def __init__(self, names: Sequence[str], rows: int, spacing: float):
        self._names = names
        self._least: dict[str, Array] = {}
        self._greatest: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Add the outputs of a block (rows, lanes, ...)."""
        for name in self._names:
            self._least[name] = np.minimum(self._least.get(name, np.inf), block[name].min(0))
            self._greatest[name] = np.maximum(self._greatest.get(name, -np.inf), block[name].max(0))

    def result(self) -> dict[str, Floats]:
        """The summaries (lanes, ...)."""
        return {f"{k}_min": v for k, v in self._least.items()} | {f"{k}_max": v for k, v in self._greatest.items()}

    @staticmethod
    def meanings(outcome: Outcome) -> dict[str, str]:
        """The summaries of a variable and their meaning, by the end of their name."""
        return {"min": "least", "max": "greatest"}


class Frequencies:
    """Angular frequencies of the state; rows are `spacing` apart, except perhaps the last, which is left out."""

    kinds = STATES

    def __init__(self, names: Sequence[str], rows: int, spacing: float):
        self._names, self._rows, self._spacing, self._filled = names, rows, spacing, 0
        self._samples: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Add the outputs of a block (rows, lanes, ...); blocks come in order."""
        for name in self._names:
            value = block[name][: self._rows - self._filled]
            samples = self._samples.setdefault(name, np.empty((self._rows, *value.shape[1:])))
            samples[self._filled : self._filled + len(value)] = value
        self._filled += len(value)

    def result(self) -> dict[str, Floats]:
        """The summaries (lanes, ...)."""
        out = {}
        for name, samples in self._samples.items():
            flat = samples.reshape(len(samples), -1)
            width = max(1, AT_ONCE // len(flat))
            parts = [angular_frequency(flat[:, i : i + width], self._spacing) for i in range(0, flat.shape[1], width)]
            out[f"{name}_frequency"] = np.concatenate(parts).reshape(samples.shape[1:])
        return out

    @staticmethod
    def meanings(outcome: Outcome) -> dict[str, str]:
        """The summaries of a variable and their meaning, by the end of their name."""
        return {"frequency": "angular frequency of the largest harmonic; 0: constant"}


SUMMARIES: dict[str, type[Drift | Extremes | Frequencies]] = {
    "drift": Drift,
    "extremes": Extremes,
    "frequencies": Frequencies,
}


def summarized(kind: str, outcomes: Mapping[str, Outcome]) -> list[str]:
    """The variables that a kind of summary covers."""
    return [name for name, outcome in outcomes.items() if outcome.kind in SUMMARIES[kind].kinds]


def angular_frequency(samples: Floats, spacing: float) -> Floats:
    """The frequency of the largest harmonic of each column of samples (rows, columns) minus its mean; 0 if constant."""
    t = spacing * (np.arange(len(samples)) - (len(samples) - 1) / 2)
    weights = harmonics.window(t, 1)
    swing = samples - (weights[:, None] * samples).sum(0)
    constant = ~(abs(swing).max(0) > ROUND_OFF * abs(samples).max(0))
    omega = harmonics.strongest(t, weights[:, None] * np.where(constant, 0.0, swing), still=False)
    return np.where(constant, np.where(np.isfinite(samples).all(0), 0.0, np.nan), omega)
