"""Maps whose integrals, entropies, singularities and exponents are printed in the literature."""

from __future__ import annotations

import math
from fractions import Fraction as F

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import objects
from kreisel.errors import InputError, RunError
from kreisel.lab import brackets, darboux, dynamics, growth, integrals, search
from kreisel.lab.certified import certify
from kreisel.lab.growth import fitted_growth, singularities
from kreisel.lab.investigation import Investigation, investigate
from kreisel.lab.subject import subject
from sizes import FULL, full

STEP = F(1, 3)


def kahan(f, dim: int):
    """x' with (x' - x)/h = Q(x, x') + B (x + x')/2 + c, f = Q + B + c, by elimination."""

    def step(x):
        units = np.eye(dim, dtype=int).astype(object)
        J = np.stack([(f(x + e) - f(x - e)) * F(1, 2) for e in units], 1)  # exact for quadratic f
        A, b = units - J * (STEP / 2), f(x) * STEP
        for k in range(dim):
            b[k], A[k] = b[k] / A[k, k], A[k] / A[k, k]
            for i in range(dim):
                if i != k:
                    b[i], A[i] = b[i] - A[i, k] * b[k], A[i] - A[i, k] * A[k]
        return x + b

    return step


def volterra(x):
    return objects([x[0] * (x[1] - x[2]), x[1] * (x[2] - x[0]), x[2] * (x[0] - x[1])])


def dressing(x):
    return objects([x[1] * x[1] - x[2] * x[2] + 1, x[2] * x[2] - x[0] * x[0] + 2, x[0] * x[0] - x[1] * x[1] - 3])


def icosahedral(x):  # Nahm's equations for monopoles
    return objects([2 * x[0] * x[0] - x[1] * x[1], -10 * x[0] * x[1] + x[1] * x[1]])


def looked_at(step, dim: int, **options) -> Investigation:
    return investigate(step, names=tuple(f"x{i}" for i in range(dim)), steps=1000, **options)


@pytest.mark.parametrize("field", [dressing, *full(volterra)])
def test_kahans_maps_of_volterras_and_the_dressing_chain(field) -> None:
    """Two integrals each for N = 3. [Petrera, Pfadler, Suris, Regul. Chaotic Dyn. 16 (2011), sections 5 and 6]"""
    step = kahan(field, 3)
    x = objects([F(1, 2), F(-2, 3), F(3, 5)])
    new = step(x)  # the mean of f'(x) x' is the symmetric bilinear form of f, and linear terms at the mean
    middle = (4 * field((x + new) * F(1, 2)) - field(x) - field(new)) * F(1, 2)
    assert ((new - x) == STEP * middle).all()
    assert looked_at(step, 3).verdict == "integrable"


def test_the_cubic_integral_of_volterras_chain() -> None:
    """x y z/(1 - eps^2 (x^2 + y^2 + z^2 - 2 x y - 2 y z - 2 z x)), the step 2 eps; its denominator is a density too."""
    chain = subject(kahan(volterra, 3), names=("x", "y", "z"))
    found = darboux.darboux(chain, 2)
    assert len(found.integrals) == 2 and len(found.densities) == 1

    def printed(x):
        return x[0] * x[1] * x[2] / (1 - (STEP / 2) ** 2 * (sum(x * x) - 2 * (x[0] * x[1] + x[1] * x[2] + x[2] * x[0])))

    points = [objects([F(1, 2), F(-2, 3), F(3, 5)]), objects([F(3), F(1, 7), F(5, 2)])]
    cubic = next(f for f in found.integrals if f.degree == 3)
    (a, b), (c, d) = ((cubic(x), printed(x)) for x in points)
    assert a * d in (b * c, 1 / (b * c) * a * a * d * d) and a != c  # up to a factor, or its inverse
    assert all(cubic(chain.step(x)) == cubic(x) for x in points)


