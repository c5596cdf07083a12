"""Records of the methods: `kr.methods`, defaults, checks, citations and tables come from them.

Of the methods that suit a model the first is its default.  A new method is a file with its maker, and a record here,
which names the maker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    from kreisel.method.scheme import Scheme
    from kreisel.record.contract import System
    from kreisel.record.model import Model


@dataclass(frozen=True)
class Suits:
    """Condition on a model: the fields below hold of its record.  Without any it holds for every model.

    states   attributes of the record that are neither None nor False, such as "map.symmetric": all of them
    either   attributes of which one at least is stated
    lacks    attributes that are not stated
    n        the dimension
    space    the name of the phase space
    kinds    the kinds of the components
    numbers  for which the record is written: one of these
    test     name of a function of the model, for conditions without an attribute; imported if everything else holds
    maker    name of the maker for these models, if it is not the method's
    """

    states: tuple[str, ...] = ()
    either: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    n: int | None = None
    space: str | None = None
    kinds: tuple[str, ...] | None = None
    numbers: tuple[str, ...] = ()
    test: str = ""
    maker: str = ""

    def __call__(self, model: Model) -> bool:
        """Whether the condition holds."""
        system = model.system
        return (
            self.n in (None, model.n)
            and self.space in (None, system.space.name)
            and self.kinds in (None, system.space.kinds)
            and (not self.numbers or system.numbers in self.numbers)
            and all(_states(system, path) for path in self.states)
            and not any(_states(system, path) for path in self.lacks)
            and (not self.either or any(_states(system, path) for path in self.either))
            and (not self.test or bool(resolve_name(self.test)(model)))
        )


def _states(system: System, path: str) -> bool:
    """Whether a record states the attribute at the end of a path such as "map.symmetric"."""
    value: Any = system
    for name in path.split("."):
        value = getattr(value, name)
        if value is None or value is False:
            return False
    return True


@dataclass(frozen=True)
class Method:
    """A method.

    name, title  of it, in a word and in a line
    needs        the data that a system must state for it, in words
    cases        conditions on a system, one of which must hold
    orders       that it has, rising; none for the flow itself; tuples for splittings.  `default` if none is asked for;
                 `words` for them, where `make` knows which there are
    poisson      whether its map is Poisson for the bracket of the system
    conserves    the quantities that are constant up to rounding errors
    default_for  the models of which it may be the default, as `cases`, which None represents
    steps        whether it makes steps: if not, it is not a default where an order or an engine is asked for
    sources      keys of refs.bib; `composed`: further keys of single orders
    maker        name of the function (model, dt, order, oriented) -> Scheme, such as "kreisel.method.maps:suris",
                 which is imported when the method is first used; "" for the function and the file of its name
    """

    name: str
    title: str
    needs: str
    cases: tuple[Suits, ...]
    conserves: str
    sources: tuple[str, ...]
    maker: str = ""
    orders: tuple[Any, ...] = ()
    default: Any = None
    poisson: str = "yes"
    default_for: tuple[Suits, ...] | None = None
    steps: bool = True
    words: str = ""  # for the orders, where no list states it
    composed: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    of_map: bool = False  # whether it steps the map of the system, which is cited then

    def __post_init__(self) -> None:
        word = self.name.replace("-", "_")
        object.__setattr__(self, "maker", self.maker or f"kreisel.method.{word}:{word}")

    def __repr__(self) -> str:
        return f"<kreisel method {self.name!r}: {self.title}>"

    def make(self, model: Model, dt: float, order: Any, oriented: bool) -> Scheme:
        """The scheme for a model."""
        maker = next((suits.maker for suits in self.cases if suits(model)), "") or self.maker
        scheme: Scheme = resolve_name(maker)(model, dt, order, oriented)
        return scheme

    def applies(self, model: Model) -> bool:
        """Whether a model states the data that the method needs."""
        return any(suits(model) for suits in self.cases)

    def check(self, model: Model) -> None:
        """Raises `InputError` for a system that does not state the data that the method needs."""
        if not self.applies(model):
            fits = any(method.may_be_default(model) for method in METHODS.values())
            way = "Leave method out for the one that fits" if fits else "None fits; state its flow in its System(...)"
            raise InputError(
                f"method={self.name!r}: expected {self.needs}, got {model.system.name} with n = {model.n}. "
                f"{way}, or see kr.methods()."
            )

    def may_be_default(self, model: Model) -> bool:
        """Whether it is one of the methods of which the first is the default."""
        cases = self.cases if self.default_for is None else self.default_for
        return any(suits(model) for suits in cases)

    @property
    def order_text(self) -> str:
        """The orders in words."""
        if self.words:
            return self.words
        if len(self.orders) > 4 and all(isinstance(order, int) for order in self.orders):
            return f"{self.orders[0]}, {self.orders[1]}, ... {self.orders[-1]}"
        return ", ".join(map(str, self.orders)) or "none: it is the flow itself"

    def order(self, asked: Any) -> Any:
        """The order that was asked for, or the default.  Raises `InputError` for one that the method has not."""
        if asked is None:
            return self.default
        result = tuple(asked) if isinstance(asked, list) else asked
        if isinstance(result, Integral) and not isinstance(result, bool):
            result = int(result)
            if self.words:
                return result
        if type(result) not in (int, tuple) or result not in self.orders:
            raise InputError(
                f"method={self.name!r}: expected one of its orders ({self.order_text}), got order={shown(asked)}."
                + ("" if self.orders else " Leave order out.")
            )
        return result

    def cited(self, order: Any) -> tuple[str, ...]:
        """Keys of refs.bib for a run of that order."""
        return (*self.sources, *self.composed.get(order or 0, ()))

    def references(self, system: System) -> str:
        """The sources of a system, and of its map if this method steps it."""
        return system.source + (f"; {system.map.source}" if self.of_map and system.map is not None else "")

    def summary(self) -> dict[str, Any]:
        """The record as plain data."""
        names = ("name", "title", "needs", "default", "poisson", "conserves")
        return {name: getattr(self, name) for name in names} | {
            "orders": list(self.orders),
            "sources": list(self.sources),
        }


# Symmetric compositions: keys of refs.bib by order.
COMPOSED = {4: ("suzuki1990", "hairer2006"), 6: ("kahan1997", "hairer2006"), 8: ("kahan1997", "hairer2006")}
COMPOSITIONS: dict[str, Any] = {"orders": (2, *COMPOSED), "default": 2, "composed": COMPOSED}
SPINS = "(so(3)*)^n"
POINTS = Suits(
    either=("pairs", "exact_map"), test="kreisel.method.conjugate:has_points", maker="kreisel.method.conjugate:products"
)

_RECORDS = (
    Method(
        name="exact",
        title="the flow itself, in closed form, or by pairs of Bäcklund maps",
        needs="n = 3: the Lagrange top, the Euler top, a case of Clebsch, a body of revolution in a fluid, Neumann's "
        "system, a body in a quadratic potential, the tops of Kovalevskaya, Komarov, and Goryachev and Chaplygin, "
        "Steklov's and Lyapunov's cases, Rubanovskii's gyrostat; n = 4, 5: euler-top, manakov-top, clebsch, "
        "clebsch-general, clebsch-body, quadratic-potential, quadratic-field, steklov-lyapunov",
        cases=(
            Suits(n=3, either=("baecklund", "closed_form.top", "closed_form.moments", "closed_form.gyrostat")),
            POINTS,
        ),
        conserves="all integrals of the flow",
        sources=("suris2001", "carlson1995", "whittaker1937"),
        default_for=(Suits(n=3, either=("closed_form.moments", "closed_form.gyrostat")),),
        steps=False,
    ),
    Method(
        name="splitting",
        title="splittings of perturbed bodies: the integrable motion and the perturbation alternate",
        needs="a perturbed body (kr.perturbed)",
        cases=(Suits(states=("perturbation",)),),
        orders=((2, 2), (4, 2), (6, 2), (8, 2), (10, 2), (18, 2), (8, 6, 4), (10, 6, 4), 4, 6, 8),
        default=(8, 6, 4),
        poisson="yes, without torque and damping",
        conserves="Casimirs and integrals that no force changes",
        sources=("touma1994", "wisdom1996", "laskar2001", "blanes2013"),
        maker="kreisel.method.splitting:make",
    ),
    Method(
        name="baecklund",
        title="products of commuting Bäcklund transformations",
        needs="a system whose Bäcklund transformations are known",
        cases=(Suits(states=("baecklund",)), POINTS),
        default_for=(Suits(states=("baecklund",)),),
        orders=tuple(range(2, 26, 2)),
        default=2,
        poisson="yes; by conjugate pairs (docs/exact.md) only if the points of the curve are fixed",
        conserves="all integrals of the flow",
        sources=("suris2001", "kuznetsov2004", "zullo2011", "ragnisco2011"),
    ),
    Method(
        name="veselov",
        title="symmetric maps of Veselov, of Moser and Veselov, and of Suris (2000), and compositions of them",
        needs="a system with a symmetric map",
        cases=(Suits(states=("map.symmetric",)),),
        **COMPOSITIONS,
        conserves="all integrals of the flow",
        sources=("moser1991", "suris2000"),
        maker="kreisel.method.maps:veselov",
        of_map=True,
    ),
    Method(
        name="brickwork",
        title="a lattice in discrete time: two-site maps of the odd bonds, then of the even ones",
        needs="a lattice with such a map (lattice-landau-lifshitz)",
        cases=(Suits(states=("map",), space="(S^2)^(2n)"),),
        orders=(1,),
        default=1,
        conserves="Casimirs, deformed integrals",
        sources=("krajnik2021", "krajnik2020"),
        maker="kreisel.method.maps:brickwork",
        of_map=True,
    ),
    Method(
        name="lagrangian",
        title="the map of a user-defined discrete Lagrangian (kreisel.reduction)",
        needs="a system of kreisel.reduction with a discrete Lagrangian",
        cases=(Suits(states=("map",), numbers=("jax",)),),
        words="the order of the discrete Lagrangian; 2 for a continuous one",
        poisson="if its symmetries give the bracket",
        conserves="what its symmetries give",
        sources=("suris2001",),
        maker="kreisel.method.maps:lagrangian",
        of_map=True,
    ),
    Method(
        name="suris",
        title="the paper's maps (order 1), and their half-kick conjugates (order 2)",
        needs="a system with an explicit map",
        cases=(Suits(states=("map.to_symmetric",), numbers=("any", "real")),),
        orders=(1, 2),
        default=2,
        conserves="Casimirs, deformed integrals",
        sources=("suris2001",),
        maker="kreisel.method.maps:suris",
        of_map=True,
    ),
    Method(
        name="map",
        title="the map of a user-defined record, which need not be Poisson",
        needs="a record with a map and no half kick",
        cases=(
            Suits(
                states=("map",),
                lacks=("map.to_symmetric", "map.symmetric"),
                numbers=("any", "real"),
                test="kreisel.method.maps:has_a_plain_map",
            ),
        ),
        words="the order of the map",
        poisson="if the map is",
        conserves="the integrals that the map states",
        sources=(),
        maker="kreisel.method.maps:user_map",
        of_map=True,
    ),
    Method(
        name="midpoint",
        title="the spherical midpoint method, and compositions of it",
        needs="spins, or a free body with n = 3: products of spheres",
        cases=(
            Suits(states=("flow",), lacks=("perturbation",), numbers=("any",), space=SPINS),
            Suits(states=("flow",), lacks=("perturbation",), numbers=("any",), kinds=("skew",), n=3),
        ),
        **COMPOSITIONS,
        conserves="Casimirs, linear integrals; the energy of the Euler top",
        sources=("mclachlan2014",),
        default_for=(Suits(space=SPINS),),
    ),
    Method(
        name="variational",
        title="the variational Lie-Poisson integrator, and compositions of it",
        needs="H = T(M) + V (a record with inverse_inertia and momentum)",
        cases=(Suits(states=("inverse_inertia", "space.momentum")),),
        **COMPOSITIONS,
        conserves="Casimirs, momenta of symmetries",
        sources=("marsden1999", "suris2001"),
    ),
    Method(
        name="dop853",
        title="SciPy's adaptive Runge-Kutta method of order 8: the reference",
        needs="a system that states its flow",
        cases=(Suits(states=("flow",)),),
        orders=(8,),
        default=8,
        poisson="no",
        conserves="nothing",
        sources=("hairer1993",),
        maker="kreisel.method.reference:dop853",
    ),
    Method(
        name="kahan",
        title="Kahan's discretization of quadratic flows, and compositions of it",
        needs="a flow that is quadratic in a state of at most 15 coordinates",
        cases=(
            Suits(
                states=("flow",),
                lacks=("perturbation",),
                numbers=("any",),
                test="kreisel.method.kahan:has_a_small_quadratic_flow",
            ),
        ),
        **COMPOSITIONS,
        poisson="no",
        conserves="linear integrals; at order 2 deformed integrals of the Euler top (n = 3, 4), of Lagrange's top with "
        "equal moments, of Clebsch's case and of gyrostats with the wheel across a principal axis",
        sources=("kahan1993", "hirota2000", "petrera2011"),
        default_for=(),
    ),
)
METHODS = {record.name: record for record in _RECORDS}
