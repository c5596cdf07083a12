"""Claims of a system about itself: the records, and a record with its parameters filled in.

A `System` is data: pure functions of named state components, and claims about them.  Laws (`kreisel.lab.laws`) test the
claims; engines compile the functions; a system contains nothing else.  The arguments of every function are the
components of the state in order, then by keyword the parameters it names and, if it depends on them, `eps` (the step)
and `lam` (the spectral parameter lambda).
"""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING, Any, SupportsIndex

from kreisel.algebra import KINDS, Array, coordinate_count, invariants, restore
from kreisel.algebra.reuse import KEPT, cached_property
from kreisel.display import show
from kreisel.errors import InputError, explained, require_one_of
from kreisel.record.calling import Function, call, keywords, naming, require_names
from kreisel.record.model import Model
from kreisel.record.values import require_one_reading

if TYPE_CHECKING:
    from kreisel.record.perturbation import Perturbation


def named(*functions: Function) -> dict[str, Any]:
    """Entries of a record whose functions have their names."""
    return {function.__name__: function for function in functions}


class Frame(enum.Enum):
    """The frame of the state, and the evolution of the orientation g (body to space)."""

    REST = "rest"  # minus bracket; a = g A with A fixed in the body; g_(k+1) = cay(X) g_k
    MOVING = "moving"  # plus bracket; P = g^T p with p fixed in space; g_(k+1) = g_k cay(X)


