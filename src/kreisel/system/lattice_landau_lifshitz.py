"""Lattice Landau-Lifshitz model with one axis, and its discrete time.  Unit spins S_i, T_i, i = 1...n, on a ring.

The 2n sites are in the order S_1, T_1, S_2, T_2, ...; Sx, Sy, ..., Tz are (..., n).  With W = (1 + D z^2)^(1/2) of a
spin N = (x, y, z) the bracket is {x, y} = -W z and cyclic.  The angle about z and z~, sinh(h z~) = z sinh h with
D = sinh(h)^2, are canonical up to a factor.  D > 0: easy axis; -1 < D < 0: easy plane; D = 0: isotropic.

    H = -2 sum log(<N_j, N_(j+1)>/2),   <N, N'> = W W' + x x' + y y' + (1 + D) z z'.

The Lax matrix q(u; N) = (sin u/s) W + x I + y J + cos u z K, s = sinh h, is a quaternion with |q|^2 = 1 + (sin u/s)^2;
the monodromy is their product in order.  A step has gates (S_i, T_i), then (T_i, S_(i+1)).  A gate is N, N' -> A, B,

    q(u + t; N) q(u - t; N') = q(u - t; A) q(u + t; B),   tan t = eps s:

B = unit(N boosted by N'), A = unit(N' boosted by N), where the null vector p = (W, x, y, (1 + D)^(1/2) z) goes to
m* p m, m the Lax matrix of the other one at the zero of det q.  For D = 0 both spins rotate about N + N'.
[Krajnik, Ilievski, Prosen, Pasquier 2021; Krajnik, Prosen 2020; Sklyanin 1982; Faddeev, Takhtajan 1987]
"""

import numpy as np

from kreisel.algebra import log, sqrt, vec
from kreisel.algebra.invariants import cross, inner, shifted, stack
from kreisel.errors import InputError
from kreisel.record.contract import Map, Parameter, System, named
from kreisel.record.spheres import LATTICE_SPACE

MOST_VALUES = 8  # of the spectral parameter


def height(N, D):  # W
    return sqrt(1 + vec(D) * N[2] * N[2])


def angles(D, eps):  # cos 2t, sin 2t/s
    below = 1 / (1 + D * eps * eps)
    return (1 - D * eps * eps) * below, 2 * eps * below


def null(N, D):  # p
    return height(N, D), (N[0], N[1], sqrt(1 + vec(D)) * N[2])


def boosted(p, N, D, eps):
    """m* p m, m = a + (u + i v).sigma the Lax matrix of N at an angle 2t from the zero of its determinant."""
    p0, p = p
    C, S = (vec(x) for x in angles(D, eps))
    c, W = sqrt(1 + vec(D)), height(N, D)
    a, b = W * C, -W * c * S  # real and imaginary part
    u, v = (N[0], N[1], c * C * N[2]), -vec(D) * S * N[2]
    re = (a * u[0], a * u[1], a * u[2] + b * v)  # of conj(m_0) times (u + i v)
    im = (-b * u[0], -b * u[1], a * v - b * u[2])
    uv = (u[1] * v, -u[0] * v)  # u x v
    aa, bb = a * a + b * b, inner(u, u) + v * v
    new = p0 * (aa + bb) + 2 * (inner(p, re) + p[0] * uv[0] + p[1] * uv[1])
    pu, turn = inner(p, u), cross(p, im)
    along = (u[0] * pu, u[1] * pu, u[2] * pu + v * v * p[2])
    drag = (re[0] - uv[0], re[1] - uv[1], re[2])
    return new, tuple((aa - bb) * p[k] + 2 * (p0 * drag[k] - turn[k] + along[k]) for k in range(3))


def unit(p, D):
    x, y, z = p[1][0], p[1][1], p[1][2] / sqrt(1 + vec(D))
    r = 1 / sqrt(x * x + y * y + z * z)
    return r * x, r * y, r * z


def gate(N, neighbour, D, eps):
    """(A, B)."""
    return unit(boosted(null(neighbour, D), N, D, eps), D), unit(boosted(null(N, D), neighbour, D, eps), D)


def after(N, k=1):
    return tuple(shifted(x, k) for x in N)


def step(Sx, Sy, Sz, Tx, Ty, Tz, *, D, eps):
    S, T = gate((Sx, Sy, Sz), (Tx, Ty, Tz), D, eps)
    T, S = gate(T, after(S), D, eps)
    return *after(S, -1), *T


def inverse(Sx, Sy, Sz, Tx, Ty, Tz, *, D, eps):
    T, S = gate((Tx, Ty, Tz), after((Sx, Sy, Sz)), D, -eps)
    S, T = gate(after(S, -1), T, D, -eps)
    return *S, *T


def product(p, q, D):  # <N, N'> of null vectors
    return p[0] * q[0] + inner(p[1], q[1])


def bond(N, neighbour, D):
    return product(null(N, D), null(neighbour, D), D)


