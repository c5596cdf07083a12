"""Roots by Newton's method on the branch that starts at a known point: x = 0 is W = I, or Omega = 0.

An implicit map is multivalued; of its branches the one with the continuous limit is followed.  Newton's method starts
from x = 0 (its first step is the continuous guess).  Its answer is accepted if it converged and is the root next to the
start: |x| is at most twice the first step, as in Kantorovich's theorem, and the determinant of the Jacobian has kept
its sign.  Where that fails, the root of r(x) = (1 - s) r(0) is followed from x = 0 at s = 0 to s = 1.  If it meets a
fold on the way there is no root on the branch, and x is NaN.

Derivatives of the root come from the implicit function theorem (Optimistix).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kreisel.algebra import Array
from kreisel.reduction.double import jax, optimistix

jnp = jax.numpy
lax = jax.lax

TOLERANCE = 1e-10  # of a Newton step, relative to 1; the error after it is its square
ROUGH = 1e-6
MOST_ITERATIONS = 30
SHORTEST = 1 / 1024  # of a stretch of the path that is followed
Residual = Callable[[Array, Any], Array]


def _newton(residual: Residual, start: Array, args: Any, tolerance: float) -> tuple[Array, Array]:
    solver = optimistix.Newton(rtol=0.0, atol=tolerance)
    found = optimistix.root_find(residual, solver, start, args, max_steps=MOST_ITERATIONS, throw=False)
    fine = (found.result == optimistix.RESULTS.successful) & jnp.isfinite(found.value).all()
    return found.value, fine


def find(residual: Residual, dim: int, args: Any) -> Array:
    """The root x (dim,) of residual(x, args) on the branch of x = 0; NaN where there is none."""
    zero = jnp.zeros(dim)
    held = lax.stop_gradient(args)
    inverse = jnp.linalg.inv(jax.jacfwd(residual)(zero, held))

    def scaled(x: Array, args: Any) -> Array:  # the identity to first order in x
        return inverse @ residual(x, args)

    offset = scaled(zero, held)

    def near(x: Array, fine: Array, start: Array, first: Array) -> Array:
        """Converged to the root next to `start`, where Newton's first step was `first`."""
        turned = jnp.linalg.det(jax.jacfwd(scaled)(x, held))
        reach = 2 * jnp.linalg.norm(first) + ROUGH
        return fine & (turned > 0) & (jnp.linalg.norm(x - start) <= reach)

    x, fine = _newton(scaled, zero, held, ROUGH)
    x, found = _follow(scaled, offset, near, held, x, near(x, fine, zero, offset))
    x, fine = _newton(scaled, lax.stop_gradient(jnp.where(found, x, jnp.nan)), args, TOLERANCE)
    return jnp.where(found & fine, x, jnp.nan)


def _follow(
    scaled: Residual, offset: Array, near: Callable[..., Array], args: Any, x: Array, found: Array
) -> tuple[Array, Array]:
    """Follow scaled(x) = (1 - s) offset from x = 0, s = 0 to s = 1, unless the root is found already."""

    def staged(x: Array, known: tuple[Array, Any]) -> Array:
        s, args = known
        return scaled(x, args) - (1 - s) * offset

    def going(carry: tuple[Array, ...]) -> Array:
        s, stretch, _ = carry
        return (s < 1) & (stretch >= SHORTEST)

    def onward(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        s, stretch, x = carry
        target = jnp.minimum(s + stretch, 1.0)
        first = jnp.linalg.solve(jax.jacfwd(staged)(x, (target, args)), staged(x, (target, args)))
        new, fine = _newton(lambda y, known: staged(y, known), x, (target, args), ROUGH)
        good = near(new, fine, x, first)
        return (
            jnp.where(good, target, s),
            jnp.where(good, 2 * stretch, stretch / 2),
            jnp.where(good, new, x),
        )

    begin = (jnp.where(found, 1.0, 0.0), jnp.asarray(0.25), jnp.where(found, x, jnp.zeros_like(x)))
    s, _, x = lax.while_loop(going, onward, begin)
    return x, s >= 1