def test_the_icosahedral_integral_of_degree_six() -> None:
    """[Petrera, Pfadler, Suris, Exp. Math. 18 (2009); Celledoni et al., J. Phys. A 46 (2013), Nahm's equations]"""
    found = looked_at(kahan(icosahedral, 2), 2)
    assert found.verdict == "integrable" and "degree 6: 1 combinations" in found["integrals"].evidence


@pytest.mark.parametrize("order", [3, 4, *full(2, 5)])
def test_demskoi_tran_van_der_kamp_and_quispel(order: int) -> None:
    """x_N = -x_0 - ... - x_(N-1) + C/(x_1 ... x_(N-1)) has [(N + 1)/2] integrals. [J. Phys. A 45 (2012) 135202]"""

    def step(x):
        return objects([*x[1:], 2 / math.prod(x[1:]) - sum(x)])

    found = looked_at(step, order)
    assert found.verdict == ("integrable" if order < 4 else "undecided")
    text = found["integrals"].answer
    assert (f"{(order + 1) // 2} as coefficients" if order > 3 else f"{(order + 1) // 2} of degree 4") in text


def test_degrees_that_wait_for_all_coordinates() -> None:
    """Six copies of Henon's map, one moved in each step: entropy log(2)/6; the first six degrees are 2."""

    def step(x):
        return objects([*x[2:], x[1], 1 - 2 * x[1] * x[1] - x[0]])

    found = looked_at(step, 12)
    assert found.verdict == "not integrable"
    assert abs(float(found["degree growth"].answer.split()[-1]) - math.log(2) / 6) < 1e-6


def test_few_degrees_have_no_certain_entropy() -> None:
    """x'' = x' + 7/x'^12 - x: 13^3 is followed by less than 13^4, its singularities confine."""
    assert math.isinf(fitted_growth((1, 13, 169, 2197)).uncertainty)


def test_singularities_at_algebraic_points() -> None:
    """The curves y^2 + y + 1, y^2 + 5 = 0 have no points modulo some primes; x^2 = 2 y^2 are two lines."""

    def texts(step) -> list[str]:
        return [str(s) for s in singularities(subject(step, names=("x", "y")))]

    def qrt(b: int, c: int):  # y' + x = -(b y^2 + e y + f)/(y^2 + b y + c) confines
        return lambda x: objects([x[1], -x[0] - (b * x[1] * x[1] + x[1] + 3) / (x[1] * x[1] + b * x[1] + c)])

    assert texts(qrt(1, 1)) == ["y^2 + y + 1 = 0: (*, c) -> (c, oo) -> (oo, c) -> (c, *)"]
    assert texts(qrt(0, 5)) == ["y^2 + 5 = 0: (*, c) -> (c, oo) -> (oo, c) -> (c, *)"]

    def lines(x):
        cone = x[0] * x[0] - 2 * x[1] * x[1]
        return objects([x[0] * cone / x[1], x[1] * cone + x[0] / x[1]])

    assert texts(lines)[0].startswith("x^2 - 2 y^2 = 0: (*, *) -> (0, c) -> (0, c)")


def turned(x):
    return objects([(3 * x[0] - 4 * x[1]) / 5, (4 * x[0] + 3 * x[1]) / 5, *x[2:]])


@pytest.mark.parametrize(
    ("names", "tensor"),
    [
        ("xy", lambda x: np.eye(2, dtype=object)),
        ("xyz", lambda x: np.array([[0, 1, -x[0]], [-1, 0, -x[1]], [x[0], x[1], 0]], dtype=object)),
    ],
)
def test_a_preserved_tensor_that_is_no_bracket(names: str, tensor) -> None:
    """The metric, and the tensor with the vector v = (-y, x, 1), v . curl v = 2, are preserved by a rotation."""
    map_of = subject(turned, names=tuple(names))
    assert brackets.defect(map_of, tensor) == 0 and not brackets.obeys_jacobi(map_of, tensor)
    found = investigate(turned, names=tuple(names), tensor=tensor, steps=1000)
    assert found["Poisson"].evidence.startswith("the bracket given with it is not antisymmetric, or violates Jacobi's")