def energy(Sx, Sy, Sz, Tx, Ty, Tz, *, D, eps=0):
    """H, and of the map -sum log(<p, m* q m>/8) over sites, p and q the null vectors of the neighbours of a site."""
    S, T = (Sx, Sy, Sz), (Tx, Ty, Tz)
    total = 0
    for left, site, right, e in ((S, T, after(S), eps), (after(T, -1), S, T, -eps)):
        ahead = boosted(null(left, D), site, D, e)
        total = total - log(product(ahead, null(right, D), D) / 8).sum(-1)
    return total


def field(N, before, behind, D):  # -dH/dN
    W = height(N, D)
    out = [0, 0, 0]
    for neighbour in (before, behind):
        g = 2 / bond(N, neighbour, D)
        parts = neighbour[0], neighbour[1], (1 + vec(D)) * neighbour[2] + vec(D) * N[2] * height(neighbour, D) / W
        out = [x + g * y for x, y in zip(out, parts, strict=True)]
    return tuple(W * x for x in out)


def flow(Sx, Sy, Sz, Tx, Ty, Tz, *, D):  # N' = W N x (-dH/dN)
    S, T = (Sx, Sy, Sz), (Tx, Ty, Tz)
    return *cross(S, field(S, after(T, -1), T, D)), *cross(T, field(T, S, after(S), D))


def times(p, q):
    """The product of quaternions."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def in_order(parts, multiply):
    """The product over the last axis, neighbours first."""
    while parts[0].shape[-1] > 1:
        even = parts[0].shape[-1] // 2 * 2
        pairs = multiply(tuple(x[..., 0:even:2] for x in parts), tuple(x[..., 1:even:2] for x in parts))
        join = parts[0].__array_namespace__().concatenate
        parts = tuple(join([y, x[..., even:]], -1) for x, y in zip(parts, pairs, strict=True))
    return tuple(x[..., 0] for x in parts)


def transfer(Sx, Sy, Sz, Tx, Ty, Tz, *, D, eps=0):
    """Half the trace of the monodromy, divided by its length: sites S at the angle u, sites T at u - 2t."""
    C, S2 = angles(D, eps)
    out, n = [], Sx.shape[-1]
    for k in range(min(2 * n - 1, MOST_VALUES)):
        j = 2 * k + 1  # tan(u/2) = s j/8
        mu, c = 16 * j / (64 + D * j * j), (64 - D * j * j) / (64 + D * j * j)  # sin u/s, cos u
        sites = []
        for N, m, e in (((Sx, Sy, Sz), mu, c), ((Tx, Ty, Tz), mu * C - c * S2, c * C + D * mu * S2)):
            scale = 1 / sqrt(1 + vec(m) * vec(m))
            sites.append((scale * vec(m) * height(N, D), scale * N[0], scale * N[1], scale * vec(e) * N[2]))
        out.append(in_order(times(*sites), times)[0])
    return stack(out)


def magnetization(Sx, Sy, Sz, Tx, Ty, Tz, *, D):
    """sinh(h sum z~)/s; for D = 0 the total z."""

    def sums(a, b):
        return a[0] * b[0] + vec(D) * a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    S, T = (Sx, Sy, Sz), (Tx, Ty, Tz)
    return in_order(sums((height(S, D), Sz), (height(T, D), Tz)), sums)[1]


def largest_step(Sx, Sy, Sz, Tx, Ty, Tz, *, D):
    """tan t = eps s is below 1 for an easy plane, s = i |s|, where eps |s| < 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.asarray(D) < 0, 1 / np.sqrt(abs(np.asarray(D, dtype=np.float64))), np.inf)


def check_anisotropy(D, name):
    if not np.all(np.asarray(D > -1, dtype=bool)):
        raise InputError(f"{name}: expected D > -1, got {np.min(D):g}. D = sinh(h)^2, and -sin(h)^2 for an easy plane.")


SYSTEM = System(
    name="lattice-landau-lifshitz",
    title="Lattice Landau-Lifshitz model with one axis",
    equations="H = -2 sum log((W W' + x x' + y y' + (1 + D) z z')/2) over neighbours,  W = (1 + D z^2)^(1/2)",
    source="Krajnik, Ilievski, Prosen, Pasquier 2021; Sklyanin 1982; Faddeev, Takhtajan 1987",
    space=LATTICE_SPACE,
    parameters=(
        Parameter("n", "dimension", "half the number of sites of the ring"),
        Parameter("D", "scalar", "anisotropy: easy axis D > 0, easy plane -1 < D < 0", check_anisotropy, default=0.0),
    ),
    **named(flow, energy),
    integrals={"transfer": transfer, "magnetization": magnetization},
    commuting=("transfer", "magnetization"),
    map=Map(**named(step, inverse, largest_step), rational=False, source="Krajnik, Ilievski, Prosen, Pasquier 2021"),
    scaling="The length of a spin is 1; H and time are in units of the coupling.",
    numbers="real",
    notes="`transfer` has half the trace of the monodromy at up to 8 values of the spectral parameter, of 2n - 1 that "
    "are independent; with `magnetization` these are complete. For D = 0 the total spin is conserved too.",
)
