"""so(n), e*(n) and the Cayley transform, for any kind of number.

| thing      | convention                                                                     |
|------------|--------------------------------------------------------------------------------|
| pairing    | <X, Y> = -tr(XY)/2 on so(n), Euclidean on R^n                                    |
| wedge      | x ^ y = x y^T - y x^T                                                            |
| Cayley     | cay(X) = (I + X)(I - X)^-1                                                       |
| n = 3      | hat(v) x = v x x (cross product), so x ^ y = hat(y x x)                           |
| batch axes | in front: skew matrices are (..., n, n), vectors (..., n), scalars (...)          |

Every function works on NumPy and JAX arrays and on NumPy object arrays of any field (fractions,
python-flint rationals, SymPy expressions, the recorded values of `kreisel.graph`).
Only `backend` distinguishes the kinds.  [Suris 2001, sections 2 and 4]
"""

from kreisel.algebra.backend import (
    LINEAR_ALGEBRA,
    Array,
    complex_number,
    conjugate,
    floats,
    holds_objects,
    identity,
    if_positive,
    is_known_zero,
    is_number,
    lanes_in_front,
    log,
    loses,
    magnitude,
    mat,
    maximum,
    nearest,
    objects,
    parts,
    principal_axes,
    rounded,
    sign,
    solve,
    sqrt,
    together,
    trace_log,
    vec,
    where_less,
)
from kreisel.algebra.kinds import KINDS, coordinate_count, flatten, restore, slices
from kreisel.algebra.rotations import (
    SECOND,
    THIRD,
    act,
    axial,
    bracket,
    cayley,
    cayley_act,
    cayley_columns,
    cayley_conjugate,
    cayley_plane,
    conjugated,
    continued,
    coordinates,
    cross,
    diagonal_resolvent,
    dot,
    double_turn,
    half_turn,
    hat,
    inverse_turn,
    moebius,
    pairing,
    pfaffians,
    polynomial,
    project_out,
    quaternion,
    quaternion_product,
    resolvent,
    rotation_matrix,
    shifted_resolvent,
    skew,
    symmetric,
    triangle,
    triangle_with_diagonal,
    turn,
    turn_left,
    turn_right,
    unit,
    unit_quaternion,
    wedge,
)

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
