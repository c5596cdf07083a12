"""Pairs of particles, of which one at least is a body: their kinds and the factors of their interaction.

A particle without mass feels others and does not act: in its pairs it has mass 1, and the other stays unchanged.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.bodies.binary import G
from kreisel.exact import rotor_step
from kreisel.rebound.compiled import PAIR, ROTOR, Kind

CONSTANTS = {"moments": 3, "degree_3": 7, "degree_4": 9, "tide": 1, "lag": 1}  # of a body, in a row
ENDS = np.cumsum([*CONSTANTS.values()])


def is_ball(moments: Array) -> bool:
    """Whether moments are equal up to rounding."""
    return bool(np.ptp(moments) <= 1e-12 * np.max(moments))


def rotor(row: Array) -> Array:
    """The constants of the free rotation of a body."""
    moments = row[:3]
    constants = rotor_step.constants(np.full(3, moments.mean()) if is_ball(moments) else moments)
    return np.concatenate([constants[name] for name in ROTOR])


class Side(NamedTuple):
    """A particle in a pair.

    particle, body   its places
    mass             1 for particles without mass
    source           the mass that acts on the other particle, or 0
    on               1, or 0 if the other does not act on it
    row              `CONSTANTS` of a body, 0 of a point
    """

    particle: int
    body: int
    mass: float
    source: float
    on: float
    row: Array

    @property
    def degree(self) -> int:
        """The degree of its figure."""
        moments, *higher = np.split(self.row, ENDS[:3])[:3]
        return 4 if any(x.any() for x in higher) else 0 if is_ball(moments) else 2

    @property
    def fluid(self) -> bool:
        """Whether rotation flattens it: a ball with tides."""
        return bool(self.row[-2] and not self.degree)

    def factors(self, n: str, other: Side, h: float, scale: float) -> dict[str, Any]:
        """The factors of this side, which is number `n` of the pair."""
        moments, third, fourth, tide, lag = np.split(self.row, ENDS[:-1])
        inverse = 1 / moments if moments.any() else moments
        return {
            f"D{n}": (moments.mean() - moments) / self.mass if self.degree else 0 * moments,
            f"degree_3_{n}": third / self.mass,
            f"degree_4_{n}": fourth / self.mass,
            f"fluid{n}": h * other.mass * tide[0] if self.fluid else 0.0,
            f"inverse{n}": inverse,
            f"lag{n}": scale * other.source**2 * tide[0] * lag[0],
            f"into{n}": self.on / self.mass,
            f"on{n}": self.on,
        }


class Row(NamedTuple):
    """An interaction: its kind, the places of both particles and bodies, its factors."""

    kind: Kind
    places: tuple[int, int, int, int]
    factors: dict[str, Any]

    def values(self) -> Array:
        """The factors in a row, in the order of `PAIR`."""
        return np.concatenate([np.ravel(self.factors[name]) for name in PAIR])


def interactions(one: Side, two: Side, h: float, gravity: float) -> list[Row]:
    """The kick of a pair for a time h, and the friction of its tides, as far as there are any."""
    scale, rows = h * gravity / G, []
    tides = [(x, other.source**2 * x.row[ENDS[2]]) for x, other in ((one, two), (two, one))]
    for lags in (False, True):
        active = [bool(x.row[-1] and tide) if lags else x.fluid for x, tide in tides]
        order = [(x.degree if not lags else active[k], active[k], x.row[0] > 0) for k, x in enumerate((one, two))]
        first, second = (one, two) if order[0] >= order[1] else (two, one)
        count = 0 if not any(active) else 2 if all(active) or active != [first is one, first is two] else 1
        raised = sum(tide for _, tide in tides) / (one.mass * two.mass)
        factors = {"strength": scale * one.mass * two.mass, "raised": raised}
        factors |= first.factors("1", second, h, scale) | second.factors("2", first, h, scale)
        places = first.particle, second.particle, first.body, second.body
        if lags and count:
            degrees = [min(x.degree, 2) * on for x, on in ((first, 1), (second, count == 2))]
            rows.append(Row(Kind(degrees[0], degrees[1], lags=count), places, factors))
        elif not lags and any((first.degree, count, raised)):
            rows.append(Row(Kind(first.degree, second.degree, fluids=count), places, factors))
    return rows


class Pairs(NamedTuple):
    """The interactions of a simulation, the values that they depend on, and the arrays of the kernels."""

    key: tuple[float, float, int, int, bytes]
    kinds: tuple[Kind, ...]
    rows: list[Row]
    places: Array
    factors: Array

    @classmethod
    def of(cls, key: Any, masses: Array, index: Array, constants: Array) -> Pairs:
        """Interactions of particles, of which `index` are bodies; `key`: h, G, active, testparticle_type, masses."""
        h, gravity, active, mutual, _ = key
        bodies, points = {int(i): k for k, i in enumerate(index)}, np.zeros(constants.shape[1])

        def acts(i: int, j: int) -> bool:
            return bool(masses[i] > 0 and (i < active or (mutual and j < active)))

        def side(i: int, j: int) -> Side:
            row = constants[bodies[i]] if i in bodies else points
            return Side(i, bodies.get(i, len(bodies)), masses[i] or 1.0, acts(i, j) * masses[i], acts(j, i) * 1.0, row)

        pairs = [(i, j) for i in sorted(bodies) for j in range(len(masses)) if j not in bodies or i < j]
        rows = [row for i, j in pairs for row in interactions(side(i, j), side(j, i), h, gravity)]
        rows.sort(key=lambda row: row.kind.lags > 0)  # frictions last: kicks do not wait for the results of each other
        kinds = tuple(sorted({row.kind for row in rows}))
        places = np.array([[kinds.index(row.kind), *row.places] for row in rows], dtype=np.int64)
        return cls(key, kinds, rows, places, np.array([row.values() for row in rows]))
