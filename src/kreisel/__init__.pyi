# Made by `make stubs` from the records; not to be edited.
from numpy.typing import ArrayLike

from kreisel.errors import AccuracyWarning as AccuracyWarning
from kreisel.errors import ConservationWarning as ConservationWarning
from kreisel.errors import InputError as InputError
from kreisel.errors import InputWarning as InputWarning
from kreisel.errors import RunError as RunError
from kreisel.method import Method
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel import analysis as analysis
from kreisel import checkcases as checkcases
from kreisel import gym as gym
from kreisel import lab as lab
from kreisel import physical as physical
from kreisel import rebound as rebound
from kreisel import reduction as reduction
from kreisel import units as units
from kreisel.physical.control import Control as Control
from kreisel.sweeps.design import Design as Design
from kreisel.runs.settings import Event as Event
from kreisel.record.table import Table as Table
from kreisel.runs.closed_form import at as at
from kreisel.runs.run_record import cite as cite
from kreisel.languages.source import code as code
from kreisel.analysis.method_comparison import compare as compare
from kreisel.runs.differentiable import differentiable as differentiable
from kreisel.runs.drift import drift as drift
from kreisel.storage.exporting import export as export
from kreisel.sweeps.sweep import failures as failures
from kreisel.analysis.fit import fit as fit
from kreisel.runs.closed_form import nutation as nutation
from kreisel.sweeps.grids import open_run as open_run
from kreisel.forces.body import perturbed as perturbed
from kreisel.viewer.plots import plot as plot
from kreisel.runs.propagation.propagator import propagator as propagator
from kreisel.storage.simulate import resume as resume
from kreisel.storage.simulate import simulate as simulate
from kreisel.sweeps.sweep import sweep as sweep
from kreisel.runs.differentiable import tangent as tangent
from kreisel.storage.exporting import to_numpy as to_numpy
from kreisel.viewer.page import view as view

__version__: str

def methods() -> list[Method]: ...
def systems() -> list[str]: ...

class _Clebsch(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
    ) -> Model:
        r"""Clebsch's case, the special flow c = 1.

        b: diagonal of B: H has -<P, BP>/2. Adding a constant to b does not change the flow"""

Clebsch: _Clebsch

class _ClebschBody(System):
    def __call__(
        self,
        *,
        J: ArrayLike,
    ) -> Model:
        r"""Clebsch's case, the flow of a body, c = 1/(J_j + J_k).

        J: diagonal of the mass tensor (n = 3: I_1 = J_2 + J_3, ...)"""

ClebschBody: _ClebschBody

class _ClebschGeneral(System):
    def __call__(
        self,
        *,
        a: ArrayLike,
        b: ArrayLike,
    ) -> Model:
        r"""Clebsch's case of Kirchhoff's equations.

        a: diagonal of A, distinct entries
        b: diagonal of B: H has -<P, BP>/2"""

ClebschGeneral: _ClebschGeneral

class _EulerTop(System):
    def __call__(
        self,
        *,
        J: ArrayLike,
    ) -> Model:
        r"""Euler top, moving frame.

        J: diagonal of the mass tensor (n = 3: I_1 = J_2 + J_3, ...)"""

EulerTop: _EulerTop

class _GoryachevChaplygin(System):
    def __call__(
        self,
        *,
        gamma: ArrayLike = 0.0,
    ) -> Model:
        r"""Goryachev-Chaplygin top.

        gamma: the momentum of a rotor along the third axis"""

GoryachevChaplygin: _GoryachevChaplygin

class _HeavyTop(System):
    def __call__(
        self,
        *,
        J: ArrayLike,
        A: ArrayLike,
    ) -> Model:
        r"""Heavy top, moving frame.

        J: mass tensor sum m x x^T (n = 3: J = tr(I)/2 - I from the classical inertia tensor I)
        A: from the fixed point to the centre of mass, in the body"""

HeavyTop: _HeavyTop

class _HeisenbergChain(System):
    def __call__(
        self,
        *,
        n: int,
        J: ArrayLike = 1.0,
        closing: ArrayLike = 1.0,
    ) -> Model:
        r"""Classical Heisenberg chain.

        n: the number of sites
        J: coupling of neighbours: ferromagnet for J > 0
        closing: factor of the bond of last and first site: 1 ring, 0 open chain"""

