"""MuJoCo: a body with a free joint, or a ball joint if there is a pivot.  Setting: the integrator."""

import mujoco
from wire import serve


def start(job):
    moments = " ".join(repr(job["inertia"][k][k]) for k in range(3))
    arm = " ".join(repr(a) for a in job["arm"] or [0.0] * 3)
    gravity = " ".join(repr(a) for a in job["gravity"] or [0.0] * 3)
    joint = "ball" if job["arm"] else "free"
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{job["dt"]!r}" integrator="{job["setting"]}" gravity="{gravity}">
          <flag autoreset="disable"/>
        </option>
        <worldbody><body>
          <joint type="{joint}"/><inertial pos="{arm}" mass="{job["mass"]!r}" diaginertia="{moments}"/>
        </body></worldbody>
      </mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[-4:] = job["attitude"]
    data.qvel[-3:] = job["angular_velocity"]

    return lambda n: mujoco.mj_step(model, data, n), lambda: (data.qpos[-4:], data.qvel[-3:])


serve(start, frame="body")
