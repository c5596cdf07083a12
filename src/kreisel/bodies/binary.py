"""Two rigid bodies that attract each other, in SI units, with a third body or without.

State: r from body 1 to body 2 and r' = v; the angular momentum L and the attitude q (body to space) of each; with a
third body its position R, in units of 2^23 m, and velocity V relative to the barycentre of the two, and L and q unless
it is a point.  All vectors are in space.

    H = m v^2/2 - mu m/|r| + sum L.Omega/2 + V_12                m = m1 m2/(m1 + m2),  mu = G (m1 + m2)
    m v' = -mu m r/|r|^3 - dV/dr,  L' = torque of V,  q' = Omega q/2,  Omega = Q I^-1 Q^T L

V_12 has all terms of the expansion in (size/distance) up to the fourth degree.  With n = r/|r|, the trace-free second
moments D = tr I/3 - I over the mass, w1 = Q1^T n and w2 = -Q2^T n,

    V_12 = - mu m (3/2) (n.D1 n + n.D2 n)/|r|^3 - mu m sum over l = 3, 4 of (Y_l(w1)/m1 + Y_l(w2)/m2)/|r|^(l+1)
           - mu m (105/4 (n.D1 n)(n.D2 n) - 15 (D1 n).(D2 n) + 3/2 tr D1 D2)/|r|^5
           - G (m2^2 tide1 + m1^2 tide2)/(2 |r|^6)               tide = k_2 R^5

with Y_l of `kreisel.bodies.satellite`.  The masses of the third body and of these act on each other exactly, and on
the D of all.  Tides lag by a constant time: the force on body 2 by the bulge of body 1, and -r x it on the spin of body
1, is [Hut 1981]

    F = -3 G m2^2 tide1 lag1/|r|^8 (3 v_r + v_t - Omega1 x r)    v_r, v_t: along and across r

The free motion, two points on a conic section and two free bodies, has a closed form (`kreisel.exact.kepler`,
`rotor_step`).  [Maciejewski, Celest. Mech. Dyn. Astron. 63 (1995) 1; Ashenberg, ibid. 99 (2007) 149]
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial, reduce

import numpy as np

from kreisel.algebra import (
    act,
    cross,
    dot,
    hat,
    identity,
    mat,
    maximum,
    quaternion,
    quaternion_product,
    rotation_matrix,
    sqrt,
    vec,
)
from kreisel.algebra.invariants import blocks
from kreisel.bodies.orbit import check_not_negative, check_positive
from kreisel.bodies.satellite import check_moments, harmonics_3, harmonics_4
from kreisel.exact import kepler, rotor_step
from kreisel.forces.product import block_diagonal
from kreisel.forces.records import perturbed_record
from kreisel.record.contract import ClosedForm, Parameter, PhaseSpace, System
from kreisel.record.perturbation import Force, Perturbation
from kreisel.record.units import BodyFrame

FAR = 2.0**23  # m, the unit of R: R and V are then alike in size
G = 6.67430e-11  # m^3/(kg s^2), CODATA 2022
PAIR = tuple((k, "quaternion" if k[0] == "q" else "vector") for k in ("r", "v", "L1", "q1", "L2", "q2"))
POINT = (("R", "vector"), ("V", "vector"))
ROTATING = (("L3", "vector"), ("q3", "quaternion"))
ROTOR = ("inverse", "rates", "curvatures")  # of `rotor_step.constants`, one after the other

# -- free motion -----------------------------------------------------------------------------------


def spin(L, q, rotor):
    """Omega in space."""
    Q = rotation_matrix(q)
    return act(Q, rotor[..., :3] * act(Q.mT, L))


def _turning(omega, q):
    """q' = Omega q/2."""
    return quaternion_product(quaternion(0 * omega[..., 0], omega / 2), q)


def _falling(r, mu):
    square = dot(r, r)
    return vec(-mu / (square * sqrt(square))) * r