HeisenbergChain: _HeisenbergChain

class _HessAppelrot(System):
    def __call__(
        self,
        *,
        a: ArrayLike,
        k: ArrayLike,
        x: ArrayLike,
        z: ArrayLike,
    ) -> Model:
        r"""Hess and Appelrot's heavy top.

        a: the least of the inverse moments
        k: the others are a + k x^2 and a + k (x^2 + z^2)
        x: first coordinate of the centre of mass (x, 0, z)
        z: third coordinate of the centre of mass"""

HessAppelrot: _HessAppelrot

class _Kirchhoff(System):
    def __call__(
        self,
        *,
        C: ArrayLike,
        B: ArrayLike,
    ) -> Model:
        r"""Kirchhoff's rigid body in an ideal fluid.

        C: inverse moments c_jk, one for each plane (j, k); the diagonal is not used
        B: H has -<P, BP>/2: minus the inverse masses; a matrix or its diagonal"""

Kirchhoff: _Kirchhoff

class _KirchhoffCase(System):
    def __call__(
        self,
        *,
        a1: ArrayLike,
        a3: ArrayLike,
        b1: ArrayLike,
        b3: ArrayLike,
        c1: ArrayLike,
        c3: ArrayLike,
    ) -> Model:
        r"""Kirchhoff's case of a body of revolution in a fluid.

        a1: coefficient of (M_1^2 + M_2^2)/2 in H
        a3: coefficient of M_3^2/2 in H
        b1: coefficient of M_1 P_1 + M_2 P_2 in H
        b3: coefficient of M_3 P_3 in H
        c1: coefficient of (P_1^2 + P_2^2)/2 in H
        c3: coefficient of P_3^2/2 in H"""

KirchhoffCase: _KirchhoffCase

class _KirchhoffRevolution(System):
    def __call__(
        self,
        *,
        a1: ArrayLike,
        a3: ArrayLike,
        c1: ArrayLike,
        c3: ArrayLike,
        n: int = 3,
    ) -> Model:
        r"""Kirchhoff's case of a body of revolution in a fluid, without mixed terms.

        a1: inverse moment of inertia across the axis
        a3: inverse moment of inertia about the axis
        c1: inverse mass across the axis, with the added mass
        c3: inverse mass along the axis, with the added mass
        n: the dimension of the space"""

KirchhoffRevolution: _KirchhoffRevolution

class _Komarov(System):
    def __call__(
        self,
        *,
        kappa: ArrayLike = 0.0,
        beta: ArrayLike = 0.0,
        c: ArrayLike = 1.0,
        gamma: ArrayLike = 0.0,
    ) -> Model:
        r"""Kovalevskaya's top on e(3), so(4) and so(3,1), with Sokolov's terms and a rotor.

        kappa: curvature of the phase space: zero is e(3), negative so(4), positive so(3,1)
        beta: strength of Sokolov's terms
        c: strength of the linear potential
        gamma: the momentum of a rotor along the third axis"""

Komarov: _Komarov

class _KovalevskayaGyrostat(System):
    def __call__(
        self,
        *,
        n: int,
        gamma: ArrayLike,
    ) -> Model:
        r"""Kovalevskaya gyrostat in two fields.

        n: the dimension of the space
        gamma: the momentum of the rotor, in the plane of e_1 and e_2"""

KovalevskayaGyrostat: _KovalevskayaGyrostat

class _KovalevskayaTop(System):
    def __call__(
        self,
        *,
        n: int,
    ) -> Model:
        r"""Kovalevskaya top in two fields.

        n: the dimension of the space"""

KovalevskayaTop: _KovalevskayaTop

class _KovalevskayaTopE3(System):
    def __call__(
        self,
    ) -> Model:
        r"""Kovalevskaya's top of 1889."""

KovalevskayaTopE3: _KovalevskayaTopE3

class _KovalevskayaTopSO3(System):
    def __call__(
        self,
    ) -> Model:
        r"""Kovalevskaya top, n = 3, in two fields."""

KovalevskayaTopSO3: _KovalevskayaTopSO3

class _KovalevskayaTopSP4(System):
    def __call__(
        self,
    ) -> Model:
        r"""Kovalevskaya's top of 1889, with a second map."""

KovalevskayaTopSP4: _KovalevskayaTopSP4