def test_constant_fractions_in_brackets_and_lax_pairs() -> None:
    """{x, y} = 1/2 has leaves of two dimensions; det of ((0, 1/2), (x, 0)) is -x/2, which x -> x + 1 changes."""
    half = np.array([[0, F(1, 2)], [F(-1, 2), 0]], dtype=object)
    found = investigate(turned, names=("x", "y"), tensor=lambda x: half, steps=1000)
    assert "on leaves of dimension 2" in found["integrals"].answer
    pair = brackets.lax(
        subject(lambda x: x + 1, names=("x",)), L=lambda x, lam: np.array([[0, F(1, 2)], [x[0], 0]], dtype=object)
    )
    assert pair.isospectral is False


def test_a_map_onto_a_curve_is_refused() -> None:
    with pytest.raises(InputError, match="Jacobian determinant of <lambda> vanishes: the map is not invertible"):
        looked_at(lambda x: objects([x[0] * x[1], x[0] * x[1] + 1]), 2)


# -- Lyapunov's exponents -------------------------------------------------------------------------------


@pytest.mark.parametrize("strength", [7.0, *full(10.0, 20.0)])
def test_exponents_of_the_standard_map(strength: float) -> None:
    """+- log(K/2) for large K. [Chirikov, Phys. Rep. 52 (1979), section 5.3]"""

    def standard(x):
        p = x[1] + strength * np.sin(x[0])
        return objects([x[0] + p, p])

    orbit = dynamics.dynamics(subject(standard, names=("q", "p")), np.array([0.5, 0.3]), 20_000)
    assert orbit.chaotic and abs(orbit.exponents[0] - math.log(strength / 2)) < 0.05
    assert abs(orbit.exponents.sum()) < 1e-6  # it preserves areas


def test_an_orbit_into_a_point_without_derivative() -> None:
    """x -> x^2 from inside (0, 1), (x^2 y, x y) into the origin: the exponents are -oo."""
    for step, names in (
        (lambda x: x * x, ("x",)),
        (lambda x: objects([x[0] * x[0] * x[1], x[0] * x[1]]), ("x", "y")),
    ):
        with pytest.raises(RunError, match="derivative is 0"):
            dynamics.dynamics(subject(step, names=names), np.full(len(names), 0.5), 1000)
    cat = looked_at(lambda x: objects([x[0] * x[0] * x[1], x[0] * x[1]]), 2)
    assert cat.verdict == "not integrable" and abs(math.log((3 + 5**0.5) / 2) - 0.962424) < 1e-6
    assert cat["degree growth"].answer.startswith("exponential, entropy 0.962424")


# -- in floats ----------------------------------------------------------------------------------------------


def test_an_energy_that_is_nearly_conserved_is_no_integral() -> None:
    """The free body by the trapezoidal rule of its Lagrangian, in Cayley's parameters: at eps = 1/3 a quadratic
    polynomial changes by 1e-11 on orbits of size 1; at eps = 1 the energy visibly oscillates.  Veselov's has it."""
    pytest.importorskip("jax")
    import jax.numpy as jnp

    from kreisel import reduction as red
    from kreisel.lab.integrals import integrals_in_floats

    def free(Omega, *, J):
        return -jnp.trace(Omega @ (J[:, None] * Omega)) / 2

    def veselov(W, *, J, eps):
        return -jnp.trace(W * J) / eps

    group = red.SO(3)
    of_group = {"group": group, "representation": red.trivial(group)}
    body = red.system("free", lagrangian=free, **of_group)(J=(1, 2, 4))
    for eps in (F(1, 3), F(1), *[F(1, 6)] * FULL):
        assert not integrals_in_floats(subject(body, eps=eps)).enough
    rotor = red.system("veselov", discrete=veselov, **of_group)(J=(0.4, 1, 1.7))
    found = integrals_in_floats(subject(rotor, eps=STEP))
    assert found.enough and (found.count, found.on_leaf) == (2, 1)
    run = kr.simulate(body, {"M": (3.0, 4.0, 1.0)}, dt=1.0, steps=400, progress=False)
    assert kr.drift(run).max_change["energy"] > 1e-4
    with pytest.raises(RunError, match="move too little in 40 steps"):
        integrals_in_floats(subject(rotor, eps=F(1, 10**6)))