@dataclass(frozen=True)
class PhaseSpace:
    """A Poisson manifold in coordinates: components, Poisson tensor, Casimirs.

    `tensor(*state)`, which may name parameters, is the matrix of brackets of the independent coordinates (skew matrices
    count by their entries i < j, symmetric ones by i <= j); the field of H is F' = {H, F}.  `momentum(*state)` is the M
    in so(n) that generates the rotations of the state.  `carried` are the places of the components that rotate with the
    body, such as a, P or x, on which potentials depend; the others are momenta.  `constraints` names functions that
    vanish on the phase space when it is a submanifold of its coordinate space.  `draw(n, draw)` returns a random point
    from random values draw(shape), if not every point of the coordinate space is allowed.  `sites`: whether the n
    entries of a vector belong to n sites.  `unlike`: whether the components have unlike units and sizes.
    """

    name: str
    components: tuple[tuple[str, str], ...]
    tensor: Function
    casimirs: Function | None
    sign: int
    constraints: Mapping[str, Function] = field(default_factory=dict)
    momentum: Function | None = None
    carried: tuple[int, ...] = (1,)
    draw: Function | None = None
    sites: bool = False
    unlike: bool = False

    @cached_property
    def letters(self) -> tuple[str, ...]:
        """The letters of the components, in order."""
        return tuple(letter for letter, _ in self.components)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of the components: "skew", "symmetric", "vector", or "R^k" for k entries independent of n."""
        return tuple(kind for _, kind in self.components)

    @property
    def frame(self) -> Frame:
        """The frame of the state, which follows from the sign of the bracket."""
        return Frame.MOVING if self.sign > 0 else Frame.REST

    @property
    def of_body(self) -> bool:
        """Whether the first component is the momentum of a body, in so(n)."""
        return self.kinds[0] == "skew"

    def point(self, n: int, draw: Function) -> tuple[Array, ...]:
        """Random point, from random values draw(shape)."""
        if self.draw is not None:
            return tuple(self.draw(n, draw))
        return restore(draw((coordinate_count(self.kinds, n),)), self.kinds, n)

    @property
    def leading(self) -> int:
        """The place of the component shown in pictures and angles: the first that is carried, if any."""
        return self.carried[0] if self.carried else 0


def semidirect(name: str, components: tuple[tuple[str, str], ...], casimirs: Function, sign: int = +1) -> PhaseSpace:
    """The dual of so(n) <x V: M in so(n), then components that it rotates, of kinds "vector", "symmetric" and "skew".

    V = R^n, several copies of it, the symmetric matrices or so(n) itself; without more components only so(n).  The plus
    bracket (moving frame) or the minus bracket (rest frame) follows from the rotation of the components.
    """
    kinds = tuple(kind for _, kind in components)
    return PhaseSpace(
        name=name,
        components=components,
        tensor=partial(_tensor, sign, kinds),
        casimirs=casimirs,
        momentum=_momentum,
        sign=sign,
        carried=tuple(range(1, len(components))),
    )


def _tensor(sign: int, kinds: tuple[str, ...], *state: Array) -> Array:
    return sign * invariants.lie_poisson(kinds, *state)


def _momentum(M: Array, *carried: Array) -> Array:
    return M


REST_SPACE = semidirect("e*(n)", (("m", "skew"), ("a", "vector")), invariants.casimirs, -1)
MOVING_SPACE = semidirect("e*(n)", (("M", "skew"), ("P", "vector")), invariants.casimirs)
FREE_SPACE = semidirect("so*(n)", (("M", "skew"),), invariants.casimirs_free)
QUADRATIC_SPACE, FIELD_SPACE = (
    semidirect("(so(n) <x Sym(n))*", (("M", "skew"), (letter, "symmetric")), invariants.power_traces) for letter in "PF"
)
ADJOINT_SPACE, ADJOINT_PAIR_SPACE = (
    semidirect("(so(n) <x so(n))*", (("M", "skew"), (letter, "skew")), invariants.casimirs_adjoint) for letter in "GP"
)
TWO_FIELDS_SPACE = semidirect("(so(n) <x 2 R^n)*", (("M", "skew"), ("P", "vector"), ("Q", "vector")), invariants.gram)


@explained
@dataclass(frozen=True)
class Parameter:
    """A parameter: its letter, kind, meaning and valid range.

    Kinds are "scalar", "vector", "symmetric", "array", "dimension" and "table".

    A dimension is n itself, for systems whose other parameters do not determine it.  A symmetric matrix may be given by
    its diagonal; an array has any shape, and no batch axes unless it states its `rank`, the number of its axes.
    `check(value, name)` raises `InputError`.  `fixed` is the frame in which a vector of a top with a fixed point rests:
    "space" (the vertical, against gravity) or "body" (its axis, from the fixed point to the centre of mass).
    """

    letter: str
    kind: str
    meaning: str
    check: Function | None = None
    default: Any = None
    diagonal: bool = False  # a vector: the diagonal of a matrix, so n x n values may be meant as the matrix
    distinct: bool = False  # the entries must be distinct
    positive: bool = False  # the entries must be positive
    fixed: str = ""
    rank: int | None = None

    def __post_init__(self) -> None:
        if not str(self.kind).startswith("R^"):
            require_one_of([*KINDS, "array", "table"], self.kind, f"The kind of the parameter {self.letter}")

    @property
    def axes(self) -> int | None:
        """Axes without axes of lanes; None for an array of any shape."""
        return self.rank if self.kind == "array" else 1 if self.kind == "table" else KINDS[self.kind].axes


@dataclass(frozen=True)
class Map:
    """A discretization of a flow, with all claims about it, each tested by a law.

    Only the step must be stated.

    step, inverse            (*state, eps) -> state; of a symmetric map the inverse follows
    symmetric                whether the step with -eps is the inverse
    involution               R with R step R = inverse, anti-Poisson
    to_symmetric             chi with chi step chi^-1 of order 2 and symmetric; chi^-1 is chi with -eps
    generator                X(*old, *new, eps) with the rotation of the body w = cay(X)
    lagrangian               (q0, q1, *carried, eps): q = g in SO(n) and the carried vectors, such as A (rest frame) or
                             p (moving frame), or q = x on the sphere; only its differences matter
    lax                      L(*state, lam, eps);  conjugator V(*state, lam, eps) with V L_(k+1) = L_k V
    pencil                   L(*state, lam, mu, eps), singular where (lam, mu) is on the spectral curve;  factors
                             (U, V)(*state, lam, eps) with U L_(k+1) = L_k V
    turn                     (*state, eps) -> X with w = cay(X), and the square of its last correction: for implicit
                             maps, whose step is then move(*state, X, eps)
    trajectory               (*state, eps) -> sigma, a further argument of `turn` for n = 3, constant on a trajectory
    largest_step             (*state) -> the |eps| beyond which the map may be singular on the orbit; with an argument
                             `enough` it may return a shorter one beyond that
    regularity               (*state, eps) -> reciprocal condition number of the Legendre transform, for implicit maps
    commutes                 whether it commutes with itself at other steps and with the flow
    poisson                  whether the map is Poisson; if not, as for a Runge-Kutta step, Casimirs are conserved only
                             if `conserves` has "casimir"
    conserves                 names of the integrals that the map conserves; None: all of the record
    darboux                  (*state, eps) -> (*state, rho): variables in which the step is the Bäcklund transformation
                             D_eps at the point (2/eps, rho) of the spectral curve of the flow
    rational                 whether the step is a rational function; else it does not accept exact values
    """

    step: Function
    inverse: Function | None = None
    involution: Function | None = None
    to_symmetric: Function | None = None
    generator: Function | None = None
    lagrangian: Function | None = None
    lax: Function | None = None
    conjugator: Function | None = None
    pencil: Function | None = None
    factors: Function | None = None
    turn: Function | None = None
    trajectory: Function | None = None
    move: Function | None = None
    largest_step: Function | None = None
    second_order: Function | None = None
    regularity: Function | None = None
    conserves: tuple[str, ...] | None = None
    darboux: Function | None = None
    rational: bool = True
    symmetric: bool = False
    poisson: bool = True
    commutes: bool = False
    order: int = 1
    source: str = ""

    def __post_init__(self) -> None:
        if self.symmetric and self.inverse is None:
            object.__setattr__(self, "inverse", _with_the_other_sign(self.step))

    @property
    def from_symmetric(self) -> Function | None:
        """chi^-1."""
        return None if self.to_symmetric is None else _with_the_other_sign(self.to_symmetric)

    @property
    def adjoint(self) -> Function | None:
        """The inverse of the step with -eps; for a symmetric map the step itself."""
        if self.symmetric or self.inverse is None:
            return self.step if self.symmetric else None
        return _with_the_other_sign(self.inverse)


@cache
def _with_the_other_sign(function: Function) -> Function:
    """A function of a state with -eps for eps."""
    return naming(partial(_reversed, function), function)


def _reversed(function: Function, *state: Array, eps: Any, **constants: Any) -> Any:
    return function(*state, eps=-eps, **constants)


def kicked_map(kick: Function, turn: Function, **claims: Any) -> Map:
    """The map (M, ...) -> `turn(M + kick(...), ...)`: a potential changes M, then the state rotates.

    kick(*carried, eps)   the change of M, a function of the other components, which stay
    `turn(*state, eps)`   the state after the rotation; with -eps it is the inverse

    Its inverse, its reversing involution and half a kick follow; `claims` are the other fields.
    """

    def step(M: Array, *carried: Array, **constants: Any) -> Any:
        return call(turn, (M + call(kick, carried, constants), *carried), constants)

    def inverse(*state: Array, eps: Any, **constants: Any) -> Any:
        M, *carried = call(turn, state, {**constants, "eps": -eps})
        return M - call(kick, tuple(carried), {**constants, "eps": eps}), *carried

    def involution(M: Array, *carried: Array, **constants: Any) -> Any:
        return -M - call(kick, carried, constants), *carried

    def to_symmetric(M: Array, *carried: Array, **constants: Any) -> Any:
        return M + call(kick, carried, constants) / 2, *carried

    steps = {f.__name__: naming(f, kick, turn) for f in (step, inverse)}
    kicks = {f.__name__: naming(f, kick) for f in (involution, to_symmetric)}
    return Map(**(steps | kicks | claims))


def implicit_map(turn: Function, move: Function, **claims: Any) -> Map:
    """The symmetric map move(*state, X, eps) with X, defect = `turn(*state, eps)`, of order 2; see `Map`."""

    def step(*state: Array, **constants: Any) -> Any:
        return call(move, (*state, call(turn, state, constants)[0]), constants)

    def generator(*old_and_new: Array, **constants: Any) -> Any:
        return call(turn, old_and_new[: len(old_and_new) // 2], constants)[0]

    derived = {"step": naming(step, turn, move), "generator": naming(generator, turn), "turn": turn, "move": move}
    return Map(**(derived | {"symmetric": True, "rational": False, "commutes": True, "order": 2} | claims))


@dataclass(frozen=True)
class Baecklund:
    """Maps D_eps, eps = 2/mu, that conserve all integrals of the flow and commute with it and with each other.

    (mu, rho) is a point of the spectral curve, rho a constant of the trajectory; e is the eigenvector there of
    the Lax matrix.  Re mu > 0; mu, rho and e are real, or complex with e = u + i w.

    point(*state, mu)            the rho for mu on the branch with D_eps -> 1 as eps -> 0, not finite or complex if
                                 there is none; also recorded: choices by `algebra.where_less`
    vector(*state, mu, rho)      e, for the rho of this state, by a step of Newton's method
    defect(*state, e, mu, rho)   a function that vanishes on the curve
    step(*state, e, mu)          D_eps for real mu
    pair(*state, e, mu)          D_eps D_conj(eps) for complex mu, in real arithmetic
    arc, arc_of_pair(*state, e)  (x, y): the carried vector rotates by R_y R_x, R a half-turn
    darboux(*state, e, mu, rho, lam)     N with N L = L_new N
    odd                          +1 or -1: (-mu, odd rho) corresponds to (mu, rho)
    block(*state)                the part of the momentum that does not act on the carried vector; g also rotates by
                                 cay(eps/2 block), in the body for the rest frame, in space for the moving frame
    spin(*state)                 constant remainder of the angular velocity for unequal moments, in the state's frame
    axis                         of spin in a moving frame: the name of a parameter
    largest_step(*state)         the largest real eps
    case, pair_case(n, draw)     (state, params, e, mu, rho), all rational, for the laws; in the latter e, mu
                                 and rho are complex, over Q(i)
    """

    point: Function
    vector: Function
    defect: Function
    step: Function
    pair: Function
    arc: Function
    arc_of_pair: Function
    block: Function
    darboux: Function | None = None
    spin: Function | None = None
    axis: str = ""
    largest_step: Function | None = None
    case: Function | None = None
    pair_case: Function | None = None
    odd: int = 1
    source: str = ""


@dataclass(frozen=True)
class ConjugatePairs:
    """Pairs of maps at points (lam, mu), (conj lam, conj mu) of the spectral curve det(L(lam) - mu) = 0, Re lam != 0.

    They conserve all integrals of the flow and commute with it and with each other; the nearer Re lam is to 0, the
    nearer they are to the identity.  The flow over a time is a product of them (`kreisel.method.conjugate`).

    matrix(*state, lam)              L (..., m, m) for complex lam (...), one state
    heights(*state)                  rows (origin, side, low, high) of recorded values: Im lam of points to try, with
                                     imaginary mu, is origin + side r, r from low to high the distance of poles
    projector(*state, lam, mu)       Pi (m, m) of the eigenvalue mu of L, of recorded numbers
    rates(*state, lam, Pi)           with respect to Re lam: the rates of the state and the angular velocity of the
                                     body, analytic in lam; Pi (..., m, m)
    pair(*state, lam, mu)            (state, turns): the state, and rotations g cay(X) of the body, one after another,
                                     except one that commutes with all it carries; mu: nearest eigenvalue of this state
    metric()                         the diagonal S (m,), maybe singular, if L q = mu S q; then Pi = q p^T, p^T S q = 1
    spectrum(*state, y)              (Im mu of some of the branches at iy, positive where they may be used), recorded;
                                     without, all eigenvalues of L, a matrix that is similar to i times a Hermitian one
    require()                        raises `InputError` for parameters with which the pairs are not used
    dimensions                       n
    between                          steps between two projections: the least interval by cost, so that more pairs in
                                     other lanes change nothing; fewer where half the mean drift, by which a projection
                                     goes beyond the integrals of the start, is more than 3 last places
    """

    matrix: Function
    heights: Function
    projector: Function
    rates: Function
    pair: Function
    spectrum: Function | None = None
    metric: Function | None = None
    require: Function | None = None
    dimensions: tuple[int, ...] = (3, 4, 5)
    between: int = 10


@dataclass(frozen=True)
class ExactMap:
    """A map that is the flow over a time, for constants of the trajectory: the complex values z and w.

    For short times h, z is nearly h/2i; the logarithm of the map at such a z is odd in z.

    point(*state, dt)                    (z for the flow over dt, positive unless dt is too long), recorded
    level(*state, z)                     w
    step(*state, z_re, z_im, w_re, w_im) -> state: the same for z = 0 and w = 1
    """

    point: Function
    level: Function
    step: Function


@dataclass(frozen=True)
class Relation:
    """A motion that is also the motion of another system: (state, params, g) -> (state, params) of `target`.

    A law compares the flows and, if `map` names "step" or "adjoint" of the target, the maps; in floats only if `exact`
    is False.  `back` maps the state of the target back, if the image determines it.
    """

    target: str
    carry: Function
    map: str | None = None
    meaning: str = ""
    exact: bool = True
    back: Function | None = None


def pullback(target: System, carry: Function) -> Callable[[Function], Function]:
    """Functions of the target at the image of a state, by `carry` of a `Relation`, as functions of that state."""
    letters = {p.letter for p in target.parameters}

    def pulled(function: Function) -> Function:
        def at_image(*state: Array, **constants: Any) -> Any:
            image, params = call(carry, (*state, None), constants)
            return call(function, image, {**constants, **params})

        return naming(at_image, carry, keywords(function) - letters)

    return pulled


@dataclass(frozen=True)
class Orbit:
    """One trajectory in closed form: three phases give the position, 64-bit fractions of one revolution.

    phases(M, e)  -> (times, 4) unsigned integers, at times M 2^e: Python integers in an object array, small integers;
                  the last one has the next 64 places of the first phase, for small times
    rates         of the phases if they grow like the time, revolutions per unit of time as integers of `bits` binary
                  places; else None
    place(j)      -> (terms, values), for part j of the 2^places parts of the first phase: values that are polynomials
                  in x, from -1 at the start of the part to 1 at its end; the lowest power first
    row(place, left, right, **constants) -> z, from these values at one x; `left` and `right` are 2 pi times the other
                  phases, as (cos, sin, rest of the angle, at most pi/512): half the angles of rotation, so that a
                  quaternion is continuous.  Compiled by an engine.
    """

    phases: Callable[[Array, Array], Array]
    rates: tuple[int, int, int] | None
    bits: int
    places: int
    place: Callable[[int], Array]
    row: Callable[..., tuple[Array, ...]]
    constants: Mapping[str, Array]


States = Callable[[Array, Array], tuple[Array, ...]]  # (M, e) -> z at the times M 2^e: an orbit as a function


@dataclass(frozen=True)
class ClosedForm:
    """Functions that give the flow in closed form.

    top(*state)   (m, a, p) of the Lagrange top in space with this motion, at time 0
    moments()     the principal moments of a free body, n = 3, whose momentum obeys Euler's equations
    gyrostat()    w and b, n = 3, of a momentum that obeys M' = M x (w M - b), w a diagonal
    step(*state, h), reach(*state, h)   the state after the time h, and a measure of h: precise up to 1
    """

    top: Function | None = None
    moments: Function | None = None
    gyrostat: Function | None = None
    step: Function | None = None
    reach: Function | None = None


@dataclass(frozen=True)
class Checks:
    """Checks of parameters and states.

    parameters(params)   raises `InputError` for contradictory parameters
    state                letter -> check(component, letter), which raises `InputError` for a component without a meaning
    doubts(params)       sentences on parameters that are possible but seldom meant, for `InputWarning`
    idle(params)         sentences on parameters that have no effect, unless user-defined functions read them
    lasting(params, epoch, seconds)  sentences on models that do not hold for so long after the epoch, ISO text or ""
    """

    parameters: Function | None = None
    state: Mapping[str, Function] = field(default_factory=dict)
    doubts: Function | None = None
    idle: Function | None = None
    lasting: Function | None = None


def _velocity(
    momentum: Function, inverse_inertia: Function, spin: Function | None, *state: Array, **constants: Any
) -> Array:
    Omega = call(inverse_inertia, (momentum(*state),), constants)
    return Omega if spin is None else Omega + call(spin, state, constants)


@explained
@dataclass(frozen=True)
class System:
    """The record of a system.  Call it with parameters to get a `Model`: `LagrangeTop(p=(0, 0, 1))`.

    energy(*state, eps=0)    at eps = 0 the Hamiltonian H, with F' = {H, F}; else the energy of the map
    integrals                name -> function; those that name `eps` are deformed by the map
    invariant                name -> (f, k) with f' = k f: f is not an integral, but f = 0 stays
    commuting                the integrals that are in involution with each other and the energy
    lax(*state, lam)         the pair (L, U) with L' = [L, U]
    velocity(*state)         the angular velocity: g' = omega g (rest frame), g' = g Omega (moving frame); without it
                             dT/dM + spin, if inverse_inertia is stated
    inverse_inertia(M)       dT/dM, linear in the momentum M, if H = T(M) + V(vector)
    translation(*state)      U = dH/dP, the velocity of a body with the momentum P in its frame: x' = g U
    spin(*state)             the velocity minus dT/dM: a rotation about the vector, of which H is independent
    pairs                    conjugate pairs of Bäcklund maps, of which the flow over a time is a product
    exact_map                a map that is the flow over a time
    closed_form              the flow in closed form, if known without a Bäcklund transformation
    derive(params)           further constants computed once from the parameters: a differentiable formula
    body_frame(params)       the `BodyFrame` of a system that is a body in SI units, from parameters and constants
    checks                   of parameters and states, beyond the checks of each `Parameter`
    n                        the dimension, if the parameters do not determine it
    values                 "any": the functions accept any kind of number; "real": any with square roots; "jax":
                             floats and JAX arrays (`kreisel.reduction`), and steps are compiled by JAX
    perturbation             the integrable system of which this is a perturbation, and the forces (`kr.perturbed`);
                             then flow and energy may have the keywords g, the orientation as a matrix, and t, the time
    product                  the bodies of which this is a product (`kreisel.forces.product`)
    """

    name: str
    title: str
    equations: str
    source: str
    space: PhaseSpace
    parameters: tuple[Parameter, ...] = ()
    flow: Function | None = None
    energy: Function | None = None
    velocity: Function | None = None
    scaling: str = "Any consistent units."
    integrals: Mapping[str, Function] = field(default_factory=dict)
    invariant: Mapping[str, tuple[Function, Function]] = field(default_factory=dict)
    commuting: tuple[str, ...] = ()
    lax: Function | None = None
    inverse_inertia: Function | None = None
    translation: Function | None = None
    spin: Function | None = None
    map: Map | None = None
    baecklund: Baecklund | None = None
    pairs: ConjugatePairs | None = None
    exact_map: ExactMap | None = None
    relations: tuple[Relation, ...] = ()
    closed_form: ClosedForm = ClosedForm()
    derive: Function | None = None
    body_frame: Function | None = None
    checks: Checks = Checks()
    notes: str = ""
    n: int | None = None
    numbers: str = "any"
    perturbation: Perturbation | None = None
    product: tuple[Any, ...] = ()

    @property
    def frame(self) -> Frame:
        """The frame of the state."""
        return self.space.frame

    def __call__(self, *unnamed: Any, **params: Any) -> Model:
        """The system with these parameters, by name.  Raises `InputError` as `Model` does."""
        require_names(unnamed, self.name, [p.letter for p in self.parameters])
        sites = next((params.get(p.letter) for p in self.parameters if p.kind == "dimension"), None)
        for p in self.parameters:
            if p.letter in params:
                require_one_reading(p, params[p.letter], self.name, sites if self.space.sites else None)
        return Model(self, params)

    def remade_by(self, function: Function, *arguments: Any) -> System:
        """System itself, for which pickle and copy keep the call that creates it again instead of its functions."""
        object.__setattr__(self, "_origin", (function, arguments))
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != KEPT}

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        return self.__dict__.get("_origin") or object.__reduce_ex__(self, protocol)

    def __repr__(self) -> str:
        return f"<kreisel system {self.name!r}: {self.title}>"

    def _repr_html_(self) -> str:
        return str(show("system", self))

    def __post_init__(self) -> None:
        names = [*self.space.letters, "eps", "lam", *(p.letter for p in self.parameters)]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(
                f"{self.name}: parameters: expected letters that neither another parameter nor the state nor the step "
                f"has, {', '.join(self.space.letters)}, eps, lam, got {twice[0]}."
            )
        letters = "\n".join(f"    {p.letter} ({p.kind}): {p.meaning}" for p in self.parameters)
        text = f"{self.title}: {self.equations}  [{self.source}]\n\nParameters:\n{letters}\n\n{self.scaling}"
        object.__setattr__(self, "__doc__", text)
        if self.velocity is None and self.inverse_inertia is not None and self.space.momentum is not None:
            remainder = () if self.spin is None else (self.spin,)
            velocity = partial(_velocity, self.space.momentum, self.inverse_inertia, self.spin)
            object.__setattr__(self, "velocity", naming(velocity, self.inverse_inertia, *remainder))

    @property
    def __signature__(self) -> inspect.Signature:
        keyword = inspect.Parameter.KEYWORD_ONLY
        defaults = {p.letter: inspect.Parameter.empty if p.default is None else p.default for p in self.parameters}
        return inspect.Signature([inspect.Parameter(k, keyword, default=default) for k, default in defaults.items()])
