"""JAX-MD: simulate.nve of a rigid body whose moments are given in place of a shape, in doubles (JAX_ENABLE_X64=1).

It rounds the step to single precision, so that its time is off by 1e-8 to 1e-7.
"""

import jax
import jax.numpy as jnp
from jax_md import rigid_body, simulate
from wire import serve


def start(job):
    moments = [job["inertia"][k][k] for k in range(3)]
    body = rigid_body.RigidBody(jnp.zeros((1, 3)), rigid_body.Quaternion(jnp.array([job["attitude"]])))
    mass = rigid_body.RigidBody(jnp.array([[job["mass"]]]), jnp.array([moments]))
    init, step = simulate.nve(lambda body, **_: 0.0, lambda position, change, **_: position + change, job["dt"])
    state = init(jax.random.PRNGKey(0), body, 0.0, mass=mass)
    momentum = jnp.array([[moments[k] * job["angular_velocity"][k] for k in range(3)]])
    state = state.set(
        momentum=rigid_body.RigidBody(
            jnp.zeros((1, 3)), rigid_body.angular_momentum_to_conjugate_momentum(body.orientation, momentum)
        )
    )

    @jax.jit
    def steps(state, n):
        return jax.lax.fori_loop(0, n, lambda _, s: step(s), state)

    jax.block_until_ready(steps(state, 1))  # compiles
    now = [state]

    def advance(n):
        now[0] = jax.block_until_ready(steps(now[0], n))

    def read():
        q, p = now[0].position.orientation, now[0].momentum.orientation
        spin = rigid_body.conjugate_momentum_to_angular_momentum(q, p)[0]
        return q.vec[0], [spin[k] / moments[k] for k in range(3)]

    return advance, read


serve(start, frame="body")
