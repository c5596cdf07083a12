"""Summaries of each lane of a run, made block by block of its rows, without its trajectory.

    drift        NAME_start and NAME_drift: first value and largest |change| of each Casimir and integral
    extremes     NAME_min and NAME_max of each component of the state, over the saved rows
    frequencies  NAME_frequency: angular frequency of the largest harmonic of each component of the state

The frequency is that of `harmonics` under Hann's window: for a quasi-periodic motion it is off by O(1/T^4), T the
length of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

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


class Summary(Protocol):
    """Fed with blocks of outputs (rows, lanes, ...), in order; then the summaries (lanes, ...) by name."""

    def add(self, block: Mapping[str, Array]) -> None:
        """Take a block in."""

    def result(self) -> dict[str, Floats]:
        """The summaries."""


class Drift:
    """First value and largest change of the Casimirs and integrals."""

    def __init__(self, outcomes: Mapping[str, Outcome], rows: int, spacing: float):
        self._names = [name for name, outcome in outcomes.items() if outcome.kind in KINDS]
        self._start: dict[str, Array] = {}
        self._worst: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Take a block in."""
        for name in self._names:
            start = self._start.setdefault(name, block[name][0].copy())
            change = abs(block[name] - start).max(0)
            self._worst[name] = np.maximum(self._worst.get(name, 0.0), change)

    def result(self) -> dict[str, Floats]:
        """The summaries."""
        return {f"{k}_start": v for k, v in self._start.items()} | {f"{k}_drift": v for k, v in self._worst.items()}

    @staticmethod
    def parts(outcomes: Mapping[str, Outcome]) -> dict[str, tuple[str, str]]:
        """Name -> (the variable that it is of, its meaning)."""
        out = {}
        for name, outcome in outcomes.items():
            if outcome.kind in KINDS:
                out[f"{name}_start"] = name, f"{outcome.meaning}: at time 0"
                out[f"{name}_drift"] = (
                    name,
                    f"{outcome.meaning}: largest |change|{'' if outcome.conserved else ', not conserved'}",
                )
        return out


class Extremes:
    """Least and greatest values of the state."""

    def __init__(self, outcomes: Mapping[str, Outcome], rows: int, spacing: float):
        self._names = [name for name, outcome in outcomes.items() if outcome.kind in STATES]
        self._least: dict[str, Array] = {}
        self._greatest: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Take a block in."""
        for name in self._names:
            self._least[name] = np.minimum(self._least.get(name, np.inf), block[name].min(0))
            self._greatest[name] = np.maximum(self._greatest.get(name, -np.inf), block[name].max(0))

    def result(self) -> dict[str, Floats]:
        """The summaries."""
        return {f"{k}_min": v for k, v in self._least.items()} | {f"{k}_max": v for k, v in self._greatest.items()}

    @staticmethod
    def parts(outcomes: Mapping[str, Outcome]) -> dict[str, tuple[str, str]]:
        """Name -> (the variable that it is of, its meaning)."""
        states = {name: outcome.meaning for name, outcome in outcomes.items() if outcome.kind in STATES}
        least = {f"{name}_min": (name, f"{meaning}: least") for name, meaning in states.items()}
        return least | {f"{name}_max": (name, f"{meaning}: greatest") for name, meaning in states.items()}


class Frequencies:
    """Angular frequencies of the state; rows are `spacing` apart, a last one that is not is left out."""

    def __init__(self, outcomes: Mapping[str, Outcome], rows: int, spacing: float):
        self._names = [name for name, outcome in outcomes.items() if outcome.kind in STATES]
        self._rows, self._spacing, self._filled = rows, spacing, 0
        self._samples: dict[str, Array] = {}

    def add(self, block: Mapping[str, Array]) -> None:
        """Take a block in."""
        for name in self._names:
            value = block[name][: self._rows - self._filled]
            samples = self._samples.setdefault(name, np.empty((self._rows, *value.shape[1:])))
            samples[self._filled : self._filled + len(value)] = value
        self._filled += len(value)

    def result(self) -> dict[str, Floats]:
        """The summaries."""
        out = {}
        for name, samples in self._samples.items():
            flat = samples.reshape(len(samples), -1)
            width = max(1, AT_ONCE // len(flat))
            parts = [angular_frequency(flat[:, i : i + width], self._spacing) for i in range(0, flat.shape[1], width)]
            out[f"{name}_frequency"] = np.concatenate(parts).reshape(samples.shape[1:])
        return out

    @staticmethod
    def parts(outcomes: Mapping[str, Outcome]) -> dict[str, tuple[str, str]]:
        """Name -> (the variable that it is of, its meaning)."""
        return {
            f"{name}_frequency": (name, f"{outcome.meaning}: angular frequency of the largest harmonic; 0: constant")
            for name, outcome in outcomes.items()
            if outcome.kind in STATES
        }


SUMMARIES: dict[str, Callable[[Mapping[str, Outcome], int, float], Summary]] = {
    "drift": Drift,
    "extremes": Extremes,
    "frequencies": Frequencies,
}
PARTS = {"drift": Drift.parts, "extremes": Extremes.parts, "frequencies": Frequencies.parts}


def angular_frequency(samples: Floats, spacing: float) -> Floats:
    """The frequency of the largest harmonic of each column of samples (rows, columns) less its mean; 0 if constant."""
    t = spacing * (np.arange(len(samples)) - (len(samples) - 1) / 2)
    weights = harmonics.window(t, 1)
    swing = samples - (weights[:, None] * samples).sum(0)
    constant = ~(abs(swing).max(0) > ROUND_OFF * abs(samples).max(0))
    omega = harmonics.strongest(t, weights[:, None] * np.where(constant, 0.0, swing), still=False)
    return np.where(constant, np.where(np.isfinite(samples).all(0), 0.0, np.nan), omega)
