"""Rubanovskii's gyrostat: Steklov's and Lyapunov's cases with a rotor, n = 3.  State (M, P), body frame, both skew.

With m, p, the vectors of M and P, h the momentum of the rotor, and H_S, H_L of `steklov_lyapunov`,

    H = s [H_S + <h, tr(B) p + m_0>] + l [H_L + <h, p>],   m_0 = m - (tr(B) - B) p/2.

The Lax pair is the pair L, U_0 of `steklov_lyapunov` with (lambda - B)^-1 h added to the vector of X:

    L = hat(x) C,   U = U_0 + lambda (s lambda + l) hat(C h) C,   x = m_0 + lambda p + C h,   C = (lambda - B)^-1.

Plus bracket, F' = {H, F}.  [Rubanovskii 1988.  The Lax pair was derived here]
"""

from dataclasses import replace

from kreisel.algebra import bracket, hat, mat, pairing, vec
from kreisel.algebra.invariants import diagonal, stack, trace
from kreisel.record.contract import Parameter, named
from kreisel.system import steklov_lyapunov


def constants(*, b, s, l, h):
    """The coefficients of `steklov_lyapunov`, and dH/dM, dH/dP by the rotor."""
    rotor, total = hat(h), b.sum(-1, keepdims=True)[..., None]
    force = (mat(s) * (total - steklov_lyapunov.halves(b)) + mat(l)) * rotor
    return steklov_lyapunov.constants(b=b, s=s, l=l) | {"spun": mat(s) * rotor, "pushed": force}


def velocity(M, P, *, x, y, spun):  # Omega = dH/dM
    return x * M + y * P + spun


def flow(M, P, *, x, y, z, spun, pushed):  # M' = [M, Omega] + [P, dH/dP],   P' = [P, Omega]
    Omega = velocity(M, P, x=x, y=y, spun=spun)
    return bracket(M, Omega) + bracket(P, y * M + z * P + pushed), bracket(P, Omega)


def energy(M, P, *, x, y, z, spun, pushed):
    return steklov_lyapunov.energy(M, P, x=x, y=y, z=z) + pairing(M, spun) + pairing(P, pushed)


def pencil(M, P, b, h, lam):  # hat(x)
    return steklov_lyapunov.pencil(M, P, b, mat(lam)) + hat(h / (vec(lam) - b))


def traces(M, P, *, b, h, beyond):
    """Tr L^2 at 3 values of lambda beyond the sum of all |b|."""
    out = []
    for j in range(3):
        lam = beyond + (j + 1)
        L = pencil(M, P, b, h, lam) / (vec(lam) - b)[..., None, :]
        out.append(trace(L @ L))
    return stack(out)


def lax(M, P, *, b, s, l, h, x, y, lam):
    C, (_, U) = diagonal(1 / (lam - b)), steklov_lyapunov.lax(M, P, b=b, s=s, l=l, x=x, y=y, lam=lam)
    return pencil(M, P, b, h, lam) @ C, U + lam * (mat(s) * lam + mat(l)) * hat(h / (lam - b)) @ C


SYSTEM = replace(
    steklov_lyapunov.SYSTEM,
    name="rubanovskii",
    title="Rubanovskii's gyrostat in a fluid",
    source="Rubanovskii 1988",
    parameters=(
        Parameter("b", "vector", "diagonal of B", diagonal=True),
        Parameter("h", "vector", "the momentum of the rotor"),
        Parameter("s", "scalar", "how much of Steklov's H", None, 0.0),
        Parameter("l", "scalar", "how much of Lyapunov's H", None, 1.0),
    ),
    **named(flow, energy, velocity, lax),
    derive=constants,
    integrals={"traces": traces},
    pairs=steklov_lyapunov.RUBANOVSKII,
    n=3,
    notes="No explicit map is known; method='exact'.",
)