def flow(r, v, L1, q1, L2, q2, *third, mu, rotor1, rotor2, mu3=None, rotor3=None):
    def rotating(L, q, rotor):
        return 0 * L, _turning(spin(L, q, rotor), q)

    pair = v, _falling(r, mu), *rotating(L1, q1, rotor1), *rotating(L2, q2, rotor2)
    if not third:
        return pair
    R, V, *rotation = third
    return (*pair, V / FAR, _falling(FAR * R, mu3), *(rotating(rotation[0], rotation[1], rotor3) if rotation else ()))


def energy(r, v, L1, q1, L2, q2, *third, mu, reduced, rotor1, rotor2, mu3=None, reduced3=None, rotor3=None):
    spins = dot(L1, spin(L1, q1, rotor1)) + dot(L2, spin(L2, q2, rotor2))
    total = spins / 2 + _energy_of_orbit(r, v, mu, reduced)
    if third:
        R, V, *rotation = third
        total = total + _energy_of_orbit(FAR * R, V, mu3, reduced3)
        total = total + dot(rotation[0], spin(rotation[0], rotation[1], rotor3)) / 2 if rotation else total
    return total


def _energy_of_orbit(r, v, mu, reduced):
    return reduced * (dot(v, v) / 2 - mu / sqrt(dot(r, r)))


def angular_momentum(r, v, L1, q1, L2, q2, *third, reduced, reduced3=None):
    total = vec(reduced) * cross(r, v) + L1 + L2
    if third:
        R, V, *rotation = third
        total = total + vec(reduced3) * cross(FAR * R, V)
        total = total + rotation[0] if rotation else total
    return total


def step(r, v, L1, q1, L2, q2, *third, h, mu, rotor1, rotor2, mu3=None, rotor3=None):
    """The free motion for the time h."""
    pair = *kepler.step(r, v, mu=mu, h=h), L1, _rotated(L1, q1, h, rotor1), L2, _rotated(L2, q2, h, rotor2)
    if not third:
        return pair
    R, V, *rotation = third
    R, V = kepler.step(FAR * R, V, mu=mu3, h=h)
    return (*pair, R / FAR, V, *((rotation[0], _rotated(rotation[0], rotation[1], h, rotor3)) if rotation else ()))


def _rotated(L, q, h, rotor):
    return rotor_step.step(act(rotation_matrix(q).mT, L), q, h=h, **_rotor(rotor))[1]


def _rotor(rotor):
    return {name: rotor[..., 3 * i : 3 * i + 3] for i, name in enumerate(ROTOR)}


def reach(r, v, L1, q1, L2, q2, *third, h, rotor1, rotor2, rotor3=None):
    """A measure of the length of that step, as in `rotor_step`."""
    rotors = [(L1, q1, rotor1), (L2, q2, rotor2)] + ([(*third[2:], rotor3)] if third[2:] else [])
    return reduce(maximum, [rotor_step.reach(act(rotation_matrix(q).mT, L), h, **_rotor(c)) for L, q, c in rotors])


# -- interaction -----------------------------------------------------------------------------------


def potential(
    r, q1, q2, *, m1, m2, D1, D2, degree_3_1, degree_3_2, degree_4_1, degree_4_2, tide1, tide2
):  # fmt: skip
    Q1, Q2, square = rotation_matrix(q1), rotation_matrix(q2), r @ r
    distance = sqrt(square)
    n = r / distance
    C, w1, w2 = Q1.T @ Q2, n @ Q1, -(n @ Q2)
    A1, A2 = D1 * w1, D2 * w2
    a1, a2 = A1 @ w1, A2 @ w2
    mixed = 26.25 * a1 * a2 + 15 * (A1 @ C @ A2) + 1.5 * (D1 @ (C * C) @ D2)
    third = degree_3_1 @ harmonics_3(w1) / m1 + degree_3_2 @ harmonics_3(w2) / m2
    fourth = degree_4_1 @ harmonics_4(w1) / m1 + degree_4_2 @ harmonics_4(w2) / m2 + mixed
    raised = (m2 * tide1 / m1 + m1 * tide2 / m2) / 2
    higher = (third + (fourth + raised / distance) / distance) / distance
    return -G * m1 * m2 * (1.5 * (a1 + a2) + higher) / (square * distance)


