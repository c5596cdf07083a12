"""Phase spaces whose points lie on spheres: T*S^(n-1), spins, lattices of spins."""

from __future__ import annotations

from kreisel import algebra
from kreisel.algebra import Array, invariants
from kreisel.record.calling import Function
from kreisel.record.contract import PhaseSpace


def random_on_sphere(n: int, draw: Function, least: int = 0) -> tuple[Array, Array]:
    """A random (x, q) with |x| = 1, <x, q> = 0 and all |x_i| > least/(2 sqrt(n))."""
    count = n * (n - 1) // 2
    while True:
        x = algebra.cayley(algebra.skew(draw((count,)), n))[:, 0]
        if all(not getattr(v, "ordered", True) or 4 * n * v * v > least for v in x):  # residues have no order
            return x, algebra.act(algebra.skew(draw((count,)), n), x)


SPHERE_SPACE = PhaseSpace(
    name="T*S^(n-1)",
    components=(("x", "vector"), ("q", "vector")),
    tensor=invariants.sphere_poisson,
    casimirs=lambda x, q: invariants.stack([algebra.dot(x, x), algebra.dot(x, q)]),
    momentum=algebra.wedge,
    sign=+1,
    carried=(0,),
    constraints={"|x|^2 - 1": lambda x, q: algebra.dot(x, x) - 1, "<x, q>": lambda x, q: algebra.dot(x, q)},
    draw=random_on_sphere,
)


def random_spins(n: int, draw: Function) -> tuple[Array, ...]:
    """n random unit vectors as x, y, z, rational if `draw` is rational."""
    u, v = draw((2, n))
    below = 1 / (1 + u * u + v * v)
    return 2 * u * below, 2 * v * below, (1 - u * u - v * v) * below


SPINS_SPACE = PhaseSpace(
    name="(so(3)*)^n",
    components=(("Sx", "vector"), ("Sy", "vector"), ("Sz", "vector")),
    tensor=lambda *spins: -invariants.spins_poisson(*spins),
    casimirs=invariants.squared_lengths,
    sign=-1,
    carried=(),
    sites=True,
)
LATTICE_SPACE = PhaseSpace(
    name="(S^2)^(2n)",
    components=tuple((f"{spin}{axis}", "vector") for spin in "ST" for axis in "xyz"),
    tensor=lambda *spins, D: -invariants.lattice_poisson(spins, D),
    casimirs=invariants.squared_lengths,
    sign=-1,
    carried=(),
    sites=True,
    constraints={
        "|S|^2 - 1": lambda *spins: invariants.squared_lengths(*spins[:3]) - 1,
        "|T|^2 - 1": lambda *spins: invariants.squared_lengths(*spins[3:]) - 1,
    },
    draw=lambda n, draw: (*random_spins(n, draw), *random_spins(n, draw)),
)
