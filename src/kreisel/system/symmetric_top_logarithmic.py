"""Totally symmetric Lagrange top, moving frame: a second explicit map, by a logarithmic potential.

State (M, P) in e(n)*: M (..., n, n) skew, P (..., n), any |A| and |P|.  Plus bracket, F' = {H, F}.  The flow is that of
`symmetric_top`; the map is that of `quadratic_field` on so(n) x so(1), B = [[0, A], [A^T, 0]] and the field
-[[0, P], [P^T, 0]]: with k = eps/2,

    M_(k+1) = M + eps A ^ P/(1 - k^2 <A, P>),   P_(k+1) = cay(-k M_(k+1)) P.

The logarithm is Kovalevskaya's; with the other sign of eps^2 the map is not integrable.  [This map was made here]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import act, dot, identity, log, mat, pairing, trace_log, wedge
from kreisel.algebra.invariants import MOST, border
from kreisel.record.contract import Relation, kicked_map, named
from kreisel.system import quadratic_field as general, symmetric_top


def kick(P, *, A, eps):
    return wedge(A, P) * mat(eps / (1 - eps * eps / 4 * dot(A, P)))


def lagrangian(g, h, p, *, A, eps):  # -(1/eps) tr log(2 + W + W^T) + (4/eps) log(1 - k^2 <A, P>)
    W = g.mT @ h
    kinetic = trace_log(2 * identity(W.shape[-1]) + W + W.mT) / eps
    return 4 / eps * log(1 - eps * eps / 4 * dot(A, act(g.mT, p))) - kinetic


def energy(M, P, *, A, eps=0):  # H at S = (1 + k M) P, less (k^2/2) (|A|^2 |S|^2 - <A, S>^2)
    S = P + eps * act(M, P) / 2
    along = dot(A, S)
    return pairing(M, M) / 2 + along - eps * eps * (dot(A, A) * dot(S, S) - along * along) / 8


def enlarged(M, P, A):
    """M (+) 0, the field and B, of size n + 1."""
    return border(M, 0 * P), border(0 * M, -P), border(0 * M, A + 0 * P)


def spectrum(M, P, *, A, eps=0):
    """det L(lambda, mu) at n - 2 points (lambda, mu): with the energy and `noether` they are complete."""
    points = [(1 + j, 1 + j % 2) for j in range(min(M.shape[-1], MOST) - 2)]
    M, F, B = enlarged(M, P, A)
    return general.values_of(M, F, general.potential(F, eps * eps * B / 4), B, eps=eps, points=points)


def ranks(P):
    """V = [[P, 0], [0, 1]] and -V [[0, 1], [1, 0]], (n + 1, 2): the first times the second's transpose is the field."""
    zero, unit = 0 * P, 1 + 0 * P[..., :1]
    first, second = np.concatenate([P, 0 * unit], -1), np.concatenate([zero, unit], -1)
    return np.stack([first, second], -1), -np.stack([second, first], -1)


def pencil(M, P, *, A, lam, mu, eps):  # of size n + 3
    (M, _, B), (left, right) = enlarged(M, P, A), ranks(P)
    return general.pencil_of(M, left, right, B, lam=lam, mu=mu, eps=eps)


def factors(M, P, *, A, lam, eps):
    (_, _, B), (left, right) = enlarged(M, P, A), ranks(P)
    unit = identity(P.shape[-1] + 1) + 0 * B
    return general.turned(general.factors_of(left, right, B, lam=lam, eps=eps), unit, unit[..., :2, :2])


def largest_step(M, P, *, A):
    """The denominator 1 - (eps^2/4) <A, P> stays positive on |P| = const for smaller |eps|."""
    return 2 / np.sqrt(np.sqrt(dot(P, P) * dot(A, A)))


SYSTEM = replace(
    symmetric_top.SYSTEM,
    name="symmetric-top-logarithmic",
    title="Totally symmetric Lagrange top, moving frame, in a logarithmic potential",
    source="Suris 2001, section 1",
    energy=energy,
    integrals={"spectrum": spectrum, "noether": symmetric_top.noether},
    map=kicked_map(
        kick,
        symmetric_top.turn,
        **named(lagrangian, pencil, factors, largest_step),
        generator=symmetric_top.generator,
        source="Kreisel",
    ),
    baecklund=None,
    relations=(Relation("symmetric-top", lambda M, P, g, *, A: ((M, P), {"A": A}), meaning="another map"),),
    notes="For n >= 4 the spectrum is not complete: noether is needed too.",
)