def potential_of_three(r, q1, q2, R, q3=None, *, m1, m2, m3, D1, D2, D3=None, **constants):
    R = FAR * R
    mass, square = m1 + m2, R @ R
    distance = sqrt(square)
    inner = m1 * m2 / mass * (r @ r) / (2 * square)  # the linear terms of both masses cancel
    V = inner
    for m, x, q, D in ((m1, -m2 / mass * r, q1, D1), (m2, m1 / mass * r, q2, D2)):
        away = R - x
        ratio = (x @ x - 2 * (R @ x)) / square
        root = sqrt(1 + ratio)
        w = away @ rotation_matrix(q)
        V = V - m * ratio * ratio * (root + 2) / (2 * root * (1 + root) * (1 + root))
        w3 = None if q3 is None else away @ rotation_matrix(q3)
        moments = D @ (w * w) + (0 if w3 is None else D3 @ (w3 * w3))
        V = V - m * 1.5 * moments / (square * square * root**5)
    return potential(r, q1, q2, m1=m1, m2=m2, D1=D1, D2=D2, **constants) + G * m3 * V / distance


def friction(r, v, L1, q1, L2, q2, *third, m1, m2, reduced, rotor1, rotor2, tide1, tide2, lag1, lag2):
    """The rates of the state by the lag of tides, and of the work."""
    square = dot(r, r)
    along, total, rates, power = vec(2 * dot(r, v) / square) * r, 0 * v, [], 0
    for L, q, rotor, strength in ((L1, q1, rotor1, m2 * m2 * tide1 * lag1), (L2, q2, rotor2, m1 * m1 * tide2 * lag2)):
        slip = v - cross(spin(L, q, rotor), r)
        force = vec(-3 * G * strength / (square * square * square * square)) * (slip + along)
        total, power = total + force, power + dot(force, slip)
        rates += [-cross(r, force), 0 * q]
    return (0 * r, total / vec(reduced), *rates, *(0 * x for x in third)), power


# -- records ---------------------------------------------------------------------------------------


def tensor(r, v, L1, q1, L2, q2, *third, reduced, reduced3=None):
    """{x_i, x_j} of coordinates: {v, r} = 1/m, {L, q} = (dq/dt of a unit rotation)^T, {L, L} = hat(L)."""
    blocks = [_canonical(r, reduced), _of_rotor(L1, q1), _of_rotor(L2, q2)]
    blocks += [_canonical(third[0], FAR * reduced3)] if third else []
    blocks += [_of_rotor(*third[2:])] if third[2:] else []
    return block_diagonal(blocks)


def _canonical(r, mass):
    unit = identity(3) / mat(mass) + 0 * vec(r)
    return blocks([[0 * unit, -unit], [unit, 0 * unit]])


def _of_rotor(L, q):
    turning = np.stack([_turning(identity(3)[i] + 0 * L, q) for i in range(3)], -2)  # (3, 4)
    none = 0 * turning.mT @ turning
    return blocks([[hat(L), turning], [-turning.mT, none]])


def draw(third, n, numbers):
    """A random state with unit quaternions, rational if the values are."""

    def attitude():
        q = numbers((4,))
        return quaternion_product(q, q) / (q @ q)

    def vectors(count):
        return [numbers((n,)) for _ in range(count)]

    pair = (*vectors(3), attitude(), *vectors(1), attitude())
    return (*pair, *vectors(min(third, 2)), *((*vectors(1), attitude()) if third > 2 else ()))


def derive(*, m1, m2, moments1, moments2, m3=None, moments3=None):
    mass = m1 + m2
    out = {"mu": G * mass, "reduced": m1 * m2 / mass}
    for i, m, moments in ((1, m1, moments1), (2, m2, moments2), (3, m3, moments3)):
        if moments is None:
            continue
        rotor = rotor_step.constants(moments)
        out[f"rotor{i}"] = np.concatenate([rotor[name] for name in ROTOR], -1)
        out[f"D{i}"] = (moments.sum(-1, keepdims=True) / 3 - moments) / vec(m)
    return out if m3 is None else out | {"mu3": G * (mass + m3), "reduced3": m3 * mass / (mass + m3)}