class _LagrangeTop(System):
    def __call__(
        self,
        *,
        p: ArrayLike,
        alpha: ArrayLike = 1.0,
    ) -> Model:
        r"""Lagrange top, rest frame.

        p: gravity vector in the rest frame: the potential energy is <p, a>
        alpha: axial over transverse moment of inertia, not 0; only the orientation feels it"""

LagrangeTop: _LagrangeTop

class _LagrangeTopMoving(System):
    def __call__(
        self,
        *,
        A: ArrayLike,
        alpha: ArrayLike = 1.0,
    ) -> Model:
        r"""Lagrange top, moving frame.

        A: from the fixed point to the centre of mass; |A| scales <P, A>
        alpha: axial over transverse moment of inertia, not 0"""

LagrangeTopMoving: _LagrangeTopMoving

class _LagrangeTopSU2(System):
    def __call__(
        self,
        *,
        p: ArrayLike,
        alpha: ArrayLike = 1.0,
    ) -> Model:
        r"""Lagrange top on SU(2), rest frame.

        p: gravity vector in the rest frame: the potential energy is <p, a>
        alpha: axial over transverse moment of inertia, not 0; only the orientation feels it"""

LagrangeTopSU2: _LagrangeTopSU2

class _LagrangeTopSU2Moving(System):
    def __call__(
        self,
        *,
        A: ArrayLike,
        alpha: ArrayLike = 1.0,
    ) -> Model:
        r"""Lagrange top on SU(2), moving frame.

        A: from the fixed point to the centre of mass; |A| scales <P, A>
        alpha: axial over transverse moment of inertia, not 0"""

LagrangeTopSU2Moving: _LagrangeTopSU2Moving

class _LatticeLandauLifshitz(System):
    def __call__(
        self,
        *,
        n: int,
        D: ArrayLike = 0.0,
    ) -> Model:
        r"""Lattice Landau-Lifshitz model with one axis.

        n: half the number of sites of the ring
        D: anisotropy: easy axis D > 0, easy plane -1 < D < 0"""

LatticeLandauLifshitz: _LatticeLandauLifshitz

class _Lyapunov(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
        nu: ArrayLike,
    ) -> Model:
        r"""Lyapunov's case of a body in a fluid.

        b: H has b_i M_i^2/2
        nu: strength of the mixed terms, not 0"""

Lyapunov: _Lyapunov

class _ManakovTop(System):
    def __call__(
        self,
        *,
        a: ArrayLike,
        b: ArrayLike,
    ) -> Model:
        r"""Euler top with Manakov's metrics.

        a: diagonal of A, distinct entries
        b: diagonal of B"""

ManakovTop: _ManakovTop

class _Neumann(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
    ) -> Model:
        r"""Neumann's particle on the sphere.

        b: diagonal of B: the potential energy is -<x, Bx>/2"""

Neumann: _Neumann

class _NeumannVeselov(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
    ) -> Model:
        r"""Neumann's particle on the sphere, Veselov's map.

        b: diagonal of B: the potential energy is -<x, Bx>/2"""

NeumannVeselov: _NeumannVeselov

class _QuadraticField(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
    ) -> Model:
        r"""Body with equal moments in a quadratic potential.

        b: diagonal of B: the potential energy is -tr(B F)/2"""

QuadraticField: _QuadraticField

class _QuadraticPotential(System):
    def __call__(
        self,
        *,
        J: ArrayLike,
    ) -> Model:
        r"""Rigid body in a quadratic potential.

        J: diagonal of the mass tensor (n = 3: I_1 = J_2 + J_3, ...)"""

QuadraticPotential: _QuadraticPotential

class _RatiuBitop(System):
    def __call__(
        self,
        *,
        a: ArrayLike,
        b: ArrayLike,
        chi12: ArrayLike,
        chi34: ArrayLike = 0.0,
    ) -> Model:
        r"""Lagrange bitop, and Ratiu's Lagrange top for n = 4.

        a: J_1 = J_2, positive
        b: J_3 = ... = J_n, positive
        chi12: strength of the field in the plane (1, 2)
        chi34: strength of the field in the plane (3, 4); 0 for Ratiu's top"""

RatiuBitop: _RatiuBitop

