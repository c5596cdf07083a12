"""A rigid body deep in a fluid, with any mass matrix, in SI units: weight, buoyancy, linear and quadratic drag.

With the velocity U of a point O of the body, its angular velocity Omega and the symmetric 6 x 6 matrix of mass and
added mass about O, in axes of the body, the kinetic energy and the momenta are

    T = nu.mass_matrix nu/2,   nu = (U, Omega),   (P, M) = mass_matrix nu

and T = (M.AM + 2 M.KP + P.DP)/2 with its inverse.  At the point O + shift K is symmetric, (tr A - A) shift = -c with c
the axial vector of K - K^T at O; the state is there, along the principal axes of A, the columns of `turn`, which are
as near the axes of the body as can be.  Then

    M' = M x Omega + P x U + (torque of V) + drag,    P' = P x Omega + F + drag,     Omega = dH/dM,  U = dH/dP
    V = weight height(center_of_mass) - buoyancy height(center_of_buoyancy),  both from O + shift
    F = (buoyancy - weight) g^T e_3;    drag at O, of each part of nu: -(linear_drag + quadratic_drag |nu_i|) nu_i

Space has its third axis up and moves with the fluid, whose velocity is uniform.  The part of V that depends on the
depth is counted as work, U.F.  [Lamb, Hydrodynamics, 6th ed., chapter 6; Fossen, Handbook of Marine Craft, 2011]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import act, axial, cross, hat, identity, mat, principal_axes, solve, sqrt, vec
from kreisel.algebra.invariants import trace
from kreisel.bodies.orbit import expected
from kreisel.errors import InputError
from kreisel.forces.records import perturbed_record
from kreisel.record.contract import Parameter
from kreisel.record.perturbation import Force, Perturbation
from kreisel.record.units import BodyFrame
from kreisel.system import kirchhoff

TINY = 1e-300  # so that |0| has a derivative
SYMMETRIC = 1e-9
OTHER = np.array([[0, 2, 1], [2, 1, 0], [1, 0, 2]])  # the axis of the plane (j, k)


def potential(g, *, lever):
    return g[2] @ lever


def wrench(M, P, *, inverse, coupling, D, turn, shift, linear_drag, quadratic_drag):
    """The drag at O as a force and a torque along the body axes."""
    Omega = turn @ (inverse * M + coupling @ P)
    U = turn @ (D @ P + coupling @ M) - cross(Omega, shift)
    nu = [*U, *Omega]
    drag = [-(linear_drag[i] + quadratic_drag[i] * sqrt(v * v + TINY)) * v for i, v in enumerate(nu)]
    return np.array(drag[:3]), np.array(drag[3:])


def force(M, P, g, *, weight, buoyancy, turn, **constants):
    F, _ = wrench(M, P, turn=turn, **constants)
    return (buoyancy - weight) * g[2] + F @ turn


def torque(M, P, *, turn, shift, **constants):
    F, tau = wrench(M, P, turn=turn, shift=shift, **constants)
    return (tau - cross(shift, F)) @ turn


def derive(*, mass_matrix, weight, buoyancy, center_of_mass, center_of_buoyancy):
    """C, B and the coupling of `kirchhoff` at the place of the state; the place and the axes of the state."""
    inverse = solve(mass_matrix, identity(6))
    D, K, A = inverse[..., :3, :3], inverse[..., 3:, :3], inverse[..., 3:, 3:]
    shift = -act(solve(mat(trace(A)) * identity(3) - A, identity(3)), axial(K - K.mT))
    S = hat(shift)
    D, K = D + S.mT @ A @ S + S.mT @ K + K.mT @ S, K + A @ S
    A = (A + A.mT) / 2
    if A.ndim == 2:
        rates, turn = principal_axes(A)
    else:
        frames = [principal_axes(a) for a in A.reshape(-1, 3, 3)]
        rates, turn = (np.stack(parts).reshape(*A.shape[:-2], *parts[0].shape) for parts in zip(*frames, strict=True))
    D, K = (turn.mT @ (X + X.mT) @ turn / 2 for X in (D, K))
    lever = vec(weight) * (center_of_mass - shift) - vec(buoyancy) * (center_of_buoyancy - shift)
    planes = (1 - identity(3)) * rates[..., OTHER]
    return {"C": planes, "B": -D, "D": D, "coupling": K, "inverse": rates, "turn": turn, "shift": shift} | {
        "lever": act(turn.mT, lever)
    }


def body_frame(*, turn):
    """SI units; the mass matrix is given in any axes of the body."""
    units = {"time": "s", "M": "kg m^2/s", "P": "kg m/s", "energy": "J", "work": "J", "balance": "J"}
    first = turn.reshape(-1, 3, 3)[0]
    return BodyFrame(
        turn if (turn != first).any() else first, {name: (unit, 1.0) for name, unit in units.items()}, ("M", "P")
    )


def check_mass_matrix(value, name):
    if value.shape != (6, 6):
        raise InputError(f"{name}: expected a 6 x 6 matrix, of (U, Omega), got the shape {value.shape}.")
    if not abs(value - value.T).max() <= SYMMETRIC * abs(value).max():
        raise InputError(
            f"{name}: expected a symmetric matrix, got entries that differ by {abs(value - value.T).max():.3g}. "
            "Usual cause: added masses of different units, or of another order than (U, Omega)."
        )
    least = np.linalg.eigvalsh((value + value.T) / 2)[0]
    if not least > 0:
        raise InputError(
            f"{name}: expected a positive matrix, got the least eigenvalue {least:.3g}. Usual cause: an inertia about "
            "another point than the centre of mass, or added masses without the body's."
        )


check_drag = expected(lambda x: x.shape == (6,) and (x >= 0).all(), "6 values >= 0, of U and of Omega")
check_force = expected(lambda x: x >= 0, "a force >= 0")
PARAMETERS = (
    Parameter("mass_matrix", "array", "of mass and added mass about O, of (U, Omega), SI", check_mass_matrix, rank=2),
    Parameter("weight", "scalar", "N", check_force, 0.0),
    Parameter("buoyancy", "scalar", "weight of the fluid displaced, N", check_force, 0.0),
    Parameter("center_of_mass", "vector", "from O, m", default=np.zeros(3)),
    Parameter("center_of_buoyancy", "vector", "from O, m", default=np.zeros(3)),
    Parameter("current", "vector", "of the fluid in space, m/s: the motion is relative to it", default=np.zeros(3)),
    Parameter("linear_drag", "array", "N s/m three times, N m s three times", check_drag, np.zeros(6), rank=1),
    Parameter("quadratic_drag", "array", "N s^2/m^2 three times, N m s^2 three times", check_drag, np.zeros(6), rank=1),
)
MATRICES = ("inverse", "coupling", "D", "turn", "shift", "linear_drag", "quadratic_drag")
AXES = {"C": 2, "B": 2, "D": 2, "coupling": 2, "inverse": 1, "turn": 2, "shift": 1, "lever": 1}
OF_PARAMETERS = {p.letter: {"mass_matrix": 2, "weight": 0, "buoyancy": 0}.get(p.letter, 1) for p in PARAMETERS}

BODIES = (
    perturbed_record(
        Perturbation(
            base=kirchhoff.SYSTEM,
            potential=Force(potential, ("g",), ("lever",)),
            torque=Force(torque, ("M", "P"), MATRICES),
            force=Force(force, ("M", "P", "g"), ("weight", "buoyancy", *MATRICES)),
            coupling=True,
        ),
        AXES | OF_PARAMETERS,
        name="submerged-body",
        title="Body deep in a fluid, with any mass matrix",
        equations="M' = M x Omega + P x U - dV/dg + drag,  P' = P x Omega + F + drag",
        source="Lamb 1932, chapter 6",
        space=replace(kirchhoff.SYSTEM.space, casimirs=None),
        parameters=PARAMETERS,
        integrals={},
        derive=derive,
        body_frame=body_frame,
        scaling="SI units.",
        n=3,
    ),
)