def _of_body(i):
    return (
        Parameter(f"m{i}", "scalar", f"mass of body {i}, kg", check_positive),
        Parameter(f"moments{i}", "vector", "its principal moments of inertia, kg m^2", check_moments, diagonal=True),
        Parameter(f"degree_3_{i}", "R^7", "mass times R^3 (C_30, C_31, S_31, ...), kg m^3", default=np.zeros(7)),
        Parameter(f"degree_4_{i}", "R^9", "mass times R^4 (C_40, C_41, S_41, ...), kg m^4", default=np.zeros(9)),
        Parameter(f"tide{i}", "scalar", "k_2 R^5 of its tides, m^5", check_not_negative, 0.0),
        Parameter(f"lag{i}", "scalar", "time by which its tides lag, s", check_not_negative, 0.0),
    )


AXES = {"mu": 0, "reduced": 0, "rotor1": 1, "rotor2": 1, "D1": 1, "D2": 1}
OF_THIRD = {"mu3": 0, "reduced3": 0, "rotor3": 1, "D3": 1}
LOADED = ("m1", "m2", "D1", "D2", "degree_3_1", "degree_3_2", "degree_4_1", "degree_4_2", "tide1", "tide2")


def body_frame():
    units = {"r": "m", "v": "m/s", "R": "m", "V": "m/s", "time": "s"}
    units |= dict.fromkeys(("L1", "L2", "L3"), "kg m^2/s")
    sizes = {"R": FAR}
    units |= {"energy": "J", "work": "J", "balance": "J", "angular_momentum": "kg m^2/s"}
    return BodyFrame(units={name: (unit, sizes.get(name, 1.0)) for name, unit in units.items()})


def body(name, title, third=()):
    space = PhaseSpace(
        name=f"{name} phase space",
        components=PAIR + third,
        tensor=tensor,
        casimirs=None,  # q.q: 1 after each step, whatever it was, so not to be projected
        sign=-1,
        carried=(),
        draw=partial(draw, len(third)),
        unlike=True,
    )
    parameters = (*_of_body(1), *_of_body(2))
    parameters += (Parameter("m3", "scalar", "mass of the third body, kg", check_positive),) if third else ()
    parameters += (replace(parameters[1], letter="moments3"),) if len(third) > 2 else ()
    stated = {
        "title": title,
        "equations": "r'' = -mu r/|r|^3 - dV/dr/m,  L' = torque of V,  q' = Omega q/2",
        "source": "Maciejewski 1995",
        "space": space,
        "parameters": parameters,
        "derive": derive,
        "n": 3,
        "numbers": "real",
    }
    base = System(
        name=f"free-{name}",
        flow=flow,
        energy=energy,
        integrals={"angular_momentum": angular_momentum},
        closed_form=ClosedForm(step=step, reach=reach),
        **stated,
    )
    force = Force(
        potential_of_three if third else potential,
        ("r", "q1", "q2", *(letter for letter, _ in third if letter in ("R", "q3"))),
        (*LOADED, *("m3", "D3")[: len(third) // 2]),
    )
    axes = AXES | (OF_THIRD if third else {}) | {p.letter: p.axes for p in parameters}
    record = Perturbation(base=base, potential=force, friction=friction, rubbing=("lag1", "lag2"))
    integrals = base.integrals
    return perturbed_record(
        record, axes, name=name, integrals=integrals, body_frame=body_frame, scaling="SI units.", **stated
    )


BODIES = (
    body("binary", "Two rigid bodies"),
    body("binary-with-third-body", "Two rigid bodies and a point mass", POINT),
    body("binary-with-moon", "Two rigid bodies and a moon", POINT + ROTATING),
)
