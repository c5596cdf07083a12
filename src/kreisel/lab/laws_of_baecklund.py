"""Laws of Bäcklund transformations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Complex
from kreisel.errors import InputError
from kreisel.lab import exact
from kreisel.lab.exact import slopes
from kreisel.lab.law import ORDER_TOLERANCE, Case, Sides, _law
from kreisel.lab.laws_of_flows import _carried
from kreisel.lab.orders import baecklund_orders, flowed
from kreisel.record.contract import Baecklund, System
from kreisel.record.model import Model


def _has_baecklund(system: System) -> bool:
    return system.baecklund is not None


@dataclass(frozen=True)
class _Curve:
    """A state with a point (mu, rho) of its spectral curve, and maps from it; `given` is the e of a rational case."""

    case: Case
    model: Model
    record: Baecklund
    state: tuple[Array, ...]
    mu: Any
    rho: Any
    given: Array = None

    def call(self, function: Callable[..., Any] | None, *arguments: Array, **extra: Any) -> Any:
        if function is None:
            raise InputError(f"{self.case.system.name} does not state what this law needs.")
        return self.model.call(function, *arguments, **{"mu": self.mu, "rho": self.rho, **extra})

    def flat(self, state: tuple[Array, ...]) -> Array:
        return self.case.flat(state)

    def at(self, mu: Any, state: tuple[Array, ...] | None = None) -> _Curve:
        """The same state, or another, with the rho of mu on the near branch; floats only."""
        state = self.state if state is None else state
        rho = self.model.call(self.record.point, *state, mu=mu)
        return _Curve(self.case, self.model, self.record, state, mu, rho[()])

    def move(self, *state: Array) -> tuple[Array, ...]:
        """D_eps, or the conjugate pair for a complex mu, from this state or another on the curve."""
        state = state or self.state
        e = self.call(self.record.vector, *state)
        pair = isinstance(self.mu, complex | Complex)
        return tuple(self.call(self.record.pair if pair else self.record.step, *state, e))


def _record(case: Case) -> Baecklund:
    if case.system.baecklund is None:
        raise InputError(f"{case.system.name} states no Bäcklund transformation.")
    return case.system.baecklund


def _point_on_curve(case: Case) -> _Curve:
    """In exact numbers a random rational point; in floats the case's own state with eps = 2/7."""
    record = _record(case)
    if case.numbers == "exact":
        if record.case is None:
            raise InputError(f"{case.system.name} does not state a rational case.")
        state, params, e, mu, rho = record.case(case.model.n, case.draw)
        return _Curve(case, case.system(**params), record, state, mu, rho, e)
    return _Curve(case, case.model, record, case.state, 7.0, None).at(7.0)


@_law("(mu, rho) lies on the spectral curve; e is the eigenvector that a rational case is made from", _has_baecklund)
def spectral_point(case: Case) -> Sides:
    curve = _point_on_curve(case)
    e = curve.call(curve.record.vector, *curve.state)
    value = curve.call(curve.record.defect, *curve.state, e)
    yield value, 0 * value
    if curve.given is not None:
        yield e, curve.given


@_law("I(D(z)) = I(z) for the Casimirs and every integral of the continuous flow", _has_baecklund)
def integrals_of_baecklund(case: Case) -> Sides:
    casimirs: Any = case.system.space.casimirs
    for curve in (_point_on_curve(case), _pairs(case)[0]):
        new = curve.move()
        yield casimirs(*new), casimirs(*curve.state)
        for function in (case.system.energy, *case.system.integrals.values()):
            yield np.asarray(curve.call(function, *new)), np.asarray(curve.call(function, *curve.state))


@_law("N L = L_new N at random lambda: the Darboux matrix", _has_baecklund)
def darboux(case: Case) -> Sides:
    curve = _point_on_curve(case)
    e = curve.call(curve.record.vector, *curve.state)
    N = curve.call(curve.record.darboux, *curve.state, e, lam=case.lam)
    old, new = (curve.call(case.system.lax, *z, lam=case.lam)[0] for z in (curve.state, curve.move()))
    yield N @ old, new @ N


