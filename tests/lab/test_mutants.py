"""Every law catches its mutants: a record with one formula spoiled must fail."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from kreisel import algebra, implicit
from kreisel.algebra import act, cayley_act, dot, invariants, mat, pairing, trace_log, vec, wedge
from kreisel.algebra.invariants import border, diagonal, su2
from kreisel.baecklund import clebsch as body_maps, lagrange_top as top_maps
from kreisel.lab import laws
from kreisel.lab.paper.clebsch import printed_lagrangian, printed_pencil
from kreisel.lab.paper.tops import printed_b, printed_conjugator, printed_lax, unnormalised
from kreisel.record.contract import System
from kreisel.system import (
    clebsch,
    clebsch_body,
    euler_top,
    goryachev_chaplygin,
    hess_appelrot,
    kirchhoff_revolution,
    kovalevskaya_gyrostat,
    kovalevskaya_top_e3,
    kovalevskaya_top_so3,
    kovalevskaya_top_sp4,
    lagrange_top,
    lagrange_top_moving,
    lagrange_top_su2,
    lattice_landau_lifshitz,
    lyapunov,
    neumann,
    neumann_veselov,
    quadratic_field,
    quadratic_potential,
    ratiu_bitop,
    ratiu_top,
    rosochatius,
    spin_chain,
    steklov,
    symmetric_top,
    symmetric_top_logarithmic,
    zhukovsky_volterra,
)

VESELOV, ROSOCHATIUS = neumann_veselov.SYSTEM, rosochatius.SYSTEM
GORYACHEV, HESS = goryachev_chaplygin.SYSTEM, hess_appelrot.SYSTEM
STEKLOV, LYAPUNOV = steklov.SYSTEM, lyapunov.SYSTEM
BITOP, RATIU = ratiu_bitop.SYSTEM, ratiu_top.SYSTEM
ROTOR, SP4 = kovalevskaya_gyrostat.SYSTEM, kovalevskaya_top_sp4.SYSTEM
LOGARITHMIC = symmetric_top_logarithmic.SYSTEM
KOVALEVSKAYA, TWO_FIELDS = kovalevskaya_top_e3.SYSTEM, kovalevskaya_top_so3.SYSTEM
REVOLUTION = kirchhoff_revolution.SYSTEM
BODY = clebsch_body.SYSTEM
FIELD = quadratic_field.SYSTEM
GYROSTAT = zhukovsky_volterra.SYSTEM
LATTICE, CHAIN = lattice_landau_lifshitz.SYSTEM, spin_chain.SYSTEM
EULER, SU2 = euler_top.SYSTEM, lagrange_top_su2.SYSTEM
TOP, MOVING, CLEBSCH, NEUMANN = lagrange_top.SYSTEM, lagrange_top_moving.SYSTEM, clebsch.SYSTEM, neumann.SYSTEM


def mapped(system: System, **changes: object) -> System:
    return replace(system, map=replace(system.map, **changes))


def wrong_space(system: System, **changes: object) -> System:
    return replace(system, space=replace(system.space, **changes))


# the five mutants of the step of the Lagrange top
def turned_backwards(m, a, *, p, eps):
    m = m + eps * wedge(a, p)
    return m, cayley_act(-eps / 2 * m, a)


def kicked_backwards(m, a, *, p, eps):
    m = m - eps * wedge(a, p)
    return m, cayley_act(eps / 2 * m, a)


def old_momentum(m, a, *, p, eps):
    return m + eps * wedge(a, p), cayley_act(eps / 2 * m, a)


def lost_half(m, a, *, p, eps):
    m = m + eps * wedge(a, p)
    return m, cayley_act(eps * m, a)


def euler_for_cayley(m, a, *, p, eps):
    m = m + eps * wedge(a, p)
    return m, a + eps * act(m, a)


STEPS = [turned_backwards, kicked_backwards, old_momentum, lost_half, euler_for_cayley]


def linear_force(M, F, *, b, eps):  # a quadratic field without the denominator of its kick
    M = M + eps * algebra.bracket(F, diagonal(b))
    return M, quadratic_field.rotated(-eps / 2 * M, F)


def other_potential(g, h, A, *, B, eps):  # with 1/eps for 2/eps
    F, one = g.mT @ A @ g, algebra.identity(len(A))
    return quadratic_field.lagrangian(g, h, A, B=B, eps=eps) - trace_log(one + eps * eps / 4 * B @ F) / eps


def unturned_blocks(M, F, *, B, lam, eps):
    return quadratic_field.factors_of(F, algebra.identity(len(M)) + 0 * F, B, lam=lam, eps=eps)


def plain_kick(M, P, *, e, eps):  # Kovalevskaya's top without the denominator of its kick
    return kovalevskaya_top_e3.turn(M + eps * wedge(e, P), P, eps=eps)


def turned_alone(M, P, *, e, eps):  # without the second turn of the momentum
    M = M + kovalevskaya_top_e3.kick(P, e=e, eps=eps)
    return M, kovalevskaya_top_e3.turn(M, P, eps=eps)[1]


def without_own_turn(M, P, M1, P1, *, e, eps):
    return eps / 2 * (M + kovalevskaya_top_e3.kick(P, e=e, eps=eps))


def undeformed(M, P, *, c, eps=0):
    return kovalevskaya_top_e3.energy(M, P, c=c)


def fields_apart(M, P, Q, *, e, h, eps):  # each field with a denominator of its own
    k = eps * eps / 4
    kick = vec(1 / (1 - k * P[..., 0])) * wedge(e, P) + vec(1 / (1 - k * Q[..., 1])) * wedge(h, Q)
    return kovalevskaya_gyrostat.turn(M + eps * kick, P, Q, 0, eps)


def rotor_forgotten(M, P, Q, *, gamma, e, h, eps):  # the turn cay(k M) cay(k M_11) and then one by gamma alone
    M, P, Q = kovalevskaya_gyrostat.step(M, P, Q, gamma=0, e=e, h=h, eps=eps)
    Y = eps / 2 * mat(gamma) * wedge(e, h)
    turned = kovalevskaya_gyrostat.turned
    F = turned(Y, np.stack([P, Q], -1))
    return turned(Y, turned(Y, M).mT).mT, F[..., 0], F[..., 1]


def blocks_at_rest(M, G, *, X, h, spins, eps):  # without the turn by the conserved blocks
    return ratiu_top.turn(M + ratiu_top.kick(G, X=X, h=h, eps=eps), G, h=h, spins=0 * spins, eps=eps)


def linear_pull(M, G, *, X, h, spins, eps):  # a kick without its denominator
    return ratiu_top.turn(M + eps * algebra.bracket(G, X), G, h=h, spins=spins, eps=eps)


def of_flow(M, G, *, c, X, C, h):
    return ratiu_top.energy(M, G, c=c, X=X, C=C, h=h)


def double_weight(M, P, *, eps):  # with eps^2/4 for eps^2/8 in the denominator of the kick
    return kovalevskaya_top_sp4.turn(M + kovalevskaya_top_sp4.kick(2 * P, eps=eps) / 2, P, eps=eps)


def turned_alike(M, P, *, eps):  # both turns with the same denominator
    M = M + kovalevskaya_top_sp4.kick(P, eps=eps)
    return kovalevskaya_gyrostat.turn(M, P, 0 * P, 0, eps)[:2]


def other_logarithm(M, P, *, A, eps):  # with 1 + eps^2/4 <A, P>
    M = M - symmetric_top_logarithmic.kick(-P, A=A, eps=eps)
    return M, cayley_act(-eps / 2 * M, P)


def plain_reversal(M, P, Q, *, e, h, eps):  # which turns the rotor round too
    return -kovalevskaya_gyrostat.kicked(M, P, Q, e, h, eps), P, Q


def without_rotor(M, P, Q, *, lam, mu, eps):
    return kovalevskaya_gyrostat.pencil(M, P, Q, gamma=0, lam=lam, mu=mu, eps=eps)


def without_rotor_energy(M, P, Q, *, gamma, c, eps=0):  # gamma in the flow's part alone
    return kovalevskaya_gyrostat.energy(M, P, Q, gamma=0, c=c, eps=eps) - gamma * M[..., 0, 1]


def rest_of_gram(M, P, Q, *, eps=0):
    return kovalevskaya_top_so3.gram(M, P, Q, eps=eps) + eps * eps * dot(P, Q) * P[..., 0]


def rough_kick(M, P, *, b, eps):  # a Clebsch step without its denominator
    M = M + eps * wedge(P, b * P)
    return M, cayley_act(-eps / 2 * M, P)


def not_poisson(m, a, *, p, eps):
    m = m + eps * wedge(a, p)
    return m, cayley_act(eps / 2 * m * mat(1 + eps * dot(a, p)), a)


def wheel_at_rest(M, *, w):  # a Zhukovsky-Volterra gyrostat without h
    return zhukovsky_volterra.flow(M, h=np.zeros(3, dtype=np.int8), w=w)


def wheel_turned_round(M, *, h, w, lam):
    return zhukovsky_volterra.lax(M, h=-h, w=w, lam=lam)


def body_alone(M, *, h, w):  # T(M), without the wheel
    return zhukovsky_volterra.energy(M, h=0 * h, w=w)


def without_curvature(x0, x, *, b, eps):
    z = vec(eps * eps / 2 / clebsch.denominator(x, b=b, eps=eps)) * (b * x) - x0 / vec(1 + dot(x, x0))
    return z / vec(1 - dot(x, z))


def euler_without_curvature(M, *, c, eps):  # X = (eps/2) Omega, as in a variational step without its correction
    return euler_top.move(M, eps / 2 * c * M)


def euler_other_branch(M, *, J, eps):  # W -> diag(-1, -1, 1, 1): a solution for every step, by sweeps
    signs = np.array([-1, -1, 1, 1])
    c, X = euler_top.sums(J=J * signs)["c"], 0 * M
    for _ in range(40):
        X = eps / 2 * c * (M + M @ X - X @ M - X @ M @ X)
    W = algebra.cayley(X) * signs
    return (W.mT @ M @ W,)


def euler_one_doubling_less(M, *, J, eps):  # it stops at |A| = 0.05 gamma^2, not 1e-9
    one = np.eye(4) + 0 * M
    with mock.patch.object(implicit, "SMALL", implicit.SMALL**0.15):
        return euler_top.move(M, implicit.turn(M, J, one, one, eps))


def doubled_flow(m, a, *, p):
    return 2 * wedge(a, p), act(m, a)


def transposed_turn(m, a, m1, a1, *, alpha, eps):
    return -lagrange_top.generator(m, a, m1, a1, alpha=alpha, eps=eps)


def isotropic_turn(m, a, m1, a1, *, alpha, eps):
    return eps / 2 * m1 / mat(alpha)


def constant_alpha(g, h, A, *, p, alpha, eps):
    return lagrange_top.lagrangian(g, h, A, p=p, alpha=1, eps=eps)


def half_angle(g, h, A, *, p, alpha, eps):  # tr R in the place of tr w
    return lagrange_top_su2.lagrangian(g, h, A, p=p, alpha=2 * alpha, eps=eps)


def force_forgotten(M, P, *, J, c, eps):  # R = P P^T/2
    X = quadratic_potential.solved(M, clebsch_body.outer(P), clebsch_body.outer(P) / 2, J=J, c=c, eps=eps)[0]
    return quadratic_potential.moved(M, clebsch_body.outer(P) / 2, X, J=J, eps=eps), cayley_act(-X, P)


def opposite(M, P, *, b, nu):
    return steklov.lyapunov(M, P, b=b, nu=-nu)


def cayley_turn(M, G, *, X, h, eps):  # cay(h M) for W, which is right for n = 3
    M = M + eps * algebra.bracket(G, X)
    return M, algebra.cayley_conjugate(-eps * h / 2 * M, G)


def unturned(M, G, *, X, h, u, v, eps):  # M without its turn by R
    return M + eps * algebra.bracket(G, X), BITOP.map.step(M, G, X=X, h=h, u=u, v=v, eps=eps)[1]


def other_root(x, q, *, b, eps):  # x1 = -x_(k-1)
    x1, q1 = neumann_veselov.step(x, q, b=b, eps=-eps)
    return -x1, q1


def without_walls(x, q, *, b, mu, eps):
    return neumann_veselov.step(x, q, b=b, eps=eps)


def without_turns(x, q, *, b, mu, lam):
    return neumann.lax(*rosochatius.lifted(x, q, mu), b=rosochatius.doubled(b), lam=lam)


def same(m, a, *, p, eps):
    return m, a


def whole_kick(m, a, *, p, eps):
    return m + eps * wedge(a, p), a


def transformed(system: System, **changes: object) -> System:
    return replace(system, baecklund=replace(system.baecklund, **changes))


def next_to_rho(m, a, *, p, mu, rho):
    return top_maps.eigenvector(m, a, p=p, mu=mu, rho=rho + 1)


def fixed_rho(m, a, *, p, mu, rho):
    return 2 * algebra.shifted_resolvent(mu, m, a - vec(rho) * p)


def frozen(system: System) -> System:  # rho frozen at a wrong value: no longer that of the state
    vector = system.baecklund.vector

    def rest(m, a, *, p, mu, rho):
        return vector(m, a, p=p, mu=mu, rho=2 * rho)

    def top(M, P, *, A, mu, rho):
        return vector(M, P, A=A, mu=mu, rho=2 * rho)

    def body(M, P, *, c, mu, rho):
        return vector(M, P, c=c, mu=mu, rho=2 * rho)

    return transformed(system, vector=rest if system is TOP else body if system.derive else top)


def stretched(system: System) -> System:  # a pair with a wrong real part of its eigenvector
    pair, derived = system.baecklund.pair, system.derive is not None

    def other(e):
        re, im = algebra.parts(e)
        return algebra.together(2 * re, im)

    def top(M, P, e, *, A):
        return pair(M, P, other(e), A=A)

    def body(M, P, e, *, c, mu):
        return pair(M, P, other(e), c=c, mu=mu)

    return transformed(system, pair=body if derived else top)


def forgotten_rho(m, a, *, p, mu):
    return dot(a, a) / (mu * mu)


def flipped_step(m, a, e, *, p):
    return top_maps.step(m, a, -e, p=p)


def old_momentum_transform(m, a, e, *, p):
    return m + wedge(e, p), a + act(m, e)


def lost_curvature(m, a, e, *, p):  # the pair without the term across
    m1, _ = top_maps.pair(m, a, e, p=p)
    return m1, a + act(m + m1, algebra.parts(e)[0])


def unscaled_darboux(m, a, e, *, rho, lam):
    return top_maps.darboux(m, a, e, rho=2 * rho, lam=lam)


def unshifted(m, a, *, p, eps):
    return m, a - eps / 2 * act(m, a), eps * eps * dot(a, a) / 4


def no_block(m, a):
    return 0 * m


def without_spin(M, P, M1, P1, *, a1, eps):
    return mat(a1 * eps / 2) * M1


def other_way_round(M, P, *, a1, a3, b, e, eps):
    M = M + kirchhoff_revolution.kick(P, a1=a1, b=b, eps=eps)
    return kirchhoff_revolution.turn(M, P, a1=a1, a3=2 * a1 - a3, e=e, eps=eps)


def without_rest(M, P):
    return 0 * M


def at_another_point(M, P, *, c, mu, rho):
    return body_maps.eigenvector(M, P, c=c, mu=mu, rho=rho)


def even_bonds_backwards(*z, D, eps):
    S, T = lattice_landau_lifshitz.gate(z[:3], z[3:], D, eps)
    T, S = lattice_landau_lifshitz.gate(T, lattice_landau_lifshitz.after(S), D, -eps)
    return *lattice_landau_lifshitz.after(S, -1), *T


def one_spin_of_two(*z, D, eps):
    S, _ = lattice_landau_lifshitz.gate(z[:3], z[3:], D, eps)
    return *S, *z[3:]


def without_anisotropy(*z, D):
    return lattice_landau_lifshitz.flow(*z, D=0 * D)


def of_one_sublattice(*z, D, eps=0):
    return lattice_landau_lifshitz.bond(z[:3], z[3:], D).sum(-1)


def without_left_neighbours(x, y, z, *, Jx, Jy, Jz, Bx, By, Bz, K, bond):
    right = spin_chain.field(x, y, z, Jx=Jx, Jy=Jy, Jz=Jz, Bx=Bx, By=By, Bz=Bz, K=K, bond=2 * bond)
    both = spin_chain.field(x, y, z, Jx=Jx, Jy=Jy, Jz=Jz, Bx=Bx, By=By, Bz=Bz, K=K, bond=bond)
    return spin_chain.cross((x, y, z), tuple(r + b for r, b in zip(right, both, strict=True)))


MUTANTS = [
    ("spectral-point", transformed(TOP, point=forgotten_rho, vector=next_to_rho), 3),
    ("integrals-of-baecklund", transformed(TOP, step=old_momentum_transform), 3),
    *(("integrals-of-baecklund", frozen(system), n) for system in (TOP, MOVING, CLEBSCH, NEUMANN) for n in (3, 4)),
    *(("conjugate-pair", stretched(system), n) for system in (MOVING, CLEBSCH, NEUMANN) for n in (3, 4)),
    ("conjugate-pair", transformed(TOP, darboux=unscaled_darboux), 3),
    ("darboux", transformed(TOP, darboux=unscaled_darboux), 3),
    ("darboux", transformed(TOP, step=flipped_step), 3),
    ("poisson-baecklund", transformed(TOP, step=old_momentum_transform), 3),
    ("poisson-baecklund", transformed(TOP, vector=fixed_rho), 3),  # without the derivative of rho
    ("symmetric-baecklund", transformed(TOP, step=old_momentum_transform), 3),
    ("symmetric-baecklund", transformed(CLEBSCH, odd=1), 3),
    ("commuting-baecklund", transformed(TOP, step=old_momentum_transform), 3),
    ("map-is-baecklund", mapped(TOP, darboux=unshifted), 3),
    ("conjugate-pair", transformed(TOP, pair=lost_curvature), 3),
    ("order-baecklund", transformed(TOP, block=no_block), 4),
    ("order-baecklund", transformed(TOP, pair=lost_curvature), 3),
    ("hamiltonian-flow", replace(TOP, flow=doubled_flow), 3),
    ("hamiltonian-flow", replace(TOP, energy=lambda m, a, *, p, eps=0: pairing(m, m) / 2 - dot(a, p)), 3),
    ("hamiltonian-flow", wrong_space(TOP, tensor=MOVING.space.tensor), 3),
    ("jacobi-identity", wrong_space(TOP, tensor=lambda m, a: TOP.space.tensor(m, a) * mat(pairing(m, m))), 3),
    ("jacobi-identity", wrong_space(TOP, tensor=lambda m, a: TOP.space.tensor(m, a) ** 2), 3),
    ("casimirs", wrong_space(TOP, casimirs=lambda m, a: invariants.stack([dot(a, a), pairing(m, m)])), 3),
    ("integrals-of-the-flow", replace(TOP, integrals={"squares": lambda m, a: pairing(m, m)}), 3),
    ("integrals-of-the-flow", replace(TOP, flow=lambda m, a, *, p: (wedge(p, a), act(m, a))), 3),
    (
        "involution",
        replace(
            TOP,
            integrals={"noether": lambda m, a, *, p: algebra.coordinates(lagrange_top.noether(m, a, p=p))},
            commuting=("noether",),
        ),
        4,
    ),
    (
        "involution",
        replace(CLEBSCH, integrals={"spectrum": lambda M, P, *, b, eps=0: clebsch.spectrum(M, P, b=b * b, eps=eps)}),
        4,
    ),
    (
        "lax-equation",
        replace(
            TOP,
            lax=lambda m, a, *, p, lam: (lagrange_top.lax_matrix(m, a, p=p, lam=lam), border(0 * m, lam * a, -lam * a)),
        ),
        3,
    ),
    ("separable", replace(MOVING, inverse_inertia=lambda M, *, A, alpha: M), 3),
    ("separable", replace(TOP, flow=lambda m, a, *, p: (wedge(a, p) + m, act(m, a))), 3),
    ("separable", replace(TOP, inverse_inertia=lambda m: m * mat(pairing(m, m))), 3),
    ("separable", replace(TOP, spin=lambda m, a, *, alpha: m / alpha), 3),
    ("velocity", replace(TOP, velocity=lambda m, a, *, alpha: -m), 3),
    (
        "integrals-of-the-map",
        replace(
            TOP,
            integrals={
                "b": lambda m, a, *, p, eps=0: dot(printed_b(m, a, p=p, eps=eps), printed_b(m, a, p=p, eps=eps))
            },
        ),
        3,
    ),
    *(("integrals-of-the-map", mapped(TOP, step=step), 3) for step in STEPS),
    ("integrals-of-the-map", mapped(CLEBSCH, step=rough_kick), 3),
    ("continuous-limit", mapped(TOP, step=turned_backwards), 3),
    (
        "continuous-limit",
        replace(TOP, energy=lambda m, a, *, p, eps=0: lagrange_top.energy(m, a, p=p, eps=eps) + (eps != 0)),
        3,
    ),
    ("discrete-lax-equation", mapped(TOP, lax=printed_lax), 3),
    ("discrete-lax-equation", mapped(MOVING, conjugator=printed_conjugator), 3),
    ("discrete-lax-equation", mapped(CLEBSCH, lax=printed_pencil), 3),
    ("poisson", mapped(TOP, step=not_poisson), 3),
    ("poisson", mapped(TOP, step=euler_for_cayley), 3),
    ("inverse", mapped(TOP, inverse=lagrange_top.MAP.adjoint), 3),
    ("adjoint", mapped(TOP, symmetric=True), 3),
    ("reversing-involution", mapped(TOP, involution=lambda m, a: (-m, a)), 3),
    ("reversing-involution", mapped(TOP, involution=same), 3),
    ("symmetric-conjugate", mapped(TOP, to_symmetric=whole_kick), 3),
    ("symmetric-conjugate", mapped(TOP, to_symmetric=same), 3),
    ("reconstruction", mapped(TOP, generator=transposed_turn), 3),
    ("reconstruction", mapped(TOP, generator=isotropic_turn), 3),
    ("translation", replace(REVOLUTION, translation=lambda M, P, *, c1: vec(c1) * P), 3),
    ("translation", replace(CLEBSCH, translation=lambda M, P, *, b: b * P), 4),
    ("reconstruction", mapped(REVOLUTION, generator=without_spin), 3),
    ("continuous-limit", mapped(REVOLUTION, step=other_way_round), 4),
    ("order-baecklund", transformed(REVOLUTION, spin=without_rest), 3),
    ("integrals-of-baecklund", transformed(REVOLUTION, vector=at_another_point), 3),
    ("discrete-euler-lagrange", mapped(CLEBSCH, lagrangian=printed_lagrangian), 3),
    ("discrete-euler-lagrange", mapped(TOP, lagrangian=constant_alpha), 3),
    ("discrete-euler-lagrange", mapped(TOP, lagrangian=unnormalised), 3),
    ("relations", replace(TOP, relations=(replace(TOP.relations[0], map="step"),)), 3),
    (
        "relations",
        replace(
            NEUMANN,
            relations=(replace(NEUMANN.relations[0], carry=lambda x, q, g, *, b: ((wedge(q, x), x), {"b": b})),),
        ),
        3,
    ),
    ("integrals-of-the-map", mapped(EULER, step=euler_without_curvature), 3),
    ("poisson", mapped(EULER, step=euler_without_curvature), 3),
    ("discrete-lax-equation", mapped(EULER, step=euler_without_curvature), 4),
    ("continuous-limit", mapped(EULER, step=euler_other_branch), 4),
    ("integrals-of-the-map", mapped(EULER, step=euler_one_doubling_less), 4),
    ("discrete-euler-lagrange", mapped(EULER, lagrangian=lambda g, h, *, J, eps: pairing(g, h) / eps), 3),
    ("integrals-of-the-map", mapped(VESELOV, step=neumann.step), 3),  # Adler's
    ("discrete-euler-lagrange", mapped(VESELOV, lagrangian=neumann.lagrangian), 3),
    ("discrete-lax-equation", mapped(VESELOV, step=other_root), 4),
    ("continuous-limit", mapped(VESELOV, step=other_root), 3),
    ("adjoint", mapped(VESELOV, step=neumann.step), 3),
    ("integrals-of-the-map", mapped(ROSOCHATIUS, step=without_walls), 3),
    ("lax-equation", replace(ROSOCHATIUS, lax=without_turns), 3),
    ("integrals-of-the-map", mapped(BODY, step=force_forgotten), 3),
    ("commuting-maps", mapped(VESELOV, step=neumann.step), 3),
    ("commuting-maps", mapped(EULER, step=euler_without_curvature), 3),
    ("invariant-relations", replace(HESS, invariant={"hess": (hess_appelrot.hess, lambda M, P: 0 * P[..., 0])}), 3),
    ("invariant-relations", replace(HESS, invariant={"M_1": (lambda M, P: M[..., 2, 1], hess_appelrot.rate)}), 3),
    ("integrals-of-the-flow", wrong_space(GORYACHEV, draw=None), 3),  # off <M, P> = 0
    ("integrals-of-the-flow", replace(STEKLOV, integrals={"lyapunov": opposite}), 3),
    ("lax-equation", replace(STEKLOV, lax=lyapunov.lax), 3),
    ("lax-equation", replace(GYROSTAT, lax=wheel_turned_round), 3),
    ("hamiltonian-flow", replace(GYROSTAT, flow=wheel_at_rest), 3),
    ("integrals-of-the-flow", replace(GYROSTAT, energy=body_alone), 3),
    ("relations", replace(LYAPUNOV, derive=steklov.coefficients), 3),
    ("integrals-of-the-map", mapped(BITOP, step=cayley_turn), 4),
    ("discrete-lax-equation", mapped(BITOP, lax=lambda M, G, *, C, lam: lam * lam * C + lam * M + G), 4),
    ("poisson", mapped(BITOP, step=unturned), 4),
    *((law, mapped(FIELD, step=linear_force), 3) for law in ("integrals-of-the-map", "discrete-lax-pencil")),
    ("discrete-lax-pencil", mapped(FIELD, factors=unturned_blocks), 4),
    ("discrete-euler-lagrange", mapped(FIELD, lagrangian=other_potential), 3),
    ("involution", replace(FIELD, energy=lambda M, F, *, b: quadratic_field.energy(M, F, b=b)), 3),
    *((law, mapped(KOVALEVSKAYA, step=plain_kick), 3) for law in ("integrals-of-the-map", "inverse", "adjoint")),
    ("poisson", mapped(KOVALEVSKAYA, step=turned_alone), 3),
    ("integrals-of-the-map", mapped(KOVALEVSKAYA, step=turned_alone), 3),
    ("reconstruction", mapped(KOVALEVSKAYA, generator=without_own_turn), 3),
    ("involution", replace(KOVALEVSKAYA, energy=undeformed), 3),
    ("reversing-involution", mapped(KOVALEVSKAYA, involution=lambda M, P, *, eps: (-M, P)), 3),
    ("order", mapped(RATIU, step=blocks_at_rest), 4),
    ("integrals-of-the-map", mapped(RATIU, step=linear_pull), 5),
    ("discrete-lax-pencil", mapped(RATIU, step=blocks_at_rest), 4),
    ("involution", replace(RATIU, energy=of_flow), 4),
    *((law, mapped(SP4, step=double_weight), 3) for law in ("integrals-of-the-map", "discrete-lax-pencil", "inverse")),
    ("integrals-of-the-map", mapped(SP4, step=turned_alike), 3),
    *((law, mapped(LOGARITHMIC, step=other_logarithm), 3) for law in ("integrals-of-the-map", "discrete-lax-pencil")),
    ("integrals-of-the-map", mapped(LOGARITHMIC, step=symmetric_top.MAP.step), 4),
    ("integrals-of-the-map", mapped(ROTOR, step=rotor_forgotten), 4),
    ("discrete-lax-pencil", mapped(ROTOR, pencil=without_rotor), 3),
    ("discrete-lax-pencil", mapped(KOVALEVSKAYA, step=plain_kick), 3),
    ("reversing-involution", mapped(ROTOR, involution=plain_reversal), 3),
    ("integrals-of-the-map", replace(ROTOR, energy=without_rotor_energy), 3),
    ("integrals-of-the-map", mapped(TWO_FIELDS, step=fields_apart), 3),
    ("integrals-of-the-map", replace(TWO_FIELDS, integrals={"gram": rest_of_gram}), 3),
    ("relations", mapped(SU2, step=lost_half), 3),
    ("discrete-lax-equation", mapped(SU2, conjugator=lambda m, a, *, lam, eps: 1 + 2 * eps * lam * su2(a)), 3),
    ("lax-equation", replace(SU2, lax=lambda m, a, *, p, lam: (SU2.lax(m, a, p=p, lam=lam)[0], su2(2 * a))), 3),
    ("discrete-euler-lagrange", mapped(SU2, lagrangian=half_angle), 3),
    *(
        (law, mapped(LATTICE, step=even_bonds_backwards), 3)
        for law in ("integrals-of-the-map", "inverse", "continuous-limit")
    ),
    ("integrals-of-the-map", mapped(LATTICE, step=one_spin_of_two), 3),
    ("poisson", mapped(LATTICE, step=one_spin_of_two), 3),
    ("poisson", wrong_space(LATTICE, tensor=lambda *spins: LATTICE.space.tensor(*spins, D=0)), 3),
    ("hamiltonian-flow", replace(LATTICE, flow=without_anisotropy), 3),
    ("adjoint", mapped(LATTICE, symmetric=True), 3),
    ("involution", replace(LATTICE, energy=of_one_sublattice), 3),
    ("hamiltonian-flow", replace(CHAIN, flow=without_left_neighbours), 3),
    ("casimirs", wrong_space(CHAIN, casimirs=lambda x, y, z: x * x + y * y), 3),
    ("second-order-form", mapped(NEUMANN, second_order=without_curvature), 3),
    ("order", mapped(TOP, to_symmetric=same), 3),
    ("order", mapped(TOP, generator=lambda m, a, m1, a1, *, alpha, eps: eps / 2 * m1), 3),
]


def test_every_law_has_a_mutant() -> None:
    assert {law for law, _, _ in MUTANTS} == set(laws.LAWS)


@pytest.mark.parametrize(("law", "mutant", "n"), MUTANTS, ids=[f"{law}-{i}" for i, (law, _, _) in enumerate(MUTANTS)])
@pytest.mark.parametrize("numbers", ["exact", "float"])
def test_mutant_is_caught(law: str, mutant: System, n: int, numbers: str) -> None:
    stated = laws.LAWS[law]
    if numbers not in stated.numbers(mutant):
        numbers = "float"
    verdict = laws.test(stated, laws.make_case(mutant, n, numbers, 1))
    assert not verdict.holds


@pytest.mark.parametrize(("law", "mutant", "n"), MUTANTS, ids=[f"{law}-{i}" for i, (law, _, _) in enumerate(MUTANTS)])
def test_the_record_itself_passes_there(law: str, mutant: System, n: int) -> None:
    from kreisel.system import find

    numbers = laws.LAWS[law].numbers(find(mutant.name))[0]
    assert laws.test(laws.LAWS[law], laws.make_case(find(mutant.name), n, numbers, 1)).holds