class _RatiuTop(System):
    def __call__(
        self,
        *,
        n: int,
        a: ArrayLike,
        b: ArrayLike,
        chi: ArrayLike,
    ) -> Model:
        r"""Ratiu's Lagrange top.

        n: the dimension of the space
        a: J_1 = J_2, positive
        b: J_3 = ... = J_n, positive
        chi: chi_12, the strength of the field"""

RatiuTop: _RatiuTop

class _Rosochatius(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
        mu: ArrayLike,
    ) -> Model:
        r"""Rosochatius's particle on the sphere.

        b: diagonal of B, distinct entries: H has -<x, Bx>/2
        mu: strengths of the walls x_i = 0: H has mu_i^2/(2 x_i^2)"""

Rosochatius: _Rosochatius

class _Rubanovskii(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
        h: ArrayLike,
        s: ArrayLike = 0.0,
        l: ArrayLike = 1.0,
    ) -> Model:
        r"""Rubanovskii's gyrostat in a fluid.

        b: diagonal of B
        h: the momentum of the rotor
        s: how much of Steklov's H
        l: how much of Lyapunov's H"""

Rubanovskii: _Rubanovskii

class _SpinChain(System):
    def __call__(
        self,
        *,
        n: int,
        Jx: ArrayLike = 1.0,
        Jy: ArrayLike = 1.0,
        Jz: ArrayLike = 1.0,
        Bx: ArrayLike = 0.0,
        By: ArrayLike = 0.0,
        Bz: ArrayLike = 0.0,
        K: ArrayLike = 0.0,
        closing: ArrayLike = 1.0,
    ) -> Model:
        r"""Classical spin chain, XYZ, in a field.

        n: the number of sites
        Jx: coupling of the x components
        Jy: coupling of the y components
        Jz: coupling of the z components
        Bx: x component of the field
        By: y component of the field
        Bz: z component of the field
        K: anisotropy of a site: easy axis for K > 0, easy plane for K < 0
        closing: factor of the bond of last and first site: 1 ring, 0 open chain"""

SpinChain: _SpinChain

class _Steklov(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
        nu: ArrayLike,
    ) -> Model:
        r"""Steklov's case of a body in a fluid.

        b: H has b_i M_i^2/2
        nu: strength of the mixed terms, not 0"""

Steklov: _Steklov

class _SteklovLyapunov(System):
    def __call__(
        self,
        *,
        b: ArrayLike,
        s: ArrayLike,
        l: ArrayLike,
    ) -> Model:
        r"""Steklov's and Lyapunov's cases of a body in a fluid.

        b: diagonal of B
        s: how much of Steklov's H
        l: how much of Lyapunov's H"""

SteklovLyapunov: _SteklovLyapunov

class _SymmetricTop(System):
    def __call__(
        self,
        *,
        A: ArrayLike,
    ) -> Model:
        r"""Totally symmetric Lagrange top, moving frame.

        A: from the fixed point to the centre of mass, in the body"""

SymmetricTop: _SymmetricTop

class _SymmetricTopLogarithmic(System):
    def __call__(
        self,
        *,
        A: ArrayLike,
    ) -> Model:
        r"""Totally symmetric Lagrange top, moving frame, in a logarithmic potential.

        A: from the fixed point to the centre of mass, in the body"""

SymmetricTopLogarithmic: _SymmetricTopLogarithmic

class _UniaxialChain(System):
    def __call__(
        self,
        *,
        n: int,
        J: ArrayLike = 1.0,
        Jz: ArrayLike = 1.0,
        Bz: ArrayLike = 0.0,
        K: ArrayLike = 0.0,
        closing: ArrayLike = 1.0,
    ) -> Model:
        r"""Classical XXZ chain, field along z.

        n: the number of sites
        J: coupling of the x and y components
        Jz: coupling of the z components
        Bz: z component of the field
        K: anisotropy of a site: easy axis for K > 0, easy plane for K < 0
        closing: factor of the bond of last and first site: 1 ring, 0 open chain"""

UniaxialChain: _UniaxialChain

class _ZhukovskyVolterra(System):
    def __call__(
        self,
        *,
        J: ArrayLike,
        h: ArrayLike,
    ) -> Model:
        r"""Zhukovsky-Volterra gyrostat.

        J: diagonal of the mass tensor of body and wheel (I_1 = J_2 + J_3, ...)
        h: momentum of the wheel relative to the body"""

ZhukovskyVolterra: _ZhukovskyVolterra
