"""Neumann's system, a particle on the sphere in a quadratic potential, and its discretization.

State (x, q): x (..., n) with |x| = 1, q (..., n) with <x, q> = 0, in the frame that rotates with the body of
which it is the smallest leaf: M = x ^ q, P = x in `clebsch`.  The potential energy is -<x, Bx>/2, B = diag(b).
Dirac bracket of T*S^(n-1), F' = {H, F}.  [Suris 2001, section 7, end; dimension 2(n-1) and the sign of the
potential by errata E6 and E7; the map is Adler's]
"""

from kreisel.algebra import dot, log, mat, vec, wedge
from kreisel.algebra.invariants import plane_spectrum
from kreisel.baecklund.clebsch import NEUMANN, on_sphere, shifted_diagonal
from kreisel.record.contract import Map, Parameter, Relation, System, named, pullback
from kreisel.record.spheres import SPHERE_SPACE
from kreisel.system import clebsch


def flow(x, q, *, b):  # x' = q,   q' = Bx - (<x, Bx> + |q|^2) x; divided by |x|^2 = 1 it stays tangential in floats
    return q, b * x - vec((dot(x, b * x) + dot(q, q)) / dot(x, x)) * x


def kick(x, q, h, *, b, eps):
    """The tangential part of q + h Bx / den."""
    q = q + vec(h / clebsch.denominator(x, b=b, eps=eps)) * (b * x)
    return q - vec(dot(x, q) / dot(x, x)) * x


def turn(x, q, eps):
    """cay(-(eps/2) x ^ q) on both: a great circle, <x, q> = 0."""
    xx, qq = dot(x, x), dot(q, q)
    product = eps / 2 * xx * qq
    s = vec(eps / (1 + eps / 2 * product))
    return x + s * (vec(xx) * q - vec(product) * x), q - s * (vec(qq) * x + vec(product) * q)


def step(x, q, *, b, eps):
    return turn(x, kick(x, q, eps, b=b, eps=eps), eps)


def inverse(x, q, *, b, eps):
    x, q = turn(x, q, -eps)
    return x, kick(x, q, -eps, b=b, eps=eps)


def involution(x, q, *, b, eps):
    return x, -kick(x, q, eps, b=b, eps=eps)


def half_kick(x, q, *, b, eps):
    return x, kick(x, q, eps / 2, b=b, eps=eps)


def second_order(x0, x, *, b, eps):
    """x_(k+1) from x_(k-1), x_k.

    x_(k+1)/(1+<x_k,x_(k+1)>) + x_(k-1)/(1+<x_k,x_(k-1)>) = (eps^2/2) B x_k/den + mu x_k.
    """
    z = vec(eps * eps / 2 / clebsch.denominator(x, b=b, eps=eps)) * (b * x) - x0 / vec(1 + dot(x, x0))
    zx = dot(z, x)
    y = z + vec(((1 - zx) * (1 - zx) - dot(z, z)) / 2) * x
    return y / vec(1 - dot(x, y))


def energy(x, q, *, b, eps=0):
    xBx, qq = dot(x, b * x), dot(q, q)
    return qq / 2 - xBx / 2 + eps * dot(x, b * q) / 2 + eps * eps * qq * xBx / 8


def spectrum(x, q, *, b, eps=0):
    xx, along = dot(x, x), eps * dot(x, q)  # x + eps/2 (x ^ q) x = (1 + eps/2 <x, q>) x - eps/2 |x|^2 q
    return plane_spectrum(x, q, b, 1 + along / 2, -eps * xx / 2, eps * eps * xx / 4)


def to_clebsch(x, q, g, *, b):
    return (wedge(x, q), x), {"b": b}


of_clebsch = pullback(clebsch.SYSTEM, to_clebsch)
lax = of_clebsch(clebsch.lax)


def generator(x, q, x1, q1):  # (eps/2) M_(k+1) = x_k ^ x_(k+1) / (1 + <x_k, x_(k+1)>)
    return wedge(x, x1) / mat(1 + dot(x, x1))


def lagrangian(x, x1, p, *, b, eps):
    return 2 / eps * (log(clebsch.denominator(x, b=b, eps=eps)) - log(1 + dot(x, x1)))


SYSTEM = System(
    name="neumann",
    title="Neumann's particle on the sphere",
    equations="x' = q,  q' = Bx - (<x, Bx> + |q|^2) x",
    source="Suris 2001, section 7, end",
    space=SPHERE_SPACE,
    parameters=(Parameter("b", "vector", "diagonal of B: the potential energy is -<x, Bx>/2", diagonal=True),),
    **named(flow, energy),
    inverse_inertia=lambda M: M,
    scaling="The mass and the radius of the sphere are 1.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    lax=lax,
    map=Map(
        **named(step, inverse, involution, generator, lagrangian, second_order),
        largest_step=lambda x, q, *, b: clebsch.largest_step(q, x, b=b),
        conjugator=of_clebsch(clebsch.conjugator),
        to_symmetric=half_kick,
        lax=of_clebsch(clebsch.lax_matrix),
        source="Suris 2001, section 7, end (Adler's discretization)",
    ),
    baecklund=NEUMANN,
    derive=shifted_diagonal,
    relations=(Relation("clebsch", to_clebsch, "step", "M = x ^ q, P = x", back=on_sphere),),
    notes="On the sphere the spectrum has rank n - 1, which is complete.",
)
