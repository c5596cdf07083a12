"""MJX, MuJoCo in JAX, in doubles on the CPU, with a free joint or a ball joint.  Setting: the integrator."""

import jax
import mujoco
from mujoco import mjx
from wire import serve


def start(job):
    jax.config.update("jax_enable_x64", True)
    moments = " ".join(repr(job["inertia"][k][k]) for k in range(3))
    arm = " ".join(repr(a) for a in job["arm"] or [0.0] * 3)
    gravity = " ".join(repr(a) for a in job["gravity"] or [0.0] * 3)
    joint = "ball" if job["arm"] else "free"
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{job["dt"]!r}" integrator="{job["setting"]}" gravity="{gravity}"/>
        <worldbody><body>
          <joint type="{joint}"/><inertial pos="{arm}" mass="{job["mass"]!r}" diaginertia="{moments}"/>
        </body></worldbody>
      </mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[-4:] = job["attitude"]
    data.qvel[-3:] = job["angular_velocity"]
    place, now = mjx.put_model(model), [mjx.put_data(model, data)]

    @jax.jit
    def steps(data, n):
        return jax.lax.fori_loop(0, n, lambda _, d: mjx.step(place, d), data)

    jax.block_until_ready(steps(now[0], 1))  # compiles

    def advance(n):
        now[0] = jax.block_until_ready(steps(now[0], n))

    return advance, lambda: (now[0].qpos[-4:], now[0].qvel[-3:])


serve(start, frame="body")