@_law("J Pi(z) J^T = Pi(D(z)), the derivative of rho included", _has_baecklund)
def poisson_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    flat = curve.flat(curve.state)
    new = curve.move(*algebra.restore(exact.independent(flat), case.kinds, curve.model.n))  # Newton's step has d rho
    J = slopes(algebra.flatten(new, case.kinds), len(flat))
    yield J @ case.tensor(curve.state) @ J.T, case.tensor(curve.move())


@_law("D(-eps) is the inverse of D(eps)", _has_baecklund)
def symmetric_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    sign = curve.record.odd
    back = _Curve(case, curve.model, curve.record, curve.move(), -curve.mu, sign * curve.rho)
    yield curve.flat(back.move()), curve.flat(curve.state)


@_law("D(eps) D(delta) = D(delta) D(eps), and D(eps) commutes with the flow", _has_baecklund, exact=False)
def commuting_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    first, second = curve, curve.at(5.0)
    yield curve.flat(second.move(*first.move())), curve.flat(first.move(*second.move()))

    def flow(state: tuple[Array, ...]) -> tuple[Array, ...]:
        return flowed(curve.model, state, 0.3)

    yield curve.flat(flow(first.move())), curve.flat(first.move(*flow(curve.state)))
    pair = curve.at(7 + 4j)
    yield curve.flat(flow(pair.move())), curve.flat(pair.move(*flow(curve.state)))


@_law(
    "the paper's map is D(eps) in other variables, at its point of the spectral curve",
    lambda s: s.baecklund is not None and s.map is not None and s.map.darboux is not None,
)
def map_is_baecklund(case: Case) -> Sides:
    *state, rho = case.call(case.map.darboux)
    *after, rho_after = case.call(case.map.darboux, *case.call(case.map.step))
    curve = _Curve(case, case.model, _record(case), tuple(state), 2 / case.eps, rho)
    yield curve.flat(curve.move()), curve.flat(tuple(after))
    yield np.asarray(rho), np.asarray(rho_after)


@_law(
    "a conjugate pair in real arithmetic is the product of the two complex maps; N2 N1 L = L_new N2 N1", _has_baecklund
)
def conjugate_pair(case: Case) -> Sides:
    for pair in _pairs(case):
        first = pair.call(pair.record.vector, *pair.state)
        between = pair.call(pair.record.step, *pair.state, first)
        other = {"mu": algebra.conjugate(pair.mu), "rho": algebra.conjugate(pair.rho)}
        second = pair.call(pair.record.vector, *between, **other)
        re, im = algebra.parts(pair.flat(tuple(pair.call(pair.record.step, *between, second, **other))))
        yield re, pair.flat(pair.move())
        yield im, 0 * re
        arc = pair.call(pair.record.arc_of_pair, *pair.state, first)
        carried = _carried(case, pair.state)
        one = algebra.identity(len(carried)) + 0 * carried[:, None]
        turned = algebra.double_turn(arc[0], arc[1], one) @ carried
        yield turned, _carried(case, pair.move())
        N1 = pair.call(pair.record.darboux, *pair.state, first, lam=case.lam)
        N2 = pair.call(pair.record.darboux, *between, second, lam=case.lam, **other)
        old, new = (pair.call(case.system.lax, *z, lam=case.lam)[0] for z in (pair.state, pair.move()))
        yield from zip(algebra.parts(N2 @ N1 @ old), algebra.parts(new @ (N2 @ N1)), strict=True)


def _pairs(case: Case) -> list[_Curve]:
    """Complex points: in exact numbers a random one over Q(i), in floats two of the case's own state."""
    record = _record(case)
    if case.numbers == "float":
        return [_point_on_curve(case).at(mu) for mu in (7 + 4j, 2 + 1.5j)]
    if record.pair_case is None:
        raise InputError(f"{case.system.name} does not state a case over Q(i).")
    state, params, _, mu, rho = record.pair_case(case.model.n, case.draw)
    return [_Curve(case, case.system(**params), record, state, mu, rho)]


@_law("the error of K maps is O(dt^(2K)) in the state and in g, for K = 1 to 3", _has_baecklund, exact=False)
def order_baecklund(case: Case) -> Sides:
    for order, counts in ((2, (8, 12, 16, 24)), (4, (6, 8, 12, 16)), (6, (4, 6, 8, 12))):
        for slope in baecklund_orders(case.model, case.state, order, counts):
            off = abs(slope - order)
            yield np.asarray(0.0 if off < ORDER_TOLERANCE else off), np.asarray(0.0)
