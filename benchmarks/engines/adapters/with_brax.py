"""Brax: a free body, in doubles on the CPU (JAX_ENABLE_X64=1).  Setting: the pipeline."""

import jax
import jax.numpy as jnp
from brax.generalized import pipeline as generalized
from brax.io import mjcf
from brax.positional import pipeline as positional
from brax.spring import pipeline as spring
from wire import serve


def start(job):
    moments = " ".join(repr(job["inertia"][k][k]) for k in range(3))
    system = mjcf.loads(f"""
      <mujoco>
        <option timestep="{job["dt"]!r}" gravity="0 0 0"/>
        <worldbody><body>
          <freejoint/><inertial pos="0 0 0" mass="{job["mass"]!r}" diaginertia="{moments}"/>
          <geom type="sphere" size="0.01" contype="0" conaffinity="0" mass="0"/>
        </body></worldbody>
      </mujoco>""")
    pipeline = {"generalized": generalized, "spring": spring, "positional": positional}[job["setting"]]
    q = jnp.array([0.0] * 3 + job["attitude"])
    state = pipeline.init(system, q, jnp.array([0.0] * 3 + job["angular_velocity"]))
    action = jnp.zeros(system.act_size())

    @jax.jit
    def steps(state, n):
        return jax.lax.fori_loop(0, n, lambda _, s: pipeline.step(system, s, action), state)

    jax.block_until_ready(steps(state, 1))  # compiles
    now = [state]

    def advance(n):
        now[0] = jax.block_until_ready(steps(now[0], n))

    return advance, lambda: (now[0].x.rot[0], now[0].xd.ang[0])


serve(start)
