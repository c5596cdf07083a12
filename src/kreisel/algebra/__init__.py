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
    LINEAR_ALGEBRA as LINEAR_ALGEBRA,
    Array as Array,
    complex_number as complex_number,
    conjugate as conjugate,
    first_not_finite as first_not_finite,
    floats as floats,
    holds_objects as holds_objects,
    identity as identity,
    if_positive as if_positive,
    is_known_zero as is_known_zero,
    is_number as is_number,
    lanes_in_front as lanes_in_front,
    log as log,
    loses as loses,
    magnitude as magnitude,
    mat as mat,
    maximum as maximum,
    nearest as nearest,
    objects as objects,
    parts as parts,
    principal_axes as principal_axes,
    rounded as rounded,
    sign as sign,
    solve as solve,
    sqrt as sqrt,
    together as together,
    trace_log as trace_log,
    vec as vec,
    where_less as where_less,
)
from kreisel.algebra.kinds import (
    KINDS as KINDS,
    coordinate_count as coordinate_count,
    flatten as flatten,
    restore as restore,
    slices as slices,
)
from kreisel.algebra.rotations import (
    SECOND as SECOND,
    THIRD as THIRD,
    act as act,
    axial as axial,
    bracket as bracket,
    cayley as cayley,
    cayley_act as cayley_act,
    cayley_columns as cayley_columns,
    cayley_conjugate as cayley_conjugate,
    cayley_plane as cayley_plane,
    conjugated as conjugated,
    continued as continued,
    coordinates as coordinates,
    cross as cross,
    diagonal_resolvent as diagonal_resolvent,
    dot as dot,
    double_turn as double_turn,
    half_turn as half_turn,
    hat as hat,
    inverse_turn as inverse_turn,
    moebius as moebius,
    pairing as pairing,
    pfaffians as pfaffians,
    polynomial as polynomial,
    project_out as project_out,
    quaternion as quaternion,
    quaternion_product as quaternion_product,
    resolvent as resolvent,
    rotation_matrix as rotation_matrix,
    shifted_resolvent as shifted_resolvent,
    skew as skew,
    symmetric as symmetric,
    triangle as triangle,
    triangle_with_diagonal as triangle_with_diagonal,
    turn as turn,
    turn_left as turn_left,
    turn_right as turn_right,
    unit as unit,
    unit_quaternion as unit_quaternion,
    wedge as wedge,
)

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