def test_kahans_map_has_the_names_of_the_coordinates() -> None:
    """The momentum about the axis of Lagrange's top is m3; a step is that of `method="kahan"`, by another engine."""
    top = search.kahan_map(kr.LagrangeTop(p=(0, 0, 1)), F(1, 4))
    assert str(integrals.integrals(top, 1)[0]) == "m3"
    x = np.array([0.25, 0.5, 1.5, 0.6, 0.0, 0.8])
    run = kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": x[:3], "a": x[3:]}, dt=0.25, steps=1, method="kahan")
    new = np.array(top.step(objects(map(F, x))), dtype=float)
    np.testing.assert_allclose(new, [*run.m[-1], *run.a[-1]], atol=1e-15)


def test_maps_that_do_not_interact() -> None:
    """Two of McMillan's: {x, y} = 1 and {u, v} = 1 are preserved one by one, and so is their sum, of full rank."""

    def two(z):
        pairs = ((z[k], z[k + 1], F(3 + k, 2)) for k in (0, 2))
        return objects(v for x, y, a in pairs for v in (y, a * y / (1 + y * y) - x))

    found = looked_at(two, 4)
    assert found.verdict == "integrable" and "2 on leaves of dimension 4, in involution" in found["integrals"].answer


@pytest.mark.parametrize(
    ("rate", "answer"),
    [(1, "exact to round-off"), (10, "unknown")],  # the second motion ends at t = 1/(10 x)
)
def test_the_order_of_a_map_that_is_the_flow(rate: int, answer: str) -> None:
    """x/(1 - c eps x) is the flow of x' = c x^2, Kahan's map of Riccati's equation."""
    found = investigate(lambda x, eps: x / (1 - rate * eps * x), names=("x",), flow=lambda x: rate * x * x, steps=1000)
    assert found["order"].answer == answer


def test_heights_and_enclosures_of_a_step_with_fractions() -> None:
    """Henon's map over Q: the heights double; balls need its fractions as constants."""

    def henon(x, a=F(7, 5), b=F(3, 10)):
        return objects([1 + x[1] - a * x[0] * x[0], b * x[0]])

    start = [F(1, 3), F(1, 5)]
    assert abs(growth.heights(subject(henon, names=("x", "y")), start, 14).entropy - math.log(2)) < 1e-3
    with pytest.raises(InputError, match="a fraction in the step"):
        certify(subject(henon, names=("x", "y")), start, 5)
    assert certify(subject(henon, names=("x", "y"), a=F(7, 5), b=F(3, 10)), start, 5).steps == 5


def test_a_longest_step_with_a_root() -> None:
    """Ratiu's top: the parameters are fractions, the bound of the step has roots of them."""
    assert investigate("ratiu-top", steps=1000).verdict == "integrable"


def test_coefficients_beyond_two_primes_leave_other_answers() -> None:
    """A QRT map with fractions of 7 digits: its integral is beyond two primes, the page has the growth k^2."""
    a, b = F(1234567, 1000003), F(7654321, 3000017)
    found = looked_at(lambda x: objects([x[1], (x[1] * x[1] + a) / (x[0] * (1 + b * x[1] * x[1]))]), 2)
    assert found["integrals"].answer == "unknown" and "short fractions" in found["integrals"].evidence
    assert found["degree growth"].answer == "k^2, entropy 0" and found.verdict == "undecided"
